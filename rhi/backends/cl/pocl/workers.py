"""Pins each of PoCL's worker threads to a CPU of its own.

- After a pause, Linux tends to wake all workers on the CPU that wakes them and takes some milliseconds to
  move them apart. A frame that follows a pause, as most do, then takes twice as long. With one thread per CPU
  nothing is gained by moving threads, so each is pinned. In return, a wait for little work ends about 20 µs
  later.
- PoCL pins its threads itself if `POCL_AFFINITY` is set, but to CPUs counted from 0, and it ends the process
  if it may not use those.
"""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Set
from contextlib import suppress
from pathlib import Path
from typing import Final

_VARIABLE: Final = "POCL_AFFINITY"
_TASKS: Final = Path("/proc/self/task")


def list_threads() -> frozenset[int]:
    """Return the ids of the process's threads; empty on systems that don't list them."""
    try:
        return frozenset(int(task.name) for task in _TASKS.iterdir())
    except OSError:
        return frozenset()


def list_python_threads() -> frozenset[int]:
    """Return the ids of the threads that Python knows, which are never a driver's."""
    return frozenset(thread.native_id or 0 for thread in threading.enumerate())


def spread_threads(threads: Set[int]) -> None:
    """Pin each thread to a CPU of its own if there are enough CPUs, unless the user has set
    `POCL_AFFINITY`."""
    if sys.platform != "linux" or _VARIABLE in os.environ:
        return
    cpus = sorted(os.sched_getaffinity(0))
    if 1 < len(threads) <= len(cpus):
        for thread, cpu in zip(sorted(threads), cpus, strict=False):
            with suppress(OSError):  # the thread has ended
                os.sched_setaffinity(thread, {cpu})
