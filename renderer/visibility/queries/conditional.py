"""CHC++ by conditional rendering (thesis 8.2): the GPU itself drops what it finds to be hidden.

The walk is that of CHC++. What was visible is opened and drawn; what was hidden is asked for after that, and then
all of it is drawn on condition that the query shows something. So the CPU never waits for an answer: it reads it in
the next frame, if it is there, to know what is visible then. The price is that a hidden node comes in sight as a
whole, and is looked at more closely a level a frame.

What is drawn on condition is counted as drawn: whether it was, only the GPU knows.
"""

from __future__ import annotations

import numpy as np

from renderer import rules
from renderer.scene import Camera, Scene
from renderer.visibility.algorithm import VisibilityStatistics
from renderer.visibility.queries.chc import pull_up
from renderer.visibility.queries.chc_plus_plus import ChcPlusPlus
from renderer.visibility.scene_pass import ScenePass
from rhi import Device, refuse

__rhi_internal__ = True


class ConditionalCulling(ChcPlusPlus):
    """Draws what was visible, and the rest on conditions that the GPU looks at."""

    def __init__(
        self, scene: Scene, device: Device, *, persistence: int = 20, threshold: int = 0, seed: int = 0
    ) -> None:
        """As `ChcPlusPlus`. `threshold` is for what is visible in the next frame; what a frame shows is decided by
        the GPU, for which one sample is enough. The device needs `capabilities.conditional_rendering`."""
        if not device.capabilities.conditional_rendering:
            refuse(
                rules.NO_CONDITIONS, "ConditionalCulling(...)", f"a {device.backend_name} device without them"
            )
        super().__init__(scene, device, persistence=persistence, threshold=threshold, seed=seed)

    def render(self, camera: Camera, scene_pass: ScenePass) -> VisibilityStatistics:
        """Draw what `camera` saw lately, and what it sees of the rest."""
        forest, stack = self._forest, self._stack
        self._begin(camera)
        while stack:
            self._visit(stack.pop())
        self._draw_render_queue(scene_pass)
        self._query_i_queue(scene_pass)
        device = self._queries.device
        for nodes, query in self._i_queries:
            rows = np.sort(np.concatenate([forest.objects(node) for node in nodes]))
            with device.conditional(query):
                scene_pass.draw(rows)
            self._drawn += len(rows)
            self._batches += 1
        if self._v_queue:
            self._query_v_queue(scene_pass)
        pull_up(self._shown, self._visible, forest.parent)
        return self._count()

    def _begin(self, camera: Camera) -> None:
        """Take the last frame's answers about what was hidden; one that isn't there tells nothing."""
        shown = []
        while self._i_queries:
            nodes, query = self._i_queries.pop()
            if not query.is_finished:
                self._queries.release(query)
            elif self._queries.answer(query):
                if len(nodes) == 1:
                    self._next_query[nodes[0]] = self._frame + self._random.randint(1, self._persistence)
                    self._visible[nodes[0]] = 1
                    shown += nodes
                for node in nodes:  # one of several, not known which: next time each is asked for alone
                    self._hidden_since[node] = self._frame + 1
        pull_up(shown, self._visible, self._forest.parent)
        super()._begin(camera)

    def _query_v_queue(self, scene_pass: ScenePass) -> None:
        """Ask for the v-queue; there is nothing to wait for."""
        with self._queries.states():
            while self._v_queue:
                self._query_leaf(self._v_queue.pop())
