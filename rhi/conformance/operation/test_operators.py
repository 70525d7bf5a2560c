"""Every unary and binary operator, of every type and shape that it takes, against exact integers and rounded
floats.

- Ints wrap at 32 bits, and floor as Python's do. `test_outside` has more of their edges.
- A sum, a difference and a product of floats is the nearest float32. Quotients and powers have the bounds of
  the table of built-ins (`rhi.shading.language.builtins.OPERATORS`).
- Operands and results are finite: not every platform has NaN and infinities (docs/shading-arithmetic.md).
  Operators may flush denormals.
"""

from __future__ import annotations

import itertools
import operator
from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np
import pytest
from numpy.typing import NDArray

import rhi.shading as sl
from rhi import Device
from rhi.conformance.compare import assert_near, assert_same
from rhi.shading.language.builtins import OPERATORS

pytestmark = pytest.mark.requires("shading", "compute")

Array = NDArray[Any]

_INTS: Final = (0, 1, -1, 2, -3, 7, 31, 100, -32, -99999, 65536, 2**31 - 1, -(2**31))
_UINTS: Final = (0, 1, 2, 3, 7, 31, 100, 99999, 65536, 2**31, 2**31 + 1, 2**32 - 2, 2**32 - 1)
_FLOATS: Final = (0.0, 1.0, -1.0, 2.5, -3.25, 0.1, 7.0, -100.75, 1e-7, -1e10, 16777216.0, 16777215.0, 3e18)
_VALUES: Final[dict[str, tuple[float, ...]]] = {
    "int": _INTS,
    "uint": _UINTS,
    "float": _FLOATS,
    "bool": (0, 1),
}
_DTYPES: Final[dict[str, Any]] = {"int": np.int32, "uint": np.uint32, "float": np.float32, "bool": np.uint32}
_VECTORS: Final = {"float": "vec", "int": "ivec", "uint": "uvec"}
_FROM_WORD: Final = {"float": "uint_bits_to_float({})", "int": "int({})", "uint": "{}", "bool": "({} != 0)"}
_TO_WORD: Final = {
    "float": "float_bits_to_uint({})",
    "int": "uint({})",
    "uint": "{}",
    "bool": "(uint(1) if {} else uint(0))",
}
_COMPARISONS: Final = ("==", "!=", "<", "<=", ">", ">=")
_WHOLE: Final = ("+", "-", "*", "/", "//", "%", "&", "|", "^", "<<", ">>")
_BINARY: Final = {"float": ("+", "-", "*", "/", "//", "%", "**"), "int": _WHOLE, "uint": _WHOLE, "bool": ()}
_UNARY: Final = {"float": ("-",), "int": ("-", "~"), "uint": ("-", "~"), "bool": ("not ",)}
_SHAPES: Final = [(kind, size) for kind in ("float", "int", "uint") for size in (1, 2, 3, 4)] + [("bool", 1)]

Case = tuple[str, str, str]
"""An expression in a and b, vectors, and x and y, their first components; the type of its components; an
operator."""


def _cases(kind: str, size: int) -> list[Case]:
    """Return the expressions of one type: all operators, also of a vector and a scalar."""
    cases: list[Case] = []
    for sign in _UNARY[kind]:
        cases.append((f"{sign}a", kind, sign.strip()))
    for sign in _BINARY[kind]:
        result = "float" if sign == "/" else kind
        cases.append((f"a {sign} b", result, sign))
        if size > 1:
            cases.append((f"a {sign} y", result, sign))
            if sign not in ("**", "<<", ">>"):
                cases.append((f"x {sign} b", result, sign))
    if kind == "bool":
        cases += [(f"a {sign} b", "bool", sign) for sign in ("and", "or", "==", "!=")]
    elif size == 1:
        cases += [(f"a {sign} b", "bool", sign) for sign in _COMPARISONS]
    else:
        cases += [(f"a {sign} b", "bool!", sign) for sign in ("==", "!=")]  # one bool for all components
        names = ("equal", "not_equal", "less_than", "less_than_equal", "greater_than", "greater_than_equal")
        cases += [(f"{name}(a, b)", "bool", sign) for name, sign in zip(names, _COMPARISONS, strict=True)]
    return cases


def _constructor(kind: str, size: int, words: Sequence[str]) -> str:
    parts = [_FROM_WORD[kind].format(word) for word in words]
    return f"{_VECTORS[kind]}{size}({', '.join(parts)})" if size > 1 else parts[0]


