"""Inputs of draws: vertex formats, views, base vertices and instances, shared buffers."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import rhi
import rhi.shading as sl
from rhi.conformance.compare import assert_mask, assert_near, assert_same
from rhi.conformance.formats import require_targets, require_vertex_alignment
from rhi.conformance.shaders import Colored, Corner, Flat, FlatShade, PaintedShader, PaintedTwice
from rhi.conformance.shapes import centers, corners, rectangle
from rhi.conformance.single_draws import draw_once

pytestmark = [pytest.mark.requires("draws", "shading"), pytest.mark.recorded_too]

ROW = (8, 1)
CENTERS = centers([(i, 0) for i in range(8)], ROW)


@pytest.fixture
def image(device: rhi.Device) -> Iterator[rhi.Texture]:
    with device.texture(ROW, rhi.Format.RGBA32F) as image:
        yield image


@pytest.fixture
def mesh(device: rhi.Device) -> Iterator[rhi.Mesh]:
    """A point for each texel of the row."""
    with device.mesh(corners(CENTERS), primitive=rhi.Primitive.POINTS) as mesh:
        yield mesh


def count_points(
    device: rhi.Device, mesh: Any, instances: int = 1, shader: type[sl.Shader] = Colored
) -> NDArray[Any]:
    """Return the number of draws of each of 8 texels in a row."""
    with device.texture(ROW, rhi.Format.R16F) as image:
        with device.render_pass(image), device.states(rhi.BlendFunction.ADDITIVE):
            device.draw(device.program(shader), mesh, instances)
        return np.asarray(image.read()[0])


def vertices_of(mesh: rhi.Mesh) -> rhi.Buffer:
    """Return the vertex buffer of a mesh."""
    assert mesh.vertices is not None
    return mesh.vertices


# -- views -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("first", "count"), [(0, 8), (0, 3), (5, 3), (3, 0), (7, 1), (8, 0)])
def test_a_view_draws_its_vertices_only(device: rhi.Device, first: int, count: int, mesh: rhi.Mesh) -> None:
    expected = np.zeros(8)
    expected[first : first + count] = 1
    assert_same(count_points(device, mesh.view(first, count)), expected)


@pytest.mark.parametrize("dtype", ["u2", "u4"])
@pytest.mark.parametrize(("first", "count"), [(0, 6), (0, 2), (3, 3), (2, 0), (5, 1)])
def test_a_view_of_indices_draws_its_indices_only(
    device: rhi.Device, first: int, count: int, dtype: str
) -> None:
    indices = np.array([7, 0, 3, 3, 5, 1], dtype)
    with device.mesh(corners(CENTERS), indices, primitive=rhi.Primitive.POINTS) as mesh:
        expected = np.bincount(indices[first : first + count].astype(int), minlength=8)
        assert_same(count_points(device, mesh.view(first, count)), expected)


@pytest.mark.parametrize("dtype", ["u2", "u4"])
@pytest.mark.parametrize("base", [0, 1, 4, -2])
def test_a_base_vertex_is_added_to_each_index(device: rhi.Device, base: int, dtype: str) -> None:
    indices = np.array([2, 3], dtype)
    with device.mesh(corners(CENTERS), indices, primitive=rhi.Primitive.POINTS) as mesh:
        expected = np.bincount(indices.astype(int) + base, minlength=8)
        assert_same(count_points(device, mesh.view(base_vertex=base)), expected)


def test_a_base_vertex_reaches_vertices_beyond_16_bits(device: rhi.Device) -> None:
    rows = corners(np.full((70_000, 2), -3.0))
    rows["position"][69_999, :2] = CENTERS[4]
    with device.mesh(rows, np.array([65_000], "u2"), primitive=rhi.Primitive.POINTS) as mesh:
        assert_same(count_points(device, mesh.view(base_vertex=4_999)), np.arange(8) == 4)


def test_a_view_can_have_another_primitive(device: rhi.Device) -> None:
    rows = corners(centers([(0, 0), (7, 0)], ROW))
    with device.mesh(rows, primitive=rhi.Primitive.POINTS) as mesh:
        assert count_points(device, mesh).sum() == 2
        assert count_points(device, mesh.view(primitive=rhi.Primitive.LINES)).sum() >= 7


def test_no_instance_draws_nothing(device: rhi.Device, mesh: rhi.Mesh) -> None:
    assert_same(count_points(device, mesh, 0), 0)


def test_meshes_can_share_buffers(device: rhi.Device) -> None:
    with (
        device.buffer(corners(CENTERS)) as vertices,
        device.buffer(np.array([1, 2], "u4")) as first_indices,
        device.buffer(np.array([6], "u2")) as two,
    ):
        first = device.mesh(vertices, first_indices, primitive=rhi.Primitive.POINTS)
        second = device.mesh(vertices, two, primitive=rhi.Primitive.POINTS)
        assert_same(count_points(device, first), np.isin(np.arange(8), (1, 2)))
        assert_same(count_points(device, second), np.arange(8) == 6)
        first.destroy()
        assert_same(count_points(device, second), np.arange(8) == 6)
        second.destroy()


def test_a_mesh_draws_the_latest_data_of_its_buffer(device: rhi.Device) -> None:
    with device.mesh(corners(CENTERS[:1]), primitive=rhi.Primitive.POINTS) as mesh:
        assert_same(count_points(device, mesh), np.arange(8) == 0)
        vertices_of(mesh).write(corners(CENTERS[5:6]))
        assert_same(count_points(device, mesh), np.arange(8) == 5)


def test_a_draw_sees_the_vertices_of_its_time(device: rhi.Device) -> None:
    """A write after a draw doesn't affect the draw, even if the GPU hasn't executed it yet."""
    with (
        device.texture(ROW, rhi.Format.R16F) as image,
        device.mesh(corners(CENTERS[:1]), primitive=rhi.Primitive.POINTS) as mesh,
    ):
        with device.render_pass(image), device.states(rhi.BlendFunction.ADDITIVE):
            for i in range(8):
                vertices_of(mesh).write(corners(CENTERS[i : i + 1]))
                device.draw(device.program(Colored), mesh)
        assert_same(image.read(), 1)


@pytest.mark.parametrize("bytes_", [1, 4], ids=["of 49 bytes", "of 52 bytes"])
def test_fields_that_the_program_does_not_read_are_skipped(device: rhi.Device, bytes_: int) -> None:
    require_vertex_alignment(device, bytes_)
    fields = [
        ("normal", "f4", 3),
        ("color", "f4", 4),
        ("id", "u1", bytes_),
        ("position", "f4", 4),
        ("uv", "f2", 2),
    ]
    dtype = np.dtype(fields)
    rows = np.zeros(8, dtype)
    plain = corners(CENTERS)
    rows["position"], rows["color"] = plain["position"], plain["color"]
    with device.mesh(rows, primitive=rhi.Primitive.POINTS) as mesh:
        assert_same(count_points(device, mesh), 1)


def test_arrays_by_name_make_a_mesh(device: rhi.Device) -> None:
    plain = corners(CENTERS)
    arrays = {"position": plain["position"].astype(np.float64), "color": plain["color"]}
    with device.mesh(arrays, primitive=rhi.Primitive.POINTS) as mesh:
        assert_same(count_points(device, mesh), 1)


# -- vertex formats ----------------------------------------------------------------------------------------


def expected_floats(values: NDArray[Any]) -> NDArray[Any]:
    """The numbers that a shader reads from floats and from normalised integers."""
    if values.dtype.kind == "f":
        return values.astype(np.float64)
    return np.maximum(values.astype(np.float64) / np.iinfo(values.dtype).max, -1.0)


def painted(device: rhi.Device, shader: type[sl.Shader], values: NDArray[Any]) -> NDArray[Any]:
    """Return the texels (8, 4) of 8 points in these colors."""
    rows = {"position": CENTERS, "color": values}
    drawn = draw_once(device, ROW, rhi.Format.RGBA32F, rows, shader=shader, primitive=rhi.Primitive.POINTS)
    return np.asarray(drawn[0])


@pytest.mark.parametrize("code", ["f4", "f2", "u1", "i1"])
def test_a_float_attribute_takes_floats_and_normalised_integers(device: rhi.Device, code: str) -> None:
    rng = np.random.default_rng(7)
    values = rng.normal(size=(8, 4)).astype(code) if code[0] == "f" else np.zeros((8, 4), code)
    if code[0] != "f":
        limits = np.iinfo(code)
        values[:] = rng.integers(limits.min, limits.max, (8, 4), endpoint=True)
        values[0], values[1], values[2] = limits.max, limits.min, 0
    assert_near(
        painted(device, PaintedShader, values), expected_floats(values), 1e-6, "conversion in float32"
    )


@pytest.mark.parametrize("code", ["f4", "f2", "u2", "i2"])
def test_two_components_take_two(device: rhi.Device, code: str) -> None:
    values = (np.linspace(-1, 1, 16) * (1 if code[0] == "f" else 32767)).reshape(8, 2).astype(code)
    drawn = painted(device, PaintedTwice, values)[:, :2]
    assert_near(drawn, expected_floats(values), 1e-6, "conversion in float32")


def test_a_vector_may_be_fed_more_components_than_it_reads(device: rhi.Device) -> None:
    values = np.arange(32, dtype="f4").reshape(8, 4)
    assert_same(painted(device, PaintedTwice, values)[:, :2], values[:, :2])


class IntegerProbe(sl.Struct):
    """A vertex with integers."""

    position: sl.vec2
    unsigned: sl.uvec4
    signed: sl.ivec4
    single: sl.uint


class Integers(sl.Struct):
    """Integer varyings."""

    clip: sl.vec4
    unsigned: sl.Flat[sl.uvec4]
    signed: sl.Flat[sl.ivec4]
    single: sl.Flat[sl.uint]


class IntegerOutputs(sl.Struct):
    """Integer outputs."""

    unsigned: sl.uvec4
    signed: sl.ivec4
    single: sl.uint


class ShowIntegers(sl.Shader):
    """Writes integer attributes to integer targets."""

    def vertex(self, v: IntegerProbe) -> Integers:
        return Integers(
            clip=sl.vec4(v.position, 0.5, 1.0), unsigned=v.unsigned, signed=v.signed, single=v.single
        )

    def fragment(self, v: Integers) -> IntegerOutputs:
        return IntegerOutputs(unsigned=v.unsigned, signed=v.signed, single=v.single)


@pytest.mark.parametrize("code", ["u4", "u1"])
def test_integer_attributes_keep_all_their_bits(device: rhi.Device, code: str) -> None:
    rng = np.random.default_rng(3)
    unsigned = rng.integers(0, np.iinfo(code).max, (8, 4), endpoint=True).astype(code)
    signed = rng.integers(-(2**31), 2**31, (8, 4)).astype("i4")
    single = rng.integers(0, 2**32, 8).astype("u4")
    formats = (rhi.Format.RGBA32UI, rhi.Format.RGBA32I, rhi.Format.R32UI)
    require_targets(device, formats)
    targets = [device.texture(ROW, f) for f in formats]
    arrays = {"position": CENTERS, "unsigned": unsigned, "signed": signed, "single": single}
    with device.mesh(arrays, primitive=rhi.Primitive.POINTS) as mesh, device.render_pass(targets):
        device.draw(device.program(ShowIntegers), mesh)
    assert_same(targets[0].read()[0], unsigned)
    assert_same(targets[1].read()[0], signed)
    assert_same(targets[2].read()[0], single)
    for target in targets:
        target.destroy()


class Narrow(sl.Struct):
    """A vertex with three components and one."""

    position: sl.vec3
    weight: float


class ShowNarrow(Flat):
    """Draws points at three-component positions, with a one-component color."""

    def vertex(self, v: Narrow) -> FlatShade:
        return FlatShade(clip=sl.vec4(v.position, 1.0), color=sl.vec4(v.weight))


def test_three_components_and_one_lie_where_the_dtype_says(device: rhi.Device) -> None:
    packed = np.zeros(8, np.dtype([("weight", "f4"), ("position", "f4", 3)]))
    padded = np.zeros(8, Narrow.dtype)
    for rows in (packed, padded):
        rows["position"][:, :2], rows["position"][:, 2] = CENTERS, 0.5
        rows["weight"] = np.arange(8)
        drawn = draw_once(
            device, ROW, rhi.Format.R32F, rows, shader=ShowNarrow, primitive=rhi.Primitive.POINTS
        )
        assert_same(drawn[0], np.arange(8))


# -- instances ---------------------------------------------------------------------------------------------


class Instanced(sl.Struct):
    """A vertex attribute and an instance attribute."""

    position: sl.vec2
    offset: sl.vec2
    shade: float


class ShowInstances(Flat):
    """Draws a point, moved by the instance's offset."""

    def vertex(self, v: Instanced) -> FlatShade:
        return FlatShade(clip=sl.vec4(v.position + v.offset, 0.5, 1.0), color=sl.vec4(v.shade))


