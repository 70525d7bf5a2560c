"""Vertex and fragment stages on 16 lanes: inputs and outputs, active lanes, discards."""

from __future__ import annotations

import re

import numpy as np
import pytest
from opencl_runner import run_opencl
from stage_runner import run_fragment_lanes, run_fragment_numpy, run_vertex_lanes, run_vertex_numpy, view

import rhi.shading as sl
from rhi.contract.descriptors import Interpolation, Stage, StageVarying
from rhi.contract.formats import Format
from rhi.errors import ShaderError, ValidationError
from rhi.shading import compile as compiler
from rhi.shading.language import rules

SHAPE = (8, 12)
ROWS, COLUMNS = np.mgrid[: SHAPE[0], : SHAPE[1]]


class Corner(sl.Struct):
    position: sl.vec2
    id: int


class PerInstance(sl.Struct):
    weight: sl.uint


class Surface(sl.Struct):
    clip: sl.vec4
    uv: sl.vec2
    unread: sl.vec3
    turn: sl.mat2
    tint: sl.Flat[sl.vec3]
    id: int
    screen: sl.NoPerspective[sl.vec2]


class Targets(sl.Struct):
    color: sl.vec4
    ids: sl.uvec2
    level: float
    depth: sl.FragmentDepth


class Draws(sl.Shader):
    camera: sl.Uniform[sl.mat4]
    offsets: sl.Storage[sl.vec2]

    def vertex(self, v: Corner, n: PerInstance) -> Surface:
        shifted = v.position + self.offsets[sl.vertex_index() % len(self.offsets)]
        if v.id % 3 == 0:
            shifted = -shifted
        return Surface(
            clip=self.camera @ sl.vec4(shifted, 0.5, 1.0),
            uv=shifted,
            unread=sl.vec3(1.0),
            turn=sl.mat2(1.0, 2.0, 3.0, float(v.id)),
            tint=sl.vec3(float(sl.instance_index()), float(sl.draw_index()), float(sl.vertex_index())),
            id=v.id + int(n.weight),
            screen=v.position * 2.0,
        )

    def fragment(self, s: Surface) -> Targets:
        at = sl.fragment_coordinate()
        color = sl.vec4(s.uv, s.turn[1][0], s.screen.y)
        if sl.front_facing():
            color.x += 1000.0
        return Targets(
            color=color + sl.vec4(s.tint, 0.0),
            ids=sl.uvec2(sl.uint(s.id), sl.uint(sl.primitive_index())),
            level=at.x + 100.0 * at.y + 10000.0 * at.w,
            depth=at.z * 0.5,
        )


def test_varyings_are_those_that_the_fragment_stage_reads():
    flat, linear = Interpolation.FLAT, Interpolation.NO_PERSPECTIVE
    assert sl.compile_shader(Draws).varyings == (
        StageVarying("uv", 0, 2, "float"),
        StageVarying("turn", 2, 4, "float"),
        StageVarying("tint", 6, 3, "float", flat),
        StageVarying("id", 9, 1, "int", flat),
        StageVarying("screen", 10, 2, "float", linear),
    )


def test_a_vertex_stage_gives_positions_and_varyings():
    count = 37  # the last group isn't full
    camera = np.arange(16, dtype="f4").reshape(4, 4)
    offsets = np.arange(10, dtype="f4").reshape(5, 2)
    position = np.random.default_rng(1).random((count, 2), "f4")
    ids = np.arange(count, dtype="i4")
    weights = np.full(count, 7, "u4")
    out = run_vertex_lanes(
        Draws,
        {"position": position, "id": ids, "weight": weights},
        count,
        first=100,
        instance=3,
        draw=2,
        camera=camera,
        offsets=offsets,
    )
    vertex = 100 + ids
    shifted = position + offsets[vertex % 5]
    shifted[ids % 3 == 0] *= -1
    clip = np.concatenate([shifted, np.full((count, 1), 0.5), np.ones((count, 1))], axis=1) @ camera.T
    np.testing.assert_allclose(out["position"], clip, rtol=1e-5)
    np.testing.assert_array_equal(out["uv"], shifted)
    np.testing.assert_array_equal(out["turn"], np.stack([ids * 0 + 1, ids * 0 + 2, ids * 0 + 3, ids], axis=1))
    np.testing.assert_array_equal(out["tint"], np.stack([ids * 0 + 3, ids * 0 + 2, vertex], axis=1))
    np.testing.assert_array_equal(out["id"][:, 0], ids + 7)
    np.testing.assert_array_equal(out["screen"], position * 2)


