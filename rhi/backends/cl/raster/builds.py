"""Machine code for the kernels that draw, made while draws go on gathering.

- A text is compiled at once, so that the call that needs it is told what a driver refuses. PoCL goes on to machine code
  only at a kernel's first launch: two thirds of the time, and one kernel at a time in a context.
- So where a text wasn't on disk yet, a thread with a context of its own launches its kernels with a batch that holds
  nothing. That leaves the machine code on disk, where the device finds it. Several threads do several kernels at once.
- Nobody waits but the device: launches stand in its queue behind a user event, which is set however the thread's work
  ends. If it failed, the device makes the machine code itself, and says why it can't.
- The logger `rhi.kernels` is told, at INFO, how many kernels of a first run are done. From the disk nothing is said.
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
from rhi.backends.cl.raster.tables import BATCH

__rhi_internal__ = True

LOGGER: Final = logging.getLogger("rhi.kernels")
_POCL: Final = "Portable Computing Language"
_COLD: Final = 0.06  # seconds of processor time: a text takes 0.15 and more, 0.03 if it is on disk
_MOST_THREADS: Final = 4
_NOTHING_PAGES: Final = 16  # more than kernels read of what an address in an empty batch leads to


class Kernel:
    """A kernel of a draw. It takes one argument, the address of a batch."""

    __slots__ = ("_kernel", "_ready")

    def __init__(self, program: cl.Program, name: str, ready: cl.Event | None) -> None:
        """`ready`: what launches wait for."""
        self._kernel = cl.Kernel(program, name)
        self._kernel.set_scalar_arg_dtypes([np.uint64])
        self._ready = ready

    def launch(self, queue: cl.CommandQueue, batch: int, items: int) -> cl.Event:
        """Enqueue `items` work-items on the batch at this address."""
        self._kernel.set_args(batch)  # knowing its type it is 20 times as fast as `set_arg`
        wait_for = None if self._ready is None else [self._ready]
        event: cl.Event = cl.enqueue_nd_range_kernel(queue, self._kernel, (items,), (1,), wait_for=wait_for)
        self._ready = None  # the queue is in order: what follows comes behind this launch
        return event


class Builds:
    """What builds a device's kernels."""

    def __init__(self, context: ClContext) -> None:
        self._context = context
        self._threads: ThreadPoolExecutor | None = None
        self._local = threading.local()
        self._lock = threading.Lock()
        self._begun = self._done = 0
        keeps = context.device.platform.name == _POCL and os.environ.get("POCL_KERNEL_CACHE", "1") != "0"
        self._in_background = keeps

    def build(self, source: str, names: Sequence[str], flushes_denormals: bool = False) -> list[Kernel]:
        """The kernels of these names.

        Raises:
            pyopencl.Error: the driver refuses the text.
        """
        started = time.thread_time()
        program = build(self._context.context, source, flushes_denormals)
        ready = None
        if self._in_background and time.thread_time() - started > _COLD:
            ready = self._begin(source, names, flushes_denormals)
        return [Kernel(program, name, ready) for name in names]

    def _begin(self, source: str, names: Sequence[str], flushes_denormals: bool) -> cl.Event | None:
        """Let a thread make machine code; the event is set when it is done. None: there can't be a thread."""
        if self._threads is None:
            count = min(os.cpu_count() or 1, _MOST_THREADS)
            self._threads = ThreadPoolExecutor(count, "rhi kernels")
        ready = cl.UserEvent(self._context.context)
        self._count(len(names), 0)
        try:
            self._threads.submit(self._generate, source, names, flushes_denormals, ready)
        except RuntimeError:  # out of threads, or Python is about to end
            self._count(0, len(names))
            return None
        return ready

    def _generate(
        self, source: str, names: Sequence[str], flushes_denormals: bool, ready: cl.UserEvent
    ) -> None:
        """In a thread; its errors are dropped, since the device will meet them, too."""
        try:
            if not hasattr(self._local, "queue"):
                self._local.queue = cl.CommandQueue(cl.Context([self._context.device]))
            queue: cl.CommandQueue = self._local.queue
            program = build_again(queue.context, source, flushes_denormals)
            for name in names:
                nothing = _Nothing()
                kernel = cl.Kernel(program, name)
                kernel.set_arg(0, np.uint64(nothing.address))
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


class _Nothing:
    """A batch of no draws in host memory, which PoCL's kernels read in place; whatever its kernels read is 0.

    Attributes:
        address: where it lies.
    """

    def __init__(self) -> None:
        self._memory = allocate_pages(PAGE + _NOTHING_PAGES * PAGE)  # the batch, and zeros
        self.address: int = self._memory.ctypes.data
        table = self._memory[: BATCH.itemsize].view(BATCH)
        for name in BATCH.names or ():
            if BATCH[name].base == np.uint64:
                table[name] = self.address + PAGE
        table["tiles"] = table["tiles_x"] = table["bounded"] = 1