def _shader(kind: str, size: int, cases: list[Case]) -> Any:
    """Return a shader that computes all cases from the words of a and b."""
    total = sum(1 if result == "bool!" else size for _, result, _ in cases)
    words = [[f"self.{name}[i * {size} + {k}]" for k in range(size)] for name in "ab"]
    lines = [f"{name} = {_constructor(kind, size, part)}" for name, part in zip("ab", words, strict=True)]
    lines += ["x = a.x", "y = b.x"] if size > 1 else []
    at = 0
    for number, (expression, result, _) in enumerate(cases):
        lines.append(f"r{number} = {expression}")
        components = [""] if size == 1 or result == "bool!" else [f".{axis}" for axis in "xyzw"[:size]]
        for component in components:
            word = _TO_WORD[result.rstrip("!")].format(f"r{number}{component}")
            lines.append(f"self.out[i * {total} + {at}] = {word}")
            at += 1
    body = "\n        ".join(lines)
    return sl.from_source(
        "from rhi.shading import *\n"
        "class Operators(Shader):\n"
        "    a: Storage[uint]\n    b: Storage[uint]\n    out: StorageRW[uint]\n"
        f"    def compute(self) -> None:\n        i = global_id().x\n        {body}\n"
    )


def _operands(kind: str, size: int) -> tuple[Array, Array]:
    """Return all pairs of values as the first components of vectors, and other pairs behind them (n,
    size)."""
    pairs = np.array(list(itertools.product(_VALUES[kind], repeat=2)), np.float64)
    rows = np.stack([np.roll(pairs, 5 * k, axis=0) for k in range(size)], axis=1)
    return rows[..., 0], rows[..., 1]


_PYTHON: Final[dict[str, Callable[[Any, Any], Any]]] = {
    "+": operator.add, "-": operator.sub, "*": operator.mul, "&": operator.and_, "|": operator.or_, "^": operator.xor,
    "//": lambda a, b: a // (b or 1), "%": lambda a, b: a % (b or 1), "/": operator.truediv,
    "<<": lambda a, b: a << (b % 32), ">>": lambda a, b: a >> (b % 32), "**": operator.pow,
    "==": operator.eq, "!=": operator.ne, "<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge,
    "and": lambda a, b: a and b, "or": lambda a, b: a or b,
}  # fmt: skip
_PYTHON_UNARY: Final[dict[str, Callable[[Any], Any]]] = {
    "-": operator.neg,
    "~": operator.invert,
    "not": operator.not_,
}


def _is_defined(kind: str, sign: str, a: float, b: float) -> bool:
    """Return whether a result is stated: finite, not next to a denormal, and with digits left."""
    if sign in ("/", "//", "%") and (kind == "float" or sign == "/") and b == 0:
        return False
    if kind != "float":
        return True
    if sign == "/":
        return a == 0 or 1e-30 < abs(a / b) < 1e30
    if sign in ("//", "%"):
        return 1e-30 < abs(a / b) < 1e6 and abs(a / b - round(a / b)) > 1e-3
    if sign == "**":
        return (1e-3 < a < 1e3 and abs(b) < 10) or (a == 0 and b > 0)
    return True


def _expected(case: Case, kind: str, a: Array, b: Array) -> tuple[Array, Array]:
    """Return the values of a case (n, components), and where they are stated."""
    expression, result, sign = case
    left = a[:, :1].repeat(a.shape[1], 1) if expression.startswith("x ") else a
    right = b[:, :1].repeat(b.shape[1], 1) if expression.endswith(" y") else b
    number = float if kind == "float" else int
    is_unary = " " not in expression.removeprefix("not ") and "(" not in expression
    values, defined = np.zeros(a.shape), np.ones(a.shape, bool)
    for index in np.ndindex(a.shape):
        x, y = number(left[index]), number(right[index])
        if is_unary:
            value = _PYTHON_UNARY[sign](x)
        else:
            defined[index] = _is_defined(kind, sign, x, y)
            value = _PYTHON[sign](x, y) if defined[index] else 0
        values[index] = _wrapped(value, result) if result in ("int", "uint") else value
    if result == "bool!":
        together = np.all if sign == "==" else np.any
        return together(values, axis=1, keepdims=True), np.ones((len(a), 1), bool)
    return values, defined


def _wrapped(value: int, kind: str) -> int:
    """Return a whole number in the range of a type of 32 bits."""
    low = 0 if kind == "uint" else -(2**31)
    return (value - low) % 2**32 + low


