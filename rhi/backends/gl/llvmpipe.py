"""Workarounds for Mesa's software rasteriser, llvmpipe.

- **Freed memory stays in the C heap.** For each draw whose uniforms changed, llvmpipe stores 18 kB (a copy of
  all its state), and frees them when the scene is done. Above a threshold of 128 kB, glibc returns freed
  memory at the end of its heap to the system. Each draw then costs four page faults to get it back: 11 µs a
  draw instead of 1.8.
- **Draws are finished before llvmpipe itself reads textures.** It draws on threads of its own. Everything but
  fragments runs elsewhere, at once: reads and copies of textures, work-groups, vertex stages. Before these,
  llvmpipe asks whether a texture is in use by a pass that isn't finished. It takes the first pass that uses
  it: if that one samples the texture, and a later one draws it, the draw isn't waited for, and the old texels
  are read (Mesa 22.3). So the backend waits for all draws there. Other drivers keep the order that GL asks
  for, so nothing is waited for.
"""

from __future__ import annotations

import ctypes
import os
from typing import Final

from rhi.backends.gl.entry_points import EntryPoints

# mallopt's parameter, and bytes. A scene is at most 36 MiB. Setting the first threshold stops glibc from
# adjusting the second, so the second is set to the value at which the adjustment ends.
_TRIM_THRESHOLD: Final = (-1, 64 << 20)
_MMAP_THRESHOLD: Final = (-3, 32 << 20)
_VARIABLES: Final = ("MALLOC_TRIM_THRESHOLD_", "MALLOC_MMAP_THRESHOLD_", "GLIBC_TUNABLES")


def keep_freed_memory() -> None:
    """Make glibc keep up to 64 MiB of freed memory in this process.

    Does nothing without glibc, or if the user has set the thresholds through the environment.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is None or any(variable in os.environ for variable in _VARIABLES):
        return
    for parameter, value in (_TRIM_THRESHOLD, _MMAP_THRESHOLD):
        mallopt(parameter, value)


class UnfinishedDraws:
    """A flag for passes, resolves or mip levels that were drawn since all draws were last waited for."""

    __slots__ = ("_draws", "_gl", "_keeps_order")

    def __init__(self, gl: EntryPoints, keeps_order: bool) -> None:
        """`keeps_order`: whether the driver itself waits for draws to a texture before it reads it."""
        self._gl = gl
        self._keeps_order = keeps_order
        self._draws = False

    def add(self) -> None:
        """Note that textures have been drawn."""
        self._draws = not self._keeps_order

    def finish(self) -> None:
        """Wait for all draws to textures, if the driver doesn't do so itself."""
        if self._draws:
            self._gl.Finish()
            self._draws = False
