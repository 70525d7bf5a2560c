"""Meshlets that the device culls: each decision compared with the triangles in float64, and the images with those of
whole meshes."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from nightly_reasons import ONLY_KERNELS

import rhi
from renderer.content.shapes import BUILT_IN, bumpy_sphere
from renderer.frame import UploadSettings
from renderer.frame.detail import make_mesh_parts
from renderer.frame.meshlets import make_meshlets
from renderer.frame.mirrors import split_doubles
from renderer.renderer import Renderer
from renderer.scene import (
    Camera,
    Orthographic,
    Perspective,
    Projection,
    Scene,
    SceneBuilder,
    StereoRig,
    translation,
)
from renderer.scene.meshes import Meshes, MeshGeometry
from renderer.scene.meshlets import cut_into_meshlets
from renderer.shaders import Object, ObjectPosition, ViewConstants
from renderer.stereo import Stereo
from renderer.techniques import TECHNIQUES, ForwardPlus, TiledDeferred
from renderer.visibility import VisibilitySettings, make_visibility
from renderer.visibility.gpu.device_culling import DeviceCulling
from renderer.visibility.gpu.draw_lists import make_instance_sets
from renderer.visibility.gpu.meshlet_culling import TURNED_AWAY, UNUSED, WAS_VISIBLE, CullMeshlets
from renderer.visibility.gpu.occludees import DRAWN, HIDDEN, OUTSIDE, VISIBLE, Occludee, _culling_camera
from rhi import Op
from rhi.math import normal_matrices
from rhi.shading import run_compute
from rhi.testing import EffectPattern, assert_free, frames

SIZE = 320, 180


def make_meshes() -> Meshes:
    """Make a sphere that is stretched and off its origin, a torus, and a sphere that is seen from within, all cut."""
    sphere = bumpy_sphere(24, 0.1).transformed(np.diag([2.0, 0.4, 1.0, 1.0]) @ translation((0.3, 0.1, 0.0)))
    ball = BUILT_IN["sphere"]().transformed(np.diag([3.0, 3.0, 3.0, 1.0]))
    hollow = MeshGeometry(ball.vertices, ball.indices.reshape(-1, 3)[:, ::-1].reshape(-1))
    cut = [cut_into_meshlets(mesh, 24) for mesh in (sphere, BUILT_IN["torus"](), hollow)]
    return Meshes([mesh for mesh, _ in cut], ["a", "b", "c"], meshlets=[sizes for _, sizes in cut])


MESHES = make_meshes()
PARTS = make_mesh_parts(MESHES)


@dataclass
class Case:
    """Objects before a camera, and the entries of their meshlets."""

    camera: Camera
    world: np.ndarray
    entries: np.ndarray
    two_sided: np.ndarray

    def cull(self) -> np.ndarray:
        """Return the state (e,) of each entry of a visible object, as the kernel writes it."""
        count = len(self.world)
        objects, positions = np.zeros(count, Object.dtype), np.zeros(count, ObjectPosition.dtype)
        normal = normal_matrices(self.world)
        largest = np.abs(normal).max(axis=(1, 2), keepdims=True)
        objects["linear"][..., :3] = self.world[:, :3, :3]
        objects["normal"][..., :3] = normal / np.where(largest > 0.0, largest, 1.0)
        positions["high"], positions["low"] = split_doubles(self.world[:, :3, 3])
        positions["draw_list"] = (np.linalg.det(self.world[:, :3, :3]) < 0.0) + 2 * self.two_sided
        high, low = split_doubles(self.camera.position)
        written = run_compute(
            CullMeshlets,
            -(-len(self.entries) // 64),
            view=ViewConstants(
                relative_view_projection=self.camera.relative_view_projection, eye_high=high, eye_low=low
            ),
            culling_camera=_culling_camera(self.camera, SIZE),
            objects=objects,
            object_positions=positions,
            entries=self.entries,
            meshlets=make_meshlets(MESHES),
            marks=np.full(count, VISIBLE, np.uint32),
            boxes=len(self.entries),
            states=np.full(len(self.entries), WAS_VISIBLE, np.uint32),
        )
        states: np.ndarray = written["states"]
        return states

    def list_corners(self, entry: int) -> np.ndarray:
        """Return the corners (t, 3, 3) of an entry's triangles in float64, relative to the eye."""
        row, part = self.entries[entry].tolist()
        first, count, base = (int(PARTS[part][name]) for name in ("first", "count", "base_vertex"))
        points = MESHES.vertices["position"][MESHES.indices[first : first + count] + base].astype(np.float64)
        world = self.world[row]
        corners: np.ndarray = (points @ world[:3, :3].T + (world[:3, 3] - self.camera.position)).reshape(
            -1, 3, 3
        )
        return corners

    def faces_the_eye(self, entry: int) -> bool:
        """Return whether the front of any triangle is seen, by the sign of the volume that it spans with the eye."""
        a, b, c = self.list_corners(entry).transpose(1, 0, 2)
        normal = np.cross(b - a, c - a)
        if isinstance(self.camera.projection, Orthographic):
            sides = -normal @ self.camera.forward
        else:
            sides = -np.einsum("td,td->t", normal, a)
        if np.linalg.det(self.world[self.entries[entry]["object"], :3, :3]) < 0.0:
            sides = -sides
        return bool((sides > 0.0).any())

    def is_in_view(self, entry: int) -> bool:
        """Return whether any of many points of the triangles is in the view's volume."""
        corners = self.list_corners(entry)
        weights = np.array([(i, j, 6 - i - j) for i in range(7) for j in range(7 - i)]) / 6.0
        points = np.einsum("wk,tkd->twd", weights, corners).reshape(-1, 3)
        rotation = self.camera.rotation
        eye = np.column_stack([points @ rotation.T, np.ones(len(points))])
        clip = eye @ np.asarray(self.camera.projection.matrix, np.float64).T
        x, y, z, w = clip.T
        return bool(((np.abs(x) <= w) & (np.abs(y) <= w) & (z >= 0.0) & (z <= w)).any())


