"""Probes: single built-ins and operators, as functions on arrays and as compute shaders, with their
arguments.

- A probe's shaders read the words of its arguments from a buffer and write the words of its result to
  another, so that all languages compute from the same bits. `sample` and `hard_inputs` generate the
  arguments.
- Float64 is the reference. It has 29 bits more than float32, so its own error of one or two units in the last
  place is 1e-8 of a float32's unit.
"""

from __future__ import annotations

import itertools
import linecache
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

import rhi.shading
from rhi.contract.layout import BOOL, FLOAT, INT, UINT, HostType, MatrixType, ScalarType, VectorType, shape_of
from rhi.shading.evaluation.compute import evaluate
from rhi.shading.language.builtins import BUILTINS, OPERATORS, Builtin, ErrorBound, Precision, SideEffect
from rhi.shading.language.shader import Shader
from rhi.shading.language.types import MATRICES, VECTORS

Array = NDArray[Any]
BoundName = Literal["glsl", "exact", "fast", "numpy"]
"""The name of a bound in `ErrorBound`, which says how a result was computed."""

WORK_GROUP: Final = 64
PASSES: Final = 32
"""Number of times that a probe's `Repeated` reads its arguments."""

_FROM_WORD: Final = {FLOAT: "uint_bits_to_float({})", INT: "int({})", UINT: "{}", BOOL: "({} != 0)"}
_TO_WORD: Final = {
    FLOAT: "float_bits_to_uint({})",
    INT: "uint({})",
    UINT: "{}",
    BOOL: "(uint(1) if {} else uint(0))",
}
_TO_FLOAT: Final = {FLOAT: "{}", INT: "float({})", UINT: "float({})", BOOL: "(1.0 if {} else 0.0)"}
_DTYPES: Final = {FLOAT: np.float32, INT: np.int32, UINT: np.uint32, BOOL: np.bool_}
_LARGEST: Final = float(np.finfo(np.float32).max)
_SMALLEST_NORMAL: Final = 2.0**-126

SMALLEST: Final = 1e-12
"""Smallest magnitude of arguments for built-ins that are made from others: products of three smaller numbers,
as in a determinant, underflow."""

_ANCHORS: Final = np.array([0.5, 1, 2, math.e, 10, 100])
_HARD_FLOATS: Final = np.array(
    [0.0, -0.0, 1.0, -1.0, 0.5, -0.5, 2.0, -2.5, 3.0, 0.1, -0.7, 7.0, 100.25, -100.75, 1e-7, -1e-20, 1e20, 8388609.0,
     65504.0, 65520.0, 6e-8, 2.0**31, -(2.0**31), 1e-45, -1e-40, 1.17549435e-38,
     _LARGEST, -_LARGEST, np.inf, -np.inf, np.nan],
    np.float32,
)  # fmt: skip
_HARD_INTS: Final = np.array(
    [0, 1, -1, 2, -2, 3, -3, 7, -7, 8, 10, 31, 32, 255, -256, 65535, 0x7FFFFFFF, -0x7FFFFFFF, -0x80000000, 0x12345678],
    np.int64,
).astype(np.int32)  # fmt: skip


def scalar_kind(type: HostType) -> ScalarType:
    """Return the type of a value's components."""
    return FLOAT if isinstance(type, MatrixType) else type.scalar if isinstance(type, VectorType) else type  # type: ignore[return-value]


def _size(type: HostType) -> int:
    return int(np.prod(shape_of(type), dtype=int))


def _parts(type: HostType, name: str) -> list[str]:
    """Return the components of a value as expressions."""
    if isinstance(type, MatrixType):
        return [f"{name}[{row}].{'xyzw'[column]}" for row in range(type.size) for column in range(type.size)]
    return [f"{name}.{letter}" for letter in "xyzw"[: type.size]] if isinstance(type, VectorType) else [name]


