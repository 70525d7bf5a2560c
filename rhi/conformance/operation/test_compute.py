"""Compute: storage, images, uniform layouts, shared memory, barriers, atomics, dispatches."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import rhi.shading as sl
from rhi import Device, Format, TextureKind
from rhi.conformance.compare import assert_near, assert_same
from rhi.conformance.formats import random_texels, require_images, squeezed
from rhi.conformance.reference import encode, rounding
from rhi.contract.formats import COLOR_FORMATS, ChannelKind

pytestmark = [pytest.mark.requires("shading", "compute"), pytest.mark.recorded_too]


# -- dispatches --------------------------------------------------------------------------------------------


class InvocationIndices(sl.Shader):
    """Writes the indices of each invocation."""

    work_group = (4, 2, 1)
    global_indices: sl.StorageRW[sl.uvec4]
    local_indices: sl.StorageRW[sl.uvec4]

    def compute(self) -> None:
        g = sl.global_id()
        width = sl.group_count().x * 4
        height = sl.group_count().y * 2
        i = g.x + width * (g.y + height * g.z)
        self.global_indices[i] = sl.uvec4(
            sl.uint(sl.group_id().x), sl.uint(sl.group_id().y), sl.uint(sl.group_id().z), sl.uint(i)
        )
        self.local_indices[i] = sl.uvec4(
            sl.uint(sl.local_id().x),
            sl.uint(sl.local_id().y),
            sl.uint(sl.local_id().z),
            sl.uint(sl.local_index()),
        )


@pytest.mark.parametrize("groups", [(1, 1, 1), (3, 1, 1), (1, 5, 1), (1, 1, 4), (3, 2, 2)], ids=str)
def test_every_invocation_runs_once_and_reads_its_indices(
    device: Device, groups: tuple[int, int, int]
) -> None:
    shape = (groups[2], groups[1] * 2, groups[0] * 4)
    count = int(np.prod(shape))
    with device.storage(sl.uvec4, count) as where, device.storage(sl.uvec4, count) as local:
        device.dispatch(device.program(InvocationIndices), groups, global_indices=where, local_indices=local)
        group, inside = where.read().reshape(*shape, 4), local.read().reshape(*shape, 4)
    z, y, x = np.indices(shape)
    assert_same(group, np.stack([x // 4, y // 2, z, np.arange(count).reshape(shape)], axis=-1))
    assert_same(inside, np.stack([x % 4, y % 2, z * 0, x % 4 + 4 * (y % 2)], axis=-1))


class Count(sl.Shader):
    """Counts its invocations."""

    work_group = (8,)
    total: sl.StorageRW[sl.uint]

    def compute(self) -> None:
        sl.atomic_add(self.total[0], sl.uint(1))


@pytest.mark.parametrize(
    ("groups", "expected"), [(5, 40), ((2, 3), 48), ((2, 2, 2), 64), (0, 0), ((4, 0), 0)]
)
def test_a_number_of_groups_has_one_to_three_dimensions(device: Device, groups: Any, expected: int) -> None:
    with device.storage(sl.uint, 1) as total:
        device.dispatch(device.program(Count), groups, total=total)
        assert_same(total.read(), expected)


@pytest.mark.parametrize("words", [(3, 1, 1), (2, 2, 2), (0, 1, 1)], ids=str)
def test_an_indirect_dispatch_reads_its_groups(device: Device, words: tuple[int, int, int]) -> None:
    with device.storage(sl.uint, 1) as total, device.buffer(np.array([9, *words, 9], "u4")) as arguments:
        device.dispatch_indirect(device.program(Count), arguments, 4, total=total)
        assert_same(total.read(), 8 * np.prod(words))


class ArgumentChecker(sl.Shader):
    """Writes the arguments of a later dispatch."""

    words: sl.StorageRW[sl.uint]

    def compute(self) -> None:
        self.words[0] = sl.uint(3)
        self.words[1] = sl.uint(2)
        self.words[2] = sl.uint(1)


def test_an_indirect_dispatch_sees_the_writes_of_an_earlier_dispatch(device: Device) -> None:
    with device.storage(sl.uint, 1) as total, device.storage(sl.uint, 3) as arguments:
        device.dispatch(device.program(ArgumentChecker), 1, words=arguments)
        device.dispatch_indirect(device.program(Count), arguments, 0, total=total)
        assert_same(total.read(), 48)


def test_dispatches_are_counted(device: Device) -> None:
    device.reset_statistics()
    with device.storage(sl.uint, 1) as total:
        device.dispatch(device.program(Count), 1, total=total)
        device.dispatch(device.program(Count), 1, total=total)
    assert device.statistics.dispatches == 2


# -- layouts -----------------------------------------------------------------------------------------------


class Inner(sl.Struct):
    """A struct inside a struct."""

    weight: float
    axis: sl.vec3


class Mixed(sl.Struct):
    """The field types that std140 and std430 lay out differently."""

    a: float
    b: sl.vec3
    c: float
    d: sl.vec2
    e: sl.mat3
    f: sl.Array[float] = sl.array(float, 3)
    g: int
    h: Inner
    i: sl.Array[sl.vec3] = sl.array(sl.vec3, 2)
    j: sl.uint
    k: sl.mat4
    m: sl.mat2
    n: sl.uvec3
    o: sl.Array[Inner] = sl.array(Inner, 2)
    p: sl.ivec2
    q: sl.Array[sl.mat3] = sl.array(sl.mat3, 2)


class ReadMixed(sl.Shader):
    """Reads one number of each field, from a uniform and from storage."""

    constants: sl.Uniform[Mixed]
    rows: sl.Storage[Mixed]
    results: sl.StorageRW[sl.vec4]

    def compute(self) -> None:
        c = self.constants
        r = self.rows[1]
        self.results[0] = sl.vec4(c.a, c.b.z, c.c, c.d.y)
        self.results[1] = sl.vec4(c.e[1][2], c.f[2], float(c.g), c.h.weight)
        self.results[2] = sl.vec4(c.h.axis.y, c.i[1].z, float(c.j), c.k[3][1])
        self.results[3] = sl.vec4(c.m[1][0], float(c.n.z), c.o[1].weight, c.o[1].axis.z)
        self.results[4] = sl.vec4(float(c.p.y), c.q[0][2][1], c.q[1][1][2], float(len(c.q)))
        self.results[5] = sl.vec4(r.a, r.b.z, r.c, r.d.y)
        self.results[6] = sl.vec4(r.e[1][2], r.f[2], float(r.g), r.h.weight)
        self.results[7] = sl.vec4(r.h.axis.y, r.i[1].z, float(r.j), r.k[3][1])
        self.results[8] = sl.vec4(r.m[1][0], float(r.n.z), r.o[1].weight, r.o[1].axis.z)
        self.results[9] = sl.vec4(float(r.p.y), r.q[0][2][1], r.q[1][1][2], float(len(r.q)))


MIXED: dict[str, Any] = {
    "a": 1.0,
    "b": (2.0, 3.0, 4.0),
    "c": 5.0,
    "d": (6.0, 7.0),
    "e": np.arange(9.0).reshape(3, 3) + 10,
    "f": (20.0, 21.0, 22.0),
    "g": -23,
    "i": ((30.0, 31.0, 32.0), (33.0, 34.0, 35.0)),
    "j": 40,
    "k": np.arange(16.0).reshape(4, 4) + 50,
    "m": np.arange(4.0).reshape(2, 2) + 70,
    "n": (74, 75, 76),
    "p": (-77, 78),
    "q": np.arange(18.0).reshape(2, 3, 3) + 80,
}


def test_structs_lie_where_their_dtype_says(device: Device) -> None:
    inner = [
        Inner(weight=weight, axis=(weight + 1, weight + 2, weight + 3)) for weight in (24.0, 100.0, 104.0)
    ]
    value = Mixed(**MIXED, h=inner[0], o=inner[1:])
    rows: Any = np.zeros(3, Mixed.dtype)
    for name, part in MIXED.items():
        rows[name][(1, *map(slice, np.shape(part)))] = part
    for name in ("weight", "axis"):
        rows["h"][name][1] = getattr(inner[0], name)
        rows["o"][name][1] = [getattr(field, name) for field in inner[1:]]
    expected = [(1, 4, 5, 7), (15, 22, -23, 24), (26, 35, 40, 63), (72, 76, 104, 107), (78, 87, 94, 2)] * 2
    with (
        device.uniform(value) as constants,
        device.storage(Mixed, rows) as storage,
        device.storage(sl.vec4, 10) as results,
    ):
        device.dispatch(device.program(ReadMixed), 1, constants=constants, rows=storage, results=results)
        assert_same(results.read(), expected)


class Matrices(sl.Struct):
    """Matrices of each size, and nothing nested."""

    two: sl.mat2
    three: sl.mat3
    four: sl.mat4


class ReadMatrices(sl.Shader):
    """Reads a struct as a whole, and matrices, a row and a number of another one."""

    matrices: sl.Storage[Matrices]
    results: sl.StorageRW[sl.vec4]

    def compute(self) -> None:
        thing, v = self.matrices[0], sl.vec4(1.0, 2.0, 3.0, 4.0)
        self.results[0] = sl.vec4(thing.two @ v.xy, self.matrices[1].two[1])
        self.results[1] = sl.vec4(thing.three @ v.xyz, self.matrices[1].three[1][2])
        self.results[2] = sl.vec4(self.matrices[1].three @ v.xyz, self.matrices[1].two[0][1])
        self.results[3] = thing.four[2] + self.matrices[1].four @ v


def test_matrices_that_are_only_read_have_their_rows_in_order(device: Device) -> None:
    rows: Any = np.zeros(2, Matrices.dtype)
    (a, b), (c, d), (e, f) = values = [np.arange(2.0 * n * n).reshape(2, n, n) for n in (2, 3, 4)]
    for name, value in zip(("two", "three", "four"), values, strict=True):
        rows[name][:, :, : value.shape[2]] = value
    expected = [
        (*a @ (1, 2), *b[1]),
        (*c @ (1, 2, 3), d[1, 2]),
        (*d @ (1, 2, 3), b[0, 1]),
        e[2] + f @ (1, 2, 3, 4),
    ]
    with device.storage(Matrices, rows) as matrices, device.storage(sl.vec4, 4) as results:
        device.dispatch(device.program(ReadMatrices), 1, matrices=matrices, results=results)
        assert_same(results.read(), expected)


class WriteMixed(sl.Shader):
    """Fills a struct in storage."""

    rows: sl.StorageRW[Mixed]

    def compute(self) -> None:
        i = sl.global_id().x
        self.rows[i].a = float(i)
        self.rows[i].b = sl.vec3(1.0, 2.0, 3.0)
        self.rows[i].d = sl.vec2(4.0, 5.0)
        self.rows[i].f[1] = 6.0
        self.rows[i].h.axis = sl.vec3(7.0, 8.0, 9.0)
        for column in range(4):
            self.rows[i].k[2][column] = float(10 + column)


@pytest.mark.parametrize(
    ("select", "expected"),
    [
        pytest.param(lambda rows: rows["a"], [0, 1, 2], id="number"),
        pytest.param(lambda rows: rows["b"], (1, 2, 3), id="vector of three"),
        pytest.param(lambda rows: rows["c"], 0, id="field that is left out"),
        pytest.param(lambda rows: rows["d"], (4, 5), id="vector of two"),
        pytest.param(lambda rows: rows["f"][:, :3], (0, 6, 0), id="element of an array"),
        pytest.param(lambda rows: rows["h"]["axis"], (7, 8, 9), id="field of a struct"),
        pytest.param(lambda rows: rows["k"][:, 2], (10, 11, 12, 13), id="row of a matrix"),
        pytest.param(lambda rows: rows["k"][:, [0, 1, 3]], 0, id="other rows of a matrix"),
    ],
)
def test_structs_are_written_where_their_dtype_says(
    device: Device, select: Callable[[NDArray[Any]], Any], expected: Any
) -> None:
    with device.storage(Mixed, 3) as storage:
        device.dispatch(device.program(WriteMixed), 3, rows=storage)
        assert_same(select(storage.read()), expected)


class Lengths(sl.Shader):
    """Writes the number of bound elements."""

    first: sl.Storage[sl.vec4]
    second: sl.Storage[sl.uint]
    third: sl.Storage[Inner]
    results: sl.StorageRW[sl.uint]

    def compute(self) -> None:
        self.results[0] = sl.uint(len(self.first))
        self.results[1] = sl.uint(len(self.second))
        self.results[2] = sl.uint(len(self.third))


def test_a_storage_buffer_knows_its_length(device: Device) -> None:
    with (
        device.storage(sl.vec4, 5) as first,
        device.storage(sl.uint, 7) as second,
        device.storage(Inner, 3) as third,
        device.storage(sl.uint, 3) as results,
    ):
        device.dispatch(device.program(Lengths), 1, first=first, second=second, third=third, results=results)
        assert_same(results.read(), [5, 7, 3])


class Pick(sl.Struct):
    """A number."""

    value: float


class ReadPick(sl.Shader):
    """Copies a uniform's number."""

    pick: sl.Uniform[Pick]
    results: sl.StorageRW[float]

    def compute(self) -> None:
        self.results[0] = self.pick.value


