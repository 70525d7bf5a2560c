"""CHC++, coherent hierarchical culling revisited (thesis 6.4; Mattausch, Bittner and Wimmer, 2008).

CHC with everything in batches:

- *i-queue*: previously invisible nodes are gathered until there are b of them; then the states are changed
  once and all are queried (6.4.2).
- *v-queue*: previously visible leaves are drawn in any case. So they are queried only when there is nothing
  else to do, and the results count in the next frame (6.4.3). If hidden nodes are about to be queried and
  waited for, the leaves are queried in the same call: a call costs more than its queries.
- *render queue*: objects to draw are gathered until a query needs them in the depth buffer (6.4.4).
- *persistence*: a visible leaf is assumed to stay visible for n frames before it is queried again, the first
  time for a random number of frames, so that queries are spread over the frames (6.4.5).
- *multiqueries*: hidden nodes that are likely to stay hidden share a query (6.4.6): see `choose_group_size`.
- *tight bounds*: a node is queried by the boxes of nodes below it where these fit more closely.

The nodes still to be visited (`Frontier`) and the queues have a fixed size (6.5.2, 6.5.3).
"""

from __future__ import annotations

from collections.abc import Sequence
from math import exp
from random import Random
from typing import Final, TypeAlias

import numpy as np

from renderer.scene import Camera, Scene
from renderer.visibility.algorithm import VisibilityStatistics
from renderer.visibility.boxes.forest import NEAR
from renderer.visibility.queries.chc import pull_up
from renderer.visibility.queries.query_culling import TreeCulling
from renderer.visibility.scene_drawer import SceneDrawer
from renderer.visibility.settings import DEFAULTS, VisibilitySettings
from renderer.visibility.traversal import CullingTraversal, forest_traversal
from rhi import Device, FixedQueue, QuerySet

PendingQueries: TypeAlias = tuple[QuerySet, list[list[int]]]
"""A query set in flight, and the nodes that each of its rows is about."""

STAY_HIDDEN_PROBABILITIES: Final = tuple(0.99 - 0.7 * exp(-t) for t in range(16))
"""The probability that a node that was hidden for t frames stays hidden in the next; almost constant from 15
on."""


def choose_group_size(probabilities: Sequence[float]) -> int:
    """Return the number of nodes to query together, 1 or more.

    `probabilities` say how likely each node stays hidden, in descending order. k nodes in one query cost 1 +
    (1 - product of their probabilities) · k queries, because all are queried again if any is visible; a
    single node costs 1. The best k is where the nodes per query stop growing.
    """
    best, likely = 1.0, probabilities[0]
    for size in range(2, len(probabilities) + 1):
        likely *= probabilities[size - 1]
        value = size / (1.0 + (1.0 - likely) * size)
        if value < best:
            return size - 1
        best = value
    return len(probabilities)


