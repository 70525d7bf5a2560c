"""`compare visibility`: its rows, table and chart."""

from __future__ import annotations

import io
import itertools
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_reports import read_report
from occlusion_scenes import delay_query_results
from PIL import Image

import rhi
from renderer.cli import main
from renderer.cli.output import show_progress
from renderer.content import load_scene
from renderer.lab.comparisons.visibility_comparison import (
    HISTORY_FREE,
    ComparedFrame,
    FrameImage,
    list_contenders,
    list_frames,
)
from renderer.renderer import Renderer
from renderer.visibility import ALGORITHMS, VisibilitySettings, make_visibility
from renderer.visibility.software_depth import can_rasterise
from tests.renderer.conftest import open_device

ROW = [
    "algorithm",
    "milliseconds",
    "ratio",
    "triangles",
    "draws",
    "queries",
    "software_state_changes",
    "hardware_state_changes",
    "wrong_pixels",
    "tied_pixels",
    "stalled_milliseconds",
    "simulation_steps",
    "skipped_simulations",
    "kernels",
]
COMMAND = ["compare", "visibility", "city:blocks=4,detail=2", "--size", "64x36", "--frames", "3"]


@pytest.fixture(scope="module")
def sky_report() -> dict[str, Any]:
    """The comparison of all algorithms along the sky path. Answers of queries take a frame, so that who waits
    for them waits."""
    with open_device("gl"), pytest.MonkeyPatch.context() as monkeypatch:
        delay_query_results(monkeypatch, 1)
        report: dict[str, Any] = read_report(*COMMAND, "--camera-path", "sky", "--backend", "gl", "--json")
    return report


@pytest.fixture(scope="module")
def sky_rows(sky_report: dict[str, Any]) -> dict[str, dict[str, Any]]:
    return {row["algorithm"]: row for row in sky_report["rows"]}


def test_a_comparison_names_its_backend_path_and_frames(sky_report: dict[str, Any]) -> None:
    measured_on = (sky_report["backend"], sky_report["camera_path"], sky_report["frames"])
    assert measured_on == ("gl", "sky", 3)


def test_each_algorithm_has_a_row_of_all_columns(sky_rows: dict[str, dict[str, Any]]) -> None:
    assert list(sky_rows) == list(ALGORITHMS)
    assert all(list(row) == ROW for row in sky_rows.values())


def test_times_are_ratios_to_drawing_everything(sky_rows: dict[str, dict[str, Any]]) -> None:
    assert sky_rows["none"]["ratio"] == 1.0


def test_no_algorithm_draws_wrong_pixels(sky_rows: dict[str, dict[str, Any]]) -> None:
    assert all(row["wrong_pixels"] == 0 for row in sky_rows.values())


def test_only_algorithms_that_ask_have_queries(sky_rows: dict[str, dict[str, Any]]) -> None:
    assert sky_rows["none"]["queries"] == sky_rows["frustum"]["queries"] == 0
    assert sky_rows["stop_and_wait"]["queries"] > sky_rows["chc_plus_plus"]["queries"] > 0


def test_stop_and_wait_waits_for_its_answers(sky_rows: dict[str, dict[str, Any]]) -> None:
    assert sky_rows["stop_and_wait"]["stalled_milliseconds"] > 0 == sky_rows["none"]["stalled_milliseconds"]


def test_boxes_of_queries_are_counted_as_draws(sky_rows: dict[str, dict[str, Any]]) -> None:
    # Nothing hides the whole city, so objects are drawn beside the boxes.
    assert sky_rows["stop_and_wait"]["draws"] > sky_rows["stop_and_wait"]["queries"]


@pytest.mark.parametrize(("teleport", "frames"), [
    (None, [10, 11, 12, 13, 14, 15, 16]), (1, [10, 61, 12, 63, 14, 65, 16]), (3, [10, 11, 12, 63, 64, 65, 16]),
])  # fmt: skip
def test_a_teleport_is_half_a_path_long(teleport: int | None, frames: list[int]) -> None:
    assert [frame.number for frame in list_frames(10, 6, 100, teleport=teleport)] == frames
    assert [frame.number for frame in list_frames(90, 2, 100, teleport=1)] == [90, 41, 92]


@pytest.mark.parametrize(("stride", "warm_up", "drawn"), [
    (1, 0, "0! 1! 2!"), (1, 1, "0 1! 2! 3!"), (1, 2, "0 1 2! 3! 4!"),
    (4, 0, "0! 4! 8!"), (4, 1, "0 1! 4 5! 8 9!"), (4, 3, "0 1 2 3! 4 5 6 7! 8 9 10 11!"),
    (4, 5, "0 1 2 3 4 5! 6 7 8 9! 10 11 12 13!"),  # no frame twice
])  # fmt: skip
def test_frames_far_apart_follow_others_that_are_not_counted(stride: int, warm_up: int, drawn: str) -> None:
    frames = list_frames(0, 3, 100, stride=stride, warm_up=warm_up)
    assert frames == [ComparedFrame(int(text.strip("!")), "!" in text) for text in drawn.split()]


