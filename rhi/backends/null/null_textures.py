"""Textures in host memory and the commands that change them, and the descriptors of samplers.

- A texture is one array (layers, height, width, channels) per level, as stored. Depth is kept as float32 with
  the values that the format can represent; stencil is in arrays of its own.
- Multi-sampled textures keep one sample per texel: without rasterisation all samples of a texel are equal.
- The methods named like commands are called when the queue reaches the command (`backend`), never earlier.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from rhi.contract.descriptors import (
    ALL_LAYERS,
    Id,
    PassDescriptor,
    Region,
    TextureDescriptor,
)
from rhi.contract.formats import Format
from rhi.contract.texels import encode, halve
from rhi.errors import DeviceError
from rhi.errors.rules import DEVICE_MEMORY


class TextureMemory:
    """The contents of a texture.

    Attributes:
        levels: the texels of each level: (layers, height, width, channels).
        stencil: the stencil values of each level: (layers, height, width, 1); empty without stencil.
    """

    __slots__ = ("descriptor", "levels", "stencil")

    def __init__(self, descriptor: TextureDescriptor) -> None:
        self.descriptor = descriptor
        format = descriptor.format
        self.levels: list[NDArray[np.generic]] = []
        self.stencil: list[NDArray[np.uint8]] = []
        for level in range(descriptor.levels):
            width, height = descriptor.level_size(level)
            texels = descriptor.level_layers(level), height, width
            self.levels.append(np.zeros((*texels, format.components), format.dtype))
            if format.has_stencil:
                self.stencil.append(np.zeros((*texels, 1), np.uint8))


def _box(region: Region) -> tuple[slice, slice, slice]:
    """Return a region as an index into a level's array."""
    return (
        slice(region.layer, region.layer + region.layers),
        slice(region.y, region.y + region.height),
        slice(region.x, region.x + region.width),
    )


@lru_cache(maxsize=64)
def _encode_once(format: Format, values: bytes) -> NDArray[np.generic]:
    """`encode` of one texel (float64), cached: most clears use the same few colors."""
    return encode(format, np.frombuffer(values))


_Clear = tuple[NDArray[np.generic], NDArray[np.generic]]
"""Texels (…, height, width, channels), and the row that they are cleared to."""
_MAX_CLEARS: Final = 64


class _RecentClears:
    """The clears of recent passes, which hold the memory of their textures."""

    def __init__(self) -> None:
        self._passes: dict[int, tuple[PassDescriptor, list[_Clear]]] = {}  # by the identity of the descriptor

    def get(self, descriptor: PassDescriptor) -> list[_Clear] | None:
        """Return the clears of a pass; None for one that isn't remembered."""
        remembered = self._passes.get(id(descriptor))
        return None if remembered is None or remembered[0] is not descriptor else remembered[1]

    def add(self, descriptor: PassDescriptor, clears: list[_Clear]) -> None:
        """Remember the clears of a pass."""
        if len(self._passes) >= _MAX_CLEARS:
            self._passes.clear()
        self._passes[id(descriptor)] = descriptor, clears

    def forget(self) -> None:
        """Release the memory of all textures."""
        self._passes.clear()


def _clear_to(texels: NDArray[np.generic], value: NDArray[np.generic] | int) -> _Clear:
    """Return the clear of texels (height, width, channels), or of several layers, to a texel. A row is repeated, since
    NumPy repeats a few bytes much more slowly."""
    row = np.empty(texels.shape[-2:], texels.dtype)
    row[...] = value
    return texels, row


