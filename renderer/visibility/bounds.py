"""What makes a box's query conservative: whatever its object would show, the box shows too.

A box and its object are rasterised apart, each with roundings of its own: vertices move to the nearest
fraction of a pixel, depths to the nearest float. So that a box covers every sample that its object covers,
and is never the farther of the two, it is drawn a little larger (`pad_boxes`). And a box that the near plane
cuts shows no front face there: what is so near counts as visible, without a query (`find_near`).
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from renderer.scene import Camera, Depth, Plane
from renderer.visibility.hierarchy import Floats

__rhi_internal__ = True

_SHARE: Final = 2.0**-11  # of half the image, which is 1/256 pixel or more where that has 8 pixels or more
_ROUNDING: Final = 2.0**-20  # of the distance: sixteen times the rounding of a float32 position
_DEPTH_STEPS: Final = 2.0**-21  # of standard depth, which spends its floats near the eye
LARGEST_SQUARED: Final = 1e100
"""Metres that distances are limited to, so that their squares are finite."""
_TOO_FAR: Final = 1e15
"""Metres beyond which float32 might overflow on the way to the screen: drawn without being asked for."""


def pad_boxes(camera: Camera, lower: Floats, upper: Floats) -> tuple[Floats, Floats, Floats]:
    """Boxes (n, 3) enlarged by what rasterising may round away, and the distances (n,) of their far corners.

    The margin grows with the distance of the box's farthest corner, so that a box lies, padded, inside every
    padded box that it lies in without padding.
    """
    eye = camera.position
    reach = np.minimum(np.maximum(np.abs(lower - eye), np.abs(upper - eye)), LARGEST_SQUARED)
    far = np.asarray(np.sqrt(np.einsum("ij,ij->i", reach, reach)))
    matrix = camera.projection.matrix
    widest = float(max(1.0 / matrix[0, 0], 1.0 / matrix[1, 1]))
    parallel = _is_parallel(camera)
    margin = far * _ROUNDING + (np.ones_like(far) if parallel else far) * (widest * _SHARE)
    if camera.projection.depth is Depth.STANDARD:
        steep = 1.0 / abs(matrix[2, 2]) if parallel else far * far / abs(matrix[2, 3])  # metres to depth
        margin += steep * _DEPTH_STEPS
    return lower - margin[:, None], upper + margin[:, None], far


def find_near(camera: Camera, lower: Floats, upper: Floats, far: Floats) -> NDArray[np.bool_]:
    """Which padded boxes (n, 3) are drawn without a query.

    Those are within near · √(1 + tan²(fx/2) + tan²(fy/2)) of the eye, which is how far the corners of the near
    plane's rectangle are; in a parallel projection those that the near plane cuts.
    """
    if _is_parallel(camera):
        *normal, d = camera.frustum.planes[Plane.NEAR].tolist()
        depth = sum((lower if n > 0.0 else upper)[:, axis] * n for axis, n in enumerate(normal)) + d
        near = np.asarray(depth <= 0.0)
    else:
        near = squared_distances(camera.position, lower, upper) <= near_radius(camera) ** 2
    return near | (far > _TOO_FAR)


def near_radius(camera: Camera) -> float:
    """Metres from the eye of a perspective camera to the farthest corner of its near plane's rectangle."""
    depth = 1.0 if camera.projection.depth is Depth.REVERSED else 0.0
    corners = np.array([(x, y, depth, 1.0) for x in (-1.0, 1.0) for y in (-1.0, 1.0)])
    places = corners @ np.linalg.inv(camera.projection.matrix).T
    return float(np.linalg.norm(places[:, :3] / places[:, 3:], axis=1).max())


def squared_distances(eye: Floats, lower: Floats, upper: Floats) -> Floats:
    """(n,) from `eye` (3,) to boxes (n, 3); 0 inside."""
    away = np.maximum(np.maximum(lower - eye, eye - upper), 0.0)
    np.minimum(away, LARGEST_SQUARED, out=away)
    return np.asarray(np.einsum("ij,ij->i", away, away))


def _is_parallel(camera: Camera) -> bool:
    return bool(camera.projection.matrix[3, 3] != 0.0)
