"""Frustum culling of lights: those whose spheres reach into a camera's frustum."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from renderer.scene.arrays import Floats, Indices

_MARGIN: Final = 64.0 * float(np.finfo(np.float64).eps)  # of the terms' sum; they round by 16 eps at most


class LightSpheres:
    """The spheres of lights, of which each view sees some."""

    def __init__(self, positions: Floats, ranges: Floats) -> None:
        """`positions` and `ranges` are (l, 3) and (l,)."""
        self._positions = np.column_stack([positions, np.ones(len(positions))])
        self._reach = -(ranges + _MARGIN * (np.abs(positions).sum(axis=1) + ranges))[:, None]

    def flag_in_view(self, planes: Floats) -> NDArray[np.bool_]:
        """Return which spheres (l,) aren't outside one of `planes` (p, 4), whose normals are unit vectors inward.

        A sphere near a corner of the view may be outside of it and still be flagged. None that touches the view is
        left out.
        """
        distance = self._positions.dot(planes.T)
        margin = _MARGIN * np.abs(planes[:, 3])
        flags: NDArray[np.bool_] = np.logical_and.reduce(distance >= self._reach - margin, axis=1)
        return flags


def select_lights_in_view(planes: Floats, positions: Floats, ranges: Floats) -> Indices:
    """Return the rows (k,), ascending, of the lights whose spheres are in view; see `LightSpheres`.

    Args:
        planes: (p, 4) with unit normals inward.
        positions, ranges: (l, 3) and (l,) of the lights.
    """
    if not len(positions):
        return np.zeros(0, np.int64)
    return LightSpheres(positions, ranges).flag_in_view(planes).nonzero()[0]