@pytest.mark.parametrize("front", [True, False])
def test_a_fragment_stage_gives_all_its_outputs(front):
    uv = np.random.default_rng(2).random((*SHAPE, 2), "f4")
    out = run_fragment_lanes(
        Draws,
        {
            "uv": uv,
            "turn": np.broadcast_to(np.arange(4, dtype="f4"), (*SHAPE, 4)),
            "tint": np.array([1, 2, 3], "f4"),
            "id": np.array(11, "i4"),
            "screen": uv * 3,
        },
        SHAPE,
        depth=COLUMNS / 16.0,
        w=0.25,
        front=front,
        primitive=5,
        camera=np.eye(4, dtype="f4"),
        offsets=1,
    )
    x, y = uv[..., 0] + (1000 if front else 0) + 1, uv[..., 1] + 2
    np.testing.assert_allclose(out["color"][..., :2], np.stack([x, y], axis=-1), rtol=1e-6)
    np.testing.assert_allclose(out["color"][..., 2], 2 + 3)
    np.testing.assert_allclose(out["color"][..., 3], uv[..., 1] * 3, rtol=1e-6)
    assert (out["ids"] == (11, 5)).all()
    np.testing.assert_array_equal(out["level"][..., 0], COLUMNS + 0.5 + 100 * (ROWS + 0.5) + 2500)
    np.testing.assert_array_equal(out["depth"], COLUMNS / 32.0)
    assert out["coverage"].all()


class Depths(sl.Shader):
    """No fragment stage, as in a depth pass."""

    def vertex(self, v: Corner) -> sl.vec4:
        return sl.vec4(v.position, float(v.id), 1.0)


def test_a_vertex_stage_alone_gives_positions():
    ids = np.arange(5, dtype="i4")
    position = np.arange(10, dtype="f4").reshape(5, 2)
    out = run_vertex_lanes(Depths, {"position": position, "id": ids}, 5)
    np.testing.assert_array_equal(out["position"], np.c_[position, ids, ids * 0 + 1])
    assert sl.compile_shader(Depths).varyings == ()


class Values(sl.Struct):
    clip: sl.vec4
    value: sl.vec2


class PositionValued(sl.Shader):
    """Half a shader: hands fragments their place."""

    def vertex(self, v: Corner) -> Values:
        return Values(clip=sl.vec4(v.position, 0.0, 1.0), value=v.position)


class Endless(PositionValued):
    """A loop that ends only by a discard in a called function."""

    def check(self, value: float, n: float) -> None:
        if n > value:
            sl.discard()

    def fragment(self, v: Values) -> sl.vec4:
        n = 0.0
        while True:
            self.check(v.value.x, n)
            n += 1.0
            if n > 9.0:
                return sl.vec4(n)


@pytest.mark.parametrize("run", [run_fragment_lanes, run_fragment_numpy])
def test_a_loop_ends_when_its_last_lane_is_discarded(run):
    value = np.stack([COLUMNS, ROWS], axis=-1).astype("f4")
    assert not run(Endless, {"value": value % 8}, SHAPE)["coverage"].any()
    out = run(Endless, {"value": value}, SHAPE)
    np.testing.assert_array_equal(out["coverage"], COLUMNS >= 9)
    assert (out["color"][out["coverage"]] == 10).all()


class Slopes(PositionValued):
    table: sl.Storage[float]
    hits: sl.StorageRW[int]

    def fragment(self, v: Values) -> sl.vec4:
        squared = v.value.x * v.value.y
        wide = 0.0
        if v.value.x > 100.0:
            wide = 1.0
        read = self.table[int(v.value.x) * 4]
        self.hits[int(v.value.x)] = 1
        sl.atomic_add(self.hits[19], 1)
        return sl.vec4(sl.ddx(squared), sl.ddy(squared), sl.fwidth(wide + 3.0), sl.ddx(read))


