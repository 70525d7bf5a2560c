"""Buffers: plain OpenCL buffers, and the commands that move bytes between them.

- A buffer is filled with zeros when it is created, so a driver that allocates late reports at once that it can't. It
  is followed by padding, since vector loads may run past its end.
- Data that the CPU writes is copied first, and the copy is kept until the device has read it (`Staging`). A write that
  is too large for that waits for the device.
- What indirect draws read from a buffer that only the CPU writes is kept on the host from the first time on, so that
  later ones don't wait for the device.
- A STREAM buffer is host memory that kernels read in place, if the device can; writing it is then a plain copy. So is
  reading a READBACK buffer.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray
from typing_extensions import Buffer as BytesLike

from rhi.backends.cl.context import ClContext, allocate_pages
from rhi.backends.cl.errors import translate_errors
from rhi.backends.cl.memory.planes import GRAIN, allocate, fill, round_to_grain
from rhi.backends.cl.memory.staging import Staging
from rhi.contract.descriptors import BufferDescriptor, BufferUsage, Id

_MAX_RANGES: Final = 4096
_MAX_KNOWN: Final = 1 << 24  # size in bytes of a buffer whose contents are kept on the host


class BufferMemory:
    """The memory of one buffer.

    Attributes:
        cl: OpenCL's buffer.
        host: the host memory that kernels read in place, or None.
        ranges: the sub-buffers that were bound, by offset and size.
        known: what the CPU wrote, if that is kept on the host, or None.
        device_wrote: whether a command or a shader may have written it; if not, `host` or `known` is what it holds.
        read_in_place: whether reads take what `host` holds now, without waiting.
    """

    __slots__ = ("cl", "device_wrote", "host", "known", "ranges", "read_in_place", "size")

    def __init__(self, made: cl.Buffer, size: int, host: NDArray[np.uint8] | None = None) -> None:
        self.cl = made
        self.size = size
        self.host = host
        self.known: NDArray[np.uint8] | None = None
        self.ranges: dict[tuple[int, int], cl.Buffer] = {}
        self.device_wrote = False
        self.read_in_place = False

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
        self._buffers: dict[Id, BufferMemory] = {}

    def create(self, buffer: Id, descriptor: BufferDescriptor) -> None:
        with translate_errors("device.buffer", f"{descriptor.size} bytes"):
            if descriptor.usage is not BufferUsage.STATIC and self._context.shares_memory:
                host = allocate_pages(round_to_grain(descriptor.size) + GRAIN)
                flags = cl.mem_flags.READ_WRITE | cl.mem_flags.USE_HOST_PTR
                shared = cl.Buffer(self._context.context, flags, hostbuf=host)
                made = BufferMemory(shared, descriptor.size, host)
                made.read_in_place = descriptor.usage is BufferUsage.READBACK
            else:
                made = BufferMemory(allocate(self._context, descriptor.size), descriptor.size)
        self._buffers[buffer] = made

    def destroy(self, buffer: Id) -> None:
        self._buffers.pop(buffer).release()

    def __getitem__(self, buffer: Id) -> BufferMemory:
        return self._buffers[buffer]

    def bound(self, buffer: Id, offset: int, size: int) -> cl.Buffer:
        """Return a range of a buffer as a kernel's argument."""
        memory = self._buffers[buffer]
        if not offset:
            return memory.cl
        part = memory.ranges.get((offset, size))
        if part is None:
            if len(memory.ranges) == _MAX_RANGES:
                memory.ranges.clear()  # the kernel's program keeps its arguments alive
            part = memory.ranges[offset, size] = memory.cl.get_sub_region(offset, size)
        return part

    def write(self, buffer: Id, offset: int, data: BytesLike) -> None:
        memory, source = self._buffers[buffer], np.frombuffer(memoryview(data), np.uint8)
        if memory.host is not None:
            memory.host[offset : offset + len(source)] = source
        elif len(source):
            staged = self._staging.has_room(len(source))
            source = source.copy() if staged else source
            event = cl.enqueue_copy(self._queue, memory.cl, source, dst_offset=offset, is_blocking=not staged)
            if staged:
                self._staging.add(event, len(source))
            else:
                self._staging.clear()
            if memory.known is not None:
                memory.known[offset : offset + len(source)] = source

    def read(self, buffer: Id, offset: int, size: int) -> bytes:
        memory = self._buffers[buffer]
        if memory.read_in_place and memory.host is not None:
            return memory.host[offset : offset + size].tobytes()
        data = np.empty(size, np.uint8)
        if size:
            cl.enqueue_copy(self._queue, data, memory.cl, src_offset=offset)
        return data.tobytes()

    def find_known(self, buffer: Id) -> NDArray[np.uint8] | None:
        """Return what a buffer holds, if the host knows it or may ask once and for all: if only the CPU writes it."""
        memory = self._buffers[buffer]
        if memory.device_wrote:
            memory.known = None
            return None
        if memory.host is not None:
            return memory.host
        if memory.known is None and memory.size <= _MAX_KNOWN:
            memory.known = np.frombuffer(bytearray(self.read(buffer, 0, memory.size)), np.uint8)
        return memory.known

    def copy(self, source: Id, source_offset: int, target: Id, target_offset: int, size: int) -> None:
        if size:
            cl.enqueue_copy(
                self._queue, self._buffers[target].cl, self._buffers[source].cl, src_offset=source_offset,
                dst_offset=target_offset, byte_count=size,
            )  # fmt: skip

    def clear(self, buffer: Id, offset: int, size: int, value: int) -> None:
        pattern = (value & 0xFFFFFFFF).to_bytes(4, "little")
        fill(self._queue, self._buffers[buffer].cl, pattern, offset, size)
