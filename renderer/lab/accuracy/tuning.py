"""The search for b and n of CHC++ (thesis 6.5.1): trials, and which values to try next.

A trial renders a walk through the scene with one pair (b, n) and, in turn, frame by frame in the same
process, with the default pair. Its result is the mean of the frames' ratios without the quarter at either
end. So other load on the machine, above all trials at the same time, slows both alike, and results from
different machines can be compared. Counters don't depend on the time, except through query results that
arrive early or late.

The search begins with a grid over both ranges, evenly spaced by ratio, and refines it around the best pair
(the thesis's binary search, on both axes at once). All trials of a round may run at the same time. Finally, a
trial compares the best few pairs with each other, in one process with nothing beside it; the best is then
tried with leaves of several objects.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from threading import Lock
from typing import Final

import numpy as np

import rhi
from renderer.content import load_scene
from renderer.lab.comparison import Column, Frames, Result, Subject, average, compare, time
from renderer.renderer import Renderer
from renderer.scene import CameraPath, PathFrame
from renderer.visibility import VisibilitySettings, make_visibility

ParameterPair = tuple[int, int]
"""Values of b and n; or the smallest and greatest value of either."""

_FIRST: Final = 4  # values of b, and of n, in the first round
_FINALISTS: Final = 3
_TRIM_FRACTION: Final = 0.25
_COUNTED: Final = ("triangles", "draws", "queries", "hardware_state_changes")
_LOCK: Final = Lock()  # trials on threads of one process would share the interpreter and the driver's context


@dataclass(frozen=True, slots=True)
class PathFrames:
    """The frames that every trial renders. Small enough to be sent to other machines, which load the scene
    themselves.

    Attributes:
        scene: the scene's text.
        path: the frame before the first, and the frames to render.
        first: the number of the former.
        backend: the backend's name; None for the machine's own choice.
        size: (width, height) of the image in pixels.
        emulated: whether queries are two counters and a fence, even if the device has its own.
    """

    scene: str
    path: CameraPath
    first: int = 0
    backend: str | None = None
    size: tuple[int, int] = (960, 540)
    emulated: bool = False


@dataclass(frozen=True, slots=True)
class Trial:
    """The result of a pair with one leaf size: median times, the `ratio` to the default settings' time, mean
    counters, and the `kernels` that drew."""

    batch: int
    persistence: int
    milliseconds: float
    default_milliseconds: float
    ratio: float
    triangles: int
    draws: int
    queries: int
    hardware_state_changes: int
    leaf_size: int = 1
    kernels: str | None = None


def trimmed_mean_ratio(result: Result, _: str) -> float:
    """A column of the mean of the frames' ratios without the lowest and the highest quarter."""
    ratios = np.sort(np.divide(result.time.seconds, result.base.seconds))
    cut = int(_TRIM_FRACTION * len(ratios))
    return round(float(ratios[cut : len(ratios) - cut].mean()), 4)


COLUMNS: Final[dict[str, Column]] = {
    "milliseconds": time(),
    "ratio": trimmed_mean_ratio,
    **dict.fromkeys(_COUNTED, average()),
}


def try_pairs(path_frames: PathFrames, pairs: Sequence[ParameterPair], leaf_size: int = 1) -> list[Trial]:
    """Try each pair on a new device. The frames of all pairs and of the default settings alternate.

    A process runs one call at a time; other calls wait.
    """
    scene = load_scene(path_frames.scene)
    default = VisibilitySettings(emulated=path_frames.emulated)
    with (
        _LOCK,
        rhi.create_device(path_frames.backend) as device,
        Renderer(device, scene, size=path_frames.size) as renderer,
    ):
        tried = [
            replace(default, batch=batch, persistence=persistence, leaf_size=leaf_size)
            for batch, persistence in pairs
        ]
        frames = [
            PathFrame(path_frames.first + frame, path_frames.path.camera(frame))
            for frame in range(len(path_frames.path))
        ]
        subjects = [_make_subject(renderer, frames, settings) for settings in (default, *tried)]
        base, *rows = compare(subjects, COLUMNS, range(1, len(frames)))
    return [
        Trial(*pair, default_milliseconds=base["milliseconds"], leaf_size=leaf_size, **row)
        for pair, row in zip(pairs, rows, strict=True)
    ]


def _make_subject(
    renderer: Renderer, path_frames: Sequence[PathFrame], settings: VisibilitySettings
) -> Subject:
    """The subject that draws frames with settings of CHC++."""
    algorithm = make_visibility("chc_plus_plus", renderer.scene, renderer.device, settings)

    def exchange() -> None:
        renderer.visibility = algorithm

    draw = Frames(renderer, *path_frames)
    return Subject({}, draw, exchange, draw.count)


def search(
    batches: ParameterPair,
    persistences: ParameterPair,
    rounds: int,
    try_all: Callable[[list[ParameterPair]], list[Trial]],
) -> Iterator[Trial]:
    """Yield trials of pairs within both ranges, ends included; `try_all` runs the trials of a round.

    The first round is a grid over the ranges. Each further round is centred at the best pair so far and spans
    the square root of the last round's spans. No pair is tried twice.
    """
    trials: dict[ParameterPair, Trial] = {}
    default = VisibilitySettings()
    spans = [high / low for low, high in (batches, persistences)]
    candidates = {
        (b, n) for b in space_evenly(*batches, _FIRST) for n in space_evenly(*persistences, _FIRST)
    } | {
        (
            min(max(default.batch, batches[0]), batches[1]),
            min(max(default.persistence, persistences[0]), persistences[1]),
        )
    }
    for turn in range(rounds):
        if turn:
            best = select_best(list(trials.values()), 1)[0]
            spans = [span**0.5 for span in spans]
            candidates = {
                (b, n)
                for b in _around(best.batch, spans[0], batches)
                for n in _around(best.persistence, spans[1], persistences)
            }
        new = try_all(sorted(candidates - trials.keys()))
        trials |= {(trial.batch, trial.persistence): trial for trial in new}
        yield from new


def select_best(trials: Sequence[Trial], count: int = _FINALISTS) -> list[Trial]:
    """The `count` trials with the smallest ratios, best first; of equal ones, those with fewer queries
    first."""
    return sorted(trials, key=lambda trial: (trial.ratio, trial.queries))[:count]


def space_evenly(low: int, high: int, count: int) -> list[int]:
    """At most `count` whole numbers from `low` to `high`, both included, evenly spaced by ratio."""
    return sorted({round(value) for value in np.geomspace(low, high, count).tolist()})


def _around(median_of: int, span: float, limits: ParameterPair) -> list[int]:
    """A value and its neighbours at a factor of about `span`, distinct where the limits leave room."""
    step = span**0.5
    below, above = min(round(median_of / step), median_of - 1), max(round(median_of * step), median_of + 1)
    return sorted({min(max(value, limits[0]), limits[1]) for value in (below, median_of, above)})
