"""A `while` that never ends is left on OpenCL, since nobody could stop it; loops that end are whole."""

import numpy as np
import pytest
from opencl_runner import run_opencl
from test_shading_checked import line_of

from rhi.errors import ShaderError
from rhi.shading import Shader, Storage, StorageRW, global_id
from rhi.shading.lowering.functions import MOST_TURNS

N = 32


class Turns(Shader):
    work_group = (N,)
    most: Storage[int]
    out: StorageRW[int]

    def compute(self) -> None:
        i = global_id().x
        n = 0
        while n < self.most[i]:
            n += 1
            if n < 0:
                n = 1
        self.out[i] = n


class Counted(Turns):
    def compute(self) -> None:
        i = global_id().x
        n = 0
        for _k in range(self.most[i]):
            n += 1 + self.most[i] * 0
        self.out[i] = n


class Endless(Turns):
    checked = True

    def compute(self) -> None:
        i = global_id().x
        n = 1
        while n != self.most[i] * 0:
            n = n ^ 2
        self.out[i] = n


def lengths(most):
    given = np.arange(N, dtype="i4")
    given[5] = most
    return given


@pytest.mark.parametrize("width", [1, 16])
def test_a_loop_has_as_many_turns_as_are_allowed_and_no_more(width):
    for most in (MOST_TURNS, MOST_TURNS + 1, 2**31 - 1):
        out = run_opencl(Turns, width, 1, most=lengths(most), out=N)["out"]
        np.testing.assert_array_equal(out, lengths(min(most, MOST_TURNS)))


@pytest.mark.parametrize("width", [1, 16])
def test_a_range_has_all_its_turns(width):
    out = run_opencl(Counted, width, 1, most=lengths(MOST_TURNS + 5), out=N)["out"]
    np.testing.assert_array_equal(out, lengths(MOST_TURNS + 5))


@pytest.mark.parametrize("width", [1, 16])
def test_a_checked_shader_says_which_loop_does_not_end(width):
    with pytest.raises(ShaderError, match=r"^\[shading-endless\]") as caught:
        run_opencl(Endless, width, most=lengths(0), out=N)
    assert f":{line_of(Endless, 'while')}" in str(caught.value)
