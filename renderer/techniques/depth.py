"""A pass that draws depth alone: the first of techniques that shade only what is visible."""

from __future__ import annotations

from typing import Any

from renderer.frame import Frame, TechniquePass
from renderer.shaders.depth import DepthOnly
from renderer.shaders.structs import SurfaceVarying
from renderer.techniques.scene_shader import SceneShader
from renderer.techniques.surfaces import Aspect, bind_surfaces, surface_variant

__rhi_internal__ = True


class PartialDepth(SceneShader):
    """Draws depth, of what isn't left out."""

    def fragment(self, v: SurfaceVarying) -> None:
        _ = self.find_texel(v)  # which leaves out what isn't drawn


def draw_depth(frame: Frame) -> None:
    """Draw the depth of the visible objects to `depth`."""
    parts, bindings = bind_surfaces(frame, (Aspect.COVERAGE,), has_materials=False)
    program: Any = frame.program(surface_variant(PartialDepth, parts) if parts else DepthOnly)
    frame.draw_visible(
        TechniquePass(
            frame.device,
            frame.resources,
            frame.view,
            program,
            bindings,
            color=None,
            depth=frame.targets["depth"],
        )
    )
