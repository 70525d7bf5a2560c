"""The same passes on several backends: the cost of a scene's depth, lighting, textures and queries on each.

Each pass does one kind of work, the same on all backends: all objects, without culling, front to back, one
fixed camera. The CPU's part is only to record the commands; scene and camera are uploaded before. A time is
from the first command until the device is finished.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np

import rhi
from renderer import shaders
from renderer.frame import (
    BoundProgram,
    Effect,
    Frame,
    SceneResources,
    Targets,
    TechniqueDrawer,
    View,
    collect_frame_effects,
    make_plan,
)
from renderer.scene import Camera, Depth, Scene
from renderer.shaders import Object, ObjectPosition, Vertex, relative_position
from renderer.techniques.forward import Forward
from renderer.techniques.parts.variants import draw_lit
from renderer.visibility import NoCulling
from renderer.visibility.boxes.bounds import pad_boxes
from rhi import ColorWrite, DepthFunction, DepthWrite, Device, Mesh, OcclusionQuery, QuerySet, StateScope
from rhi.shading import Shader, Storage, Struct, Uniform, instance_index, vec3, vec4

PASSES: Final = {
    "depth": "depth only",
    "lit": "the forward shader without images",
    "textured": "the forward shader with the scene's images",
    "queries": "a query for each of up to 1,000 objects' boxes, issued and read as one query set",
    "waited": "the same queries one by one, each read before the next is issued",
}
"""The passes that can be timed."""
_QUERIES: Final = 1000
_CORNERS: Final = np.array([(x, y, z) for z in (0, 1) for y in (0, 1) for x in (0, 1)], bool)
_FACES: Final = np.array([(0, 4, 6, 2), (1, 3, 7, 5), (0, 1, 5, 4), (2, 6, 7, 3), (0, 2, 3, 1), (4, 5, 7, 6)])
_TRIANGLES: Final = _FACES[:, [0, 1, 2, 0, 2, 3]].reshape(-1)  # counter-clockwise seen from outside


class DepthShader(Shader):
    """Draws the forward shader's positions with no output but depth."""

    view: Uniform[shaders.ViewConstants]
    objects: Storage[Object]
    object_positions: Storage[ObjectPosition]

    def vertex(self, v: Vertex) -> vec4:
        object_index = instance_index()
        thing = self.objects[object_index]
        position = thing.linear @ v.position + relative_position(
            self.object_positions[object_index], self.view
        )
        return self.view.relative_view_projection @ vec4(position, 1.0)

    def fragment(self) -> None:
        pass


class BoxVertex(Struct):
    """A corner of a box, relative to the eye."""

    position: vec3


class BoxDepthShader(Shader):
    """Draws boxes with no output but depth."""

    view: Uniform[shaders.ViewConstants]

    def vertex(self, v: BoxVertex) -> vec4:
        return self.view.relative_view_projection @ vec4(v.position, 1.0)

    def fragment(self) -> None:
        pass


