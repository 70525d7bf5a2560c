"""Rays and triangles: a tree of boxes, and the triangles that many rays meet at once.

Triangles are put in an order in which each half, quarter and so on is on one side of the other. Four neighbours make a
leaf and eight nodes the next one above, so that the tree is nothing but an array of boxes for each level. Pairs of a
ray and a node go down it level by level, all rays together; those whose ray misses the box are left out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Rows = NDArray[np.int64]

_LEAF: Final = 4
_WIDTH: Final = 8
_CHUNK: Final = 1 << 13
"""Rays that go down the tree together: some hundred pairs each fit into a cache."""
_EDGE: Final = 1e-12
"""The share of a triangle by which it is larger, so that no ray falls between two."""


@dataclass(frozen=True, eq=False, slots=True)
class Hits:
    """Places where rays meet triangles, all (k,): the rows of both, the distance in lengths of the ray's direction, and
    the shares of the second and the third corner."""

    ray: Rows
    triangle: Rows
    distance: Floats
    second: Floats
    third: Floats

    def take(self, chosen: NDArray[np.bool_] | Rows) -> Hits:
        """Return some of them."""
        return Hits(*(getattr(self, name)[chosen] for name in self.__slots__))


class TriangleTree:
    """Triangles in a tree; `corners` are (m, 3, 3)."""

    def __init__(self, corners: Floats) -> None:
        self._order = _sort(corners.mean(axis=1))
        self._origin = corners[self._order, 0]
        self._sides = corners[self._order, 1:] - corners[self._order, :1]
        lower, upper = corners[self._order].min(axis=1), corners[self._order].max(axis=1)
        self._levels = [_group(lower.T, upper.T, _LEAF)]
        while self._levels[-1][0].shape[1] > _WIDTH:
            self._levels.append(_group(*self._levels[-1], _WIDTH))

    def meet(self, origins: Floats, directions: Floats, first: Floats, last: Floats) -> Hits:
        """Return all places where rays (n, 3) meet triangles at distances from `first` to `last` (n,)."""
        found = [
            self._meet(np.arange(begin, min(begin + _CHUNK, len(origins))), origins, directions, first, last)
            for begin in range(0, max(len(origins), 1), _CHUNK)
        ]
        return Hits(*(np.concatenate([getattr(one, name) for one in found]) for name in Hits.__slots__))

    def _meet(self, rays: Rows, origins: Floats, directions: Floats, first: Floats, last: Floats) -> Hits:
        starts = origins.T.copy()
        inverse = 1.0 / np.where(directions == 0.0, 1e-290, directions).T.copy()
        top = self._levels[-1][0].shape[1]
        ray, node = np.repeat(rays, top), np.tile(np.arange(top), len(rays))
        for level, (lower, upper) in enumerate(reversed(self._levels), 1):
            enters, leaves = first[ray], last[ray]
            for axis in range(3):
                start, slope = starts[axis][ray], inverse[axis][ray]
                one, other = (lower[axis][node] - start) * slope, (upper[axis][node] - start) * slope
                np.maximum(enters, np.minimum(one, other), out=enters)
                np.minimum(leaves, np.maximum(one, other), out=leaves)
            kept = np.flatnonzero(enters <= leaves + _EDGE * np.abs(leaves))
            width = _LEAF if level == len(self._levels) else _WIDTH
            count = len(self._origin) if level == len(self._levels) else self._levels[-level - 1][0].shape[1]
            ray = np.repeat(ray[kept], width)
            node = (node[kept][:, None] * width + np.arange(width)).reshape(-1)
            if len(node) and node.max() >= count:
                ray, node = ray[node < count], node[node < count]
        return self._intersect(ray, node, origins, directions, first, last)

    def _intersect(
        self, ray: Rows, row: Rows, origins: Floats, directions: Floats, first: Floats, last: Floats
    ) -> Hits:
        """Return which pairs of a ray and a triangle meet (Möller and Trumbore 1997)."""
        one, other = self._sides[row, 0], self._sides[row, 1]
        across = np.cross(directions[ray], other)
        volume = _dot(one, across)
        away = origins[ray] - self._origin[row]
        turned = np.cross(away, one)
        with np.errstate(divide="ignore", invalid="ignore"):
            second, third = _dot(away, across) / volume, _dot(directions[ray], turned) / volume
            distance = _dot(other, turned) / volume
            met = (second >= -_EDGE) & (third >= -_EDGE) & (second + third <= 1.0 + _EDGE)
            met &= (distance >= first[ray]) & (distance <= last[ray])
        return Hits(ray[met], self._order[row[met]], distance[met], second[met], third[met])

    def are_blocked(
        self, origins: Floats, directions: Floats, last: Floats, blocks: Callable[[Hits], NDArray[np.bool_]]
    ) -> NDArray[np.bool_]:
        """Return whether rays (n, 3) meet a triangle before `last` (n,) of which `blocks` says that it stops light."""
        hits = self.meet(origins, directions, np.zeros(len(origins)), last)
        blocked = np.zeros(len(origins), bool)
        blocked[hits.ray[blocks(hits)]] = True
        return blocked


def _group(lower: Floats, upper: Floats, width: int) -> tuple[Floats, Floats]:
    """Return the boxes (3, k) around each `width` boxes (3, n)."""
    begins = np.arange(0, lower.shape[1], width)
    return np.minimum.reduceat(lower, begins, axis=1), np.maximum.reduceat(upper, begins, axis=1)


def _sort(middle: Floats) -> Rows:
    """Return an order of points (m, 3): halves, quarters and so on, each divided along its longest side."""
    order = np.arange(len(middle))
    size = _LEAF << max(int(np.ceil(np.log2(max(len(middle) / _LEAF, 1.0)))), 0)
    while size > _LEAF:
        points, group = middle[order], np.arange(len(middle)) // size
        begins = np.arange(0, len(middle), size)
        sides = np.maximum.reduceat(points, begins, axis=0) - np.minimum.reduceat(points, begins, axis=0)
        along = points[np.arange(len(middle)), sides.argmax(axis=1)[group]]
        order = order[np.lexsort([along, group])]
        size //= 2
    return order


def _dot(one: Floats, other: Floats) -> Floats:
    return np.asarray(np.einsum("ij,ij->i", one, other))
