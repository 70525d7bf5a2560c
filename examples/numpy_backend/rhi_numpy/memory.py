"""Buffers and textures as arrays.

A buffer is an array of bytes. A level of a texture is an array (layers, height, width, channels) like the one
that `Texture.read` returns, top row first. Depth is float32, limited to the values that its format can store;
stencil is a separate array.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from typing_extensions import Buffer as BytesLike

from rhi.contract import (
    BufferDescriptor,
    DeviceError,
    Id,
    PassDescriptor,
    Region,
    TextureDescriptor,
    encode,
    halve,
    rules,
)

__rhi_internal__ = True


@dataclass
class Texture:
    """The levels of a texture, and those of its stencil if it has one."""

    descriptor: TextureDescriptor
    levels: list[NDArray[Any]] = field(default_factory=list)
    stencil: list[NDArray[Any]] = field(default_factory=list)


class Memory:
    """The memory of a device: all buffers and textures, by id."""

    def __init__(self) -> None:
        self.buffers: dict[Id, NDArray[np.uint8]] = {}
        self.textures: dict[Id, Texture] = {}

    def create_buffer(self, buffer: Id, descriptor: BufferDescriptor) -> None:
        self.buffers[buffer] = _zeros((descriptor.size,), np.dtype(np.uint8), "device.buffer")

    def create_texture(self, texture: Id, descriptor: TextureDescriptor) -> None:
        created = Texture(descriptor)
        format = descriptor.format
        for level in range(descriptor.levels):
            width, height = descriptor.level_size(level)
            box = descriptor.level_layers(level), height, width
            created.levels.append(_zeros((*box, format.components), format.dtype, "device.texture"))
            if format.has_stencil:
                created.stencil.append(_zeros((*box, 1), np.dtype(np.uint8), "device.texture"))
        self.textures[texture] = created

    def box(self, texture: Id, level: int, region: Region, stencil: bool = False) -> NDArray[Any]:
        """Return a view of the texels in a region, which can be read and written."""
        stored = self.textures[texture]
        return (stored.stencil if stencil else stored.levels)[level][
            region.layer : region.layer + region.layers,
            region.y : region.y + region.height,
            region.x : region.x + region.width,
        ]

    def write_texture(self, texture: Id, level: int, region: Region, data: BytesLike) -> None:
        texels = self.box(texture, level, region)
        texels[:] = np.frombuffer(memoryview(data), np.uint8).view(texels.dtype).reshape(texels.shape)

    def copy_texture(
        self, source: Id, level: int, region: Region, target: Id, target_level: int, target_region: Region
    ) -> None:
        self.box(target, target_level, target_region)[:] = self.box(source, level, region)
        if self.textures[source].stencil:
            self.box(target, target_level, target_region, True)[:] = self.box(source, level, region, True)

    def texture_rows(self, texture: Id, level: int, region: Region) -> NDArray[np.uint8]:
        """Return a copy of a region's rows as bytes: (rows of all layers, bytes of a row)."""
        texels = np.ascontiguousarray(self.box(texture, level, region))
        return texels.view(np.uint8).reshape(region.layers * region.height, -1)

    def buffer_rows(
        self, buffer: Id, offset: int, row_bytes: int, like: NDArray[np.uint8]
    ) -> NDArray[np.uint8]:
        """Return a view of rows of a buffer that begin `row_bytes` apart, in the shape of `like`."""
        count, size = like.shape
        memory = self.buffers[buffer][offset : offset + (count - 1) * row_bytes + size]
        return np.lib.stride_tricks.as_strided(memory, (count, size), (row_bytes, 1))

    def generate_mipmaps(self, texture: Id) -> None:
        stored = self.textures[texture]
        for above, below in zip(stored.levels, stored.levels[1:], strict=False):
            below[:] = halve(stored.descriptor.format, above, len(below))

    def clear_targets(self, descriptor: PassDescriptor) -> None:
        """Clear the targets for which a pass requests it."""
        for color in descriptor.colors:
            if color.clear is not None:
                stored = self.textures[color.texture]
                texel = np.array(color.clear, np.float64)[: stored.descriptor.format.channels]
                stored.levels[color.level][color.layer] = encode(stored.descriptor.format, texel)
        depth = descriptor.depth
        if depth is None:
            return
        stored = self.textures[depth.texture]
        if depth.clear is not None:
            stored.levels[depth.level][depth.layer] = encode(
                stored.descriptor.format, np.array([depth.clear])
            )
        if depth.clear_stencil is not None:
            stored.stencil[depth.level][depth.layer] = depth.clear_stencil


def _zeros(shape: tuple[int, ...], dtype: np.dtype[Any], call: str) -> NDArray[Any]:
    try:
        return np.zeros(shape, dtype)
    except (MemoryError, ValueError) as error:
        raise DeviceError(rules.DEVICE_MEMORY, call, f"{shape} of {dtype}") from error
