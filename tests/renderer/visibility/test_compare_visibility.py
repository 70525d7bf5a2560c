"""`compare visibility`: its rows, table and chart."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from occlusion_scenes import delay_answers
from PIL import Image

from renderer.cli import main
from renderer.cli.compare_visibility import Picture, list_frames
from renderer.visibility import ALGORITHMS
from renderer.visibility.software_depth import can_rasterise

ROW = [
    "algorithm", "milliseconds", "ratio", "triangles", "draws", "queries", "software_state_changes",
    "hardware_state_changes", "wrong_pixels", "tied_pixels", "stalled_milliseconds", "simulation_steps",
    "skipped_simulations",
]  # fmt: skip
COMMAND = ["compare", "visibility", "city:blocks=4,detail=2", "--size", "64x36", "--frames", "3"]


@pytest.mark.usefixtures("gl")
def test_rows_say_what_each_algorithm_costs(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    delay_answers(monkeypatch, 1)  # so that who waits for answers has something to wait for
    assert main([*COMMAND, "--camera-path", "sky", "--backend", "gl", "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["backend"] == "gl"
    assert report["camera_path"] == "sky"
    assert report["frames"] == 3
    rows = {row["algorithm"]: row for row in report["rows"]}
    assert list(rows) == list(ALGORITHMS)
    assert all(list(row) == ROW for row in rows.values())
    assert rows["none"]["ratio"] == 1.0
    assert all(row["wrong_pixels"] == 0 for row in rows.values())
    assert rows["none"]["queries"] == rows["frustum"]["queries"] == 0
    assert rows["stop_and_wait"]["queries"] > rows["chc_plus_plus"]["queries"] > 0
    assert rows["stop_and_wait"]["stalled_milliseconds"] > 0 == rows["none"]["stalled_milliseconds"]
    # Boxes are counted: those that stop-and-wait asks for, and nothing hides the whole city.
    assert rows["stop_and_wait"]["draws"] > rows["stop_and_wait"]["queries"]


@pytest.mark.parametrize(("teleport", "frames"), [
    (None, [10, 11, 12, 13, 14, 15, 16]), (1, [10, 61, 12, 63, 14, 65, 16]), (3, [10, 11, 12, 63, 64, 65, 16]),
])  # fmt: skip
def test_a_teleport_is_half_a_path_long(teleport: int | None, frames: list[int]) -> None:
    assert list_frames(10, 6, 100, teleport) == frames
    assert list_frames(90, 2, 100, 1) == [90, 41, 92]


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
    plain = capsys.readouterr().out.splitlines()
    assert main([*command, "--markdown"]) == 0
    table = [line.strip("| ").split(" | ") for line in capsys.readouterr().out.splitlines()]
    assert [len(line) for line in table] == [11] * 4
    assert " ".join(table[0]).split() == plain[0].split()
    assert [line[0] for line in table[2:]] == ["none", "frustum"]
    assert [line[3] for line in table[2:]] == [line.split()[3] for line in plain[2:]]


@pytest.mark.usefixtures("gl")
def test_a_table_and_a_chart(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    chart = tmp_path / "new" / "chart.png"
    assert main([*COMMAND, "--algorithms", "frustum,chc", "--plot", str(chart)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].split()[:3] == ["algorithm", "ms", "ratio"]
    assert [line.split()[0] for line in lines[2:]] == ["frustum", "chc"]
    assert np.asarray(Image.open(chart)).std() > 10


def test_the_null_device_compares_what_asks_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*COMMAND, "--backend", "null", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["rows"]
    beside = ["software_depth"] if can_rasterise() else []
    assert [row["algorithm"] for row in rows] == ["none", "frustum", *beside, "auto"]
    assert {row["wrong_pixels"] for row in rows} == {None}
    assert rows[0]["triangles"] >= rows[1]["triangles"] > 0
    with pytest.raises(SystemExit):
        main([*COMMAND, "--backend", "null", "--algorithms", "chc"])
    assert "null-samples" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("extra", "said"),
    [
        (["--algorithms", "frustum,magic"], "'magic' is not an algorithm"),
        (["--camera-path", "grund"], "did you mean 'ground'"),
        (["--frame", "1798"], "camera-frame-range"),
        (["--plot", "chart.nothing"], "has no known image extension"),
    ],
)
def test_bad_input_of_compare_is_one_line(
    capsys: pytest.CaptureFixture[str], extra: list[str], said: str
) -> None:
    with pytest.raises(SystemExit) as stop:
        main([*COMMAND, "--backend", "null", *extra])
    assert stop.value.code == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1


def test_pixels_differ_by_what_they_show_or_by_the_order_of_draws() -> None:
    image, depth = np.zeros((4, 5, 4), np.uint8), np.full((4, 5), 0.5, np.float32)
    expected = Picture(image, depth)
    other, nearer = image.copy(), depth.copy()
    other[1, 2, 0] = 1
    other[3, 4] = 255
    assert expected.compare(expected) == (0, 0)
    assert Picture(other, depth).compare(expected) == (0, 2)
    nearer[3, 4] = np.nextafter(np.float32(0.5), np.float32(1.0))
    assert Picture(other, nearer).compare(expected) == (1, 1)


@pytest.mark.slow
@pytest.mark.usefixtures("gl")
@pytest.mark.parametrize("frames", ["20", pytest.param("60", marks=pytest.mark.nightly)])
def test_at_ground_level_the_counts_are_those_of_the_thesis_or_less(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, frames: str
) -> None:
    delay_answers(monkeypatch, 0)  # late ones cost triangles: no matter of the algorithms
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
