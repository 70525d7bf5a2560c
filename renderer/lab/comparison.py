"""Comparisons: subjects take turns in one process, and become rows of times and counts.

A comparison is a table of subjects and a table of columns. A subject says how it is run; a column says how
the measurements of all rounds become a cell. A new comparison needs neither a clock nor a median.
`renderer.cli.comparison` makes tables, charts and JSON of the rows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from operator import truediv
from statistics import fmean, median
from typing import Any, Final, Protocol, runtime_checkable

import rhi
from renderer.lab.measure.measurement import Measurement, alternate
from renderer.renderer import FrameResult, Renderer
from renderer.scene import Camera, PathFrame

KERNELS: Final = "kernels"
"""The column of a subject that runs on a device: which kernels ran in its rounds (`describe_kernels`)."""
Record = dict[str, Any]
"""A row: its cells by the names of its columns."""


@dataclass
class Subject:
    """A subject of a comparison.

    Attributes:
        labels: the first cells of its row.
        run: does the work of a round, given its number, and waits for it.
        before: called before each run, outside the timed part.
        count: returns counters of the run that was just timed, by name.
        device: where it runs; its row then has a cell `kernels`, after those of the columns, and a device
            that records commands forgets them before each run. `Frames` say it.
        summarize: returns the last cells of its row, once all rounds are over.
    """

    labels: Mapping[str, object]
    run: Callable[[int], object]
    before: Callable[[], object] = lambda: None
    count: Callable[[], Mapping[str, Any]] = dict
    device: rhi.Device | None = None
    summarize: Callable[[], Mapping[str, Any]] = dict

    def __post_init__(self) -> None:
        if isinstance(self.run, Frames):
            self.device = self.run.renderer.device


@dataclass(frozen=True, slots=True)
class Result:
    """Times and counts of a subject, by name, round by round, and those of its base subject."""

    time: Measurement
    base: Measurement
    counts: Mapping[str, Sequence[Any]]
    base_counts: Mapping[str, Sequence[Any]]


Column = Callable[[Result, str], object]
"""A function that makes a cell from a result and the column's name."""


def time(scale: float = 1e3, digits: int = 3, *, processor: bool = False) -> Column:
    """A column of the median time: milliseconds, or seconds times another `scale`."""
    return lambda result, _: round(
        scale * (result.time.processor_median if processor else result.time.median), digits
    )


def rate(amount: float, *, processor: bool = False) -> Column:
    """A column of the amount done per second."""
    return lambda result, _: amount / (result.time.processor_median if processor else result.time.median)


def ratio(digits: int = 3, *, processor: bool = False, inverse: bool = False) -> Column:
    """A column of the median ratio of times to the base's; with `inverse`, how many times as fast."""

    def cell(result: Result, _: str) -> float:
        time_ratio = result.time.compare_to(result.base, processor=processor).median
        return round(1.0 / time_ratio if inverse else time_ratio, digits)

    return cell


def interval(digits: int = 3) -> Column:
    """A column of the 95 % confidence limits of the ratio of processor times."""

    def cell(result: Result, _: str) -> list[float]:
        time_interval = result.time.compare_to(result.base, processor=True)
        return [round(time_interval.low, digits), round(time_interval.high, digits)]

    return cell


def average(digits: int | None = None) -> Column:
    """A column of the mean of the counts under its name."""
    return lambda result, name: round(fmean(result.counts[name]), digits)


def median_of(scale: float = 1.0, digits: int = 3) -> Column:
    """A column of the median of the counts under its name."""
    return lambda result, name: round(scale * median(result.counts[name]), digits)


def count_ratio(counted: str, digits: int = 3) -> Column:
    """A column of the median ratio of a count to the base's count in the same round, for times that subjects
    measure with clocks of their own."""
    return lambda result, _: round(
        median(map(truediv, result.counts[counted], result.base_counts[counted])), digits
    )


def max_size(result: Result, name: str) -> Any:
    """The largest count under a name; None if it couldn't be counted."""
    counts = result.counts[name]
    return None if None in counts else max(counts)


