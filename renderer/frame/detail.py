"""Levels of detail of a scene's objects: the draws of each level, as the CPU and as the device draws them.

Which level an object is drawn as is said by a limit of the error (`renderer.visibility.detail`).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from renderer.scene import Scene
from renderer.scene.arrays import Indices
from renderer.scene.meshes import Meshes
from renderer.shaders import MeshPart
from renderer.visibility.detail import DetailLimit
from rhi.math.indexing import repeat_each


class DetailLevels:
    """The draws of the levels of a scene's objects, behind those of the meshes themselves.

    Attributes:
        index_begin: where the indices of levels begin in the buffer of all indices.
    """

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self.index_begin = len(scene.meshes.indices)
        self._first: Indices = np.zeros(0, np.int64)  # by object, the row of its first level
        self._counts: Indices = np.zeros(0, np.int64)  # by object, how many levels there are

    def list_draws(self, draws: NDArray[Any]) -> NDArray[Any]:
        """Return the draws (n,) of all objects, and behind them those of their levels."""
        meshes, mesh = self._scene.meshes, self._scene.objects.mesh
        begins = meshes.level_begins
        self._counts = begins[mesh + 1] - begins[mesh]
        self._first = len(draws) + np.cumsum(self._counts) - self._counts
        rows = draws[repeat_each(np.arange(len(draws)), self._counts)]
        behind = np.arange(len(rows)) - repeat_each(self._first - len(draws), self._counts)
        ranges = meshes.level_ranges[repeat_each(begins[mesh], self._counts) + behind]
        rows["first"] = ranges["first_index"] + self.index_begin
        rows["count"] = ranges["index_count"]
        return np.concatenate([draws, rows])

    def has_any(self, is_selected: NDArray[np.bool_]) -> bool:
        """Return whether any of the objects that are selected, (n,) bool, has levels."""
        return bool((self._counts[is_selected] > 0).any())

    def select(self, object_indices: Indices, limit: DetailLimit) -> Indices:
        """Return the draws (k,) of objects (k,): those of the coarsest levels within the limit."""
        has_levels = self._counts[object_indices] > 0
        if not has_levels.any():
            return object_indices
        scene = self._scene
        indices = object_indices[has_levels]
        mesh = scene.objects.mesh[indices]
        levels = limit.count_levels(
            scene.nodes.world[scene.objects.node[indices]],
            scene.meshes.lower[mesh],
            scene.meshes.upper[mesh],
            scene.meshes.level_errors[mesh],
        )
        rows = object_indices.copy()
        rows[has_levels] = np.where(levels > 0, self._first[indices] + levels - 1, indices)
        return rows


def make_mesh_parts(meshes: Meshes) -> NDArray[Any]:
    """Return the parts of meshes, behind them those of their levels and then those of their meshlets, (meshes + levels
    + meshlets,) of `MeshPart`."""
    counts, every = np.diff(meshes.level_begins), np.arange(len(meshes))
    cut = repeat_each(every, np.diff(meshes.meshlet_begins))
    mesh = np.concatenate([every, repeat_each(every, counts), cut])
    parts = np.zeros(len(mesh), MeshPart.dtype)
    parts["lower"], parts["upper"] = meshes.lower[mesh], meshes.upper[mesh]
    parts["base_vertex"] = meshes.ranges["base_vertex"][mesh]
    own, levels = parts[: len(meshes)], parts[len(meshes) : len(meshes) + len(meshes.level_ranges)]
    own["first"], own["count"] = meshes.ranges["first_index"], meshes.ranges["index_count"]
    own["first_level"], own["level_count"] = len(meshes) + meshes.level_begins[:-1], counts
    levels["first"] = meshes.level_ranges["first_index"] + len(meshes.indices)
    levels["count"] = meshes.level_ranges["index_count"]
    errors = meshes.level_errors[np.isfinite(meshes.level_errors)]
    levels["error"] = np.nextafter(errors.astype(np.float32), np.float32(np.inf))
    meshlets = parts[len(parts) - len(cut) :]
    meshlets["first"], meshlets["count"] = (
        meshes.meshlet_ranges["first_index"],
        meshes.meshlet_ranges["index_count"],
    )
    return parts