class ChcPlusPlus(TreeCulling):
    """Draws what was visible, and queries what was hidden in batches."""

    def __init__(
        self, scene: Scene, device: Device, settings: VisibilitySettings = DEFAULTS, *, seed: int = 0
    ) -> None:
        """`seed` is that of the random numbers."""
        super().__init__(scene, device, settings, is_tight=True)
        self._batch, self._persistence = settings.batch, settings.persistence
        self._random = Random(seed)
        self._hidden_since, self._next_query = self._history.hidden_since, self._history.next_query
        self._is_queried = bytearray(len(self._forest))  # leaves with a query whose result is not yet read
        room = self._room
        self._i_queue: FixedQueue[int] = FixedQueue(room)  # nodes
        self._requery: FixedQueue[int] = FixedQueue(room)  # nodes of queries in which something was visible
        self._v_queue: FixedQueue[int] = FixedQueue(room)  # leaves
        self._i_queries: FixedQueue[tuple[PendingQueries, int]] = FixedQueue(
            room
        )  # and how many are about hidden nodes
        self._v_queries: FixedQueue[PendingQueries] = FixedQueue(room)
        self._results: FixedQueue[tuple[int, bool]] = FixedQueue(
            room
        )  # for leaves; they count in the next frame
        self._render_queue: FixedQueue[int] = FixedQueue(room)  # leaves

    def render(self, camera: Camera, scene_drawer: SceneDrawer) -> VisibilityStatistics:
        """Draw what `camera` sees, and what it saw in recent frames."""
        forest = self._forest
        frontier = self._frontier
        pending = self._i_queries
        visit = self._visit
        self._begin(camera, scene_drawer.size)
        while True:
            if frontier:
                visit(frontier.pop())
                if len(self._i_queue) < self._batch:
                    continue
                self._query_i_queue(scene_drawer)
            elif self._i_queue or self._requery:
                self._query_i_queue(scene_drawer, self._take_v_queue())
            elif not pending:
                break
            elif self._v_queue:
                self._query_v_queue(scene_drawer)
            else:
                self._resolve(*pending.pop())
            while pending and pending.front[0][0].is_finished:
                self._resolve(*pending.pop())
        self._draw_render_queue(scene_drawer)
        if self._v_queue:
            self._query_v_queue(scene_drawer)
        pull_up(self._visible_nodes, self._visible, forest.parent)
        return self._count()

    def _begin(self, camera: Camera, size: tuple[int, int]) -> None:
        """Read the results of the last frame's v-queue, and begin at the roots."""
        forest, queries = self._forest, self._queries
        self._frame += 1
        self._read_results()
        if self._history.refit(self._frame - 1):
            self._release_leaves()  # the others' queries are about other objects
            queries.set_nodes(forest.tight_sizes, forest.tight)
        queries.begin_frame(camera, forest.update(camera, size))
        self._frontier.begin()
        self._drawn = self._batches = self._visits = 0
        for left in (
            self._i_queue,
            self._requery,
            self._render_queue,
            self._visible_nodes,
            self._v_queue,
        ):
            left.clear()
        while self._i_queries:  # left by a frame that raised
            (pending, groups), hidden = self._i_queries.pop()
            self._release(pending, groups[hidden:])

    def _read_results(self) -> None:
        """Read the results of earlier frames that are available."""
        while self._results:
            self._note_leaf(*self._results.pop())
        while self._v_queries and self._v_queries.front[0].is_finished:
            pending, leaves = self._v_queries.pop()
            for (leaf,), shows in zip(leaves, self._queries.read(pending), strict=False):
                self._note_leaf(leaf, shows)

    def _note_leaf(self, leaf: int, is_visible: bool) -> None:
        """Take the answer for a leaf that was drawn in the last frame, or earlier."""
        self._is_queried[leaf] = 0
        if is_visible:
            self._next_query[leaf] = self._frame - 1 + self._persistence
        elif self._visible[leaf]:
            self._visible[leaf] = 0
            self._hidden_since[leaf] = self._frame

    def _visit(self, node: int) -> None:
        forest, visible, frame = self._forest, self._visible, self._frame
        self._visits += 1
        was_visited = self._visited[node] == frame - 1
        self._visited[node] = frame
        if forest.status[node] == NEAR:
            self._mark_visible(node)
        elif not visible[node] or not was_visited:
            visible[node] = 0
            if not was_visited:
                self._hidden_since[node] = frame
            self._i_queue.push(node)
        elif forest.child[node] < 0:
            if self._next_query[node] <= frame and not self._is_queried[node]:
                self._v_queue.push(node)
            self._visible_nodes.append(node)
            self._render_queue.push(node)
        else:
            visible[node] = 0
            self._hidden_since[node] = frame
            self._open(node)

    def _resolve(self, pending: PendingQueries, hidden: int) -> None:
        """Read the results for previously invisible nodes, and for leaves; waits if they are not yet
        available."""
        queries, groups = pending
        answers = self._queries.read(queries)
        for (leaf,), shows in zip(groups[hidden:], answers[hidden:], strict=False):
            self._results.push((leaf, shows))
        for nodes, shows in zip(groups[:hidden], answers, strict=False):
            if not shows:
                continue
            if len(nodes) > 1:
                for node in nodes:
                    self._requery.push(node)
                continue
            (node,) = nodes
            self._hidden_since[node] = self._frame
            self._next_query[node] = self._frame + self._random.randint(1, self._persistence)
            self._mark_visible(node)

    def _mark_visible(self, node: int) -> None:
        self._visible[node] = 1
        self._visible_nodes.append(node)
        self._open(node)

    def _open(self, node: int) -> None:
        forest = self._forest
        if forest.child[node] < 0:
            self._render_queue.push(node)
        else:
            self._frontier.open(node)

    def _query_i_queue(self, scene_drawer: SceneDrawer, leaves: Sequence[list[int]] = ()) -> None:
        """Query all nodes in the i-queue, and `leaves`, in one call; nodes that are likely to stay hidden
        share a query."""
        self._draw_render_queue(scene_drawer)
        hidden = self._group_i_queue()
        self._i_queries.push((self._issue_queries(hidden, leaves), len(hidden)))
        self._i_queue.clear()
        self._requery.clear()

    def _group_i_queue(self) -> list[list[int]]:
        """Return the nodes of the i-queue in groups, one for each query."""
        since = self._hidden_since
        frame = self._frame
        last = len(STAY_HIDDEN_PROBABILITIES) - 1
        hidden = sorted(self._i_queue, key=since.__getitem__)
        probabilities = [STAY_HIDDEN_PROBABILITIES[min(frame - since[node], last)] for node in hidden]
        groups = [[node] for node in self._requery]
        start = 0
        while start < len(hidden):
            end = start + choose_group_size(probabilities[start:])
            groups.append(hidden[start:end])
            start = end
        return groups

    def _query_v_queue(self, scene_drawer: SceneDrawer) -> None:
        """Query all leaves of the v-queue in one call."""
        self._draw_render_queue(scene_drawer)
        self._v_queries.push(self._issue_queries([], self._take_v_queue()))

    def _take_v_queue(self) -> list[list[int]]:
        """Empty the v-queue; return its leaves as groups of one."""
        leaves = [[leaf] for leaf in self._v_queue]
        self._v_queue.clear()
        return leaves

    def _issue_queries(self, hidden: list[list[int]], leaves: Sequence[list[int]]) -> PendingQueries:
        """Query groups of hidden nodes, and leaves, each with one query, in one call."""
        groups = [*hidden, *leaves]
        nodes = [node for group in groups for node in group]
        rows = [row for row, group in enumerate(groups) for _ in group]
        with self._queries.states():
            pending = self._queries.issue_set(nodes, rows)
        for (leaf,) in leaves:
            self._is_queried[leaf] = 1
        return pending, groups

    def _draw_render_queue(self, scene_drawer: SceneDrawer) -> None:
        """Draw all objects in the render queue."""
        if self._render_queue:
            self._draw(self._forest.objects(list(self._render_queue)), scene_drawer)
            self._render_queue.clear()

    def _release_leaves(self) -> None:
        """Discard the queries of leaves whose results are not yet read."""
        while self._v_queries:
            self._release(*self._v_queries.pop())

    def _release(self, pending: QuerySet, leaves: list[list[int]]) -> None:
        """Discard questions, `leaves` among them."""
        self._queries.release_set(pending)
        for (leaf,) in leaves:
            self._is_queried[leaf] = 0

    def traversal(self) -> CullingTraversal:
        """Return the nodes that the last frame reached."""
        visited = np.array(self._visited) == self._frame
        return forest_traversal(self._forest, visited, self._visible, self._queries.queried)