def make_case(seed: int, is_parallel: bool, kind: str, origin: float) -> Case:
    rng = np.random.default_rng(seed)
    count = 8
    linear = rng.normal(size=(count, 3, 3))
    rotation = np.linalg.qr(linear)[0]
    if kind == "uniform":
        linear = rotation * np.exp(rng.normal(0.0, 0.5, (count, 1, 1)))
    elif kind == "stretched":  # also mirrored
        linear = rotation * (
            np.exp(rng.normal(0.0, 1.5, (count, 1, 3))) * rng.choice([-1.0, 1.0], (count, 1, 3))
        )
    elif kind == "flattened":
        linear[:, 2] = linear[:, 1] * (1.0 + 1e-6 * rng.normal(size=(count, 1)))
    world = np.broadcast_to(np.eye(4), (count, 4, 4)).copy()
    world[:, :3, :3] = linear
    world[:, :3, 3] = origin + rng.normal(0.0, 3.0, (count, 3))
    projection = (
        Orthographic(float(rng.uniform(2.0, 8.0)), 16 / 9, 0.1, 50.0)
        if is_parallel
        else Perspective(float(rng.uniform(0.3, 1.5)), 16 / 9, near=0.1)
    )
    eye, target = origin + rng.normal(0.0, 4.0, (2, 3))
    camera = Camera.look_at(eye, target, projection=projection)
    mesh = rng.integers(0, 3, count).astype(np.int32)
    entries, _ = make_instance_sets(mesh, np.zeros(count, np.int32), None, MESHES.meshlet_begins, len(MESHES))
    return Case(camera, world, entries, rng.random(count) < 0.2)


KINDS = st.sampled_from(["uniform", "stretched", "skewed", "flattened"])


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 9999), st.booleans(), KINDS, st.sampled_from([0.0, 1e3, 1e6]))
def test_no_meshlet_that_is_seen_is_culled(seed: int, is_parallel: bool, kind: str, origin: float) -> None:
    case = make_case(seed, is_parallel, kind, origin)
    for entry, state in enumerate(case.cull().tolist()):
        if state == TURNED_AWAY:
            assert not case.faces_the_eye(entry)
            assert not case.two_sided[case.entries[entry]["object"]]
        elif state == OUTSIDE:
            assert not case.is_in_view(entry)
        else:
            assert state == VISIBLE, "visible in the last frame, and so at once"


@pytest.mark.parametrize("is_parallel", [False, True])
@pytest.mark.parametrize("kind", ["uniform", "stretched", "skewed"])
@pytest.mark.parametrize("origin", [0.0, 1e5])
def test_most_meshlets_that_are_unseen_are_culled(is_parallel: bool, kind: str, origin: float) -> None:
    counts: Counter[str] = Counter()
    for seed in range(6):
        case = make_case(seed, is_parallel, kind, origin)
        for entry, state in enumerate(case.cull().tolist()):
            if not case.is_in_view(entry):
                counts["out of view"] += 1
                counts["outside"] += state == OUTSIDE
            elif not case.two_sided[case.entries[entry]["object"]] and not case.faces_the_eye(entry):
                counts["backs"] += 1
                counts["turned away"] += state == TURNED_AWAY
    assert counts["outside"] + counts["turned away"] > 0.5 * (counts["out of view"] + counts["backs"]), counts
    assert counts["turned away"] > 0.3 * counts["backs"] > 5, counts


