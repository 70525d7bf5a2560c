"""The sweep of a quality setting: the error of each of its values, and the time of a frame.

All values draw the same frames in turn in one process. Errors are measured first: each frame of each value is
compared with the setting's reference. Then frames are timed, alternately, and a value's time is divided by
that of the most accurate value in the same round; the median of the rounds' ratios has a 95 % confidence
interval.

If frames of a quality setting depend on earlier ones, consecutive frames of the path are drawn, and the first
of them only build up the history of the others: a frame without history is another case. For all others,
frames are spread over the whole path.

A sweep can be divided into shards, for several processes: each has some of the views and some of the rounds,
and all values, so that it has ratios of its own. Together they have the same views and rounds as an undivided
sweep; only a frame of each value before the first round is drawn twice. Frames that depend on earlier ones
aren't divided: each shard would have to draw these again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import astuple, dataclass, field
from functools import partial
from importlib.util import find_spec
from operator import truediv
from statistics import fmean, median
from time import perf_counter, process_time
from typing import Final, TypeVar

import numpy as np

import rhi
from renderer.content import GENERATORS, change_options, load_scene, parse_camera, parse_camera_path
from renderer.content.fountains import FountainSimulation
from renderer.content.skies import paint_sky
from renderer.inspection.frame_cost import settle
from renderer.lab.accuracy.bench import TRACED_PIXELS, Bench, can_ray_trace, read_image_levels
from renderer.lab.accuracy.float64 import Float64Image, shade_in_float64
from renderer.lab.accuracy.image_errors import (
    compute_flicker,
    compute_flip_error,
    count_reached,
    crop_worst_region,
    distances_from_depth,
)
from renderer.lab.accuracy.quality_settings import (
    ErrorUnit,
    QualitySetting,
    Requirement,
    lookup_quality_setting,
)
from renderer.lab.measure.encoding_errors import ENCODINGS, ROUND_TRIPS, run_round_trip, time_round_trip
from renderer.lab.measure.exact_visibility import ExactVisibility
from renderer.lab.measure.light_evaluations import count_light_evaluations
from renderer.lab.measure.measurement import Measurement, alternate
from renderer.renderer import FrameResult
from renderer.scene import (
    AmbientOcclusion,
    Bloom,
    CameraPath,
    Compression,
    DepthOfField,
    Environment,
    PathFrame,
    Scene,
)
from renderer.scene.arrays import Floats
from renderer.scene.cloth import ClothSimulation
from renderer.settings import RenderSettings
from renderer.stereo import compute_rig
from renderer.visibility import find_missing_feature
from rhi import CompressedFormat, Device

T = TypeVar("T")

_VALUES: Final = 1 << 14
"""The number of vectors that an encoding is measured with."""
_REFERENCE_ROUNDS: Final = 3
"""The number of times that a reference is timed. It may take many times as long as a value, and its time
decides nothing."""
NO_EFFECT: Final = "no value changes what these views show"
"""Why a quality setting is left out: all its values have the same errors, so that their times are noise."""
DRAWS_NOTHING: Final = "it draws nothing"
"""Why a device that only records is left out."""
FLICKER_WEIGHT: Final = 4.0
"""The levels of a still error that weigh as much as a level of flicker, by default."""
_MAX_SHARDS: Final = 2
"""The most shards of a sweep. Each opens a device and renderers of all values, so more shards take longer
altogether."""


@dataclass(frozen=True, slots=True)
class SweepSetup:
    """The scene, device and size of a sweep. Small enough to be sent to other machines, which load the scene.

    Attributes:
        scene, camera: their texts.
        backend: its name, None for the machine's choice.
        size: (width, height) of the image in pixels.
        views: the number of frames that are compared.
        rounds: the number that are timed.
        settings: the settings that quality settings change.
        first, last: the frames of a path among which views are spread; `last` may be None for its end.
        flicker_weight: how many levels of error a level of flicker counts for when settings are chosen.
        traced_pixels: about how many pixels of an image are ray-traced.
        begins_choice: whether combinations of the values are timed afterwards. Then images are compared of the scene
            as it is, without shadows, bloom or ambient occlusion that it lacks, and no further frames are timed.
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
    flicker_weight: float = FLICKER_WEIGHT
    traced_pixels: int = TRACED_PIXELS
    begins_choice: bool = False


