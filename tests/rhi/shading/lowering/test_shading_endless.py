"""A `while` that never ends is left on OpenCL, since nobody could stop it; loops that end are whole."""

import numpy as np
import pytest
from opencl_runner import run_opencl
from test_shading_checked import line_of

from rhi.errors import ShaderError
from rhi.shading import Shader, Storage, StorageRW, global_id
from rhi.shading.lowering.functions import MAX_ITERATIONS

N = 32


class WhileLoop(Shader):
    work_group = (N,)
    limit: Storage[int]
    out: StorageRW[int]

    def compute(self) -> None:
        i = global_id().x
        n = 0
        while n < self.limit[i]:
            n += 1
            if n < 0:
                n = 1
        self.out[i] = n


class Counted(WhileLoop):
    def compute(self) -> None:
        i = global_id().x
        n = 0
        for _k in range(self.limit[i]):
            n += 1 + self.limit[i] * 0
        self.out[i] = n


class Endless(WhileLoop):
    checked = True

    def compute(self) -> None:
        i = global_id().x
        n = 1
        while n != self.limit[i] * 0:
            n = n ^ 2
        self.out[i] = n


def lengths(limit):
    counts = np.arange(N, dtype="i4")
    counts[5] = limit
    return counts


@pytest.mark.parametrize("width", [1, 16])
def test_a_loop_has_as_many_turns_as_are_allowed_and_no_more(width):
    for limit in (MAX_ITERATIONS, MAX_ITERATIONS + 1, 2**31 - 1):
        out = run_opencl(WhileLoop, width, 1, limit=lengths(limit), out=N)["out"]
        np.testing.assert_array_equal(out, lengths(min(limit, MAX_ITERATIONS)))


@pytest.mark.parametrize("width", [1, 16])
def test_a_range_has_all_its_turns(width):
    out = run_opencl(Counted, width, 1, limit=lengths(MAX_ITERATIONS + 5), out=N)["out"]
    np.testing.assert_array_equal(out, lengths(MAX_ITERATIONS + 5))


@pytest.mark.parametrize("width", [1, 16])
def test_a_checked_shader_says_which_loop_does_not_end(width):
    with pytest.raises(ShaderError, match=r"^\[shading-endless\]") as caught:
        run_opencl(Endless, width, limit=lengths(0), out=N)
    assert f":{line_of(Endless, 'while')}" in str(caught.value)
