"""The results of compute shaders, compared with those of Python. What the kit asks of devices, languages have
to give alone."""

import math
from contextlib import contextmanager
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

import rhi.shading as sl
from rhi.conformance.operation import test_compute, test_language


class Host:
    """The members of a device that the kit's tests of compute shaders use, in one language."""

    def __init__(self, run):
        self._run = run

    def program(self, shader):
        return shader

    @contextmanager
    def storage(self, element, values):
        buffer = SimpleNamespace(values=values)
        buffer.read = lambda: buffer.values
        yield buffer

    def dispatch(self, shader, groups, **bound):
        for name, values in self._run(
            shader, groups, **{name: buffer.values for name, buffer in bound.items()}
        ).items():
            bound[name].values = values


INHERITED = (1103.5, 1106.5)


@pytest.mark.parametrize(
    "examine",
    [
        test_language.test_integer_arithmetic_equals_that_of_python,
        test_language.test_loops_run_as_often_as_their_data_says,
        test_language.test_control_flow_is_python_s,
        test_language.test_components_are_read_and_written_in_any_order,
        test_language.test_conditions_stop_early,
        partial(
            test_language.test_a_shader_inherits_and_overrides,
            shader=test_language.Variant,
            expected=INHERITED,
        ),
        test_compute.test_a_work_group_sees_its_shared_memory_after_a_barrier,
        test_compute.test_atomics_work_in_shared_memory,
        test_compute.test_atomics_lose_nothing,
        partial(test_compute.test_every_invocation_runs_once_and_reads_its_indices, groups=(3, 2, 2)),
    ],
    ids=lambda examine: getattr(examine, "__name__", "places"),
)
def test_every_language_passes_the_kit_s_tests_of_the_language(run_everywhere, examine):
    examine(Host(run_everywhere))


class ByPowerOfTwo(sl.Shader):
    work_group = (16,)
    a: sl.Storage[int]
    out: sl.StorageRW[int]

    def compute(self) -> None:
        i = sl.global_id().x
        self.out[i] = self.a[i] // 8 * 100 + self.a[i] % 8


def test_division_by_a_power_of_two_floors_too(run_everywhere):
    a = np.arange(-8, 8, dtype="i4") * 5
    assert run_everywhere(ByPowerOfTwo, a=a, out=16)["out"].tolist() == [
        x // 8 * 100 + x % 8 for x in a.tolist()
    ]


class VectorDivision(sl.Shader):
    out: sl.StorageRW[sl.ivec3]

    def compute(self) -> None:
        v = sl.ivec3(-7, 7, -6)
        self.out[0] = v // 3
        self.out[1] = v % 3
        self.out[2] = v // sl.ivec3(-2, -2, 2)
        self.out[3] = 7 % sl.ivec3(-3, 3, -7)


