"""Instances out of view are culled by the box of their vertices' attributes, without a visible difference."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from nightly_reasons import CHEAPER_TEST
from numpy.typing import NDArray

import rhi
import rhi.shading as sl
from rhi.backends.cl.cl_backend import ClBackend
from rhi.backends.cl.raster import boxes, draw_tables
from rhi.backends.cl.raster.kernel_structs import GROUP

SIZE = (96, 64)
VERTICES = 6 * GROUP
DRAWS = 40
IDENTITY = np.eye(4, dtype=np.float32)


class Vertex(sl.Struct):
    position: sl.vec3
    color: sl.vec3


class View(sl.Struct):
    matrix: sl.mat4


class Thing(sl.Struct):
    matrix: sl.mat4


class Surface(sl.Struct):
    clip: sl.vec4
    color: sl.vec3


class InstancedThings(sl.Shader):
    view: sl.Uniform[View]
    things: sl.Storage[Thing]

    def vertex(self, v: Vertex) -> Surface:
        position = self.things[sl.instance_index()].matrix @ sl.vec4(v.position, 1.0)
        return Surface(clip=self.view.matrix @ position, color=v.color)

    def fragment(self, v: Surface) -> sl.vec4:
        return sl.vec4(v.color, 1.0)


class Bent(InstancedThings):
    """A vertex stage that isn't affine."""

    def vertex(self, v: Vertex) -> Surface:
        position = self.things[sl.instance_index()].matrix @ sl.vec4(v.position, 1.0)
        return Surface(
            clip=self.view.matrix @ (position + sl.vec4(v.color.x * v.position.x * 0.0)), color=v.color
        )


class Offset(sl.Struct):
    offset: sl.vec2


class Shifted(sl.Shader):
    """A vertex stage that adds an attribute of the instance, which isn't measured."""

    def vertex(self, v: Vertex, i: Offset) -> Surface:
        return Surface(clip=sl.vec4(v.position + sl.vec3(i.offset, 0.0), 1.0), color=v.color)

    def fragment(self, v: Surface) -> sl.vec4:
        return sl.vec4(v.color, 1.0)


@pytest.fixture
def bounding_device(optimised_kernels: None) -> Iterator[rhi.Device]:
    """A device whose kernels keep bounds of depth."""
    with rhi.create_device("cl") as created:
        yield created


def triangles(seed: int = 0, count: int = VERTICES) -> NDArray[Any]:
    """Return random triangles within ±1/2 on all axes, in random colors."""
    rng = np.random.default_rng(seed)
    rows = np.zeros(count, Vertex.dtype)
    rows["position"] = rng.uniform(-0.5, 0.5, (count, 3))
    rows["color"] = rng.random((count, 3))
    return rows


def rectangle() -> NDArray[Any]:
    """Return a rectangle that covers the view at z = 0."""
    rows = triangles(count=6)
    rows["position"] = [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, -1, 0), (1, 1, 0), (-1, 1, 0)]
    return rows


def translate(x: float, y: float, z: float) -> NDArray[np.float32]:
    matrix = IDENTITY.copy()
    matrix[:3, 3] = x, y, z
    return matrix


class MeshScene:
    """Meshes that are drawn frame by frame, each frame as one batch."""

    def __init__(
        self, device: rhi.Device, shader: type[InstancedThings], matrices: Any, view: Any = IDENTITY
    ) -> None:
        self.device, self.program = device, device.program(shader)
        things = np.zeros(len(matrices), device.storage(Thing, 1).dtype)
        things["matrix"] = np.asarray(matrices, np.float32)
        self.bindings = {
            "things": device.storage(Thing, things),
            "view": device.uniform(View(matrix=np.asarray(view))),
        }
        self.color, self.depth = device.texture(SIZE, rhi.Format.RGBA8), device.texture(SIZE, rhi.Format.D32F)

    def frame(self, meshes: list[rhi.Mesh], *states: Any, clears: bool = True) -> list[NDArray[Any]]:
        """Draw each mesh once; return color and depth."""
        return self.run(
            lambda: [self.device.draw(self.program, mesh, **self.bindings) for mesh in meshes],
            *states,
            clears=clears,
        )

    def run(self, draw: Callable[[], object], *states: Any, clears: bool = True) -> list[NDArray[Any]]:
        clear: dict[str, Any] = {"clear": (0, 0, 0, 0), "clear_depth": 1.0} if clears else {}
        with (
            self.device.render_pass(self.color, self.depth, **clear),
            self.device.states(
                rhi.CullMode.NONE, rhi.DepthTest.ON, rhi.DepthWrite.ON, rhi.DepthFunction.LESS
            ),
            self.device.states(rhi.Viewport(0, 0, *SIZE), *states),
        ):
            draw()
        return [self.color.read(), self.depth.read()]

    def destroy(self) -> None:
        for resource in (*self.bindings.values(), self.color, self.depth):
            resource.destroy()


