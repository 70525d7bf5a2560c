"""Chooses settings: the fastest within an error, or the most accurate within a time.

Quality settings are combined greedily first. All start at their most accurate value; each step moves the one
whose next value saves the most time for the error that it adds, judging by the sweeps of single settings. But
errors don't add up, and quality settings change what others cost. So these steps only start a Pareto local
search (Paquete, Chiarandini and Stützle 2004): settings are drawn, timed and compared with an image that is
ray-traced with 16 rays a pixel, and around those that no others beat in both, each quality setting is moved
to its next values, until nothing better is near. The rest, the Pareto front, is timed once more, alternately
in one process. If the ray tracer doesn't support the scene, the reference is the renderer's own image:
super-sampled, with fine shadow maps and exact functions.

An error here is what a frame shows standing still and in motion: the mean difference to the reference, plus
the flicker (`compute_flicker`) times a weight. Without flicker, textures without mip levels would win: a
single image of them is nearer to the reference.

A choice from the front is checked with views that weren't used to compute the front, and must be within the
bound there with a margin: the mean of their errors plus four standard deviations. Otherwise the next more
accurate one is taken. Without the margin, every second choice would exceed the bound in as many further
views, since the worst of all of them is as likely there. Four standard deviations above the mean of ten views
are exceeded by none of twenty others in 95 % of cases, if errors are normally distributed. The result is
tried in twenty views that had no part in the choice.

A time is checked likewise: all settings of the front that may be within it by their confidence intervals are
candidates, and the most accurate one is taken whose median frame of a walk through the views of the check is
within it.

Times of two settings may be nearer to each other than noise, and a race of another day may try a combination that
the first one missed. So settings in use may be passed: they are kept as long as they may be within the bounds,
unless others are surely better, and by more than what counts as equal (`_is_surely_better`).

In the end, what the original settings left to trials (`auto`) is left to them again: it saves time, and loses
nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby, pairwise
from statistics import fmean
from time import process_time
from typing import Final

import numpy as np

import rhi
from renderer import rules
from renderer.content import load_scene
from renderer.lab.accuracy.bench import Bench, can_ray_trace, read_image_levels
from renderer.lab.accuracy.image_errors import compute_flicker
from renderer.lab.accuracy.quality_settings import (
    QUALITY_SETTINGS,
    RAY_TRACED,
    ErrorUnit,
    QualitySetting,
    Requirement,
)
from renderer.lab.accuracy.race import MAX_TRIED, SettingsTrial, search
from renderer.lab.accuracy.sweep import (
    FLICKER_WEIGHT,
    SettingReport,
    SweepSetup,
    ValueRow,
    find_next_frame,
    list_views,
)
from renderer.lab.measure.disturbance import Instant
from renderer.lab.measure.measurement import Interval
from renderer.renderer import Renderer
from renderer.scene import PathFrame, Scene
from renderer.scene.arrays import Floats
from renderer.settings import RenderSettings
from rhi import Device, refuse

MAX_POINTS: Final = 24
"""The most combinations that are timed in turns. If there are more, those between the ends are thinned out
evenly."""
_MIN_TIMED_FRAMES: Final = 4
"""The fewest frames that a tried combination is timed with."""
FRONT_PIXELS: Final = 800
"""About how many pixels of a view of the front are traced: all combinations are compared in the same ones."""
_CHECK_PIXELS: Final = 400
"""About how many pixels of a view of a check are traced."""
_ALIKE: Final = 1.05
"""Settings of which one takes at most so many times as long as the other count as equally fast."""
_MARGIN: Final = 4.0
"""Standard deviations between the mean error of a check's views and the error expected elsewhere."""
_BURST: Final = 2
"""Frames that are timed after one that isn't."""
_SETTLED: Final = 0.05
"""A time is known well enough if its 95 % interval is no wider than this fraction of it: `_ALIKE`."""
_MIN_SETTLED_FRAMES: Final = 8
"""Fewer frames say too little about an interval."""
_PLAIN: Final = {"technique.name": "forward", "algorithm": "frustum"}
"""Values for the settings that the original settings leave to trials, while combinations are measured."""
_ATLAS_SETTING: Final = "shadows.max_atlas_size"


