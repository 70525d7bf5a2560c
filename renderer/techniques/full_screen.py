"""Passes over all pixels of a target, and the constants that lead from pixels to positions."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from renderer.frame import Frame
from renderer.frame.passes import FARTHEST
from renderer.frame.resources import MirroredValue
from renderer.scene import Camera, Depth
from renderer.scene.arrays import Floats
from renderer.shaders.pixels import FullScreen, PixelConstants
from rhi import BlendFunction, CullMode, DepthTest, DepthWrite, Device, State, Texture, UniformBuffer

__rhi_internal__ = True

Color = tuple[float, float, float, float]

_STATES: Final[tuple[State, ...]] = (CullMode.NONE, DepthTest.OFF, DepthWrite.OFF, BlendFunction.OFF)


class PixelWorkspace:
    """Keeps the triangle that covers a target, and the constants of the frame's pixels."""

    def __init__(self, device: Device) -> None:
        self.triangle = device.mesh(3, label="whole target")
        self._constants = MirroredValue(device, PixelConstants(from_pixel=np.eye(4), farthest=0.0))

    def aim(self, camera: Camera, size: tuple[int, int]) -> UniformBuffer[PixelConstants]:
        """Return the constants of a target of `size` that `camera` draws to; they are uploaded if they have changed."""
        self._constants.write(find_pixel_constants(camera, size))
        return self._constants.buffer

    def destroy(self) -> None:
        """Destroy the resources on the device."""
        self._constants.destroy()
        self.triangle.destroy()


def find_pixel_constants(camera: Camera, size: tuple[int, int]) -> PixelConstants:
    """Return the constants of a target of `size` (width, height) in pixels that `camera` draws to."""
    direction = camera.projection.depth
    to_clip: Floats = camera.projection.matrix.copy()
    to_clip[:, :3] = to_clip[:, :3] @ camera.rotation
    if direction is Depth.STANDARD:
        to_clip[2] = to_clip[3] - to_clip[2]  # nearness: 1 - z / w
    width, height = size
    to_pixel = np.array(
        [[0.5 * width, 0, 0, 0.5 * width], [0, -0.5 * height, 0, 0.5 * height], [0, 0, 1, 0], [0, 0, 0, 1]]
    )
    return PixelConstants(from_pixel=np.linalg.inv(to_pixel @ to_clip), farthest=FARTHEST[direction])


def bind_pixels(frame: Frame) -> UniformBuffer[PixelConstants]:
    """Return the constants of the frame's pixels."""
    return frame.resources.workspace(PixelWorkspace).aim(frame.camera, frame.targets.size)


def draw_full_screen(
    frame: Frame,
    shader: type[FullScreen],
    color: Texture | list[Texture],
    *,
    clear: Color | None = None,
    states: tuple[State, ...] = (),
    **bindings: Any,
) -> None:
    """Run a shader for every pixel of the targets, in a pass of its own.

    Args:
        clear: the colour of pixels that the shader discards; None keeps what the targets hold.
        states: states besides no culling, no depth test and no blending.
    """
    device = frame.device
    triangle = frame.resources.workspace(PixelWorkspace).triangle
    chosen = {type(state): state for state in (*_STATES, *states)}
    with device.render_pass(color, clear=clear), device.states(*chosen.values()):
        device.draw(device.program(shader), triangle, **bindings)
