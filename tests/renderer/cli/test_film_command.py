"""`film`: its files, its report, and what it refuses."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from PIL import Image

from renderer.cli import main
from renderer.cli.film import parse_range

SCENE = "hall:columns=2,rows=2,flags=2,detail=3"
COMMAND = ["film", SCENE, "--camera", "ground", "--size", "48x27"]


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(*arguments: str) -> None:
    assert main([*COMMAND, *arguments]) == 0


@pytest.mark.parametrize(
    ("text", "frames"),
    [("0:600", range(600)), ("5:6", range(5, 6)), ("0:10:3", range(0, 10, 3)), ("7:9:1", range(7, 9))],
)
def test_a_range_is_that_of_python(text: str, frames: range) -> None:
    assert parse_range(text) == frames


@pytest.mark.parametrize(
    "text", ["", "5", "5:5", "6:5", "a:b", "-1:4", "0:4:0", "0:4:1:1", "0:", "0.5:3", "١:٣"]
)
def test_a_range_without_frames_is_refused(text: str, here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        run(f"--frames={text}", "--backend", "null", "--output", "%d.png")
    assert end.value.code == 2
    error = capsys.readouterr().err
    assert "is not a range of frames" in error
    assert error.count("\n") == 1


def test_images_are_written_and_reported(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run("--frames", "8:12:2", "--backend", "gl", "--output", "film/%03d.png", "--json")
    report = json.loads(capsys.readouterr().out)
    assert report.keys() == {
        "scene", "frames", "drawn", "reused", "size", "devices", "seconds", "output",
    }  # fmt: skip
    assert (report["frames"], report["drawn"], report["reused"], report["size"]) == (2, 2, 0, [48, 27])
    assert [device.partition(":")[0] for device in report["devices"]] == ["gl"]
    assert sorted(path.name for path in here.glob("film/*")) == ["008.png", "010.png"]
    with Image.open(here / "film/008.png") as image:
        assert image.size == (48, 27)
        assert len(image.getcolors(2000) or ()) > 20


def test_the_same_command_draws_only_missing_frames(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ("--frames", "0:5", "--backend", "gl", "--output", "%d.png")
    run(*command)
    complete = {path.name: path.read_bytes() for path in here.iterdir()}
    (here / "2.png").unlink()
    (here / "3.png").write_bytes(complete["3.png"][:100])
    capsys.readouterr()
    run(*command, "--executor", "threads:2")
    assert "5 frames, 2 drawn" in (output := capsys.readouterr().out)
    assert "3 existed" in output
    assert {path.name: path.read_bytes() for path in here.iterdir()} == complete


def test_frames_of_other_settings_are_refused(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ("--frames", "0:2", "--backend", "gl", "--output", "%d.png")
    run(*command, "--technique", "forward")
    with pytest.raises(SystemExit):
        run(*command, "--technique", "clustered")
    assert "[film-other]" in capsys.readouterr().err
    run(*command)  # auto is forward


def test_a_video_has_the_rate_of_its_frames(here: Path) -> None:
    av = pytest.importorskip("av", reason="no PyAV: pip install rhi[video]")
    run("--frames", "0:8:2", "--backend", "gl", "--output", "film.mp4", "--overlay", "--particles")
    with av.open("film.mp4") as file:
        stream = file.streams.video[0]
        assert float(stream.average_rate) == 30.0
        assert (stream.width, stream.height) == (48, 26)
        assert sum(1 for _ in file.decode(stream)) == 4
    assert [path.name for path in here.iterdir()] == ["film.mp4"]


def test_two_eyes_are_drawn_side_by_side(here: Path) -> None:
    run("--frames", "4:5", "--backend", "gl", "--output", "%d.png", "--stereo", "side_by_side")
    run("--frames", "4:5", "--backend", "gl", "--output", "one-%d.png")
    with Image.open("4.png") as both_eyes, Image.open("one-4.png") as single:
        assert both_eyes.tobytes() != single.tobytes()


def test_the_null_device_draws_black_frames_and_says_so(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run("--frames", "0:2", "--backend", "null", "--output", "%d.png")
    assert "the null device draws nothing" in capsys.readouterr().err
    assert len(list(here.iterdir())) == 2


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        (["--output", "film.png"], "film-output"),
        (["--output", "%s.png"], "film-output"),
        (["--output", "film.nothing"], "video-file"),
        (["--output", "%d.png", "--frames", "0:99999"], "camera-frame-range"),
        (["--output", "%d.png", "--camera", "nowhere"], "camera-unknown-name"),
        (["--output", "%d.png", "--executor", "magic"], "none of serial, processes"),
        (["--output", "%d.png", "--eye-distance", "0.1"], "without --stereo"),
        (["--output", "%d.png", "--backend", "vulkan"], "vulkan"),
        ([], "--output"),
    ],
)
def test_bad_arguments_end_in_one_line_and_leave_nothing(
    here: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], error: str
) -> None:
    with pytest.raises(SystemExit) as end:
        main(["film", SCENE, "--frames", "0:2", "--backend", "null", *arguments])
    assert end.value.code == 2
    printed = capsys.readouterr().err
    assert error in printed
    assert len([line for line in printed.splitlines() if line.startswith("error:")]) == 1
    assert list(here.iterdir()) == []


@pytest.mark.nightly
def test_ctrl_c_keeps_finished_frames_and_ends_the_processes(here: Path) -> None:
    """As a terminal sends it: to all processes of the command."""
    import os
    import signal
    import time

    command = [
        sys.executable, "-m", "renderer", *COMMAND, "--frames", "0:1800", "--backend", "gl",
        "--executor", "processes:2", "--output", "%d.png",
    ]  # fmt: skip
    process = subprocess.Popen(
        command, stderr=subprocess.PIPE, text=True, start_new_session=True, encoding="utf-8"
    )
    deadline = time.monotonic() + 120.0
    while len(list(here.glob("*.png"))) < 5 and time.monotonic() < deadline:
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGINT)
    _, error = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "interrupted: finished frames are stored" in error
    assert "Traceback" not in error
    finished = {path.name: path.stat().st_mtime_ns for path in here.glob("*.png")}
    assert 5 <= len(finished) < 1800
    run("--frames", "0:6", "--backend", "gl", "--output", "%d.png")
    assert all((here / name).stat().st_mtime_ns == time for name, time in finished.items())
