"""Loops that llvmpipe cuts short: silently, but with validation."""

from __future__ import annotations

import inspect

import numpy as np
import pytest

import rhi
from rhi import ShaderError
from rhi.shading import Shader, Storage, StorageRW

MOST = 65_534
"""Turns of a shader whose only loop looks at its condition once more; each other loop takes one turn at least."""


class Turns(Shader):
    """Counts the turns of a `for`, a `while`, and a loop that a `break` leaves; Mesa unrolls the one in it."""

    asked: Storage[int]
    had: StorageRW[int]

    def compute(self) -> None:
        first = 0
        for _i in range(self.asked[0]):
            first += 1
        second = 0
        while second < self.asked[1]:
            second += 1
        third = 0
        while third < 80_000:
            for _i in range(4):
                third += 1
            if third >= self.asked[2]:
                break
        self.had[0] = first
        self.had[1] = second
        self.had[2] = third


@pytest.mark.parametrize("validates", [True, False])
@pytest.mark.parametrize(
    ("asked", "cut"),
    [
        ((0, 0, 4), ""),
        ((MOST - 3, 0, 4), ""),
        ((0, MOST - 3, 4), ""),
        ((40_000, 25_000, 100), ""),
        ((0, 0, 70_000), ""),
        ((MOST + 2, 0, 4), "for _i in range(self.asked[0])"),
        ((0, MOST + 2, 4), "while second"),
        ((40_000, 26_000, 4), "while second"),
        ((65_400, 0, 1000), "while third"),
    ],
)
def test_a_loop_that_is_cut_short_is_named_with_validation(
    asked: tuple[int, int, int], cut: str, validates: bool
) -> None:
    with rhi.create_device("gl", validation=validates) as device:
        if "llvmpipe" not in device.capabilities.device:
            pytest.skip("llvmpipe's own fault")
        had = device.storage(int, 3)
        device.dispatch(device.program(Turns), 1, asked=device.storage(int, asked), had=had)
        if cut and validates:
            with pytest.raises(ShaderError, match="65535 turns") as caught:
                device.finish()
            lines, start = inspect.getsourcelines(Turns)
            assert caught.value.rule.id == "shading-endless"
            assert caught.value.site is not None
            assert cut in lines[caught.value.site.line - start]
        assert bool(np.any(had.read() < asked)) == bool(cut)  # an error is raised once