@pytest.mark.parametrize(("kind", "size"), _SHAPES)
def test_each_operator_of_scalars_and_vectors(device: Device, kind: str, size: int) -> None:
    cases = _cases(kind, size)
    a, b = (
        part.astype(np.float32).astype(np.float64) if kind == "float" else part
        for part in _operands(kind, size)
    )
    words = [np.ascontiguousarray(part.astype(_DTYPES[kind])).view(np.uint32).ravel() for part in (a, b)]
    total = sum(1 if result == "bool!" else size for _, result, _ in cases)
    with (
        device.storage(sl.uint, words[0]) as left,
        device.storage(sl.uint, words[1]) as right,
        device.storage(sl.uint, len(a) * total) as out,
    ):
        device.dispatch(device.program(_shader(kind, size, cases)), len(a), a=left, b=right, out=out)
        results = out.read().reshape(len(a), total)
    at = 0
    for case in cases:
        _, result, sign = case
        expected, defined = _expected(case, kind, a, b)
        back = np.ascontiguousarray(results[:, at : at + expected.shape[1]])
        at += expected.shape[1]
        if result.startswith("bool"):
            assert_same(back[defined], expected[defined].astype(np.uint32))
        elif result != "float":
            assert_same(back.view(_DTYPES[result])[defined], expected[defined])
        else:
            numbers = back.view(np.float32).astype(np.float64)
            if sign in ("+", "-", "*"):
                assert_same(numbers[defined], expected.astype(np.float32).astype(np.float64)[defined])
            else:
                bound = max(OPERATORS[sign].glsl, OPERATORS[sign].exact)
                unit = np.spacing(np.maximum(np.abs(expected), 2.0**-126).astype(np.float32)).astype(
                    np.float64
                )
                if sign == "%":  # a unit is what a unit of an argument changes
                    unit = np.maximum(
                        unit,
                        np.spacing(
                            np.maximum(np.abs(a), np.abs(b)).max(axis=1, keepdims=True).astype(np.float32)
                        ).astype(np.float64),
                    )
                assert_near(numbers[defined], expected[defined], ((bound + 0.5) * unit)[defined], case[0])


_CONSTANTS: Final = ((2**31 - 1, 3), (-(2**31), -1), (5, 7))


def _constant_cases(kind: str) -> list[tuple[str, str, list[int]]]:
    """Return expressions of constants, which no Python folds: (expression, type of result, components)."""
    vector, cases = f"{_VECTORS[kind]}2", []
    mask = 2**32 - 1 if kind == "uint" else -1
    for sign in (sign for sign in _BINARY[kind] if sign != "/"):
        for a, b in _CONSTANTS:
            left = [a & mask, b & mask]
            right = [(b & mask) % 32, 5] if sign in ("<<", ">>") else [b & mask, 5]
            pair = [_wrapped(_PYTHON[sign](x, y), kind) for x, y in zip(left, right, strict=True)]
            cases.append(
                (f"{vector}({left[0]}, {left[1]}) {sign} {vector}({right[0]}, {right[1]})", kind, pair)
            )
    cases.append((f"-{vector}(5, 2)", kind, [_wrapped(-5, kind), _wrapped(-2, kind)]))
    cases.append((f"~{vector}(5, 2)", kind, [_wrapped(~5, kind), _wrapped(~2, kind)]))
    cases.append((f"-{vector}(5, 2) - {vector}(-{vector}(7, 7).x, 1)", kind, [2, _wrapped(-3, kind)]))
    return cases


@pytest.mark.parametrize("kind", ["int", "uint"])
def test_operators_of_constants_wrap_as_those_of_variables(device: Device, kind: str) -> None:
    cases = _constant_cases(kind)
    lines = []
    for number, (expression, result, _) in enumerate(cases):
        words = [_TO_WORD[result].format(f"r{number}.{axis}") for axis in "xy"]
        lines += [f"r{number} = {expression}"]
        lines += [f"self.out[{2 * number + k}] = {word}" for k, word in enumerate(words)]
    if kind == "uint":
        lines += [f"self.out[{2 * len(cases)}] = -uint(5)", f"self.out[{2 * len(cases) + 1}] = ~uint(5)"]
    body = "\n        ".join(lines)
    shader = sl.from_source(
        "from rhi.shading import *\nclass Constants(Shader):\n    out: StorageRW[uint]\n"
        f"    def compute(self) -> None:\n        {body}\n"
    )
    expected = [value for _, _, pair in cases for value in pair]
    expected += [-5, ~5] if kind == "uint" else [0, 0]
    with device.storage(sl.uint, len(expected)) as out:
        device.dispatch(device.program(shader), 1, out=out)
        assert_same(out.read(), np.array(expected, np.int64) % 2**32)


_MATRICES: Final[dict[str, Callable[[Array, Array, Array], Array]]] = {
    "m + n": lambda m, n, v: m + n,
    "m - n": lambda m, n, v: m - n,
    "m * n": lambda m, n, v: m * n,
    "m @ n": lambda m, n, v: m @ n,
    "m * v.x": lambda m, n, v: m * v[0],
    "v.x * m": lambda m, n, v: v[0] * m,
    "m / v.x": lambda m, n, v: m / v[0],
    "-m": lambda m, n, v: -m,
    "m @ v": lambda m, n, v: m @ v,
    "v @ m": lambda m, n, v: v @ m,
}
"""Operators of matrices m and n and a vector v, and what they are in NumPy."""


