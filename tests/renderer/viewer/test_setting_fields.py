"""The fields of settings that a panel shows, the lines of a scene's tree, and times by label."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields
from enum import Enum
from typing import Any, get_type_hints

import numpy as np
import pytest

import rhi
from renderer.content import load_scene
from renderer.light_kinds import LIGHT_KINDS
from renderer.scene import Scene
from renderer.settings import RenderSettings
from renderer.viewer import DisplaySettings, Viewer
from renderer.viewer.scene_tree import SECTIONS, Key, SceneTree
from renderer.viewer.setting_fields import SettingField, list_display_fields, list_setting_fields
from renderer.viewer.timer_history import FRAMES, TimerHistory
from rhi import TimerNode

PATHS = RenderSettings().list_paths()


@pytest.fixture(scope="module")
def viewer() -> Iterator[Viewer]:
    with rhi.create_device("null") as device:
        opened = Viewer(device, load_scene("hall:columns=3,detail=4,fountains=1"), size=(64, 36))
        yield opened
        opened.close()


def other_values(field: SettingField) -> list[Any]:
    """Values that differ from the default, and are of the field's type."""
    if field.choices:
        return [choice for choice in field.choices if choice != field.default]
    if field.kind is bool:
        return [not field.default]
    return [field.default * 2, field.default / 2 if field.kind is float else field.default + 1]


def test_each_setting_is_a_field_once(viewer: Viewer) -> None:
    assert [field.path for field in list_setting_fields(viewer.session)] == PATHS
    assert {field.path for field in list_display_fields(viewer.session)} == {
        field.name for field in fields(DisplaySettings)
    } - {"settings"}


@pytest.mark.parametrize("path", PATHS)
def test_a_field_has_the_type_the_default_and_the_sentences_of_its_setting(viewer: Viewer, path: str) -> None:
    (field,) = (field for field in list_setting_fields(viewer.session) if field.path == path)
    assert field.default == RenderSettings().get(path)
    owner: Any = RenderSettings
    for name in field.group.split(".") if field.group else ():
        owner = get_type_hints(owner)[name]
    assert isinstance(field.default, field.kind) or field.default is None
    assert field.kind in (bool, int, float) or field.choices, "a text has choices, so nobody types one"
    assert (field.default in field.choices) == bool(field.choices)
    documented = " ".join((owner.__doc__ or "").split())
    assert len(field.doc) > 10
    assert field.doc in documented
    assert not any(f" {entry.name}: " in f" {field.doc}" for entry in fields(owner)), (
        "it ends before the next"
    )


def test_fields_of_display_settings_are_documented_and_complete(viewer: Viewer) -> None:
    for field in list_display_fields(viewer.session):
        assert field.doc, field.path
        assert field.kind is bool or field.choices, field.path


@pytest.mark.parametrize("path", PATHS)
def test_a_field_offers_only_values_that_its_setting_has(viewer: Viewer, path: str) -> None:
    """Each choice is one that the settings allow by themselves, and enumerations are whole."""
    (field,) = (field for field in list_setting_fields(viewer.session) if field.path == path)
    settings = RenderSettings().change("technique.name", "forward") if path == "technique.samples" else None
    for value in other_values(field) if field.choices else ():
        assert (settings or RenderSettings()).change(path, value).get(path) == value
    if issubclass(field.kind, Enum):
        assert set(field.kind) <= set(field.choices)


# -- the tree ------------------------------------------------------------------------------------------------


@pytest.fixture
def scene() -> Scene:
    return load_scene("hall:columns=3,detail=4,fountains=1,flags=1,shadows=1")


def open_all(tree: SceneTree) -> None:
    """Open every line that can be opened."""
    while closed := {line.key for line in tree.list_lines() if line.has_children} - tree.opened:
        tree.opened |= closed


def test_the_tree_has_each_node_below_its_parent_and_all_else_once(scene: Scene) -> None:
    tree = SceneTree(scene)
    assert [line.key for line in tree.list_lines()] == [(section,) for section in SECTIONS]
    open_all(tree)
    lines = tree.list_lines()
    keys = [line.key for line in lines]
    assert len(set(keys)) == len(keys)
    assert {key[1] for key in keys if key[0] == "nodes" and len(key) == 2} == set(range(len(scene.nodes)))
    assert sum(key[0] == "materials" for key in keys) == 1 + len(scene.materials)
    assert sum(key[0] == "cameras" for key in keys) == 1 + len(scene.views) + len(scene.paths)
    lights = sum(len(scene.lights.of_kind(kind)) for kind in LIGHT_KINDS)
    assert sum(key[0] == "lights" and len(key) == 3 for key in keys) == lights
    above: list[Key] = []
    for line in lines:
        del above[line.depth :]
        if line.key[0] == "nodes" and line.depth:
            parent = int(scene.nodes.parents[line.key[1]])
            assert above[-1] == (("nodes",) if parent < 0 else ("nodes", parent))
        above.append(line.key)
    for key in keys:
        assert tree.describe(key), key


@pytest.mark.parametrize("seed", range(3))
def test_nodes_and_lights_are_hidden_and_shown_as_they_were(scene: Scene, seed: int) -> None:
    rng = np.random.default_rng(seed)
    tree = SceneTree(scene)
    open_all(tree)
    before = [scene.lights.of_kind(kind).copy() for kind in LIGHT_KINDS]
    keys = [line.key for line in tree.list_lines() if line.is_visible is not None]
    hidden: set[Key] = set()
    for _ in range(60):
        key = keys[int(rng.integers(len(keys)))]
        on = bool(rng.integers(2))
        tree.set_visible(key, on)
        (hidden.discard if on else hidden.add)(key)
        displayed = {line.key: line.is_visible for line in tree.list_lines() if line.is_visible is not None}
        assert {key for key, is_visible in displayed.items() if not is_visible} == hidden
    scene.update(0.0)
    for index in range(len(scene.objects)):
        node, is_hidden = int(scene.objects.node[index]), False
        while node >= 0:
            is_hidden |= ("nodes", node) in hidden
            node = int(scene.nodes.parents[node])
        assert scene.objects.is_shown[index] == (not is_hidden)
    for key in list(hidden):
        tree.set_visible(key, True)
    for kind, lights in zip(LIGHT_KINDS, before, strict=True):
        assert np.array_equal(scene.lights.of_kind(kind), lights)


# -- times ---------------------------------------------------------------------------------------------------


def test_times_are_listed_below_the_event_around_them_and_summed_by_label() -> None:
    history = TimerHistory()
    history.add(
        [TimerNode("shadows", 3.0, 1.0, [TimerNode("cascade", 1.0, 0.2), TimerNode("cascade", 2.0, 0.3)])]
    )
    history.add([TimerNode("light", 5.0, 2.0), TimerNode("shadows", 4.0, 1.0, [TimerNode("far", 0.5, 0.1)])])
    assert [(row.depth, row.name) for row in history.rows] == [
        (0, "shadows"),
        (1, "cascade"),
        (1, "far"),
        (0, "light"),
    ]
    rows = {row.label: row for row in history.rows}
    assert rows["shadows/cascade"].gpu.values.tolist() == [3.0]
    assert rows["shadows"].gpu.values.tolist() == [3.0, 4.0]
    assert rows["light"].cpu.values.tolist() == [2.0]
    for _ in range(FRAMES):
        history.add([TimerNode("light", 5.0, 2.0)])
    assert [row.label for row in history.rows] == ["light"], "labels of earlier frames are gone"
