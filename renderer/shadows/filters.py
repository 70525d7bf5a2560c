"""Filters of shadow maps, in shaders: the share of the texels around a point that are lit.

`ShadowMapReader` calls them with the point in texels of the atlas, its depth and the change of that per texel.

**Contact-hardening shadows** (Fernando, Percentage-Closer Soft Shadows, 2005). A light's source is a disc. What
stands between it and a point is looked for in a disc of the map: the *blockers*, texels nearer to the light than
the point's plane. Their mean height above the point says how wide the penumbra is, and so how wide the disc is
whose texels the point is then compared with. Low blockers count most in the mean (of height⁻⁴): they cover most of
the source, and a foot's shadow stays dark.

A map is linear in depth: in metres along the rays of a directional light, in 1 / z of a local light. In both, a
source seen over a blocker reaches as many texels to each side as the difference of their depths times one number,
`spread`. So a texel at a distance of r texels can cover a part of the source only if its depth differs by
r / `spread` at least. What is lower is neither counted as a blocker nor compared: it can't be in the way.

The texels of both discs lie on a spiral (Vogel 1979) that is the same for all points: no noise, and nothing that
swims. Each is compared as `HARDWARE` does it, so a straight edge that crosses the disc takes one step for each
texel of the spiral, and each step is smooth.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

import rhi.shading as sl
from renderer.shadows.shadow_settings import ShadowFilter, ShadowSettings
from rhi.errors.shared_caches import cache_once


def make_disc(count: int, radius: float) -> NDArray[np.float64]:
    """Return a Poisson disc (count, 2): each point is the one of many random points that is farthest from
    those before."""
    random = np.random.default_rng(5)
    points = np.zeros((1, 2))
    while len(points) < count:
        tried = random.uniform(-1.0, 1.0, (256, 2))
        tried = tried[(tried**2).sum(1) <= 1.0]
        distance = ((tried[:, None] - points) ** 2).sum(2).min(1)
        points = np.concatenate([points, tried[distance.argmax()][None]])
    return radius * points


_SMOOTH_RADIUS: Final = 1.5
"""Half the width in texels of the square that `SmoothShadows` compares."""

_LOWEST: Final = 0.5
"""The height, in that of what just covers a part of the source, from which on a texel is compared."""

DISC: Final = make_disc(12, 2.0)
"""The Poisson disc: offsets in texels around a point."""


class ShadowFilterShader(sl.Shader):
    """The base of filters: reads the atlas."""

    lean = True

    def lit_fraction(self, at: sl.vec2, depth: float, slope: sl.vec2, center: sl.vec2, half: float) -> float:
        """Return the share of the texels around a point that are lit.

        Args:
            at: the point in texels of the atlas.
            depth: that of the point.
            slope: its change per texel in x and y.
            center, half: the tile, whose edge is repeated outside of it.
        """
        return 1.0

    def soft_lit_fraction(
        self,
        at: sl.vec2,
        depth: float,
        slope: sl.vec2,
        center: sl.vec2,
        half: float,
        spread: float,
        stretch: sl.vec2,
        limit: float,
    ) -> sl.vec2:
        """Return the share of a source that a point sees, and the radius in texels that it was filtered with.

        Args:
            at, depth, slope, center, half: those of `lit_fraction`.
            spread: the texels that the source reaches to each side, over a blocker whose depth differs by 1.
            stretch: a vector v; the map sees a disc as an ellipse, which is longer by 1 + v·v along v.
            limit: the largest radius in texels: as far as the map is wider than its part of the light.
        """
        return sl.vec2(self.lit_fraction(at, depth, slope, center, half), _SMOOTH_RADIUS)


class TexelFilterShader(ShadowFilterShader):
    """The base of filters that compare texel by texel, each with the depth of the point's plane there."""

    shadow_atlas: sl.Texture2D

    def is_lit(
        self, at: sl.vec2, texel: sl.vec2, depth: float, slope: sl.vec2, center: sl.vec2, half: float
    ) -> float:
        """Return 1 where the plane is lit at the middle of a texel, otherwise 0."""
        inside = sl.clamp(texel, center - half, center + (half - 1.0))
        plane = depth + sl.abs(sl.dot(slope, inside + 0.5 - at))
        return 1.0 if plane >= self.shadow_atlas.load(sl.ivec2(inside)).x else 0.0