def test_each_element_of_a_uniform_array_is_bound_by_itself(device: Device) -> None:
    with device.uniform_array(Pick, 20) as picks, device.storage(float, 1) as results:
        rows = np.zeros(20, picks.dtype)
        rows["value"] = np.arange(20) * 1.5
        picks.write(rows)
        for index in (0, 1, 19):
            device.dispatch(device.program(ReadPick), 1, pick=picks[index], results=results)
            assert_same(results.read(), index * 1.5)


def test_a_uniform_written_between_dispatches_holds_for_the_later_one(device: Device) -> None:
    with (
        device.uniform(Pick(value=1.0)) as pick,
        device.storage(float, 1) as first,
        device.storage(float, 1) as second,
    ):
        device.dispatch(device.program(ReadPick), 1, pick=pick, results=first)
        pick.write(Pick(value=2.0))
        device.dispatch(device.program(ReadPick), 1, pick=pick, results=second)
        assert_same(first.read(), 1)
        assert_same(second.read(), 2)


def test_a_storage_view_of_a_buffer_shares_its_memory(device: Device) -> None:
    with device.buffer(np.arange(4, dtype="u4")) as buffer:
        total = device.storage(sl.uint, buffer)
        device.dispatch(device.program(Count), 2, total=total)
        assert_same(buffer.read(), [16, 1, 2, 3])


