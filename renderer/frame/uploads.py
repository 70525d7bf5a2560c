"""Uploads of a scene over many frames: at most so many bytes of meshes and images in each, what is large on the
screen first.

Until its mesh is on the device, an object is hidden. A surface whose image isn't there yet has the mean colour of
the image. Objects whose image decides where they are (masks, blended surfaces) and those of materials with shaders of
their own wait for their images. Once all is there, frames equal those of a scene that was uploaded at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import gcd
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer import rules
from renderer.frame.scene_images import ImageUpload, SceneImages
from renderer.scene import AlphaMode, Camera, Scene
from renderer.scene.arrays import Floats, Indices
from renderer.scene.images import ImageBlocks, ImagePixels, read_values
from renderer.scene.material_instances import list_textures
from renderer.scene.materials import TEXTURES
from renderer.visibility.boxes.volumes import Containment, classify
from rhi import Buffer, Device, Texture
from rhi.errors import refuse

_LEAST: Final = 1 << 18
_MEAN_TEXELS: Final = 4096
"""Means of images are of about so many texels."""


@dataclass(frozen=True, slots=True)
class UploadSettings:
    """Settings of how a scene is uploaded.

    Attributes:
        bytes_per_frame: the most bytes of meshes and images in a frame, 2¹⁸ or more. Tables of objects, materials
            and lights are uploaded whole. A tall image of a texture table is written once more, in one frame.
    """

    bytes_per_frame: int = 8 << 20

    def __post_init__(self) -> None:
        call = "UploadSettings(bytes_per_frame=...)"
        count = rules.check_count(rules.BAD_UPLOADS, call, self.bytes_per_frame, _LEAST)
        object.__setattr__(self, "bytes_per_frame", count)


@dataclass(frozen=True, slots=True)
class UploadProgress:
    """The progress of uploads.

    Attributes:
        fraction: of all bytes, 0 to 1.
        item: the mesh or image that is uploaded next, an empty text when all are.
        waiting_objects: the number of objects that are hidden until then.
    """

    fraction: float
    item: str
    waiting_objects: int


@dataclass(slots=True)
class _Item:
    """A mesh or an image that is uploaded: its name, all its bytes, and how many of them are on the device."""

    name: str
    bytes: int
    users: Indices  # the objects that use it
    mesh: int = -1
    image: ImageUpload | None = None
    done: int = 0
    texels: ImagePixels | None = None
    blocks: ImageBlocks | None = None
    staging: Texture | None = None


class SceneUploads:
    """The meshes and images of a scene that aren't on the device yet.

    Attributes:
        settings: may be exchanged between any two frames.
    """

    def __init__(
        self,
        device: Device,
        scene: Scene,
        settings: UploadSettings,
        vertices: Buffer,
        indices: Buffer,
        images: SceneImages | None,
    ) -> None:
        self.settings = settings
        self._device, self._scene = device, scene
        self._vertices, self._indices = vertices, indices
        self._mesh_ready: NDArray[np.bool_] = np.zeros(len(scene.meshes), bool)
        self._texture_ready: NDArray[np.bool_] = np.zeros(len(scene.textures), bool)
        if images is not None and images.stream is not None:
            self._texture_ready[:] = True  # the coarsest levels are there
        self._means: Floats = np.ones((len(scene.textures), 4))
        self._pending = [*self._list_meshes(), *(self._list_images(images) if images is not None else ())]
        self._total = sum(item.bytes for item in self._pending)
        self._note_ready()

    @property
    def is_done(self) -> bool:
        """True once everything is on the device."""
        return not self._pending

    @property
    def progress(self) -> UploadProgress:
        """The fraction that is on the device, and the next item."""
        left = sum(item.bytes - item.done for item in self._pending)
        fraction = 1.0 - left / self._total if self._total else 1.0
        name = self._pending[0].name if self._pending else ""
        return UploadProgress(fraction, name, int(self._flag_waiting().sum()))

    def advance(self, camera: Camera) -> None:
        """Upload what the budget of a frame allows, first what is large in the view of `camera`."""
        self._upload(camera, self.settings.bytes_per_frame)

    def finish(self, camera: Camera | None = None) -> None:
        """Upload all that is left."""
        while self._pending:
            self._upload(camera, self._total)

    def mask(self, materials: NDArray[Any]) -> NDArray[Any]:
        """Return materials (k,) that read only the images that are there; means stand for the others."""
        if self._texture_ready.all():
            return materials
        masked = materials.copy()
        for name in TEXTURES:
            rows = materials[name]
            missing = np.flatnonzero((rows >= 0) & ~self._texture_ready[np.maximum(rows, 0)])
            means = self._means[rows[missing]]
            masked[name][missing] = -1
            if name == "texture":
                masked["base_color"][missing] *= means
            elif name == "emissive_texture":
                masked["emissive"][missing] *= means[:, :3]
            elif name == "metallic_roughness_texture":
                masked["roughness"][missing] *= means[:, 1]
                masked["metallic"][missing] *= means[:, 2]
        return masked

    def destroy(self) -> None:
        """Destroy what is only needed for uploads, and show all objects again."""
        for item in self._pending:
            if item.staging is not None:
                item.staging.destroy()
        if self._pending:
            self._pending = []
            self._scene.set_waiting(np.zeros(len(self._scene.objects), bool))

    def _list_meshes(self) -> list[_Item]:
        meshes, scene = self._scene.meshes, self._scene
        sizes = (
            meshes.vertex_counts * meshes.vertices.itemsize
            + meshes.ranges["index_count"].astype(np.int64) * 4
        )
        order = np.argsort(scene.objects.mesh, kind="stable")
        ends = np.searchsorted(scene.objects.mesh[order], np.arange(len(meshes) + 1))
        return [
            _Item(
                f"mesh {meshes.names[mesh] or mesh}",
                int(sizes[mesh]),
                order[ends[mesh] : ends[mesh + 1]],
                mesh,
            )
            for mesh in range(len(meshes))
        ]

    def _list_images(self, images: SceneImages) -> list[_Item]:
        scene, items = self._scene, []
        for upload in images.uploads:
            users = np.flatnonzero(self._flag_readers(upload.textures)[scene.objects.material])
            items.append(_Item(f"image {upload.image}", upload.bytes, users, image=upload))
            self._means[upload.textures] = _compute_mean(scene.images[upload.image], upload.is_color)
        return items

    def _flag_readers(self, textures: Indices, *, only_needed: bool = False) -> NDArray[np.bool_]:
        """Return which materials (k,) read any of the textures; with `only_needed`, those whose objects wait."""
        scene, materials = self._scene, self._scene.materials
        reads = np.zeros(len(materials), bool)
        decides = materials["alpha_mode"] != AlphaMode.OPAQUE
        for name in TEXTURES:
            waits = decides | (materials["shader"] > 0) if only_needed else True
            reads |= np.isin(materials[name], textures) & waits
        for number, (shader, values) in enumerate(zip(scene.shaders, scene.parameters, strict=True), 1):
            for name in list_textures(shader).keys() - TEXTURES.keys():
                if len(values):
                    reads |= np.isin(values[name], textures) & (materials["shader"] == number)
        return reads

    def _flag_waiting(self) -> NDArray[np.bool_]:
        objects = self._scene.objects
        missing = np.flatnonzero(~self._texture_ready)
        waits = self._flag_readers(missing, only_needed=True)
        flags: NDArray[np.bool_] = ~self._mesh_ready[objects.mesh] | waits[objects.material]
        return flags

    def _note_ready(self) -> None:
        self._scene.set_waiting(self._flag_waiting())

    def _measure_sizes(self, camera: Camera | None) -> Floats:
        """Return the size (n,) of each object on the screen: what is in view is above 1, and the rest below."""
        objects = self._scene.objects
        if camera is None:
            return np.zeros(len(objects))
        middle, reach = 0.5 * (objects.lower + objects.upper), 0.5 * (objects.upper - objects.lower)
        radius = np.linalg.norm(reach, axis=1)
        distance = np.linalg.norm(middle - camera.position, axis=1)
        size = radius / np.maximum(np.maximum(distance, radius), 1e-30)
        side = classify(camera.frustum.planes, objects.lower, objects.upper)
        sizes: Floats = np.where(side != Containment.OUTSIDE, 1.0 + size, 0.5 * size)
        sizes[self._scene.nodes.hidden[objects.node]] = 0.0
        return sizes

    def _upload(self, camera: Camera | None, budget: int) -> None:
        if not self._pending:
            return
        sizes = self._measure_sizes(camera)

        def rank(item: _Item) -> tuple[bool, bool, float]:
            largest = float(sizes[item.users].max(initial=0.0))
            return largest < 1.0, item.mesh < 0, -largest  # in view, meshes before images, the largest first

        self._pending.sort(key=rank)
        left, has_news = budget, False
        while self._pending and left > 0:
            item = self._pending[0]
            before = self._device.statistics.upload_bytes
            written = self._write_mesh(item, left) if item.image is None else self._write_image(item, left)
            left -= max(written, self._device.statistics.upload_bytes - before)
            if item.done == item.bytes:
                del self._pending[0]
                has_news = True
            elif not written:
                break
        if has_news:
            self._note_ready()

    def _write_mesh(self, item: _Item, most: int) -> int:
        """Write a part of a mesh of at most so many bytes; return its bytes."""
        meshes = self._scene.meshes
        first, count, base = (int(value) for value in meshes.ranges[item.mesh])
        stride, vertex_count = meshes.vertices.itemsize, int(meshes.vertex_counts[item.mesh])
        vertex_bytes, written = vertex_count * stride, 0
        if item.done < vertex_bytes:
            at = item.done // stride
            number = min(vertex_count - at, most // stride)
            if number:
                self._vertices.write(meshes.vertices[base + at : base + at + number], base + at)
            written = number * stride
        if item.done + written >= vertex_bytes:
            at = (item.done + written - vertex_bytes) // 4
            number = min(count - at, (most - written) // 4)
            if number:
                self._indices.write(meshes.indices[first + at : first + at + number], first + at)
            written += number * 4
        item.done += written
        if item.done == item.bytes:
            self._mesh_ready[item.mesh] = True
        return written

    def _write_image(self, item: _Item, most: int) -> int:
        """Write rows of an image of at most so many bytes, and copy it where it is read once it is whole."""
        upload = item.image
        assert upload is not None
        if upload.target is not None:
            return self._write_blocks(item, upload, *upload.target, most)
        height = upload.size[1]
        pitch = upload.bytes // height
        first = item.done // pitch
        count = min(height - first, most // pitch)
        if not count:
            return 0
        if item.staging is None or item.texels is None:
            texels = upload.read()
            assert isinstance(texels, np.ndarray)
            item.texels = texels
            item.staging = self._device.texture(upload.size, upload.format, levels=None, label=item.name)
        item.staging.write(item.texels[first : first + count], y=first)
        item.done += count * pitch
        if item.done == item.bytes:
            item.staging.generate_mipmaps()
            for copy in upload.copies:
                copy(item.staging)
            item.staging.destroy()
            item.staging = item.texels = None
            self._texture_ready[upload.textures] = True
        return count * pitch

    def _write_blocks(self, item: _Item, upload: ImageUpload, target: Texture, layer: int, most: int) -> int:
        """Write rows of blocks of at most so many bytes, level after level."""
        if item.blocks is None:
            blocks = upload.read()
            assert isinstance(blocks, ImageBlocks)
            item.blocks, item.bytes = blocks, blocks.bytes
        written = 0
        while item.done < item.bytes:
            level, row = _locate_row(item.blocks, item.done)
            rows = item.blocks.levels[level]
            count = min(len(rows) - row, (most - written) // rows[0].nbytes)
            if not count:
                break
            target.write(rows[row : row + count], level, layer, y=4 * row)
            item.done += count * rows[0].nbytes
            written += count * rows[0].nbytes
        if item.done == item.bytes:
            item.blocks = None
            self._texture_ready[upload.textures] = True
        return written


def _locate_row(blocks: ImageBlocks, done: int) -> tuple[int, int]:
    """Return the level and the row of blocks at which so many bytes are written."""
    for level, rows in enumerate(blocks.levels):
        if done < rows.nbytes:
            return level, done // rows[0].nbytes
        done -= rows.nbytes
    return len(blocks.levels), 0


def _compute_mean(image: ImagePixels, is_color: bool) -> Floats:
    """Return the mean (4,) of an image's texels, of colours in linear light, from a part of them."""
    texels, width = image.reshape(-1, 4), image.shape[1]
    step = max(len(texels) // _MEAN_TEXELS, 1)
    while gcd(step, width) > 1:  # else only some columns are read
        step += 1
    mean: Floats = read_values(texels[::step], is_color=is_color).mean(axis=0)
    return mean


def check_uploads(value: object) -> UploadSettings | None:
    """Return upload settings, or None for uploads at once; refuse anything else."""
    if value is not None and not isinstance(value, UploadSettings):
        refuse(rules.BAD_UPLOADS, "Renderer(uploads=...)", value, "UploadSettings, or None")
    return value