@dataclass(frozen=True, slots=True)
class FrameError:
    """The error of a frame in levels.

    Attributes:
        still: the mean difference to the reference.
        flicker: the mean change of that difference to the next frame; 0 if there is none.
        total: `still` plus the weighted `flicker`.
    """

    still: float
    flicker: float
    total: float


@dataclass(frozen=True, slots=True)
class ParetoPoint:
    """Settings that were drawn and timed.

    Attributes:
        values: the value of each quality setting.
        settings: the settings with these values.
        error: the mean difference to the reference in levels of 255, plus the weighted flicker, in the view
            where the sum is the greatest.
        mean_error: the mean difference over all views.
        milliseconds: the median time of a frame.
        ratio, low, high: to the most accurate settings, with the ends of the 95 % confidence interval.
        is_best: whether no other settings are as accurate and faster.
        flicker: the mean over all views, in levels.
        slowdown: how many times as long frames took because other programs had the processors; times are
            corrected by it.
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
    flicker: float = 0.0
    slowdown: float = 1.0


@dataclass(frozen=True, slots=True)
class CheckedChoice:
    """Settings that were chosen, with their errors in other views.

    Attributes:
        point: the settings.
        error: the greatest error of a view of the check; errors are those of `ParetoPoint.error`.
        expected: the error that other views aren't expected to exceed (`expect_error`).
        views: the number of views of the check.
        rejected: how many were tried before, and expected to exceed the bound.
        held_out_error: the greatest error in the views that had no part in the choice, with the mean flicker
            of the check.
        held_out_views: how many there were.
        over_budget: the fraction of the walk's frames that took more than the budget; None without one.
        is_kept: whether they were in use, and others aren't surely better.
    """

    point: ParetoPoint
    error: float
    expected: float
    views: int
    rejected: int
    held_out_error: float
    held_out_views: int
    over_budget: float | None = None
    is_kept: bool = False


def select_effective_reports(
    scene: Scene, settings: RenderSettings, reports: Iterable[SettingReport]
) -> dict[str, SettingReport]:
    """The sweeps of the quality settings that change an image of this scene with these settings, by name."""
    base = make_plain(settings)
    lights = scene.lights
    casts = lights.has_shadows
    effective = {}
    for report in reports:
        setting = QUALITY_SETTINGS[report.setting]
        matters = all(
            base.get(path) == value for path, value in setting.base_settings.items() if path != _ATLAS_SETTING
        )
        lacks = setting.requirement in (Requirement.STEREO, Requirement.HISTORY) or (
            setting.requirement in (Requirement.SHADOWS, Requirement.SHADOW_CASTING_TESSELLATION)
            and not casts
        )
        lacks = lacks or (setting.requirement is Requirement.PENUMBRAS and not lights.has_wide_shadows)
        lacks = lacks or (
            setting.requirement is Requirement.AMBIENT_LIGHT and scene.ambient_occlusion is None
        )
        lacks = lacks or (setting.requirement is Requirement.FOCUS and scene.depth_of_field is None)
        lacks = lacks or (setting.requirement is Requirement.ENVIRONMENT and scene.environment is None)
        lacks = lacks or (
            setting.requirement is Requirement.BLOOM and not (scene.bloom and len(scene.list_emitters()))
        )
        if report.rows and setting.path and setting.unit is ErrorUnit.LEVELS and matters and not lacks:
            effective[setting.name] = report
    return effective


def omit_equal_values(report: SettingReport, values_in_use: str | None = None) -> SettingReport:
    """The sweep without most values that show the same in all views as the value before. Of equal values remain
    the first one, the default or otherwise the last one, and `values_in_use`."""
    rows = list[ValueRow]()
    for _, group in groupby(
        report.rows, key=lambda row: (row.mean_error, row.max_error, row.p99, row.flicker, row.difference)
    ):
        equal = list(group)
        last = next((row for row in equal if row.is_default), equal[-1])
        rows += [row for row in equal if row in (equal[0], last) or row.value == values_in_use]
    return replace(report, rows=tuple(rows))


def make_plain(settings: RenderSettings) -> RenderSettings:
    """Settings without trials, which would change while they are timed."""
    auto = {path: value for path, value in _PLAIN.items() if settings.get(path) == "auto"}
    return settings.change_all(auto)


def list_steps(
    reports: Mapping[str, SettingReport], flicker_weight: float = FLICKER_WEIGHT
) -> list[dict[str, str]]:
    """Combinations of values, the most accurate first; each has one more quality setting at a less accurate
    value."""
    values_by_setting = {
        name: _list_efficient_values(report, flicker_weight) for name, report in reports.items()
    }
    positions = dict.fromkeys(values_by_setting, 0)
    steps = [{name: efficient_values[0][0] for name, efficient_values in values_by_setting.items()}]
    while True:
        worth = {}
        for name, position in positions.items():
            efficient_values = values_by_setting[name]
            if position + 1 < len(efficient_values):
                (_, error, ratio), (_, next_error, next_ratio) = (
                    efficient_values[position],
                    efficient_values[position + 1],
                )
                worth[name] = (1.0 - next_ratio / ratio) / max(next_error - error, 1e-6)
        if not worth:
            return steps
        name = max(worth, key=lambda setting_name: worth[setting_name])
        positions[name] += 1
        steps.append({**steps[-1], name: values_by_setting[name][positions[name]][0]})


def _list_efficient_values(report: SettingReport, flicker_weight: float) -> list[tuple[str, float, float]]:
    """Name, error and time of the values that no other value beats in both, the most accurate first."""
    efficient_values: list[tuple[str, float, float]] = []
    errors = {row.value: row.weigh(flicker_weight) for row in report.rows}
    for row in sorted(report.rows, key=lambda row: (errors[row.value], row.processor_ratio)):
        if not efficient_values or row.processor_ratio < efficient_values[-1][2]:
            efficient_values.append((row.value, errors[row.value], row.processor_ratio))
    return efficient_values


def combine(settings: RenderSettings, values: Mapping[str, str]) -> RenderSettings:
    """Settings with these values of quality settings."""
    for name, value in values.items():
        setting = QUALITY_SETTINGS[name]
        room = max(settings.shadows.max_atlas_size, setting.base_settings.get(_ATLAS_SETTING, 0))
        settings = settings.change(_ATLAS_SETTING, room).change(setting.path, setting.values[value])
    return settings


def combine_references(settings: RenderSettings, names: Iterable[str]) -> tuple[RenderSettings, int]:
    """The settings and the scale of the reference for several quality settings together."""
    quality_settings: list[QualitySetting] = [QUALITY_SETTINGS[name] for name in names]
    best = combine(settings, {setting.name: list(setting.values)[-1] for setting in quality_settings})
    for setting in quality_settings:
        best = best.change_all(setting.reference.changes)
    return best, max((setting.reference.scale for setting in quality_settings), default=1)


class CombinationBench(Bench):
    """Draws combinations of settings, and the reference that they are compared with.

    Attributes:
        references: the references drawn so far, by the numbers of their frames.
        frames_drawn: the number of frames drawn so far, without references.
    """

    def __init__(
        self,
        device: Device,
        scene: Scene,
        setup: SweepSetup,
        names: Sequence[str],
        traced_pixels: int = FRONT_PIXELS,
    ) -> None:
        reference, scale = combine_references(make_plain(setup.settings), names)
        super().__init__(
            device,
            scene,
            setup.size,
            reference,
            scale,
            rays=RAY_TRACED.rays if can_ray_trace(scene) else 0,
            traced_pixels=traced_pixels,
        )
        self._setup, self._weight = setup, setup.flicker_weight
        self._rounds = range(setup.rounds)
        self._renderers: dict[object, Renderer] = {}
        self.references: dict[int, Floats] = {}
        self.frames_drawn = 0

    def exchange(self, settings: RenderSettings) -> Renderer:
        """A renderer with these settings. There is one for each kind of texture access, which can't
        change."""
        renderer = self._renderers.get(settings.textures)
        if renderer is None:
            renderer = self._renderers[settings.textures] = self.open(settings)
        settings.apply_to(renderer)
        return renderer

    def compare(
        self, settings: RenderSettings, frames: Sequence[PathFrame], *, has_flicker: bool = True
    ) -> list[FrameError]:
        """The errors of each frame, with `has_flicker` also of its change to the next frame of the path."""
        return [error for error, _ in self.draw_views(settings, frames, has_flicker=has_flicker)]

    def draw_views(
        self, settings: RenderSettings, frames: Sequence[PathFrame], *, has_flicker: bool = True
    ) -> Iterator[tuple[FrameError, list[float]]]:
        """Yield the error of each frame, and the seconds of processor time of all that was drawn for it."""
        renderer = self.exchange(settings)
        for frame in frames:
            following = None
            if has_flicker and self._weight > 0.0:
                following = find_next_frame(self.scene, self._setup, frame)
            seconds: list[float] = []
            lost = self._subtract_reference(renderer, settings, frame, seconds)
            flicker = 0.0
            if following is not None:
                next_lost = self._subtract_reference(renderer, settings, following, seconds)
                flicker = compute_flicker(lost, next_lost)
            still = float(np.nanmean(np.abs(lost).max(axis=2)))
            yield FrameError(still, flicker, still + self._weight * flicker), seconds

    def measure_pixels(self, settings: RenderSettings, frames: Sequence[PathFrame]) -> Floats:
        """The errors of all traced pixels of the frames, in levels."""
        renderer = self.exchange(settings)
        errors = [
            np.abs(self._subtract_reference(renderer, settings, frame, [])).max(axis=2) for frame in frames
        ]
        pixels = np.concatenate(errors).reshape(-1)
        return np.asarray(pixels[np.isfinite(pixels)])

    def try_combination(
        self,
        values: dict[str, str],
        settings: RenderSettings,
        frames: Sequence[PathFrame],
        is_beaten: Callable[[SettingsTrial], bool] = lambda trial: False,
    ) -> tuple[SettingsTrial, list[FrameError]]:
        """Draw a combination view by view until it is beaten, and return its errors of the views so far."""
        self.draw(self.exchange(settings), settings, frames[-1])  # creates what the settings need
        errors: list[FrameError] = []
        seconds: list[float] = []
        repeats = -(-_MIN_TIMED_FRAMES // len(frames))  # if there are few, as of a camera that stands
        for frame, (error, frame_seconds) in zip(frames, self.draw_views(settings, frames), strict=True):
            errors.append(error)
            seconds += frame_seconds
            while len(seconds) < len(errors) * repeats:
                began = process_time()
                self.draw(self.exchange(settings), settings, frame)
                seconds.append(process_time() - began)
            totals = tuple(frame_error.total for frame_error in errors)
            trial = SettingsTrial(values, totals, np.array(seconds), len(errors) == len(frames))
            if is_beaten(trial):
                return replace(trial, is_complete=False), errors
        return trial, errors

    def _subtract_reference(
        self, renderer: Renderer, settings: RenderSettings, frame: PathFrame, seconds: list[float]
    ) -> Floats:
        """The image of a frame minus its reference (h, w, 3), in levels. Appends the processor time of drawing
        it to `seconds`."""
        began = process_time()
        result = settings.render(renderer, frame)
        self.device.finish()
        seconds.append(process_time() - began)
        self.frames_drawn += 1
        levels = read_image_levels(result)
        if frame.number not in self.references:
            self.references[frame.number] = self.render_reference(frame)
        return levels - self.references[frame.number]

    def draw(self, renderer: Renderer, settings: RenderSettings, path_frame: PathFrame) -> None:
        """Draw a frame, and wait for the device."""
        self.frames_drawn += 1
        super().draw(renderer, settings, path_frame)

    def walk(self, settings: RenderSettings, frames: Sequence[PathFrame]) -> list[Instant]:
        """The times of frames drawn one after the other. They are drawn once beforehand."""
        renderer, instants = self.exchange(settings), list[Instant]()
        for frame in (*frames, *frames):
            self.draw(renderer, settings, frame)
            instants.append(Instant.now())
        ends = instants[len(frames) - 1 :]
        return [end - begin for begin, end in pairwise(ends)]

    def compare_times(
        self, settings: RenderSettings, other: RenderSettings, frames: Sequence[PathFrame]
    ) -> Interval:
        """The ratio of processor times of the frames of two walks, each of them walked twice in turn."""
        walks = [self.walk(walked, frames) for walked in (settings, other, other, settings)]
        first, second, third, fourth = (
            np.array([instant.processor for instant in instants]) for instants in walks
        )
        return Interval.of(np.concatenate([first / second, fourth / third]))

    def time(
        self,
        trials: Sequence[SettingsTrial],
        combinations: Sequence[RenderSettings],
        frames: Sequence[PathFrame],
        progress: Callable[[range], Iterable[int]],
    ) -> list[list[Instant]]:
        """The times of each combination in turn, round by round; the camera moves from frame to frame. A
        combination has no further rounds once a more accurate one surely beats it, or its ratio to the first
        one's times is known to `_SETTLED`.

        Args:
            trials: of the combinations, the most accurate first; what they took in the search counts, too.
        """
        times: list[list[Instant]] = [[] for _ in combinations]
        active, turn = list(range(len(combinations))), 0
        for number in progress(self._rounds[::_BURST]):
            start = number % len(active)
            for position in active[start:] + active[:start]:
                settings = combinations[position]
                renderer = self.exchange(settings)
                turn += 1  # another view is drawn first; what the exchange creates isn't timed
                self.draw(renderer, settings, frames[(turn // len(combinations) + 1) % len(frames)])
                for timed in self._rounds[number : number + _BURST]:
                    began = Instant.now()
                    self.draw(renderer, settings, frames[timed % len(frames)])
                    times[position].append(Instant.now() - began)
            timed_trials = [
                replace(trial, seconds=np.append(trial.seconds, [instant.processor for instant in series]))
                for trial, series in zip(trials, times, strict=True)
            ]
            active = [
                position
                for position in active
                if position == 0
                or not (
                    _is_settled(timed_trials[position].seconds, timed_trials[0].seconds)
                    or any(
                        timed_trials[other].beats(timed_trials[position])
                        for other in active
                        if other < position
                    )
                )
            ]
            if active == [0] and len(combinations) > 1:
                break
        return times


def _is_settled(seconds: Floats, first: Floats) -> bool:
    """True if the median ratio of times to those of the same frames of the first combination is known to
    `_SETTLED`."""
    if len(seconds) < _MIN_SETTLED_FRAMES:
        return False
    ratio = Interval.of(seconds / first[: len(seconds)])
    return ratio.high - ratio.low <= _SETTLED * ratio.median


def compute_pareto_front(
    setup: SweepSetup,
    reports: Iterable[SettingReport],
    progress: Callable[[range], Iterable[int]] = lambda rounds: rounds,
    *,
    races: bool = True,
    values_in_use: Mapping[str, str] | None = None,
) -> list[ParetoPoint]:
    """Search the best combinations of quality settings, and return them with errors and times, the most
    accurate first. Without `races` each combination is drawn in all views. The combination `values_in_use`, if any, is
    among them though others beat it.

    Raises:
        ValidationError `accuracy-no-settings`: no quality setting changes an image.
        ValidationError `accuracy-other-settings`: `values_in_use` has other settings or values.
    """
    scene = load_scene(setup.scene)
    effective = select_effective_reports(scene, setup.settings, reports)
    if not effective:
        refuse(rules.NO_QUALITY_SETTINGS, "compute_pareto_front", "no quality setting that changes its image")
    check_values_in_use(values_in_use, effective)
    effective = {
        name: omit_equal_values(report, (values_in_use or {}).get(name)) for name, report in effective.items()
    }
    base, frames = make_plain(setup.settings), list_views(scene, setup)
    values_by_setting = {name: [row.value for row in report.rows] for name, report in effective.items()}
    with (
        rhi.create_device(setup.backend) as device,
        CombinationBench(device, scene, setup, list(effective)) as bench,
    ):
        tried = iter(progress(range(MAX_TRIED)))
        views = list(frames)
        lost: dict[tuple[str, ...], list[FrameError]] = {}

        def measure(values: dict[str, str], front: Sequence[SettingsTrial]) -> SettingsTrial:
            next(tried, None)
            trial, errors = bench.try_combination(
                values,
                combine(base, values),
                views,
                lambda trial: races and any(other.beats(trial) for other in front),
            )
            if not lost and len(trial.seconds) % len(views) == 0:  # the worst view is the first from now on
                order = sorted(range(len(views)), key=lambda view: -errors[view].total)
                views[:] = [views[view] for view in order]
                errors = [errors[view] for view in order]
                seconds = trial.seconds.reshape(len(views), -1)[order].reshape(-1)
                trial = replace(trial, errors=tuple(error.total for error in errors), seconds=seconds)
            lost[tuple(values.values())] = errors
            return trial

        best = search(values_by_setting, list_steps(effective, setup.flicker_weight), measure)
        positions = np.unique(
            np.linspace(0, len(best) - 1, min(len(best), MAX_POINTS)).round().astype(int)
        ).tolist()
        trials = [best[position] for position in positions]
        if values_in_use is not None and all(trial.values != values_in_use for trial in trials):
            # In the order of the others, whose keys are the values alone.
            trials.append(measure({name: values_in_use[name] for name in values_by_setting}, []))
            trials.sort(key=lambda trial: trial.rank)
        settings = [combine(base, trial.values) for trial in trials]
        times = bench.time(trials, settings, frames, progress)
    points = []
    for trial, point_settings, series in zip(trials, settings, times, strict=True):
        errors = lost[tuple(trial.values.values())]
        # Frames of the search count, too: all combinations have drawn the same ones.
        own, first = (
            np.concatenate([each.seconds, [instant.processor for instant in timed[: len(series)]]])
            for each, timed in ((trial, series), (trials[0], times[0]))
        )
        ratio = Interval.of(own / first)
        points.append(
            ParetoPoint(
                trial.values,
                point_settings,
                round(trial.error, 4),
                round(fmean(error.still for error in errors), 4),
                round(1e3 * float(np.median([instant.undisturbed for instant in series])), 3),
                round(ratio.median, 4),
                ratio.low,
                ratio.high,
                flicker=round(fmean(error.flicker for error in errors), 4),
                slowdown=round(float(np.median([instant.slowdown for instant in series])), 3),
            )
        )
    return mark_best(points)


def check_values_in_use(
    values_in_use: Mapping[str, str] | None, reports: Mapping[str, SettingReport]
) -> None:
    """Refuse a combination that isn't one of the values that were swept."""
    if values_in_use is None:
        return
    values = {name: [row.value for row in report.rows] for name, report in reports.items()}
    if set(values_in_use) != set(values) or any(values_in_use[name] not in values[name] for name in values):
        actual = ", ".join(f"{name} {value}" for name, value in values_in_use.items()) or "no values"
        refuse(
            rules.OTHER_SETTINGS,
            "compute_pareto_front(values_in_use=...)",
            actual,
            f"a value of each of {values}",
        )


