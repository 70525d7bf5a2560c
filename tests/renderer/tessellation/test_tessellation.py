"""The triangles of height fields: without cracks, as many as the view calls for, the same on all devices."""

from __future__ import annotations

from dataclasses import replace

import bisection_reference
import numpy as np
import pytest
from bisection_reference import (
    HEIGHT,
    check_conforming,
    compute_keys,
    decode,
    make_hills,
    make_scene,
    should_split,
)
from frames import open_renderer
from nightly_reasons import ONLY_KERNELS
from numpy.typing import NDArray

import rhi
from renderer.content import load_scene
from renderer.frame import SceneResources
from renderer.scene import Camera, HeightField, Perspective, Scene, make_height_field, scaling, translation
from renderer.tessellation import SurfaceTessellation, TessellationSettings, Tessellator
from renderer.tessellation.tessellator import view_surface
from rhi import ValidationError

CAMERAS = bisection_reference.list_cameras()


def choose(field: HeightField, camera: Camera, edge_pixels: float = 6.0) -> tuple[NDArray[np.int64], bool]:
    """Return the reference's triangles (k, 3) of a field at the origin, and whether its limit is reached."""
    keys, is_cut = compute_keys(
        field, view_surface(np.eye(4), camera, TessellationSettings(edge_pixels), HEIGHT)
    )
    return decode(keys, len(field.heights)), is_cut


def read_triangles(resources: SceneResources, tessellation: SurfaceTessellation) -> NDArray[np.int64]:
    """Return the triangles that a device has written, sorted."""
    indices = resources.indices.read()[: 3 * tessellation.read_count()].astype(np.int64).reshape(-1, 3)
    return indices[np.lexsort(indices.T)]


