"""Textures: planes of texels in plain OpenCL buffers, and the commands that move texels between them.

- A texture begins as zeros.
- Its mip levels lie one after the other in one buffer. A level consists of layers of rows of texels; each
  sample of a multi-sampled texture is a layer of its own.
- Rows and columns are padded to multiples of `planes.BLOCK`, so a block of pixels always lies in memory. The
  contents of the padding are undefined and never visible.
- Depth is stored as float32, rounded to values of its format; stencil is stored in a second buffer.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray
from typing_extensions import Buffer as BytesLike

from rhi.backends.cl.cl_context import ClContext
from rhi.backends.cl.cl_errors import translate_errors
from rhi.backends.cl.memory.filters import Filters
from rhi.backends.cl.memory.in_flight import InFlight
from rhi.backends.cl.memory.planes import TexelPlane, allocate, pitches_of, round_to_grain
from rhi.contract.descriptors import Id, Region, TextureDescriptor


class TextureWords(NamedTuple):
    """A description of a texture, in memory of its own at this address."""

    memory: cl.Buffer
    address: int


class ClTexture:
    """The memory of one texture.

    Attributes:
        levels: the planes of its mip levels.
        `stencil`: those of its stencil, if it has any.
        words: its descriptions for kernels, by sampler, or for an image by level and layer (see `samplers`).
        changes: how many commands other than draws have changed it.
    """

    __slots__ = ("_memory", "changes", "descriptor", "levels", "stencil", "words")

    def __init__(self, context: ClContext, descriptor: TextureDescriptor) -> None:
        self.descriptor = descriptor
        self.changes = 0
        self._memory: list[cl.Buffer] = []
        self.words: dict[Id | tuple[int, int], TextureWords] = {}
        self.stencil: list[TexelPlane] = []
        format = descriptor.format
        self.levels = self._allocate(context, format.transfer_bytes)
        if format.has_stencil:
            self.stencil = self._allocate(context, 1)

    def _allocate(self, context: ClContext, texel: int) -> list[TexelPlane]:
        """Allocate one buffer for all levels, each beginning at a multiple of `planes.GRAIN`."""
        descriptor = self.descriptor
        boxes = [
            (*descriptor.level_size(level), descriptor.level_layers(level) * descriptor.samples)
            for level in range(descriptor.levels)
        ]
        starts = [0]
        for width, height, layers in boxes:
            starts.append(round_to_grain(starts[-1] + pitches_of(texel, width, height)[1] * layers))
        memory = allocate(context.context, starts[-1])
        self._memory.append(memory)
        return [TexelPlane(memory, start, texel, *box) for start, box in zip(starts, boxes, strict=False)]

    def list_memory(self) -> list[cl.Buffer]:
        return [*self._memory, *[words.memory for words in self.words.values()]]


class Textures:
    """The textures of a device, by id."""

    def __init__(self, context: ClContext, in_flight: InFlight) -> None:
        self._context = context
        self._queue = context.queue
        self._in_flight = in_flight
        self._filters = Filters(context)
        self._textures: dict[Id, ClTexture] = {}

    def __getitem__(self, texture: Id) -> ClTexture:
        return self._textures[texture]

    def create(self, texture: Id, descriptor: TextureDescriptor) -> None:
        with translate_errors("device.texture", f"{descriptor.size}, {descriptor.format}"):
            self._textures[texture] = ClTexture(self._context, descriptor)

    def destroy(self, texture: Id) -> None:
        for memory in self._textures.pop(texture).list_memory():
            self._in_flight.release(memory)

    def write(self, texture: Id, level: int, region: Region, data: BytesLike) -> None:
        stored, source = self._textures[texture], np.frombuffer(memoryview(data), np.uint8)
        stored.changes += 1
        plane = stored.levels[level]
        if self._in_flight.has_room(len(source)):
            self._in_flight.add(plane.write(self._queue, region, source.copy(), False), len(source))
        else:
            plane.write(self._queue, region, source, True)
            self._in_flight.take()

    def read(self, texture: Id, level: int, region: Region, stencil: bool) -> NDArray[np.generic]:
        source = self._textures[texture]
        format = source.descriptor.format
        plane = (source.stencil if stencil else source.levels)[level]
        dtype = np.dtype(np.uint8) if stencil else format.dtype
        texels = np.empty((region.layers, region.height, region.width, format.components), dtype)
        plane.read(self._queue, region, texels)
        return texels

    def copy(
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
        old, new = self._textures[source], self._textures[target]
        new.changes += 1
        old.levels[source_level].copy(self._queue, source_region, new.levels[target_level], x, y, layer)
        if old.stencil:
            old.stencil[source_level].copy(self._queue, source_region, new.stencil[target_level], x, y, layer)

    def copy_to_buffer(
        self, source: Id, level: int, region: Region, target: cl.Buffer, offset: int, row_bytes: int
    ) -> None:
        plane = self._textures[source].levels[level]
        plane.copy_to_buffer(self._queue, region, target, offset, row_bytes)

    def copy_from_buffer(
        self, source: cl.Buffer, offset: int, row_bytes: int, target: Id, level: int, region: Region
    ) -> None:
        stored = self._textures[target]
        stored.changes += 1
        stored.levels[level].copy_from_buffer(self._queue, source, offset, row_bytes, region)

    def resolve(self, source: Id, target: Id) -> None:
        old, new = self._textures[source], self._textures[target]
        new.changes += 1
        self._filters.resolve(old.descriptor.format, old.levels[0], new.levels[0])

    def generate_mipmaps(self, texture: Id) -> None:
        stored = self._textures[texture]
        stored.changes += 1
        for above, below in zip(stored.levels, stored.levels[1:], strict=False):
            self._filters.halve(stored.descriptor.format, above, below)