def mark_best(points: Sequence[ParetoPoint]) -> list[ParetoPoint]:
    """The points, with `is_best` where no other point beats them in error and time."""
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


@dataclass(frozen=True, slots=True)
class _CheckResult:
    """The errors of settings in the views of a check, the milliseconds of a walk through them, and the number
    of views: errors may be of the first ones alone."""

    errors: tuple[FrameError, ...]
    times: Floats
    views: int

    @property
    def totals(self) -> list[float]:
        return [error.total for error in self.errors]

    def find_fault(self, budget_ms: float | None, max_error: float | None, *, has_doubt: bool) -> str | None:
        """The bound that settings break; None if they break none. With `has_doubt` a time counts
        only if it surely is longer."""
        if budget_ms is not None:
            median_time = float(np.median(self.times))
            if (Interval.of(self.times).low if has_doubt else median_time) > budget_ms:
                return f"{median_time:.4g} ms, the median of {len(self.times)} frames of a walk"
        if max_error is not None and (expected := expect_least(self.totals, self.views)) > max_error:
            return f"{expected:.4g} levels or more, expected from the views of the check"
        return None


def _check(
    bench: CombinationBench,
    settings: RenderSettings,
    frames: Sequence[PathFrame],
    budget_ms: float | None,
    max_error: float | None,
    *,
    has_doubt: bool = False,
) -> _CheckResult:
    """Walk through frames if there is a bound on the time, and compare them until a bound is surely broken."""
    times = np.zeros(0)
    if budget_ms is not None:
        times = np.array([1e3 * instant.undisturbed for instant in bench.walk(settings, frames)])
        result = _CheckResult((), times, len(frames))
        if result.find_fault(budget_ms, None, has_doubt=has_doubt) is not None:
            return result
    errors = list[FrameError]()
    for error, _ in bench.draw_views(settings, frames):
        errors.append(error)
        if max_error is not None and expect_least([each.total for each in errors], len(frames)) > max_error:
            break  # whatever the other views show
    return _CheckResult(tuple(errors), times, len(frames))


