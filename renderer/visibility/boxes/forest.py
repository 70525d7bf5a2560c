"""The hierarchy that occlusion culling traverses, as one camera sees it.

Objects with fixed bounds are in a tree that is built once by surface area; these are the static ones, and those that
are animated within bounds. The others are in a second one, whose shape is kept while its bounds follow the objects, so
that a node stays the same from frame to frame and its visibility can be
remembered. Every leaf is one object: culling is then as exact as querying each object.

All that depends on the camera is computed for all nodes at once, before the traversal. The traversal itself is
Python, node by node, and reads bytes and lists.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from renderer.scene import Camera, Scene
from renderer.scene.arrays import Floats, Rows
from renderer.visibility.boxes.bounds import QueryBoxes, see_boxes, squared_distances
from renderer.visibility.boxes.culling import find_visible
from renderer.visibility.boxes.hierarchy import Hierarchy, build_by_area, build_by_median
from renderer.visibility.boxes.volumes import TightestBoxes

__rhi_internal__ = True

OUTSIDE: Final = 0
INSIDE: Final = 1
NEAR: Final = 2
"""The status of a node: outside the frustum, inside (to be queried), or so near that it counts as visible."""

_DEPTH: Final = 3
_GROWTH: Final = 1.4


class Forest:
    """The trees of a scene's static and moving objects, in one numbering of m nodes.

    Attributes:
        roots: the roots of the trees that are not empty.
        parent: for each node its parent, -1 for roots. child: the first child, whose sibling is the next node; -1 for
            leaves. object: the row of a leaf's object, -1 for other nodes.
        lower, upper: (m, 3) bounds, as of the last `update`.
        status: OUTSIDE, INSIDE or NEAR for each node. second_first: 1 where the second child is the nearer one.
        runs: for each node the begin and end of its objects in `order`, which holds the rows of all objects.
        tight: node after node, the nodes whose boxes fit it more closely: nodes below it, or the node itself.
        tight_sizes: (m,) the number of these for each node.
    """

    def __init__(self, scene: Scene) -> None:
        objects = scene.objects
        self._objects = objects
        kinds = ((objects.fixed_rows, build_by_area), (objects.following_rows, build_by_median))
        self._trees = [
            (rows, build(objects.lower[rows], objects.upper[rows], leaf_size=1))
            for rows, build in kinds
            if len(rows)
        ]
        starts = np.cumsum([0, *(len(tree) for _, tree in self._trees)]).tolist()
        self._starts: list[int] = starts
        self.roots: list[int] = starts[:-1]
        parts = [_number(rows, tree, start) for (rows, tree), start in zip(self._trees, starts, strict=False)]
        parent, child, row = (
            np.concatenate([np.zeros(0, np.int64), *(part[column] for part in parts)]) for column in range(3)
        )
        self.parent: list[int] = parent.tolist()
        self.child: list[int] = child.tolist()
        self.object: list[int] = row.tolist()
        self.order, self.runs = self._find_runs()
        self._inner: Rows = np.flatnonzero(child >= 0)
        self._first: Rows = child[self._inner]
        self._leaves: Rows = np.flatnonzero(child < 0)
        self._leaf_objects: Rows = row[self._leaves]
        self._in_view = np.ones(len(objects), bool)
        self._leaf_of: Rows = np.zeros(len(objects), np.int64)
        self._leaf_of[self._leaf_objects] = self._leaves
        self._tightest = TightestBoxes(scene)
        self.lower: Floats = np.zeros((3, len(child))).T  # columns are contiguous
        self.upper: Floats = np.zeros((3, len(child))).T
        for tree in range(len(self._trees)):
            self._fit(tree)
        self.status = bytes(len(child))
        self.second_first = bytes(len(child))
        tight = self._find_tight()
        self.tight: Rows = np.array([one for chosen in tight for one in chosen], np.int64)
        self.tight_sizes: Rows = np.array([len(chosen) for chosen in tight], np.int64)

    def __len__(self) -> int:
        return len(self.parent)

    def update(self, camera: Camera) -> QueryBoxes:
        """Update bounds, status and order of all nodes for `camera`, and return the boxes to query each node by: for
        a leaf, the tightest box of its object."""
        if len(self._objects.following_rows):
            self._fit(len(self._trees) - 1)
        lower, upper, eye = self.lower, self.upper, camera.position
        rotated = self._tightest.find()
        boxes = see_boxes(camera, lower, upper, rotated, self._leaf_of[rotated.rows])
        status = find_visible(camera.frustum.planes, lower, upper).astype(np.uint8)
        status[boxes.near & (status == INSIDE)] = NEAR
        self.status = status.tobytes()
        self._in_view[self._leaf_objects] = status[self._leaves] != OUTSIDE

        middle = 0.5 * (lower + upper)
        distance = squared_distances(eye, lower, upper)
        centre = squared_distances(eye, middle, middle)
        first, second = self._first, self._first + 1
        swap = (distance[second] < distance[first]) | (
            (distance[second] == distance[first]) & (centre[second] < centre[first])
        )
        flags = np.zeros(len(self), np.uint8)
        flags[self._inner] = swap
        self.second_first = flags.tobytes()
        return boxes

    def _fit(self, tree: int) -> None:
        """Update the bounds of a tree to those of its objects."""
        rows, hierarchy = self._trees[tree]
        run = slice(self._starts[tree], self._starts[tree + 1])
        self.lower[run], self.upper[run] = hierarchy.fit(self._objects.lower[rows], self._objects.upper[rows])

    def objects(self, node: int) -> Rows:
        """Return the rows, ascending, of the objects below a node that are not outside the frustum."""
        first, end = self.runs[node]
        rows = self.order[first:end]
        return np.sort(rows[self._in_view[rows]])

    def _find_runs(self) -> tuple[Rows, list[tuple[int, int]]]:
        order, runs, start = [np.zeros(0, np.int64)], [], 0
        for rows, tree in self._trees:
            order.append(rows[tree.order])
            first = start + tree.first
            runs += list(zip(first.tolist(), (first + tree.count).tolist(), strict=True))
            start += len(rows)
        return np.concatenate(order), runs

    def _find_tight(self) -> list[tuple[int, ...]]:
        """Find each node's tight bounds (CHC++, section 6).

        These are the nodes up to 3 levels below it, as long as the sum of the surfaces of their boxes is at most 1.4
        times the node's own. They are chosen once: any nodes that together cover a node give correct results.
        """
        size = np.minimum(self.upper - self.lower, 1e100)
        areas = (size * np.roll(size, 1, axis=1)).sum(axis=1).tolist()
        tight = []
        for node in range(len(self)):
            chosen: tuple[int, ...] = (node,)
            level = chosen
            for _ in range(_DEPTH):
                level = tuple(
                    below
                    for one in level
                    for below in ((self.child[one], self.child[one] + 1) if self.child[one] >= 0 else (one,))
                )
                if level == chosen or sum(areas[one] for one in level) > _GROWTH * areas[node]:
                    break
                chosen = level
            tight.append(chosen)
        return tight


def _number(rows: Rows, tree: Hierarchy, start: int) -> tuple[Rows, Rows, Rows]:
    """Return parents, children and objects of a tree whose first node gets the number `start`."""
    leaf = tree.child < 0
    parent = np.where(tree.parent < 0, -1, tree.parent + start)
    child = np.where(leaf, -1, tree.child + start)
    return parent, child, np.where(leaf, rows[tree.order[tree.first]], -1)