@dataclass(frozen=True, eq=False)
class Probe:
    """A built-in or operator, with the shaders and functions that evaluate it.

    Attributes:
        expression: an expression of the shading language in the arguments a, b, c and d.
        parameters: the types of the arguments.
        error: the stated error bounds.
    """

    name: str
    expression: str
    parameters: tuple[HostType, ...]
    result: HostType
    error: ErrorBound

    def __str__(self) -> str:
        return f"{self.name}({', '.join(map(str, self.parameters))})"

    @property
    def kinds(self) -> list[ScalarType]:
        """The type of each word of the arguments."""
        return [scalar_kind(type) for type in self.parameters for _ in range(_size(type))]

    @cached_property
    def _namespace(self) -> dict[str, Any]:
        names = "abcd"[: len(self.parameters)]
        declared = ", ".join(f"{name}: {type}" for name, type in zip(names, self.parameters, strict=True))
        total, at, inputs = len(self.kinds), 0, []
        for type in self.parameters:
            words = [f"self.inputs[row * {total} + {at + k}]" for k in range(_size(type))]
            texts = [_FROM_WORD[scalar_kind(type)].format(word) for word in words]
            inputs.append(texts[0] if isinstance(type, ScalarType) else f"{type}({', '.join(texts)})")
            at += len(words)
        loads = [f"{name} = {text}" for name, text in zip(names, inputs, strict=True)]
        kind, results = scalar_kind(self.result), _parts(self.result, "r")
        stores = [
            f"self.results[row * {len(results)} + {k}] = {_TO_WORD[kind].format(part)}"
            for k, part in enumerate(results)
        ]
        summed = " + ".join(_TO_FLOAT[kind].format(part) for part in results)
        idle = " + ".join(
            _TO_FLOAT[scalar_kind(type)].format(part)
            for name, type in zip(names, self.parameters, strict=True)
            for part in _parts(type, name)
        )
        call = [f"r = probe({', '.join(names)})"]
        source = "\n".join(
            [
                "@function",
                f"def probe({declared}) -> {self.result}:",
                f"    return {self.expression}",
                "class Buffers(Shader):",
                f"    work_group = ({WORK_GROUP},)",
                "    inputs: Storage[uint]",
                "    results: StorageRW[uint]",
                "class Single(Buffers):",
                "    def compute(self) -> None:",
                "        row = global_id().x",
                *(f"        {line}" for line in [*loads, *call, *stores]),
                *_repeat("Repeated", total, [*loads, *call, f"total += {summed}"]),
                *_repeat("Baseline", total, [*loads, f"total += {idle}"]),
            ]
        )
        space = {**vars(rhi.shading), "__name__": __name__}
        name = f"<probe of {self}>"
        linecache.cache[name] = (len(source), None, source.splitlines(True), name)
        exec(compile(source, name, "exec", dont_inherit=True), space)
        return space

    def shader(self, variant: str = "Single", precision: Precision = Precision.EXACT) -> type[Shader]:
        """Return one of the probe's compute shaders.

        Args:
            variant: `Single` computes a result for each row of `inputs`. `Repeated` sums many results and
                `Baseline` only their arguments, so that the difference of their times is the time of the
                calls.
            precision: the precision of the shader.
        """
        shader: type[Shader] = self._namespace[variant]
        return with_precision(shader, precision)

    def evaluate(self, inputs: Array, dtype: Any) -> Array:
        """Evaluate words (n, words) on NumPy; returns numbers (n, components)."""
        columns = self.columns(inputs).values()
        values = [
            part.reshape(-1, *shape_of(type)) for part, type in zip(columns, self.parameters, strict=True)
        ]
        return np.asarray(evaluate(self._namespace["probe"], *values, dtype=dtype)).reshape(len(inputs), -1)

    def numbers(self, words: Array) -> Array:
        """Return the words of results, (n, components), as numbers."""
        kind = scalar_kind(self.result)
        return words != 0 if kind is BOOL else words.view(_DTYPES[kind])

    # -- arguments

    def columns(self, inputs: Array) -> dict[str, Array]:
        """Return the arguments as numbers by name.

        A scalar is (n,), a vector (n, components), a matrix (n, rows · columns).
        """
        result, at = {}, 0
        for name, type in zip("abcd", self.parameters, strict=False):
            size, kind = _size(type), scalar_kind(type)
            part = np.ascontiguousarray(inputs[:, at : at + size])
            numbers = part != 0 if kind is BOOL else part.view(_DTYPES[kind])
            result[name] = numbers[:, 0] if isinstance(type, ScalarType) else numbers
            at += size
        return result

    def is_defined(self, inputs: Array) -> Array:
        """True if the result is defined, for each row of words."""
        if not self.error.defined:
            return np.ones(len(inputs), bool)
        with np.errstate(all="ignore"):
            columns = {name: values.astype(np.float64) for name, values in self.columns(inputs).items()}
            defined: Array = eval(self.error.defined, {"np": np}, columns)
        return defined

    def is_in_domain(self, inputs: Array) -> Array:
        """True if all floats of a row lie within the domain of the stated error; a NaN does not."""
        inside = np.ones(len(inputs), bool)
        for number, values in enumerate(self.columns(inputs).values()):
            if values.dtype == np.float32:
                low, high = self.error.domain[min(number, len(self.error.domain) - 1)]
                fits = (values >= low) & (values <= high)
                if self.error.of_arguments:
                    fits &= (values == 0) | (np.abs(values) >= SMALLEST)
                inside &= fits.reshape(len(inputs), -1).all(axis=1)
        return inside

    def sample(self, count: int, seed: int = 0) -> Array:
        """Generate words (count, words) with a defined result, in the domain of the stated error.

        A third of the floats each is uniform, uniform in the logarithm, and close to numbers where functions
        change.
        """
        batches: list[Array] = []
        while sum(map(len, batches)) < count:
            batch = self._sample(count, seed + len(batches))
            batches.append(batch[self.is_defined(batch)])
        return np.concatenate(batches)[:count]

    def _sample(self, count: int, seed: int) -> Array:
        rng = np.random.default_rng(seed)
        columns = []
        for number, type in enumerate(self.parameters):
            low, high = self.error.domain[min(number, len(self.error.domain) - 1)]
            for _ in range(_size(type)):
                columns.append(_sample(scalar_kind(type), low, high, count, rng))
        return np.stack(columns, axis=1)

    def hard_inputs(self) -> Array:
        """Generate words (n, words) of hard numbers: all combinations for up to two words, random ones for
        more."""
        hard_inputs = [_hard(kind) for kind in self.kinds]
        if len(hard_inputs) <= 2:
            rows = list(itertools.product(*hard_inputs))
            return np.array(rows, np.uint32).reshape(len(rows), len(hard_inputs))
        rng = np.random.default_rng(len(hard_inputs))
        return np.stack([rng.choice(column, 4096) for column in hard_inputs], axis=1)