@dataclass(frozen=True, slots=True)
class SweepShard:
    """Shard `number` of `count` shards of about the same size."""

    number: int = 0
    count: int = 1

    def take(self, items: Sequence[T]) -> Sequence[T]:
        """The consecutive items of this shard."""
        first, last = (
            shard_number * len(items) // self.count for shard_number in (self.number, self.number + 1)
        )
        return items[first:last]


SUN_DIAMETER: Final = 0.0093
"""The angle in radians that the sun fills."""
APERTURE_RADIUS: Final = 0.1
"""The radius in metres of the aperture of scenes that have none."""


def list_shards(setup: SweepSetup, name: str) -> list[SweepShard]:
    """The shards of a quality setting's sweep: two, or one if frames depend on earlier ones. They are the
    same on every machine, so that their results can be stored."""
    setting = lookup_quality_setting(name, "list_shards")
    is_whole = setting.is_encoding or setting.history_frames
    count = 1 if is_whole else min(setup.views, setup.rounds, _MAX_SHARDS)
    return [SweepShard(number, count) for number in range(count)]


WHOLE_SWEEP: Final = SweepShard()
"""The single shard of an undivided sweep."""


@dataclass(frozen=True, slots=True)
class ValueSample:
    """The measurements of a value in one shard of a sweep.

    Attributes:
        sums: of each view that was compared, the sum of the errors, and the number of pixels that count.
        max_error, worst: the greatest error, -1 if nothing was compared, and its frame, x and y.
        image: a crop there, as in `SettingReport`.
        seconds, processor_seconds: of each round.
        p99, flicker: as in `ValueRow`.
        flips: the FLIP error of each view that is compared by images.
        differences: as in `ValueRow`, of each view that is compared by images.
    """

    sums: tuple[tuple[float, int], ...]
    max_error: float
    worst: tuple[int, int, int] | None
    image: str
    seconds: tuple[float, ...]
    processor_seconds: tuple[float, ...]
    p99: float = 0.0
    flicker: float | None = None
    flips: tuple[float, ...] = ()
    differences: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class SettingSample:
    """The measurements of one shard of a sweep.

    Attributes:
        left_out: as in `SettingReport`.
        values: by name, the least accurate first.
        reference_ratios: the reference's time divided by the most accurate value's, round by round.
    """

    setting: str
    backend: str
    device: str
    left_out: dict[str, str] = field(default_factory=dict)
    values: dict[str, ValueSample] = field(default_factory=dict)
    reference_ratios: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class ValueRow:
    """The error and the time of a quality setting's value.

    Attributes:
        max_error, mean_error: in the setting's unit: over all pixels of all views with a surface, or over the
            views.
        worst: the frame, x and y of the pixel with the greatest error, None if there are no pixels to
            compare.
        milliseconds, processor_milliseconds: median times of a frame, by the clock and of the processor in
            all threads; nanoseconds for each vector, of encodings.
        ratio, low, high: to the most accurate value, by the clock, with the ends of the 95 % confidence
            interval.
        processor_ratio, processor_low, processor_high: the same by the processor.
        p99: the error that 1 % of a view's pixels exceed, in the view where it is the greatest.
        flicker: the mean change of a pixel's difference to the reference from one frame of a path to the
            next, in levels; None if images aren't compared, and where the camera stands.
        flip: the mean FLIP error (`compute_flip_error`); None if images aren't compared.
        difference: the mean difference to the image of the most accurate value, in levels: what this setting
            loses, apart from the errors of all others; None if images aren't compared.
    """

    setting: str
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
    difference: float | None = None

    def weigh(self, flicker_weight: float) -> float:
        """The mean error plus the weighted flicker."""
        return self.mean_error + flicker_weight * (self.flicker or 0.0)


@dataclass(frozen=True, slots=True)
class SettingReport:
    """The rows of a quality setting's values, the least accurate first.

    Attributes:
        left_out: for each value without a row, why it is left out.
        reference_ratio: the reference's time divided by the most accurate value's, if the renderer draws the
            reference.
        images: by value, a crop around the worst pixel as PNG in base64: the reference, the value's image,
            and their difference.
    """

    setting: str
    backend: str
    device: str
    rows: tuple[ValueRow, ...]
    left_out: dict[str, str] = field(default_factory=dict)
    reference_ratio: float | None = None
    images: dict[str, str] = field(default_factory=dict)


