"""The activity of CPU and GPU over time: the timeline of a simulated run (thesis Figures 4.1 and 6.2).

- An `ActivityTimeline` has spans on two lanes. The CPU is busy or stalled (waiting for the GPU). The GPU is
  busy, starved (without work) or halted (while an interrupt is handled, thesis 4.4.2).
- Times are integers: nanoseconds since the device was created. The same calls give the same timeline.
- A timeline can be printed as text, plotted with matplotlib, and saved as a trace for Chrome and Perfetto.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from rhi.errors import DeviceError
from rhi.errors.choices import Choice
from rhi.errors.data_classes import dataclass
from rhi.errors.rules import PLOT_LIBRARY

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Lane(Choice):
    """A row of the timeline: one of the two processors."""

    CPU = "CPU"
    GPU = "GPU"


class Activity(Choice):
    """An activity of a processor. A value is its character in text and its color in a plot."""

    BUSY = ("█", "#3b76af")
    STALLED = ("░", "#d1605e")
    STARVED = ("·", "#e3a857")
    HALTED = ("▒", "#7c5295")

    character: str
    color: str

    def __init__(self, character: str, color: str) -> None:
        self.character = character
        self.color = color


@dataclass(frozen=True, slots=True)
class Span:
    """An activity of one lane from `start` to `end`, in nanoseconds. `name` is its reason, or the label it
    measures."""

    lane: Lane
    activity: Activity
    start: int
    end: int
    name: str = ""

    @property
    def nanoseconds(self) -> int:
        """The length of the span."""
        return self.end - self.start


@dataclass(frozen=True, slots=True)
class FrameActivity:
    """The activities of a frame, from one `present` to the next. Times are in nanoseconds.

    Attributes:
        start, presented: when the CPU began the frame, and when it presented it.
        done: when the GPU reached the end of the frame, None if it hasn't yet.
        in_flight: frames presented but not done when this one was presented, including it.
    """

    start: int
    presented: int
    done: int | None
    in_flight: int

    @property
    def latency(self) -> int | None:
        """Nanoseconds from the CPU's start of the frame to the GPU's end of it, None if the GPU isn't
        done."""
        return None if self.done is None else self.done - self.start


_ACTIVITIES: Final = {Lane.CPU: (Activity.BUSY, Activity.STALLED), Lane.GPU: tuple(Activity)}


@dataclass(frozen=True, slots=True)
class ActivityTimeline:
    """A simulated run up to now.

    Attributes:
        spans: the spans of each lane in order, without gaps from 0 to `end`.
        labels: GPU time inside labels and passes that have ended, with their names; they nest.
        frames: the presented frames.
        end: the present time on the CPU's clock.
    """

    spans: tuple[Span, ...]
    labels: tuple[Span, ...]
    frames: tuple[FrameActivity, ...]
    end: int

    def lane(self, lane: Lane) -> list[Span]:
        """Return the spans of one lane, in order."""
        return [span for span in self.spans if span.lane is lane]

    def total(self, lane: Lane, activity: Activity, start: int = 0, end: int | None = None) -> int:
        """Return the nanoseconds of an activity on a lane, between `start` and `end`."""
        end = self.end if end is None else end
        return sum(
            max(0, min(span.end, end) - max(span.start, start))
            for span in self.spans
            if span.lane is lane and span.activity is activity
        )

    def format(self, width: int = 72) -> str:
        """Return the two lanes as bars of `width` characters with totals, and a row for each frame."""
        lines = [f"{'':4}0 {_format_time(self.end):>{max(1, width - 1)}}"]
        for lane in Lane:
            bar = _bar(self.lane(lane), self.end, width)
            parts = [
                f"{activity.character} {activity.name.lower()} {_format_time(time)}"
                for activity in _ACTIVITIES[lane]
                if (time := self.total(lane, activity)) or activity is not Activity.HALTED
                if lane is Lane.CPU or activity is not Activity.STALLED
            ]
            lines.append(f"{lane.value} {bar}  {', '.join(parts)}")
        if self.frames:
            lines.append("frame   cpu busy  cpu stalled     gpu busy  gpu starved      latency  in flight")
        for number, frame in enumerate(self.frames):
            times = [
                _format_time(self.total(lane, activity, frame.start, frame.presented))
                for lane, activity in (
                    (Lane.CPU, Activity.BUSY),
                    (Lane.CPU, Activity.STALLED),
                    (Lane.GPU, Activity.BUSY),
                    (Lane.GPU, Activity.STARVED),
                )
            ]
            latency = "not done" if frame.latency is None else _format_time(frame.latency)
            lines.append(
                f"{number:>5} {times[0]:>10} {times[1]:>12} {times[2]:>12} {times[3]:>12} {latency:>12} "
                f"{frame.in_flight:>10}"
            )
        return "\n".join(lines)

    def __str__(self) -> str:
        return self.format()

    def plot(self, path: str | Path | None = None) -> Figure:
        """Plot the timeline, and save the plot to `path` if given.

        Raises:
            DeviceError: `plot-library` without matplotlib.
        """
        try:
            from matplotlib.figure import Figure
            from matplotlib.patches import Patch
        except ImportError:
            raise DeviceError(PLOT_LIBRARY, "timeline.plot", "matplotlib is missing") from None

        scale, unit = _time_unit(self.end)
        figure = Figure(figsize=(10, 2.6), layout="constrained")
        axes = figure.add_subplot()
        rows = {Lane.CPU: 1.0, Lane.GPU: 0.0}
        for lane, row in rows.items():
            spans = self.lane(lane)
            axes.broken_barh(
                [(span.start / scale, span.nanoseconds / scale) for span in spans],
                (row - 0.35, 0.7),
                facecolors=[span.activity.color for span in spans],
            )
        for depth, span in zip(_depths(self.labels), self.labels, strict=True):
            top = -0.55 - 0.3 * depth
            bar = (span.start / scale, span.nanoseconds / scale)
            axes.broken_barh([bar], (top - 0.22, 0.22), facecolors="#cccccc", edgecolors="white")
            if span.nanoseconds > self.end / 25:  # else the text would overlap the next
                style: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": 7, "clip_on": True}
                axes.text(sum(bar) - bar[1] / 2, top - 0.11, span.name, **style)
        for frame in self.frames:
            axes.axvline(frame.presented / scale, color="black", linewidth=0.6, linestyle=":")
        axes.set_yticks(list(rows.values()), [lane.value for lane in rows])
        axes.set_xlim(0, max(self.end, 1) / scale)
        axes.set_xlabel(unit)
        axes.spines[["top", "right", "left"]].set_visible(False)
        axes.tick_params(axis="y", length=0)
        used = [activity for activity in Activity if any(span.activity is activity for span in self.spans)]
        handles = [Patch(color=activity.color, label=activity.name.lower()) for activity in used]
        axes.legend(handles=handles, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=4, frameon=False)
        if path is not None:
            figure.savefig(path, dpi=120)
        return figure

    def save(self, path: str | Path) -> None:
        """Save a trace in the JSON format of Chrome (`chrome://tracing`), which Perfetto reads too."""
        threads = {"CPU": 1, "GPU": 2, "GPU labels": 3}
        events: list[dict[str, Any]] = [
            {"ph": "M", "name": "thread_name", "pid": 1, "tid": tid, "args": {"name": name}}
            for name, tid in threads.items()
        ]
        for span in self.spans:
            name = span.activity.name.lower()
            events.append(
                _slice(span, threads[span.lane.value], f"{name}: {span.name}" if span.name else name)
            )
        events += [_slice(span, threads["GPU labels"], span.name) for span in self.labels]
        events += [
            {
                "ph": "i",
                "s": "g",
                "name": f"frame {number} presented",
                "pid": 1,
                "tid": 1,
                "ts": frame.presented / 1e3,
            }
            for number, frame in enumerate(self.frames)
        ]
        document = {"displayTimeUnit": "ns", "traceEvents": events}
        Path(path).write_text(json.dumps(document, indent=1), encoding="utf-8")


class ActivityLog:
    """The log of a simulation, from which `timeline` creates spans.

    Attributes:
        stalls, idle: the spans in which the CPU and the GPU weren't busy, in order.
        presented: (time, frames in flight) of each `present`.
        done: when the GPU reached the ends of these frames.
    """

    def __init__(self) -> None:
        self.stalls: list[Span] = []
        self.idle: list[Span] = []
        self.presented: list[tuple[int, int]] = []
        self.done: list[int] = []
        self._labels: list[Span | None] = []  # in the order in which they begin; None while open
        self._open: list[tuple[int, int, str]] = []

    def add_stall(self, start: int, end: int, reason: str) -> None:
        """Log that the CPU waits."""
        if end > start:
            self.stalls.append(Span(Lane.CPU, Activity.STALLED, start, end, reason))

    def add_idle(self, activity: Activity, start: int, end: int, reason: str = "") -> None:
        """Log that the GPU is starved or halted."""
        if end > start:
            self.idle.append(Span(Lane.GPU, activity, start, end, reason))

    def begin_label(self, time: int, name: str) -> None:
        self._open.append((len(self._labels), time, name))
        self._labels.append(None)

    def end_label(self, time: int) -> None:
        if self._open:
            index, start, name = self._open.pop()
            self._labels[index] = Span(Lane.GPU, Activity.BUSY, start, time, name)

    def present(self, time: int) -> None:
        self.presented.append((time, len(self.presented) + 1 - len(self.done)))

    def timeline(self, now: int, idle_since: int | None) -> ActivityTimeline:
        """Return the timeline up to `now` on the CPU's clock. The GPU has been idle since `idle_since`; None:
        it is busy."""
        idle = self.idle.copy()
        if idle_since is not None and idle_since < now:
            idle.append(Span(Lane.GPU, Activity.STARVED, idle_since, now))
        spans = (*_fill(Lane.CPU, self.stalls, now), *_fill(Lane.GPU, idle, now))
        starts = [0, *(time for time, _ in self.presented)]
        frames = [
            FrameActivity(starts[i], time, self.done[i] if i < len(self.done) else None, in_flight)
            for i, (time, in_flight) in enumerate(self.presented)
        ]
        return ActivityTimeline(spans, tuple(label for label in self._labels if label), tuple(frames), now)


def _fill(lane: Lane, others: Sequence[Span], end: int) -> Iterable[Span]:
    """Yield `others` up to `end`, with busy spans between them."""
    time = 0
    for span in others:
        if span.start >= end:
            break
        if span.start > time:
            yield Span(lane, Activity.BUSY, time, span.start)
        yield replace(span, end=min(span.end, end))
        time = span.end
    if end > time:
        yield Span(lane, Activity.BUSY, time, end)


def _bar(spans: Sequence[Span], end: int, width: int) -> str:
    """Return `width` characters, each for the longest activity in its part of the time."""
    shares = [dict.fromkeys(Activity, 0.0) for _ in range(width)]
    for span in spans:
        first, last = span.start * width / max(end, 1), span.end * width / max(end, 1)
        for column in range(int(first), min(width, int(last) + 1)):
            shares[column][span.activity] += max(0.0, min(last, column + 1) - max(first, column))
    return "".join(max(share, key=lambda a: share[a]).character for share in shares)


def _depths(labels: Sequence[Span]) -> list[int]:
    """Return the number of labels around each label. They are in the order in which they begin."""
    depths: list[int] = []
    around: list[Span] = []
    for label in labels:
        while around and around[-1].end <= label.start and around[-1].end < label.end:
            around.pop()
        depths.append(len(around))
        around.append(label)
    return depths


def _slice(span: Span, thread: int, name: str) -> dict[str, Any]:
    times = {"ts": span.start / 1e3, "dur": span.nanoseconds / 1e3}
    return {"ph": "X", "name": name, "cat": span.lane.value, "pid": 1, "tid": thread, **times}


def _time_unit(nanoseconds: int) -> tuple[float, str]:
    return (1e6, "ms") if nanoseconds >= 1e6 else (1e3, "µs")


def _format_time(nanoseconds: int) -> str:
    scale, unit = _time_unit(nanoseconds)
    return f"{nanoseconds / scale:.3f} {unit}"
