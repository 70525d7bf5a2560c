"""Indices outside and operands at the edges: `docs/shading.md` has one result for each, on every backend.

What is read outside is the nearest element, what is written outside is dropped; a division by 0 is one by 1,
shifts use five bits of the count, floats become the nearest int. Expected values are Python's integers. The
stages of a draw are in `test_draw_bounds`, texels outside in `test_sampling`. `tests/rhi/shading/numpy` runs
the same shaders on NumPy.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import rhi.shading as sl
from rhi import Device
from rhi.conformance.compare import assert_same

Values = dict[str, NDArray[Any]]
GROUP = 16
GROUPS = 20
N = GROUP * GROUPS
MIN_INT, MAX_INT = -(2**31), 2**31 - 1
NUMBERS = (
    0,
    1,
    -1,
    2,
    -3,
    7,
    31,
    32,
    33,
    100,
    -32,
    -99999,
    65536,
    MAX_INT,
    MAX_INT - 1,
    MIN_INT,
    MIN_INT + 1,
)
FLOATS = (0.0, 0.9, -0.9, 1.5, -2.5, 2147483520.0, 2.0**31, -(2.0**31), -2147483904.0, 3e9, 4294967040.0, 2.0**32,
          1e30, -1e30, math.inf, -math.inf, math.nan, 1e-30, -1e-30, 16777216.0)  # fmt: skip


def wrapped(value: int) -> int:
    """Return an int of 32 bits."""
    return (value + 2**31) % 2**32 - 2**31


def divided(a: int, b: int) -> tuple[int, int]:
    """Return `a // b` and `a % b`, by 1 instead of by 0."""
    quotient, rest = divmod(a, b or 1)
    return wrapped(quotient), rest


def truncated(x: float, low: int, high: int) -> int:
    """Return the nearest integer in the direction of 0."""
    return 0 if x != x else int(max(low, min(high, x))) if math.isfinite(x) else (high if x > 0 else low)


def field(value: int, at: int, bits: int) -> tuple[int, int]:
    """Return the shift and the mask of a field of bits, of which the part inside the word counts."""
    start = min(at % 2**32, 32)
    return start, (1 << min(bits % 2**32, 32 - start)) - 1


class Operators(sl.Shader):
    """Every operator of ints whose result drivers leave open for some operands."""

    work_group = (GROUP,)
    a: sl.Storage[int]
    b: sl.Storage[int]
    ints: sl.StorageRW[int]
    uints: sl.StorageRW[sl.uint]

    def compute(self) -> None:
        i = sl.global_id().x
        a = self.a[i]
        b = self.b[i]
        o = 16 * i
        self.ints[o] = a // b
        self.ints[o + 1] = a % b
        self.ints[o + 2] = a << b
        self.ints[o + 3] = a >> b
        self.ints[o + 4] = a + b
        self.ints[o + 5] = a - b
        self.ints[o + 6] = a * b
        self.ints[o + 7] = -a
        self.ints[o + 8] = sl.abs(a)
        self.ints[o + 9] = sl.bitfield_extract(a, b, 5)
        self.ints[o + 10] = sl.bitfield_extract(a, 5, b)
        self.ints[o + 11] = sl.bitfield_insert(a, -1, b, 5)
        zero = self.a[0]  # a constant would be refused
        v = sl.ivec4(a, b, a, b) // sl.ivec4(b, a, -1, zero)
        w = sl.ivec4(a, b, a, b) % sl.ivec4(b, a, -1, zero)
        s = sl.ivec4(a, b, a, b) << sl.ivec4(b, a, zero + 33, zero - 1)
        self.ints[o + 12] = v.x ^ v.y ^ v.z ^ v.w
        self.ints[o + 13] = w.x ^ w.y ^ w.z ^ w.w
        self.ints[o + 14] = s.x ^ s.y ^ s.z ^ s.w
        self.ints[o + 15] = (a // 4) ^ (b % 8)
        x = sl.uint(a)
        y = sl.uint(b)
        self.uints[8 * i] = x // y
        self.uints[8 * i + 1] = x % y
        self.uints[8 * i + 2] = x << y
        self.uints[8 * i + 3] = x >> y
        self.uints[8 * i + 4] = sl.bitfield_extract(x, b, 5)
        self.uints[8 * i + 5] = sl.bitfield_insert(x, sl.uint(MAX_INT), 5, b)
        q = sl.uvec4(x, y, x, y) // sl.uvec4(y, x, sl.uint(zero), sl.uint(3))
        self.uints[8 * i + 6] = q.x ^ q.y ^ q.z ^ q.w
        r = sl.uvec4(x, y, x, y) % y
        self.uints[8 * i + 7] = r.x ^ r.y ^ r.z ^ r.w


def operands() -> Values:
    """Return all pairs of numbers, repeated to fill the work-groups."""
    pairs = list(itertools.product(NUMBERS, NUMBERS))
    a, b = np.array([pairs[i % len(pairs)] for i in range(N)], np.int32).T
    return {"a": a, "b": b}


def expected_operators() -> Values:
    inputs, ints, uints = operands(), [], []
    for a, b in zip(inputs["a"].tolist(), inputs["b"].tolist(), strict=True):
        shift, x, y = b % 32, a % 2**32, b % 2**32
        start, mask = field(a, b, 5)
        part, top = (x >> start) & mask, (mask + 1) >> 1
        _, low = field(a, 5, b)
        low_part, low_top = (x >> 5) & low, (low + 1) >> 1
        quotients = [divided(*pair) for pair in ((a, b), (b, a), (a, -1), (b, 0))]
        ints += [
            *divided(a, b),
            wrapped(a << shift),
            a >> shift,
            wrapped(a + b),
            wrapped(a - b),
            wrapped(a * b),
            wrapped(-a),
            wrapped(max(a, -a)),
            part - 2 * (part & top) if mask else 0,
            low_part - 2 * (low_part & low_top) if low else 0,
            wrapped((x & ~(mask << start)) | (mask << start)),
            wrapped(quotients[0][0] ^ quotients[1][0] ^ quotients[2][0] ^ quotients[3][0]),
            wrapped(quotients[0][1] ^ quotients[1][1] ^ quotients[2][1] ^ quotients[3][1]),
            wrapped((a << shift) ^ (b << (a % 32)) ^ (a << 1) ^ (b << 31)),
            (a // 4) ^ (b % 8),
        ]
        insert = field(x, 5, b)[1]
        rests = [divided(dividend, y)[1] for dividend in (x, y, x, y)]
        uints += [
            x // (y or 1),
            x % (y or 1),
            (x << shift) % 2**32,
            x >> shift,
            part,
            (x & ~(insert << 5)) | ((MAX_INT & insert) << 5),
            (x // (y or 1)) ^ (y // (x or 1)) ^ x ^ (y // 3),
            rests[0] ^ rests[1] ^ rests[2] ^ rests[3],
        ]
    return {"ints": np.array(ints, np.int64), "uints": np.array(uints, np.int64)}


class Conversions(sl.Shader):
    """Floats as ints, by scalars and by vectors."""

    work_group = (GROUP,)
    x: sl.Storage[float]
    ints: sl.StorageRW[int]
    uints: sl.StorageRW[sl.uint]

    def compute(self) -> None:
        i = sl.global_id().x
        x = self.x[i]
        self.ints[i] = int(x)
        self.uints[i] = sl.uint(x)
        v = sl.ivec4(sl.vec4(x, -x, 0.5 * x, 1.0))
        w = sl.uvec4(sl.vec4(x, -x, 0.5 * x, 1.0))
        self.ints[N + i] = v.x ^ v.y ^ v.z ^ v.w
        self.uints[N + i] = w.x ^ w.y ^ w.z ^ w.w


def floats() -> Values:
    return {"x": np.resize(np.array(FLOATS, np.float32), N)}


def expected_conversions() -> Values:
    results: dict[str, list[int]] = {"ints": [], "uints": []}
    numbers = floats()["x"].tolist()
    for name, least, most in (("ints", MIN_INT, MAX_INT), ("uints", 0, 2**32 - 1)):
        results[name] += [truncated(x, least, most) for x in numbers]
        for x in numbers:
            truncated_value, other, half = (truncated(value, least, most) for value in (x, -x, 0.5 * x))
            results[name].append(truncated_value ^ other ^ half ^ 1)
    return {name: np.array(values, np.int64) for name, values in results.items()}


# -- memory ------------------------------------------------------------------------------------------------


class Part(sl.Struct):
    """An element of some words, with an array inside."""

    weights: sl.Array[float] = sl.array(float, 3)
    end: float


class Fixed(sl.Struct):
    """Arrays and a matrix in uniform memory."""

    numbers: sl.Array[float] = sl.array(float, 5)
    rotation: sl.mat3


TABLE = (10.0, 20.0, 30.0, 40.0, 50.0, 60.0)
WORDS = 24
INDICES = (0, 1, 2, -1, 3, 4, 5, 6, -2, 15, 16, 17, 23, 24, 25, 1000, 100000, -100000, 1 << 20, 1 << 28, 500000000,
           MAX_INT, MIN_INT, MAX_INT - 16, MIN_INT + 16, -(1 << 28))  # fmt: skip
"""Indices inside the memory of the shaders below, just outside, and as far as 32 bits reach."""


class Reads(sl.Shader):
    """Reads of every kind of memory, at an index that only the device knows."""

    work_group = (GROUP,)
    at: sl.Storage[int]
    words: sl.Storage[float]
    parts: sl.Storage[Part]
    fixed: sl.Uniform[Fixed]
    out: sl.StorageRW[float]
    group_values = sl.shared(float, 8)

    def compute(self) -> None:
        i = sl.global_id().x
        k = self.at[i]
        first = self.at[i - i % GROUP]
        o = 12 * i
        if i % GROUP < 8:
            self.group_values[i % GROUP] = float(i % GROUP) + 1.0
        sl.barrier()
        self.out[o] = self.words[k]
        self.out[o + 1] = self.words[sl.uint(k)]
        self.out[o + 2] = self.words[i + first]
        self.out[o + 3] = self.parts[k].weights[k] + self.parts[k].end
        self.out[o + 4] = self.parts[1].weights[k] + self.parts[i + first].weights[1]
        self.out[o + 5] = self.fixed.numbers[k]
        self.out[o + 6] = self.fixed.rotation[k][k] + sl.mat3(1, 2, 3, 4, 5, 6, 7, 8, 9)[k][sl.uint(k)]
        self.out[o + 7] = TABLE[k] + self.group_values[k] + self.group_values[i % GROUP + first]
        table = sl.array(float, 7)
        for j in range(7):
            table[j] = float(3 * j)
        self.out[o + 8] = table[k] + table[sl.uint(k)]
        v = sl.vec4(1.0, 2.0, 3.0, 4.0)
        self.out[o + 9] = v[k] + 10.0 * v[sl.uint(k)]
        self.out[o + 10] = TABLE[sl.unchecked(i % 6)] + self.words[WORDS - 1]
        self.out[o + 11] = self.words[k] if 0 <= k < len(self.words) else -1.0


def invocation_indices() -> Values:
    """Return the indices of the invocations, one of each for the work-groups' first."""
    indices = np.resize(np.array(INDICES, np.int32), N)
    indices[::GROUP] = np.resize(np.array(INDICES[::-1], np.int32), GROUPS)
    return {"at": indices}


