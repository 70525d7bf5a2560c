"""Rectangles on the screen around the pixels of each material, found on the device (Deferred+, 1.3.2).

Each pixel's material is a depth of 16 bits in `material ids`. A material is shaded by drawing rectangles at
its depth: a depth test with EQUAL passes at its own pixels and at no others, before anything is shaded.

The chapter has one rectangle for each material, around the boxes of its visible objects. A material that is
used all over the scene then has the whole screen, and the depth tests are as many as materials times pixels.
Here a material has a rectangle in each *tile* of the screen that shows it, around its pixels there. So the
tests grow with the pixels that are covered and with the materials that meet in a tile, however many the scene
has; and it doesn't matter which algorithm found the visible objects. With a tile as large as the screen it is
the chapter's one rectangle. `bound_materials` finds that rectangle as the chapter does, on the CPU from the boxes of
objects.

A tile is examined by one invocation, which takes its materials in ascending order and looks at all pixels
once for each: no shared memory, and no limit on their number. A dispatch takes `_MATERIALS_PER_DISPATCH` of
them, because llvmpipe ends loops after 65,535 turns in all; as many dispatches follow as the scene's
materials may need, which leave at once where a tile has no more.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from itertools import product
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

import rhi.shading as sl
from renderer.frame import Frame, FramePass, Target
from renderer.frame.mirrors import MirroredValue
from renderer.scene import Camera, Depth, Scene
from renderer.shaders.encodings import material_depth
from renderer.shaders.pixels import BackgroundScreen
from renderer.shaders.structs import Material
from renderer.techniques.parts.full_screen import make_triangle
from renderer.techniques.parts.geometry_buffer import MAX_MATERIALS
from renderer.techniques.parts.variants import bind, list_shaders, shader_variant
from renderer.visibility.boxes.volumes import select_in_view
from rhi import (
    CullMode,
    DepthFunction,
    DepthTest,
    DepthWrite,
    Device,
    Format,
    IndirectDraws,
    Mesh,
    Program,
    StorageBuffer,
    Texture,
)

TILE: Final = 32
"""The side of a tile in pixels: larger ones have more materials each, smaller ones more rectangles."""
IDS_FORMAT: Final = Format.D16
"""The format of materials as depth."""

_GROUP: Final = 8
_LAST: Final = MAX_MATERIALS - 1
_MATERIALS_PER_DISPATCH: Final = 60
"""The materials of a tile that a dispatch takes: each is 32 × 33 turns of loops, and one more."""


class MaterialDepthOutput(sl.Struct):
    """Output of `MaterialIdShader`."""

    depth: sl.FragmentDepth


class MaterialIdShader(BackgroundScreen):
    """Writes each pixel's material as a depth."""

    packed: sl.UintTexture2D
    depth: sl.Texture2D

    def fragment(self) -> MaterialDepthOutput:
        pixel = sl.ivec2(sl.fragment_coordinate().xy)
        if self.depth.load(pixel).x == self.rays.farthest:
            sl.discard()
        return MaterialDepthOutput(
            depth=material_depth(self.material_id(int(self.packed.load(pixel).y & sl.uint(_LAST))))
        )

    def material_id(self, material_index: int) -> int:
        """The number that is written for a material."""
        return material_index


class ShaderIdShader(MaterialIdShader):
    """Writes the shader of each pixel's material as a depth."""

    materials: sl.Storage[Material]

    def material_id(self, material_index: int) -> int:
        return self.materials[material_index].shader


class TileSize(sl.Struct):
    """Side of a tile in pixels, and number of the scene's materials."""

    tile: int
    materials: int


class RectangleDraw(sl.Struct):
    """The arguments of an indirect draw without indices, laid out as `rhi.DRAW_UNINDEXED`."""

    count: sl.uint
    instances: sl.uint
    first: sl.uint
    base_instance: sl.uint
    unused: sl.uint


class MaterialRectangle(sl.Struct):
    """The part of a tile that shows a material: its first pixel (x in the low half), width and height
    (width in the low half), and the material."""

    first: sl.uint
    size: sl.uint
    material: sl.uint


