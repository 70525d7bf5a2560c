"""A device that is lost in the middle of a frame, and a new one as in docs/how-to/lost-device.md."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from testing_kit import backend_works

import rhi
import rhi.shading as sl
from rhi import Device, Format
from rhi.backends.null import Faults

FRAMES = 6
SIZE = 8


class Corner(sl.Struct):
    position: sl.vec2


class Tinted(sl.Shader):
    tint: sl.Uniform[sl.vec4]

    def vertex(self, v: Corner) -> sl.vec4:
        return sl.vec4(v.position, 0.5, 1.0)

    def fragment(self) -> sl.vec4:
        return self.tint


class Engine:
    """All that is on the device. It is made from data that the CPU keeps, so it can be made again."""

    def __init__(self, device: Device, corners: np.ndarray[Any, Any]) -> None:
        self.device = device
        self.program = device.program(Tinted)
        self.mesh = device.mesh({"position": corners})

    def render(self, frame: int) -> np.ndarray[Any, Any]:
        device = self.device
        with device.texture((SIZE, SIZE), Format.RGBA8) as image:
            with device.render_pass(image, clear=(0, 0, 0, 1)):
                device.draw(self.program, self.mesh, tint=sl.vec4(frame / FRAMES, 0.5, 1.0, 1.0))
            device.present(image)
            return image.read()


def run(
    make_device: Callable[[int], Device], before_frame: Callable[[Device, int], object]
) -> tuple[list[np.ndarray[Any, Any]], int]:
    """Return the images of all frames, and how many devices were lost."""
    corners = np.float32([[-1, -1], [3, -1], [-1, 3]])
    images: list[np.ndarray[Any, Any]] = []
    for losses in range(3):
        with make_device(losses) as device:  # closing a lost device raises nothing
            try:
                engine = Engine(device, corners)
                while len(images) < FRAMES:
                    before_frame(device, losses)
                    images.append(engine.render(len(images)))
                return images, losses
            except rhi.DeviceError as error:
                if error.rule.id != "device-lost":
                    raise
    raise AssertionError("the device is lost again and again")


def never(device: Device, losses: int) -> None:
    """Lose no device."""


def lose_wgpu(device: Device) -> None:
    from rhi.backends.wgpu.wgpu_backend import WgpuBackend

    device.backend_as(WgpuBackend).device.destroy()


def lose_gl(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    """Have the driver report GL_CONTEXT_LOST from now on, as one does whose GPU was reset. Mesa's llvmpipe never
    loses a context by itself."""
    from rhi.backends.gl import enums
    from rhi.backends.gl.gl_backend import GlBackend

    gl = device.backend_as(GlBackend).gl
    monkeypatch.setattr(gl, "GetError", lambda: enums.CONTEXT_LOST)


@pytest.mark.parametrize("frame", [0, 1, FRAMES - 1])
@pytest.mark.parametrize("backend", ["wgpu", "gl"])
def test_a_frame_goes_on_after_the_device_was_lost(
    backend: str, frame: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not backend_works(backend):
        pytest.skip(f"no device of {backend} here")
    count = 0

    def lose(device: Device, losses: int) -> None:
        nonlocal count
        if count == frame and losses == 0:
            lose_wgpu(device) if backend == "wgpu" else lose_gl(device, monkeypatch)
        elif losses:
            monkeypatch.undo()
        count += 1

    def make_device(losses: int) -> Device:
        monkeypatch.undo()
        return rhi.create_device(backend)

    images, losses = run(make_device, lose)
    expected, none = run(make_device, never)
    assert (losses, none) == (1, 0)
    assert [image[0, 0].tolist() for image in images] == [image[0, 0].tolist() for image in expected]
    assert images[-1][0, 0].tolist() != images[0][0, 0].tolist()


def test_each_command_of_null_may_lose_the_device() -> None:
    with rhi.create_device("null") as device:
        Engine(device, np.float32([[-1, -1], [3, -1], [-1, 3]])).render(0)
        commands = len(device.stream)
    lost = 0
    for number in range(1, 3 * commands, 2):

        def make_device(losses: int, number: int = number) -> Device:
            return (
                rhi.create_device("null", faults=Faults(loss=number))
                if not losses
                else rhi.create_device("null")
            )

        images, losses = run(make_device, never)
        assert len(images) == FRAMES
        lost += losses
    assert lost > commands


def test_a_device_that_is_lost_each_time_isnt_created_for_ever() -> None:
    with pytest.raises(AssertionError, match="again and again"):
        run(lambda losses: rhi.create_device("null", faults=Faults(loss=5)), never)


def test_another_error_is_not_taken_for_a_loss() -> None:
    with pytest.raises(rhi.DeviceError, match="device-out-of-memory"):
        run(lambda losses: rhi.create_device("null", faults=Faults(memory=1)), never)
