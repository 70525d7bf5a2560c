"""Scenes that load while a viewer's frames go on: progress, errors, scripts, uploads, and the first scene."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from renderer.content import BackgroundLoad, background, load_scene
from renderer.frame import UploadSettings
from renderer.scene import Scene
from renderer.viewer.scene_loading import SceneLoading, make_placeholder
from renderer.viewer.viewer import Viewer
from rhi import Device, create_device
from rhi.errors import ValidationError
from tests.renderer.content.test_background import write_model

SIZE = (96, 54)
SECONDS = 60.0


class Gate:
    """Holds loads back until it is opened."""

    def __init__(self) -> None:
        self.opened = threading.Event()
        self.texts: list[str] = []

    def load(self, text: str) -> Scene:
        self.texts.append(text)
        assert self.opened.wait(SECONDS)
        return load_scene(text)


@pytest.fixture
def gate(monkeypatch: pytest.MonkeyPatch) -> Iterator[Gate]:
    gate = Gate()
    monkeypatch.setattr(background, "load_scene", gate.load)
    yield gate
    gate.opened.set()


@pytest.fixture
def device() -> Iterator[Device]:
    with create_device("null") as device:
        yield device


@pytest.fixture
def viewer(device: Device) -> Iterator[Viewer]:
    viewer = Viewer(device, load_scene("grid:count=9"), size=SIZE)
    viewer.file_reloader.patience = 0.0
    yield viewer
    viewer.close()


def finish(viewer: Viewer) -> None:
    """Wait for the thread that loads; the next frame shows the scene."""
    load = viewer.file_reloader.loading._load
    assert load is not None
    assert load.join(SECONDS)


def test_frames_show_the_old_scene_and_the_progress_until_the_new_scene_is_loaded(
    viewer: Viewer, gate: Gate
) -> None:
    before = viewer.session.scene
    assert viewer.run("scene city:blocks=3") == ("loading city:blocks=3: 0%", False)
    for _ in range(3):
        viewer.draw()
        assert viewer.session.scene is before
        assert viewer._interface.state.corner.endswith("loading city:blocks=3: 0%")
    gate.opened.set()
    finish(viewer)
    viewer.draw()
    scene = viewer.session.scene
    assert scene.name.startswith("city:blocks=3,")
    assert np.allclose(viewer.session.camera.view, next(iter(scene.views.values())).view)
    assert "loading" not in viewer._interface.state.corner
    assert (scene.name, False) in viewer.console.lines


def test_a_scene_is_flown_through_at_a_speed_that_suits_its_size(viewer: Viewer) -> None:
    viewer.file_reloader.patience = None
    speeds = []
    for blocks in (3, 12):
        viewer.run("scene grid:count=4")
        viewer.run(f"scene city:blocks={blocks}")
        speeds.append(viewer.session.controller.speed)
    assert 2.0 < speeds[1] / speeds[0] < 6.0


@pytest.mark.parametrize("line", ["scene nowhere.glb", "scene city:blocks=x"])
def test_a_scene_that_cannot_be_loaded_leaves_the_old_one_and_an_error(viewer: Viewer, line: str) -> None:
    before = viewer.session.scene
    message, _ = viewer.run(line)
    if viewer.is_loading:
        assert message.startswith("loading")
        finish(viewer)
        viewer.draw()
    assert viewer.session.scene is before
    assert any(is_error for _, is_error in viewer.console.lines)
    assert not viewer.is_loading


def test_an_error_of_a_library_that_reads_a_file_is_shown(
    viewer: Viewer, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(text: str) -> Scene:
        raise ZeroDivisionError(text)

    monkeypatch.setattr(background, "load_scene", fail)
    viewer.file_reloader.loading.follow(BackgroundLoad("grid"), lambda scene: scene.name)
    finish(viewer)
    viewer.draw()
    assert any(is_error and "ZeroDivisionError: grid" in line for line, is_error in viewer.console.lines)


def test_another_scene_takes_the_turn_of_one_that_is_loading(viewer: Viewer, gate: Gate) -> None:
    viewer.run("scene city:blocks=3")
    viewer.run("scene grid:count=4")
    gate.opened.set()
    finish(viewer)
    viewer.draw()
    viewer.draw()
    assert gate.texts == ["city:blocks=3", "grid:count=4"]
    assert len(viewer.session.scene.objects) == 4


def test_the_lines_of_a_script_wait_for_the_scene(viewer: Viewer, gate: Gate) -> None:
    viewer.run_script("scene grid:count=4\nobjects\n")
    viewer.draw()
    viewer.draw()
    assert not any(line.startswith("> objects") for line, _ in viewer.console.lines)
    gate.opened.set()
    finish(viewer)
    viewer.draw()
    viewer.draw()
    assert ("4 objects, 4 of them not hidden", False) in viewer.console.lines


def test_no_longer_watching_files_goes_on_loading(viewer: Viewer, gate: Gate) -> None:
    viewer.file_reloader.watch(True)
    viewer.run("scene grid:count=4")
    viewer.run("reload off")
    assert viewer.is_loading
    gate.opened.set()
    finish(viewer)
    viewer.draw()
    assert len(viewer.session.scene.objects) == 4


def test_closing_a_viewer_cancels_its_load(device: Device, gate: Gate) -> None:
    viewer = Viewer(device, load_scene("grid:count=9"), size=SIZE)
    viewer.file_reloader.patience = 0.0
    viewer.run("scene city")
    load = viewer.file_reloader.loading._load
    viewer.close()
    gate.opened.set()
    assert load is not None
    assert load.join(SECONDS)
    with pytest.raises(ValidationError, match="scene-load-cancelled"):
        load.poll()


# -- uploads -------------------------------------------------------------------------------------------------


def test_a_scene_is_uploaded_over_frames_and_then_looks_the_same(gl: Device, tmp_path: Path) -> None:
    """The three images of 256 KiB need three frames at least; the viewer asks for them although nothing moves."""
    model = write_model(tmp_path, 3, 256)
    images = []
    for uploads in (None, UploadSettings(1 << 18)):
        viewer = Viewer(gl, load_scene("grid:count=9"), size=SIZE)
        viewer._interface.is_hidden = True
        viewer.session.uploads = uploads
        viewer.run(f"scene {model}")
        viewer.run_script("objects")
        frames = 0
        while viewer.session.is_uploading:
            assert viewer.is_moving
            assert not any(line == "> objects" for line, _ in viewer.console.lines)
            assert "uploading" in viewer._describe().corner
            viewer.draw()
            frames += 1
        assert (frames >= 2) == (uploads is not None)
        assert ("uploading" in viewer._interface.state.corner) == (uploads is not None)
        assert viewer.is_moving
        images.append(viewer.draw().read())
        assert any(line == "> objects" for line, _ in viewer.console.lines)
        viewer.close()
    assert len(np.unique(images[0].reshape(-1, 4), axis=0)) > 100
    assert np.array_equal(*images)


# -- the first scene -----------------------------------------------------------------------------------------


def test_a_placeholder_draws_nothing(device: Device) -> None:
    scene = make_placeholder("city:blocks=3")
    viewer = Viewer(device, scene, size=SIZE)
    viewer.draw()
    result = viewer.session.latest_result
    assert scene.name == "city:blocks=3"
    assert result is not None
    assert len(result.visible) == 0
    viewer.close()


def test_a_loading_that_has_nothing_to_load_says_nothing() -> None:
    loading = SceneLoading()
    assert (loading.update(), loading.wait(0.0), loading.describe(), loading.is_loading) == (
        "",
        "",
        "",
        False,
    )
    loading.cancel()


def test_a_long_text_is_shortened_at_its_beginning(gate: Gate) -> None:
    loading = SceneLoading()
    loading.follow(BackgroundLoad("folder/" * 20 + "engine.glb"), lambda scene: scene.name)
    text = loading.describe()
    loading.cancel()
    assert text.startswith("loading …")
    assert text.endswith("/folder/engine.glb: 0%")
    assert len(text) < 60