class HardShadows(TexelFilterShader):
    """Compares one texel."""

    def lit_fraction(self, at: sl.vec2, depth: float, slope: sl.vec2, center: sl.vec2, half: float) -> float:
        return self.is_lit(at, sl.floor(at), depth, slope, center, half)


class ComparisonFilterShader(ShadowFilterShader):
    """The base of filters whose comparison the hardware filters."""

    shadow_compare: sl.DepthTexture2D

    def compare_texels(self, inside: sl.vec2, depth: float, slope: sl.vec2) -> float:
        """Return the lit share of the 2 × 2 texels around a point, all compared with one depth: that of the plane
        where it is nearest to the light among them.

        Args:
            inside: the point, at least half a texel inside the tile.
            depth: the plane's depth at the point.
            slope: its change per texel in x and y.
        """
        share = sl.fract(inside - 0.5)
        nearest = sl.max(-slope * share, slope * (1.0 - share))
        reference = sl.clamp(depth + nearest.x + nearest.y, 0.0, 1.0)
        return self.shadow_compare.sample_compare_lod(
            inside / sl.vec2(self.shadow_compare.size()), reference, 0.0
        )


class HardwareShadows(ComparisonFilterShader):
    """Compares 2 × 2 texels with the plane."""

    def lit_fraction(self, at: sl.vec2, depth: float, slope: sl.vec2, center: sl.vec2, half: float) -> float:
        inside = sl.clamp(at, center - (half - 0.5), center + (half - 0.5))
        return self.compare_texels(inside, depth + sl.dot(slope, inside - at), slope)


class SmoothShadows(TexelFilterShader):
    """Compares the 4 × 4 texels that a square of 3 × 3 around the point overlaps, weighted by their areas in
    it."""

    def lit_fraction(self, at: sl.vec2, depth: float, slope: sl.vec2, center: sl.vec2, half: float) -> float:
        first = sl.floor(at - 1.5)
        share = at - 1.5 - first
        lit = 0.0
        for row in range(4):
            high = 1.0 if row > 0 else 1.0 - share.y
            high = share.y if row == 3 else high
            for column in range(4):
                wide = 1.0 if column > 0 else 1.0 - share.x
                wide = share.x if column == 3 else wide
                texel = first + sl.vec2(float(column), float(row))
                lit += wide * high * self.is_lit(at, texel, depth, slope, center, half)
        return lit / 9.0


class PoissonShadows(TexelFilterShader):
    """Compares 12 texels of a disc, turned by an angle that depends on the position in the map alone: noise
    doesn't swim."""

    def lit_fraction(self, at: sl.vec2, depth: float, slope: sl.vec2, center: sl.vec2, half: float) -> float:
        cell = sl.floor(at * 8.0)
        angle = 6.2831853 * sl.fract(52.982918 * sl.fract(sl.dot(cell, sl.vec2(0.06711056, 0.00583715))))
        rotate = sl.vec2(sl.cos(angle), sl.sin(angle))
        lit = 0.0
        for i in range(len(DISC)):
            tap = DISC[i]
            turned = at + sl.vec2(rotate.x * tap.x - rotate.y * tap.y, rotate.y * tap.x + rotate.x * tap.y)
            lit += self.is_lit(at, sl.floor(turned), depth, slope, center, half)
        return lit / float(len(DISC))