@pytest.mark.parametrize("is_mirrored", [False, True])
@pytest.mark.parametrize("is_parallel", [False, True])
@pytest.mark.parametrize("two_sided", [False, True])
def test_only_backs_of_one_sided_objects_are_turned_away(
    is_mirrored: bool, is_parallel: bool, two_sided: bool
) -> None:
    """Seen from one side, and then from the other, a meshlet is turned away once."""
    entries, _ = make_instance_sets(
        np.zeros(1, np.int32), np.zeros(1, np.int32), None, MESHES.meshlet_begins, len(MESHES)
    )
    world = np.diag([1.0, 1.0, -1.0 if is_mirrored else 1.0, 1.0])[None]
    states = []
    for y in (60.0, -60.0):
        projection = Orthographic(9.0, 1.0, 0.1, 99.0) if is_parallel else Perspective(0.5, 1.0, near=0.1)
        camera = Camera.look_at((0.0, y, 0.5 * y), (0.0, 0.0, 0.0), projection=projection)
        states.append(Case(camera, world, entries, np.array([two_sided])).cull() == TURNED_AWAY)
    assert not (states[0] & states[1]).any()
    share = (states[0] | states[1]).mean()
    assert share == 0.0 if two_sided else share > 0.5


def test_objects_outside_the_view_and_other_levels_are_not_used() -> None:
    case = make_case(1, False, "uniform", 0.0)
    control = case.cull()
    assert UNUSED not in control
    case.camera = Camera.look_at((0.0, 0.0, 900.0), (0.0, 0.0, 1000.0), projection=Perspective(0.9, 16 / 9))
    assert (case.cull() == OUTSIDE).all()


@given(st.integers(0, 999))
def test_there_is_an_entry_for_each_meshlet_or_level(seed: int) -> None:
    rng = np.random.default_rng(seed)
    levels, cuts = np.array([0, 2, 2, 5]), np.array([0, 0, 3, 7])
    meshes, groups = rng.integers(0, 3, 30).astype(np.int32), rng.integers(0, 2, 30).astype(np.int32)
    for level_begins in (levels, None):
        entries, begins = make_instance_sets(meshes, groups, level_begins, cuts, 8)
        expected = []
        for group in range(2):
            for mesh in range(3):
                rows = np.flatnonzero((groups == group) & (meshes == mesh)).tolist()
                parts = [] if cuts[mesh + 1] > cuts[mesh] else [mesh]
                parts += list(range(3 + levels[mesh], 3 + levels[mesh + 1])) if level_begins is levels else []
                parts += range(8 + cuts[mesh], 8 + cuts[mesh + 1])
                expected += [[(row, part) for row in rows] for part in parts if rows]
        listed = [entries[a:b].tolist() for a, b in pairwise(begins.tolist())]
        assert listed == expected


def make_row(
    meshlet_size: int = 32, levels: int = 0, *, has_two_sides: bool = False, side: int = 24
) -> Scene:
    """Make two rows of stretched, mirrored and turned bodies behind a wall with a window, that lead away."""
    builder = SceneBuilder("row")
    meshes = [
        builder.add_mesh(bumpy_sphere(side, 0.1), levels=levels, meshlet_size=meshlet_size),
        builder.add_mesh(BUILT_IN["torus"](), meshlet_size=meshlet_size),
        builder.add_mesh(BUILT_IN["box"]()),
    ]
    materials = [
        builder.add_material(base_color=(0.8, 0.3, 0.2)),
        builder.add_material(base_color=(0.2, 0.4, 0.8), double_sided=has_two_sides),
    ]
    for number in range(12):
        transform = translation((1.7 * (number % 2), 0.2 * (number % 3), -1.4 * number))
        transform[:3, :3] = np.diag([1.0, 1.0 if number % 3 else -0.7, 1.4])
        builder.add_objects(builder.add_node(transform), meshes[number % 2], materials[number % 2])
    for x in (-2.2, 4.0):
        wall = translation((x, 0.0, 1.5))
        wall[:3, :3] = np.diag([3.0, 6.0, 0.1])
        builder.add_objects(builder.add_node(wall), meshes[2], materials[0])
    builder.lights.add_directional((0.4, -1.0, -0.3))
    builder.lights.add_point((1.0, 2.0, -2.0), 9.0, (1.0, 0.9, 0.8), 9.0)
    return builder.build()


