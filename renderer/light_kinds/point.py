"""Point lights: light from a point, or from a sphere around it, in all directions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from renderer.light_kinds.arrays import LightArrays, count_positions
from renderer.light_kinds.incidence import Incidence, attenuation, safe_normalize
from renderer.light_kinds.kind import LOCAL_FIELDS, GltfMapping, LightKind, LocalLightKind
from renderer.light_kinds.volumes import FARTHEST_CORNER, LightVolume, VolumeCorner, VolumeVarying
from rhi.math import Floats
from rhi.shading import Struct, dot, function, instance_index, vec3

POINT: Final = np.dtype([*LOCAL_FIELDS])

RELATIVE_POINT: Final = np.dtype(
    [("position", "<f4", 3), ("range", "<f4"), ("color", "<f4", 3), ("intensity", "<f4")]
)
"""32 bytes, std430 without padding; positions relative to the eye."""


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
    ) -> int:
        """Add a point light, `position`, `range` and `source_radius` <= range in metres; returns its
        index."""
        values = {"position": position, "range": range, "color": color, "intensity": intensity}
        return int(self._add("point", "add_point", 1, casts_shadow, **values, source_radius=source_radius)[0])

    def add_points(
        self,
        position: ArrayLike,
        range: ArrayLike,
        color: ArrayLike = (1, 1, 1),
        intensity: ArrayLike = 1.0,
        casts_shadow: bool = False,
        source_radius: ArrayLike = 0.0,
    ) -> NDArray[np.int64]:
        """Add point lights at positions (k, 3); returns their indices (k,).

        `range`, `intensity` and `source_radius` are (k,) or one for all, `color` is (k, 3) or one for all.
        """
        values = {"position": position, "range": range, "color": color, "intensity": intensity}
        count = count_positions("add_points", position)
        return self._add("point", "add_points", count, casts_shadow, **values, source_radius=source_radius)
