"""The shading language as it runs: every family of built-in function and every statement against NumPy and Python.

Tolerances are in units of float32's precision at the result, generous enough for fast approximations; what must
be exact (integers, bits, comparisons, control flow) is compared exactly.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from rhi import Device
from rhi.conformance.compare import assert_near, assert_same
from rhi.shading import (
    Shader,
    Storage,
    StorageRW,
    Struct,
    abs,
    acos,
    all,
    any,
    array,
    asin,
    atan,
    atan2,
    bit_count,
    bitfield_extract,
    bitfield_insert,
    bitfield_reverse,
    broadcast_first,
    ceil,
    clamp,
    cos,
    cosh,
    cross,
    degrees,
    determinant,
    distance,
    dot,
    exp,
    exp2,
    find_lsb,
    find_msb,
    float_bits_to_uint,
    floor,
    fma,
    fract,
    function,
    global_id,
    inverse,
    inversesqrt,
    isinf,
    isnan,
    ivec4,
    length,
    less_than,
    log,
    log2,
    mat3,
    max,
    min,
    mix,
    normalize,
    pack_half_2x16,
    pack_snorm_4x8,
    pack_unorm_4x8,
    pow,
    radians,
    reflect,
    refract,
    round,
    sign,
    sin,
    smoothstep,
    sqrt,
    step,
    tan,
    tanh,
    transpose,
    trunc,
    uint,
    uint_bits_to_float,
    unpack_half_2x16,
    unpack_unorm_4x8,
    uvec4,
    vec2,
    vec3,
    vec4,
)

pytestmark = pytest.mark.needs("shading", "compute")

Array = NDArray[Any]


def run(device: Device, shader: Any, element: Any, inputs: Array, outputs: int, result: Any = None) -> Array:
    """Run one invocation per row of `inputs`; return (n, outputs, …) results, `outputs` rows for each."""
    result = result or element
    with device.storage(element, inputs) as source, device.storage(result, len(inputs) * outputs) as target:
        device.dispatch(device.program(shader), len(inputs), source=source, target=target)
        back = target.read()
    return back.reshape(len(inputs), outputs, *back.shape[1:])


# -- functions of floats -----------------------------------------------------------------------------------


class Angles(Shader):
    """Trigonometry."""

    source: Storage[float]
    target: StorageRW[float]

    def compute(self) -> None:
        i = global_id().x
        x = self.source[i]
        o = 11 * i
        self.target[o] = sin(x)
        self.target[o + 1] = cos(x)
        self.target[o + 2] = tan(x)
        self.target[o + 3] = atan(x)
        self.target[o + 4] = asin(clamp(x, -1.0, 1.0))
        self.target[o + 5] = acos(clamp(x, -1.0, 1.0))
        self.target[o + 6] = radians(x)
        self.target[o + 7] = degrees(x)
        self.target[o + 8] = cosh(x)
        self.target[o + 9] = tanh(x)
        self.target[o + 10] = atan2(x, 0.5)


def test_trigonometric_functions_are_near_float64_s(device: Device) -> None:
    x = np.array([-3.0, -1.5, -1.0, -0.7, -0.1, 0.0, 0.2, 0.5, 1.0, 1.4, 2.0, 3.1], "f4")
    d = x.astype(np.float64)
    c = np.clip(d, -1, 1)
    expected = [np.sin(d), np.cos(d), np.tan(d), np.arctan(d), np.arcsin(c), np.arccos(c), np.radians(d), np.degrees(d),
                np.cosh(d), np.tanh(d), np.arctan2(d, 0.5)]  # fmt: skip
    wanted = np.stack(expected, axis=1)
    assert_near(run(device, Angles, float, x, 11), wanted, 1e-3 + 1e-4 * np.abs(wanted), "approximations")


class Powers(Shader):
    """Exponentials, logarithms, roots."""

    source: Storage[float]
    target: StorageRW[float]

    def compute(self) -> None:
        i = global_id().x
        x = self.source[i]
        o = 9 * i
        self.target[o] = exp(x)
        self.target[o + 1] = exp2(x)
        self.target[o + 2] = log(x)
        self.target[o + 3] = log2(x)
        self.target[o + 4] = sqrt(x)
        self.target[o + 5] = inversesqrt(x)
        self.target[o + 6] = pow(x, 2.5)
        self.target[o + 7] = x**3
        self.target[o + 8] = pow(x, -1.0)


def test_powers_and_roots_are_near_float64_s(device: Device) -> None:
    x = np.array([0.01, 0.3, 0.5, 0.999, 1.0, 1.001, 2.0, 3.7, 10.0, 20.0], "f4")
    d = x.astype(np.float64)
    expected = [np.exp(d), np.exp2(d), np.log(d), np.log2(d), np.sqrt(d), d**-0.5, d**2.5, d**3, 1 / d]
    wanted = np.stack(expected, axis=1)
    slack = 2e-6 + 3e-5 * np.abs(wanted)
    slack[:, 4:6] = 2e-7 + 1e-6 * np.abs(wanted[:, 4:6])
    assert_near(run(device, Powers, float, x, 9), wanted, slack, "approximations; roots nearly exact")


class Steps(Shader):
    """Functions with steps, whose results are exact."""

    source: Storage[float]
    target: StorageRW[float]

    def compute(self) -> None:
        i = global_id().x
        x = self.source[i]
        o = 14 * i
        self.target[o] = floor(x)
        self.target[o + 1] = ceil(x)
        self.target[o + 2] = trunc(x)
        self.target[o + 3] = round(x)
        self.target[o + 4] = fract(x)
        self.target[o + 5] = abs(x)
        self.target[o + 6] = sign(x)
        self.target[o + 7] = min(x, 0.75)
        self.target[o + 8] = max(x, 0.75)
        self.target[o + 9] = clamp(x, -1.0, 1.0)
        self.target[o + 10] = step(0.5, x)
        self.target[o + 11] = smoothstep(-2.0, 2.0, x)
        self.target[o + 12] = mix(2.0, 6.0, x)
        self.target[o + 13] = fma(x, 2.0, 1.0)


def test_functions_with_steps_are_exact(device: Device) -> None:
    x = np.array([-2.5, -2.0, -1.5, -0.5, -0.25, 0.0, 0.5, 0.75, 1.0, 1.5, 2.5, 3.5, 1e6], "f4")
    d = x.astype(np.float64)
    t = np.clip((d + 2) / 4, 0, 1)
    expected = [np.floor(d), np.ceil(d), np.trunc(d), np.round(d), d - np.floor(d), np.abs(d), np.sign(d),
                np.minimum(d, 0.75), np.maximum(d, 0.75), np.clip(d, -1, 1), d >= 0.5, t * t * (3 - 2 * t),
                2 + 4 * d, 2 * d + 1]  # fmt: skip
    wanted = np.stack(expected, axis=1)
    back = run(device, Steps, float, x, 14)
    assert_same(back[:, :11], wanted[:, :11])
    assert_near(back[:, 11:], wanted[:, 11:], 1e-6 * np.maximum(1, np.abs(wanted[:, 11:])), "float32")


class Specials(Shader):
    """Infinities and NaN, made from bits."""

    source: Storage[uint]
    target: StorageRW[uint]

    def compute(self) -> None:
        i = global_id().x
        x = uint_bits_to_float(self.source[i])
        bits = uint(0)
        if isnan(x):
            bits |= uint(1)
        if isinf(x):
            bits |= uint(2)
        if x == x:
            bits |= uint(4)
        if x > 1.0:
            bits |= uint(8)
        self.target[2 * i] = bits
        self.target[2 * i + 1] = float_bits_to_uint(x)


def test_infinities_and_nan_are_known_for_what_they_are(device: Device) -> None:
    values = np.array([0.0, -0.0, 1.5, np.inf, -np.inf, np.nan], "f4")
    back = run(device, Specials, uint, values.view("u4"), 2)
    assert_same(back[:, 0], [4, 4, 12, 14, 6, 1])
    assert_same(back[:5, 1], values[:5].view("u4"))


# -- vectors and matrices ----------------------------------------------------------------------------------


class Geometry(Shader):
    """Geometric functions of two vectors."""

    source: Storage[vec4]
    target: StorageRW[vec4]

    def compute(self) -> None:
        i = global_id().x
        a = self.source[i].xyz
        b = self.source[i].zwx
        n = normalize(b)
        self.target[5 * i] = vec4(dot(a, b), length(a), distance(a, b), dot(n, n))
        self.target[5 * i + 1] = vec4(cross(a, b), 0.0)
        self.target[5 * i + 2] = vec4(reflect(a, n), 0.0)
        self.target[5 * i + 3] = vec4(refract(normalize(a), n, 0.8), 0.0)
        self.target[5 * i + 4] = vec4(mix(a, b, 0.25), float(any(less_than(a, b))) + 2.0 * float(all(less_than(a, b))))


def test_geometric_functions_of_vectors_are_numpy_s(device: Device) -> None:
    rng = np.random.default_rng(1)
    rows = rng.normal(size=(20, 4)).astype("f4")
    back = run(device, Geometry, vec4, rows, 5)
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


class Matrices(Shader):
    """Functions of a matrix made from rows."""

    source: Storage[vec4]
    target: StorageRW[vec4]

    def compute(self) -> None:
        m = mat3(self.source[0].xyz, self.source[1].xyz, self.source[2].xyz)
        i = inverse(m)
        t = transpose(m)
        scaled = m * 2.0
        one = m @ i
        for row in range(3):
            self.target[row] = vec4(i[row], one[row][row])
            self.target[3 + row] = vec4(t[row], determinant(m))
            self.target[6 + row] = vec4(scaled[row], m[row][2])
        m[1][2] = 99.0
        self.target[9] = vec4(m[1], 0.0)


def test_matrices_are_rows_as_numpy_s(device: Device) -> None:
    m = np.array([(2.0, 1, 0), (0.5, 3, -1), (1, 0, 4)])
    rows = np.zeros((3, 4), "f4")
    rows[:, :3] = m
    with device.storage(vec4, rows) as source, device.storage(vec4, 10) as target:
        device.dispatch(device.program(Matrices), 1, source=source, target=target)
        back = target.read()
    assert_near(back[:3, :3], np.linalg.inv(m), 1e-6, "float32")
    assert_near(back[:3, 3], 1, 1e-6, "float32")
    assert_same(back[3:6, :3], m.T)
    assert_near(back[3:6, 3], np.linalg.det(m), 1e-5, "float32")
    assert_same(back[6:9, :3], 2 * m)
    assert_same(back[6:9, 3], m[:, 2])
    assert_same(back[9, :3], (0.5, 3, 99))


class Swizzles(Shader):
    """Components read and written in any order."""

    source: Storage[vec4]
    target: StorageRW[vec4]

    def compute(self) -> None:
        v = self.source[0]
        w = v
        w.xz = v.wy
        w.g += 10.0
        v[3] = 7.0
        self.target[0] = v.wzyx
        self.target[1] = w
        self.target[2] = vec4(v.xx, v.bgr.yz)
        self.target[3].yz = vec2(5.0, 6.0)
        u = vec4(1.0)
        u.xyz = (2.0, 3.0, 4.0)
        self.target[4] = u * v + vec4(v.xyz, 1.0) / 2.0 - u


def test_components_are_read_and_written_in_any_order(device: Device) -> None:
    with device.storage(vec4, np.array([(1, 2, 3, 4)], "f4")) as source, device.storage(vec4, 5) as target:
        device.dispatch(device.program(Swizzles), 1, source=source, target=target)
        back = target.read()
    assert_same(back[0], (7, 3, 2, 1))
    assert_same(back[1], (4, 12, 2, 4))
    assert_same(back[2], (1, 1, 2, 1))
    assert_same(back[3], (0, 5, 6, 0))
    assert_same(back[4], (0.5, 4, 9.5, 6.5))


# -- integers ----------------------------------------------------------------------------------------------


class Integers(Shader):
    """Division and remainder as in Python, and bit operations."""

    source: Storage[ivec4]
    target: StorageRW[ivec4]

    def compute(self) -> None:
        i = global_id().x
        a = self.source[i].x
        b = self.source[i].y
        o = 5 * i
        self.target[o] = ivec4(a // b, a % b, int(float(a) / float(b)), abs(a))
        self.target[o + 1] = ivec4(a & b, a | b, a ^ b, ~a)
        self.target[o + 2] = ivec4(a << 3, a >> 2, min(a, b), max(a, b))
        self.target[o + 3] = ivec4(sign(a), clamp(a, -3, 3), -a, a * b - a + b)
        self.target[o + 4] = ivec4(int(a < b), int(a == b), int(a <= b and a != 7), a if a > b else b)


def test_integers_mean_what_they_mean_in_python(device: Device) -> None:
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
    assert_same(run(device, Integers, ivec4, rows, 5), expected)


abs_: Callable[[int], int] = int.__abs__
min_: Callable[[int, int], int] = lambda a, b: a if a < b else b  # noqa: E731
max_: Callable[[int, int], int] = lambda a, b: a if a > b else b  # noqa: E731


class Bits(Shader):
    """Unsigned arithmetic and bit functions."""

    source: Storage[uint]
    target: StorageRW[uvec4]

    def compute(self) -> None:
        i = global_id().x
        a = self.source[i]
        o = 4 * i
        self.target[o] = uvec4(a + uint(7), a * uint(3), a - uint(9), a >> uint(4))
        self.target[o + 1] = uvec4(uint(bit_count(a)), uint(find_lsb(a)), uint(find_msb(a)), bitfield_reverse(a))
        self.target[o + 2] = uvec4(
            bitfield_extract(a, 4, 8), bitfield_insert(a, uint(5), 8, 4), a // uint(10), a % uint(10)
        )
        self.target[o + 3] = uvec4(uint(a > uint(1 << 30)), ~a, a << uint(5), a & uint(0xFF00))


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
    assert_same(run(device, Bits, uint, values, 4, uvec4), expected)


class Packing(Shader):
    """Packed numbers."""

    source: Storage[vec4]
    target: StorageRW[uvec4]

    def compute(self) -> None:
        v = self.source[global_id().x]
        half = pack_half_2x16(v.xy)
        unorm = pack_unorm_4x8(v)
        again = pack_unorm_4x8(unpack_unorm_4x8(unorm))
        back = unpack_half_2x16(half)
        self.target[2 * global_id().x] = uvec4(half, unorm, pack_snorm_4x8(v), again)
        self.target[2 * global_id().x + 1] = uvec4(float_bits_to_uint(back.x), float_bits_to_uint(back.y), 0, 0)


def test_packed_numbers_are_rounded_to_the_nearest(device: Device) -> None:
    rows = np.array([(0.0, 1.0, 0.5, -1.0), (0.25, -0.25, 2.0, 0.2), (-3.0, 100.0, 0.1, 0.9)], "f4")
    back = run(device, Packing, vec4, rows, 2, uvec4)
    halves = rows[:, :2].astype("f2")
    assert_same(back[:, 0, 0], halves.copy().view("u4")[:, 0])
    assert_same(back[:, 1, :2], halves.astype("f4").view("u4"))
    unorm = np.clip(rows.astype(np.float64), 0, 1) * 255
    assert_near(back[:, 0, 1:2].copy().view("u1"), unorm, 0.51, "rounding to the nearest")
    snorm = np.clip(rows.astype(np.float64), -1, 1) * 127
    assert_near(back[:, 0, 2:3].copy().view("i1"), snorm, 0.51, "rounding to the nearest")
    assert_same(back[:, 0, 3], back[:, 0, 1])


class Conversions(Shader):
    """Conversions between kinds of numbers."""

    source: Storage[float]
    target: StorageRW[ivec4]

    def compute(self) -> None:
        x = self.source[global_id().x]
        self.target[global_id().x] = ivec4(int(x), int(bool(x)), int(floor(x)), int(round(x)))


def test_conversions_cut_towards_zero(device: Device) -> None:
    x = np.array([-2.7, -2.5, -1.0, -0.3, 0.0, 0.3, 1.5, 2.5, 1000.9], "f4")
    expected = [(int(v), bool(v), math.floor(v), np.round(v)) for v in x]
    with device.storage(float, x) as source, device.storage(ivec4, len(x)) as target:
        device.dispatch(device.program(Conversions), len(x), source=source, target=target)
        assert_same(target.read(), expected)


# -- statements --------------------------------------------------------------------------------------------


class Collatz(Shader):
    """Loops whose length depends on the data."""

    source: Storage[uint]
    target: StorageRW[uint]

    def compute(self) -> None:
        n = self.source[global_id().x]
        steps = uint(0)
        while n != uint(1):
            if n % uint(2) == uint(0):
                n //= uint(2)
            else:
                n = uint(3) * n + uint(1)
            steps += uint(1)
        self.target[global_id().x] = steps


def collatz(n: int) -> int:
    steps = 0
    while n != 1:
        n = n // 2 if n % 2 == 0 else 3 * n + 1
        steps += 1
    return steps


def test_loops_run_as_often_as_their_data_says(device: Device) -> None:
    values = np.arange(1, 101, dtype="u4")
    assert_same(run(device, Collatz, uint, values, 1)[:, 0], [collatz(int(n)) for n in values])


@function
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


@function
def raised(values: vec3, by: float = 1.0) -> vec3:
    """Changes only its own copy."""
    values.x += by
    values *= 2.0
    return values


class Control(Shader):
    """break, continue, early return, nested loops, ranges with steps, copies."""

    source: Storage[int]
    target: StorageRW[ivec4]

    def compute(self) -> None:
        i = global_id().x
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
        self.target[2 * i] = ivec4(first_divisor(n), odd, down, pairs)
        v = vec3(1.0, 2.0, 3.0)
        w = raised(v)
        u = raised(v, 5.0)
        self.target[2 * i + 1] = ivec4(int(v.x), int(w.x), int(u.x), int(w.z))
        if n > 12:
            return
        self.target[2 * i].y += 1000


def test_control_flow_is_python_s(device: Device) -> None:
    values = np.arange(0, 20, dtype="i4")
    back = run(device, Control, int, values, 2, ivec4)
    for n, got in zip(map(int, values), back, strict=True):
        divisor = next((d for d in range(2, n) if n % d == 0), n) if n > 1 else 0
        odd = sum(k for k in range(n) if k % 2 and k <= 9) + (1000 if n <= 12 else 0)
        down = 0
        for k in range(10, n, -3):
            down = 10 * down + k % 10
        pairs = sum((a + b) % 3 == 0 for a in range(n) for b in range(a, n))
        assert_same(got[0], (divisor, odd, down, pairs))
        assert_same(got[1], (1, 4, 12, 6))


class Waterfall(Shader):
    """Goes through the values of the invocations that run together one after the other; some wait for nothing."""

    source: Storage[int]
    target: StorageRW[int]

    def compute(self) -> None:
        own = self.source[global_id().x]
        if own >= 0:
            total = 0
            while True:
                shared = broadcast_first(own)
                if own == shared:
                    for k in range(shared):
                        total += k * shared
                    break
            self.target[global_id().x] = total


def test_a_loop_over_what_invocations_broadcast_gives_each_its_own(device: Device) -> None:
    random = np.random.default_rng(3)
    own = np.r_[random.integers(-3, 9, 64), np.repeat([4, 7], [21, 12]), np.arange(31)].astype("i4")
    found = run(device, Waterfall, int, own, 1)[:, 0]
    assert_same(found, [sum(k * n for k in range(n)) if n >= 0 else 0 for n in own.tolist()])


class Short(Shader):
    """`and` and `or` short-circuit: an element outside of the array isn't read."""

    source: Storage[int]
    target: StorageRW[ivec4]

    def compute(self) -> None:
        i = global_id().x
        count = len(self.source)
        after = int(i + 1 < count and self.source[i + 1] > 5)
        last = int(i + 1 >= count or self.source[i + 1] == 0)
        chained = int(2 < self.source[i] <= 6)
        self.target[i] = ivec4(after, last, chained, self.source[i] if i < 2 else -1)


