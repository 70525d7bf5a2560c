"""Keeping PoCL's worker threads on CPUs of their own.

After a pause Linux likes to wake all of them on the CPU that wakes them, and takes some milliseconds to move them
apart: a frame that follows a pause, as most do, then takes twice as long. A thread for each CPU has nothing to gain
from moving, so each stays on one. A wait for a little work wakes up some 20 µs later.

PoCL does that by itself where `POCL_AFFINITY` asks for it, but for CPUs counted from 0, and ends the process where it
may not use them.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Set
from contextlib import suppress
from pathlib import Path
from typing import Final

__rhi_internal__ = True

_VARIABLE: Final = "POCL_AFFINITY"
_TASKS: Final = Path("/proc/self/task")


def list_threads() -> frozenset[int]:
    """The process's threads, where that can be known."""
    try:
        return frozenset(int(task.name) for task in _TASKS.iterdir())
    except OSError:
        return frozenset()


def spread_threads(threads: Set[int]) -> None:
    """Keep each on a CPU of its own, if there are as many CPUs, and the user hasn't said otherwise."""
    if sys.platform != "linux" or _VARIABLE in os.environ:
        return
    cpus = sorted(os.sched_getaffinity(0))
    if 1 < len(threads) <= len(cpus):
        for thread, cpu in zip(sorted(threads), cpus, strict=False):
            with suppress(OSError):  # it has ended
                os.sched_setaffinity(thread, {cpu})
