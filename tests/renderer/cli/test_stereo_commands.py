"""Two eyes on the command line: `render --stereo` and `compare stereo`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
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
    both = np.asarray(Image.open(here / "both.png")).astype(int)
    assert both.shape == (54, 96, 3)
    left, right = both[:, :48], both[:, 48:]
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


def test_the_matrix_has_a_row_for_each_way_and_its_ratio_to_one_eye(
    capsys: pytest.CaptureFixture[str],
) -> None:
    report = run(
        capsys,
        "compare",
        "stereo",
        CITY,
        "--backend",
        "null",
        "--sizes",
        "32x18,64x36",
        "--shadows",
        "off,on",
        "--stereo",
        "dubois,side_by_side,color_reprojected",
        "--frames",
        "2",
        "--json",
    )
    rows = report["rows"]
    names = ["mono", "dubois", "side_by_side", "color_reprojected"]
    assert [(row["stereo"], row["shadows"], tuple(row["size"])) for row in rows] == [
        (name, shadows, size) for size in ((32, 18), (64, 36)) for shadows in (False, True) for name in names
    ]
    assert all(row["milliseconds"] > 0 and row["ratio"] > 0 for row in rows)
    for mono, dubois, halves, moved in zip(*(rows[i::4] for i in range(4)), strict=True):
        assert mono["ratio"] == mono["processor_ratio"] == 1.0
        assert dubois["draws"] == halves["draws"] == 2 * moved["draws"] >= 2 * mono["draws"] > 0
        assert dubois["maps_drawn"] == moved["maps_drawn"] >= halves["maps_drawn"], (
            "smaller images, fewer maps"
        )
        more = dubois["maps_drawn"] - mono["maps_drawn"]
        assert abs(more) <= 1, "once for both eyes, which see a little more than one"
        assert (mono["maps_drawn"] > 0) == mono["shadows"]
        if not mono["shadows"]:
            scene = mono["calls"]
            light_calls = 2  # a kernel places the point lights for both eyes, another the spot lights
            assert halves["calls"] == 2 * scene + light_calls
            assert dubois["calls"] == halves["calls"] + 1, "a kernel mixes the colours"
            assert moved["calls"] == mono["calls"] + 3, "two kernels move pixels, and one mixes the colours"
            assert 0 < dubois["upload_bytes"] < 1.15 * mono["upload_bytes"] + 1000


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
