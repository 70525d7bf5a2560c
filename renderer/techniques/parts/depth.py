"""A pass that draws depth alone: the first of techniques that shade only what is visible."""

from __future__ import annotations

from functools import partial

from renderer.frame import DEPTH_FORMAT, BoundProgram, Effect, Frame, Pass, Target
from renderer.shaders.depth import DepthOnly
from renderer.shaders.structs import SurfaceVarying
from renderer.techniques.parts.scene_shader import SceneShader
from renderer.techniques.parts.variants import COVERAGE, SWITCHES, bind_programs, name_samples, scene_pass


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


def depth_pass(because: str, *, samples: int = 1) -> Pass[Frame]:
    """Return the pass that draws the depth of the visible objects to `depth`, or with several samples, after that, to
    contents that `name_samples` names. The pass has the name of what it writes."""
    depth = Target(name_samples("depth", samples), DEPTH_FORMAT, samples=samples)
    reads = ("depth",) if samples > 1 else ()
    return Pass(depth.name, partial(draw_depth, depth=depth.name), because, reads=reads, writes=(depth,))


def draw_depth(frame: Frame, depth: str = "depth") -> None:
    """Draw the depth of the visible objects to the contents `depth`."""
    shader = PartialDepth if Effect.MASKS in frame.needs.effects else DepthOnly
    frame.draw_visible(scene_pass(frame, shader, color=None, depth=frame.targets[depth], switches=COVERAGE))
