"""Directional lights: light from infinitely far away, such as the sun's, equal everywhere. Its source is a point,
or a disc of `angular_diameter` radians."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from renderer.light_kinds.arrays import LightArrays
from renderer.light_kinds.incidence import Incidence
from renderer.light_kinds.kind import GltfMapping, LightKind
from rhi.shading import Struct, function, uint, vec3

PACKED_DIRECTIONAL: Final = np.dtype(
    [("direction", "<f4", 3), ("intensity", "<f4"), ("color", "<f4", 3), ("casts_shadow", "<u4")]
)
"""32 bytes, std430 without padding."""

DIRECTIONAL: Final = np.dtype([*PACKED_DIRECTIONAL.descr, ("angular_diameter", "<f4")])
"""`direction` is the unit vector along which the light travels, `casts_shadow` is 0 or 1, and `angular_diameter`
the angle in radians that the source fills."""


class DirectionalLight(Struct):
    """A directional light, laid out as `PACKED_DIRECTIONAL`; it travels along the unit vector `direction`.
    `casts_shadow` is 0 or 1."""

    direction: vec3
    intensity: float
    color: vec3
    casts_shadow: uint


@function
def directional_incidence(light: DirectionalLight) -> Incidence:
    """The light of a directional light that arrives anywhere."""
    return Incidence(direction=-light.direction, irradiance=light.color * light.intensity)


def pack_directional(lights: NDArray[Any]) -> NDArray[Any]:
    """Directional lights (k,) as shaders read them."""
    packed = np.zeros(len(lights), PACKED_DIRECTIONAL)
    for name in PACKED_DIRECTIONAL.names or ():
        packed[name] = lights[name]
    return packed


KIND: Final = LightKind(
    name="directional",
    noun="directional light",
    dtype=DIRECTIONAL,
    element=DirectionalLight,
    incidence=directional_incidence,
    gltf=GltfMapping("directional"),
)


@dataclass(eq=False)
class DirectionalLights(LightArrays):
    """The directional lights of a scene, (k,) of `DIRECTIONAL`."""

    kind: ClassVar[LightKind] = KIND
    directional: NDArray[Any] = field(default_factory=lambda: np.zeros(0, DIRECTIONAL))

    def add_directional(
        self,
        direction: Sequence[float],
        color: Sequence[float] = (1, 1, 1),
        intensity: float = 1.0,
        casts_shadow: bool = False,
        angular_diameter: float = 0.0,
    ) -> int:
        """Add light that travels along `direction`, from a source that fills an angle of at most π/2 radians;
        returns its index."""
        values: dict[str, ArrayLike] = {"direction": direction, "color": color, "intensity": intensity}
        values["angular_diameter"] = angular_diameter
        return int(self._add("directional", "add_directional", 1, casts_shadow, **values)[0])