def instanced(device: rhi.Device) -> Any:
    """Return a mesh of one point with eight instances: each covers a texel of its own, with its number plus 1
    as the color."""
    vertices = {"position": CENTERS[:1]}
    instances = {"offset": CENTERS - CENTERS[0], "shade": np.arange(1.0, 9.0)}
    return device.mesh(vertices, instances=instances, primitive=rhi.Primitive.POINTS)


@pytest.mark.parametrize("count", [0, 1, 5, 8])
def test_each_instance_reads_its_element(device: rhi.Device, count: int) -> None:
    with instanced(device) as mesh:
        drawn = count_points(device, mesh, count, ShowInstances)
        assert_same(drawn, np.where(np.arange(8) < count, np.arange(1, 9), 0))


@pytest.mark.parametrize("base", [0, 1, 6])
def test_a_base_instance_says_where_to_begin(device: rhi.Device, base: int) -> None:
    with instanced(device) as mesh:
        drawn, numbers = count_points(device, mesh.view(base_instance=base), 2, ShowInstances), np.arange(8)
        assert_same(drawn, np.where((numbers >= base) & (numbers < base + 2), numbers + 1, 0))


def test_instances_of_indexed_meshes_read_their_elements(device: rhi.Device) -> None:
    vertices = {"position": CENTERS[[3, 0]]}
    instances = {"offset": CENTERS[:4] - CENTERS[0], "shade": np.arange(1.0, 5.0)}
    indices = np.array([0, 1], "u2")
    with device.mesh(vertices, indices, instances=instances, primitive=rhi.Primitive.POINTS) as mesh:
        drawn = count_points(device, mesh.view(base_instance=1, count=1), 3, ShowInstances)
        assert_same(drawn, [0, 0, 0, 0, 2, 3, 4, 0])
        drawn = count_points(device, mesh.view(1, 1, base_vertex=-1, base_instance=1), 2, ShowInstances)
        assert_same(drawn, [0, 0, 0, 0, 2, 3, 0, 0])


