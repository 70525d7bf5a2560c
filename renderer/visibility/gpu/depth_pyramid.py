"""Occlusion culling with a depth pyramid: boxes are compared with the farthest depths under them.

1. What was visible in the last frame is drawn.
2. A pyramid is built of the resulting depth, and each box is tested against it. Visible objects that aren't
   drawn yet are drawn; all visible objects are drawn first in the next frame.

A box is tested by one invocation: it compares the box's nearest depth with the texels under the rectangle
around its corners, in the finest level in which the rectangle is at most 8 texels wide and high, or as many
as settings say, or in the last level. The box is visible unless it is behind all of them. The texels of the
next coarser level are tested first: what is behind those is behind all of these. The rectangle is larger than
the box, and the depth of its texels farther than that of the pixels, so more is drawn than if boxes were
rasterised."""

from __future__ import annotations

from typing import Any, Final

import rhi.shading as sl
from renderer.scene import Camera, Depth, Scene
from renderer.shaders import ListEntry, ViewConstants
from renderer.shaders.prefix_sum import PrefixSum
from renderer.visibility.gpu.device_culling import DeviceCulling
from renderer.visibility.gpu.draw_lists import (
    CountKeys,
    CountMarks,
    WriteDraws,
    WriteObjects,
    count_parts,
    with_parts,
)
from renderer.visibility.gpu.farthest_depth import SCALE, STEPS, DepthPyramid, depth_variant
from renderer.visibility.gpu.meshlet_culling import (
    ALWAYS_VISIBLE,
    WAS_VISIBLE,
    CountMeshlets,
    CullMeshlets,
)
from renderer.visibility.gpu.occludees import DRAWN, GROUP, HIDDEN, VISIBLE, ComputeOccludees, Occludee
from renderer.visibility.scene_drawer import SceneArrays, SceneDrawer
from renderer.visibility.settings import DEFAULTS, VisibilitySettings
from rhi import Device, DrawPlan, Encoder, Preparation, UniformBuffer

_LEVELS: Final = 9
"""The number of levels of an image of 65,536 pixels a side, the image included."""


class PyramidLevels(sl.Struct):
    """The number of levels of a pyramid, and for each its width, height and first element; level 0 is the
    image. `texels` is the largest number of texels that a test covers in each direction."""

    levels: sl.Array[sl.ivec4] = sl.array(sl.ivec4, _LEVELS)
    count: int
    texels: int


class ComputeOccludeesWithHistory(ComputeOccludees):
    """Finds the boxes, and marks what was visible in the last frame VISIBLE."""

    was_visible: sl.Storage[sl.uint]

    def initial_mark(self, object_index: int) -> int:
        return VISIBLE if self.was_visible[object_index] == sl.uint(1) else HIDDEN


