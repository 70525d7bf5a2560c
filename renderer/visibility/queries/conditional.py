"""CHC++ with conditional rendering (thesis 8.2): the GPU itself discards what it finds to be hidden.

The traversal is that of CHC++, but a frame asks once, and never waits:

1. What was visible is opened and drawn.
2. What was hidden, and the visible leaves that are due, are queried with one query set.
3. All that was hidden is drawn, each object on condition that its row of the set finds it visible.

The answers are read at the beginning of the next frame, if they are available, and tell what counts as
visible then. They decide what is asked and when, never what is seen. The price is that a hidden node becomes
visible as a whole, and is refined by one level per frame.

Conditional draws count as drawn: only the GPU knows whether they were.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from renderer import rules
from renderer.scene import Camera, Scene
from renderer.visibility.algorithm import VisibilityStatistics
from renderer.visibility.queries.chc import pull_up
from renderer.visibility.queries.chc_plus_plus import ChcPlusPlus, PendingQueries
from renderer.visibility.scene_drawer import SceneDrawer
from renderer.visibility.settings import DEFAULTS, VisibilitySettings
from rhi import Device, FixedQueue, refuse
from rhi.math.indexing import repeat_each

_MAX_PENDING: Final = 8
"""The largest number of frames whose answers are awaited; older ones are given up."""


def _has_conditions(device: Device) -> bool:
    return device.capabilities.conditional_rendering and device.capabilities.occlusion_queries


class ConditionalCulling(ChcPlusPlus):
    """Draws what was visible, and the rest on conditions that the GPU evaluates."""

    def __init__(
        self, scene: Scene, device: Device, settings: VisibilitySettings = DEFAULTS, *, seed: int = 0
    ) -> None:
        """`threshold` only affects what counts as visible in the next frame: for the GPU, one sample is
        enough to draw. The device needs `capabilities.conditional_rendering`, and occlusion queries of its
        own: `emulated` is refused."""
        if not _has_conditions(device):
            lacking = f"a {device.backend_name} device without both"
            refuse(rules.NO_CONDITIONAL_RENDERING, "ConditionalCulling(...)", lacking)
        if settings.emulated:
            refuse(
                rules.NO_CONDITIONAL_RENDERING,
                "ConditionalCulling(...)",
                "emulated queries",
                "native queries",
            )
        super().__init__(scene, device, settings, seed=seed)
        self._pending: FixedQueue[tuple[PendingQueries, int]] = FixedQueue(_MAX_PENDING)
        """For each frame that asked, its questions, and how many of them are about hidden nodes: the first
        ones."""

    @staticmethod
    def find_missing_feature(device: Device) -> str | None:
        """Name the feature that a device lacks to draw on conditions."""
        obstacle = ChcPlusPlus.find_missing_feature(device)
        if obstacle is None and not _has_conditions(device):
            return "conditional rendering with native occlusion queries"
        return obstacle

    def render(self, camera: Camera, scene_drawer: SceneDrawer) -> VisibilityStatistics:
        """Draw what `camera` saw in recent frames, and the rest on condition."""
        frontier = self._frontier
        self._begin(camera, scene_drawer.size)
        while frontier:
            self._visit(frontier.pop())
        self._draw_render_queue(scene_drawer)
        hidden = self._group_i_queue()
        leaves = self._take_v_queue()
        if hidden or leaves:
            if self._pending.is_full:
                self._discard_oldest()
            pending = self._issue_queries(hidden, leaves)
            self._pending.push((pending, len(hidden)))
            self._draw_hidden(hidden, pending, scene_drawer)
        pull_up(self._visible_nodes, self._visible, self._forest.parent)
        return self._count()

    def _draw_hidden(
        self, hidden: list[list[int]], pending: PendingQueries, scene_drawer: SceneDrawer
    ) -> None:
        """Draw all objects below hidden nodes, on condition that their row of the set finds them visible."""
        object_indices, nodes = self._forest.list_objects([node for group in hidden for node in group])
        if len(object_indices):
            row_of = repeat_each(np.arange(len(hidden)), [len(group) for group in hidden])
            scene_drawer.draw_conditional(object_indices, pending[0], row_of[nodes])
            self._drawn += len(object_indices)
            self._batches += 1

    def _read_results(self) -> None:
        visible_nodes: list[int] = []
        while self._pending and self._pending.front[0][0].is_finished:
            (queries, groups), hidden = self._pending.pop()
            answers = self._queries.read(queries)
            for nodes, shows in zip(groups[:hidden], answers, strict=False):
                if shows:
                    self._note_visible(nodes)
                    visible_nodes += nodes[: len(nodes) == 1]
            for (leaf,), shows in zip(groups[hidden:], answers[hidden:], strict=False):
                self._note_leaf(leaf, shows)
        pull_up(visible_nodes, self._visible, self._forest.parent)

    def _note_visible(self, nodes: list[int]) -> None:
        """Record that a query found a hidden node visible. If it covered several nodes, each is queried alone
        next time."""
        if len(nodes) == 1:
            self._next_query[nodes[0]] = self._frame - 1 + self._random.randint(1, self._persistence)
            self._visible[nodes[0]] = 1
        for node in nodes:
            self._hidden_since[node] = self._frame

    def _discard_oldest(self) -> None:
        """Forget the oldest questions."""
        (queries, groups), hidden = self._pending.pop()
        self._release(queries, groups[hidden:])

    def _release_leaves(self) -> None:
        """Discard all questions in flight, also those about hidden nodes."""
        while self._pending:
            self._discard_oldest()
        super()._release_leaves()