class CutSlopes(PositionValued):
    """A discard, followed by work that helpers of discarded fragments must not do."""

    def fragment(self, v: Values) -> sl.vec4:
        slope = sl.ddx(v.value.y)
        if v.value.x < 4.0:
            sl.discard()
        n = 0.0
        while n < v.value.y and n < 100.0:
            n += 1.0
        return sl.vec4(n, slope, 0.0, 0.0)


@pytest.mark.parametrize("run", [run_fragment_lanes, run_fragment_numpy])
def test_helpers_leave_with_the_last_fragment_of_their_quad(run):
    value = np.stack([COLUMNS, np.full(SHAPE, 3.0)], axis=-1).astype("f4")
    mask = (COLUMNS % 2 == 0) & (ROWS % 2 == 0)
    value[~mask & (COLUMNS < 4), 0] = 9.0  # isn't discarded itself,
    value[~mask & (COLUMNS < 4), 1] = 1e9  # and would go round for long
    out = run(CutSlopes, {"value": value}, SHAPE, mask=mask)
    coverage = mask & (COLUMNS >= 4)
    np.testing.assert_array_equal(out["coverage"], coverage)
    np.testing.assert_array_equal(
        out["color"][coverage][:, :2], np.broadcast_to([3.0, 0.0], (coverage.sum(), 2))
    )
    text = sl.compile_shader(CutSlopes).emit("opencl16", Stage.FRAGMENT).text
    assert re.search(r"= rhi_quads\(kept_\d+\);", text)


def test_helper_lanes_are_read_and_never_write():
    value = np.stack([COLUMNS, ROWS], axis=-1).astype("f4")
    value[:, 5, 0] = 1e8  # outside the triangle: read within bounds, whatever the index
    table = np.arange(48, dtype="f4")
    mask = (COLUMNS % 2 == 0) & (COLUMNS < 6)
    out = run_fragment_lanes(Slopes, {"value": value}, SHAPE, mask=mask, table=table, hits=20)
    np.testing.assert_array_equal(out["color"][:, [0, 2], 0], ROWS[:, :2])
    np.testing.assert_array_equal(out["color"][:, [0, 2], 3], 4)
    np.testing.assert_array_equal(out["color"][:, 4, 3], table[-1] - table[16])
    assert np.flatnonzero(out["hits"]).tolist() == [0, 2, 4, 19]
    assert out["hits"][19] == mask.sum()
    np.testing.assert_array_equal(out["coverage"], mask)


class NativeOnly(sl.Shader):
    def vertex(self, v: Corner) -> sl.vec4:
        return sl.vec4(v.position, 0.0, 1.0)

    @sl.native("glsl", "return vec4(1.0);")
    def fragment(self) -> sl.vec4: ...


def test_a_stage_that_is_native_in_another_language_has_no_lanes():
    assert sl.compile_shader(NativeOnly).emit("opencl16", Stage.VERTEX).text
    with pytest.raises(ShaderError):
        sl.compile_shader(NativeOnly).emit("opencl16", Stage.FRAGMENT)


class ClipAndValue(sl.Struct):
    clip: sl.vec4
    value: float


class Value(sl.Struct):
    value: float


class NativeLanes(sl.Shader):
    scale: sl.Uniform[sl.vec2]

    @sl.native("opencl16", "for (int i = 0; i < 4; i++) outputs[i] = inputs[i % 2];\noutputs[4] = inputs[2];")
    def vertex(self, v: Corner) -> ClipAndValue:
        return ClipAndValue(clip=sl.vec4(v.position, v.position), value=float(v.id))

    @sl.native(
        "opencl16",
        "outputs[0] = as_uint16(twice(as_float16(inputs[0])) * as_float(scale_[1]));\nreturn mask;",
        declarations="float16 twice(float16 x) { return x + x; }",
    )
    def fragment(self, v: Value) -> float: ...


