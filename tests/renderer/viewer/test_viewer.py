"""The viewer: events in, images out, with a clock that the tests set."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from frames import list_owned
from gltf_documents import GltfDocument
from refusals import refused_message

import rhi
from renderer.content import load_scene, parse_camera
from renderer.layers.canvas import Canvas
from renderer.renderer import Renderer
from renderer.scene import CameraPath, Scene
from renderer.stereo import OUTPUTS
from renderer.techniques import TECHNIQUES, AutoTechnique
from renderer.viewer import DisplaySettings, Viewer
from renderer.viewer.key_bindings import KEY_BINDINGS, list_cameras
from renderer.viewer.session import suitable_speed

SIZE = (64, 48)
FRAME = 1.0 / 60.0


class Clock:
    """A clock that is set by hand."""

    def __init__(self) -> None:
        self.time = 5.0

    def __call__(self) -> float:
        return self.time


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("grid:count=9")


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def viewer(null: rhi.Device, scene: Scene, clock: Clock) -> Iterator[Viewer]:
    opened = Viewer(null, scene, size=SIZE, clock=clock)
    yield opened
    opened.close()


Draw = Callable[..., None]


@pytest.fixture
def draw(viewer: Viewer, clock: Clock) -> Draw:
    def draw(frames: int = 1) -> None:
        for _ in range(frames):
            clock.time += FRAME
            viewer.draw()

    return draw


def press(viewer: Viewer, *keys: str, hold: bool = False, modifiers: tuple[str, ...] = ()) -> None:
    for key in keys:
        viewer.handle({"event_type": "key_down", "key": key, "modifiers": modifiers})
        if not hold:
            viewer.handle({"event_type": "key_up", "key": key, "modifiers": modifiers})


def drag(viewer: Viewer, x: float, y: float) -> None:
    event: dict[str, Any] = {"x": 10, "y": 10, "button": 1, "buttons": (1,), "modifiers": (), "touches": {}}
    viewer.handle(event | {"event_type": "pointer_down"})
    viewer.handle(event | {"event_type": "pointer_move", "x": 10 + x, "y": 10 + y})
    viewer.handle(event | {"event_type": "pointer_up", "x": 10 + x, "y": 10 + y, "buttons": ()})


# -- input and image -----------------------------------------------------------------------------------------


def test_an_event_is_in_the_next_frame(viewer: Viewer, draw: Draw) -> None:
    with patch.object(Renderer, "render", autospec=True, side_effect=Renderer.render) as render:
        draw(2)
        drag(viewer, 20, 0)
        draw(2)
    seen = [call.args[1].forward for call in render.call_args_list]
    assert np.allclose(seen[0], seen[1])
    assert not np.allclose(seen[1], seen[2])
    assert np.allclose(seen[2], seen[3])


def test_a_held_key_moves_until_it_is_released(viewer: Viewer, draw: Draw) -> None:
    before = viewer.session.camera.position
    press(viewer, "w", hold=True)
    assert viewer.is_moving
    draw(30)
    there = viewer.session.camera.position
    assert (there - before) @ viewer.session.camera.forward > 0.0
    viewer.handle({"event_type": "key_up", "key": "w", "modifiers": ()})
    draw(90)
    assert not viewer.is_moving
    assert np.linalg.norm(viewer.session.camera.position - there) < np.linalg.norm(there - before)


def test_a_pause_without_frames_moves_nothing(viewer: Viewer, draw: Draw, clock: Clock) -> None:
    draw()
    before = viewer.session.camera.position
    clock.time += 100.0
    press(viewer, "w", hold=True)
    draw()
    assert np.linalg.norm(viewer.session.camera.position - before) < viewer.session.controller.speed * FRAME


def test_a_frame_that_takes_long_moves_no_farther_than_a_quarter_of_a_second(
    viewer: Viewer, draw: Draw, clock: Clock
) -> None:
    press(viewer, "w", hold=True)
    before = viewer.session.camera.position
    clock.time += 100.0
    draw()
    assert np.linalg.norm(viewer.session.camera.position - before) < 0.25 * viewer.session.controller.speed


@pytest.mark.parametrize("number", range(3))
def test_number_keys_go_to_the_scene_s_cameras(viewer: Viewer, draw: Draw, number: int) -> None:
    drag(viewer, 20, 5)
    name = list_cameras(viewer.session.scene)[number].partition(" ")[2]
    press(viewer, str(number + 1))
    draw()
    expected = parse_camera(
        name, viewer.session.scene, 1
    )  # of a path: the frame after the first 60th of a second
    assert np.allclose(viewer.session.camera.position, expected.position, atol=1e-9)


def test_a_path_is_shown_in_real_time_until_the_camera_is_moved(viewer: Viewer, draw: Draw) -> None:
    path = viewer.session.scene.paths["ground"]
    viewer.run("play ground")
    draw(120)
    assert viewer.session.replay is not None
    assert np.allclose(viewer.session.camera.position, path.camera(120).position, atol=1e-6)
    press(viewer, "s", hold=True)
    assert viewer.session.replay is None
    assert np.allclose(viewer.session.camera.position, path.camera(120).position, atol=1e-6)


def test_the_size_of_the_next_frame_is_that_of_the_canvas(viewer: Viewer) -> None:
    viewer.resize((32, 20), 2.0)
    assert viewer.draw().size == (32, 20)


# -- commands ------------------------------------------------------------------------------------------------


def test_every_key_runs_a_command_that_there_is(viewer: Viewer) -> None:
    names = {command.name for command in viewer.commands}
    of_screens = {"panel", "fullscreen"}  # which `test_panel.py` tests
    assert {line.split()[0] for line, _ in KEY_BINDINGS.values()} <= names | of_screens
    assert {line.split()[0] for line in list_cameras(viewer.session.scene)} <= names


@pytest.mark.parametrize("name", [AutoTechnique.name, *TECHNIQUES])
def test_every_technique_can_be_chosen(viewer: Viewer, draw: Draw, name: str) -> None:
    message, is_error = viewer.run(f"technique {name}")
    draw(2)
    assert (viewer.session.display.technique, is_error, message) == (name, False, f"technique {name}")
    assert viewer.session.renderer.technique.name == name


@pytest.mark.parametrize(
    "key", ["technique", "visibility", "show", "shadows", "blending", "stereo", "samples"]
)
def test_next_goes_round_through_all_choices(
    viewer: Viewer, draw: Draw, key: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "renderer.viewer.commands.list_algorithms", lambda device: ["none", "frustum"]
    )  # others build
    viewer.run("technique forward")
    begin = getattr(viewer.session.display, key)
    seen = []
    for _ in range(40):
        message, is_error = viewer.run(f"{key} next")
        assert not is_error, message
        draw()
        seen.append(getattr(viewer.session.display, key))
        if seen[-1] == begin:
            break
    assert seen[-1] == begin
    assert len(set(seen)) == len(seen)
    if key == "stereo":
        assert set(seen) == {*OUTPUTS, None}


@pytest.mark.parametrize("key", ["fxaa", "overlay", "particles", "grid"])
def test_a_switch_turns_on_and_off(viewer: Viewer, draw: Draw, key: str) -> None:
    for line, on in (
        (key, True),
        (key, False),
        (f"{key} on", True),
        (f"{key} on", True),
        (f"{key} off", False),
    ):
        assert viewer.run(line) == (f"{key} {'on' if on else 'off'}", False)
        draw()
        assert getattr(viewer.session.display, key) is on


def test_shadows_are_those_of_the_scene_again(null: rhi.Device, clock: Clock) -> None:
    city = load_scene("city:blocks=3")
    city.lights.directional["casts_shadow"] = True
    viewer = Viewer(null, city, size=SIZE, clock=clock)
    casts = [city.lights.directional["casts_shadow"].tolist(), city.lights.point["casts_shadow"].tolist()]
    for word, expected in (("off", 0), ("all", 1)):
        viewer.run(f"shadows {word}")
        assert city.lights.directional["casts_shadow"].tolist() == [expected]
        assert set(city.lights.point["casts_shadow"].tolist()) <= {bool(expected)}
    viewer.run("shadows scene")
    assert [
        city.lights.directional["casts_shadow"].tolist(),
        city.lights.point["casts_shadow"].tolist(),
    ] == casts
    viewer.close()


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("technique defered", "did you mean deferred"),
        ("visibility chc", "viewer-bad-argument"),  # the null device has no queries
        ("technique deferred; quit", "viewer-bad-argument"),
        ("samples 3", "viewer-bad-argument"),
        ("camera nowhere", "camera-unknown-name"),
        ("speed -1", "a number above 0"),
        ("time inf", "viewer-bad-argument"),
        ("pick 3", "viewer-bad-argument"),
        ("play", "no recording"),
        ("play missing.json", "No such file"),
        ("script missing.txt", "No such file"),
        ("screenshot x.png", "viewer-no-screenshot"),
        ("screenshot x.tiff2", "ends with .png"),
        ("capture x.txt", "ends with .csv"),
        ("capture x.csv 61", "FRAMES"),
        ("record walk.csv", "ends with .json"),
    ],
)
def test_a_refused_command_is_one_line_and_changes_nothing(
    viewer: Viewer, draw: Draw, line: str, says: str
) -> None:
    display, camera = viewer.session.display, viewer.session.camera
    message = refused_message(viewer.run, line)
    assert says in message
    assert "\n" not in message
    draw()
    assert viewer.session.display == display
    assert (viewer.session.camera.position == camera.position).all()


def test_samples_that_a_technique_lacks_are_refused(viewer: Viewer, draw: Draw) -> None:
    viewer.run("technique deferred")
    assert "technique-one-sample" in refused_message(viewer.run, "samples 4")
    draw()
    assert viewer.session.display == DisplaySettings().change(technique="deferred")


def test_samples_that_a_technique_lacks_are_refused_also_where_a_buffer_is_shown(viewer: Viewer) -> None:
    assert not viewer.run("show normals")[1]
    assert not viewer.run("samples 4")[1]
    assert "technique-one-sample" in refused_message(viewer.run, "technique deferred")


def test_a_look_that_cannot_be_drawn_gives_way_to_the_last_one(
    viewer: Viewer, draw: Draw, monkeypatch: pytest.MonkeyPatch
) -> None:
    viewer.run("technique clustered")
    draw()
    plain = Renderer.render

    def fail(renderer: Renderer, camera: Any, seconds: float = 0.0) -> Any:
        if renderer.technique.name == "inferred":
            from renderer import rules

            rhi.refuse(rules.TOO_MANY_MATERIALS, "render", "70,000")
        return plain(renderer, camera, seconds)

    monkeypatch.setattr(Renderer, "render", fail)
    viewer.run("technique inferred")
    draw()
    assert viewer.session.display.technique == "clustered"
    assert any("technique-too-many-materials" in line and is_error for line, is_error in viewer.console.lines)


def test_a_script_runs_its_lines_and_waits(viewer: Viewer, draw: Draw, tmp_path: Path) -> None:
    script = tmp_path / "tour.txt"
    script.write_text(
        "# a tour\ntechnique deferred\n\nwait 0.5\nvisibility none\nquit\ntechnique forward\n",
        encoding="utf-8",
    )
    viewer.run(f"script {script}")
    draw()
    assert (viewer.session.display.technique, viewer.session.display.visibility) == ("deferred", "frustum")
    draw(28)
    assert viewer.session.display.visibility == "frustum"
    draw(5)
    assert (viewer.session.display.visibility, viewer.is_over, viewer.session.display.technique) == (
        "none",
        True,
        "deferred",
    )


def test_a_script_that_runs_itself_ends_nothing(viewer: Viewer, draw: Draw, tmp_path: Path) -> None:
    script = tmp_path / "loop.txt"
    script.write_text(f"time 1\nscript {script}\n" + "time 2\n" * 400, encoding="utf-8")
    viewer.run(f"script {script}")
    draw(40)
    assert any("at most 10000" in line for line, _ in viewer.console.lines) or viewer.is_moving


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("set technique.tiles.tile 32", "technique.tiles.tile 32"),
        ("set shadows.filter poisson", "shadows.filter poisson"),
        ("set shadows.back_faces true", "shadows.back_faces True"),
        ("set textures.mip nearest", "textures.mip nearest"),
    ],
)
def test_any_setting_can_be_printed_and_set(viewer: Viewer, line: str, message: str) -> None:
    assert viewer.run(line) == (message, False)
    viewer.draw()
    assert viewer.run(line.rpartition(" ")[0]) == (message, False)


@pytest.mark.parametrize(
    ("line", "near"),
    [
        ("set shadows.filters hard", "shadows.filter"),
        ("set shadows.filter soft", "soft"),
        ("set shadows.cascades 99", "1 to 8"),
        ("set shadows.cascades " + "[" * 3000, "int"),
    ],
)
def test_a_setting_that_is_refused_changes_nothing(viewer: Viewer, line: str, near: str) -> None:
    before = viewer.session.display
    assert near in refused_message(viewer.run, line)
    assert viewer.session.display == before


def test_times_of_frames_and_passes_are_captured(viewer: Viewer, tmp_path: Path, draw: Draw) -> None:
    draw()
    message, is_error = viewer.run(f"capture {tmp_path}/times.csv 3")
    assert not is_error
    assert "ms a frame" in message
    head, *rows = (tmp_path / "times.csv").read_text(encoding="utf-8").splitlines()
    assert head.startswith("frame,ms,")
    assert "forward cpu ms" in head
    assert [row.split(",")[0] for row in rows] == ["1", "2", "3"]
    draw()


# -- the console ---------------------------------------------------------------------------------------------


def test_the_console_takes_the_keys_and_gives_them_back(viewer: Viewer, draw: Draw) -> None:
    press(viewer, "w", hold=True)
    press(viewer, "F2")
    for key in "time 7":
        press(viewer, key)
    draw()
    assert viewer.console.text == "time 7"
    press(viewer, "Enter")
    assert viewer.session.seconds == 7.0
    press(viewer, "F2")
    press(viewer, "t")
    assert viewer.session.display.technique != "forward"
    draw(60)
    assert not viewer._gestures.has_pressed_keys


def test_a_character_event_tells_which_character_a_key_is(viewer: Viewer) -> None:
    press(viewer, "`")
    viewer.handle({"event_type": "key_down", "key": "1", "modifiers": ("Shift",)})
    viewer.handle({"event_type": "char", "data": "!", "modifiers": ("Shift",)})
    viewer.handle({"event_type": "key_up", "key": "1", "modifiers": ("Shift",)})
    assert viewer.console.text == "!"
    press(viewer, "a")  # and where there is none, the key's name does
    viewer.draw()
    assert viewer.console.text == "!a"


def test_a_chord_is_not_typed(viewer: Viewer) -> None:
    press(viewer, "F2")
    press(viewer, "c", modifiers=("Control",))
    press(viewer, "Shift")
    viewer.draw()
    assert viewer.console.text == ""


# -- picking, images, recordings -----------------------------------------------------------------------------


def test_a_click_picks_the_object_under_it_and_a_drag_does_not(viewer: Viewer, draw: Draw) -> None:
    viewer.session.camera = parse_camera("0,9,0.1,0,0,0", viewer.session.scene)
    viewer.run("visibility none")
    draw()
    drag(viewer, 9, 0)
    assert viewer.session.hit is None
    press(viewer, "1")
    draw()
    middle = {"x": 32, "y": 24, "button": 1, "buttons": (1,), "modifiers": (), "touches": {}}
    viewer.handle(middle | {"event_type": "pointer_down"})
    viewer.handle(middle | {"event_type": "pointer_up", "buttons": ()})
    picked = viewer.session.hit
    assert picked is not None
    assert viewer.session.hit_lines[0].endswith(f"triangle {picked.triangle}")
    assert f"{picked.distance:.2f} m away" in viewer.session.hit_lines[0]
    assert viewer.session.hit_lines[1] == "drawn: everything is drawn"
    press(viewer, "Escape")
    assert viewer.session.hit is None


def test_an_orbit_is_around_the_picked_point(viewer: Viewer, draw: Draw) -> None:
    draw()
    viewer.run("pick 32,24")
    assert viewer.session.hit is not None
    press(viewer, "c")
    point = viewer.session.hit.point
    distance = np.linalg.norm(viewer.session.camera.position - point)
    drag(viewer, 15, 7)
    assert np.linalg.norm(viewer.session.camera.position - point) == pytest.approx(distance)
    press(viewer, "c")
    assert viewer.session.controller.name == "fly"


def test_a_recording_can_be_rendered_and_replayed(viewer: Viewer, draw: Draw, tmp_path: Path) -> None:
    file = tmp_path / "walks" / "walk.json"
    viewer.run(f"record {file}")
    press(viewer, "d", hold=True)
    draw(31)
    end = viewer.session.camera
    assert "31 frames" in viewer.run("record")[0]
    path = CameraPath.load(file)
    assert len(path) == 31
    assert np.allclose(path.camera(30).position, end.position, atol=1e-6)
    assert (parse_camera(str(file), viewer.session.scene, 30).position == path.camera(30).position).all()
    viewer.handle({"event_type": "key_up", "key": "d", "modifiers": ()})
    press(viewer, "1", "p")
    assert viewer.session.camera.position == pytest.approx(path.camera(0).position)


def test_a_recording_that_runs_is_written_at_the_end(
    null: rhi.Device, scene: Scene, clock: Clock, tmp_path: Path
) -> None:
    viewer = Viewer(null, scene, size=SIZE, clock=clock)
    viewer.run(f"record {tmp_path / 'walk.json'}")
    viewer.draw()
    viewer.close()
    assert len(CameraPath.load(tmp_path / "walk.json")) == 1


def test_the_interface_shows_its_state(viewer: Viewer, draw: Draw, monkeypatch: pytest.MonkeyPatch) -> None:
    texts: list[str] = []
    plain = Canvas.text

    def note(canvas: Canvas, x: float, y: float, text: str, *rest: Any) -> tuple[int, int]:
        texts.append(text)
        return plain(canvas, x, y, text, *rest)

    monkeypatch.setattr(Canvas, "text", note)
    viewer.resize((960, 540))
    draw(61)
    assert texts[-1].startswith("60 frames/s   16.7 ms   forward, frustum")
    press(viewer, "F1")
    texts.clear()
    draw()
    assert any("the next technique" in text for text in texts)
    press(viewer, "F1", "F2", "h", "e")
    texts.clear()
    draw()
    assert "> he" in texts
    press(viewer, "F2")
    viewer.run("nonsense")
    texts.clear()
    draw()
    assert any("no command of this name: nonsense" in text for text in texts)
    draw(60 * 5)
    texts.clear()
    draw()
    assert len(texts) == 1  # the counter: what was said is gone


def test_closing_leaves_nothing_on_the_device(null: rhi.Device, scene: Scene, clock: Clock) -> None:
    viewer = Viewer(null, scene, size=SIZE, clock=clock)
    for line in (
        "overlay",
        "technique deferred",
        "stereo dubois",
        "particles",
        "show normals",
        "visibility none",
    ):
        assert viewer.run(line)[1] is False
        viewer.draw()
    viewer.close()
    owned, left = list_owned(null)
    assert len(owned) > 20
    assert list(map(str, left)) == []


def test_the_speed_suits_the_scene_and_not_the_plain_around_it() -> None:
    city, hall = (suitable_speed(load_scene(name)) for name in ("city:blocks=3", "hall"))
    assert 2.0 < city < 40.0
    assert 0.5 < hall < 10.0


def test_a_clip_is_played_instead_of_clips_that_move_the_same_nodes(
    null: rhi.Device, tmp_path: Path, clock: Clock
) -> None:
    document = GltfDocument(nodes=[{"mesh": 0}])
    document.mesh()
    for distance in (2, 8):
        document.animate(0, "translation", [0, 1], [[0, 0, 0], [distance, 0, 0]])
    scene = load_scene(document.write(tmp_path / "a.glb"))
    viewer = Viewer(null, scene, size=SIZE, clock=clock)
    assert viewer.run("clip") == ("plays animation 0", False)
    assert viewer.run('clip "animation 1"') == ("plays animation 1", False)
    assert scene.clips["animation 0"].weight_at(0.15) == pytest.approx(0.5)  # fades
    viewer.run("pause on")
    assert viewer.run('clip "animation 0"') == ("plays animation 0", False)
    assert scene.clips["animation 0"].weight_at(0.0) == 1.0
    assert viewer.run("clip wave")[1]
    viewer.close()
