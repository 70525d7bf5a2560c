"""Merged objects: those with equal materials that never move apart become one object with one mesh."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from renderer.scene.arrays import Floats, Indices
from renderer.scene.meshes import MeshGeometry, join
from rhi.math import multiply, transform_bounds, translation


@dataclass(frozen=True, eq=False, slots=True)
class NodeAnchors:
    """For each node the nearest one at or above it that may move or be hidden, -1 for the world: `anchors` (n,).
    `transforms` (n, 4, 4) lead from the nodes to their anchors."""

    anchors: Indices
    transforms: Floats

    @classmethod
    def make(cls, parents: Indices, locals: Floats, is_anchor: NDArray[np.bool_]) -> NodeAnchors:
        """List the anchors of nodes, parents before children."""
        anchors, transforms = np.full(len(parents), -1), locals.copy()
        for node, parent in enumerate(parents.tolist()):
            if is_anchor[node]:
                anchors[node], transforms[node] = node, np.eye(4)
            elif parent >= 0:
                anchors[node] = anchors[parent]
                transforms[node] = multiply(transforms[parent], locals[node])
        return cls(anchors, transforms)


@dataclass(frozen=True, eq=False, slots=True)
class MergedObject:
    """An object that replaces the objects `indices` (k,): a mesh around the point `centre` (3,) in the space of
    `anchor`."""

    indices: Indices
    anchor: int
    centre: Floats
    geometry: MeshGeometry


def group_equal(keys: Sequence[object], is_mergeable: NDArray[np.bool_]) -> list[Indices]:
    """Return the indices of objects with equal keys, where there are two or more, in the order of the first."""
    groups: dict[object, list[int]] = {}
    for index in np.flatnonzero(is_mergeable).tolist():
        groups.setdefault(keys[index], []).append(index)
    return [np.array(indices, np.int64) for indices in groups.values() if len(indices) > 1]


def merge_group(
    indices: Indices, anchor: int, transforms: Floats, geometries: Sequence[MeshGeometry]
) -> MergedObject:
    """Merge objects `indices` (k,) whose meshes have these transforms (k, 4, 4) to the space of `anchor`.

    The mesh is relative to the middle of its bounds, so that float32 has its positions wherever it is.
    """
    corners = np.array([geometry.bounds for geometry in geometries])
    lower, upper = transform_bounds(transforms, corners[:, 0], corners[:, 1])
    centre: Floats = 0.5 * (lower.min(axis=0) + upper.max(axis=0))
    moved = multiply(translation(-centre)[None], transforms)
    parts = [geometry.transformed(matrix) for geometry, matrix in zip(geometries, moved, strict=True)]
    return MergedObject(indices, anchor, centre, join(parts))
