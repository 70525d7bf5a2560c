"""Fast approximate anti-aliasing (Lottes, FXAA 3.11): smooths the edges of a finished image.

The method looks for edges in luma, follows each one to both of its ends, and shifts the pixel across the edge
by the part of it that the edge would cover. Single pixels that differ from all around them are blurred. It is
for techniques that can't have several samples per pixel. It knows nothing but the image: detail finer than a
pixel is softened, not found.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import rhi.shading as sl
from renderer.frame import IMAGE_FORMAT, Frame, FrameEffects, FramePass, Target, last_version
from renderer.shaders.pixels import BackgroundScreen
from renderer.techniques.parts.variants import draw_full_screen
from renderer.techniques.technique import WrappedTechnique

REACH: Final = 16
"""The pixels along an edge, each way, in which its end is looked for."""


class Fxaa(BackgroundScreen):
    """Smooths the edges of an image."""

    source: sl.Texture2D
    absolute_threshold = 1.0 / 32.0  # contrast of luma below which there is no edge, also in the dark
    relative_threshold = 0.125  # the same as a share of the brightest neighbour
    blur = 0.75  # how much of a single pixel's difference is removed

    def fragment(self) -> sl.vec4:
        pixel = sl.ivec2(sl.fragment_coordinate().xy)
        middle = self.luma(pixel)
        north = self.luma(pixel + sl.ivec2(0, -1))
        south = self.luma(pixel + sl.ivec2(0, 1))
        west = self.luma(pixel + sl.ivec2(-1, 0))
        east = self.luma(pixel + sl.ivec2(1, 0))
        highest = sl.max(middle, sl.max(sl.max(north, south), sl.max(west, east)))
        contrast = highest - sl.min(middle, sl.min(sl.min(north, south), sl.min(west, east)))
        if contrast < sl.max(self.absolute_threshold, highest * self.relative_threshold):
            sl.discard()  # the image already has this color
        north_west = self.luma(pixel + sl.ivec2(-1, -1))
        north_east = self.luma(pixel + sl.ivec2(1, -1))
        south_west = self.luma(pixel + sl.ivec2(-1, 1))
        south_east = self.luma(pixel + sl.ivec2(1, 1))
        level = (
            sl.abs(north_west + south_west - 2.0 * west)
            + 2.0 * sl.abs(north + south - 2.0 * middle)
            + sl.abs(north_east + south_east - 2.0 * east)
        )
        upright = (
            sl.abs(north_west + north_east - 2.0 * north)
            + 2.0 * sl.abs(west + east - 2.0 * middle)
            + sl.abs(south_west + south_east - 2.0 * south)
        )
        is_level = level >= upright
        before = north if is_level else west
        after = south if is_level else east
        along = sl.ivec2(1, 0) if is_level else sl.ivec2(0, 1)
        across = sl.ivec2(0, 1) if is_level else sl.ivec2(1, 0)
        beyond = after
        if sl.abs(before - middle) >= sl.abs(after - middle):
            across = -across
            beyond = before
        shift = self.edge_shift(pixel, along, across, middle, beyond)
        around = 2.0 * (north + south + west + east) + north_west + north_east + south_west + south_east
        single = sl.saturate(sl.abs(around / 12.0 - middle) / contrast)
        single = single * single * (3.0 - 2.0 * single)
        shift = sl.max(shift, single * single * self.blur)
        return sl.mix(self.source.load(pixel), self.texel(pixel + across), shift)

    def edge_shift(
        self, pixel: sl.ivec2, along: sl.ivec2, across: sl.ivec2, middle: float, beyond: float
    ) -> float:
        """Fraction of the pixel that the edge between it and its neighbour cuts off."""
        mean = 0.5 * (middle + beyond)
        change = 0.25 * sl.abs(beyond - middle)
        back = self.edge_end(pixel, -along, across, mean, change)
        forth = self.edge_end(pixel, along, across, mean, change)
        nearer = sl.min(sl.abs(back), sl.abs(forth))
        # The edge cuts the pixel only if it bends towards it at the nearer end, whose sign says on which side
        # it ends.
        end = back if sl.abs(back) < sl.abs(forth) else forth
        if (end < 0.0) == (middle < mean):
            return 0.0
        return 0.5 - nearer / (sl.abs(back) + sl.abs(forth))

    def edge_end(
        self, pixel: sl.ivec2, along: sl.ivec2, across: sl.ivec2, mean: float, change: float
    ) -> float:
        """Pixels to the end of an edge; negative if the end is darker than the edge."""
        away = 0.0
        for i in range(1, REACH + 1):
            at = pixel + along * i
            off = 0.5 * (self.luma(at) + self.luma(at + across)) - mean
            away = float(i) if off >= 0.0 else -float(i)
            if sl.abs(off) >= change:
                break
        return away

    def luma(self, pixel: sl.ivec2) -> float:
        """Brightness of a pixel as perceived, approximated by a square root."""
        return sl.sqrt(sl.dot(self.texel(pixel).rgb, sl.vec3(0.299, 0.587, 0.114)))

    def texel(self, pixel: sl.ivec2) -> sl.vec4:
        return self.source.load(sl.clamp(pixel, sl.ivec2(0), self.source.size() - 1))


class FxaaTechnique(WrappedTechnique):
    """A technique whose image is smoothed by FXAA."""

    def declare(self, effects: FrameEffects) -> Sequence[FramePass[Frame]]:
        """The technique's passes, and one that smooths the image."""
        passes = self._technique.declare(effects)
        return (
            *passes,
            FramePass(
                "fxaa",
                _smooth,
                "smooths edges",
                writes=(Target("image with edges", IMAGE_FORMAT),),
                changes={last_version(passes, "image"): "smooth image"},
            ),
        )


def _smooth(frame: Frame) -> None:
    image, source = frame.targets["smooth image"], frame.targets["image with edges"]
    image.copy_to(source)
    draw_full_screen(frame, Fxaa, image, {"source": source})