def with_precision(shader: type[Shader], precision: Precision) -> type[Shader]:
    """Return a compute shader with another precision; shaders are EXACT by default."""
    if precision is Precision.EXACT:
        return shader
    return type(f"{precision.value.capitalize()}{shader.__name__}", (shader,), {"precision": precision})


def _repeat(name: str, words: int, lines: Sequence[str]) -> list[str]:
    """Write a shader that repeats `lines`; it keeps four sums, so that the latency of one isn't measured."""
    return [
        f"class {name}(Buffers):",
        "    def compute(self) -> None:",
        "        i = global_id().x",
        "        count = len(self.results)",
        *(f"        total{k} = 0.0" for k in range(4)),
        f"        for _ in range({PASSES}):",
        f"            for turn in range(0, len(self.inputs) // (count * {words}), 4):",
        *(
            f"                {line.replace('total', f'total{k}')}"
            for k in range(4)
            for line in (f"row = (turn + {k}) * count + i", *lines)
        ),
        "        self.results[i] = float_bits_to_uint(total0 + total1 + total2 + total3)",
    ]


def _hard(kind: ScalarType) -> Array:
    if kind is FLOAT:
        return _HARD_FLOATS.view(np.uint32)
    return np.array([0, 1], np.uint32) if kind is BOOL else _HARD_INTS.view(np.uint32)


