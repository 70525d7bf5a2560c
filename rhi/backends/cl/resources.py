"""Buffers and textures: plain OpenCL buffers, and the commands that move bytes between them.

- Each is zeroed when made, which also makes a driver that allocates late say at once that it can't. Room for a
  vector load that runs past the end is left behind each.
- What the CPU writes is copied first and the copy kept until the device has read it (`Staging`); a write that is
  too large for that waits instead.
- A texture's levels lie one after the other in one buffer; a level is layers of rows of texels, a sample being a
  layer of its own. Rows and columns are padded to multiples of `BLOCK`, so that a block of pixels always lies in
  memory; nobody may see what the padding holds. Depth is kept as float32 with the values that its format has,
  stencil in a second buffer.
- A STREAM buffer is host memory that kernels read in place, where the device can; writing it is then a copy.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray
from typing_extensions import Buffer as BytesLike

from rhi.backends.cl.context import ClContext, allocate_pages
from rhi.backends.cl.errors import translate_errors
from rhi.backends.cl.filters import Filters
from rhi.backends.cl.planes import GRAIN, Plane, allocate, fill, pitches_of, round_up
from rhi.contract.descriptors import BufferDescriptor, BufferUsage, Id, Region, TextureDescriptor

__rhi_internal__ = True

_MAX_STAGED: Final = 1 << 24
_MAX_RANGES: Final = 4096


class Staging:
    """Copies of what the CPU wrote, for as long as commands in the queue may read them."""

    def __init__(self) -> None:
        self._copies: list[cl.Event] = []  # each holds its memory
        self._bytes = 0

    def takes(self, size: int) -> bool:
        """Whether there is room for a copy; if not, wait for the write, and say so by `clear`."""
        return self._bytes + size <= _MAX_STAGED

    def add(self, event: cl.Event, size: int) -> None:
        self._copies.append(event)
        self._bytes += size

    def clear(self) -> list[cl.Event]:
        """Hand over all copies: to be let go when the device is past this point."""
        copies, self._copies, self._bytes = self._copies, [], 0
        return copies


class Memory:
    """A buffer: OpenCL's, its host memory if the CPU writes it in place, and the ranges of it that were bound."""

    __slots__ = ("cl", "host", "ranges", "size")

    def __init__(self, made: cl.Buffer, size: int, host: NDArray[np.uint8] | None = None) -> None:
        self.cl = made
        self.size = size
        self.host = host
        self.ranges: dict[tuple[int, int], cl.Buffer] = {}

    def release(self) -> None:
        for part in self.ranges.values():
            part.release()
        self.cl.release()


class Buffers:
    """All buffers of a device, by id."""

    def __init__(self, context: ClContext, staging: Staging) -> None:
        self._context = context
        self._queue = context.queue
        self._staging = staging
        self._buffers: dict[Id, Memory] = {}

    def create(self, buffer: Id, descriptor: BufferDescriptor) -> None:
        with translate_errors("device.buffer", f"{descriptor.size} bytes"):
            if descriptor.usage is BufferUsage.STREAM and self._context.shares_memory:
                host = allocate_pages(round_up(descriptor.size) + GRAIN)
                flags = cl.mem_flags.READ_WRITE | cl.mem_flags.USE_HOST_PTR
                made = Memory(cl.Buffer(self._context.context, flags, hostbuf=host), descriptor.size, host)
            else:
                made = Memory(allocate(self._context, descriptor.size), descriptor.size)
        self._buffers[buffer] = made

    def destroy(self, buffer: Id) -> None:
        self._buffers.pop(buffer).release()

    def __getitem__(self, buffer: Id) -> Memory:
        return self._buffers[buffer]

    def bound(self, buffer: Id, offset: int, size: int) -> cl.Buffer:
        """A range as a kernel's argument."""
        memory = self._buffers[buffer]
        if not offset:
            return memory.cl
        part = memory.ranges.get((offset, size))
        if part is None:
            if len(memory.ranges) == _MAX_RANGES:
                memory.ranges.clear()  # those that are arguments of a kernel live on with it
            part = memory.ranges[offset, size] = memory.cl.get_sub_region(offset, size)
        return part

    def write(self, buffer: Id, offset: int, data: BytesLike) -> None:
        memory, source = self._buffers[buffer], np.frombuffer(memoryview(data), np.uint8)
        if memory.host is not None:
            memory.host[offset : offset + len(source)] = source
        elif len(source):
            staged = self._staging.takes(len(source))
            source = source.copy() if staged else source
            event = cl.enqueue_copy(self._queue, memory.cl, source, dst_offset=offset, is_blocking=not staged)
            if staged:
                self._staging.add(event, len(source))
            else:
                self._staging.clear()

    def read(self, buffer: Id, offset: int, size: int) -> bytes:
        data = np.empty(size, np.uint8)
        if size:
            cl.enqueue_copy(self._queue, data, self._buffers[buffer].cl, src_offset=offset)
        return data.tobytes()

    def copy(self, source: Id, source_offset: int, target: Id, target_offset: int, size: int) -> None:
        if size:
            cl.enqueue_copy(
                self._queue, self._buffers[target].cl, self._buffers[source].cl, src_offset=source_offset,
                dst_offset=target_offset, byte_count=size,
            )  # fmt: skip

    def clear(self, buffer: Id, offset: int, size: int, value: int) -> None:
        pattern = (value & 0xFFFFFFFF).to_bytes(4, "little")
        fill(self._queue, self._buffers[buffer].cl, pattern, offset, size)