@pytest.mark.parametrize("size", [2, 3, 4])
def test_each_operator_of_matrices(device: Device, size: int) -> None:
    words = iter(range(2 * size * size + size))
    m, n = (
        f"mat{size}({', '.join(f'self.words[{next(words)}]' for _ in range(size * size))})" for _ in range(2)
    )
    v = f"vec{size}({', '.join(f'self.words[{next(words)}]' for _ in range(size))})"
    lines, at = [f"m = {m}", f"n = {n}", f"v = {v}"], 0
    for number, expression in enumerate(_MATRICES):
        is_vector = expression in ("m @ v", "v @ m")
        lines.append(f"r{number} = {expression}")
        for row, column in itertools.product(range(1 if is_vector else size), range(size)):
            part = f"[{column}]" if is_vector else f"[{row}][{column}]"
            lines.append(f"self.out[{at}] = r{number}{part}")
            at += 1
    body = "\n        ".join(lines)
    shader = sl.from_source(
        "from rhi.shading import *\nclass Matrices(Shader):\n    words: Storage[float]\n"
        f"    out: StorageRW[float]\n    def compute(self) -> None:\n        {body}\n"
    )
    values = np.random.default_rng(size).integers(1, 9, 2 * size * size + size).astype(np.float64)
    first, second = values[: 2 * size * size].reshape(2, size, size)
    vector = values[2 * size * size :]
    expected = [compute(first, second, vector).ravel() for compute in _MATRICES.values()]
    with device.storage(float, values.astype(np.float32)) as source, device.storage(float, at) as out:
        device.dispatch(device.program(shader), 1, words=source, out=out)
        assert_near(out.read(), np.concatenate(expected), 1e-5, "whole numbers, but for quotients")


class Edges(sl.Shader):
    """Where GLSL leaves the result open, and Python doesn't."""

    values: sl.Storage[float]
    powers: sl.StorageRW[float]
    infinities: sl.StorageRW[float]
    angles: sl.StorageRW[float]

    def compute(self) -> None:
        i = sl.global_id().x
        x = self.values[i]
        zero = self.values[0]
        self.powers[6 * i] = x**zero
        self.powers[6 * i + 1] = sl.pow(x, zero)
        v = sl.pow(sl.vec3(x, 2.0, 3.0), sl.vec3(zero, zero, 2.0))
        self.powers[6 * i + 2] = v.x
        self.powers[6 * i + 3] = v.y
        self.powers[6 * i + 4] = v.z
        self.powers[6 * i + 5] = zero ** (x * x + 1.0)
        self.infinities[4 * i] = zero ** (-1.0 - x)
        self.infinities[4 * i + 1] = zero**-0.5
        self.infinities[4 * i + 2] = sl.pow(sl.vec2(zero, 2.0), sl.vec2(-1.0 - x, 1.0)).x
        self.infinities[4 * i + 3] = sl.pow(sl.vec2(2.0, zero), sl.vec2(1.0, -2.5)).y
        angle = sl.atan2(sl.vec2(zero, x), sl.vec2(zero, 1.0))
        self.angles[3 * i] = sl.atan2(zero, zero)
        self.angles[3 * i + 1] = angle.x
        self.angles[3 * i + 2] = angle.y


def test_powers_of_0_and_to_0_and_the_angle_of_no_vector(device: Device) -> None:
    values = np.array([0.0, 1.0, 2.0, 100.0, 1e-3], np.float32)
    with (
        device.storage(float, values) as source,
        device.storage(float, 6 * len(values)) as powers,
        device.storage(float, 4 * len(values)) as infinities,
        device.storage(float, 3 * len(values)) as angles,
    ):
        device.dispatch(
            device.program(Edges),
            len(values),
            values=source,
            powers=powers,
            infinities=infinities,
            angles=angles,
        )
        rows = np.array([[1.0, 1.0, 1.0, 1.0, 9.0, 0.0]] * len(values))
        assert_near(powers.read().reshape(-1, 6), rows, 1e-4, "the exponent 0 gives 1")
        assert (infinities.read() > 1e38).all(), "0 to a negative power is infinite"
        zeros = np.zeros(len(values))
        expected = np.stack([zeros, zeros, np.arctan(values.astype(np.float64))], axis=1)
        assert_near(angles.read().reshape(-1, 3), expected, 1e-3, "the angle of (0, 0) is 0")
