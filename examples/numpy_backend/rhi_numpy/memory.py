"""Buffers and textures as arrays.

A buffer is bytes. A texture's level is an array (layers, height, width, channels) as `Texture.read` gives it, top
row first; depth is float32 with the values that its format has, stencil an array of its own.
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
    """A texture's levels, and those of its stencil if it has one."""

    descriptor: TextureDescriptor
    levels: list[NDArray[Any]] = field(default_factory=list)
    stencil: list[NDArray[Any]] = field(default_factory=list)


class Memory:
    """All buffers and textures, by id."""

    def __init__(self) -> None:
        self.buffers: dict[Id, NDArray[np.uint8]] = {}
        self.textures: dict[Id, Texture] = {}

    def create_buffer(self, buffer: Id, descriptor: BufferDescriptor) -> None:
        self.buffers[buffer] = _zeros((descriptor.size,), np.dtype(np.uint8), "device.buffer")

    def create_texture(self, texture: Id, descriptor: TextureDescriptor) -> None:
        made = Texture(descriptor)
        format = descriptor.format
        for level in range(descriptor.levels):
            width, height = descriptor.level_size(level)
            box = descriptor.level_layers(level), height, width
            made.levels.append(_zeros((*box, format.channels), format.dtype, "device.texture"))
            if format.has_stencil:
                made.stencil.append(_zeros((*box, 1), np.dtype(np.uint8), "device.texture"))
        self.textures[texture] = made

    def box(self, texture: Id, level: int, region: Region, stencil: bool = False) -> NDArray[Any]:
        """The texels of a region, to be read or written in place."""
        made = self.textures[texture]
        return (made.stencil if stencil else made.levels)[level][
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

    def generate_mipmaps(self, texture: Id) -> None:
        made = self.textures[texture]
        for above, below in zip(made.levels, made.levels[1:], strict=False):
            below[:] = halve(made.descriptor.format, above, len(below))

    def clear_targets(self, descriptor: PassDescriptor) -> None:
        """What a pass clears at its beginning."""
        for color in descriptor.colors:
            if color.clear is not None:
                made = self.textures[color.texture]
                texel = np.array(color.clear, np.float64)[: made.descriptor.format.channels]
                made.levels[color.level][color.layer] = encode(made.descriptor.format, texel)
        depth = descriptor.depth
        if depth is None:
            return
        made = self.textures[depth.texture]
        if depth.clear is not None:
            made.levels[depth.level][depth.layer] = encode(made.descriptor.format, np.array([depth.clear]))
        if depth.clear_stencil is not None:
            made.stencil[depth.level][depth.layer] = depth.clear_stencil


def _zeros(shape: tuple[int, ...], dtype: np.dtype[Any], call: str) -> NDArray[Any]:
    try:
        return np.zeros(shape, dtype)
    except (MemoryError, ValueError) as error:
        raise DeviceError(rules.DEVICE_MEMORY, call, f"{shape} of {dtype}") from error
