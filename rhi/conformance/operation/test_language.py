"""The shading language as it runs: every family of built-in function and every statement against NumPy and
Python.

Tolerances are in units of float32's precision at the result, generous enough for fast approximations; what
must be exact (integers, bits, comparisons, control flow) is compared exactly.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import rhi.shading as sl
from rhi import Device, Format
from rhi.conformance.compare import assert_near, assert_same

pytestmark = pytest.mark.requires("shading", "compute")

Array = NDArray[Any]


def run(device: Device, shader: Any, element: Any, inputs: Array, outputs: int, result: Any = None) -> Array:
    """Run one invocation per row of `inputs`; return (n, outputs, …) results, `outputs` rows for each."""
    result = result or element
    with device.storage(element, inputs) as source, device.storage(result, len(inputs) * outputs) as target:
        device.dispatch(device.program(shader), len(inputs), source=source, target=target)
        back = target.read()
    return back.reshape(len(inputs), outputs, *back.shape[1:])


# -- functions of floats -----------------------------------------------------------------------------------


class Angles(sl.Shader):
    """Trigonometry."""

    source: sl.Storage[float]
    target: sl.StorageRW[float]

    def compute(self) -> None:
        i = sl.global_id().x
        x = self.source[i]
        o = 11 * i
        self.target[o] = sl.sin(x)
        self.target[o + 1] = sl.cos(x)
        self.target[o + 2] = sl.tan(x)
        self.target[o + 3] = sl.atan(x)
        self.target[o + 4] = sl.asin(sl.clamp(x, -1.0, 1.0))
        self.target[o + 5] = sl.acos(sl.clamp(x, -1.0, 1.0))
        self.target[o + 6] = sl.radians(x)
        self.target[o + 7] = sl.degrees(x)
        self.target[o + 8] = sl.cosh(x)
        self.target[o + 9] = sl.tanh(x)
        self.target[o + 10] = sl.atan2(x, 0.5)


def test_trigonometric_functions_are_near_float64_s(device: Device) -> None:
    x = np.array([-3.0, -1.5, -1.0, -0.7, -0.1, 0.0, 0.2, 0.5, 1.0, 1.4, 2.0, 3.1], "f4")
    d = x.astype(np.float64)
    c = np.clip(d, -1, 1)
    expected = [
        np.sin(d),
        np.cos(d),
        np.tan(d),
        np.arctan(d),
        np.arcsin(c),
        np.arccos(c),
        np.radians(d),
        np.degrees(d),
        np.cosh(d),
        np.tanh(d),
        np.arctan2(d, 0.5),
    ]
    columns = np.stack(expected, axis=1)
    assert_near(run(device, Angles, float, x, 11), columns, 1e-3 + 1e-4 * np.abs(columns), "approximations")


class Powers(sl.Shader):
    """Exponentials, logarithms, roots."""

    source: sl.Storage[float]
    target: sl.StorageRW[float]

    def compute(self) -> None:
        i = sl.global_id().x
        x = self.source[i]
        o = 9 * i
        self.target[o] = sl.exp(x)
        self.target[o + 1] = sl.exp2(x)
        self.target[o + 2] = sl.log(x)
        self.target[o + 3] = sl.log2(x)
        self.target[o + 4] = sl.sqrt(x)
        self.target[o + 5] = sl.inversesqrt(x)
        self.target[o + 6] = sl.pow(x, 2.5)
        self.target[o + 7] = x**3
        self.target[o + 8] = sl.pow(x, -1.0)


def test_powers_and_roots_are_near_float64_s(device: Device) -> None:
    x = np.array([0.01, 0.3, 0.5, 0.999, 1.0, 1.001, 2.0, 3.7, 10.0, 20.0], "f4")
    d = x.astype(np.float64)
    expected = [np.exp(d), np.exp2(d), np.log(d), np.log2(d), np.sqrt(d), d**-0.5, d**2.5, d**3, 1 / d]
    columns = np.stack(expected, axis=1)
    slack = 2e-6 + 3e-5 * np.abs(columns)
    slack[:, 4:6] = 2e-7 + 1e-6 * np.abs(columns[:, 4:6])
    assert_near(run(device, Powers, float, x, 9), columns, slack, "approximations; roots nearly exact")


class Steps(sl.Shader):
    """Functions with steps, whose results are exact."""

    source: sl.Storage[float]
    target: sl.StorageRW[float]

    def compute(self) -> None:
        i = sl.global_id().x
        x = self.source[i]
        o = 14 * i
        self.target[o] = sl.floor(x)
        self.target[o + 1] = sl.ceil(x)
        self.target[o + 2] = sl.trunc(x)
        self.target[o + 3] = sl.round(x)
        self.target[o + 4] = sl.fract(x)
        self.target[o + 5] = sl.abs(x)
        self.target[o + 6] = sl.sign(x)
        self.target[o + 7] = sl.min(x, 0.75)
        self.target[o + 8] = sl.max(x, 0.75)
        self.target[o + 9] = sl.clamp(x, -1.0, 1.0)
        self.target[o + 10] = sl.step(0.5, x)
        self.target[o + 11] = sl.smoothstep(-2.0, 2.0, x)
        self.target[o + 12] = sl.mix(2.0, 6.0, x)
        self.target[o + 13] = sl.fma(x, 2.0, 1.0)


def test_functions_with_steps_are_exact(device: Device) -> None:
    x = np.array([-2.5, -2.0, -1.5, -0.5, -0.25, 0.0, 0.5, 0.75, 1.0, 1.5, 2.5, 3.5, 1e6], "f4")
    d = x.astype(np.float64)
    t = np.clip((d + 2) / 4, 0, 1)
    expected = [
        np.floor(d),
        np.ceil(d),
        np.trunc(d),
        np.round(d),
        d - np.floor(d),
        np.abs(d),
        np.sign(d),
        np.minimum(d, 0.75),
        np.maximum(d, 0.75),
        np.clip(d, -1, 1),
        d >= 0.5,
        t * t * (3 - 2 * t),
        2 + 4 * d,
        2 * d + 1,
    ]
    columns = np.stack(expected, axis=1)
    back = run(device, Steps, float, x, 14)
    assert_same(back[:, :11], columns[:, :11])
    assert_near(back[:, 11:], columns[:, 11:], 1e-6 * np.maximum(1, np.abs(columns[:, 11:])), "float32")


class Specials(sl.Shader):
    """Infinities and NaN, made from bits."""

    source: sl.Storage[sl.uint]
    target: sl.StorageRW[sl.uint]

    def compute(self) -> None:
        i = sl.global_id().x
        x = sl.uint_bits_to_float(self.source[i])
        bits = sl.uint(0)
        if sl.isnan(x):
            bits |= sl.uint(1)
        if sl.isinf(x):
            bits |= sl.uint(2)
        if x == x:
            bits |= sl.uint(4)
        if x > 1.0:
            bits |= sl.uint(8)
        self.target[2 * i] = bits
        self.target[2 * i + 1] = sl.float_bits_to_uint(x)


def test_isinf_and_isnan_tell_special_floats_apart(device: Device) -> None:
    values = np.array([0.0, -0.0, 1.5, np.inf, -np.inf, np.nan], "f4")
    back = run(device, Specials, sl.uint, values.view("u4"), 2)
    assert_same(back[:, 0], [4, 4, 12, 14, 6, 1])
    assert_same(back[:5, 1], values[:5].view("u4"))


# -- vectors and matrices ----------------------------------------------------------------------------------


class Geometry(sl.Shader):
    """Geometric functions of two vectors."""

    source: sl.Storage[sl.vec4]
    target: sl.StorageRW[sl.vec4]

    def compute(self) -> None:
        i = sl.global_id().x
        a = self.source[i].xyz
        b = self.source[i].zwx
        n = sl.normalize(b)
        self.target[5 * i] = sl.vec4(sl.dot(a, b), sl.length(a), sl.distance(a, b), sl.dot(n, n))
        self.target[5 * i + 1] = sl.vec4(sl.cross(a, b), 0.0)
        self.target[5 * i + 2] = sl.vec4(sl.reflect(a, n), 0.0)
        self.target[5 * i + 3] = sl.vec4(sl.refract(sl.normalize(a), n, 0.8), 0.0)
        self.target[5 * i + 4] = sl.vec4(
            sl.mix(a, b, 0.25), float(sl.any(sl.less_than(a, b))) + 2.0 * float(sl.all(sl.less_than(a, b)))
        )


def test_geometric_functions_of_vectors_are_numpy_s(device: Device) -> None:
    rng = np.random.default_rng(1)
    rows = rng.normal(size=(20, 4)).astype("f4")
    back = run(device, Geometry, sl.vec4, rows, 5)
    for row, got in zip(rows.astype(np.float64), back, strict=True):
        a, b = row[[0, 1, 2]], row[[2, 3, 0]]
        n = b / np.linalg.norm(b)
        u = a / np.linalg.norm(a)
        k = 1 - 0.64 * (1 - (n @ u) ** 2)
        bent = 0.8 * u - (0.8 * (n @ u) + math.sqrt(k)) * n if k >= 0 else 0 * n
        expected = [
            (a @ b, np.linalg.norm(a), np.linalg.norm(a - b), 1),
            (*np.cross(a, b), 0),
            (*(a - 2 * (n @ a) * n), 0),
            (*bent, 0),
            (*(0.75 * a + 0.25 * b), (a < b).any() + 2 * (a < b).all()),
        ]
        assert_near(got, expected, 1e-4, "float32, with cancellation")


class Matrices(sl.Shader):
    """Functions of a matrix made from rows."""

    source: sl.Storage[sl.vec4]
    target: sl.StorageRW[sl.vec4]

    def compute(self) -> None:
        m = sl.mat3(self.source[0].xyz, self.source[1].xyz, self.source[2].xyz)
        i = sl.inverse(m)
        t = sl.transpose(m)
        scaled = m * 2.0
        product = m @ i
        for row in range(3):
            self.target[row] = sl.vec4(i[row], product[row][row])
            self.target[3 + row] = sl.vec4(t[row], sl.determinant(m))
            self.target[6 + row] = sl.vec4(scaled[row], m[row][2])
        m[1][2] = 99.0
        self.target[9] = sl.vec4(m[1], 0.0)


MATRIX = np.array([(2.0, 1, 0), (0.5, 3, -1), (1, 0, 4)])


@pytest.fixture
def matrix_results(device: Device) -> NDArray[Any]:
    """The rows that `Matrices` writes of `MATRIX`."""
    rows = np.zeros((3, 4), "f4")
    rows[:, :3] = MATRIX
    with device.storage(sl.vec4, rows) as source, device.storage(sl.vec4, 10) as target:
        device.dispatch(device.program(Matrices), 1, source=source, target=target)
        return target.read()


def test_an_inverse_has_the_rows_that_numpy_computes(matrix_results: NDArray[Any]) -> None:
    assert_near(matrix_results[:3, :3], np.linalg.inv(MATRIX), 1e-6, "float32")


def test_a_matrix_times_its_inverse_is_the_identity(matrix_results: NDArray[Any]) -> None:
    assert_near(matrix_results[:3, 3], 1, 1e-6, "float32")


def test_a_transposed_matrix_has_columns_as_rows(matrix_results: NDArray[Any]) -> None:
    assert_same(matrix_results[3:6, :3], MATRIX.T)


def test_a_determinant_is_numpy_s(matrix_results: NDArray[Any]) -> None:
    assert_near(matrix_results[3:6, 3], np.linalg.det(MATRIX), 1e-5, "float32")


def test_a_matrix_times_a_number_scales_each_element(matrix_results: NDArray[Any]) -> None:
    assert_same(matrix_results[6:9, :3], 2 * MATRIX)


def test_two_indices_of_a_matrix_are_row_and_column(matrix_results: NDArray[Any]) -> None:
    assert_same(matrix_results[6:9, 3], MATRIX[:, 2])


def test_an_element_of_a_matrix_is_written_in_its_row(matrix_results: NDArray[Any]) -> None:
    assert_same(matrix_results[9, :3], (0.5, 3, 99))


class Swizzles(sl.Shader):
    """Components read and written in any order."""

    source: sl.Storage[sl.vec4]
    target: sl.StorageRW[sl.vec4]

    def compute(self) -> None:
        v = self.source[0]
        w = v
        w.xz = v.wy
        w.g += 10.0
        w.yw = w.wy
        v[3] = 7.0
        self.target[0] = v.wzyx
        self.target[1] = w
        self.target[2] = sl.vec4(v.xx, v.bgr.yz)
        self.target[3].yz = sl.vec2(5.0, 6.0)
        self.target[3][0] = v[-1]
        u = sl.vec4(1.0)
        u.xyz = (2.0, 3.0, 4.0)
        self.target[4] = u * v + sl.vec4(v.xyz, 1.0) / 2.0 - u


def test_components_are_read_and_written_in_any_order(device: Device) -> None:
    with (
        device.storage(sl.vec4, np.array([(1, 2, 3, 4)], "f4")) as source,
        device.storage(sl.vec4, 5) as target,
    ):
        device.dispatch(device.program(Swizzles), 1, source=source, target=target)
        back = target.read()
    assert_same(back[0], (7, 3, 2, 1))
    assert_same(back[1], (4, 4, 2, 12))
    assert_same(back[2], (1, 1, 2, 1))
    assert_same(back[3], (7, 5, 6, 0))
    assert_same(back[4], (0.5, 4, 9.5, 6.5))


# -- integers ----------------------------------------------------------------------------------------------


class Integers(sl.Shader):
    """Division and remainder as in Python, and bit operations."""

    source: sl.Storage[sl.ivec4]
    target: sl.StorageRW[sl.ivec4]

    def compute(self) -> None:
        i = sl.global_id().x
        a = self.source[i].x
        b = self.source[i].y
        o = 5 * i
        self.target[o] = sl.ivec4(a // b, a % b, int(float(a) / float(b)), sl.abs(a))
        self.target[o + 1] = sl.ivec4(a & b, a | b, a ^ b, ~a)
        self.target[o + 2] = sl.ivec4(a << 3, a >> 2, sl.min(a, b), sl.max(a, b))
        self.target[o + 3] = sl.ivec4(sl.sign(a), sl.clamp(a, -3, 3), -a, a * b - a + b)
        self.target[o + 4] = sl.ivec4(int(a < b), int(a == b), int(a <= b and a != 7), a if a > b else b)


def test_integer_arithmetic_equals_that_of_python(device: Device) -> None:
    pairs = [(7, 2), (-7, 2), (7, -2), (-7, -2), (0, 5), (6, 3), (-6, 3), (7, 7), (100, -9), (-1, 1)]
    rows = np.zeros((len(pairs), 4), "i4")
    rows[:, :2] = pairs
    expected = [
        [
            (a // b, a % b, int(a / b), abs_(a)),
            (a & b, a | b, a ^ b, ~a),
            (a << 3, a >> 2, min_(a, b), max_(a, b)),
            ((a > 0) - (a < 0), min_(3, max_(-3, a)), -a, a * b - a + b),
            (a < b, a == b, a <= b and a != 7, a if a > b else b),
        ]
        for a, b in pairs
    ]
    assert_same(run(device, Integers, sl.ivec4, rows, 5), expected)


abs_: Callable[[int], int] = int.__abs__
min_: Callable[[int, int], int] = lambda a, b: a if a < b else b  # noqa: E731
max_: Callable[[int, int], int] = lambda a, b: a if a > b else b  # noqa: E731


class Bits(sl.Shader):
    """Unsigned arithmetic and bit functions."""

    source: sl.Storage[sl.uint]
    target: sl.StorageRW[sl.uvec4]

    def compute(self) -> None:
        i = sl.global_id().x
        a = self.source[i]
        o = 4 * i
        self.target[o] = sl.uvec4(a + sl.uint(7), a * sl.uint(3), a - sl.uint(9), a >> sl.uint(4))
        self.target[o + 1] = sl.uvec4(
            sl.uint(sl.bit_count(a)), sl.uint(sl.find_lsb(a)), sl.uint(sl.find_msb(a)), sl.bitfield_reverse(a)
        )
        self.target[o + 2] = sl.uvec4(
            sl.bitfield_extract(a, 4, 8),
            sl.bitfield_insert(a, sl.uint(5), 8, 4),
            a // sl.uint(10),
            a % sl.uint(10),
        )
        self.target[o + 3] = sl.uvec4(sl.uint(a > sl.uint(1 << 30)), ~a, a << sl.uint(5), a & sl.uint(0xFF00))


def test_bits_are_moved_and_counted(device: Device) -> None:
    values = np.array([1, 2, 0xFF, 0x80000000, 0xFFFFFFFF, 0x12345678, 1 << 30, 10], "u4")
    wrap = 1 << 32
    expected = []
    for a in map(int, values):
        reverse = int(f"{a:032b}"[::-1], 2)
        expected.append(
            [
                ((a + 7) % wrap, a * 3 % wrap, (a - 9) % wrap, a >> 4),
                (a.bit_count(), (a & -a).bit_length() - 1, a.bit_length() - 1, reverse),
                (a >> 4 & 0xFF, (a & ~0xF00) | 0x500, a // 10, a % 10),
                (a > 1 << 30, ~a % wrap, (a << 5) % wrap, a & 0xFF00),
            ]
        )
    assert_same(run(device, Bits, sl.uint, values, 4, sl.uvec4), expected)


class Packing(sl.Shader):
    """Packed numbers."""

    source: sl.Storage[sl.vec4]
    target: sl.StorageRW[sl.uvec4]

    def compute(self) -> None:
        v = self.source[sl.global_id().x]
        half = sl.pack_half_2x16(v.xy)
        unorm = sl.pack_unorm_4x8(v)
        again = sl.pack_unorm_4x8(sl.unpack_unorm_4x8(unorm))
        back = sl.unpack_half_2x16(half)
        self.target[2 * sl.global_id().x] = sl.uvec4(half, unorm, sl.pack_snorm_4x8(v), again)
        self.target[2 * sl.global_id().x + 1] = sl.uvec4(
            sl.float_bits_to_uint(back.x), sl.float_bits_to_uint(back.y), 0, 0
        )


def test_packed_numbers_are_rounded_to_the_nearest(device: Device) -> None:
    rows = np.array([(0.0, 1.0, 0.5, -1.0), (0.25, -0.25, 2.0, 0.2), (-3.0, 100.0, 0.1, 0.9)], "f4")
    back = run(device, Packing, sl.vec4, rows, 2, sl.uvec4)
    halves = rows[:, :2].astype("f2")
    assert_same(back[:, 0, 0], halves.copy().view("u4")[:, 0])
    assert_same(back[:, 1, :2], halves.astype("f4").view("u4"))
    unorm = np.clip(rows.astype(np.float64), 0, 1) * 255
    assert_near(back[:, 0, 1:2].copy().view("u1"), unorm, 0.51, "rounding to the nearest")
    snorm = np.clip(rows.astype(np.float64), -1, 1) * 127
    assert_near(back[:, 0, 2:3].copy().view("i1"), snorm, 0.51, "rounding to the nearest")
    assert_same(back[:, 0, 3], back[:, 0, 1])


class Conversions(sl.Shader):
    """Conversions between kinds of numbers."""

    source: sl.Storage[float]
    target: sl.StorageRW[sl.ivec4]

    def compute(self) -> None:
        x = self.source[sl.global_id().x]
        self.target[sl.global_id().x] = sl.ivec4(int(x), int(bool(x)), int(sl.floor(x)), int(sl.round(x)))


def test_conversions_cut_towards_zero(device: Device) -> None:
    x = np.array([-2.7, -2.5, -1.0, -0.3, 0.0, 0.3, 1.5, 2.5, 1000.9], "f4")
    expected = [(int(v), bool(v), math.floor(v), np.round(v)) for v in x]
    with device.storage(float, x) as source, device.storage(sl.ivec4, len(x)) as target:
        device.dispatch(device.program(Conversions), len(x), source=source, target=target)
        assert_same(target.read(), expected)


# -- statements --------------------------------------------------------------------------------------------


class Collatz(sl.Shader):
    """Loops whose length depends on the data."""

    source: sl.Storage[sl.uint]
    target: sl.StorageRW[sl.uint]

    def compute(self) -> None:
        n = self.source[sl.global_id().x]
        steps = sl.uint(0)
        while n != sl.uint(1):
            if n % sl.uint(2) == sl.uint(0):
                n //= sl.uint(2)
            else:
                n = sl.uint(3) * n + sl.uint(1)
            steps += sl.uint(1)
        self.target[sl.global_id().x] = steps


def collatz(n: int) -> int:
    steps = 0
    while n != 1:
        n = n // 2 if n % 2 == 0 else 3 * n + 1
        steps += 1
    return steps


def test_loops_run_as_often_as_their_data_says(device: Device) -> None:
    values = np.arange(1, 101, dtype="u4")
    assert_same(run(device, Collatz, sl.uint, values, 1)[:, 0], [collatz(int(n)) for n in values])


@sl.function
def first_divisor(n: int) -> int:
    """Returns from inside a loop."""
    if n < 2:
        return 0
    for d in range(2, n):
        if d * d > n:
            break
        if n % d == 0:
            return d
    return n


@sl.function
def raised(values: sl.vec3, by: float = 1.0) -> sl.vec3:
    """Changes only its own copy."""
    values.x += by
    values *= 2.0
    return values


class Control(sl.Shader):
    """break, continue, early return, nested loops, ranges with steps, copies."""

    source: sl.Storage[int]
    target: sl.StorageRW[sl.ivec4]

    def compute(self) -> None:
        i = sl.global_id().x
        n = self.source[i]
        odd = 0
        for k in range(n):
            if k % 2 == 0:
                continue
            if k > 9:
                break
            odd += k
        down = 0
        for k in range(10, n, -3):
            down = 10 * down + k % 10
        pairs = 0
        for a in range(n):
            for b in range(a, n):
                if (a + b) % 3 == 0:
                    pairs += 1
        self.target[2 * i] = sl.ivec4(first_divisor(n), odd, down, pairs)
        v = sl.vec3(1.0, 2.0, 3.0)
        w = raised(v)
        u = raised(v, 5.0)
        self.target[2 * i + 1] = sl.ivec4(int(v.x), int(w.x), int(u.x), int(w.z))
        if n > 12:
            return
        self.target[2 * i].y += 1000


def test_control_flow_is_python_s(device: Device) -> None:
    values = np.arange(0, 20, dtype="i4")
    back = run(device, Control, int, values, 2, sl.ivec4)
    for n, got in zip(map(int, values), back, strict=True):
        divisor = next((d for d in range(2, n) if n % d == 0), n) if n > 1 else 0
        odd = sum(k for k in range(n) if k % 2 and k <= 9) + (1000 if n <= 12 else 0)
        down = 0
        for k in range(10, n, -3):
            down = 10 * down + k % 10
        pairs = sum((a + b) % 3 == 0 for a in range(n) for b in range(a, n))
        assert_same(got[0], (divisor, odd, down, pairs))
        assert_same(got[1], (1, 4, 12, 6))


class Waterfall(sl.Shader):
    """Goes through the values of the invocations that run together one after the other; some wait for
    nothing."""

    source: sl.Storage[int]
    target: sl.StorageRW[int]

    def compute(self) -> None:
        number = self.source[sl.global_id().x]
        if number >= 0:
            total = 0
            while True:
                shared = sl.broadcast_first(number)
                if number == shared:
                    for k in range(shared):
                        total += k * shared
                    break
            self.target[sl.global_id().x] = total


def test_a_loop_over_broadcast_values_gives_each_invocation_its_own_result(device: Device) -> None:
    random = np.random.default_rng(3)
    counts = np.r_[random.integers(-3, 9, 64), np.repeat([4, 7], [21, 12]), np.arange(31)].astype("i4")
    sums = run(device, Waterfall, int, counts, 1)[:, 0]
    assert_same(sums, [sum(k * n for k in range(n)) if n >= 0 else 0 for n in counts.tolist()])


class Short(sl.Shader):
    """`and`, `or` and conditional expressions evaluate what they need, and count what they evaluate."""

    source: sl.Storage[int]
    target: sl.StorageRW[sl.ivec4]

    def count(self, i: int, value: bool) -> bool:
        self.target[i].w += 1
        return value

    def compute(self) -> None:
        i = sl.global_id().x
        n = self.source[i]
        both = n > 5 and self.count(i, n > 6)
        either = n < 3 or self.count(i, n == 6)
        selected = n if 2 < n <= 6 else int(self.count(i, n > 0))
        self.target[i].xyz = sl.ivec3(int(both), int(either), selected)


def test_conditions_stop_early(device: Device) -> None:
    values = np.array([9, 0, 6, 3, 7, 2], "i4")
    expected = [(1, 0, 1, 3), (0, 1, 0, 1), (0, 1, 6, 2), (0, 0, 3, 1), (1, 0, 1, 3), (0, 1, 1, 1)]
    assert_same(run(device, Short, int, values, 1, sl.ivec4)[:, 0], expected)


class Particle(sl.Struct):
    """A struct to be copied."""

    position: sl.vec3
    age: float


class Locals(sl.Shader):
    """Local arrays and structs are values."""

    source: sl.Storage[float]
    target: sl.StorageRW[sl.vec4]

    def compute(self) -> None:
        values = sl.array(float, 8)
        for k in range(8):
            values[k] = self.source[k]
        for _ in range(8):
            for b in range(7, 0, -1):
                if values[b] < values[b - 1]:
                    swap = values[b]
                    values[b] = values[b - 1]
                    values[b - 1] = swap
        copy = values
        copy[0] = 99.0
        first = Particle(position=sl.vec3(1.0, 2.0, 3.0), age=4.0)
        second = first
        second.position.y = 50.0
        second.age += 1.0
        self.target[0] = sl.vec4(values[0], values[1], values[2], values[3])
        self.target[1] = sl.vec4(values[4], values[5], values[6], values[-1])
        self.target[2] = sl.vec4(copy[0], first.position.y, second.position.y, second.age - first.age)


def test_arrays_and_structs_are_copied(device: Device) -> None:
    values = np.array([5, 3, 8, 1, 9, 2, 7, 4], "f4")
    with device.storage(float, values) as source, device.storage(sl.vec4, 3) as target:
        device.dispatch(device.program(Locals), 1, source=source, target=target)
        back = target.read()
    assert_same(back[:2].reshape(-1), np.sort(values))
    assert_same(back[2], (99, 2, 50, 1))


class Pair(sl.Struct):
    """Members of several kinds and widths."""

    first: sl.vec3
    count: int
    last: sl.vec2


@sl.function
def make_pair(x: float) -> Pair:
    """Return a struct whose members all differ."""
    return Pair(first=sl.vec3(x, x + 1.0, x + 2.0), count=int(x) + 10, last=sl.vec2(x + 20.0, x + 30.0))


class Members(sl.Shader):
    """Reads each member of what a function returns, where it is called."""

    source: sl.Storage[float]
    target: sl.StorageRW[float]

    def compute(self) -> None:
        i = sl.global_id().x
        x = self.source[i]
        self.target[4 * i] = make_pair(x).first.z
        self.target[4 * i + 1] = float(make_pair(x).count)
        self.target[4 * i + 2] = make_pair(x).last.x
        self.target[4 * i + 3] = make_pair(x + 1.0).last.y


def test_members_of_a_returned_struct_are_read_where_it_is_returned(device: Device) -> None:
    x = np.array([1.0, 5.0], "f4")
    assert_same(run(device, Members, float, x, 4), np.stack([x + 2, x + 10, x + 20, x + 31], axis=-1))


class Together(sl.Shader):
    """Assigns several targets at once: variables, components and elements, some of which the values read."""

    source: sl.Storage[float]
    target: sl.StorageRW[float]

    def compute(self) -> None:
        i = sl.global_id().x
        a, b = self.source[i], 2
        v, c = sl.vec3(1.0, 2.0, a), float(b)
        share: float = 1
        for _n in range(7):
            a, c = c, a + c
        v.x, v.z, share = v.z, v.x, share / 4
        elements = sl.array(float, 3)
        k, elements[0], elements[1] = 1, a, c
        k, elements[k] = 2, elements[0] + float(k)
        self.target[6 * i], self.target[6 * i + 1] = elements[2], elements[1]
        self.target[6 * i + 2], self.target[6 * i + 3] = v.x, v.z
        self.target[6 * i + 4], self.target[6 * i + 5] = share + float(k), c


def test_targets_are_assigned_once_all_values_are_known(device: Device) -> None:
    def expect(a: float) -> list[float]:
        c, x, z, share = 2.0, 1.0, a, 1.0
        for _n in range(7):
            a, c = c, a + c
        x, z, share = z, x, share / 4
        elements = [0.0, 0.0, 0.0]
        k, elements[0], elements[1] = 1, a, c
        k, elements[k] = 2, elements[0] + float(k)
        return [elements[2], elements[1], x, z, share + float(k), c]

    source = np.array([1.0, 5.0, -3.0], "f4")
    assert_same(run(device, Together, float, source, 6), np.array([expect(x) for x in source.tolist()], "f4"))


class Ordered(sl.Shader):
    """Operands that read what calls beside them write, in memory, in shared memory and in an image.

    One invocation of a whole group works: llvmpipe lets those that a group lacks go round in loops.
    """

    work_group = (8,)
    numbers: sl.StorageRW[int]
    texels: sl.IntImage2D = sl.image(Format.R32I)
    part = sl.shared(int, 2)
    target: sl.StorageRW[int]

    def grow(self) -> int:
        self.numbers[0] = self.numbers[0] + 1
        return self.numbers[0]

    def grow_part(self) -> int:
        self.part[0] = self.part[0] + 1
        return self.part[0]

    def grow_texel(self) -> int:
        number = self.texels.load(sl.ivec2(0, 0)).x + 1
        self.texels.store(sl.ivec2(0, 0), sl.ivec4(number, 0, 0, 1))
        return number

    def pair(self, first: int, second: int) -> int:
        return first * 100 + second

    def sum(self) -> int:
        return self.numbers[0] * 100 + self.grow()

    def compute(self) -> None:
        if sl.local_index() == 0:
            self.evaluate()

    def evaluate(self) -> None:
        self.part[0] = 4
        self.texels.store(sl.ivec2(0, 0), sl.ivec4(4, 0, 0, 1))
        self.target[0] = self.numbers[0] * 100 + self.grow()
        self.target[1] = self.grow() * 100 + self.numbers[0]
        self.target[2] = self.pair(self.numbers[0], self.grow())
        self.target[3] = self.sum()
        self.target[4] = int(self.numbers[0] == self.grow())
        self.target[5] = self.numbers[0] * 100 + sl.atomic_add(self.numbers[0], 1)
        self.target[6] = sl.ivec2(self.numbers[0], self.grow()).x
        self.target[7] = self.numbers[0] if self.grow() > 0 else 0
        self.target[8] = int(self.numbers[0] > 0 and self.numbers[0] == self.grow())
        self.numbers[0] += self.grow()
        self.target[9] = self.numbers[0]
        self.numbers[1 + (self.numbers[0] & 1)] += self.grow()
        self.target[10] = self.numbers[1] * 100 + self.numbers[2]
        self.numbers[0] = 0
        steps = 0
        while self.numbers[0] + self.grow() < 10:
            steps += 1
        self.target[11] = steps
        for k in range(self.numbers[0], self.grow() + 2):
            self.target[12] = k
        self.target[13] = sl.atomic_add(self.numbers[3 + (self.grow() & 1)], self.numbers[0])
        self.target[14] = self.numbers[3] * 100 + self.numbers[4]
        self.target[15] = self.part[0] * 100 + self.grow_part()
        self.target[16] = self.texels.load(sl.ivec2(0, 0)).x * 100 + self.grow_texel()


@pytest.mark.requires("max_image_slots")
def test_operands_are_evaluated_from_left_to_right(device: Device) -> None:
    with (
        device.storage(int, np.array([4, 0, 0, 0, 0], "i4")) as numbers,
        device.storage(int, 17) as target,
        device.texture((1, 1), Format.R32I) as texels,
    ):
        device.dispatch(device.program(Ordered), 1, numbers=numbers, target=target, texels=texels.image())
        back = target.read()
    # The first number is 4, and grows by one at each call.
    expected = [405, 606, 607, 708, 0, 909, 10, 12, 0, 13 + 14, 28, 5, 8, 0, 800, 405, 405]
    assert_same(back, expected)


class Alike(sl.Struct):
    """Fields whose names are similar, or words of shading languages."""

    a: float
    a_: float
    a__: float
    b_b: float
    b__b: float
    input: float
    input_: float
    target: float
    target_: float
    a_2: float


class NamesAlike(sl.Shader):
    """Bindings, shared memory, functions and variables with similar names."""

    u: sl.Uniform[Alike]
    u_: sl.Storage[Alike]
    u__: sl.StorageRW[float]
    s = sl.shared(float, 1)
    s_ = sl.shared(float, 1)

    def f(self, x: float, x_: float) -> float:
        return x

    def f_(self, x_: float, x: float) -> float:
        return x

    def compute(self) -> None:
        y = Alike(
            a=1.0,
            a_=2.0,
            a__=3.0,
            b_b=4.0,
            b__b=5.0,
            input=6.0,
            input_=7.0,
            target=8.0,
            target_=9.0,
            a_2=10.0,
        )
        y_ = y
        y_.a_ += 100.0
        self.s[0] = 1.0
        self.s_[0] = 2.0
        self.u__[0] = self.u.a
        self.u__[1] = self.u.a_
        self.u__[2] = self.u.a__
        self.u__[3] = self.u.b_b
        self.u__[4] = self.u.b__b
        self.u__[5] = self.u.input
        self.u__[6] = self.u.input_
        self.u__[7] = self.u.target
        self.u__[8] = self.u.target_
        self.u__[9] = self.u.a_2
        self.u__[10] = self.u_[0].a
        self.u__[11] = self.u_[0].a_
        self.u__[12] = self.u_[0].b__b
        self.u__[13] = self.u_[0].input_
        self.u__[14] = y.a_
        self.u__[15] = y_.a_ + y_.a + y_.a__
        self.u__[16] = self.s[0]
        self.u__[17] = self.s_[0]
        self.u__[18] = self.f(1.0, 2.0)
        self.u__[19] = self.f_(1.0, 2.0)


def test_names_that_differ_in_underscores_are_two(device: Device) -> None:
    names = [field.name for field in Alike.shading_type.fields]
    values = {name: float(number) for number, name in enumerate(names)}
    rows = np.zeros(1, Alike.dtype)
    for name, number in values.items():
        rows[name] = number + 50.0
    with device.storage(Alike, rows) as stored, device.storage(float, 20) as target:
        device.dispatch(device.program(NamesAlike), 1, u=Alike(**values), u_=stored, u__=target)
        back = target.read()
    assert_same(back, [*range(10), 50, 51, 54, 56, 2, 106, 1, 2, 1, 2])


class Base(sl.Shader):
    """A shader to inherit from."""

    scale = 2.0
    detailed = False
    source: sl.Storage[float]
    target: sl.StorageRW[float]

    def shade(self, x: float) -> float:
        if self.detailed:
            return x * self.scale + 100.0
        return x * self.scale

    def compute(self) -> None:
        i = sl.global_id().x
        self.target[i] = self.shade(self.source[i]) + (1000.0 if self.detailed else 0.0)


class Derived(Base):
    """Overrides a constant, and a method that calls the base's."""

    scale = 3.0

    def shade(self, x: float) -> float:
        return super().shade(x) + 0.5


class Variant(Derived):
    """Takes the other branch."""

    detailed = True


@pytest.mark.parametrize(
    ("shader", "expected"),
    [(Base, (2, 4)), (Derived, (3.5, 6.5)), (Variant, (1103.5, 1106.5))],
    ids=["base", "derived", "variant"],
)
def test_a_shader_inherits_and_overrides(device: Device, shader: Any, expected: tuple[float, float]) -> None:
    assert_same(run(device, shader, float, np.array([1, 2], "f4"), 1)[:, 0], expected)