@pytest.mark.usefixtures("gl")
def test_the_whole_path_is_its_frames_at_a_stride(capsys: pytest.CaptureFixture[str]) -> None:
    command = [*COMMAND, "--backend", "gl", "--json", "--algorithms", "none,frustum"]
    assert main([*command, "--frames", "4", "--stride", "450", "--warm-up", "2"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert (report["first_frame"], report["stride"], report["warm_up"]) == (226, 450, 2)  # to 1576 of 1,800
    scene = load_scene(COMMAND[2])
    with rhi.create_device("null") as device, Renderer(device, scene, size=(64, 36)) as renderer:
        renderer.visibility = make_visibility("frustum", scene, device)
        path = scene.paths["ground"]
        drawn = [
            renderer.render(path.camera(frame), frame / 60).statistics.draws
            for frame in range(226, 1800, 450)
        ]
    assert report["rows"][1]["draws"] == round(sum(drawn) / 4)
    assert len(set(drawn)) > 1


@pytest.mark.parametrize("algorithm", HISTORY_FREE)
def test_algorithms_without_history_draw_a_frame_the_same_after_any_other(
    gl: rhi.Device, algorithm: str
) -> None:
    if algorithm == "software_depth" and not can_rasterise():
        pytest.skip("no OpenCL")
    scene = load_scene(COMMAND[2])
    path = scene.paths["ground"]
    with Renderer(gl, scene, size=(64, 36)) as renderer:
        results = []
        for before in ([], [1500, 300, 899]):
            renderer.visibility = make_visibility(algorithm, scene, gl)
            for frame in [*before, 900]:
                result = renderer.render(path.camera(frame))
            results.append((result.visible.tolist(), result.visibility))
            renderer.visibility.destroy()
    (first, counted), (second, again) = results
    assert first == second
    assert (counted.queries, counted.boxes, counted.visible) == (again.queries, again.boxes, again.visible)


@pytest.mark.usefixtures("gl")
def test_emulated_queries_draw_and_ask_the_same_beside_native_ones(
    capsys: pytest.CaptureFixture[str],
) -> None:
    command = [*COMMAND, "--backend", "gl", "--json", "--queries", "emulated,native"]
    assert main([*command, "--algorithms", "frustum,stop_and_wait,chc,chc_plus_plus"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["queries"] == ["native", "emulated"]
    rows = {row["algorithm"]: row for row in report["rows"]}
    assert list(rows) == [
        "frustum",
        "stop_and_wait",
        "chc",
        "chc_plus_plus",
        "stop_and_wait (emulated)",
        "chc (emulated)",
        "chc_plus_plus (emulated)",
    ]
    waits, emulated = rows["stop_and_wait"], rows["stop_and_wait (emulated)"]
    counters = ("triangles", "draws", "queries", "software_state_changes")
    assert [waits[name] for name in counters] == [emulated[name] for name in counters]
    assert all(row["wrong_pixels"] == 0 for row in rows.values())


def test_contenders_have_the_kind_of_queries_that_they_are_named_by() -> None:
    tuned = VisibilitySettings(batch=7, emulated=True)
    both = list_contenders(["none", "chc", "chc_plus_plus"], VisibilitySettings(), tuned, [False, True])
    assert {
        contender.name: (contender.algorithm, contender.settings.batch, contender.settings.emulated)
        for contender in both
    } == {
        "none": ("none", 50, False),
        "chc": ("chc", 50, False),
        "chc_plus_plus": ("chc_plus_plus", 50, False),
        "optimized_chc_plus_plus": ("chc_plus_plus", 7, False),
        "chc (emulated)": ("chc", 50, True),
        "chc_plus_plus (emulated)": ("chc_plus_plus", 50, True),
        "optimized_chc_plus_plus (emulated)": ("chc_plus_plus", 7, True),
    }
    alone = list_contenders(["none", "chc"], VisibilitySettings(), None, [True])
    assert [(contender.name, contender.settings.emulated) for contender in alone] == [
        ("none", True),
        ("chc", True),
    ]


@pytest.mark.usefixtures("gl")
def test_with_emulated_queries_alone_nothing_is_drawn_on_condition(
    capsys: pytest.CaptureFixture[str],
) -> None:
    command = [*COMMAND, "--frames", "1", "--backend", "gl", "--queries", "emulated"]
    assert main([*command, "--json"]) == 0
    names = [row["algorithm"] for row in json.loads(capsys.readouterr().out)["rows"]]
    assert names == [name for name in ALGORITHMS if name != "conditional"]
    with pytest.raises(SystemExit):
        main([*command, "--algorithms", "conditional"])
    error = capsys.readouterr().err
    assert "emulated queries" in error
    assert error.count("\n") == 1


def test_progress_is_shown_on_a_terminal_only(monkeypatch: pytest.MonkeyPatch) -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    for stream, is_shown in ((Terminal(), True), (io.StringIO(), False)):
        monkeypatch.setattr(sys, "stderr", stream)
        clock = itertools.count(step=10.0)  # a frame takes long: work of less than a second shows nothing
        monkeypatch.setattr("tqdm.std.time", lambda clock=clock: next(clock))
        assert list(show_progress(range(3), "compare")) == [0, 1, 2]
        assert ("compare" in stream.getvalue()) is is_shown


@pytest.mark.usefixtures("gl")
def test_teleports_lose_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*COMMAND, "--frames", "6", "--teleport", "2", "--backend", "gl", "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["teleport"] == 2
    assert all(row["wrong_pixels"] == 0 for row in report["rows"])


@pytest.mark.usefixtures("gl")
def test_above_a_threshold_of_0_the_error_is_counted(capsys: pytest.CaptureFixture[str]) -> None:
    command = [*COMMAND, "--backend", "gl", "--json", "--algorithms", "frustum,stop_and_wait"]
    assert main([*command, "--threshold", "100"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["settings"]["threshold"] == 100
    wrong = {row["algorithm"]: row["wrong_pixels"] for row in report["rows"]}
    assert wrong["frustum"] == 0 < wrong["stop_and_wait"]
    assert main(command) == 0
    assert all(row["wrong_pixels"] == 0 for row in json.loads(capsys.readouterr().out)["rows"])


def test_a_table_in_markdown_has_the_same_columns(capsys: pytest.CaptureFixture[str]) -> None:
    command = [*COMMAND, "--backend", "null", "--algorithms", "none,frustum"]
    assert main(command) == 0
    plain = capsys.readouterr().out.splitlines()[:-2]  # without the machine
    assert main([*command, "--markdown"]) == 0
    table = [line.strip("| ").split(" | ") for line in capsys.readouterr().out.splitlines()[:-2]]
    assert [len(line) for line in table] == [12] * 4
    assert " ".join(table[0]).split() == plain[0].split()
    assert [line[0] for line in table[2:]] == ["none", "frustum"]
    assert [line[3] for line in table[2:]] == [line.split()[3] for line in plain[2:]]


@pytest.mark.usefixtures("gl")
def test_a_table_and_a_chart(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    chart = tmp_path / "new" / "chart.png"
    assert main([*COMMAND, "--algorithms", "frustum,chc", "--plot", str(chart)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].split()[:3] == ["algorithm", "ms", "ratio"]
    assert [line.split()[0] for line in lines[2:-2]] == ["frustum", "chc"]
    assert np.asarray(Image.open(chart)).std() > 10


def test_the_null_device_compares_algorithms_without_queries(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*COMMAND, "--backend", "null", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["rows"]
    beside = ["software_depth"] if can_rasterise() else []
    assert [row["algorithm"] for row in rows] == ["none", "frustum", *beside, "auto"]
    assert {row["wrong_pixels"] for row in rows} == {None}
    assert rows[0]["triangles"] >= rows[1]["triangles"] > 0


def test_pixels_differ_by_color_and_depth_or_by_the_order_of_draws() -> None:
    image, depth = np.zeros((4, 5, 4), np.uint8), np.full((4, 5), 0.5, np.float32)
    expected = FrameImage(image, depth)
    other, nearer = image.copy(), depth.copy()
    other[1, 2, 0] = 1
    other[3, 4] = 255
    assert expected.compare(expected) == (0, 0)
    assert FrameImage(other, depth).compare(expected) == (0, 2)
    nearer[3, 4] = np.nextafter(np.float32(0.5), np.float32(1.0))
    assert FrameImage(other, nearer).compare(expected) == (1, 1)


@pytest.mark.nightly
@pytest.mark.usefixtures("gl")
@pytest.mark.parametrize("frames", ["20", "60"])
def test_at_ground_level_the_counts_are_those_of_the_thesis_or_less(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, frames: str
) -> None:
    delay_query_results(monkeypatch, 0)  # late ones cost triangles: no matter of the algorithms
    command = [
        "compare",
        "visibility",
        "city",
        "--camera-path",
        "ground",
        "--frames",
        frames,
        "--size",
        "320x180",
    ]
    algorithms = ["--algorithms", "frustum,stop_and_wait,chc,chc_plus_plus"]
    assert main([*command, *algorithms, "--backend", "gl", "--json"]) == 0
    rows = {row["algorithm"]: row for row in json.loads(capsys.readouterr().out)["rows"]}
    ours = rows["chc_plus_plus"]
    assert ours["triangles"] <= 0.15 * rows["frustum"]["triangles"]
    assert ours["queries"] <= 0.1 * rows["stop_and_wait"]["queries"]
    assert ours["hardware_state_changes"] <= 0.15 * rows["chc"]["hardware_state_changes"]
    assert all(row["wrong_pixels"] == 0 for row in rows.values())
