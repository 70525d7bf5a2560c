"""The last pass of techniques that collect light: makes the image of what earlier passes have left of each pixel.

A shader of this pass finds the light that each surface sends to the eye, and finishes it as forward shading does: maps
tones, and adds haze by the distance of the surface. A pixel without a surface is the background.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Final

from renderer import rules
from renderer.frame import Effect, Frame, Needs, Pass
from renderer.shaders.pixels import BackgroundScreen, distance_at, nearness_of, place_pixel
from renderer.techniques.parts.scene_shader import FinishShader
from renderer.techniques.parts.variants import draw_full_screen
from rhi import Format, refuse
from rhi.shading import Texture2D, discard, fragment_coordinate, ivec2, vec4

LIGHT_FORMAT: Final = Format.RGBA16F
"""The format of light that is stored once it is complete."""
SUM_FORMATS: Final = {16: Format.RGBA16F, 32: Format.RGBA32F}
"""The formats of light that is added up by blending, by the bits of a channel. Each addition is rounded: a half float
loses up to a 1,024th of the sum each time, and what is smaller than that altogether."""
EXACT_BITS: Final = 32
"""The bits with which no picture shows that its light was added up by blending."""


class LightSum(BackgroundScreen, FinishShader):
    """Makes the image of all light, added up in `light`."""

    light: Texture2D
    depth: Texture2D

    def fragment(self) -> vec4:
        place = fragment_coordinate().xy
        nearness = nearness_of(self.rays, self.depth.load(ivec2(place)).x)
        if nearness == 0.0:
            discard()
        position = place_pixel(self.rays, place, distance_at(self.rays, nearness))
        return self.finish(self.light.load(ivec2(place)).rgb, position)


class LitPixels(BackgroundScreen):
    """Shows what was shaded elsewhere."""

    lit: Texture2D

    def fragment(self) -> vec4:
        return vec4(self.lit.load(ivec2(fragment_coordinate().xy)).rgb, 1.0)


def check_bits(bits: int, known: Collection[int], call: str) -> None:
    """Refuse a number of bits that isn't known."""
    if type(bits) is not int or bits not in known:
        refuse(rules.BAD_TECHNIQUE, call, bits, f"one of {', '.join(map(str, known))}")


def resolve_pass(needs: Needs, run: Callable[[Frame], None], because: str, reads: tuple[str, ...]) -> Pass[Frame]:
    """Return the pass that writes `needs.image`."""
    return Pass("resolve", run, because, reads=reads, writes=(needs.image,))


def sum_pass(needs: Needs, light: str) -> Pass[Frame]:
    """Return the pass that writes `needs.image` from the contents `light` and `depth`."""

    def resolve(frame: Frame) -> None:
        draw_full_screen(frame, LightSum, frame.image, {"light": frame.targets[light]}, clear=frame.background)

    because = "maps the light that was added up to colours"
    for effect in (Effect.HAZE, Effect.FOG):
        if effect in needs.effects:
            because += f"; {needs.explain(effect)}"
    return resolve_pass(needs, resolve, because, (light, "depth"))
