"""Stop-and-wait occlusion culling (thesis 6.2, Listing 6.2): simple, exact, and slow."""

from __future__ import annotations

from typing import Final

import numpy as np

from renderer.scene import Camera, Scene
from renderer.visibility.algorithm import VisibilityStatistics, find_visible_objects
from renderer.visibility.boxes.bounds import see_boxes
from renderer.visibility.boxes.volumes import TightestBoxes
from renderer.visibility.frustum import FrustumCulling
from renderer.visibility.queries.box_queries import BoxQueries
from renderer.visibility.scene_pass import ScenePass
from rhi import Device


class StopAndWait:
    """Queries each object in the frustum, front to back, and waits for each result before the next query.

    An object is drawn only if its box is visible, given all nearer objects. CPU and GPU work in turns: while one
    works, the other waits.
    """

    opens_pass: Final = False

    def __init__(self, scene: Scene, device: Device, *, threshold: int = 0, emulated: bool = False) -> None:
        """An object whose box passes at most `threshold` samples counts as hidden; `emulated` queries are two counters
        and a fence."""
        self._objects = scene.objects
        self._frustum = FrustumCulling(scene)
        self._tightest = TightestBoxes(scene)
        count = len(scene.objects)
        self._queries = BoxQueries(device, np.ones(count, np.int64), np.arange(count), threshold, emulated)

    def render(self, camera: Camera, scene_pass: ScenePass) -> VisibilityStatistics:
        """Draw the objects that are not hidden behind nearer ones."""
        lower, upper = self._objects.lower, self._objects.upper
        rows = find_visible_objects(self._frustum, camera)
        rows = rows[np.argsort((lower[rows] + upper[rows]) @ camera.forward, kind="stable")]
        rotated = self._tightest.find()
        boxes = see_boxes(camera, lower, upper, rotated, rotated.rows)
        near = boxes.near
        queries = self._queries
        queries.begin_frame(camera, boxes)
        visible = 0
        for index, row in enumerate(rows.tolist()):
            if not near[row]:
                with queries.states():
                    query = queries.issue((row,))
                if not queries.resolve(query):
                    continue
            scene_pass.draw(rows[index : index + 1])
            visible += 1
        return VisibilityStatistics(
            objects=len(self._objects),
            visible=visible,
            batches=visible,
            queries=queries.issued,
            box_draws=queries.draws,
            boxes=queries.boxes,
            stalled_milliseconds=1e3 * queries.stalled,
        )

    def destroy(self) -> None:
        """Destroy the resources on the device."""
        self._queries.destroy()
