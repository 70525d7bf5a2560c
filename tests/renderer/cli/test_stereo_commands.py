"""Two eyes on the command line: `render --stereo` and `compare stereo`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_reports import read_report
from PIL import Image

from renderer.cli import main

CITY = "city:blocks=4"
WALK = ("--camera", "ground", "--frame", "600", "--backend", "null", "--json", "--size", "64x36")


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Run in an empty folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("RHI_BACKEND", raising=False)
    return tmp_path


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, Any]:
    assert main(list(arguments)) == 0
    report: dict[str, Any] = json.loads(capsys.readouterr().out)
    return report


def test_two_eyes_draw_twice_as_much(capsys: pytest.CaptureFixture[str]) -> None:
    mono = run(capsys, "render", CITY, *WALK)
    stereo = run(capsys, "render", CITY, "--stereo", "dubois", "--eye-distance", "0", *WALK)
    assert stereo["draws"] == 2 * mono["draws"]
    assert stereo["triangles"] == 2 * mono["triangles"]
    assert "stereo" not in mono
    assert (stereo["stereo"], stereo["eye_distance"]) == ("dubois", 0.0)


def test_stereo_defaults_to_a_comfortable_eye_distance_and_convergence(
    capsys: pytest.CaptureFixture[str],
) -> None:
    # The street enters the image 1.8 m below the eye and some 3 m ahead; its harmonic middle with infinity is
    # at 6 m.
    report = run(capsys, "render", CITY, "--stereo", "grey", *WALK)
    assert report["eye_distance"] == 0.063
    assert 5.0 < report["convergence"] < 7.0
    with_convergence = run(capsys, "render", CITY, "--stereo", "grey", "--convergence", "2", *WALK)
    assert (with_convergence["eye_distance"], with_convergence["convergence"]) == (0.063, 2.0)


@pytest.mark.usefixtures("gl")
def test_the_image_shows_both_eyes_and_another_one_the_holes(
    capsys: pytest.CaptureFixture[str], here: Path
) -> None:
    report = run(
        capsys,
        "render",
        CITY,
        "--camera",
        "ground",
        "--frame",
        "600",
        "--backend",
        "gl",
        "--json",
        "--size",
        "96x54",
        "--stereo",
        "side_by_side",
        "--holes",
        "holes.png",
        "--output",
        "both.png",
        "--eye-distance",
        "0.5",
    )
    pair_image = np.asarray(Image.open(here / "both.png")).astype(int)
    assert pair_image.shape == (54, 96, 3)
    left, right = pair_image[:, :48], pair_image[:, 48:]
    assert 0 < np.abs(left - right).mean() < 30
    holes = (np.asarray(Image.open(here / "holes.png")) == (255, 0, 255)).all(axis=2)
    assert report["holes"] == holes.sum() > 0


@pytest.mark.parametrize(
    "arguments", [["--eye-distance", "0.1"], ["--swap-eyes"], ["--reproject"], ["--toe-in"]]
)
def test_one_eye_has_no_distance(capsys: pytest.CaptureFixture[str], arguments: list[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(["render", CITY, "--backend", "null", "--size", "64x36", *arguments])
    assert end.value.code == 2
    assert "stereo-one-eye" in capsys.readouterr().err
    assert main(["render", CITY, "--backend", "null", "--size", "64x36", "--stereo", "grey", *arguments]) == 0


OUTPUTS = ("mono", "dubois", "side_by_side", "color_reprojected")


@pytest.fixture(scope="module")
def matrix() -> list[dict[str, Any]]:
    """Rows of two sizes, without shadows and with them, of each output."""
    options = [
        "--backend",
        "null",
        "--frames",
        "2",
        "--json",
        "--sizes",
        "32x18,64x36",
        "--shadows",
        "off,on",
    ]
    report = read_report("compare", "stereo", CITY, *options, "--stereo", ",".join(OUTPUTS[1:]))
    rows: list[dict[str, Any]] = report["rows"]
    return rows


def list_cases(matrix: list[dict[str, Any]]) -> list[dict[str, dict[str, Any]]]:
    """The rows of each size, without shadows and with them, by their output."""
    return [dict(zip(OUTPUTS, matrix[i : i + 4], strict=True)) for i in range(0, len(matrix), 4)]


def test_the_matrix_has_a_row_for_each_size_shadow_and_output(matrix: list[dict[str, Any]]) -> None:
    assert [(row["stereo"], row["shadows"], tuple(row["size"])) for row in matrix] == [
        (name, shadows, size)
        for size in ((32, 18), (64, 36))
        for shadows in (False, True)
        for name in OUTPUTS
    ]


def test_times_of_the_matrix_are_ratios_to_one_eye(matrix: list[dict[str, Any]]) -> None:
    assert all(row["milliseconds"] > 0 and row["ratio"] > 0 for row in matrix)
    assert all(case["mono"]["ratio"] == case["mono"]["processor_ratio"] == 1.0 for case in list_cases(matrix))


def test_two_eyes_of_the_matrix_draw_twice_unless_one_is_reprojected(matrix: list[dict[str, Any]]) -> None:
    for case in list_cases(matrix):
        draws = {name: row["draws"] for name, row in case.items()}
        assert draws["dubois"] == draws["side_by_side"] == 2 * draws["color_reprojected"]
        assert draws["dubois"] >= 2 * draws["mono"] > 0


def test_shadow_maps_of_the_matrix_are_drawn_once_for_both_eyes(matrix: list[dict[str, Any]]) -> None:
    for case in list_cases(matrix):
        maps = {name: row["maps_drawn"] for name, row in case.items()}
        assert (maps["mono"] > 0) == case["mono"]["shadows"]
        assert abs(maps["dubois"] - maps["mono"]) <= 1  # two eyes see a little more than one
        assert (
            maps["dubois"] == maps["color_reprojected"] >= maps["side_by_side"]
        )  # smaller images, fewer maps


def test_two_eyes_of_the_matrix_make_no_more_calls_than_their_kernels_need(
    matrix: list[dict[str, Any]],
) -> None:
    for case in list_cases(matrix):
        calls = {name: row["calls"] for name, row in case.items()}
        if case["mono"]["shadows"]:
            continue
        light_kernels = 2  # one places the point lights for both eyes, the other the spot lights
        assert calls["side_by_side"] == 2 * calls["mono"] + light_kernels
        assert calls["dubois"] == calls["side_by_side"] + 1  # a kernel mixes the colours
        assert calls["color_reprojected"] == calls["mono"] + 3  # two kernels move pixels, and one mixes


def test_two_eyes_of_the_matrix_upload_little_more_than_one(matrix: list[dict[str, Any]]) -> None:
    for case in list_cases(matrix):
        if not case["mono"]["shadows"]:
            assert 0 < case["dubois"]["upload_bytes"] < 1.15 * case["mono"]["upload_bytes"] + 1000


def test_the_matrix_is_printed_as_a_table(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["compare", "stereo", CITY, "--backend", "null", "--sizes", "32x18"]
    arguments += ["--frames", "1", "--stereo", "grey"]
    assert main([*arguments, "--markdown"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("| stereo | shadows | size | ms | ratio |")
    assert lines[3].startswith("| grey | off | 32 × 18 |")
    with pytest.raises(SystemExit):
        main([*arguments, "--shadows", "maybe"])
    assert "neither off nor on" in capsys.readouterr().err
