"""The shapes of sources that aren't spheres: rectangles and tubes.

A light has them in two fields. `source_right` and `source_up` are half of a rectangle's sides, or `source_right` is
half of a tube's axis and `source_up` is 0; both are 0 for points and spheres. A rectangle shines along
`cross(source_right, source_up)`.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rhi.math import Floats

SHAPE_FIELDS: Final = (("source_right", "<f4", 3), ("source_up", "<f4", 3))
"""The fields that the arrays of kinds with shapes end with."""

_THINNEST: Final = 5e-3
"""The least width of a source over its length as shaders see it: sums over the edges of a thinner one lose digits,
and a thinner one looks the same."""
_SMALLEST: Final = 1e-6
"""The least half side over the range."""
_LEAST: Final = 1e-15
"""The least half side in metres."""

_SMALLEST_SPHERE: Final = 1e-9
"""The radius over the range up to which a sphere looks like a point: at a thousandth of the range it is as wide as
1e-6 radians, and nearer surfaces are too bright to differ."""
_SMALLEST_DISC: Final = 1e-9
"""The diameter in radians up to which a directional light looks like a point: behind an edge 10,000 km away its
shadow is soft over a centimetre."""


def flag_spheres(lights: NDArray[Any]) -> NDArray[np.bool_]:
    """The mask (k,) of lights with a position whose radius changes something."""
    return np.asarray(lights["source_radius"] > _SMALLEST_SPHERE * lights["range"])


def flag_discs(lights: NDArray[Any]) -> NDArray[np.bool_]:
    """The mask (k,) of directional lights whose diameter changes something."""
    return np.asarray(lights["angular_diameter"] > _SMALLEST_DISC)


def flag_areas(lights: NDArray[Any]) -> NDArray[np.bool_]:
    """The mask (k,) of lights that are rectangles or tubes."""
    return np.asarray(lights["source_right"].any(axis=-1))


def measure_extent(lights: NDArray[Any]) -> Floats:
    """The distance (k,) from the middles of rectangles and tubes to their farthest points; 0 for others."""
    squares = (lights[name].astype(np.float64) ** 2 for name, *_ in SHAPE_FIELDS)
    extent = np.sqrt(sum(square.sum(axis=-1) for square in squares))
    radius = np.where(lights["source_up"].any(axis=-1), 0.0, lights["source_radius"])
    return np.asarray(np.where(flag_areas(lights), np.hypot(extent, radius), 0.0))


def aim_rectangle(direction: ArrayLike, up: ArrayLike) -> tuple[Floats, Floats]:
    """Unit vectors (3,) along the sides of a rectangle that shines along `direction`: to the right of someone who
    sees it, and as nearly along `up` as can be."""
    forward = np.asarray(direction, np.float64)
    forward = forward / max(float(np.abs(forward).max(initial=0.0)), 1e-300)
    forward = forward / max(float(np.linalg.norm(forward)), 1e-300)
    right = np.cross(np.asarray(up, np.float64), forward)
    if np.linalg.norm(right) < 1e-6:
        right = np.cross(np.eye(3)[int(np.abs(forward).argmin())], forward)
    right = right / max(float(np.linalg.norm(right)), 1e-300)
    return right, np.cross(forward, right)


def turn_sides(linear: Floats, sides: Floats) -> tuple[Floats, Floats]:
    """The sides of sources, (k, 3) each, turned by matrices (k, 3, 3). They keep their lengths and right angles, as
    ranges aren't scaled; in a mirrored space, rectangles shine to the mirrored side.

    Args:
        sides: (k, 2, 3), `source_right` and `source_up`.
    """
    lengths = np.linalg.norm(sides, axis=2, keepdims=True)
    turned = np.einsum("kij,knj->kni", linear, sides)
    right = _normalize(turned[:, 0])
    up = turned[:, 1] - right * (turned[:, 1] * right).sum(axis=1, keepdims=True)
    up = _normalize(up) * np.where(np.linalg.det(linear) < 0.0, -1.0, 1.0)[:, None]
    return right * lengths[:, 0], up * lengths[:, 1]


def _normalize(vectors: Floats) -> Floats:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-300))


def pack_shapes(lights: NDArray[Any]) -> NDArray[np.float32]:
    """The shapes (k, 2, 4) of lights as shaders read them (`SourceShape`): `right` and the radius, -1 for rectangles,
    then `up` and π times the radiance of a light of intensity 1. Zeros for points and spheres."""
    packed = np.zeros((len(lights), 2, 4))
    right, up = (lights[name].astype(np.float64) for name, *_ in SHAPE_FIELDS)
    length, height = (np.linalg.norm(side, axis=1) for side in (right, up))
    is_area, is_tube = length > 0.0, height == 0.0
    across = np.where(is_tube, lights["source_radius"], height)
    least = np.maximum(_SMALLEST * lights["range"].astype(np.float64), _LEAST)
    long = np.maximum(np.maximum(length, _THINNEST * across), least)
    wide = np.maximum(np.maximum(across, _THINNEST * length), least)
    packed[:, 0, :3] = right * (long / np.where(is_area, length, 1.0))[:, None]
    packed[:, 1, :3] = up * np.where(is_tube, 0.0, wide / np.where(is_tube, 1.0, height))[:, None]
    packed[:, 0, 3] = np.where(is_tube, wide, -1.0)
    packed[:, 1, 3] = np.pi / (4.0 * long * wide)
    packed[~is_area] = 0.0
    return packed.astype(np.float32)
