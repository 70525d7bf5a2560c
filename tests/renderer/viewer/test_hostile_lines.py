"""Lines that a stranger might send: each is refused in a sentence, and the frames go on."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from refusals import refused_message

import rhi
from renderer.content import load_scene
from renderer.scene.files import parse_path, read_file
from renderer.viewer import Viewer

HUGE = "9" * 3000


@pytest.fixture(scope="module")
def viewer() -> Iterator[Viewer]:
    with rhi.create_device("null") as device:
        opened = Viewer(device, load_scene("grid:count=4"), size=(64, 36))
        yield opened
        opened.close()


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working folder, with files that are hard to read."""
    monkeypatch.chdir(tmp_path)
    for name, text in {
        "list": "[" * 100_000,
        "object": '{"a":' * 100_000,
        "zero": "\0",
        "nan": '{"a": NaN}',
    }.items():
        (tmp_path / f"{name}.json").write_text(text, encoding="utf-8")
    (tmp_path / "bytes.json").write_bytes(b"\xff\0")
    (tmp_path / "folder.json").mkdir()
    os.mkfifo(tmp_path / "pipe.json")
    with (tmp_path / "large.json").open("wb") as large:
        large.truncate(1 << 40)
    return tmp_path


FILES = (
    "list",
    "object",
    "zero",
    "nan",
    "bytes",
    "folder",
    "pipe",
    "large",
    "\0",
    "\ud800",
    "x" * 5000,
    "missing",
)


@pytest.mark.parametrize("command", ["settings", "play", "camera", "script"])
@pytest.mark.parametrize("name", FILES)
def test_a_file_that_can_not_be_read_is_refused(viewer: Viewer, command: str, name: str) -> None:
    if (command, name) in (("script", "list"), ("script", "object"), ("script", "zero"), ("script", "nan")):
        return  # they are text, and their lines are refused later
    assert refused_message(viewer.run, f"{command} '{name}.json'")
    viewer.draw()


@pytest.mark.parametrize(
    "line",
    [
        "\0",
        "technique \0",
        "screenshot a\0.png",
        "save settings a\0.json",
        "save settings \ud800.json",
        "record a\0.json",
        f"pick {HUGE},{HUGE}",
        "pick 99999999999999999999,1",
        "pick -1,0",
        "pick 9223372036854775808,0",
        "camera 1e308,0,0,-1e308,0,0",
        "camera 1e308,1e308,1e308",
        "camera 1e39,0,0,1e39,1,0",
        "camera nan,0,0",
        "camera inf,0,0,0,0,0",
        f"camera {HUGE},0,0",
        "time 1e308",
        "wait 1e308",
        "speed 1e308",
        f"time {HUGE}",
        "time nan",
        "screenshot folder.json/a.png/b.png",
        "save settings folder.json",
        "show " + HUGE,
        "'",
        "\\",
    ],
)
def test_a_hostile_line_is_refused_and_changes_nothing(viewer: Viewer, line: str) -> None:
    before = viewer.session.camera
    refused_message(viewer.run, line)
    assert viewer.session.camera is before or (viewer.session.camera.position == before.position).all()
    viewer.draw()


@pytest.mark.parametrize("line", ["camera 1e18,0,0,0,0,0", "time 1e9", "pick 1,1", "speed 1e9", "wait 0"])
def test_large_numbers_that_can_be_drawn_are_taken(viewer: Viewer, line: str) -> None:
    assert not viewer.run(line)[1]
    viewer.draw()
    viewer.run("camera 0,2,5,0,1,0")
    viewer.run("time 0")


def test_while_it_listens_commands_write_below_one_folder_only(
    viewer: Viewer, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        viewer.session, "screenshot", lambda: np.zeros((4, 4, 4), np.uint8)
    )  # the null device has none
    outside = folder / "outside"
    inside = folder / "inside"
    for writable_folder in (outside, inside, inside / "b"):
        writable_folder.mkdir()
    (inside / "link").symlink_to(outside)
    assert not viewer.run(f"save settings {outside}/before.json")[1]
    viewer.listen(0, inside)
    for command, end in (("screenshot", "png"), ("save settings", "json"), ("record", "json")):
        for target in (outside, "../outside", "link", "a/../../outside"):
            assert str(inside) in refused_message(viewer.run, f"{command} {target}/evil.{end}")
        for name in ("a", "b/c"):
            message, is_error = viewer.run(f"{command} {name}.{end}")
            assert not is_error, message
            viewer.draw()
            if command == "record":
                assert not viewer.run("record")[1]
            assert (inside / f"{name}.{end}").is_file()
    assert not viewer.run("screenshot")[1]
    assert [path.name for path in outside.iterdir()] == ["before.json"]
    assert [path.name for path in folder.glob("*.png")] == []
    viewer.session.folder = None


def test_a_file_is_read_up_to_the_allowed_size(tmp_path: Path) -> None:
    large = tmp_path / "large"
    with large.open("wb") as file:
        file.truncate((1 << 40) + 1)  # takes no room; as much memory there isn't
    with pytest.raises(OSError, match="more than 1,099,511,627,776 bytes"):
        read_file(large, 1 << 40)
    unknown = Path("/proc/self/maps")  # which says 0
    if unknown.exists():
        with pytest.raises(OSError, match="more than 9 bytes"):
            read_file(unknown, 9)
    for text in ("", "a\0b"):
        with pytest.raises(ValueError, match=f"^{text}$"):
            parse_path(text)
