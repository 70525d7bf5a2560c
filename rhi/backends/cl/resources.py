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

from typing import Any, Final

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray
from typing_extensions import Buffer as BytesLike

from rhi.backends.cl.context import Context, allocate_pages
from rhi.backends.cl.errors import translate_errors
from rhi.backends.cl.filters import Filters
from rhi.descriptors import (
    BufferDescriptor,
    BufferUsage,
    Id,
    Region,
    TextureDescriptor,
)

__rhi_internal__ = True

GRAIN: Final = 128
"""Memory comes in multiples of this many bytes, and at least as many are behind what was asked for."""
BLOCK: Final = 4
"""Texels along the edge of a block: rows are as long, and as many, as whole blocks need."""
_copy_box: Final[Any] = cl.enqueue_copy  # whose stubs name a box's arguments otherwise than it does
_MAX_PATTERN: Final = 128
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

    def __init__(self, context: Context, staging: Staging) -> None:
        self._context = context
        self._queue = context.queue
        self._staging = staging
        self._buffers: dict[Id, Memory] = {}

    def create(self, buffer: Id, descriptor: BufferDescriptor) -> None:
        with translate_errors("device.buffer", f"{descriptor.size} bytes"):
            if descriptor.usage is BufferUsage.STREAM and self._context.shares_memory:
                host = allocate_pages(_round_up(descriptor.size) + GRAIN)
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


class Plane:
    """Layers of texels from byte `start` of a buffer on, top row first.

    Attributes:
        texel: bytes of a texel.
        width, height, layers: in texels, without padding.
        pitch: bytes from one row to the next.
        layer_bytes: bytes from one layer to the next.
    """

    __slots__ = ("height", "layer_bytes", "layers", "memory", "pitch", "start", "texel", "width")

    def __init__(
        self, memory: cl.Buffer, start: int, texel: int, width: int, height: int, layers: int
    ) -> None:
        self.memory = memory
        self.start = start
        self.texel = texel
        self.width = width
        self.height = height
        self.layers = layers
        self.pitch, self.layer_bytes = pitches_of(texel, width, height)

    @property
    def _pitches(self) -> tuple[int, int]:
        return self.pitch, self.layer_bytes

    def write(
        self, queue: cl.CommandQueue, region: Region, texels: NDArray[np.uint8], block: bool
    ) -> cl.Event:
        event: cl.Event = _copy_box(queue, self.memory, texels, **self._host_box(region), is_blocking=block)
        return event

    def read(self, queue: cl.CommandQueue, region: Region, texels: NDArray[np.generic]) -> None:
        _copy_box(queue, texels, self.memory, **self._host_box(region))

    def copy(self, queue: cl.CommandQueue, region: Region, target: Plane, x: int, y: int, layer: int) -> None:
        if self.memory is target.memory and self._pitches != target._pitches:  # which OpenCL can't do at once
            box = region.width, region.height, region.layers
            size = pitches_of(self.texel, *box[:2])[1] * region.layers
            with translate_errors("Texture.copy_to", f"{size} bytes between two levels"):
                memory = cl.Buffer(queue.context, cl.mem_flags.READ_WRITE, size)
            between = Plane(memory, 0, self.texel, *box)
            self.copy(queue, region, between, 0, 0, 0)
            between.copy(queue, Region(0, 0, *box[:2], 0, box[2]), target, x, y, layer)
            return
        _copy_box(
            queue, target.memory, self.memory, src_origin=self._origin(region.x, region.y, region.layer),
            dst_origin=target._origin(x, y, layer),
            region=(region.width * self.texel, region.height, region.layers),
            src_pitches=self._pitches, dst_pitches=target._pitches,
        )  # fmt: skip

    def fill(self, queue: cl.CommandQueue, texel: bytes, layer: int, layers: int) -> None:
        """Padding, too."""
        start = self.start + layer * self.layer_bytes
        fill(queue, self.memory, texel, start, layers * self.layer_bytes)

    def _origin(self, x: int, y: int, layer: int) -> tuple[int, int, int]:
        """A box's corner. The level's start is added to the first number, a distance in bytes like any other:
        PoCL 3.1 crashes on boxes in sub-buffers."""
        return self.start + x * self.texel, y, layer

    def _host_box(self, region: Region) -> dict[str, tuple[int, ...]]:
        """A region of this memory, and tightly packed host memory."""
        row = region.width * self.texel
        return {
            "buffer_origin": self._origin(region.x, region.y, region.layer),
            "host_origin": (0, 0, 0),
            "region": (row, region.height, region.layers),
            "buffer_pitches": self._pitches,
            "host_pitches": (row, row * region.height),
        }


class Texture:
    """A texture's levels, and those of its stencil if it has one.

    Attributes:
        words: what kernels are told about it, by sampler, or by level and layer of an image (`samplers`).
        changes: how often anything but draws changed it.
    """

    __slots__ = ("_memory", "changes", "descriptor", "levels", "stencil", "words")

    def __init__(self, context: Context, descriptor: TextureDescriptor) -> None:
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

    def _allocate(self, context: Context, texel: int) -> list[Plane]:
        """One buffer for all levels, each beginning at a multiple of `GRAIN`."""
        descriptor = self.descriptor
        boxes = [
            (*descriptor.level_size(level), descriptor.level_layers(level) * descriptor.samples)
            for level in range(descriptor.levels)
        ]
        starts = [0]
        for width, height, layers in boxes:
            starts.append(_round_up(starts[-1] + pitches_of(texel, width, height)[1] * layers))
        memory = allocate(context, starts[-1])
        self._memory.append(memory)
        return [Plane(memory, start, texel, *box) for start, box in zip(starts, boxes, strict=False)]

    def release(self) -> None:
        for memory in (*self._memory, *self.words.values()):
            memory.release()


class Textures:
    """All textures of a device, by id."""

    def __init__(self, context: Context, staging: Staging) -> None:
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



def pitches_of(texel: int, width: int, height: int) -> tuple[int, int]:
    """Bytes from row to row and from layer to layer."""
    pitch = _whole_blocks(width) * texel
    return pitch, _whole_blocks(height) * pitch


def alignment(device: cl.Device) -> int:
    """Bytes at whose multiples a part of a buffer may begin."""
    return max(16, int(device.mem_base_addr_align) // 8)


def allocate(context: Context, size: int) -> cl.Buffer:
    """Zeroed memory of the device.

    Raises:
        pyopencl.Error: there isn't as much.
    """
    size = _round_up(size) + GRAIN
    made = cl.Buffer(context.context, cl.mem_flags.READ_WRITE, size)
    try:
        fill(context.queue, made, b"\0", 0, size)
    except cl.Error:
        made.release()
        raise
    return made


def fill(queue: cl.CommandQueue, memory: cl.Buffer, pattern: bytes, offset: int, size: int) -> None:
    """Repeat `pattern` (its length a power of two) over a range, a multiple of it at a multiple of it."""
    if not size:
        return
    while len(pattern) < _MAX_PATTERN and (offset | size) % (2 * len(pattern)) == 0:
        pattern += pattern
    cl.enqueue_fill_buffer(queue, memory, np.frombuffer(pattern, np.uint8), offset, size)


def _whole_blocks(size: int) -> int:
    return -(-size // BLOCK) * BLOCK


def _round_up(size: int) -> int:
    return -(-size // GRAIN) * GRAIN
