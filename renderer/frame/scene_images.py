"""The images of a scene on a device: arrays of textures, or two texture tables.

A shader reads all images of a scene in one draw. Where they have few sizes, images are layers of arrays, one
for each size; colours (sRGB) and data (linear) have arrays of their own. So they take the memory of their
texels and mip levels, and no more, and the device's own samplers read them.

A shader binds each array once for each sampler that reads it, at most `MAX_ARRAYS` in all. If a scene has
more sizes or samplers, colours and data are in a `TextureTable` each. There too each image keeps its own
size, mip levels and sampler.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from math import inf
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer import rules
from renderer.scene import Scene
from renderer.shaders.structs import TextureUse
from rhi import (
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
TEXEL_BYTES: Final = 4
_MAX_BIAS: Final = 16.0
"""The most levels of a bias: there are no more levels."""

Size = tuple[int, int]
"""Width and height in texels."""


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
    """

    filter: Filter = Filter.LINEAR
    mip: Filter | None = Filter.LINEAR
    anisotropy: float = 1.0
    mip_bias: float = 0.0

    def __post_init__(self) -> None:
        rules.check_types(self, rules.BAD_TEXTURES)
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
    """An array texture: the size of its layers, whether they are colours, the images in its layers, and
    the samplers that read it, as indices of the scene."""

    size: Size
    is_color: bool
    images: tuple[int, ...]
    samplers: frozenset[int]

    @property
    def bytes(self) -> int:
        """The memory of all layers with their levels."""
        return len(self.images) * count_bytes(self.size)


@dataclass(slots=True)
class ImageUpload:
    """An image that is to be uploaded: to a texture of its own, whose levels are then copied where shaders read them.

    Attributes:
        image: its index in the scene.
        is_color: whether it is uploaded as colours.
        size: in texels, on the device.
        read: returns its texels (height, width, 4) of uint8.
        copies: copy a texture with all levels to where shaders read them.
        textures: (k,) the indices of the scene's textures that are complete then.
    """

    image: int
    is_color: bool
    size: Size
    read: Callable[[], NDArray[np.uint8]]
    copies: tuple[Callable[[Texture], None], ...]
    textures: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))


