"""The sweep of a quality setting: what is compared, what is timed, and what is left out."""

from __future__ import annotations

import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from nightly_reasons import CHEAPER_TEST

from renderer.content import load_scene
from renderer.lab.accuracy import (
    QUALITY_SETTINGS,
    SettingReport,
    SweepSetup,
    image_errors,
    sweep,
    sweep_setting,
)
from renderer.lab.accuracy.bench import downsample_image
from renderer.lab.accuracy.image_errors import compute_flicker
from renderer.lab.measure.measurement import Interval, Measurement
from renderer.scene import Camera
from tests.renderer.conftest import open_device

TINY = SweepSetup("city:blocks=2", backend="gl", size=(48, 28), views=2, rounds=2)


pytestmark = pytest.mark.usefixtures("gl")


@pytest.fixture(scope="module")
def bias_report() -> SettingReport:
    with open_device("gl"):
        return sweep_setting(replace(TINY, scene="glass"), "shadow_bias")


def test_errors_fall_with_accuracy(bias_report: SettingReport) -> None:
    none, half, full = bias_report.rows
    assert none.mean_error > half.mean_error > full.mean_error
    assert none.max_error >= 1.0


def test_times_are_ratios_to_the_most_accurate_value(bias_report: SettingReport) -> None:
    none, _, full = bias_report.rows
    assert (full.ratio, full.low, full.high) == (1.0, 1.0, 1.0)
    assert none.low <= none.ratio <= none.high


def test_the_worst_frame_is_one_of_the_views_and_has_an_image(bias_report: SettingReport) -> None:
    none = bias_report.rows[0]
    assert none.worst is not None
    assert none.worst[0] in (449, 899, 1349, 599, 1199)
    assert "0.0" in bias_report.images


def test_the_default_value_is_marked(bias_report: SettingReport) -> None:
    assert [row.is_default for row in bias_report.rows] == [False, False, True]


def test_a_reference_of_rays_has_no_time(bias_report: SettingReport) -> None:
    assert bias_report.reference_ratio is None


def test_textures_without_mip_levels_flicker_though_single_images_are_no_worse() -> None:
    rows = {row.value: row for row in sweep_setting(replace(TINY, size=(96, 54)), "texture_filter").rows}
    sharp, mipped = rows["bilinear, no mip levels"], rows["trilinear"]
    assert sharp.mean_error < 1.1 * mipped.mean_error
    assert sharp.flicker is not None
    assert mipped.flicker is not None
    assert sharp.flicker > 1.2 * mipped.flicker > 0.0
    assert all(row.mean_error < row.p99 < row.max_error for row in rows.values())


def test_a_still_camera_and_measures_that_are_not_images_have_no_flicker() -> None:
    assert {row.flicker for row in sweep_setting(replace(TINY, camera="street"), "fxaa").rows} == {None}
    assert {(row.flicker, row.flip) for row in sweep_setting(TINY, "depth").rows} == {(None, None)}