def sweep_setting(setup: SweepSetup, name: str) -> SettingReport:
    """Measure all values of a quality setting on a new device."""
    return join_shards([sweep_shard(setup, name, WHOLE_SWEEP)])


def sweep_shard(setup: SweepSetup, name: str, shard: SweepShard) -> SettingSample:
    """Measure one shard of a quality setting's sweep on a new device."""
    setting = lookup_quality_setting(name, "sweep_shard")
    with rhi.create_device(setup.backend) as device:
        make_sample = partial(SettingSample, setting.name, device.backend_name, device.capabilities.device)
        if setting.is_encoding:
            return _sweep_encodings(setup, setting, device, make_sample)
        scene = load_scene(setup.scene)
        lack = prepare_scene(scene, setting, is_changed=not setup.begins_choice) or find_missing_option(
            setup.scene, setting
        )
        if lack is not None:
            return make_sample(dict.fromkeys(setting.values, lack))
        left_out = list_unsupported_values(device, setup.settings, setting)
        values = [value for value in setting.values if value not in left_out]
        if not values:
            return make_sample(left_out)
        with SettingBench(device, scene, setup, setting, values, shard) as bench:
            bench.draw_history()
            errors = bench.measure_errors(bench.list_views())
            times, reference_ratios = bench.time()
        samples = {value: errors[value].sample(times[value]) for value in values}
        return make_sample(left_out, samples, reference_ratios)


def join_shards(samples: Sequence[SettingSample]) -> SettingReport:
    """Join the shards of a sweep into its report."""
    first = samples[0]
    setting = lookup_quality_setting(first.setting, "join_shards")
    report = partial(SettingReport, first.setting, first.backend, first.device)
    if not first.values:
        return report((), first.left_out)
    values = {value: _join_samples([sample.values[value] for sample in samples]) for value in first.values}
    if (
        len(values) > 1
        and len({(value_sample.sums, value_sample.flicker) for value_sample in values.values()}) == 1
    ):
        return report((), first.left_out | dict.fromkeys(values, NO_EFFECT))
    times = {
        value: Measurement(value, value_sample.seconds, value_sample.processor_seconds)
        for value, value_sample in values.items()
    }
    base = times[list(times)[-1]]
    ratios = [ratio for sample in samples for ratio in sample.reference_ratios]
    return report(
        tuple(
            _make_row(setting, value, value_sample, times[value], base)
            for value, value_sample in values.items()
        ),
        first.left_out,
        round(median(ratios), 2) if ratios else None,
        {value: value_sample.image for value, value_sample in values.items() if value_sample.image},
    )


def _join_samples(samples: Sequence[ValueSample]) -> ValueSample:
    """Join the samples of a value: all views and rounds."""
    worst = max(samples, key=lambda sample: sample.max_error)  # the first of several
    return ValueSample(
        tuple(view for sample in samples for view in sample.sums),
        worst.max_error,
        worst.worst,
        worst.image,
        tuple(time for sample in samples for time in sample.seconds),
        tuple(time for sample in samples for time in sample.processor_seconds),
        max(sample.p99 for sample in samples),
        next((sample.flicker for sample in samples if sample.flicker is not None), None),
        tuple(flip for sample in samples for flip in sample.flips),
        tuple(difference for sample in samples for difference in sample.differences),
    )


def prepare_scene(scene: Scene, setting: QualitySetting, *, is_changed: bool = True) -> str | None:
    """Add what a quality setting needs to a scene where possible: shadows, bloom, occlusion, an aperture. Return what
    is still missing, None for nothing. With `is_changed=False` nothing is added."""
    if setting.unit is ErrorUnit.OVERDRAW and scene.tessellated:
        return "the scene has a ground, of which each view has other triangles"
    if setting.reference.is_float64 or setting.reference.rays:
        scene.bloom = None  # pixels are compared with their own light
    if setting.reference.rays and not can_ray_trace(scene):
        return "the scene has simulated meshes, which rays don't follow"
    if is_changed:
        _add_required_effect(scene, setting.requirement)
    return _name_missing_part(scene, setting)


