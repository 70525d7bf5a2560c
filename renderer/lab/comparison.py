"""Comparison: subjects take turns in one process; what they took and did becomes rows.

A comparison is a table of subjects and a table of columns. A subject says how it is run; a column says how what was
found in all rounds becomes a cell. So who compares writes neither a clock nor a median. Tables, charts and JSON of rows
are the business of `renderer.cli.comparison`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from operator import truediv
from statistics import fmean, median
from typing import Any, Final, Protocol, runtime_checkable

import rhi
from renderer.lab.measure.alternate import Measurement, alternate
from renderer.renderer import FrameResult, Renderer
from renderer.scene import Camera, Shot

KERNELS: Final = "kernels"
"""The cell of a subject that runs on a device: which kernels ran in its rounds, see `describe_kernels`."""
Record = dict[str, Any]
"""A row: its cells by the names of its columns."""


@dataclass
class Subject:
    """A subject of a comparison.

    Attributes:
        about: the first cells of its row.
        run: does the work of a round, given its number, and waits for it.
        before: called before each run, untimed.
        count: returns what the run that was just timed has done, by name.
        device: where it runs; its row then has a cell `kernels`, after those of the columns, and a device that records
            commands forgets them before each run. `Frames` say it.
        find: returns the last cells of its row, once all rounds are over.
    """

    about: Mapping[str, object]
    run: Callable[[int], object]
    before: Callable[[], object] = lambda: None
    count: Callable[[], Mapping[str, Any]] = dict
    device: rhi.Device | None = None
    find: Callable[[], Mapping[str, Any]] = dict

    def __post_init__(self) -> None:
        if isinstance(self.run, Frames):
            self.device = self.run.renderer.device


@dataclass(frozen=True, slots=True)
class Result:
    """The times and counts of a subject, by name, round by round, and those of the one that it is compared with."""

    time: Measurement
    base: Measurement
    counts: Mapping[str, Sequence[Any]]
    base_counts: Mapping[str, Sequence[Any]]


Column = Callable[[Result, str], object]
"""Makes a cell of a result, given the column's name."""


def time(scale: float = 1e3, digits: int = 3, *, processor: bool = False) -> Column:
    """Return the column of the median time: milliseconds, or another number of parts of a second."""
    return lambda found, _: round(scale * (found.time.processor_median if processor else found.time.median), digits)


def rate(amount: float, *, processor: bool = False) -> Column:
    """Return the column of the amounts done in a second."""
    return lambda found, _: amount / (found.time.processor_median if processor else found.time.median)


def ratio(digits: int = 3, *, processor: bool = False, inverse: bool = False) -> Column:
    """Return the column of the median ratio of times to those of the base; `inverse`: how many times as fast."""

    def cell(found: Result, _: str) -> float:
        own = found.time.compare_to(found.base, processor=processor).median
        return round(1.0 / own if inverse else own, digits)

    return cell


def interval(digits: int = 3) -> Column:
    """Return the column of the limits of the ratio of processor times, with 95 % confidence."""

    def cell(found: Result, _: str) -> list[float]:
        own = found.time.compare_to(found.base, processor=True)
        return [round(own.low, digits), round(own.high, digits)]

    return cell


def average(digits: int | None = None) -> Column:
    """Return the column of the mean of what was counted under its name."""
    return lambda found, name: round(fmean(found.counts[name]), digits)


def middle(scale: float = 1.0, digits: int = 3) -> Column:
    """Return the column of the median of what was counted under its name."""
    return lambda found, name: round(scale * median(found.counts[name]), digits)


def ratio_of(counted: str, digits: int = 3) -> Column:
    """Return the column of the median ratio of a count to that of the base in the same round: what a subject has taken
    by a clock of its own."""
    return lambda found, _: round(median(map(truediv, found.counts[counted], found.base_counts[counted])), digits)


def largest(found: Result, name: str) -> Any:
    """Return the largest of what was counted under this name; None if it couldn't be counted."""
    counts = found.counts[name]
    return None if None in counts else max(counts)


