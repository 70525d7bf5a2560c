"""The machine that figures were measured on, as Figure 6.1 of Kosmadakis's thesis lists it: without it a time says
little."""

from __future__ import annotations

import os
import platform
import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Final

_PROCESSORS: Final = Path("/proc/cpuinfo")
_GIBIBYTE: Final = 2.0**30


@dataclass(frozen=True, slots=True)
class Machine:
    """The parts of a machine that times depend on.

    Attributes:
        processor: the model, as its maker calls it, or the architecture where the system doesn't say.
        cores: how many this process may run on.
        memory_gib: the memory of the machine in GiB, None where the system doesn't say.
        system: the name and the version of the operating system.
        python: the implementation and its version.
    """

    processor: str
    cores: int
    memory_gib: float | None
    system: str
    python: str

    def __str__(self) -> str:
        memory = "" if self.memory_gib is None else f", {self.memory_gib:.0f} GiB"
        cores = f"{self.cores} core{'s' if self.cores > 1 else ''}"
        return f"{self.processor}, {cores}{memory}, {self.system}, {self.python}"


@cache
def describe_machine() -> Machine:
    """Describe the machine that this process runs on."""
    return Machine(
        processor=_read_model(_PROCESSORS)
        or platform.processor()
        or platform.machine()
        or "unknown processor",
        cores=_count_cores(),
        memory_gib=_read_memory(),
        system=f"{platform.system()} {platform.release()}".strip() or "unknown system",
        python=f"{platform.python_implementation()} {platform.python_version()}",
    )


def _read_model(processors: Path) -> str:
    """Return the model of the first processor that a file such as /proc/cpuinfo lists, or nothing."""
    try:
        text = processors.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
    match = re.search(r"^model name\s*:\s*(.+)$", text, re.MULTILINE)
    return "" if match is None else " ".join(match[1].split())


def _count_cores() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _read_memory() -> float | None:
    """Return the memory of the machine in GiB."""
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / _GIBIBYTE
    except (AttributeError, ValueError, OSError):
        return None
