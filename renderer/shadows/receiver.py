"""Receivers of shadows, in shaders: the share of a light that shadow maps leave to a surface.

A shader that lights surfaces hands the light of each lamp to `unblocked_sun`, `unblocked_point` or `unblocked_spot`,
which return what arrives. `ShadowReceiver` returns all of it; the classes below each add the shadows of one kind of
light, and one of the filters reads the maps. So a technique has shadows by one call for each light, whichever maps
there are. The table of the sun's maps is a uniform block, and those of lamps, of which there may be thousands, are
textures: forward shading needs the eight storage buffers that a program may have.

**Bias.** A texel holds the depth of a surface at its middle, and is compared with a point elsewhere in it, whose
depth differs by tan θ times the distance. So a point isn't compared with its own depth, but with that of its
surface's plane at the middle of the texel, which follows from the normal. Where the plane is farther away there, it
is compared with a depth that is as much nearer: at the foot of a wall the floor is in front of the wall's plane. What
is left is rounding, and the difference between a normal and a facet: for these the point is moved along its normal,
by `bias.x` texels and `bias.y` times the sine of θ, in all by less than a texel.

The normal is that of the surface in the map, which normal maps don't bend (`SurfacePoint.plane`). Where they bend it
towards a light behind the surface, the surface is in its own shadow.

Depth is reversed: 1 at the light, less farther away. A point is lit where it isn't farther than what is in the map.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

import rhi.shading as sl
from renderer.shaders.structs import TABLE_WIDTH, PointLight, SpotLight
from renderer.shadows.lamps import NEAR
from renderer.shadows.settings import ShadowFilter

MOST_CASCADES: Final = 8
"""The number of maps of all directional lights together."""

NO_MAPS: Final = -1
DARK: Final = -2
"""The slots of lamps without maps: those that nothing blocks, and those for whose maps there is no room. The latter
light nothing, so that no wall is lit through."""

_SMALL: Final = 64
"""The width in texels of a lamp's map up to which shadows err towards dark."""

_STEEPEST: Final = 0.005
"""The cosine of the steepest slope that a plane is followed to: 89.7°."""


def make_disc(count: int, radius: float) -> NDArray[np.float64]:
    """Return a Poisson disc (count, 2): each place is, of many random ones, the farthest from those before it."""
    random = np.random.default_rng(5)
    places = np.zeros((1, 2))
    while len(places) < count:
        tried = random.uniform(-1.0, 1.0, (256, 2))
        tried = tried[(tried**2).sum(1) <= 1.0]
        distance = ((tried[:, None] - places) ** 2).sum(2).min(1)
        places = np.concatenate([places, tried[distance.argmax()][None]])
    return radius * places


DISC: Final = make_disc(12, 2.0)
"""Places in texels around a point."""


class SunMap(sl.Struct):
    """A map of a directional light.

    `axes` turns the world to the light's right, up and back. `place` is the middle of the map at depth 1, along these
    axes and relative to the eye, `length` its depth in metres. `middle` is that of the tile in texels of the atlas,
    `half` half its width; a texel is `texel` metres wide. Points are looked up within `inner` metres. Without casters
    `length` is 0. `light` is the row of the light, and `is_last` 1 in the last map of a light, whose shadows fade at
    its edge.
    """

    axes: sl.mat3
    place: sl.vec3
    texel: float
    middle: sl.vec2
    half: float
    inner: float
    length: float
    light: int
    is_last: int


class SunTable(sl.Struct):
    """The maps of directional lights, `count` of them, from the nearest of a light to its farthest, and their bias."""

    maps: sl.Array[SunMap] = sl.array(SunMap, MOST_CASCADES)
    bias: sl.vec3
    count: int


@sl.function
def turn(rotation: sl.vec4, v: sl.vec3) -> sl.vec3:
    """Return a vector turned by a quaternion."""
    return v + 2.0 * sl.cross(rotation.xyz, sl.cross(rotation.xyz, v) + rotation.w * v)


@sl.function
def cube_face(v: sl.vec3) -> int:
    """Return the face of a cube that a direction leads to: +x, -x, +y, -y, +z, -z."""
    size = sl.abs(v)
    if size.x >= size.y and size.x >= size.z:
        return 0 if v.x > 0.0 else 1
    if size.y >= size.z:
        return 2 if v.y > 0.0 else 3
    return 4 if v.z > 0.0 else 5


class LampTable(sl.Struct):
    """What all maps of lamps have in common. Spot lights are numbered after the `points` point lights."""

    bias: sl.vec3
    points: int


class ShadowReader(sl.Shader):
    """The base of filters: reads the atlas."""

    lean = True

    def find_lit_share(self, at: sl.vec2, depth: float, slope: sl.vec2, middle: sl.vec2, half: float) -> float:
        """Return the share of the texels around a point that are lit.

        Args:
            at: the place in texels of the atlas. depth: that of the point. slope: how much it changes with a texel.
            middle, half: the tile, whose edge is repeated outside of it.
        """
        return 1.0


