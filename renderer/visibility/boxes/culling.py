"""Tests of boxes against planes, on arrays (thesis 6.1): by brute force, and through a hierarchy.

A box is outside when its p-vertex (the corner farthest along the normal) lies behind some plane: `(x n_x + y
n_y) + z n_z < -d` in float64, evaluated in this order. Both ways end in this test, so they find exactly the
same set: nodes are tested with a margin wider than the rounding of either way, and what the margin leaves
undecided is passed down to the boxes.

The hierarchy is traversed breadth first; a level is a few array operations over all remaining nodes. Nodes
are wide, because a NumPy call costs as much as a hundred boxes: the levels are cuts through the binary
hierarchy, and the last level is the boxes themselves. The optimisations of the thesis, which works node by
node, become:

- *Last culling plane first* (6.1.2): the first cut is kept sorted by the plane that culled each node last. A
  group is then a slice, which is tested against its one plane without gathering anything. Only nodes that
  pass, few more than those in view, are tested against the other planes.
- *Plane masking* (6.1.3): below the first cut, (node, plane) pairs are tested: one for each plane that the
  node's n-vertex lies behind, so that the node crosses it. All children of the node are tested side by side.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from typing import Final

import numpy as np
from numpy.typing import NDArray

from renderer.scene.arrays import Floats, Indices
from renderer.visibility.boxes.hierarchy import MAX_COORDINATE, Hierarchy
from rhi.math.indexing import count_indices, reduce_runs, repeat_each

Bits = NDArray[np.uint8]
"""A set of planes for each box: bit p is plane p. `_OUTSIDE` marks a box that some plane culls."""

_GROUPS: Final = (8, 64)  # least and greatest number of boxes in a node of the last cut
_NODES: Final = 1024  # number of nodes aimed for between these limits
_WIDEST: Final = 8192  # number of nodes in the first cut above which a coarser cut is added
_WIDTH: Final = 64  # nodes of a cut for each node of the cut above
_STALE: Final = 16  # the first cut is sorted again when one node in this many changes its culling plane
_MAX_PLANES: Final = 7
_OUTSIDE: Final = np.uint8(1 << _MAX_PLANES)
_BIT: Final = np.left_shift(1, np.arange(_MAX_PLANES)).astype(np.uint8)
_WEIGHTS: Final = [np.append(np.full(p, _OUTSIDE), _BIT[:p])[:, None] for p in range(_MAX_PLANES + 1)]
_LOWER: Final = np.arange(3)[:, None]  # rows of the lower corner among the six numbers of a box
_UPPER: Final = _LOWER + 3
_MEMBERS: Final = (np.arange(1 << _MAX_PLANES)[:, None] & _BIT) != 0  # (128, 7) each set of planes as flags
_SIZES: Final = _MEMBERS.sum(axis=1)
_MARGIN: Final = 64.0 * float(np.finfo(np.float64).eps)  # of the terms' sum; each way rounds by 8 eps at most


@dataclass(frozen=True, slots=True)
class CullingCounts:
    """The cost of culling: numbers of nodes and objects tested, and of (box, plane) pairs in all."""

    nodes: int = 0
    objects: int = 0
    planes: int = 0

    def __add__(self, other: CullingCounts) -> CullingCounts:
        return CullingCounts(
            self.nodes + other.nodes, self.objects + other.objects, self.planes + other.planes
        )


def select_visible(planes: Floats, lower: Floats, upper: Floats) -> NDArray[np.bool_]:
    """Return which boxes (n, 3) are not outside any of `planes` (p, 4), (n,) bool, by testing all against
    all.

    Fastest when each column is contiguous, as in the transpose of a (3, n) array.
    """
    visible = np.empty(len(lower), bool)
    visible.fill(True)
    below, above = lower.T, upper.T
    for x, y, z, d in planes.tolist():
        distance = (above if x > 0.0 else below)[0] * x
        distance += (above if y > 0.0 else below)[1] * y
        distance += (above if z > 0.0 else below)[2] * z
        visible &= distance >= -d
    return visible


class BruteForceCuller:
    """Culls boxes by brute force, where there are so few that a hierarchy would take longer to traverse.

    One product of matrices gives the distances of all p-vertices from all planes. It rounds otherwise than
    `select_visible`, which decides what lies within a margin of a plane.
    """

    def __init__(self, lower: Floats, upper: Floats) -> None:
        self._lower, self._upper = (np.ascontiguousarray(corner.T).T for corner in (lower, upper))
        corners = np.concatenate([lower.T, upper.T, np.ones((1, len(lower)))])
        self._corners = np.ascontiguousarray(corners)  # (7, n)
        self._largest = float(np.abs(corners).sum(axis=0).max(initial=0.0))
        self._is_finite = isfinite(self._largest)

    def select_visible(self, planes: Floats) -> tuple[Indices, CullingCounts]:
        """Return the indices, ascending, of the boxes that are not outside any of `planes` (p, 4), and the
        cost."""
        count = len(self._lower)
        visible = self._select_surely(planes) if self._is_finite else None
        if visible is None:
            visible = select_visible(planes, self._lower, self._upper).nonzero()[0]
        return visible, CullingCounts(0, count, count * len(planes))

    def _select_surely(self, planes: Floats) -> Indices | None:
        """Return the boxes that are not outside; None if a box is so near a plane that rounding decides."""
        weights = np.empty((len(planes), 7))
        normals = planes[:, :3]
        np.minimum(normals, 0.0, out=weights[:, :3])
        np.maximum(normals, 0.0, out=weights[:, 3:6])
        weights[:, 6] = planes[:, 3]
        margin = _MARGIN * (self._largest + max(map(abs, planes[:, 3].tolist())))
        nearest = np.minimum.reduce(weights.dot(self._corners), axis=0)
        visible = (nearest >= margin).nonzero()[0]
        return visible if np.count_nonzero(nearest >= -margin) == len(visible) else None


class HierarchyCuller:
    """Culls the boxes of one hierarchy frame after frame, and remembers which plane culled each node."""

    def __init__(self, hierarchy: Hierarchy, lower: Floats, upper: Floats) -> None:
        self._order = hierarchy.order.astype(np.int32 if len(hierarchy.order) < 2**31 else np.int64)
        total = len(self._order)
        sizes = [min(max(total // _NODES, _GROUPS[0]), _GROUPS[1])]
        while total > _WIDEST * sizes[0]:
            sizes.insert(0, sizes[0] * _WIDTH)
        cuts = [hierarchy.cut(size) for size in sizes]
        firsts = [*(hierarchy.first[cut] for cut in cuts), np.arange(total)]
        bounds = [*((hierarchy.lower[cut], hierarchy.upper[cut]) for cut in cuts)]
        bounds.append((lower[self._order], upper[self._order]))
        self._runs = [np.append(first, total) for first in firsts]
        self._groups = _Groups(*bounds[0])
        self._blocks = [
            _Blocks(*bounds[level], np.searchsorted(firsts[level], self._runs[level - 1]))
            for level in range(1, len(bounds))
        ]

    def select_visible(self, planes: Floats) -> tuple[Indices, CullingCounts]:
        """Return the indices, ascending, of the boxes that are not outside any of `planes` (p, 4), and the
        cost.

        There are at most 7 planes, with unit normals.
        """
        tables = _Tables(planes)
        nodes, across, tested, pairs = self._groups.test(tables)
        parts: list[Indices] = []
        objects = 0
        for runs, blocks in zip(self._runs, self._blocks, strict=False):
            tested += objects
            inside = nodes.take((across == 0).nonzero()[0])
            parts.append(_expand(runs.take(inside), runs.take(inside + 1)))
            crossing = across.nonzero()[0]
            nodes, across = nodes.take(crossing), across.take(crossing)
            nodes, across, objects, more = blocks.test(tables, nodes, across, blocks is self._blocks[-1])
            pairs += more
        parts.append(nodes)
        visible = self._order.take(np.concatenate(parts))
        visible.sort()  # takes half the time with 32 bits
        return visible.astype(np.int64), CullingCounts(tested, objects, pairs)


class _Tables:
    """The planes of a frame as tables: which coordinates of a box to gather, and what to multiply them by."""

    def __init__(self, planes: Floats) -> None:
        self.planes = planes
        self.normals = planes.T[:3].copy()
        self.limits = -planes[:, 3]
        self.far = np.where(self.normals > 0.0, _UPPER, _LOWER)  # the rows of each plane's p-vertex
        self.weights = _WEIGHTS[len(planes)]

    @property
    def near(self) -> Indices:
        """The rows of each plane's n-vertex: on each axis the corner that the p-vertex does not use."""
        return (_LOWER + _UPPER) - self.far


