"""Boxes for queries, enlarged so that they are conservative: a box covers whatever its object covers.

A box and its object are rasterised apart, each with its own rounding: vertices move to the nearest fraction
of a pixel, depths to the nearest float. So that a box covers every sample that its object covers, and is
never the farther of the two, it is drawn a little larger (`pad_boxes`). A box that the near plane cuts has no
front face there, so objects that near count as visible without a query (`near_mask`). `compute_query_boxes`
does both for each object's tightest box.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from renderer.scene import Camera, Depth, FrustumPlane, Projection
from renderer.scene.arrays import Floats, Indices
from renderer.visibility.boxes.volumes import RotatedBoxes
from rhi.math import is_parallel

_PIXEL_FRACTION: Final = 2.0**-8
"""Vertices move by at most this part of a pixel."""
_MOST_PIXELS: Final = 16
"""A longer side of an image counts as one of so many pixels, so that margins don't depend on the size."""
UNKNOWN_SIZE: Final = (_MOST_PIXELS, _MOST_PIXELS)
"""Stands for the size of an image that isn't smaller."""
ROUNDING: Final = 2.0**-20  # of the distance: 16 times the rounding of a float32 position
_DEPTH_STEPS: Final = 2.0**-21  # of standard depth, whose floats are dense near the eye and sparse far away
MAX_SQUARABLE: Final = 1e100
"""Limit of distances in metres, so that their squares are finite."""
TOO_FAR: Final = 1e15
"""Distance in metres beyond which float32 might overflow on the way to the screen: such objects are drawn
without a query."""


@dataclass(frozen=True, eq=False, slots=True)
class QueryBoxes:
    """The boxes that queries draw, as one camera sees them.

    Attributes:
        centre: (n, 3) world positions.
        half: (n, 3) padded half sizes along the boxes' own axes.
        x, y: (n, 3) float32, unit vectors along the first two axes; the third is their cross product.
        near: (n,) bool, whether the box is so near that its object is drawn without a query.
    """

    centre: Floats
    half: Floats
    x: NDArray[np.float32]
    y: NDArray[np.float32]
    near: NDArray[np.bool_]


def compute_query_boxes(
    camera: Camera,
    lower: Floats,
    upper: Floats,
    rotated: RotatedBoxes,
    indices: Indices,
    size: tuple[int, int] = UNKNOWN_SIZE,
) -> QueryBoxes:
    """Return the boxes (n, 3) as `camera` sees them in an image of `size`, with the boxes `indices` (k,) replaced
    by the `rotated` ones (k,).

    A rotated box that the near plane may cut is not used; the aligned one is, unless that may be cut too. So
    no box of a group inside a box that isn't near is itself near.
    """
    low, high, far = pad_boxes(camera, lower, upper, size)
    x, y = np.zeros((2, len(low), 3), np.float32)
    x[:, 0] = y[:, 1] = 1.0
    boxes = QueryBoxes(0.5 * (low + high), 0.5 * (high - low), x, y, near_mask(camera, low, high, far))
    half, near = pad_rotated(camera, rotated, size)
    used = np.flatnonzero(~near)
    indices = indices[used]
    boxes.centre[indices], boxes.half[indices], boxes.near[indices] = rotated.centre[used], half[used], False
    boxes.x[indices], boxes.y[indices] = rotated.axes[used, 0], rotated.axes[used, 1]
    return boxes


def pad_boxes(
    camera: Camera, lower: Floats, upper: Floats, size: tuple[int, int] = UNKNOWN_SIZE
) -> tuple[Floats, Floats, Floats]:
    """Return boxes (n, 3) enlarged by what rasterising may round away in an image of `size`, and the distances
    (n,) of their far corners.

    The margin grows with the distance of the box's farthest corner, so that a padded box lies inside every
    padded box that it lies in without padding.
    """
    eye = camera.position
    reach = np.minimum(np.maximum(np.abs(lower - eye), np.abs(upper - eye)), MAX_SQUARABLE)
    far = np.asarray(np.sqrt(np.einsum("ij,ij->i", reach, reach)))
    margin = _margins(camera, far, size)
    return lower - margin[:, None], upper + margin[:, None], far


