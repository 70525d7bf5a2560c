"""A viewer on a screen: events and images through canvases of rendercanvas."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

pytest.importorskip("rendercanvas", reason="no rendercanvas: pip install rhi[viewer]")

from screens_kit import open_display

import renderer
from renderer.cli import main
from renderer.content import BackgroundLoad, background, load_scene
from renderer.scene import Camera, Depth, Scene
from renderer.settings import RenderSettings
from renderer.techniques import TechniqueSettings
from renderer.viewer import viewer_screen as viewer_screen_module
from renderer.viewer.viewer import Viewer
from renderer.viewer.viewer_screen import ViewerScreen, open_viewer
from rhi import RhiError
from rhi_screen import Screen, open_screen

SCENE = "grid:count=9"
SIZE = (96, 54)


@pytest.fixture
def viewer_screen() -> Iterator[ViewerScreen]:
    opened = open_viewer(SCENE, "null", canvas="offscreen", size=SIZE)
    yield opened
    opened.close()


def tick(viewer_screen: ViewerScreen) -> None:
    """Do what a canvas's scheduler does: take the events, then draw."""
    viewer_screen.screen.canvas._process_events()
    viewer_screen.screen.canvas.force_draw()


def drag(canvas: Any, x: float, y: float = 10.0) -> None:
    event = {
        "x": 10.0,
        "y": 10.0,
        "button": 1,
        "buttons": (1,),
        "modifiers": (),
        "ntouches": 0,
        "touches": {},
    }
    canvas.submit_event({**event, "event_type": "pointer_down"})
    canvas.submit_event({**event, "event_type": "pointer_move", "x": x, "y": y})
    canvas.submit_event({**event, "event_type": "pointer_up", "x": x, "y": y, "buttons": ()})


@pytest.mark.usefixtures("gl")
def test_an_event_is_seen_in_the_frame_after_it() -> None:
    """From input to image it is one frame: the first one that is shown after the event differs, and shows it
    all."""
    viewer_screen = open_viewer(SCENE, "gl", canvas="offscreen", size=SIZE)
    viewer_screen.viewer._interface.is_hidden = True  # whose counter differs in each frame
    images = []
    for number in range(5):
        if number == 3:
            drag(viewer_screen.screen.canvas, 40.0)
        tick(viewer_screen)
        images.append(viewer_screen.screen.canvas._last_image)
    viewer_screen.close()
    assert (images[1] == images[2]).all()
    assert (images[2] != images[3]).any()
    assert (images[3] == images[4]).all()


@pytest.mark.parametrize("ratio", [1.0, 2.0])
def test_a_command_sets_the_size_of_the_canvas_in_physical_pixels(
    viewer_screen: ViewerScreen, ratio: float
) -> None:
    viewer_screen.screen.canvas.set_pixel_ratio(ratio)
    assert viewer_screen.viewer.run("size 128x64") == ("128 x 64 pixels", False)
    tick(viewer_screen)
    assert viewer_screen.screen.size == viewer_screen.viewer.session.renderer.size == (128, 64)
    assert viewer_screen.viewer.run("size") == ("128 x 64 pixels", False)
    for wrong in ("15x64", "128", "128x64x3", "20000x64", "axb"):
        assert viewer_screen.viewer.run(f"size {wrong}")[1]
    tick(viewer_screen)
    assert viewer_screen.screen.size == (128, 64)


