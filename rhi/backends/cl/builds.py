"""Builds of kernels: quickly at first, optimised later by other processes.

- An optimised kernel takes PoCL up to ten times as long as one that isn't, and draws 1.2 to 2.5 times as
  fast. So a kernel is at first compiled without optimisation, unless the optimised one is in the cache on
  disk. When its launches have taken `HOT` seconds, it is optimised in the background and replaced by the
  result. Both compute the same bits.
- The kernel that has taken most time is optimised first.
- PoCL compiles one kernel at a time per process, and no kernel can be launched while it generates machine
  code. So other processes optimise kernels into the cache (`compiler.py`), from which a thread takes them.
- `Optimisation.begin` begins the optimisation earlier, even before the kernel exists.
- `RHI_KERNELS=quick` keeps the first kernels, `RHI_KERNELS=optimised` builds optimised ones at once. Drivers
  whose cache isn't a folder (`rhi.backends.cl.pocl.kernel_cache`) always do the latter.
- The logger `rhi.kernels` reports at level INFO how many kernels are built. Cached kernels aren't reported. A wait
  of the calling thread for more than a second is shown (`build_progress.py`).
"""

from __future__ import annotations

import os
import threading
from collections.abc import Sequence
from concurrent.futures import Future
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeAlias

import numpy as np
import pyopencl as cl

from rhi.backends.cl.build_progress import LOGGER, BuildProgress
from rhi.backends.cl.cl_context import (
    FLUSHES_DENORMALS,
    KERNELS_ENVIRONMENT,
    QUICK,
    ClContext,
    build_again,
    build_cached,
)
from rhi.backends.cl.pocl.kernel_cache import CachedProgram, Request, make_mark

if TYPE_CHECKING:
    from rhi.backends.cl.pocl.compiler import Compiler
    from rhi.backends.cl.pocl.program_residency import EvictableProgram

HOT: Final = 0.02
"""Seconds of a kernel's launches after which it is optimised: one frame that is slow, or many that aren't."""
_MAX_COMPILERS: Final = 4
_ARGUMENTS: Final = (np.uint64,)
"""The types of the arguments of kernels that draw: the address of a batch table."""


Arguments: TypeAlias = tuple[int | bytes | tuple[bytes, tuple[int, ...]], ...]


class Launch(NamedTuple):
    """Launches of a program's kernels, which make another process generate their machine code.

    Attributes:
        names: the kernels.
        arguments: the arguments of each kernel. An `int` is an integer of 32 bits; bytes are memory that
            begins with them and goes on with zeros; bytes with offsets are the address of such memory, with
            addresses of zeros at these offsets.
    """

    names: tuple[str, ...]
    arguments: Arguments


class Optimisation:
    """A build of optimised kernels.

    Attributes:
        request: their source code.
        launch: their first launch.
        program: None until they are built.
        done: the end of the build, with or without success; None until it begins.
        heat: seconds that launches of the kernels to be replaced have taken.
    """

    __slots__ = ("_builds", "done", "heat", "launch", "program", "request")

    def __init__(self, request: Request, launch: Launch, builds: Builds) -> None:
        self.request = request
        self.launch = launch
        self.program: EvictableProgram | None = None
        self.done: Future[None] | None = None
        self._builds = builds
        self.heat = 0.0

    @property
    def progress(self) -> BuildProgress:
        """The line that says how long the calling thread waits for builds."""
        return self._builds.progress

    def warm(self, items: int, seconds: float) -> None:
        """Add the work-items and the seconds of a launch of the kernels to be replaced; begin when they are
        hot."""
        self._builds.quick_work += items
        self.heat += seconds
        if self.heat >= HOT and self.done is None:
            self.begin()

    def begin(self) -> Future[None]:
        """Begin the build, unless it has begun."""
        if self.done is None:
            self.done = self._builds.begin(self)
        return self.done


