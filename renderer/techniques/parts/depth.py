"""A pass that draws depth alone: the first of techniques that shade only what is visible."""

from __future__ import annotations

from functools import partial
from typing import Final

from renderer.frame import DEPTH_FORMAT, BoundProgram, Effect, Frame, FramePass, Target
from renderer.shaders.depth import DepthOnly
from renderer.shaders.structs import SurfaceVarying
from renderer.techniques.parts.scene_shader import SceneShader
from renderer.techniques.parts.variants import (
    COVERAGE,
    SWITCHES,
    bind_programs,
    make_scene_drawer,
    name_samples,
)
from rhi.shading import Shader


class PartialDepth(SceneShader):
    """Draws depth where masks don't cut the surface."""

    is_coverage = True

    def fragment(self, v: SurfaceVarying) -> None:
        self.discard_masked(self.surface_input(v))


DEPTH_SHADERS: Final[tuple[type[Shader], ...]] = (DepthOnly, PartialDepth)
"""The shaders that draw depth alone."""


def bind_depth_programs(frame: Frame) -> list[BoundProgram]:
    """Programs that draw the depth of any object of the scene, masks applied: shadow casters may be out of
    view."""
    counts = frame.effects.counts
    switches = {**{SWITCHES[effect]: count > 0 for effect, count in counts.items()}, **COVERAGE}
    shader = PartialDepth if counts[Effect.MASKS] else DepthOnly
    return bind_programs(frame, shader, switches=switches)


def depth_pass(reason: str, *, samples: int = 1, has_meshlets: bool = True) -> FramePass[Frame]:
    """The pass that draws the depth of the visible objects to `depth`; with several samples, to the
    resource that `name_samples` names. Without `has_meshlets`, meshes are drawn whole: before passes with more
    samples."""
    depth = Target(name_samples("depth", samples), DEPTH_FORMAT, samples=samples)
    name = "depth" if samples == 1 else "depth samples"
    reads = ("depth",) if samples > 1 else ()
    return FramePass(
        name,
        partial(draw_depth, depth=depth.name, has_meshlets=has_meshlets),
        reason,
        reads=reads,
        writes=(depth,),
        draws_objects=True,
    )


def draw_depth(frame: Frame, depth: str = "depth", *, has_meshlets: bool = True) -> None:
    """Draw the depth of the visible objects to the resource `depth`, without `has_meshlets` of whole meshes."""
    shader = PartialDepth if Effect.MASKS in frame.effects.enabled else DepthOnly
    frame.draw_visible(
        make_scene_drawer(
            frame,
            shader,
            color=None,
            depth=frame.targets[depth],
            switches=COVERAGE,
            has_meshlets=has_meshlets,
        )
    )
