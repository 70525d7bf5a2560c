"""The hierarchy that occlusion culling traverses, as one camera sees it.

Objects with fixed bounds are in a tree that is built once by surface area: the static ones, and those that
are animated within bounds. The others, which follow their motion, are in a second one (thesis 5.2.1), split
in the middle. It is kept as long as it is about as good as when it was built, so that a node stays the same
from frame to frame and its visibility can be remembered; then it is rebuilt. Below the leaves of the
traversal the trees go on to single objects, whose boxes say what is in view, and fit leaves closely.

All that depends on the camera is computed for all nodes at once, before the traversal. The traversal itself
is Python, node by node, and reads bytes and lists. Its `Frontier` walks all trees together, front to back.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from renderer.scene import Camera, Scene
from renderer.scene.arrays import Floats, Indices
from renderer.visibility.boxes.bounds import (
    UNKNOWN_SIZE,
    QueryBoxes,
    compute_query_boxes,
    squared_distances,
)
from renderer.visibility.boxes.culling import select_visible
from renderer.visibility.boxes.hierarchy import build_by_area, build_by_middle
from renderer.visibility.boxes.volumes import TightestBoxes
from rhi.math.indexing import count_indices, repeat_each

OUTSIDE: Final = 0
INSIDE: Final = 1
NEAR: Final = 2
"""The status of a node: outside the frustum, inside (to be queried), or so near that it counts as visible."""

REBUILD_RATIO: Final = 1.2
"""The factor by which the cost of the moving objects' tree may grow before it is rebuilt."""

_MAX_TIGHT_DEPTH: Final = 3
_MAX_TIGHT_GROWTH: Final = 1.4