@runtime_checkable
class RunsQuickKernels(Protocol):
    """A backend whose kernels are built quickly at first, and replaced by optimised ones while they are used."""

    @property
    def quick_work(self) -> int:
        """The work-items of draws that kernels were given which aren't optimised."""


def find_quick_work(device: rhi.Device | None) -> int | None:
    """Return the work-items that quick kernels of a device were given; None if it has no such kernels."""
    kind: Any = RunsQuickKernels  # mypy takes no protocol for a class
    try:
        return None if device is None else int(device.backend_as(kind).quick_work)
    except rhi.ValidationError:
        return None


def forget_commands(device: rhi.Device) -> None:
    """Let the null device forget the commands that it has recorded, which would take ever more memory."""
    if device.backend_name == "null":
        device.stream.clear()


def describe_kernels(ran: Sequence[bool | None]) -> str | None:
    """Return which kernels ran, given for each round whether quick ones did: these, optimised ones as in a long run, or
    first these and then those; None if the device has no such kernels."""
    if None in ran:
        return None
    if all(ran):
        return "quick"
    return "quick, then optimised" if any(ran) else "optimised"


def compare(
    subjects: Sequence[Subject], columns: Mapping[str, Column], rounds: Iterable[int], *, warm_ups: int = 1,
    within: Sequence[str] = (),
) -> list[Record]:  # fmt: skip
    """Return a row for each subject: its first cells, those of the columns, which `kernels` ran if it has a device, and
    what it has found.

    Subjects take turns: each round starts with another one.

    Args:
        rounds: the rounds' numbers, at least one. Of a generator, what stands before a `yield` is done untimed before
            the subjects' round (frames that aren't counted, the picture that others are compared with), and what stands
            after it when all are done (comparing their pictures).
        warm_ups: how often all subjects are run beforehand, untimed, with the number 0.
        within: names of first cells; ratios are to the first subject that has the same ones.
    """
    named = {str(number): one for number, one in enumerate(subjects)}
    bases: dict[tuple[object, ...], str] = {}
    for name, one in named.items():
        bases.setdefault(tuple(one.about[key] for key in within), name)
    counted: dict[str, list[Mapping[str, Any]]] = {name: [] for name in named}
    quick: dict[str, int | None] = {}
    ran: dict[str, list[bool | None]] = {name: [] for name in named}

    def prepare(name: str) -> None:
        one = named[name]
        one.before()
        if one.device is not None:
            forget_commands(one.device)
        quick[name] = find_quick_work(one.device)

    def count(name: str) -> None:
        done = find_quick_work(named[name].device)
        ran[name].append(None if done is None else done > (quick[name] or 0))
        counted[name].append(named[name].count())

    times = alternate({name: one.run for name, one in named.items()}, rounds, warm_ups, prepare, count)
    counts = {name: {key: [some[key] for some in found] for key in found[0]} for name, found in counted.items()}
    rows = []
    for name, one in named.items():
        base = bases[tuple(one.about[key] for key in within)]
        found = Result(times[name], times[base], counts[name], counts[base])
        cells = {key: make(found, key) for key, make in columns.items()}
        if one.device is not None:
            cells[KERNELS] = describe_kernels(ran[name])
        rows.append({**one.about, **cells, **one.find()})
    return rows


class Frames:
    """Draws the shot of a round, which are taken in turn, and waits for the device.

    Attributes:
        result: the latest frame.
    """

    result: FrameResult

    def __init__(self, renderer: Renderer, *shots: Shot | Camera) -> None:
        """A camera alone draws the frame 0."""
        self.renderer = renderer
        self.shots = [one if isinstance(one, Shot) else Shot(0, one) for one in shots]

    def __call__(self, number: int) -> None:
        shot = self.shots[number % len(self.shots)]
        self.result = self.renderer.render(shot.camera, shot.seconds)
        self.renderer.device.finish()

    def count(self) -> Record:
        """Return the statistics of the latest frame, for a subject."""
        return asdict(self.result.statistics)
