"""The history that CHC and CHC++ keep of each node from frame to frame, across rebuilds of the moving objects' tree.

A rebuilt tree has other nodes. What was known of its objects is known of the nodes that hold them now (thesis
5.2.1): visible is a node with a visible object below it.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from renderer.visibility.boxes.forest import Forest
from rhi.math.indexing import reduce_runs

NEVER: Final = -2
"""A frame number for "not visited yet": it is less than that of any last frame."""


class NodeHistory:
    """The visibility of the nodes of a forest, as of the frame in which each was visited last.

    Attributes:
        visible: whether the node was visible.
        visited: the frame in which it was visited.
        hidden_since: the frame since which it was found to be hidden, each time that it was visited.
        next_query: for a visible leaf, the frame in which it is to be queried again.
    """

    def __init__(self, forest: Forest) -> None:
        count = len(forest)
        self.visible = bytearray(count)
        self.visited = [NEVER] * count
        self.hidden_since = [0] * count
        self.next_query = [0] * count
        self._forest = forest

    def refit(self, last: int) -> bool:
        """Refit the forest to the moving objects; `last` is the last frame's number.

        Return whether their tree was rebuilt. What was known is then carried over to its nodes.
        """
        is_worn = self._forest.refit()
        if is_worn:
            self._rebuild(last)
        return is_worn

    def _rebuild(self, last: int) -> None:
        forest, nodes = self._forest, range(*self._forest.moving.indices(len(self._forest)))
        # What is known of each object, in the tree's order: from the lowest node above it that was visited.
        visited, was_visible, since, due = np.zeros((4, len(forest.order)), np.int64)
        for node in nodes:
            if self.visited[node] == last:
                run = slice(forest.first[node], forest.first[node] + forest.count[node])
                is_leaf = forest.child[node] < 0
                was_visible[run] = self.visible[node] and is_leaf
                visited[run] = is_leaf or not self.visible[node]
                since[run], due[run] = self.hidden_since[node], self.next_query[node]
        before = forest.order
        forest.rebuild()
        object_positions = np.zeros(len(before), np.int64)
        object_positions[before] = np.arange(len(before))
        object_positions = object_positions[forest.order]
        first, count = forest.first[forest.moving], forest.count[forest.moving]

        def reduce(function: np.ufunc, values: np.ndarray) -> list[int]:
            ends = np.stack([first, first + count], axis=1).reshape(-1)
            results = reduce_runs(function, np.append(values[object_positions], 0), ends)
            reduced: list[int] = results[::2].tolist()
            return reduced

        self.visible[forest.moving] = bytes(reduce(np.maximum, was_visible))
        self.visited[forest.moving] = [
            last if is_visited else NEVER for is_visited in reduce(np.maximum, visited)
        ]
        self.hidden_since[forest.moving] = reduce(np.maximum, since)
        self.next_query[forest.moving] = reduce(np.minimum, due)