def choose(
    setup: SweepSetup,
    points: Sequence[ParetoPoint],
    *,
    budget_ms: float | None = None,
    max_error: float | None = None,
    views: int = 10,
    held_out: int = 20,
    values_in_use: Mapping[str, str] | None = None,
) -> CheckedChoice:
    """Choose the fastest settings of the front within an error, or the most accurate within a time, or both.

    Args:
        views: the number of views that check the error. They lie between the front's views.
        held_out: the number of views that the result is tried in. They lie between all the others.
        values_in_use: the values of settings in use. They remain if they may be within the bounds, unless others are
            better by more than what was measured is uncertain.

    Raises:
        ValidationError `accuracy-out-of-reach`: no settings keep the bounds.
    """
    # Times are checked again, so points that lose by noise alone remain.
    best = sorted(points, key=lambda point: (point.error, point.milliseconds))
    fast = [point for point in best if budget_ms is None or _min_milliseconds(point) <= budget_ms]
    good = [point for point in fast if max_error is None or point.error <= max_error]
    if budget_ms is None:
        good = order_by_speed(good)
    in_use = next(
        (point for point in best if values_in_use is not None and point.values == values_in_use), None
    )
    bounds = ((budget_ms, "ms"), (max_error, "levels"))
    bounds_text = " and ".join(f"{bound:.4g} {unit}" for bound, unit in bounds if bound is not None)
    if not good and in_use is None:
        least, first = min(point.error for point in best), min(map(_min_milliseconds, best))
        allowed = f"{first:.4g} ms or more, an error of {least:.4g} levels or more"
        refuse(rules.OUT_OF_REACH, "choose", bounds_text, allowed)
    scene = load_scene(setup.scene)
    front_views = list_views(scene, setup)
    checks = list_held_out(scene, setup, views, front_views)
    others = list_held_out(scene, setup, held_out, [*front_views, *checks])
    names = list(points[0].values)
    with (
        rhi.create_device(setup.backend) as device,
        CombinationBench(device, scene, setup, names, _CHECK_PIXELS) as bench,
    ):
        selection: tuple[ParetoPoint, _CheckResult] | None = None
        rejected, found_out = 0, "no settings that may be within them"
        for point in good:
            checked = _check(bench, point.settings, checks, budget_ms, max_error)
            fault = checked.find_fault(budget_ms, max_error, has_doubt=False)
            if fault is None:
                selection = point, checked
                break
            if checked.errors:  # the next settings are likely to fail by the same views, too
                checks = _order_by_spread(checks, checked.totals)
            rejected, found_out = rejected + 1, fault
        if in_use is not None and (selection is None or selection[0] is not in_use):
            own = _check(bench, in_use.settings, checks, budget_ms, max_error, has_doubt=True)
            fault = own.find_fault(budget_ms, max_error, has_doubt=True)
            if fault is None and (
                selection is None or not _is_surely_better(bench, selection, (in_use, own), checks, budget_ms)
            ):
                selection = in_use, own
        if selection is None:
            refuse(rules.OUT_OF_REACH, "choose", bounds_text, found_out)
        point, checked = selection
        motion = setup.flicker_weight * fmean(error.flicker for error in checked.errors)
        stills = bench.compare(point.settings, others, has_flicker=False)
    return CheckedChoice(
        point,
        max(checked.totals),
        expect_error(checked.totals),
        len(checked.errors),
        rejected,
        max(error.still for error in stills) + motion,
        len(others),
        None if budget_ms is None else float((checked.times > budget_ms).mean()),
        point is in_use,
    )