def assert_same(images: list[NDArray[Any]], expected: list[NDArray[Any]]) -> None:
    for a, b in zip(images, expected, strict=True):
        np.testing.assert_array_equal(a.view(np.uint8), b.view(np.uint8))


def count_dropped(device: rhi.Device) -> int:
    """Return the number of instances of the last piece that were culled before they were transformed, if none has more
    than a chunk of vertices. Their extents are marked as lying behind all planes."""
    backend = device.backend_as(ClBackend)
    memory, state = (
        backend._rasteriser._launcher._scratch.pools["extents"]._memory,
        backend._rasteriser._batch.state,
    )
    assert state is not None
    backend.context.queue.finish()
    words = memory.view(np.int32)[: 8 * int(state.table["vertex_groups"])].reshape(-1, 8)
    return int((words[:, 7] == -1).sum())


def clean(device: rhi.Device) -> None:
    """Clear the extents that earlier batches left in memory."""
    backend = device.backend_as(ClBackend)
    pool = backend._rasteriser._launcher._scratch.pools["extents"]
    pool.reserve(32 * 64)
    backend.context.queue.finish()
    pool._memory[:] = 0


ASIDE = translate(3.0, 0.0, 0.5)
INSIDE = translate(0.0, 0.0, 0.5)


def parts(mesh: rhi.Mesh, count: int) -> list[rhi.Mesh]:
    """Return views of a mesh, one for each instance's transform."""
    return [mesh.view(base_instance=i) for i in range(count)]


# -- what is dropped -----------------------------------------------------------------------------------------


def test_a_draw_out_of_view_is_dropped_from_its_third_time_on(
    device: rhi.Device, launches: list[str]
) -> None:
    """At its second draw a box is measured and used at once; at the first it isn't known."""
    stage = MeshScene(device, InstancedThings, [INSIDE, ASIDE])
    with device.mesh(triangles()) as mesh:
        meshes, dropped, measured, frames = parts(mesh, 2), [], [], []
        for _ in range(3):
            clean(device)
            frames.append(stage.frame(meshes))
            dropped.append(count_dropped(device))
            measured.append(launches.count("measure"))
    assert dropped == [0, 1, 1]
    assert measured == [0, 1, 1]
    assert frames[0][0].any()
    assert_same(frames[1], frames[0])
    assert_same(frames[2], frames[0])


@pytest.mark.parametrize(
    ("transform", "dropped"),
    [
        (translate(-2.0, 0.0, 0.5), True),
        (translate(0.0, 2.0, 0.5), True),
        (translate(0.0, -2.0, 0.5), True),
        (translate(0.0, 0.0, -1.0), True),
        (translate(0.0, 0.0, 2.0), True),
        (translate(1.2, 0.0, 0.5), False),
        (translate(0.0, 0.0, -0.2), False),
        (10.0 * IDENTITY, False),
        (np.full((4, 4), np.nan), False),
        (np.full((4, 4), np.inf), False),
        (1.7e38 * translate(2.0, 0.0, 0.0), False),
    ],
)
def test_instances_beyond_a_plane_of_the_view_are_dropped(
    device: rhi.Device, transform: Any, dropped: bool
) -> None:
    """Nothing else is culled, nor anything with numbers that overflow or aren't finite."""
    stage = MeshScene(device, InstancedThings, [INSIDE, transform])
    with device.mesh(triangles()) as mesh:
        meshes = parts(mesh, 2)
        for _ in range(3):
            clean(device)
            stage.frame(meshes)
        assert count_dropped(device) == dropped


