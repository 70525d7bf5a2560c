"""The viewer's panel, its keys, controllers and full screen, on a canvas that needs no display."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest

import rhi
from renderer.settings import RenderSettings
from renderer.viewer.interface import InterfaceLayer
from renderer.viewer.key_bindings import GAMEPAD_BINDINGS, KEY_BINDINGS, list_key_bindings
from rhi import DeviceError
from rhi_screen.gamepads import BUTTONS, SimulatedGamepads

pytest.importorskip("rendercanvas", reason="no rendercanvas: pip install rhi[viewer]")
imgui = pytest.importorskip("imgui_bundle", reason="no imgui-bundle: pip install rhi[imgui]").imgui

from renderer.viewer import DisplaySettings  # noqa: E402
from renderer.viewer import panel as panel_module  # noqa: E402
from renderer.viewer.panel import Panel  # noqa: E402
from renderer.viewer.viewer_screen import ViewerScreen, open_viewer  # noqa: E402

SCENE = "grid:count=9"
SIZE = (480, 300)
DEFAULTS = RenderSettings()


@pytest.fixture
def viewer_screen() -> Iterator[ViewerScreen]:
    opened = open_viewer(SCENE, "null", canvas="offscreen", size=SIZE, reload=False)
    yield opened
    opened.close()


@pytest.fixture
def panel(viewer_screen: ViewerScreen) -> Panel:
    viewer_screen.viewer.run("panel on")
    tick(viewer_screen, 3)
    assert viewer_screen.panel is not None
    return viewer_screen.panel


@pytest.fixture(scope="module")
def shared_screen() -> Iterator[ViewerScreen]:
    """A viewer with an open panel, whose settings tests change and bring back."""
    opened = open_viewer(SCENE, "null", canvas="offscreen", size=SIZE, reload=False)
    opened.open_panel()
    tick(opened, 3)
    yield opened
    opened.close()


def tick(viewer_screen: ViewerScreen, frames: int = 1) -> None:
    for _ in range(frames):
        viewer_screen.screen.canvas._process_events()
        viewer_screen.screen.canvas.force_draw()


def send(viewer_screen: ViewerScreen, kind: str, **fields: Any) -> None:
    viewer_screen.screen.send(kind, **fields)


# -- settings ------------------------------------------------------------------------------------------------


def list_values(field: Any) -> list[Any]:
    if field.choices:
        return [choice for choice in field.choices if choice != field.default]
    if field.kind is bool:
        return [not field.default]
    return (
        [field.default * 2, field.default / 2, field.default + 0.25]
        if field.kind is float
        else [
            field.default * 2,
            field.default + 1,
            max(field.default // 2, 1),
        ]
    )


@pytest.mark.parametrize("path", DEFAULTS.list_paths())
def test_each_setting_is_changed_live_undone_and_redone(shared_screen: ViewerScreen, path: str) -> None:
    session, panel = shared_screen.viewer.session, shared_screen.panel
    assert panel is not None
    (field,) = (field for field in panel.fields if field.path == path)
    before = session.display
    for value in list_values(field):
        panel.change(field, value)
        panel.apply_changes()
        if session.display != before:
            break
    if panel.value(field) == before.settings.get(path):
        pytest.fail(f"no value of {path} was taken: {list(shared_screen.viewer.console.lines)}")
    after = session.display
    assert {
        name for name in DEFAULTS.list_paths() if after.settings.get(name) != before.settings.get(name)
    } == {path}
    tick(shared_screen)
    panel.undo()
    assert session.display == before
    panel.redo()
    assert session.display == after
    panel.reset([field])
    panel.apply_changes()
    assert panel.value(field) == field.default
    panel.undo()
    if session.display != before:
        panel.undo()
    assert session.display == before


@pytest.mark.parametrize("seed", range(3))
def test_all_defaults_come_back_at_once_from_any_settings_and_so_does_each_step(
    viewer_screen: ViewerScreen, panel: Panel, seed: int
) -> None:
    """Settings that limit others are among them, so that an order of steps would be refused."""
    rng = np.random.default_rng(seed)
    session = viewer_screen.viewer.session
    all_fields = [*panel.fields, *panel.display_fields]
    steps = [session.display]
    for index in rng.permutation(len(all_fields))[:25]:
        field = all_fields[index]
        values = list_values(field)
        panel.change(field, values[int(rng.integers(len(values)))])
        panel.apply_changes()
        if session.display != steps[-1]:
            steps.append(session.display)
    assert len(steps) > 8
    panel.reset(all_fields)
    panel.apply_changes()
    assert session.display == DisplaySettings(DEFAULTS)
    for display in reversed(steps):
        panel.undo()
        assert session.display == display
    panel.undo()
    assert session.display == steps[0], "there is nothing more to undo"


def test_a_refused_value_is_a_message_and_changes_nothing(viewer_screen: ViewerScreen, panel: Panel) -> None:
    session = viewer_screen.viewer.session
    (field,) = (field for field in panel.fields if field.path == "shadows.cascade_size")
    before = session.display
    panel.change(field, -1)
    panel.apply_changes()
    assert session.display == before
    assert viewer_screen.viewer.console.lines[-1][1]
    assert "cascade_size" in viewer_screen.viewer.console.lines[-1][0]
    panel.undo()
    assert session.display == before


def test_every_field_has_a_widget_of_its_type(
    viewer_screen: ViewerScreen, panel: Panel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each widget that is drawn reports a new value; the panel asks for exactly that change."""
    kinds: dict[str, str] = {}
    changes: dict[str, Any] = {}
    current: list[str] = []

    def spy(name: str, answer: Callable[..., Any]) -> None:
        def widget(*arguments: Any) -> tuple[bool, Any]:
            kinds[current[-1]] = name
            return True, answer(*arguments)

        monkeypatch.setattr(panel_module.imgui, name, widget)

    monkeypatch.setattr(panel_module.imgui, "collapsing_header", lambda *_: True)
    monkeypatch.setattr(panel_module.imgui, "is_item_deactivated", lambda: True)
    monkeypatch.setattr(panel_module.imgui, "is_item_hovered", lambda *_: True)
    texts: list[str] = []
    text = imgui.text
    monkeypatch.setattr(panel_module.imgui, "text", lambda line: (texts.append(line), text(line))[0])
    spy("combo", lambda _label, index, words: (index + 1) % len(words))
    spy("checkbox", lambda _label, value: not value)
    spy("input_int", lambda _label, value: value + 3)
    spy("input_double", lambda _label, value, *_: value + 0.5)
    add_editor = Panel._add_editor

    def note_editor(self: Panel, field: Any, value: Any) -> None:
        current.append(field.path)
        add_editor(self, field, value)

    monkeypatch.setattr(Panel, "_add_editor", note_editor)
    monkeypatch.setattr(Panel, "change", lambda self, field, value: changes.update({field.path: value}))
    tick(viewer_screen)
    display = viewer_screen.viewer.session.display
    for field in [*panel.fields, *panel.display_fields]:
        expected = {bool: "checkbox", int: "input_int", float: "input_double"}.get(field.kind, "combo")
        assert kinds[field.path] == ("combo" if field.choices else expected), field.path
        assert changes[field.path] != panel.value(field)
        assert isinstance(changes[field.path], field.kind) or changes[field.path] is None
        assert field.doc in texts, "a tooltip"
    assert viewer_screen.viewer.session.display == display


