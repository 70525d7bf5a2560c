"""A grid: a layer of lines on the plane y = 0, a metre apart and each tenth one stronger, hidden by what is
nearer.

It is one quad around the eye. Lines fade where a pixel holds several, and towards the edge of the quad.
"""

from __future__ import annotations

from typing import Any, Final

import rhi.shading as sl
from renderer.frame import Frame, SceneLayer
from renderer.frame.drawing import NEARER
from renderer.shaders import ViewConstants
from rhi import BlendFunction, CullMode, DepthTest, DepthWrite, Device

_REACH: Final = 200.0  # m from the eye
_STRONG: Final = 10.0  # m between stronger lines


class GridVarying(sl.Struct):
    """The varyings of `GridLines`: a position relative to the eye, and relative to a crossing of stronger
    lines, along x and z."""

    clip: sl.vec4
    eye_offset: sl.vec2
    grid_position: sl.vec2


@sl.function
def line_coverage(grid_position: sl.vec2) -> float:
    """Return the part of a pixel that lines at whole numbers cover, as wide as a pixel, 0 where it holds
    several."""
    width = sl.max(sl.fwidth(grid_position), sl.vec2(1e-6))
    near = sl.saturate(1.0 - sl.abs(sl.fract(grid_position + 0.5) - 0.5) / width) * sl.saturate(
        1.0 - 2.0 * width
    )
    return sl.max(near.x, near.y)


class GridLines(sl.Shader):
    """Draws the lines; `eye` is the eye's position relative to a crossing of stronger lines."""

    view: sl.Uniform[ViewConstants]
    eye: sl.Uniform[sl.vec3]

    def vertex(self) -> GridVarying:
        number = sl.vertex_index()
        eye_offset = _REACH * (sl.vec2(float((22 >> number) & 1), float((52 >> number) & 1)) * 2.0 - 1.0)
        position = 0.999 * sl.vec3(eye_offset.x, -self.eye.y, eye_offset.y)  # before a floor in that plane
        clip = self.view.relative_view_projection @ sl.vec4(position, 1.0)
        return GridVarying(clip=clip, eye_offset=eye_offset, grid_position=eye_offset + self.eye.xz)

    def fragment(self, v: GridVarying) -> sl.vec4:
        covered = sl.max(
            0.35 * line_coverage(v.grid_position), 0.7 * line_coverage(v.grid_position / _STRONG)
        )
        return sl.vec4(sl.vec3(0.8), covered * sl.saturate(1.0 - sl.length(v.eye_offset) / _REACH))


class GroundGrid(SceneLayer):
    """A layer that draws the lines, in one draw."""

    def __init__(self, device: Device) -> None:
        self._mesh = device.mesh(6, label="ground grid")

    def render(self, device: Device, frame: Frame) -> None:
        """Draw the lines."""
        x, y, z = frame.camera.position
        program: Any = device.program(GridLines)
        states = (CullMode.NONE, DepthTest.ON, NEARER[frame.camera.projection.depth], DepthWrite.OFF)
        with (
            device.event("grid"),
            device.render_pass(frame.targets["image"], frame.targets.depth),
            device.states(*states, BlendFunction.ALPHA),
        ):
            eye = device.transient.uniform(sl.vec3(x % _STRONG, y, z % _STRONG))
            device.draw(program, self._mesh, view=frame.view.buffer, eye=eye)

    def destroy(self) -> None:
        """Destroy the resources on the device."""
        self._mesh.destroy()