# -- shared memory and barriers ----------------------------------------------------------------------------


class PrefixSum(sl.Shader):
    """A scan over a work-group, which is wrong unless every barrier works."""

    work_group = (64,)
    values: sl.Storage[sl.uint]
    results: sl.StorageRW[sl.uint]
    partial = sl.shared(sl.uint, 64)

    def compute(self) -> None:
        i = sl.local_index()
        self.partial[i] = self.values[sl.global_id().x]
        sl.barrier()
        step = 1
        while step < 64:
            before = sl.uint(0)
            if i >= step:
                before = self.partial[i - step]
            sl.barrier()
            self.partial[i] += before
            sl.barrier()
            step *= 2
        self.results[sl.global_id().x] = self.partial[i]


def test_a_work_group_sees_its_shared_memory_after_a_barrier(device: Device) -> None:
    values = np.random.default_rng(0).integers(0, 1000, 256).astype("u4")
    with device.storage(sl.uint, values) as source, device.storage(sl.uint, 256) as results:
        device.dispatch(device.program(PrefixSum), 4, values=source, results=results)
        assert_same(results.read(), values.reshape(4, 64).cumsum(axis=1).reshape(-1))


class SharedCount(sl.Shader):
    """An atomic counter in shared memory."""

    work_group = (32,)
    results: sl.StorageRW[sl.uint]
    total = sl.shared(sl.uint)

    def compute(self) -> None:
        if sl.local_index() == 0:
            self.total = sl.uint(0)
        sl.barrier()
        sl.atomic_add(self.total, sl.uint(sl.local_index()))
        sl.barrier()
        if sl.local_index() == 0:
            self.results[sl.group_id().x] = self.total