class Forest:
    """The trees of a scene's static and moving objects, in one numbering of m nodes.

    Attributes:
        roots: the roots of the trees that are not empty.
        parent: for each node its parent, -1 for roots.
        child: the first child, whose sibling is the next node; -1 for nodes of at most `leaf_size` objects,
            the leaves of the traversal. object: the row of the object of a node that has only one, -1 for
            other nodes.
        moving: the nodes of the moving objects' tree, as a slice.
        lower, upper: (m, 3) bounds, as of the last `refit`.
        status: OUTSIDE, INSIDE or NEAR for each node.
        front_to_back: the nodes that aren't outside, by the distance of their boxes from the eye, of equally
            near boxes by that of their centres. place: the index of each of these nodes in it.
        first, count: (m,) for each node its run of `order`, which holds the rows of all objects.
        tight: node after node, the nodes whose boxes fit it more closely: nodes below it, or the node itself.
        tight_sizes: (m,) the number of these for each node.
    """

    def __init__(self, scene: Scene, leaf_size: int = 1) -> None:
        self._objects = objects = scene.objects
        self._leaf_size = leaf_size
        self._tightest = TightestBoxes(scene)
        self._in_view = np.ones(len(objects), bool)
        kinds = ((objects.fixed_indices, build_by_area), (objects.following_indices, build_by_middle))
        self._trees = [
            (object_indices, build(objects.lower[object_indices], objects.upper[object_indices], leaf_size=1))
            for object_indices, build in kinds
            if len(object_indices)
        ]
        *roots, count = np.cumsum([0, *(len(tree) for _, tree in self._trees)]).tolist()
        self.roots: list[int] = roots
        self.moving = slice(roots[-1] if len(objects.following_indices) else count, count)
        self.lower: Floats = np.zeros((3, count)).T  # columns are contiguous
        self.upper: Floats = np.zeros((3, count)).T
        self._number()
        for (_, tree), root in zip(self._trees, roots, strict=True):
            self.lower[root : root + len(tree)], self.upper[root : root + len(tree)] = tree.lower, tree.upper
        self._built_cost = self._compute_cost()
        self._compute_tight_bounds()
        self.status = bytes(count)
        self._front_to_back, self._rank = np.zeros((2, count), np.int64)
        self.front_to_back, self.rank = self._front_to_back.data, self._rank.data

    def __len__(self) -> int:
        return len(self.parent)

    def refit(self) -> bool:
        """Update the bounds of the moving objects' nodes. Return whether a `rebuild` is worth its time:
        whether the tree's cost, the sum of its nodes' surfaces over its root's, has grown by a factor of
        REBUILD_RATIO."""
        if self.moving.start == self.moving.stop:
            return False
        object_indices, tree = self._trees[-1]
        self.lower[self.moving], self.upper[self.moving] = tree.refit_bounds(
            self._objects.lower[object_indices], self._objects.upper[object_indices]
        )
        return self._compute_cost() > REBUILD_RATIO * self._built_cost

    def rebuild(self) -> None:
        """Build the tree of the moving objects anew, as they are now. Its nodes get other objects; their
        number stays the same."""
        object_indices, _ = self._trees[-1]
        tree = build_by_middle(
            self._objects.lower[object_indices], self._objects.upper[object_indices], leaf_size=1
        )
        self._trees[-1] = (object_indices, tree)
        self.lower[self.moving], self.upper[self.moving] = tree.lower, tree.upper
        self._number()
        self._built_cost = self._compute_cost()
        self._compute_tight_bounds()

    def update(self, camera: Camera, size: tuple[int, int] = UNKNOWN_SIZE) -> QueryBoxes:
        """Update status and order of all nodes for `camera`, and return the boxes to query each node by in an
        image of `size`: for a node of one object, the tightest box of that object."""
        lower, upper, eye = self.lower, self.upper, camera.position
        rotated = self._tightest.collect()
        leaves = self._leaf_of[rotated.object_indices]
        boxes = compute_query_boxes(camera, lower, upper, rotated, leaves, size)
        status = select_visible(camera.frustum.planes, lower, upper).astype(np.uint8)
        status[boxes.near & (status == INSIDE)] = NEAR
        if not self._objects.is_shown.all():  # what has nothing below it that is shown counts as outside
            shown_count = np.concatenate([[0], np.cumsum(self._objects.is_shown[self.order])])
            status[shown_count[self.first + self.count] == shown_count[self.first]] = OUTSIDE
        self.status = status.tobytes()
        self._in_view[:] = status[self._leaf_of] != OUTSIDE

        seen = np.flatnonzero(status)
        lower, upper = lower[seen], upper[seen]
        middle = 0.5 * (lower + upper)
        distance, centre = squared_distances(eye, lower, upper), squared_distances(eye, middle, middle)
        nearest_first = seen[np.lexsort((centre, distance))]
        self._front_to_back[: len(seen)] = nearest_first
        self._rank[nearest_first] = np.arange(len(seen))
        return boxes

    def objects(self, nodes: Sequence[int]) -> Indices:
        """Return the indices, ascending, of the objects below `nodes` that are not outside the frustum."""
        object_indices, _ = self.list_objects(nodes)
        object_indices.sort()
        return object_indices

    def list_objects(self, nodes: Sequence[int]) -> tuple[Indices, Indices]:
        """Return the indices of the objects below `nodes` that are not outside the frustum, and for each of
        them the index of its node in `nodes`."""
        selected = np.array(nodes, np.int64)
        counts = self.count[selected]
        tree_index = repeat_each(np.arange(len(selected)), counts)
        object_indices = self.order[
            np.arange(len(tree_index)) + (self.first[selected] - np.cumsum(counts) + counts)[tree_index]
        ]
        seen = self._in_view[object_indices]
        return object_indices[seen], tree_index[seen]

    def _number(self) -> None:
        """Number the nodes of all trees, and find the run and the leaf of each object."""
        parents, children, firsts, counts, orders = [], [], [], [], []
        start = objects = 0
        for object_indices, tree in self._trees:
            parents.append(np.where(tree.parent < 0, -1, tree.parent + start))
            children.append(np.where(tree.child < 0, -1, tree.child + start))
            firsts.append(tree.first + objects)
            counts.append(tree.count)
            orders.append(object_indices[tree.order])
            start, objects = start + len(tree), objects + len(object_indices)
        none = np.zeros(0, np.int64)
        parent, child, self.first, self.count, self.order = (
            np.concatenate([none, *parts]) for parts in (parents, children, firsts, counts, orders)
        )
        self._below: Indices = child  # of all inner nodes, also below the leaves of the traversal
        single = np.flatnonzero(child < 0)
        row = np.full(len(child), -1)
        row[single] = self.order[self.first[single]]
        self._leaf_of: Indices = np.zeros(objects, np.int64)
        self._leaf_of[row[single]] = single
        self.parent: list[int] = parent.tolist()
        self.child: list[int] = np.where(self.count <= self._leaf_size, -1, child).tolist()
        self.object_index: list[int] = row.tolist()

    def _compute_cost(self) -> float:
        """Find the sum of the surfaces of the moving objects' nodes over that of their root."""
        areas = _areas(self.lower[self.moving], self.upper[self.moving])
        return float(areas.sum() / areas[0]) if len(areas) and areas[0] > 0.0 else 1.0

    def _compute_tight_bounds(self) -> None:
        """Find each node's tight bounds (CHC++, section 6).

        These are the nodes up to 3 levels below it, as long as the sum of the surfaces of their boxes is at
        most 1.4 times the node's own. They are chosen when a tree is built: any nodes that together cover a
        node give correct results.
        """
        child = self._below
        inner = np.flatnonzero(child >= 0)
        areas = _areas(self.lower, self.upper)
        levels = np.zeros(len(areas), np.int64)
        fits = np.ones(len(areas), bool)
        below = areas
        for _ in range(_MAX_TIGHT_DEPTH):
            deeper = below.copy()
            deeper[inner] = below[child[inner]] + below[child[inner] + 1]
            fits &= deeper <= _MAX_TIGHT_GROWTH * areas
            levels += fits
            below = deeper
        nodes = np.arange(len(areas))
        owners = nodes
        for level in range(_MAX_TIGHT_DEPTH):
            opened = (levels[owners] > level) & (child[nodes] >= 0)
            copies = np.where(opened, 2, 1)
            second = np.concatenate([nodes[:0], np.cumsum(copies)])[np.flatnonzero(opened)] - 1
            nodes = repeat_each(np.where(opened, child[nodes], nodes), copies)
            nodes[second] += 1
            owners = repeat_each(owners, copies)
        self.tight: Indices = nodes
        self.tight_sizes: Indices = count_indices(owners, minlength=len(areas))