def pad_rotated(
    camera: Camera, rotated: RotatedBoxes, size: tuple[int, int] = UNKNOWN_SIZE
) -> tuple[Floats, NDArray[np.bool_]]:
    """Return half sizes (k, 3) enlarged as by `pad_boxes`, and whether each box is near (k,), as by
    `near_mask`."""
    local = np.abs(np.einsum("kij,kj->ki", rotated.axes, camera.position - rotated.centre))
    reach = np.minimum(local + rotated.half, MAX_SQUARABLE)
    far = np.asarray(np.sqrt(np.einsum("ij,ij->i", reach, reach)))
    half = rotated.half + _margins(camera, far, size)[:, None]
    if is_parallel(camera.projection):
        plane = camera.frustum.planes[FrustumPlane.NEAR]
        before = rotated.centre @ plane[:3] + plane[3]
        near = before <= (half * np.abs(rotated.axes @ plane[:3])).sum(axis=1)
    else:
        away = np.minimum(np.maximum(local - half, 0.0), MAX_SQUARABLE)
        near = np.einsum("ij,ij->i", away, away) <= near_radius(camera) ** 2
    return half, near | (far > TOO_FAR)


def _margins(camera: Camera, far: Floats, size: tuple[int, int]) -> Floats:
    constant, linear, square = margin_terms(camera, size)
    return constant + far * (linear + far * square)


def margin_terms(camera: Camera, size: tuple[int, int] = UNKNOWN_SIZE) -> tuple[float, float, float]:
    """Return (a, b, c): in an image of `size`, a box whose farthest point is f metres from the eye has a margin
    of a + b f + c f² metres.

    The distance to which a vertex is moved is a fraction of a pixel, so in an image of few pixels it is a large
    part of the view.
    """
    matrix = camera.projection.matrix
    width, height = min(size[0], _MOST_PIXELS), min(size[1], _MOST_PIXELS)
    focal_pixels = 0.5 * min(width * float(matrix[0, 0]), height * float(matrix[1, 1]))
    fraction = _PIXEL_FRACTION / focal_pixels
    steps = _DEPTH_STEPS if camera.projection.depth is Depth.STANDARD else 0.0
    if is_parallel(camera.projection):
        return fraction + steps / abs(matrix[2, 2]), ROUNDING, 0.0
    return 0.0, fraction + ROUNDING, steps / abs(matrix[2, 3])  # metres to depth


def near_mask(camera: Camera, lower: Floats, upper: Floats, far: Floats) -> NDArray[np.bool_]:
    """Return which padded boxes (n, 3) are so near that they are drawn without a query, (n,) bool.

    In a perspective projection these are the boxes within near · √(1 + tan²(fx/2) + tan²(fy/2)) of the eye,
    the distance of the corners of the near plane's rectangle; in a parallel projection those that the near
    plane cuts.
    """
    if is_parallel(camera.projection):
        *normal, d = camera.frustum.planes[FrustumPlane.NEAR].tolist()
        depth = sum((lower if n > 0.0 else upper)[:, axis] * n for axis, n in enumerate(normal)) + d
        near = np.asarray(depth <= 0.0)
    else:
        near = squared_distances(camera.position, lower, upper) <= near_radius(camera) ** 2
    return near | (far > TOO_FAR)


def near_radius(camera: Camera) -> float:
    """Return the distance in metres from a perspective camera to the farthest corner of its near
    rectangle."""
    return _near_radius(camera.projection)


@lru_cache(maxsize=16)
def _near_radius(projection: Projection) -> float:
    depth = 1.0 if projection.depth is Depth.REVERSED else 0.0
    corners = np.array([(x, y, depth, 1.0) for x in (-1.0, 1.0) for y in (-1.0, 1.0)])
    points = corners @ np.linalg.inv(projection.matrix).T
    return float(np.linalg.norm(points[:, :3] / points[:, 3:], axis=1).max())


def squared_distances(eye: Floats, lower: Floats, upper: Floats) -> Floats:
    """Return squared distances (n,) from `eye` (3,) to boxes (n, 3); 0 for an eye inside a box."""
    away = np.maximum(np.maximum(lower - eye, eye - upper), 0.0)
    np.minimum(away, MAX_SQUARABLE, out=away)
    return np.asarray(np.einsum("ij,ij->i", away, away))
