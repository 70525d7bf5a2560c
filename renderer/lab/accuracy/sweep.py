"""The sweep of a knob: what each of its values loses, and what a frame of it costs.

All values draw the same frames in turn in one process. Errors are found first: each frame of each value is compared
with the truth of the knob. Then frames are timed, alternately, and a value's time is a ratio to that of the most
accurate value in the same round; the median of the rounds' ratios is given with its 95 % confidence interval.

A knob whose frames depend on earlier ones draws consecutive frames of the path, of which the first only make the memory
of the others: a frame that remembers nothing is another case. The others draw frames that are spread over all of it.

A sweep can be divided into shares, for several processes: each has some of the views and some of the rounds, and all
values of the knob, so that it has ratios of its own. Together they have the same views and rounds as one that does all;
nothing is drawn twice but a frame of each value before the first round. Frames that depend on earlier ones aren't
divided: each share would have to draw these again.
"""

from __future__ import annotations

import io
from base64 import b64encode
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import astuple, dataclass, field
from functools import partial
from operator import truediv
from statistics import fmean, median
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray
from PIL import Image

import rhi
from renderer.content import GENERATORS, change_options, find_path, load_scene, parse_camera
from renderer.content.fountains import Fountains
from renderer.lab.accuracy.bench import Bench, can_judge, read_picture
from renderer.lab.accuracy.float64 import ExactPicture, shade_exactly
from renderer.lab.accuracy.knobs import Demand, Knob, Unit, find_knob
from renderer.lab.measure.alternate import Measurement, alternate
from renderer.lab.measure.encodings import ENCODINGS, TURNS, run_round_trip, time_round_trip
from renderer.lab.measure.exact import ExactVisibility
from renderer.lab.measure.frames import settle
from renderer.lab.measure.light_evaluations import count_light_evaluations
from renderer.renderer import FrameResult
from renderer.scene import Camera, CameraPath, Glow, Orthographic, Perspective, Scene, Shot
from renderer.scene.arrays import Floats
from renderer.scene.cloth import Cloths
from renderer.settings import RenderSettings
from renderer.stereo import find_rig
from renderer.visibility import find_obstacle
from rhi import Device

T = TypeVar("T")

_CROP: Final = (112, 63)
"""Width and height of the part of a picture that shows its worst pixel."""
_VALUES: Final = 1 << 14
"""Vectors that an encoding is measured with."""
_TRUTH_ROUNDS: Final = 3
"""The number of times that a truth is timed: it may take many times as long as a value, and isn't chosen by time."""
NO_EFFECT: Final = "no value changes what these views show"
"""The lack of a scene in which all values of a knob have the same errors, so that their times are noise."""
DRAWS_NOTHING: Final = "it draws nothing"
"""The lack of a device that only records."""
_MOST_SHARES: Final = 2
"""The most shares of a sweep. Each opens a device and renderers of all values, so more of them take longer in all."""


@dataclass(frozen=True, slots=True)
class Situation:
    """The scene, device and size of a sweep, small enough to be sent to other machines, which load the scene.

    Attributes:
        scene, camera: their texts. backend: its name, None for the machine's choice.
        size: (width, height) of the image in pixels.
        views: the number of frames that are compared. rounds: the number that are timed.
        settings: those that knobs change.
        first, last: the frames of a path among which views are spread; `last` may be None for its end.
    """

    scene: str
    camera: str = ""
    backend: str | None = None
    size: tuple[int, int] = (480, 270)
    views: int = 3
    rounds: int = 11
    settings: RenderSettings = field(default_factory=RenderSettings)
    first: int = 0
    last: int | None = None