def test_flip_falls_with_the_error_and_is_between_nothing_and_all(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("flip_evaluator", reason="no FLIP: pip install rhi[flip]")
    rows = sweep_setting(TINY, "scale").rows
    assert 1.0 > rows[0].flip > 1.5 * rows[-1].flip > 0.0  # type: ignore[operator]
    black, white = np.zeros((54, 96, 3)), np.full((54, 96, 3), 255.0)
    assert image_errors.compute_flip_error(black, black) == 0.0
    assert image_errors.compute_flip_error(black, white) == pytest.approx(0.967, abs=0.001)
    assert 0.0 < (image_errors.compute_flip_error(white, white - 30.0) or 0.0) < 0.3
    monkeypatch.setitem(sys.modules, "flip_evaluator", None)
    assert image_errors.compute_flip_error(black, white) is None


@pytest.mark.parametrize("change", [0.0, 6.0])
def test_flicker_is_the_change_of_the_error_from_a_frame_to_the_next(
    change: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    frames = iter((5.0, 5.0 + change))
    monkeypatch.setattr(sweep, "read_image_levels", lambda _: np.full((28, 48, 3), next(frames)))
    monkeypatch.setattr(sweep.SettingBench, "render_reference", lambda *_: np.zeros((28, 48, 3)))
    scene = load_scene("city:blocks=2")
    with (
        open_device("gl") as device,
        sweep.SettingBench(device, scene, replace(TINY, views=1), QUALITY_SETTINGS["fxaa"], ["off"]) as bench,
    ):
        (errors,) = bench.measure_errors(bench.list_views()).values()
    assert (errors.flicker, errors.summarize()) == (change, (5.0, 5.0))


def test_depth_is_compared_with_the_distances_of_surfaces() -> None:
    standard, reverse = sweep_setting(TINY, "depth").rows
    assert standard.mean_error > 10.0 * reverse.mean_error > 0.0
    assert reverse.max_error < 50.0  # millionths


def test_an_image_that_is_too_dark_is_worse_by_the_ray_tracer(monkeypatch: pytest.MonkeyPatch) -> None:
    """And so it is under each value: the reference isn't the renderer's own."""
    read, errors = sweep.read_image_levels, []
    for shard in (1.0, 0.3):
        monkeypatch.setattr(sweep, "read_image_levels", lambda result, shard=shard: read(result) * shard)
        errors.append(
            [row.mean_error for row in sweep_setting(replace(TINY, views=1, rounds=1), "samples").rows]
        )
    assert all(dark > right + 5.0 for right, dark in zip(*errors, strict=True))


def test_values_that_the_device_lacks_are_left_out_by_name() -> None:
    report = sweep_setting(TINY, "samples")
    assert [row.value for row in report.rows] == ["1", "4"]
    assert report.left_out == {value: f"the device has no {value} samples a pixel" for value in ("2", "8")}
    assert report.rows[0].mean_error > report.rows[1].mean_error


def test_a_setting_that_changes_nothing_in_the_views_has_no_rows() -> None:
    report = sweep_setting(TINY, "precision")  # GL has one
    assert (report.rows, set(report.left_out.values())) == ((), {sweep.NO_EFFECT})
    assert len(sweep_setting(TINY, "fxaa").rows) == 2


def test_a_still_camera_has_one_view_in_all_shards_together() -> None:
    still = replace(TINY, camera="street")
    shards = [sweep.sweep_shard(still, "fxaa", shard) for shard in sweep.list_shards(still, "fxaa")]
    assert [len(shard.values["on"].sums) for shard in shards] == [0, 1]
    assert sweep.join_shards(shards).rows[0].mean_error > 0.0


def test_a_setting_that_the_scene_has_no_use_for_has_no_rows() -> None:
    report = sweep_setting(TINY, "blending")
    assert report.rows == ()
    assert set(report.left_out.values()) == {"the scene lacks a transparent object"}


@pytest.mark.parametrize("name", ["cloth_sub_steps", "cloth_rate", "cloth_detail", "drops"])
def test_a_scene_setting_is_compared_with_the_scene_of_its_last_value(name: str) -> None:
    setting, text = (
        replace(QUALITY_SETTINGS[name], history_frames=24),
        "hall:columns=6,flags=0,fountains=4,cloths=4",
    )
    camera, values = "banners" if "cloth" in name else "-9,2.2,0,-3,1.8,2", list(setting.values)
    setup = replace(TINY, scene=text, camera=camera, rounds=1, size=(96, 54))
    scene = load_scene(text)
    with (
        open_device("gl") as device,
        sweep.SettingBench(device, scene, setup, setting, [values[0], values[-1]]) as bench,
    ):
        bench.draw_history()
        least, most = (errors.summarize()[1] for errors in bench.measure_errors(bench.list_views()).values())
    assert least > most == 0.0


def test_a_scene_without_a_cloth_or_without_the_option_lacks_the_quality_setting() -> None:
    assert set(sweep_setting(TINY, "cloth_rate").left_out.values()) == {"the scene lacks a cloth"}
    assert sweep.prepare_scene(load_scene("hall:cloths=1"), QUALITY_SETTINGS["cloth_rate"]) is None
    assert (
        sweep.find_missing_option("city:blocks=2", QUALITY_SETTINGS["drops"])
        == "the scene has no option drops"
    )
    assert (
        sweep.find_missing_option("model.glb", QUALITY_SETTINGS["drops"]) == "the scene has no option drops"
    )
    assert sweep.find_missing_option("hall:flags=2", QUALITY_SETTINGS["drops"]) is None
    assert sweep.find_missing_option("city", QUALITY_SETTINGS["fxaa"]) is None


def test_pausing_hidden_simulations_costs_accuracy_and_simulating_them_costs_none() -> None:
    setup = replace(TINY, scene="hall:columns=23,flags=0,cloths=12", size=(96, 54), rounds=1)
    rest, simulated = sweep_setting(setup, "hidden_simulations").rows
    assert rest.mean_error > simulated.mean_error == 0.0
    assert rest.is_default
    assert set(sweep_setting(TINY, "hidden_simulations").left_out.values()) == {
        "the scene lacks a simulation that depends on its history"
    }


def test_frames_that_remember_nothing_are_not_compared() -> None:
    scene, setting = load_scene("city:blocks=4"), QUALITY_SETTINGS["pyramid_texels"]
    with open_device("gl") as device, sweep.SettingBench(device, scene, TINY, setting, ["8"]) as bench:
        (first,) = bench.measure_errors(bench.list_views()[:1]).values()
        with sweep.SettingBench(device, scene, TINY, setting, ["8"]) as other:
            other.draw_history()
            (later,) = other.measure_errors(other.list_views()[:1]).values()
    assert first.summarize()[1] > 2.0 * later.summarize()[1] > 0.0  # all in view was drawn


@pytest.mark.nightly_cases(reason=CHEAPER_TEST)
def test_joined_shards_equal_a_single_sweep() -> None:
    setup = replace(TINY, rounds=3)
    shards = sweep.list_shards(setup, "occluder_pixels")
    samples = [sweep.sweep_shard(setup, "occluder_pixels", shard) for shard in shards]
    joined, whole = sweep.join_shards(samples), sweep_setting(setup, "occluder_pixels")
    rows = [
        [(row.value, row.mean_error, row.max_error, row.worst) for row in report.rows]
        for report in (joined, whole)
    ]
    assert rows[0] == rows[1]
    assert joined.images == whole.images
    assert [[len(value.seconds) for value in sample.values.values()] for sample in samples] == [
        [1] * 5,
        [2] * 5,
    ]
    assert [len(sample.reference_ratios) for sample in samples] == [1, 2]
    assert joined.rows[-1].ratio == 1.0


def test_frames_that_depend_on_earlier_ones_follow_each_other() -> None:
    scene, setting = load_scene("city:blocks=2"), QUALITY_SETTINGS["pyramid_texels"]
    parts = sweep.list_frames(scene, TINY, setting, sweep.SweepShard())
    assert [len(frames) for frames in parts] == [setting.history_frames, 2, 2]
    assert np.diff([frame.number for frames in parts for frame in frames]).tolist() == [1] * (
        setting.history_frames + 3
    )
    short = replace(TINY, first=7, last=8)
    history, compared, timed = sweep.list_frames(scene, short, setting, sweep.SweepShard())
    assert [[frame.number for frame in frames] for frames in (history, compared, timed)] == [
        [],
        [7, 8],
        [7, 8],
    ]


def test_a_sweep_has_two_shards_unless_frames_depend_on_earlier_ones() -> None:
    counts = {
        views: len(sweep.list_shards(replace(TINY, views=views, rounds=9), "fxaa")) for views in (1, 2, 9)
    }
    assert counts == {1: 1, 2: 2, 9: 2}
    assert len(sweep.list_shards(replace(TINY, rounds=1), "fxaa")) == 1  # each has a round
    assert len(sweep.list_shards(TINY, "pyramid_texels")) == len(sweep.list_shards(TINY, "normal_bits")) == 1
    for count in (1, 2, 4):
        parts = [sweep.SweepShard(number, count).take(range(11)) for number in range(count)]
        assert [item for part in parts for item in part] == list(range(11))
        assert max(map(len, parts)) - min(map(len, parts)) <= 1


def test_encodings_are_measured_without_a_frame() -> None:
    rough, fine = sweep_setting(TINY, "tangent_packing").rows
    assert rough.max_error > fine.max_error > 0.0
    assert fine.worst is None


def test_shadows_are_switched_on_for_their_settings_only() -> None:
    scene = load_scene("city:blocks=2")
    assert sweep.prepare_scene(scene, QUALITY_SETTINGS["fxaa"]) is None
    assert not scene.lights.point["casts_shadow"].any()
    assert sweep.prepare_scene(scene, QUALITY_SETTINGS["occluders"]) is None
    assert "other triangles" in str(
        sweep.prepare_scene(load_scene("terrain:cells=8,trees=0"), QUALITY_SETTINGS["occluders"])
    )
    assert sweep.prepare_scene(scene, QUALITY_SETTINGS["shadow_size"]) is None
    assert scene.lights.point["casts_shadow"].all()


def test_views_are_spread_or_follow_each_other() -> None:
    scene = load_scene("city:blocks=2")
    spread = [view.number for view in sweep.list_views(scene, replace(TINY, views=3))]
    assert spread == sorted(spread)
    assert min(np.diff(spread)) > 100
    near = [view.number for view in sweep.list_views(scene, TINY, consecutive=True, count=5)]
    assert np.diff(near).tolist() == [1] * 4
    part = [view.number for view in sweep.list_views(scene, replace(TINY, first=100, last=110))]
    assert all(100 < number < 110 for number in part)
    assert [view.number for view in sweep.list_views(scene, replace(TINY, camera="street"))] == [0]


def test_downsampling_averages_in_linear_light() -> None:
    image = np.zeros((2, 2, 3))
    image[0] = 255.0
    assert np.allclose(downsample_image(image, 2), 187.5, atol=0.5)  # half the light, not 127.5
    assert downsample_image(image, 1) is image


def test_lights_that_reach_a_point_are_counted_by_range_and_cone() -> None:
    scene = load_scene("hall")
    spot = scene.lights.spot[0]
    away = 0.5 * float(spot["range"])
    camera = Camera.look_at(spot["position"], spot["position"] + spot["direction"])
    before, behind = (
        away * np.asarray(spot["direction"], np.float64),
        -away * np.asarray(spot["direction"], np.float64),
    )
    only = type("Lights", (), {"point": scene.lights.point[:0], "spot": scene.lights.spot[:1]})
    stage: Any = type("Stage", (), {"lights": only})
    counts = [
        image_errors.count_reached(stage, camera, position[None])
        for position in (before, behind, 3.0 * before)
    ]
    assert counts == [1, 0, 0]


def test_an_image_of_the_worst_region_has_three_parts() -> None:
    import io
    from base64 import b64decode

    from PIL import Image

    true, image = np.zeros((200, 300, 3)), np.zeros((200, 300, 3))
    image[199, 299] = 60.0
    pixels = np.asarray(
        Image.open(io.BytesIO(b64decode(image_errors.crop_worst_region(true, image, 299, 199))))
    )
    height, width = pixels.shape[0], pixels.shape[1] // 3
    assert (pixels[-1, 2 * width - 1] == 60).all()
    assert (pixels[-1, 3 * width - 1] == 240).all()
    assert not pixels[: height - 1].any()


def test_an_interval_holds_the_median_and_narrows_with_more_samples() -> None:
    few, many = np.random.default_rng(1).normal(1.0, 0.1, 8), np.random.default_rng(2).normal(1.0, 0.1, 400)
    of_few, of_many = Interval.of(few), Interval.of(many)
    assert of_few.low <= float(np.median(few)) == of_few.median <= of_few.high
    assert of_many.high - of_many.low < 0.5 * (of_few.high - of_few.low)
    assert Interval.of(np.full(5, 2.0)) == Interval(2.0, 2.0, 2.0)
    a, b = Measurement("a", (2.0, 4.0), (1.0, 1.0)), Measurement("b", (1.0, 1.0), (1.0, 2.0))
    assert a.compare_to(b) == Interval(3.0, 2.0, 4.0)
    assert a.compare_to(b, processor=True) == Interval(0.75, 0.5, 1.0)


def test_flicker_is_the_change_of_an_error() -> None:
    rng = np.random.default_rng(3)
    error = rng.uniform(-9.0, 9.0, (5, 7, 3))
    assert compute_flicker(error, error) == 0.0  # an error that stands still doesn't flicker
    assert compute_flicker(error, -error) == pytest.approx(2.0 * np.abs(error).max(axis=2).mean())
    later = error.copy()
    later[2, 3] += (1.0, -4.0, 2.0)
    assert compute_flicker(error, later) == pytest.approx(4.0 / 35)
    later[2, 4:] = np.nan  # these pixels don't count
    assert compute_flicker(error, later) == pytest.approx(4.0 / 32)
    assert compute_flicker(error, np.full_like(error, np.nan)) == 0.0


def test_differences_to_the_most_accurate_value_are_apart_from_errors(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    images = iter((5.0, 7.0) * 2)  # both values, of the view and of the frame after it
    monkeypatch.setattr(sweep, "read_image_levels", lambda _: np.full((28, 48, 3), next(images)))
    monkeypatch.setattr(sweep.SettingBench, "render_reference", lambda *_: np.full((28, 48, 3), 4.0))
    setup, fxaa = replace(TINY, views=1), QUALITY_SETTINGS["fxaa"]
    with (
        open_device("gl") as device,
        sweep.SettingBench(device, load_scene("city:blocks=2"), setup, fxaa, ["off", "on"]) as bench,
    ):
        errors = bench.measure_errors(bench.list_views())
    assert {value: value_errors.differences for value, value_errors in errors.items()} == {
        "off": [2.0],
        "on": [0.0],
    }
    assert [value_errors.summarize()[1] for value_errors in errors.values()] == [1.0, 3.0]
