"""Stages give the same results as GLSL on the driver, on 16 lanes and with NumPy."""

from __future__ import annotations

import re
from functools import partial

import numpy as np
import pytest
import stage_runner

import rhi.shading as sl
from rhi.contract.descriptors import Stage

SHAPE = (12, 16)
ROWS, COLUMNS = np.mgrid[: SHAPE[0], : SHAPE[1]]
LANGUAGES = ["glsl", "lanes", "numpy 32", "numpy 64"]


@pytest.fixture(params=LANGUAGES)
def vertex_stage(request, context):
    """`vertex_stage(shader, attributes, count, …)` in each language."""
    dtype = np.float64 if "64" in request.param else np.float32
    return {
        "glsl": partial(stage_runner.run_vertex_glsl, context),
        "lanes": stage_runner.run_vertex_lanes,
    }.get(request.param, partial(stage_runner.run_vertex_numpy, dtype=dtype))


@pytest.fixture(params=LANGUAGES)
def fragment_stage(request, context):
    """`fragment_stage(shader, varyings, shape, …)` in each language."""
    dtype = np.float64 if "64" in request.param else np.float32
    return {
        "glsl": partial(stage_runner.run_fragment_glsl, context),
        "lanes": stage_runner.run_fragment_lanes,
    }.get(request.param, partial(stage_runner.run_fragment_numpy, dtype=dtype))


# -- vertices ----------------------------------------------------------------------------------------------


class Corner(sl.Struct):
    position: sl.vec3
    normal: sl.vec3
    joint: sl.ivec2
    color: sl.uint


class Instance(sl.Struct):
    scale: float


class Bone(sl.Struct):
    turn: sl.mat3
    offset: sl.vec3


class Skinned(sl.Struct):
    clip: sl.vec4
    normal: sl.vec3
    color: sl.Flat[sl.vec3]
    bones: sl.ivec2
    unread: sl.vec4


class Skinning(sl.Shader):
    camera: sl.Uniform[sl.mat4]
    bones: sl.Storage[Bone]
    uses: sl.StorageRW[int]

    def skin(self, p: sl.vec3, joint: int) -> sl.vec3:
        if joint < 0:
            return p
        return self.bones[joint].turn @ p + self.bones[joint].offset

    def vertex(self, v: Corner, n: Instance) -> Skinned:
        position = sl.vec3(0.0)
        for k in range(2):
            joint = v.joint[k]
            if joint >= 0:
                sl.atomic_add(self.uses[joint], 1)
            if joint == 3:
                break
            position += self.skin(v.position, joint) * 0.5
        number = float(sl.vertex_index() % 7 + 100 * sl.instance_index())
        color = sl.uvec3(
            v.color & sl.uint(255), (v.color >> sl.uint(8)) & sl.uint(255), v.color >> sl.uint(16)
        )
        return Skinned(
            clip=self.camera @ sl.vec4(position * n.scale, 1.0),
            normal=sl.normalize(sl.cross(v.normal, sl.vec3(1.0, 2.0, 3.0))) + number,
            color=sl.vec3(color) / 255.0,
            bones=v.joint,
            unread=sl.vec4(number),
        )

    def fragment(self, s: Skinned) -> sl.vec4:
        return sl.vec4(s.normal + s.color, float(s.bones.x + s.bones.y))