class Numbered(Flat):
    """Writes the indices of the vertex and instance."""

    def vertex(self, v: Corner) -> FlatShade:
        return FlatShade(
            clip=v.position, color=sl.vec4(float(sl.vertex_index()), float(sl.instance_index()), 0.0, 1.0)
        )


class NumberedDraws(Numbered):
    """Writes the indices of the vertex, instance and draw."""

    def vertex(self, v: Corner) -> FlatShade:
        color = sl.vec4(float(sl.vertex_index()), float(sl.instance_index()), float(sl.draw_index()), 1.0)
        return FlatShade(clip=v.position, color=color)


def numbered(device: rhi.Device) -> Any:
    """Return the program of `NumberedDraws`, or of `Numbered` where vertices don't know the index of the
    draw."""
    return device.program(NumberedDraws if device.capabilities.draw_index else Numbered)


def test_a_shader_knows_its_vertex_and_instance(device: rhi.Device, image: rhi.Texture) -> None:
    with device.mesh(corners(CENTERS), np.array([1, 2, 3], "u2"), primitive=rhi.Primitive.POINTS) as mesh:
        with device.render_pass(image):
            device.draw(numbered(device), mesh.view(1, 2, base_vertex=2, base_instance=10), 3)
        # Vertices 2 and 3 plus the base vertex 2. The last of three instances is visible. Instance indices
        # include the base instance.
        assert_same(image.read()[0, 4], (4, 12, 0, 1))
        assert_same(image.read()[0, 5], (5, 12, 0, 1))


