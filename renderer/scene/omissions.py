"""Omissions: the properties of a file that its scene lacks, or of a scene that its file lacks. They are
listed, so that nothing is dropped in silence."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True, slots=True)
class Omission:
    """Something that was left out: `what` it is, how often it occurs, and the place where it occurs first."""

    what: str
    count: int
    where: str

    def __str__(self) -> str:
        times = f", {self.count} times" if self.count > 1 else ""
        return f"{self.what} ({self.where}{times})"


@dataclass(slots=True)
class Omissions:
    """A list of omissions in which equal ones are counted."""

    _counts: dict[str, list[Any]] = field(default_factory=dict)

    def add(self, what: str, where: str, count: int = 1) -> None:
        """Note that `what` was left out at the place `where`."""
        self._counts.setdefault(what, [0, where])[0] += count

    def __len__(self) -> int:
        return len(self._counts)

    def __iter__(self) -> Iterator[Omission]:
        return (Omission(what, count, where) for what, (count, where) in self._counts.items())
