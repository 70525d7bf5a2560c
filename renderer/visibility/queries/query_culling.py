"""The common part of algorithms that ask the device: their queries, their trees, and the numbers of a frame."""

from __future__ import annotations

from typing import Final

import numpy as np

from renderer.scene import Scene
from renderer.scene.arrays import Rows
from renderer.visibility.algorithm import VisibilityStatistics
from renderer.visibility.boxes.forest import Forest, Frontier
from renderer.visibility.queries.box_queries import BoxQueries
from renderer.visibility.queries.memory import NodeMemory
from renderer.visibility.scene_pass import ScenePass
from renderer.visibility.settings import VisibilitySettings
from rhi import Device


class QueryCulling:
    """Draws batches of objects as soon as queries have found them visible."""

    opens_pass: Final = False

    def __init__(self, scene: Scene, device: Device, settings: VisibilitySettings, sizes: Rows, members: Rows) -> None:
        """`sizes` and `members` are those of `BoxQueries`."""
        self._objects = scene.objects
        self._queries = BoxQueries(device, sizes, members, settings.threshold, settings.emulated)
        self._drawn = self._batches = self._visits = 0

    @staticmethod
    def find_obstacle(device: Device) -> str | None:
        """Return what a device lacks to answer occlusion queries."""
        can = device.capabilities
        if not can.shading:
            return "draws that run, to answer its occlusion queries"
        return None if can.occlusion_queries or can.sample_counter else "occlusion queries or a sample counter"

    def _draw(self, rows: Rows, scene_pass: ScenePass) -> None:
        scene_pass.draw(rows)
        self._drawn += len(rows)
        self._batches += 1

    def _count(self) -> VisibilityStatistics:
        queries = self._queries
        return VisibilityStatistics(
            objects=len(self._objects),
            visible=self._drawn,
            batches=self._batches,
            nodes_tested=self._visits,
            queries=queries.issued,
            box_draws=queries.draws,
            boxes=queries.boxes,
            stalled_milliseconds=1e3 * queries.stalled,
        )

    def destroy(self) -> None:
        """Destroy the resources on the device."""
        self._queries.destroy()


class TreeCulling(QueryCulling):
    """Walks trees of bounding boxes, and remembers of each node what was found in earlier frames."""

    def __init__(self, scene: Scene, device: Device, settings: VisibilitySettings, *, is_tight: bool) -> None:
        """`is_tight` queries draw several boxes inside of a node's in its place."""
        self._forest = forest = Forest(scene, settings.leaf_size)
        each = np.arange(len(forest))
        boxes = (forest.tight_sizes, forest.tight) if is_tight else (np.ones_like(each), each)
        super().__init__(scene, device, settings, *boxes)
        self._room = max(len(forest), 1)
        self._memory = NodeMemory(forest)
        self._visible, self._visited = self._memory.visible, self._memory.visited
        self._frontier = Frontier(forest)
        self._frame = 0
        self._shown: list[int] = []
