"""Lists of lights made on a device: compared with every cell's distance from every light in float64."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest
from depth_textures import create_depth_texture
from nightly_reasons import FEWER_CASES, ONLY_KERNELS

import rhi
from renderer.lab.exam.cell_pairs import OffAxisPerspective, cell_corners, distances
from renderer.light_kinds.volumes import bounding_sphere
from renderer.lights.culling.cells import ClusterGrid, slice_start
from renderer.lights.culling.light_lists import LightListData, LightLists
from renderer.scene import POINT, SPOT, Camera, Depth, Lights, Orthographic, Perspective, Projection
from rhi import Device, Format, ValidationError
from rhi.shading import evaluate

SIZE = (333, 187)
ASPECT = SIZE[0] / SIZE[1]
PROJECTIONS: dict[str, Projection] = {
    "perspective": Perspective(aspect=ASPECT, far=60.0),
    "endless": Perspective(aspect=ASPECT),
    "off-axis": OffAxisPerspective(projection=Perspective(aspect=ASPECT, far=60.0)),
    "parallel": Orthographic(20.0, aspect=ASPECT, near=0.0, far=60.0, depth=Depth.STANDARD),
}


def look(projection: Projection) -> Camera:
    """A camera far from the world's origin."""
    return Camera.look_at((1e6, 2.0, -1e6), (1e6 + 3.0, 1.0, -1e6 - 8.0), projection=projection)


def make_lights(points: int = 90, spots: int = 40, seed: int = 1) -> Lights:
    rng, camera, lights = np.random.default_rng(seed), look(PROJECTIONS["endless"]), Lights()
    lights.point, lights.spot = np.zeros(points, POINT), np.zeros(spots, SPOT)
    for rows in (lights.point, lights.spot):
        eye = np.column_stack([rng.uniform(-20, 20, (len(rows), 2)), rng.uniform(-60, 5, len(rows))])
        rows["position"] = camera.position + eye @ camera.rotation
        rows["range"] = rng.uniform(0.0, 6.0, len(rows))
    aim = rng.normal(size=(spots, 3))
    lights.spot["direction"] = aim / np.linalg.norm(aim, axis=1)[:, None]
    lights.spot["outer"] = rng.choice(np.radians([0.1, 20.0, 45.0, 80.0, 90.0, 130.0, 180.0]), spots)
    return lights