class BuildRectangles(sl.Shader):
    """Lists the rectangles of all tiles."""

    work_group = (_GROUP, _GROUP)
    layout: sl.Uniform[TileSize]
    ids: sl.Texture2D
    rectangles: sl.StorageRW[MaterialRectangle]
    draw: sl.StorageRW[RectangleDraw]
    progress: sl.StorageRW[int]

    def compute(self) -> None:
        tile = sl.global_id().xy
        size = self.ids.size()
        begin = tile * self.layout.tile
        if begin.x >= size.x or begin.y >= size.y:
            return
        if tile.x == 0 and tile.y == 0:
            self.draw[0].count = sl.uint(6)
        end = sl.min(begin + self.layout.tile, size)
        across = (size.x + self.layout.tile - 1) // self.layout.tile
        last_material = self.progress[tile.y * across + tile.x] - 1
        is_left = last_material < self.layout.materials
        turn = 0
        while is_left and turn < _MATERIALS_PER_DISPATCH:
            turn += 1
            # the next material, and whether there are more beyond it
            next_material = self.layout.materials
            is_left = False
            first = end
            last = begin
            for y in range(begin.y, end.y):
                for x in range(begin.x, end.x):
                    material_index = int(sl.round(self.ids.load(sl.ivec2(x, y)).x * float(_LAST)))
                    if material_index > last_material and material_index < next_material:
                        is_left = is_left or next_material < self.layout.materials
                        next_material = material_index
                        first = sl.ivec2(x, y)
                        last = sl.ivec2(x, y)
                    elif material_index == next_material:
                        first = sl.min(first, sl.ivec2(x, y))
                        last = sl.max(last, sl.ivec2(x, y))
                    elif material_index > next_material and material_index < self.layout.materials:
                        is_left = True
            if next_material < self.layout.materials:
                extent = last - first + 1
                at = int(sl.atomic_add(self.draw[0].instances, sl.uint(1)))
                self.rectangles[at] = MaterialRectangle(
                    first=sl.uint(first.x) | sl.uint(first.y) << 16,
                    size=sl.uint(extent.x) | sl.uint(extent.y) << 16,
                    material=sl.uint(next_material),
                )
            last_material = next_material
        self.progress[tile.y * across + tile.x] = (last_material if is_left else self.layout.materials) + 1


class RectangleShader(BackgroundScreen):
    """Base of shaders that run for the pixels of materials: two triangles for each rectangle, at its
    material's depth."""

    shader = -1
    """The number of the shader whose materials are drawn; -1 for all."""

    rectangles: sl.Storage[MaterialRectangle]
    materials: sl.Storage[Material]

    def vertex(self) -> sl.vec4:
        rectangle = self.rectangles[sl.instance_index()]
        if self.shader >= 0 and self.materials[int(rectangle.material)].shader != self.shader:
            return sl.vec4(0.0, 0.0, 0.0, 1.0)
        corner = sl.vertex_index()
        if corner > 2:
            corner -= 2
        x = float((rectangle.first & 65535) + sl.uint(corner & 1) * (rectangle.size & 65535))
        y = float((rectangle.first >> 16) + sl.uint(corner >> 1) * (rectangle.size >> 16))
        corner_position = sl.vec2(x, y) / self.rays.size * 2.0 - 1.0
        return sl.vec4(corner_position.x, -corner_position.y, material_depth(int(rectangle.material)), 1.0)


RECTANGLE_SHADERS: Final[tuple[type[sl.Shader], ...]] = (MaterialIdShader, ShaderIdShader, BuildRectangles)
"""The shaders of `ids_pass` and `rectangles_pass`."""


