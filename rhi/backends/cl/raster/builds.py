"""Builds of the kernels that draw. Their machine code is generated while further draws are gathered.

- Source code is compiled at once, so that the call that needs it gets the driver's errors. PoCL generates machine code
  only at a kernel's first launch, which takes two thirds of the time, and does one kernel at a time per context.
- So for source code that isn't in the cache on disk yet, a thread with a context of its own launches the kernels with
  an empty batch. That leaves the machine code in the cache, where the device finds it. Several threads generate several
  kernels at the same time.
- Only the device waits: launches in its queue wait for a user event, which is set however the thread's work ends. If
  the thread failed, the device generates the machine code itself and reports the error.
- The logger `rhi.kernels` reports at level INFO how many kernels of a first run are built. Cached kernels aren't
  reported.
"""

from __future__ import annotations

import logging
import os
import threading
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Final

import numpy as np
import pyopencl as cl

from rhi.backends.cl.context import PAGE, ClContext, allocate_pages, build, build_again
from rhi.backends.cl.raster.tables import BATCH_STRUCT

__rhi_internal__ = True

LOGGER: Final = logging.getLogger("rhi.kernels")
_POCL: Final = "Portable Computing Language"
_COLD: Final = 0.06  # seconds of processor time: a compilation takes 0.15 or more, 0.03 from the cache on disk
_MOST_THREADS: Final = 4
_EMPTY_PAGES: Final = 16  # more than kernels read at any address of an empty batch


class Kernel:
    """A kernel that draws. Its only argument is the address of a batch table."""

    __slots__ = ("_kernel", "_ready")

    def __init__(self, program: cl.Program, name: str, ready: cl.Event | None) -> None:
        """`ready`: the event that launches wait for, if any."""
        self._kernel = cl.Kernel(program, name)
        self._kernel.set_scalar_arg_dtypes([np.uint64])
        self._ready = ready

    def launch(self, queue: cl.CommandQueue, batch: int, items: int) -> cl.Event:
        """Enqueue `items` work-items on the batch table at this address."""
        self._kernel.set_args(batch)  # with the argument's type set, 20 times as fast as `set_arg`
        wait_for = None if self._ready is None else [self._ready]
        event: cl.Event = cl.enqueue_nd_range_kernel(queue, self._kernel, (items,), (1,), wait_for=wait_for)
        self._ready = None  # the queue is in order, so later launches wait for this one
        return event


class Builds:
    """Builds the kernels of one device."""

    def __init__(self, context: ClContext) -> None:
        self._context = context
        self._threads: ThreadPoolExecutor | None = None
        self._local = threading.local()
        self._lock = threading.Lock()
        self._begun = self._done = 0
        caches = context.device.platform.name == _POCL and os.environ.get("POCL_KERNEL_CACHE", "1") != "0"
        self._in_background = caches

    def build(self, source: str, names: Sequence[str], flushes_denormals: bool = False) -> list[Kernel]:
        """Compile source code and return its kernels of these names.

        Raises:
            pyopencl.Error: the driver rejects the source code.
        """
        started = time.thread_time()
        program = build(self._context.context, source, flushes_denormals)
        ready = None
        if self._in_background and time.thread_time() - started > _COLD:
            ready = self._begin(source, names, flushes_denormals)
        return [Kernel(program, name, ready) for name in names]

    def _begin(self, source: str, names: Sequence[str], flushes_denormals: bool) -> cl.Event | None:
        """Let a thread generate machine code. Return the event that it sets at the end, or None if no thread can
        start."""
        if self._threads is None:
            count = min(os.cpu_count() or 1, _MOST_THREADS)
            self._threads = ThreadPoolExecutor(count, "rhi kernels")
        ready = cl.UserEvent(self._context.context)
        self._count(len(names), 0)
        try:
            self._threads.submit(self._generate, source, names, flushes_denormals, ready)
        except RuntimeError:  # no more threads, or Python is shutting down
            self._count(0, len(names))
            return None
        return ready

    def _generate(
        self, source: str, names: Sequence[str], flushes_denormals: bool, ready: cl.UserEvent
    ) -> None:
        """Generate machine code in a thread. Errors are dropped, since the device will get them as well."""
        try:
            if not hasattr(self._local, "queue"):
                self._local.queue = cl.CommandQueue(cl.Context([self._context.device]))
            queue: cl.CommandQueue = self._local.queue
            program = build_again(queue.context, source, flushes_denormals)
            for name in names:
                empty = _EmptyBatch()
                kernel = cl.Kernel(program, name)
                kernel.set_arg(0, np.uint64(empty.address))
                cl.enqueue_nd_range_kernel(queue, kernel, (1,), (1,)).wait()
        finally:
            try:
                self._count(0, len(names))
            finally:
                ready.set_status(cl.command_execution_status.COMPLETE)

    def _count(self, begun: int, done: int) -> None:
        with self._lock:
            self._begun += begun
            self._done += done
            LOGGER.info("building kernels, %d of %d", self._done, self._begun)


class _EmptyBatch:
    """A batch table without draws in host memory, which PoCL's kernels read in place. All that kernels read through it
    is 0.

    Attributes:
        address: the table's address.
    """

    def __init__(self) -> None:
        self._memory = allocate_pages(PAGE + _EMPTY_PAGES * PAGE)  # the table, then zeros
        self.address: int = self._memory.ctypes.data
        table = self._memory[: BATCH_STRUCT.itemsize].view(BATCH_STRUCT)
        for name in BATCH_STRUCT.names or ():
            if BATCH_STRUCT[name].base == np.uint64:
                table[name] = self.address + PAGE
        table["tiles"] = table["tiles_x"] = table["bounded"] = 1