def test_without_indices_vertices_count_from_the_first_of_the_buffer(
    device: rhi.Device, image: rhi.Texture, mesh: rhi.Mesh
) -> None:
    with device.render_pass(image):
        device.draw(numbered(device), mesh.view(3, 2))
    assert_same(image.read()[0, 3:5], [(3, 0, 0, 1), (4, 0, 0, 1)])


class FullTriangle(Flat):
    """Covers the whole target with one triangle, from vertex numbers alone."""

    def vertex(self) -> FlatShade:
        x = float(sl.vertex_index() % 2) * 4.0 - 1.0
        y = float(sl.vertex_index() // 2) * 4.0 - 1.0
        return FlatShade(clip=sl.vec4(x, y, 0.5, 1.0), color=sl.vec4(1.0))


def test_a_shader_without_attributes_counts_its_vertices(device: rhi.Device) -> None:
    assert_same(draw_once(device, (4, 4), rhi.Format.R8, 3, rhi.CullMode.NONE, shader=FullTriangle), 255)


# -- many draws in one call --------------------------------------------------------------------------------


def test_draw_many_follows_the_arguments_of_each_draw(device: rhi.Device) -> None:
    with (
        device.texture(ROW, rhi.Format.RGBA32F) as image,
        device.mesh(corners(CENTERS), np.arange(4, dtype="u2"), primitive=rhi.Primitive.POINTS) as mesh,
    ):
        draws = mesh.draws([0, 1, 0], [1, 2, 4], base_vertex=[0, 0, 4], base_instance=[5, 6, 7])
        draws["instances"][1] = 0
        with device.render_pass(image):
            device.draw_many(numbered(device), mesh, draws)
        row = image.read()[0]
    assert_same(row[0], (0, 5, 0, 1))
    assert_same(row[1:4], 0)
    assert_same(row[4:], [(4 + i, 7, 2 * device.capabilities.draw_index, 1) for i in range(4)])


@pytest.mark.requires("draw_index")
@pytest.mark.parametrize("indices", [None, np.arange(8, dtype="u2")], ids=["plain", "indexed"])
def test_the_same_draws_in_another_order_have_other_numbers(
    device: rhi.Device, indices: Any, image: rhi.Texture
) -> None:
    with device.mesh(corners(CENTERS), indices, primitive=rhi.Primitive.POINTS) as mesh:
        for order in ([0, 1, 2], [2, 0, 1], [1], [2, 0, 1]):
            with device.render_pass(image, clear=(0, 0, 0, 0)):
                device.draw_many(numbered(device), mesh, mesh.draws(order, 1))
            for number, first in enumerate(order):
                assert_same(image.read()[0, first], (first, 0, number, 1))


def test_many_draws_without_indices(device: rhi.Device) -> None:
    with (
        device.texture(ROW, rhi.Format.RGBA32F) as image,
        device.mesh(corners(CENTERS), primitive=rhi.Primitive.POINTS) as mesh,
    ):
        with device.render_pass(image):
            device.draw_many(numbered(device), mesh, mesh.draws([6, 0], [2, 1], base_instance=[3, 9]))
        row = image.read()[0]
    assert_same(row[6:], [(6, 3, 0, 1), (7, 3, 0, 1)])
    assert_same(row[0], (0, 9, int(device.capabilities.draw_index), 1))
    assert_same(row[1:6], 0)


CLIPS = [(0, 0, 3, 1), (2, 0, 4, 1), (-5, -2, 6, 9), (7, 0, 1 << 30, 1), (1, 0, 0, 1), (3, 1, 2, 5)]
"""Rectangles in a row of 8 texels; the last two are empty, or beside it."""


@pytest.mark.parametrize("primitive", [rhi.Primitive.TRIANGLES, rhi.Primitive.QUADS])
@pytest.mark.parametrize("indexed", [False, True], ids=["plain", "indexed"])
def test_each_clipped_draw_is_cut_by_its_own_rectangle(
    device: rhi.Device, primitive: rhi.Primitive, indexed: bool
) -> None:
    """As by a scope of `Scissor` around each. The second half of the vertices covers nothing."""
    quad = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)], float)
    shape = quad if primitive is rhi.Primitive.QUADS else quad[[0, 1, 2, 0, 2, 3]]
    count = len(shape)
    rows = corners(np.concatenate([shape + 9, shape]))
    indices = np.arange(2 * count, dtype=np.uint16) if indexed else None
    with (
        device.texture(ROW, rhi.Format.RGBA16F) as image,
        device.texture(ROW, rhi.Format.RGBA16F) as expected,
        device.mesh(rows, indices, primitive=primitive) as mesh,
    ):
        program = numbered(device)
        draws = mesh.draws(count, count, base_instance=np.arange(6))
        with device.states(rhi.BlendFunction.ADDITIVE, rhi.CullMode.NONE):
            with device.render_pass(image, clear=(0, 0, 0, 0)):
                device.draw_clipped(program, mesh, draws, CLIPS)
            with device.render_pass(expected, clear=(0, 0, 0, 0)):
                for number, clip in enumerate(CLIPS):
                    with device.states(rhi.Scissor(*clip)):
                        device.draw(program, mesh.view(count, count, base_instance=number))
        assert image.read()[0, :, 3].tolist() == [2, 1, 2, 1, 1, 1, 0, 1]
        assert_same(image.read(), expected.read())


