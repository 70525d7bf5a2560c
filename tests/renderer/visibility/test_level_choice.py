"""The levels of detail that the device chooses for its lists: compared with the CPU's and with an oracle in float64,
object by object, and the draws that follow."""

from __future__ import annotations

from collections import Counter
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from nightly_reasons import ONLY_KERNELS

import rhi
from renderer.content.shapes import bumpy_sphere
from renderer.frame import SceneResources
from renderer.frame.detail import make_mesh_parts
from renderer.frame.mirrors import split_doubles
from renderer.renderer import Renderer
from renderer.scene import Camera, Orthographic, Perspective, Scene, SceneBuilder, StereoRig, translation
from renderer.scene.meshes import Meshes, MeshGeometry, MeshLevel
from renderer.shaders import Object, ObjectPosition
from renderer.stereo import Stereo
from renderer.visibility.detail import ChooseLevels, DetailLimit, make_constants
from renderer.visibility.gpu.draw_lists import make_instance_sets
from renderer.visibility.gpu.two_pass import TwoPassCulling
from rhi import Op
from rhi.shading import run_compute
from rhi.testing import EffectPattern, assert_free, frames

SIZE = 320, 180
CLOSE = 3e-6
"""The part of the distance from the eye, and of its size, by which the device may see an object nearer than it is."""


def make_meshes() -> Meshes:
    """Make meshes with three levels, none, and one level."""
    box = bumpy_sphere(8)
    moved = MeshGeometry(box.vertices.copy(), box.indices)
    moved.vertices["position"] = (box.vertices["position"] * (1.0, 0.3, 2.0) + 0.5).astype(np.float32)
    levels = [[0.01, 0.04, 0.09], [], [0.02]]
    return Meshes(
        [moved, box, box],
        ["a", "b", "c"],
        [None] * 3,
        [[MeshLevel(box.indices[: 6 * (k + 1)], error) for k, error in enumerate(row)] for row in levels],
    )


