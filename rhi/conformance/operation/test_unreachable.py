"""Statements that are never reached, behind `return`, `discard`, `break` and `continue`: they change nothing,
anywhere.

Random methods are written as Python. A device runs them as a shader, and Python runs the same text: that is
what is expected. Each has dead statements in its body, in branches and in loops, which name new variables and
call others.
"""

from __future__ import annotations

import random
from collections.abc import Iterator
from typing import Any, Final

import numpy as np
import pytest
from numpy.typing import NDArray

import rhi.shading as sl
from rhi import Device, Format
from rhi.conformance.compare import assert_same

pytestmark = pytest.mark.requires("shading")

METHODS: Final = 8
ARGUMENTS: Final = 24
_CALLEES: Final = 3
"""The first methods call none; the others call these."""
_CONSTANTS: Final = (2, 3, 5, 7, 11)

_PAIR = """
class Pair(Struct):
    first: int
    second: int
"""
_COMPUTE = """
class Compute(Shader):
    out: StorageRW[int]

    def compute(self) -> None:
        i = global_id().x
        self.out[i] = self.select(i // {arguments}, i % {arguments})
"""
_FRAGMENT = """
class Fragment(FullScreen):
    lean = {lean}

    def fragment(self) -> ivec4:
        at = ivec2(fragment_coordinate().xy)
        return ivec4(self.select(at.y, at.x), 1, 2, 3)
"""


class DiscardError(Exception):
    """Raised where Python runs `discard()`."""


class Writer:
    """Writes random methods of an int with dead statements in them.

    Args:
        discards: whether they discard fragments.
    """

    def __init__(self, seed: int, discards: bool) -> None:
        self._random = random.Random(seed)
        self._discards = discards
        self._lines: list[str] = []
        self._variables = 0
        self._callees: list[str] = []

    def methods(self, count: int) -> str:
        """Return the methods `f0` to `f<count - 1>`, and `select(which, x)`, which calls one of them."""
        for number in range(count):
            self._method(number)
        self._lines.append("    def select(self, which: int, x: int) -> int:")
        for number in range(count - 1):
            self._lines += [f"        if which == {number}:", f"            return {_call(number, 'x')}"]
        self._lines += [f"        return {_call(count - 1, 'x')}", ""]
        return "\n".join(self._lines)

    def _method(self, number: int) -> None:
        result = "Pair" if number % 2 else "int"
        self._lines.append(f"    def f{number}(self, x: int) -> {result}:")
        self._result = result
        if not self._block(8, 0, False):
            self._line(8, self._return())
        if self._random.random() < 0.5:
            self._dead(8, False)
        self._lines.append("")
        if number < _CALLEES:
            self._callees.append(_call(number, "{}"))

    def _line(self, indent: int, text: str) -> None:
        self._lines.append(" " * indent + text)

    def _value(self) -> str:
        kinds = ["x", "(x + {})", "(x * {})", "(7 - x)", "(x // {})"]
        text = self._random.choice(kinds).format(self._random.choice(_CONSTANTS))
        if len(self._callees) == _CALLEES and self._random.random() < 0.2:
            text = self._random.choice(self._callees).format(f"{text} % 50")
        return f"{text} % 97"

    def _condition(self) -> str:
        divisor = self._random.choice((2, 3, 4))
        return f"x % {divisor} {self._random.choice(('==', '!=', '<'))} {self._random.randrange(divisor)}"

    def _return(self) -> str:
        value = self._value()
        return f"return Pair(first={value}, second=x)" if self._result == "Pair" else f"return {value}"

    def _block(self, indent: int, depth: int, in_loop: bool) -> bool:
        """Write statements, and return whether none behind them is reached."""
        for _ in range(self._random.randint(1, 3)):
            if self._statement(indent, depth, in_loop):
                if self._random.random() < 0.7:
                    self._dead(indent, in_loop)
                return True
        return False

    def _statement(self, indent: int, depth: int, in_loop: bool) -> bool:
        kind = self._random.random()
        if kind < 0.3 or depth > 3:
            self._line(indent, f"x = {self._value()}")
            return False
        if kind < 0.6:
            self._line(indent, f"if {self._condition()}:")
            ends = self._block(indent + 4, depth + 1, in_loop)
            if self._random.random() < 0.6:
                return False
            self._line(indent, "else:")
            return self._block(indent + 4, depth + 1, in_loop) and ends
        if kind < 0.8:
            if self._random.random() < 0.7:
                self._variables += 1
                self._line(indent, f"for i{self._variables} in range({self._random.randint(1, 4)}):")
                self._block(indent + 4, depth + 1, True)
                return False
            self._line(indent, "while True:")
            self._line(indent + 4, "x += 5")
            self._line(indent + 4, f"if x > {self._random.randint(3, 40)}:")
            self._line(indent + 8, self._random.choice(("break", self._return())))
            self._dead(indent + 8, True)
            self._line(indent, f"x = {self._value()}")
            return False
        if depth or kind > 0.9:
            self._line(indent, self._end(in_loop))
            return True
        return False

    def _end(self, in_loop: bool) -> str:
        ends = [self._return()] * 2 + ["discard()"] * 2 * self._discards + ["break", "continue"] * in_loop
        return self._random.choice(ends)

    def _dead(self, indent: int, in_loop: bool) -> None:
        """Write statements that are never reached."""
        for _ in range(self._random.randint(1, 3)):
            self._variables += 1
            name = f"dead{self._variables}"
            forms = [
                ["x = 1000"],
                [f"{name} = x * 1000", f"x = {name}"],
                [f"for {name} in range(x):", f"    x += {name}"],
                [f"if {self._condition()}:", f"    {self._end(in_loop)}", "else:", "    x = 2000"],
                [f"while {self._condition()}:", "    x += 1", f"    {self._end(True)}"],
                [self._end(in_loop)],
            ]
            for line in self._random.choice(forms):
                self._line(indent, line)