def _sample(kind: ScalarType, low: float, high: float, count: int, rng: np.random.Generator) -> Array:
    if kind is BOOL:
        return rng.integers(0, 2, count).astype(np.uint32)
    if kind is not FLOAT:
        return rng.integers(0, 1 << 32, count, np.uint64).astype(np.uint32) >> rng.integers(
            0, 32, count
        ).astype(np.uint32)
    even = rng.uniform(low, high, count)
    largest = max(abs(low), abs(high))
    magnitude = np.exp(rng.uniform(np.log(low if low > 0 else largest * 1e-6), np.log(largest), count))
    turns = rng.integers(1, 640, count) * (np.pi / 2)
    close = np.where(rng.random(count) < 0.5, rng.choice(_ANCHORS, count), turns)
    close *= 1 + rng.choice((-1, 1), count) * np.exp(rng.uniform(np.log(1e-8), 0, count))
    sign = np.where(rng.random(count) < 0.5, -1, 1) if low < 0 else 1
    values = np.choose(rng.integers(0, 3, count, np.intp), (even, sign * magnitude, sign * close)).astype(
        np.float32
    )
    return np.clip(values, np.float32(low), np.float32(high)).view(np.uint32)


# -- errors ------------------------------------------------------------------------------------------------


def count_units(probe: Probe, inputs: Array, results: Array) -> Array:
    """Return the errors of results, (n, components), in the units of the error bound.

    - A unit is one unit in the last place (ulp) of the exact float32. For a built-in that is made from others
      it is the change of the result by one ulp in each argument, if that is more: a sum of products can't do
      better.
    - Results and arguments below 2^-126 may count as zero, since devices may flush them.
    - The error is infinite if only one of the two is NaN or infinite, and for different whole numbers or
      bools. These may also equal the result of float32: a pack rounds a product.
    """
    if scalar_kind(probe.result) is not FLOAT:
        same = [results == probe.evaluate(inputs, dtype) for dtype in (np.float64, np.float32)]
        return np.where(same[0] | same[1], 0.0, np.inf)
    off = _distance(probe, inputs, results)
    flushed = _flush(probe, inputs)
    return off if flushed is None else np.minimum(off, _distance(probe, flushed, results))


def _distance(probe: Probe, inputs: Array, results: Array) -> Array:
    with np.errstate(all="ignore"):
        exact, got = probe.evaluate(inputs, np.float64), results.astype(np.float64)
        unit = np.spacing(np.clip(np.abs(exact), _SMALLEST_NORMAL, _LARGEST).astype(np.float32)).astype(
            np.float64
        )
        if probe.error.of_arguments:
            unit = np.maximum(unit, _spread(probe, inputs, exact))
        off = np.abs(got - exact)
        off = np.where(np.abs(exact) < _SMALLEST_NORMAL, np.minimum(off, np.abs(got)), off) / unit
        rounded = exact.astype(np.float32)
        same = (rounded == got) | (np.isnan(exact) & np.isnan(got))
        return np.where(
            same,
            np.where(np.isinf(rounded) | np.isnan(exact), 0.0, off),
            np.where(np.isfinite(off), off, np.inf),
        )


def _spread(probe: Probe, inputs: Array, exact: Array) -> Array:
    """Return the change of the result by a unit in the last place of each argument, summed over the
    arguments."""
    total = np.zeros_like(exact)
    for column, kind in enumerate(probe.kinds):
        if kind is FLOAT:
            changes = []
            for step in (1, -1):
                moved = inputs.copy()
                moved[:, column] += np.uint32(step & 0xFFFFFFFF)
                changes.append(np.nan_to_num(np.abs(probe.evaluate(moved, np.float64) - exact)))
            total += np.maximum(*changes)
    return total