def test_conditions_stop_early(device: Device) -> None:
    values = np.array([9, 0, 6, 3, 7, 2], "i4")
    expected = [
        (
            i + 1 < 6 and values[i + 1] > 5,
            i + 1 >= 6 or values[i + 1] == 0,
            2 < values[i] <= 6,
            values[i] if i < 2 else -1,
        )
        for i in range(6)
    ]
    assert_same(run(device, Short, int, values, 1, ivec4)[:, 0], expected)


class Particle(Struct):
    """A struct to be copied."""

    position: vec3
    age: float


class Locals(Shader):
    """Local arrays and structs are values."""

    source: Storage[float]
    target: StorageRW[vec4]

    def compute(self) -> None:
        values = array(float, 8)
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
        first = Particle(position=vec3(1.0, 2.0, 3.0), age=4.0)
        second = first
        second.position.y = 50.0
        second.age += 1.0
        self.target[0] = vec4(values[0], values[1], values[2], values[3])
        self.target[1] = vec4(values[4], values[5], values[6], values[-1])
        self.target[2] = vec4(copy[0], first.position.y, second.position.y, second.age - first.age)


def test_arrays_and_structs_are_copied(device: Device) -> None:
    values = np.array([5, 3, 8, 1, 9, 2, 7, 4], "f4")
    with device.storage(float, values) as source, device.storage(vec4, 3) as target:
        device.dispatch(device.program(Locals), 1, source=source, target=target)
        back = target.read()
    assert_same(back[:2].reshape(-1), np.sort(values))
    assert_same(back[2], (99, 2, 50, 1))