class PenumbraShadows(SmoothShadows, ComparisonFilterShader):
    """Compares as many texels as the penumbra is wide, and at least those of `SmoothShadows`."""

    blocker_samples = 16
    penumbra_samples = 32

    def soft_lit_fraction(
        self,
        at: sl.vec2,
        depth: float,
        slope: sl.vec2,
        center: sl.vec2,
        half: float,
        spread: float,
        stretch: sl.vec2,
        limit: float,
    ) -> sl.vec2:
        lit = self.lit_fraction(at, depth, slope, center, half)
        reach = sl.min(limit, spread * (1.0 - depth))
        if reach <= _SMOOTH_RADIUS:
            return sl.vec2(lit, _SMOOTH_RADIUS)
        # The texels around the point, and those of the spiral: near the point it has more texels for its area,
        # as low blockers are near it.
        blockers = sl.vec2(0.0)
        for i in range(4):
            near = at + sl.vec2(float(i % 2) * 2.0 - 1.0, float(i // 2) * 2.0 - 1.0) * 0.75
            blockers += self.weigh_blocker(at, near, 1.0, depth, slope, center, half, spread)
        way = sl.vec2(1.0, 0.0)
        for i in range(self.blocker_samples):
            distance = reach * ((float(i) + 0.5) / float(self.blocker_samples))
            tap = at + distance * (way + stretch * sl.dot(stretch, way))
            blockers += self.weigh_blocker(at, tap, distance, depth, slope, center, half, spread)
            way = turn_by_golden_angle(way)
        if blockers.y <= 0.0:
            return sl.vec2(lit, _SMOOTH_RADIUS)
        radius = sl.min(sl.sqrt(sl.sqrt(blockers.x / blockers.y)), limit)
        if radius <= _SMOOTH_RADIUS:
            return sl.vec2(lit, _SMOOTH_RADIUS)
        share = self.compare_disc(at, depth, slope, center, half, spread, stretch, radius)
        is_wide = sl.saturate((radius - _SMOOTH_RADIUS) / _SMOOTH_RADIUS)
        return sl.vec2(sl.mix(lit, share, is_wide), radius)

    def weigh_blocker(
        self,
        at: sl.vec2,
        tap: sl.vec2,
        distance: float,
        depth: float,
        slope: sl.vec2,
        center: sl.vec2,
        half: float,
        spread: float,
    ) -> sl.vec2:
        """Return the weight of the texel at `tap`, 0 if it blocks nothing and 1 if it covers a part of the source,
        and that times radius⁻⁴ of the penumbra that it alone would make."""
        texel = sl.clamp(sl.floor(tap), center - half, center + (half - 1.0))
        stored = self.shadow_atlas.load(sl.ivec2(texel)).x
        if stored <= depth + sl.abs(sl.dot(slope, texel + 0.5 - at)):
            return sl.vec2(0.0)
        width = spread * (stored - depth)
        share = sl.min(width / distance, 1.0)
        weight = share * share * share * share
        return sl.vec2(weight, weight / (width * width * width * width))

    def compare_disc(
        self,
        at: sl.vec2,
        depth: float,
        slope: sl.vec2,
        center: sl.vec2,
        half: float,
        spread: float,
        stretch: sl.vec2,
        radius: float,
    ) -> float:
        """Return the lit share of a disc of `radius` texels."""
        lit = 0.0
        way = sl.vec2(1.0, 0.0)
        for i in range(self.penumbra_samples):
            distance = radius * sl.sqrt((float(i) + 0.5) / float(self.penumbra_samples))
            tap = at + distance * (way + stretch * sl.dot(stretch, way))
            inside = sl.clamp(tap, center - (half - 0.5), center + (half - 0.5))
            rise = sl.max(sl.abs(sl.dot(slope, inside - at)), _LOWEST * distance / spread)
            lit += self.compare_texels(inside, depth + rise, slope)
            way = turn_by_golden_angle(way)
        return lit / float(self.penumbra_samples)


@sl.function
def turn_by_golden_angle(way: sl.vec2) -> sl.vec2:
    """Return a vector turned by the golden angle, π (3 - √5)."""
    return sl.vec2(-0.73736888 * way.x - 0.67549029 * way.y, 0.67549029 * way.x - 0.73736888 * way.y)


FILTERS: Final[dict[ShadowFilter, type[ShadowFilterShader]]] = {
    ShadowFilter.HARD: HardShadows,
    ShadowFilter.HARDWARE: HardwareShadows,
    ShadowFilter.SMOOTH: SmoothShadows,
    ShadowFilter.POISSON: PoissonShadows,
    ShadowFilter.PCSS: PenumbraShadows,
}
"""The shader part of each filter."""


@cache_once
def filter_shader(settings: ShadowSettings, *, has_penumbras: bool) -> type[ShadowFilterShader]:
    """Return the shader part of the filter. Without lights whose sources have a size, penumbras are those of
    `SMOOTH`."""
    if settings.filter is not ShadowFilter.PCSS:
        return FILTERS[settings.filter]
    if not has_penumbras:
        return SmoothShadows
    counts = {"blocker_samples": settings.blocker_samples, "penumbra_samples": settings.penumbra_samples}
    return type("PenumbraShadows", (PenumbraShadows,), {"__module__": __name__, **counts})
