"""Loads OpenCL's drivers in a thread, while Python imports the modules of the backend.

- The first question for platforms loads and starts the drivers: PoCL with LLVM takes 20 ms. pyopencl asks it with
  Python's lock held, so the same library is asked through ctypes, which releases it. Each takes as long as the other.
- Nothing depends on the answer: pyopencl asks again, and what it is told then counts. Where the library can't be found,
  pyopencl loads the drivers as it always would.
"""

from __future__ import annotations

import ctypes
import threading
from contextlib import suppress

from rhi.backends.cl.pocl.workers import list_threads


class Loading:
    """Drivers that are being loaded. The process's threads are listed before, because drivers start some."""

    def __init__(self, library: str) -> None:
        """`library`: the path of a library that OpenCL's loader is linked to."""
        self._threads = list_threads()
        self._thread = threading.Thread(target=_load, args=(library,), name="rhi drivers", daemon=True)
        try:
            self._thread.start()
        except RuntimeError:  # no more threads
            _load(library)

    def finish(self) -> frozenset[int]:
        """Wait until they are loaded. Return the threads that aren't the drivers'."""
        if self._thread.ident is None:
            return self._threads
        self._thread.join()
        return self._threads | {self._thread.native_id or 0}


def _load(library: str) -> None:
    count = ctypes.c_uint()
    with suppress(OSError, AttributeError):
        ctypes.CDLL(library).clGetPlatformIDs(0, None, ctypes.byref(count))
