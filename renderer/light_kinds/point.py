"""Point lights: light from a point in all directions, or from a sphere, a rectangle or a tube around it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from renderer.light_kinds.arrays import LightArrays, check_direction, check_side, count_positions
from renderer.light_kinds.incidence import Incidence, attenuation, safe_normalize
from renderer.light_kinds.kind import LOCAL_FIELDS, GltfMapping, LightKind, LocalLightKind
from renderer.light_kinds.shapes import SHAPE_FIELDS, aim_rectangle
from renderer.light_kinds.volumes import FARTHEST_CORNER, LightVolume, VolumeCorner, VolumeVarying
from rhi.math import Floats
from rhi.shading import Struct, dot, function, instance_index, vec3

POINT: Final = np.dtype([*LOCAL_FIELDS, *SHAPE_FIELDS])

RELATIVE_POINT: Final = np.dtype(
    [("position", "<f4", 3), ("range", "<f4"), ("color", "<f4", 3), ("intensity", "<f4")]
)
"""32 bytes, std430 without padding; positions relative to the eye."""

_SHORTEST: Final = 1e-9
"""The least half side of rectangles and tubes over the range: a height of 0 would stand for a tube, a length of 0 for a
point."""


class PointLight(Struct):
    """A point light, laid out as `RELATIVE_POINT`."""

    position: vec3
    range: float
    color: vec3
    intensity: float


@function
def point_incidence(position: vec3, light: PointLight) -> Incidence:
    """The light of a point light that arrives at a position; 0 beyond its range."""
    to_light = light.position - position
    distance_squared = dot(to_light, to_light)
    return Incidence(
        direction=safe_normalize(to_light),
        irradiance=light.color * (light.intensity * attenuation(distance_squared, light.range)),
    )


class PointVolume(LightVolume):
    """The spheres of point lights."""

    if TYPE_CHECKING:
        point_lights: Any

    def vertex(self, v: VolumeCorner) -> VolumeVarying:
        light_index = self.volume_lights[instance_index()]
        light = self.point_lights[light_index]
        extent = self.volume_range(light.position, light.range)
        offset = v.position * extent
        reach = extent * FARTHEST_CORNER
        return VolumeVarying(
            clip=self.project_volume(light.position, offset, reach, self.view, self.rays), light=light_index
        )


def bound(lights: NDArray[Any]) -> tuple[Floats, Floats]:
    """The spheres within which point lights (k,) may light something: centres (k, 3), radii (k,)."""
    return lights["position"], lights["range"].astype(np.float64)


KIND: Final = LocalLightKind(
    name="point",
    noun="point light",
    dtype=POINT,
    element=PointLight,
    incidence=point_incidence,
    gltf=GltfMapping("point"),
    packed=RELATIVE_POINT,
    bounds=bound,
    volume=PointVolume,
)


@dataclass(eq=False)
class PointLights(LightArrays):
    """The point lights of a scene, (k,) of `POINT`."""

    kind: ClassVar[LightKind] = KIND
    point: NDArray[Any] = field(default_factory=lambda: np.zeros(0, POINT))

    def add_point(
        self,
        position: ArrayLike,
        range: float,
        color: Sequence[float] = (1, 1, 1),
        intensity: float = 1.0,
        casts_shadow: bool = False,
        source_radius: float = 0.0,
        source_right: ArrayLike = (0.0, 0.0, 0.0),
        source_up: ArrayLike = (0.0, 0.0, 0.0),
    ) -> int:
        """Add a point light, `position`, `range` and `source_radius` <= range in metres; returns its
        index. `source_right` and `source_up` are half the sides of a rectangle, or half the axis of a tube and 0."""
        values = {"position": position, "range": range, "color": color, "intensity": intensity}
        values |= {"source_radius": source_radius, "source_right": source_right, "source_up": source_up}
        return int(self._add("point", "add_point", 1, casts_shadow, **values)[0])

    def add_points(
        self,
        position: ArrayLike,
        range: ArrayLike,
        color: ArrayLike = (1, 1, 1),
        intensity: ArrayLike = 1.0,
        casts_shadow: bool = False,
        source_radius: ArrayLike = 0.0,
        source_right: ArrayLike = (0.0, 0.0, 0.0),
        source_up: ArrayLike = (0.0, 0.0, 0.0),
    ) -> NDArray[np.int64]:
        """Add point lights at positions (k, 3); returns their indices (k,).

        `range`, `intensity` and `source_radius` are (k,) or one for all, `color` and the sides of sources are (k, 3)
        or one for all.
        """
        values = {"position": position, "range": range, "color": color, "intensity": intensity}
        values |= {"source_radius": source_radius, "source_right": source_right, "source_up": source_up}
        count = count_positions("add_points", position)
        return self._add("point", "add_points", count, casts_shadow, **values)

    def add_rectangle(
        self,
        position: ArrayLike,
        direction: Sequence[float],
        range: float,
        width: float,
        height: float,
        color: Sequence[float] = (1, 1, 1),
        intensity: float = 1.0,
        casts_shadow: bool = False,
        source_radius: float = 0.0,
        up: Sequence[float] = (0, 1, 0),
    ) -> int:
        """Add a rectangle that shines to the side of `direction`; returns its index in `point`.

        Its light is `intensity` / d² in front of it, far away, and falls to the sides with the cosine. Shadows are
        those of its middle, or of a sphere of `source_radius` there.

        Args:
            position: the middle. The light ends at `range` from it, which is at least half the diagonal.
            width, height: the sides, in metres.
            up: the height is along this, as nearly as it can be.
        """
        call = "add_rectangle"
        shortest = _SHORTEST * check_side(call, "range", range)
        half_width = max(0.5 * check_side(call, "width", width), shortest)
        half_height = max(0.5 * check_side(call, "height", height), shortest)
        right, above = aim_rectangle(
            check_direction(call, "direction", direction), check_direction(call, "up", up)
        )
        values: dict[str, ArrayLike] = {"position": position, "range": range, "color": color}
        values |= {"intensity": intensity, "source_radius": source_radius}
        values |= {"source_right": right * half_width, "source_up": above * half_height}
        return int(self._add("point", call, 1, casts_shadow, **values)[0])

    def add_tube(
        self,
        position: ArrayLike,
        direction: Sequence[float],
        range: float,
        length: float,
        radius: float = 0.0,
        color: Sequence[float] = (1, 1, 1),
        intensity: float = 1.0,
        casts_shadow: bool = False,
    ) -> int:
        """Add a tube, a cylinder along `direction` that shines from its side; returns its index in `point`.

        Its light is `intensity` / d² beside it, far away, and falls to its ends with the sine. Shadows are those of
        its middle.

        Args:
            position: the middle. The light ends at `range` from it, which reaches at least the ends.
            length, radius: of the cylinder, in metres.
        """
        call = "add_tube"
        axis = check_direction(call, "direction", direction)
        half = max(0.5 * check_side(call, "length", length), _SHORTEST * check_side(call, "range", range))
        values: dict[str, ArrayLike] = {"position": position, "range": range, "color": color}
        values |= {"intensity": intensity, "source_radius": radius, "source_right": axis * half}
        return int(self._add("point", call, 1, casts_shadow, **values)[0])
