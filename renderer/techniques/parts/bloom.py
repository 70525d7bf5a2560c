"""Bloom: a share of all light is scattered in the eye or the camera, and seen around what is brighter than
white.

What is seen is `(1 - strength) · light + strength · blurred light`. The blurred light is the mean of copies
of the image, each blurred twice as far as the one before. So each doubling of the distance gets as much
light, which falls with the square of the distance, as glare in the eye does (Vos and van den Berg 1999).
There is no threshold: nothing is cut out, and what is dark gives little light. All filters are weighted
means, so light is moved and none is made.

1. `bloom` halves the image, level by level, with 13 bilinear samples of 6 × 6 texels each: half of the mean
   of the middle 4 × 4, and an eighth of each corner's (Jimenez 2014). All texels count the same, wherever
   they are in the grid of the halves, so that what moves by less than a texel doesn't flicker. Then each
   level, from the smallest, is blended over the one before it, spread by a tent of 3 × 3 texels.
2. `tone mapping` mixes light and bloom, and maps tones.

A level has exactly half the size of the one before it, rounded up, and texels of a half lie between those of
the whole at any size; what is beyond the edge is as at the edge. So a target may have any size, from one
pixel on. Texels that are NaN or infinite count as black.
"""

from __future__ import annotations

from functools import partial
from typing import Any, Final

import rhi.shading as sl
from renderer.frame import (
    IMAGE_FORMAT,
    LIGHT_FORMATS,
    BloomSettings,
    Effect,
    Frame,
    FrameEffects,
    FramePass,
    Target,
)
from renderer.shaders.pixels import BackgroundScreen
from renderer.shaders.tone_mapping import tone_map
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
    """True if a float is finite. Tests bits, because fast arithmetic may assume that all floats are."""
    return (sl.float_bits_to_uint(number) & sl.uint(_EXPONENT)) != sl.uint(_EXPONENT)


@sl.function
def finite_light(color: sl.vec3) -> sl.vec3:
    """Light of at least 0; black where a channel is NaN or infinite."""
    if is_finite(color.x + color.y + color.z):
        return sl.max(color, 0.0)
    return sl.vec3(0.0)


class BloomConstants(sl.Struct):
    """The fraction of all light that is scattered."""

    strength: float


class Downsample(BackgroundScreen):
    """Downsamples an image to half its width and height."""

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
        return sl.vec4(
            self.combine(inner * 0.25, first * 0.25, second * 0.25, third * 0.25, fourth * 0.25), 1.0
        )

    def read(self, position: sl.vec2) -> sl.vec3:
        """Mean of the four texels around a corner."""
        return self.source.sample_lod(position / sl.vec2(self.source.size()), 0.0).rgb

    def combine(
        self, inner: sl.vec3, first: sl.vec3, second: sl.vec3, third: sl.vec3, fourth: sl.vec3
    ) -> sl.vec3:
        """Weighted mean of the inner box and the four corner boxes."""
        return inner * 0.5 + (first + second + third + fourth) * 0.125


class DownsampleImage(Downsample):
    """Downsamples the image itself, whose texels may be NaN, infinite or negative."""

    def read(self, position: sl.vec2) -> sl.vec3:
        return finite_light(super().read(position))


class DownsampleKaris(DownsampleImage):
    """Downsamples the image with the Karis average: bright boxes weigh less (Karis 2013)."""

    def combine(
        self, inner: sl.vec3, first: sl.vec3, second: sl.vec3, third: sl.vec3, fourth: sl.vec3
    ) -> sl.vec3:
        heavy = 0.5 * self.weigh(inner)
        weights = (
            sl.vec4(self.weigh(first), self.weigh(second), self.weigh(third), self.weigh(fourth)) * 0.125
        )
        sum = inner * heavy + first * weights.x + second * weights.y + third * weights.z + fourth * weights.w
        return sum / (heavy + sl.dot(weights, sl.vec4(1.0)))

    def weigh(self, color: sl.vec3) -> float:
        """Karis weight of a box."""
        return 1.0 / (1.0 + sl.dot(color, sl.vec3(0.2126, 0.7152, 0.0722)))