def reference_pairs(
    camera: Camera,
    grid: ClusterGrid,
    lights: Lights,
    near: np.ndarray | None = None,
    far: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Find the cells (c, l) that the spheres of point and spot lights certainly overlap, and those that they
    may, in float64."""
    columns, rows, slices = grid.count
    z, y, x = np.meshgrid(np.arange(slices), np.arange(rows), np.arange(columns), indexing="ij")
    tiles = np.column_stack([x.ravel(), y.ravel()])
    if near is None or far is None:
        near, far = (evaluate(slice_start, grid, z.ravel() + i, dtype=np.float64) for i in range(2))
    corners = cell_corners(camera.projection, grid, tiles, near, far)
    axes = camera.rotation * np.array([[1], [1], [-1]])
    point = (lights.point["position"] - camera.position) @ axes.T
    cones = {
        "apex": (lights.spot["position"] - camera.position) @ axes.T,
        "range": lights.spot["range"],
        "axis": lights.spot["direction"] @ axes.T,
        "cosine": np.cos(lights.spot["outer"].astype(np.float64)),
    }
    spheres = evaluate(bounding_sphere, cones, dtype=np.float64)
    centres = np.concatenate([point, spheres[:, :3]])
    radii = np.concatenate([lights.point["range"], spheres[:, 3]]).astype(np.float64)
    away = np.column_stack(
        [distances(corners, np.broadcast_to(centre, (len(tiles), 3))) for centre in centres]
    )
    slack = 1e-5 * (1.0 + np.abs(corners).max((1, 2))[:, None] + np.abs(centres).max(1))
    return away < radii - slack, away < radii + slack


_exact: dict[tuple[str, int], tuple[np.ndarray, np.ndarray]] = {}


def as_pairs(lists: LightListData, lights: Lights) -> np.ndarray:
    """Return which lights each cell lists (c, l), point lights first, and check the order of the lists."""
    points = len(lights.point)
    listed = np.zeros((len(lists.begins), points + len(lights.spot)), bool)
    assert lists.begins[0] == 0
    assert (lists.begins[1:] == lists.ends[:-1]).all()
    assert lists.ends[-1] == len(lists.lights)
    for cell, (begin, middle, end) in enumerate(lists.bounds):
        assert (np.diff(lists.lights[begin:middle]) > 0).all()
        assert (np.diff(lists.lights[middle:end]) > 0).all()
        listed[cell, lists.lights[begin:middle]] = True
        listed[cell, points + lists.lights[middle:end]] = True
    return listed


@pytest.fixture
def make(device: Device) -> Iterator[Callable[..., LightLists]]:
    created: list[LightLists] = []

    def make_grid(**options: object) -> LightLists:
        created.append(LightLists(device, **options))
        return created[-1]

    yield make_grid
    for grid in created:
        grid.destroy()


def collect(
    grid: LightLists, device: Device, camera: Camera, lights: Lights, **options: object
) -> LightListData:
    grid.collect(device, camera, SIZE, lights, **options)
    return grid.read()


@pytest.mark.nightly_cases(
    "gl-endless-1", "gl-off-axis-1", "gl-parallel-1", "gl-endless-12", "gl-off-axis-12", reason=FEWER_CASES
)
@pytest.mark.parametrize("slices", [1, 12])
@pytest.mark.parametrize("projection", PROJECTIONS)
def test_cells_list_the_lights_whose_spheres_reach_them(
    device: Device, make: Callable[..., LightLists], projection: str, slices: int
) -> None:
    lights, camera = make_lights(), look(PROJECTIONS[projection])
    grid = make(tile=16 if slices == 1 else 32, slices=slices, sphere_test="exact", cone_test="sphere")
    listed = as_pairs(collect(grid, device, camera, lights), lights)
    if (projection, slices) not in _exact:  # the same for all devices
        _exact[projection, slices] = reference_pairs(camera, grid.layout, lights)
    certain, possible = _exact[projection, slices]
    assert not (certain & ~listed).any()
    assert not (listed & ~possible).any()
    assert 0.002 < certain.mean() < 0.3


@pytest.mark.nightly_cases("cl", reason=ONLY_KERNELS)
def test_the_same_lists_are_made_with_the_pre_filter_in_a_tenth_of_the_tests(
    device: Device, make: Callable[..., LightLists]
) -> None:
    lights, camera = make_lights(1024, 0), look(PROJECTIONS["perspective"])
    lights.point["range"] *= 0.3
    options = {"tile": 8, "sphere_test": "exact", "counted": True, "capacity": 100_000}
    lists = [collect(make(**options, block_test=name), device, camera, lights) for name in ("none", "planes")]
    assert (lists[0].lights == lists[1].lights).all()
    assert (lists[0].ends == lists[1].ends).all()
    assert lists[0].tests == 42 * 24 * 1024
    assert 6 * 3 * 1024 < lists[1].tests < 0.1 * lists[0].tests


def test_lists_are_the_same_in_every_run(device: Device, make: Callable[..., LightLists]) -> None:
    lights, camera, grid = make_lights(300, 100), look(PROJECTIONS["perspective"]), make(capacity=100_000)
    first, second = (collect(grid, device, camera, lights) for _ in range(2))
    for name in ("bounds", "lights"):
        assert (getattr(first, name) == getattr(second, name)).all()


def test_cones_are_tested_after_their_spheres(device: Device, make: Callable[..., LightLists]) -> None:
    lights, camera = make_lights(40, 300), look(PROJECTIONS["perspective"])
    passed = {}
    for name in ("sphere", "tight"):
        grid = make(slices=8, sphere_test="exact", cone_test=name, capacity=200_000)
        passed[name] = as_pairs(collect(grid, device, camera, lights), lights)
        assert not (passed[name] & ~passed["sphere"]).any()
        assert (passed[name][:, :40] == passed["sphere"][:, :40]).all()
    assert passed["tight"].sum() < 0.9 * passed["sphere"].sum()


def test_a_grid_has_no_lists_without_lights(device: Device, make: Callable[..., LightLists]) -> None:
    lists = collect(make(), device, look(PROJECTIONS["perspective"]), Lights())
    assert lists.pairs == 0
    assert len(lists.ends) == 21 * 12
    assert not lists.ends.any()


@pytest.mark.parametrize(("points", "spots"), [(1, 0), (0, 1), (32, 32), (33, 31), (31, 33), (2100, 2100)])
def test_any_number_of_lights_is_listed(
    device: Device, make: Callable[..., LightLists], points: int, spots: int
) -> None:
    lights, camera = make_lights(points, spots), look(PROJECTIONS["perspective"])
    for rows in (lights.point, lights.spot):
        rows["position"], rows["range"] = camera.position + 5.0 * camera.forward, 1e4
    lights.spot["outer"] = np.pi
    lists = collect(make(tile=64, capacity=100_000), device, camera, lights)
    assert (np.diff(lists.bounds)[:, 0] == points).all()
    assert (np.diff(lists.bounds)[:, 1] == spots).all()
    as_pairs(lists, lights)


# -- overflow ------------------------------------------------------------------------------------------------


def test_full_lists_are_in_the_masks_and_grow(device: Device, make: Callable[..., LightLists]) -> None:
    lights, camera = make_lights(), look(PROJECTIONS["perspective"])
    whole = collect(make(capacity=100_000), device, camera, lights)
    for less in (0, 1, whole.pairs - 1):
        grid = make(capacity=whole.pairs - less)
        lists = collect(grid, device, camera, lights)
        assert (lists.full == (whole.ends > whole.pairs - less)).all()
        assert lists.full.any() == (less > 0)
        for name in ("bounds", "lights"):
            assert (getattr(lists, name) == getattr(whole, name)).all()
        for _ in range(4):  # a frame asks for the need of the one before, and the next learns it
            grid.collect(device, camera, SIZE, lights)
            device.finish()
        assert not grid.read().full.any()
        assert (grid.read().lights == whole.lights).all()
        assert grid.overflows == (2 if less else 0)


def test_the_capacity_follows_the_number_of_cells_unless_it_is_set(
    device: Device, make: Callable[..., LightLists]
) -> None:
    lights, camera = make_lights(), look(PROJECTIONS["perspective"])
    for options, rooms in (({}, [64 * 4, 64 * 16]), ({"capacity": 300}, [300, 300])):
        grid = make(tile=16, **options)
        for size, room in zip(((32, 32), (64, 64)), rooms, strict=True):
            grid.collect(device, camera, size, lights)
            assert grid.capacity == room


# -- resolutions, depths -------------------------------------------------------------------------------------


@pytest.mark.parametrize("size", [(1366, 768), (1680, 1050), (1, 1)])
def test_a_grid_fits_every_resolution(
    device: Device, make: Callable[..., LightLists], size: tuple[int, int]
) -> None:
    """A light that just reaches each corner's pixel is on the list of the cell that the pixel finds."""
    projection = Perspective(aspect=size[0] / size[1], far=60.0)
    camera, lights = look(projection), Lights()
    x, y = 10.0 * np.tan(projection.fov / 2) * projection.aspect, 10.0 * np.tan(projection.fov / 2)
    for offset in ((-x, y), (x, y), (-x, -y), (x, -y)):
        lights.add_point(camera.position + np.array([*offset, -10.0]) @ camera.rotation, 0.01)
    grid = make(tile=16, sphere_test="exact")
    grid.collect(device, camera, size, lights)
    lists = as_pairs(grid.read(), lights)
    columns, rows = -(-size[0] // 16), -(-size[1] // 16)
    assert len(lists) == columns * rows
    for light, cell in enumerate((0, columns - 1, columns * (rows - 1), columns * rows - 1)):
        assert lists[cell, light]


def test_a_grid_follows_the_images_size_and_the_number_of_lights(
    device: Device, make: Callable[..., LightLists]
) -> None:
    camera, grid = look(PROJECTIONS["perspective"]), make(capacity=100_000)
    for size, points, spots in (
        ((333, 187), 90, 0),
        ((640, 360), 40, 60),
        ((64, 64), 300, 10),
        ((333, 187), 90, 0),
    ):
        fresh, lights = make(capacity=100_000), make_lights(points, spots)
        for light_lists in (grid, fresh):
            light_lists.collect(device, camera.with_aspect(size[0] / size[1]), size, lights)
        lists, expected = grid.read(), fresh.read()
        for name in ("bounds", "lights"):
            assert (getattr(lists, name) == getattr(expected, name)).all()
    assert grid.overflows == 0


def project_depths(projection: Projection, z: np.ndarray) -> np.ndarray:
    """Compute the depths in a texture of distances; those that are infinite are the background."""
    ahead = np.where(np.isfinite(z), z, 1.0)
    m = projection.matrix
    depth = (m[2, 3] - m[2, 2] * ahead) / (m[3, 3] - m[3, 2] * ahead)
    return np.where(np.isfinite(z), depth, 0.0 if projection.depth is Depth.REVERSED else 1.0).astype(
        np.float32
    )


@pytest.mark.nightly_cases("cl-*-True-*", "cl-perspective-False-1", reason=ONLY_KERNELS)
@pytest.mark.parametrize("slices", [1, 6])
@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize("projection", PROJECTIONS)
def test_no_surface_is_lit_by_fewer_lights_than_reach_it(
    device: Device, make: Callable[..., LightLists], projection: str, masked: bool, slices: int
) -> None:
    camera, lights, rng = look(PROJECTIONS[projection]), make_lights(200, 60), np.random.default_rng(6)
    y, x = np.mgrid[: SIZE[1], : SIZE[0]]
    z = 10.0 + 8.0 * np.sin(x / 40.0) * np.cos(y / 30.0) + np.where((x // 7 + y // 11) % 3 == 0, 25.0, 0.0)
    z = np.where(x > 250, 12.0, z)  # flat tiles
    z[(y < 40) & (x < 90)] = np.inf
    texture = create_depth_texture(device, project_depths(camera.projection, z))
    grid = make(
        tile=16, slices=slices, sphere_test="exact", cone_test="tight", depth_mask=masked, capacity=200_000
    )
    listed = as_pairs(collect(grid, device, camera, lights, depth=texture), lights)

    pixels = np.column_stack([rng.integers(0, SIZE[0], 3000), rng.integers(0, SIZE[1], 3000)])
    ahead = z[pixels[:, 1], pixels[:, 0]]
    pixels, ahead = pixels[np.isfinite(ahead)], ahead[np.isfinite(ahead)]
    starts = evaluate(slice_start, grid.layout, np.arange(slices + 1), dtype=np.float64)
    layer = np.clip(np.searchsorted(starts, ahead, side="right") - 1, 0, slices - 1)
    cell = (layer * 12 + pixels[:, 1] // 16) * 21 + pixels[:, 0] // 16
    positions = camera.position + view_positions(camera.projection, pixels, ahead) @ camera.rotation
    for light in range(260):
        row = lights.point[light] if light < 200 else lights.spot[light - 200]
        away = positions - row["position"]
        distance = np.linalg.norm(away, axis=1)
        reached = distance < row["range"] * 0.9999
        if light >= 200:
            reached &= away @ row["direction"] > distance * (np.cos(row["outer"]) + 1e-5)
        assert listed[cell[reached], light].all()
    sky = listed.reshape(slices, 12, 21, 260)[:, :2, :5]
    assert not sky.any()
    texture.destroy()


def view_positions(projection: Projection, pixels: np.ndarray, ahead: np.ndarray) -> np.ndarray:
    """Compute the places in view space of the middles of pixels at distances."""
    clip = (2.0 * (pixels + 0.5) / SIZE - 1.0) * (1.0, -1.0)
    m = projection.matrix
    w = m[3, 3] - m[3, 2] * ahead
    x = (clip[:, 0] * w + m[0, 2] * ahead - m[0, 3]) / m[0, 0]
    y = (clip[:, 1] * w + m[1, 2] * ahead - m[1, 3]) / m[1, 1]
    return np.column_stack([x, y, -ahead])


@pytest.mark.nightly_cases("cl", reason=ONLY_KERNELS)
def test_a_light_between_the_surfaces_of_a_tile_is_dropped_by_the_mask(
    device: Device, make: Callable[..., LightLists]
) -> None:
    camera, lights = look(PROJECTIONS["perspective"]), Lights()
    for depth in (4.0, 20.0, 40.0):
        lights.add_point(camera.position + depth * camera.forward, 2.0)
    z = np.full(SIZE[::-1], 4.0)
    z[:, ::2] = 40.0
    texture = create_depth_texture(device, project_depths(camera.projection, z))
    middle = 6 * 21 + 10
    passed = {}
    for masked in (False, True):
        grid = make(sphere_test="exact", depth_mask=masked)
        passed[masked] = as_pairs(collect(grid, device, camera, lights, depth=texture), lights)[
            middle
        ].tolist()
    assert passed == {False: [True, True, True], True: [True, False, True]}
    texture.destroy()


def test_lists_can_be_made_in_a_recorded_command_buffer(
    device: Device, make: Callable[..., LightLists]
) -> None:
    lights, camera, grid = make_lights(), look(PROJECTIONS["perspective"]), make(capacity=100_000)
    expected = collect(grid, device, camera, lights)
    grid.lists.clear()
    with device.record() as commands:
        grid.collect(commands, camera, SIZE, lights)
    device.submit(commands)
    assert (grid.read().lights == expected.lights).all()


def test_a_test_of_another_name_is_refused(device: Device) -> None:
    for name in ("sphere_test", "cone_test", "block_test"):
        with pytest.raises(ValidationError, match="lights-unknown-test"):
            LightLists(device, **{name: "hybrit"})


def test_a_frame_issues_three_dispatches_and_one_more_for_depth() -> None:
    with rhi.create_device("null") as null:
        lights, camera = make_lights(), look(PROJECTIONS["perspective"])
        depth = null.texture(SIZE, Format.D32F)
        grid = LightLists(null)
        grid.collect(null, camera, SIZE, lights)
        null.stream.clear()
        before = null.statistics
        grid.collect(null, camera, SIZE, lights)
        after = null.statistics
        assert after.dispatches - before.dispatches == 3
        assert after.upload_bytes - before.upload_bytes < 10_000
        grid.collect(null, camera, SIZE, lights, depth)
        assert null.statistics.dispatches - after.dispatches == 4
        grid.destroy()