class TexelReader(ShadowReader):
    """The base of filters that compare texel by texel, each with the depth of the point's plane there."""

    shadow_atlas: sl.Texture2D

    def is_lit(self, at: sl.vec2, texel: sl.vec2, depth: float, slope: sl.vec2, middle: sl.vec2, half: float) -> float:
        """Return 1 where the plane is lit at the middle of a texel, otherwise 0."""
        inside = sl.clamp(texel, middle - half, middle + (half - 1.0))
        plane = depth + sl.abs(sl.dot(slope, inside + 0.5 - at))
        return 1.0 if plane >= self.shadow_atlas.load(sl.ivec2(inside)).x else 0.0


class HardShadows(TexelReader):
    """Compares one texel."""

    def find_lit_share(self, at: sl.vec2, depth: float, slope: sl.vec2, middle: sl.vec2, half: float) -> float:
        return self.is_lit(at, sl.floor(at), depth, slope, middle, half)


class HardwareShadows(ShadowReader):
    """Compares 2 × 2 texels with one depth: that of the plane where it is nearest to the light among them."""

    shadow_compare: sl.DepthTexture2D

    def find_lit_share(self, at: sl.vec2, depth: float, slope: sl.vec2, middle: sl.vec2, half: float) -> float:
        inside = sl.clamp(at, middle - (half - 0.5), middle + (half - 0.5))
        share = sl.fract(inside - 0.5)
        nearest = sl.max(-slope * share, slope * (1.0 - share))
        reference = depth + sl.dot(slope, inside - at) + nearest.x + nearest.y
        return self.shadow_compare.sample_compare_lod(
            inside / sl.vec2(self.shadow_compare.size()), sl.clamp(reference, 0.0, 1.0), 0.0
        )


class SmoothShadows(TexelReader):
    """Compares the 4 × 4 texels that a square of 3 × 3 around the point overlaps, weighted by their areas in it."""

    def find_lit_share(self, at: sl.vec2, depth: float, slope: sl.vec2, middle: sl.vec2, half: float) -> float:
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
                lit += wide * high * self.is_lit(at, texel, depth, slope, middle, half)
        return lit / 9.0


class PoissonShadows(TexelReader):
    """Compares texels of a disc. The angle by which it is turned belongs to the place in the map: it doesn't swim."""

    def find_lit_share(self, at: sl.vec2, depth: float, slope: sl.vec2, middle: sl.vec2, half: float) -> float:
        cell = sl.floor(at * 8.0)
        angle = 6.2831853 * sl.fract(52.982918 * sl.fract(sl.dot(cell, sl.vec2(0.06711056, 0.00583715))))
        turn = sl.vec2(sl.cos(angle), sl.sin(angle))
        lit = 0.0
        for i in range(len(DISC)):
            tap = DISC[i]
            place = at + sl.vec2(turn.x * tap.x - turn.y * tap.y, turn.y * tap.x + turn.x * tap.y)
            lit += self.is_lit(at, sl.floor(place), depth, slope, middle, half)
        return lit / float(len(DISC))


