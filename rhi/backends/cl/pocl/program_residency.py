"""Programs in memory: those that weren't used for long are released, and built again when needed.

PoCL keeps the LLVM code of a program from its build until it is released, about 2 MB of it, although machine
code is all that a launch needs. A program that goes through all techniques of a renderer has some 200. So
beyond `LIMIT` of them, those that weren't launched for `AGE` values of the fence are released. The next
launch builds them again, of what the cache on disk has: 10 ms. What a frame draws with is never released,
however much that is.

The C library keeps what is freed between other blocks. So where it can hand that back (glibc), it is told to:
3 to 15 ms, in a frame that releases programs.
"""

from __future__ import annotations

import ctypes
import threading
import weakref
import zlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from operator import attrgetter
from typing import Any, Final

import pyopencl as cl

from rhi.backends.cl.pocl.binaries import LARGE_GRID
from rhi.backends.cl.pocl.kernel_cache import Request
from rhi.backends.cl.pocl.memory_maps import COUNTER

LIMIT: Final = 32
"""Number of programs in memory up to which none is released."""
AGE: Final = 128
"""Values of the fence, some two seconds of frames, after which a program may be released."""
_OFTEN: Final = 16
"""Values of the fence between two searches for programs to release."""
_REMEMBERED: Final = 96
"""Kernels of which PoCL surely remembers the machine code: its table, one for the process, has 128 places."""
_PACKING: Final = 1  # a source of 80 kB becomes 12 in half a millisecond


class EvictableProgram:
    """A program, which may be released between two launches.

    Attributes:
        builds: how often it was built; kernels of an earlier build have lost their arguments.
    """

    __slots__ = (
        "__weakref__",
        "_build",
        "_has_code",
        "_is_whole",
        "_kernels",
        "_most_items",
        "_owner",
        "_program",
        "_types",
        "builds",
        "last_used",
    )

    def __init__(
        self,
        owner: ProgramResidency,
        program: cl.Program,
        build: Callable[[bool], cl.Program],
        types: Sequence[type] | None,
        has_code: Callable[[str], bool] = lambda name: True,
    ) -> None:
        """
        Args:
            build: builds the program again, with LLVM code if its argument is True.
            types: the types of each kernel's arguments, if they are scalars.
            has_code: whether the driver finds machine code of a kernel, or needs none.
        """
        self._is_whole = False
        self._has_code = has_code
        self._most_items: dict[str, int] = {}  # of a launch of each kernel
        self._owner = owner
        self._program: cl.Program | None = program
        self._build = build
        self._types = types
        self._kernels: dict[str, cl.Kernel] = {}
        self.builds = 1
        self.last_used = owner.now

    @property
    def is_resident(self) -> bool:
        """True if the program is in memory."""
        return self._program is not None

    def list_names(self) -> list[str]:
        """Return the names of the kernels, of a program that was just built."""
        assert self._program is not None
        names: Any = self._program.get_info(cl.program_info.KERNEL_NAMES)
        return [name for name in str(names).split(";") if name]

    def find(self, name: str) -> cl.Kernel:
        """Return a kernel for a launch, and build the program first if it was released.

        Raises:
            pyopencl.Error: there is none of this name, or the program can't be built again.
        """
        self.last_used = self._owner.now
        kernel = self._kernels.get(name)
        return kernel if kernel is not None else self._make(name)

    def prepare(self, name: str, items: int) -> cl.Kernel:
        """Return a kernel for a launch of `items` work-items, as `find` does.

        PoCL looks for machine code on disk if a launch has more items than all before. Without that, it would
        end the process; so the program is built with its LLVM code first.
        """
        if not self._is_whole and (items > self._most_items.get(name, -1) or self._owner.is_crowded):
            if items >= LARGE_GRID or not self._has_code(name):
                self.complete()
            if name not in self._kernels:
                self._make(name)  # which may build it again, and then forgets the number
            self._most_items[name] = max(items, self._most_items.get(name, 0))
        self.last_used = self._owner.now
        return self._kernels.get(name) or self._make(name)

    def _make(self, name: str) -> cl.Kernel:
        if self._program is None:
            self._program = self._build(self._is_whole)
            self.builds += 1
        COUNTER.note_kernel()
        try:
            kernel = cl.Kernel(self._program, name)
        except cl.Error:  # there is no machine code of it
            if self._is_whole:
                raise
            self.complete()
            return self._make(name)
        if self._types is not None:
            kernel.set_scalar_arg_dtypes(list(self._types))
        self._kernels[name] = kernel
        return kernel

    def complete(self) -> None:
        """Build the program with its LLVM code, for launches without machine code
        (`rhi.backends.cl.pocl.binaries`)."""
        if not self._is_whole:
            self._is_whole = True
            self.release()

    def release(self) -> None:
        """Release the program's memory. Enqueued launches keep what they need."""
        self._kernels.clear()
        self._most_items.clear()
        self._program = None


class ProgramResidency:
    """The programs of a device, and which of them stay in memory.

    Attributes:
        now: the latest value of the fence.
    """

    def __init__(self, releases: bool) -> None:
        """`releases`: whether programs are found again on disk, so that they can be released."""
        self._releases = releases
        self._programs: weakref.WeakSet[EvictableProgram] = weakref.WeakSet()
        self._lock = threading.Lock()  # programs are optimised in other threads
        self.now = 0

    @property
    def is_crowded(self) -> bool:
        """True if the driver may look for machine code at any launch: it remembers that of so many kernels,
        whichever device they are of."""
        return COUNTER.kernels > _REMEMBERED

    def list_resident(self) -> list[EvictableProgram]:
        """Return the programs that are in memory."""
        with self._lock:
            return [program for program in self._programs if program.is_resident]

    def add(
        self,
        program: cl.Program,
        request: Request,
        build: Callable[[Request], cl.Program],
        types: Sequence[type] | None = None,
        has_code: Callable[[str], bool] = lambda name: True,
    ) -> EvictableProgram:
        """Add a program that was built, and that `build` builds again.

        Args:
            types, has_code: see `EvictableProgram`.
        """
        packed = zlib.compress(request.source.encode(), _PACKING)
        rest = replace(request, source="")

        def build_again(whole: bool) -> cl.Program:
            kernels = () if whole else rest.kernels
            return build(replace(rest, source=zlib.decompress(packed).decode(), kernels=kernels))

        evictable = EvictableProgram(self, program, build_again, types, has_code)
        with self._lock:
            self._programs.add(evictable)
        return evictable

    def reach(self, value: int) -> None:
        """Note the fence's new value, and now and then release programs that weren't used for long."""
        self.now = value
        if self._releases and value % _OFTEN == 0:
            resident = self.list_resident()
            old = [evictable for evictable in resident if evictable.last_used <= value - AGE]
            released = sorted(old, key=attrgetter("last_used"))[: max(len(resident) - LIMIT, 0)]
            for evictable in released:
                evictable.release()
            if released:
                trim_heap()


def trim_heap() -> None:
    """Return freed memory to the system, where the C library can."""
    if _MALLOC_TRIM is not None:
        _MALLOC_TRIM(0)


def _load_malloc_trim() -> Callable[[int], int] | None:
    try:
        trim: Callable[[int], int] = ctypes.CDLL(None).malloc_trim
    except (OSError, AttributeError, TypeError):  # another C library, or another system
        return None
    return trim


_MALLOC_TRIM: Final = _load_malloc_trim()
