"""Buffers: plain OpenCL buffers, and the commands that move bytes between them.

- A buffer is host memory of zeros, followed by padding, since vector loads may run past its end.
- Data that the CPU writes is copied first, and the copy is kept until the device has read it (`InFlight`). A
  write that is too large for that waits for the device.
- Buffers that only the CPU writes and indirect draws read get a copy on the host at the first such draw, so
  that later ones don't wait for the device.
- If kernels read host memory in place, writing a STREAM buffer is a plain copy. So is reading a READBACK
  buffer.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray
from typing_extensions import Buffer as BytesLike

from rhi.backends.cl.cl_context import ClContext
from rhi.backends.cl.cl_errors import translate_errors
from rhi.backends.cl.memory.in_flight import InFlight
from rhi.backends.cl.memory.planes import allocate, buffer_address, fill
from rhi.contract.descriptors import BufferDescriptor, BufferUsage, Id

_MAX_RANGES: Final = 4096
_MAX_CPU_COPY_BYTES: Final = 1 << 24  # largest buffer that is copied on the host


class BufferMemory:
    """The memory of one buffer.

    Attributes:
        cl: OpenCL's buffer.
        `address`: where kernels find it.
        host: its host memory, if commands and the CPU may use that at the same time, or None.
        ranges: the sub-buffers that were bound, by offset and size.
        cpu_copy: the copy on the host, or None.
        device_wrote: whether a command or a shader may have written it; if not, `host` or `cpu_copy` is up to
            date.
        read_in_place: whether reads copy from `host` at once, without waiting.
    """

    __slots__ = ("address", "cl", "cpu_copy", "device_wrote", "host", "ranges", "read_in_place", "size")

    def __init__(self, buffer: cl.Buffer, size: int, usage: BufferUsage) -> None:
        """`usage`: STATIC for memory that only commands use."""
        self.cl = buffer
        self.address = buffer_address(buffer)
        self.size = size
        host: Any = buffer.hostbuf
        self.host: NDArray[np.uint8] | None = None if usage is BufferUsage.STATIC else host
        self.cpu_copy: NDArray[np.uint8] | None = None
        self.ranges: dict[tuple[int, int], cl.Buffer] = {}
        self.device_wrote = False
        self.read_in_place = usage is BufferUsage.READBACK


class Buffers:
    """The buffers of a device, by id."""

    def __init__(self, context: ClContext, in_flight: InFlight) -> None:
        self._context = context
        self._queue = context.queue
        self._in_flight = in_flight
        self._buffers: dict[Id, BufferMemory] = {}

    def create(self, buffer: Id, descriptor: BufferDescriptor) -> None:
        with translate_errors("device.buffer", f"{descriptor.size} bytes"):
            memory = allocate(self._context.context, descriptor.size)
        usage = descriptor.usage if self._context.shares_memory else BufferUsage.STATIC
        self._buffers[buffer] = BufferMemory(memory, descriptor.size, usage)

    def destroy(self, buffer: Id) -> None:
        memory = self._buffers.pop(buffer)
        for part in memory.ranges.values():
            part.release()
        self._in_flight.release(memory.cl)

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
            staged = self._in_flight.has_room(len(source))
            source = source.copy() if staged else source
            event = cl.enqueue_copy(self._queue, memory.cl, source, dst_offset=offset, is_blocking=not staged)
            if staged:
                self._in_flight.add(event, len(source))
            else:
                self._in_flight.take()
            if memory.cpu_copy is not None:
                memory.cpu_copy[offset : offset + len(source)] = source

    def read(self, buffer: Id, offset: int, size: int) -> bytes:
        memory = self._buffers[buffer]
        if self._context.shares_memory:  # a command that copies has to wake a thread of the device
            if not memory.read_in_place:
                self._queue.finish()
            host: Any = memory.cl.hostbuf
            return bytes(host[offset : offset + size])
        data = np.empty(size, np.uint8)
        if size:
            cl.enqueue_copy(self._queue, data, memory.cl, src_offset=offset)
        return data.tobytes()

    def host_memory(self, buffer: Id) -> NDArray[np.uint8] | None:
        """Wait for the queue, and return the memory that kernels write; None if it isn't the host's."""
        if not self._context.shares_memory:
            return None
        self._queue.finish()
        memory = self._buffers[buffer]
        host: Any = memory.cl.hostbuf
        view: NDArray[np.uint8] = host[: memory.size]
        return view

    def get_cpu_copy(self, buffer: Id) -> NDArray[np.uint8] | None:
        """Return the host's copy of a buffer, reading it back once; None if the device may have written the
        buffer."""
        memory = self._buffers[buffer]
        if memory.device_wrote:
            memory.cpu_copy = None
            return None
        if memory.host is not None:
            return memory.host
        if memory.cpu_copy is None and memory.size <= _MAX_CPU_COPY_BYTES:
            memory.cpu_copy = np.frombuffer(bytearray(self.read(buffer, 0, memory.size)), np.uint8)
        return memory.cpu_copy

    def copy(self, source: Id, source_offset: int, target: Id, target_offset: int, size: int) -> None:
        if size:
            cl.enqueue_copy(
                self._queue,
                self._buffers[target].cl,
                self._buffers[source].cl,
                src_offset=source_offset,
                dst_offset=target_offset,
                byte_count=size,
            )

    def clear(self, buffer: Id, offset: int, size: int, value: int) -> None:
        pattern = (value & 0xFFFFFFFF).to_bytes(4, "little")
        fill(self._queue, self._buffers[buffer].cl, pattern, offset, size)