def _flush(probe: Probe, inputs: Array) -> Array | None:
    """Return the arguments with numbers below 2^-126 replaced by zeros; None if there are none."""
    floats = np.array([kind is FLOAT for kind in probe.kinds])
    small = floats & ((inputs & 0x7F800000) == 0) & ((inputs & 0x7FFFFFFF) != 0)
    return np.where(small, inputs & 0x80000000, inputs).astype(np.uint32) if small.any() else None


def worst_units(probe: Probe, inputs: Array, results: Array, bound: BoundName) -> Array:
    """Return the largest error of each row's components, (n,), for comparison with `getattr(probe.error,
    bound)`.

    It is 0 for rows that the bound doesn't cover: without a defined result, or outside the domain.
    """
    error = probe.error
    units = count_units(probe, inputs, results)
    if bound == "glsl" and error.glsl_absolute:
        with np.errstate(all="ignore"):
            off = np.abs(results - probe.evaluate(inputs, np.float64))
        units = np.where(off <= error.glsl_absolute, 0, units)
    covered = probe.is_defined(inputs)
    if error.of_arguments or bound in ("glsl", "fast"):
        covered &= probe.is_in_domain(inputs)
    worst: Array = np.where(covered, units.max(axis=1), 0.0)
    return worst


# -- all probes --------------------------------------------------------------------------------------------


def all_probes() -> list[Probe]:
    """Return probes of all operators and of all built-ins that depend on their arguments alone, in one size
    each."""
    return [*operator_probes(), *itertools.chain.from_iterable(map(builtin_probes, BUILTINS.values()))]


def builtin_probes(row: Builtin) -> Iterator[Probe]:
    """Yield probes of a built-in for floats, ints and uints, as far as it accepts them.

    Arguments are scalars, or where there is no such overload vectors or matrices of three.
    """
    if (
        row.effect is not SideEffect.NONE
        or len(row.stages) == 1
        or row.name in ("uniform", "broadcast_first")
    ):
        return  # they return their argument only where all lanes have the same
    signatures: dict[tuple[ScalarType, ...], tuple[tuple[HostType, ...], HostType]] = {}
    for overload in row.overloads:
        types: tuple[Any, ...] = tuple(parameter.type for parameter in overload.parameters)
        kinds = tuple(map(scalar_kind, types))
        if kinds not in signatures or all(3 in shape_of(type) for type in types):
            if kinds in signatures and not shape_of(signatures[kinds][0][0]):
                continue
            signatures[kinds] = types, overload.result  # type: ignore[assignment]
    for types, result in signatures.values():
        yield Probe(row.name, f"{row.name}({', '.join('abcd'[: len(types)])})", types, result, row.error)


def operator_probes() -> Iterator[Probe]:
    """Yield probes of each operator for floats, ints, uints and bools, as far as it accepts them."""
    vector, matrix = VECTORS[FLOAT, 3], MATRICES[3]
    for name, error in OPERATORS.items():
        unary = name in ("neg", "~", "not")
        if name == "@":
            yield Probe(name, "a @ b", (matrix, vector), vector, error)
            continue
        for kind in _operands(name):
            result = BOOL if name in ("==", "!=", "<", "<=", ">", ">=") else FLOAT if name == "/" else kind
            text = f"{'-' if name == 'neg' else name + ' '}a" if unary else f"a {name} b"
            yield Probe(name, text, (kind,) if unary else (kind, kind), result, error)


def _operands(operator: str) -> tuple[ScalarType, ...]:
    match operator:
        case "and" | "or" | "not":
            return (BOOL,)
        case "&" | "|" | "^" | "<<" | ">>" | "~":
            return INT, UINT
        case "neg":
            return FLOAT, INT
        case "**":
            return (FLOAT,)
        case _:
            return FLOAT, INT, UINT
