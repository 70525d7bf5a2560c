"""Buffers and textures in real memory, and the commands that change them.

- A buffer is bytes; a texture an array (layers, height, width, channels) for each level, as stored. Depth is
  kept as float32 with the values the format has, stencil in arrays of its own.
- Multi-sampled textures keep one sample a texel: without rasterisation all of a texel's samples are equal.
- The methods named as commands run when the queue gets to them (`backend`), never earlier.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from rhi.contract.descriptors import (
    Attachment,
    BufferDescriptor,
    DepthAttachment,
    Id,
    PassDescriptor,
    Primitive,
    Region,
    TextureDescriptor,
)
from rhi.contract.texels import encode, halve
from rhi.errors import DeviceError
from rhi.errors.rules import DEVICE_MEMORY

__rhi_internal__ = True

DRAW_ARGUMENTS: Final = np.dtype({
    "names": ["count", "instances", "first", "base_vertex", "base_instance"],
    "formats": ["<u4", "<u4", "<u4", "<i4", "<u4"],
})  # fmt: skip
"""One draw of an indirect command."""


@dataclass(frozen=True, slots=True)
class IndirectDraws:
    """What an indirect draw came to when it was executed: `draws` is an array of `DRAW_ARGUMENTS`, as long
    as the number of draws (none if conditional rendering dropped them)."""

    vertex_array: Id
    primitive: Primitive
    draws: NDArray[np.void]


class Texture:
    """A texture's levels, and those of its stencil if it has one."""

    __slots__ = ("descriptor", "levels", "stencil")

    def __init__(self, descriptor: TextureDescriptor) -> None:
        self.descriptor = descriptor
        format = descriptor.format
        self.levels: list[NDArray[np.generic]] = []
        self.stencil: list[NDArray[np.uint8]] = []
        for level in range(descriptor.levels):
            width, height = descriptor.level_size(level)
            texels = descriptor.level_layers(level), height, width
            self.levels.append(np.zeros((*texels, format.channels), format.dtype))
            if format.has_stencil:
                self.stencil.append(np.zeros((*texels, 1), np.uint8))


def _box(region: Region) -> tuple[slice, slice, slice]:
    """A region as an index of a level's array."""
    return (
        slice(region.layer, region.layer + region.layers),
        slice(region.y, region.y + region.height),
        slice(region.x, region.x + region.width),
    )