def test_frames_are_drawn_while_something_moves_and_only_then(
    viewer_screen: ViewerScreen, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[int] = []
    canvas = viewer_screen.screen.canvas
    monkeypatch.setattr(canvas, "request_draw", lambda draw=None: asked.append(viewer_screen.frames))
    tick(viewer_screen)  # and it is told its size
    asked.clear()
    tick(viewer_screen)
    assert asked == []
    canvas.submit_event({"event_type": "key_down", "key": "w", "modifiers": ()})
    for _ in range(3):
        tick(viewer_screen)
    assert asked == [2, 3, 4, 5]  # the event, and each frame


def test_a_resized_canvas_has_frames_of_its_size(viewer_screen: ViewerScreen) -> None:
    tick(viewer_screen)
    viewer_screen.screen.canvas.set_physical_size(40, 30)
    tick(viewer_screen)
    assert viewer_screen.screen.canvas._last_image.shape == (30, 40, 4)


def test_quitting_and_the_last_frame_close_the_canvas(viewer_screen: ViewerScreen) -> None:
    viewer_screen.end_after = 3
    for number in range(3):
        assert not viewer_screen.screen.canvas.get_closed(), number
        tick(viewer_screen)
    assert viewer_screen.screen.canvas.get_closed()
    other = open_viewer(SCENE, "null", canvas="offscreen", size=SIZE)
    other.viewer.run("quit")
    tick(other)
    assert other.screen.canvas.get_closed()
    other.close()
    other.close()


def test_lines_that_come_over_the_socket_are_run_by_the_next_frame(viewer_screen: ViewerScreen) -> None:
    import socket

    port = viewer_screen.listen(0)
    with socket.create_connection(("127.0.0.1", port)) as client:
        client.settimeout(5.0)
        client.sendall(viewer_screen.viewer.greeting.encode() + b"\ntechnique deferred\ntechnique nonsense\n")
        for _ in range(2):
            tick(viewer_screen)
        reply = b""
        while reply.count(b"\n") < 3:
            reply += client.recv(999)
        assert reply.startswith(b"ok\nok technique deferred\nerror: a command doesn't accept this argument")
    assert viewer_screen.viewer.session.display.technique == "deferred"


def test_a_saved_file_asks_the_loop_of_the_screen_for_a_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    loop = Mock(**{"call_soon_threadsafe.side_effect": [None, AttributeError]})
    monkeypatch.setattr(viewer_screen_module, "get_loop", lambda canvas: loop)
    shown_viewer = open_viewer(SCENE, "null", canvas="offscreen", size=SIZE)
    assert shown_viewer.viewer.file_reloader.is_watching
    shown_viewer.viewer.file_reloader.wake()
    loop.call_soon_threadsafe.assert_called_once_with(shown_viewer.screen.canvas.request_draw)
    # a file that is saved while the loop ends is no error of the thread that sees it
    shown_viewer.viewer.file_reloader.wake()
    shown_viewer.close()
    assert not shown_viewer.viewer.file_reloader.is_watching


def test_a_screen_that_exists_can_show_a_viewer(viewer_screen: ViewerScreen) -> None:
    again = ViewerScreen(
        viewer_screen.viewer, Screen(viewer_screen.screen.canvas, viewer_screen.screen.device)
    )
    tick(again)
    assert again.frames == 1


# -- a scene that is loaded while frames go on -----------------------------------------------------------------


class Opening:
    """A viewer's screen whose scene is loaded once `gate` is set, and what `begin` has seen."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, backend: str, text: str, **options: Any) -> None:
        self.gate = threading.Event()
        self.began: list[tuple[str, float, int]] = []

        def load(text: str) -> Scene:
            assert self.gate.wait(60.0)
            return load_scene(text)

        monkeypatch.setattr(background, "load_scene", load)
        options = {"canvas": "offscreen", "size": SIZE, "reload": False, **options}
        self.screen = open_viewer(text, backend, begin=self.begin, **options)

    def begin(self, viewer_screen: ViewerScreen) -> None:
        session = viewer_screen.viewer.session
        self.began.append((session.scene.name, session.seconds, session.counter.frames))

    def finish(self) -> None:
        """Load the scene; the next frame shows it."""
        self.gate.set()
        self.screen.viewer.file_reloader.loading._load.join(60.0)


@pytest.mark.usefixtures("gl")
@pytest.mark.parametrize("camera", [None, Camera.look_at((2.0, 3.0, 6.0), (0.0, 0.5, 0.0))])
def test_a_scene_that_loads_while_frames_go_on_then_looks_as_if_it_had_been_waited_for(
    monkeypatch: pytest.MonkeyPatch, camera: Camera | None
) -> None:
    expected = open_viewer(SCENE, "gl", canvas="offscreen", size=SIZE, reload=False, camera=camera)
    opening = Opening(monkeypatch, "gl", SCENE, camera=camera)
    for viewer_screen in (expected, opening.screen):
        viewer_screen.viewer._interface.is_hidden = True
    tick(opening.screen)
    tick(opening.screen)
    empty = opening.screen.screen.canvas._last_image
    assert (empty == empty[0, 0]).all()
    assert opening.began == []
    opening.finish()
    tick(opening.screen)
    tick(expected)
    assert opening.began == [(expected.viewer.session.scene.name, 0.0, 0)]
    images = [opened.screen.canvas._last_image for opened in (expected, opening.screen)]
    assert (images[0] != images[0][0, 0]).any()
    assert (images[0] == images[1]).all()
    for viewer_screen in (expected, opening.screen):
        viewer_screen.close()


def test_ten_frames_a_second_are_drawn_while_a_scene_loads(monkeypatch: pytest.MonkeyPatch) -> None:
    opening = Opening(monkeypatch, "null", SCENE)
    canvas, rates = opening.screen.screen.canvas, []
    monkeypatch.setattr(canvas, "set_update_mode", lambda mode, *, min_fps: rates.append((mode, min_fps)))
    tick(opening.screen)
    assert rates == []  # it was set before
    opening.finish()
    tick(opening.screen)
    tick(opening.screen)
    assert rates == [("ondemand", 0.0)]
    opening.screen.close()


def test_a_scene_that_loads_at_once_needs_no_frames_before_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(viewer_screen_module, "_PATIENCE", 60.0)
    begin = Mock()
    viewer_screen = open_viewer(SCENE, "null", canvas="offscreen", size=SIZE, begin=begin)
    begin.assert_called_once_with(viewer_screen)
    assert len(viewer_screen.viewer.session.scene.objects) == 9
    assert not viewer_screen.viewer.is_loading
    viewer_screen.close()


def test_a_name_that_no_scene_has_is_refused_before_a_screen_opens(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(viewer_screen_module, "_PATIENCE", 60.0)
    monkeypatch.setattr(viewer_screen_module, "open_screen", Mock(side_effect=AssertionError))
    with pytest.raises(RhiError, match="scene-unknown"):
        open_viewer("citty", "null", canvas="offscreen", size=SIZE, begin=Mock())


def test_a_screen_that_cannot_be_opened_cancels_the_load(monkeypatch: pytest.MonkeyPatch) -> None:
    loads: list[BackgroundLoad] = []

    def begin_load(text: str) -> BackgroundLoad:
        loads.append(BackgroundLoad(text))
        return loads[-1]

    monkeypatch.setattr(viewer_screen_module, "BackgroundLoad", begin_load)
    monkeypatch.setattr(viewer_screen_module, "open_screen", Mock(side_effect=OSError("no screen")))
    with pytest.raises(OSError, match="no screen"):
        Opening(monkeypatch, "null", SCENE)
    (load,) = loads
    assert load._is_cancelled.is_set()


def test_the_error_of_a_scene_that_is_waited_for_names_the_line_of_the_call() -> None:
    with pytest.raises(RhiError, match=r"at: .*test_viewer_screen\.py"):
        open_viewer("citty", "null", canvas="offscreen", size=SIZE)


def test_a_first_scene_that_cannot_be_loaded_ends_the_loop_with_its_error(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    opening = Opening(monkeypatch, "null", "nowhere.glb")
    tick(opening.screen)
    opening.finish()
    with pytest.raises(RhiError, match="scene-missing-file"):
        opening.screen.run()
    assert opening.began == []
    opening.screen.close()


def test_a_refused_argument_of_the_first_scene_ends_the_loop_with_its_error(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    opening = Opening(monkeypatch, "null", SCENE)
    monkeypatch.setattr(opening, "begin", Mock())
    opening.screen.viewer.file_reloader.loading._show = Mock(side_effect=KeyError("stereo"))
    opening.finish()
    with pytest.raises(KeyError, match="stereo"):
        opening.screen.run()
    opening.screen.close()


def test_an_unknown_camera_ends_the_command_with_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit), pytest.MonkeyPatch.context() as patch:
        patch.setattr(viewer_screen_module, "open_screen", open_offscreen)
        main(["view", SCENE, "--backend", "null", "--camera", "nowhere", "--size", "96x54"])
    stderr = capsys.readouterr().err
    assert "nowhere" in stderr
    assert stderr.count("\n") == 1


def open_offscreen(backend: str, *, size: tuple[int, int], canvas: str, **options: Any) -> Screen:
    """Open an offscreen canvas whose loop draws ten frames, in place of a window."""
    screen = open_screen(backend, size=size, canvas="offscreen")
    run = screen.run
    screen.run = lambda draw: run(draw, frames=10)
    return screen


# -- notebooks -----------------------------------------------------------------------------------------------


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::RuntimeWarning")
def test_a_widget_is_turned_by_the_events_of_its_page() -> None:
    """Frames go out as jupyter_rfb's messages, and events come in as its page sends them."""
    pytest.importorskip("jupyter_rfb", reason="no jupyter_rfb: pip install jupyter_rfb")

    viewers: list[Viewer] = []
    plain = Viewer.__init__

    def note(viewer: Viewer, *arguments: Any, **named: Any) -> None:
        viewers.append(viewer)
        plain(viewer, *arguments, **named)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Viewer, "__init__", note)
        widget = renderer.view(SCENE, "null", canvas="jupyter", size=SIZE)
    (viewer,) = viewers
    widget.handle_event({"event_type": "resize", "width": 96.0, "height": 54.0, "pixel_ratio": 1.5})
    widget.get_frame()
    assert widget._last_image.shape == (81, 144, 4)
    before = viewer.session.camera.forward
    pointer = {"button": 1, "buttons": (1,), "modifiers": (), "ntouches": 0, "touches": {}, "time_stamp": 0}
    widget.handle_event({**pointer, "event_type": "pointer_down", "x": 10, "y": 10})
    widget.handle_event({**pointer, "event_type": "pointer_move", "x": 50, "y": 10})
    widget.handle_event({"event_type": "key_down", "key": "t", "modifiers": (), "time_stamp": 0})
    widget.get_frame()
    after = viewer.session.camera.forward
    left = np.degrees(np.arctan2(before[0], before[2]) - np.arctan2(after[0], after[2]))
    assert left % 360.0 == pytest.approx(60.0 * 40 / 54)
    assert viewer.session.display.technique != "forward"
    widget.handle_event({"event_type": "close"})
    widget.close()
    assert viewer.session.renderer.device.closed