@pytest.mark.nightly_cases("DepthFunction.GREATER", reason=CHEAPER_TEST)
@pytest.mark.parametrize("nearer", [rhi.DepthFunction.LESS, rhi.DepthFunction.GREATER])
def test_instances_behind_a_wall_are_dropped(bounding_device: rhi.Device, nearer: rhi.DepthFunction) -> None:
    """Bounds of depth that an earlier batch left cull instances, but not those that reach through, nor with a
    bias."""
    device, flat = bounding_device, np.diag([1.0, 1.0, 0.2, 1.0])
    depths = [0.8, 0.5, 0.2] if nearer is rhi.DepthFunction.LESS else [0.2, 0.5, 0.8]
    behind, through, before = (translate(0.0, 0.0, depth) @ flat for depth in depths)
    stage = MeshScene(device, InstancedThings, [translate(0.0, 0.0, 0.5), behind, through, before])

    def draw(meshes: list[rhi.Mesh], *states: Any) -> list[NDArray[Any]]:
        stage.frame([front, front], rhi.DepthFunction.ALWAYS)
        stage.frame([front, front], nearer, clears=False)
        clean(device)
        return stage.frame(meshes, nearer, *states, clears=False)

    with device.mesh(rectangle()) as front, device.mesh(triangles()) as mesh:
        meshes = [mesh.view(base_instance=i) for i in range(1, 4)]
        frames = [draw(meshes) for _ in range(3)]
        assert count_dropped(device) == 1
        assert_same(frames[2], frames[0])
        draw(meshes, rhi.DepthBias(1))
        assert count_dropped(device) == 0


@pytest.mark.parametrize("count", [3 * GROUP, VERTICES])
def test_draws_of_few_vertices_have_no_box(device: rhi.Device, launches: list[str], count: int) -> None:
    stage = MeshScene(device, InstancedThings, [INSIDE, ASIDE])
    with device.mesh(triangles(count=count)) as mesh:
        meshes = parts(mesh, 2)
        for _ in range(3):
            stage.frame(meshes)
    assert launches.count("measure") == (count == VERTICES)


def test_positions_that_are_not_affine_have_no_box(device: rhi.Device, launches: list[str]) -> None:
    stage = MeshScene(device, Bent, [INSIDE, ASIDE])
    with device.mesh(triangles()) as mesh:
        meshes = parts(mesh, 2)
        for _ in range(3):
            clean(device)
            stage.frame(meshes)
    assert "measure" not in launches
    assert count_dropped(device) == 0


def test_instances_have_boxes_of_their_own(device: rhi.Device) -> None:
    stage = MeshScene(device, InstancedThings, [INSIDE, ASIDE, INSIDE, ASIDE, ASIDE])
    with device.mesh(triangles()) as mesh:
        things = mesh.draws(0, VERTICES, instances=[2, 3], base_instance=[0, 2])
        for _ in range(3):
            clean(device)
            stage.run(lambda: device.draw_many(stage.program, mesh, things, **stage.bindings))
        assert count_dropped(device) == 3


def test_a_draw_without_instances_has_no_box(device: rhi.Device, launches: list[str]) -> None:
    """A draw without instances launches nothing. With instances it uses the same prepared draw."""
    stage = MeshScene(device, InstancedThings, [INSIDE, ASIDE])
    with device.mesh(triangles()) as mesh:
        for instances in (0, 1):
            things = mesh.draws(0, VERTICES, instances=instances, base_instance=[0, 1])
            draw = partial(device.draw_many, stage.program, mesh, things, **stage.bindings)
            frames = []
            for _ in range(3):
                clean(device)
                frames.append(stage.run(draw))
                assert_same(frames[-1], frames[0])
            assert launches.count("measure") == instances
            assert frames[0][0].any() == bool(instances)
        assert count_dropped(device) == 1


def test_offsets_of_instances_are_not_part_of_a_box(device: rhi.Device) -> None:
    offsets = np.zeros(4, Offset.dtype)
    offsets["offset"] = [(0, 0), (3, 0), (0, -4), (0.5, 0)]
    program = device.program(Shifted)
    stage = MeshScene(device, InstancedThings, [INSIDE])
    with device.mesh(triangles(), instances=offsets) as mesh:
        things = mesh.draws(0, VERTICES, instances=[2, 2], base_instance=[0, 2])
        frames = []
        for _ in range(3):
            clean(device)
            frames.append(stage.run(lambda: device.draw_many(program, mesh, things)))
        assert count_dropped(device) == 2
        assert_same(frames[2], frames[0])


# -- what makes a box out of date ----------------------------------------------------------------------------


def write(device: rhi.Device, mesh: rhi.Mesh, rows: NDArray[Any]) -> None:
    mesh.data.vertices.write(rows)


def copy(device: rhi.Device, mesh: rhi.Mesh, rows: NDArray[Any]) -> None:
    with device.mesh(rows) as other:
        other.data.vertices.copy_to(mesh.data.vertices)


