"""Passes over all pixels of a target, and the constants that lead from pixels to positions."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from renderer.frame import Frame
from renderer.frame.mirrors import MirroredValue
from renderer.frame.passes import FARTHEST
from renderer.scene import Camera, Depth
from renderer.shaders.pixels import FullScreen, PixelRays
from rhi import (
    BlendFunction,
    CullMode,
    DepthFunction,
    DepthTest,
    DepthWrite,
    Device,
    State,
    Texture,
    UniformBuffer,
)

__rhi_internal__ = True

Color = tuple[float, float, float, float]

BEHIND: Final = {Depth.REVERSED: DepthFunction.LESS, Depth.STANDARD: DepthFunction.GREATER}
"""The depth function that is passed behind the geometry, and never in front of the background."""


class WholeTarget:
    """What is kept to run shaders for each pixel of a view.

    Attributes:
        triangle: the mesh for a `FullScreen` shader.
    """

    def __init__(self, device: Device) -> None:
        self.triangle = device.mesh(3, label="whole target")
        self._aimed: tuple[Camera, tuple[int, int]] | None = None
        self._rays = MirroredValue(
            device,
            PixelRays(
                across=np.zeros((3, 3)),
                along=(0, 0, 0),
                start=(0, 0, 0),
                size=(0, 0),
                forward=(0, 0, 0),
                far=0.0,
                farthest=0.0,
                lens=(0, 0, 0, 0),
            ),
        )

    def aim(self, camera: Camera, size: tuple[int, int]) -> UniformBuffer[PixelRays]:
        """Return the rays through an image of `size` that `camera` draws to; they are uploaded if they have changed."""
        if self._aimed is None or self._aimed[0] is not camera or self._aimed[1] != size:
            self._rays.write(find_rays(camera, size))
            self._aimed = camera, size
        return self._rays.buffer

    def destroy(self) -> None:
        """Destroy the resources on the device."""
        self.triangle.destroy()
        self._rays.destroy()


def find_rays(camera: Camera, size: tuple[int, int]) -> PixelRays:
    """Return the rays through the pixels of an image of `size`, computed in float64."""
    (width, height), matrix = size, camera.projection.matrix
    # A lens maps (x, y, -d) to clip coordinates. Its rows are solved for x and y, as functions of the pixel and of d:
    # matrix[0, 0] * x = pixel_x * w + matrix[0, 2] * d - matrix[0, 3], where w = by_distance * d + constant.
    by_distance, constant = -matrix[3, 2], matrix[3, 3]
    scale = np.array([matrix[0, 0], matrix[1, 1], 1.0])
    across = np.array([[2.0 / width, 0.0, -1.0], [0.0, -2.0 / height, 1.0], [0.0, 0.0, 0.0]]) / scale[:, None]
    along = np.array([matrix[0, 2], matrix[1, 2], -1.0]) / scale
    start = np.array([-matrix[0, 3], -matrix[1, 3], 0.0]) / scale
    depth = camera.projection.depth
    # Nearness is z / w, or 1 - z / w for standard depth; that is solved for the distance.
    near = matrix[2] if depth is Depth.REVERSED else matrix[3] - matrix[2]
    return PixelRays(
        across=camera.rotation.T @ across,
        along=camera.rotation.T @ along,
        start=camera.rotation.T @ start,
        size=size,
        forward=camera.forward,
        far=find_far(camera),
        farthest=FARTHEST[depth],
        lens=(near[3], constant, near[2], -by_distance),
    )


def find_far(camera: Camera) -> float:
    """Return the distance of the far plane, or the largest float if there is none."""
    planes = camera.frustum.planes
    if len(planes) < 6:
        return float(np.finfo(np.float32).max)
    return float(planes[5] @ np.array([*camera.position, 1.0]))


def bind_rays(frame: Frame) -> dict[str, Any]:
    """Return the binding of the rays of the frame's view."""
    return {"rays": frame.view.workspace(WholeTarget).aim(frame.camera, frame.targets.size)}


def draw_full_screen(
    frame: Frame,
    shader: type[FullScreen],
    color: Texture | list[Texture],
    bindings: dict[str, Any],
    *,
    depth: Texture | None = None,
    clear: Color | None = None,
    states: tuple[State, ...] = (),
) -> None:
    """Run a shader for each pixel of the targets, in a pass of its own.

    Args:
        bindings: those of the shader; it has the rays of the frame's view in any case.
        depth: the depth that geometry was drawn to. Then the shader runs only for pixels with a surface. It can't be
            among the bindings.
        clear: the colour of pixels for which the shader isn't run, or that it discards; None keeps what the targets
            hold.
        states: states besides no culling, no blending, and the depth test that `depth` asks for.
    """
    device = frame.device
    defaults: tuple[State, ...] = (CullMode.NONE, DepthWrite.OFF, BlendFunction.OFF)
    if depth is None:
        defaults += (DepthTest.OFF,)
    else:
        defaults += (DepthTest.ON, BEHIND[frame.camera.projection.depth])
    chosen = {type(state): state for state in (*defaults, *states)}
    program: Any = frame.program(shader)
    triangle = frame.view.workspace(WholeTarget).triangle
    with device.render_pass(color, depth, clear=clear), device.states(*chosen.values()):
        device.draw(program, triangle, **(bind_rays(frame) | bindings))