_ELSE: Final = ("else:", "    {end}", "{dead}")
_CONTEXTS: Final = (
    ["{end}", "{dead}"],
    ["if x % 2 == 0:", "    {end}", "    {dead}", "x += 1", "return {x}"],
    ["if x % 2 == 0:", "    x += 1", "else:", "    {end}", "    {dead}", "return {x}"],
    ["if x % 2 == 0:", "    {end}", "    {dead}", "else:", "    return {x}", "{dead}"],
    ["if x % 3 == 0:", "    return {x}", "elif x % 3 == 1:", "    {end}", "else:", "    {end}", "{dead}"],
    ["if x % 2 == 0:", "    if x > 9:", "        {end}", "    else:", "        {end}", "    {dead}", *_ELSE],
    ["while True:", "    {end}", "    {dead}", "{dead}"],
    ["while True:", "    x += 2", "    {end}", "    {dead}", "    if x > 50:", "        return {x}"],
    ["while True:", "    x += 2", "    if x > 9:", "        {end}", "        {dead}", "{dead}"],
    ["for i in range(x):", "    if i > 3:", "        {end}", "        {dead}", "x += 1", "return {x}"],
)
_DEAD: Final = "x = 1000 + x"


def write_forms(discards: bool, lean: bool) -> tuple[str, int]:
    """Return the text of a shader with a method for each form of dead code, and the number of methods.

    A form is a statement that ends a path, where it stands, and the type of the method's result.
    """
    forms = [(context, result, "discard()") for context in _CONTEXTS for result in ("int", "Pair")]
    # A loop that nothing ends but a function which discards.
    forms += [(context, "int", "self.stop(x)") for context in _CONTEXTS if discards and "while" in context[0]]
    lines = ["    def stop(self, x: int) -> int:", "        if x > 3:", "            discard()"]
    lines += ["            return x", "        return x + 1"]
    for number, (context, result, end) in enumerate(forms):
        value = "Pair(first=x, second=3)" if result == "Pair" else "x"
        if not discards:
            end = f"return {value}"
        lines += [f"    def g{number}(self, x: int) -> {result}:"]
        lines += ["        " + line.format(end=end, dead=_DEAD, x=value) for line in [*context, "return {x}"]]
        # A local struct's field is read from a call that may never return.
        lines += [f"    def f{number}(self, x: int) -> int:"]
        lines += [f"        return self.g{number}(x)" + (".first" if result == "Pair" else "") + " + 1"]
    count = len(forms)
    lines += ["    def select(self, which: int, x: int) -> int:"]
    lines += [f"        if which == {n}:\n            return self.f{n}(x)" for n in range(count)]
    lines += ["        return 0", ""]
    head = _FRAGMENT.format(lean=lean) if discards else _COMPUTE.format(arguments=ARGUMENTS)
    return _PAIR + head + "\n" + "\n".join(lines), count


