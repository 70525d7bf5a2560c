"""Settings of visibility algorithms, and their file."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from occlusion_scenes import make_boxes
from refusals import refused_rule

import rhi
from renderer.renderer import Renderer
from renderer.scene import Camera
from renderer.visibility import VisibilitySettings, make_visibility
from rhi import Op
from rhi.backends.null import NullBackend
from rhi.errors import ValidationError


def test_settings_come_back_from_their_file(tmp_path: Path) -> None:
    settings = VisibilitySettings(batch=7, persistence=3, threshold=2, emulated=True)
    settings.save(tmp_path / "s.json", device="a device")
    assert VisibilitySettings.load(tmp_path / "s.json") == settings
    assert json.loads((tmp_path / "s.json").read_text(encoding="utf-8"))["device"] == "a device"


def test_a_number_that_is_missing_is_the_default(tmp_path: Path) -> None:
    (tmp_path / "s.json").write_text('{"visibility": {"batch": 9}}', encoding="utf-8")
    assert VisibilitySettings.load(tmp_path / "s.json") == VisibilitySettings(batch=9)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "{}",
        '{"visibility": 3}',
        '{"visibility": {"bach": 3}}',
    ],
)
def test_a_file_that_holds_no_settings_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "s.json").write_text(text, encoding="utf-8")
    assert refused_rule(lambda: VisibilitySettings.load(tmp_path / "s.json")) == "visibility-bad-settings"


@pytest.mark.parametrize(
    "value",
    [
        {"batch": 0},
        {"persistence": 0},
        {"leaf_size": 0},
        {"threshold": -1},
        {"batch": 2.5},
        {"batch": "2"},
        {"batch": True},
        {"emulated": 1},
        {"emulated": "native"},
        {"emulated": None},
    ],
)
def test_a_value_out_of_its_range_is_refused(value: dict[str, int]) -> None:
    assert refused_rule(lambda: VisibilitySettings(**value)) == "visibility-bad-parameter"
    VisibilitySettings(batch=1, persistence=1, leaf_size=1, threshold=0)


def test_algorithms_are_made_with_their_settings(null: rhi.Device) -> None:
    scene = make_boxes([(0.0, 0.0, 0.0)], [(1.0, 1.0, 1.0)])
    settings = VisibilitySettings(batch=7, persistence=3, threshold=2)
    algorithm = make_visibility("chc_plus_plus", scene, null, settings)
    assert (algorithm._batch, algorithm._persistence, algorithm._queries.threshold) == (7, 3, 2)
    assert make_visibility("chc_plus_plus", scene, null)._batch == VisibilitySettings().batch
    assert make_visibility("conditional", scene, null, settings)._persistence == 3
    for name in ("chc", "chc_plus_plus", "conditional"):
        assert make_visibility(name, scene, null, VisibilitySettings(leaf_size=5))._forest._leaf_size == 5
    for name in ("stop_and_wait", "chc"):
        assert make_visibility(name, scene, null, settings)._queries.threshold == 2


@pytest.mark.parametrize("emulated", [False, True])
@pytest.mark.parametrize("name", ["stop_and_wait", "chc", "chc_plus_plus"])
def test_emulated_queries_are_counters_in_place_of_queries(
    null: rhi.Device, name: str, emulated: bool
) -> None:
    null.backend_as(NullBackend).count_samples(lambda draw: 100)
    scene = make_boxes([(0.0, 0.0, 0.0)], [(1.0, 1.0, 1.0)])
    algorithm = make_visibility(name, scene, null, VisibilitySettings(emulated=emulated))
    null.stream.clear()
    camera = Camera.look_at((0.0, 0.0, 20.0), (0.0, 0.0, 0.0))
    with Renderer(null, scene, visibility=algorithm, size=(64, 36)) as renderer:
        assert renderer.render(camera).visibility.queries == 1
    begun, written = (len(null.stream.filter(op)) for op in (Op.BEGIN_QUERY, Op.WRITE_QUERY))
    assert (begun, written) == ((0, 2) if emulated else (1, 0))


def test_the_algorithm_conditional_needs_native_queries(null: rhi.Device) -> None:
    scene = make_boxes([(0.0, 0.0, 0.0)], [(1.0, 1.0, 1.0)])
    with pytest.raises(ValidationError, match=r"^\[visibility-no-conditional-rendering\]"):
        make_visibility("conditional", scene, null, VisibilitySettings(emulated=True))
    make_visibility("conditional", scene, null, VisibilitySettings(emulated=False)).destroy()


def test_auto_hands_settings_on(gl: rhi.Device) -> None:
    scene = make_boxes([(0.0, 0.0, 0.0)], [(1.0, 1.0, 1.0)])
    auto = make_visibility("auto", scene, gl, VisibilitySettings(batch=7, emulated=True))
    assert auto._get_candidate("chc_plus_plus")._batch == 7
    assert auto._get_candidate("chc_plus_plus")._queries.emulated