def test_vertex_stages_agree(vertex_stage):
    rng, count = np.random.default_rng(1), 45
    attributes = {
        "position": rng.normal(size=(count, 3)).astype("f4"),
        "normal": rng.normal(size=(count, 3)).astype("f4"),
        "joint": rng.integers(-1, 5, (count, 2)).astype("i4"),
        "color": rng.integers(0, 1 << 24, count).astype("u4"),
        "scale": rng.random(count).astype("f4"),
    }
    bones = np.zeros(5, Bone.dtype)
    bones["turn"][..., :3] = rng.normal(size=(5, 3, 3))
    bones["offset"] = rng.normal(size=(5, 3))
    camera = rng.normal(size=(4, 4)).astype("f4")
    out = vertex_stage(Skinning, attributes, count, instance=0, camera=camera, bones=bones, uses=5)
    position = np.zeros((count, 3))
    uses, ended = np.zeros(5, int), np.zeros(count, bool)
    for k in range(2):
        joint = attributes["joint"][:, k]
        np.add.at(uses, joint[(joint >= 0) & ~ended], 1)
        ended |= joint == 3
        p = attributes["position"]
        moved = np.einsum("nij,nj->ni", bones["turn"][joint, :, :3], p) + bones["offset"][joint]
        moved = np.where(joint[:, None] < 0, p, moved) * 0.5
        position += np.where(ended[:, None], 0, moved)
    position = np.c_[position * attributes["scale"][:, None], np.ones(count)]
    np.testing.assert_allclose(out["position"], position @ camera.T.astype("f8"), rtol=1e-4, atol=1e-5)
    side = np.cross(attributes["normal"], [1, 2, 3])
    side /= np.linalg.norm(side, axis=1)[:, None]
    np.testing.assert_allclose(out["normal"], side + (np.arange(count) % 7)[:, None], rtol=1e-5, atol=1e-6)
    color = attributes["color"][:, None] >> np.array([0, 8, 16]) & 255
    np.testing.assert_allclose(out["color"], color / 255, rtol=1e-6)
    np.testing.assert_array_equal(out["bones"], attributes["joint"])
    np.testing.assert_array_equal(out["uses"], uses)


class Pulled(sl.Shader):
    points: sl.Storage[sl.vec3]
    words: sl.Storage[int]
    marks: sl.StorageRW[int]

    def vertex(self) -> sl.vec4:
        i = sl.vertex_index()
        self.marks[i] = i + 1
        return sl.vec4(self.points[i].xy, float(self.words[i * 2 + 1] + i), float(sl.instance_index()))


CONSECUTIVE = np.arange(40) + 5


@pytest.mark.parametrize(
    "vertex",
    [CONSECUTIVE, CONSECUTIVE[::-1], np.random.default_rng(3).integers(0, 64, 40)],
    ids=["consecutive", "backwards", "scattered"],
)
def test_vertices_read_from_buffers_agree(vertex_stage, vertex):
    total = 64
    points = np.random.default_rng(4).random((total, 4), "f4")
    words = np.arange(2 * total, dtype="i4") ** 2
    out = vertex_stage(Pulled, {}, 40, vertices=vertex, instance=2, points=points, words=words, marks=total)
    expected = np.c_[points[vertex, :2], words[vertex * 2 + 1] + vertex, vertex * 0 + 2]
    np.testing.assert_array_equal(out["position"], expected)
    np.testing.assert_array_equal(
        out["marks"], np.where(np.isin(np.arange(total), vertex), np.arange(total) + 1, 0)
    )


def test_consecutive_vertices_are_read_with_vector_loads():
    assert (
        "rhi_load_global_4_0_of_4(points_," in sl.compile_shader(Pulled).emit("opencl16", Stage.VERTEX).text
    )


# -- fragments ---------------------------------------------------------------------------------------------


class Surface(sl.Struct):
    clip: sl.vec4
    uv: sl.vec2
    screen: sl.NoPerspective[sl.vec2]
    tint: sl.Flat[sl.vec3]
    id: int


class Targets(sl.Struct):
    color: sl.vec4
    id: int
    ids: sl.uvec3
    depth: sl.FragmentDepth


class Lit(sl.Shader):
    """Every kind of output and input; early returns; a local array; stores and atomics under masks."""

    scale: sl.Uniform[sl.vec3]
    table: sl.Storage[sl.vec4]
    hits: sl.StorageRW[int]

    def vertex(self) -> Surface:
        return Surface(clip=sl.vec4(0.0), uv=sl.vec2(0.0), screen=sl.vec2(0.0), tint=sl.vec3(0.0), id=0)

    def pick(self, x: float, y: float) -> sl.vec4:
        total = sl.vec4(0.0)
        for i in range(len(self.table)):
            if self.table[i].x > x:
                return self.table[i]
            total += self.table[i] * y
        return -total

    def fragment(self, s: Surface) -> Targets:
        at = sl.fragment_coordinate()
        row = int(at.y)
        column = int(at.x)
        counts = sl.array(int, 4)
        counts[column % 4] = row
        counts[s.id % 4] += 10
        if (row + column) % 5 == 0:
            return Targets(color=sl.vec4(1.0), id=-1, ids=sl.uvec3(7), depth=0.25)
        color = self.pick(s.uv.x, s.screen.y)
        if sl.front_facing():
            color.rgb = color.bgr * self.scale + s.tint
        n = 0
        while n < 6:
            n += 1
            if n * 3 > row:
                break
            if n % 2 == column % 2:
                continue
            color.w += 1.0
            sl.atomic_add(self.hits[0], 1)
        if row < 6:
            self.hits[1 + column] = 1
        sl.atomic_max(self.hits[20 + row], column * 2)
        return Targets(
            color=color,
            id=counts[1] + s.id,
            ids=sl.uvec3(sl.uint(row), sl.uint(column), sl.uint(n)),
            depth=at.x / 64.0,
        )