@pytest.mark.parametrize(
    ("primitive", "indices"),
    [
        (rhi.Primitive.TRIANGLES, [0, 1, 2, 0, 2, 3]),
        (rhi.Primitive.TRIANGLES, [0, 1, 2, 65535, 0, 2, 3, 65535]),
        (rhi.Primitive.TRIANGLE_STRIP, [1, 2, 0, 3]),
        (rhi.Primitive.TRIANGLE_STRIP, [1, 2, 0, 65535, 2, 3, 0]),
    ],
    ids=["lists", "lists with restarts", "strips", "strips with restarts"],
)
@pytest.mark.parametrize("written_by", ["cpu", "device"])
def test_clipped_draws_are_assembled_as_others(
    device: rhi.Device, primitive: rhi.Primitive, indices: list[int], written_by: str
) -> None:
    """Each of two draws reads the second half of the indices, or the first, from another vertex on."""
    if primitive is rhi.Primitive.TRIANGLES and 65535 in indices and not device.capabilities.list_restart:
        pytest.skip(f"{device.backend_name} declares no list_restart")
    quad = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)], float)
    rows = corners(np.concatenate([quad * (0.25, 1), quad]))
    count = len(indices)
    both = np.array(indices * 2, np.uint16)
    with (
        device.texture(ROW, rhi.Format.RGBA16F) as image,
        device.texture(ROW, rhi.Format.RGBA16F) as expected,
        device.mesh(rows, both, primitive=primitive) as mesh,
    ):
        program = numbered(device)
        if written_by == "device" and mesh.indices is not None:
            device.buffer(both).copy_to(mesh.indices)
        firsts, bases, instances = [count, 0], [4, 0], [2, 3]
        clips = [(1, 0, 3, 1), (2, 0, 6, 1)]
        with device.states(rhi.BlendFunction.ADDITIVE, rhi.CullMode.NONE):
            with device.render_pass(image, clear=(0, 0, 0, 0)):
                draws = mesh.draws(firsts, count, base_vertex=bases, base_instance=instances)
                device.draw_clipped(program, mesh, draws, clips)
            with device.render_pass(expected, clear=(0, 0, 0, 0)):
                for first, base, instance, clip in zip(firsts, bases, instances, clips, strict=True):
                    part = mesh.view(first, count, base_vertex=base, base_instance=instance)
                    with device.states(rhi.Scissor(*clip)):
                        device.draw(program, part)
        assert image.read()[0, :, 3].tolist() == [0, 1, 1, 2, 1, 0, 0, 0]
        assert_same(image.read(), expected.read())


