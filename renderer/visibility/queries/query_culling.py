"""Base classes of algorithms that issue occlusion queries: their queries, their trees, and the counters of a
frame."""

from __future__ import annotations

from typing import Final

import numpy as np

from renderer.scene import Scene
from renderer.scene.arrays import Indices
from renderer.visibility.algorithm import VisibilityStatistics
from renderer.visibility.boxes.forest import Forest, Frontier
from renderer.visibility.queries.box_queries import BoxQueries
from renderer.visibility.queries.node_history import NodeHistory
from renderer.visibility.scene_drawer import SceneDrawer
from renderer.visibility.settings import VisibilitySettings
from rhi import Device


class QueryCulling:
    """Draws batches of objects as soon as queries have found them visible."""

    opens_pass: Final = False

    def __init__(
        self, scene: Scene, device: Device, settings: VisibilitySettings, sizes: Indices, box_indices: Indices
    ) -> None:
        """`sizes` and `box_indices` are those of `BoxQueries`."""
        self._objects = scene.objects
        self._queries = BoxQueries(device, sizes, box_indices, settings.threshold, settings.emulated)
        self._drawn = self._batches = self._visits = 0

    @staticmethod
    def find_missing_feature(device: Device) -> str | None:
        """Name the feature that a device lacks to answer occlusion queries."""
        can = device.capabilities
        if not can.shading:
            return "draws that run, to answer its occlusion queries"
        return (
            None if can.occlusion_queries or can.sample_counter else "occlusion queries or a sample counter"
        )

    def _draw(self, object_indices: Indices, scene_drawer: SceneDrawer) -> None:
        scene_drawer.draw(object_indices)
        self._drawn += len(object_indices)
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
        node_indices = np.arange(len(forest))
        boxes = (forest.tight_sizes, forest.tight) if is_tight else (np.ones_like(node_indices), node_indices)
        super().__init__(scene, device, settings, *boxes)
        self._room = max(len(forest), 1)
        self._history = NodeHistory(forest)
        self._visible, self._visited = self._history.visible, self._history.visited
        self._frontier = Frontier(forest)
        self._frame = 0
        self._visible_nodes: list[int] = []