class Resources:
    """All buffers and textures of a device, by id."""

    def __init__(self) -> None:
        self.buffers: dict[Id, NDArray[np.uint8]] = {}
        self.textures: dict[Id, Texture] = {}

    def clear(self) -> None:
        self.buffers.clear()
        self.textures.clear()

    # -- at once -----------------------------------------------------------------------------------------

    def create_buffer(self, buffer: Id, descriptor: BufferDescriptor) -> None:
        try:
            self.buffers[buffer] = np.zeros(descriptor.size, np.uint8)
        except (MemoryError, ValueError) as error:
            raise DeviceError(DEVICE_MEMORY, "create_buffer", f"{descriptor.size} bytes") from error

    def create_texture(self, texture: Id, descriptor: TextureDescriptor) -> None:
        try:
            self.textures[texture] = Texture(descriptor)
        except (MemoryError, ValueError) as error:
            raise DeviceError(DEVICE_MEMORY, "create_texture", repr(descriptor)) from error

    def read_buffer(self, buffer: Id, offset: int, size: int) -> bytes:
        return self.buffers[buffer][offset : offset + size].tobytes()

    def read_texture(self, texture: Id, level: int, region: Region, stencil: bool) -> NDArray[np.generic]:
        source = self.textures[texture]
        if stencil:
            return source.stencil[level][_box(region)].copy()
        return source.levels[level][_box(region)].copy()

    # -- commands ----------------------------------------------------------------------------------------

    def destroy(self, resource: Id) -> None:
        self.buffers.pop(resource, None)
        self.textures.pop(resource, None)

    def write_buffer(self, buffer: Id, offset: int, data: bytes) -> None:
        self.buffers[buffer][offset : offset + len(data)] = np.frombuffer(data, np.uint8)

    def copy_buffer(self, source: Id, source_offset: int, target: Id, target_offset: int, size: int) -> None:
        taken = self.buffers[source][source_offset : source_offset + size]
        self.buffers[target][target_offset : target_offset + size] = taken

    def clear_buffer(self, buffer: Id, offset: int, size: int, value: int) -> None:
        self.buffers[buffer][offset : offset + size].view("<u4")[:] = value & 0xFFFFFFFF

    def write_texture(self, texture: Id, level: int, region: Region, data: bytes) -> None:
        target = self.textures[texture].levels[level]
        box = target[_box(region)]
        box[:] = np.frombuffer(data, target.dtype).reshape(box.shape)

    def copy_texture(
        self, source: Id, source_level: int, source_region: Region, target: Id, target_level: int, x: int,
        y: int, layer: int,
    ) -> None:  # fmt: skip
        region = source_region
        target_region = Region(x, y, region.width, region.height, layer, region.layers)
        taken, given = self.textures[source], self.textures[target]
        given.levels[target_level][_box(target_region)] = taken.levels[source_level][_box(region)]
        if taken.stencil:
            given.stencil[target_level][_box(target_region)] = taken.stencil[source_level][_box(region)]

    def resolve_texture(self, source: Id, target: Id) -> None:
        self.textures[target].levels[0][:] = self.textures[source].levels[0]

    def generate_mipmaps(self, texture: Id) -> None:
        levels, format = self.textures[texture].levels, self.textures[texture].descriptor.format
        for index in range(1, len(levels)):
            levels[index][:] = halve(format, levels[index - 1], len(levels[index]))

    def begin_pass(self, descriptor: PassDescriptor) -> None:
        """The clears."""
        for attachment in descriptor.colors:
            if attachment.clear is not None:
                self._clear_color(attachment)
        if descriptor.depth is not None:
            self._clear_depth(descriptor.depth)

    def end_pass(self, descriptor: PassDescriptor) -> None:
        """The resolves of the pass that was begun."""
        for attachment in descriptor.colors:
            if attachment.resolve:
                source = self.textures[attachment.texture].levels[attachment.level]
                self.textures[attachment.resolve].levels[0][0] = source[attachment.layer]

    def _clear_color(self, attachment: Attachment) -> None:
        texture = self.textures[attachment.texture]
        format = texture.descriptor.format
        values = np.array(attachment.clear, np.float64)[: format.channels]
        texture.levels[attachment.level][attachment.layer] = encode(format, values)

    def _clear_depth(self, attachment: DepthAttachment) -> None:
        texture = self.textures[attachment.texture]
        level, layer = attachment.level, attachment.layer
        if attachment.clear is not None:
            value = np.array([attachment.clear], np.float64)
            texture.levels[level][layer] = encode(texture.descriptor.format, value)
        if attachment.clear_stencil is not None and texture.stencil:
            texture.stencil[level][layer] = attachment.clear_stencil & 0xFF

    # -- what commands read from buffers ------------------------------------------------------------------

    def indirect_draws(
        self, buffer: Id, offset: int, draws: int, stride: int, count_buffer: Id, count_offset: int,
        indexed: bool,
    ) -> NDArray[np.void]:  # fmt: skip
        """The draws of an indirect command, as `DRAW_ARGUMENTS`, from what the buffers hold now."""
        if count_buffer:
            draws = min(draws, int(self._words(count_buffer, count_offset, 1)[0]))
        result = np.zeros(draws, DRAW_ARGUMENTS)
        if draws:
            memory = self.buffers[buffer]
            words = np.ndarray((draws, 5), "<u4", memory, offset, (stride, 4))
            result["count"], result["instances"], result["first"] = words[:, 0], words[:, 1], words[:, 2]
            if indexed:
                result["base_vertex"] = words[:, 3].astype(np.int32)
            result["base_instance"] = words[:, 4 if indexed else 3]
        return result

    def indirect_groups(self, buffer: Id, offset: int) -> tuple[int, int, int]:
        """The work-groups of an indirect dispatch."""
        x, y, z = self._words(buffer, offset, 3).tolist()
        return x, y, z

    def _words(self, buffer: Id, offset: int, count: int) -> NDArray[np.uint32]:
        return self.buffers[buffer][offset : offset + 4 * count].view("<u4")
