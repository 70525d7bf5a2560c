"""The images of a scene on a device: arrays of textures, or two texture tables.

A shader reads all images of a scene in one draw. Where they have few sizes, images are layers of arrays, one
for each size; colours (sRGB), data (linear) and images of high range (RGBA16F) have arrays of their own. So they
take the memory of their texels and mip levels, and no more, and the device's own samplers read them.

A shader binds each array once for each sampler that reads it, at most `MAX_ARRAYS` in all. If a scene has
more sizes or samplers, colours and data are in a `TextureTable` each. There too each image keeps its own
size, mip levels and sampler. All images of a table have one format: one of high range makes all of them RGBA16F.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from math import inf
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer import rules
from renderer.content.compression import check_compression, choose_format, compress_image
from renderer.frame.streamed_images import ArrayKind, ImageStream, StreamedImage, list_kinds
from renderer.frame.texture_needs import TextureNeeds
from renderer.scene import Camera, Scene
from renderer.scene.images import Compression, ImageBlocks, ImagePixels, has_high_range, read_values
from renderer.scene.material_instances import collect_normal_images
from renderer.shaders.structs import TextureUse
from rhi import (
    CompressedFormat,
    Device,
    Filter,
    Format,
    SamplerDescriptor,
    StorageBuffer,
    Texture,
    TextureKind,
    TextureTable,
    refuse,
)
from rhi.shading import TextureBinding

MAX_ARRAYS: Final = 8
"""The most arrays that a shader binds: devices have 16 textures, and techniques read up to 8 of their own, and
one more of an environment."""
_BLOCK: Final = 4
_MIB: Final = 1 << 20
_MAX_BIAS: Final = 16.0
"""The most levels of a bias: there are no more levels."""

Size = tuple[int, int]
"""Width and height in texels."""
ImageFormat = Format | CompressedFormat


@dataclass(frozen=True, slots=True)
class TextureSettings:
    """Settings of texture filtering. A texture's own sampler may ask for less mip levels and bias, or more
    anisotropy.

    Attributes:
        filter: whether texels are mixed with their neighbours.
        mip: whether mip levels are mixed, or the nearest is read; None for the largest level alone.
        anisotropy: the most samples along a pixel's longer side, where the device has that: at most its
            `capabilities.max_anisotropy`.
        mip_bias: what is added to the mip level, −16 to 16: a pixel is taken to cover 2^bias times as many
            texels in each direction. Below 0 textures are sharper, and flicker.
        compression: the format in which images of 8 bits are compressed, where the device stores it as it is. It
            needs the package etcpak. Images that have blocks keep these.
        memory: the most MiB (2²⁰ bytes) of images on the device; 0 for all levels of all images. Images then have the
            levels that are read, as far as they fit (`streamed_images`). Images in texture tables have all.
        memory_per_frame: the most MiB of images that a frame uploads then; 0 for what the frame reads.
    """

    filter: Filter = Filter.LINEAR
    mip: Filter | None = Filter.LINEAR
    anisotropy: float = 1.0
    mip_bias: float = 0.0
    compression: Compression = Compression.NONE
    memory: float = 0.0
    memory_per_frame: float = 0.0

    def __post_init__(self) -> None:
        rules.check_types(self, rules.BAD_TEXTURES)
        rules.check_non_negative(rules.BAD_TEXTURES, "TextureSettings(memory=...)", self.memory)
        call = "TextureSettings(memory_per_frame=...)"
        rules.check_non_negative(rules.BAD_TEXTURES, call, self.memory_per_frame)
        if not 1.0 <= self.anisotropy < inf:
            refuse(
                rules.BAD_TEXTURES, "TextureSettings(anisotropy=...)", self.anisotropy, "1 or more, finite"
            )
        if not -_MAX_BIAS <= self.mip_bias <= _MAX_BIAS:
            allowed = f"{-_MAX_BIAS:g} to {_MAX_BIAS:g}"
            refuse(rules.BAD_TEXTURES, "TextureSettings(mip_bias=...)", self.mip_bias, allowed)

    def adjust(self, sampler: SamplerDescriptor, most: float) -> SamplerDescriptor:
        """A texture's sampler with these settings, on a device with at most this anisotropy."""
        minify, magnify, mip = sampler.minify, sampler.magnify, sampler.mip
        if self.filter is Filter.NEAREST:
            minify = magnify = Filter.NEAREST
        if self.mip is None or (self.mip is Filter.NEAREST and mip is not None):
            mip = self.mip
        anisotropy = min(max(sampler.max_anisotropy, self.anisotropy), max(most, sampler.max_anisotropy))
        return replace(sampler, minify=minify, magnify=magnify, mip=mip, max_anisotropy=anisotropy)


