"""Memory that draws need besides buffers and textures. It comes from pools; no draw allocates any of its own.

- Kernels access memory by its address (kernels/common.cl). A small kernel reports the address of each object once, in a
  queue of its own. OpenCL doesn't guarantee that memory stays in place and can be accessed this way; `Addresses.work`
  says whether a probe succeeded. If it didn't, the device has no draws.
- `Pool`: scratch memory of the device. All batches share it, since they execute one after the other in one queue. It
  grows by doubling; the memory that it replaces is released after the next fence value.
- `Uploads`: host memory that kernels read in place, or a staging copy on devices that can't. Pages are reused once the
  device has executed the kernels that read them.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import pyopencl as cl

from rhi.backends.cl.context import ClContext, allocate_pages
from rhi.backends.cl.errors import translate_errors

_PAGE_BYTES: Final = 1 << 20
_ALIGN: Final = 64
_SLACK: Final = 256  # bytes that vector loads may read past the end
_PATTERN: Final = 0x5EED_0123_4567_89AB


class Addresses:
    """Finds the addresses of buffers on the device.

    Attributes:
        queue: a queue of its own, whose commands don't wait for draws.
        work: whether a kernel that is given only an address can read the memory there.
    """

    def __init__(self, context: ClContext) -> None:
        self.queue = cl.CommandQueue(context.context)
        self._find, self._read = cl.Kernel(context.probe, "find"), cl.Kernel(context.probe, "read")
        self._answer = np.zeros(1, np.uint64)
        self._memory = cl.Buffer(context.context, cl.mem_flags.READ_WRITE, self._answer.nbytes)
        self.work = self._probe(context)

    def find(self, memory: cl.Buffer) -> int:
        """Return the address of a buffer's first byte."""
        with translate_errors("device.draw", "the address of memory"):
            return self._ask(self._find, memory)

    def _ask(self, kernel: cl.Kernel, what: Any) -> int:
        kernel.set_args(what, self._memory)
        cl.enqueue_nd_range_kernel(self.queue, kernel, (1,), (1,))
        cl.enqueue_copy(self.queue, self._answer, self._memory)
        return int(self._answer[0])

    def _probe(self, context: ClContext) -> bool:
        flags = cl.mem_flags.READ_WRITE | cl.mem_flags.COPY_HOST_PTR
        memory = cl.Buffer(context.context, flags, hostbuf=np.array([_PATTERN], np.uint64))
        address = self.find(memory)
        try:
            return address != 0 and self._ask(self._read, np.uint64(address)) == _PATTERN
        except cl.Error:
            return False


def allocate_raw(context: ClContext, size: int) -> cl.Buffer:
    """Return a new buffer with undefined contents.

    Raises:
        pyopencl.Error: out of memory.
    """
    made = cl.Buffer(context.context, cl.mem_flags.READ_WRITE, size + _SLACK)
    try:  # makes the driver allocate now
        cl.enqueue_fill_buffer(context.queue, made, np.zeros(4, np.uint8), 0, 4)
    except cl.Error:
        made.release()
        raise
    return made


class Retired:
    """Memory that is no longer needed but that the device may still use, to be released after the next fence value."""

    def __init__(self) -> None:
        self._memory: list[Any] = []

    def add(self, memory: Any) -> None:
        self._memory.append(memory)

    def take(self) -> list[Any]:
        """Remove and return everything collected so far."""
        taken, self._memory = self._memory, []
        return taken


class Pool:
    """Scratch memory of the device for one purpose; `size` in bytes."""

    def __init__(self, context: ClContext, addresses: Addresses, retired: Retired) -> None:
        self._context = context
        self._addresses = addresses
        self._retired = retired
        self._memory: cl.Buffer | None = None
        self.size = 0
        self._address = 0

    def reserve(self, size: int) -> int:
        """Return the address of at least `size` bytes. If the pool has to grow, its contents are lost.

        Raises:
            pyopencl.Error: out of memory; the pool is unchanged.
        """
        if size > self.size:
            size = max(size, 2 * self.size, 1 << 16)
            memory = allocate_raw(self._context, size)
            address = self._addresses.find(memory)
            if self._memory is not None:
                self._retired.add(self._memory)
            self._memory, self.size, self._address = memory, size, address
        return self._address


class IndexList:
    """An index list made on the host. Its memory outlives the batches that read it."""

    __slots__ = ("_memory", "_retired", "address")

    def __init__(self, memory: cl.Buffer, address: int, retired: Retired) -> None:
        self._memory = memory
        self._retired = retired
        self.address = address

    def __del__(self) -> None:
        self._retired.add(self._memory)


class _UploadPage:
    """Memory for consecutive tables; `event`: the completion of the last kernels that read it."""

    __slots__ = ("address", "bytes", "event", "host", "memory", "used")

    def __init__(self, context: ClContext, addresses: Addresses, size: int) -> None:
        self.host = allocate_pages(size)
        self.bytes = self.host.data
        flags = cl.mem_flags.READ_WRITE
        if context.shares_memory:
            self.memory = cl.Buffer(context.context, flags | cl.mem_flags.USE_HOST_PTR, hostbuf=self.host)
        else:
            self.memory = cl.Buffer(context.context, flags, size)
        self.address = addresses.find(self.memory)
        self.used = 0
        self.event: cl.Event | None = None


class Uploads:
    """A ring of pages for tables that the host writes and kernels read."""

    def __init__(self, context: ClContext, addresses: Addresses) -> None:
        self._context = context
        self._addresses = addresses
        self._page = self._make(_PAGE_BYTES)
        self._waiting: list[_UploadPage] = []

    def write(self, table: bytes) -> int:
        """Upload a table and return its address. It is valid until the event passed to the next `release` completes."""
        size = -(-(len(table) + _SLACK) // _ALIGN) * _ALIGN
        if self._page.used + size > len(self._page.host):
            page = self._find_page(size)
            self._page.event = None  # the next event covers all of the page
            self._waiting.append(self._page)
            self._page = page
        page = self._page
        start = page.used
        page.used += size
        page.bytes[start : start + len(table)] = table
        if not self._context.shares_memory:
            view = page.host[start : start + len(table)]
            cl.enqueue_copy(self._context.queue, page.memory, view, dst_offset=start, is_blocking=False)
        return page.address + start

    def release(self, event: cl.Event) -> None:
        """Let all tables written so far be overwritten once `event` is complete."""
        self._page.event = event
        for page in self._waiting:
            page.event = page.event or event

    def _find_page(self, size: int) -> _UploadPage:
        complete = cl.command_execution_status.COMPLETE
        for index, page in enumerate(self._waiting):
            event = page.event
            if len(page.host) >= size and event is not None and event.command_execution_status == complete:
                del self._waiting[index]
                page.used, page.event = 0, None
                return page
        return self._make(max(size, _PAGE_BYTES))

    def _make(self, size: int) -> _UploadPage:
        return _UploadPage(self._context, self._addresses, size)