def lit(front, mask):
    """Return the results of `Lit`: color without rounding, id, ids, depth, hits."""
    table = table_of_lit().astype("f8")
    uv, screen = COLUMNS / 16 + 0.01, ROWS / 12.0
    color = np.zeros((*SHAPE, 4))
    rows, columns, n_of = ROWS, COLUMNS, np.zeros(SHAPE, int)
    hits = np.zeros(40, int)
    early = (ROWS + COLUMNS) % 5 == 0
    for r, c in np.ndindex(*SHAPE):
        total = np.zeros(4)
        for row in table:
            if row[0] > uv[r, c]:
                total = row.copy()
                break
            total += row * screen[r, c]
        else:
            total = -total
        if front:
            total[:3] = total[2::-1] * [1, 2, 3] + [0.5, 0.25, 0.125]
        n = 0
        while n < 6:
            n += 1
            if n * 3 > r:
                break
            if n % 2 == c % 2:
                continue
            total[3] += 1
            hits[0] += mask[r, c] and not early[r, c]
        n_of[r, c] = n
        color[r, c] = total
        if mask[r, c] and not early[r, c]:
            hits[1 + c] |= r < 6
            hits[20 + r] = max(hits[20 + r], c * 2)
    ids = np.stack([rows, columns, n_of], axis=-1)
    counts1 = np.where(columns % 4 == 1, rows, 0) + np.where(13 % 4 == 1, 10, 0)
    color[early], ids[early] = 1, 7
    return color, np.where(early, -1, counts1 + 13), ids, np.where(early, 0.25, (columns + 0.5) / 64), hits


def table_of_lit():
    table = np.random.default_rng(5).random((6, 4)).astype("f4")
    table[:, 0] = [0.1, 0.2, 0.4, 0.55, 0.7, 0.75]
    return table


@pytest.mark.parametrize("front", [True, False])
@pytest.mark.parametrize("covered", ["all", "part"])
def test_fragment_stages_agree(fragment_stage, front, covered):
    mask = (
        np.ones(SHAPE, bool) if covered == "all" else (ROWS > 2) & (ROWS < 9) & (COLUMNS > 4) & (COLUMNS < 11)
    )
    varyings = {
        "uv": np.stack([COLUMNS / 16 + 0.01, ROWS / 12], axis=-1).astype("f4"),
        "screen": np.stack([COLUMNS / 16, ROWS / 12], axis=-1).astype("f4"),
        "tint": np.array([0.5, 0.25, 0.125], "f4"),
        "id": np.array(13, "i4"),
    }
    out = fragment_stage(
        Lit,
        varyings,
        SHAPE,
        mask=mask,
        front=front,
        scale=np.array([1, 2, 3], "f4"),
        table=table_of_lit(),
        hits=40,
    )
    color, number, ids, depth, hits = lit(front, mask)
    np.testing.assert_array_equal(out["coverage"], mask)
    np.testing.assert_allclose(out["color"][mask], color[mask], rtol=2e-5, atol=2e-5)
    np.testing.assert_array_equal(out["id"][mask][:, 0], number[mask])
    np.testing.assert_array_equal(out["ids"][mask], ids[mask])
    np.testing.assert_allclose(out["depth"][mask], depth[mask], atol=1e-6)
    np.testing.assert_array_equal(out["hits"], hits)


class Plain(sl.Struct):
    clip: sl.vec4
    at: sl.vec2


class Sloped(sl.Shader):
    """Differences of inputs, of what is computed from them, of what is read from memory, within a called
    function."""

    table: sl.Storage[float]

    def vertex(self) -> Plain:
        return Plain(clip=sl.vec4(0.0), at=sl.vec2(0.0))

    def edge(self, x: float) -> float:
        return sl.fwidth(x) + sl.ddx(x * x)

    def fragment(self, v: Plain) -> sl.vec4:
        column = int(sl.fragment_coordinate().x)
        read = self.table[column]
        wave = sl.sin(v.at.x * 3.0) * v.at.y
        return sl.vec4(sl.ddx(v.at.x), sl.ddy(wave), self.edge(read), sl.length(sl.ddx(v.at)) + sl.ddy(2.0))


