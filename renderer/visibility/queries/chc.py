"""CHC, coherent hierarchical culling (thesis 6.3; Bittner et al., 2004).

A node is assumed to be as visible as it was in the last frame, and its query is issued at once. The traversal goes on
while the GPU works on the result:

- An inner node that was visible is opened without a query: its visibility follows from its children (pull-up).
- A leaf that was visible is drawn inside its query: the query is about its own geometry.
- All other nodes are queried by their box. When the result says visible, they are drawn or opened.

Results are looked at after each node, and waited for when there is nothing else to do.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from renderer.scene import Camera, Scene
from renderer.visibility.algorithm import VisibilityStatistics
from renderer.visibility.boxes.forest import NEAR, OUTSIDE, Forest
from renderer.visibility.queries.box_queries import BoxQueries
from renderer.visibility.scene_pass import ScenePass
from rhi import Device, FixedQueue, FixedStack, OcclusionQuery

__rhi_internal__ = True

NEVER = -2
"""A frame number for "not visited yet": it is less than that of any last frame."""


class Chc:
    """Draws what was visible and queries whether it still is; queries all else before drawing it."""

    opens_pass: Final = False

    def __init__(self, scene: Scene, device: Device, *, threshold: int = 0, emulated: bool = False) -> None:
        """A node that passes at most `threshold` samples counts as hidden; `emulated` queries are two counters and a
        fence."""
        self._objects = scene.objects
        self._forest = Forest(scene)
        count = len(self._forest)
        self._queries = BoxQueries(device, np.ones(count, np.int64), np.arange(count), threshold, emulated)
        self._visible = bytearray(count)
        self._visited = [NEVER] * count
        self._frame = 0
        room = max(count, 1)
        self._stack: FixedStack[int] = FixedStack(room)
        self._query_queue: FixedQueue[tuple[int, bool, OcclusionQuery]] = FixedQueue(room)
        self._shown: list[int] = []
        self._drawn = 0

    def render(self, camera: Camera, scene_pass: ScenePass) -> VisibilityStatistics:
        """Draw what `camera` sees, and what it saw in the last frame."""
        forest, queries, stack, query_queue = self._forest, self._queries, self._stack, self._query_queue
        queries.begin_frame(camera, forest.update(camera))
        self._frame += 1
        self._drawn = 0
        self._shown.clear()
        stack.clear()
        while query_queue:  # left by a frame that raised
            queries.release(query_queue.pop()[2])
        for root in forest.roots:
            stack.push(root)
        while stack or query_queue:
            while query_queue and (not stack or query_queue.front[2].is_finished):
                self._resolve(*query_queue.pop(), scene_pass)
            if stack:
                self._visit(stack.pop(), scene_pass)
        pull_up(self._shown, self._visible, forest.parent)
        return VisibilityStatistics(
            objects=len(self._objects),
            visible=self._drawn,
            batches=self._drawn,
            queries=queries.issued,
            box_draws=queries.draws,
            boxes=queries.boxes,
            stalled_milliseconds=1e3 * queries.stalled,
        )

    def _visit(self, node: int, scene_pass: ScenePass) -> None:
        forest, queries, visible = self._forest, self._queries, self._visible
        status = forest.status[node]
        if status == OUTSIDE:
            return
        was_visible = bool(visible[node]) and self._visited[node] == self._frame - 1
        self._visited[node] = self._frame
        visible[node] = 0
        if status == NEAR:
            self._show(node, scene_pass)
        elif not was_visible:
            with queries.states():
                self._query_queue.push((node, False, queries.issue((node,))))
        elif forest.child[node] < 0:
            query = queries.acquire()
            with query:
                self._open(node, scene_pass)
            self._query_queue.push((node, True, query))
        else:
            self._open(node, scene_pass)

    def _resolve(self, node: int, is_drawn: bool, query: OcclusionQuery, scene_pass: ScenePass) -> None:
        if not self._queries.resolve(query):
            return
        if is_drawn:
            self._visible[node] = 1
            self._shown.append(node)
        else:
            self._show(node, scene_pass)

    def _show(self, node: int, scene_pass: ScenePass) -> None:
        """Note that a node is visible in this frame, and open it."""
        self._visible[node] = 1
        self._shown.append(node)
        self._open(node, scene_pass)

    def _open(self, node: int, scene_pass: ScenePass) -> None:
        """Draw a leaf; push the children of an inner node, the nearer one last, so that it is popped first."""
        forest = self._forest
        child = forest.child[node]
        if child < 0:
            scene_pass.draw(np.array((forest.object[node],)))
            self._drawn += 1
        else:
            nearer = forest.second_first[node]
            self._stack.push(child + 1 - nearer)
            self._stack.push(child + nearer)

    def destroy(self) -> None:
        """Destroy the resources on the device."""
        self._queries.destroy()


def pull_up(shown: list[int], visible: bytearray, parent: list[int]) -> None:
    """Mark all ancestors of those nodes of `shown` that are (still) visible as visible."""
    for node in shown:
        if visible[node]:
            above = parent[node]
            while above >= 0 and not visible[above]:
                visible[above] = 1
                above = parent[above]
