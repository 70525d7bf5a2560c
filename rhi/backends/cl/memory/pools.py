"""Pools of memory that draws need besides buffers and textures, so that no draw allocates any.

- Kernels access memory by its address (kernels/common.cl), and read host memory in place. So this memory
  needs no OpenCL buffer.
- `Pool`: scratch memory. All batches share it, since they execute one after the other in one queue. It grows
  by doubling; the memory that it replaces is released after the next fence value.
- `Uploads`: tables that the host writes and kernels read. Pages are reused once the device has executed the
  kernels that read them.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from rhi.backends.cl.cl_context import allocate_pages
from rhi.backends.cl.cl_errors import translate_errors
from rhi.backends.cl.memory.in_flight import InFlight

_PAGE_BYTES: Final = 1 << 20
_ALIGN: Final = 64
_SLACK: Final = 256  # bytes that vector loads may read past the end


class Pool:
    """Scratch memory of the device for one purpose; `size` in bytes."""

    def __init__(self, in_flight: InFlight) -> None:
        self._in_flight = in_flight
        self._memory = allocate_pages(0)
        self.size = self._address = 0

    def reserve(self, size: int) -> int:
        """Return the address of at least `size` bytes. If the pool has to grow, its contents are lost.

        Raises:
            MemoryError: out of memory; the pool is unchanged.
        """
        if size > self.size:
            size = max(size, 2 * self.size, 1 << 16)
            memory = allocate_pages(size + _SLACK)
            self._in_flight.add(self._memory)
            self._memory, self.size, self._address = memory, size, memory.ctypes.data
        return self._address


class IndexList:
    """An index list made on the host. Its memory outlives the batches that read it."""

    __slots__ = ("_in_flight", "_memory", "address")

    def __init__(self, in_flight: InFlight, indices: NDArray[np.uint32]) -> None:
        self._memory: NDArray[np.uint8] | None = None  # None while the list is empty
        self._in_flight = in_flight
        with translate_errors("device.draw", f"{len(indices)} indices"):
            memory = allocate_pages(indices.nbytes + _SLACK, indices)
        self._memory = memory
        self.address: int = memory.ctypes.data

    def __del__(self) -> None:
        if self._memory is not None:
            self._in_flight.add(self._memory)


class _UploadPage:
    """Memory for consecutive tables; `event`: the completion of the last kernels that read it."""

    __slots__ = ("address", "bytes", "event", "used")

    def __init__(self, size: int) -> None:
        memory = allocate_pages(size)
        self.bytes, self.address = memory.data, memory.ctypes.data
        self.used = 0
        self.event: cl.Event | None = None


class Uploads:
    """A ring of pages for tables that the host writes and kernels read."""

    def __init__(self) -> None:
        self._page = _UploadPage(_PAGE_BYTES)
        self._waiting: list[_UploadPage] = []

    def write(self, table: bytes) -> int:
        """Upload a table and return its address. It is valid until the event passed to the next `release`
        completes."""
        size = -(-(len(table) + _SLACK) // _ALIGN) * _ALIGN
        if self._page.used + size > len(self._page.bytes):
            page = self._next_page(size)
            self._page.event = None  # the next event covers all of the page
            self._waiting.append(self._page)
            self._page = page
        page = self._page
        start = page.used
        page.used += size
        page.bytes[start : start + len(table)] = table
        return page.address + start

    def release(self, event: cl.Event) -> None:
        """Release all tables written so far; they are overwritten once `event` is complete."""
        self._page.event = event
        for page in self._waiting:
            page.event = page.event or event

    def _next_page(self, size: int) -> _UploadPage:
        complete = cl.command_execution_status.COMPLETE
        for index, page in enumerate(self._waiting):
            event = page.event
            if len(page.bytes) >= size and event is not None and event.command_execution_status == complete:
                del self._waiting[index]
                page.used, page.event = 0, None
                return page
        return _UploadPage(max(size, _PAGE_BYTES))