class Textures:
    """The textures and samplers of a device, by id."""

    def __init__(self) -> None:
        self.textures: dict[Id, TextureMemory] = {}
        self._recent_clears = _RecentClears()

    def clear(self) -> None:
        """Release all textures."""
        self.textures.clear()
        self._recent_clears.forget()

    # -- immediate -----------------------------------------------------------------------------------------

    def create_texture(self, texture: Id, descriptor: TextureDescriptor) -> None:
        try:
            self.textures[texture] = TextureMemory(descriptor)
        except (MemoryError, ValueError) as error:
            raise DeviceError(DEVICE_MEMORY, "create_texture", repr(descriptor)) from error

    def read_texture(self, texture: Id, level: int, region: Region, stencil: bool) -> NDArray[np.generic]:
        source = self.textures[texture]
        if stencil:
            return source.stencil[level][_box(region)].copy()
        return source.levels[level][_box(region)].copy()

    def copy_rows(self, texture: Id, level: int, region: Region) -> NDArray[np.uint8]:
        """Return a copy of a region's rows as bytes: (rows of all layers, bytes of a row)."""
        texels = np.ascontiguousarray(self.textures[texture].levels[level][_box(region)])
        return texels.view(np.uint8).reshape(region.layers * region.height, -1)

    # -- commands ----------------------------------------------------------------------------------------

    def destroy(self, resource: Id) -> None:
        if self.textures.pop(resource, None) is not None:
            self._recent_clears.forget()

    def write_texture(self, texture: Id, level: int, region: Region, data: bytes) -> None:
        target = self.textures[texture].levels[level]
        box = target[_box(region)]
        box[:] = np.frombuffer(data, target.dtype).reshape(box.shape)

    def copy_texture(
        self,
        source: Id,
        source_level: int,
        source_region: Region,
        target: Id,
        target_level: int,
        x: int,
        y: int,
        layer: int,
    ) -> None:
        region, box = source_region, _box(source_region)
        end = layer + region.layers, y + region.height, x + region.width
        target_box = slice(layer, end[0]), slice(y, end[1]), slice(x, end[2])
        read, written = self.textures[source], self.textures[target]
        written.levels[target_level][target_box] = read.levels[source_level][box]
        if read.stencil:
            written.stencil[target_level][target_box] = read.stencil[source_level][box]

    def resolve_texture(self, source: Id, target: Id) -> None:
        self.textures[target].levels[0][:] = self.textures[source].levels[0]

    def generate_mipmaps(self, texture: Id) -> None:
        levels, format = self.textures[texture].levels, self.textures[texture].descriptor.format
        for index in range(1, len(levels)):
            levels[index][:] = halve(format, levels[index - 1], len(levels[index]))

    def begin_pass(self, descriptor: PassDescriptor) -> None:
        """Clear the attachments of a pass."""
        clears = self._recent_clears.get(descriptor)
        if clears is None:
            clears = self._list_clears(descriptor)
            self._recent_clears.add(descriptor, clears)
        for texels, row in clears:
            texels[...] = row

    def _list_clears(self, descriptor: PassDescriptor) -> list[_Clear]:
        """Return the clears of the attachments of a pass."""
        clears = []
        for color in descriptor.colors:
            if color.clear is not None:
                texture = self.textures[color.texture]
                format = texture.descriptor.format
                values = np.array(color.clear, np.float64)[: format.channels]
                level = texture.levels[color.level]
                texels = level if color.layer == ALL_LAYERS else level[color.layer]
                clears.append(_clear_to(texels, _encode_once(format, values.tobytes())))
        depth = descriptor.depth
        if depth is not None:
            texture = self.textures[depth.texture]
            layers = slice(None) if depth.layer == ALL_LAYERS else depth.layer
            if depth.clear is not None:
                value = np.array([depth.clear], np.float64)
                texels = texture.levels[depth.level][layers]
                clears.append(_clear_to(texels, _encode_once(texture.descriptor.format, value.tobytes())))
            if depth.clear_stencil is not None and texture.stencil:
                clears.append(_clear_to(texture.stencil[depth.level][layers], depth.clear_stencil & 0xFF))
        return clears

    def end_pass(self, descriptor: PassDescriptor) -> None:
        """Resolve the attachments of a pass."""
        for attachment in descriptor.colors:
            if attachment.resolve:
                source = self.textures[attachment.texture].levels[attachment.level]
                self.textures[attachment.resolve].levels[0][0] = source[attachment.layer]
