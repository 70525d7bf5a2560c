"""Levels of detail: their limits, compared with projections of moved points, which of them are drawn, and where images
differ from those of full meshes."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from nightly_reasons import ONLY_KERNELS

import rhi
from renderer.content.shapes import bumpy_sphere
from renderer.frame import SceneResources
from renderer.renderer import Renderer
from renderer.scene import Camera, Orthographic, Perspective, Scene, SceneBuilder, StereoRig, translation
from renderer.settings import RenderSettings
from renderer.stereo import Stereo
from renderer.visibility.detail import DetailLimit
from rhi import ValidationError

SIZE = 320, 180


def make_field(shadows: bool = False, levels: int = 5, material: dict[str, float] | None = None) -> Scene:
    """Make spheres in a row that leads away from the eye, turned and stretched, under a directional light."""
    builder = SceneBuilder("field")
    mesh = builder.add_mesh(bumpy_sphere(24), levels=levels)
    row = builder.add_material(**(material or {}))
    for number in range(12):
        transform = translation((1.6 * (number % 2), 0.0, -1.5 * number**1.5))
        transform[:3, :3] = np.diag([1.0 + 0.1 * number, 1.0, 1.5])
        builder.add_objects(builder.add_node(transform), mesh, row)
    builder.lights.add_directional((0.4, -1.0, -0.3), casts_shadow=shadows)
    return builder.build()


CAMERA = Camera.look_at((0.0, 2.0, 6.0), (0.0, 0.0, -20.0)).with_aspect(SIZE[0] / SIZE[1])


@pytest.fixture(scope="module")
def field() -> Scene:
    return make_field()


def project(camera: Camera, points: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Return points (k, 3) in pixels (k, 2)."""
    clip = np.append(points, np.ones((len(points), 1)), axis=1) @ camera.view_projection.T
    pixels: np.ndarray = clip[:, :2] / clip[:, 3:] * 0.5 * np.array(size)
    return pixels


@settings(max_examples=30)
@given(st.floats(0.2, 2.2), st.integers(80, 400), st.floats(0.1, 5.0), st.integers(0, 999))
def test_allowed_errors_are_within_the_pixels(fov: float, width: int, pixels: float, seed: int) -> None:
    rng, size = np.random.default_rng(seed), (width, 200)
    projection = Perspective(fov, width / 200)
    camera = Camera.look_at(rng.normal(0.0, 9.0, 3), rng.normal(0.0, 9.0, 3), projection=projection)
    limit = DetailLimit.compute([camera], size, pixels)
    assert limit is not None
    tangents = 1.0 / np.diag(projection.matrix)[:2]
    on_image = rng.uniform(-1.0, 1.0, (400, 2))
    on_image[0] = 1.0  # a corner
    offsets = np.append(on_image * tangents, -np.ones((400, 1)), axis=1) * rng.uniform(0.2, 50.0, (400, 1))
    points = offsets @ camera.rotation + camera.position
    directions = rng.normal(size=points.shape)
    directions[0] = np.cross(offsets[0], np.cross(offsets[0], (0.0, 0.0, 1.0))) @ camera.rotation  # outwards
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    errors = limit.allow(points, points)[:, None]
    at_rest = project(camera, points, size)
    shifts = np.linalg.norm(project(camera, points + errors * directions, size) - at_rest, axis=1)
    assert shifts.max() <= 1.0001 * pixels
    control = np.linalg.norm(project(camera, points + 2.0 * errors * directions, size) - at_rest, axis=1)
    assert control[0] > pixels


def test_a_parallel_projection_allows_the_same_everywhere() -> None:
    camera = Camera.look_at(
        (0.0, 0.0, 0.0), (0.0, 0.0, -1.0), projection=Orthographic(height=10.0, aspect=2.0)
    )
    limit = DetailLimit.compute([camera], (200, 100), 2.0)
    assert limit is not None
    points = np.array([[0.0, 0.0, -5.0], [3.0, 1.0, -90.0]])
    assert limit.allow(points, points) == pytest.approx([0.2, 0.2], rel=1e-2)
    assert (limit.allow(points, points) <= 0.2).all()