# -- windows -------------------------------------------------------------------------------------------------


def run_view(environment: dict[str, str], *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "renderer", "view", SCENE, "--size", "96x54", *arguments]
    clean = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY")}
    return subprocess.run(
        command, env=clean | environment, capture_output=True, text=True, timeout=300, encoding="utf-8"
    )


def test_without_glfw_one_line_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "glfw", None)
    monkeypatch.delitem(sys.modules, "rhi_screen.window", raising=False)
    with pytest.raises(SystemExit):
        main(["view", SCENE])
    stderr = capsys.readouterr().err
    assert stderr.startswith("error: a package that is needed here is not installed: glfw is missing")
    assert 'pip install "rhi[viewer]"' in stderr
    assert stderr.count("\n") == 1


def test_a_window_shows_the_frames_of_a_script(tmp_path: Path) -> None:
    script = tmp_path / "tour.txt"
    image_path, walk = tmp_path / "shot.png", tmp_path / "walk.json"
    settings_path, saved_path = tmp_path / "given.json", tmp_path / "saved.json"
    RenderSettings(TechniqueSettings("deferred"), algorithm="none", depth=Depth.STANDARD).save(settings_path)
    lines = (
        "camera overview",
        f"screenshot {image_path}",
        f"record {walk}",
        "wait 0.2",
        "record",
        f"save settings {saved_path}",
    )
    script.write_text("\n".join([*lines, "quit"]), encoding="utf-8")
    settings = ("--settings", str(settings_path), "--visibility", "frustum")
    with open_display(tmp_path) as display:
        done = run_view(display.environment, "--backend", "gl", "--script", str(script), *settings)
    assert (done.returncode, done.stderr) == (0, "")
    assert RenderSettings.load(saved_path) == RenderSettings.load(settings_path).change(
        "algorithm", "frustum"
    )
    assert image_path.stat().st_size > 1000
    assert main(["render", SCENE, "--backend", "null", "--camera", str(walk), "--json"]) == 0