class UpsampleShader(BackgroundScreen):
    """Base of shaders that upsample a level of half their target's size with a tent filter."""

    precision = sl.Precision.FAST
    smaller_level: sl.Texture2D

    def read_upsampled(self) -> sl.vec3:
        """Tent filter of 3 × 3 bilinear samples around the pixel, whose middle weighs four times as much
        as a corner. It reads 4 × 4 texels, which four well-placed bilinear samples cover."""
        position = (
            sl.vec2(sl.ivec2(sl.fragment_coordinate().xy)) * 0.5 - 0.25
        )  # in texels, from the middle of the first
        first = sl.floor(position)
        part = position - first
        # Along an axis, the weights of the four texels are 1 - p, 2 - p, 1 + p and p quarters.
        near = first - 0.5 + (2.0 - part) / (3.0 - 2.0 * part)
        far = first + 1.5 + part / (1.0 + 2.0 * part)
        weight = (1.0 + 2.0 * part) * 0.25
        upper = sl.mix(self.read(near), self.read(sl.vec2(far.x, near.y)), weight.x)
        lower = sl.mix(self.read(sl.vec2(near.x, far.y)), self.read(far), weight.x)
        return sl.mix(upper, lower, weight.y)

    def read(self, position: sl.vec2) -> sl.vec3:
        """Light at a position in texels."""
        return self.smaller_level.sample_lod(position / sl.vec2(self.smaller_level.size()), 0.0).rgb


class Upsample(UpsampleShader):
    """Upsamples a level, to be blended over the next larger one."""

    def fragment(self) -> sl.vec4:
        return sl.vec4(self.read_upsampled(), 1.0)


class BloomComposite(UpsampleShader):
    """Mixes light and bloom, and maps tones."""

    light: sl.Texture2D
    bloom: sl.Uniform[BloomConstants]

    def fragment(self) -> sl.vec4:
        light = finite_light(self.light.load(sl.ivec2(sl.fragment_coordinate().xy)).rgb)
        return sl.vec4(tone_map(sl.mix(light, self.read_upsampled(), self.bloom.strength)), 1.0)


BLOOM_SHADERS: Final[tuple[type[sl.Shader], ...]] = (
    DownsampleImage,
    DownsampleKaris,
    Downsample,
    Upsample,
    BloomComposite,
)
"""The shaders of `bloom_passes`."""


def bloom_passes(effects: FrameEffects, light: str) -> tuple[FramePass[Frame], ...]:
    """The passes that make `image` from the resource `light`; none without bloom."""
    if Effect.BLOOM not in effects.enabled:
        return ()
    format = LIGHT_FORMATS[effects.bloom.bits]
    levels = tuple(Target(f"bloom {i}", format, 0.5**i) for i in range(1, effects.bloom.levels + 1))
    return (
        FramePass(
            "bloom",
            partial(_blur_light, light=light, settings=effects.bloom),
            f"spreads a share of the light; {effects.explain(Effect.BLOOM)}",
            reads=(light,),
            writes=levels,
        ),
        FramePass(
            "tone mapping",
            partial(_composite, light=light),
            "mixes light and bloom, and maps them to colours",
            reads=(light, "bloom 1"),
            writes=(Target("image", IMAGE_FORMAT),),
        ),
    )


def _blur_light(frame: Frame, *, light: str, settings: BloomSettings) -> None:
    source, count = frame.targets[light], settings.levels
    levels = [frame.targets[f"bloom {i}"] for i in range(1, count + 1)]
    shader: type[Downsample] = DownsampleKaris if settings.karis_average else DownsampleImage
    for level in levels:
        draw_full_screen(frame, shader, level, {"source": source.sampled(_EDGE)})
        source, shader = level, Downsample
    for i in range(count - 1, 0, -1):
        # Of the mean of `n` copies from this level on, all but one come from smaller levels.
        n = count - i + 1
        weight = (n - 1) / n
        states = _OVER, BlendColor(weight, weight, weight, weight)
        draw_full_screen(
            frame, Upsample, levels[i - 1], {"smaller_level": levels[i].sampled(_EDGE)}, states=states
        )


def _composite(frame: Frame, *, light: str) -> None:
    scene = frame.resources.scene
    assert scene.bloom is not None, "bloom can be drawn only if the scene has bloom"
    smaller_level = frame.targets["bloom 1"].sampled(_EDGE)
    bloom = frame.resources.mirror(BloomConstants(strength=scene.bloom.strength))
    bindings: dict[str, Any] = {"light": frame.targets[light], "smaller_level": smaller_level, "bloom": bloom}
    draw_full_screen(frame, BloomComposite, frame.targets["image"], bindings)
