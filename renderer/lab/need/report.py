"""The report of `need`: a row for each rung of the ladder, its table, and the page that explains it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Final

import rhi
from renderer.lab.measure import format_table
from renderer.lab.measure.alternate import Interval
from renderer.lab.need.counting import FrameCosts, Left, compare, count_rung, find_faults, remove_rung
from renderer.lab.need.ladder import LADDER
from renderer.lab.need.timing import RungTime, time_removal, time_rungs

_ROUNDS_OF_REMOVAL: Final = 5
"""The factor by which more rounds time the removal of an effect than its addition: it is a matter of percents."""


@dataclass(frozen=True, slots=True)
class RungRow:
    """The figures of what a rung adds.

    Attributes:
        costs: of a frame with all rungs up to this one. added: of each number, how much this one adds.
        passes: the names of those that the rung adds. replaced: of those that it doesn't have any more.
        left: what is left once the effect is removed; None for the first rung.
        faults: what the effect costs where it isn't, or leaves behind, without a cause.
        times: by backend, milliseconds of the processor. ratios: by backend, the time of a frame from which the effect
            was removed as a multiple of one that never had it.
    """

    name: str
    adds: str
    costs: FrameCosts
    added: dict[str, int]
    passes: tuple[str, ...]
    replaced: tuple[str, ...]
    left: Left | None
    faults: tuple[str, ...] = ()
    times: dict[str, RungTime] = field(default_factory=dict)
    ratios: dict[str, Interval] = field(default_factory=dict)


def find_rungs(names: Sequence[str]) -> list[int]:
    """Return the numbers of rungs with these names, ascending; of all if none is given."""
    return [number for number, rung in enumerate(LADDER) if not names or rung.name in names]


def count_need(numbers: Iterable[int]) -> list[RungRow]:
    """Count what rungs add, each to the one before it on the ladder."""
    rows, counted = [], dict[int, FrameCosts]()
    for number in numbers:
        for each in (number - 1, number):
            if each >= 0 and each not in counted:
                counted[each] = count_rung(each).costs
        costs, before = counted[number], counted.get(number - 1)
        left: Left | None = None
        faults: list[str] = []
        if number:
            never, removed = remove_rung(number)
            left = compare(never, removed)[0]
            faults = find_faults(number, never, removed, left)
        numbers_of = [one.name for one in fields(FrameCosts) if one.name != "passes"]
        old = before.passes if before is not None else ()
        rows.append(
            RungRow(
                LADDER[number].name,
                LADDER[number].adds,
                costs,
                {name: getattr(costs, name) - getattr(before, name, 0) for name in numbers_of},
                tuple(dict.fromkeys(name for name in costs.passes if name not in old)),
                tuple(dict.fromkeys(name for name in old if name not in costs.passes)),
                left,
                tuple(faults),
            )
        )
    return rows


def time_need(
    rows: Sequence[RungRow],
    device: rhi.Device,
    rounds: int,
    watch: Callable[[Iterable[int], str], Iterable[int]] = lambda items, what: items,
) -> None:
    """Time what rungs add on a device, and what is left of each once it is removed.

    Args:
        rounds: in which all rungs are timed; their removal is timed in five times as many. watch: shows progress.
    """
    backend = device.backend_name
    numbers = {LADDER[number].name: number for number in range(len(LADDER))}
    chosen = [numbers[row.name] for row in rows]
    times = time_rungs(device, chosen, watch(range(rounds), f"{backend}: all rungs"))
    for row in rows:
        row.times[backend] = times[numbers[row.name]]
        if row.left is not None:
            turns = watch(range(_ROUNDS_OF_REMOVAL * rounds), f"{backend}: without {row.name}")
            row.ratios[backend] = time_removal(device, numbers[row.name], turns)


_TITLES: Final[Mapping[str, str]] = {
    "draws": "draws", "dispatches": "dispatches", "programs": "programs", "bindings": "bindings",
    "uploads": "bytes a frame", "setup": "bytes at first", "images": "image bytes", "buffers": "buffer bytes",
    "steps": "steps", "calls": "calls",
}  # fmt: skip


def show_added(rows: Sequence[RungRow], *, markdown: bool = False) -> str:
    """Format what rungs add as a table."""
    backends = list(dict.fromkeys(name for row in rows for name in row.times))
    header = ["scene", "adds", "passes", *_TITLES.values(), *(f"ms on {name}" for name in backends)]
    cells: list[list[object]] = []
    for row in rows:
        passes = [*row.passes, *(f"not {name}" for name in row.replaced)]
        times = [_show_time(row.times.get(name)) for name in backends]
        numbers = [_show_added(row.added[name]) for name in _TITLES]
        cells.append([row.name, row.adds, ", ".join(passes) or "-", *numbers, *times])
    return format_table(header, cells, markdown=markdown)


def show_removed(rows: Sequence[RungRow], *, markdown: bool = False) -> str:
    """Format what is left of effects once they are removed as a table."""
    backends = list(dict.fromkeys(name for row in rows for name in row.ratios))
    header = [
        "without", "commands that differ", "calls that differ", "calls of the device that differ", "bytes still held",
        *(f"time on {name}" for name in backends),
    ]  # fmt: skip
    cells: list[list[object]] = []
    for row in rows:
        if row.left is None:
            continue
        held = ", ".join(f"{size:,} ({name})" for name, size in row.left.held.items()) or "0"
        ratios = [_show_ratio(row.ratios.get(name)) for name in backends]
        cells.append([row.name, row.left.differences, row.left.calls, row.left.device_calls, held, *ratios])
    return format_table(header, cells, markdown=markdown)


def _show_added(number: int) -> str:
    return f"{number:+,}" if number else "0"


def _show_time(time: RungTime | None) -> str:
    if time is None:
        return "-"
    if time.added is None:
        return f"{time.frame.median:.2f}"
    return f"{time.added.median:+.2f} ({time.added.low:+.2f} to {time.added.high:+.2f})"


def _show_ratio(ratio: Interval | None) -> str:
    return "-" if ratio is None else f"{ratio.median:.3f} ({ratio.low:.3f} to {ratio.high:.3f})"