VIEWS: dict[str, tuple[tuple[float, ...], tuple[float, ...], Projection]] = {
    "along the rows": ((0.4, 1.0, 6.0), (0.6, 0.0, -20.0), Perspective(0.9, 16 / 9, near=0.1)),
    "from within a body": ((0.0, 0.1, 0.1), (1.0, 0.0, -30.0), Perspective(0.7, 16 / 9, near=0.05)),
    "from above": ((4.0, 7.0, 4.0), (0.5, 0.0, -8.0), Perspective(0.9, 16 / 9, near=0.1)),
    "parallel": ((4.0, 9.0, 6.0), (0.5, 0.0, -8.0), Orthographic(7.0, 16 / 9, 0.1, 90.0)),
}


def make_view(title: str) -> Camera:
    eye, target, projection = VIEWS[title]
    return Camera.look_at(eye, target, projection=projection)


class View:
    """A renderer whose lists the device makes, with meshlets or without."""

    def __init__(self, device: rhi.Device, scene: Scene, name: str, has_meshlets: bool, **more: Any) -> None:
        algorithm = make_visibility(name, scene, device, VisibilitySettings(meshlets=has_meshlets))
        assert isinstance(algorithm, DeviceCulling)
        self.algorithm = algorithm
        self.renderer = Renderer(device, scene, size=SIZE, visibility=algorithm, **more)

    def render(self, camera: Camera) -> np.ndarray:
        self.result = self.renderer.render(camera)
        image: np.ndarray = self.result.image.read()
        return image

    def count_states(self) -> Counter[int]:
        meshlets = self.algorithm.meshlets
        assert meshlets is not None
        assert meshlets.states is not None
        return Counter((meshlets.states.read() % WAS_VISIBLE).tolist())

    def destroy(self) -> None:
        self.renderer.destroy()
        self.algorithm.destroy()


def compare_images(device: rhi.Device, scene: Scene, name: str, **more: Any) -> Counter[int]:
    """Draw all views with meshlets and without, and return the states of all entries."""
    whole, cut = (View(device, scene, name, has_meshlets, **more) for has_meshlets in (False, True))
    states: Counter[int] = Counter()
    for title in VIEWS:
        for step in range(3):
            eye = make_view(title)
            camera = Camera(eye.position + np.array([0.15 * step, 0.0, 0.0]), eye.rotation, eye.projection)
            expected, image = whole.render(camera), cut.render(camera)
            assert (image == expected).all(), (title, step, int((image != expected).any(axis=-1).sum()))
            assert len(np.unique(image.reshape(-1, 4), axis=0)) > 20
            states += cut.count_states()
    whole.destroy()
    cut.destroy()
    return states


@pytest.mark.nightly_cases("cl*", reason=ONLY_KERNELS)
@pytest.mark.parametrize("name", ["two_pass", "depth_pyramid"])
def test_images_are_those_of_whole_meshes(device: rhi.Device, name: str) -> None:
    states = compare_images(device, make_row(), name, technique="forward")
    assert min(states[state] for state in (DRAWN, OUTSIDE, TURNED_AWAY, HIDDEN)) > 50, states


