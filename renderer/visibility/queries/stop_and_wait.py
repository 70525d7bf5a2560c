"""Stop-and-wait occlusion culling (thesis 6.2, Listing 6.2): simple, exact, and slow."""

from __future__ import annotations

import numpy as np

from renderer.scene import Camera, Scene
from renderer.visibility.algorithm import VisibilityStatistics, list_visible_objects
from renderer.visibility.boxes.bounds import compute_query_boxes
from renderer.visibility.boxes.volumes import TightestBoxes
from renderer.visibility.frustum import FrustumCulling
from renderer.visibility.queries.query_culling import QueryCulling
from renderer.visibility.scene_drawer import SceneDrawer
from renderer.visibility.settings import DEFAULTS, VisibilitySettings
from rhi import Device


class StopAndWait(QueryCulling):
    """Queries each object in the frustum, front to back, and waits for each result before the next query.

    An object is drawn only if its box is visible, given all nearer objects. CPU and GPU work in turns: while
    one works, the other waits.
    """

    def __init__(self, scene: Scene, device: Device, settings: VisibilitySettings = DEFAULTS) -> None:
        object_indices = np.arange(len(scene.objects))
        super().__init__(scene, device, settings, np.ones_like(object_indices), object_indices)
        self._frustum = FrustumCulling(scene)
        self._tightest = TightestBoxes(scene)

    def render(self, camera: Camera, scene_drawer: SceneDrawer) -> VisibilityStatistics:
        """Draw the objects that are not hidden behind nearer ones."""
        lower, upper = self._objects.lower, self._objects.upper
        object_indices = list_visible_objects(self._frustum, camera)
        object_indices = object_indices[
            np.argsort((lower[object_indices] + upper[object_indices]) @ camera.forward, kind="stable")
        ]
        rotated = self._tightest.collect()
        boxes = compute_query_boxes(camera, lower, upper, rotated, rotated.object_indices, scene_drawer.size)
        near = boxes.near
        queries = self._queries
        queries.begin_frame(camera, boxes)
        self._drawn = self._batches = 0
        for index, object_index in enumerate(object_indices.tolist()):
            if not near[object_index]:
                with queries.states():
                    query = queries.issue((object_index,))
                if not queries.resolve(query):
                    continue
            self._draw(object_indices[index : index + 1], scene_drawer)
        return self._count()