class Kernel:
    """A kernel, which is replaced as soon as it has been optimised."""

    __slots__ = ("_is_launched", "_items", "_name", "_optimisation", "_timed", "program")

    def __init__(
        self, program: EvictableProgram, name: str, optimisation: Optimisation | None = None
    ) -> None:
        """`optimisation`: the build that is going to replace the kernel, or None."""
        self._name = name
        self._optimisation = optimisation
        self._timed: tuple[cl.Event, int] | None = None  # a launch, and its work-items
        self._items = 0  # of all launches since then
        self._is_launched = False
        self._take(program)

    def _take(self, program: EvictableProgram) -> None:
        self.program = program

    @property
    def is_quick(self) -> bool:
        """True if the kernel isn't optimised."""
        return self._optimisation is not None

    def optimise(self) -> Future[None] | None:
        """Begin to optimise the kernel; return a future of the end, or None if there is nothing to do."""
        return None if self._optimisation is None else self._optimisation.begin()

    def get(self, items: int) -> cl.Kernel:
        """Return the kernel, of which `items` work-items are going to be launched."""
        self._renew(items)
        return self.program.find(self._name)

    def _renew(self, items: int) -> None:
        optimisation = self._optimisation
        if optimisation is not None:
            if optimisation.program is not None:
                self._take(optimisation.program)
                self._optimisation = self._timed = None
            else:
                optimisation.warm(items, self._take_time())

    def watch(self, event: cl.Event, items: int) -> cl.Event:
        """Note, and return, the event of that launch."""
        if self._optimisation is not None:
            if not self._is_launched:
                self._is_launched = True
                self._optimisation.progress.note_launch(self._name, event)
            self._timed, self._items = self._timed or (event, items), self._items + items
        return event

    def launch(self, queue: cl.CommandQueue, batch: int, items: int) -> cl.Event:
        """Enqueue `items` work-items of a kernel that draws, whose only argument is the address of a batch
        table."""
        self._renew(items)
        kernel = self.program.prepare(self._name, items)
        kernel.set_args(batch)  # with the argument's type set, 20 times as fast as `set_arg`
        return self.watch(cl.enqueue_nd_range_kernel(queue, kernel, (items,), (1,)), items)

    def _take_time(self) -> float:
        """Return the seconds of the launches so far, once the first of them has ended.

        The others are assumed to take the same time per work-item. The next launch is then timed."""
        if self._timed is None:
            return 0.0
        event, items = self._timed
        status: Any = event.get_info(cl.event_info.COMMAND_EXECUTION_STATUS)
        if status > 0:  # it hasn't ended
            return 0.0
        share, self._timed, self._items = self._items / items, None, 0
        return 0.0 if status else 1e-9 * (event.profile.end - event.profile.start) * share


