"""Operators of literals give what operators of variables give: in Python's folding, and in each compiler's.

Compilers compute constants themselves, and differ where a language leaves a result open. Half of each
negative result is taken as well, since a compiler may think that it can't be negative. Each expression is
written twice, with numbers in the text and with numbers from memory, and compared with Python's ints of 32
bits.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from typing import Any, Final

import pytest
from nightly_reasons import FEWER_CASES
from nights import rotate_seed

import rhi
import rhi.shading as sl
from rhi.backends.null import NullBackend

BACKENDS: Final = ("gl", "cl", "wgpu", "null")
COUNT: Final = 40
NUMBERS: Final = (0, 1, -1, 2, -2, 7, -7, 13, 31, -32, 65536, -65537, 1 << 30, 2**31 - 1, -(2**31))
Case = tuple[str, tuple[int, ...], int]
"""A template, its operands, and its value in 32 bits."""

BINARY: Final[dict[str, Callable[[int, int], int]]] = {
    "{} + {}": lambda a, b: a + b,
    "{} - {}": lambda a, b: a - b,
    "{} * {}": lambda a, b: a * b,
    "{} // {}": lambda a, b: a // b,
    "{} % {}": lambda a, b: a % b,
    "{} & {}": lambda a, b: a & b,
    "{} | {}": lambda a, b: a | b,
    "{} ^ {}": lambda a, b: a ^ b,
    "{} << {}": lambda a, b: a << b,
    "{} >> {}": lambda a, b: a >> b,
    "int({} < {})": lambda a, b: int(a < b),
    "int({} == {})": lambda a, b: int(a == b),
    "max({}, {})": max,
    "min({}, {})": min,
    "(sl.ivec2({}) // sl.ivec2({})).x": lambda a, b: a // b,
    "(sl.ivec2({}) % {}).y": lambda a, b: a % b,
    "({} - sl.ivec3({})).z": lambda a, b: a - b,
    "int(sl.uint({}) * sl.uint({}))": lambda a, b: a * b,
    "int(sl.uint({}) // sl.uint({}))": lambda a, b: (a % 2**32) // (b % 2**32),
    "int(sl.uint({}) % sl.uint({}))": lambda a, b: (a % 2**32) % (b % 2**32),
    "int(sl.uint({}) < sl.uint({}))": lambda a, b: int(a % 2**32 < b % 2**32),
}
UNARY: Final[dict[str, Callable[[int], int]]] = {
    "-({})": lambda a: -a,
    "~({})": lambda a: ~a,
    "abs({})": abs,
    "sl.sign({})": lambda a: (a > 0) - (a < 0),
    "sl.abs(sl.ivec3({})).y": abs,
    "({}) ** 2": lambda a: a * a,
    "({}) ** 3": lambda a: a**3,
    "(-sl.ivec2({})).x": lambda a: -a,
}


def wrapped(value: int) -> int:
    return (value + 2**31) % 2**32 - 2**31


def literal(value: int) -> str:
    return f"({value})" if value != -(2**31) else "(-2147483647 - 1)"


def operations(seed: int) -> list[Case]:
    """Return random operations on operands that literals may have, and all unary ones of the least int."""
    rng = random.Random(seed)
    cases: list[Case] = [
        (template, (-(2**31),), wrapped(value(-(2**31)))) for template, value in UNARY.items()
    ]
    while len(cases) < COUNT:
        a, b = rng.choice(NUMBERS), rng.choice(NUMBERS)
        if rng.randint(0, 3) == 0:
            template = rng.choice(list(UNARY))
            cases.append((template, (a,), wrapped(UNARY[template](a))))
            continue
        template = rng.choice(list(BINARY))
        if ("/" in template or "%" in template) and b == 0:
            continue  # refused in literals
        if ("<<" in template or ">>" in template) and not 0 <= b < 32:
            continue
        if "sl.uint" in template and min(a, b) < 0:
            continue
        cases.append((template, (a, b), wrapped(BINARY[template](a, b))))
    return cases


def is_refused(case: Case) -> bool:
    """Return whether a case of literals doesn't fit its type, which is an error of its own."""
    expression = case[0].format(*map(literal, case[1]))
    text = (
        "import rhi.shading as sl\nclass One(sl.Shader):\n    out: sl.StorageRW[int]\n"
        f"    def compute(self) -> None:\n        self.out[0] = {expression}\n"
    )
    try:
        sl.compile_shader(sl.from_source(text, "One"))
    except rhi.ShaderError as error:
        return error.rule.id == "shading-out-of-range"
    return False


