"""A pass that draws depth alone: the first of techniques that shade only what is visible."""

from __future__ import annotations

from renderer.frame import DEPTH_FORMAT, BoundProgram, Effect, Frame, Pass, Target
from renderer.shaders.depth import DepthOnly
from renderer.shaders.structs import SurfaceVarying
from renderer.techniques.parts.scene_shader import SceneShader
from renderer.techniques.parts.variants import COVERAGE, SWITCHES, bind_programs, scene_pass


class PartialDepth(SceneShader):
    """Draws depth, of what isn't left out."""

    is_coverage = True

    def fragment(self, v: SurfaceVarying) -> None:
        self.cut(self.take(v))


def bind_depth_programs(frame: Frame) -> list[BoundProgram]:
    """Return the programs that draw the depth of any of the scene's objects, of masks what they leave: what casts a
    shadow may be out of view."""
    counts = frame.needs.counts
    switches = {**{SWITCHES[effect]: count > 0 for effect, count in counts.items()}, **COVERAGE}
    shader = PartialDepth if counts[Effect.MASKS] else DepthOnly
    return bind_programs(frame, shader, switches=switches)


def depth_pass(because: str) -> Pass[Frame]:
    """Return the pass that draws the depth of the visible objects to `depth`."""
    return Pass("depth", draw_depth, because, writes=(Target("depth", DEPTH_FORMAT),))


def draw_depth(frame: Frame) -> None:
    """Draw the depth of the visible objects to `depth`."""
    shader = PartialDepth if Effect.MASKS in frame.needs.effects else DepthOnly
    frame.draw_visible(scene_pass(frame, shader, color=None, switches=COVERAGE))
