"""Versions of files: those of each earlier version are read as they were meant, and newer ones are refused.

The files in `old_files` are those that earlier states of this repository wrote.
"""

import json
from pathlib import Path

import numpy as np
import pytest

from renderer.content import add_model, load_model, load_scene, save_scene
from renderer.content.gltf.extras import SCENE_VERSIONS
from renderer.scene import CameraPath, SceneBuilder
from renderer.scene import paths as walk_throughs
from renderer.scene.file_versions import FileVersions, rename_fields
from renderer.scene.settings_versions import SETTINGS_VERSIONS
from renderer.settings import RenderSettings
from renderer.viewer import frame_budget
from renderer.viewer.frame_budget import BudgetStep, load_steps, save_steps
from renderer.visibility import VisibilitySettings
from tests.renderer.refusals import refused_rule

OLD = Path(__file__).parent / "old_files"

MEANT = RenderSettings().change_all(
    {
        "technique.name": "clustered",
        "bloom.levels": 4,
        "shadows.min_size": 128,
        "tessellation.out_of_view_scale": 3.0,
        "simulates_hidden": True,
    }
)
"""What `settings-1.json` says."""


def write_settings(path):
    MEANT.save(path)
    return RenderSettings.load


def write_visibility(path):
    VisibilitySettings(batch=7).save(path)
    return VisibilitySettings.load


def write_walk_through(path):
    load_scene("grid:count=1").paths["ground"].save(path)
    return CameraPath.load


def write_front(path):
    save_steps(path, [BudgetStep(MEANT, 4.0, 2.0)])
    return load_steps


def write_scene(path):
    save_scene(load_scene("grid:count=1"), path)
    return load_model


WRITERS = {
    "settings.json": (write_settings, SETTINGS_VERSIONS),
    "visibility.json": (write_visibility, SETTINGS_VERSIONS),
    "walk-through.json": (write_walk_through, walk_throughs.VERSIONS),
    "front.json": (write_front, frame_budget.VERSIONS),
    "scene.gltf": (write_scene, SCENE_VERSIONS),
}


def find_version(values):
    """The JSON object of a file that has the version."""
    return values["scenes"][0]["extras"]["rhi"] if "scenes" in values else values


def test_settings_of_version_1_have_the_names_of_today():
    assert RenderSettings.load(OLD / "settings-1.json") == MEANT
    assert VisibilitySettings.load(OLD / "settings-1.json") == MEANT.visibility


def test_a_walk_through_of_version_1_has_a_projection():
    path = CameraPath.load(OLD / "walk-through-1.json")
    assert path.projection.fov == pytest.approx(np.pi / 3)
    assert np.allclose(path.positions[:, 2], [0.0, -3.0, -6.0, -9.0], atol=1e-9)


def test_a_pareto_front_of_version_1_has_the_settings_of_today():
    assert load_steps(OLD / "pareto-front-1.json") == [BudgetStep(MEANT, 4.0, 2.0)]


def test_a_scene_of_version_1_has_no_nodes_that_only_hold_lights_and_cameras():
    scene = load_model(OLD / "scene-1.gltf")
    assert scene.nodes.names == ("box",)
    assert list(scene.views) == ["front"]
    assert scene.haze == 0.25
    assert (len(scene.lights.directional), len(scene.lights.point)) == (1, 1)
    assert scene.lights.point["casts_shadow"].tolist() == [True]


@pytest.mark.parametrize("name", WRITERS)
def test_written_files_have_the_current_version_and_older_ones_are_read(name, tmp_path):
    write, versions = WRITERS[name]
    load = write(tmp_path / name)
    values = json.loads((tmp_path / name).read_text(encoding="utf-8"))
    assert find_version(values)["version"] == versions.current
    for version in (1, versions.current):
        find_version(values)["version"] = version
        (tmp_path / name).write_text(json.dumps(values), encoding="utf-8")
        load(tmp_path / name)
    del find_version(values)["version"]
    (tmp_path / name).write_text(json.dumps(values), encoding="utf-8")
    load(tmp_path / name)


@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.parametrize("version", ["newer", 0, -1, 1.5, "2", None, True, [1]], ids=str)
def test_newer_and_malformed_versions_are_refused_by_name(name, version, tmp_path):
    write, versions = WRITERS[name]
    load = write(tmp_path / name)
    values = json.loads((tmp_path / name).read_text(encoding="utf-8"))
    find_version(values)["version"] = versions.current + 1 if version == "newer" else version
    (tmp_path / name).write_text(json.dumps(values), encoding="utf-8")
    assert refused_rule(lambda: load(tmp_path / name)) == "file-version"


def test_steps_run_in_order_from_the_version_of_the_file():
    versions = FileVersions(
        "tests",
        tuple(lambda fields, n=n: fields | {"steps": [*fields.get("steps", []), n]} for n in (1, 2, 3)),
    )
    assert versions.current == 4
    assert versions.migrate({"a": 5}, "read") == {"a": 5, "steps": [1, 2, 3]}
    assert versions.migrate({"version": 3}, "read") == {"steps": [3]}
    assert versions.migrate({"version": 4}, "read") == {}


def test_an_old_name_beside_its_new_one_stays_and_is_refused(tmp_path):
    fields = {"old": 1, "new": 2}
    rename_fields(fields, {"old": "new"})
    assert fields == {"old": 1, "new": 2}
    rename_fields([1], {"old": "new"})
    values = json.loads((OLD / "settings-1.json").read_text(encoding="utf-8"))
    values["rendering"]["bloom"] = {}
    (tmp_path / "both.json").write_text(json.dumps(values), encoding="utf-8")
    assert refused_rule(lambda: RenderSettings.load(tmp_path / "both.json")) == "visibility-bad-settings"


@pytest.mark.parametrize(
    "extras", [5, [1], {"rhi": 5}, {"rhi": {"version": 1}}, {"other": {"version": 9}}], ids=str
)
def test_nodes_of_other_programs_have_any_extras(extras, tmp_path):
    values = json.loads((OLD / "scene-1.gltf").read_text(encoding="utf-8"))
    values["nodes"][0]["extras"] = extras
    (tmp_path / "a.gltf").write_text(json.dumps(values), encoding="utf-8")
    assert len(load_model(tmp_path / "a.gltf").nodes) == 1


def test_a_scene_that_is_refused_for_its_version_adds_nothing(tmp_path):
    write_scene(tmp_path / "a.gltf")
    values = json.loads((tmp_path / "a.gltf").read_text(encoding="utf-8"))
    find_version(values)["version"] = 9
    (tmp_path / "a.gltf").write_text(json.dumps(values), encoding="utf-8")
    builder = SceneBuilder("empty")
    assert refused_rule(lambda: add_model(builder, tmp_path / "a.gltf")) == "file-version"
    assert builder.object_count == 0
