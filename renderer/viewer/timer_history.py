"""The times of the latest frames by label, for graphs."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Final

from renderer.layers.overlay.history import History
from rhi import TimerNode

FRAMES: Final = 120
"""How many frames a graph has."""
_MAX_LABELS: Final = 200
_SHOWN_FRAMES: Final = 120  # for which a label stays listed after its last time


@dataclass(slots=True)
class TimerRow:
    """The times of the events of one label.

    Attributes:
        label: the label, with those of the events around it before: `shadows/cascade 0`.
        gpu, cpu: milliseconds a frame of the latest frames.
        latest: the number of the latest frame with such an event.
    """

    label: str
    gpu: History = field(default_factory=lambda: History(FRAMES))
    cpu: History = field(default_factory=lambda: History(FRAMES))
    latest: int = 0

    @property
    def name(self) -> str:
        """The last part of the label."""
        return self.label.rpartition("/")[2]

    @property
    def depth(self) -> int:
        """The number of events around it."""
        return self.label.count("/")


class TimerHistory:
    """Collects the timers of frames."""

    def __init__(self) -> None:
        self._rows: dict[str, TimerRow] = {}
        self._frame = 0

    def add(self, timers: Iterable[TimerNode]) -> None:
        """Add a frame's timers; events of one label are added up."""
        self._frame += 1
        times: dict[str, tuple[float, float]] = {}
        _sum_times(timers, "", times)
        for label, (gpu, cpu) in times.items():
            if label not in self._rows and len(self._rows) >= _MAX_LABELS:
                continue
            row = self._rows.setdefault(label, TimerRow(label))
            row.gpu.add(gpu)
            row.cpu.add(cpu)
            row.latest = self._frame

    @property
    def rows(self) -> list[TimerRow]:
        """The labels of recent frames, each below that around it."""
        recent = [row for row in self._rows.values() if self._frame - row.latest < _SHOWN_FRAMES]
        order = {row.label: index for index, row in enumerate(recent)}

        def position(row: TimerRow) -> list[int]:
            parts = row.label.split("/")
            return [order.get("/".join(parts[: end + 1]), -1) for end in range(len(parts))]

        return sorted(recent, key=position)


def _sum_times(timers: Iterable[TimerNode], above: str, times: dict[str, tuple[float, float]]) -> None:
    for timer in timers:
        label = f"{above}{timer.name.replace('/', '|')}"
        gpu, cpu = times.get(label, (0.0, 0.0))
        times[label] = gpu + timer.gpu_milliseconds, cpu + timer.cpu_milliseconds
        _sum_times(timer.children, f"{label}/", times)