# -- what is drawn, and who gets the events ------------------------------------------------------------------


@pytest.mark.usefixtures("gl")
def test_the_panel_is_drawn_over_the_image_and_not_into_screenshots() -> None:
    viewer_screen = open_viewer(SCENE, "gl", canvas="offscreen", size=SIZE)
    viewer_screen.viewer._interface.is_hidden = True
    tick(viewer_screen, 2)
    plain = viewer_screen.screen.canvas._last_image.astype(int)
    viewer_screen.viewer.run("panel")
    tick(viewer_screen, 3)
    with_panel = viewer_screen.screen.canvas._last_image.astype(int)
    assert np.array_equal(viewer_screen.viewer.session.screenshot().astype(int)[..., :3], plain[..., :3])
    rows, _ = np.nonzero(np.abs(with_panel - plain)[..., :3].sum(axis=2) > 30)
    assert len(rows) > 10_000
    assert rows.max() < 0.8 * SIZE[1], "the console's place stays free"
    viewer_screen.viewer.run("panel off")
    tick(viewer_screen, 2)
    assert np.array_equal(viewer_screen.screen.canvas._last_image.astype(int), plain)
    viewer_screen.close()


def test_events_over_the_panel_move_no_camera(viewer_screen: ViewerScreen, panel: Panel) -> None:
    session = viewer_screen.viewer.session
    wheel = {"dx": 0.0, "dy": -300.0}
    before = session.camera.position
    send(viewer_screen, "pointer_move", x=100.0, y=100.0)
    tick(viewer_screen, 2)
    send(viewer_screen, "wheel", x=100.0, y=100.0, **wheel)
    tick(viewer_screen)
    assert np.array_equal(session.camera.position, before)
    viewer_screen.viewer.run("panel off")
    send(viewer_screen, "wheel", x=100.0, y=100.0, **wheel)
    tick(viewer_screen)
    assert not np.array_equal(session.camera.position, before)


