"""Far objects drawn once for both eyes: their images, its commands, and the frames that have none of it."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from itertools import product
from typing import Any, Final

import numpy as np
import pytest
from frames import open_renderer as open_any
from numpy.typing import NDArray

import rhi
from renderer.content import load_scene
from renderer.frame import TemporalSettings
from renderer.lab.exam.far_object_cases import measure_far_objects
from renderer.renderer import Renderer
from renderer.scene import Camera, Orthographic, Scene, StereoRig
from renderer.stereo import Stereo
from renderer.stereo.pair import compute_far_rig
from renderer.techniques import TECHNIQUES, Clustered, Forward
from rhi import Op, ValidationError

SIZE: Final = (192, 108)
RIG: Final = StereoRig(0.3, 20.0)
ERROR: Final = 0.5
open_renderer = partial(open_any, size=SIZE, visibility="frustum")


@pytest.fixture(scope="module")
def camera(city: Scene) -> Camera:
    return city.paths["ground"].camera(600).with_aspect(SIZE[0] / SIZE[1])


def snap(camera: Camera) -> tuple[StereoRig, float, int]:
    return compute_far_rig(RIG, float(camera.projection.matrix[0, 0]), SIZE[0], ERROR)


def read_eyes(renderer: Renderer, camera: Camera) -> list[NDArray[Any]]:
    return [image.read()[..., :3].astype(int) for image in renderer.render(camera, 10.0).eye_images]


@pytest.mark.parametrize("technique", ["forward", "deferred", "deferred_plus"])
def test_far_objects_are_moved_by_whole_pixels_and_all_else_is_exact(
    drawing_device: rhi.Device, city: Scene, camera: Camera, technique: str
) -> None:
    rig, _, shift = snap(camera)
    assert shift >= 1
    with open_renderer(drawing_device, city, TECHNIQUES[technique]()) as renderer:
        renderer.stereo = Stereo(RIG, "color", far_error=ERROR)
        for _ in range(3):  # the last one repeats recorded commands
            left, right = read_eyes(renderer, camera)
        is_shared = renderer.view.far is not None and renderer.view.far.are_copied
        renderer.stereo = Stereo(rig, "color")
        expected_left, expected_right = read_eyes(renderer, camera)
        renderer.stereo = Stereo(RIG, "color")
        assert not np.array_equal(read_eyes(renderer, camera)[0], left), "the convergence differs"
    assert is_shared == (technique != "deferred_plus")
    assert np.array_equal(left, expected_left)
    assert np.array_equal(right[:, :shift], expected_right[:, :shift]), (
        "the columns that the left eye doesn't see"
    )
    errors = np.abs(right - expected_right).max(-1)
    if is_shared:
        assert 0.0 < (errors > 2).mean() < 0.15
        moved = [np.abs(right - np.roll(expected_right, x, 1)).max(-1) for x in (-1, 0, 1)]
        assert (np.minimum.reduce(moved) > 60).mean() < 0.01, "no pixel is farther off than one"
    else:
        assert not errors.any()


def test_the_pixels_of_panels_are_those_of_rays(drawing_device: rhi.Device) -> None:
    result = measure_far_objects(drawing_device)
    assert result.error == 0
    assert all(result.holds.values())


def test_each_eye_sees_through_far_glass(gl: rhi.Device) -> None:
    scene = load_scene("glass:panes=9,lights=2")
    camera = scene.views["along"].with_aspect(SIZE[0] / SIZE[1])
    rig = snap(camera)[0]
    with open_renderer(gl, scene) as renderer:
        renderer.stereo = Stereo(RIG, "color", far_error=ERROR)
        left, right = read_eyes(renderer, camera)
        renderer.stereo = Stereo(rig, "color")
        expected = read_eyes(renderer, camera)
    assert np.array_equal(left, expected[0])
    assert np.abs(right - expected[1]).mean() < 1.0


def run(
    null: rhi.Device, scene: Scene, camera: Camera, stereo: Stereo, technique: Any = None, **options: Any
) -> tuple[Any, int, bool]:
    """The third frame's commands, objects drawn, and whether anything was drawn once."""
    with open_renderer(null, scene, technique, **options) as renderer:
        renderer.stereo = stereo
        for frame in range(3):
            begin, before = len(null.stream), null.statistics.recorded_commands
            result = renderer.render(camera, 10.0 + frame)
        stream = null.stream[begin:]
        far = renderer.view.far
        assert null.statistics.recorded_commands == before, "commands are recorded before"
        return stream, result.statistics.draws, far is not None and far.are_copied


def test_far_objects_are_drawn_for_the_left_eye_and_copied(
    null: rhi.Device, city: Scene, camera: Camera
) -> None:
    rig = snap(camera)[0]
    plain, all_draws, _ = run(null, city, camera, Stereo(rig, "color"))
    stream, draws, is_shared = run(null, city, camera, Stereo(RIG, "color", far_error=ERROR))
    assert is_shared
    assert 0.5 * all_draws < draws < 0.8 * all_draws
    extra = {op: len(stream.filter(op)) - len(plain.filter(op)) for op in (Op.BEGIN_PASS, Op.COPY_TEXTURE)}
    assert extra == {Op.BEGIN_PASS: 2, Op.COPY_TEXTURE: 2}, "what is far, and clearing; colour and depth"


def test_eyes_that_move_upload_no_more_than_the_order_of_draws(
    null: rhi.Device, city: Scene, camera: Camera
) -> None:
    uploads = []
    for error in (0.0, ERROR):
        with open_renderer(null, city) as renderer:
            renderer.stereo = Stereo(RIG, "color", far_error=error)
            for frame in range(4):
                moved = city.paths["ground"].camera(600 + frame)
                uploads.append(renderer.render(moved, 10.0).statistics.upload_bytes)
    plain, shared = uploads[3], uploads[7]
    assert shared <= plain + 3 * 32 * 20, "three parts, each rounded up to 32 draws of 20 bytes"