def _is_surely_better(
    bench: CombinationBench,
    other: tuple[ParetoPoint, _CheckResult],
    in_use: tuple[ParetoPoint, _CheckResult],
    frames: Sequence[PathFrame],
    budget_ms: float | None,
) -> bool:
    """True if other settings are surely better than those in use, by more than `_ALIKE`: faster, or with a bound
    on the time surely within it and more accurate in the same views. Surely means at both ends of the 95 %
    intervals of what was measured. A smaller gain may be a matter of which combinations a race has tried."""
    (point, checked), (used, own) = other, in_use
    if budget_ms is None:
        return bench.compare_times(point.settings, used.settings, frames).high < 1.0 / _ALIKE
    ratios = np.array(checked.totals) / np.maximum(own.totals, 1e-9)
    return Interval.of(checked.times).high <= budget_ms and Interval.of(ratios).high < 1.0 / _ALIKE


def order_by_speed(points: Iterable[ParetoPoint]) -> list[ParetoPoint]:
    """The points, the fastest first. Among those that are equally fast the most accurate one is first, so that
    noise hardly changes the order."""
    remaining, ordered = sorted(points, key=lambda point: point.ratio), list[ParetoPoint]()
    while remaining:
        alike = [point for point in remaining if point.ratio <= _ALIKE * remaining[0].ratio]
        ordered.append(min(alike, key=lambda point: (point.error, point.ratio)))
        remaining.remove(ordered[-1])
    return ordered


