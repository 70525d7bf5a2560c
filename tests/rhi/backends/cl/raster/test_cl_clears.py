"""The execution of a pass's clears: by draws if possible, else as fills. rhi/conformance checks their
results."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pytest

import rhi
from rhi.backends.cl.memory import cl_buffers, planes
from rhi.backends.cl.memory import pools as memory
from rhi.conformance.compare import assert_same
from rhi.conformance.shaders import Colored
from rhi.conformance.shapes import rectangle
from rhi.errors import DeviceError

SIZE = (150, 70)
RED = (1, 0, 0, 1)


@pytest.fixture
def fills(monkeypatch: pytest.MonkeyPatch) -> list[bytes]:
    """The patterns that memory is filled with from now on."""
    filled: list[bytes] = []
    fill = planes.fill

    def count(queue: object, memory: object, pattern: bytes, offset: int, size: int) -> None:
        filled.append(pattern)
        fill(queue, memory, pattern, offset, size)

    for module in (planes, cl_buffers):
        monkeypatch.setattr(module, "fill", count)
    return filled


@dataclass
class Scene:
    """Two targets, and a mesh that covers them."""

    image: rhi.Texture
    depth: rhi.Texture
    mesh: rhi.Mesh
    program: rhi.Program[...]


@pytest.fixture
def scene(device: rhi.Device) -> Iterator[Scene]:
    program = device.program(Colored)
    with (
        device.texture(SIZE, rhi.Format.RGBA8) as image,
        device.texture(SIZE, rhi.Format.D32F) as depth,
        device.mesh(rectangle()) as mesh,
    ):
        yield Scene(image, depth, mesh, program)


def test_draws_clear_the_targets_that_they_write(
    device: rhi.Device, scene: Scene, fills: list[bytes]
) -> None:
    with device.render_pass(scene.image, scene.depth, clear=RED, clear_depth=0.25):
        device.draw(scene.program, scene.mesh)
    assert fills == []


@pytest.mark.parametrize(
    ("states", "filled"),
    [
        ((rhi.DepthTest.OFF, rhi.DepthWrite.OFF), np.float32(0.25).tobytes()),
        ((rhi.ColorWrite.OFF,), b"\xff\0\0\xff"),
    ],
    ids=["depth", "color"],
)
def test_a_target_that_no_draw_of_the_pass_writes_is_cleared_by_a_fill(
    device: rhi.Device, scene: Scene, fills: list[bytes], states: tuple[rhi.State, ...], filled: bytes
) -> None:
    with device.render_pass(scene.image, scene.depth, clear=RED, clear_depth=0.25), device.states(*states):
        device.draw(scene.program, scene.mesh)
    assert fills == [filled]


def test_a_clear_to_minus_zero_is_none_to_zero(device: rhi.Device) -> None:
    with device.texture(SIZE, rhi.Format.R32F) as image:
        for zero in (0.0, -0.0):
            with device.render_pass(image, clear=(zero, 0, 0, 0)):
                pass
            assert (np.signbit(image.read()) == np.signbit(zero)).all()


def test_a_clear_is_done_although_its_draws_fail(device: rhi.Device, monkeypatch: pytest.MonkeyPatch) -> None:
    with device.texture(SIZE, rhi.Format.RGBA8) as image, device.mesh(rectangle()) as mesh:
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


def test_a_clear_is_done_once(device: rhi.Device) -> None:
    """The second draw is a batch of its own and reads what the first one left."""
    with (
        device.texture(SIZE, rhi.Format.RGBA8) as image,
        device.texture(SIZE, rhi.Format.D32F) as depth,
        device.mesh(rectangle(-1, -1, 0, 1, depth=0.75)) as left,
        device.mesh(rectangle(0, -1, 1, 1, depth=0.5)) as right,
    ):
        with device.render_pass(image, depth, clear=RED, clear_depth=0.25):
            device.draw(device.program(Colored), left)
            with device.states(rhi.BlendFunction.ADDITIVE):
                device.draw(device.program(Colored), right)
        assert_same(image.read(), 255)
        assert_same(depth.read()[:, :75], 0.75)
        assert_same(depth.read()[:, 75:], 0.5)
