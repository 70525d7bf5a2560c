"""Glow: a share of all light is scattered in the eye or the lens, and seen around what is brighter than white.

What is seen is `(1 - share) · light + share · spread light`. The spread light is the mean of copies of the image, each
spread twice as far as the one before. So each doubling of the distance gets as much light, which falls with the square
of the distance, as glare in the eye does (Vos and van den Berg 1999). There is no threshold: nothing is cut out, and
what is dark gives little light. All filters are weighted means, so light is moved and none is made.

1. `glow` halves the image, level by level, with 13 bilinear samples of 6 × 6 texels each: half of the mean of the
   middle 4 × 4, and an eighth of each corner's (Jimenez 2014). All texels count the same, wherever they are in the grid
   of the halves, so that what moves by less than a texel doesn't flicker. Then each level, from the smallest, is
   blended over the one before it, spread by a tent of 3 × 3 texels.
2. `tones` mixes light and glow, and maps tones.

A level has exactly half the size of the one before it, rounded up, and texels of a half lie between those of the whole
at any size; what is beyond the edge is as at the edge. So a target may have any size, from one pixel on. Texels that
are NaN or infinite count as black.
"""

from __future__ import annotations

from functools import partial
from typing import Any, Final

import rhi.shading as sl
from renderer.frame import IMAGE_FORMAT, LIGHT_FORMATS, Effect, Frame, GlowSettings, Needs, Pass, Target
from renderer.shaders.lighting import tone_map
from renderer.shaders.pixels import BackgroundScreen
from renderer.techniques.parts.variants import draw_full_screen
from rhi import (
    BlendColor,
    BlendFactor,
    BlendFunction,
    SamplerDescriptor,
    Wrap,
)

_EDGE: Final = SamplerDescriptor(mip=None, wrap_u=Wrap.CLAMP, wrap_v=Wrap.CLAMP)
_OVER: Final = BlendFunction(BlendFactor.CONSTANT, BlendFactor.ONE_MINUS_CONSTANT)
_EXPONENT: Final = 0x7F800000
"""The bits of an exponent, all of which are set in NaN and infinity."""


@sl.function
def is_finite(number: float) -> bool:
    """Return whether a float is a number that isn't infinite, which no fast arithmetic assumes away."""
    return (sl.float_bits_to_uint(number) & sl.uint(_EXPONENT)) != sl.uint(_EXPONENT)


@sl.function
def keep_light(color: sl.vec3) -> sl.vec3:
    """Return light of at least 0, and black for what isn't light."""
    if is_finite(color.x + color.y + color.z):
        return sl.max(color, 0.0)
    return sl.vec3(0.0)


class Share(sl.Struct):
    """The share of all light that is scattered."""

    share: float


class Halved(BackgroundScreen):
    """Makes an image of half the width and height."""

    precision = sl.Precision.FAST
    source: sl.Texture2D

    def fragment(self) -> sl.vec4:
        centre = sl.vec2(sl.ivec2(sl.fragment_coordinate().xy)) * 2.0 + 1.0  # in texels of the source
        north_west = self.read(centre + sl.vec2(-2.0, -2.0))
        north = self.read(centre + sl.vec2(0.0, -2.0))
        north_east = self.read(centre + sl.vec2(2.0, -2.0))
        west = self.read(centre + sl.vec2(-2.0, 0.0))
        middle = self.read(centre)
        east = self.read(centre + sl.vec2(2.0, 0.0))
        south_west = self.read(centre + sl.vec2(-2.0, 2.0))
        south = self.read(centre + sl.vec2(0.0, 2.0))
        south_east = self.read(centre + sl.vec2(2.0, 2.0))
        inner = self.read(centre + sl.vec2(-1.0, -1.0)) + self.read(centre + sl.vec2(1.0, -1.0))
        inner += self.read(centre + sl.vec2(-1.0, 1.0)) + self.read(centre + sl.vec2(1.0, 1.0))
        first = north_west + north + west + middle
        second = north + north_east + middle + east
        third = west + middle + south_west + south
        fourth = middle + east + south + south_east
        return sl.vec4(self.combine(inner * 0.25, first * 0.25, second * 0.25, third * 0.25, fourth * 0.25), 1.0)

    def read(self, place: sl.vec2) -> sl.vec3:
        """Return the mean of the four texels around a corner."""
        return self.source.sample_lod(place / sl.vec2(self.source.size()), 0.0).rgb

    def combine(self, inner: sl.vec3, first: sl.vec3, second: sl.vec3, third: sl.vec3, fourth: sl.vec3) -> sl.vec3:
        """Return the mean of the boxes in the middle and at the corners."""
        return inner * 0.5 + (first + second + third + fourth) * 0.125


class HalvedImage(Halved):
    """Halves the image itself, whose texels may be anything."""

    def read(self, place: sl.vec2) -> sl.vec3:
        return keep_light(super().read(place))


