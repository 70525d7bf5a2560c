"""The choice of settings: the least accurate that are good enough, or the most accurate that are fast enough.

Knobs are combined greedily at first. All begin at their most accurate value; each step takes the knob whose next value
saves the most time for the error that it adds, by what the sweeps of the single knobs have found. But errors don't add
up, and knobs change what others cost. So the settings along the way are only where a Pareto local search begins
(Paquete, Chiarandini and Stützle 2004): settings are drawn, timed and compared with what the judge sees by 16 rays a
pixel, and around those that no others beat in both, each knob is moved to its next values, until nothing better is
near. What is left, the front, is timed once more, alternately in one process. Of a scene that the judge can't follow,
the truth is the renderer's own picture: super-sampled, with fine shadow maps and exact functions.

A choice from the front is checked by views that the front wasn't found with, and must keep the bound there with a
margin: the mean of their errors and four standard deviations. Else the next more accurate one is taken. Without the
margin every second choice would break the bound somewhere in as many views again, since the worst of all of them is as
likely there. Four of ten views' standard deviations above their mean is what none of twenty others exceeds in 95 % of
cases, if errors are spread normally. The result is tried in twenty views that had no part in the choice at all.

A time is checked likewise: all settings of the front that may keep it by their intervals are candidates, and the most
accurate one is taken of which the median frame of a walk through the views of the check keeps it. What was left to
trials (`auto`) is left to them again in the end: it saves time, and loses nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from time import perf_counter, process_time
from typing import Final

import numpy as np

import rhi
from renderer import rules
from renderer.content import load_scene
from renderer.lab.accuracy.bench import Bench, can_judge, read_picture
from renderer.lab.accuracy.knobs import KNOBS, TRACED, Demand, Knob, Unit
from renderer.lab.accuracy.sweep import KnobReport, Situation, list_views
from renderer.lab.measure.alternate import alternate
from renderer.renderer import Renderer
from renderer.scene import Scene, Shot
from renderer.scene.arrays import Floats
from renderer.settings import RenderSettings
from rhi import Device, refuse

MOST_POINTS: Final = 24
"""The most combinations that are timed in turns: those between the ends are left out evenly."""
MOST_TRIED: Final = 120
"""The most combinations that a search tries."""
_TURNS: Final = 3
"""Turns of a walk between whose processor times a combination's is, when it is tried."""
_MARGIN: Final = 4.0
"""Standard deviations between the mean error of the views of a check and what is expected of others."""
_PLAIN: Final = {"technique.name": "forward", "algorithm": "frustum"}
"""The settings that combinations are drawn with where the settings leave it to trials."""
_ROOM: Final = "shadows.largest_atlas"


@dataclass(frozen=True, slots=True)
class FrontPoint:
    """Settings that were drawn.

    Attributes:
        values: of each knob. settings: those that have them.
        error: the mean difference to the truth in levels of 255, in the view where it is the greatest.
        mean_error: that of all views. milliseconds: the median time of a frame.
        ratio, low, high: to the most accurate settings, with the ends of the 95 % confidence interval.
        is_best: whether no other settings are as accurate and faster.
    """

    values: dict[str, str]
    settings: RenderSettings
    error: float
    mean_error: float
    milliseconds: float
    ratio: float
    low: float
    high: float
    is_best: bool = False


@dataclass(frozen=True, slots=True)
class CheckedChoice:
    """Settings that were chosen, and what they are in other views.

    Attributes:
        point: the settings.
        error: the greatest mean error of a view of the check. expected: what is expected of any view (`expect_error`).
        views: the number of views of the check.
        refused: how many more were chosen before, of which more was expected than the bound.
        held_out_error: the greatest mean error in the views that had no part in the choice.
        held_out_views: how many there were.
        over: the share of the walk's frames that took more than the budget; None without one.
    """

    point: FrontPoint
    error: float
    expected: float
    views: int
    refused: int
    held_out_error: float
    held_out_views: int
    over: float | None = None


def find_choices(scene: Scene, settings: RenderSettings, reports: Iterable[KnobReport]) -> dict[str, KnobReport]:
    """Return the sweeps of the knobs that change a picture of this scene with these settings, by their names."""
    base = make_plain(settings)
    lights = scene.lights
    casts = any(some["casts_shadow"].any() for some in (lights.directional, lights.point, lights.spot))
    found = {}
    for report in reports:
        knob = KNOBS[report.knob]
        matters = all(base.get(path) == value for path, value in knob.within.items() if path != _ROOM)
        lacks = knob.demand is Demand.STEREO or (knob.demand in (Demand.SHADOWS, Demand.RIDGES) and not casts)
        lacks = lacks or (knob.demand is Demand.GLOW and not (scene.glow and len(scene.find_glowing())))
        if report.rows and knob.path and knob.unit is Unit.LEVELS and matters and not lacks:
            found[knob.name] = report
    return found


