"""A fourth kind of lights, for a test: tubes, which shine from the nearest point of a segment.

The test copies this file to `renderer/light_kinds` and adds a row to the table there; nothing else knows of
tubes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from renderer.light_kinds.arrays import LightArrays
from renderer.light_kinds.incidence import MIN_SQUARED_DISTANCE, Incidence, safe_normalize
from renderer.light_kinds.kind import LOCAL_FIELDS, LightKind, LocalLightKind
from renderer.light_kinds.volumes import FARTHEST_CORNER, LightVolume, VolumeCorner, VolumeVarying
from rhi.math import Floats
from rhi.shading import Struct, clamp, dot, function, instance_index, max, saturate, vec3

TUBE: Final = np.dtype([*LOCAL_FIELDS, ("direction", "<f4", 3), ("half_length", "<f4")])


class TubeLight(Struct):
    """A tube light: a segment of `half_length` to both sides of `position`, along the unit vector
    `direction`."""

    position: vec3
    range: float
    color: vec3
    intensity: float
    direction: vec3
    half_length: float


@function
def tube_incidence(position: vec3, light: TubeLight) -> Incidence:
    """The light of the nearest point of the segment, windowed by the distance to its middle."""
    to_middle = light.position - position
    along = clamp(-dot(to_middle, light.direction), -light.half_length, light.half_length)
    to_light = to_middle + light.direction * along
    fraction = dot(to_middle, to_middle) / max(light.range * light.range, MIN_SQUARED_DISTANCE)
    window = saturate(1.0 - fraction * fraction)
    falloff = window * window / max(dot(to_light, to_light), MIN_SQUARED_DISTANCE)
    return Incidence(direction=safe_normalize(to_light), irradiance=light.color * (light.intensity * falloff))


class TubeVolume(LightVolume):
    """The spheres that tube lights reach."""

    if TYPE_CHECKING:
        tube_lights: Any

    def vertex(self, v: VolumeCorner) -> VolumeVarying:
        light_index = self.volume_lights[instance_index()]
        light = self.tube_lights[light_index]
        offset = v.position * light.range
        reach = light.range * FARTHEST_CORNER
        return VolumeVarying(
            clip=self.project_volume(light.position, offset, reach, self.view, self.rays), light=light_index
        )


def bound(lights: NDArray[Any]) -> tuple[Floats, Floats]:
    """The spheres that tubes (k,) reach: centres (k, 3), radii (k,)."""
    return lights["position"], lights["range"].astype(np.float64)


KIND: Final = LocalLightKind(
    name="tube",
    noun="tube light",
    dtype=TUBE,
    element=TubeLight,
    incidence=tube_incidence,
    gltf=None,
    packed=np.dtype(
        [
            *[
                (name, "<f4", *shape)
                for name, *shape in (("position", 3), ("range",), ("color", 3), ("intensity",))
            ],
            ("direction", "<f4", 3),
            ("half_length", "<f4"),
        ]
    ),
    bounds=bound,
    volume=TubeVolume,
)


@dataclass(eq=False)
class TubeLights(LightArrays):
    """The tube lights of a scene, (k,) of `TUBE`."""

    kind: ClassVar[LightKind] = KIND
    tube: NDArray[Any] = field(default_factory=lambda: np.zeros(0, TUBE))

    def add_segment(
        self,
        position: ArrayLike,
        direction: Sequence[float],
        half_length: float,
        range: float,
        color: Sequence[float] = (1, 1, 1),
        intensity: float = 1.0,
        casts_shadow: bool = False,
    ) -> int:
        """Add a tube light; returns its index."""
        values = {"position": position, "direction": direction, "half_length": half_length, "range": range}
        return int(
            self._add("tube", "add_segment", 1, casts_shadow, **values, color=color, intensity=intensity)[0]
        )