@dataclass(frozen=True, slots=True)
class SweepShare:
    """A part of a sweep, of `count`, of about the same size."""

    number: int = 0
    count: int = 1

    def take(self, items: Sequence[T]) -> Sequence[T]:
        """Return the items of this share, which follow each other."""
        first, last = (place * len(items) // self.count for place in (self.number, self.number + 1))
        return items[first:last]


def list_shares(situation: Situation, name: str) -> list[SweepShare]:
    """Return the shares into which the sweep of a knob is divided: two, or one if frames depend on earlier ones. They
    don't depend on who does them, so that all of them can be kept."""
    knob = find_knob(name, "list_shares")
    is_whole = knob.is_encoding or knob.remembers
    count = 1 if is_whole else min(situation.views, situation.rounds, _MOST_SHARES)
    return [SweepShare(number, count) for number in range(count)]


WHOLE: Final = SweepShare()
"""The share of who does all."""


@dataclass(frozen=True, slots=True)
class ValueSample:
    """The findings of a share of a sweep for a value.

    Attributes:
        sums: of each view that was compared, the sum of the errors, and the number of pixels that count.
        max_error, worst: the greatest error, -1 if nothing was compared, and its frame, x and y. picture: its place, as
            in `KnobReport`.
        seconds, processor_seconds: of each round.
        p99, flicker: as in `ValueRow`. flips: of each view that is a picture, the FLIP error.
    """

    sums: tuple[tuple[float, int], ...]
    max_error: float
    worst: tuple[int, int, int] | None
    picture: str
    seconds: tuple[float, ...]
    processor_seconds: tuple[float, ...]
    p99: float = 0.0
    flicker: float | None = None
    flips: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class KnobSample:
    """The findings of a share of a sweep.

    Attributes:
        left_out: as in `KnobReport`. values: by name, the least accurate first.
        truth_ratios: the time of the truth in that of the most accurate value, round by round.
    """

    knob: str
    backend: str
    device: str
    left_out: dict[str, str] = field(default_factory=dict)
    values: dict[str, ValueSample] = field(default_factory=dict)
    truth_ratios: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class ValueRow:
    """The error and the cost of a knob's value.

    Attributes:
        max_error, mean_error: in the knob's unit: over all pixels of all views with a surface, or over the views.
        worst: the frame, x and y of the pixel with the greatest error, None if there are no pixels to compare.
        milliseconds, processor_milliseconds: median times of a frame, by the clock and of the processor in all threads;
            nanoseconds for each vector, of encodings.
        ratio, low, high: to the most accurate value, by the clock, with the ends of the 95 % confidence interval.
        processor_ratio, processor_low, processor_high: the same by the processor.
        p99: the error that 1 % of a view's pixels exceed, in the view where it is the greatest.
        flicker: the mean change of a pixel's difference to the truth from one frame of a path to the next, in levels;
            None for what isn't judged by pictures, and where the camera stands.
        flip: the mean FLIP error (`find_flip`); None for what isn't judged by pictures.
    """

    knob: str
    value: str
    is_default: bool
    unit: str
    max_error: float
    mean_error: float
    worst: tuple[int, int, int] | None
    milliseconds: float
    ratio: float
    low: float
    high: float
    processor_milliseconds: float
    processor_ratio: float
    processor_low: float
    processor_high: float
    p99: float = 0.0
    flicker: float | None = None
    flip: float | None = None


@dataclass(frozen=True, slots=True)
class KnobReport:
    """The rows of a knob's values, the least accurate first.

    Attributes:
        left_out: why values that the device lacks aren't there, or why there are none at all.
        truth_ratio: the time of the truth in that of the most accurate value, if it is a picture of the renderer.
        pictures: by value, the place of the worst pixel as PNG in base64: the truth, the value, and their difference.
    """

    knob: str
    backend: str
    device: str
    rows: tuple[ValueRow, ...]
    left_out: dict[str, str] = field(default_factory=dict)
    truth_ratio: float | None = None
    pictures: dict[str, str] = field(default_factory=dict)


def sweep_knob(situation: Situation, name: str) -> KnobReport:
    """Measure all values of a knob, on a device of its own."""
    return join_shares([sweep_share(situation, name, WHOLE)])


def sweep_share(situation: Situation, name: str, share: SweepShare) -> KnobSample:
    """Measure a share of a knob's sweep, on a device of its own."""
    knob = find_knob(name, "sweep_share")
    with rhi.create_device(situation.backend) as device:
        found = partial(KnobSample, knob.name, device.backend_name, device.capabilities.device)
        if knob.is_encoding:
            return _sweep_encodings(situation, knob, device, found)
        scene = load_scene(situation.scene)
        lack = prepare_scene(scene, knob) or find_missing_option(situation.scene, knob)
        if lack is not None:
            return found(dict.fromkeys(knob.values, lack))
        left_out = list_left_out(device, situation.settings, knob)
        values = [value for value in knob.values if value not in left_out]
        if not values:
            return found(left_out)
        with KnobBench(device, scene, situation, knob, values, share) as bench:
            bench.draw_history()
            errors = bench.find_errors(bench.list_views())
            times, truth_ratios = bench.time()
        samples = {value: errors[value].sample(times[value]) for value in values}
        return found(left_out, samples, truth_ratios)


def join_shares(samples: Sequence[KnobSample]) -> KnobReport:
    """Return what all shares of a sweep have found together."""
    first = samples[0]
    knob = find_knob(first.knob, "join_shares")
    report = partial(KnobReport, first.knob, first.backend, first.device)
    if not first.values:
        return report((), first.left_out)
    values = {value: _join_samples([sample.values[value] for sample in samples]) for value in first.values}
    if len(values) > 1 and len({(one.sums, one.flicker) for one in values.values()}) == 1:
        return report((), first.left_out | dict.fromkeys(values, NO_EFFECT))
    times = {value: Measurement(value, one.seconds, one.processor_seconds) for value, one in values.items()}
    base = times[list(times)[-1]]
    ratios = [ratio for sample in samples for ratio in sample.truth_ratios]
    return report(
        tuple(_make_row(knob, value, one, times[value], base) for value, one in values.items()),
        first.left_out,
        round(median(ratios), 2) if ratios else None,
        {value: one.picture for value, one in values.items() if one.picture},
    )


def _join_samples(samples: Sequence[ValueSample]) -> ValueSample:
    """Return one sample of all views and rounds."""
    worst = max(samples, key=lambda sample: sample.max_error)  # the first of several
    return ValueSample(
        tuple(view for sample in samples for view in sample.sums),
        worst.max_error,
        worst.worst,
        worst.picture,
        tuple(time for sample in samples for time in sample.seconds),
        tuple(time for sample in samples for time in sample.processor_seconds),
        max(sample.p99 for sample in samples),
        next((sample.flicker for sample in samples if sample.flicker is not None), None),
        tuple(flip for sample in samples for flip in sample.flips),
    )


def prepare_scene(scene: Scene, knob: Knob) -> str | None:
    """Give a scene what the knob needs if it can be given: shadows, glow. Return what it lacks, None for nothing."""
    if knob.unit is Unit.OVERDRAW and scene.height_fields:
        return "the scene has a ground, of which each view has other triangles"
    if knob.truth.is_float64 or knob.truth.rays:
        scene.glow = None  # pixels are compared with their own light
    if knob.truth.rays and not can_judge(scene):
        return "the scene has simulated meshes, which rays don't follow"
    match knob.demand:
        case Demand.SHADOWS:
            scene.lights.cast_shadows()
            has = len(scene.lights.directional) + len(scene.lights.point) + len(scene.lights.spot)
        case Demand.TRANSPARENCY:
            has = len(scene.find_transparent())
        case Demand.IMAGES:
            has = len(scene.textures)
        case Demand.LAMPS:
            has = len(scene.lights.point) + len(scene.lights.spot)
        case Demand.GLOW:
            scene.glow = scene.glow or Glow()
            has = len(scene.find_glowing())
        case Demand.MOTION:
            has = len(scene.simulated)
        case Demand.HISTORY:
            has = len(scene.make_simulator().diverging)
        case Demand.CLOTH:
            has = sum(isinstance(one.simulation, Cloths) for one in scene.simulated)
        case Demand.FOUNTAINS:
            has = sum(isinstance(one.simulation, Fountains) for one in scene.simulated)
        case Demand.HEIGHT_FIELDS | Demand.RIDGES:
            if knob.demand is Demand.RIDGES:
                scene.lights.cast_shadows()
                scene.objects.casts_shadow[list(scene.height_fields)] = True
            has = sum(field.limit == field.count for field in scene.height_fields.values())
        case _:
            return None
    return None if has else f"the scene lacks {knob.demand.value}"


def find_missing_option(scene: str, knob: Knob) -> str | None:
    """Return what a scene's text lacks for a knob: an option, None for nothing."""
    generator = GENERATORS.get(scene.partition(":")[0])
    has = not knob.option or (generator is not None and knob.option in {one.name for one in generator.options})
    return None if has else f"the scene has no option {knob.option}"


def list_left_out(device: Device, settings: RenderSettings, knob: Knob) -> dict[str, str]:
    """Return what the device lacks for values of a knob, by these values."""
    lacks = {value: find_lack(device, knob.set(settings, value)) for value in knob.values}
    return {value: lack for value, lack in lacks.items() if lack is not None}


def find_lack(device: Device, settings: RenderSettings) -> str | None:
    """Return what a device lacks for settings, None for nothing."""
    can = device.capabilities
    if settings.technique.samples not in can.sample_counts:
        return f"the device has no {settings.technique.samples} samples a pixel"
    if settings.textures.anisotropy > can.max_anisotropy:
        return f"the device has no anisotropy of {settings.textures.anisotropy:g}"
    return find_obstacle(settings.algorithm, device) or (None if can.renders else DRAWS_NOTHING)


class ValueErrors:
    """The errors of a value, view by view."""

    def __init__(self, unit: Unit) -> None:
        self._unit = unit
        self._sums: list[tuple[float, int]] = []
        self._greatest = -1.0
        self._p99 = 0.0
        self._flips: list[float] = []
        self.flicker: float | None = None
        self.worst: tuple[int, int, int] | None = None
        self.picture = ""

    def add(self, view: Shot, errors: Floats, pictures: tuple[Floats, Floats] | None) -> None:
        """Add the errors of a view: (h, w), NaN where nothing counts, with the true picture and the value's; or a
        single number."""
        counted = errors[np.isfinite(errors)]
        if not counted.size:
            return
        self._sums.append((float(counted.sum()), counted.size))
        self._p99 = max(self._p99, float(np.percentile(counted, 99.0)))
        if pictures is not None and (flip := find_flip(*pictures)) is not None:
            self._flips.append(flip)
        greatest = float(counted.max())
        if greatest <= self._greatest:
            return
        self._greatest = greatest
        if self._unit.is_per_pixel:
            y, x = (int(i) for i in np.unravel_index(np.nanargmax(errors), errors.shape))
            self.worst = view.number, x, y
            if pictures is not None and greatest >= 1.0:
                self.picture = crop_worst(*pictures, x, y)

    def summarize(self) -> tuple[float, float]:
        """Return the greatest error and the mean one."""
        return max(self._greatest, 0.0), find_mean(self._sums)

    def sample(self, time: Measurement) -> ValueSample:
        """Return the errors, with times."""
        return ValueSample(
            tuple(self._sums), self._greatest, self.worst, self.picture, time.seconds, time.processor_seconds,
            self._p99, self.flicker, tuple(self._flips),
        )  # fmt: skip


def find_mean(sums: Sequence[tuple[float, int]]) -> float:
    """Return the mean error of all views, given the sum of each and what it is a sum of."""
    return sum(total for total, _ in sums) / max(sum(count for _, count in sums), 1)


def _make_row(knob: Knob, value: str, sample: ValueSample, time: Measurement, base: Measurement) -> ValueRow:
    greatest, mean = max(sample.max_error, 0.0), find_mean(sample.sums)
    scale = 1e9 / _VALUES / TURNS if knob.is_encoding else 1e3
    ratios = (
        round(number, 4) for is_processor in (False, True)
        for number in astuple(time.compare_to(base, processor=is_processor))
    )  # fmt: skip
    ratio, low, high, processor_ratio, processor_low, processor_high = ratios
    return ValueRow(
        knob.name, value, value == knob.default, knob.unit.value, float(f"{greatest:.5g}"), float(f"{mean:.5g}"),
        sample.worst, float(f"{scale * time.median:.4g}"), ratio, low, high,
        float(f"{scale * time.processor_median:.4g}"), processor_ratio, processor_low, processor_high,
        float(f"{sample.p99:.5g}"), None if sample.flicker is None else float(f"{sample.flicker:.5g}"),
        float(f"{fmean(sample.flips):.4g}") if sample.flips else None,
    )  # fmt: skip


class KnobBench(Bench):
    """The renderers of all values of a knob, and what judges them."""

    def __init__(
        self, device: Device, scene: Scene, situation: Situation, knob: Knob, values: Sequence[str],
        share: SweepShare = WHOLE,
    ) -> None:  # fmt: skip
        self._knob, self._share = knob, share
        self._rounds = share.take(range(situation.rounds))
        self._history, self._views, self._timed = list_frames(scene, situation, knob, share)
        has_next = self._views and not share.number and not knob.remembers
        self._next = find_next(scene, situation, self._views[0]) if has_next else None
        self._settings = {value: knob.set(situation.settings, value) for value in values}
        best = self._settings[values[-1]]
        rig = None
        if knob.demand is Demand.STEREO:
            width, height = situation.size
            rig = find_rig(scene, best.aim(self._timed[0].camera).with_aspect(width / height))
        super().__init__(device, scene, situation.size, best.change_all(knob.truth.changes), knob.truth.scale, rig,
                         knob.truth.rays)  # fmt: skip
        with ExitStack() as self._opened:  # closed if one of them can't be opened
            scenes = {value: self._load(situation, value) for value in values}
            self._renderers = {value: self.open(one, 1, scenes[value]) for value, one in self._settings.items()}
            if knob.unit is Unit.OVERDRAW:
                self._exact = ExactVisibility(device, scene, situation.size)
                self._opened.callback(self._exact.destroy)
            elif knob.unit is Unit.LEVELS and not knob.truth.is_float64 and not knob.truth.rays:
                known = [value for value, settings in self._settings.items() if settings == self._truth]
                is_known = known and knob.truth.scale == 1
                self._true = self._renderers[known[-1]] if is_known else self.open(self._truth, self._scale)
            self._opened = self._opened.pop_all()

    def _load(self, situation: Situation, value: str) -> Scene | None:
        """Return the scene of a value if it has one of its own."""
        option = self._knob.option
        if not option:
            return None
        scene = load_scene(change_options(situation.scene, f"{option}={self._knob.values[value]}"))
        prepare_scene(scene, self._knob)
        return scene

    @property
    def _has_own_truth(self) -> bool:
        """Whether the truth is a picture, and none of the values'."""
        return self._true is not None and self._true not in self._renderers.values()

    def list_views(self) -> Sequence[Shot]:
        """Return the frames to compare."""
        return self._views

    def draw_history(self) -> None:
        """Draw what frames to compare depend on, if they depend on earlier ones."""
        for view in self._history:
            for value in self._renderers:
                self._render(value, view)
            if self._has_own_truth:
                self.find_true(view)

    def find_errors(self, views: Sequence[Shot]) -> dict[str, ValueErrors]:
        """Return the errors of each value in all views."""
        errors = {value: ValueErrors(self._knob.unit) for value in self._renderers}
        before: dict[str, Floats] = {}
        for view in views:
            for value, (lost, pictures) in self.compare(view):
                errors[value].add(view, lost, pictures)
                if pictures is not None and view is views[0]:
                    before[value] = pictures[1] - pictures[0]
        if before and self._next is not None:
            for value, (_, pictures) in self.compare(self._next):
                if pictures is not None:
                    change = np.abs(pictures[1] - pictures[0] - before[value]).max(axis=2)
                    errors[value].flicker = float(change.mean())
        return errors

    def compare(self, view: Shot) -> Iterator[tuple[str, tuple[Floats, tuple[Floats, Floats] | None]]]:
        """Yield each value with the errors of its frame, and the pictures that they are differences of."""
        match self._knob.unit:
            case Unit.LEVELS:
                yield from self._compare_pictures(view)
                return
            case Unit.DEPTH:
                found = self._compare_depths(view)
            case Unit.LIGHTS:
                found = self._compare_lights(view)
            case _:
                found = self._compare_triangles(view)
        for value, errors in found:
            yield value, (errors, None)

    def _render(self, value: str, view: Shot) -> FrameResult:
        return self._settings[value].render(self._renderers[value], view)

    def _compare_pictures(self, view: Shot) -> Iterator[tuple[str, tuple[Floats, tuple[Floats, Floats] | None]]]:
        # The truth is read before values are drawn: it may be the renderer of one of them.
        if self._knob.truth.is_float64:
            exact = self._shade(view)
            true, counts = exact.levels, exact.objects >= 0
        else:
            true = self.find_true(view)
            counts = np.isfinite(true[..., 0])
        for value, renderer in self._renderers.items():
            if renderer is self._true and self._knob.remembers:
                yield value, (np.zeros(true.shape[:2]), None)  # drawn already: another time would be another frame
                continue
            shown = read_picture(self._render(value, view))
            errors = np.where(counts, np.abs(shown - true).max(axis=2), np.nan)
            yield value, (errors, (np.where(counts[..., None], true, shown), shown))

    def _shade(self, view: Shot) -> ExactPicture:
        value = list(self._renderers)[-1]
        return shade_exactly(self._renderers[value], self._settings[value].aim(view.camera), view.seconds)

    def _compare_depths(self, view: Shot) -> Iterator[tuple[str, Floats]]:
        exact = self._shade(view)
        for value in self._renderers:
            depth = self._render(value, view).depth.read().astype(np.float64)
            away = find_distances(self._settings[value].aim(view.camera), depth)
            errors = np.full(depth.shape, np.nan)
            seen = exact.objects >= 0
            errors[seen] = 1e6 * np.abs(away[seen] / exact.distances[seen] - 1.0)
            yield value, errors

    def _compare_lights(self, view: Shot) -> Iterator[tuple[str, Floats]]:
        exact = self._shade(view)
        seen = exact.positions[exact.objects >= 0]
        needed = count_reached(self.scene, view.camera, seen)
        for value, renderer in self._renderers.items():
            counted = count_light_evaluations(renderer, self._settings[value].aim(view.camera))
            assert counted is not None
            yield value, np.array([(counted - needed) / max(len(seen), 1)])

    def _compare_triangles(self, view: Shot) -> Iterator[tuple[str, Floats]]:
        results = {value: self._render(value, view).statistics.triangles for value in self._renderers}
        rows = np.array(sorted(self._exact.find(self._truth.aim(view.camera))), np.int64)
        seen = self.scene.count_triangles(rows) if len(rows) else 0
        for value, triangles in results.items():
            # Nothing is seen in some views, and a part of nothing is no error.
            yield value, np.array([100.0 * (triangles / seen - 1.0) if seen else np.nan])

    def time(self) -> tuple[dict[str, Measurement], tuple[float, ...]]:
        """Time frames of all values, and of the truth if it is a picture of a renderer of its own; return the latter's
        times in those of the most accurate value."""
        views, rounds, names = self._timed, self._rounds, list(self._renderers)
        start = rounds[0] % len(names)  # another value is the first in each round, in all shares together, too
        work = {name: self._draw_timed(name) for name in names[start:] + names[:start]}
        if self._knob.remembers:
            rounds = range(len(rounds))
        else:
            view = views[(rounds[0] - 1) % len(views)]  # the view before that of the first round
            for name, renderer in self._renderers.items():
                settle(renderer, self._settings[name].aim(view.camera), view.seconds)
        return alternate(work, rounds, 0), self._time_truth(work[names[-1]])

    def _draw_timed(self, name: str) -> Callable[[int], None]:
        """Return what draws the frame of a round with a value."""
        views, renderer, settings = self._timed, self._renderers[name], self._settings[name]
        return lambda number: self.draw(renderer, settings, views[number % len(views)])

    def _time_truth(self, draw_best: Callable[[int], None]) -> tuple[float, ...]:
        """Return the times of the truth in those of the most accurate value, none if it isn't a picture of its own."""
        true, views = self._true, self._timed
        if true is None or not self._has_own_truth:
            return ()
        rounds = self._share.take(range(max(_TRUTH_ROUNDS, self._share.count)))
        work = {"truth": lambda number: self.draw(true, self._truth, views[number % len(views)]), "best": draw_best}
        times = alternate(work, rounds, 0 if self._views else 1)
        return tuple(map(truediv, times["truth"].seconds, times["best"].seconds))


def _name_camera(scene: Scene, situation: Situation) -> str:
    return situation.camera or ("ground" if "ground" in scene.paths else next(iter(scene.views)))


def find_walk(scene: Scene, situation: Situation) -> CameraPath | None:
    """Return the situation's camera path, None if its camera isn't one."""
    text = _name_camera(scene, situation)
    return find_path(text, scene) if text in scene.paths or text.endswith(".json") else None


def find_next(scene: Scene, situation: Situation, shot: Shot) -> Shot | None:
    """Return the frame of the path after another one, None if there is none."""
    path = find_walk(scene, situation)
    return None if path is None or shot.number + 1 >= len(path) else path.shot(shot.number + 1)


def list_views(
    scene: Scene, situation: Situation, *, consecutive: bool = False, count: int | None = None
) -> list[Shot]:
    """Return frames of the situation's camera: consecutive ones from the middle of its path, or spread over all of it.
    A camera that isn't a path has one."""
    path, wanted = find_walk(scene, situation), count or situation.views
    if path is None:
        camera = parse_camera(_name_camera(scene, situation), scene)
        return [Shot(number, camera) for number in range(wanted)] if consecutive else [Shot(0, camera)]
    last = len(path) - 1 if situation.last is None else min(situation.last, len(path) - 1)
    first = min(situation.first, last)
    if consecutive:
        begin = max(first, min((first + last) // 2, last - wanted + 1))
        return [path.shot(number) for number in range(begin, min(begin + wanted, last + 1))]
    places = np.linspace(first, last, wanted + 2)[1:-1]  # not the ends, where there may be nothing to see
    return [path.shot(number) for number in dict.fromkeys(int(place) for place in places)]


def list_frames(
    scene: Scene, situation: Situation, knob: Knob, share: SweepShare
) -> tuple[Sequence[Shot], Sequence[Shot], Sequence[Shot]]:
    """Return the frames of a share that others depend on, those to compare, and those to time."""
    if not knob.remembers:
        views = list_views(scene, situation)
        return [], share.take(views), views
    compared, counted = situation.views, situation.views + situation.rounds
    frames = list_views(scene, situation, consecutive=True, count=knob.remembers + counted)
    first = max(len(frames) - counted, 0)
    counting = frames[first:]
    return frames[:first], counting[:compared], counting[compared:] or counting


def find_distances(camera: Camera, depth: Floats) -> Floats:
    """Return the distances from the plane of the eye that depths lead back to."""
    lens = camera.projection
    assert isinstance(lens, Perspective | Orthographic)
    matrix = lens.matrix
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray((matrix[2, 3] - depth * matrix[3, 3]) / (matrix[2, 2] - depth * matrix[3, 2]))


def count_reached(scene: Scene, camera: Camera, positions: Floats) -> int:
    """Return the number of pairs of a position (k, 3), relative to the eye, and a point or spot light that reaches it:
    in whose range, and in whose cone it is."""
    total = 0
    for lights in (scene.lights.point, scene.lights.spot):
        for light in lights:
            away = positions - (light["position"] - camera.position)
            squares = np.einsum("ij,ij->i", away, away)
            reached = squares <= float(light["range"]) ** 2
            if lights is scene.lights.spot:
                reached &= away @ light["direction"] >= np.cos(float(light["outer"])) * np.sqrt(squares)
            total += int(np.count_nonzero(reached))
    return total


def find_flip(true: Floats, shown: Floats) -> float | None:
    """Return the mean FLIP error of a picture, 0 to 1: how much somebody sees who switches between it and the truth, 67
    pixels a degree (Andersson and others, FLIP: A Difference Evaluator for Alternating Images, 2020). None without
    `flip-evaluator`. Pictures: (h, w, 3), levels of 255."""
    try:
        import flip_evaluator
    except ImportError:
        return None
    pictures = [np.clip(picture / 255.0, 0.0, 1.0).astype(np.float32) for picture in (true, shown)]
    return float(flip_evaluator.evaluate(*pictures, "LDR", applyMagma=False)[1])


def crop_worst(true: Floats, shown: Floats, x: int, y: int) -> str:
    """Return the place around a pixel as PNG in base64: the truth, the value's picture, and four times the
    difference."""
    (width, height), (rows, columns) = _CROP, true.shape[:2]
    left = min(max(x - width // 2, 0), max(columns - width, 0))
    top = min(max(y - height // 2, 0), max(rows - height, 0))
    part = slice(top, top + height), slice(left, left + width)
    difference = np.abs(shown[part] - true[part]).max(axis=2, keepdims=True).repeat(3, axis=2)
    panels: NDArray[Any] = np.concatenate([true[part], shown[part], 4.0 * difference], axis=1)
    file = io.BytesIO()
    Image.fromarray(np.clip(np.round(panels), 0, 255).astype(np.uint8)).save(file, "PNG", optimize=True)
    return b64encode(file.getvalue()).decode()


def _sweep_encodings(situation: Situation, knob: Knob, device: Device, found: Callable[..., KnobSample]) -> KnobSample:
    """Measure encodings: what they lose of random vectors, and the time to store and read one."""
    known = {one.name: one for one in ENCODINGS}
    chosen = {value: known[name] for value, name in knob.values.items()}
    if not device.capabilities.compute or not device.capabilities.renders:
        return found(dict.fromkeys(knob.values, "it computes nothing"))
    errors, work = {}, {}
    for value, one in chosen.items():
        vectors = one.sample(np.random.default_rng(0), _VALUES)
        errors[value] = one.measure(vectors, run_round_trip(device, one.shader, vectors, **one.uniforms))
        work[value] = time_round_trip(device, one.shader, vectors, **one.uniforms)
    times = alternate(work, range(situation.rounds), 2)
    samples = {
        value: ValueSample(
            ((float(error.sum()), error.size),), float(error.max()), None, "", times[value].seconds,
            times[value].processor_seconds, float(np.percentile(error, 99.0)),
        )
        for value, error in errors.items()
    }  # fmt: skip
    return found({}, samples)
