"""Loops that llvmpipe cuts short: silently, but with validation."""

from __future__ import annotations

import inspect
from collections.abc import Iterator

import numpy as np
import pytest

import rhi
from rhi import ShaderError
from rhi.conformance.shaders import Shade, Shaded
from rhi.conformance.shapes import rectangle
from rhi.shading import Shader, Storage, StorageRW, Uniform, vec4

MAX_ITERATIONS = 65_534
"""Turns of a shader whose only loop looks at its condition once more; each other loop takes one turn at
least."""


class LoopCounter(Shader):
    """Counts the turns of a `for`, a `while`, and a loop that a `break` leaves; Mesa unrolls the one in
    it."""

    requested: Storage[int]
    completed: StorageRW[int]

    def compute(self) -> None:
        first = 0
        for _i in range(self.requested[0]):
            first += 1
        second = 0
        while second < self.requested[1]:
            second += 1
        third = 0
        while third < 80_000:
            for _i in range(4):
                third += 1
            if third >= self.requested[2]:
                break
        self.completed[0] = first
        self.completed[1] = second
        self.completed[2] = third


@pytest.mark.parametrize("validates", [True, False])
@pytest.mark.parametrize(
    ("requested", "cut"),
    [
        ((0, 0, 4), ""),
        ((MAX_ITERATIONS - 3, 0, 4), ""),
        ((0, MAX_ITERATIONS - 3, 4), ""),
        ((40_000, 25_000, 100), ""),
        ((0, 0, 70_000), ""),
        ((MAX_ITERATIONS + 2, 0, 4), "for _i in range(self.requested[0])"),
        ((0, MAX_ITERATIONS + 2, 4), "while second"),
        ((40_000, 26_000, 4), "while second"),
        ((65_400, 0, 1000), "while third"),
    ],
)
def test_a_loop_that_is_cut_short_is_named_with_validation(
    requested: tuple[int, int, int], cut: str, validates: bool
) -> None:
    with rhi.create_device("gl", validation=validates) as device:
        if "llvmpipe" not in device.capabilities.device:
            pytest.skip("llvmpipe's own fault")
        completed = device.storage(int, 3)
        device.dispatch(
            device.program(LoopCounter), 1, requested=device.storage(int, requested), completed=completed
        )
        if cut and validates:
            with pytest.raises(ShaderError, match="65535 iterations") as caught:
                device.finish()
            lines, start = inspect.getsourcelines(LoopCounter)
            assert caught.value.rule.id == "shading-endless"
            assert caught.value.site is not None
            assert cut in lines[caught.value.site.line - start]
        assert bool(np.any(completed.read() < requested)) == bool(cut)  # an error is raised once


class CountedLayers(Shaded):
    """Covers the target, after a loop that the driver can't unroll."""

    turns: Uniform[int]

    def fragment(self, v: Shade) -> vec4:
        total = 0
        for turn in range(self.turns):
            total += turn
        return v.color * float(total)


@pytest.fixture
def llvmpipe() -> Iterator[rhi.Device]:
    with rhi.create_device("gl", validation=True) as device:
        if "llvmpipe" not in device.capabilities.device:
            pytest.skip("llvmpipe's own fault")
        yield device


def test_polls_wait_for_no_loop_that_still_runs(llvmpipe: rhi.Device) -> None:
    """Draws grow until polls find them unfinished: another program may have the processor between polls."""
    device = llvmpipe
    with device.texture((1024, 1024), rhi.Format.RGBA8) as image, device.mesh(rectangle()) as mesh:
        program = device.program(CountedLayers)
        for instances in (16, 64, 256, 512):
            with device.render_pass(image):
                device.draw(program, mesh, instances, turns=4)
            value = device.signal()
            polls = 0
            while device.completed < value:
                polls += 1
            if polls > 1:
                break
        assert polls > 1


def test_polls_alone_learn_of_a_loop_that_was_cut_short(llvmpipe: rhi.Device) -> None:
    device = llvmpipe
    requested = device.storage(int, (MAX_ITERATIONS + 2, 0, 4))
    device.dispatch(device.program(LoopCounter), 1, requested=requested, completed=device.storage(int, 3))
    with pytest.raises(ShaderError, match="65535 iterations"):
        value = device.signal()
        while device.completed < value:
            pass