def project(field: HeightField, camera: Camera, triangles: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the triangles' corners on screen, (k, 3, 2) in pixels, NaN for one behind the near plane."""
    points = field.positions().reshape(-1, 3)[triangles]
    clip = np.concatenate([points, np.ones((*points.shape[:2], 1))], axis=-1) @ camera.view_projection.T
    clip[clip[..., 3] < camera.projection.near] = np.nan  # type: ignore[attr-defined]
    pixels: NDArray[np.float64] = clip[..., :2] / clip[..., 3:] * (HEIGHT, 0.5 * HEIGHT)
    return pixels


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
def test_every_edge_inside_belongs_to_two_triangles(camera: Camera) -> None:
    field = make_hills()
    for edge_pixels in (2.0, 9.0):
        check_conforming(choose(field, camera, edge_pixels)[0], len(field.heights))


@pytest.mark.nightly
def test_no_crack_in_two_thousand_views_of_a_large_field() -> None:
    field, rng = make_hills(128), np.random.default_rng(3)
    for _ in range(2000):
        eye, aim = (
            rng.uniform((-150, -40, -150), (150, 90, 150)),
            rng.uniform((-128, -20, -128), (128, 20, 128)),
        )
        camera = Camera.look_at(eye, aim, projection=Perspective(rng.uniform(0.2, 2.0), aspect=2.0))
        check_conforming(choose(field, camera, rng.uniform(1.0, 30.0))[0], len(field.heights))


def test_without_reaches_that_hold_each_other_there_are_cracks(monkeypatch: pytest.MonkeyPatch) -> None:
    field = make_hills()
    length, reach = field.bounds
    monkeypatch.setitem(field.__dict__, "bounds", (length, 0.0 * reach))
    with pytest.raises(AssertionError):
        for camera in CAMERAS.values():
            keys, _ = compute_keys(field, view_surface(np.eye(4), camera, TessellationSettings(6.0), HEIGHT))
            splitting = should_split(
                field, view_surface(np.eye(4), camera, TessellationSettings(6.0), HEIGHT)
            )
            assert splitting.any()
            check_conforming(decode(keys, len(field.heights)), len(field.heights))


@pytest.mark.parametrize("name", ["random 0", "random 5", "straight down"])
def test_no_edge_in_view_is_longer_than_asked_for(name: str) -> None:
    field, camera = make_hills(64), CAMERAS[name]
    corners = project(field, camera, choose(field, camera, 12.0)[0])
    finest = 1.5 * max(field.steps)
    ends = field.positions().reshape(-1, 3)[choose(field, camera, 12.0)[0]]
    for first, second in ((0, 1), (1, 2), (2, 0)):
        edge = corners[:, second] - corners[:, first]
        seen = (np.abs(corners) < (HEIGHT, 0.5 * HEIGHT)).all((1, 2))
        coarse = np.linalg.norm((ends[:, second] - ends[:, first])[:, ::2], axis=-1) > finest
        slant = np.sqrt(1.0 + 5.0 * np.tan(0.45) ** 2)  # in a corner of the image
        assert np.nanmax(np.linalg.norm(edge, axis=-1)[seen & coarse], initial=0.0) <= 12.0 * slant
    assert seen.sum() > 100


def test_half_the_length_is_about_four_times_as_many_triangles() -> None:
    field = make_height_field(np.zeros((513, 513)), 4000.0)
    camera = Camera.look_at((0.0, 500.0, 1200.0), (0.0, 0.0, 0.0), projection=Perspective(0.9, aspect=2.0))
    counts = [len(choose(field, camera, edge)[0]) for edge in (8.0, 4.0, 2.0)]
    assert 3.0 < counts[1] / counts[0] < 5.0
    assert 3.0 < counts[2] / counts[1] < 5.0


def test_a_limit_gives_a_coarser_mesh_without_cracks_and_says_so() -> None:
    camera = CAMERAS["straight down"]
    full, is_cut = choose(make_hills(), camera, 1.0)
    assert not is_cut
    exact, is_cut = choose(make_hills(limit=1 << (len(full) - 1).bit_length()), camera, 1.0)
    assert not is_cut
    assert len(exact) == len(full)
    limit = 1 << (len(full).bit_length() - 1)
    cut, is_cut = choose(make_hills(limit=limit), camera, 1.0)
    assert is_cut
    assert limit // 4 <= len(cut) <= limit < len(full)
    check_conforming(cut, 33)


@pytest.mark.nightly_cases("cl", reason=ONLY_KERNELS)
def test_a_device_chooses_the_reference_s_keys(device: rhi.Device) -> None:
    field = make_hills()
    local = translation((1e5, 300.0, -2e5)) @ scaling((0.5, 0.5, 0.5))
    resources = SceneResources(device, make_scene(field, local))
    tessellator = Tessellator(device)
    for camera in CAMERAS.values():
        moved = Camera(0.5 * camera.position + (1e5, 300.0, -2e5), camera.rotation, camera.projection)
        tessellator.update(resources, moved, HEIGHT)
        tessellation = tessellator.surfaces[0]
        keys, _ = compute_keys(field, view_surface(local, moved, TessellationSettings(), HEIGHT))
        expected = decode(keys, len(field.heights))
        assert (read_triangles(resources, tessellation) == expected[np.lexsort(expected.T)]).all()
        after = resources.indices.read().reshape(-1, 3)[len(expected) : field.limit]
        assert not after[: field.limit - len(expected)].any() or resources.tessellations == 1
        assert resources.tessellated_draws.read()["count"].tolist() == [3 * len(expected)]
        assert resources.mesh_parts.read()["count"].tolist() == [3 * len(expected)]
    assert resources.tessellations == len(CAMERAS)
    tessellator.destroy()
    resources.destroy()


def test_a_device_keeps_the_limit_and_counts_the_cut_views(device: rhi.Device) -> None:
    field = make_hills(limit=256)
    resources, tessellator = SceneResources(device, make_scene(field)), Tessellator(device)
    tessellator.settings = TessellationSettings(1.0)
    for height in (400, 401):  # the second one learns of the first
        tessellator.update(resources, CAMERAS["straight down"], height)
        device.finish()
    tessellation = tessellator.surfaces[0]
    assert tessellation.limited_views == 1
    assert tessellation.read_count() <= 256
    check_conforming(read_triangles(resources, tessellation), len(field.heights))
    tessellator.destroy()
    resources.destroy()


@pytest.mark.parametrize(
    ("heights", "count"),
    [([[3.0]], 2), (np.zeros((2, 2)), 2), (np.zeros((9, 9)), 2 * 64)],
    ids=["1 × 1", "2 × 2", "flat"],
)
def test_small_and_flat_maps(heights: NDArray[np.float64], count: int) -> None:
    field = make_height_field(heights, 10.0)
    camera = Camera.look_at((0.0, 3.0 + float(field.heights[0, 0]), 4.0), (0.0, 0.0, 0.0))
    triangles, _ = choose(field, camera, 0.01)
    assert len(triangles) == count
    check_conforming(triangles, len(field.heights))


def test_a_device_draws_a_map_of_one_height(device: rhi.Device) -> None:
    resources, tessellator = (
        SceneResources(device, make_scene(make_height_field([[3.0]], 10.0))),
        Tessellator(device),
    )
    tessellator.update(resources, CAMERAS["random 0"], HEIGHT)
    assert tessellator.surfaces[0].read_count() == 2
    check_conforming(read_triangles(resources, tessellator.surfaces[0]), 2)
    tessellator.destroy()
    resources.destroy()


def count_commands(null: rhi.Device, scene: Scene, *cameras: Camera) -> list[tuple[int, int]]:
    """Return the number of dispatches of each frame, and the number of its indirect draws."""
    frames = []
    with open_renderer(null, scene, size=(2 * HEIGHT, HEIGHT), visibility="frustum") as renderer:
        for camera in cameras:
            null.stream.clear()
            renderer.render(camera)
            ops = [command.op for command in null.stream]
            frames.append((ops.count(rhi.Op.DISPATCH), ops.count(rhi.Op.DRAW_INDIRECT)))
    return frames


def test_nothing_is_dispatched_while_the_camera_stands_still(null: rhi.Device) -> None:
    first, second = CAMERAS["random 0"], CAMERAS["random 1"]
    levels = make_hills().levels
    frames = count_commands(null, make_scene(make_hills()), first, first, second)
    assert frames == [(levels + 2, 1), (0, 1), (levels + 2, 1)]


def test_a_ground_out_of_view_has_as_few_triangles_as_is_asked_for() -> None:
    field, counts = make_hills(), list[int]()
    for out_of_view_scale in (1.0, 8.0, 64.0):
        settings = TessellationSettings(2.0, out_of_view_scale)
        keys, _ = compute_keys(field, view_surface(np.eye(4), CAMERAS["random 0"], settings, HEIGHT))
        triangles = decode(keys, len(field.heights))
        check_conforming(triangles, len(field.heights))
        counts.append(len(triangles))
    assert counts[0] > 1.2 * counts[1] > 1.2 * counts[2]


def test_a_device_without_compute_shaders_draws_equal_triangles() -> None:
    with rhi.create_device("null") as null:
        lacking = replace(null.capabilities, compute=False)
    with rhi.create_device("null", profile=lacking) as null:
        assert count_commands(null, make_scene(make_hills()), CAMERAS["random 0"]) == [(0, 1)]


def test_a_scene_without_a_field_dispatches_nothing(null: rhi.Device) -> None:
    scene = load_scene("grid:count=2")
    assert count_commands(null, scene, scene.views["overview"]) == [(0, 1)]


@pytest.mark.parametrize("edge_pixels", [0.0, -1.0, float("nan"), float("inf")])
def test_a_length_that_is_none_is_refused(edge_pixels: float) -> None:
    with pytest.raises(ValidationError, match=r"^\[tessellation-edge\]"):
        TessellationSettings(edge_pixels)
    assert TessellationSettings(1e-3).edge_pixels == 1e-3


@pytest.mark.parametrize("out_of_view_scale", [0.99, float("nan"), float("inf")])
def test_edges_out_of_view_that_are_shorter_than_those_in_view_are_refused(out_of_view_scale: float) -> None:
    with pytest.raises(ValidationError, match="tessellation-edge"):
        TessellationSettings(out_of_view_scale=out_of_view_scale)
    assert TessellationSettings(out_of_view_scale=1.0).out_of_view_scale == 1.0
