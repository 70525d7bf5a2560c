"""The report of `effect-costs`: a row for each effect step, its table, and the page that explains it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Final

import rhi
from renderer.lab.effect_costs.counting import (
    FrameCosts,
    Leftovers,
    compare_frames,
    count_step,
    list_faults,
    remove_step,
)
from renderer.lab.effect_costs.effect_steps import EFFECT_STEPS
from renderer.lab.effect_costs.timing import EffectTime, time_removal, time_steps
from renderer.lab.measure import format_table
from renderer.lab.measure.measurement import Interval

_REMOVAL_ROUNDS_FACTOR: Final = 5
"""How many times as many rounds time the removal of an effect as its addition: differences are a few percent.
"""


@dataclass(frozen=True, slots=True)
class EffectRow:
    """The figures of an effect step.

    Attributes:
        costs: of a frame with all steps up to this one.
        added: how much this step adds to each number.
        passes: names of passes that the step adds.
        replaced: names of passes that it removes.
        leftovers: what remains once the effect is removed; None for the first step.
        faults: costs of the effect in scenes without it, and unexplained leftovers.
        times: by backend, milliseconds of the processor.
        ratios: by backend, the time of a frame from which the effect was removed as a multiple of one that
            never had it.
    """

    name: str
    description: str
    costs: FrameCosts
    added: dict[str, int]
    passes: tuple[str, ...]
    replaced: tuple[str, ...]
    leftovers: Leftovers | None
    faults: tuple[str, ...] = ()
    times: dict[str, EffectTime] = field(default_factory=dict)
    ratios: dict[str, Interval] = field(default_factory=dict)


def list_steps_named(names: Sequence[str]) -> list[int]:
    """The numbers of the steps with these names, ascending; all if there are none."""
    return [number for number, step in enumerate(EFFECT_STEPS) if not names or step.name in names]


def count_effect_costs(numbers: Iterable[int]) -> list[EffectRow]:
    """Count what steps add, each to the one before it."""
    rows, counted = [], dict[int, FrameCosts]()
    for number in numbers:
        for step in (number - 1, number):
            if step >= 0 and step not in counted:
                counted[step] = count_step(step).costs
        costs, before = counted[number], counted.get(number - 1)
        leftovers: Leftovers | None = None
        faults: list[str] = []
        if number:
            never, removed = remove_step(number)
            leftovers = compare_frames(never, removed)[0]
            faults = list_faults(number, never, removed, leftovers)
        numbers_of = [field.name for field in fields(FrameCosts) if field.name != "passes"]
        old = before.passes if before is not None else ()
        rows.append(
            EffectRow(
                EFFECT_STEPS[number].name,
                EFFECT_STEPS[number].description,
                costs,
                {name: getattr(costs, name) - getattr(before, name, 0) for name in numbers_of},
                tuple(dict.fromkeys(name for name in costs.passes if name not in old)),
                tuple(dict.fromkeys(name for name in old if name not in costs.passes)),
                leftovers,
                tuple(faults),
            )
        )
    return rows


def time_effect_costs(
    rows: Sequence[EffectRow],
    device: rhi.Device,
    rounds: int,
    watch: Callable[[Iterable[int], str], Iterable[int]] = lambda items, task: items,
) -> None:
    """Time what steps add on a device, and what remains of each once it is removed.

    Args:
        rounds: in which all steps are timed; their removal is timed in five times as many.
        watch: shows progress.
    """
    backend = device.backend_name
    numbers = {EFFECT_STEPS[number].name: number for number in range(len(EFFECT_STEPS))}
    step_numbers = [numbers[row.name] for row in rows]
    times = time_steps(device, step_numbers, watch(range(rounds), f"{backend}: all steps"))
    for row in rows:
        row.times[backend] = times[numbers[row.name]]
        if row.leftovers is not None:
            turns = watch(range(_REMOVAL_ROUNDS_FACTOR * rounds), f"{backend}: without {row.name}")
            row.ratios[backend] = time_removal(device, numbers[row.name], turns)


_TITLES: Final[Mapping[str, str]] = {
    "draws": "draws",
    "dispatches": "dispatches",
    "programs": "programs",
    "bindings": "bindings",
    "uploads": "bytes a frame",
    "setup": "bytes at first",
    "images": "image bytes",
    "buffers": "buffer bytes",
    "steps": "steps",
    "calls": "calls",
}


def format_added(rows: Sequence[EffectRow], *, markdown: bool = False) -> str:
    """Format the costs of steps as a table."""
    backends = list(dict.fromkeys(name for row in rows for name in row.times))
    header = ["scene", "description", "passes", *_TITLES.values(), *(f"ms on {name}" for name in backends)]
    cells: list[list[object]] = []
    for row in rows:
        passes = [*row.passes, *(f"not {name}" for name in row.replaced)]
        times = [_format_time(row.times.get(name)) for name in backends]
        numbers = [_format_added(row.added[name]) for name in _TITLES]
        cells.append([row.name, row.description, ", ".join(passes) or "-", *numbers, *times])
    return format_table(header, cells, markdown=markdown)


def format_removed(rows: Sequence[EffectRow], *, markdown: bool = False) -> str:
    """Format the leftovers of removed effects as a table."""
    backends = list(dict.fromkeys(name for row in rows for name in row.ratios))
    header = [
        "without",
        "commands that differ",
        "calls that differ",
        "calls of the device that differ",
        "bytes still held",
        *(f"time on {name}" for name in backends),
    ]
    cells: list[list[object]] = []
    for row in rows:
        if row.leftovers is None:
            continue
        allocated_bytes = (
            ", ".join(f"{size:,} ({name})" for name, size in row.leftovers.allocated_bytes.items()) or "0"
        )
        ratios = [_format_ratio(row.ratios.get(name)) for name in backends]
        cells.append(
            [
                row.name,
                row.leftovers.differences,
                row.leftovers.calls,
                row.leftovers.device_calls,
                allocated_bytes,
                *ratios,
            ]
        )
    return format_table(header, cells, markdown=markdown)


def _format_added(number: int) -> str:
    return f"{number:+,}" if number else "0"


def _format_time(time: EffectTime | None) -> str:
    if time is None:
        return "-"
    if time.added is None:
        return f"{time.frame.median:.2f}"
    return f"{time.added.median:+.2f} ({time.added.low:+.2f} to {time.added.high:+.2f})"


def _format_ratio(ratio: Interval | None) -> str:
    return "-" if ratio is None else f"{ratio.median:.3f} ({ratio.low:.3f} to {ratio.high:.3f})"