def shader_of(cases: list[Case], twice: bool = True) -> tuple[Any, list[int]]:
    """Return a shader that computes each case from literals and, if `twice`, from memory, and what memory
    holds."""
    numbers: list[int] = []
    lines = ["        if len(self.numbers) == 0:", "            return"]
    for number, (template, operands, _) in enumerate(cases):
        reads = [f"self.numbers[{len(numbers) + k}]" for k in range(len(operands))]
        numbers += operands
        for k, texts in enumerate((map(literal, operands), reads if twice else map(literal, operands))):
            lines.append(f"        x = {template.format(*texts)}")
            lines.append(f"        self.out[{4 * number + 2 * k}] = x")
            lines.append(f"        self.out[{4 * number + 2 * k + 1}] = x // 2 if x < 0 else x")
    text = (
        "import rhi.shading as sl\nclass Literals(sl.Shader):\n    work_group = (1,)\n"
        "    numbers: sl.Storage[int]\n    out: sl.StorageRW[int]\n    def compute(self) -> None:\n"
    )
    return sl.from_source(text + "\n".join(lines) + "\n", "Literals"), numbers


@pytest.fixture(scope="module", params=BACKENDS)
def running_device(request: pytest.FixtureRequest) -> Iterator[rhi.Device]:
    """A device of each backend; the null device runs compute shaders."""
    if request.param not in [backend.name for backend in rhi.report() if backend.usable]:
        pytest.skip(f"{request.param} doesn't work here")
    with rhi.create_device(request.param) as device:
        if request.param == "null":
            device.backend_as(NullBackend).run_shaders()
        yield device


def assert_same_as_python(device: rhi.Device, cases: list[Case], twice: bool = True) -> None:
    """Compute cases from literals and from variables, and compare both with Python's results."""
    shader, numbers = shader_of(cases, twice)
    out = device.storage(int, 4 * len(cases))
    program: Any = device.program(shader)
    device.dispatch(program, 1, numbers=device.storage(int, numbers), out=out)
    wrong = {
        template.format(*operands): words
        for (template, operands, value), words in zip(cases, out.read().reshape(-1, 4).tolist(), strict=True)
        if words != [value, value // 2 if value < 0 else value] * 2
    }
    assert wrong == {}


@pytest.mark.nightly_cases("*-1", "*-2", "*-3", reason=FEWER_CASES)
@pytest.mark.parametrize("seed", range(4))
def test_literals_and_variables_have_the_same_results(running_device: rhi.Device, seed: int) -> None:
    cases = [case for case in operations(rotate_seed(seed)) if not is_refused(case)]
    assert len(cases) > COUNT // 2
    assert_same_as_python(running_device, cases)


@pytest.mark.nightly_cases("cl-[-~s(]*", "wgpu-*", reason=FEWER_CASES)
@pytest.mark.parametrize("template", UNARY)
def test_the_least_int_as_a_literal_wraps(running_device: rhi.Device, template: str) -> None:
    """A shader has few calls of a helper, so that compilers compute it themselves."""
    case = template, (-(2**31),), wrapped(UNARY[template](-(2**31)))
    if is_refused(case):
        pytest.skip("refused, since it doesn't fit an int")
    assert_same_as_python(running_device, [case], twice=False)
