"""The sweep of a knob: what is compared, what is timed, and what is left out."""

from __future__ import annotations

import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from nightly_reasons import CHEAPER_TEST

from renderer.content import load_scene
from renderer.lab.accuracy import KNOBS, Situation, sweep, sweep_knob
from renderer.lab.accuracy.bench import shrink_picture
from renderer.lab.measure.alternate import Interval, Measurement
from renderer.scene import Camera
from tests.renderer.conftest import open_device

TINY = Situation("city:blocks=2", backend="gl", size=(48, 28), views=2, rounds=2)


pytestmark = pytest.mark.usefixtures("gl")


def test_errors_fall_and_times_are_ratios_to_the_most_accurate_value() -> None:
    report = sweep_knob(replace(TINY, scene="glass"), "shadow_bias")
    none, half, all_ = report.rows
    assert none.mean_error > half.mean_error > all_.mean_error
    assert none.max_error >= 1.0
    assert none.worst is not None
    assert none.worst[0] in (449, 899, 1349, 599, 1199)
    assert "0.0" in report.pictures
    assert (all_.ratio, all_.low, all_.high) == (1.0, 1.0, 1.0)
    assert none.low <= none.ratio <= none.high
    assert [row.is_default for row in report.rows] == [False, False, True]
    assert report.truth_ratio is None  # no renderer draws what rays see


def test_textures_without_mip_levels_flicker_though_single_pictures_are_no_worse() -> None:
    rows = {row.value: row for row in sweep_knob(replace(TINY, size=(96, 54)), "texture_filter").rows}
    sharp, mipped = rows["bilinear, no mip levels"], rows["trilinear"]
    assert sharp.mean_error < 1.1 * mipped.mean_error
    assert sharp.flicker is not None
    assert mipped.flicker is not None
    assert sharp.flicker > 1.2 * mipped.flicker > 0.0
    assert all(row.mean_error < row.p99 < row.max_error for row in rows.values())


def test_a_camera_that_stands_and_what_is_not_a_picture_have_no_flicker() -> None:
    assert {row.flicker for row in sweep_knob(replace(TINY, camera="street"), "fxaa").rows} == {None}
    assert {(row.flicker, row.flip) for row in sweep_knob(TINY, "depth").rows} == {(None, None)}