def test_a_stage_may_be_opencl_c_in_the_same_form():
    position = np.arange(10, dtype="f4").reshape(5, 2)
    ids = np.arange(5, dtype="i4")
    scale = np.array([1, 3], "f4")
    out = run_vertex_lanes(NativeLanes, {"position": position, "id": ids}, 5, scale=scale)
    np.testing.assert_array_equal(out["position"], np.c_[position, position])
    np.testing.assert_array_equal(view(out["value"], "int")[:, 0], ids)  # the words as they are
    value = (ROWS * 12 + COLUMNS).astype("f4")
    mask = ROWS > 2
    out = run_fragment_lanes(NativeLanes, {"value": value}, SHAPE, mask=mask, scale=scale)
    np.testing.assert_array_equal(out["color"][..., 0], value * 6)
    np.testing.assert_array_equal(out["coverage"], mask)


class NativeKernel(sl.Shader):
    out: sl.StorageRW[int]
    work_group = (32,)

    @sl.native("opencl16", "vstore16(RHI_LANES + rhi_item, rhi_item, (global int *)out_);")
    def compute(self) -> None:
        self.out[0] = 1


def test_a_kernel_may_be_opencl_c_for_one_number_of_lanes():
    out = run_opencl(NativeKernel, 16, out=32)["out"]
    np.testing.assert_array_equal(out, np.arange(32) % 16 + np.arange(32) // 16)
    assert run_opencl(NativeKernel, 4, out=32)["out"][0] == 1  # its Python body


class Camera(sl.Struct):
    turn: sl.mat4
    eye: sl.vec3


class Surface2(sl.Struct):
    clip: sl.vec4
    near: sl.vec4


class DepthPass(sl.Shader):
    camera: sl.Uniform[Camera]

    def clip_position(self, v: Corner) -> sl.vec4:
        position = sl.vec3(v.position, float(v.id)) * 1.7 - self.camera.eye
        return self.camera.turn @ sl.vec4(position, 1.0)

    def vertex(self, v: Corner) -> sl.vec4:
        return self.clip_position(v)


class ColorPass(DepthPass):
    """Needs parts of the same sums and products for something else."""

    def vertex(self, v: Corner) -> Surface2:  # type: ignore[override]
        position = sl.vec3(v.position, float(v.id)) * 1.7
        turn = self.camera.turn
        near = turn[0] * position.x + sl.vec4(
            position - self.camera.eye, turn[0].x * (position.x - self.camera.eye.x)
        )
        return Surface2(clip=self.clip_position(v), near=near)

    def fragment(self, s: Surface2) -> sl.vec4:
        return s.near


def test_the_same_position_in_two_programs_is_the_same_bits():
    rng, count = np.random.default_rng(6), 4096
    attributes = {"position": rng.normal(size=(count, 2)).astype("f4"), "id": np.arange(count, dtype="i4")}
    camera = Camera(turn=rng.normal(size=(4, 4)), eye=rng.normal(size=3))
    first = run_vertex_lanes(DepthPass, attributes, count, camera=camera)["position"]
    second = run_vertex_lanes(ColorPass, attributes, count, camera=camera)["position"]
    np.testing.assert_array_equal(view(first, "uint"), view(second, "uint"))
    exact = run_vertex_numpy(DepthPass, attributes, count, camera=camera)["position"]
    np.testing.assert_array_equal(first, exact)  # nothing is fused


@pytest.mark.parametrize(("language", "called"), [("opencl16", "rhi_ddy("), ("glsl", "dFdy(")])
def test_lines_of_a_stage_lead_back_to_python(language, called):
    emitted = sl.compile_shader(Slopes).emit(language, Stage.FRAGMENT)
    lines = emitted.text.splitlines()
    assert len(lines) == len(emitted.origins)
    at = next(i for i, line in enumerate(lines) if called in line and "inline" not in line)
    file, number = emitted.origins[at]
    assert file == __file__
    with open(file, encoding="utf-8") as text:
        assert "ddy(squared)" in text.read().splitlines()[number - 1]


class OwnArray(PositionValued):
    """A local array, read and written at an index from the inputs."""

    def fragment(self, v: Values) -> sl.vec4:
        table = sl.array(int, 4)
        table[int(v.value.x)] = int(v.value.y)
        return sl.vec4(float(table[0]), float(table[1]), float(table[int(v.value.x)]), self.slope(v.value.y))

    def slope(self, y: float) -> float:
        return 0.0


class OwnArrayWithHelpers(OwnArray):
    def slope(self, y: float) -> float:
        return sl.ddy(y)


@pytest.mark.parametrize("shader", [OwnArray, OwnArrayWithHelpers])
def test_lanes_outside_the_mask_leave_memory_alone(shader):
    value = np.stack([COLUMNS % 4, ROWS], axis=-1).astype("f4")
    mask = (COLUMNS % 4 != 1) & (ROWS % 2 == 0)
    value[~mask, 0] = np.where(ROWS % 3 == 0, 1e8, -1e7)[~mask]
    out = run_fragment_lanes(shader, {"value": value}, SHAPE, mask=mask)
    x, y = (COLUMNS % 4)[mask], ROWS[mask]
    expected = np.stack([y * (x == 0), y * (x == 1), y, y * 0 + (shader is OwnArrayWithHelpers)], axis=-1)
    np.testing.assert_array_equal(out["color"][mask], expected)


class Lookup(sl.Shader):
    """A row by a varying that is the same for all covered pixels."""

    elements: sl.Storage[float]

    def vertex(self, v: Corner) -> Values:
        return Values(clip=sl.vec4(v.position, self.elements[v.id], 1.0), value=v.position)

    def fragment(self, v: Values) -> sl.vec4:
        row = sl.uniform(int(v.value.x + 0.5))
        return sl.vec4(self.elements[row], self.elements[int(v.value.y)], sl.ddx(v.value.y), 1.0)


class CheckedLookup(Lookup):
    checked = True


def test_helper_invocations_do_not_affect_uniformity():
    value = np.stack([np.full(SHAPE, 3.0), ROWS % 4], axis=-1).astype("f4")
    mask = (COLUMNS % 4 != 0) & (ROWS > 0)
    value[~mask] = -1000.0
    rows = np.arange(5, dtype="f4") + 10
    out = run_fragment_lanes(Lookup, {"value": value}, SHAPE, mask=mask, elements=rows)
    assert (out["color"][mask][:, 0] == 13).all()
    np.testing.assert_array_equal(out["color"][mask][:, 1], 10 + ROWS[mask] % 4)


def test_a_checked_stage_reports_the_indices_of_covered_fragments_only():
    value = np.stack([np.full(SHAPE, 3.0), ROWS % 4], axis=-1).astype("f4")
    mask = COLUMNS > 3
    value[~mask] = -1000.0
    run_fragment_numpy(CheckedLookup, {"value": value}, SHAPE, mask=mask, elements=5)
    value[2, 7, 1] = 9
    with pytest.raises(ShaderError, match="index 9") as caught:
        run_fragment_numpy(CheckedLookup, {"value": value}, SHAPE, mask=mask, elements=5)
    assert caught.value.rule is rules.INDEX
    run_fragment_numpy(Lookup, {"value": value}, SHAPE, mask=mask, elements=5)


def test_a_checked_vertex_stage_reports_its_indices():
    position, ids = np.zeros((8, 2), "f4"), np.arange(8, dtype="i4")
    run_vertex_numpy(CheckedLookup, {"position": position, "id": ids}, 8, elements=8)
    with pytest.raises(ShaderError, match="index 7") as caught:
        run_vertex_numpy(CheckedLookup, {"position": position, "id": ids}, 8, elements=7)
    assert __file__ in str(caught.value)


class PassesTextures(PositionValued):
    first: sl.Texture2D
    second: sl.Texture2D

    def red(self, source: sl.Texture2D, at: sl.vec2) -> float:
        return source.load(sl.ivec2(at)).x

    def sum(self, a: sl.Texture2D, b: sl.Texture2D, at: sl.vec2) -> float:
        return self.red(a, at) + 10.0 * self.red(b, at)

    def fragment(self, v: Values) -> sl.vec4:
        first = self.sum(self.first, self.second, v.value)
        return sl.vec4(first, self.sum(self.second, self.first, v.value), 0.0, 0.0)


@pytest.mark.parametrize("run", [run_fragment_lanes, run_fragment_numpy])
def test_textures_are_passed_to_functions(run):
    first, second = (np.random.default_rng(n).random((*SHAPE, 4), "f4") for n in range(2))
    value = np.stack([COLUMNS, ROWS], axis=-1).astype("f4")
    textures = {
        "first": sl.HostTexture(first, Format.RGBA32F),
        "second": sl.HostTexture(second, Format.RGBA32F),
    }
    out = run(PassesTextures, {"value": value}, SHAPE, **textures)["color"]
    a, b = first[..., 0], second[..., 0]
    np.testing.assert_allclose(out[..., :2], np.stack([a + 10 * b, b + 10 * a], axis=-1), rtol=1e-6)


# -- arguments of the runs on NumPy ------------------------------------------------------------------------

GOOD = {"position": np.zeros((4, 2)), "id": np.arange(4)}


@pytest.mark.parametrize(
    "attributes",
    [
        {"position": np.zeros((4, 2))},
        {**GOOD, "color": np.zeros(4)},
        {**GOOD, "id": np.arange(5)},
        {**GOOD, "position": np.zeros((4, 3))},
    ],
    ids=["missing", "unknown", "another length", "another size"],
)
def test_attributes_that_a_stage_hasnt_got_are_refused(attributes):
    assert sl.run_vertex(Depths, GOOD).position.shape == (4, 4)
    with pytest.raises(ValidationError, match=r"^\[shading-arguments\]"):
        sl.run_vertex(Depths, attributes)


def test_a_structured_array_gives_attributes_and_varyings():
    corners = np.zeros(3, Corner.dtype)
    corners["position"] = [(1, 2), (3, 4), (5, 6)]
    assert sl.run_vertex(Depths, corners).position[:, :2].tolist() == corners["position"].tolist()


def test_quads_have_even_rows_and_columns():
    def run(rows, columns, shader=Slopes):
        values = {"value": np.zeros((rows, columns, 2))}
        return sl.run_fragment(shader, values, table=64, hits=20).coverage.shape

    assert run(2, 4) == (2, 4)
    for size in ((3, 4), (2, 5)):
        with pytest.raises(ValidationError, match=r"^\[shading-arguments\]"):
            run(*size)
    values = {"value": np.zeros((3, 5, 2))}  # no differences, no quads
    assert sl.run_fragment(Endless, values).coverage.shape == (3, 5)


def test_a_stage_that_a_shader_hasnt_got_doesnt_run():
    with pytest.raises(ValidationError, match=r"^\[shading-stages\]"):
        sl.run_fragment(Depths, {})
    with pytest.raises(ValidationError, match=r"^\[shading-arguments\]"):
        sl.run_fragment(Endless, {"value": np.zeros((2, 2, 2))}, dtype=np.float16)


def test_a_shader_of_which_both_stages_run_is_parsed_once(monkeypatch):
    class Both(sl.Shader):
        def vertex(self) -> sl.vec4:
            return sl.vec4(0.5)

        def fragment(self) -> sl.vec4:
            return sl.vec4(0.25)

    parsed, parse = [], compiler.parse_stage
    monkeypatch.setattr(
        compiler, "parse_stage", lambda *arguments: parsed.append(arguments[1]) or parse(*arguments)
    )
    for _ in range(2):
        assert sl.run_vertex(Both).position.tolist() == [0.5] * 4
        (color,) = sl.run_fragment(Both, fragment_coordinate=np.zeros((2, 2, 4))).outputs.values()
        assert color[0, 0].tolist() == [0.25] * 4
        assert set(sl.stage_trees(Both)) == {Stage.VERTEX, Stage.FRAGMENT}
    assert sorted(stage.value for stage in parsed) == ["fragment", "vertex"]
