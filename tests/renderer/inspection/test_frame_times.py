"""The times of frames and of their passes, and the command that writes them."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest

import rhi
from renderer.cli import main
from renderer.content import load_scene
from renderer.inspection.frame_times import CapturedFrame, PassTime, capture_frames, list_passes, write_frames
from renderer.renderer import Renderer
from renderer.scene import PathFrame
from renderer.techniques import ForwardMultipass


def test_each_frame_has_the_times_of_its_own_passes(null: rhi.Device) -> None:
    scene = load_scene("hall:columns=4,flags=2")
    view = next(iter(scene.views.values()))
    away = view.__class__.look_at(
        (0, 900, 0), (0, 1000, 1), projection=view.projection
    )  # no local light in view
    path_frames = [PathFrame(7, view), PathFrame(8, away), PathFrame(9, view)]
    with Renderer(null, scene, technique=ForwardMultipass(), size=(32, 16)) as renderer:
        frames = list(capture_frames(renderer, path_frames))
    lit = ["base", "point lights", "spot lights", "resolve"]
    assert [frame.frame for frame in frames] == [7, 8, 9]
    assert [list(frame.passes) for frame in frames] == [lit, ["forward"], lit]
    assert list_passes(frames) == [*lit, "forward"]
    assert all(0.0 < time.cpu < frame.milliseconds for frame in frames for time in frame.passes.values())
    assert not null.timing  # as it was


def test_a_row_is_a_frame_and_times_that_it_lacks_are_empty(tmp_path: Path) -> None:
    frames = [
        CapturedFrame(3, 2.5, {"base": PassTime(1.25, 0.5)}),
        CapturedFrame(4, 3.0, {"base": PassTime(None, 0.25), "resolve": PassTime(0.125, 1.0)}),
    ]
    write_frames(tmp_path / "times.csv", frames)
    with (tmp_path / "times.csv").open(encoding="utf-8") as file:
        assert list(csv.reader(file)) == [
            ["frame", "ms", "base gpu ms", "base cpu ms", "resolve gpu ms", "resolve cpu ms"],
            ["3", "2.5000", "1.2500", "0.5000", "", ""],
            ["4", "3.0000", "", "0.2500", "0.1250", "1.0000"],
        ]


def test_capture_writes_a_table_and_a_chart(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table, chart = tmp_path / "new" / "frames.csv", tmp_path / "new" / "frames.svg"
    command = "capture grid:count=4 --backend null --size 32x16 --frames 5 --frame 3 --fxaa --json"
    assert main([*command.split(), "--output", str(table), "--plot", str(chart)]) == 0
    assert list(json.loads(capsys.readouterr().out)) == ["frame", "forward", "fxaa"]
    with table.open(encoding="utf-8") as file:
        rows = list(csv.reader(file))
    assert [row[0] for row in rows] == ["frame", "3", "4", "5", "6", "7"]
    assert "<svg" in chart.read_text(encoding="utf-8")


def test_more_samples_than_a_technique_draws_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    common = ["plan", "grid:count=4", "--samples", "4"]
    with pytest.raises(SystemExit) as ended:
        main([*common, "--technique", "inferred"])
    assert ended.value.code == 2
    assert "technique-one-sample" in capsys.readouterr().err
    assert main(common) == 0
    assert "resolve" in capsys.readouterr().out
