"""When a pass's clears are done: by draws where they can, else by themselves. That they are is in rhi/conformance."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

import rhi
from rhi import BlendFunction, ColorWrite, DepthTest, DepthWrite, Device, Format
from rhi.backends.cl import memory, resources
from rhi.conformance.compare import assert_same
from rhi.conformance.shaders import Colored
from rhi.conformance.shapes import rectangle
from rhi.errors import DeviceError

SIZE = (150, 70)
RED = (1, 0, 0, 1)


@pytest.fixture
def device() -> Iterator[Device]:
    with rhi.create_device("cl") as device:
        yield device


@pytest.fixture
def fills(monkeypatch: pytest.MonkeyPatch) -> list[bytes]:
    """What memory was filled with, from now on."""
    filled: list[bytes] = []
    fill = resources.fill

    def count(queue: object, memory: object, pattern: bytes, offset: int, size: int) -> None:
        filled.append(pattern)
        fill(queue, memory, pattern, offset, size)

    monkeypatch.setattr(resources, "fill", count)
    return filled


def test_draws_clear_what_they_draw_into(device: Device, fills: list[bytes]) -> None:
    with (
        device.texture(SIZE, Format.RGBA8) as image,
        device.texture(SIZE, Format.D32F) as depth,
        device.mesh(rectangle()) as mesh,
    ):
        program = device.program(Colored)
        fills.clear()
        with device.render_pass(image, depth, clear=RED, clear_depth=0.25):
            device.draw(program, mesh)
        assert fills == []


def test_what_no_draw_of_the_pass_draws_into_is_filled(device: Device, fills: list[bytes]) -> None:
    with (
        device.texture(SIZE, Format.RGBA8) as image,
        device.texture(SIZE, Format.D32F) as depth,
        device.mesh(rectangle()) as mesh,
    ):
        program = device.program(Colored)
        fills.clear()
        with (
            device.render_pass(image, depth, clear=RED, clear_depth=0.25),
            device.states(DepthTest.OFF, DepthWrite.OFF),
        ):
            device.draw(program, mesh)
        assert fills == [np.float32(0.25).tobytes()]
        with device.render_pass(image, depth, clear=RED, clear_depth=0.25), device.states(ColorWrite.OFF):
            device.draw(program, mesh)
        assert fills[1:] == [b"\xff\0\0\xff"]


def test_a_clear_is_done_although_its_draws_fail(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    with device.texture(SIZE, Format.RGBA8) as image, device.mesh(rectangle()) as mesh:
        program = device.program(Colored)

        def fail(pool: object, size: int) -> int:
            raise MemoryError

        with monkeypatch.context() as patch:
            patch.setattr(memory.Pool, "reserve", fail)
            with pytest.raises(DeviceError, match="memory"), device.render_pass(image, clear=RED):
                device.draw(program, mesh)
        assert_same(image.read(), (255, 0, 0, 255))
        with device.render_pass(image, clear=(0, 0, 0, 0)):
            device.draw(program, mesh)
        assert_same(image.read(), 255)


def test_a_clear_is_done_once(device: Device) -> None:
    """The second draw is a batch of its own and finds what the first one left."""
    with (
        device.texture(SIZE, Format.RGBA8) as image,
        device.texture(SIZE, Format.D32F) as depth,
        device.mesh(rectangle(-1, -1, 0, 1, depth=0.75)) as left,
        device.mesh(rectangle(0, -1, 1, 1, depth=0.5)) as right,
    ):
        with device.render_pass(image, depth, clear=RED, clear_depth=0.25):
            device.draw(device.program(Colored), left)
            with device.states(BlendFunction.ADDITIVE):
                device.draw(device.program(Colored), right)
        assert_same(image.read(), 255)
        assert_same(depth.read()[:, :75], 0.75)
        assert_same(depth.read()[:, 75:], 0.5)
