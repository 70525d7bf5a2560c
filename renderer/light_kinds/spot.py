"""Spot lights: light from a point, or from a sphere around it, within a cone whose edge is soft."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

import rhi.shading as sl
from renderer.light_kinds.arrays import LightArrays, count_positions
from renderer.light_kinds.incidence import Incidence, attenuation, safe_normalize, versine
from renderer.light_kinds.kind import LOCAL_FIELDS, GltfMapping, LightKind, LocalLightKind
from renderer.light_kinds.volumes import FARTHEST_CORNER, LightVolume, VolumeCorner, VolumeVarying
from rhi.math import Floats
from rhi.shading import dot, function, max, saturate, vec3

MAX_SPOT_HALF_ANGLE: Final = np.pi / 3
"""The largest outer half angle of a spot light that has a single shadow map."""

MAX_CONE_HALF_ANGLE: Final = np.pi / 3
"""The largest outer half angle for which a cone is drawn: about there, a sphere is as small."""

SPOT: Final = np.dtype(
    [
        *LOCAL_FIELDS,
        ("direction", "<f4", 3),
        ("inner", "<f4"),  # half angles in radians, inner <= outer
        ("outer", "<f4"),
    ]
)

RELATIVE_SPOT: Final = np.dtype(
    [
        ("position", "<f4", 3),
        ("range", "<f4"),
        ("color", "<f4", 3),
        ("intensity", "<f4"),
        ("direction", "<f4", 3),
        ("inner_versine", "<f4"),
        ("outer_versine", "<f4"),
        ("pad", "<f4", 3),
    ]
)
"""64 bytes, std430; positions relative to the eye. A versine is 1 - cos of a half angle."""

_MIN_EDGE: Final = 1e-14
"""The least difference of versines between the edges of a cone: the quotient by it is finite."""

_ALL_DIRECTIONS: Final = 3.0
"""A versine above that of each angle."""


class SpotLight(sl.Struct):
    """A spot light, laid out as `RELATIVE_SPOT`."""

    position: vec3
    range: float
    color: vec3
    intensity: float
    direction: vec3
    inner_versine: float
    outer_versine: float


@function
def spot_incidence(position: vec3, light: SpotLight) -> Incidence:
    """The light of a spot light that arrives at a position: full inside the inner angle, squared between, and
    outside the outer angle 0, from no direction."""
    to_light = light.position - position
    distance_squared = dot(to_light, to_light)
    direction = safe_normalize(to_light)
    inside = light.outer_versine - versine(-direction, light.direction)
    if inside <= 0.0:
        return Incidence(direction=vec3(0.0), irradiance=vec3(0.0))
    cone = saturate(inside / max(light.outer_versine - light.inner_versine, _MIN_EDGE))
    irradiance = light.color * (light.intensity * cone * cone * attenuation(distance_squared, light.range))
    return Incidence(direction=direction, irradiance=irradiance)


class SpotVolume(LightVolume):
    """The cones of narrow spot lights, or the spheres of wide ones."""

    if TYPE_CHECKING:
        spot_lights: Any

    def vertex(self, v: VolumeCorner) -> VolumeVarying:
        light_index = self.volume_lights[sl.instance_index()]
        light = self.spot_lights[light_index]
        # A float32 is too coarse for the cosine of a small angle; light reaches up to two steps of it beyond
        # the cone.
        cosine = sl.max(1.0 - light.outer_versine - 1e-6, 1e-3)
        slope = sl.sqrt(sl.max(1.0 - cosine * cosine, 0.0)) / cosine
        extent = self.volume_range(light.position, light.range)
        width = extent * (slope if v.cone > 0.0 else 1.0)
        up = sl.vec3(0.0, 1.0, 0.0) if sl.abs(light.direction.y) < 0.9 else sl.vec3(1.0, 0.0, 0.0)
        aside = sl.normalize(sl.cross(up, light.direction))
        across = sl.cross(light.direction, aside)
        offset = (aside * v.position.x + across * v.position.y) * width
        offset += light.direction * (v.position.z * extent)
        reach = sl.max(extent, width) * FARTHEST_CORNER
        return VolumeVarying(
            clip=self.project_volume(light.position, offset, reach, self.view, self.rays), light=light_index
        )


def pack(packed: NDArray[Any], lights: NDArray[Any]) -> None:
    """Set the versines of the half angles."""
    packed["outer_versine"] = cone_versine(lights)
    packed["inner_versine"] = np.where(_is_everywhere(lights), _ALL_DIRECTIONS, _versine(lights["inner"]))


def cone_versine(lights: NDArray[Any]) -> Floats:
    """1 - cos (k,) of the half angles of spot lights' cones; more than that of each direction if all of them
    are inside the inner angle."""
    return np.where(_is_everywhere(lights), _ALL_DIRECTIONS, _versine(lights["outer"]))


def _versine(angles: Any) -> Floats:
    """1 - cos of angles (k,) in radians, with all digits of small ones."""
    sine = np.sin(0.5 * np.asarray(angles, np.float64))
    return np.asarray(2.0 * sine * sine)


def _is_everywhere(lights: NDArray[Any]) -> NDArray[np.bool_]:
    """True if spot lights (k,) light all directions in full."""
    return np.asarray(lights["inner"] >= np.float32(np.pi))


def bound_cones(
    positions: Floats, directions: Floats, ranges: Floats, outer: Floats
) -> tuple[Floats, Floats]:
    """The smallest spheres, centres (k, 3) and radii (k,), around the light of spot lights: sectors of balls.

    Args:
        outer: (k,) half angles in radians.
    """
    cosine, sine = np.cos(outer), np.sin(outer)
    narrow = outer <= 0.25 * np.pi
    wide = ~narrow & (outer < 0.5 * np.pi)
    around = 0.5 * ranges / np.maximum(cosine, 0.5)  # through the apex and the rim
    radii = np.where(narrow, around, np.where(wide, ranges * sine, ranges))
    along = np.where(narrow, around, np.where(wide, ranges * cosine, 0.0))
    return positions + directions * along[:, None], radii


def bound(lights: NDArray[Any]) -> tuple[Floats, Floats]:
    """The smallest spheres around the light of spot lights (k,): centres (k, 3), radii (k,)."""
    ranges, outer = lights["range"].astype(np.float64), lights["outer"].astype(np.float64)
    return bound_cones(lights["position"], lights["direction"].astype(np.float64), ranges, outer)


def make_cones(lights: NDArray[Any]) -> dict[str, NDArray[Any]]:
    """The cones (k,) of spot lights in the world."""
    return {
        "apex": lights["position"],
        "range": lights["range"].astype(np.float64),
        "axis": lights["direction"].astype(np.float64),
        "cosine": _round_down(np.cos(lights["outer"].astype(np.float64))),
    }


def _round_down(cosines: Floats) -> NDArray[np.float32]:
    """Cosines (k,) in float32 that aren't above the exact ones: no cone is narrower than its light."""
    return np.nextafter(cosines.astype(np.float32), np.float32(-2.0))


