"""The exact set of visible objects: each object is drawn with its index as colour, and each pixel keeps the
nearest."""

from __future__ import annotations

import numpy as np

from renderer.frame import BoundProgram, SceneResources, TechniqueDrawer, View
from renderer.scene import Camera, Scene
from renderer.shaders import Object, ObjectPosition, Vertex, ViewConstants, relative_position
from renderer.visibility import NoCulling
from rhi import Device, Format
from rhi.shading import Shader, Storage, Struct, Uniform, instance_index, uint, vec4


class ObjectIndexVarying(Struct):
    """The varyings of `ObjectIndexShader`."""

    clip: vec4
    object_index: int


class ObjectIndexShader(Shader):
    """Draws an object's index + 1 as colour."""

    view: Uniform[ViewConstants]
    objects: Storage[Object]
    object_positions: Storage[ObjectPosition]

    def vertex(self, v: Vertex) -> ObjectIndexVarying:
        object_index = instance_index()
        position = self.objects[object_index].linear @ v.position + relative_position(
            self.object_positions[object_index], self.view
        )
        return ObjectIndexVarying(
            clip=self.view.relative_view_projection @ vec4(position, 1.0), object_index=object_index
        )

    def fragment(self, v: ObjectIndexVarying) -> uint:
        return uint(v.object_index + 1)


class ExactVisibility:
    """Finds the objects that a camera sees, pixel by pixel; where two surfaces have equal depth, one of
    them."""

    def __init__(self, device: Device, scene: Scene, size: tuple[int, int]) -> None:
        """`size` is (width, height) in pixels."""
        self._device, self._scene = device, scene
        self._resources = SceneResources(device, scene)
        self._view = View(device, "eye", NoCulling(scene))
        self._numbers = device.texture(size, Format.R32UI)
        self._depth = device.texture(size, Format.D32F)

    def visible_objects(self, camera: Camera) -> set[int]:
        """The indices of the objects that cover a pixel. The scene must be up to date."""
        resources = self._resources
        width, height = self._numbers.size
        camera = camera.with_aspect(width / height)
        resources.simulator.begin_frame(self._scene.seconds)
        self._view.aim(camera)
        resources.update(camera)
        arrays = resources.scene_arrays(self._view.buffer)
        bindings = {
            "view": arrays.view,
            "objects": arrays.objects,
            "object_positions": arrays.object_positions,
        }
        program = self._device.program(ObjectIndexShader)
        with TechniqueDrawer(
            self._device,
            resources,
            self._view,
            [BoundProgram(program, bindings)],
            color=self._numbers,
            depth=self._depth,
            clear=(0, 0, 0, 0),
        ) as scene_drawer:
            scene_drawer.draw(np.arange(len(self._scene.objects)))
        return set((np.unique(self._numbers.read()).astype(np.int64) - 1).tolist()) - {-1}

    def destroy(self) -> None:
        """Destroy the resources on the device."""
        for part in (self._resources, self._view, self._numbers, self._depth):
            part.destroy()