class Pair(Struct):
    """Members of several kinds and widths."""

    first: vec3
    count: int
    last: vec2


@function
def make_pair(x: float) -> Pair:
    """Return a struct whose members all differ."""
    return Pair(first=vec3(x, x + 1.0, x + 2.0), count=int(x) + 10, last=vec2(x + 20.0, x + 30.0))


class Members(Shader):
    """Reads each member of what a function returns, where it is called."""

    source: Storage[float]
    target: StorageRW[float]

    def compute(self) -> None:
        i = global_id().x
        x = self.source[i]
        self.target[4 * i] = make_pair(x).first.z
        self.target[4 * i + 1] = float(make_pair(x).count)
        self.target[4 * i + 2] = make_pair(x).last.x
        self.target[4 * i + 3] = make_pair(x + 1.0).last.y


def test_members_of_a_returned_struct_are_read_where_it_is_returned(device: Device) -> None:
    x = np.array([1.0, 5.0], "f4")
    assert_same(run(device, Members, float, x, 4), np.stack([x + 2, x + 10, x + 20, x + 31], axis=-1))


class Together(Shader):
    """Assigns several targets at once: variables, components and elements, some of which the values read."""

    source: Storage[float]
    target: StorageRW[float]

    def compute(self) -> None:
        i = global_id().x
        a, b = self.source[i], 2
        v, c = vec3(1.0, 2.0, a), float(b)
        share: float = 1
        for _n in range(7):
            a, c = c, a + c
        v.x, v.z, share = v.z, v.x, share / 4
        places = array(float, 3)
        k, places[0], places[1] = 1, a, c
        k, places[k] = 2, places[0] + float(k)
        self.target[6 * i], self.target[6 * i + 1] = places[2], places[1]
        self.target[6 * i + 2], self.target[6 * i + 3] = v.x, v.z
        self.target[6 * i + 4], self.target[6 * i + 5] = share + float(k), c


