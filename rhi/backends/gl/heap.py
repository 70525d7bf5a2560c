"""Keeps freed memory in the C heap, for Mesa's software rasteriser.

For each draw whose uniforms changed, llvmpipe stores 18 kB (a copy of all its state), and frees them when the scene
is done. Above a threshold of 128 kB, glibc returns freed memory at the end of its heap to the system. Each draw then
costs four page faults to get it back: 11 µs a draw instead of 1.8 (`docs/backends-gl.md`).
"""

from __future__ import annotations

import ctypes
import os
from typing import Final

__rhi_internal__ = True

# mallopt's parameter, and bytes. A scene is at most 36 MiB. Setting the first threshold stops glibc from adjusting
# the second, so the second is set to the value at which the adjustment ends.
_TRIM_THRESHOLD: Final = (-1, 64 << 20)
_MMAP_THRESHOLD: Final = (-3, 32 << 20)
_VARIABLES: Final = ("MALLOC_TRIM_THRESHOLD_", "MALLOC_MMAP_THRESHOLD_", "GLIBC_TUNABLES")


def keep_freed_memory() -> None:
    """Let glibc keep up to 64 MiB of freed memory in this process.

    Does nothing without glibc, or if the user has set the thresholds through the environment.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is None or any(variable in os.environ for variable in _VARIABLES):
        return
    for parameter, value in (_TRIM_THRESHOLD, _MMAP_THRESHOLD):
        mallopt(parameter, value)