def make_plain(settings: RenderSettings) -> RenderSettings:
    """Return settings that leave nothing to trials, which would change while they are timed."""
    auto = {path: value for path, value in _PLAIN.items() if settings.get(path) == "auto"}
    return settings.change_all(auto)


def list_steps(reports: Mapping[str, KnobReport]) -> list[dict[str, str]]:
    """Return combinations of values, the most accurate first, each with one more knob at a less accurate value."""
    ladders = {name: _find_ladder(report) for name, report in reports.items()}
    places = dict.fromkeys(ladders, 0)
    steps = [{name: ladder[0][0] for name, ladder in ladders.items()}]
    while True:
        worth = {}
        for name, place in places.items():
            ladder = ladders[name]
            if place + 1 < len(ladder):
                (_, error, ratio), (_, next_error, next_ratio) = ladder[place], ladder[place + 1]
                worth[name] = (1.0 - next_ratio / ratio) / max(next_error - error, 1e-6)
        if not worth:
            return steps
        name = max(worth, key=lambda one: worth[one])
        places[name] += 1
        steps.append({**steps[-1], name: ladders[name][places[name]][0]})


def search(
    ladders: Mapping[str, Sequence[str]],
    start: Iterable[dict[str, str]],
    measure: Callable[[dict[str, str]], tuple[float, float, float]],
    most: int = MOST_TRIED,
) -> list[dict[str, str]]:
    """Return the combinations of values that none of those tried surely beats in error and time, the most accurate
    first.

    Args:
        ladders: the values of each knob, in order. start: combinations to begin with.
        measure: returns the error of a combination, and between which times it takes. most: so many are tried at most.
    """
    found: dict[tuple[str, ...], tuple[float, float, float]] = {}
    best = list[tuple[str, ...]]()
    wanted = [tuple(one[name] for name in ladders) for one in start]
    while wanted and len(found) < most:
        for key in wanted[: most - len(found)]:
            found[key] = measure(dict(zip(ladders, key, strict=True)))
        best, least = [], float("inf")
        for key in sorted(found, key=found.__getitem__):
            if found[key][1] < least:
                best.append(key)
            least = min(least, found[key][2])
        near = dict.fromkeys(other for key in best for other in _list_neighbours(ladders, key))
        wanted = [key for key in near if key not in found]
    return [dict(zip(ladders, key, strict=True)) for key in best]


def _list_neighbours(ladders: Mapping[str, Sequence[str]], key: tuple[str, ...]) -> Iterator[tuple[str, ...]]:
    """Yield the combinations in which one knob has the next value, up or down."""
    for number, ladder in enumerate(ladders.values()):
        place = ladder.index(key[number])
        for other in ladder[max(place - 1, 0) : place + 2]:
            if other != key[number]:
                yield (*key[:number], other, *key[number + 1 :])


def _find_ladder(report: KnobReport) -> list[tuple[str, float, float]]:
    """Return value, error and time of the values that no other value beats in both, the most accurate first."""
    ladder: list[tuple[str, float, float]] = []
    for row in sorted(report.rows, key=lambda row: (row.mean_error, row.processor_ratio)):
        if not ladder or row.processor_ratio < ladder[-1][2]:
            ladder.append((row.value, row.mean_error, row.processor_ratio))
    return ladder


def combine(settings: RenderSettings, values: Mapping[str, str]) -> RenderSettings:
    """Return settings in which knobs have these values."""
    for name, value in values.items():
        knob = KNOBS[name]
        room = max(settings.shadows.largest_atlas, knob.within.get(_ROOM, 0))
        settings = settings.change(_ROOM, room).change(knob.path, knob.values[value])
    return settings


def find_truth(settings: RenderSettings, names: Iterable[str]) -> tuple[RenderSettings, int]:
    """Return the settings that all these knobs together are judged by, and the scale of their picture."""
    knobs: list[Knob] = [KNOBS[name] for name in names]
    best = combine(settings, {knob.name: list(knob.values)[-1] for knob in knobs})
    for knob in knobs:
        best = best.change_all(knob.truth.changes)
    return best, max((knob.truth.scale for knob in knobs), default=1)