@pytest.mark.parametrize("tab", ["settings", "scene", "statistics", "times"])
def test_each_tab_is_drawn_with_all_that_can_be_opened(
    viewer_screen: ViewerScreen, panel: Panel, monkeypatch: pytest.MonkeyPatch, tab: str
) -> None:
    device = viewer_screen.screen.device
    texts: list[str] = []
    text_wrapped = imgui.text_wrapped
    monkeypatch.setattr(panel_module.imgui, "begin_tab_item", lambda name: (name == tab, None))
    monkeypatch.setattr(panel_module.imgui, "end_tab_item", lambda: None)
    monkeypatch.setattr(panel_module.imgui, "collapsing_header", lambda *_: True)
    monkeypatch.setattr(
        panel_module.imgui, "text_wrapped", lambda text: (texts.append(text), text_wrapped(text))[0]
    )
    panel.tree.opened |= {("nodes",), ("lights",), ("cameras",), ("materials",)}
    panel.select(("nodes", 1))
    device.stream.clear()
    tick(viewer_screen, 2)
    assert device.stream.filter(rhi.Op.DRAW)
    if tab == "statistics":
        assert {f"{SIZE[0]} x {SIZE[1]} pixels on null"} <= set(texts)
    if tab == "scene":
        assert "none" in texts, "the parent of the selected node"


def test_a_camera_of_the_tree_becomes_the_camera(viewer_screen: ViewerScreen, panel: Panel) -> None:
    session = viewer_screen.viewer.session
    send(viewer_screen, "wheel", x=470.0, y=290.0, dx=0.0, dy=-500.0)
    tick(viewer_screen)
    name, camera = next(iter(session.scene.views.items()))
    assert not np.allclose(session.camera.position, camera.position)
    panel.select(("cameras", "view", name))
    tick(viewer_screen)
    assert np.allclose(session.camera.position, camera.position)


def test_a_node_that_is_hidden_in_the_tree_is_not_drawn(viewer_screen: ViewerScreen, panel: Panel) -> None:
    session = viewer_screen.viewer.session
    tick(viewer_screen)
    assert session.latest_result is not None
    index = int(session.latest_result.visible[0])
    node = int(session.scene.objects.node[index])
    for on in (False, True):
        panel.set_visible(("nodes", node), on)
        tick(viewer_screen, 2)
        assert (index in session.latest_result.visible) == on


