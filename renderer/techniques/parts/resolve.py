"""The last pass of techniques that collect light: makes the image of what earlier passes have left of each
pixel.

A shader of this pass finds the light that each surface sends to the eye, and finishes it as forward shading
does: maps tones, and adds haze by the distance of the surface. A pixel without a surface is the background.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Final

from renderer import rules
from renderer.frame import Effect, Frame, FrameEffects, FramePass
from renderer.shaders.pixels import BackgroundScreen, depth_to_nearness, nearness_to_distance, pixel_position
from renderer.techniques.parts.scene_shader import FinishShader
from renderer.techniques.parts.variants import draw_full_screen
from rhi import Format, refuse
from rhi.shading import Texture2D, discard, fragment_coordinate, ivec2, vec4

LIGHT_FORMAT: Final = Format.RGBA16F
"""The format of light that is stored once it is complete."""
SUM_FORMATS: Final = {16: Format.RGBA16F, 32: Format.RGBA32F}
"""The formats of light that is added up by blending, by the bits of a channel. Each addition is rounded: a
half float loses up to a 1,024th of the sum each time, and what is smaller than that altogether."""
DEFAULT_LIGHT_BITS: Final = 32
"""The bits with which no image shows that its light was added up by blending."""


class LightSum(BackgroundScreen, FinishShader):
    """Makes the image from the accumulated light in `light`."""

    light: Texture2D
    depth: Texture2D

    def fragment(self) -> vec4:
        pixel = fragment_coordinate().xy
        nearness = depth_to_nearness(self.rays, self.depth.load(ivec2(pixel)).x)
        if nearness == 0.0:
            discard()
        position = pixel_position(self.rays, pixel, nearness_to_distance(self.rays, nearness))
        return self.finish(self.light.load(ivec2(pixel)).rgb, position)


class LitPixels(BackgroundScreen):
    """Copies pixels that were shaded elsewhere."""

    lit: Texture2D

    def fragment(self) -> vec4:
        return vec4(self.lit.load(ivec2(fragment_coordinate().xy)).rgb, 1.0)


def check_bits(bits: int, choices: Collection[int], call: str) -> None:
    """Refuse a number of bits that isn't among the choices."""
    if type(bits) is not int or bits not in choices:
        refuse(rules.BAD_TECHNIQUE, call, bits, f"one of {', '.join(map(str, choices))}")


def resolve_pass(
    effects: FrameEffects, run: Callable[[Frame], None], reason: str, reads: tuple[str, ...]
) -> FramePass[Frame]:
    """The pass that writes `effects.image`."""
    return FramePass("resolve", run, reason, reads=reads, writes=(effects.image,))


def sum_pass(effects: FrameEffects, light: str) -> FramePass[Frame]:
    """The pass that writes `effects.image` from `light` and `depth`."""

    def resolve(frame: Frame) -> None:
        draw_full_screen(
            frame, LightSum, frame.image, {"light": frame.targets[light]}, clear=frame.background
        )

    reason = "maps the light that was added up to colours"
    for effect in (Effect.HAZE, Effect.FOG):
        if effect in effects.enabled:
            reason += f"; {effects.explain(effect)}"
    return resolve_pass(effects, resolve, reason, (light, "depth"))