def test_no_error_has_no_limit() -> None:
    assert DetailLimit.compute([CAMERA], SIZE, 0.0) is None
    assert DetailLimit.compute([CAMERA], SIZE, 1e-3) is not None


@pytest.fixture
def renderer(null: rhi.Device, field: Scene) -> Iterator[Renderer]:
    with Renderer(null, field, size=SIZE, visibility="none", technique="forward") as renderer:
        yield renderer


def expect_levels(scene: Scene, camera: Camera, pixels: float) -> list[int]:
    """Return the level of each object, one by one: the coarsest whose error, at the nearest point of the box, is
    within the pixels."""
    limit = DetailLimit.compute([camera], SIZE, pixels)
    levels = []
    for index, (node, mesh) in enumerate(
        zip(scene.objects.node.tolist(), scene.objects.mesh.tolist(), strict=True)
    ):
        stretch = np.linalg.norm(scene.nodes.world[node][:3, :3], 2)
        lower, upper = scene.objects.lower[index], scene.objects.upper[index]
        allowed = 0.0 if limit is None else float(limit.allow(lower[None], upper[None])[0])
        errors = scene.meshes.level_errors[mesh]
        levels.append(max((n + 1 for n, error in enumerate(errors) if error * stretch <= allowed), default=0))
    return levels