def test_after_clipped_draws_the_scissor_of_the_enclosing_scope_holds(device: rhi.Device) -> None:
    with device.texture(ROW, rhi.Format.RGBA16F) as image, device.mesh(rectangle()) as mesh:
        program = numbered(device)
        with device.render_pass(image, clear=(0, 0, 0, 0)), device.states(rhi.BlendFunction.ADDITIVE):
            with device.states(rhi.Scissor(4, 0, 2, 1)):
                device.draw_clipped(program, mesh, mesh.draws([0, 0], 6), [(0, 0, 1, 1), (1, 0, 2, 1)])
                device.draw(program, mesh)
            device.draw(program, mesh)
        assert_same(image.read()[0, :, 3], [2, 2, 2, 1, 2, 2, 1, 1])


def test_clipped_draws_of_a_transient_mesh_see_its_vertices(device: rhi.Device, image: rhi.Texture) -> None:
    program = numbered(device)
    for first in (0, 2):
        mesh = device.transient.mesh(program, corners(CENTERS[first:]), primitive=rhi.Primitive.POINTS)
        with device.render_pass(image, clear=(0, 0, 0, 0)):
            device.draw_clipped(program, mesh, mesh.draws([1, 3], 1), [(0, 0, 8, 1), (0, 0, 3, 1)])
        assert_same(image.read()[0, :, 3], np.arange(8) == first + 1)


