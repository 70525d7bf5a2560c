"""Counts the process's memory maps, of which each kernel takes some for ever.

PoCL loads the machine code of a kernel as a library, in five maps, and never unloads it. At the system's
limit (Linux: `vm.max_map_count`) the next one can't be loaded, and PoCL ends the process. So maps are counted
now and then, a warning comes at `WARNED` of the limit, and kernels are refused from `REFUSED` on.

Others take maps as well: other backends, libraries, other devices' files. So they are counted again after a
while, too, however few kernels have come.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Final

from rhi.errors import DeviceError
from rhi.errors.rules import DEVICE_MEMORY

WARNED: Final = 0.80
REFUSED: Final = 0.95
_STEP: Final = 256
"""Kernels between two counts, while maps are far from the limit. A count takes a microsecond for each map."""
_NEAR_STEP: Final = 16
_SHARE: Final = 0.02
"""Of the time while kernels are loaded: counts take at most so much."""
_LEAST_SECONDS: Final = 0.05
"""Between two counts, unless that many kernels have come."""
_MAPS: Final = Path("/proc/self/maps")
_LIMIT: Final = Path("/proc/sys/vm/max_map_count")


class MapCounter:
    """Watches the memory maps of this process while kernels are made.

    Attributes:
        kernels: how many have been made.
    """

    def __init__(self, count: Callable[[], int], limit: Callable[[], int]) -> None:
        """`count`, `limit`: return the number of maps and the system's limit; 0 where it isn't known."""
        self._count = count
        self._limit = limit
        self._until_count = 1
        self._due = 0.0  # seconds, of the next count
        self._has_warned = False
        self.kernels = 0

    def note_kernel(self) -> None:
        """Note that a kernel is going to be loaded.

        Raises:
            DeviceError: `device-out-of-memory` if there are too many maps for it.
        """
        self.kernels += 1
        self._until_count -= 1
        now = time.monotonic()
        if self._until_count > 0 and now < self._due:
            return
        count, limit = self._count(), self._limit()
        counted = time.monotonic()
        self._due = counted + max(_LEAST_SECONDS, (counted - now) / _SHARE)
        self._until_count = _STEP
        if not limit or count < WARNED * limit - _STEP * _NEAR_STEP:
            return
        self._until_count = _NEAR_STEP
        if count >= REFUSED * limit:
            self._until_count = 1
            given, allowed = f"{count} memory maps of this process", f"below {int(REFUSED * limit)}"
            raise DeviceError(
                DEVICE_MEMORY,
                "a new kernel on cl",
                given,
                f"{allowed}, {REFUSED:.0%} of vm.max_map_count",
                "PoCL never unloads kernels: begin a new process, or raise the limit (sysctl vm.max_map_count)",
            )
        if count >= WARNED * limit and not self._has_warned:
            self._has_warned = True
            text = (
                f"{count} of {limit} memory maps are taken: PoCL never unloads kernels. From "
                f"{int(REFUSED * limit)} on, new ones are refused; begin a new process, or raise vm.max_map_count"
            )
            warnings.warn(text, RuntimeWarning, stacklevel=2)


def count_maps() -> int:
    """Return the number of memory maps of this process, 0 if it isn't known."""
    try:
        return _MAPS.read_bytes().count(b"\n")
    except OSError:
        return 0


def read_limit() -> int:
    """Return the largest number of memory maps of a process, 0 if it isn't known."""
    try:
        return int(_LIMIT.read_text(encoding="ascii"))
    except (OSError, ValueError):
        return 0


COUNTER: Final = MapCounter(count_maps, read_limit)
"""The counter of this process."""
