"""Built-ins of constants, which compilers evaluate themselves, are those of the same numbers in memory.

All built-ins with exact results are called with random arguments: once as literals, once from a buffer.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from typing import Any, Final

import numpy as np
import pytest
from numpy.typing import NDArray

import rhi.shading as sl
from rhi import Device
from rhi.conformance.compare import assert_same
from rhi.contract import layout
from rhi.contract.descriptors import Stage
from rhi.shading.language.builtins import BUILTINS, Overload, SideEffect
from rhi.shading.language.types import scalar_of

pytestmark = pytest.mark.requires("shading", "compute")

_NUMBERS: Final[dict[str, tuple[float, ...]]] = {
    "float": (0.0, -0.5, 0.25, 0.5, 1.5, -1.5, 2.5, -2.0, -1.0, 1.0, 0.75, 3.0, -0.125),
    "int": (0, 1, -1, 5, -7, 31, 100, -(2**31) + 1, 2**31 - 1, 12345, -99999),
    "uint": (0, 1, 5, 31, 100, 2**32 - 1, 2**31, 12345, 0x80017FFF, 0x7C008001, 0xFF80817F),
    "bool": (0, 1),
}
_LITERALS: Final[dict[str, Callable[[float], str]]] = {
    "float": lambda x: repr(float(x)),
    "int": lambda x: str(int(x)),
    "uint": lambda x: f"uint({int(x)})",
    "bool": lambda x: str(bool(x)),
}
_FROM_WORD: Final = {
    "float": "uint_bits_to_float({})",
    "int": "int({})",
    "uint": "{}",
    "bool": "({} != uint(0))",
}
_TO_WORD: Final = {
    "float": "float_bits_to_uint({})",
    "int": "uint({})",
    "uint": "{}",
    "bool": "uint({})",
}
_FIELDS: Final = (0, 3, 8, 16)
"""Offsets and counts of bits; the sum of two is inside the word."""
_LANES: Final = ("uniform", "unchecked", "broadcast_first")
_CASES_OF_A_SHADER: Final = 50


def _calls(*, only_exact: bool) -> Iterator[tuple[str, Overload]]:
    """Yield the built-ins without effects, or those with exact results, each with its largest types."""
    for name, row in BUILTINS.items():
        error = row.error
        is_exact = not (error.glsl or error.exact or error.glsl_absolute)
        is_pure = row.effect is SideEffect.NONE and row.stages == set(Stage) and name not in _LANES
        if (is_exact or not only_exact) and is_pure and row.overloads[-1].parameters:
            yield name, row.overloads[-1]


def _size(type: Any) -> int:
    """Return the number of components of a scalar, a vector or a matrix."""
    return type.size**2 if isinstance(type, layout.MatrixType) else getattr(type, "size", 1)


def _kind(type: Any) -> str:
    """Return the name of the type of the components."""
    return "float" if isinstance(type, layout.MatrixType) else str(scalar_of(type))


def _call(name: str, overload: Overload, arguments: list[list[str]]) -> str:
    texts = [
        f"{parameter.type}({', '.join(parts)})" if len(parts) > 1 else parts[0]
        for parameter, parts in zip(overload.parameters, arguments, strict=True)
    ]
    return f"{name}({', '.join(texts)})"


def _words(overload: Overload, value: str) -> list[str]:
    """Return the components of a result as uints."""
    type = overload.result
    parts = [value]
    if isinstance(type, layout.VectorType):
        parts = [f"{value}.{axis}" for axis in "xyzw"[: type.size]]
    elif isinstance(type, layout.MatrixType):
        parts = [f"{value}[{i}][{j}]" for i in range(type.size) for j in range(type.size)]
    return [_TO_WORD[_kind(type)].format(part) for part in parts]


def _shader(calls: list[tuple[str, Overload]], texts: list[str]) -> tuple[Any, int]:
    """Return a shader that writes the results of calls, and their number of words."""
    lines, count = [], 0
    for number, ((_, overload), text) in enumerate(zip(calls, texts, strict=True)):
        lines.append(f"r{number} = {text}")
        for word in _words(overload, f"r{number}"):
            lines.append(f"self.results[{count}] = {word}")
            count += 1
    lines.append(f"self.results[{count}] = self.numbers[0]")
    body = "\n        ".join(lines)
    shader = sl.from_source(
        "from rhi.shading import *\nclass Calls(Shader):\n    numbers: Storage[uint]\n"
        f"    results: StorageRW[uint]\n    def compute(self) -> None:\n        {body}\n"
    )
    return shader, count


def test_exact_built_ins_of_constants_are_those_of_variables(device: Device) -> None:
    rng = random.Random(1)
    all_calls = list(_calls(only_exact=True))
    for start in range(0, len(all_calls), _CASES_OF_A_SHADER):
        calls = all_calls[start : start + _CASES_OF_A_SHADER]
        numbers, constants, variables = [0], [], []
        for name, overload in calls:
            literals, reads = [], []
            for position, parameter in enumerate(overload.parameters):
                kind = _kind(parameter.type)
                is_field = (
                    name in ("bitfield_extract", "bitfield_insert")
                    and len(overload.parameters) - position <= 2
                )
                values = [
                    rng.choice(_FIELDS if is_field else _NUMBERS[kind]) for _ in range(_size(parameter.type))
                ]
                literals.append([_LITERALS[kind](value) for value in values])
                reads.append(
                    [_FROM_WORD[kind].format(f"self.numbers[{len(numbers) + i}]") for i in range(len(values))]
                )
                dtype = {"float": "f4", "int": "i4"}.get(kind, "u4")
                numbers += np.array(values, dtype).view(np.uint32).tolist()
            constants.append(_call(name, overload, literals))
            variables.append(_call(name, overload, reads))
        results: list[NDArray[Any]] = []
        with device.storage(sl.uint, numbers) as source:
            for texts in (constants, variables):
                shader, count = _shader(calls, texts)
                with device.storage(sl.uint, count + 1) as out:
                    device.dispatch(device.program(shader), 1, numbers=source, results=out)
                    results.append(out.read())
        assert_same(results[0], results[1])


@pytest.mark.parametrize("number", [-2.5, 0.0, 1e30])
def test_no_driver_refuses_built_ins_of_constants(device: Device, number: float) -> None:
    """The root of a negative number, the logarithm of 0, and what is beyond float32."""
    calls = [(name, overload) for name, overload in _calls(only_exact=False) if "bitfield" not in name]
    texts = []
    for name, overload in calls:
        kinds = [_kind(parameter.type) for parameter in overload.parameters]
        values = [number if kind == "float" else _NUMBERS[kind][-1] for kind in kinds]
        literals = [
            [_LITERALS[kind](value)] * _size(parameter.type)
            for kind, value, parameter in zip(kinds, values, overload.parameters, strict=True)
        ]
        texts.append(_call(name, overload, literals))
    shader, count = _shader(calls, texts)
    with device.storage(sl.uint, [7]) as source, device.storage(sl.uint, count + 1) as results:
        device.dispatch(device.program(shader), 1, numbers=source, results=results)
        assert results.read()[-1] == 7