def test_atomics_work_in_shared_memory(device: Device) -> None:
    with device.storage(sl.uint, 3) as results:
        device.dispatch(device.program(SharedCount), 3, results=results)
        assert_same(results.read(), 32 * 31 // 2)


# -- atomics -----------------------------------------------------------------------------------------------


class Atomics(sl.Shader):
    """Every atomic operation, from 256 invocations."""

    work_group = (64,)
    signed: sl.StorageRW[int]
    unsigned: sl.StorageRW[sl.uint]
    order: sl.StorageRW[sl.uint]

    def compute(self) -> None:
        i = sl.global_id().x
        u = sl.uint(i)
        sl.atomic_add(self.signed[0], 2 - i)
        sl.atomic_min(self.signed[1], 100 - i)
        sl.atomic_max(self.signed[2], i - 100)
        sl.atomic_add(self.unsigned[0], u)
        sl.atomic_min(self.unsigned[1], u + sl.uint(7))
        sl.atomic_max(self.unsigned[2], u)
        sl.atomic_or(self.unsigned[3], u)
        sl.atomic_and(self.unsigned[4], ~u)
        sl.atomic_xor(self.unsigned[5], u)
        sl.atomic_compare_exchange(self.unsigned[6], sl.uint(5), u + sl.uint(1000))
        mine = sl.atomic_add(self.unsigned[7], sl.uint(1))
        self.order[mine] = u
        sl.atomic_exchange(self.unsigned[8], sl.uint(42))


def test_atomics_lose_nothing(device: Device) -> None:
    i = np.arange(256)
    signed = np.array([0, 1000, -1000], "i4")
    unsigned = np.array([0, 1 << 31, 0, 0, 0xFFFFFFFF, 0, 5, 0, 0], "u4")
    with (
        device.storage(int, signed) as a,
        device.storage(sl.uint, unsigned) as b,
        device.storage(sl.uint, 256) as order,
    ):
        device.dispatch(device.program(Atomics), 4, signed=a, unsigned=b, order=order)
        assert_same(a.read(), [(2 - i).sum(), 100 - 255, 155])
        result = b.read()
        assert_same(result[:6], [i.sum(), 7, 255, 255, 0xFFFFFF00, np.bitwise_xor.reduce(i)])
        assert 1000 <= result[6] < 1256, "exactly one invocation replaced the 5"
        assert_same(result[7:], [256, 42])
        assert_same(np.sort(order.read()), i)


# -- images ------------------------------------------------------------------------------------------------


def image_copy(pixel_format: Format, annotation: Any) -> Any:
    class Copy(sl.Shader):
        source: annotation = sl.image(pixel_format)
        target: annotation = sl.image(pixel_format)

        def compute(self) -> None:
            at = sl.global_id().xy
            self.target.store(at, self.source.load(at))

    return Copy


IMAGES: dict[ChannelKind, Any] = {ChannelKind.UINT: sl.UintImage2D, ChannelKind.INT: sl.IntImage2D}


@pytest.mark.parametrize(
    "format", [f for f in COLOR_FORMATS if f.kind is not ChannelKind.SRGB], ids=lambda f: f.name
)
@pytest.mark.requires("max_image_slots")
def test_an_image_is_loaded_and_stored_in_its_format(device: Device, format: Format) -> None:
    require_images(device, format)
    data = random_texels(format, 3, 5)
    if format is Format.R11G11B10F:  # a store may flush denormals: exponents of 0 become 1
        for shift, bits in ((0, 6), (11, 6), (22, 5)):
            data |= ((data >> shift + bits & 31) == 0).astype(np.uint32) << shift + bits
    plain = squeezed(format, data)
    with device.texture(plain, format) as source, device.texture((5, 3), format) as target:
        program = device.program(image_copy(format, IMAGES.get(format.kind, sl.Image2D)))
        device.dispatch(program, (5, 3), source=source.image(), target=target.image())
        assert_same(target.read(), plain)
        program.destroy()


class StoreColor(sl.Shader):
    """Stores a color in an image of 8 bits."""

    target: sl.Image2D = sl.image(Format.RGBA8)

    def compute(self) -> None:
        self.target.store(sl.global_id().xy, sl.vec4(0.2, 0.5, -3.0, 7.0))


@pytest.mark.requires("max_image_slots")
def test_a_stored_color_is_converted(device: Device) -> None:
    with device.texture((2, 2), Format.RGBA8) as target:
        device.dispatch(device.program(StoreColor), (2, 2), target=target.image())
        expected = encode(Format.RGBA8, (0.2, 0.5, -3.0, 7.0))
        assert_near(target.read(), expected, *rounding(Format.RGBA8, expected))


@pytest.mark.requires("max_image_slots")
def test_stores_beyond_the_edge_do_nothing(device: Device) -> None:
    with device.texture((3, 3), Format.RGBA8) as target, device.texture((3, 3), Format.RGBA8) as other:
        device.dispatch(device.program(StoreColor), (8, 8), target=target.image())
        assert_same(target.read()[..., 3], 255)
        assert_same(other.read(), 0)


@pytest.mark.requires("max_image_slots")
def test_one_level_is_an_image(device: Device) -> None:
    with device.texture((8, 8), Format.RGBA8, levels=3) as target:
        device.dispatch(device.program(StoreColor), (8, 8), target=target.image(1))
        assert_same(target.read(0), 0)
        assert_same(target.read(1)[..., 3], 255)
        assert_same(target.read(2), 0)


@pytest.mark.requires("max_image_slots")
@pytest.mark.parametrize("layer", range(3))
def test_one_layer_is_an_image(device: Device, layer: int) -> None:
    with device.texture((2, 2), Format.RGBA8, kind=TextureKind.D2_ARRAY, layers=3) as target:
        device.dispatch(device.program(StoreColor), (2, 2), target=target.image(0, layer))
        stored = np.arange(3) == layer
        assert_same(target.read_layers()[..., 3], np.where(stored, 255, 0)[:, None, None])


class StoreLayers(sl.Shader):
    """Stores its number in each texel of an array, counted across rows and layers."""

    target: sl.Image2DArray = sl.image(Format.R32F)

    def compute(self) -> None:
        at = sl.global_id()
        size = self.target.size()
        self.target.store(at, sl.vec4(float(at.x + size.x * (at.y + size.y * at.z))))


class StoreVolume(sl.Shader):
    """Stores its number in each texel of a volume, counted across rows and slices."""

    target: sl.Image3D = sl.image(Format.R32F)

    def compute(self) -> None:
        at = sl.global_id()
        size = self.target.size()
        self.target.store(sl.ivec3(at.x, at.y, at.z), sl.vec4(float(at.x + size.x * (at.y + size.y * at.z))))


@pytest.mark.parametrize(
    ("kind", "shader"),
    [(TextureKind.D2_ARRAY, StoreLayers), (TextureKind.D3, StoreVolume)],
    ids=["array", "3d"],
)
@pytest.mark.requires("max_image_slots")
def test_all_layers_are_an_image(device: Device, kind: TextureKind, shader: Any) -> None:
    with device.texture((3, 2), Format.R32F, kind=kind, layers=4) as target:
        device.dispatch(device.program(shader), (3, 2, 4), target=target.image())
        assert_same(target.read_layers(), np.arange(24).reshape(4, 2, 3, 1))


# -- order of dispatches and other commands ----------------------------------------------------------------


class Double(sl.Shader):
    """Computes 2x + 1 of the number x that another invocation of the previous dispatch wrote."""

    work_group = (32,)
    source: sl.Storage[sl.uint]
    target: sl.StorageRW[sl.uint]

    def compute(self) -> None:
        i = sl.global_id().x
        self.target[i] = self.source[(i + 37) % 256] * sl.uint(2) + sl.uint(1)


def test_a_dispatch_sees_the_writes_of_the_dispatch_before(device: Device) -> None:
    values = np.arange(256, dtype="u4")
    with device.storage(sl.uint, values) as a, device.storage(sl.uint, 256) as b:
        expected = values
        for _ in range(10):
            device.dispatch(device.program(Double), 8, source=a, target=b)
            device.dispatch(device.program(Double), 8, source=b, target=a)
            for _ in range(2):
                expected = np.roll(expected, -37) * np.uint32(2) + np.uint32(1)
        assert_same(a.read(), expected)


def test_copies_clears_and_writes_stay_in_order_among_dispatches(device: Device) -> None:
    with device.storage(sl.uint, 1) as total, device.buffer(4, np.dtype("u4")) as log:
        program = device.program(Count)
        device.dispatch(program, 1, total=total)
        total.owner.copy_to(log, target_offset=0)
        total.clear(100)
        device.dispatch(program, 1, total=total)
        total.owner.copy_to(log, target_offset=4)
        total.write(np.array([1000], "u4"))
        device.dispatch(program, 2, total=total)
        total.owner.copy_to(log, target_offset=8)
        assert_same(log.read(), [8, 108, 1016, 0])