@runtime_checkable
class RunsQuickKernels(Protocol):
    """A backend that builds kernels quickly at first and replaces them with optimised ones while they run."""

    @property
    def quick_work(self) -> int:
        """The number of work-items that unoptimised kernels have run."""


def read_quick_work(device: rhi.Device | None) -> int | None:
    """The number of work-items that a device's quick kernels have run; None if it has no such kernels."""
    kind: Any = RunsQuickKernels  # mypy takes no protocol for a class
    try:
        return None if device is None else int(device.backend_as(kind).quick_work)
    except rhi.ValidationError:
        return None


def forget_commands(device: rhi.Device) -> None:
    """Clear the commands that the null device has recorded, so that they don't fill memory."""
    if device.backend_name == "null":
        device.stream.clear()


def describe_kernels(quick_rounds: Sequence[bool | None]) -> str | None:
    """Describe which kernels ran, from whether quick ones ran in each round: quick, optimised, or first one
    and then the other. None if the device has no such kernels."""
    if None in quick_rounds:
        return None
    if all(quick_rounds):
        return "quick"
    return "quick, then optimised" if any(quick_rounds) else "optimised"


def compare(
    subjects: Sequence[Subject],
    columns: Mapping[str, Column],
    rounds: Iterable[int],
    *,
    warm_ups: int = 1,
    group_by: Sequence[str] = (),
) -> list[Record]:
    """Time subjects in turn, and return a row for each: its labels, the columns' cells, the `kernels` that
    ran if it has a device, and its summary.

    Each round starts with the next subject.

    Args:
        rounds: the rounds' numbers, at least one. A generator's code before a `yield` runs untimed before the
            subjects' round (frames that aren't counted, the image that others are compared with), its code
            after the `yield` when all are done (comparing their images).
        warm_ups: how often all subjects are run beforehand, untimed, with the number 0.
        group_by: names of labels; ratios are to the first subject with the same values of these.
    """
    named = {str(number): subject for number, subject in enumerate(subjects)}
    bases: dict[tuple[object, ...], str] = {}
    for name, subject in named.items():
        bases.setdefault(tuple(subject.labels[key] for key in group_by), name)
    counted: dict[str, list[Mapping[str, Any]]] = {name: [] for name in named}
    quick: dict[str, int | None] = {}
    ran: dict[str, list[bool | None]] = {name: [] for name in named}

    def prepare(name: str) -> None:
        subject = named[name]
        subject.before()
        if subject.device is not None:
            forget_commands(subject.device)
        quick[name] = read_quick_work(subject.device)

    def count(name: str) -> None:
        done = read_quick_work(named[name].device)
        ran[name].append(None if done is None else done > (quick[name] or 0))
        counted[name].append(named[name].count())

    times = alternate(
        {name: subject.run for name, subject in named.items()}, rounds, warm_ups, prepare, count
    )
    counts = {
        name: {key: [round_counts[key] for round_counts in rounds_of] for key in rounds_of[0]}
        for name, rounds_of in counted.items()
    }
    rows = []
    for name, subject in named.items():
        base = bases[tuple(subject.labels[key] for key in group_by)]
        result = Result(times[name], times[base], counts[name], counts[base])
        cells = {key: make(result, key) for key, make in columns.items()}
        if subject.device is not None:
            cells[KERNELS] = describe_kernels(ran[name])
        rows.append({**subject.labels, **cells, **subject.summarize()})
    return rows


class Frames:
    """Draws the round's frame of a camera path, and waits for the device.

    Attributes:
        result: the latest frame.
    """

    result: FrameResult

    def __init__(self, renderer: Renderer, *path_frames: PathFrame | Camera) -> None:
        """A camera without a path is frame 0."""
        self.renderer = renderer
        self.path_frames = [
            path_frame if isinstance(path_frame, PathFrame) else PathFrame(0, path_frame)
            for path_frame in path_frames
        ]

    def __call__(self, number: int) -> None:
        path_frame = self.path_frames[number % len(self.path_frames)]
        self.result = self.renderer.render(path_frame.camera, path_frame.seconds)
        self.renderer.device.finish()

    def count(self) -> Record:
        """The statistics of the latest frame, as a subject's counts."""
        return asdict(self.result.statistics)