class _Groups:
    """The nodes of the first cut, sorted by the plane that culled each node last.

    Attributes:
        nodes: (m,) the node of the cut that each column holds.
        corners: (7, m) lower corner, upper corner and 1 of each node.
        last: (m,) the plane that culled each node, as of the last sort.
        starts: where each plane's slice begins.
        reach: the sum of the largest absolute coordinates; an upper bound of the terms of a distance.
    """

    def __init__(self, lower: Floats, upper: Floats) -> None:
        self.nodes: Indices = np.arange(len(lower))
        self.corners = np.ones((7, len(lower)))
        self.corners[:3], self.corners[3:6] = lower.T, upper.T
        self.last = np.zeros(len(lower), np.uint8)
        self.reach = np.maximum(np.abs(lower), np.abs(upper)).max(axis=0, initial=0.0).sum()
        self._update_starts()

    def test(self, tables: _Tables) -> tuple[Indices, Bits, int, int]:
        """Return the nodes that are not outside, the planes that each of them crosses, and the numbers of
        nodes and of (node, plane) pairs tested."""
        count = len(tables.planes)
        matrix = self._make_matrix(tables.planes)
        distance = np.empty(len(self.nodes))
        for plane in range(count):
            start, end = self.starts[plane], self.starts[plane + 1]
            if start < end:
                np.matmul(matrix[plane], self.corners[:, start:end], out=distance[start:end])
        distance[self.starts[count] :] = 0.0  # culled last by a plane that this frame doesn't have
        columns = (distance >= 0.0).nonzero()[0]

        behind = np.matmul(matrix, self.corners.take(columns, axis=1)) < 0.0
        bits = np.bitwise_or.reduce(behind * tables.weights)
        passing = (bits < _OUTSIDE).nonzero()[0]
        nodes = self.nodes.take(columns.take(passing))
        if _STALE * (len(columns) - len(passing)) > len(self.nodes):
            outside = (bits >= _OUTSIDE).nonzero()[0]
            self._sort(columns.take(outside), behind[:count].take(outside, axis=1).argmax(axis=0))
        return nodes, bits.take(passing), len(self.nodes), len(self.nodes) + len(columns) * (count - 1)

    def _make_matrix(self, planes: Floats) -> Floats:
        """Return (2 p, 7) to multiply `corners` by: p-vertices' distances plus the margin, n-vertices' minus
        it."""
        count, offsets = len(planes), planes[:, 3]
        margin = np.abs(offsets)
        margin += self.reach
        margin *= _MARGIN
        matrix = np.empty((2 * count, 7))
        up = np.maximum(planes[:, :3], 0.0, out=matrix[:count, 3:6])
        down = np.minimum(planes[:, :3], 0.0, out=matrix[:count, :3])
        matrix[count:, :3], matrix[count:, 3:6] = up, down
        np.add(offsets, margin, out=matrix[:count, 6])
        np.subtract(offsets, margin, out=matrix[count:, 6])
        return matrix

    def _sort(self, columns: Indices, planes: Indices) -> None:
        """Record that `planes` culled the nodes in `columns`, and sort by plane again."""
        self.last[columns] = planes
        order = np.argsort(self.last, kind="stable")
        self.nodes, self.last = self.nodes.take(order), self.last.take(order)
        self.corners = self.corners.take(order, axis=1)
        self._update_starts()

    def _update_starts(self) -> None:
        self.starts = [0, *np.cumsum(count_indices(self.last, minlength=_MAX_PLANES)).tolist()]