@pytest.mark.parametrize("change", [write, copy])
def test_vertices_that_come_into_view_are_seen(
    device: rhi.Device, launches: list[str], change: Callable[[rhi.Device, rhi.Mesh, NDArray[Any]], None]
) -> None:
    stage = MeshScene(device, InstancedThings, [INSIDE, INSIDE])
    rows = triangles()
    away = rows.copy()
    away["position"][:, 0] += 3.0
    with device.mesh(away) as mesh:
        meshes = parts(mesh, 2)
        for _ in range(3):
            clean(device)
            empty = stage.frame(meshes)
        assert not empty[0].any()
        assert count_dropped(device) == 2
        change(device, mesh, rows)
        for turn in range(3):
            assert stage.frame(meshes)[0].any()
            assert launches.count("measure") == 1 + (turn > 0)


def test_other_indices_name_other_vertices(device: rhi.Device) -> None:
    stage = MeshScene(device, InstancedThings, [INSIDE, INSIDE])
    rows = np.concatenate([triangles(), triangles()])
    rows["position"][:VERTICES, 0] += 3.0
    with device.mesh(rows, np.arange(VERTICES, dtype="u4")) as mesh:
        meshes = parts(mesh, 2)
        for _ in range(3):
            clean(device)
            assert not stage.frame(meshes)[0].any()
        assert count_dropped(device) == 2
        assert mesh.data.index_buffer is not None
        mesh.data.index_buffer.write(np.arange(VERTICES, 2 * VERTICES, dtype="u4"))
        for _ in range(3):
            assert stage.frame(meshes)[0].any()


def test_boxes_outlive_a_table_that_grows(device: rhi.Device) -> None:
    """Boxes are measured again at the new address."""
    stage = MeshScene(device, InstancedThings, [INSIDE, ASIDE])
    with device.mesh(triangles()) as mesh:
        meshes = parts(mesh, 2)
        for _ in range(3):
            first = stage.frame(meshes)
        table = device.backend_as(ClBackend)._rasteriser._prepared
        views = [mesh.view(first=i % 2, base_instance=i % 2) for i in range(len(table.draws))]
        for _ in range(2):
            stage.frame(views)
        for _ in range(3):
            clean(device)
            assert_same(stage.frame(meshes), first)
        assert count_dropped(device) == 1


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf])
def test_a_vertex_that_is_nowhere_leaves_the_others_in_view(device: rhi.Device, wrong: float) -> None:
    stage = MeshScene(device, InstancedThings, [INSIDE, ASIDE])
    rows = triangles()
    with device.mesh(rows) as mesh:
        meshes = parts(mesh, 2)
        rows["position"][VERTICES - 2, 1] = wrong
        mesh.data.vertices.write(rows)
        frames = [stage.frame(meshes) for _ in range(2)]
        clean(device)
        frames.append(stage.frame(meshes))
        assert count_dropped(device) == 0
    assert frames[0][0].any()
    assert_same(frames[1], frames[0])
    assert_same(frames[2], frames[0])


# -- that nothing shows of it --------------------------------------------------------------------------------


@st.composite
def scenes(draw: st.DrawFn) -> tuple[int, dict[str, Any]]:
    """A seed, and the kind of numbers in the scene."""
    return draw(st.integers(0, 2**32 - 1)), {
        "size": draw(st.sampled_from([0.0, 1e-3, 0.1, 0.3, 1.0, 4.0])),
        "thickness": draw(st.sampled_from([1.0, 0.3, 0.01])),
        "reach": draw(st.sampled_from([0.5, 1.0, 1.3, 1.5, 2.0, 30.0, 1e4, 1e30])),
        "perspective": draw(st.booleans()),
        "wall": draw(st.sampled_from([None, 0.0, 0.3, 0.5, 0.7, 0.99])),
        "indexed": draw(st.sampled_from([None, "u2", "u4"])),
        "primitive": draw(
            st.sampled_from(
                [
                    rhi.Primitive.TRIANGLES,
                    rhi.Primitive.TRIANGLES,
                    rhi.Primitive.TRIANGLES,
                    rhi.Primitive.TRIANGLE_STRIP,
                    rhi.Primitive.TRIANGLE_FAN,
                    rhi.Primitive.LINES,
                    rhi.Primitive.LINE_STRIP,
                    rhi.Primitive.POINTS,
                ]
            )
        ),
        "slope": draw(st.sampled_from([0.0, 0.0, 1.0])),
        "reversed": draw(st.booleans()),
    }


def project(eye: NDArray[Any], near: float) -> NDArray[Any]:
    """Return a perspective along +z from a point, with depth 0 at the near plane and 1 at infinity."""
    view = np.zeros((4, 4))
    view[0, 0], view[1, 1] = 1.2, 1.8
    view[2] = 0, 0, 1, -near
    view[3] = 0, 0, 1, 0
    return view @ translate(*-eye)