def test_flip_falls_with_the_error_and_is_between_nothing_and_all(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("flip_evaluator", reason="no FLIP: pip install rhi[flip]")
    rows = sweep_knob(TINY, "scale").rows
    assert 1.0 > rows[0].flip > 1.5 * rows[-1].flip > 0.0  # type: ignore[operator]
    black, white = np.zeros((54, 96, 3)), np.full((54, 96, 3), 255.0)
    assert sweep.find_flip(black, black) == 0.0
    assert sweep.find_flip(black, white) == pytest.approx(0.967, abs=0.001)
    assert 0.0 < (sweep.find_flip(white, white - 30.0) or 0.0) < 0.3
    monkeypatch.setitem(sys.modules, "flip_evaluator", None)
    assert sweep.find_flip(black, white) is None


@pytest.mark.parametrize("change", [0.0, 6.0])
def test_flicker_is_the_change_of_what_is_wrong_from_a_frame_to_the_next(
    change: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    frames = iter((5.0, 5.0 + change))
    monkeypatch.setattr(sweep, "read_picture", lambda _: np.full((28, 48, 3), next(frames)))
    monkeypatch.setattr(sweep.KnobBench, "find_true", lambda *_: np.zeros((28, 48, 3)))
    scene = load_scene("city:blocks=2")
    with (
        open_device("gl") as device,
        sweep.KnobBench(device, scene, replace(TINY, views=1), KNOBS["fxaa"], ["off"]) as bench,
    ):
        (errors,) = bench.find_errors(bench.list_views()).values()
    assert (errors.flicker, errors.summarize()) == (change, (5.0, 5.0))


def test_depth_is_judged_by_the_distances_of_surfaces() -> None:
    standard, reverse = sweep_knob(TINY, "depth").rows
    assert standard.mean_error > 10.0 * reverse.mean_error > 0.0
    assert reverse.max_error < 50.0  # millionths


def test_a_picture_that_is_too_dark_is_worse_by_the_judge(monkeypatch: pytest.MonkeyPatch) -> None:
    """And so it is under each value: the truth isn't the renderer's own."""
    read, errors = sweep.read_picture, []
    for share in (1.0, 0.3):
        monkeypatch.setattr(sweep, "read_picture", lambda result, share=share: read(result) * share)
        errors.append([row.mean_error for row in sweep_knob(replace(TINY, views=1, rounds=1), "samples").rows])
    assert all(dark > right + 5.0 for right, dark in zip(*errors, strict=True))


def test_values_that_the_device_lacks_are_left_out_by_name() -> None:
    report = sweep_knob(TINY, "samples")
    assert [row.value for row in report.rows] == ["1", "4"]
    assert report.left_out == {value: f"the device has no {value} samples a pixel" for value in ("2", "8")}
    assert report.rows[0].mean_error > report.rows[1].mean_error


def test_a_knob_that_changes_nothing_in_the_views_has_no_rows() -> None:
    report = sweep_knob(TINY, "precision")  # GL has one
    assert (report.rows, set(report.left_out.values())) == ((), {sweep.NO_EFFECT})
    assert len(sweep_knob(TINY, "fxaa").rows) == 2


def test_a_camera_that_stands_has_one_view_in_all_shares_together() -> None:
    still = replace(TINY, camera="street")
    shares = [sweep.sweep_share(still, "fxaa", share) for share in sweep.list_shares(still, "fxaa")]
    assert [len(share.values["on"].sums) for share in shares] == [0, 1]
    assert sweep.join_shares(shares).rows[0].mean_error > 0.0


def test_a_knob_that_the_scene_has_no_use_for_has_no_rows() -> None:
    report = sweep_knob(TINY, "blending")
    assert report.rows == ()
    assert set(report.left_out.values()) == {"the scene lacks a transparent object"}


@pytest.mark.parametrize("name", ["cloth_sub_steps", "cloth_step", "cloth_grid", "drops"])
def test_a_knob_of_the_scene_is_judged_by_the_scene_of_its_last_value(name: str) -> None:
    knob, text = replace(KNOBS[name], remembers=24), "hall:columns=6,flags=0,fountains=4,cloths=4"
    camera, values = "banners" if "cloth" in name else "-9,2.2,0,-3,1.8,2", list(knob.values)
    situation = replace(TINY, scene=text, camera=camera, rounds=1, size=(96, 54))
    scene = load_scene(text)
    with open_device("gl") as device, sweep.KnobBench(device, scene, situation, knob, [values[0], values[-1]]) as bench:
        bench.draw_history()
        least, most = (one.summarize()[1] for one in bench.find_errors(bench.list_views()).values())
    assert least > most == 0.0


def test_a_scene_without_a_cloth_or_without_the_option_has_no_such_knob() -> None:
    assert set(sweep_knob(TINY, "cloth_step").left_out.values()) == {"the scene lacks a cloth"}
    assert sweep.prepare_scene(load_scene("hall:cloths=1"), KNOBS["cloth_step"]) is None
    assert sweep.find_missing_option("city:blocks=2", KNOBS["drops"]) == "the scene has no option drops"
    assert sweep.find_missing_option("model.glb", KNOBS["drops"]) == "the scene has no option drops"
    assert sweep.find_missing_option("hall:flags=2", KNOBS["drops"]) is None
    assert sweep.find_missing_option("city", KNOBS["fxaa"]) is None


def test_what_an_absence_changes_is_an_error_unless_it_is_simulated_unseen() -> None:
    situation = replace(TINY, scene="hall:columns=23,flags=0,cloths=12", size=(96, 54), rounds=1)
    rest, simulated = sweep_knob(situation, "unseen").rows
    assert rest.mean_error > simulated.mean_error == 0.0
    assert rest.is_default
    assert set(sweep_knob(TINY, "unseen").left_out.values()) == {
        "the scene lacks something that an absence would change"
    }


def test_frames_that_remember_nothing_are_not_compared() -> None:
    scene, knob = load_scene("city:blocks=4"), KNOBS["pyramid_texels"]
    with open_device("gl") as device, sweep.KnobBench(device, scene, TINY, knob, ["8"]) as bench:
        (first,) = bench.find_errors(bench.list_views()[:1]).values()
        with sweep.KnobBench(device, scene, TINY, knob, ["8"]) as other:
            other.draw_history()
            (later,) = other.find_errors(other.list_views()[:1]).values()
    assert first.summarize()[1] > 2.0 * later.summarize()[1] > 0.0  # all in view was drawn


@pytest.mark.nightly_cases(reason=CHEAPER_TEST)
def test_shares_find_together_what_one_finds_that_does_all() -> None:
    situation = replace(TINY, rounds=3)
    shares = sweep.list_shares(situation, "occluder_pixels")
    samples = [sweep.sweep_share(situation, "occluder_pixels", share) for share in shares]
    joined, whole = sweep.join_shares(samples), sweep_knob(situation, "occluder_pixels")
    found = [[(row.value, row.mean_error, row.max_error, row.worst) for row in one.rows] for one in (joined, whole)]
    assert found[0] == found[1]
    assert joined.pictures == whole.pictures
    assert [[len(value.seconds) for value in sample.values.values()] for sample in samples] == [[1] * 5, [2] * 5]
    assert [len(sample.truth_ratios) for sample in samples] == [1, 2]
    assert joined.rows[-1].ratio == 1.0


def test_frames_that_depend_on_earlier_ones_follow_each_other() -> None:
    scene, knob = load_scene("city:blocks=2"), KNOBS["pyramid_texels"]
    parts = sweep.list_frames(scene, TINY, knob, sweep.SweepShare())
    assert [len(some) for some in parts] == [knob.remembers, 2, 2]
    assert np.diff([one.number for some in parts for one in some]).tolist() == [1] * (knob.remembers + 3)
    short = replace(TINY, first=7, last=8)
    history, compared, timed = sweep.list_frames(scene, short, knob, sweep.SweepShare())
    assert [[one.number for one in some] for some in (history, compared, timed)] == [[], [7, 8], [7, 8]]


def test_a_sweep_has_two_shares_unless_frames_depend_on_earlier_ones() -> None:
    counts = {views: len(sweep.list_shares(replace(TINY, views=views, rounds=9), "fxaa")) for views in (1, 2, 9)}
    assert counts == {1: 1, 2: 2, 9: 2}
    assert len(sweep.list_shares(replace(TINY, rounds=1), "fxaa")) == 1  # each has a round
    assert len(sweep.list_shares(TINY, "pyramid_texels")) == len(sweep.list_shares(TINY, "normal_bits")) == 1
    for count in (1, 2, 4):
        parts = [sweep.SweepShare(number, count).take(range(11)) for number in range(count)]
        assert [item for part in parts for item in part] == list(range(11))
        assert max(map(len, parts)) - min(map(len, parts)) <= 1


def test_encodings_are_measured_without_a_frame() -> None:
    rough, fine = sweep_knob(TINY, "tangent_packing").rows
    assert rough.max_error > fine.max_error > 0.0
    assert fine.worst is None


def test_shadows_are_switched_on_for_their_knobs_only() -> None:
    scene = load_scene("city:blocks=2")
    assert sweep.prepare_scene(scene, KNOBS["fxaa"]) is None
    assert not scene.lights.point["casts_shadow"].any()
    assert sweep.prepare_scene(scene, KNOBS["occluders"]) is None
    assert "other triangles" in str(sweep.prepare_scene(load_scene("terrain:cells=8,trees=0"), KNOBS["occluders"]))
    assert sweep.prepare_scene(scene, KNOBS["shadow_size"]) is None
    assert scene.lights.point["casts_shadow"].all()


def test_views_are_spread_or_follow_each_other() -> None:
    scene = load_scene("city:blocks=2")
    spread = [one.number for one in sweep.list_views(scene, replace(TINY, views=3))]
    assert spread == sorted(spread)
    assert min(np.diff(spread)) > 100
    near = [one.number for one in sweep.list_views(scene, TINY, consecutive=True, count=5)]
    assert np.diff(near).tolist() == [1] * 4
    part = [one.number for one in sweep.list_views(scene, replace(TINY, first=100, last=110))]
    assert all(100 < number < 110 for number in part)
    assert [one.number for one in sweep.list_views(scene, replace(TINY, camera="street"))] == [0]


def test_the_mean_of_samples_is_one_of_light() -> None:
    picture = np.zeros((2, 2, 3))
    picture[0] = 255.0
    assert np.allclose(shrink_picture(picture, 2), 187.5, atol=0.5)  # half the light, not 127.5
    assert shrink_picture(picture, 1) is picture


def test_lights_that_reach_a_point_are_counted_by_range_and_cone() -> None:
    scene = load_scene("hall")
    spot = scene.lights.spot[0]
    away = 0.5 * float(spot["range"])
    camera = Camera.look_at(spot["position"], spot["position"] + spot["direction"])
    before, behind = away * np.asarray(spot["direction"], np.float64), -away * np.asarray(spot["direction"], np.float64)
    only = type("Lights", (), {"point": scene.lights.point[:0], "spot": scene.lights.spot[:1]})
    stage: Any = type("Stage", (), {"lights": only})
    counts = [sweep.count_reached(stage, camera, place[None]) for place in (before, behind, 3.0 * before)]
    assert counts == [1, 0, 0]


def test_a_picture_of_the_worst_place_has_three_parts() -> None:
    import io
    from base64 import b64decode

    from PIL import Image

    true, shown = np.zeros((200, 300, 3)), np.zeros((200, 300, 3))
    shown[199, 299] = 60.0
    pixels = np.asarray(Image.open(io.BytesIO(b64decode(sweep.crop_worst(true, shown, 299, 199)))))
    height, width = pixels.shape[0], pixels.shape[1] // 3
    assert (pixels[-1, 2 * width - 1] == 60).all()
    assert (pixels[-1, 3 * width - 1] == 240).all()
    assert not pixels[: height - 1].any()


def test_an_interval_holds_the_median_and_narrows_with_more_samples() -> None:
    few, many = np.random.default_rng(1).normal(1.0, 0.1, 8), np.random.default_rng(2).normal(1.0, 0.1, 400)
    one, other = Interval.of(few), Interval.of(many)
    assert one.low <= float(np.median(few)) == one.median <= one.high
    assert other.high - other.low < 0.5 * (one.high - one.low)
    assert Interval.of(np.full(5, 2.0)) == Interval(2.0, 2.0, 2.0)
    a, b = Measurement("a", (2.0, 4.0), (1.0, 1.0)), Measurement("b", (1.0, 1.0), (1.0, 2.0))
    assert a.compare_to(b) == Interval(3.0, 2.0, 4.0)
    assert a.compare_to(b, processor=True) == Interval(0.75, 0.5, 1.0)