def _name_missing_part(scene: Scene, setting: QualitySetting) -> str | None:
    """Name the part that a scene lacks for a quality setting; None if it lacks none."""
    has: int
    match setting.requirement:
        case Requirement.SHADOWS:
            has = scene.lights.has_shadows
        case Requirement.PENUMBRAS:
            has = scene.lights.has_wide_shadows
        case Requirement.TRANSPARENCY:
            has = len(scene.list_transparent())
        case Requirement.IMAGES:
            has = len(scene.textures)
        case Requirement.LOCAL_LIGHTS:
            has = len(scene.lights.point) + len(scene.lights.spot)
        case Requirement.BLOOM:
            has = bool(scene.bloom and len(scene.list_emitters()))
        case Requirement.FOCUS:
            has = bool(scene.depth_of_field and len(scene.objects))
        case Requirement.ENVIRONMENT:
            has = bool(scene.environment and len(scene.objects))
        case Requirement.AMBIENT_LIGHT:
            has = bool(scene.ambient_occlusion and max(*scene.lights.sky, *scene.lights.ground) > 0.0)
        case Requirement.MOTION:
            has = len(scene.simulated)
        case Requirement.DIVERGING_SIMULATIONS:
            has = len(scene.make_simulator().diverging)
        case Requirement.CLOTH:
            has = sum(isinstance(simulated.simulation, ClothSimulation) for simulated in scene.simulated)
        case Requirement.FOUNTAINS:
            has = sum(isinstance(simulated.simulation, FountainSimulation) for simulated in scene.simulated)
        case Requirement.LEVELS_OF_DETAIL:
            has = len(scene.meshes.level_ranges)
        case Requirement.TESSELLATION | Requirement.SHADOW_CASTING_TESSELLATION:
            has = sum(field.limit == field.count for field in scene.tessellated.values())
            if setting.requirement is Requirement.SHADOW_CASTING_TESSELLATION:
                has *= scene.lights.has_shadows
        case _:
            return None
    return None if has else f"the scene lacks {setting.requirement.value}"


def _add_required_effect(scene: Scene, requirement: Requirement | None) -> None:
    """Add the effect that a requirement asks for to a scene."""
    match requirement:
        case Requirement.SHADOWS:
            scene.lights.cast_shadows()
        case Requirement.PENUMBRAS:
            scene.lights.cast_shadows()
            suns = scene.lights.directional
            suns["angular_diameter"] = np.where(
                suns["angular_diameter"] > 0.0, suns["angular_diameter"], SUN_DIAMETER
            )
        case Requirement.BLOOM:
            scene.bloom = scene.bloom or Bloom()
        case Requirement.AMBIENT_LIGHT:
            scene.ambient_occlusion = scene.ambient_occlusion or AmbientOcclusion()
        case Requirement.ENVIRONMENT:
            scene.environment = scene.environment or Environment(paint_sky())
        case Requirement.FOCUS:
            scene.depth_of_field = scene.depth_of_field or DepthOfField(10.0, APERTURE_RADIUS)
        case Requirement.SHADOW_CASTING_TESSELLATION:
            scene.lights.cast_shadows()
            scene.objects.casts_shadow[list(scene.tessellated)] = True


def find_missing_option(scene: str, setting: QualitySetting) -> str | None:
    """The option that a scene's text lacks for a quality setting, None for nothing."""
    generator = GENERATORS.get(scene.partition(":")[0])
    has = not setting.option or (
        generator is not None and setting.option in {scene_option.name for scene_option in generator.options}
    )
    return None if has else f"the scene has no option {setting.option}"


def list_unsupported_values(
    device: Device, settings: RenderSettings, setting: QualitySetting
) -> dict[str, str]:
    """The values of a quality setting that the device doesn't support, each with the missing capability."""
    lacks = {value: find_missing_capability(device, setting.set(settings, value)) for value in setting.values}
    return {value: lack for value, lack in lacks.items() if lack is not None}


def find_missing_capability(device: Device, settings: RenderSettings) -> str | None:
    """The capability that a device lacks for settings, None for nothing."""
    can = device.capabilities
    if settings.technique.samples not in can.sample_counts:
        return f"the device has no {settings.technique.samples} samples a pixel"
    if settings.textures.anisotropy > can.max_anisotropy:
        return f"the device has no anisotropy of {settings.textures.anisotropy:g}"
    if settings.textures.compression is not Compression.NONE:
        if CompressedFormat.BC7 not in can.compressed_formats:
            return "the device stores no compressed images"
        if find_spec("etcpak") is None:
            return "the package etcpak is missing"
    return find_missing_feature(settings.algorithm, device) or (None if can.renders else DRAWS_NOTHING)


