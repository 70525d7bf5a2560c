"""The exact set of visible objects: each object is drawn with its row as colour, and each pixel keeps the nearest."""

from __future__ import annotations

import numpy as np

from renderer.frame import BoundProgram, SceneResources, TechniquePass, View
from renderer.scene import Camera, Scene
from renderer.shaders import Object, ObjectPosition, Vertex, ViewConstants, relative_position
from renderer.visibility import NoCulling
from rhi import Device, Format
from rhi.shading import Shader, Storage, Struct, Uniform, instance_index, uint, vec4


class RowVarying(Struct):
    """The varyings of `RowShader`."""

    clip: vec4
    row: int


class RowShader(Shader):
    """Draws an object's row + 1 as colour."""

    view: Uniform[ViewConstants]
    objects: Storage[Object]
    places: Storage[ObjectPosition]

    def vertex(self, v: Vertex) -> RowVarying:
        row = instance_index()
        position = self.objects[row].linear @ v.position + relative_position(self.places[row], self.view)
        return RowVarying(clip=self.view.relative_view_projection @ vec4(position, 1.0), row=row)

    def fragment(self, v: RowVarying) -> uint:
        return uint(v.row + 1)


class ExactVisibility:
    """Finds the objects that a camera sees, pixel by pixel; of two surfaces at equal depth, one."""

    def __init__(self, device: Device, scene: Scene, size: tuple[int, int]) -> None:
        """`size` is (width, height) in pixels."""
        self._device, self._scene = device, scene
        self._resources = SceneResources(device, scene)
        self._view = View(device, "eye", NoCulling(scene))
        self._numbers = device.texture(size, Format.R32UI)
        self._depth = device.texture(size, Format.D32F)

    def find(self, camera: Camera) -> set[int]:
        """Return the rows of the objects that cover a pixel. The scene must be up to date."""
        resources = self._resources
        width, height = self._numbers.size
        camera = camera.with_aspect(width / height)
        resources.simulator.begin_frame(self._scene.seconds)
        self._view.aim(camera)
        resources.update(camera)
        arrays = resources.list_arrays(self._view.buffer)
        bindings = {"view": arrays.view, "objects": arrays.objects, "places": arrays.places}
        program = self._device.program(RowShader)
        with TechniquePass(
            self._device, resources, self._view, [BoundProgram(program, bindings)],
            color=self._numbers, depth=self._depth, clear=(0, 0, 0, 0),
        ) as scene_pass:  # fmt: skip
            scene_pass.draw(np.arange(len(self._scene.objects)))
        return set((np.unique(self._numbers.read()).astype(np.int64) - 1).tolist()) - {-1}

    def destroy(self) -> None:
        """Destroy the resources on the device."""
        for part in (self._resources, self._view, self._numbers, self._depth):
            part.destroy()