class ShadowReceiver(ShadowReader):
    """The base of shaders that light surfaces: takes from light what casters block. `plane` is the normal that maps
    don't bend. Without shadows nothing blocks light; with any, a filter is combined with it.

    `lamp_slots` has for each lamp twice the number of its first map, and 1 more if its maps are the faces of a cube;
    `NO_MAPS` or `DARK` without maps. `lamp_maps` has two texels for each map: the rotation from the world to its right,
    up and back, as a quaternion, and its tile: its middle and half its width in texels, and the texels in a unit of the
    tangent. The width of a face without casters is 0.
    """

    has_sun_shadows = False
    has_point_shadows = False
    has_spot_shadows = False

    suns: sl.Uniform[SunTable]
    lamps: sl.Uniform[LampTable]
    lamp_slots: sl.IntTexture2D
    lamp_maps: sl.Texture2D
    point_lights: sl.Storage[PointLight]
    spot_lights: sl.Storage[SpotLight]

    def unblocked_point(self, light: sl.vec3, position: sl.vec3, plane: sl.vec3, row: int) -> sl.vec3:
        """Return what arrives of the light of a point light at a surface."""
        if not self.has_point_shadows:
            return light
        away = position - self.point_lights[row].position
        return self.past_casters(light, away, self.point_lights[row].range, plane, row)

    def unblocked_spot(self, light: sl.vec3, position: sl.vec3, plane: sl.vec3, row: int) -> sl.vec3:
        """Return what arrives of the light of a spot light at a surface."""
        if not self.has_spot_shadows:
            return light
        away = position - self.spot_lights[row].position
        return self.past_casters(light, away, self.spot_lights[row].range, plane, row + self.lamps.points)

    def unblocked_sun(self, light: sl.vec3, position: sl.vec3, plane: sl.vec3, row: int) -> sl.vec3:
        """Return what arrives of the light of a directional light at a surface."""
        if not self.has_sun_shadows:
            return light
        if light.x + light.y + light.z <= 0.0:
            return light
        # The first map that the position is in, if it has casters. What is read of it is read in the loop, where all
        # fragments read the same: a read at an index of each fragment's own takes a CPU twice as long.
        place = sl.vec3(0.0)
        facing = sl.vec3(0.0)
        tile = sl.vec4(0.0)
        deep = 0.0
        edge = 0.0
        for i in range(self.suns.count):
            if deep == 0.0 and self.suns.maps[i].light == row:
                there = self.suns.maps[i].axes @ position - self.suns.maps[i].place
                aside = sl.max(sl.abs(there.x), sl.abs(there.y)) / self.suns.maps[i].inner
                if aside < 1.0 and -there.z < self.suns.maps[i].length:
                    place = there
                    facing = self.suns.maps[i].axes @ plane
                    tile = sl.vec4(self.suns.maps[i].middle, self.suns.maps[i].half, self.suns.maps[i].texel)
                    deep = self.suns.maps[i].length
                    edge = aside * float(self.suns.maps[i].is_last)
        if deep == 0.0:
            return light
        sine = sl.sqrt(sl.max(1.0 - facing.z * facing.z, 0.0))
        place += facing * (tile.w * (self.suns.bias.x + self.suns.bias.y * sine))
        at = tile.xy + sl.vec2(place.x, -place.y) / tile.w
        slope = sl.vec2(-facing.x, facing.y) * (self.suns.bias.z * tile.w / (sl.max(facing.z, _STEEPEST) * deep))
        share = 0.0
        if facing.z > 0.0:
            share = self.find_lit_share(at, 1.0 + place.z / deep, slope, tile.xy, tile.z)
        return light * sl.mix(share, 1.0, sl.smoothstep(0.9, 1.0, edge))

    def lamp_map(self, texel: int) -> sl.vec4:
        """Return a texel of `lamp_maps`."""
        return self.lamp_maps.load(sl.ivec2(texel % TABLE_WIDTH, texel // TABLE_WIDTH))

    def past_casters(self, light: sl.vec3, away: sl.vec3, reach: float, normal: sl.vec3, number: int) -> sl.vec3:
        """Return what arrives of a lamp's light at a surface.

        Args:
            away: from the lamp to the surface. reach: the lamp's range. number: that of the lamp.
        """
        if light.x + light.y + light.z <= 0.0:
            return light
        slot = self.lamp_slots.load(sl.ivec2(number % TABLE_WIDTH, number // TABLE_WIDTH)).x
        if slot < 0:
            return light if slot == NO_MAPS else sl.vec3(0.0)
        first = 2 * (slot // 2)
        is_cube = slot % 2 == 1
        distance = sl.max(sl.length(away), 1e-20)
        facing = sl.dot(normal, away) / distance
        if facing >= 0.0:
            return sl.vec3(0.0)
        sine = sl.sqrt(sl.max(1.0 - facing * facing, 0.0))
        depth = sl.max(sl.max(sl.abs(away.x), sl.abs(away.y)), sl.abs(away.z))
        if not is_cube:
            depth = -turn(self.lamp_map(first), away).z
        texel = sl.max(depth, 0.0) / self.lamp_map(first + 1).w
        moved = away + normal * (texel * (self.lamps.bias.x + self.lamps.bias.y * sine))
        if is_cube:
            first += 2 * cube_face(moved)
        tile = self.lamp_map(first + 1)
        if tile.z <= 0.0:
            return light
        rotation = self.lamp_map(first)
        place = turn(rotation, moved)
        near = reach * NEAR
        nearness = 1.0 / sl.max(-place.z, near)
        at = tile.xy + sl.vec2(place.x, -place.y) * (nearness * tile.w)
        # On a plane n · p = d through the lamp's space, 1 / -z is linear in x / -z and y / -z: n.x / d and n.y / d.
        plane = sl.min(sl.dot(normal, moved), -_STEEPEST * distance)
        tilt = turn(rotation, normal)
        slope = sl.vec2(tilt.x, -tilt.y) * (self.lamps.bias.z * near / (plane * tile.w))
        share = self.find_lit_share(at, near * nearness, slope, tile.xy, tile.z)
        if tile.z <= _SMALL / 2.0:
            # An edge is drawn at most half a texel off, and filters reach 1.5: beyond it, 2/3 of them may be lit.
            share = sl.max(3.0 * share - 2.0, 0.0)
        return light * share


FILTERS: Final[dict[ShadowFilter, type[ShadowReader]]] = {
    ShadowFilter.HARD: HardShadows,
    ShadowFilter.HARDWARE: HardwareShadows,
    ShadowFilter.SMOOTH: SmoothShadows,
    ShadowFilter.POISSON: PoissonShadows,
}
"""The shader part of each filter."""