class BoxTest(sl.Shader):
    """Tests whether boxes are visible in a depth image, with its pyramid."""

    work_group = (GROUP,)
    view: sl.Uniform[ViewConstants]
    pyramid: sl.Uniform[PyramidLevels]
    depth: sl.Texture2D
    farthest: sl.Storage[float]
    boxes: sl.Storage[Occludee]
    is_reversed = True
    margin = 1.0 / 64.0
    """Margin of the rectangle in pixels, for the rounding of rasterisation."""

    def is_visible(self, box: Occludee) -> bool:
        size = sl.vec2(self.pyramid.levels[0].xy)
        nearest = 0.0 if self.is_reversed else 1.0
        lower = size
        upper = sl.vec2(0.0)
        for corner in range(8):
            point = box.centre
            point += box.x if corner % 2 == 1 else -box.x
            point += box.y if corner // 2 % 2 == 1 else -box.y
            point += box.z if corner // 4 == 1 else -box.z
            clip = self.view.relative_view_projection @ sl.vec4(point, 1.0)
            if not clip.w > 0.0:
                return True  # a corner is beside or behind the eye: there is no rectangle
            pixel = (sl.vec2(clip.x, -clip.y) / clip.w + 1.0) * 0.5 * size
            lower = sl.min(lower, pixel)
            upper = sl.max(upper, pixel)
            depth = clip.z / clip.w
            nearest = sl.max(nearest, depth) if self.is_reversed else sl.min(nearest, depth)
        begin = sl.ivec2(sl.clamp(sl.floor(lower - self.margin), sl.vec2(0.0), size))
        end = sl.ivec2(sl.clamp(sl.floor(upper + self.margin), sl.vec2(-1.0), size - 1.0))
        level = 0
        most = self.pyramid.texels
        while level < self.pyramid.count - 1 and (end.x - begin.x >= most or end.y - begin.y >= most):
            begin = begin // SCALE
            end = end // SCALE
            level += 1
        if level < self.pyramid.count - 1 and not self.is_before(
            nearest, level + 1, begin // SCALE, end // SCALE
        ):
            return False  # behind whole tiles: the finer texels needn't be read
        return self.is_before(nearest, level, begin, end)

    def is_before(self, nearest: float, level: int, begin: sl.ivec2, end: sl.ivec2) -> bool:
        for y in range(begin.y, end.y + 1):
            for x in range(begin.x, end.x + 1):
                behind = self.fetch(level, sl.ivec2(x, y))
                if (nearest >= behind) if self.is_reversed else (nearest <= behind):
                    return True
        return False

    def fetch(self, level: int, at: sl.ivec2) -> float:
        if level == 0:
            return self.depth.load(at).r
        level_info = self.pyramid.levels[level]
        return self.farthest[level_info.z + at.y * level_info.x + at.x]


class CompareBoxes(BoxTest):
    """Marks visible objects, and records them in `was_visible` for the next frame."""

    marks: sl.StorageRW[sl.uint]
    was_visible: sl.StorageRW[sl.uint]

    def compute(self) -> None:
        object_index = sl.global_id().x
        if object_index >= len(self.marks):
            return
        mark = self.marks[object_index]
        visible = False
        if mark == sl.uint(HIDDEN) or mark == sl.uint(DRAWN):
            visible = self.is_visible(self.boxes[object_index])
        self.was_visible[object_index] = sl.uint(1 if visible else 0)
        if visible and mark == sl.uint(HIDDEN):
            self.marks[object_index] = sl.uint(VISIBLE)


class CompareMeshlets(BoxTest):
    """Shows the meshlets of visible objects that a depth pyramid doesn't hide, and records them for the next frame."""

    entries: sl.Storage[ListEntry]
    marks: sl.Storage[sl.uint]
    states: sl.StorageRW[sl.uint]

    def compute(self) -> None:
        index = sl.global_id().x
        if index >= len(self.states):
            return
        mark = self.marks[self.entries[index].object]
        state = self.states[index]
        if mark != sl.uint(VISIBLE) and mark != sl.uint(DRAWN):
            return
        if state != sl.uint(HIDDEN) and state != sl.uint(DRAWN):
            return
        box = self.boxes[index]
        if box.depth == ALWAYS_VISIBLE or self.is_visible(box):
            self.states[index] = sl.uint(WAS_VISIBLE) + (
                sl.uint(VISIBLE) if state == sl.uint(HIDDEN) else state
            )