class Frontier:
    """The nodes that a traversal still has to visit, of all trees of a forest together; `pop` returns the
    nearest one.

    Whatever hides the nearest point of a box is nearer itself. So when a node is popped, all that may hide it
    entirely has been popped before, in whichever tree it is. Only what has become visible since then comes
    later.

    A node is a flag at its place in the forest's order from front to back: the memory is of fixed size, and
    the next node is found by one search through bytes.
    """

    __slots__ = ("_count", "_first", "_flags", "_forest")

    def __init__(self, forest: Forest) -> None:
        self._forest = forest
        self._flags = bytearray(len(forest))
        self._first = self._count = 0  # no flag is set before `_first`

    def begin(self) -> None:
        """Remove all nodes and add the roots, after an update of the forest."""
        forest, flags = self._forest, self._flags
        if self._count:  # left by a frame that raised
            flags[:] = bytes(len(flags))
        self._first, self._count = len(flags), 0
        for root in forest.roots:
            if forest.status[root]:
                self._add(root)

    def open(self, node: int) -> None:
        """Add those children of an inner node that aren't outside the frustum."""
        forest = self._forest
        child, status = forest.child[node], forest.status
        if status[child]:
            self._add(child)
        if status[child + 1]:
            self._add(child + 1)

    def pop(self) -> int:
        """Remove the nearest node and return it. There must be one."""
        rank = self._flags.index(1, self._first)
        self._flags[rank] = 0
        self._first = rank
        self._count -= 1
        node: int = self._forest.front_to_back[rank]
        return node

    def _add(self, node: int) -> None:
        rank = self._forest.rank[node]
        self._flags[rank] = 1
        self._count += 1
        if rank < self._first:
            self._first = rank

    def __len__(self) -> int:
        return self._count


def _areas(lower: Floats, upper: Floats) -> Floats:
    """Return half the surfaces (n,) of boxes (n, 3)."""
    size = np.minimum(upper - lower, 1e100)
    return np.asarray((size * np.roll(size, 1, axis=1)).sum(axis=1))