def choose_on_device(
    meshes: Meshes, mesh: np.ndarray, world: np.ndarray, limit: DetailLimit | None
) -> np.ndarray:
    """Return the level (k,) of each object, as the kernel chooses it."""
    objects, positions = np.zeros(len(mesh), Object.dtype), np.zeros(len(mesh), ObjectPosition.dtype)
    objects["linear"][..., :3] = world[:, :3, :3]
    positions["high"], positions["low"] = split_doubles(world[:, :3, 3])
    written = run_compute(
        ChooseLevels,
        -(-len(mesh) // 64),
        detail=make_constants(limit),
        objects=objects,
        object_positions=positions,
        object_meshes=mesh.astype(np.int32),
        mesh_parts=make_mesh_parts(meshes),
        drawn_parts=len(mesh),
    )
    parts = written["drawn_parts"]
    levels: np.ndarray = np.where(parts < len(meshes), 0, parts - len(meshes) - meshes.level_begins[mesh] + 1)
    assert (parts[levels == 0] == mesh[levels == 0]).all()
    return levels


def choose_by_oracle(
    meshes: Meshes, mesh: np.ndarray, world: np.ndarray, limit: DetailLimit, nearer: float = 0.0
) -> list[int]:
    """Return the level of each object, one by one from its box's corners, in float64; with all objects nearer by a
    part of their distance and size."""
    levels = []
    for number, transform in zip(mesh.tolist(), world, strict=True):
        lower, upper = meshes.lower[number], meshes.upper[number]
        corners = np.array([np.where([i & 1, i & 2, i & 4], upper, lower) for i in range(8)])
        corners = corners @ transform[:3, :3].T + transform[:3, 3]
        distances = [
            np.linalg.norm(np.clip(eye, corners.min(axis=0), corners.max(axis=0)) - eye)
            - nearer * np.linalg.norm(corners - eye, axis=1).max()
            for eye in limit.eyes
        ]
        allowed = limit.constant + limit.slope * max(min(distances), 0.0)
        products = [sum(abs(float(transform[:3, i] @ transform[:3, j])) for j in range(3)) for i in range(3)]
        stretch = max(products) ** 0.5 * (1.0 + nearer)
        errors = meshes.level_errors[number].tolist()
        levels.append(sum(error * stretch <= allowed for error in errors))
    return levels


def choose_on_cpu(meshes: Meshes, mesh: np.ndarray, world: np.ndarray, limit: DetailLimit) -> list[int]:
    levels: list[int] = limit.count_levels(
        world, meshes.lower[mesh], meshes.upper[mesh], meshes.level_errors[mesh]
    ).tolist()
    return levels


def make_cameras(rng: np.random.Generator, count: int, is_parallel: bool, origin: float) -> list[Camera]:
    projection = (
        Orthographic(float(rng.uniform(1.0, 30.0)), 1.5) if is_parallel else Perspective(0.9, 1.5, near=0.1)
    )
    return [
        Camera.look_at(*(origin + rng.normal(0.0, 9.0, (2, 3))), projection=projection) for _ in range(count)
    ]


@settings(max_examples=40, deadline=None)
@given(
    st.integers(0, 9999),
    st.sampled_from([1, 2]),
    st.booleans(),
    st.sampled_from([0.0, 1e3, 1e6]),
    st.floats(0.05, 40),
)
def test_the_device_chooses_the_cpus_levels(
    seed: int, eyes: int, is_parallel: bool, origin: float, pixels: float
) -> None:
    rng, meshes = np.random.default_rng(seed), make_meshes()
    cameras = make_cameras(rng, eyes, is_parallel, origin)
    limit = DetailLimit.compute(cameras, SIZE, pixels)
    assert limit is not None
    mesh = rng.integers(0, 3, 90)
    world = np.broadcast_to(np.eye(4), (90, 4, 4)).copy()
    world[:, :3, :3] = rng.normal(size=(90, 3, 3)) * np.exp(
        rng.normal(-1.0, 1.5, (90, 1, 3))
    )  # also mirrored
    world[:, :3, 3] = origin + rng.normal(0.0, 1.0, (90, 3)) * np.exp(rng.uniform(-2.0, 7.0, (90, 1)))
    on_device = choose_on_device(meshes, mesh, world, limit).tolist()
    expected = choose_by_oracle(meshes, mesh, world, limit)
    nearer = choose_by_oracle(meshes, mesh, world, limit, CLOSE)
    assert choose_on_cpu(meshes, mesh, world, limit) == expected
    assert all(low <= level <= high for low, level, high in zip(nearer, on_device, expected, strict=True))
    assert sum(low != high for low, high in zip(nearer, expected, strict=True)) <= 1, "hardly any is so close"


@pytest.mark.parametrize("scale", [(1.0, 1.0, 1.0), (0.01, 0.01, 0.01), (3.0, 1.0, -0.5)])
@pytest.mark.parametrize("level", [1, 2, 3])
@pytest.mark.parametrize("is_behind", [False, True])
def test_a_level_begins_at_its_distance(scale: tuple[float, ...], level: int, is_behind: bool) -> None:
    meshes, mesh = make_meshes(), np.zeros(3, np.int64)
    camera = Camera.look_at((0.0, 0.0, 0.0), (0.0, 0.0, -1.0), projection=Perspective(0.9, 1.5))
    limit = DetailLimit.compute([camera], SIZE, 2.0)
    assert limit is not None
    stretch, error = max(map(abs, scale)), float(meshes.level_errors[0, level - 1])
    ends = (meshes.lower[0] * scale, meshes.upper[0] * scale)
    middle, half = 0.5 * (ends[0] + ends[1]), 0.5 * np.abs(ends[1] - ends[0])
    away = error * stretch / limit.slope
    world = np.broadcast_to(np.diag([*scale, 1.0]), (3, 4, 4)).copy()
    for row, factor in enumerate((1.0 - 1e-4, 1.0, 1.0 + 1e-4)):
        z = (away * factor + half[2]) * (1.0 if is_behind else -1.0)
        world[row, :3, 3] = np.array([0.0, 0.0, z]) - middle
    before, at, beyond = choose_on_device(meshes, mesh, world, limit).tolist()
    assert (before, beyond) == (level - 1, level)
    assert at in (before, beyond), "a rounding may decide"
    on_cpu = choose_on_cpu(meshes, mesh, world, limit)
    assert (on_cpu[0], on_cpu[2]) == (level - 1, level)
    assert at <= on_cpu[1]


@pytest.mark.parametrize("origin", [0.0, 1e5])
def test_where_roundings_decide_no_level_is_coarser(origin: float) -> None:
    rng, meshes, mesh = np.random.default_rng(1), make_meshes(), np.full(2000, 2)
    camera = Camera.look_at((origin, 0.0, 0.0), (origin, 0.0, -1.0), projection=Perspective(0.9, 1.5))
    limit = DetailLimit.compute([camera], SIZE, 2.0)
    assert limit is not None
    world = np.broadcast_to(np.eye(4), (2000, 4, 4)).copy()
    world[:, :3, :3] = np.linalg.qr(rng.normal(size=(2000, 3, 3)))[0] * rng.uniform(0.5, 2.0, (2000, 1, 1))
    middle = world[:, :3, :3] @ (0.5 * (meshes.lower[2] + meshes.upper[2]))
    half = np.abs(world[:, :3, :3]) @ (0.5 * (meshes.upper[2] - meshes.lower[2]))
    gram = world[:, :3, :3].transpose(0, 2, 1) @ world[:, :3, :3]
    away = float(meshes.level_errors[2, 0]) * np.sqrt(np.abs(gram).sum(axis=2).max(axis=1)) / limit.slope
    world[:, :3, 3] = camera.position - middle
    world[:, 2, 3] -= away * (1.0 + rng.uniform(-2e-7, 2e-7, 2000)) + half[:, 2]
    on_device = choose_on_device(meshes, mesh, world, limit)
    on_cpu = np.array(choose_on_cpu(meshes, mesh, world, limit))
    assert 200 < on_cpu.sum() < 1800
    assert (on_device <= on_cpu).all()


def test_an_eye_within_the_box_and_no_limit_draw_the_mesh() -> None:
    meshes, mesh, world = make_meshes(), np.array([0, 1, 2]), np.eye(4)[None].repeat(3, axis=0)
    limit = DetailLimit.compute([Camera.look_at((0.5, 0.5, 0.5), (0.0, 0.0, -1.0))], SIZE, 5.0)
    assert choose_on_device(meshes, mesh, world, limit).tolist() == [0, 0, 0]
    world[:, :3, 3] = 500.0
    assert choose_on_device(meshes, mesh, world, None).tolist() == [0, 0, 0]
    assert choose_on_device(meshes, mesh, world, limit).tolist() == [3, 0, 1]  # the control


@given(st.integers(0, 999))
def test_there_is_an_entry_for_each_level(seed: int) -> None:
    rng = np.random.default_rng(seed)
    begins = np.array([0, 2, 2, 5])
    meshes, groups = rng.integers(0, 3, 40).astype(np.int32), rng.integers(0, 2, 40).astype(np.int32)
    entries, set_begins = make_instance_sets(meshes, groups, begins)
    expected = []
    for group in range(2):
        for mesh in range(3):
            rows = np.flatnonzero((groups == group) & (meshes == mesh)).tolist()
            for part in [mesh, *range(3 + begins[mesh], 3 + begins[mesh + 1])]:
                expected += [[(row, part) for row in rows]] if rows else []
    parts = [entries[a:b].tolist() for a, b in pairwise(set_begins.tolist())]
    assert parts == expected
    without = make_instance_sets(meshes, groups, np.zeros(4, np.int64))
    assert all(map(np.array_equal, without, make_instance_sets(meshes, groups)))


def make_row(levels: int = 5) -> Scene:
    """Make a row of spheres and one mesh without levels, that leads away from the eye."""
    builder = SceneBuilder("row")
    meshes = [builder.add_mesh(bumpy_sphere(24), levels=levels), builder.add_mesh(bumpy_sphere(10))]
    row = builder.add_material()
    for number in range(14):
        transform = translation((1.6 * (number % 2), 0.0, -1.5 * number**1.5))
        transform[:3, :3] = np.diag([1.0 + 0.1 * number, 1.0 if number % 3 else -1.0, 1.5])
        builder.add_objects(builder.add_node(transform), meshes[number == 7], row)
    builder.lights.add_directional((0.4, -1.0, -0.3))
    return builder.build()


CAMERA = Camera.look_at((0.0, 2.0, 6.0), (0.0, 0.0, -20.0)).with_aspect(SIZE[0] / SIZE[1])


class LevelRecord:
    """A renderer whose lists the device makes, and the draws of its last frame."""

    def __init__(
        self, device: rhi.Device, scene: Scene, camera: Camera, stereo: Stereo | None = None
    ) -> None:
        self.algorithm = TwoPassCulling(scene, device)
        self.renderer = Renderer(device, scene, size=SIZE, visibility=self.algorithm, technique="forward")
        self.renderer.stereo = stereo
        self.renderer.detail_error = 3.0
        for _ in range(3):
            self.result = self.renderer.render(camera)

    def read_draws(self) -> np.ndarray:
        """Return all draws of both lists."""
        draws = []
        for listed in (self.algorithm.first, self.algorithm.second):
            totals, rows = listed.totals.read()[:-1], listed.draws.read()
            room = len(rows) // listed.parts
            draws += [rows[room * part : room * part + total] for part, total in enumerate(totals.tolist())]
        every: np.ndarray = np.concatenate(draws)
        return every

    def expect_draws(self) -> np.ndarray:
        """Return the draws of the CPU's levels of all objects, one by one."""
        resources = self.renderer.resources
        return resources.get_draws(np.arange(len(resources.scene.objects)), resources.detail_limit)

    def destroy(self) -> None:
        self.renderer.destroy()
        self.algorithm.destroy()


@pytest.mark.nightly_cases("cl*", reason=ONLY_KERNELS)
def test_each_level_is_one_draw_and_the_image_that_of_the_cpu(device: rhi.Device) -> None:
    scene = make_row()
    record = LevelRecord(device, scene, CAMERA)
    image, draws, expected = record.result.image.read(), record.read_draws(), record.expect_draws()
    mirrored = record.renderer.resources.group  # drawn with other states: draws of their own
    pairs = set(zip(expected["first"].tolist(), mirrored.tolist(), strict=True))
    assert len(draws) == len(pairs) > 4
    for first in set(expected["first"].tolist()):
        assert draws["instances"][draws["first"] == first].sum() == (expected["first"] == first).sum()
    drawn = int((draws["count"] * draws["instances"]).sum()) // 3
    assert record.result.statistics.triangles == drawn == int(expected["count"].sum()) // 3
    full = int(scene.meshes.triangle_counts[scene.objects.mesh].sum())
    assert drawn < 0.7 * full
    record.destroy()
    with Renderer(device, scene, size=SIZE, visibility="frustum", technique="forward") as renderer:
        renderer.detail_error = 3.0
        assert np.abs(renderer.render(CAMERA).image.read()[..., :3].astype(int) - image[..., :3]).max() <= 1
        renderer.detail_error = 0.0
        assert np.abs(renderer.render(CAMERA).image.read()[..., :3].astype(int) - image[..., :3]).max() > 8


def test_no_error_lists_the_meshes(gl: rhi.Device) -> None:
    record = LevelRecord(gl, make_row(), CAMERA)
    listed = []
    for record.renderer.detail_error in (3.0, 0.0):
        record.renderer.render(CAMERA)
        draws = record.read_draws()
        assert draws["instances"].sum() == 14
        listed.append(int((draws["count"] * draws["instances"]).sum()) // 3)
    scene = record.renderer.scene
    assert listed[0] < listed[1] == int(scene.meshes.triangle_counts[scene.objects.mesh].sum())
    record.destroy()


@pytest.mark.parametrize("projection", [Orthographic(9.0, 16 / 9, 0.1, 90.0), Perspective(0.9, 16 / 9)])
def test_projections_have_the_levels_of_their_limits(
    gl: rhi.Device, projection: Orthographic | Perspective
) -> None:
    camera = Camera.look_at((0.0, 9.0, 9.0), (0.0, 0.0, -20.0), projection=projection)
    record = LevelRecord(gl, make_row(), camera)
    drawn = record.algorithm.level_choice
    assert drawn is not None
    resources = record.renderer.resources
    counts = make_mesh_parts(resources.scene.meshes)["count"][drawn.drawn_parts.read()]
    expected = record.expect_draws()["count"]
    assert counts.tolist() == expected.tolist()
    assert len(set(expected[resources.scene.objects.mesh == 0].tolist())) > 1, "sizes and distances differ"
    record.destroy()


def test_both_eyes_list_the_same_levels(gl: rhi.Device) -> None:
    record = LevelRecord(gl, make_row(), CAMERA, Stereo(StereoRig(1.5, 5.0)))
    limit = record.renderer.resources.detail_limit
    assert limit is not None
    assert len(limit.eyes) == 2
    expected, levels = record.expect_draws()["count"].tolist(), []
    for frame in record.result.frames:
        algorithm = frame.view.visibility
        assert isinstance(algorithm, TwoPassCulling)
        assert algorithm.level_choice is not None
        parts = make_mesh_parts(record.renderer.scene.meshes)
        levels.append(parts["count"][algorithm.level_choice.drawn_parts.read()].tolist())
    assert levels[0] == levels[1] == expected
    record.destroy()


def draw_on(device: rhi.Device, levels: int) -> None:
    """Draw three frames."""
    scene = make_row(levels)
    algorithm = TwoPassCulling(scene, device)
    with Renderer(device, scene, size=SIZE, visibility=algorithm, technique="forward") as renderer:
        for _ in range(3):
            renderer.render(CAMERA)
    algorithm.destroy()


LEVELS = EffectPattern(
    "levels",
    programs=("ChooseLevels", "CountLevels"),
    bindings=("drawn_parts", "detail"),
    resources=("drawn parts", "DetailConstants"),
    events=("choose levels",),
)


def test_scenes_without_levels_have_no_command_of_them() -> None:
    with rhi.create_device("null") as without, rhi.create_device("null") as with_levels:
        draw_on(without, 0)
        draw_on(with_levels, 5)
        assert_free(LEVELS, without, control=with_levels)
        counts = [
            Counter(
                command.op for command in frames(device)[-1] if command.op in (Op.DISPATCH, Op.DRAW_INDIRECT)
            )
            for device in (without, with_levels)
        ]
    assert counts[1] - counts[0] == {Op.DISPATCH: 1}
    assert not counts[0] - counts[1]


def test_levels_that_are_not_shown_cost_nothing(null: rhi.Device) -> None:
    scene = make_row()
    has_levels, counts = scene.objects.mesh == 0, []
    algorithm = TwoPassCulling(scene, null)
    with Renderer(null, scene, size=SIZE, visibility=algorithm, technique="forward") as renderer:
        for is_shown in (True, False, True):
            (scene.nodes.show if is_shown else scene.nodes.hide)(scene.objects.node[has_levels])
            for _ in range(2):
                null.stream.clear()
                renderer.render(CAMERA)
            counts.append(len(null.stream.filter(Op.DISPATCH)))
            assert renderer.resources.uses_levels == is_shown
            arrays = renderer.resources.scene_arrays(renderer._view.buffer)
            assert (arrays.detail is not None) == is_shown
            assert (arrays.list_entries.count > len(scene.objects)) == is_shown
    algorithm.destroy()
    assert counts == [counts[1] + 1, counts[1], counts[1] + 1]


def test_parts_of_levels_are_behind_those_of_meshes(null: rhi.Device) -> None:
    scene = make_row()
    resources = SceneResources(null, scene)
    parts = resources.mesh_parts.read()
    meshes = scene.meshes
    assert parts["first_level"][:2].tolist() == (2 + meshes.level_begins[:-1]).tolist()
    assert parts["level_count"][:2].tolist() == np.diff(meshes.level_begins).tolist()
    assert (parts["error"][2:] >= meshes.level_errors[0]).all()
    assert parts["error"][2:] == pytest.approx(meshes.level_errors[0], rel=1e-6)
    indices = resources.mesh.indices
    assert indices is not None
    assert (parts["first"] + parts["count"]).max() == len(meshes.indices) + len(meshes.level_indices)
    resources.destroy()
