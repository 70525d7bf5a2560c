"""Times on a busy machine: how long threads waited for a processor that other programs had.

The clock runs on while a thread waits, processor time doesn't. On Linux the kernel counts both for each thread
(`/proc/self/task/*/schedstat`). If all threads of a frame wait the same part of their time, the clock is
longer by the ratio of their whole time to their processor time, and can be corrected by it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from time import perf_counter, process_time
from typing import Final

_TASKS: Final = Path("/proc/self/task")
DISTURBED: Final = 1.15
"""From this slowdown on, a machine is said to be busy: threads of one frame also wait for each other."""


@dataclass(frozen=True, slots=True)
class Instant:
    """Seconds of the clock, of the processor, and of waiting for one, of all threads; or their differences."""

    clock: float
    processor: float
    waiting: float

    @classmethod
    def now(cls) -> Instant:
        """The present instant."""
        return cls(perf_counter(), process_time(), read_waiting_seconds())

    def __sub__(self, other: Instant) -> Instant:
        return Instant(
            self.clock - other.clock, self.processor - other.processor, max(self.waiting - other.waiting, 0.0)
        )

    @property
    def slowdown(self) -> float:
        """The ratio of running and waiting to running alone; 1 if the system doesn't say."""
        return (self.processor + self.waiting) / self.processor if self.processor > 0.0 else 1.0

    @property
    def undisturbed(self) -> float:
        """About the seconds by the clock on a machine that does nothing else."""
        return self.clock / self.slowdown


def read_waiting_seconds() -> float:
    """The seconds that the living threads of this process have waited for a processor; 0 where the system
    doesn't count them."""
    nanoseconds = 0
    try:
        for task in _TASKS.iterdir():
            try:
                nanoseconds += int((task / "schedstat").read_text(encoding="ascii").split()[1])
            except (OSError, ValueError, IndexError):
                continue  # the thread has ended
    except OSError:
        return 0.0
    return 1e-9 * nanoseconds