class ValueErrors:
    """The errors of a value, view by view."""

    def __init__(self, unit: ErrorUnit) -> None:
        self._unit = unit
        self._sums: list[tuple[float, int]] = []
        self._greatest = -1.0
        self._p99 = 0.0
        self._flips: list[float] = []
        self.differences: list[float] = []
        self.flicker: float | None = None
        self.worst: tuple[int, int, int] | None = None
        self.image = ""

    def add(self, view: PathFrame, errors: Floats, images: tuple[Floats, Floats] | None) -> None:
        """Add the errors of a view: (h, w), NaN where nothing counts, with the reference and the value's
        image; or a single number."""
        counted = errors[np.isfinite(errors)]
        if not counted.size:
            return
        self._sums.append((float(counted.sum()), counted.size))
        self._p99 = max(self._p99, float(np.percentile(counted, 99.0)))
        if images is not None and (flip := compute_flip_error(*images)) is not None:
            self._flips.append(flip)
        greatest = float(counted.max())
        if greatest <= self._greatest:
            return
        self._greatest = greatest
        if self._unit.is_per_pixel:
            y, x = (int(i) for i in np.unravel_index(np.nanargmax(errors), errors.shape))
            self.worst = view.number, x, y
            if images is not None and greatest >= 1.0:
                self.image = crop_worst_region(*images, x, y)

    def summarize(self) -> tuple[float, float]:
        """The greatest error and the mean error."""
        return max(self._greatest, 0.0), compute_mean_error(self._sums)

    def sample(self, time: Measurement) -> ValueSample:
        """The errors as a sample, with times."""
        return ValueSample(
            tuple(self._sums),
            self._greatest,
            self.worst,
            self.image,
            time.seconds,
            time.processor_seconds,
            self._p99,
            self.flicker,
            tuple(self._flips),
            tuple(self.differences),
        )


def compute_mean_error(sums: Sequence[tuple[float, int]]) -> float:
    """The mean error of all views, from each view's sum and number of pixels."""
    return sum(total for total, _ in sums) / max(sum(count for _, count in sums), 1)


def _make_row(
    setting: QualitySetting, value: str, sample: ValueSample, time: Measurement, base: Measurement
) -> ValueRow:
    greatest, mean = max(sample.max_error, 0.0), compute_mean_error(sample.sums)
    scale = 1e9 / _VALUES / ROUND_TRIPS if setting.is_encoding else 1e3
    ratios = (
        round(number, 4)
        for is_processor in (False, True)
        for number in astuple(time.compare_to(base, processor=is_processor))
    )
    ratio, low, high, processor_ratio, processor_low, processor_high = ratios
    return ValueRow(
        setting.name,
        value,
        value == setting.default,
        setting.unit.value,
        float(f"{greatest:.5g}"),
        float(f"{mean:.5g}"),
        sample.worst,
        float(f"{scale * time.median:.4g}"),
        ratio,
        low,
        high,
        float(f"{scale * time.processor_median:.4g}"),
        processor_ratio,
        processor_low,
        processor_high,
        float(f"{sample.p99:.5g}"),
        None if sample.flicker is None else float(f"{sample.flicker:.5g}"),
        float(f"{fmean(sample.flips):.4g}") if sample.flips else None,
        float(f"{fmean(sample.differences):.4g}") if sample.differences else None,
    )