class CombinationBench(Bench):
    """Draws combinations of settings, and what all of them are judged by."""

    def __init__(self, device: Device, scene: Scene, situation: Situation, names: Sequence[str]) -> None:
        truth, scale = find_truth(make_plain(situation.settings), names)
        super().__init__(device, scene, situation.size, truth, scale, rays=TRACED.rays if can_judge(scene) else 0)
        self._rounds = range(situation.rounds)
        self._renderers: dict[object, Renderer] = {}
        self._pictures: dict[int, Floats] = {}

    def exchange(self, settings: RenderSettings) -> Renderer:
        """Return a renderer that has settings: one for each way to read textures, which can't be exchanged."""
        renderer = self._renderers.get(settings.textures)
        if renderer is None:
            renderer = self._renderers[settings.textures] = self.open(settings)
        settings.exchange(renderer)
        return renderer

    def compare(self, settings: RenderSettings, frames: Sequence[Shot]) -> list[float]:
        """Return the mean error of each frame."""
        renderer, errors = self.exchange(settings), []
        for frame in frames:
            shown = read_picture(settings.render(renderer, frame))
            if frame.number not in self._pictures:
                self._pictures[frame.number] = self.find_true(frame)
            errors.append(float(np.nanmean(np.abs(shown - self._pictures[frame.number]).max(axis=2))))
        return errors

    def walk(
        self, settings: RenderSettings, frames: Sequence[Shot], turns: int = 1,
        clock: Callable[[], float] = perf_counter,
    ) -> Floats:  # fmt: skip
        """Return the milliseconds (turns, frames) of frames that are drawn one after the other, in each of the `turns`;
        they were drawn once before."""
        renderer, ends = self.exchange(settings), [clock()]
        for frame in (*frames,) * (1 + turns):
            self.draw(renderer, settings, frame)
            ends.append(clock())
        times: Floats = 1e3 * np.diff(ends).reshape(1 + turns, len(frames))[1:]
        return times

    def time(
        self, combinations: Mapping[str, RenderSettings], frames: Sequence[Shot],
        progress: Callable[[range], Iterable[int]],
    ) -> dict[str, tuple[float, float, float, float]]:  # fmt: skip
        """Return the median milliseconds of a frame of each, and its ratio to the first with the interval's ends. The
        eye moves from frame to frame."""
        turn = 0

        def draw(name: str, number: int) -> None:
            settings = combinations[name]
            self.draw(self._renderers[settings.textures], settings, frames[number % len(frames)])

        def exchange(name: str) -> None:
            """Exchange the settings, and draw another view; what this creates isn't timed."""
            nonlocal turn
            self.exchange(combinations[name])
            turn += 1
            draw(name, turn // len(combinations) + 1)

        work: dict[str, Callable[[int], object]] = {name: partial(draw, name) for name in combinations}
        times = alternate(work, progress(self._rounds), 1, exchange)
        base = times[next(iter(combinations))]
        ratios = {name: one.compare_to(base, processor=True) for name, one in times.items()}
        return {
            name: (round(1e3 * times[name].median, 3), round(ratio.median, 4), ratio.low, ratio.high)
            for name, ratio in ratios.items()
        }


def find_front(
    situation: Situation,
    reports: Iterable[KnobReport],
    progress: Callable[[range], Iterable[int]] = lambda rounds: rounds,
) -> list[FrontPoint]:
    """Return the combinations that the search finds the best, the most accurate first."""
    scene = load_scene(situation.scene)
    found = find_choices(scene, situation.settings, reports)
    if not found:
        refuse(rules.NO_KNOBS, "find_front", "no knob that changes its picture")
    base, frames = make_plain(situation.settings), list_views(scene, situation)
    ladders = {name: [row.value for row in report.rows] for name, report in found.items()}
    with (
        rhi.create_device(situation.backend) as device,
        CombinationBench(device, scene, situation, list(found)) as bench,
    ):
        tried = iter(progress(range(MOST_TRIED)))
        lost: dict[tuple[str, ...], list[float]] = {}

        def measure(values: dict[str, str]) -> tuple[float, float, float]:
            next(tried, None)
            settings = combine(base, values)
            errors = lost[tuple(values.values())] = bench.compare(settings, frames)
            times = bench.walk(settings, frames, _TURNS, process_time).mean(axis=1)
            return max(errors), float(times.min()), float(times.max())

        best = search(ladders, list_steps(found), measure)
        places = np.unique(np.linspace(0, len(best) - 1, min(len(best), MOST_POINTS)).round().astype(int)).tolist()
        settings = {str(place): combine(base, best[place]) for place in places}
        errors = {str(place): lost[tuple(best[place].values())] for place in places}
        times = bench.time(settings, frames, progress)
    points = [
        FrontPoint(
            best[int(name)], one, round(max(errors[name]), 4), round(float(np.mean(errors[name])), 4), *times[name]
        )
        for name, one in settings.items()
    ]
    return mark_best(points)


def mark_best(points: Sequence[FrontPoint]) -> list[FrontPoint]:
    """Return the points, of which those are marked that no other point beats in error and time."""
    return [
        replace(
            point,
            is_best=not any(
                other.error <= point.error
                and other.milliseconds <= point.milliseconds
                and (other.error, other.milliseconds) != (point.error, point.milliseconds)
                for other in points
            ),
        )
        for point in points
    ]


def choose(
    situation: Situation,
    points: Sequence[FrontPoint],
    *,
    budget_ms: float | None = None,
    error_at_most: float | None = None,
    views: int = 10,
    held_out: int = 20,
) -> CheckedChoice:
    """Return the fastest settings of the front within an error, the most accurate within a time, or both.

    Args:
        views: the number of views that the error is checked by. They lie between those that the front was found with.
        held_out: the number of views that the result is tried in. They lie between all of those.

    Raises:
        ValidationError `accuracy-out-of-reach`: no settings keep the bounds.
    """
    best = sorted((point for point in points if point.is_best), key=lambda point: point.milliseconds)
    if error_at_most is None:  # a time is tried, so what others beat by noise alone is left out by no one
        best = sorted(points, key=lambda point: (point.error, point.milliseconds))
    fast = [point for point in best if budget_ms is None or _find_least(point) <= budget_ms]
    good = [point for point in fast if error_at_most is None or point.error <= error_at_most]
    bounds = ((budget_ms, "ms"), (error_at_most, "levels"))
    asked = " and ".join(f"{bound:.4g} {unit}" for bound, unit in bounds if bound is not None)
    if not good:
        least, first = min(point.error for point in best), min(map(_find_least, best))
        allowed = f"{first:.4g} ms or more, an error of {least:.4g} levels or more"
        refuse(rules.OUT_OF_REACH, "choose", asked, allowed)
    scene = load_scene(situation.scene)
    found = list_views(scene, situation)
    checks = list_held_out(scene, situation, views, found)
    others = list_held_out(scene, situation, held_out, [*found, *checks])
    names = list(points[0].values)
    with (
        rhi.create_device(situation.backend) as device,
        CombinationBench(device, scene, situation, names) as bench,
    ):
        for refused, point in enumerate(good):
            over = None
            if budget_ms is not None:
                (times,) = bench.walk(point.settings, checks)
                if np.median(times) > budget_ms:
                    found_out = f"{np.median(times):.4g} ms, the median of {len(times)} frames of a walk"
                    continue
                over = float((times > budget_ms).mean())
            errors = bench.compare(point.settings, checks)
            expected = expect_error(errors)
            found_out = f"{expected:.4g} levels or more, expected from the views of the check"
            if error_at_most is None or expected <= error_at_most:
                last = max(bench.compare(point.settings, others))
                return CheckedChoice(point, max(errors), expected, len(checks), refused, last, len(others), over)
    refuse(rules.OUT_OF_REACH, "choose", asked, found_out)


def _find_least(point: FrontPoint) -> float:
    """Return the lower end of the interval of a point's milliseconds."""
    return point.milliseconds * min(point.low / point.ratio, 1.0)


def leave_to_trials(chosen: RenderSettings, given: RenderSettings) -> RenderSettings:
    """Return settings that were chosen, in which trials decide what they decided in those given."""
    auto = {path: "auto" for path, value in _PLAIN.items() if given.get(path) == "auto" and chosen.get(path) == value}
    return chosen.change_all(auto)


def expect_error(errors: Sequence[float]) -> float:
    """Return the error that is expected not to be exceeded in other views: four standard deviations above the mean, or
    the greatest if that is more."""
    if len(errors) < 2:
        return max(errors)
    return max(*errors, float(np.mean(errors) + _MARGIN * np.std(errors, ddof=1)))


def list_held_out(scene: Scene, situation: Situation, count: int, known: Sequence[Shot]) -> list[Shot]:
    """Return frames that are none of `known`, spread over the same part of the path; if it has only one view, that
    one."""
    numbers = {frame.number for frame in known}
    frames = list_views(scene, replace(situation, views=count + len(numbers)))
    others = [frame for frame in frames if frame.number not in numbers]
    return others[:: max(len(others) // count, 1)][:count] or frames