SAMPLER_DEFAULTS: Final = TextureSettings()
"""Textures are read as their own samplers ask for."""


@dataclass(frozen=True, slots=True)
class ImageArray:
    """An array texture: the size, format and mip levels of its layers, whether they are colours, the images in
    them, and the samplers that read it, as indices of the scene."""

    size: Size
    format: ImageFormat
    levels: int
    is_color: bool
    images: tuple[int, ...]
    samplers: frozenset[int]

    @property
    def bytes(self) -> int:
        """The memory of all layers with their levels."""
        return len(self.images) * count_bytes(self.size, self.format, self.levels)


@dataclass(slots=True)
class ImageUpload:
    """An image that is to be uploaded: to a texture of its own, whose levels are then copied where shaders read them.

    Attributes:
        image: its index in the scene.
        is_color: whether it is uploaded as colours.
        format: the format on the device.
        size: in texels, on the device.
        read: returns its texels (height, width, 4) as the format has them; its blocks if that is compressed.
        copies: copy a texture with all levels to where shaders read them.
        target: the texture and the layer to which blocks are written; they can't be copied.
        textures: (k,) the indices of the scene's textures that are complete then.
    """

    image: int
    is_color: bool
    format: ImageFormat
    size: Size
    read: Callable[[], ImagePixels | ImageBlocks]
    copies: tuple[Callable[[Texture], None], ...]
    target: tuple[Texture, int] | None = None
    textures: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))

    @property
    def bytes(self) -> int:
        """The bytes that are written: those of the largest level, from which others are made, or of all blocks."""
        if isinstance(self.format, CompressedFormat):
            return count_bytes(self.size, self.format)
        return self.size[0] * self.size[1] * self.format.transfer_bytes


def image_format(image: ImagePixels, *, is_color: bool) -> Format:
    """The texel format of an image on a device."""
    if has_high_range(image):
        return Format.RGBA16F
    return Format.RGBA8_SRGB if is_color else Format.RGBA8


