"""Forward shading: one pass, in which each fragment is lit by all lights that reach its object, or by all of
the scene.

Objects are drawn front to back, so that early depth tests avoid the shading of hidden fragments.
"""

from __future__ import annotations

from typing import Final

from renderer import rules
from renderer.frame import Frame, FrameEffects, FramePass
from renderer.light_kinds.bounds import LightBounds
from renderer.light_kinds.generation import define, for_each_kind
from renderer.shaders.structs import SurfacePoint
from renderer.techniques.parts.depth import DEPTH_SHADERS
from renderer.techniques.parts.finish import FINISH_SHADERS, forward_passes
from renderer.techniques.parts.scene_shader import ForwardShader
from renderer.techniques.parts.variants import FORWARD, Lighting
from rhi.shading import Shader, vec3

LitByAll: Final[type[ForwardShader]] = define(
    """
class LitByAll(ForwardShader):
    def shade_local_lights(self, surface: SurfacePoint, lights: LightBounds) -> vec3:
        color = vec3(0.0)
"""
    + for_each_kind(
        """
        if self.has_${kind}_lights:
            for light_index in range(len(self.${kind}_lights)):
                color += self.shade_${kind}_light(surface, light_index)
"""
    )
    + "        return color\n",
    "LitByAll",
    __name__,
    ForwardShader=ForwardShader,
    LightBounds=LightBounds,
    SurfacePoint=SurfacePoint,
    vec3=vec3,
)
"""Lights a fragment by all lights of the scene, whether they reach its object or not."""

LIT_BY_ALL: Final = Lighting((LitByAll,))


class Forward:
    """Draws the scene lit in one pass; the shader handles only the effects that the frame needs.

    With several samples per pixel, edges are smooth. Depth of several samples can't be read, but layers and
    visibility algorithms read it: so a pass of its own draws depth first, and finds the visible objects.
    """

    name: Final = "forward"
    shaders: Final[tuple[type[Shader], ...]] = (
        LitByAll,
        *DEPTH_SHADERS,
        *FINISH_SHADERS,
    )
    """The shaders of its passes: a draw's shader is one of them, or several combined."""

    def __init__(self, samples: int = 1, *, all_lights: bool = False) -> None:
        """`samples` is the number of samples per pixel, one of the device's `capabilities.sample_counts`.
        `all_lights` evaluates every light of the scene for each opaque fragment instead of its object's
        light list, as Wilks's forward shading does."""
        self.samples = rules.check_count(rules.BAD_TECHNIQUE, "Forward(samples=...)", samples)
        self.all_lights = all_lights

    @property
    def lighting(self) -> Lighting:
        """The lighting of opaque surfaces."""
        return LIT_BY_ALL if self.all_lights else FORWARD

    def declare(self, effects: FrameEffects) -> tuple[FramePass[Frame], ...]:
        """The pass `forward` and those of transparent surfaces; with several samples, `depth` before and
        `resolve` after it."""
        return forward_passes(effects, self.lighting, samples=self.samples)
