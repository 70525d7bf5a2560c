"""Rays and triangles: a tree of boxes, and the triangles that many rays meet, computed together.

Triangles are put in an order in which each half, quarter and so on is on one side of the other. Four
neighbours make a leaf and eight nodes the next one above, so that the tree is nothing but an array of boxes
for each level. Pairs of a bundle of neighbouring rays and a node go down it level by level, all together;
those whose rays all miss the box are left out. At the leaves each ray goes on alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

_LEAF: Final = 4
_WIDTH: Final = 8
_CHUNK: Final = 1 << 13
"""Rays that traverse the tree together: some hundred pairs each fit into a cache."""
_BUNDLE: Final = 16
"""The most consecutive rays that descend the tree together, up to its leaves."""
_TURN: Final = 0.05
"""The change of direction from ray to ray, as a fraction, at which a bundle ends."""
_EDGE: Final = 1e-12
"""The fraction by which triangles are enlarged, so that no ray falls between two."""


@dataclass(frozen=True, eq=False, slots=True)
class Hits:
    """Hits of rays with triangles, all (k,): the indices of both, the distance in lengths of the ray's
    direction, and the weights of the second and the third corner."""

    ray: Indices
    triangle: Indices
    distance: Floats
    second: Floats
    third: Floats

    def take(self, selection: NDArray[np.bool_] | Indices) -> Hits:
        """The selected hits."""
        return Hits(*(getattr(self, name)[selection] for name in self.__slots__))


class TriangleTree:
    """Triangles in a tree; `corners` are (m, 3, 3).

    Attributes:
        order: (m,) the triangles in the order of the leaves.
    """

    def __init__(self, corners: Floats, order: Indices | None = None) -> None:
        """Build a tree. With the `order` of a tree of the same triangles elsewhere, boxes are fitted to it: hits
        are the same for any order, and most of the time goes into sorting."""
        self.order = _sort(corners.mean(axis=1)) if order is None else order
        # Coordinates lie apart: a gather of one is several times as fast as one of three.
        first, second, third = np.ascontiguousarray(corners[self.order].transpose(1, 2, 0))
        self._origin, self._side_a, self._side_b = first, second - first, third - first
        lower = np.minimum(np.minimum(first, second), third)
        upper = np.maximum(np.maximum(first, second), third)
        self._levels = [_group(lower, upper, _LEAF)]
        while self._levels[-1][0].shape[1] > _WIDTH:
            self._levels.append(_group(*self._levels[-1], _WIDTH))
        lower, upper = self._levels[0]
        self._leaf_size = float(np.median((upper - lower).max(axis=0)))

    def intersect(self, origins: Floats, directions: Floats, first: Floats, last: Floats) -> Hits:
        """All hits of rays (n, 3) with triangles at distances from `first` to `last` (n,)."""
        hit_batches = [
            self._traverse(
                np.arange(begin, min(begin + _CHUNK, len(origins))), origins, directions, first, last
            )
            for begin in range(0, max(len(origins), 1), _CHUNK)
        ]
        return Hits(
            *(np.concatenate([getattr(batch, name) for batch in hit_batches]) for name in Hits.__slots__)
        )

    def _traverse(
        self, rays: Indices, origins: Floats, directions: Floats, first: Floats, last: Floats
    ) -> Hits:
        begin, end = int(rays[0]) if len(rays) else 0, int(rays[-1]) + 1 if len(rays) else 0
        starts, slopes = origins[begin:end].T.copy(), directions[begin:end].T.copy()
        first, last = first[begin:end], last[begin:end]
        inverse = 1.0 / np.where(slopes == 0.0, 1e-290, slopes)
        begins = self._divide_into_bundles(starts, slopes)
        bundle, node = self._enter_leaves(begins, starts, inverse, first, last)
        counts = np.diff(begins, append=len(rays))[bundle]
        ray = np.repeat(begins[bundle] - (np.cumsum(counts) - counts), counts) + np.arange(counts.sum())
        node = np.repeat(node, counts)
        lower, upper = self._levels[0]
        enters, leaves = first[ray], last[ray]
        for axis in range(3):
            start, slope = starts[axis][ray], inverse[axis][ray]
            to_lower, to_upper = (lower[axis][node] - start) * slope, (upper[axis][node] - start) * slope
            np.maximum(enters, np.minimum(to_lower, to_upper), out=enters)
            np.minimum(leaves, np.maximum(to_lower, to_upper), out=leaves)
        entered = np.flatnonzero(enters <= leaves + _EDGE * np.abs(leaves))
        triangle = _list_children(node[entered], _LEAF)
        ray = np.repeat(ray[entered], _LEAF)
        exists = triangle < self._origin.shape[1]
        hits = self._intersect(ray[exists], triangle[exists], starts, slopes, first, last)
        return Hits(hits.ray + begin, hits.triangle, hits.distance, hits.second, hits.third)

    def _divide_into_bundles(self, starts: Floats, slopes: Floats) -> Indices:
        """The first ray of each bundle: of at most `_BUNDLE` rays that begin and point alike.

        Args:
            starts, slopes: the rays' origins and directions, (3, n).
        """
        apart = np.abs(np.diff(starts, axis=1)).max(axis=0) > self._leaf_size
        apart |= np.abs(np.diff(slopes, axis=1)).max(axis=0) > _TURN * np.abs(slopes[:, 1:]).max(axis=0)
        is_first = np.ones(starts.shape[1], bool)
        is_first[1:] = apart
        is_first[::_BUNDLE] = True
        return np.flatnonzero(is_first)

    def _enter_leaves(
        self, begins: Indices, starts: Floats, inverse: Floats, first: Floats, last: Floats
    ) -> tuple[Indices, Indices]:
        """The pairs of a bundle of rays and a leaf whose box some of them may enter.

        Interval arithmetic: a bundle meets a slab no earlier and no later than any combination of the least and
        greatest start and slope of its rays.

        Args:
            begins: the first ray of each bundle.
            starts, inverse: the rays' origins, and the inverses of their directions, (3, n).
        """
        if not len(begins):
            return np.zeros(0, np.int64), np.zeros(0, np.int64)
        least_start, least_slope = (np.minimum.reduceat(array, begins, axis=1) for array in (starts, inverse))
        most_start, most_slope = (np.maximum.reduceat(array, begins, axis=1) for array in (starts, inverse))
        earliest, latest = np.minimum.reduceat(first, begins), np.maximum.reduceat(last, begins)
        top = self._levels[-1][0].shape[1]
        bundle, node = np.repeat(np.arange(len(begins)), top), np.tile(np.arange(top), len(begins))
        for level in range(len(self._levels) - 1, -1, -1):
            lower, upper = self._levels[level]
            enters, leaves = earliest[bundle], latest[bundle]
            for axis in range(3):
                near = lower[axis][node] - most_start[axis][bundle]
                far = upper[axis][node] - least_start[axis][bundle]
                low, high = least_slope[axis][bundle], most_slope[axis][bundle]
                times = near * low, near * high, far * low, far * high
                np.maximum(enters, np.minimum.reduce(times), out=enters)
                np.minimum(leaves, np.maximum.reduce(times), out=leaves)
            entered = np.flatnonzero(enters <= leaves + _EDGE * np.abs(leaves))
            bundle, node = bundle[entered], node[entered]
            if level:
                bundle, node = np.repeat(bundle, _WIDTH), _list_children(node, _WIDTH)
                exists = node < self._levels[level - 1][0].shape[1]
                bundle, node = bundle[exists], node[exists]
        return bundle, node

    def _intersect(
        self,
        ray: Indices,
        triangle: Indices,
        starts: Floats,
        slopes: Floats,
        first: Floats,
        last: Floats,
    ) -> Hits:
        """The pairs of a ray and a triangle that meet (Möller and Trumbore 1997).

        Args:
            starts, slopes: the rays' origins and directions, (3, n).
        """
        direction = [slopes[axis][ray] for axis in range(3)]
        side_a = [self._side_a[axis][triangle] for axis in range(3)]
        side_b = [self._side_b[axis][triangle] for axis in range(3)]
        across = _cross(direction, side_b)
        volume = _dot(side_a, across)
        away = [starts[axis][ray] - self._origin[axis][triangle] for axis in range(3)]
        with np.errstate(divide="ignore", invalid="ignore"):
            second = _dot(away, across) / volume
        # Most pairs end here, before the other half of the work.
        near = np.flatnonzero((second >= -_EDGE) & (second <= 1.0 + 2.0 * _EDGE))
        ray, triangle, volume, second = ray[near], triangle[near], volume[near], second[near]
        direction, side_a, side_b, away = (
            [array[near] for array in vector] for vector in (direction, side_a, side_b, away)
        )
        turned = _cross(away, side_a)
        with np.errstate(divide="ignore", invalid="ignore"):
            third, distance = _dot(direction, turned) / volume, _dot(side_b, turned) / volume
            met = (third >= -_EDGE) & (second + third <= 1.0 + _EDGE)
            met &= (distance >= first[ray]) & (distance <= last[ray])
        return Hits(ray[met], self.order[triangle[met]], distance[met], second[met], third[met])

    def are_occluded(
        self, origins: Floats, directions: Floats, last: Floats, blocks: Callable[[Hits], NDArray[np.bool_]]
    ) -> NDArray[np.bool_]:
        """The mask of rays (n, 3) that meet a triangle before `last` (n,) that stops light, as `blocks` tells."""
        hits = self.intersect(origins, directions, np.zeros(len(origins)), last)
        blocked = np.zeros(len(origins), bool)
        blocked[hits.ray[blocks(hits)]] = True
        return blocked


def _list_children(nodes: Indices, width: int) -> Indices:
    """The indices of `width` children of each node, whether they exist or not."""
    return np.asarray((nodes[:, None] * width + np.arange(width)).reshape(-1))


def _group(lower: Floats, upper: Floats, width: int) -> tuple[Floats, Floats]:
    """The boxes (3, k) around each `width` boxes (3, n)."""
    begins = np.arange(0, lower.shape[1], width)
    return np.minimum.reduceat(lower, begins, axis=1), np.maximum.reduceat(upper, begins, axis=1)


def _sort(median_of: Floats) -> Indices:
    """An order of points (m, 3): halves, quarters and so on, each divided along its longest side."""
    order = np.arange(len(median_of))
    size = _LEAF << max(int(np.ceil(np.log2(max(len(median_of) / _LEAF, 1.0)))), 0)
    while size > _LEAF:
        points, group = median_of[order], np.arange(len(median_of)) // size
        begins = np.arange(0, len(median_of), size)
        sides = np.maximum.reduceat(points, begins, axis=0) - np.minimum.reduceat(points, begins, axis=0)
        along = points[np.arange(len(median_of)), sides.argmax(axis=1)[group]]
        order = order[np.lexsort([along, group])]
        size //= 2
    return order


def _dot(a: Sequence[Floats], b: Sequence[Floats]) -> Floats:
    """The dot products (k,) of vectors whose coordinates lie apart."""
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


def _cross(a: Sequence[Floats], b: Sequence[Floats]) -> list[Floats]:
    """The cross products of vectors whose coordinates lie apart."""
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
