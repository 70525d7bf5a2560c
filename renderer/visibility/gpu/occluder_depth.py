"""The depth of a few objects, drawn on a second device, and boxes tested against it in one batch (thesis
8.2).

- Occluders are drawn with their own meshes, at the image's own samples. What is kept is the farthest depth of
  4 × 4 pixels, of 16 × 16, and so on. So a tile that they cover in part hides nothing, and what a tile hides
  is behind all its pixels. At a smaller size this no longer holds: a gap between occluders that holds no
  sample is closed.
- A box is tested against the tiles under its rectangle, coarse ones first, which decide most boxes
  (`BoxTest`).
- Two rasterisers may differ where an edge passes within 1/256 pixel of a sample. So rectangles are enlarged
  by a pixel on each side: if this device covers a pixel that the other one doesn't, the next pixel beyond the
  edge is uncovered.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

import rhi.shading as sl
from renderer.scene import Camera, Depth, Scene
from renderer.scene.arrays import Floats, Indices
from renderer.shaders import Vertex, ViewConstants
from renderer.visibility.gpu.depth_pyramid import BoxTest, PyramidLevels, make_levels
from renderer.visibility.gpu.farthest_depth import FAR, DepthPyramid, depth_variant
from renderer.visibility.gpu.occludees import GROUP, Occludee
from renderer.visibility.settings import DEFAULTS
from rhi import (
    CullMode,
    DepthFunction,
    DepthTest,
    DepthWrite,
    Device,
    Format,
    FrontFace,
    Texture,
    UniformBuffer,
)

_NEARER: Final = {Depth.REVERSED: DepthFunction.GREATER, Depth.STANDARD: DepthFunction.LESS}
_WINDINGS: Final = ((False, FrontFace.COUNTER_CLOCKWISE), (True, FrontFace.CLOCKWISE))


class Occluder(sl.Struct):
    """An occluder's transform, relative to the eye."""

    linear: sl.mat3
    position: sl.vec3


class DrawOccluders(sl.Shader):
    """Draws occluders with no output but depth."""

    view: sl.Uniform[ViewConstants]
    occluders: sl.Storage[Occluder]

    def vertex(self, v: Vertex) -> sl.vec4:
        occluder = self.occluders[sl.instance_index()]
        position = occluder.linear @ v.position + occluder.position
        return self.view.relative_view_projection @ sl.vec4(position, 1.0)

    def fragment(self) -> None:
        pass


class TestBoxes(BoxTest):
    """Writes 1 for each visible box, 0 for the others."""

    margin = 1.0 + 1.0 / 64.0
    visible_flags: sl.StorageRW[sl.uint]

    def compute(self) -> None:
        box_index = sl.global_id().x
        if box_index < len(self.visible_flags):
            self.visible_flags[box_index] = sl.uint(1 if self.is_visible(self.boxes[box_index]) else 0)


class _DepthResources:
    """The resources that depend on the image's size: its depth, and the tiles."""

    def __init__(self, device: Device, size: tuple[int, int], texels: int) -> None:
        self.depth: Texture = device.texture(size, Format.D32F, label="occluder depth")
        self.pyramid = DepthPyramid(device, size)
        self.levels: UniformBuffer[PyramidLevels] = device.uniform(make_levels(self.pyramid, texels))

    def destroy(self) -> None:
        for part in (self.depth, self.pyramid, self.levels):
            part.destroy()


class OccluderDepth:
    """Draws the depth of some objects of a scene, and tests boxes against it."""

    def __init__(
        self,
        device: Device,
        scene: Scene,
        occluders: int,
        boxes: int,
        *,
        texels: int = DEFAULTS.pyramid_texels,
    ) -> None:
        """`occluders` and `boxes` are the largest numbers of objects drawn and of boxes tested at a time; a
        box is compared with at most `texels` × `texels` texels."""
        meshes = scene.meshes
        self._device = device
        self._scene = scene
        self._texels = texels
        self._mesh = device.mesh(meshes.vertices, meshes.indices, label="occluders")
        self._view = device.uniform(_view(np.eye(4, dtype=np.float32)))
        self._occluders = device.storage(Occluder, occluders, label="occluders")
        self._boxes = device.storage(Occludee, boxes, label="boxes")
        self._visible_flags = device.storage(sl.uint, boxes, label="shown")
        self._image: _DepthResources | None = None
        self._depth = Depth.REVERSED

    def render(self, camera: Camera, object_indices: Indices, size: tuple[int, int]) -> None:
        """Draw the objects `object_indices` (k,) in an image of `size` pixels. Doesn't wait for the
        device."""
        image = self._image
        if image is None or image.pyramid.size != size:
            old = image
            image = self._image = _DepthResources(self._device, size, self._texels)
            if old is not None:
                old.destroy()
        device, scene = self._device, self._scene
        self._depth = direction = camera.projection.depth
        world = scene.nodes.world[scene.objects.node[object_indices]]
        table = np.zeros(len(object_indices), Occluder.dtype)
        table["linear"][:, :, :3] = world[:, :3, :3]
        table["position"] = world[:, :3, 3] - camera.position
        if len(object_indices):
            self._occluders.write(table)
        self._view.write(_view(camera.relative_view_projection))
        ranges = scene.meshes.ranges[scene.objects.mesh[object_indices]]
        draws = self._mesh.draws(
            ranges["first_index"],
            ranges["index_count"],
            base_vertex=ranges["base_vertex"],
            base_instance=np.arange(len(object_indices)),
        )
        mirrored = np.linalg.det(world[:, :3, :3]) < 0.0
        program = device.program(DrawOccluders)
        with (
            device.render_pass(depth=image.depth, clear_depth=FAR[direction]),
            device.states(CullMode.BACK, DepthTest.ON, DepthWrite.ON, _NEARER[direction]),
        ):
            for turned, winding in _WINDINGS:
                part = draws[mirrored == turned]
                if len(part):
                    with device.states(winding):
                        device.draw_many(
                            program, self._mesh, part, view=self._view, occluders=self._occluders
                        )
        image.pyramid.build(device, image.depth, direction)

    def test_boxes(self, centre: Floats, half: Floats) -> NDArray[np.bool_]:
        """Return which boxes aren't behind what was rendered, (k,) bool. Waits for the device.

        `centre` (k, 3) is relative to the eye; `half` (k, 3) is the padded half size along the world's axes.
        The near plane must cut none of the boxes.
        """
        image, count = self._image, len(centre)
        assert image is not None, "render must be called first"
        if not count:
            return np.zeros(0, bool)
        table = np.zeros(count, Occludee.dtype)
        table["centre"] = centre
        for axis, name in enumerate("xyz"):
            table[name][:, axis] = half[:, axis]
        self._boxes.write(table)
        self._device.dispatch(
            self._device.program(depth_variant(TestBoxes, self._depth)),
            -(-count // GROUP),
            view=self._view,
            pyramid=image.levels,
            depth=image.depth,
            farthest=image.pyramid.farthest,
            boxes=self._boxes,
            visible_flags=self._visible_flags,
        )
        return self._visible_flags.read(0, count).astype(bool)

    def destroy(self) -> None:
        """Destroy the resources on the device."""
        for resource in (self._mesh, self._view, self._occluders, self._boxes, self._visible_flags):
            resource.destroy()
        if self._image is not None:
            self._image.destroy()
            self._image = None


def _view(matrix: NDArray[np.float32]) -> ViewConstants:
    return ViewConstants(relative_view_projection=matrix, eye_high=(0, 0, 0), eye_low=(0, 0, 0))
