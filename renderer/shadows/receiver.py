"""Receivers of shadows, in shaders: the share of a light that shadow maps leave to a surface.

A shader that lights surfaces derives from `ShadowReceiver` and passes each light to
`shadow_directional_light`, or for a local light to the `shadow_…_light` of its kind, such as
`shadow_point_light`. These return the light that arrives. Without shadows that is all of it; `has_…_shadows`
turns on those of a kind of light, and a filter class reads the maps. So a technique has shadows by one call
for each light, whichever maps there are. The table of the sun's maps is a uniform block, and those of local
lights, of which there may be thousands, are textures: forward shading needs the eight storage buffers that a
program may have.

**Bias.** A texel holds the depth of a surface at its middle, and is compared with a point elsewhere in it,
whose depth differs by tan θ times the distance. So a point isn't compared with its own depth, but with that
of its surface's plane at the middle of the texel, which follows from the normal. Where the plane is farther
away there, it is compared with a depth that is as much nearer: at the foot of a wall the floor is in front of
the wall's plane. What is left is rounding, and the difference between a normal and a facet: for these the
point is moved along its normal, by `bias.x` texels and `bias.y` times the sine of θ, in all by less than a
texel.

The normal is that of the surface in the map, which normal maps don't bend (`SurfacePoint.geometric_normal`).
Where they bend it towards a light behind the surface, the surface is in its own shadow.

Depth is reversed: 1 at the light, less farther away. A point is lit where it isn't farther than what is in
the map.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import rhi.shading as sl
from renderer.light_kinds.generation import define, for_each_kind
from renderer.light_kinds.table import LOCAL_LIGHT_KINDS
from renderer.shaders.structs import TABLE_WIDTH
from renderer.shadows.cascades import CASCADE_MARGIN
from renderer.shadows.filters import ShadowFilterShader
from renderer.shadows.local_light_maps import LOCAL_MARGIN, NEAR

MAX_CASCADES: Final = 8
"""The number of maps of all directional lights together."""

NO_SHADOW: Final = -1
NO_ATLAS_ROOM: Final = -2
"""The slots of local lights without maps: those that nothing blocks, and those for whose maps there is no
room. The latter light nothing, so that no wall is lit through."""

_SMALL: Final = 64
"""The width in texels of a local light's map up to which shadows err towards dark."""

_MIN_COSINE: Final = 0.005
"""The cosine of the steepest slope that a plane is followed to: 89.7°."""

_NORMAL_OFFSET: Final = (0.1, 0.6)
"""Texels by which a point is moved along its normal: at any angle, and times the sine of the angle."""


def scale_bias(bias: float) -> tuple[float, float, float]:
    """Return the bias of the tables of maps, for the setting `bias`: 0 is none, 1 the default."""
    return bias * _NORMAL_OFFSET[0], bias * _NORMAL_OFFSET[1], bias


class CascadeMap(sl.Struct):
    """A map of a directional light.

    `axes` turns the world to the light's right, up and back. `middle` is that of the map at depth 1, along
    these axes and relative to the eye, `length` its depth in metres. `center` is that of the tile in texels
    of the atlas, `half` half its width; a texel is `texel` metres wide. Points are looked up within `inner`
    metres. Without casters `length` is 0. `light` is the row of the light, and `is_last` 1 in the last map of
    a light, whose shadows fade at its edge. `source` is the tangent of half the angle that the light's source
    fills.
    """

    axes: sl.mat3
    middle: sl.vec3
    texel: float
    center: sl.vec2
    half: float
    inner: float
    length: float
    light: int
    is_last: int
    source: float


class CascadeTable(sl.Struct):
    """The maps of directional lights, `count` of them, from the nearest of a light to its farthest, and their
    bias."""

    maps: sl.Array[CascadeMap] = sl.array(CascadeMap, MAX_CASCADES)
    bias: sl.vec3
    count: int


@sl.function
def rotate(rotation: sl.vec4, v: sl.vec3) -> sl.vec3:
    """Return the vector `v` rotated by a quaternion (x, y, z, w)."""
    return v + 2.0 * sl.cross(rotation.xyz, sl.cross(rotation.xyz, v) + rotation.w * v)


@sl.function
def cube_face(v: sl.vec3) -> int:
    """Return the index of the cube face that a direction points to: +x, -x, +y, -y, +z, -z."""
    size = sl.abs(v)
    if size.x >= size.y and size.x >= size.z:
        return 0 if v.x > 0.0 else 1
    if size.y >= size.z:
        return 2 if v.y > 0.0 else 3
    return 4 if v.z > 0.0 else 5


