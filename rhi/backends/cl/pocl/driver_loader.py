"""Loads OpenCL's drivers in a thread, while Python imports the modules of the backend.

- The first question for platforms loads and starts the drivers: PoCL with LLVM takes 20 ms. pyopencl asks it
  with Python's lock held, so the same library is asked through ctypes, which releases it. Each takes as long
  as the other.
- Nothing depends on the result: pyopencl asks again. Where the library can't be found,
  pyopencl loads the drivers as it always would.
"""

from __future__ import annotations

import ctypes
import threading
from contextlib import suppress

from rhi.backends.cl.pocl.workers import list_threads


class DriverLoader:
    """A thread that loads the drivers. Lists the process's threads first, because drivers start some."""

    def __init__(self, library: str) -> None:
        """`library`: the path of a library that OpenCL's loader is linked to."""
        self._threads = list_threads()
        self._thread = threading.Thread(target=_load, args=(library,), name="rhi drivers", daemon=True)
        try:
            self._thread.start()
        except RuntimeError:  # no more threads
            _load(library)

    def finish(self) -> frozenset[int]:
        """Wait until the drivers are loaded. Return the ids of the threads that the drivers didn't start."""
        if self._thread.ident is None:
            return self._threads
        self._thread.join()
        return self._threads | {self._thread.native_id or 0}


def _load(library: str) -> None:
    count = ctypes.c_uint()
    with suppress(OSError, AttributeError):
        ctypes.CDLL(library).clGetPlatformIDs(0, None, ctypes.byref(count))
