"""The range of depths that a camera sees, by the boxes of objects: what a comfortable pair of eyes is made
for."""

from __future__ import annotations

from typing import Final

import numpy as np

from renderer.scene import Camera, Scene
from renderer.scene.arrays import Floats
from renderer.visibility.boxes.volumes import Containment, classify

_CORNERS: Final = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)], bool)
_FACES: Final = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))


def compute_depth_range(scene: Scene, camera: Camera) -> tuple[float, float] | None:
    """Return the least and the greatest distance along the view at which `camera` sees the box of an object
    that is shown, None if it sees none.

    The nearest part of a box is that inside the frustum: a street begins where it enters the image, not under
    the camera. Boxes that hold the camera are left out, since they don't tell how far their objects are.
    """
    planes = camera.frustum.planes
    side = classify(planes, scene.objects.lower, scene.objects.upper)
    lower, upper = scene.objects.lower - camera.position, scene.objects.upper - camera.position
    holds = ((lower <= 0.0) & (upper >= 0.0)).all(axis=1)
    object_indices = np.flatnonzero((side != Containment.OUTSIDE) & ~holds & scene.objects.is_shown)
    if not len(object_indices):
        return None
    relative = planes.copy()
    relative[:, 3] += planes[:, :3] @ camera.position
    near = -float(relative[4, 3])  # of the near plane, along the view
    ends = np.where(camera.forward > 0.0, lower[object_indices], upper[object_indices]) @ camera.forward
    order = np.argsort(ends)
    nearest = np.inf
    for object_index, begin in zip(object_indices[order].tolist(), ends[order].tolist(), strict=True):
        if max(begin, near) >= nearest:
            break
        if side[object_index] == Containment.INSIDE:
            nearest = begin
        else:
            nearest = min(
                nearest, _nearest_depth(lower[object_index], upper[object_index], relative, camera.forward)
            )
    farthest = float(
        (np.where(camera.forward > 0.0, upper[object_indices], lower[object_indices]) @ camera.forward).max()
    )
    if len(relative) == 6:
        farthest = min(farthest, float(relative[5, 3]))
    return (nearest, max(farthest, nearest)) if np.isfinite(nearest) else None


def _nearest_depth(lower: Floats, upper: Floats, planes: Floats, forward: Floats) -> float:
    """Return the distance along the view to a box inside all planes, inf if it isn't inside: each face is cut by
    them."""
    corners = np.where(_CORNERS, upper, lower)
    nearest = np.inf
    for face in _FACES:
        polygon = corners[list(face)]
        for plane in planes:
            polygon = _cut(polygon, polygon @ plane[:3] + plane[3])
            if not len(polygon):
                break
        else:
            nearest = min(nearest, float((polygon @ forward).min()))
    return nearest


def _cut(polygon: Floats, inside: Floats) -> Floats:
    """Return the part of a polygon (k, 3) where `inside` (k,) isn't negative (Sutherland and Hodgman,
    1974)."""
    points = []
    for i, distance in enumerate(inside):
        last = inside[i - 1]
        if (distance < 0.0) != (last < 0.0):
            points.append(polygon[i - 1] + (polygon[i] - polygon[i - 1]) * (last / (last - distance)))
        if distance >= 0.0:
            points.append(polygon[i])
    return np.array(points).reshape(-1, 3)