@pytest.mark.parametrize(
    "case",
    [
        "off",
        "nothing far",
        "toed in",
        "parallel",
        "reprojected",
        "samples",
        "depth first",
        "temporal",
        "device lists",
    ],
)
def test_frames_that_cannot_share_have_no_further_commands(
    null: rhi.Device, city: Scene, camera: Camera, case: str
) -> None:
    rig, technique, options = RIG, None, dict[str, Any]()
    error = {"off": 0.0, "nothing far": 1e-3}.get(case, ERROR)
    if case == "toed in":
        rig = replace(rig, is_toed_in=True)
    if case == "parallel":
        camera = camera.with_projection(Orthographic(30.0, near=-5.0, far=300.0))
    if case == "samples":
        technique = Forward(samples=4)
    if case == "depth first":
        technique = Clustered(depth_first=True)
        city = load_scene("night:lights=16,blocks=2")
        camera = city.paths["ground"].camera(600)
    if case == "temporal":
        options["temporal"] = TemporalSettings(is_on=True)
    if case == "device lists":
        options["visibility"] = "depth_pyramid"
    counts = []
    for far_error in (0.0, error):
        stereo = Stereo(rig, "color", is_reprojected=case == "reprojected", far_error=far_error)
        if far_error and case in ("nothing far", "samples", "depth first", "temporal", "device lists"):
            counts.pop()
            fitted = camera.with_aspect(SIZE[0] / SIZE[1])
            scale = float(fitted.projection.matrix[0, 0])
            snapped, _, _ = compute_far_rig(rig, scale, SIZE[0], far_error)
            counts.append(
                count(null, city, camera, replace(stereo, rig=snapped, far_error=0.0), technique, options)
            )
        counts.append(count(null, city, camera, stereo, technique, options))
    assert counts[0] == counts[1]
    assert not counts[1][2]


def count(
    null: rhi.Device, scene: Scene, camera: Camera, stereo: Stereo, technique: Any, options: dict[str, Any]
) -> tuple[int, int, bool]:
    stream, draws, is_shared = run(null, scene, camera, stereo, technique, **options)
    return len(stream), draws, is_shared


@pytest.mark.parametrize("distance", [0.5, 3.0, 11.0, 250.0, np.inf])
@pytest.mark.parametrize("error", [0.05, 0.25, 1.0])
def test_parallax_is_within_the_error_of_whole_pixels(camera: Camera, distance: float, error: float) -> None:
    width = 640
    original_rig = StereoRig(0.063, distance)
    rig, far, shift = compute_far_rig(original_rig, float(camera.projection.matrix[0, 0]), width, error)
    depths = np.geomspace(far, 1e7, 200)
    parallax = 0.5 * width * rig.compute_parallax(camera.projection, depths)
    assert abs(parallax[0] - shift) < 1e-9
    assert (np.abs(parallax - shift) <= error * (1.0 + 1e-9)).all()
    assert abs(parallax[-1] - shift) > 0.99 * error, "the bound is reached"
    moved = parallax - 0.5 * width * original_rig.compute_parallax(camera.projection, depths)
    assert np.ptp(moved) < 1e-9, "all by the same"
    assert abs(moved[0]) <= max(0.5, error) + 1e-9


def test_far_objects_and_those_at_the_edge_are_found_by_their_boxes(
    null: rhi.Device, city: Scene, camera: Camera
) -> None:
    with open_renderer(null, city) as renderer:
        renderer.stereo = Stereo(RIG, "color", far_error=ERROR)
        renderer.render(camera, 10.0)
        far = renderer.view.far
        assert far is not None
        rows = np.arange(len(city.objects))
        is_far, is_at_edge = far.select_far(city, rows), far.select_edge(city, rows)
    lower, upper = city.objects.lower, city.objects.upper
    corners = np.stack(
        [np.where(choice, upper, lower) for choice in product((False, True), repeat=3)], axis=1
    )
    rig, distance, shift = snap(camera)
    right = rig.place_eyes(camera)[1]
    seen = (corners - right.position) @ right.rotation.T
    assert np.array_equal(is_far, (-seen[..., 2]).min(1) >= distance)
    clip = np.concatenate([seen, np.ones((*seen.shape[:2], 1))], axis=2) @ right.projection.matrix.T
    column = 0.5 * SIZE[0] * (clip[..., 0] / clip[..., 3] + 1.0)
    in_front = (-seen[..., 2]).min(1) > 0.1
    assert np.array_equal(is_at_edge[in_front], (column.min(1) <= shift)[in_front])
    assert 10 < is_far.sum() < len(rows)
    assert 0 < (is_at_edge & is_far).sum() < is_far.sum()


def test_eyes_without_a_distance_share_all(gl: rhi.Device, city: Scene, camera: Camera) -> None:
    with open_renderer(gl, city) as renderer:
        expected = renderer.render(camera, 10.0).image.read()
        renderer.stereo = Stereo(StereoRig(0.0, 6.0), "color", far_error=ERROR)
        result = renderer.render(camera, 10.0)
        assert [np.array_equal(eye.read(), expected) for eye in result.eye_images] == [True, True]
        assert result.statistics.draws < 1.2 * len(result.visible)
        renderer.stereo = None
        assert np.array_equal(renderer.render(camera, 10.0).image.read(), expected), "one eye shares nothing"


@pytest.mark.parametrize("error", [-0.5, float("nan")])
def test_an_error_below_zero_is_refused(error: float) -> None:
    with pytest.raises(ValidationError, match="stereo-bad"):
        Stereo(RIG, far_error=error)
