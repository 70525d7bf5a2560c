"""A panel of Dear ImGui over the viewer's image: settings, the scene's tree, statistics and times.

It is drawn with the image, and what a person changes in it happens before the next one: `apply_changes` runs
it between two frames.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import fields
from functools import partial
from itertools import groupby
from typing import Any, Final

import numpy as np
from imgui_bundle import imgui

from renderer import rules
from renderer.layers.overlay.history import History
from renderer.settings import RenderSettings, from_json, to_json
from renderer.viewer.display_settings import DisplaySettings
from renderer.viewer.scene_tree import Key, SceneTree, TreeLine
from renderer.viewer.setting_fields import (
    SettingField,
    describe_choice,
    list_display_fields,
    list_setting_fields,
)
from renderer.viewer.timer_history import FRAMES, TimerHistory
from renderer.viewer.viewer import Viewer
from rhi import RhiError, Texture
from rhi_screen import Screen
from rhi_screen.imgui import ImGui

_POSITION: Final = (8.0, 30.0)
_WIDTH: Final = 400.0
_HEIGHT_SHARE: Final = 0.62  # of the image: the console below stays free
_LABEL_SHARE: Final = 0.48  # of the panel's width, for names
_MAX_INTEGER: Final = 2**31  # of ImGui's fields
_MAX_UNDO: Final = 200
_SETTLING_FRAMES: Final = 3  # in which ImGui finds its layout
_MEMORY_FRAMES: Final = 30  # for which the device's memory isn't asked for again
_DETAIL_HEIGHT: Final = 150.0
_GRAPH: Final = (150.0, 18.0)
_FRAME_GRAPH_HEIGHT: Final = 60.0
_DISPLAY_NAMES: Final = tuple(field.name for field in fields(DisplaySettings) if field.name != "settings")
_CHANGED: Final = (0.91, 0.71, 0.3, 1.0)


class Panel:
    """The panel of a viewer on a screen.

    Attributes:
        gui: ImGui's context.
        tree: the scene's tree.
        fields: the fields of all `RenderSettings`.
    """

    def __init__(self, screen: Screen, viewer: Viewer) -> None:
        self.gui = ImGui(screen)
        self.tree = SceneTree(viewer.session.scene)
        self._viewer = viewer
        self._session = viewer.session
        self._device = screen.device
        self._requested: list[Callable[[], object]] = []
        self.fields = list_setting_fields(self._session)
        self._listed_for: object = None
        self._display_fields: list[SettingField] = []
        self._drafts: dict[str, Any] = {}
        self._undone: list[DisplaySettings] = []
        self._undo: list[DisplaySettings] = []
        self._timers = TimerHistory()
        self._frame_times, self._processor_times = History(FRAMES), History(FRAMES)
        self._counters = self._device.statistics
        self._memory = ""
        self._frames = 0
        self._last: float | None = None
        self._session.is_timed = True

    @property
    def needs_frame(self) -> bool:
        """True if the next frame has something new, without an event."""
        return bool(self._requested) or self._frames < _SETTLING_FRAMES or bool(self._drafts)

    def apply_changes(self) -> None:
        """Do what was asked for in the latest frame; what is refused is a message of the viewer."""
        requested, self._requested = self._requested, []
        for change in requested:
            try:
                change()
            except RhiError as error:
                self._viewer.show_message(rules.describe(error), is_error=True)
        if self.tree.scene is not self._session.scene or self.tree.is_outdated:
            self.tree = SceneTree(self._session.scene)

    def draw(self, image: Texture) -> None:
        """Draw the panel over a frame's image."""
        self._note_frame()
        with self.gui.frame(image):
            width, height = imgui.get_io().display_size
            first = imgui.Cond_.first_use_ever
            imgui.set_next_window_pos(imgui.ImVec2(*_POSITION), first)
            size = min(_WIDTH, max(width - 2 * _POSITION[0], 100.0)), max(_HEIGHT_SHARE * height, 120.0)
            imgui.set_next_window_size(imgui.ImVec2(*size), first)
            is_expanded, is_open = imgui.begin("rhi", True)
            if is_expanded and imgui.begin_tab_bar("tabs"):
                for name, add in (
                    ("settings", self._add_settings),
                    ("scene", self._add_scene),
                    ("statistics", self._add_statistics),
                    ("times", self._add_times),
                ):
                    if imgui.begin_tab_item(name)[0]:
                        add()
                        imgui.end_tab_item()
                imgui.end_tab_bar()
            imgui.end()
        if not is_open:
            self._requested.append(partial(self._viewer.run, "panel off"))
        self._frames += 1

    def close(self) -> None:
        """Destroy what it has on the device, and take no more times."""
        self._session.is_timed = False
        self.gui.close()

    # -- settings ------------------------------------------------------------------------------------------

    def change(self, field: SettingField, value: Any) -> None:
        """Give a setting another value before the next frame."""

        def set_value() -> None:
            try:
                self._set_display(self._changed(field, value))
            except RhiError as error:
                self._viewer.show_message(f"{field.path}: {rules.describe(error)}", is_error=True)

        self._requested.append(set_value)

    def undo(self) -> None:
        """Return to the settings before the latest change that was made here."""
        if self._undo:
            self._undone.append(self._session.display)
            self._show_display(self._undo.pop())

    def redo(self) -> None:
        """Make the change again that was undone last."""
        if self._undone:
            self._undo.append(self._session.display)
            self._show_display(self._undone.pop())

    def reset(self, reset_fields: Iterable[SettingField]) -> None:
        """Give settings their defaults, all in one change."""
        reset_fields = list(reset_fields)

        def set_defaults() -> None:
            display, defaults = self._session.display, RenderSettings()
            changes: dict[str, Any] = {}
            for field in reset_fields:
                if field.path in _DISPLAY_NAMES:
                    display = display.change(**{field.path: field.default})
                    continue
                part = changes
                for name in field.path.split(".")[:-1]:
                    part = part.setdefault(name, {})
                part[field.name] = to_json(defaults.get(field.path))
            settings = from_json(RenderSettings, changes, "default", display.settings)
            self._set_display(display.change(settings=settings))

        self._requested.append(set_defaults)

    def value(self, field: SettingField) -> Any:
        """The present value of a setting."""
        display = self._session.display
        owner = display if field.path in _DISPLAY_NAMES else display.settings
        return getattr(owner, field.path) if owner is display else display.settings.get(field.path)

    def _changed(self, field: SettingField, value: Any) -> DisplaySettings:
        display = self._session.display
        if field.path in _DISPLAY_NAMES:
            return display.change(**{field.path: value})
        return display.change(settings=display.settings.change(field.path, value))

    def _set_display(self, display: DisplaySettings) -> None:
        before = self._session.display
        if display != before:
            self._show_display(display)
            self._undo = [*self._undo, before][-_MAX_UNDO:]
            self._undone.clear()

    def _show_display(self, display: DisplaySettings) -> None:
        names = ("settings", *_DISPLAY_NAMES)
        self._session.change(**{name: getattr(display, name) for name in names})

    @property
    def display_fields(self) -> list[SettingField]:
        """The fields of the display settings; which images can be shown depends on the present ones."""
        listed_for = self._session.scene, self._session.display
        if self._listed_for is None or self._listed_for != listed_for:
            self._listed_for, self._display_fields = listed_for, list_display_fields(self._session)
        return self._display_fields

    def _add_settings(self) -> None:
        setting_fields, display_fields = self.fields, self.display_fields
        for name, run, is_enabled in (
            ("undo", self.undo, bool(self._undo)),
            ("redo", self.redo, bool(self._undone)),
        ):
            imgui.begin_disabled(not is_enabled)
            if imgui.button(name):
                self._requested.append(run)
            imgui.end_disabled()
            imgui.same_line()
        if imgui.button("all defaults"):
            self.reset([*setting_fields, *display_fields])
        imgui.begin_child("fields")
        self._add_group("display", display_fields)
        for group, members in groupby(setting_fields, lambda field: field.path.partition(".")[0]):
            parts = list(members)
            if parts[0].group:
                self._add_group(group, parts)
        self._add_group("renderer", [field for field in setting_fields if not field.group])
        imgui.end_child()

    def _add_group(self, name: str, members: list[SettingField]) -> None:
        is_first = name == "display"
        if not imgui.collapsing_header(name, imgui.TreeNodeFlags_.default_open if is_first else 0):
            return
        for field in members:
            imgui.push_id(field.path)
            self._add_field(field, name)
            imgui.pop_id()

    def _add_field(self, field: SettingField, group: str) -> None:
        value = self.value(field)
        label = field.path.removeprefix(f"{group}.")
        if value == field.default:
            imgui.text(label)
        else:
            imgui.text_colored(imgui.ImVec4(*_CHANGED), label)
        self._add_tooltip(field)
        imgui.same_line(_LABEL_SHARE * imgui.get_window_width())
        is_changed = value != field.default
        imgui.set_next_item_width(-70.0 if is_changed else -1.0)
        self._add_editor(field, value)
        self._add_tooltip(field)
        if is_changed:
            imgui.same_line()
            if imgui.small_button("default"):
                self.change(field, field.default)

    def _add_tooltip(self, field: SettingField) -> None:
        if imgui.is_item_hovered() and imgui.begin_tooltip():
            imgui.push_text_wrap_pos(320.0)
            imgui.text(f"{field.path}, by default {describe_choice(field.default)}")
            imgui.text(field.doc)
            imgui.pop_text_wrap_pos()
            imgui.end_tooltip()

    def _add_editor(self, field: SettingField, value: Any) -> None:
        """Add a widget of the field's type, which asks for a change."""
        if field.choices:
            words = [describe_choice(choice) for choice in field.choices]
            index = field.choices.index(value) if value in field.choices else -1
            is_changed, index = imgui.combo("##value", index, words)
            if is_changed:
                self.change(field, field.choices[index])
        elif field.kind is bool:
            is_changed, value = imgui.checkbox("##value", value)
            if is_changed:
                self.change(field, value)
        elif field.kind is int and abs(value) < _MAX_INTEGER:
            self._add_number(field, imgui.input_int("##value", self._drafts.get(field.path, value)))
        elif field.kind is float:
            draft = self._drafts.get(field.path, value)
            self._add_number(field, imgui.input_double("##value", draft, 0.0, 0.0, "%.6g"))
        else:
            imgui.text(str(value))

    def _add_number(self, field: SettingField, edited: tuple[bool, Any]) -> None:
        """Ask for a change when a number's field is left: half a typed number is none."""
        is_changed, value = edited
        if is_changed:
            self._drafts[field.path] = value
        if imgui.is_item_deactivated() and field.path in self._drafts:
            self.change(field, self._drafts.pop(field.path))

    # -- the scene -----------------------------------------------------------------------------------------

    def select(self, key: Key) -> None:
        """Select a line of the tree. A view becomes the camera, and a path is played."""
        self.tree.selected = key
        if key[0] == "cameras" and len(key) == 3:
            command = "camera" if key[1] == "view" else "play"
            self._requested.append(partial(self._viewer.run, f'{command} "{key[2]}"'))

    def set_visible(self, key: Key, on: bool) -> None:
        """Show or hide what a line stands for, before the next frame."""
        self._requested.append(lambda: self.tree.set_visible(key, on))

    def _add_scene(self) -> None:
        hit = self._session.hit
        imgui.begin_child("tree", imgui.ImVec2(0.0, -_DETAIL_HEIGHT))
        lines = self.tree.list_lines()
        clipper = imgui.ListClipper()
        clipper.begin(len(lines))
        while clipper.step():
            for line in lines[clipper.display_start : clipper.display_end]:
                self._add_line(line)
        imgui.end_child()
        imgui.separator()
        imgui.begin_child("details")
        if hit is not None and imgui.small_button("select what was picked"):
            self.select(("nodes", int(self._session.scene.objects.node[hit.object_index])))
        if self.tree.selected is not None:
            self._add_rows(self.tree.describe(self.tree.selected))
        imgui.end_child()

    def _add_line(self, line: TreeLine) -> None:
        imgui.push_id(repr(line.key))
        indent = 14.0 * line.depth
        if indent:
            imgui.indent(indent)
        if line.has_children:
            is_open = line.key in self.tree.opened
            imgui.set_next_item_width(20.0)
            if imgui.arrow_button("open", imgui.Dir.down if is_open else imgui.Dir.right):
                self._requested.append(partial(self.tree.toggle_open, line.key))
        else:
            imgui.dummy(imgui.ImVec2(imgui.get_frame_height(), imgui.get_frame_height()))
        imgui.same_line()
        if line.is_visible is not None:
            is_changed, is_visible = imgui.checkbox("##shown", line.is_visible)
            if is_changed:
                self.set_visible(line.key, is_visible)
            if imgui.is_item_hovered():
                imgui.set_tooltip("shown")
            imgui.same_line()
        if imgui.selectable(line.label, line.key == self.tree.selected)[0]:
            self.select(line.key)
        if indent:
            imgui.unindent(indent)
        imgui.pop_id()

    def _add_rows(self, rows: Iterable[tuple[str, str]]) -> None:
        for name, value in rows:
            imgui.text_disabled(name)
            imgui.same_line(_LABEL_SHARE * imgui.get_window_width())
            imgui.text_wrapped(value)

    # -- statistics and times ------------------------------------------------------------------------------

    def _note_frame(self) -> None:
        """Note the times of the frame that is shown now."""
        now = self._viewer.clock()
        if self._last is not None:
            self._frame_times.add(1e3 * (now - self._last))
            self._processor_times.add(1e3 * self._session.counter.processor)
        self._last = now
        self._timers.add(self._device.timers)
        self._before, self._counters = self._counters, self._device.statistics
        if self._frames % _MEMORY_FRAMES == 0:
            memory = self._device.memory()
            self._memory = f"{memory.total / 2**20:,.1f} MiB, at most {memory.peak / 2**20:,.1f}"

    def list_statistics(self) -> list[tuple[str, str]]:
        """The names and values of the latest frame's counters."""
        session = self._session
        width, height = session.renderer.size
        rows = [
            ("frames", session.counter.describe()),
            ("processors", f"{1e3 * session.counter.processor:.1f} ms a frame"),
            ("image", f"{width} x {height} pixels on {self._device.backend_name}"),
        ]
        result = session.latest_result
        if result is not None and all(frame.draw_result.is_on_cpu for frame in result.frames):
            rows += [
                ("objects", f"{len(result.visible):,} of {len(session.scene.objects):,}"),
                ("triangles", f"{result.statistics.triangles:,}"),
            ]
        rows += [
            (name.replace("_", " "), f"{getattr(self._counters, name) - getattr(self._before, name):,}")
            for name in ("draws", "queries", "upload_bytes", "creations", "hardware_state_changes")
        ]
        return [*rows, ("memory", self._memory)]

    def _add_statistics(self) -> None:
        for name, history in (("frame", self._frame_times), ("processors", self._processor_times)):
            self._add_graph(name, history, (-1.0, _FRAME_GRAPH_HEIGHT))
        self._add_rows(self.list_statistics())

    def _add_graph(self, name: str, history: History, size: tuple[float, float]) -> None:
        values = history.values.astype(np.float32)
        latest = f"{values[-1]:.2f} ms" if len(values) else "-"
        text = f"{name} {latest}" if size[0] < 0.0 else ""
        highest = float(values.max(initial=1e-3))
        imgui.plot_lines(f"##{name}", values, 0, text, 0.0, 1.05 * highest, imgui.ImVec2(*size))

    def _add_times(self) -> None:
        if not self._device.capabilities.timestamps:
            imgui.text_wrapped("This device takes no timestamps: there are times of the CPU alone.")
        rows = self._timers.rows
        if not rows:
            imgui.text_wrapped("No times yet.")
        columns = ("label", "GPU ms", "CPU ms", "latest frames")
        if rows and imgui.begin_table("times", len(columns)):
            for column in columns:
                imgui.table_setup_column(column)
            imgui.table_headers_row()
            for row in rows:
                gpu, cpu = row.gpu.values, row.cpu.values
                graphed = row.gpu if gpu.any() else row.cpu
                imgui.table_next_column()
                imgui.text(f"{'  ' * row.depth}{row.name}")
                imgui.table_next_column()
                imgui.text(f"{gpu[-1]:.3f}" if gpu.any() else "-")
                imgui.table_next_column()
                imgui.text(f"{cpu[-1]:.3f}")
                imgui.table_next_column()
                self._add_graph(row.label, graphed, _GRAPH)
            imgui.end_table()
