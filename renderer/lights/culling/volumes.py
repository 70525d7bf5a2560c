"""The volumes of a scene's lights as the device tests them: in eye space, from positions in float64."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.light_kinds.kind import LocalLightKind
from renderer.light_kinds.table import LOCAL_LIGHT_KINDS
from renderer.light_kinds.volumes import Cone, bounding_sphere
from renderer.scene import Camera, Lights
from renderer.scene.arrays import Floats
from rhi.shading import evaluate

WORD: Final = 32
"""Number of lights whose results are the bits of a word."""


_CONE: Final = Cone.dtype


@dataclass(frozen=True, eq=False, slots=True)
class LightVolumes:
    """The bounding volumes of all local lights.

    Attributes:
        spheres: (32 w, 4) float64, centres and radii: of the lights of each kind, in the order of the table,
            and each from a multiple of 32 on. Rows between them have a radius of -1.
        cones: (c,) of `Cone`, for the spheres from `word_ends[k]` on, where k is the last kind without cones.
        word_ends: for each kind, the word behind which its lights end.
        reach: the farthest depth that a light reaches; -inf without lights.
    """

    spheres: Floats
    cones: NDArray[Any]
    word_ends: tuple[int, ...]
    reach: float

    @property
    def words(self) -> int:
        """The number of words with a bit for each light."""
        return len(self.spheres) // WORD


def compute_light_volumes(lights: Lights, camera: Camera) -> LightVolumes:
    """Return the volumes of all lights with a position, seen from a camera."""
    axes = camera.rotation * np.array([[1.0], [1.0], [-1.0]])  # right, up, ahead

    def to_eye(positions: Floats) -> Floats:
        return np.asarray((positions - camera.position) @ axes.T)

    counts = [len(lights.of_kind(kind)) for kind in LOCAL_LIGHT_KINDS]
    word_ends = tuple(np.cumsum([-(-count // WORD) for count in counts]).tolist())
    spheres = np.full((WORD * word_ends[-1], 4), (0.0, 0.0, 0.0, -1.0))
    cones: list[NDArray[Any]] = []
    for number, kind in enumerate(LOCAL_LIGHT_KINDS):
        lights_of_kind, first = lights.of_kind(kind), WORD * (word_ends[number - 1] if number else 0)
        if kind.cones is None:
            centers, radii = kind.bounds(lights_of_kind)
        else:
            around = _bound_cones(kind, lights_of_kind.tobytes())
            centers, radii = around[:, :3], around[:, 3]
            if cones:
                cones.append(np.zeros(-counts[number - 1] % WORD, _CONE))
            added = np.zeros(counts[number], _CONE)
            world = kind.cones(lights_of_kind)
            added["apex"], added["axis"] = to_eye(world["apex"]), world["axis"] @ axes.T
            added["range"], added["cosine"] = world["range"], world["cosine"]
            cones.append(added)
        spheres[first : first + counts[number], :3] = to_eye(centers)
        spheres[first : first + counts[number], 3] = radii
    ends = (spheres[:, 2] + spheres[:, 3])[spheres[:, 3] >= 0.0]
    all_cones = cones[0] if len(cones) == 1 else np.concatenate([np.zeros(0, _CONE), *cones])
    return LightVolumes(spheres, all_cones, word_ends, float(ends.max()) if len(ends) else -np.inf)


@lru_cache(maxsize=4)
def _bound_cones(kind: LocalLightKind, data: bytes) -> Floats:
    """Return the spheres (k, 4) around the cones of lights of a kind in the world. They stay while eyes
    move."""
    assert kind.cones is not None
    return np.asarray(
        evaluate(bounding_sphere, kind.cones(np.frombuffer(data, kind.dtype)), dtype=np.float64)
    )
