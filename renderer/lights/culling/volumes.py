"""The volumes of a scene's point and spot lights as the device tests them: in eye space, from positions in float64."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.lights.culling.cone_tests import Cone, bounding_sphere
from renderer.scene import Camera, Lights
from renderer.scene.arrays import Floats
from renderer.scene.lights import SPOT
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

    points, spots, around = lights.point, lights.spot, _bound_cones(lights.spot.tobytes())
    cones = np.zeros(len(spots), Cone.dtype)
    cones["apex"], cones["axis"] = to_eye(spots["position"]), spots["direction"] @ axes.T
    cones["range"], cones["cosine"] = spots["range"], np.cos(spots["outer"])
    point_words = -(-len(points) // WORD)
    spheres = np.full((WORD * (point_words - (-len(spots) // WORD)), 4), (0.0, 0.0, 0.0, -1.0))
    spheres[: len(points), :3] = to_eye(points["position"])
    spheres[: len(points), 3] = points["range"]
    last = spheres[WORD * point_words :][: len(spots)]
    last[:, :3], last[:, 3] = to_eye(around[:, :3]), around[:, 3]
    ends = (spheres[:, 2] + spheres[:, 3])[spheres[:, 3] >= 0.0]
    return LightVolumes(spheres, cones, point_words, float(ends.max()) if len(ends) else -np.inf)


@lru_cache(maxsize=4)
def _bound_cones(spots: bytes) -> Floats:
    """Return the spheres (s, 4) around the cones of spot lights in the world. They stay while eyes move."""
    lights = np.frombuffer(spots, SPOT)
    cones = {
        "apex": lights["position"],
        "range": lights["range"].astype(np.float64),
        "axis": lights["direction"].astype(np.float64),
        "cosine": np.cos(lights["outer"]),  # in float32, as shaders have it
    }
    return np.asarray(evaluate(bounding_sphere, cones, dtype=np.float64))