class Texture:
    """A texture's levels, and those of its stencil if it has one.

    Attributes:
        words: what kernels are told about it, by sampler, or by level and layer of an image (`samplers`).
        changes: how often anything but draws changed it.
    """

    __slots__ = ("_memory", "changes", "descriptor", "levels", "stencil", "words")

    def __init__(self, context: ClContext, descriptor: TextureDescriptor) -> None:
        self.descriptor = descriptor
        self.changes = 0
        self._memory: list[cl.Buffer] = []
        self.words: dict[Id | tuple[int, int], cl.Buffer] = {}
        self.stencil: list[Plane] = []
        format = descriptor.format
        self.levels = self._allocate(context, format.channels * format.dtype.itemsize)
        if format.has_stencil:
            try:
                self.stencil = self._allocate(context, 1)
            except cl.Error:
                self.release()
                raise

    def _allocate(self, context: ClContext, texel: int) -> list[Plane]:
        """One buffer for all levels, each beginning at a multiple of `GRAIN`."""
        descriptor = self.descriptor
        boxes = [
            (*descriptor.level_size(level), descriptor.level_layers(level) * descriptor.samples)
            for level in range(descriptor.levels)
        ]
        starts = [0]
        for width, height, layers in boxes:
            starts.append(round_up(starts[-1] + pitches_of(texel, width, height)[1] * layers))
        memory = allocate(context, starts[-1])
        self._memory.append(memory)
        return [Plane(memory, start, texel, *box) for start, box in zip(starts, boxes, strict=False)]

    def release(self) -> None:
        for memory in (*self._memory, *self.words.values()):
            memory.release()


class Textures:
    """All textures of a device, by id."""

    def __init__(self, context: ClContext, staging: Staging) -> None:
        self._context = context
        self._queue = context.queue
        self._staging = staging
        self._filters = Filters(context)
        self._textures: dict[Id, Texture] = {}

    def __getitem__(self, texture: Id) -> Texture:
        return self._textures[texture]

    def create(self, texture: Id, descriptor: TextureDescriptor) -> None:
        with translate_errors("device.texture", f"{descriptor.size}, {descriptor.format}"):
            self._textures[texture] = Texture(self._context, descriptor)

    def destroy(self, texture: Id) -> None:
        self._textures.pop(texture).release()

    def write(self, texture: Id, level: int, region: Region, data: BytesLike) -> None:
        made, source = self._textures[texture], np.frombuffer(memoryview(data), np.uint8)
        made.changes += 1
        plane = made.levels[level]
        if self._staging.takes(len(source)):
            self._staging.add(plane.write(self._queue, region, source.copy(), False), len(source))
        else:
            plane.write(self._queue, region, source, True)
            self._staging.clear()

    def read(self, texture: Id, level: int, region: Region, stencil: bool) -> NDArray[np.generic]:
        source = self._textures[texture]
        format = source.descriptor.format
        plane = (source.stencil if stencil else source.levels)[level]
        dtype = np.dtype(np.uint8) if stencil else format.dtype
        texels = np.empty((region.layers, region.height, region.width, format.channels), dtype)
        plane.read(self._queue, region, texels)
        return texels

    def copy(
        self, source: Id, source_level: int, source_region: Region, target: Id, target_level: int, x: int, y: int,
        layer: int,
    ) -> None:  # fmt: skip
        old, new = self._textures[source], self._textures[target]
        new.changes += 1
        old.levels[source_level].copy(self._queue, source_region, new.levels[target_level], x, y, layer)
        if old.stencil:
            old.stencil[source_level].copy(self._queue, source_region, new.stencil[target_level], x, y, layer)

    def resolve(self, source: Id, target: Id) -> None:
        old, new = self._textures[source], self._textures[target]
        new.changes += 1
        self._filters.resolve(old.descriptor.format, old.levels[0], new.levels[0])

    def generate_mipmaps(self, texture: Id) -> None:
        made = self._textures[texture]
        made.changes += 1
        for above, below in zip(made.levels, made.levels[1:], strict=False):
            self._filters.halve(made.descriptor.format, above, below)



