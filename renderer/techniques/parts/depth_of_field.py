"""Depth of field: what is out of focus is seen as discs, the circles of confusion of the scene's `DepthOfField`.

A pixel's light is spread over a disc by the aperture. Here each pixel gathers instead: it takes from the pixels
around it those whose discs reach it, each with the share of its light that arrives, 1 / (π · radius²) of a pixel's
area (Potmesil and Chakravarty 1981; Jimenez 2014, *Next Generation Post Processing in Call of Duty: Advanced
Warfare*). Discs have a sign: those of what is nearer than the focus are negative.

1. `circles of confusion` stores light and the signed radius of each pixel's disc, in pixels.
2. `near discs` takes the largest disc before the focus from blocks of 16 × 16 pixels, and then from all blocks that
   such discs reach. So pixels with nothing blurred before them gather no more than their own disc.
3. `depth of field` samples the pixel's own disc, and the ring around it up to the largest near disc. Samples are of
   three layers. What is *in front* covers the pixel by the shares that reach it. What is at the pixel's own
   distance fills the aperture as far as the front leaves it, and what is *behind* fills what is left then. So near
   things spill over what is sharp, and sharp things take no light from what is blurred behind them.

What the rest of the aperture sees around a near thing is hidden in the image. It counts as what is behind nearby, the
nearest samples the most.

Light is summed up before its tones are mapped, so small bright things become bright discs.
"""

from __future__ import annotations

from functools import partial
from typing import Final

import numpy as np

import rhi.shading as sl
from renderer.frame import (
    IMAGE_FORMAT,
    LIGHT_FORMATS,
    DepthOfFieldSettings,
    Effect,
    Frame,
    FrameEffects,
    FramePass,
    Target,
)
from renderer.frame.pixel_rays import compute_pixel_rays
from renderer.shaders.lighting import MAX_HALF_FLOAT
from renderer.shaders.pixels import BackgroundScreen, ViewRayShader, depth_to_nearness, nearness_to_distance
from renderer.shaders.tone_mapping import tone_map
from renderer.techniques.parts.bloom import finite_light
from renderer.techniques.parts.variants import draw_full_screen
from rhi import Format

BLURRED_LIGHT: Final = "blurred_light"
"""The resource with depth of field, if there is bloom, too."""
_CIRCLES: Final = "circles"
_BLOCK_DISCS: Final = "block_discs"
_NEAR_DISCS: Final = "near_discs"
_BLOCK: Final = 16
_GOLDEN_ANGLE: Final = 2.399963229728653
_PI: Final = 3.141592653589793
_SMALLEST: Final = 0.5
"""The radius in pixels of what is sharp: the pixel itself."""
_FORMATS: Final = {16: Format.RGBA16F, 32: Format.RGBA32F}


class ApertureConstants(sl.Struct):
    """The aperture of a view: its radius in metres, 1 / focus distance, the radius of the largest disc in pixels of a
    column, how many blocks that is, and how many pixels of a row are as long as one of a column."""

    radius: float
    inverse_focus: float
    max_radius: float
    blocks: int
    stretch: float


class CircleOfConfusion(BackgroundScreen, ViewRayShader):
    """Stores light and the signed radius of the circle of confusion, in pixels of a column."""

    precision = sl.Precision.FAST

    light: sl.Texture2D
    depth: sl.Texture2D
    aperture: sl.Uniform[ApertureConstants]

    def fragment(self) -> sl.vec4:
        pixel = sl.ivec2(sl.fragment_coordinate().xy)
        color = sl.min(finite_light(self.light.load(pixel).rgb), MAX_HALF_FLOAT)
        nearness = depth_to_nearness(self.rays, self.depth.load(pixel).x)
        distance = self.rays.far
        if nearness > 0.0:
            distance = nearness_to_distance(self.rays, nearness)
        # The difference is in metres at the distance d, over d with a perspective projection.
        defocus = self.aperture.inverse_focus - 1.0 / distance
        if self.has_parallel_rays:
            defocus = distance * self.aperture.inverse_focus - 1.0
        height = sl.length(self.rays.across @ sl.vec3(0.0, 1.0, 0.0))
        radius = self.aperture.radius * defocus / height
        return sl.vec4(color, sl.clamp(radius, -self.aperture.max_radius, self.aperture.max_radius))


class BlockDiscs(BackgroundScreen):
    """Finds the largest disc before the focus in each block of pixels."""

    precision = sl.Precision.FAST

    circles: sl.Texture2D

    def fragment(self) -> sl.vec4:
        first = sl.ivec2(sl.fragment_coordinate().xy) * _BLOCK
        last = self.circles.size() - 1
        largest = 0.0
        for y in range(_BLOCK):
            for x in range(_BLOCK):
                pixel = sl.min(first + sl.ivec2(x, y), last)
                largest = sl.max(largest, -self.circles.load(pixel).w)
        return sl.vec4(largest)