def memory() -> dict[str, Any]:
    words = np.arange(WORDS, dtype=np.float32) + 100
    parts = np.zeros(4, Part.dtype)
    parts["weights"] = np.arange(12).reshape(4, 3) * 2
    parts["end"] = (0.5, 1.5, 2.5, 3.5)
    fixed = Fixed(numbers=[1, 3, 5, 7, 9], rotation=np.arange(9).reshape(3, 3) + 1)
    return {"words": words, "parts": parts, "fixed": fixed}


def nearest(index: int, count: int) -> int:
    return max(0, min(index, count - 1))


def expected_reads() -> Values:
    inputs, at = memory(), invocation_indices()["at"].tolist()
    words, weights, ends = (
        inputs["words"].tolist(),
        inputs["parts"]["weights"].tolist(),
        inputs["parts"]["end"].tolist(),
    )
    numbers, rotation = [1, 3, 5, 7, 9], np.arange(9).reshape(3, 3) + 1
    out = []
    for i, k in enumerate(at):
        first, whole = at[i - i % GROUP], k % 2**32
        along, row, inner = wrapped(i + first), nearest(k, 4), nearest(k, 3)
        group_values = nearest(k, 8) + nearest(wrapped(i % GROUP + first), 8) + 2
        out += [
            words[nearest(k, WORDS)],
            words[nearest(whole, WORDS)],
            words[nearest(along, WORDS)],
            weights[row][inner] + ends[row],
            weights[1][inner] + weights[nearest(along, 4)][1],
            numbers[nearest(k, 5)],
            rotation[inner][inner] + rotation[inner][nearest(whole, 3)],
            TABLE[nearest(k, 6)] + group_values,
            3 * (nearest(k, 7) + nearest(whole, 7)),
            nearest(k, 4) + 1 + 10 * (nearest(whole, 4) + 1),
            TABLE[i % 6] + words[-1],
            words[k] if 0 <= k < WORDS else -1,
        ]
    return {"out": np.array(out, np.float64)}