def count_bytes(size: Size) -> int:
    """Bytes of an image with its mip levels."""
    width, height = size
    total = 0
    while True:
        total += width * height * TEXEL_BYTES
        if width == height == 1:
            return total
        width, height = max(width // 2, 1), max(height // 2, 1)


def plan_arrays(sizes: Sequence[Size], uses: Sequence[tuple[int, bool, int]]) -> list[ImageArray]:
    """The array textures that hold images of these sizes.

    Args:
        uses: image, whether it holds colours, and sampler, of each texture.
    """
    groups: dict[tuple[Size, bool], tuple[dict[int, None], set[int]]] = {}
    for image, is_color, sampler in uses:
        images, samplers = groups.setdefault((sizes[image], is_color), ({}, set()))
        images[image] = None
        samplers.add(sampler)
    return [
        ImageArray(size, is_color, tuple(images), frozenset(samplers))
        for (size, is_color), (images, samplers) in groups.items()
    ]


def count_bindings(sizes: Sequence[Size], uses: Sequence[tuple[int, bool, int]]) -> int:
    """The number of arrays with their samplers that hold images of these sizes; `uses` are those of
    `plan_arrays`."""
    return len({(sizes[image], is_color, sampler) for image, is_color, sampler in uses})


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
        if count_bindings(sizes, uses) > MAX_ARRAYS - (scene.environment is not None):
            self._make_tables(device, scene, settings, uses, table)
        else:
            self._make_arrays(device, scene, settings, sizes, uses, table)
        self.image_bytes = sum(count_bytes(sizes[image]) for image, _ in {use[:2] for use in uses})
        table["u"], table["v"] = textures["transform"][:, 0], textures["transform"][:, 1]
        table["uv_set"] = textures["uv_set"]
        is_plain = (
            len(self.arrays) == 1
            and (table["layer"] == np.arange(len(table))).all()
            and (textures["transform"] == np.eye(2, 3)).all()
            and not textures["uv_set"].any()
        )
        self.table: StorageBuffer[TextureUse] | None = (
            None if is_plain else device.storage(TextureUse, table, label="textures")
        )

    def _make_arrays(
        self,
        device: Device,
        scene: Scene,
        settings: TextureSettings,
        sizes: Sequence[Size],
        uses: Sequence[tuple[int, bool, int]],
        table: NDArray[Any],
    ) -> None:
        """Make an array for each size, and write where each texture is into the table."""
        planned = sorted(plan_arrays(sizes, uses), key=lambda array: not array.is_color)
        self.bytes = sum(array.bytes for array in planned)
        self.textures: tuple[Texture, ...] = tuple(
            self._make_streamed_array(device, scene, array)
            if self._is_streamed
            else _make_array(device, scene, array)
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
        for row, (image, is_color, sampler) in enumerate(uses):
            array = next(
                number
                for number, plan in enumerate(planned)
                if plan.is_color == is_color and image in plan.images and sampler in plan.samplers
            )
            table["array"][row] = bound.index((array, sampler)) - (0 if is_color else color_count)
            table["layer"][row] = planned[array].images.index(image)

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
            images: Sequence[Size | NDArray[np.uint8]] = sizes
            if not self._is_streamed:
                images = [
                    _resize(scene.images[image], size, nearest=False)
                    for (image, _), size in zip(entries, sizes, strict=True)
                ]
            tables.append(
                device.texture_table(
                    images,
                    Format.RGBA8_SRGB if of_colors else Format.RGBA8,
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

    def _make_streamed_array(self, device: Device, scene: Scene, array: ImageArray) -> Texture:
        """Create an array without texels, and list the uploads of its layers."""
        format = Format.RGBA8_SRGB if array.is_color else Format.RGBA8
        texture = device.texture(
            array.size,
            format,
            kind=TextureKind.D2_ARRAY,
            layers=len(array.images),
            levels=None,
            label="images" if array.is_color else "maps",
        )
        nearest = _is_nearest(scene, array)
        for layer, image in enumerate(array.images):
            read = partial(_resize, scene.images[image], array.size, nearest=nearest)
            copy = partial(_copy_levels, texture, layer)
            self.uploads.append(ImageUpload(image, array.is_color, array.size, read, (copy,)))
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
            read = partial(_resize, scene.images[image], size, nearest=False)
            self.uploads.append(ImageUpload(image, is_color, size, read, tuple(copies)))

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
        for texture in self.textures:
            texture.destroy()
        if self.table is not None:
            self.table.destroy()


def _is_nearest(scene: Scene, array: ImageArray) -> bool:
    return all(scene.samplers[sampler].magnify is Filter.NEAREST for sampler in array.samplers)


def _copy_levels(target: Texture, layer: int, source: Texture) -> None:
    for level in range(source.levels):
        source.copy_to(target, level=level, target_level=level, layer=layer)


def _copy_to_table(table: TextureTable, index: int, source: Texture) -> None:
    table.copy_from(source, index)


def _make_array(device: Device, scene: Scene, array: ImageArray) -> Texture:
    nearest = _is_nearest(scene, array)
    layers = np.stack([_resize(scene.images[image], array.size, nearest=nearest) for image in array.images])
    return device.texture(
        layers,
        Format.RGBA8_SRGB if array.is_color else Format.RGBA8,
        kind=TextureKind.D2_ARRAY,
        levels=None,
        label="images" if array.is_color else "maps",
    )


def _resize(image: NDArray[np.uint8], size: Size, *, nearest: bool) -> NDArray[np.uint8]:
    if (image.shape[1], image.shape[0]) == size:
        return image
    from PIL import Image  # optional

    filter = Image.Resampling.NEAREST if nearest else Image.Resampling.LANCZOS
    return np.asarray(Image.fromarray(image).resize(size, filter))