def make_random_bodies(rng: np.random.Generator, origin: float) -> Scene:
    """Make bodies in any position and of any stretch, whose triangles are large or smaller than pixels."""
    builder = SceneBuilder("random")
    side, size = int(rng.choice([16, 40, 100])), int(rng.choice([8, 32, 128]))
    meshes = [
        builder.add_mesh(bumpy_sphere(side, float(rng.uniform(0.0, 0.2))), meshlet_size=size),
        builder.add_mesh(BUILT_IN["torus"](), meshlet_size=32),
    ]
    materials = [builder.add_material(base_color=rng.uniform(0.1, 1.0, 3).tolist()) for _ in range(4)]
    for number in range(20):
        transform = translation(origin + rng.normal(0.0, 1.0, 3) * rng.choice([2.0, 8.0, 30.0]))
        transform[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0] * np.exp(rng.normal(0.0, 0.5, 3))
        builder.add_objects(builder.add_node(transform), meshes[number % 2], materials[number % 4])
    builder.lights.add_directional((0.4, -1.0, -0.3))
    return builder.build()


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("name", ["two_pass", "depth_pyramid"])
def test_images_of_random_bodies_are_those_of_whole_meshes(gl: rhi.Device, name: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    origin = 1e4 * (seed % 3 == 0)
    scene = make_random_bodies(rng, origin)
    whole, cut = (View(gl, scene, name, has_meshlets, technique="forward") for has_meshlets in (False, True))
    projection = Orthographic(12.0, 16 / 9, 0.1, 200.0) if seed % 4 == 0 else Perspective(0.9, 16 / 9)
    eye, target = origin + rng.normal(0.0, 6.0, 3), origin + rng.normal(0.0, 3.0, 3)
    for step in range(4):
        camera = Camera.look_at(eye + 0.3 * step * rng.normal(0.0, 1.0, 3), target, projection=projection)
        assert (whole.render(camera) == cut.render(camera)).all()
    assert cut.count_states()[DRAWN] > 0
    whole.destroy()
    cut.destroy()


@pytest.mark.parametrize("technique", [name for name in TECHNIQUES if name != "auto"])
def test_techniques_draw_the_same_with_meshlets(gl: rhi.Device, technique: str) -> None:
    assert compare_images(gl, make_row(), "depth_pyramid", technique=technique)[TURNED_AWAY] > 50


@pytest.mark.parametrize("technique", [ForwardPlus, TiledDeferred])
def test_several_samples_are_of_whole_meshes(
    gl: rhi.Device, technique: type[ForwardPlus | TiledDeferred]
) -> None:
    """A surface that is hidden at a pixel's centre may be seen beside it."""
    whole, cut = (
        View(gl, make_row(), "two_pass", has, technique=technique(samples=4)) for has in (False, True)
    )
    for title in VIEWS:
        for step in range(3):
            eye = make_view(title)
            camera = Camera(eye.position + np.array([0.15 * step, 0.0, 0.0]), eye.rotation, eye.projection)
            assert (whole.render(camera) == cut.render(camera)).all()
    meshlets = cut.algorithm.meshlets
    assert meshlets is not None
    assert meshlets.states is None
    whole.destroy()
    cut.destroy()


def test_meshes_that_are_uploaded_by_later_frames_are_culled(gl: rhi.Device) -> None:
    images = []
    for has_meshlets in (False, True):
        settings, scene = UploadSettings(bytes_per_frame=262_144), make_row(side=160)
        view = View(gl, scene, "two_pass", has_meshlets, technique="forward", uploads=settings)
        images.append([view.render(make_view("from above")) for _ in range(8)])
        view.destroy()
    assert all((whole == cut).all() for whole, cut in zip(*images, strict=True))
    assert (images[0][0] != images[0][-1]).any(), "meshes came later"


def test_two_sides_are_never_turned_away(gl: rhi.Device) -> None:
    single, double = (
        compare_images(gl, make_row(has_two_sides=two), "two_pass", technique="forward")
        for two in (False, True)
    )
    assert 0 < double[TURNED_AWAY] < single[TURNED_AWAY]


@pytest.mark.parametrize("name", ["two_pass", "depth_pyramid"])
def test_levels_of_detail_take_the_place_of_meshlets(gl: rhi.Device, name: str) -> None:
    scene = make_row(levels=4)
    camera = make_view("from above")
    view = View(gl, scene, name, True, technique="forward")
    counts = []
    for view.renderer.detail_error in (0.0, 3.0, 50.0):
        for _ in range(3):
            view.render(camera)
        counts.append(view.count_states()[UNUSED])
    image = view.result.image.read()[..., :3].astype(int)
    view.destroy()
    with Renderer(gl, scene, size=SIZE, visibility="frustum", technique="forward") as renderer:
        renderer.detail_error = 50.0
        expected = renderer.render(camera).image.read()[..., :3].astype(int)
    assert np.abs(image - expected).max() <= 1
    assert counts[0] < counts[1] < counts[2]


def test_both_eyes_see_whole_meshes(gl: rhi.Device) -> None:
    images = []
    for has_meshlets in (False, True):
        view = View(gl, make_row(), "depth_pyramid", has_meshlets, technique="forward")
        view.renderer.stereo = Stereo(StereoRig(1.5, 5.0))
        for _ in range(2):
            view.render(make_view("from above"))
        images.append([frame.image.read() for frame in view.result.frames])
        view.destroy()
    assert all((first == second).all() for first, second in zip(*images, strict=True))
    assert (images[0][0] != images[0][1]).any()


def test_visible_objects_are_named_once(gl: rhi.Device) -> None:
    whole, cut = (View(gl, make_row(), "depth_pyramid", has) for has in (False, True))
    for view in (whole, cut):
        for title in ("along the rows", "from above"):
            view.render(make_view(title))
    visible = cut.result.visible.tolist()
    assert len(visible) == len(set(visible))
    assert set(visible) <= set(whole.result.visible.tolist())
    whole.destroy()
    cut.destroy()


def test_edits_renew_the_meshlets(gl: rhi.Device) -> None:
    scenes = [make_row() for _ in range(2)]
    views = [View(gl, scene, "two_pass", bool(number)) for number, scene in enumerate(scenes)]
    camera = make_view("from above")
    images = []
    for step in range(4):
        for scene in scenes:
            if step == 1:
                scene.nodes.hide(scene.objects.node[:4])
            if step == 2:
                scene.materials["double_sided"][:] = 1
            if step == 3:
                scene.nodes.show(scene.objects.node[:4])
                scene.objects.mesh[3] = 0
        pair = [view.render(camera) for view in views]
        assert (pair[0] == pair[1]).all(), step
        images.append(pair[0])
    assert all((images[0] != image).any() for image in images[1:])
    for view in views:
        view.destroy()


SHADERS = {
    "two_pass": ("CullMeshlets", "CountMeshlets", "PickMeshlets", "ShowMeshlets"),
    "depth_pyramid": ("CullMeshlets", "CountMeshlets", "CompareMeshlets"),
}


def make_pattern(name: str) -> EffectPattern:
    """Return the pattern that recognises an algorithm's commands of meshlets."""
    resources = ("meshlets", "meshlet boxes", "meshlet states")
    return EffectPattern(
        "meshlets",
        programs=SHADERS[name],
        bindings=("meshlets", "states"),
        resources=resources + (("seen meshlets",) if name == "two_pass" else ()),
        events=("cull meshlets",),
    )


MORE = {
    "two_pass": {Op.DISPATCH: 3, Op.DRAW: 1},
    "depth_pyramid": {Op.DISPATCH: 2},
}
"""The commands that meshlets add to a frame: their boxes are computed, and tested."""


@pytest.mark.parametrize("name", ["two_pass", "depth_pyramid"])
def test_scenes_without_meshlets_have_no_command_of_them(name: str) -> None:
    with rhi.create_device("null") as without, rhi.create_device("null") as cut:
        for device, size in ((without, 0), (cut, 32)):
            view = View(device, make_row(size), name, True, technique="forward")
            for _ in range(3):
                view.render(make_view("from above"))
            view.destroy()
        assert_free(make_pattern(name), without, control=cut)
        ops = Op.DISPATCH, Op.DRAW, Op.DRAW_INDIRECT
        counts = [
            Counter(command.op for command in frames(device)[-1] if command.op in ops)
            for device in (without, cut)
        ]
    assert counts[1] - counts[0] == MORE[name]
    assert not counts[0] - counts[1]


def test_meshlets_that_are_not_wanted_or_not_shown_cost_nothing(null: rhi.Device) -> None:
    scene = make_row()
    is_cut = scene.objects.mesh != 2
    counts = {}
    for has_meshlets in (False, True):
        view = View(null, scene, "two_pass", has_meshlets, technique="forward")
        for is_shown in (True, False):
            (scene.nodes.show if is_shown else scene.nodes.hide)(scene.objects.node[is_cut])
            for _ in range(2):
                null.stream.clear()
                view.render(make_view("from above"))
            counts[has_meshlets, is_shown] = len(null.stream.filter(Op.DISPATCH))
        scene.nodes.show(scene.objects.node[is_cut])
        view.destroy()
    assert counts[True, True] == counts[False, True] + 3
    assert counts[True, False] == counts[False, False] == counts[False, True]


def test_boxes_of_meshlets_take_their_bytes(null: rhi.Device) -> None:
    scene = make_row()
    view = View(null, scene, "depth_pyramid", True)
    view.render(make_view("from above"))
    meshlets = view.algorithm.meshlets
    assert meshlets is not None
    assert meshlets.boxes is not None
    assert meshlets.states is not None
    counts = np.diff(scene.meshes.meshlet_begins)[scene.objects.mesh]
    entries = int(np.where(counts > 0, counts, 1).sum())
    assert meshlets.boxes.count == meshlets.states.count == entries
    assert view.algorithm.first.objects.count == entries
    assert Occludee.dtype.itemsize == 64
    view.destroy()