def test_the_panel_takes_times_while_it_is_open_whatever_the_settings(
    viewer_screen: ViewerScreen,
) -> None:
    device, viewer = viewer_screen.screen.device, viewer_screen.viewer
    has_timestamps = device.capabilities.timestamps
    for line, timing in (
        ("panel on", True),
        ("overlay on", True),
        ("overlay off", True),
        ("technique deferred", True),
        ("panel off", False),
    ):
        assert not viewer.run(line)[1]
        tick(viewer_screen, 2)
        assert device.timing == (timing and has_timestamps), line


def test_the_panel_stays_usable_when_another_scene_is_shown(
    viewer_screen: ViewerScreen, panel: Panel
) -> None:
    panel.tree.opened.add(("nodes",))
    assert not viewer_screen.viewer.run("scene grid:count=25")[1]
    tick(viewer_screen, 2)
    assert panel.tree.scene is viewer_screen.viewer.session.scene
    assert sum(line.key[0] == "nodes" for line in panel.tree.list_lines()) == 1


def test_without_imgui_the_panel_is_refused_by_the_missing_package(
    viewer_screen: ViewerScreen, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delitem(sys.modules, "renderer.viewer.panel")
    monkeypatch.delitem(sys.modules, "rhi_screen.imgui", raising=False)
    monkeypatch.setitem(sys.modules, "imgui_bundle", None)
    with pytest.raises(DeviceError) as caught:
        viewer_screen.open_panel()
    assert caught.value.rule.id == "screen-missing"
    message, is_error = viewer_screen.viewer.run("panel")
    assert is_error
    assert "imgui-bundle" in message
    tick(viewer_screen)


# -- keys, controllers, full screen --------------------------------------------------------------------------


def test_every_key_and_button_runs_a_command_that_a_screen_has(viewer_screen: ViewerScreen) -> None:
    names = {command.name for command in viewer_screen.viewer.commands}
    for line, _ in (*KEY_BINDINGS.values(), *GAMEPAD_BINDINGS.values()):
        assert line.partition(" ")[0] in names
    assert set(GAMEPAD_BINDINGS) <= set(BUTTONS)


@pytest.mark.parametrize("button", sorted(GAMEPAD_BINDINGS))
def test_a_button_runs_its_line_once(viewer_screen: ViewerScreen, button: str) -> None:
    viewer = viewer_screen.viewer
    viewer.run("visibility auto")  # the next one builds no kernels
    source = viewer_screen.screen.gamepads.source = SimulatedGamepads()
    with patch.object(viewer, "run", side_effect=viewer.run) as run:
        for buttons in ((button,), (button,), ()):
            source.set(0, buttons=buttons)
            tick(viewer_screen)
    line = GAMEPAD_BINDINGS[button][0]
    assert [call.args[0] for call in run.call_args_list] == [
        f"pick {SIZE[0] // 2},{SIZE[1] // 2}" if line == "pick" else line
    ]


def test_a_stick_flies_and_ends_a_replay(viewer_screen: ViewerScreen) -> None:
    viewer, session = viewer_screen.viewer, viewer_screen.viewer.session
    now = [5.0]
    viewer.clock = lambda: now[0]
    source = viewer_screen.screen.gamepads.source = SimulatedGamepads()
    name = next(iter(session.scene.paths))
    viewer.run(f"play {name}")
    tick(viewer_screen)
    assert session.replay is not None
    source.set(0, left_y=1.0)
    for _ in range(5):
        now[0] += 0.1
        tick(viewer_screen)
    assert session.replay is None
    begin = session.camera
    now[0] += 0.1
    tick(viewer_screen)
    way = session.camera.position - begin.position
    assert way @ begin.forward > 0.9 * np.linalg.norm(way) > 0.0
    assert viewer.is_moving
    source.set(0)
    for _ in range(40):
        now[0] += 0.1
        tick(viewer_screen)
    assert not viewer.is_moving


def test_f11_and_the_command_fill_each_monitor_and_come_back(
    viewer_screen: ViewerScreen, monkeypatch: pytest.MonkeyPatch
) -> None:
    filled: list[int | None] = [None]
    canvas = type(viewer_screen.screen.canvas)

    def set_full(self: Any, on: bool) -> None:
        filled.append(0 if on else None)

    is_full = property(lambda self: filled[-1] is not None, set_full)
    monkeypatch.setattr(canvas, "is_full_screen", is_full, raising=False)
    monkeypatch.setattr(canvas, "monitors", ["first", "second"], raising=False)
    monkeypatch.setattr(canvas, "fill_monitor", lambda self, number: filled.append(number), raising=False)
    viewer = viewer_screen.viewer
    for line, expected in (
        ("fullscreen", 0),
        ("fullscreen", None),
        ("fullscreen 2", 1),
        ("fullscreen 1", 0),
        ("fullscreen off", None),
        ("fullscreen on", 0),
    ):
        assert viewer.run(line) == ("", False)
        assert filled[-1] == expected, line
    send(viewer_screen, "key_down", key="F11")
    assert filled[-1] is None
    count = len(filled)
    for wrong in ("3", "0", "-1", "x", "1 2"):
        assert viewer.run(f"fullscreen {wrong}")[1], wrong
    assert len(filled) == count


def test_full_screen_is_refused_where_there_is_no_window(viewer_screen: ViewerScreen) -> None:
    message, is_error = viewer_screen.viewer.run("fullscreen")
    assert is_error
    assert "window" in message


# -- the keys and the console --------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def console_screen() -> Iterator[ViewerScreen]:
    """A viewer whose console and keys tests fill anew."""
    opened = open_viewer(SCENE, "null", canvas="offscreen", size=SIZE, reload=False)
    yield opened
    opened.close()


@pytest.mark.parametrize("size", [(960, 540), (1920, 1080), (640, 480), (320, 240), (64, 48)])
@pytest.mark.parametrize("scale", [1, 2])
@pytest.mark.parametrize("lines", [0, 3, 64])
def test_the_keys_never_cover_the_console(
    console_screen: ViewerScreen, size: tuple[int, int], scale: int, lines: int
) -> None:
    viewer = console_screen.viewer
    layer: InterfaceLayer = viewer._interface
    rectangles: list[tuple[int, int, int, int]] = []
    texts: list[str] = []
    canvas = layer._canvas
    viewer.console.lines.clear()
    viewer.console.lines.extend((f"line {number}", False) for number in range(lines))
    viewer.console.is_open = viewer.has_keys = True
    layer.state, layer.scale = viewer._describe(), scale
    with (
        patch.object(canvas, "rect", side_effect=lambda *arguments: rectangles.append(arguments[:4])),
        patch.object(canvas, "text", side_effect=lambda x, y, text, *_: texts.append(text)),
        console_screen.screen.device.texture(size, rhi.Format.RGBA8) as image,
    ):
        layer.render(console_screen.screen.device, _frame(console_screen, image))
    _corner, console, _cursor, *rest = rectangles
    (keys,) = rest or [(0, 0, 0, 0)]
    assert keys[1] + keys[3] <= console[1] or not rest
    if size == (1920, 1080) and scale == 1:
        displayed = "\n".join(texts)
        assert all(text in displayed for _, text in list_key_bindings(viewer.session.scene))
    if size[1] >= 480 * scale:
        assert rest, "there is room for some"


def _frame(viewer_screen: ViewerScreen, image: rhi.Texture) -> Any:
    from types import SimpleNamespace

    camera = viewer_screen.viewer.session.camera
    return SimpleNamespace(camera=camera, targets=SimpleNamespace(image=image))