class _Blocks:
    """A level below the first cut: the children of each node above it, side by side, in rows of equal width.

    Attributes:
        corners: (6 b, w) for each of b nodes the children's lower x, then lower y, and so on, padded with
            boxes that every plane culls; w is a multiple of 8, for `_merge`.
        first: (b,) the first child of each node.
        size: (b,) the number of its children.
    """

    def __init__(self, lower: Floats, upper: Floats, starts: Indices) -> None:
        self.first, self.size = starts[:-1].copy(), np.diff(starts)
        self.width = -(-int(self.size.max(initial=1)) // 8) * 8
        lane = np.arange(self.width)
        child = np.minimum(self.first[:, None] + lane, max(len(lower) - 1, 0))
        unused = (lane >= self.size[:, None])[..., None]
        corners = (
            np.where(unused, MAX_COORDINATE, lower[child]),
            np.where(unused, -MAX_COORDINATE, upper[child]),
        )
        blocks = np.concatenate(corners, axis=2).transpose(0, 2, 1)
        self.corners = np.ascontiguousarray(blocks).reshape(6 * len(self.first), self.width)

    def test(
        self, tables: _Tables, nodes: Indices, across: Bits, last: bool
    ) -> tuple[Indices, Bits, int, int]:
        """Test the children of `nodes` (k,) against the planes `across` (k,) that their node crosses.

        Return the children that are not outside, the planes that each of them crosses (not computed for the
        `last` level, which has nothing below it), and the numbers of children and of pairs tested.
        """
        flat = _MEMBERS.take(across, axis=0).reshape(-1).nonzero()[0]
        above = flat // _MAX_PLANES
        plane = flat - above * _MAX_PLANES
        node = nodes.take(above)
        limits = tables.limits.take(plane)[:, None]
        normals = tables.normals.take(plane, axis=1)[:, :, None]
        bits = self._behind_mask(tables.far, normals, node, plane, limits).view(np.uint8)
        if not last:
            bits = bits * _OUTSIDE
            bits |= self._behind_mask(tables.near, normals, node, plane, limits) * _BIT.take(plane)[:, None]
        pairs = _SIZES.take(across)
        if len(above) > len(nodes):
            bits = _merge(bits, pairs.cumsum() - pairs)
        bits = bits.reshape(-1)
        passing = (bits < (1 if last else _OUTSIDE)).nonzero()[0]
        row = passing // self.width
        children = self.first.take(nodes.take(row))
        children += passing
        children -= row * self.width
        size = self.size.take(nodes)
        return children, bits if last else bits.take(passing), int(np.add.reduce(size)), int(size.dot(pairs))

    def _behind_mask(
        self, columns: Indices, normals: Floats, node: Indices, plane: Indices, limits: Floats
    ) -> NDArray[np.bool_]:
        """Return (pairs, w) bool: whether the corners of the children that `columns` selects lie behind the
        plane."""
        rows = columns.take(plane, axis=1)
        rows += 6 * node
        products = self.corners.take(rows, axis=0)
        products *= normals
        total: Floats = products[0]
        total += products[1]
        total += products[2]
        return total < limits


def _merge(bits: Bits, starts: Indices) -> Bits:
    """Return the `bitwise_or` of the rows from each start to the next, computed on eight bytes at a time."""
    return reduce_runs(np.bitwise_or, bits.view(np.uint64), starts).view(np.uint8)


def _expand(first: Indices, end: Indices) -> Indices:
    """Return the ranges first[0] to end[0], first[1] to end[1], and so on, concatenated."""
    count = end - first
    last = count.cumsum()
    first = first - last
    first += count
    run = repeat_each(first, count)
    run += np.arange(len(run))
    return run
