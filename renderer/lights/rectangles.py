"""Bounding rectangles of local lights on the screen: the smallest around the projections of their spheres.

A clip matrix maps a sphere and the eye's plane of an axis to an ellipse in (x, w), of which x / w is sought
where w is not nearer than the near plane. Its extremes are at the tangents from the origin, or where the near
plane cuts the ellipse. So the bounds are exact, too, if the eye is inside the sphere or the sphere reaches
behind the eye.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from renderer.scene.arrays import Floats
from rhi.math import Camera, Depth

_MARGIN = 1e-6  # of the image: rounding to float32


def bound_spheres(camera: Camera, centers: Floats, radii: Floats) -> Floats:
    """Return the rectangles (l, 4) of spheres in the image: left, bottom, right, top from -1 to 1.

    They are clipped to the image. A sphere outside of it has no area; with a perspective projection, neither
    has one that is nearer than the near plane.

    Args:
        centers, radii: (l, 3) and (l,) of the spheres, in the world.
    """
    matrix = camera.projection.matrix
    turned = matrix[:, :3] @ camera.rotation
    away = centers - camera.position
    middles = away @ turned.T + matrix[:, 3]
    near = _near_plane_w(matrix, camera.projection.depth)
    result = np.empty((len(centers), 4))
    for axis in (0, 1):
        low, high = _bound(turned[axis], middles[:, axis], turned[3], middles[:, 3], radii, near)
        result[:, axis], result[:, axis + 2] = low - _MARGIN, high + _MARGIN
    result[np.any(result[:, :2] > result[:, 2:], axis=1)] = 0.0
    return result.clip(-1.0, 1.0)


def _near_plane_w(matrix: Floats, depth: Depth) -> float:
    """Return w on the near plane of a clip matrix."""
    near = matrix[3] - matrix[2] if depth is Depth.REVERSED else matrix[2]
    distance = near[3] / near[2]  # along the camera's axis
    return float(matrix[3, 3] - matrix[3, 2] * distance)


def _bound(a: Floats, x: Floats, b: Floats, w: Floats, radii: Floats, near: float) -> tuple[Floats, Floats]:
    """Return the bounds of x / w, where w >= near, of spheres: their points are (x, w) + radius · (a · d, b ·
    d) for all d of length 1 or less. If no point has w >= near, the lower bound is inf and the upper one
    -inf."""
    aa, ab, bb = float(a @ a), float(a @ b), float(b @ b)
    if bb == 0.0:  # parallel rays
        reach = radii * np.sqrt(aa)
        return (x - reach) / w, (x + reach) / w
    squared = radii * radii
    # A plane x = s w touches the sphere: (x - s w)² = radius² |a - s b|².
    second = w * w - squared * bb
    first = x * w - squared * ab
    zeroth = x * x - squared * aa
    root = np.sqrt(np.maximum(first * first - second * zeroth, 0.0))
    stable = first + np.where(first >= 0.0, root, -root)
    candidates: list[NDArray[np.float64]] = []
    valid: list[NDArray[np.bool_]] = []
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        # The near plane cuts it in a circle.
        along = (near - w) / np.maximum(radii, 1e-300)
        aside = np.sqrt(max(aa - ab * ab / bb, 0.0)) * np.sqrt(np.maximum(1.0 - along * along / bb, 0.0))
        for tangent in (stable / second, zeroth / stable):
            normal = aa - 2.0 * tangent * ab + tangent * tangent * bb
            touched = w - (ab - tangent * bb) * (x - tangent * w) / normal
            candidates.append(tangent)
            valid.append(touched >= near)
        for side in (-aside, aside):
            candidates.append((x + radii * (ab / bb * along + side)) / near)
            valid.append(along * along <= bb)
    low = np.min([np.where(fine, s, np.inf) for s, fine in zip(candidates, valid, strict=True)], axis=0)
    high = np.max([np.where(fine, s, -np.inf) for s, fine in zip(candidates, valid, strict=True)], axis=0)
    return low, high
