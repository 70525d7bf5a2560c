"""Byte order: arrays of big-endian numbers are converted wherever they come in.

Each test passes the same numbers in both orders, as an array or in a buffer, and compares what the device
reads.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import rhi.shading as sl
from rhi import Access, Buffer, Device, Format, IndirectDraws, Mesh, Primitive, TextureKind
from rhi.conformance.compare import assert_near, assert_same
from rhi.conformance.formats import random_texels, require_format, squeezed
from rhi.contract.formats import COLOR_FORMATS

draws_shaders = pytest.mark.requires("draws", "shading")
runs_compute = pytest.mark.requires("shading", "compute")
SIZE = (4, 1)


def big_endian(values: Any) -> NDArray[Any]:
    """Return equal numbers with the bytes of each in the other order."""
    array = np.asarray(values)
    return array.astype(array.dtype.newbyteorder(">"))


# -- memory ------------------------------------------------------------------------------------------------


INNER = np.dtype([("count", "<u2"), ("level", "<i8")])
RECORD = np.dtype(
    {
        "names": ["weight", "inner", "name", "corner"],
        "formats": ["<f4", INNER, ("u1", (4,)), ("<f8", (2, 3))],
        "offsets": [8, 16, 0, 40],
        "itemsize": 96,
    }
)


def make_records() -> NDArray[Any]:
    records = np.zeros(3, RECORD)
    records["weight"] = [0.5, -3.0, 1e9]
    records["inner"]["count"], records["inner"]["level"] = [1, 2, 65535], [-1, 7, 1 << 40]
    records["name"], records["corner"] = 9, np.arange(18).reshape(3, 2, 3) / 8
    return records


VALUES = {code: np.array([1, 2, 100, 77]).astype(code) for code in ("u2", "i2", "u4", "i4", "u8", "i8")}
VALUES |= {code: np.array([1.5, -2.0, 0.25, 300.0], code) for code in ("f2", "f4", "f8")}
VALUES |= {"record": make_records()}


@pytest.mark.parametrize("values", VALUES.values(), ids=VALUES)
def test_a_buffer_holds_the_numbers_of_an_array(device: Device, values: NDArray[Any]) -> None:
    with device.buffer(big_endian(values)) as buffer:
        assert buffer.dtype == values.dtype
        assert buffer.read().tobytes() == values.tobytes()


@pytest.mark.parametrize("values", VALUES.values(), ids=VALUES)
def test_a_buffer_of_a_big_endian_dtype_is_little_endian(device: Device, values: NDArray[Any]) -> None:
    with device.buffer(len(values), values.dtype.newbyteorder(">")) as buffer:
        assert buffer.dtype == values.dtype
        buffer.write(values)
        assert buffer.read_async().result().tobytes() == values.tobytes()


@pytest.mark.parametrize("values", VALUES.values(), ids=VALUES)
def test_a_write_converts_the_numbers_of_an_array(device: Device, values: NDArray[Any]) -> None:
    with device.buffer(len(values) + 1, values.dtype) as buffer:
        buffer.write(big_endian(values), 1)
        assert buffer.read(1).tobytes() == values.tobytes()


@pytest.mark.parametrize("values", VALUES.values(), ids=VALUES)
def test_a_lock_of_big_endian_numbers_keeps_their_values(device: Device, values: NDArray[Any]) -> None:
    with device.buffer(big_endian(values)) as buffer:
        with buffer.lock(Access.READ_WRITE) as array:
            assert array.tobytes() == values.tobytes()
            array[0] = big_endian(values)[-1]
        assert buffer.read(0, 1).tobytes() == values[-1:].tobytes()


# -- shaders -----------------------------------------------------------------------------------------------


class Sample(sl.Struct):
    weight: float
    direction: sl.vec3
    ids: sl.uvec2
    turn: sl.mat3


class Halved(sl.Shader):
    """Writes what it reads of each kind of element."""

    scale: sl.Uniform[float]
    offset: sl.Uniform[sl.vec3]
    turned: sl.Uniform[sl.mat4]
    record: sl.Uniform[Sample]
    floats: sl.Storage[float]
    whole: sl.Storage[int]
    naturals: sl.Storage[sl.uvec2]
    corners: sl.Storage[sl.vec3]
    samples: sl.Storage[Sample]
    results: sl.StorageRW[float]

    def compute(self) -> None:
        self.results[0] = self.scale
        self.results[1] = self.offset.z
        self.results[2] = (self.turned @ sl.vec4(0.0, 0.0, 1.0, 0.0)).y
        self.results[3] = self.record.direction.y + float(self.record.ids.y)
        self.results[4] = self.floats[1]
        self.results[5] = float(self.whole[1])
        self.results[6] = float(self.naturals[1].y)
        self.results[7] = self.corners[1].z
        self.results[8] = self.samples[1].weight + self.samples[1].direction.z
        self.results[9] = float(self.samples[1].ids.x) + (self.samples[1].turn @ sl.vec3(0.0, 1.0, 0.0)).x


RESULTS = [0.5, 3.0, 6.0, 2.0 + 9.0, 2.5, -5.0, 1_000_000.0, 6.5, 0.125 + 3.0, 8.0 + 1.0]
STORED: dict[str, tuple[Any, NDArray[Any]]] = {
    "floats": (float, np.array([1.0, 2.5], "f4")),
    "whole": (int, np.array([7, -5], "i4")),
    "naturals": (sl.uvec2, np.array([[1, 2], [3, 1_000_000]], "u4")),
    "corners": (sl.vec3, np.array([[1, 2, 3, 0], [4.5, 5.5, 6.5, 0]], "f4")),
}


def make_samples(dtype: np.dtype[Any]) -> NDArray[Any]:
    samples = np.zeros(2, dtype)
    samples["weight"], samples["direction"][..., :3], samples["ids"] = 0.125, [1.0, 2.0, 3.0], [8, 9]
    samples["turn"][..., :3] = np.arange(9).reshape(3, 3)
    return samples


def store_array(device: Device, element: Any, values: NDArray[Any]) -> Any:
    return device.storage(element, big_endian(values))


def store_buffer(device: Device, element: Any, values: NDArray[Any]) -> Any:
    return device.storage(element, device.buffer(big_endian(values)))


def store_later(device: Device, element: Any, values: NDArray[Any]) -> Any:
    stored = device.storage(element, len(values))
    stored.write(big_endian(values))
    return stored


def store_for_a_frame(device: Device, element: Any, values: NDArray[Any]) -> Any:
    return device.transient.storage(element, big_endian(values))


def store_plainly(device: Device, element: Any, values: NDArray[Any]) -> Any:
    return device.storage(element, values)


@runs_compute
@pytest.mark.parametrize(
    "store",
    [store_array, store_buffer, store_later, store_for_a_frame, store_plainly],
    ids=lambda f: f.__name__,
)
def test_shaders_read_equal_numbers(device: Device, store: Callable[..., Any]) -> None:
    """In storage and in uniforms, for every kind of element; the last way is the control."""
    order: Callable[[Any], Any] = np.asarray if store is store_plainly else big_endian
    turned = np.arange(16, dtype="f4").reshape(4, 4)
    record_array = device.uniform_array(Sample, 2)
    record_array.write(order(make_samples(record_array.dtype)))
    with device.storage(float, len(RESULTS)) as results:
        device.dispatch(
            device.program(Halved),
            1,
            scale=order(np.array(0.5, "f4"))[()],
            offset=order(np.array([1, 2, 3], "f4")),
            turned=device.uniform(order(turned)),
            record=record_array[1],
            samples=store(device, Sample, make_samples(Sample.dtype)),
            results=results,
            **{name: store(device, *stored) for name, stored in STORED.items()},
        )
        assert_same(results.read(), RESULTS)


@runs_compute
@pytest.mark.requires("max_storage_slots")
def test_an_indirect_dispatch_reads_equal_numbers(device: Device) -> None:
    with device.storage(sl.uint, 1) as total, device.buffer(big_endian(np.array([3, 2, 1], "u4"))) as groups:
        device.dispatch_indirect(device.program(Counted), groups, 0, total=total)
        assert_same(total.read(), 6)


class Counted(sl.Shader):
    """Counts its work-groups."""

    total: sl.StorageRW[sl.uint]

    def compute(self) -> None:
        sl.atomic_add(self.total[0], sl.uint(1))


# -- meshes ------------------------------------------------------------------------------------------------


class Vertex(sl.Struct):
    position: sl.vec2
    pair: sl.vec2
    whole: sl.ivec2
    natural: sl.uvec2


class VertexVarying(sl.Struct):
    clip: sl.vec4
    shade: sl.Flat[sl.vec4]


class Numbered(sl.Shader):
    """Points that show their attributes."""

    def vertex(self, v: Vertex) -> VertexVarying:
        shade = sl.vec4(v.pair.x, v.pair.y, float(v.whole.y), float(v.natural.y))
        return VertexVarying(clip=sl.vec4(v.position, 0.5, 1.0), shade=shade)

    def fragment(self, v: VertexVarying) -> sl.vec4:
        return v.shade


def make_vertices(pair: str, natural: str) -> NDArray[Any]:
    """Return four vertices, one at the centre of each texel."""
    vertices = np.zeros(
        4, [("position", "f4", 2), ("pair", pair, 2), ("whole", "i4", 2), ("natural", natural, 2)]
    )
    vertices["position"][:, 0] = (np.arange(4) + 0.5) / 2 - 1
    vertices["pair"] = np.arange(8).reshape(4, 2) * 21
    vertices["whole"], vertices["natural"] = [[1, -70], [2, 3], [4, 5], [6, 7]], [1000, 260]
    return vertices


def expect_shades(vertices: NDArray[Any]) -> NDArray[np.float64]:
    """The expected shades of the points, (4, 4)."""
    pair = vertices["pair"].astype(np.float64)
    if vertices["pair"].dtype.kind in "iu":  # normalised
        pair /= np.iinfo(vertices["pair"].dtype).max
    return np.column_stack([pair, vertices["whole"][:, 1], vertices["natural"][:, 1]])


def by_name(vertices: NDArray[Any]) -> dict[str, Any]:
    return {name: vertices[name] for name in vertices.dtype.names or ()}


def show(device: Device, draw: Callable[[], object]) -> NDArray[Any]:
    """Return the row of texels that a draw shows."""
    with device.texture(SIZE, Format.RGBA32F) as image:
        with device.render_pass(image, clear=(0, 0, 0, 0)):
            draw()
        return np.asarray(image.read()[0])


@draws_shaders
@pytest.mark.parametrize(
    "source", ["array", "arrays by name", "buffer", "transient", "immediate", "instances"]
)
@pytest.mark.parametrize("natural", ["u4", "u2"])
@pytest.mark.parametrize("pair", ["f4", "f2", "u2", "i2"])
def test_vertices_are_equal_numbers(device: Device, pair: str, natural: str, source: str) -> None:
    vertices = make_vertices(pair, natural)
    big, program = big_endian(vertices), device.program(Numbered)

    def draw() -> None:
        if source == "immediate":
            with device.immediate(program, Primitive.POINTS) as points:
                points.vertices(big)
            return
        mesh: Any
        if source == "transient":
            mesh = device.transient.mesh(program, big, primitive=Primitive.POINTS)
        elif source == "instances":
            mesh = device.mesh(1, instances=big, primitive=Primitive.POINTS)
        else:
            sources: dict[str, Any] = {"array": big, "arrays by name": by_name(big)}
            sources["buffer"] = device.buffer(big)
            mesh = device.mesh(sources[source], primitive=Primitive.POINTS)
        device.draw(program, mesh, 4 if source == "instances" else 1)

    assert_near(show(device, draw), expect_shades(vertices), 1e-6, "normalised integers")


def list_indices(values: list[int], code: str) -> NDArray[Any]:
    restart = np.iinfo(code).max
    return np.array([restart if value < 0 else value for value in values], code)


def mesh_of(device: Device, indices: NDArray[Any] | Buffer, primitive: Primitive) -> Mesh:
    return device.mesh(make_vertices("f4", "u4"), indices, primitive=primitive)


@draws_shaders
@pytest.mark.parametrize("code", ["u2", "u4", "i4", "i8"])
def test_indices_are_equal_numbers(device: Device, code: str) -> None:
    indices = np.array([0, 2, 3], code)
    expected = expect_shades(make_vertices("f4", "u4")) * np.array([1, 0, 1, 1])[:, None]
    for order in (big_endian, np.asarray):
        mesh = mesh_of(device, order(indices), Primitive.POINTS)
        assert_same(show(device, partial(device.draw, device.program(Numbered), mesh)), expected)


@draws_shaders
@pytest.mark.parametrize("in_buffer", [False, True], ids=["array", "buffer"])
@pytest.mark.parametrize("code", ["u2", "u4"])
def test_the_largest_index_restarts_in_either_order(device: Device, code: str, in_buffer: bool) -> None:
    """A line strip of two lines, from the first vertex to the second and from the third to the fourth."""
    indices, images = list_indices([0, 1, -1, 2, 3], code), []
    for order in (big_endian, np.asarray):
        source: Any = device.buffer(order(indices)) if in_buffer else order(indices)
        mesh = mesh_of(device, source, Primitive.LINE_STRIP)
        images.append(show(device, partial(device.draw, device.program(Numbered), mesh)))
    assert images[1].any()
    assert_same(images[0], images[1])


@draws_shaders
@pytest.mark.parametrize("indexed", [False, True], ids=["vertices", "indices"])
@pytest.mark.parametrize("way", ["draw_many", "draw_clipped", "draw_indirect"])
def test_arguments_of_draws_are_equal_numbers(device: Device, way: str, indexed: bool) -> None:
    vertices, program = make_vertices("f4", "u4"), device.program(Numbered)
    indices = np.arange(4) if indexed else None
    mesh = device.mesh(vertices, indices, primitive=Primitive.POINTS)
    draws, clips = mesh.draws([1, 3], 1), np.array([(0, 0, 4, 1), (3, 0, 1, 1)], "i4")

    def draw() -> None:
        if way == "draw_many":
            device.draw_many(program, mesh, big_endian(draws))
        elif way == "draw_clipped":
            device.draw_clipped(program, mesh, big_endian(draws), big_endian(clips))
        else:
            device.draw_indirect(program, mesh, IndirectDraws(device.buffer(big_endian(draws)), 2))

    assert_same(show(device, draw), expect_shades(vertices) * np.array([0, 1, 0, 1])[:, None])


@draws_shaders
@pytest.mark.requires("indirect_count")
def test_a_number_of_draws_is_an_equal_number(device: Device) -> None:
    vertices, program = make_vertices("f4", "u4"), device.program(Numbered)
    mesh = device.mesh(vertices, primitive=Primitive.POINTS)
    draws, count = device.buffer(mesh.draws([0, 1, 2], 1)), device.buffer(big_endian(np.array([2], "u4")))
    image = show(device, lambda: device.draw_indirect(program, mesh, IndirectDraws(draws, 3, count=count)))
    assert_same(image, expect_shades(vertices) * np.array([1, 1, 0, 0])[:, None])


# -- textures ----------------------------------------------------------------------------------------------


WIDE_FORMATS = [color_format for color_format in COLOR_FORMATS if color_format.dtype.itemsize > 1]


@pytest.mark.parametrize("format", WIDE_FORMATS, ids=lambda format: format.name)
def test_texels_are_equal_numbers(device: Device, format: Format) -> None:
    if format in device.capabilities.unsupported_formats:
        pytest.skip(f"{format.name} isn't supported")
    texels = squeezed(format, random_texels(format, 3, 5))
    with device.texture(big_endian(texels), format) as texture, device.texture((5, 3), format) as written:
        written.write(big_endian(texels))
        assert_same(texture.read(), texels)
        assert_same(written.read(), texels)


@pytest.mark.parametrize("code", ["u2", "f2", "f4", "u4", "i4"])
@pytest.mark.parametrize("shape", [(2, 3), (2, 3, 2), (2, 3, 4), (4, 2, 3, 4)], ids=str)
def test_a_format_follows_from_either_order(device: Device, code: str, shape: tuple[int, ...]) -> None:
    if code == "u2":
        formats = {1: Format.R16, 2: Format.RG16, 4: Format.RGBA16}
        require_format(device, formats[shape[-1] if len(shape) > 2 else 1])
    texels = np.arange(np.prod(shape)).reshape(shape).astype(code)
    kind = TextureKind.D2_ARRAY if len(shape) == 4 else TextureKind.D2
    with device.texture(big_endian(texels), kind=kind) as texture, device.texture(texels, kind=kind) as same:
        assert texture.format is same.format
        assert_same(texture.read_layers(), same.read_layers())
