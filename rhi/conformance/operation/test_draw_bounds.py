"""Draws that name what doesn't exist: what the CPU knows is refused, the rest reads within the buffers.

A point of each vertex, or of each instance, shows its own number. Buffers beside the mesh hold other numbers,
so a draw that reads beyond its buffers shows them, or ends the process. Which of the mesh's numbers it shows
instead, or none, is the platform's choice (as in WebGPU's robust buffer access).
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import rhi.shading as sl
from rhi import Buffer, Device, Format, IndirectDraws, Mesh, Primitive, ShaderError
from rhi.conformance.compare import assert_same
from rhi.conformance.shaders import Bare
from rhi.conformance.shapes import centers
from rhi.conformance.validation.refusal import refuses
from rhi.errors.rules import MESH_RANGE

pytestmark = [pytest.mark.requires("draws", "shading"), pytest.mark.recorded_too]

COUNT = 8
SIZE = (COUNT, 1)
OWN = np.arange(1.0, COUNT + 1)
FOREIGN = 77.0
FAR = [COUNT, 1000, 1 << 20, (1 << 31) - 1, 1 << 31, (1 << 32) - 2]
"""Numbers of vertices, instances or indices beyond a mesh, just beyond it and as far as 32 bits reach."""


class Vertex(sl.Struct):
    position: sl.vec2
    shade: float


class ShadeVarying(sl.Struct):
    clip: sl.vec4
    shade: sl.Flat[float]


class Numbered(sl.Shader):
    """Points that show their own number, in whichever stream it lies."""

    def vertex(self, v: Vertex) -> ShadeVarying:
        return ShadeVarying(clip=sl.vec4(v.position, 0.5, 1.0), shade=v.shade)

    def fragment(self, v: ShadeVarying) -> float:
        return v.shade


class Position(sl.Struct):
    position: sl.vec2


class Counted(sl.Shader):
    """Points at their vertex, that show how many instances were drawn; no data of instances is read."""

    def vertex(self, v: Position) -> ShadeVarying:
        return ShadeVarying(clip=sl.vec4(v.position, 0.5, 1.0), shade=float(sl.instance_index() + 1))

    def fragment(self, v: ShadeVarying) -> float:
        return v.shade


def make_vertices(shade: Any) -> NDArray[Any]:
    vertices = np.zeros(COUNT, Vertex.dtype)
    vertices["position"], vertices["shade"] = centers([(i, 0) for i in range(COUNT)], SIZE), shade
    return vertices


@pytest.fixture
def guarded(device: Device) -> Iterator[list[Buffer]]:
    """Buffers of foreign numbers, created before and after what a test creates."""
    buffers = [device.buffer(np.repeat(make_vertices(FOREIGN), 512)) for _ in range(4)]
    yield buffers
    for buffer in buffers:
        buffer.destroy()


@pytest.fixture
def indexed(device: Device, guarded: list[Buffer]) -> Iterator[Mesh]:
    with device.mesh(
        make_vertices(OWN), np.arange(COUNT, dtype=np.uint32), primitive=Primitive.POINTS
    ) as mesh:
        guarded.append(device.buffer(np.repeat(make_vertices(FOREIGN), 512)))
        yield mesh


@pytest.fixture
def plain(device: Device, guarded: list[Buffer]) -> Iterator[Mesh]:
    with device.mesh(make_vertices(OWN), primitive=Primitive.POINTS) as mesh:
        guarded.append(device.buffer(np.repeat(make_vertices(FOREIGN), 512)))
        yield mesh


@pytest.fixture
def instanced(device: Device, guarded: list[Buffer]) -> Iterator[Mesh]:
    """One point; its place and number are those of 8 instances."""
    vertices = {"unused": np.zeros((1, 2), np.float32)}
    indices = np.zeros(1, np.uint32)
    with device.mesh(vertices, indices, instances=make_vertices(OWN), primitive=Primitive.POINTS) as mesh:
        guarded.append(device.buffer(np.repeat(make_vertices(FOREIGN), 512)))
        yield mesh


def show(device: Device, draw: Any) -> NDArray[Any]:
    """Return the row of numbers that a draw shows, 0 where nothing is drawn."""
    with device.texture(SIZE, Format.R32F) as image:
        with device.render_pass(image, clear=(0, 0, 0, 0)):
            draw()
        return np.asarray(image.read()[0])


def assert_own(device: Device, mesh: Mesh, draw: Any) -> None:
    """Assert that a draw shows nothing but numbers of the mesh, and that the next one is right."""
    image = show(device, draw)
    assert np.isin(image, [0.0, *OWN]).all(), image
    assert_same(
        show(device, lambda: device.draw(device.program(Numbered), mesh.view(0, 1))), OWN * (OWN == 1)
    )


# -- refused -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("base", [COUNT, COUNT + 1, 1 << 29])
def test_a_base_vertex_beyond_the_vertices_is_refused(device: Device, indexed: Mesh, base: int) -> None:
    program = device.program(Numbered)
    with refuses(MESH_RANGE):
        indexed.view(0, 1, base_vertex=base)
    with refuses(MESH_RANGE):
        indexed.draws(0, 1, base_vertex=[0, base])
    draws = indexed.draws(0, 1, base_vertex=[0, COUNT - 1])
    with device.texture(SIZE, Format.R32F) as image, device.render_pass(image, clear=(0, 0, 0, 0)):
        device.draw_many(program, indexed, draws)
        draws["base_vertex"][1] = base
        with refuses(MESH_RANGE):
            device.draw_many(program, indexed, draws)


def test_the_last_vertex_is_a_base_vertex(device: Device, indexed: Mesh) -> None:
    view = indexed.view(0, 1, base_vertex=COUNT - 1)
    assert_same(show(device, lambda: device.draw(device.program(Numbered), view)), OWN * (OWN == COUNT))


@pytest.mark.parametrize(
    ("base", "instances"), [(0, COUNT + 1), (1, COUNT), (COUNT, 1), (COUNT + 1, 1), (0, 1 << 30)]
)
def test_instances_beyond_their_data_are_refused(
    device: Device, instanced: Mesh, base: int, instances: int
) -> None:
    program, view = device.program(Numbered), instanced.view(base_instance=base)
    draws = instanced.draws(0, 1, instances=[1, instances], base_instance=[0, base])
    with device.texture(SIZE, Format.R32F) as image, device.render_pass(image, clear=(0, 0, 0, 0)):
        device.draw(program, instanced, COUNT)
        with refuses(MESH_RANGE):
            device.draw(program, view, instances)
        with refuses(MESH_RANGE):
            device.draw_many(program, instanced, draws)
        with refuses(MESH_RANGE):  # each time, whatever was drawn in between
            device.draw(program, view, instances)


def test_all_instances_are_drawn_and_none_beyond_the_last(device: Device, instanced: Mesh) -> None:
    program = device.program(Numbered)
    assert_same(show(device, lambda: device.draw(program, instanced, COUNT)), OWN)
    last = instanced.view(base_instance=COUNT - 1)
    assert_same(show(device, lambda: device.draw(program, last)), OWN * (OWN == COUNT))
    end = instanced.view(base_instance=COUNT)
    assert_same(show(device, lambda: device.draw(program, end, 0)), 0)
    draws = instanced.draws(0, 1, instances=[1, 0], base_instance=[0, COUNT])
    assert_same(show(device, lambda: device.draw_many(program, instanced, draws)), OWN * (OWN == 1))


def test_a_program_that_reads_no_instances_draws_more_of_them(device: Device) -> None:
    with device.mesh(
        make_vertices(OWN), instances={"other": np.zeros(2, np.float32)}, primitive=Primitive.POINTS
    ) as mesh:
        image = show(
            device, lambda: device.draw(device.program(Counted), mesh.view(0, 1, base_instance=3), 5)
        )
        assert image[0] in (5.0, 8.0)  # whether an instance's index counts from the base
        assert not image[1:].any()


# -- only the device knows -----------------------------------------------------------------------------------


@pytest.mark.parametrize("by_device", [False, True], ids=["by the CPU", "by the device"])
@pytest.mark.parametrize("far", FAR)
@pytest.mark.parametrize("primitive", [Primitive.POINTS, Primitive.TRIANGLES, Primitive.LINE_STRIP])
def test_an_index_that_was_written_reads_the_mesh(
    device: Device, indexed: Mesh, primitive: Primitive, far: int, by_device: bool
) -> None:
    written = np.array([0, 1, far, 3, far, far], np.uint32)
    assert indexed.indices is not None
    if by_device:
        with device.buffer(written) as source:
            source.copy_to(indexed.indices)
    else:
        indexed.indices.write(written)
    view = indexed.view(0, 6, primitive=primitive)
    assert_own(device, indexed, lambda: device.draw(device.program(Numbered), view))


@pytest.mark.parametrize("base", [-1, -COUNT, -(1 << 30)])
def test_a_negative_base_vertex_reads_the_mesh(device: Device, indexed: Mesh, base: int) -> None:
    view = indexed.view(0, 3, base_vertex=base)
    assert_own(device, indexed, lambda: device.draw(device.program(Numbered), view))


@pytest.mark.parametrize(
    ("mesh_name", "name", "value"),
    [
        ("indexed", "count", 9),
        ("indexed", "count", 100_000),
        ("indexed", "first", COUNT),
        ("indexed", "first", 1 << 20),
        ("indexed", "base_vertex", COUNT),
        ("indexed", "base_vertex", -1),
        ("indexed", "base_vertex", 1 << 30),
        ("indexed", "base_vertex", -(1 << 31)),
        ("plain", "count", 9),
        ("plain", "count", 100_000),
        ("plain", "first", COUNT),
        ("plain", "first", 1 << 30),
        ("instanced", "instances", 9),
        ("instanced", "instances", 100_000),
        ("instanced", "base_instance", COUNT),
        ("instanced", "base_instance", 1 << 30),
    ],
)
def test_indirect_arguments_read_the_mesh(
    device: Device, request: pytest.FixtureRequest, mesh_name: str, name: str, value: int
) -> None:
    mesh: Mesh = request.getfixturevalue(mesh_name)
    draws = mesh.draws(0, 1)
    draws[name] = value
    with device.buffer(draws) as arguments:
        program, indirect = device.program(Numbered), IndirectDraws(arguments, 1)
        assert_own(device, mesh, lambda: device.draw_indirect(program, mesh, indirect))


FARTHEST = [5_000_000, 10_000_000, 100_663_296, (1 << 31) - 1, 1 << 31, (1 << 32) - 1]
"""Numbers at which drivers have read memory far from a buffer."""


@pytest.mark.parametrize("by_device", [False, True], ids=["by the CPU", "by the device"])
@pytest.mark.parametrize("value", FARTHEST)
@pytest.mark.parametrize(
    ("mesh_name", "name"),
    [
        ("indexed", "count"),
        ("indexed", "first"),
        ("plain", "count"),
        ("plain", "first"),
        ("instanced", "instances"),
        ("instanced", "base_instance"),
    ],
)
def test_far_indirect_arguments_read_the_mesh(
    device: Device, request: pytest.FixtureRequest, mesh_name: str, name: str, value: int, by_device: bool
) -> None:
    mesh: Mesh = request.getfixturevalue(mesh_name)
    draws = mesh.draws(0, 1)
    draws[name] = value
    with device.buffer(mesh.draws(0, 1)) as arguments, device.buffer(draws) as source:
        if by_device:
            source.copy_to(arguments)
        else:
            arguments.write(draws)
        program, indirect = device.program(Numbered), IndirectDraws(arguments, 1)
        assert_own(device, mesh, lambda: device.draw_indirect(program, mesh, indirect))


@pytest.mark.parametrize("stride", [20, 36])
@pytest.mark.parametrize("name", ["count", "first"])
@pytest.mark.parametrize("mesh_name", ["indexed", "plain"])
def test_draws_beside_one_beyond_the_mesh_are_whole(
    device: Device, request: pytest.FixtureRequest, mesh_name: str, name: str, stride: int
) -> None:
    mesh: Mesh = request.getfixturevalue(mesh_name)
    draws = mesh.draws([1, 0, 6], [2, 1, 2])
    draws[name][1] = (1 << 32) - 1
    padded = np.zeros((3, stride), np.uint8)
    padded[:, :20] = draws.view(np.uint8).reshape(3, 20)
    with device.buffer(padded) as arguments:
        program, indirect = device.program(Numbered), IndirectDraws(arguments, 3, stride=stride)
        image = show(device, lambda: device.draw_indirect(program, mesh, indirect))
    whole = np.isin(OWN, [2, 3, 7, 8])
    assert_same(image[whole], OWN[whole])
    assert np.isin(image[~whole], [0.0, *OWN]).all(), image


def draw_random_arguments(mesh: Mesh, rng: np.random.Generator) -> NDArray[Any]:
    """Return a draw whose numbers lie inside the mesh, at its ends, or far beyond it."""
    draws = mesh.draws(0, 1)
    far = [0, 1, COUNT - 1, COUNT, COUNT + 1, *FARTHEST]
    for name in ("count", "first", "base_instance"):
        if rng.random() < 0.6:
            draws[name] = rng.choice(far)
    draws["instances"] = rng.integers(0, 3)
    if mesh.is_indexed and rng.random() < 0.5:
        draws["base_vertex"] = rng.choice([0, -1, COUNT, (1 << 31) - 1, -(1 << 31)])
    return draws


@pytest.mark.parametrize("mesh_name", ["indexed", "plain", "instanced"])
def test_random_indirect_arguments_read_the_mesh(
    device: Device, request: pytest.FixtureRequest, mesh_name: str
) -> None:
    mesh: Mesh = request.getfixturevalue(mesh_name)
    rng, program = np.random.default_rng(7), device.program(Numbered)
    for _ in range(24):
        draws = np.concatenate([draw_random_arguments(mesh, rng) for _ in range(rng.integers(1, 4))])
        with device.buffer(draws) as arguments:
            indirect = IndirectDraws(arguments, len(draws))
            image = show(device, partial(device.draw_indirect, program, mesh, indirect))
            assert np.isin(image, [0.0, *OWN]).all(), (draws, image)
    assert_own(device, mesh, lambda: None)


@pytest.mark.requires("indirect_count")
@pytest.mark.parametrize("count", [3, 1000, (1 << 32) - 1])
def test_an_indirect_count_is_at_most_the_draws_of_the_command(
    device: Device, plain: Mesh, count: int
) -> None:
    draws = plain.draws([0, 1, 2, 3], 1)
    with device.buffer(draws) as arguments, device.buffer(np.array([count], np.uint32)) as counts:
        indirect = IndirectDraws(arguments, 2, count=counts)
        image = show(device, lambda: device.draw_indirect(device.program(Numbered), plain, indirect))
    if count >= 1 << 31 and not image.any():
        return  # NVIDIA's OpenGL driver reads a negative number, and draws nothing
    assert_same(image, OWN * (OWN <= 2))


class Checked(Numbered):
    """The same, which reports what it reads beyond."""

    checked = True


def test_a_checked_shader_reports_an_index_beyond_the_buffer(device: Device, indexed: Mesh) -> None:
    assert indexed.indices is not None
    indexed.indices.write(np.array([0, 1, 1000], np.uint32))
    error: ShaderError | None = None
    try:
        show(device, lambda: device.draw(device.program(Checked), indexed.view(0, 3)))
    except ShaderError as raised:
        error = raised
    if error is None:
        assert device.backend_name != "cl"  # OpenCL's and NumPy's shaders check their indices
        pytest.skip(f"{device.backend_name} doesn't check the indices of shaders")
    assert error.rule.id == "shading-index"
    assert (error.given, error.allowed) == ("index 1000", f"0 to {COUNT - 1}")
    assert error.site is not None
    assert error.site.file == __file__


def test_a_device_draws_after_a_checked_shader_has_met_an_index_beyond_the_buffer(
    device: Device, indexed: Mesh
) -> None:
    program = device.program(Checked)
    assert indexed.indices is not None
    indexed.indices.write(np.array([0, 1, 1000], np.uint32))
    with suppress(ShaderError):
        show(device, lambda: device.draw(program, indexed.view(0, 3)))
    assert_same(show(device, lambda: device.draw(program, indexed.view(0, 2))), OWN * (OWN <= 2))


class Bounded(sl.Shader):
    """An image whose stages read and write outside; differences of pixels let helper invocations run."""

    words: sl.Storage[float]
    far: sl.Storage[int]
    results: sl.StorageRW[float]

    def vertex(self) -> Bare:
        n = sl.vertex_index()
        x = 4.0 * float(n & 1) - 1.0 if self.words[n + self.far[0]] > 0.0 else 9.0
        return Bare(clip=sl.vec4(x, 4.0 * float(n >> 1) - 1.0, 0.5, 1.0))

    def fragment(self) -> sl.vec4:
        x = int(sl.fragment_coordinate().x)
        table = sl.array(float, 4)
        table[x + self.far[0]] = 50.0
        table[x] = 2.0
        self.results[x + self.far[1]] = 1.0
        self.results[x] = 3.0
        return sl.vec4(
            self.words[x - 2],
            table[x + self.far[0]] + table[x],
            sl.ddx(self.words[self.far[0] - x]),
            table[3],
        )


@pytest.mark.requires("max_storage_slots")
def test_the_stages_of_a_draw_are_bounded_too(device: Device) -> None:
    words = np.array([5, 6, 7, 8], "f4")
    results, far = (
        device.storage(float, np.zeros(4, "f4")),
        device.storage(int, np.array([100000, 500000000], "i4")),
    )
    with device.texture((8, 2), Format.RGBA32F) as target:
        with device.render_pass(target, clear=(0, 0, 0, 0)):
            device.draw(
                device.program(Bounded),
                device.mesh(3),
                words=device.storage(float, words),
                far=far,
                results=results,
            )
        back = target.read()
    for x in range(8):
        last = 2.0 if x == 3 else 0.0
        assert_same(back[:, x], (words[np.clip(x - 2, 0, 3)], last + (2.0 if x < 4 else 0.0), 0.0, last))
    assert_same(results.read(), 3.0)