@pytest.mark.parametrize("pixels", [0.0, 3.0, 8.0, 50.0])
def test_the_coarsest_level_within_the_limit_is_drawn(
    renderer: Renderer, field: Scene, pixels: float
) -> None:
    renderer.detail_error = pixels
    result = renderer.render(CAMERA)
    levels = expect_levels(field, CAMERA, pixels)
    counts = [int(field.meshes.triangle_counts[0]), *(field.meshes.level_ranges["index_count"] // 3).tolist()]
    assert result.statistics.triangles == sum(counts[level] for level in levels)
    assert (len(set(levels)) > 1) == (pixels > 0.0)
    draws = renderer.resources.draws[
        renderer.resources.select_draws(np.arange(12), renderer.resources.detail_limit)
    ]
    assert (draws["count"] // 3).tolist() == [counts[level] for level in levels]
    assert draws["base_instance"].tolist() == list(range(12))


def test_a_turn_of_the_camera_changes_no_level(renderer: Renderer) -> None:
    selected = []
    for target in ((0.0, 0.0, -20.0), (5.0, 1.0, -20.0), (-9.0, 0.0, -10.0)):
        renderer.render(Camera.look_at((0.0, 2.0, 6.0), target))
        resources = renderer.resources
        selected.append(resources.select_draws(np.arange(12), resources.detail_limit).tolist())
    assert selected[0] == selected[1] == selected[2]
    renderer.render(Camera.look_at((0.0, 2.0, 90.0), (0.0, 0.0, -20.0)))
    assert resources.select_draws(np.arange(12), resources.detail_limit).tolist() != selected[0]


def test_both_eyes_draw_the_same_levels(null: rhi.Device, field: Scene) -> None:
    with Renderer(null, field, size=SIZE, visibility="frustum", technique="deferred") as renderer:
        renderer.stereo = Stereo(StereoRig())
        renderer.render(CAMERA)
        limit = renderer.resources.detail_limit
        assert limit is not None
        assert len(limit.eyes) == 2
        near = [
            DetailLimit.compute([frame.camera], frame.targets.size, 1.0)
            for frame in renderer.render(CAMERA).frames
        ]
        assert limit.slope <= min(part.slope for part in near if part is not None)


def test_scenes_without_levels_have_no_limit(null: rhi.Device) -> None:
    scene = make_field(levels=0)
    with Renderer(null, scene, size=SIZE, visibility="frustum") as renderer:
        renderer.render(CAMERA)
        assert renderer.resources.levels is None
        assert renderer.resources.detail_limit is None
        assert len(renderer.resources.draws) == 12


@pytest.mark.parametrize("pixels", [-1.0, float("nan"), float("inf")])
def test_errors_of_levels_are_checked(null: rhi.Device, field: Scene, pixels: float) -> None:
    with pytest.raises(ValidationError, match=r"^\[detail-error\]"):
        RenderSettings(detail_error=pixels)
    with RenderSettings(detail_error=0.5).open(null, field, (8, 8)) as renderer:
        with pytest.raises(ValidationError, match=r"^\[detail-error\]"):
            renderer.detail_error = pixels
        assert renderer.detail_error == 0.5


def test_shadow_maps_have_levels_by_their_texels(null: rhi.Device, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[tuple[DetailLimit | None, int]] = []

    def record(resources: SceneResources, indices: np.ndarray, limit: DetailLimit | None) -> np.ndarray:
        rows = select(resources, indices, limit)
        drawn.append((limit, int(resources.draws[rows]["count"].sum())))
        return rows

    select = SceneResources.select_draws
    monkeypatch.setattr(SceneResources, "select_draws", record)
    scene, counts = make_field(shadows=True), []
    with Renderer(null, scene, size=SIZE, visibility="frustum", technique="forward") as renderer:
        for renderer.detail_error in (0.0, 4.0):
            drawn.clear()
            renderer.render(CAMERA)
            counts.append(
                sum(count for limit, count in drawn if limit is not renderer.resources.detail_limit)
            )
            if not renderer.detail_error:
                counts[-1] = sum(count for _, count in drawn[:-1])
        limits = [limit for limit, _ in drawn if limit is not renderer.resources.detail_limit]
        assert all(limit is not None and limit.slope == 0.0 for limit in limits), (
            "the sun's maps are parallel"
        )
        assert len({limit.constant for limit in limits if limit is not None}) > 1, (
            "maps have texels of other sizes"
        )
    assert 0 < counts[1] < 0.7 * counts[0]


def draw(device: rhi.Device, scene: Scene, pixels: float, technique: str = "forward") -> np.ndarray:
    with Renderer(device, scene, size=SIZE, visibility="frustum", technique=technique) as renderer:
        renderer.detail_error = pixels
        image: np.ndarray = renderer.render(CAMERA).image.read()[..., :3].astype(int)
        return image


def flag_near_edges(covered: np.ndarray, pixels: int) -> np.ndarray:
    """Return the pixels that have both kinds within a distance."""
    has = np.zeros((2, *covered.shape), bool)
    for y in range(-pixels, pixels + 1):
        for x in range(-pixels, pixels + 1):
            if x * x + y * y <= pixels * pixels:
                moved = np.roll(covered, (y, x), (0, 1))
                has |= np.stack([moved, ~moved])
    both: np.ndarray = has.all(axis=0)
    return both


@pytest.mark.nightly_cases("cl*", reason=ONLY_KERNELS)
@pytest.mark.parametrize("pixels", [2.0, 5.0])
def test_silhouettes_differ_within_the_limit(device: rhi.Device, pixels: float) -> None:
    scene = make_field(material={"emission": 1.0})
    scene.background = (0.0, 0.0, 0.0)
    full, levels = (draw(device, scene, error).sum(axis=2) > 0 for error in (0.0, pixels))
    differs = full != levels
    assert differs.any(), "the levels are seen"
    assert not (differs & ~flag_near_edges(full, int(np.ceil(pixels)) + 1)).any()


@pytest.mark.parametrize("technique", ["deferred", "forward_multipass", "light_pre_pass", "deferred_plus"])
def test_all_passes_draw_the_same_levels(gl: rhi.Device, technique: str) -> None:
    """Where surfaces of a later pass weren't those of the first one, they would be black."""
    scene = make_field()
    expected = draw(gl, scene, 3.0)
    assert np.abs(expected - draw(gl, scene, 3.0, technique)).max() <= 3
    assert np.abs(expected - draw(gl, scene, 0.0)).max() > 3  # the control