def test_many_draws_read_the_instances_of_their_base(device: rhi.Device) -> None:
    with device.texture(ROW, rhi.Format.R32F) as image, instanced(device) as mesh:
        draws = mesh.draws(0, 1, instances=[2, 1, 0], base_instance=[1, 6, 0])
        with device.render_pass(image):
            device.draw_many(device.program(ShowInstances), mesh, draws)
        assert_same(image.read()[0], [0, 2, 3, 0, 0, 0, 7, 0])
        with device.render_pass(image, clear=(0, 0, 0, 0)), device.buffer(draws) as buffer:
            device.draw_indirect(device.program(ShowInstances), mesh, rhi.IndirectDraws(buffer, 3))
        assert_same(image.read()[0], [0, 2, 3, 0, 0, 0, 7, 0])


@pytest.mark.parametrize("dtype", ["u2", "u4"])
def test_many_draws_add_their_base_vertices(device: rhi.Device, dtype: str) -> None:
    indices = np.array([0, 2, 1], dtype)
    with (
        device.texture(ROW, rhi.Format.R16F) as image,
        device.mesh(corners(CENTERS), indices, primitive=rhi.Primitive.POINTS) as mesh,
    ):
        draws = mesh.draws([0, 1], [2, 2], base_vertex=[5, -1])
        with device.render_pass(image), device.states(rhi.BlendFunction.ADDITIVE):
            device.draw_many(device.program(Colored), mesh, draws)
        assert_same(image.read()[0], [1, 1, 0, 0, 0, 1, 0, 1])


def test_no_draws_draw_nothing(device: rhi.Device, mesh: rhi.Mesh) -> None:
    with device.texture(ROW, rhi.Format.R32F) as image:
        with device.render_pass(image):
            device.draw_many(device.program(Colored), mesh, mesh.draws(0, 8)[:0])
        assert_same(image.read(), 0)


def test_thousands_of_draws_in_one_call_are_all_drawn(device: rhi.Device, mesh: rhi.Mesh) -> None:
    count = 5000
    with device.texture(ROW, rhi.Format.R16F) as image:
        with device.render_pass(image), device.states(rhi.BlendFunction.ADDITIVE):
            device.draw_many(device.program(Colored), mesh, mesh.draws(np.arange(count) % 8, 1))
        assert_same(image.read(), count / 8)


def test_the_array_of_draws_may_change_right_after_the_call(device: rhi.Device, mesh: rhi.Mesh) -> None:
    with device.texture(ROW, rhi.Format.R32F) as image:
        draws = mesh.draws(0, 4)
        with device.render_pass(image):
            device.draw_many(device.program(Colored), mesh, draws)
            draws["count"] = 8
        assert_same(image.read()[0], np.arange(8) < 4)