def test_targets_are_assigned_once_all_values_are_known(device: Device) -> None:
    def expect(a: float) -> list[float]:
        c, x, z, share = 2.0, 1.0, a, 1.0
        for _n in range(7):
            a, c = c, a + c
        x, z, share = z, x, share / 4
        places = [0.0, 0.0, 0.0]
        k, places[0], places[1] = 1, a, c
        k, places[k] = 2, places[0] + float(k)
        return [places[2], places[1], x, z, share + float(k), c]

    source = np.array([1.0, 5.0, -3.0], "f4")
    assert_same(run(device, Together, float, source, 6), np.array([expect(x) for x in source.tolist()], "f4"))


class Base(Shader):
    """A shader to inherit from."""

    scale = 2.0
    detailed = False
    source: Storage[float]
    target: StorageRW[float]

    def shade(self, x: float) -> float:
        if self.detailed:
            return x * self.scale + 100.0
        return x * self.scale

    def compute(self) -> None:
        i = global_id().x
        self.target[i] = self.shade(self.source[i])


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
    [(Base, (2, 4)), (Derived, (3.5, 6.5)), (Variant, (103.5, 106.5))],
    ids=["base", "derived", "variant"],
)
def test_a_shader_inherits_and_overrides(device: Device, shader: Any, expected: tuple[float, float]) -> None:
    assert_same(run(device, shader, float, np.array([1, 2], "f4"), 1)[:, 0], expected)