def _call(number: int, argument: str) -> str:
    """Return a call of a method whose value is an int."""
    return f"self.f{number}({argument})" + ".first" * (number % 2)


def write_program(seed: int, discards: bool, count: int = METHODS) -> str:
    """Return the text of a struct and of a shader, `Compute` or `Fragment`, with random methods."""
    head = _FRAGMENT.format(lean=seed % 2 == 1) if discards else _COMPUTE.format(arguments=ARGUMENTS)
    return _PAIR + head + "\n" + Writer(seed, discards).methods(count)


def shader_of(text: str) -> Any:
    """Return the last class of a text as a shader."""
    return sl.from_source("from rhi.shading import *\n" + text)


def expected_values(text: str, count: int = METHODS) -> NDArray[np.int32]:
    """The results of a text's methods in Python (method, argument); −1 for a discarded fragment."""

    class Pair:
        def __init__(self, first: int = 0, second: int = 0) -> None:
            self.first, self.second = first, second

    class Base:
        pass

    def discard() -> None:
        raise DiscardError

    names: dict[str, Any] = dict.fromkeys(("ivec4", "ivec2", "global_id", "fragment_coordinate"), Any)
    names |= {"Struct": Pair, "Shader": Base, "FullScreen": Base, "StorageRW": list, "discard": discard}
    exec(text, names)
    shader = names.get("Compute") or names["Fragment"]
    return np.array(list(_results(shader(), count)), np.int32).reshape(count, ARGUMENTS)


def _results(shader: Any, count: int) -> Iterator[int]:
    for number in range(count):
        for x in range(ARGUMENTS):
            try:
                yield shader.select(number, x)
            except DiscardError:
                yield -1


def run_compute(device: Device, text: str, count: int = METHODS) -> NDArray[Any]:
    """Return the results of the methods on a device (method, argument)."""
    program = device.program(shader_of(text))
    with device.storage(int, count * ARGUMENTS) as out:
        device.dispatch(program, count * ARGUMENTS, out=out)
        return out.read().reshape(count, ARGUMENTS)


def draw(device: Device, text: str, count: int = METHODS) -> NDArray[Any]:
    """Return the results of the methods in a fragment stage (method, argument); −1 where it discards."""
    program, mesh = device.program(shader_of(text)), device.mesh(3)
    with device.texture((ARGUMENTS, count), Format.RGBA32I) as target, mesh:
        with device.render_pass(target, clear=(-1, -1, -1, -1)):
            device.draw(program, mesh)
        return target.read()[..., 0]


@pytest.mark.requires("compute")
@pytest.mark.parametrize("seed", range(2))
def test_dead_statements_of_a_compute_stage_change_nothing(device: Device, seed: int) -> None:
    text = write_program(seed, False)
    assert_same(run_compute(device, text), expected_values(text))


@pytest.mark.requires("compute")
def test_each_form_of_dead_code_changes_nothing_in_a_compute_stage(device: Device) -> None:
    text, count = write_forms(False, False)
    assert_same(run_compute(device, text, count), expected_values(text, count))


@pytest.mark.requires("draws")
@pytest.mark.parametrize("lean", [False, True])
def test_each_form_of_dead_code_changes_nothing_in_a_fragment_stage(device: Device, lean: bool) -> None:
    text, count = write_forms(True, lean)
    expected = expected_values(text, count)
    assert (expected == -1).any()
    assert (expected >= 0).any()
    assert_same(draw(device, text, count), expected)


