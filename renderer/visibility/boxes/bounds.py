"""What makes a box's query conservative: whatever its object would show, the box shows too.

A box and its object are rasterised apart, each with roundings of its own: vertices move to the nearest
fraction of a pixel, depths to the nearest float. So that a box covers every sample that its object covers,
and is never the farther of the two, it is drawn a little larger (`pad_boxes`). And a box that the near plane
cuts shows no front face there: what is so near counts as visible, without a query (`find_near`).
`see_boxes` does both for each object's tightest box.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from renderer.scene import Camera, Depth, FrustumPlane
from renderer.scene.arrays import Floats, Rows
from renderer.visibility.boxes.volumes import TurnedBoxes

__rhi_internal__ = True

_SHARE: Final = 2.0**-11  # of half the image, which is 1/256 pixel or more where that has 8 pixels or more
ROUNDING: Final = 2.0**-20  # of the distance: sixteen times the rounding of a float32 position
_DEPTH_STEPS: Final = 2.0**-21  # of standard depth, which spends its floats near the eye
LARGEST_SQUARED: Final = 1e100
"""Metres that distances are limited to, so that their squares are finite."""
TOO_FAR: Final = 1e15
"""Metres beyond which float32 might overflow on the way to the screen: drawn without being asked for."""


@dataclass(frozen=True, eq=False, slots=True)
class QueryBoxes:
    """What queries draw, as one camera sees it.

    Attributes:
        centre, half: (n, 3) in the world, and along their own axes, padded.
        x, y: (n, 3) float32, unit vectors along the first two of these; the third is at right angles.
        near: (n,) bool, which are drawn without a query.
    """

    centre: Floats
    half: Floats
    x: NDArray[np.float32]
    y: NDArray[np.float32]
    near: NDArray[np.bool_]


def see_boxes(camera: Camera, lower: Floats, upper: Floats, turned: TurnedBoxes, places: Rows) -> QueryBoxes:
    """QueryBoxes (n, 3) as `camera` sees them, with those at `places` (k,) replaced by `turned`, k of them.

    A turned box that the near plane may cut isn't asked for: the aligned one is, if that isn't cut either. So a
    group of boxes inside one that isn't near has none that is.
    """
    low, high, far = pad_boxes(camera, lower, upper)
    x, y = np.zeros((2, len(low), 3), np.float32)
    x[:, 0] = y[:, 1] = 1.0
    boxes = QueryBoxes(0.5 * (low + high), 0.5 * (high - low), x, y, find_near(camera, low, high, far))
    half, near = pad_turned(camera, turned)
    asked = np.flatnonzero(~near)
    places = places[asked]
    boxes.centre[places], boxes.half[places], boxes.near[places] = turned.centre[asked], half[asked], False
    boxes.x[places], boxes.y[places] = turned.turn[asked, 0], turned.turn[asked, 1]
    return boxes


def pad_boxes(camera: Camera, lower: Floats, upper: Floats) -> tuple[Floats, Floats, Floats]:
    """QueryBoxes (n, 3) enlarged by what rasterising may round away, and the distances (n,) of their far corners.

    The margin grows with the distance of the box's farthest corner, so that a box lies, padded, inside every
    padded box that it lies in without padding.
    """
    eye = camera.position
    reach = np.minimum(np.maximum(np.abs(lower - eye), np.abs(upper - eye)), LARGEST_SQUARED)
    far = np.asarray(np.sqrt(np.einsum("ij,ij->i", reach, reach)))
    margin = _find_margins(camera, far)
    return lower - margin[:, None], upper + margin[:, None], far


def pad_turned(camera: Camera, turned: TurnedBoxes) -> tuple[Floats, NDArray[np.bool_]]:
    """Half sizes (k, 3), enlarged as `pad_boxes` does, and which are near, as `find_near` says."""
    local = np.abs(np.einsum("kij,kj->ki", turned.turn, camera.position - turned.centre))
    reach = np.minimum(local + turned.half, LARGEST_SQUARED)
    far = np.asarray(np.sqrt(np.einsum("ij,ij->i", reach, reach)))
    half = turned.half + _find_margins(camera, far)[:, None]
    if is_parallel(camera):
        plane = camera.frustum.planes[FrustumPlane.NEAR]
        before = turned.centre @ plane[:3] + plane[3]
        near = before <= (half * np.abs(turned.turn @ plane[:3])).sum(axis=1)
    else:
        away = np.minimum(np.maximum(local - half, 0.0), LARGEST_SQUARED)
        near = np.einsum("ij,ij->i", away, away) <= near_radius(camera) ** 2
    return half, near | (far > TOO_FAR)


def _find_margins(camera: Camera, far: Floats) -> Floats:
    constant, linear, square = margin_terms(camera)
    return constant + far * (linear + far * square)


def margin_terms(camera: Camera) -> tuple[float, float, float]:
    """The margin of a box whose farthest point is f metres from the eye: a + b f + c f² metres."""
    matrix = camera.projection.matrix
    share = float(max(1.0 / matrix[0, 0], 1.0 / matrix[1, 1])) * _SHARE
    steps = _DEPTH_STEPS if camera.projection.depth is Depth.STANDARD else 0.0
    if is_parallel(camera):
        return share + steps / abs(matrix[2, 2]), ROUNDING, 0.0
    return 0.0, share + ROUNDING, steps / abs(matrix[2, 3])  # metres to depth


def find_near(camera: Camera, lower: Floats, upper: Floats, far: Floats) -> NDArray[np.bool_]:
    """Which padded boxes (n, 3) are drawn without a query.

    Those are within near · √(1 + tan²(fx/2) + tan²(fy/2)) of the eye, which is how far the corners of the near
    plane's rectangle are; in a parallel projection those that the near plane cuts.
    """
    if is_parallel(camera):
        *normal, d = camera.frustum.planes[FrustumPlane.NEAR].tolist()
        depth = sum((lower if n > 0.0 else upper)[:, axis] * n for axis, n in enumerate(normal)) + d
        near = np.asarray(depth <= 0.0)
    else:
        near = squared_distances(camera.position, lower, upper) <= near_radius(camera) ** 2
    return near | (far > TOO_FAR)


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


def is_parallel(camera: Camera) -> bool:
    """Whether the camera's projection is."""
    return bool(camera.projection.matrix[3, 3] != 0.0)