def count_bytes(size: Size, format: ImageFormat = Format.RGBA8, levels: int = 0) -> int:
    """Bytes of an image with so many mip levels; with all of them for 0."""
    width, height = size
    total = 0
    for _ in range(levels or count_levels(size)):
        if isinstance(format, CompressedFormat):
            total += -(-width // _BLOCK) * -(-height // _BLOCK) * format.block_bytes
        else:
            total += width * height * format.transfer_bytes
        width, height = max(width // 2, 1), max(height // 2, 1)
    return total


def count_levels(size: Size) -> int:
    """The number of mip levels down to a texel."""
    return max(size).bit_length()


def plan_arrays(
    sizes: Sequence[Size],
    uses: Sequence[tuple[int, bool, int]],
    formats: Sequence[ImageFormat],
    levels: Mapping[int, int] = MappingProxyType({}),
) -> list[ImageArray]:
    """The array textures that hold images of these sizes.

    Args:
        uses: image, whether it holds colours, and sampler, of each texture.
        formats: the format of each use's image.
        levels: the mip levels of images that haven't all.
    """
    groups: dict[tuple[Size, ImageFormat, int, bool], tuple[dict[int, None], set[int]]] = {}
    for (image, is_color, sampler), format in zip(uses, formats, strict=True):
        count = count_levels(sizes[image])
        if isinstance(format, CompressedFormat):
            count = levels.get(image, count)
        images, samplers = groups.setdefault((sizes[image], format, count, is_color), ({}, set()))
        images[image] = None
        samplers.add(sampler)
    return [
        ImageArray(size, format, count, is_color, tuple(images), frozenset(samplers))
        for (size, format, count, is_color), (images, samplers) in groups.items()
    ]


def count_bindings(
    sizes: Sequence[Size], uses: Sequence[tuple[int, bool, int]], formats: Sequence[ImageFormat]
) -> int:
    """The number of arrays with their samplers that hold images of these sizes; `uses` and `formats` are those
    of `plan_arrays`."""
    used = zip(uses, formats, strict=True)
    return len({(sizes[image], format, is_color, sampler) for (image, is_color, sampler), format in used})


class SceneImages:
    """The images that a scene's textures refer to, on a device.

    Attributes:
        textures: the arrays, or the pages of the tables.
        arrays: what a shader binds: each array with a sampler.
        samplers: those.
        colors, data: the arrays of colours, which come first, and of data. A texture's row of the table has
            its place among those of its kind: a shader compares it with no others.
        tables: the texture tables of colours and of data, None for a kind that the scene lacks; None if the
            images are in arrays.
        table: (t,) of `TextureUse`, how each texture of the scene is read. None if the row of a texture is
            its layer, and texture coordinates are read as they are.
        gradient_scale: the factor of texture gradients, 2^`mip_bias`.
        has_bright_texels: whether any texel is above 1.
        has_two_channels: whether a normal map has two channels, and its third is that of a unit normal.
        stream: the arrays of images within a budget; None if all levels are on the device.
        bytes: the memory of the arrays or tables.
        image_bytes: that of the images, each by itself.
    """

    def __init__(
        self,
        device: Device,
        scene: Scene,
        settings: TextureSettings = SAMPLER_DEFAULTS,
        *,
        is_streamed: bool = False,
    ) -> None:
        """Create the arrays or tables, and upload the images unless `is_streamed`: then `uploads` lists what is to
        be uploaded."""
        self.uploads: list[ImageUpload] = []
        self._is_streamed = is_streamed
        self.gradient_scale = 2.0**settings.mip_bias
        textures, limit = scene.textures, device.capabilities.max_texture_size
        uses = [(int(row["image"]), bool(row["is_color"]), int(row["sampler"])) for row in textures]
        sizes = [(min(image.shape[1], limit), min(image.shape[0], limit)) for image in scene.images]
        table: NDArray[Any] = np.zeros(len(textures), TextureUse.dtype)
        self.tables: tuple[TextureTable | None, TextureTable | None] | None = None
        self.stream: ImageStream | None = None
        formats: list[ImageFormat] = [
            image_format(scene.images[image], is_color=is_color) for image, is_color, _ in uses
        ]
        used = {use[0] for use, format in zip(uses, formats, strict=True) if format is Format.RGBA16F}
        self.has_bright_texels = any(float(scene.images[image].max()) > 1.0 for image in used)
        self._levels = {image: len(blocks.levels) for image, blocks in scene.blocks.items()}
        self.has_two_channels = False
        if settings.compression is not Compression.NONE or scene.blocks:
            compressed = _choose_formats(device, scene, settings.compression, uses, formats)
            if count_bindings(sizes, uses, compressed) <= MAX_ARRAYS - (scene.environment is not None):
                formats = compressed
                self.has_two_channels = CompressedFormat.BC5 in formats
        if count_bindings(sizes, uses, formats) > MAX_ARRAYS - (scene.environment is not None):
            self._make_tables(device, scene, settings, uses, table)
        elif settings.memory:
            self._make_stream(device, scene, settings, sizes, uses, formats, table)
        else:
            self._make_arrays(device, scene, settings, sizes, uses, formats, table)
        self._rows = table
        self.image_bytes = sum(
            count_bytes(sizes[image], format, self._count_levels(image, format))
            for image, _, format in {(*use[:2], format) for use, format in zip(uses, formats, strict=True)}
        )
        table["u"], table["v"] = textures["transform"][:, 0], textures["transform"][:, 1]
        table["uv_set"] = textures["uv_set"]
        is_plain = (
            self.stream is None
            and len(self.arrays) == 1
            and (table["layer"] == np.arange(len(table))).all()
            and (textures["transform"] == np.eye(2, 3)).all()
            and not textures["uv_set"].any()
        )
        self.table: StorageBuffer[TextureUse] | None = (
            None if is_plain else device.storage(TextureUse, table, label="textures")
        )

    @property
    def version(self) -> int:
        """A number that changes whenever textures are in other arrays or layers."""
        return 0 if self.stream is None else self.stream.version

    def advance(self, cameras: Sequence[Camera], size: Size) -> None:
        """Choose and upload the levels that images should have in a frame of this size through these cameras."""
        if self.stream is not None and self.stream.advance(cameras, size):
            self._bind_stream()
            assert self.table is not None
            self.table.write(self._rows)

    def arrays_and_layers(self, textures: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return the arrays (k,) and the layers (k,) in which shaders find textures (k,)."""
        return self._rows["array"][textures], self._rows["layer"][textures]

    def _make_arrays(
        self,
        device: Device,
        scene: Scene,
        settings: TextureSettings,
        sizes: Sequence[Size],
        uses: Sequence[tuple[int, bool, int]],
        formats: Sequence[ImageFormat],
        table: NDArray[Any],
    ) -> None:
        """Make an array for each size, and write where each texture is into the table."""
        planned = sorted(
            plan_arrays(sizes, uses, formats, self._levels), key=lambda array: not array.is_color
        )
        self.bytes = sum(array.bytes for array in planned)
        self.textures: tuple[Texture, ...] = tuple(
            self._make_streamed_array(device, scene, array)
            if self._is_streamed
            else self._make_array(device, scene, array)
            for array in planned
        )
        self._list_textures(uses)
        bound = [
            (array, sampler) for array in range(len(planned)) for sampler in sorted(planned[array].samplers)
        ]
        most = device.capabilities.max_anisotropy
        self.samplers: tuple[SamplerDescriptor, ...] = tuple(
            settings.adjust(scene.samplers[sampler], most) for _, sampler in bound
        )
        self.arrays: tuple[TextureBinding, ...] = tuple(
            self.textures[array].sampled(sampler)
            for (array, _), sampler in zip(bound, self.samplers, strict=True)
        )
        color_count = sum(planned[array].is_color for array, _ in bound)
        self.colors, self.data = self.arrays[:color_count], self.arrays[color_count:]
        for row, ((image, is_color, sampler), format) in enumerate(zip(uses, formats, strict=True)):
            key = is_color, format
            array = next(
                number
                for number, plan in enumerate(planned)
                if (plan.is_color, plan.format) == key and image in plan.images and sampler in plan.samplers
            )
            table["array"][row] = bound.index((array, sampler)) - (0 if is_color else color_count)
            table["layer"][row] = planned[array].images.index(image)

    def _make_stream(
        self,
        device: Device,
        scene: Scene,
        settings: TextureSettings,
        sizes: Sequence[Size],
        uses: Sequence[tuple[int, bool, int]],
        formats: Sequence[ImageFormat],
        table: NDArray[Any],
    ) -> None:
        """Make arrays that hold the levels of images that are read, within a budget."""
        entries = list(dict.fromkeys((use[:2], format) for use, format in zip(uses, formats, strict=True)))
        numbers = [entries.index((use[:2], format)) for use, format in zip(uses, formats, strict=True)]
        room = MAX_ARRAYS - (scene.environment is not None)
        most = max(max(sizes[use[0]]).bit_length() for use in uses)
        while True:
            kinds = [
                list_kinds(
                    sizes[image],
                    format,
                    self._count_levels(image, format) or count_levels(sizes[image]),
                    is_color,
                    most,
                )
                for (image, is_color), format in entries
            ]
            bound = {
                (kind, use[2]) for use, number in zip(uses, numbers, strict=True) for kind in kinds[number]
            }
            if len(bound) <= room or most == 1:
                break
            most -= 1
        slots = sorted(bound, key=lambda slot: (not slot[0].is_color, -slot[0].layer_bytes, slot[1]))
        scales = np.zeros(len(uses))
        for row, (image, _, sampler) in enumerate(uses):
            descriptor = settings.adjust(scene.samplers[sampler], device.capabilities.max_anisotropy)
            if descriptor.mip is not None:
                matrix = np.diag(sizes[image]) @ scene.textures["transform"][row][:, :2]
                least = np.linalg.svd(matrix, compute_uv=False)[-1]
                scales[row] = least * self.gradient_scale / descriptor.max_anisotropy
        images = [
            _make_streamed_image(
                device,
                scene,
                image,
                sizes[image],
                kinds[number],
                nearest=all(
                    scene.samplers[sampler].magnify is Filter.NEAREST
                    for use, sampler in zip(numbers, [use[2] for use in uses], strict=True)
                    if use == number
                ),
            )
            if not isinstance(format, CompressedFormat)
            else StreamedImage(kinds[number], tuple(_read_blocks(scene, image, format).levels))
            for number, ((image, _), format) in enumerate(entries)
        ]
        frame_bytes = settings.memory_per_frame * _MIB or inf
        needs = TextureNeeds(scene, np.array(numbers, np.int64), scales)
        self.stream = ImageStream(device, images, needs, int(settings.memory * _MIB), frame_bytes)
        most_anisotropy = device.capabilities.max_anisotropy
        self.samplers = tuple(
            settings.adjust(scene.samplers[sampler], most_anisotropy) for _, sampler in slots
        )
        self._slots, self._entries = slots, numbers
        self._uses, self._rows = uses, table
        self._bind_stream()

    def _bind_stream(self) -> None:
        """Note the arrays that shaders bind, and where each texture is."""
        stream = self.stream
        assert stream is not None
        self.textures = tuple(dict.fromkeys(stream.get_texture(kind) for kind, _ in self._slots))
        self.arrays = tuple(
            stream.get_texture(kind).sampled(sampler)
            for (kind, _), sampler in zip(self._slots, self.samplers, strict=True)
        )
        color_count = sum(kind.is_color for kind, _ in self._slots)
        self.colors, self.data = self.arrays[:color_count], self.arrays[color_count:]
        self.bytes = stream.bytes
        slot_of = {slot: number for number, slot in enumerate(self._slots)}
        for row, (number, (_, is_color, sampler)) in enumerate(zip(self._entries, self._uses, strict=True)):
            slot = slot_of[stream.get_kind(number), sampler]
            self._rows["array"][row] = slot - (0 if is_color else color_count)
            self._rows["layer"][row] = stream.get_layer(number)

    def _make_tables(
        self,
        device: Device,
        scene: Scene,
        settings: TextureSettings,
        uses: Sequence[tuple[int, bool, int]],
        table: NDArray[Any],
    ) -> None:
        """Make a texture table of colours and one of data, and write where each texture is into the table."""
        limit, most = device.capabilities.max_texture_size - 2, device.capabilities.max_anisotropy
        tables: list[TextureTable | None] = []
        for of_colors in (True, False):
            entries = list(dict.fromkeys((i, s) for i, is_color, s in uses if is_color == of_colors))
            for row, (image, is_color, sampler) in enumerate(uses):
                if is_color == of_colors:
                    table["layer"][row] = entries.index((image, sampler))
            if not entries:
                tables.append(None)
                continue
            sizes = [
                (min(scene.images[image].shape[1], limit), min(scene.images[image].shape[0], limit))
                for image, _ in entries
            ]
            format = Format.RGBA8_SRGB if of_colors else Format.RGBA8
            if any(has_high_range(scene.images[image]) for image, _ in entries):
                format = Format.RGBA16F
            images: Sequence[Size | ImagePixels] = sizes
            if not self._is_streamed:
                images = [
                    _read_as(scene.images[image], format, size, is_color=of_colors)
                    for (image, _), size in zip(entries, sizes, strict=True)
                ]
            tables.append(
                device.texture_table(
                    images,
                    format,
                    samplers=[settings.adjust(scene.samplers[sampler], most) for _, sampler in entries],
                    label="images" if of_colors else "maps",
                )
            )
            if self._is_streamed:
                self._stream_table(scene, tables[-1], entries, sizes, of_colors)
        self.tables = tables[0], tables[1]
        self._list_textures(uses)
        existing = [texture_table for texture_table in tables if texture_table is not None]
        self.textures = tuple(texture_table.pages for texture_table in existing)
        self.arrays = self.colors = self.data = ()
        self.samplers = ()
        self.bytes = sum(texture_table.bytes for texture_table in existing)

    def _count_levels(self, image: int, format: ImageFormat) -> int:
        """The number of mip levels of an image in a format, 0 for all."""
        return self._levels.get(image, 0) if isinstance(format, CompressedFormat) else 0

    def _make_array(self, device: Device, scene: Scene, array: ImageArray) -> Texture:
        """Create an array with its texels."""
        if isinstance(array.format, CompressedFormat):
            texture = self._create_array(device, array)
            for layer, image in enumerate(array.images):
                for level, blocks in enumerate(_read_blocks(scene, image, array.format).levels):
                    texture.write(blocks, level, layer)
            return texture
        nearest = _is_nearest(scene, array)
        layers = np.stack(
            [_resize(scene.images[image], array.size, nearest=nearest) for image in array.images]
        )
        return device.texture(
            layers,
            array.format,
            kind=TextureKind.D2_ARRAY,
            levels=None,
            label="images" if array.is_color else "maps",
        )

    def _create_array(self, device: Device, array: ImageArray) -> Texture:
        """Create an array without texels."""
        return device.texture(
            array.size,
            array.format,
            kind=TextureKind.D2_ARRAY,
            layers=len(array.images),
            levels=array.levels,
            label="images" if array.is_color else "maps",
        )

    def _make_streamed_array(self, device: Device, scene: Scene, array: ImageArray) -> Texture:
        """Create an array without texels, and list the uploads of its layers."""
        texture = self._create_array(device, array)
        if isinstance(array.format, CompressedFormat):
            for layer, image in enumerate(array.images):
                blocks = partial(_read_blocks, scene, image, array.format)
                self.uploads.append(
                    ImageUpload(image, array.is_color, array.format, array.size, blocks, (), (texture, layer))
                )
            return texture
        nearest = _is_nearest(scene, array)
        for layer, image in enumerate(array.images):
            read = partial(_resize, scene.images[image], array.size, nearest=nearest)
            copy = partial(_copy_levels, texture, layer)
            self.uploads.append(ImageUpload(image, array.is_color, array.format, array.size, read, (copy,)))
        return texture

    def _stream_table(
        self,
        scene: Scene,
        table: TextureTable | None,
        entries: Sequence[tuple[int, int]],
        sizes: Sequence[Size],
        is_color: bool,
    ) -> None:
        """List the uploads of the images of a table, each once for all its samplers."""
        assert table is not None
        for image, size in dict(zip([image for image, _ in entries], sizes, strict=True)).items():
            copies = [
                partial(_copy_to_table, table, index)
                for index, (entry_image, _) in enumerate(entries)
                if entry_image == image
            ]
            read = partial(_read_as, scene.images[image], table.format, size, is_color=is_color)
            self.uploads.append(ImageUpload(image, is_color, table.format, size, read, tuple(copies)))

    def _list_textures(self, uses: Sequence[tuple[int, bool, int]]) -> None:
        """Note which textures of the scene each upload completes."""
        for upload in self.uploads:
            upload.textures = np.flatnonzero(
                [(image, is_color) == (upload.image, upload.is_color) for image, is_color, _ in uses]
            )

    def destroy(self) -> None:
        """Destroy the textures and the tables."""
        for texture_table in self.tables or ():
            if texture_table is not None:
                texture_table.destroy()
        if self.stream is not None:
            self.stream.destroy()
        else:
            for texture in self.textures:
                texture.destroy()
        if self.table is not None:
            self.table.destroy()


def _is_nearest(scene: Scene, array: ImageArray) -> bool:
    return all(scene.samplers[sampler].magnify is Filter.NEAREST for sampler in array.samplers)


def _make_streamed_image(
    device: Device, scene: Scene, image: int, size: Size, kinds: tuple[ArrayKind, ...], *, nearest: bool
) -> StreamedImage:
    """An image whose levels are those that the device makes of it: to the bit those of a texture with all levels."""
    texels, kind = _resize(scene.images[image], size, nearest=nearest), kinds[0]
    assert isinstance(kind.format, Format)
    with device.texture(texels, kind.format, levels=None, label="levels") as texture:
        return StreamedImage(kinds, (texels, *(texture.read(level) for level in range(1, kind.levels))))


def _copy_levels(target: Texture, layer: int, source: Texture) -> None:
    for level in range(source.levels):
        source.copy_to(target, level=level, target_level=level, layer=layer)


def _copy_to_table(table: TextureTable, index: int, source: Texture) -> None:
    table.copy_from(source, index)


def _choose_formats(
    device: Device,
    scene: Scene,
    compression: Compression,
    uses: Sequence[tuple[int, bool, int]],
    formats: Sequence[ImageFormat],
) -> list[ImageFormat]:
    """The format of each use's image, compressed where the device stores that as it is."""
    stored, limit = device.capabilities.compressed_formats, device.capabilities.max_texture_size
    if CompressedFormat.BC7 not in stored:
        compression = Compression.NONE
    check_compression(rules.BAD_TEXTURES, "TextureSettings(compression=...)", compression)
    normals = collect_normal_images(scene.textures, scene.materials, scene.shaders, scene.parameters)
    choices: dict[tuple[int, bool], ImageFormat | None] = {}
    for image, is_color, _ in uses:
        if (image, is_color) not in choices and max(scene.images[image].shape[:2]) <= limit:
            blocks, is_normal = scene.blocks.get(image), not is_color and image in normals
            if blocks is None:
                pixels = scene.images[image]
                format = choose_format(pixels, compression, is_color=is_color, is_normal=is_normal)
            else:
                format = blocks.choose_view(is_color=is_color)
                if format is CompressedFormat.BC5 and not is_normal:
                    format = None  # another map reads the third channel
            choices[image, is_color] = format if format in stored else None
    return [choices.get(use[:2]) or format for use, format in zip(uses, formats, strict=True)]


def _read_blocks(scene: Scene, image: int, format: CompressedFormat) -> ImageBlocks:
    return scene.blocks.get(image) or compress_image(scene.images[image], format)


def _read_as(image: ImagePixels, format: Format, size: Size, *, is_color: bool) -> ImagePixels:
    """An image of this size in the format of a table."""
    resized = _resize(image, size, nearest=False)
    if format is not Format.RGBA16F or has_high_range(resized):
        return resized
    return read_values(resized, is_color=is_color).astype(np.float16)


def _resize(image: ImagePixels, size: Size, *, nearest: bool) -> ImagePixels:
    if (image.shape[1], image.shape[0]) == size:
        return image
    from PIL import Image  # optional

    if has_high_range(image):  # means: other filters fall below 0 beside bright texels
        filter = Image.Resampling.NEAREST if nearest else Image.Resampling.BOX
        channels = [Image.fromarray(channel).resize(size, filter) for channel in _split(image)]
        return np.stack([np.asarray(channel) for channel in channels], axis=-1).astype(np.float16)
    filter = Image.Resampling.NEAREST if nearest else Image.Resampling.LANCZOS
    return np.asarray(Image.fromarray(image).resize(size, filter))


def _split(image: ImagePixels) -> list[NDArray[np.float32]]:
    """The channels (height, width) of an image of high range."""
    return [np.ascontiguousarray(image[..., channel], np.float32) for channel in range(image.shape[2])]
