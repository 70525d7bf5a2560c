"""The volumes of a scene's point and spot lights as the device tests them: in eye space, from positions in float64."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.lights.culling.cone_tests import Cone, bounding_sphere
from renderer.scene import Camera, Lights
from renderer.scene.arrays import Floats
from rhi.shading import evaluate

WORD: Final = 32
"""Number of lights whose results are the bits of a word."""


@dataclass(frozen=True, eq=False, slots=True)
class LightVolumes:
    """The volumes of all lights that have an end.

    Attributes:
        spheres: (32 w, 4) float64, centres and radii: of the point lights, then from a multiple of 32 on those around
            the cones of the spot lights. Rows between them have a radius of -1.
        cones: (s,) of `Cone`, of the spot lights.
        point_words: the number of words before the spot lights'.
        reach: the farthest depth that a light reaches; -inf without lights.
    """

    spheres: Floats
    cones: NDArray[Any]
    point_words: int
    reach: float

    @property
    def words(self) -> int:
        """The number of words with a bit for each light."""
        return len(self.spheres) // WORD


def find_volumes(lights: Lights, camera: Camera) -> LightVolumes:
    """Return the volumes of all point and spot lights, seen from a camera."""
    axes = camera.rotation * np.array([[1.0], [1.0], [-1.0]])  # right, up, ahead

    def to_eye(positions: Floats) -> Floats:
        return np.asarray((positions - camera.position) @ axes.T)

    points, spots = lights.point, lights.spot
    cones = np.zeros(len(spots), Cone.dtype)
    exact = {
        "apex": to_eye(spots["position"]),
        "range": spots["range"].astype(np.float64),
        "axis": spots["direction"].astype(np.float64) @ axes.T,
        "cosine": np.cos(spots["outer"]),  # in float32, as shaders have it
    }
    for name, values in exact.items():
        cones[name] = values
    around = evaluate(bounding_sphere, exact, dtype=np.float64)
    point_words = -(-len(points) // WORD)
    spheres = np.full((WORD * (point_words - (-len(spots) // WORD)), 4), (0.0, 0.0, 0.0, -1.0))
    spheres[: len(points), :3] = to_eye(points["position"])
    spheres[: len(points), 3] = points["range"]
    spheres[WORD * point_words :][: len(spots)] = around
    ends = (spheres[:, 2] + spheres[:, 3])[spheres[:, 3] >= 0.0]
    return LightVolumes(spheres, cones, point_words, float(ends.max()) if len(ends) else -np.inf)