class SettingBench(Bench):
    """The renderers of all values of a quality setting, and their reference."""

    def __init__(
        self,
        device: Device,
        scene: Scene,
        setup: SweepSetup,
        setting: QualitySetting,
        values: Sequence[str],
        shard: SweepShard = WHOLE_SWEEP,
    ) -> None:
        self._setting, self._shard = setting, shard
        self._begins_choice = setup.begins_choice
        self._compared_times: dict[str, list[tuple[float, float]]] = {value: [] for value in values}
        self._rounds = shard.take(range(setup.rounds))
        self._history, self._views, self._timed = list_frames(scene, setup, setting, shard)
        has_next = self._views and not shard.number and not setting.history_frames
        self._next = find_next_frame(scene, setup, self._views[0]) if has_next else None
        self._settings = {value: setting.set(setup.settings, value) for value in values}
        best = self._settings[values[-1]]
        rig = None
        if setting.requirement is Requirement.STEREO:
            width, height = setup.size
            rig = compute_rig(scene, best.adapt_camera(self._timed[0].camera).with_aspect(width / height))
        super().__init__(
            device,
            scene,
            setup.size,
            best.change_all(setting.reference.changes),
            setting.reference.scale,
            rig,
            setting.reference.rays,
            setup.traced_pixels,
        )
        with ExitStack() as self._opened:  # closed if one of them can't be opened
            scenes = {value: self._load(setup, value) for value in values}
            self._renderers = {
                value: self.open(value_settings, 1, scenes[value])
                for value, value_settings in self._settings.items()
            }
            if setting.unit is ErrorUnit.OVERDRAW:
                self._exact = ExactVisibility(device, scene, setup.size)
                self._opened.callback(self._exact.destroy)
            elif (
                setting.unit is ErrorUnit.LEVELS
                and not setting.reference.is_float64
                and not setting.reference.rays
            ):
                equal_values = [
                    value
                    for value, settings in self._settings.items()
                    if settings == self._reference_settings
                ]
                is_known = equal_values and setting.reference.scale == 1
                self._reference_renderer = (
                    self._renderers[equal_values[-1]]
                    if is_known
                    else self.open(self._reference_settings, self._scale)
                )
            self._opened = self._opened.pop_all()

    def _load(self, setup: SweepSetup, value: str) -> Scene | None:
        """The scene of a value, if it has its own."""
        option = self._setting.option
        if not option:
            return None
        scene = load_scene(change_options(setup.scene, f"{option}={self._setting.values[value]}"))
        prepare_scene(scene, self._setting, is_changed=not setup.begins_choice)
        return scene

    @property
    def _has_own_reference(self) -> bool:
        """True if the reference is an image that is none of the values'."""
        return (
            self._reference_renderer is not None and self._reference_renderer not in self._renderers.values()
        )

    def list_views(self) -> Sequence[PathFrame]:
        """The frames to compare."""
        return self._views

    def draw_history(self) -> None:
        """Draw the earlier frames that the frames to compare depend on, if any."""
        for view in self._history:
            for value in self._renderers:
                self._render(value, view)
            if self._has_own_reference:
                self.render_reference(view)

    def measure_errors(self, views: Sequence[PathFrame]) -> dict[str, ValueErrors]:
        """The errors of each value in all views."""
        errors = {value: ValueErrors(self._setting.unit) for value in self._renderers}
        before: dict[str, Floats] = {}
        for view in views:
            drawn: dict[str, Floats] = {}
            for value, (lost, images) in self.compare(view):
                errors[value].add(view, lost, images)
                if images is not None:
                    drawn[value] = images[1]
                    if view is views[0]:
                        before[value] = images[1] - images[0]
                    elif self._setting.history_frames and view is views[1]:  # the next frame
                        errors[value].flicker = compute_flicker(before[value], images[1] - images[0])
            best = drawn.get(list(self._renderers)[-1])
            if best is not None:
                for value, levels in drawn.items():
                    errors[value].differences.append(float(np.abs(levels - best).max(axis=2).mean()))
        if before and self._next is not None:
            for value, (_, images) in self.compare(self._next):
                if images is not None:
                    errors[value].flicker = compute_flicker(before[value], images[1] - images[0])
        return errors

    def compare(self, view: PathFrame) -> Iterator[tuple[str, tuple[Floats, tuple[Floats, Floats] | None]]]:
        """Yield each value with the errors of its frame, and the two images that they are differences of."""
        match self._setting.unit:
            case ErrorUnit.LEVELS:
                yield from self._compare_images(view)
                return
            case ErrorUnit.DEPTH:
                errors_by_value = self._compare_depths(view)
            case ErrorUnit.LIGHTS:
                errors_by_value = self._compare_lights(view)
            case _:
                errors_by_value = self._compare_triangles(view)
        for value, errors in errors_by_value:
            yield value, (errors, None)

    def _render(self, value: str, view: PathFrame) -> FrameResult:
        return self._settings[value].render(self._renderers[value], view)

    def _compare_images(
        self, view: PathFrame
    ) -> Iterator[tuple[str, tuple[Floats, tuple[Floats, Floats] | None]]]:
        # The reference is read before values are drawn: its renderer may be one of theirs.
        if self._setting.reference.is_float64:
            exact = self._shade(view)
            true, counts = exact.levels, exact.objects >= 0
        else:
            true = self.render_reference(view)
            counts = np.isfinite(true[..., 0])
        for value, renderer in self._renderers.items():
            if renderer is self._reference_renderer and self._setting.history_frames:
                yield (
                    value,
                    (np.zeros(true.shape[:2]), None),
                )  # drawn already; drawing again would give another frame
                continue
            processor, began = process_time(), perf_counter()
            result = self._render(value, view)
            self.device.finish()
            self._compared_times[value].append((perf_counter() - began, process_time() - processor))
            visible_objects = read_image_levels(result)
            errors = np.where(counts, np.abs(visible_objects - true).max(axis=2), np.nan)
            yield value, (errors, (np.where(counts[..., None], true, visible_objects), visible_objects))

    def _shade(self, view: PathFrame) -> Float64Image:
        value = list(self._renderers)[-1]
        return shade_in_float64(
            self._renderers[value], self._settings[value].adapt_camera(view.camera), view.seconds
        )

    def _compare_depths(self, view: PathFrame) -> Iterator[tuple[str, Floats]]:
        exact = self._shade(view)
        for value in self._renderers:
            depth = self._render(value, view).depth.read().astype(np.float64)
            away = distances_from_depth(self._settings[value].adapt_camera(view.camera), depth)
            errors = np.full(depth.shape, np.nan)
            seen = exact.objects >= 0
            errors[seen] = 1e6 * np.abs(away[seen] / exact.distances[seen] - 1.0)
            yield value, errors

    def _compare_lights(self, view: PathFrame) -> Iterator[tuple[str, Floats]]:
        exact = self._shade(view)
        seen = exact.positions[exact.objects >= 0]
        needed = count_reached(self.scene, view.camera, seen)
        for value, renderer in self._renderers.items():
            counted = count_light_evaluations(renderer, self._settings[value].adapt_camera(view.camera))
            assert counted is not None
            yield value, np.array([(counted - needed) / max(len(seen), 1)])

    def _compare_triangles(self, view: PathFrame) -> Iterator[tuple[str, Floats]]:
        results = {value: self._render(value, view).statistics.triangles for value in self._renderers}
        rows = np.array(
            sorted(self._exact.visible_objects(self._reference_settings.adapt_camera(view.camera))), np.int64
        )
        seen = self.scene.count_triangles(rows) if len(rows) else 0
        for value, triangles in results.items():
            # Some views show nothing; a fraction of nothing is no error.
            yield value, np.array([100.0 * (triangles / seen - 1.0) if seen else np.nan])

    def time(self) -> tuple[dict[str, Measurement], tuple[float, ...]]:
        """Time frames of all values, and of the reference if the renderer draws it. Returns the reference's
        times divided by the most accurate value's as well."""
        views, rounds, names = self._timed, self._rounds, list(self._renderers)
        if self._begins_choice and all(self._compared_times.values()):
            return {
                value: Measurement(value, *zip(*times, strict=True))
                for value, times in self._compared_times.items()
            }, ()
        start = rounds[0] % len(names)  # each round starts with the next value, also across shards
        work = {name: self._draw_timed(name) for name in names[start:] + names[:start]}
        if self._setting.history_frames:
            rounds = range(len(rounds))
        else:
            view = views[(rounds[0] - 1) % len(views)]  # the view before that of the first round
            for name, renderer in self._renderers.items():
                settle(renderer, self._settings[name].adapt_camera(view.camera), view.seconds)
        return alternate(work, rounds, 0), self._time_reference(work[names[-1]])

    def _draw_timed(self, name: str) -> Callable[[int], None]:
        """A function that draws the frame of a round with a value."""
        views = self._timed
        renderer = self._renderers[name]
        settings = self._settings[name]
        return lambda number: self.draw(renderer, settings, views[number % len(views)])

    def _time_reference(self, draw_best: Callable[[int], None]) -> tuple[float, ...]:
        """The reference's times divided by the most accurate value's; none if the reference isn't an image of
        its own."""
        true, views = self._reference_renderer, self._timed
        if true is None or not self._has_own_reference:
            return ()
        rounds = self._shard.take(range(max(_REFERENCE_ROUNDS, self._shard.count)))
        work = {
            "reference": lambda number: self.draw(true, self._reference_settings, views[number % len(views)]),
            "best": draw_best,
        }
        times = alternate(work, rounds, 0 if self._views else 1)
        return tuple(map(truediv, times["reference"].seconds, times["best"].seconds))