class ShadowBias(sl.Struct):
    """The bias of the maps of local lights."""

    bias: sl.vec3


class LocalShadowTable(ShadowBias):
    """The constants of all maps of local lights: their bias, and the first slot of each kind of light but the
    first."""

    __annotations__ = dict.fromkeys([f"{kind.name}_slots" for kind in LOCAL_LIGHT_KINDS[1:]], int)


class ShadowMapReader(ShadowFilterShader):
    """The base of shaders that light surfaces: multiplies light by the share that casters let through. The
    geometric normal is the one that normal maps don't bend. Without shadows light passes unchanged; with
    shadows, a filter class is combined with this one.

    `shadow_slots` has for each local light twice the number of its first map, and 1 more if its maps are the
    faces of a cube; `NO_SHADOW` or `NO_ATLAS_ROOM` without maps. `local_shadow_maps` has two texels for each
    map: the rotation from the world to its right, up and back, as a quaternion, and its tile: its middle and
    half its width in texels, and the texels in a unit of the tangent. The width of a face without casters is
    0. `shadow_sources` has the radius in metres of each local light's source, if any of them has one.
    """

    has_directional_shadows = False
    has_directional_penumbras = False
    has_local_penumbras = False

    cascade_table: sl.Uniform[CascadeTable]
    local_shadow_table: sl.Uniform[LocalShadowTable]
    shadow_slots: sl.IntTexture2D
    local_shadow_maps: sl.Texture2D
    shadow_sources: sl.Texture2D

    def shadow_directional_light(
        self, light: sl.vec3, position: sl.vec3, geometric_normal: sl.vec3, light_index: int
    ) -> sl.vec3:
        """Return `light` times the share of it that reaches a surface, of a directional light."""
        if not self.has_directional_shadows:
            return light
        if light.x + light.y + light.z <= 0.0:
            return light
        # The first map that the position is in, if it has casters. What is read of it is read in the loop,
        # where all fragments read the same: a read at an index of each fragment's own takes a CPU twice as
        # long.
        point = sl.vec3(0.0)
        facing = sl.vec3(0.0)
        tile = sl.vec4(0.0)
        deep = 0.0
        edge = 0.0
        source = 0.0
        for i in range(self.cascade_table.count):
            if deep == 0.0 and self.cascade_table.maps[i].light == light_index:
                there = self.cascade_table.maps[i].axes @ position - self.cascade_table.maps[i].middle
                aside = sl.max(sl.abs(there.x), sl.abs(there.y)) / self.cascade_table.maps[i].inner
                if aside < 1.0 and there.z <= 0.0 and -there.z < self.cascade_table.maps[i].length:
                    point = there
                    facing = self.cascade_table.maps[i].axes @ geometric_normal
                    tile = sl.vec4(
                        self.cascade_table.maps[i].center,
                        self.cascade_table.maps[i].half,
                        self.cascade_table.maps[i].texel,
                    )
                    deep = self.cascade_table.maps[i].length
                    if self.has_directional_penumbras:
                        source = self.cascade_table.maps[i].source
                    edge = aside * float(self.cascade_table.maps[i].is_last)
        if deep == 0.0:
            return light
        sine = sl.sqrt(sl.max(1.0 - facing.z * facing.z, 0.0))
        point += facing * (tile.w * (self.cascade_table.bias.x + self.cascade_table.bias.y * sine))
        at = tile.xy + sl.vec2(point.x, -point.y) / tile.w
        slope = sl.vec2(-facing.x, facing.y) * (
            self.cascade_table.bias.z * tile.w / (sl.max(facing.z, _MIN_COSINE) * deep)
        )
        share = 0.0
        depth = 1.0 + point.z / deep
        if facing.z > 0.0:
            if self.has_directional_penumbras and source > 0.0:
                share = self.soft_lit_fraction(
                    at,
                    depth,
                    slope,
                    tile.xy,
                    tile.z,
                    source * deep / tile.w,
                    sl.vec2(0.0),
                    2.0 * CASCADE_MARGIN * tile.z,
                ).x
            else:
                share = self.lit_fraction(at, depth, slope, tile.xy, tile.z)
        return light * sl.mix(share, 1.0, sl.smoothstep(0.9, 1.0, edge))

    def shadow_map_texel(self, texel: int) -> sl.vec4:
        """Return a texel of `local_shadow_maps`."""
        return self.local_shadow_maps.load(sl.ivec2(texel % TABLE_WIDTH, texel // TABLE_WIDTH))

    def shadow_local_light(
        self, light: sl.vec3, away: sl.vec3, reach: float, normal: sl.vec3, slot_index: int
    ) -> sl.vec3:
        """Return `light` times the share of it that reaches a surface, of a local light.

        Args:
            away: from the light to the surface.
            reach: the light's range.
            slot_index: the light's index in `shadow_slots`.
        """
        if light.x + light.y + light.z <= 0.0:
            return light
        slot = self.shadow_slots.load(sl.ivec2(slot_index % TABLE_WIDTH, slot_index // TABLE_WIDTH)).x
        if slot < 0:
            return light if slot == NO_SHADOW else sl.vec3(0.0)
        first = 2 * (slot // 2)
        is_cube = slot % 2 == 1
        distance = sl.max(sl.length(away), 1e-20)
        facing = sl.dot(normal, away) / distance
        if facing >= 0.0:
            return sl.vec3(0.0)
        sine = sl.sqrt(sl.max(1.0 - facing * facing, 0.0))
        depth = sl.max(sl.max(sl.abs(away.x), sl.abs(away.y)), sl.abs(away.z))
        if not is_cube:
            depth = -rotate(self.shadow_map_texel(first), away).z
        texel = sl.max(depth, 0.0) / self.shadow_map_texel(first + 1).w
        moved = away + normal * (
            texel * (self.local_shadow_table.bias.x + self.local_shadow_table.bias.y * sine)
        )
        if is_cube:
            first += 2 * cube_face(moved)
        tile = self.shadow_map_texel(first + 1)
        if tile.z <= 0.0:
            return light
        rotation = self.shadow_map_texel(first)
        point = rotate(rotation, moved)
        near = reach * NEAR
        nearness = 1.0 / sl.max(-point.z, near)
        at = tile.xy + sl.vec2(point.x, -point.y) * (nearness * tile.w)
        # On a plane n · p = d through the light's space, 1 / -z is linear in x / -z and y / -z: n.x / d and
        # n.y / d.
        plane = sl.min(sl.dot(normal, moved), -_MIN_COSINE * distance)
        tilt = rotate(rotation, normal)
        slope = sl.vec2(tilt.x, -tilt.y) * (self.local_shadow_table.bias.z * near / (plane * tile.w))
        source = 0.0
        if self.has_local_penumbras:
            source = self.shadow_sources.load(sl.ivec2(slot_index % TABLE_WIDTH, slot_index // TABLE_WIDTH)).x
        if self.has_local_penumbras and source > 0.0:
            # A sphere beside the axis is an ellipse in the map, longer by 1 / cos of the angle away from it.
            tangent = (at - tile.xy) / tile.w
            soft = self.soft_lit_fraction(
                at,
                near * nearness,
                slope,
                tile.xy,
                tile.z,
                source * tile.w / near,
                tangent / sl.sqrt(sl.sqrt(1.0 + sl.dot(tangent, tangent)) + 1.0),
                2.0 * LOCAL_MARGIN * tile.z,
            )
            share = soft.x
            if tile.z <= _SMALL / 2.0:
                # As below, of filters that reach farther.
                share = sl.max((soft.y * share - 1.0) / (soft.y - 1.0), 0.0)
        else:
            share = self.lit_fraction(at, near * nearness, slope, tile.xy, tile.z)
            if tile.z <= _SMALL / 2.0:
                # An edge is drawn at most half a texel off, and filters reach 1.5: beyond it, 2/3 of them may
                # be lit.
                share = sl.max(3.0 * share - 2.0, 0.0)
        return light * share


if TYPE_CHECKING:

    class ShadowReceiver(ShadowMapReader):
        """The base of shaders that light surfaces by lights that may cast shadows."""

else:
    ShadowReceiver = define(
        "class ShadowReceiver(ShadowMapReader):\n"
        + for_each_kind("    has_${kind}_shadows = False\n    ${kind}_lights: sl.Storage[$Element]\n")
        + for_each_kind(
            """
    def shadow_${kind}_light(
        self, light: sl.vec3, position: sl.vec3, geometric_normal: sl.vec3, light_index: int
    ) -> sl.vec3:
        if not self.has_${kind}_shadows:
            return light
        away = position - self.${kind}_lights[light_index].position
        return self.shadow_local_light(
            light, away, self.${kind}_lights[light_index].range, geometric_normal, light_index$first_slot
        )
""",
            first_slot=lambda index, kind: f" + self.local_shadow_table.{kind.name}_slots" if index else "",
        ),
        "ShadowReceiver",
        __name__,
        ShadowMapReader=ShadowMapReader,
        sl=sl,
    )
