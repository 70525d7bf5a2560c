"""A bounding volume hierarchy as arrays (thesis 5.2.1), built level by level, for all nodes of a level at
once.

Nodes are in breadth-first order: a parent before its children, siblings side by side. The objects of every
node are a run of `order`, so those of a whole subtree are one slice. There are two builders:

- `build_by_area`: the binned surface area heuristic (Wald, 2007), for static objects;
- `build_by_middle`: the spatial median split, in the middle of the longest axis, for moving objects: it is
  built in a sixth to a twentieth of the time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from renderer import rules
from renderer.scene.arrays import Floats, Indices
from rhi.errors import refuse
from rhi.math.indexing import reduce_runs, repeat_each

MAX_COORDINATE: Final = 1e300
"""The largest allowed absolute coordinate of a box, so that distances to planes never overflow."""

_BINS: Final = 16


@dataclass(frozen=True, eq=False, slots=True)
class Hierarchy:
    """A binary tree of m nodes over n boxes; node 0 is the root. Without boxes there are no nodes.

    Attributes:
        lower, upper: (m, 3) float64, the exact bounds of the boxes under each node.
        parent: (m,) int64, -1 for the root.
        child: (m,) int64, the first child, whose sibling is the next node; -1 for leaves.
        first, count: (m,) int64, each node's run of `order`.
        order: (n,) int64, the rows of the boxes, leaf after leaf.
        level_starts: (levels + 1,) int64; level l is the nodes level_starts[l] to level_starts[l + 1].
    """

    lower: Floats
    upper: Floats
    parent: Indices
    child: Indices
    first: Indices
    count: Indices
    order: Indices
    level_starts: Indices

    def __len__(self) -> int:
        return len(self.parent)

    def refit_bounds(self, lower: Floats, upper: Floats) -> tuple[Floats, Floats]:
        """Return the bounds (m, 3) of the nodes for boxes (n, 3) that have moved; the tree stays the same."""
        return _node_bounds(
            lower[self.order], upper[self.order], self.first, self.count, self.child, self.level_starts
        )

    def cut(self, size: int) -> Indices:
        """Return the nodes nearest to the root that have at most `size` boxes or are leaves, in tree order.

        Their runs are consecutive and make up all of `order`.
        """
        small = (self.count <= size) | (self.child < 0)
        small[1:] &= ~small[self.parent[1:]]  # nodes below a small node are small
        nodes = np.flatnonzero(small)
        return nodes[np.argsort(self.first[nodes])]


def check_bounds(call: str, lower: Floats, upper: Floats) -> None:
    """Refuse bounds that are not boxes (n, 3) of finite size."""
    if lower.ndim != 2 or lower.shape[1] != 3 or upper.shape != lower.shape:
        refuse(rules.BAD_BOUNDS, call, f"shapes {lower.shape} and {upper.shape}", "(n, 3)")
    if not ((np.abs(lower) <= MAX_COORDINATE).all() and (np.abs(upper) <= MAX_COORDINATE).all()):
        refuse(
            rules.BAD_BOUNDS, call, "a value that is not finite, or too large", f"at most {MAX_COORDINATE:g}"
        )
    if (lower > upper).any():
        refuse(rules.BAD_BOUNDS, call, f"box {int(np.flatnonzero((lower > upper).any(1))[0])} inside out")


def build_by_area(lower: Floats, upper: Floats, leaf_size: int = 4) -> Hierarchy:
    """Build a hierarchy over boxes (n, 3) that minimises the expected number of tests, in O(n log n).

    A node is split at the one of 15 planes on each axis for which the sum over both halves of area times
    count is least. Beyond twice the depth of a balanced tree, and where all centres coincide, the halves have
    equal counts, which limits the depth for any input.
    """
    check_bounds("build_by_area", lower, upper)
    limit = _limit_depth(len(lower))
    return _build(lower, upper, leaf_size, lambda work: work.split_by_area(work.depth < limit))


def build_by_middle(lower: Floats, upper: Floats, leaf_size: int = 4) -> Hierarchy:
    """Build a hierarchy over boxes (n, 3), split in the middle of the longest axis of the centres, in O(n log
    n).

    Like `build_by_area`, it is limited to about twice the depth of a balanced tree.
    """
    check_bounds("build_by_middle", lower, upper)
    limit = _limit_depth(len(lower))
    return _build(lower, upper, leaf_size, lambda work: work.split_in_middle(work.depth < limit))


def _limit_depth(boxes: int) -> int:
    return 2 * int(np.ceil(np.log2(max(boxes, 2)))) + 4


class _SplitState:
    """The nodes of one level that are still being split; `order` holds their boxes, run after run.

    Attributes:
        order: (k,) rows of the boxes.
        first, count: (g,) the nodes' runs of it.
        owner: (k,) the node of each box.
        lower, upper, centre: (k, 3) corners and centres of the boxes in that order, in units of the root box.
    """

    def __init__(self, lower: Floats, upper: Floats) -> None:
        # A unit root: no area overflows, none vanishes.
        base = 0.5 * lower.min(0)
        span = max(float((0.5 * upper.max(0) - base).max()), float(np.finfo(np.float64).tiny))
        self.all_lower, self.all_upper = (0.5 * lower - base) / span, (0.5 * upper - base) / span
        self.order = np.arange(len(lower))
        self.first, self.count = np.zeros(1, np.int64), np.array([len(lower)])
        self.depth = 0
        self._sort(self.order)

    def _sort(self, order: Indices) -> None:
        self.order = order
        self.lower, self.upper = self.all_lower[order], self.all_upper[order]
        self.centre = 0.5 * (self.lower + self.upper)
        self.owner = repeat_each(np.arange(len(self.count)), self.count)

    def descend(self, first: Indices, count: Indices, boxes: Indices) -> None:
        """Go on to the children that are split further: the boxes `boxes`, in runs (first, count)."""
        self.first, self.count = np.concatenate([[0], np.cumsum(count)[:-1]]), count
        self.depth += 1
        self._sort(self.order[boxes])

    def split_by_median(self) -> Indices:
        """Sort the boxes of each node so that its halves are its children; return the left children's
        counts."""
        extent = self._reduce(np.maximum, self.centre) - self._reduce(np.minimum, self.centre)
        axis = extent.argmax(1)[self.owner]
        key = self.centre[np.arange(len(axis)), axis]
        self._sort(self.order[np.lexsort((key, self.owner))])
        return self.count // 2

    def split_in_middle(self, allowed: bool) -> Indices:
        """Sort like `split_by_median`, but split in the middle of the longest axis; nodes whose centres
        coincide get equal halves."""
        if not allowed:
            return self.split_by_median()
        low, high = self._reduce(np.minimum, self.centre), self._reduce(np.maximum, self.centre)
        groups = np.arange(len(low))
        axis = (high - low).argmax(1)
        low, high = low[groups, axis], high[groups, axis]
        middle = 0.5 * (low + high)
        right = self.centre[np.arange(len(self.owner)), axis[self.owner]] > middle[self.owner]
        return self._divide(right, (low <= middle) & (middle < high))

    def split_by_area(self, allowed: bool) -> Indices:
        """Sort like `split_by_median`, but split at the cheapest plane; nodes without one get equal
        halves."""
        if not allowed:
            return self.split_by_median()
        low, high = self._reduce(np.minimum, self.centre), self._reduce(np.maximum, self.centre)
        width = np.where(high > low, high - low, 1.0)
        bins = (
            ((self.centre - low[self.owner]) / width[self.owner] * _BINS).astype(np.int64).clip(0, _BINS - 1)
        )
        groups = len(self.count)
        best_cost = np.full(groups, np.inf)
        best_axis, best_plane = np.zeros(groups, np.int64), np.zeros(groups, np.int64)
        for axis in range(3):
            cost = self._plane_costs(bins[:, axis])
            plane = cost.argmin(1)
            value = cost[np.arange(groups), plane]
            better = value < best_cost
            best_cost[better], best_axis[better], best_plane[better] = value[better], axis, plane[better]
        has_split = np.isfinite(best_cost)
        right = bins[np.arange(len(bins)), best_axis[self.owner]] > best_plane[self.owner]
        return self._divide(right, has_split)

    def _divide(self, right: NDArray[np.bool_], has_split: NDArray[np.bool_]) -> Indices:
        """Sort the boxes (k,) that go to the right behind the others of their node; return the left
        children's counts.

        Of nodes (g,) without a plane that has boxes on both sides, the upper half of the order goes to the
        right.
        """
        rank = np.arange(len(right)) - self.first[self.owner]
        right = np.where(has_split[self.owner], right, rank >= (self.count // 2)[self.owner])
        self._sort(self.order[np.argsort(2 * self.owner + right, kind="stable")])
        left: Indices = self.count - reduce_runs(np.add, right.astype(np.int64), self.first)
        return left

    def _plane_costs(self, bin_of: Indices) -> Floats:
        """Return the costs (g, 15) of the planes between bins: the sum over both sides of area times count.

        The cost is inf where a side is empty.
        """
        groups = len(self.count)
        cell = self.owner * _BINS + bin_of
        order = np.argsort(cell, kind="stable")
        used, starts = np.unique(cell[order], return_index=True)
        filled = np.zeros(groups * _BINS, np.int64)
        filled[used] = np.diff(np.append(starts, len(cell)))
        lower: Floats = np.full((groups * _BINS, 3), np.inf)
        upper: Floats = np.full((groups * _BINS, 3), -np.inf)
        lower[used] = reduce_runs(np.minimum, self.lower[order], starts)
        upper[used] = reduce_runs(np.maximum, self.upper[order], starts)
        lower, upper = lower.reshape(groups, _BINS, 3), upper.reshape(groups, _BINS, 3)
        left = _areas(np.minimum.accumulate(lower, 1), np.maximum.accumulate(upper, 1))[:, :-1]
        right = _areas(np.minimum.accumulate(lower[:, ::-1], 1), np.maximum.accumulate(upper[:, ::-1], 1))[
            :, -2::-1
        ]
        before = np.cumsum(filled.reshape(groups, _BINS), 1)[:, :-1]
        after = self.count[:, None] - before
        return np.where((before > 0) & (after > 0), left * before + right * after, np.inf)

    def _reduce(self, function: np.ufunc, values: Floats) -> Floats:
        return reduce_runs(function, values, self.first)


def _areas(lower: Floats, upper: Floats) -> Floats:
    """Return half the surface of boxes; 0 for empty ones."""
    x, y, z = np.moveaxis(np.maximum(upper - lower, 0.0), -1, 0)
    return np.asarray(x * y + y * z + z * x)


def _build(
    lower: Floats, upper: Floats, leaf_size: int, split: Callable[[_SplitState], Indices]
) -> Hierarchy:
    """Split all nodes of a level at once until none holds more than `leaf_size` boxes."""
    total = len(lower)
    order: Indices = np.arange(total)
    parents = [np.full(min(total, 1), -1)]
    firsts, counts = [np.zeros(min(total, 1), np.int64)], [np.full(min(total, 1), total)]
    children: list[Indices] = []
    level_first: Indices = firsts[0]
    level_count: Indices = counts[0]
    base, end = 0, len(level_first)
    work = _SplitState(lower, upper) if total > leaf_size else None
    while True:
        inner = np.flatnonzero(level_count > leaf_size)
        child = np.full(len(level_first), -1)
        child[inner] = end + 2 * np.arange(len(inner))
        children.append(child)
        if not len(inner) or work is None:
            break
        left = split(work)
        first, count = level_first[inner], level_count[inner]
        run = repeat_each(first - work.first, count) + np.arange(int(count.sum()))
        order[run] = work.order
        level_first = np.stack([first, first + left], axis=1).reshape(-1)
        level_count = np.stack([left, count - left], axis=1).reshape(-1)
        parents.append(repeat_each(base + inner, 2))
        firsts.append(level_first)
        counts.append(level_count)
        base, end = end, end + len(level_first)
        deeper = level_count > leaf_size
        local = np.cumsum(level_count) - level_count
        deeper_boxes = np.flatnonzero(repeat_each(deeper, level_count))
        work.descend(local[deeper], level_count[deeper], deeper_boxes)
    first, count = np.concatenate(firsts), np.concatenate(counts)
    starts = np.cumsum([0, *(len(level) for level in firsts)])
    node_lower, node_upper = _node_bounds(
        lower[order], upper[order], first, count, np.concatenate(children), starts
    )
    return Hierarchy(
        node_lower, node_upper, np.concatenate(parents), np.concatenate(children), first, count, order, starts
    )


def _node_bounds(
    lower: Floats, upper: Floats, first: Indices, count: Indices, child: Indices, starts: Indices
) -> tuple[Floats, Floats]:
    """Compute the bounds of all nodes: those of leaves from the sorted boxes, all others from their
    children."""
    node_lower, node_upper = np.empty((len(first), 3)), np.empty((len(first), 3))
    leaves = np.flatnonzero(child < 0)
    leaves = leaves[np.argsort(first[leaves])]
    if len(leaves):
        node_lower[leaves] = reduce_runs(np.minimum, lower, first[leaves])
        node_upper[leaves] = reduce_runs(np.maximum, upper, first[leaves])
    for level in range(len(starts) - 2, -1, -1):
        inner = np.flatnonzero(child[starts[level] : starts[level + 1]] >= 0) + starts[level]
        left = child[inner]
        node_lower[inner] = np.minimum(node_lower[left], node_lower[left + 1])
        node_upper[inner] = np.maximum(node_upper[left], node_upper[left + 1])
    return node_lower, node_upper