def _name_camera(scene: Scene, setup: SweepSetup) -> str:
    return setup.camera or ("ground" if "ground" in scene.paths else next(iter(scene.views)))


def find_camera_path(scene: Scene, setup: SweepSetup) -> CameraPath | None:
    """The setup's camera path, None if its camera isn't one."""
    text = _name_camera(scene, setup)
    return parse_camera_path(text, scene) if text in scene.paths or text.endswith(".json") else None


def find_next_frame(scene: Scene, setup: SweepSetup, path_frame: PathFrame) -> PathFrame | None:
    """The next frame of the path, None at its end."""
    path = find_camera_path(scene, setup)
    return (
        None if path is None or path_frame.number + 1 >= len(path) else path.path_frame(path_frame.number + 1)
    )


def list_views(
    scene: Scene, setup: SweepSetup, *, consecutive: bool = False, count: int | None = None
) -> list[PathFrame]:
    """Frames of the setup's camera: consecutive ones from the middle of its path, or spread over all of it. A
    camera that isn't a path has one."""
    path, view_count = find_camera_path(scene, setup), count or setup.views
    if path is None:
        camera = parse_camera(_name_camera(scene, setup), scene)
        return (
            [PathFrame(number, camera) for number in range(view_count)]
            if consecutive
            else [PathFrame(0, camera)]
        )
    last = len(path) - 1 if setup.last is None else min(setup.last, len(path) - 1)
    first = min(setup.first, last)
    if consecutive:
        begin = max(first, min((first + last) // 2, last - view_count + 1))
        return [path.path_frame(number) for number in range(begin, min(begin + view_count, last + 1))]
    positions = np.linspace(first, last, view_count + 2)[
        1:-1
    ]  # not the ends, where there may be nothing to see
    return [path.path_frame(number) for number in dict.fromkeys(int(position) for position in positions)]


def list_frames(
    scene: Scene, setup: SweepSetup, setting: QualitySetting, shard: SweepShard
) -> tuple[Sequence[PathFrame], Sequence[PathFrame], Sequence[PathFrame]]:
    """The frames of a shard: those that only build up history, those to compare, and those to time."""
    if not setting.history_frames:
        views = list_views(scene, setup)
        return [], shard.take(views), views
    compared, counted = setup.views, setup.views + setup.rounds
    frames = list_views(scene, setup, consecutive=True, count=setting.history_frames + counted)
    first = max(len(frames) - counted, 0)
    counting = frames[first:]
    return frames[:first], counting[:compared], counting[compared:] or counting


def _sweep_encodings(
    setup: SweepSetup, setting: QualitySetting, device: Device, make_sample: Callable[..., SettingSample]
) -> SettingSample:
    """Measure encodings: their errors on random vectors, and the time to store and read one."""
    encodings_by_name = {encoding.name: encoding for encoding in ENCODINGS}
    encodings = {value: encodings_by_name[name] for value, name in setting.values.items()}
    if not device.capabilities.compute or not device.capabilities.renders:
        return make_sample(dict.fromkeys(setting.values, "it computes nothing"))
    errors, work = {}, {}
    for value, encoding in encodings.items():
        vectors = encoding.sample(np.random.default_rng(0), _VALUES)
        errors[value] = encoding.measure(
            vectors, run_round_trip(device, encoding.shader, vectors, **encoding.uniforms)
        )
        work[value] = time_round_trip(device, encoding.shader, vectors, **encoding.uniforms)
    times = alternate(work, range(setup.rounds), 2)
    samples = {
        value: ValueSample(
            ((float(error.sum()), error.size),),
            float(error.max()),
            None,
            "",
            times[value].seconds,
            times[value].processor_seconds,
            float(np.percentile(error, 99.0)),
        )
        for value, error in errors.items()
    }
    return make_sample({}, samples)