class DepthPyramidCulling(DeviceCulling):
    """Draws what was visible in the last frame, then what isn't behind it."""

    def __init__(self, scene: Scene, device: Device, settings: VisibilitySettings = DEFAULTS) -> None:
        super().__init__(scene, device, ComputeOccludeesWithHistory, settings)
        self._texels = settings.pyramid_texels
        self._was_visible = device.storage(sl.uint, len(scene.objects), label="was_visible")
        self._pyramid: DepthPyramid | None = None
        self._levels: UniformBuffer[PyramidLevels] = device.uniform(
            PyramidLevels(levels=[(0, 0, 0, 0)] * _LEVELS, count=0, texels=self._texels)
        )

    def _aim(self, camera: Camera, size: tuple[int, int]) -> tuple[object, ...]:
        return (self._fit(size),)

    def _mark_likely(self, encoder: Encoder, direction: Depth, scene_drawer: SceneDrawer) -> None:
        self._occludees.compute_boxes(encoder, scene_drawer.arrays, was_visible=self._was_visible)

    def _mark_missed(self, encoder: Encoder, direction: Depth, scene_drawer: SceneDrawer) -> None:
        pyramid, occludees = self._fit(scene_drawer.depth.size), self._occludees
        pyramid.build(encoder, scene_drawer.depth, direction)
        encoder.dispatch(
            self._device.program(depth_variant(CompareBoxes, direction)),
            occludees.groups,
            view=scene_drawer.arrays.view,
            pyramid=self._levels,
            depth=scene_drawer.depth,
            farthest=pyramid.farthest,
            boxes=occludees.boxes,
            marks=occludees.marks,
            was_visible=self._was_visible,
        )

    def _reveal_meshlets(
        self, encoder: Encoder, direction: Depth, scene_drawer: SceneDrawer, arrays: SceneArrays
    ) -> None:
        assert self.meshlets is not None
        self.meshlets.compare(
            encoder,
            arrays,
            self._occludees,
            depth_variant(CompareMeshlets, direction),
            pyramid=self._levels,
            depth=scene_drawer.depth,
            farthest=self._fit(scene_drawer.depth.size).farthest,
        )

    def _remember(self, encoder: Encoder, direction: Depth, scene_drawer: SceneDrawer) -> None:
        """Do nothing: the shader has recorded what was visible."""

    def _fit(self, size: tuple[int, int]) -> DepthPyramid:
        """Return the pyramid for an image of `size`; it is made again when the size changes."""
        pyramid = self._pyramid
        if pyramid is None or pyramid.size != size:
            old, pyramid = pyramid, DepthPyramid(self._device, size)
            self._pyramid = None
            if old is not None:
                old.destroy()
            self._levels.write(make_levels(pyramid, self._texels))
            self._pyramid = pyramid  # the last step, since it tells whether the levels are written
        return pyramid

    def destroy(self) -> None:
        """Destroy the resources on the device."""
        super().destroy()
        self._was_visible.destroy()
        self._levels.destroy()
        if self._pyramid is not None:
            self._pyramid.destroy()
            self._pyramid = None


def prepare_depth_pyramid(scene: Scene, device: Device, depth: Depth) -> Preparation:
    """Begin to build all that the algorithm dispatches in a scene whose depth has this direction."""
    parts = count_parts(scene)
    shaders: list[type[Any]] = [
        ComputeOccludeesWithHistory,
        CountMarks,
        PrefixSum,
        WriteObjects,
        with_parts(CountKeys, parts),
        with_parts(WriteDraws, parts),
    ]
    tests: list[type[Any]] = [*STEPS, CompareBoxes]
    if len(scene.meshes.meshlet_ranges):
        shaders += [CullMeshlets, CountMeshlets]
        tests.append(CompareMeshlets)
    shaders += [depth_variant(shader, depth) for shader in tests]
    return device.prepare([DrawPlan(device.program(shader)) for shader in shaders])


def make_levels(pyramid: DepthPyramid, texels: int = DEFAULTS.pyramid_texels) -> PyramidLevels:
    """Return a pyramid's levels as the shader reads them, with how many texels a test covers in each
    direction."""
    image_offset = 0  # isn't read: the shader reads level 0 from the depth texture
    offsets = [image_offset, *pyramid.offsets]
    levels = [(*size, offset, 0) for size, offset in zip(pyramid.sizes, offsets, strict=True)]
    unused = [(0, 0, 0, 0)] * (_LEVELS - len(levels))
    return PyramidLevels(levels=levels + unused, count=len(levels), texels=texels)