class Builds:
    """Builds the kernels of one device.

    Attributes:
        built: number of programs compiled in the calling thread, those from the cache not counted.
        progress: shows how long the calling thread waits for builds.
        quick_work: number of work-items launched of kernels that aren't optimised.
    """

    def __init__(self, context: ClContext, optimises: bool | None = None) -> None:
        """`optimises`: whether other processes optimise kernels; None: as `RHI_KERNELS` says."""
        self._context = context
        self._cache = context.cache
        mode = os.environ.get(KERNELS_ENVIRONMENT, "")
        self.is_quick = context.cache.works and context.shares_memory and mode != "optimised"
        self._optimises = mode != "quick" if optimises is None else optimises
        self._jobs: list[tuple[Optimisation, Future[None]]] = []
        self._compilers: list[Compiler] = []
        self._threads: list[threading.Thread] = []
        self._lock = threading.Lock()
        self._changed = threading.Condition(self._lock)  # there is a job, or the device is closed
        self._begun = self._done = 0
        self.progress = BuildProgress(lambda: (self._done, self._begun), context.waited)
        self._waiting = 0
        self._closed = False
        self.built = self.quick_work = 0

    @property
    def is_building(self) -> bool:
        """True if kernels are being optimised."""
        return self._waiting > 0

    def request(self, source: str, names: Sequence[str], flushes_denormals: bool = False) -> Request:
        """Return the request for kernels.

        Args:
            names: the kernels that draw. A compute program has none, since its kernel takes other arguments.
            flushes_denormals: whether numbers below 2^-126 count as 0 in them.
        """
        return self._cache.request(source, [FLUSHES_DENORMALS] if flushes_denormals else [], names)

    def build(self, request: Request, launch: Launch) -> list[Kernel]:
        """Build the kernels of a request; they are optimised later unless they are in the cache.

        Raises:
            pyopencl.Error: the driver rejects the source code.
        """
        is_quick = self.is_quick and not self.is_cached(request, launch)
        optimisation = Optimisation(request, launch, self) if is_quick else None
        program = self.compile(request, is_quick)
        return [Kernel(program, name, optimisation) for name in request.kernels]

    def is_cached(self, request: Request, launch: Launch) -> bool:
        """Return whether optimised machine code of the kernels is in the cache."""
        return self._cache.contains(request.key, launch.names)

    def is_stored(self, request: Request) -> bool:
        """Return whether machine code of the kernels that isn't optimised is in the cache."""
        return self._cache.contains(self._quick(request).key, request.kernels)

    def _quick(self, request: Request) -> Request:
        """Return the request for kernels that aren't optimised."""
        return self._cache.request(request.source, (*request.options, *QUICK), request.kernels)

    def compile(self, request: Request, quick: bool = False) -> EvictableProgram:
        """Compile source code, or take it from the cache.

        Raises:
            pyopencl.Error: the driver rejects it.
        """
        if quick:
            request = self._quick(request)
        stored = self._cache.find(request.key)
        if stored is not None:
            return self._build(request, stored)
        count = len(request.kernels)
        self.built += 1
        self._count(count, 0)
        try:
            with self.progress.waiting(", ".join(request.kernels) or "a program"):
                return self._build(request, None)
        finally:
            self._count(0, count)

    def _build(self, request: Request, stored: CachedProgram | None) -> EvictableProgram:
        """Build a program, or load the one that is stored."""
        program = build_cached(self._context.context, self._cache, request, stored)
        return self._make_evictable(program, request)

    def _make_evictable(self, program: cl.Program, request: Request) -> EvictableProgram:
        return self._context.make_evictable(program, request, _ARGUMENTS if request.kernels else None)

    def close(self) -> None:
        """End the other processes and their builds."""
        self.progress.close()
        with self._lock:
            self._closed = True
            for compiler in self._compilers:
                compiler.stop()
            self._changed.notify_all()
        for thread in self._threads:
            thread.join()
        for compiler in self._compilers:
            compiler.close()
        self._cache.finish()

    # -- in the background -----------------------------------------------------------------------------------

    def begin(self, optimisation: Optimisation) -> Future[None]:
        """Queue an optimisation for another process. Its future never has an error: if it fails, the quick
        kernels stay."""
        done: Future[None] = Future()
        if not self._optimises:
            done.set_result(None)
            return done
        self._count(len(optimisation.launch.names), 0)
        with self._lock:
            self._waiting += 1
            if self._waiting > len(self._threads) < min(os.cpu_count() or 1, _MAX_COMPILERS):
                thread = threading.Thread(target=self._work, name="rhi kernels", daemon=True)
                try:
                    thread.start()
                    self._threads.append(thread)
                except RuntimeError:  # no more threads, or Python is shutting down
                    pass
            alone = not self._threads
            if not alone:
                self._jobs.append((optimisation, done))
                self._changed.notify()
        if alone:
            done.set_result(None)
        return done

    def _wait_for_job(self) -> tuple[Optimisation, Future[None]] | None:
        """Return the job whose kernels have taken most time, as soon as there is one; None when the device is
        closed and there is none left."""
        with self._changed:
            while not self._jobs and not self._closed:
                self._changed.wait()
            if not self._jobs:
                return None
            hottest = max(range(len(self._jobs)), key=lambda index: self._jobs[index][0].heat)
            return self._jobs.pop(hottest)

    def _work(self) -> None:
        """Optimise kernels until the device is closed."""
        compiler: Compiler | None = None
        while (job := self._wait_for_job()) is not None:
            optimisation, done = job
            try:
                if compiler is None:
                    compiler = self._open_compiler()
                if compiler is not None and not self._closed:
                    self._optimise(compiler, optimisation)
            except (OSError, EOFError):
                compiler = None  # it ended; the kernels at hand remain
            except (ValueError, MemoryError, cl.Error):
                pass  # they remain, too
            finally:
                with self._lock:
                    self._waiting -= 1
                self._count(0, len(optimisation.launch.names))
                done.set_result(None)

    def _open_compiler(self) -> Compiler | None:
        from rhi.backends.cl.pocl.compiler import Compiler  # which most programs never need

        with self._lock:
            if self._closed:  # what is left of the queue is dropped
                return None
            compiler = Compiler(self._context.device)
            self._compilers.append(compiler)
            return compiler

    def _optimise(self, compiler: Compiler, optimisation: Optimisation) -> None:
        """Compile kernels into the cache in the other process, and load them."""
        from rhi.backends.cl.pocl.compiler import Job

        request = optimisation.request
        launch = optimisation.launch
        cache = self._cache
        lock = cache.lock_path(request.key)
        cache.hold(request.key)  # the other process writes there, too
        if not cache.contains(request.key, launch.names):
            if cache.takes_code and cache.read_code(request.key) is None:
                mark = make_mark()
                compiler.compile(Job(*request.write(mark), (), (), lock))
                with cache.writing(request.key) as is_safe:
                    if is_safe:
                        cache.store_code(request.key, mark)
            compiler.compile(Job(*cache.choose(request), *launch, lock))
            with cache.writing(request.key) as is_safe:
                if is_safe:
                    cache.record(request.key)
        if cache.contains(request.key, launch.names):
            code, options = cache.choose(request)
            program = build_again(self._context.context, cache.make_binary(request) or code, options)
            optimisation.program = self._make_evictable(program, request)

    def _count(self, started: int, done: int) -> None:
        if not started and not done:
            return
        with self._lock:
            self._begun += started
            self._done += done
            LOGGER.info("building kernels, %d of %d", self._done, self._begun)