_EXITS: Final = """
    def f0(self, x: int) -> int:
        total = 0
        for i in range(4):
            for j in range(5):
                if j == x % 5:
                    break
                if (i + j) % 2 == 0:
                    continue
                total += 10 * i + j
            if i == x % 4:
                continue
            total += 100
        return total

    def f1(self, x: int) -> int:
        for i in range(6):
            k = i
            while k < 9:
                k += 2
                if k * i == x:
                    return 100 * i + k
                if k > x:
                    break
        return x

    def f2(self, x: int) -> int:
        i = 0
        total = 0
        while self.f1(i) < 300 and i < 7:
            i += 1
            if self.f3(i + x) > 2:
                continue
            total += i
        return total

    def f3(self, x: int) -> int:
        if x % 3 == 0:
            return 1
        elif x % 3 == 1:
            if x > 12:
                return 2
        else:
            for i in range(x):
                if i * i > x:
                    return i
        return x % 7

    def f4(self, x: int) -> int:
        total = 0
        for i in range(3):
            total += self.f3(x + i) if i != x % 3 else self.f1(x)
            if total > 20:
                return total
        return -total - 2

    def f5(self, x: int) -> int:
        i = 0
        while True:
            i += 1
            if i > 8:
                break
            if i % 2 == 0:
                continue
            if self.f3(i) == x % 4:
                return i
        return 50 + i

    def f6(self, x: int) -> int:
        for i in range(5):
            if x % 6 == i:
                {exit}
            if i == 3 and x > 9:
                return self.f6_inner(x, i)
        return 7

    def f6_inner(self, x: int, i: int) -> int:
        for j in range(i):
            if j == x % 5:
                {exit}
            if j > 1:
                break
        return 1000 + i

    def f7(self, x: int) -> int:
        total = self.f6(x) + self.f6(x + 1)
        for i in range(2):
            for j in range(3):
                if total % (i + j + 2) == 0:
                    return total + 10 * i + j
        return total
"""
"""Methods that end early in loops within loops, in conditions and in each other; `{exit}` is `discard()` where a
stage has it."""


def _write_exits(head: str, exit: str) -> str:
    chooses = "".join(
        f"        if number == {number}:\n            return self.f{number}(x)\n" for number in range(METHODS)
    )
    select = f"    def select(self, number: int, x: int) -> int:\n{chooses}        return 0\n"
    return f"{head}\n{select}{_EXITS.format(exit=exit)}"


@pytest.mark.requires("compute")
def test_early_exits_of_nested_loops_and_methods_in_a_compute_stage(device: Device) -> None:
    text = _write_exits(_COMPUTE.format(arguments=ARGUMENTS), "return 3 + x")
    expected = expected_values(text)
    assert len(np.unique(expected)) > 40
    assert_same(run_compute(device, text), expected)


@pytest.mark.requires("draws")
@pytest.mark.parametrize("lean", [False, True])
@pytest.mark.parametrize("exit", ["discard()", "return 3 + x"])
def test_early_exits_of_nested_loops_and_methods_in_a_fragment_stage(
    device: Device, lean: bool, exit: str
) -> None:
    text = _write_exits(_FRAGMENT.format(lean=lean), exit)
    expected = expected_values(text)
    assert (expected[6:] == -1).any() == (exit == "discard()")
    assert_same(draw(device, text), expected)


class Always(sl.FullScreen):
    """Discards all fragments, and would return a color."""

    def fragment(self) -> sl.vec4:
        sl.discard()
        return sl.vec4(1.0)


class AlwaysInBranches(sl.FullScreen):
    """Discards all fragments in two branches."""

    lean = True

    def fragment(self) -> sl.vec4:
        if sl.fragment_coordinate().x > 2.0:
            sl.discard()
            color = sl.vec4(1.0)
        else:
            sl.discard()
            color = sl.vec4(0.5)
        return color


class Colored(sl.FullScreen):
    """Draws one color, and then has dead statements."""

    def fragment(self) -> sl.vec4:
        return sl.vec4(1.0)
        sl.discard()
        return sl.vec4(0.5)


@pytest.mark.requires("draws")
@pytest.mark.parametrize(("shader", "expected"), [(Always, 0), (AlwaysInBranches, 0), (Colored, 255)])
def test_a_fragment_stage_of_dead_code(device: Device, shader: type[sl.Shader], expected: int) -> None:
    with device.texture((4, 4), Format.RGBA8) as target, device.mesh(3) as mesh:
        with device.render_pass(target, clear=(0, 0, 0, 0)):
            device.draw(device.program(shader), mesh)
        assert_same(target.read(), np.full((4, 4, 4), expected))


@pytest.mark.requires("draws")
@pytest.mark.parametrize("seed", range(2))
def test_dead_statements_of_a_fragment_stage_change_nothing(device: Device, seed: int) -> None:
    text = write_program(seed, True)
    assert_same(draw(device, text), expected_values(text))