def half_angles(lights: NDArray[Any]) -> NDArray[Any]:
    """The outer half angles (k,) of spot lights that are narrow enough for a single shadow map; NaN for
    others."""
    outer: NDArray[Any] = lights["outer"]
    return np.where(outer > MAX_SPOT_HALF_ANGLE, np.float32(np.nan), outer)


def read_gltf(fields: Any) -> dict[str, float]:
    """The half angles of a JSON object `spot`."""
    spot = fields.child("spot")
    outer = spot.real("outerConeAngle", np.pi / 4.0, 0.0, np.pi)
    return {"outer": outer, "inner": spot.real("innerConeAngle", 0.0, 0.0, outer)}


def write_gltf(light: Any) -> dict[str, Any]:
    """The JSON object `spot` of a light."""
    return {"spot": {"innerConeAngle": float(light["inner"]), "outerConeAngle": float(light["outer"])}}


KIND: Final = LocalLightKind(
    name="spot",
    noun="spot light",
    dtype=SPOT,
    element=SpotLight,
    incidence=spot_incidence,
    gltf=GltfMapping(
        "spot",
        read_gltf,
        write_gltf,
        is_allowed=lambda light: not (light["outer"] > np.pi / 2.0 or light["inner"] == light["outer"]),
        omission="cones of spot lights that glTF doesn't allow",
    ),
    packed=RELATIVE_SPOT,
    pack=pack,
    bounds=bound,
    cones=make_cones,
    cone_versine=cone_versine,
    volume=SpotVolume,
    fits_cone=lambda lights: lights["outer"] <= MAX_CONE_HALF_ANGLE,
    half_angle=half_angles,
)


@dataclass(eq=False)
class SpotLights(LightArrays):
    """The spot lights of a scene, (k,) of `SPOT`."""

    kind: ClassVar[LightKind] = KIND
    spot: NDArray[Any] = field(default_factory=lambda: np.zeros(0, SPOT))

    def add_spot(
        self,
        position: ArrayLike,
        direction: Sequence[float],
        range: float,
        inner: float,
        outer: float,
        color: Sequence[float] = (1, 1, 1),
        intensity: float = 1.0,
        casts_shadow: bool = False,
        source_radius: float = 0.0,
    ) -> int:
        """Add a spot light with half angles 0 <= inner <= outer <= pi radians; returns its index."""
        values = {"position": position, "range": range, "color": color, "intensity": intensity}
        values |= {"direction": direction, "inner": inner, "outer": outer, "source_radius": source_radius}
        return int(self._add("spot", "add_spot", 1, casts_shadow, **values)[0])

    def add_spots(
        self,
        position: ArrayLike,
        direction: ArrayLike,
        range: ArrayLike,
        inner: ArrayLike,
        outer: ArrayLike,
        color: ArrayLike = (1, 1, 1),
        intensity: ArrayLike = 1.0,
        casts_shadow: bool = False,
        source_radius: ArrayLike = 0.0,
    ) -> NDArray[np.int64]:
        """Add spot lights at positions (k, 3); returns their indices (k,).

        `direction` and `color` are (k, 3) or one for all, all else is (k,) or one for all.
        """
        values = {"position": position, "range": range, "color": color, "intensity": intensity}
        values |= {"direction": direction, "inner": inner, "outer": outer, "source_radius": source_radius}
        return self._add("spot", "add_spots", count_positions("add_spots", position), casts_shadow, **values)
