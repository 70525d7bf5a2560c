"""Scenes and cameras named by text: generators with options, and cameras."""

import numpy as np
import pytest

from renderer.content import GENERATORS, load_scene, parse_camera
from rhi.errors import ValidationError


@pytest.fixture(scope="module")
def grid():
    return load_scene("grid:mesh=box,count=4")


def refusal(text):
    with pytest.raises(ValidationError) as error:
        load_scene(text)
    return error.value


def test_options_are_parsed_and_the_rest_keep_their_defaults():
    values = GENERATORS["city"].parse("detail=3,blocks=5")
    rest = {
        "seed": 0,
        "shadows": 0,
        "fog": 0.0,
        "bloom": 0.0,
        "occlusion": 0.0,
        "sun_degrees": 0.0,
        "focus": 0.0,
        "aperture": 0.05,
        "environment": 0.0,
    }
    assert values == {"blocks": 5, "detail": 3} | rest
    assert GENERATORS["city"].parse("") == {"blocks": 44, "detail": 7} | rest


@pytest.mark.parametrize(
    "name", ["city:blocks=1", "night:blocks=1,lights=12", "hall:columns=2,rows=2,flags=0"]
)
def test_fog_and_bloom_are_as_the_text_says_and_their_scene_says_so(name):
    plain, foggy = load_scene(name), load_scene(f"{name},fog=0.25,bloom=0.125")
    assert plain.fog is plain.bloom is None
    assert (foggy.fog.density, foggy.bloom.strength) == (0.25, 0.125)
    assert foggy.name == f"{plain.name},fog=0.25,bloom=0.125"
    assert load_scene(foggy.name).name == foggy.name


@pytest.mark.parametrize(
    ("text", "rule", "message"),
    [
        ("ctiy", "scene-unknown-scene", "did you mean 'city'"),
        ("", "scene-unknown-scene", "city, hall, grid"),
        ("city:block=3", "scene-unknown-key", "did you mean 'blocks'"),
        ("city:height=3", "scene-unknown-key", "blocks, detail, seed"),
        ("city:blocks=0", "scene-bad-value", "from 1 to 256"),
        ("city:blocks=257", "scene-bad-value", "from 1 to 256"),
        ("city:blocks=7.5", "scene-bad-value", "a whole number"),
        ("city:blocks=many", "scene-bad-value", "a whole number"),
        ("grid:spacing=nan", "scene-bad-value", "a number from"),
        ("grid:mesh=", "scene-bad-value", "box, plane"),
        ("city:blocks", "scene-spec-syntax", "key=value"),
        ("city:blocks=3,", "scene-spec-syntax", "an empty option"),
        ("city:blocks=3,blocks=4", "scene-spec-syntax", "blocks twice"),
        ("grid:mesh=teapot.obj", "scene-missing-file", "teapot.obj"),
        ("grid:mesh=cube", "scene-missing-file", "cube"),
    ],
)
def test_bad_scene_text_is_refused_with_the_allowed_values(text, rule, message):
    error = refusal(text)
    assert error.rule.id == rule
    assert message in str(error)


def test_the_edges_of_a_range_are_taken():
    assert len(load_scene("city:blocks=1,detail=2").objects) > 0
    assert GENERATORS["city"].parse("blocks=256,detail=32")["blocks"] == 256


def test_an_error_names_the_users_line():
    error = refusal("city:blocks=0")
    assert error.site is not None
    assert error.site.file.endswith("test_scene_text.py")


def test_a_camera_is_a_path_a_view_or_coordinates(grid):
    assert np.array_equal(parse_camera("sky", grid, 7).position, grid.paths["sky"].camera(7).position)
    assert parse_camera("overview", grid) is grid.views["overview"]
    at = parse_camera("3,4,5", grid)
    lower, upper = grid.bounds
    assert at.position.tolist() == [3.0, 4.0, 5.0]
    assert np.allclose(np.cross(at.forward, 0.5 * (lower + upper) - at.position), 0.0, atol=1e-12)
    aimed = parse_camera("3, 4, 5, 3, 4, 0", grid)
    assert np.allclose(aimed.forward, (0.0, 0.0, -1.0))


@pytest.mark.parametrize(
    ("text", "rule", "message"),
    [
        ("grond", "camera-unknown-name", "did you mean 'ground'"),
        ("1,2", "camera-unknown-name", "3 or 6 finite numbers"),
        ("1,2,3,4", "camera-unknown-name", "3 or 6 finite numbers"),
        ("1,2,inf", "camera-unknown-name", "3 or 6 finite numbers"),
        ("1,2,x", "camera-unknown-name", "overview"),
        ("1,2,3,1,2,3", "camera-bad-value", "other than the position"),
    ],
)
def test_bad_cameras_are_refused(grid, text, rule, message):
    with pytest.raises(ValidationError, match=message) as error:
        parse_camera(text, grid)
    assert error.value.rule.id == rule


@pytest.mark.parametrize("frame", [-1, 1800])
def test_a_frame_off_the_path_is_refused_and_the_last_one_is_not(grid, frame):
    parse_camera("ground", grid, 1799)
    with pytest.raises(ValidationError, match=r"^\[camera-frame-range\]"):
        parse_camera("ground", grid, frame)
