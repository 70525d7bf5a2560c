"""Walk-throughs: camera paths that were recorded, and their files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from refusals import refused_rule

from renderer.content import load_scene, parse_camera, parse_camera_path
from renderer.scene import Camera, CameraPath, Depth, Orthographic, Perspective

PROJECTIONS = [
    Perspective(fov=0.9, aspect=1.5, near=0.3),
    Perspective(near=0.3, far=90.0, depth=Depth.STANDARD),
    Orthographic(7.0),
]


def walk(projection: object = PROJECTIONS[0]) -> list[Camera]:
    rng = np.random.default_rng(4)
    positions, targets, ups = rng.uniform(-9.0, 9.0, (3, 5, 3))
    return [Camera.look_at(p, t, u, projection) for p, t, u in zip(positions, targets, ups, strict=True)]


def assert_equal(path: CameraPath, cameras: list[Camera]) -> None:
    assert len(path) == len(cameras)
    for frame, camera in enumerate(cameras):
        actual = path.camera(frame)
        assert (actual.position == camera.position).all()
        assert np.allclose(actual.rotation, camera.rotation, atol=1e-12)
        assert actual.projection == camera.projection


@pytest.mark.parametrize("projection", PROJECTIONS, ids=str)
def test_a_recorded_walk_comes_back_from_its_file(tmp_path: Path, projection: object) -> None:
    cameras = walk(projection)
    CameraPath.record(cameras).save(tmp_path / "walk.json")
    assert_equal(CameraPath.load(tmp_path / "walk.json"), cameras)


def test_a_path_of_a_scene_can_be_saved(tmp_path: Path) -> None:
    path = load_scene("grid:count=4").paths["sky"]
    path.save(tmp_path / "walk.json")
    assert_equal(CameraPath.load(tmp_path / "walk.json"), [path.camera(frame) for frame in range(len(path))])


def test_a_walk_is_parsed_from_its_file_and_a_path_from_its_name(tmp_path: Path) -> None:
    scene = load_scene("grid:count=4")
    file = tmp_path / "walk.json"
    CameraPath.record(walk()).save(file)
    assert_equal(parse_camera_path(str(file), scene), walk())
    assert parse_camera_path("sky", scene) is scene.paths["sky"]
    assert np.allclose(parse_camera(str(file), scene, 3).position, walk()[3].position)


def test_a_walk_without_a_camera_is_refused() -> None:
    assert refused_rule(lambda: CameraPath.record([])) == "camera-bad-path"


@pytest.mark.parametrize(
    ("change", "rule"),
    [
        ({"projection": {}}, "camera-bad-path"),
        ({"projection": {"kind": "fisheye", "depth": "reversed"}}, "camera-bad-path"),
        ({"projection": {"kind": "perspective", "depth": "sideways"}}, "camera-bad-path"),
        ({"projection": {"kind": "perspective", "depth": "reversed", "near": -1.0}}, "camera-bad-value"),
        ({"frames": []}, "camera-bad-path"),
        ({"frames": [[1.0] * 8]}, "camera-bad-path"),
        ({"frames": [[1.0] * 8 + [float("nan")]]}, "camera-bad-path"),
    ],
)
def test_a_file_that_holds_no_walk_is_refused(tmp_path: Path, change: dict[str, object], rule: str) -> None:
    file = tmp_path / "walk.json"
    CameraPath.record(walk()).save(file)
    file.write_text(json.dumps(json.loads(file.read_text(encoding="utf-8")) | change), encoding="utf-8")
    assert refused_rule(lambda: CameraPath.load(file)) == rule
    file.write_text("no json", encoding="utf-8")
    assert refused_rule(lambda: CameraPath.load(file)) == "camera-bad-path"
