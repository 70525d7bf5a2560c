"""CHC, coherent hierarchical culling (thesis 6.3; Bittner et al., 2004).

A node is taken to be as visible as it was in the last frame, and asked for at once; the walk goes on while the
GPU works on the answer:

- an inner node that was visible is opened without a query: what it is follows from its children (pull-up);
- a leaf that was visible is drawn inside its query, so it is asked for by its own geometry;
- all others are asked for by their box; when the answer says visible, they are drawn or opened.

Answers are looked at after each node and waited for when there is nothing else to do.
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
"""Of a frame's number: longer ago than the last one."""


class Chc:
    """Draws what was visible, and asks whether it still is; asks for the rest before drawing it."""

    opens_pass: Final = False

    def __init__(self, scene: Scene, device: Device, *, threshold: int = 0) -> None:
        """`threshold`: a node that passes no more samples than this is taken for hidden."""
        self._objects = scene.objects
        self._forest = Forest(scene)
        count = len(self._forest)
        self._queries = BoxQueries(device, np.ones(count, np.int64), np.arange(count), threshold)
        self._visible = bytearray(count)
        self._visited = [NEVER] * count
        self._frame = 0
        room = max(count, 1)
        self._stack: FixedStack[int] = FixedStack(room)
        self._asked: FixedQueue[tuple[int, bool, OcclusionQuery]] = FixedQueue(room)
        self._shown: list[int] = []
        self._drawn = 0

    def render(self, camera: Camera, scene_pass: ScenePass) -> VisibilityStatistics:
        """Draw what `camera` sees, and what it saw in the last frame."""
        forest, queries, stack, asked = self._forest, self._queries, self._stack, self._asked
        queries.begin_frame(camera, forest.update(camera))
        self._frame += 1
        self._drawn = 0
        self._shown.clear()
        stack.clear()
        while asked:  # a frame that was broken off
            queries.release(asked.pop()[2])
        for root in forest.roots:
            stack.push(root)
        while stack or asked:
            while asked and (not stack or asked.front[2].is_finished):
                self._take_answer(*asked.pop(), scene_pass)
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
        place = forest.place[node]
        if place == OUTSIDE:
            return
        was_visible = bool(visible[node]) and self._visited[node] == self._frame - 1
        self._visited[node] = self._frame
        visible[node] = 0
        if place == NEAR:
            self._show(node, scene_pass)
        elif not was_visible:
            with queries.states():
                self._asked.push((node, False, queries.ask((node,))))
        elif forest.child[node] < 0:
            query = queries.take()
            with query:
                self._open(node, scene_pass)
            self._asked.push((node, True, query))
        else:
            self._open(node, scene_pass)

    def _take_answer(self, node: int, is_drawn: bool, query: OcclusionQuery, scene_pass: ScenePass) -> None:
        if not self._queries.answer(query):
            return
        if is_drawn:
            self._visible[node] = 1
            self._shown.append(node)
        else:
            self._show(node, scene_pass)

    def _show(self, node: int, scene_pass: ScenePass) -> None:
        """A node that is visible in this frame."""
        self._visible[node] = 1
        self._shown.append(node)
        self._open(node, scene_pass)

    def _open(self, node: int, scene_pass: ScenePass) -> None:
        """Draw a leaf; put the children of another node on the stack, the nearer one on top."""
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
        """Give back what was made on the device."""
        self._queries.destroy()


def pull_up(shown: list[int], visible: bytearray, parent: list[int]) -> None:
    """Mark as visible what is above the nodes `shown` that are (still) visible."""
    for node in shown:
        if visible[node]:
            above = parent[node]
            while above >= 0 and not visible[above]:
                visible[above] = 1
                above = parent[above]