class MaterialRectangles:
    """The rectangles of a frame.

    Attributes:
        tile: the side of a tile in pixels.
        rectangles: the list.
        draw: its indirect draw, whose number of instances is that of the rectangles.
        corners: the mesh that the rectangles are drawn as.
    """

    def __init__(self, device: Device, tile: int = TILE) -> None:
        self.tile = tile
        self.corners: Mesh = device.mesh(6, label="rectangle")
        self.draw: StorageBuffer[RectangleDraw] = device.storage(RectangleDraw, 1, label="rectangle draw")
        self.rectangles: StorageBuffer[MaterialRectangle] = device.storage(MaterialRectangle, 1)
        self._progress: StorageBuffer[int] = device.storage(int, 1, label="progress of rectangles")
        self._device = device
        self._layout = MirroredValue(device, TileSize(tile=tile, materials=0))

    def build(self, ids: Texture, materials: int) -> None:
        """List the rectangles of an image whose material indices are below `materials`."""
        device = self._device
        tiles = tuple(-(-side // self.tile) for side in ids.size)
        in_a_tile = min(materials, self.tile * self.tile)
        most = tiles[0] * tiles[1] * in_a_tile
        if self._progress.count < tiles[0] * tiles[1]:
            progress = device.storage(int, tiles[0] * tiles[1], label="progress of rectangles")
            old_progress, self._progress = self._progress, progress
            old_progress.destroy()
        if self.rectangles.count < most:
            rectangles = device.storage(MaterialRectangle, most, label="rectangles")
            old_rectangles, self.rectangles = self.rectangles, rectangles
            old_rectangles.destroy()
        self._layout.write(TileSize(tile=self.tile, materials=materials))
        self.draw.clear()
        self._progress.clear()
        for _ in range(0, in_a_tile, _MATERIALS_PER_DISPATCH):
            device.dispatch(
                device.program(BuildRectangles),
                tuple(-(-count // _GROUP) for count in tiles),
                layout=self._layout.buffer,
                ids=ids,
                rectangles=self.rectangles,
                draw=self.draw,
                progress=self._progress,
            )

    def write(self, rectangles: NDArray[np.int64]) -> None:
        """Write rectangles (k, 5): material, first x and y, width and height in pixels."""
        if self.rectangles.count < len(rectangles):
            listed = self._device.storage(MaterialRectangle, len(rectangles), label="rectangles")
            old_rectangles, self.rectangles = self.rectangles, listed
            old_rectangles.destroy()
        rows = np.zeros(len(rectangles), MaterialRectangle.dtype)
        material, x, y, width, height = rectangles.T
        rows["material"], rows["first"], rows["size"] = material, x | y << 16, width | height << 16
        if len(rows):
            self.rectangles.write(rows)
        draw = np.zeros(1, RectangleDraw.dtype)
        draw["count"], draw["instances"] = 6, len(rows)
        self.draw.write(draw)

    def read(self) -> NDArray[Any]:
        """Rectangles (k, 5): material, first x and y, width and height in pixels. Waits for the device."""
        rows = self.rectangles.read()[: int(self.draw.read()[0]["instances"])]
        first, size = rows["first"], rows["size"]
        parts = (rows["material"], first & 0xFFFF, first >> 16, size & 0xFFFF, size >> 16)
        result: NDArray[Any] = np.stack(parts, axis=1).astype(np.int64)
        return result

    def destroy(self) -> None:
        """Destroy the resources on the device."""
        for resource in (self.corners, self.draw, self.rectangles, self._layout, self._progress):
            resource.destroy()


def ids_pass(*, by_shader: bool = False) -> FramePass[Frame]:
    """The pass that writes `material ids`: materials, or their shaders."""
    return FramePass(
        "material ids",
        partial(draw_ids, by_shader=by_shader),
        "a depth test tells the pixels of a material",
        reads=("packed", "depth"),
        writes=(Target("material ids", IDS_FORMAT),),
    )


def draw_ids(frame: Frame, *, by_shader: bool = False) -> None:
    """Write each pixel's material, or its shader, as a depth. The background has the largest, 1."""
    device, targets = frame.device, frame.targets
    states = CullMode.NONE, DepthTest.ON, DepthWrite.ON, DepthFunction.ALWAYS
    program: Program[...] = device.program(ShaderIdShader if by_shader else MaterialIdShader)
    with device.render_pass(None, targets["material ids"], clear_depth=1.0), device.states(*states):
        device.draw(program, frame.view.workspace(make_triangle), **bind(frame, program, {}))


def rectangles_pass() -> FramePass[Frame]:
    """The pass that lists the rectangles, as the resource `rectangles`."""

    def build(frame: Frame) -> None:
        rectangles = frame.view.workspace(MaterialRectangles)
        rectangles.build(frame.targets["material ids"], len(frame.resources.scene.materials))

    return FramePass(
        "rectangles",
        build,
        "a material is shaded where it is seen",
        reads=("material ids",),
        writes=("rectangles",),
    )


def object_rectangles_pass() -> FramePass[Frame]:
    """The pass that bounds materials by the boxes of their objects in view, as the resource `rectangles`."""

    def bound(frame: Frame) -> None:
        rows = bound_materials(frame.resources.scene, frame.camera, frame.targets.size)
        frame.view.workspace(MaterialRectangles).write(rows)

    return FramePass(
        "rectangles", bound, "a material is shaded where its objects are", writes=("rectangles",)
    )


def bound_materials(scene: Scene, camera: Camera, size: tuple[int, int]) -> NDArray[np.int64]:
    """The rectangle of each material in view around the boxes of its objects: (k, 5) material, first x and y, width
    and height in pixels. A box that reaches before the near plane has the whole image."""
    objects = scene.objects
    object_indices = select_in_view(scene, camera, np.arange(len(objects)))
    ends = np.stack([objects.lower[object_indices], objects.upper[object_indices]], axis=1)
    corners = np.stack([ends[:, [a, b, c], [0, 1, 2]] for a, b, c in product((0, 1), repeat=3)], axis=1)
    toward = (corners - camera.position) @ camera.rotation.T
    matrix = np.asarray(camera.projection.matrix, np.float64)
    clip = toward @ matrix[:, :3].T + matrix[:, 3]
    near = clip[..., 3] - clip[..., 2] if camera.projection.depth is Depth.REVERSED else clip[..., 2]
    is_before = (near < 0.0) | (clip[..., 3] <= 0.0)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        on_screen = clip[..., :2] / clip[..., 3:]
    pixels = (0.5 + 0.5 * on_screen * (1.0, -1.0)) * size
    is_whole = np.asarray(is_before.any(axis=1) | ~np.isfinite(pixels).all(axis=(1, 2)))
    # A pixel more on each side is for rounding, of the rasteriser, too.
    first = np.where(is_whole[:, None], 0.0, pixels.min(axis=1) - 1.0).clip(0.0, size)
    last = np.where(is_whole[:, None], size, pixels.max(axis=1) + 1.0).clip(0.0, size)
    material_indices, slots = np.unique(objects.material[object_indices], return_inverse=True)
    begin = np.tile(np.asarray(size, np.float64), (len(material_indices), 1))
    end = np.zeros_like(begin)
    np.minimum.at(begin, slots, first)
    np.maximum.at(end, slots, last)
    begin, end = np.floor(begin).astype(np.int64), np.ceil(end).astype(np.int64)
    rows = np.column_stack([material_indices, begin, end - begin])
    return rows[(end > begin).all(axis=1)]


def draw_rectangles(
    frame: Frame,
    shader: type[RectangleShader],
    shader_bindings: Mapping[str, Any],
    switches: Mapping[str, Any],
) -> None:
    """Make the image: clear it to the background, and run a shader for the pixels of each material."""
    device, rectangles = frame.device, frame.view.workspace(MaterialRectangles)
    bound = {**shader_bindings, "rectangles": rectangles.rectangles}
    drawn = []
    shaders = list_shaders(frame)
    for number, bases, parameters in shaders:
        only = number if len(shaders) > 1 else -1
        program: Program[...] = frame.program(shader_variant(frame, *bases, shader, **switches, shader=only))
        drawn.append((program, bind(frame, program, bound | parameters)))
    states = CullMode.NONE, DepthTest.ON, DepthWrite.OFF, DepthFunction.EQUAL
    ids, clear = frame.targets["material ids"], frame.background
    with device.render_pass(frame.image, ids, clear=clear), device.states(*states):
        for program, bindings in drawn:
            device.draw_indirect(program, rectangles.corners, IndirectDraws(rectangles.draw, 1), **bindings)
