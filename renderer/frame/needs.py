"""What a frame needs: the effects that its scene has and its view shows.

A technique declares only the passes and shaders of these effects, so what a scene lacks costs nothing. Each effect
comes with the reason why it is needed or not.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.lights.in_view import find_lights_in_view
from renderer.scene import Camera, Scene
from renderer.scene.arrays import Rows

__rhi_internal__ = True


class Effect(Enum):
    """What a scene may call for."""

    DIRECTIONAL_LIGHTS = "directional lights"
    POINT_LIGHTS = "point lights"
    SPOT_LIGHTS = "spot lights"
    IMAGES = "images"
    EMISSION = "emission"
    HAZE = "haze"
    SUN_SHADOWS = "shadows of directional lights"


_NOUNS: Final = {
    Effect.DIRECTIONAL_LIGHTS: "directional light",
    Effect.POINT_LIGHTS: "point light",
    Effect.SPOT_LIGHTS: "spot light",
    Effect.IMAGES: "image",
    Effect.EMISSION: "material that emits light",
    Effect.SUN_SHADOWS: "directional light that casts shadows",
}


@dataclass(frozen=True, eq=False, slots=True)
class Needs:
    """What one frame needs.

    Attributes:
        effects: those that are needed. counts: of each effect, how many of its causes the scene has.
        point_rows, spot_rows: the rows of the lights whose light may reach something in view.
    """

    effects: frozenset[Effect]
    counts: dict[Effect, int]
    point_rows: Rows
    spot_rows: Rows

    @property
    def has_sun(self) -> bool:
        """Whether there is exactly one directional light."""
        return self.counts[Effect.DIRECTIONAL_LIGHTS] == 1

    @property
    def key(self) -> tuple[object, ...]:
        """What a technique's declaration depends on."""
        return self.effects, self.has_sun

    def explain(self, effect: Effect) -> str:
        """Return why the effect is needed or not, such as `3 of 13 point lights reach what is in view`."""
        count = self.counts[effect]
        if effect is Effect.HAZE:
            return "the scene has haze" if count else "the scene has no haze"
        noun = _NOUNS[effect]
        if not count:
            return f"the scene has no {noun}"
        plural = noun.replace("material that emits", "materials that emit") if "material" in noun else f"{noun}s"
        if effect is Effect.SUN_SHADOWS:
            plural = "directional lights that cast shadows"
        if effect in (Effect.POINT_LIGHTS, Effect.SPOT_LIGHTS):
            rows = self.point_rows if effect is Effect.POINT_LIGHTS else self.spot_rows
            if count == 1 and not len(rows):
                return f"the only {noun} doesn't reach what is in view"
            reach = "reaches" if len(rows) == 1 else "reach"
            return f"{len(rows) or 'none'} of {count} {plural if count > 1 else noun} {reach} what is in view"
        return f"the scene has {count} {plural if count > 1 else noun}"


def find_needs(scene: Scene, camera: Camera, *, reaches: tuple[bool, bool] = (True, True)) -> Needs:
    """Find what `scene` needs as `camera` sees it.

    Args:
        reaches: whether any point light reaches an object, and whether any spot light does.
    """
    lights = scene.lights
    planes = camera.frustum.planes if len(lights.point) or len(lights.spot) else np.zeros((0, 4))
    none = np.zeros(0, np.int64)
    point, spot = (
        find_lights_in_view(planes, some["position"], some["range"].astype(np.float64)) if reached else none
        for some, reached in zip((lights.point, lights.spot), reaches, strict=True)
    )
    counts = {
        Effect.DIRECTIONAL_LIGHTS: len(lights.directional),
        Effect.POINT_LIGHTS: len(lights.point),
        Effect.SPOT_LIGHTS: len(lights.spot),
        Effect.IMAGES: len(scene.images),
        Effect.EMISSION: int(np.count_nonzero(scene.materials["emission"])),
        Effect.HAZE: int(scene.haze > 0.0),
        Effect.SUN_SHADOWS: _count_casting(scene, lights.directional),
    }
    hidden = {
        effect for effect, rows in ((Effect.POINT_LIGHTS, point), (Effect.SPOT_LIGHTS, spot)) if not len(rows)
    }
    effects = frozenset(effect for effect, count in counts.items() if count and effect not in hidden)
    return Needs(effects, counts, point, spot)


def _count_casting(scene: Scene, lights: NDArray[Any]) -> int:
    """Return the number of lights that cast shadows: none if no object does."""
    count = int(np.count_nonzero(lights["casts_shadow"]))
    return count if count and scene.objects.casts_shadow.any() else 0