class Writes(sl.Shader):
    """Writes to every kind of memory, at an index that only the device knows; no two meet."""

    work_group = (GROUP,)
    at: sl.Storage[int]
    words: sl.StorageRW[float]
    parts: sl.StorageRW[Part]
    counts: sl.StorageRW[int]
    out: sl.StorageRW[float]
    group_values = sl.shared(float, 8)
    sums = sl.shared(int, 8)

    def compute(self) -> None:
        i = sl.global_id().x
        k = self.at[i]
        o = 6 * i
        j = i % GROUP
        if j < 8:
            self.group_values[j] = 0.0
            self.sums[j] = 0
        sl.barrier()
        self.words[i + self.at[0]] = float(i) + 1.0
        self.words[WORDS - 4 - i] += 1000.0
        self.parts[i + 2].weights[k] = float(i) + 1.0
        self.parts[i - 1].end = 8.0
        self.group_values[j + self.at[i - j]] = float(j) + 1.0
        self.out[o] = float(sl.atomic_add(self.counts[k], 1) * 0)
        self.out[o + 1] = float(sl.atomic_compare_exchange(self.counts[k + (1 << 29)], 0, 5))
        sl.atomic_add(self.sums[k], 1)
        sl.barrier()
        self.out[o + 2] = self.group_values[j % 8] + 100.0 * float(self.sums[j % 8])
        table = sl.array(float, 3)
        other = sl.array(float, 3)
        table[k] = 7.0
        table[sl.uint(k)] += 20.0
        self.out[o + 3] = table[0] + 100.0 * table[1] + 10000.0 * table[2] + other[0] + other[1] + other[2]
        v = sl.vec3(0.0, 0.0, 0.0)
        v[k] = 1.0
        m = sl.mat3(0.0)
        m[k][1] = 2.0
        self.out[o + 4] = (
            v.x + 10.0 * v.y + 100.0 * v.z + m[0][1] * 1000.0 + m[1][1] * 10000.0 + m[2][1] * 1e5
        )
        self.out[o + 5] = float(len(self.words))


