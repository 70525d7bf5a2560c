"""Memory that draws need besides buffers and textures: all of it from pools, nothing per draw.

- Kernels find memory by its address (kernels/common.cl). A tiny kernel asks for it, once per object, in a queue of its
  own. OpenCL doesn't promise that memory stays where it is and can be used so; `Addresses.work` is whether it was seen
  to, and without that there are no draws.
- `Pool`: scratch memory of the device, the same for all batches, since they follow one another in one queue. It grows
  by doubling; what it grew out of lives until the next fence value has passed.
- `Uploads`: host memory that kernels read in place, or, where they can't, copies on their way to the device. Pages are
  used again when the device is past what was written to them.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import pyopencl as cl

from rhi.backends.cl.context import ClContext, allocate_pages
from rhi.backends.cl.errors import translate_errors

__rhi_internal__ = True

_PAGE_BYTES: Final = 1 << 20
_ALIGN: Final = 64
_SLACK: Final = 256  # what vector loads may read beyond the end
_PATTERN: Final = 0x5EED_0123_4567_89AB


class Addresses:
    """Finds where memory lies on the device.

    Attributes:
        queue: one that doesn't stand behind draws.
        work: whether a kernel that is given nothing but an address reads what lies there.
    """

    def __init__(self, context: ClContext) -> None:
        self.queue = cl.CommandQueue(context.context)
        self._find, self._read = cl.Kernel(context.probe, "find"), cl.Kernel(context.probe, "read")
        self._answer = np.zeros(1, np.uint64)
        self._memory = cl.Buffer(context.context, cl.mem_flags.READ_WRITE, self._answer.nbytes)
        self.work = self._probe(context)

    def find(self, memory: cl.Buffer) -> int:
        """The address of a buffer's first byte."""
        with translate_errors("device.draw", "where memory lies"):
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
    """Memory of the device, its contents unknown.

    Raises:
        pyopencl.Error: there isn't as much.
    """
    made = cl.Buffer(context.context, cl.mem_flags.READ_WRITE, size + _SLACK)
    try:  # makes the driver allocate now
        cl.enqueue_fill_buffer(context.queue, made, np.zeros(4, np.uint8), 0, 4)
    except cl.Error:
        made.release()
        raise
    return made


class Retired:
    """Memory that the device may still use: to be let go when the next fence value has passed."""

    def __init__(self) -> None:
        self._memory: list[Any] = []

    def add(self, memory: Any) -> None:
        self._memory.append(memory)

    def take(self) -> list[Any]:
        """Hand all over."""
        taken, self._memory = self._memory, []
        return taken


class Pool:
    """Scratch memory of the device for one purpose."""

    def __init__(self, context: ClContext, addresses: Addresses, retired: Retired) -> None:
        self._context = context
        self._addresses = addresses
        self._retired = retired
        self._memory: cl.Buffer | None = None
        self.size = 0
        self._address = 0

    def reserve(self, size: int) -> int:
        """The address of at least so many bytes; what they held is lost.

        Raises:
            pyopencl.Error: there isn't as much; the pool stays as it was.
        """
        if size > self.size:
            size = max(size, 2 * self.size, 1 << 16)
            memory = allocate_raw(self._context, size)
            if self._memory is not None:
                self._retired.add(self._memory)
            self._memory, self.size, self._address = memory, size, self._addresses.find(memory)
        return self._address


class IndexList:
    """Indices made on the host; their memory outlives the batch that reads them."""

    __slots__ = ("_memory", "_retired", "address")

    def __init__(self, memory: cl.Buffer, address: int, retired: Retired) -> None:
        self._memory = memory
        self._retired = retired
        self.address = address

    def __del__(self) -> None:
        self._retired.add(self._memory)


class _Page:
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
    """Tables on their way to kernels."""

    def __init__(self, context: ClContext, addresses: Addresses) -> None:
        self._context = context
        self._addresses = addresses
        self._page = self._make(_PAGE_BYTES)
        self._waiting: list[_Page] = []

    def write(self, table: bytes) -> int:
        """Put a table where kernels find it; gives its address. It stays until `release` is told an event."""
        size = -(-(len(table) + _SLACK) // _ALIGN) * _ALIGN
        if self._page.used + size > len(self._page.host):
            page = self._find_page(size)
            self._page.event = None  # the next one covers it whole
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
        """What was written so far is done with when `event` is."""
        self._page.event = event
        for page in self._waiting:
            page.event = page.event or event

    def _find_page(self, size: int) -> _Page:
        complete = cl.command_execution_status.COMPLETE
        for place, page in enumerate(self._waiting):
            event = page.event
            if len(page.host) >= size and event is not None and event.command_execution_status == complete:
                del self._waiting[place]
                page.used, page.event = 0, None
                return page
        return self._make(max(size, _PAGE_BYTES))

    def _make(self, size: int) -> _Page:
        return _Page(self._context, self._addresses, size)