class NearDiscs(BackgroundScreen):
    """Finds the largest disc before the focus that may reach a pixel of each block."""

    precision = sl.Precision.FAST

    block_discs: sl.Texture2D
    aperture: sl.Uniform[ApertureConstants]

    def fragment(self) -> sl.vec4:
        block = sl.ivec2(sl.fragment_coordinate().xy)
        last = self.block_discs.size() - 1
        count = self.aperture.blocks
        largest = 0.0
        for y in range(2 * count + 1):
            for x in range(2 * count + 1):
                step = sl.ivec2(x, y) - count
                other = block + step
                if other == sl.clamp(other, sl.ivec2(0), last):
                    radius = self.block_discs.load(other).x
                    away = float(sl.max(sl.max(sl.abs(step.x), sl.abs(step.y)) - 1, 0) * _BLOCK)
                    if radius * sl.max(self.aperture.stretch, 1.0) + 1.0 > away:
                        largest = sl.max(largest, radius)
        return sl.vec4(largest)


class GatherDiscs(BackgroundScreen):
    """Gathers the light of the discs that reach a pixel."""

    precision = sl.Precision.FAST
    samples = 64
    maps_tones = True

    circles: sl.Texture2D
    near_discs: sl.Texture2D
    aperture: sl.Uniform[ApertureConstants]

    def fragment(self) -> sl.vec4:
        pixel = sl.ivec2(sl.fragment_coordinate().xy)
        own = self.circles.load(pixel)
        radius = sl.abs(own.w)
        reach = self.near_discs.load(pixel // _BLOCK).x
        color = own.rgb
        if sl.max(radius, reach) > _SMALLEST:
            color = self.gather(pixel, own, sl.max(radius, _SMALLEST), reach)
        if self.maps_tones:
            color = tone_map(color)
        return sl.vec4(color, 1.0)

    def gather(self, pixel: sl.ivec2, own: sl.vec4, radius: float, reach: float) -> sl.vec3:
        """Return the light of a pixel whose disc has this radius, reached by near discs of up to `reach`."""
        # 16 pixels of 4 × 4 have as many turns of the spiral of samples.
        turn = float(((pixel.x + pixel.y) & 3) * 4 + (pixel.x & 3)) * (_GOLDEN_ANGLE / 16.0)
        inner = sl.max(radius, reach)
        half = self.bound_disc(inner)
        if (2 * half.x + 1) * (2 * half.y + 1) > self.samples:
            inner = radius
            half = self.bound_disc(inner)
        width = 2 * half.x + 1
        count = width * (2 * half.y + 1)
        is_whole = count <= self.samples
        area = 1.0 / (_PI * self.aperture.stretch)
        edge = inner + 0.5  # the share of a disc's edge is half a pixel wide on both sides
        if not is_whole:
            count = self.samples
            area = edge * edge / float(count)
        front = sl.vec4(0.0)
        same = sl.vec4(0.0)
        behind = sl.vec4(0.0)
        fill = sl.vec4(0.0)
        for i in range(count):
            step = sl.ivec2(i % width, i // width) - half
            if not is_whole:
                distance = edge * sl.sqrt((float(i) + 0.5) / float(count))
                step = self.choose_step(distance, float(i) * _GOLDEN_ANGLE + turn)
            away = self.measure_step(step)
            if away <= edge:
                sample = self.load_circle(pixel + step)
                share = self.measure_share(sample.w, away) * area
                nearer = sl.saturate(own.w - sample.w - 0.5)
                farther = sl.saturate(sample.w - own.w - 0.5)
                color = sl.vec4(sample.rgb, 1.0)
                front += color * (share * nearer)
                same += color * (share * (1.0 - nearer) * (1.0 - farther))
                behind += color * (share * farther)
                fill += color * (farther / (1.0 + away * away))
        if reach > inner:
            square = edge * edge
            ring = (reach + 0.5) * (reach + 0.5) - square
            for i in range(self.samples):
                distance = sl.sqrt(square + ring * (float(i) + 0.5) / float(self.samples))
                step = self.choose_step(distance, float(i) * _GOLDEN_ANGLE + turn)
                sample = self.load_circle(pixel + step)
                share = self.measure_share(sample.w, self.measure_step(step)) * ring / float(self.samples)
                front += sl.vec4(sample.rgb, 1.0) * (share * sl.saturate(own.w - sample.w - 0.5))
        total = self.cover(sl.vec4(0.0), front)
        total = self.cover(total, same)
        total = self.cover(total, behind)
        total = self.cover(total, fill * 1e6)
        if total.w > 0.0:
            return total.rgb / total.w
        return own.rgb

    def cover(self, total: sl.vec4, layer: sl.vec4) -> sl.vec4:
        """Return the light of an aperture of which a layer covers more, up to all of it."""
        share = sl.min(layer.w, 1.0 - total.w)
        if share <= 0.0:
            return total
        return total + layer * (share / layer.w)

    def bound_disc(self, radius: float) -> sl.ivec2:
        """Return the pixels that a disc reaches to each side, along rows and columns."""
        return sl.ivec2(sl.floor((radius + 0.5) * sl.vec2(self.aperture.stretch, 1.0)))

    def choose_step(self, distance: float, angle: float) -> sl.ivec2:
        """Return the step to the pixel at a distance, in pixels of a column."""
        along = sl.vec2(sl.cos(angle) * self.aperture.stretch, sl.sin(angle))
        return sl.ivec2(sl.round(along * distance))

    def measure_step(self, step: sl.ivec2) -> float:
        """Return the length of a step in pixels of a column."""
        return sl.length(sl.vec2(step) / sl.vec2(self.aperture.stretch, 1.0))

    def load_circle(self, pixel: sl.ivec2) -> sl.vec4:
        """Return light and disc of a pixel; beyond the edge, of the nearest one."""
        return self.circles.load(sl.clamp(pixel, sl.ivec2(0), self.circles.size() - 1))

    def measure_share(self, circle: float, away: float) -> float:
        """Return the share of a pixel's light that falls on a pixel so far away, times π."""
        radius = sl.max(sl.abs(circle), _SMALLEST)
        return sl.saturate(radius - away + 0.5) / (radius * radius)


DEPTH_OF_FIELD_SHADERS: Final[tuple[type[sl.Shader], ...]] = (
    CircleOfConfusion,
    BlockDiscs,
    NearDiscs,
    GatherDiscs,
)
"""The shaders of `depth_of_field_passes`."""


def depth_of_field_passes(effects: FrameEffects, light: str) -> tuple[FramePass[Frame], ...]:
    """The passes that blur the resource `light`: to `image`, or if there is bloom to `BLURRED_LIGHT`; none without
    depth of field."""
    if Effect.DEPTH_OF_FIELD not in effects.enabled:
        return ()
    settings, has_bloom = effects.depth_of_field, Effect.BLOOM in effects.enabled
    blurred = (
        Target(BLURRED_LIGHT, LIGHT_FORMATS[max(settings.bits, effects.bloom.bits)])
        if has_bloom
        else Target("image", IMAGE_FORMAT)
    )
    blocks = Target(_BLOCK_DISCS, Format.R16F, 1.0 / _BLOCK), Target(_NEAR_DISCS, Format.R16F, 1.0 / _BLOCK)
    return (
        FramePass(
            "circles of confusion",
            partial(_draw_circles, light=light, settings=settings),
            f"computes how far light spreads; {effects.explain(Effect.DEPTH_OF_FIELD)}",
            reads=(light, "depth"),
            writes=(Target(_CIRCLES, _FORMATS[settings.bits]),),
        ),
        FramePass(
            "near discs",
            partial(_draw_near_discs, settings=settings),
            "finds the discs before the focus that reach each block of pixels",
            reads=(_CIRCLES,),
            writes=blocks,
        ),
        FramePass(
            "depth of field",
            partial(_gather, settings=settings, target=blurred.name, maps_tones=not has_bloom),
            "gathers the light of the discs that reach each pixel",
            reads=(_CIRCLES, _NEAR_DISCS),
            writes=(blurred,),
        ),
    )


def compute_aperture(frame: Frame, settings: DepthOfFieldSettings) -> ApertureConstants:
    """Compute the aperture of a frame's view."""
    depth_of_field, size = frame.resources.scene.depth_of_field, frame.targets.size
    assert depth_of_field is not None, "only a scene with depth of field has its passes"
    across = np.linalg.norm(compute_pixel_rays(frame.camera, size).across, axis=0)
    stretch = float(across[1] / across[0])
    max_radius = settings.max_radius * size[1]
    return ApertureConstants(
        radius=depth_of_field.aperture_radius,
        inverse_focus=1.0 / depth_of_field.focus_distance,
        max_radius=max_radius,
        blocks=int(max_radius * max(stretch, 1.0) / _BLOCK) + 1,
        stretch=stretch,
    )


def _draw_circles(frame: Frame, *, light: str, settings: DepthOfFieldSettings) -> None:
    bindings = {
        "light": frame.targets[light],
        "depth": frame.targets["depth"],
        "aperture": frame.view.mirror(compute_aperture(frame, settings)),
    }
    draw_full_screen(frame, CircleOfConfusion, frame.targets[_CIRCLES], bindings)


def _draw_near_discs(frame: Frame, *, settings: DepthOfFieldSettings) -> None:
    blocks = frame.targets[_BLOCK_DISCS]
    draw_full_screen(frame, BlockDiscs, blocks, {"circles": frame.targets[_CIRCLES]})
    aperture = frame.view.mirror(compute_aperture(frame, settings))
    draw_full_screen(
        frame, NearDiscs, frame.targets[_NEAR_DISCS], {"block_discs": blocks, "aperture": aperture}
    )


def _gather(frame: Frame, *, settings: DepthOfFieldSettings, target: str, maps_tones: bool) -> None:
    bindings = {
        "circles": frame.targets[_CIRCLES],
        "near_discs": frame.targets[_NEAR_DISCS],
        "aperture": frame.view.mirror(compute_aperture(frame, settings)),
    }
    switches = {"samples": settings.samples, "maps_tones": maps_tones}
    draw_full_screen(frame, GatherDiscs, frame.targets[target], bindings, switches=switches)
