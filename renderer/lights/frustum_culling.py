"""Frustum culling of lights: those whose spheres reach into a camera's frustum."""

from __future__ import annotations

from typing import Final

import numpy as np

from renderer.scene.arrays import Floats, Indices

_MARGIN: Final = 64.0 * float(np.finfo(np.float64).eps)  # of the terms' sum; they round by 16 eps at most


def select_lights_in_view(planes: Floats, positions: Floats, ranges: Floats) -> Indices:
    """Return the rows (k,), ascending, of the lights whose spheres aren't outside one of the planes.

    A sphere near a corner of the view may be outside of it and still be selected. None that touches the view
    is left out.

    Args:
        planes: (p, 4) with unit normals inward.
        positions, ranges: (l, 3) and (l,) of the lights.
    """
    if not len(positions):
        return np.zeros(0, np.int64)
    offsets = planes[:, 3]
    reach = ranges + _MARGIN * (np.add.reduce(np.abs(positions), axis=1) + ranges)
    distance = positions @ planes[:, :3].T
    distance += offsets + _MARGIN * np.abs(offsets)
    return np.asarray(np.logical_and.reduce(distance >= -reach[:, None], axis=1).nonzero()[0])
