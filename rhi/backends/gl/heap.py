"""Keeping the C heap's freed memory, for Mesa's software rasteriser.

llvmpipe stores 18 kB per draw whose uniforms changed (all of its state, copied) and frees it when the scene is
done. glibc hands freed memory at the end of its heap back to the system from 128 kB on, and each draw then
pays four page faults to get it again: 11 µs a draw instead of 1.8 (`docs/backends-gl.md`).
"""

from __future__ import annotations

import ctypes
import os
from typing import Final

__rhi_internal__ = True

# mallopt's parameter, and bytes. A scene is at most 36 MiB; setting the first threshold stops glibc from
# adjusting the second, so it gets the value where the adjustment ends.
_TRIM_THRESHOLD: Final = (-1, 64 << 20)
_MMAP_THRESHOLD: Final = (-3, 32 << 20)
_VARIABLES: Final = ("MALLOC_TRIM_THRESHOLD_", "MALLOC_MMAP_THRESHOLD_", "GLIBC_TUNABLES")


def keep_freed_memory() -> None:
    """Let glibc keep up to 64 MiB of freed memory in this process.

    Nothing is done without glibc, or if the user has set its thresholds through the environment.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is None or any(variable in os.environ for variable in _VARIABLES):
        return
    for parameter, value in (_TRIM_THRESHOLD, _MMAP_THRESHOLD):
        mallopt(parameter, value)