class BackendPasses:
    """The passes of one scene on one device, seen by one camera.

    Attributes:
        targets: the targets.
        resources: the scene.
        camera: the camera, with the targets' aspect.
        view: its view.
    """

    def __init__(self, device: Device, scene: Scene, camera: Camera, size: tuple[int, int]) -> None:
        """`size` is (width, height) of the targets in pixels."""
        self.device = device
        self.targets = Targets(device, size)
        self.resources = SceneResources(device, scene)
        self.camera = camera.with_aspect(size[0] / size[1])
        self.view = View(device, "eye", NoCulling(scene))
        self.view.aim(self.camera)
        self._rows = np.arange(len(scene.objects))
        self.resources.update(self.camera)
        self.resources.simulate(self._rows)
        self._needs = collect_frame_effects(scene, self.camera, reaches=self.resources.reaching)
        self.targets.provide(make_plan(Forward().declare(self._needs)).textures)
        self._depth = device.program(DepthShader)
        self._box = device.program(BoxDepthShader)
        self._boxes: Mesh | None = None
        self._parts: list[Mesh] = []
        self._draws = np.zeros(0, rhi.DRAW)
        self._query: OcclusionQuery | None = None
        self._queries: QuerySet | None = None

    def work(self, name: str) -> Callable[[int], object]:
        """The function that runs a pass of `PASSES` once and waits for the device; it takes a round's
        number."""
        if name in ("lit", "textured"):
            return lambda _: self._draw_lit(images=name == "textured")
        if name == "depth":
            return lambda _: self.draw_depth()
        self.draw_depth()
        self._prepare_boxes()
        return lambda _: self.wait_for_boxes() if name == "waited" else self.count_boxes()

    def draw_depth(self) -> None:
        """Draw the depth of all objects."""
        arrays = self.resources.scene_arrays(self.view.buffer)
        bindings = {
            "view": arrays.view,
            "objects": arrays.objects,
            "object_positions": arrays.object_positions,
        }
        with TechniqueDrawer(
            self.device,
            self.resources,
            self.view,
            [BoundProgram(self._depth, bindings)],
            color=None,
            depth=self.targets.depth,
        ) as scene_drawer:
            scene_drawer.draw(self._rows)
        self.device.finish()

    def _draw_lit(self, images: bool) -> None:
        enabled = self._needs.enabled if images else self._needs.enabled - {Effect.IMAGES}
        effects = replace(self._needs, enabled=enabled)
        draw_lit(Frame(self.device, self.view, self.resources, self.targets, effects))
        self.device.finish()

    def _prepare_boxes(self) -> None:
        if self._boxes is not None:
            return
        objects = self.resources.scene.objects
        count = min(_QUERIES, len(objects))
        # Spread over the scene: the first 1,000 objects of a generated city are on one side of it.
        rows = np.linspace(0, len(objects) - 1, count).astype(np.int64)
        low, high, _ = pad_boxes(self.camera, objects.lower[rows], objects.upper[rows])
        corners = np.where(_CORNERS, high[:, None], low[:, None]) - self.camera.position
        indices = 8 * np.arange(count)[:, None] + _TRIANGLES
        self._boxes = self.device.mesh(
            {"position": corners.reshape(-1, 3).astype(np.float32)}, indices.reshape(-1).astype(np.uint32)
        )
        self._parts = [self._boxes.view(36 * i, 36) for i in range(count)]
        self._draws = self._boxes.draws(36 * np.arange(count), 36)
        self._query = self.device.occlusion_query()
        self._queries = self.device.query_set(count)

    def count_boxes(self) -> list[int]:
        """The number of samples of each box that are nearer than the last drawn depth, queried as one set."""
        boxes, queries = self._boxes, self._queries
        assert boxes is not None
        assert queries is not None
        with self.device.render_pass(depth=self.targets.depth), self._box_states():
            self.device.draw_counted(self._box, boxes, self._draws, queries, view=self.view.buffer)
        samples: list[int] = queries.wait().tolist()
        return samples

    def wait_for_boxes(self) -> list[int]:
        """The same as `count_boxes`, waiting for each query before the next."""
        device = self.device
        view = self.view.buffer
        program = self._box
        query = self._query
        assert query is not None
        samples = []
        with device.render_pass(depth=self.targets.depth), self._box_states():
            for part in self._parts:
                with query:
                    device.draw(program, part, view=view)
                samples.append(query.wait())
        return samples

    def _box_states(self) -> StateScope:
        reverses = self.camera.projection.depth is Depth.REVERSED
        nearer = DepthFunction.GREATER if reverses else DepthFunction.LESS
        return self.device.states(ColorWrite.OFF, DepthWrite.OFF, nearer)

    def destroy(self) -> None:
        """Destroy the resources on the device."""
        if self._boxes is not None:
            self._boxes.destroy()
        for queries in (self._query, self._queries):
            if queries is not None:
                queries.destroy()
        self.resources.destroy()
        self.view.destroy()
        self.targets.destroy()