def test_vector_division_floors_by_component(run_everywhere):
    out = run_everywhere(VectorDivision, out=4)["out"][:, :3]
    v = np.array([-7, 7, -6])
    expected = [v // 3, v % 3, v // np.array([-2, -2, 2]), 7 % np.array([-3, 3, -7])]
    assert out.tolist() == np.array(expected).tolist()


class Floats(sl.Shader):
    out: sl.StorageRW[float]
    a: sl.Storage[float]

    def compute(self) -> None:
        x = self.a[0]
        y = self.a[1]
        self.out[0] = x // y
        self.out[1] = x % y
        self.out[2] = x**2
        self.out[3] = x**3
        self.out[4] = x**-2
        self.out[5] = abs(x) ** 0.5
        self.out[6] = 7 / 2
        n = int(x)
        self.out[7] = n / 2
        self.out[8] = sl.round(y)
        self.out[9] = x**0


def test_float_operators_have_pythons_meaning(run_everywhere):
    x, y = -3.25, 2.5
    out = run_everywhere(Floats, a=np.array([x, y], "f4"), out=10)["out"]
    expected = [x // y, x % y, x**2, x**3, x**-2, abs(x) ** 0.5, 3.5, -1.5, 2.0, 1.0]
    np.testing.assert_allclose(out, expected, rtol=1e-6)


class BoundsOnce(sl.Shader):
    out: sl.StorageRW[int]

    def compute(self) -> None:
        n = 3
        turns = 0
        for _i in range(n):
            n = n + 1
            turns += 1
            if turns > 50:
                break
        self.out[0] = turns
        total = 0
        for i in range(4):
            total += i
            i = i + 10
        self.out[1] = total
        count = 0
        for i in range(10, 0, -3):
            count = count * 100 + i
        self.out[2] = count
        step = n - 8
        last = 0
        for i in range(5, -1, step):
            last = last * 10 + i
        self.out[3] = last
        for _ in range(len(self.out), 2):
            self.out[4] = 1
        k = 7
        for k in range(2):  # noqa: B007 (read below)
            pass
        self.out[5] = k


def test_loop_bounds_are_evaluated_once_and_the_body_cannot_change_the_count(run_everywhere):
    out = run_everywhere(BoundsOnce, out=np.full(8, -1, "i4"))["out"]
    assert out[:6].tolist() == [3, 0 + 1 + 2 + 3, 10070401, 531, -1, 1]


class NestedLoops(sl.Shader):
    """Two loops, one in the other, count in the same variable."""

    out: sl.StorageRW[int]

    def compute(self) -> None:
        total = 0
        for m in range(3):
            total += 100 * m
            for m in range(2):
                total += m + 1
            total += 10 * m
        self.out[0] = total


def test_nested_loops_may_count_in_the_same_variable(run_everywhere):
    assert run_everywhere(NestedLoops, out=1)["out"].tolist() == [3 * (1 + 2 + 10) + 300]


WEIGHTS = (0.25, 0.5, 1)
OFFSETS = (sl.vec2(1, 2), sl.vec2(3, 4))
SKY = sl.vec3(0.5, 0.25, 0.125)
LIMIT = 3
BIG = 0xFFFFFFFF


class Constants(sl.Shader):
    scale = 2.0
    out: sl.StorageRW[float]

    def compute(self) -> None:
        total = 0.0
        for i in range(LIMIT):
            total += WEIGHTS[i]
        self.out[0] = total * self.scale
        self.out[1] = OFFSETS[1].y + SKY.z
        self.out[2] = math.pi
        mask: sl.uint = BIG
        self.out[3] = float(sl.bit_count(mask & 0xF0))
        self.out[4] = WEIGHTS[-1]


def test_module_and_class_constants_are_usable(run_everywhere):
    out = run_everywhere(Constants, out=5)["out"]
    np.testing.assert_allclose(out, [3.5, 4.125, math.pi, 4, 1], rtol=1e-6)


class Table:
    WEIGHTS = (10.0, 20.0)


class SameName(sl.Shader):
    out: sl.StorageRW[float]

    def compute(self) -> None:
        WEIGHTS = 1.0  # noqa: N806
        out = WEIGHTS + Table.WEIGHTS[1]
        self.out[0] = out


def test_a_local_may_have_the_name_of_a_constant_or_a_binding(run_everywhere):
    assert run_everywhere(SameName, out=1)["out"].tolist() == [21]


class Arrays(sl.Shader):
    out: sl.StorageRW[int]

    def total(self, values: sl.Array[int]) -> int:
        result = 0
        for i in range(len(values)):
            result += values[i]
        return result

    def compute(self) -> None:
        stack = sl.array(int, 8)
        top = 0
        for i in range(5):
            stack[top] = i * i
            top += 1
        while top > 0:
            top -= 1
            self.out[top] = stack[top]
        big = sl.array(int, 100)
        big[99] = 7
        self.out[5] = self.total(big)
        self.out[6] = self.total(stack)
        copy = stack
        copy[0] = 100
        self.out[7] = stack[0]


def test_local_arrays_start_as_zeros_and_are_values(run_everywhere):
    assert run_everywhere(Arrays, out=8)["out"].tolist() == [0, 1, 4, 9, 16, 7, 30, 0]


class Inner(sl.Struct):
    direction: sl.vec3
    weight: float


class Outer(sl.Struct):
    inner: Inner
    turn: sl.mat2
    count: int


class Structs(sl.Shader):
    items: sl.StorageRW[Outer]

    def moved(self, item: Outer) -> Outer:
        item.count += 1
        item.inner.direction.y = 9.0
        return item

    def compute(self) -> None:
        item = self.items[0]
        other = self.moved(item)
        self.items[1] = other
        self.items[2] = Outer(inner=Inner(weight=2.0, direction=(1, 2, 3)), turn=item.turn, count=item.count)
        self.items[2].turn[1][0] = 5.0


def test_structs_are_values_and_their_fields_can_be_written(run_everywhere):
    items = np.zeros(3, Outer.dtype)
    items[0]["turn"] = [[1, 2], [3, 4]]
    items[0]["count"] = 41
    out = run_everywhere(Structs, items=items)["items"]
    assert out["count"].tolist() == [41, 42, 41]
    assert out["inner"]["direction"][:, :3].tolist() == [[0, 0, 0], [0, 9, 0], [1, 2, 3]]
    assert out[2]["inner"]["weight"] == 2
    assert out[2]["turn"].tolist() == [[1, 2], [5, 4]]


class Matrices(sl.Shader):
    m: sl.Uniform[sl.mat3]
    m4: sl.Storage[sl.mat4]
    out: sl.StorageRW[sl.vec4]

    def compute(self) -> None:
        v = sl.vec3(1, 2, 3)
        self.out[0] = sl.vec4(self.m @ v, self.m[1][2])
        self.out[1] = sl.vec4(v @ self.m, self.m[2][0])
        self.out[2] = sl.vec4(self.m[1], 0)
        self.out[3] = sl.vec4(sl.transpose(self.m)[1], 0)
        self.out[4] = self.m4[0] @ sl.vec4(v, 1)
        rows = sl.mat2(1, 2, 3, 4)
        self.out[5] = sl.vec4(rows @ sl.vec2(1, 10), rows[0])
        basis = sl.transpose(sl.mat2(sl.vec2(1, 2), sl.vec2(3, 4)))
        self.out[6] = sl.vec4(basis @ sl.vec2(1, 10), basis[0])
        product = sl.mat3(2.0) @ self.m
        self.out[7] = sl.vec4(product[2], (self.m * self.m)[2][1])
        i = len(self.out) - 9
        self.out[8] = sl.vec4(self.m[i], sl.mat3(self.m4[0])[2][1])


def test_a_numpy_matrix_means_the_same_in_a_shader(run_everywhere):
    m = np.arange(1, 10, dtype="f4").reshape(3, 3)
    m4 = np.arange(1, 17, dtype="f4").reshape(4, 4)
    padded = np.zeros((3, 4), "f4")
    padded[:, :3] = m
    out = run_everywhere(Matrices, m=padded, m4=m4[None], out=10)["out"]
    v, w = np.array([1, 2, 3]), np.array([1, 10])
    square = np.array([[1, 2], [3, 4]])
    expected = [
        [*(m @ v), m[1, 2]],
        [*(v @ m), m[2, 0]],
        [*m[1], 0],
        [*m[:, 1], 0],
        m4 @ [1, 2, 3, 1],
        [*(square @ w), *square[0]],
        [*(square.T @ w), *square.T[0]],
        [*(2 * m)[2], m[2, 1] ** 2],
        [*m[1], m4[2, 1]],
    ]
    np.testing.assert_array_equal(out[:9], expected)


@sl.function
def halved(x: float, *, by: int = 2) -> float:
    return x / by


@sl.function
def twice_halved(x: float) -> float:
    return halved(halved(x), by=4)


class Calls(sl.Shader):
    out: sl.StorageRW[float]

    @staticmethod
    def plain(x: float) -> float:
        return x + 1

    def compute(self) -> None:
        self.out[0] = twice_halved(16)
        self.out[1] = self.plain(x=3)
        self.out[2] = sl.clamp(sl.dot(sl.vec3(1), sl.vec3(2)), 0.0, 5.0)


def test_functions_helpers_and_defaults_are_resolved_as_in_python(run_everywhere):
    assert run_everywhere(Calls, out=3)["out"].tolist() == [2, 4, 5]


class Reserved(sl.Struct):
    out: float
    sample: sl.ivec2
    flat: sl.uint


class Mangled(sl.Shader):
    buffer: sl.StorageRW[Reserved]

    def input(self, half: float) -> float:
        gl_position = half
        a__b = gl_position * 2
        _texture = a__b
        return _texture + 0

    def compute(self) -> None:
        output = self.input(2.0)
        filter = sl.ivec2(3, 4)
        self.buffer[0] = Reserved(out=output, sample=filter, flat=7)
        rhi_power_2 = output**2
        self.buffer[1].out = rhi_power_2


def test_names_that_glsl_reserves_can_be_used(run_everywhere):
    out = run_everywhere(Mangled, buffer=2)["buffer"]
    assert out["out"].tolist() == [4, 16]
    assert out["sample"][0].tolist() == [3, 4]
    assert out["flat"][0] == 7