def _min_milliseconds(point: ParetoPoint) -> float:
    """The lower end of the confidence interval of a point's milliseconds."""
    return point.milliseconds * min(point.low / point.ratio, 1.0)


def leave_to_trials(settings: RenderSettings, original: RenderSettings) -> RenderSettings:
    """The chosen settings, with `auto` again wherever the original settings had it."""
    auto = {
        path: "auto"
        for path, value in _PLAIN.items()
        if original.get(path) == "auto" and settings.get(path) == value
    }
    return settings.change_all(auto)


def expect_error(errors: Sequence[float]) -> float:
    """The error that other views are not expected to exceed: four standard deviations above the mean, or the
    greatest error if that is more."""
    if len(errors) < 2:
        return max(errors)
    return max(*errors, float(np.mean(errors) + _MARGIN * np.std(errors, ddof=1)))


def expect_least(errors: Sequence[float], count: int) -> float:
    """The least that `expect_error` can be of `count` errors of which these are the first.

    Mean plus deviations is convex and the same for any order of the other errors, so it is least where they are
    equal: `x` above the mean of the first ones, or 0.
    """
    first, others = len(errors), count - len(errors)
    if others <= 0 or count < 2:
        return expect_error(errors)
    mean = float(np.mean(errors))
    squares = float(np.sum((np.asarray(errors) - mean) ** 2))
    weight, share = first * others / count, others / count
    # The derivative by x is 0 at this distance below the mean.
    slope = share**2 * (count - 1)
    steepness = _MARGIN**2 * weight**2 - slope * weight
    x = mean - np.sqrt(slope * squares / steepness) if steepness > 0.0 else 0.0
    rest = max(float(x), 0.0)
    deviation = np.sqrt((squares + weight * (rest - mean) ** 2) / (count - 1))
    return max(*errors, mean + share * (rest - mean) + _MARGIN * float(deviation), 0.0)


def _order_by_spread(frames: Sequence[PathFrame], errors: Sequence[float]) -> list[PathFrame]:
    """The frames, of which the first ones have these errors: first the worst one, then the best, the second
    worst and so on. In this order few of them show that errors differ too much."""
    ascending = np.argsort(errors, kind="stable").tolist()
    order = [ascending.pop(0 if number % 2 else -1) for number in range(len(errors))]
    return [frames[number] for number in order] + list(frames[len(errors) :])


def list_held_out(
    scene: Scene, setup: SweepSetup, count: int, excluded: Sequence[PathFrame]
) -> list[PathFrame]:
    """Frames that aren't in `excluded`, spread over the same part of the path; if it has only one view, that
    one."""
    numbers = {frame.number for frame in excluded}
    frames = list_views(scene, replace(setup, views=count + len(numbers)))
    others = [frame for frame in frames if frame.number not in numbers]
    return others[:: max(len(others) // count, 1)][:count] or frames