def targets() -> dict[str, Any]:
    return {
        "words": np.zeros(WORDS, np.float32),
        "parts": np.zeros(4, Part.dtype),
        "counts": np.zeros(WORDS, np.int32),
        "out": np.zeros(6 * N, np.float32),
    }


def expected_writes() -> Values:
    at, result = invocation_indices()["at"].tolist(), targets()
    for i, k in enumerate(at):
        for index, add in ((i + at[0], i + 1), (WORDS - 4 - i, 1000)):
            if 0 <= index < WORDS:
                result["words"][index] += add
        if i + 2 < 4 and 0 <= k < 3:
            result["parts"]["weights"][i + 2, k] = i + 1
        if 0 <= i - 1 < 4:
            result["parts"]["end"][i - 1] = 8
        if 0 <= k < WORDS:
            result["counts"][k] += 1
    for i, k in enumerate(at):
        j, group = i % GROUP, at[i - i % GROUP : i - i % GROUP + GROUP]
        group_values = j % 8 - group[0] if 0 <= j % 8 - group[0] < GROUP else -1
        table = [7 + 20 if k == n else 0 for n in range(3)]
        out = (0, 0, group_values + 1 + 100 * group.count(j % 8), table[0] + 100 * table[1] + 10000 * table[2],
               {0: 1, 1: 10, 2: 100}.get(k, 0) + {0: 2e3, 1: 2e4, 2: 2e5}.get(k, 0), WORDS)  # fmt: skip
        result["out"][6 * i : 6 * i + 6] = out
    return result


CASES: dict[str, tuple[type[sl.Shader], Callable[[], dict[str, Any]], Callable[[], Values]]] = {
    "operators": (
        Operators,
        lambda: {**operands(), "ints": np.zeros(16 * N, "i4"), "uints": np.zeros(8 * N, "u4")},
        expected_operators,
    ),
    "conversions": (
        Conversions,
        lambda: {**floats(), "ints": np.zeros(2 * N, "i4"), "uints": np.zeros(2 * N, "u4")},
        expected_conversions,
    ),
    "reads": (
        Reads,
        lambda: {**invocation_indices(), **memory(), "out": np.zeros(12 * N, "f4")},
        expected_reads,
    ),
    "writes": (Writes, lambda: {**invocation_indices(), **targets()}, expected_writes),
}
"""Of each case its shader, what is bound, and the buffers' contents afterwards."""


@pytest.mark.requires("shading", "compute")
@pytest.mark.parametrize("case", CASES)
def test_operands_at_the_edges_and_indices_outside_have_one_result(device: Device, case: str) -> None:
    shader, make_inputs, expected = CASES[case]
    guards: list[Any] = []
    bound: dict[str, Any] = {}
    for name, value in make_inputs().items():
        guards.append(device.storage(float, np.full(4096, -7, "f4")))  # between the buffers of the shader
        if isinstance(value, sl.Struct):
            bound[name] = device.uniform(value)
        else:
            element = Part if name == "parts" else {"f": float, "i": int, "u": sl.uint}[value.dtype.kind]
            bound[name] = device.storage(element, value)
    device.dispatch(device.program(shader), GROUPS, **bound)
    for name, values in expected().items():
        back = bound[name].read()
        for part in values.dtype.names or ("",):
            assert_same(back[part] if part else back, values[part] if part else values)
    for guard in guards:
        assert_same(guard.read(), -7.0)