class TamedImage(HalvedImage):
    """Halves the image; boxes count less the brighter they are (Karis 2013)."""

    def combine(self, inner: sl.vec3, first: sl.vec3, second: sl.vec3, third: sl.vec3, fourth: sl.vec3) -> sl.vec3:
        heavy = 0.5 * self.weigh(inner)
        weights = sl.vec4(self.weigh(first), self.weigh(second), self.weigh(third), self.weigh(fourth)) * 0.125
        sum = inner * heavy + first * weights.x + second * weights.y + third * weights.z + fourth * weights.w
        return sum / (heavy + sl.dot(weights, sl.vec4(1.0)))

    def weigh(self, color: sl.vec3) -> float:
        """Return the weight of a box."""
        return 1.0 / (1.0 + sl.dot(color, sl.vec3(0.2126, 0.7152, 0.0722)))


class Spreading(BackgroundScreen):
    """The base of shaders that read a level of half their target's size, spread by a tent."""

    precision = sl.Precision.FAST
    spread: sl.Texture2D

    def read_spread(self) -> sl.vec3:
        """Return the mean of 3 × 3 bilinear samples around the pixel, the middle one with four times the weight of a
        corner. They read 4 × 4 texels, which are as many as four samples between the right places read."""
        place = sl.vec2(sl.ivec2(sl.fragment_coordinate().xy)) * 0.5 - 0.25  # in texels, from the middle of the first
        first = sl.floor(place)
        part = place - first
        # Along an axis, the weights of the four texels are 1 - p, 2 - p, 1 + p and p quarters.
        near = first - 0.5 + (2.0 - part) / (3.0 - 2.0 * part)
        far = first + 1.5 + part / (1.0 + 2.0 * part)
        share = (1.0 + 2.0 * part) * 0.25
        upper = sl.mix(self.read(near), self.read(sl.vec2(far.x, near.y)), share.x)
        lower = sl.mix(self.read(sl.vec2(near.x, far.y)), self.read(far), share.x)
        return sl.mix(upper, lower, share.y)

    def read(self, place: sl.vec2) -> sl.vec3:
        """Return the light at a place, in texels."""
        return self.spread.sample_lod(place / sl.vec2(self.spread.size()), 0.0).rgb


class Spread(Spreading):
    """Spreads a level, to be blended over the next larger one."""

    def fragment(self) -> sl.vec4:
        return sl.vec4(self.read_spread(), 1.0)


class Tones(Spreading):
    """Mixes light and glow, and maps tones."""

    light: sl.Texture2D
    mixture: sl.Uniform[Share]

    def fragment(self) -> sl.vec4:
        light = keep_light(self.light.load(sl.ivec2(sl.fragment_coordinate().xy)).rgb)
        return sl.vec4(tone_map(sl.mix(light, self.read_spread(), self.mixture.share)), 1.0)


def glow_passes(needs: Needs, light: str) -> tuple[Pass[Frame], ...]:
    """Return the passes that make `image` of the contents `light`: none without glow."""
    if Effect.GLOW not in needs.effects:
        return ()
    format = LIGHT_FORMATS[needs.glow.bits]
    levels = tuple(Target(f"glow {i}", format, 0.5**i) for i in range(1, needs.glow.levels + 1))
    return (
        Pass(
            "glow",
            partial(_spread_light, settings=needs.glow),
            f"spreads a share of the light; {needs.explain(Effect.GLOW)}",
            reads=(light,),
            writes=levels,
        ),
        Pass(
            "tones",
            _map_tones,
            "mixes light and glow, and maps them to colours",
            reads=(light, "glow 1"),
            writes=(Target("image", IMAGE_FORMAT),),
        ),
    )


def _spread_light(frame: Frame, *, settings: GlowSettings) -> None:
    source, count = frame.image, settings.levels
    levels = [frame.targets[f"glow {i}"] for i in range(1, count + 1)]
    shader: type[Halved] = TamedImage if settings.tames_sparks else HalvedImage
    for level in levels:
        draw_full_screen(frame, shader, level, {"source": source.sampled(_EDGE)})
        source, shader = level, Halved
    for i in range(count - 1, 0, -1):
        # Of the mean of `n` copies from this level on, all but one come from smaller levels.
        n = count - i + 1
        share = (n - 1) / n
        states = _OVER, BlendColor(share, share, share, share)
        draw_full_screen(frame, Spread, levels[i - 1], {"spread": levels[i].sampled(_EDGE)}, states=states)


def _map_tones(frame: Frame) -> None:
    scene = frame.resources.scene
    assert scene.glow is not None, "glow is made where the scene has some"
    spread = frame.targets["glow 1"].sampled(_EDGE)
    mixture = frame.resources.mirror(Share(share=scene.glow.share))
    bindings: dict[str, Any] = {"light": frame.image, "spread": spread, "mixture": mixture}
    draw_full_screen(frame, Tones, frame.targets["image"], bindings)
