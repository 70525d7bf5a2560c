"""CHC++ with conditional rendering (thesis 8.2): the GPU itself discards what it finds to be hidden.

The traversal is that of CHC++. What was visible is opened and drawn. Then what was hidden is queried, and all of it
is drawn on condition that its query finds it visible. So the CPU never waits for a result: if it is available in the
next frame, it tells what is visible then. The price is that a hidden node becomes visible as a whole, and is refined
by one level per frame.

Conditional draws count as drawn: only the GPU knows whether they were.
"""

from __future__ import annotations

from renderer import rules
from renderer.scene import Camera, Scene
from renderer.visibility.algorithm import VisibilityStatistics
from renderer.visibility.queries.chc import pull_up
from renderer.visibility.queries.chc_plus_plus import ChcPlusPlus
from renderer.visibility.scene_pass import ScenePass
from rhi import Device, refuse

__rhi_internal__ = True


class ConditionalCulling(ChcPlusPlus):
    """Draws what was visible, and the rest on conditions that the GPU evaluates."""

    def __init__(
        self,
        scene: Scene,
        device: Device,
        *,
        persistence: int = 20,
        leaf_size: int = 1,
        threshold: int = 0,
        emulated: bool = False,
        seed: int = 0,
    ) -> None:
        """The parameters are those of `ChcPlusPlus`. `threshold` only affects what counts as visible in the next
        frame: for the GPU, one sample is enough to draw. The device needs `capabilities.conditional_rendering`.
        A condition needs a native query: `emulated` is refused.
        """
        if not (device.capabilities.conditional_rendering and device.capabilities.occlusion_queries):
            refuse(
                rules.NO_CONDITIONS,
                "ConditionalCulling(...)",
                f"a {device.backend_name} device without both",
            )
        if emulated:
            refuse(rules.NO_CONDITIONS, "ConditionalCulling(...)", "emulated queries", "native ones")
        super().__init__(
            scene, device, persistence=persistence, leaf_size=leaf_size, threshold=threshold, seed=seed
        )

    def render(self, camera: Camera, scene_pass: ScenePass) -> VisibilityStatistics:
        """Draw what `camera` saw in recent frames, and the rest on condition."""
        forest, frontier = self._forest, self._frontier
        self._begin(camera)
        while frontier:
            self._visit(frontier.pop())
        self._draw_render_queue(scene_pass)
        self._query_i_queue(scene_pass)
        device = self._queries.device
        for nodes, query in self._i_queries:
            rows = forest.objects(nodes)
            with device.conditional(query):
                scene_pass.draw(rows)
            self._drawn += len(rows)
            self._batches += 1
        if self._v_queue:
            self._query_v_queue(scene_pass)
        pull_up(self._shown, self._visible, forest.parent)
        return self._count()

    def _begin(self, camera: Camera) -> None:
        """Read the last frame's results for hidden nodes; those not yet available are discarded."""
        shown = []
        while self._i_queries:
            nodes, query = self._i_queries.pop()
            if not query.is_finished:
                self._queries.release(query)
            elif self._queries.resolve(query):
                if len(nodes) == 1:
                    self._next_query[nodes[0]] = self._frame + self._random.randint(1, self._persistence)
                    self._visible[nodes[0]] = 1
                    shown += nodes
                for node in nodes:  # some are visible, unknown which: each is queried alone next time
                    self._hidden_since[node] = self._frame + 1
        pull_up(shown, self._visible, self._forest.parent)
        super()._begin(camera)

    def _query_v_queue(self, scene_pass: ScenePass) -> None:
        """Query all leaves of the v-queue."""
        with self._queries.states():
            while self._v_queue:
                self._query_leaf(self._v_queue.pop())
