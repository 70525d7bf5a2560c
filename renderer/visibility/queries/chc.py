"""CHC, coherent hierarchical culling (thesis 6.3; Bittner et al., 2004).

A node is assumed to be as visible as it was in the last frame, and its query is issued at once. The traversal
goes on while the GPU works on the result:

- An inner node that was visible is opened without a query: its visibility follows from its children
  (pull-up).
- A leaf that was visible is drawn inside its query: the query is about its own geometry.
- All other nodes are queried by their box. When the result says visible, they are drawn or opened.

Results are looked at after each node, and waited for when there is nothing else to do.
"""

from __future__ import annotations

import numpy as np

from renderer.scene import Camera, Scene
from renderer.visibility.algorithm import VisibilityStatistics
from renderer.visibility.boxes.forest import NEAR
from renderer.visibility.queries.query_culling import TreeCulling
from renderer.visibility.scene_drawer import SceneDrawer
from renderer.visibility.settings import DEFAULTS, VisibilitySettings
from renderer.visibility.traversal import CullingTraversal, forest_traversal
from rhi import Device, FixedQueue, OcclusionQuery


class Chc(TreeCulling):
    """Draws what was visible and queries whether it still is; queries all else before drawing it."""

    def __init__(self, scene: Scene, device: Device, settings: VisibilitySettings = DEFAULTS) -> None:
        super().__init__(scene, device, settings, is_tight=False)
        self._query_queue: FixedQueue[tuple[int, bool, OcclusionQuery]] = FixedQueue(self._room)

    def render(self, camera: Camera, scene_drawer: SceneDrawer) -> VisibilityStatistics:
        """Draw what `camera` sees, and what it saw in the last frame."""
        forest, frontier = self._forest, self._frontier
        queries, query_queue = self._queries, self._query_queue
        self._history.refit(self._frame)
        queries.begin_frame(camera, forest.update(camera, scene_drawer.size))
        self._frame += 1
        self._drawn = self._batches = 0
        self._visible_nodes.clear()
        frontier.begin()
        while query_queue:  # left by a frame that raised
            queries.release(query_queue.pop()[2])
        while frontier or query_queue:
            while query_queue and (not frontier or query_queue.front[2].is_finished):
                self._resolve(*query_queue.pop(), scene_drawer)
            if frontier:
                self._visit(frontier.pop(), scene_drawer)
        pull_up(self._visible_nodes, self._visible, forest.parent)
        return self._count()

    def _visit(self, node: int, scene_drawer: SceneDrawer) -> None:
        forest, queries, visible = self._forest, self._queries, self._visible
        was_visible = bool(visible[node]) and self._visited[node] == self._frame - 1
        self._visited[node] = self._frame
        visible[node] = 0
        if forest.status[node] == NEAR:
            self._mark_visible(node, scene_drawer)
        elif not was_visible:
            with queries.states():
                self._query_queue.push((node, False, queries.issue((node,))))
        elif forest.child[node] < 0:
            query = queries.acquire()
            with query:
                self._open(node, scene_drawer)
            self._query_queue.push((node, True, query))
        else:
            self._open(node, scene_drawer)

    def _resolve(self, node: int, is_drawn: bool, query: OcclusionQuery, scene_drawer: SceneDrawer) -> None:
        if not self._queries.resolve(query):
            return
        if is_drawn:
            self._visible[node] = 1
            self._visible_nodes.append(node)
        else:
            self._mark_visible(node, scene_drawer)

    def _mark_visible(self, node: int, scene_drawer: SceneDrawer) -> None:
        """Note that a node is visible in this frame, and open it."""
        self._visible[node] = 1
        self._visible_nodes.append(node)
        self._open(node, scene_drawer)

    def _open(self, node: int, scene_drawer: SceneDrawer) -> None:
        """Draw a leaf; have the children of an inner node visited."""
        forest = self._forest
        if forest.child[node] < 0:
            self._draw(forest.objects((node,)), scene_drawer)
        else:
            self._frontier.open(node)

    def traversal(self) -> CullingTraversal:
        """Return the nodes that the last frame reached. Visible leaves that aren't near are queried by their
        own geometry."""
        forest, visited = self._forest, np.array(self._visited) == self._frame
        queried = bytearray(
            was or (child < 0 and status != NEAR)
            for was, child, status in zip(self._queries.queried, forest.child, forest.status, strict=True)
        )
        return forest_traversal(forest, visited, self._visible, queried)


def pull_up(nodes: list[int], visible: bytearray, parent: list[int]) -> None:
    """Mark all ancestors of those nodes of `nodes` that are (still) visible as visible."""
    for node in nodes:
        if visible[node]:
            above = parent[node]
            while above >= 0 and not visible[above]:
                visible[above] = 1
                above = parent[above]