def scatter(rng: np.random.Generator, kind: dict[str, Any]) -> list[NDArray[Any]]:
    """Return random transforms: rotated, mirrored, sometimes one with a number that overflows or isn't
    finite."""
    matrices = []
    for _ in range(64):
        scale = kind["size"] * rng.choice([-1, 1], 3) * rng.uniform(0.1, 2.0, 3)
        turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        matrix = np.eye(4)
        matrix[:3, :3] = turn * scale
        matrix[2] *= kind["thickness"]
        matrix[:3, 3] = rng.uniform(-1, 1, 3) * kind["reach"]
        if not kind["perspective"]:
            matrix[2, 3] = rng.uniform(0.1, 0.9)
        matrices.append(matrix)
    if rng.random() < 0.1:
        matrices[3][rng.integers(4), rng.integers(4)] = rng.choice([np.nan, np.inf, 3e38])
    return matrices


@pytest.fixture
def allow_boxes(monkeypatch: pytest.MonkeyPatch) -> Callable[[bool], None]:
    monkeypatch.setattr(draw_tables, "_FIRST_PIECE_GROUPS", 100)  # later pieces know what earlier ones hide
    monkeypatch.setattr(draw_tables, "_PIECE_GROUPS", 200)
    return lambda allowed: monkeypatch.setattr(boxes, "_MIN_GROUPS", 1 if allowed else 1 << 30)


@settings(deadline=None, max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(scene=scenes())
def test_frames_are_the_same_with_and_without_boxes(
    device: rhi.Device, allow_boxes: Callable[[bool], None], scene: tuple[int, dict[str, Any]]
) -> None:
    """Color, depth and counts are the same bits while boxes are unknown, measured and known."""
    seed, kind = scene
    rng = np.random.default_rng(seed)
    rows = triangles(seed, 400)
    if rng.random() < 0.1:
        rows["position"] *= rng.choice([1.0, 1e-20, 1e20, 0.0], 3)
    eye = rng.uniform(-1, 1, 3) * min(kind["reach"], 100.0)
    stage = MeshScene(
        device, InstancedThings, scatter(rng, kind), project(eye, 0.1) if kind["perspective"] else IDENTITY
    )
    count, indices = 400, None
    if kind["indexed"] is not None:
        count, indices = 600, rng.integers(0, 300, 600).astype(kind["indexed"])
    nearer = rhi.DepthFunction.GREATER if kind["reversed"] else rhi.DepthFunction.LESS
    states = (
        rhi.PolygonOffset(kind["slope"]),
        rhi.Viewport(*(3, 5, 80, 50) if rng.random() < 0.3 else (0, 0, *SIZE)),
        nearer,
    )
    wall = MeshScene(
        device, InstancedThings, [translate(0.0, 0.0, kind["wall"] or 0.0) @ np.diag([2.0, 2.0, 0.0, 1.0])]
    )
    queries = device.query_set(DRAWS)
    frames: list[list[NDArray[Any]]] = []
    with device.mesh(rows, indices, primitive=kind["primitive"]) as mesh, device.mesh(rectangle()) as front:
        parts = mesh.draws(
            rng.integers(0, count // 2, DRAWS),
            rng.choice([0, 1, 20, 80, count // 2], DRAWS),
            instances=rng.integers(0, 4, DRAWS),
            base_vertex=rng.integers(0, 100, DRAWS) * (indices is not None),
            base_instance=rng.integers(0, 60, DRAWS),
        )
        far = 0.0 if kind["reversed"] else 1.0
        for allowed in (False, True, True, True):
            allow_boxes(allowed)
            with (
                device.render_pass(stage.color, stage.depth, clear=(0, 0, 0, 0), clear_depth=far),
                device.states(rhi.CullMode.NONE, rhi.DepthTest.ON, rhi.DepthWrite.ON, *states),
            ):
                if kind["wall"] is not None:
                    device.draw(wall.program, front, **wall.bindings)
                    device.draw(wall.program, front, **wall.bindings)
                device.draw_many(stage.program, mesh, parts, **stage.bindings)
            with (
                device.render_pass(depth=stage.depth),
                device.states(rhi.CullMode.NONE, rhi.DepthWrite.OFF, *states),
            ):
                device.draw_counted(stage.program, mesh, parts, queries, **stage.bindings)
            frames.append([stage.color.read(), stage.depth.read(), np.asarray(queries.wait())])
    for frame in frames[1:]:
        assert_same(frame, frames[0])
    for buffer in (queries, stage, wall):
        buffer.destroy()