def test_many_quads_are_drawn_or_refused_but_never_wrong(device: rhi.Device) -> None:
    quad = corners([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    with (
        device.texture(ROW, rhi.Format.R8) as image,
        device.mesh(quad, primitive=rhi.Primitive.QUADS) as mesh,
    ):
        with device.render_pass(image):
            try:
                device.draw_many(device.program(Colored), mesh, mesh.draws())
            except rhi.ValidationError:
                return
        assert_same(image.read(), 255)


# -- indirect draws ----------------------------------------------------------------------------------------


def indirect(device: rhi.Device, mesh: Any, arguments: rhi.IndirectDraws) -> NDArray[Any]:
    with device.texture(ROW, rhi.Format.R16F) as image:
        with device.render_pass(image), device.states(rhi.BlendFunction.ADDITIVE):
            device.draw_indirect(device.program(Colored), mesh, arguments)
        return np.asarray(image.read()[0])


def test_an_indirect_draw_reads_its_arguments(device: rhi.Device) -> None:
    with device.mesh(corners(CENTERS), np.arange(8, dtype="u4"), primitive=rhi.Primitive.POINTS) as mesh:
        draws = np.array([(2, 3, 1, 0, 0), (1, 1, 0, 7, 0), (3, 0, 0, 0, 0)], rhi.DRAW)
        with device.buffer(draws) as buffer:
            expected = np.array([0, 3, 3, 0, 0, 0, 0, 1])
            assert_same(indirect(device, mesh, rhi.IndirectDraws(buffer, 3)), expected)
            assert_same(indirect(device, mesh, rhi.IndirectDraws(buffer, 1)), [0, 3, 3, 0, 0, 0, 0, 0])
            assert_same(indirect(device, mesh, rhi.IndirectDraws(buffer, 1, offset=20)), np.arange(8) == 7)


def test_an_indirect_draw_without_indices_reads_its_arguments(device: rhi.Device, mesh: rhi.Mesh) -> None:
    with device.buffer(mesh.draws([2, 7], [3, 1], instances=[2, 1])) as buffer:
        assert_same(indirect(device, mesh, rhi.IndirectDraws(buffer, 2)), [0, 0, 2, 2, 2, 0, 0, 1])


def test_indirect_draws_may_lie_a_stride_apart(device: rhi.Device) -> None:
    words = np.zeros((3, 8), "u4")
    with device.mesh(corners(CENTERS), np.arange(8, dtype="u4"), primitive=rhi.Primitive.POINTS) as mesh:
        words[:, :5] = [(1, 1, 0, 0, 0), (1, 1, 3, 0, 0), (1, 1, 6, 0, 0)]
        words[:, 5:] = 999
        with device.buffer(np.concatenate([[999, 999], words.reshape(-1)]).astype("u4")) as buffer:
            arguments = rhi.IndirectDraws(buffer, 3, offset=8, stride=32)
            assert_same(indirect(device, mesh, arguments), np.isin(np.arange(8), (0, 3, 6)))


@pytest.mark.requires("indirect_count")
@pytest.mark.parametrize(("stored", "drawn"), [(0, 0), (1, 1), (3, 3), (4, 4), (9, 4)])
def test_a_count_from_a_buffer_limits_indirect_draws(device: rhi.Device, stored: int, drawn: int) -> None:
    with (
        device.mesh(corners(CENTERS), np.arange(8, dtype="u4"), primitive=rhi.Primitive.POINTS) as mesh,
        device.buffer(mesh.draws(np.arange(4), 1)) as buffer,
        device.buffer(np.array([77, stored], "u4")) as count,
    ):
        arguments = rhi.IndirectDraws(buffer, 4, count=count, count_offset=4)
        assert_same(indirect(device, mesh, arguments), np.arange(8) < drawn)


@pytest.mark.requires("indirect_count")
def test_a_count_does_not_linger(device: rhi.Device, mesh: rhi.Mesh) -> None:
    """A draw without a count buffer executes all its draws, even after one with a count buffer."""
    with device.buffer(mesh.draws(np.arange(4), 1)) as buffer, device.buffer(np.array([1], "u4")) as count:
        assert_same(indirect(device, mesh, rhi.IndirectDraws(buffer, 4, count=count)), np.arange(8) < 1)
        assert_same(indirect(device, mesh, rhi.IndirectDraws(buffer, 4)), np.arange(8) < 4)


def test_arguments_are_read_when_the_draw_is_executed(device: rhi.Device, mesh: rhi.Mesh) -> None:
    """Indirect arguments are read when the draw is executed, not when it is issued: a copy before it takes
    effect."""
    with device.buffer(mesh.draws(3, 2)) as source, device.buffer(mesh.draws(0, 8)) as buffer:
        source.copy_to(buffer)
        assert_same(indirect(device, mesh, rhi.IndirectDraws(buffer, 1)), np.isin(np.arange(8), (3, 4)))


def test_a_draw_with_no_vertices_draws_nothing(device: rhi.Device) -> None:
    with device.mesh(rectangle()) as mesh, device.texture((2, 2), rhi.Format.R8) as image:
        with device.render_pass(image):
            device.draw(device.program(Colored), mesh.view(0, 0))
        assert_mask(image.read(), np.zeros((2, 2), bool))