@pytest.mark.parametrize("covered", ["all", "part"])
def test_differences_agree(fragment_stage, covered, request):
    mask = np.ones(SHAPE, bool) if covered == "all" else (ROWS == 5) & (COLUMNS > 4) & (COLUMNS < 12)
    at = np.stack([COLUMNS / 16, ROWS / 12], axis=-1).astype("f4")
    table = np.arange(16, dtype="f4") ** 1.5
    out = fragment_stage(Sloped, {"at": at}, SHAPE, mask=mask, table=table)
    even = COLUMNS // 2 * 2
    wave = np.sin(COLUMNS / 16 * 3) / 12
    read = (table[even + 1] - table[even]) + (table[even + 1] ** 2 - table[even] ** 2)
    expected = np.stack([np.full(SHAPE, 1 / 16), wave, read, np.full(SHAPE, 1 / 16)], axis=-1)
    if "glsl" in request.node.name:
        expected[..., 2] = out["color"][..., 2]  # llvmpipe's helpers read 0 from buffers
    np.testing.assert_allclose(out["color"][mask], expected[mask], rtol=1e-4, atol=1e-5)


class Cut(sl.Shader):
    """Discards: at once, in a loop, in a function called from a loop, after a return of others."""

    limit: sl.Uniform[float]
    counts: sl.StorageRW[int]

    def vertex(self) -> Plain:
        return Plain(clip=sl.vec4(0.0), at=sl.vec2(0.0))

    def check(self, value: int, i: int) -> int:
        if value % 7 == i and i > 1:
            sl.discard()
        if value % 2 == 0:
            return value
        return value + i

    def fragment(self, v: Plain) -> sl.vec4:
        at = sl.fragment_coordinate()
        value = int(at.x) + 16 * int(at.y)
        if self.limit > 10.0:
            sl.discard()
        if value % 11 == 3:
            sl.discard()
        if value % 13 == 4:
            return sl.vec4(-1.0)
        total = 0
        for i in range(4):
            total += self.check(value, i)
            if value % 5 == 2 and i == 2:
                if value % 3 == 1:
                    sl.discard()
                break
            sl.atomic_add(self.counts[i], 1)
        return sl.vec4(float(total), float(value), 0.0, 1.0)


def cut(limit, mask):
    """(kept, total, counts) of `Cut`."""
    coverage, total, counts = np.zeros(SHAPE, bool), np.zeros(SHAPE), np.zeros(4, int)
    for r, c in np.ndindex(*SHAPE):
        value = c + 16 * r
        if not mask[r, c] or limit > 10 or value % 11 == 3:
            continue
        coverage[r, c] = True
        if value % 13 == 4:
            total[r, c] = -1
            continue
        for i in range(4):
            if value % 7 == i and i > 1:
                coverage[r, c] = False
                break
            total[r, c] += value if value % 2 == 0 else value + i
            if value % 5 == 2 and i == 2:
                coverage[r, c] = value % 3 != 1
                break
            counts[i] += 1
    return coverage, total, counts


@pytest.mark.parametrize(("limit", "covered"), [(0, "all"), (0, "part"), (11, "all")])
def test_discards_agree(fragment_stage, limit, covered):
    mask = (
        np.ones(SHAPE, bool) if covered == "all" else (ROWS > 2) & (ROWS < 9) & (COLUMNS > 4) & (COLUMNS < 11)
    )
    out = fragment_stage(Cut, {}, SHAPE, mask=mask, limit=np.float32(limit), counts=4)
    coverage, total, counts = cut(limit, mask)
    np.testing.assert_array_equal(out["coverage"], coverage)
    np.testing.assert_array_equal(out["color"][..., 0][coverage], total[coverage])
    np.testing.assert_array_equal(out["counts"], counts)


def test_a_discard_that_all_lanes_reach_ends_the_stage_at_once():
    text = sl.compile_shader(Cut).emit("opencl16", Stage.FRAGMENT).text
    assert re.search(r"^ *goto end_fragment", text, re.MULTILINE)  # and not with a mask's end
