"""Random shaders whose methods end early: `discard`, `return`, `break` and `continue` in nested branches, loops
and conditions, with values and stores that Python gives as well.

A shader's methods call each other, also in operands of `and`, `or` and `x if c else y`, and write to a buffer
of their own element. `expected` runs the same text as Python; `run_on_numpy` and `run_on_device` run it as a
compute, vertex or fragment stage. Nothing that is behind an exit may change a value, a store or a depth.
"""

from __future__ import annotations

import random
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

import rhi
import rhi.shading as sl
from rhi import Device, Format

ARGUMENTS: Final = 24
METHODS: Final = 4
HELPERS: Final = 4
"""Methods that only the others call."""
MAX_LINES: Final = 150
"""Lines of a method, with those of the methods that it calls each time it calls them, beyond which it calls no
more. Drivers put called methods in place of the calls; without a limit, one of a hundred programs had 5,000
lines then, and took minutes to compile."""
_DISCARDED: Final = -1
_CONSTANTS: Final = (2, 3, 5, 7, 11)

_STRUCTS: Final = """
class Pair(Struct):
    first: int
    second: int

class Trio(Struct):
    pair: Pair
    third: int
"""
# A fragment stage stores 0 at first, so that a lean shader has the binding `log` whatever its methods store.
STAGES: Final = {
    "compute": """
class Stage(Shader):
    out: StorageRW[int]
    log: StorageRW[int]

    def compute(self) -> None:
        i = global_id().x
        self.out[i] = self.select(i // {arguments}, i % {arguments}, int(i))
""",
    "vertex": """
class Moved(Struct):
    clip: vec4
    value: Flat[int]

class Stage(Shader):
    def vertex(self) -> Moved:
        i = vertex_index()
        value = self.select(i // {arguments}, i % {arguments}, i)
        at = vec2(float(i % {arguments}) + 0.5, float(i // {arguments}) + 0.5) / vec2({arguments}.0, {methods}.0)
        return Moved(clip=vec4(at.x * 2.0 - 1.0, 1.0 - at.y * 2.0, 0.5, 1.0), value=value)

    def fragment(self, m: Moved) -> ivec4:
        return ivec4(m.value, 1, 2, 3)
""",
    "fragment": """
class Stage(FullScreen):
    lean = {lean}
    log: StorageRW[int]

    def fragment(self) -> ivec4:
        at = ivec2(fragment_coordinate().xy)
        self.log[at.y * {arguments} + at.x] += 0
        return ivec4(self.select(at.y, at.x, at.y * {arguments} + at.x), 1, 2, 3)
""",
    "depth": """
class Written(Struct):
    first: ivec4
    second: uvec2
    depth: FragmentDepth

class Stage(FullScreen):
    lean = {lean}
    log: StorageRW[int]

    def fragment(self) -> Written:
        at = ivec2(fragment_coordinate().xy)
        self.log[at.y * {arguments} + at.x] += 0
        if at.y % 2 == 0:
            x = self.select(at.y, at.x, at.y * {arguments} + at.x)
            return Written(first=ivec4(x, 1, 2, 3), second=uvec2(uint(x), 7), depth=float(x) / 128.0)
        y = self.select(at.y, at.x, at.y * {arguments} + at.x)
        return Written(first=ivec4(y, 1, 2, 3), second=uvec2(uint(y), 7), depth=float(y) / 128.0)
""",
}
_KINDS: Final = ("int", "int", "Pair", "Trio", "ivec3", "bool", "float")
_AS_INT: Final = {
    "int": "{}",
    "Pair": "{}.first",
    "Trio": "{}.pair.second",
    "ivec3": "{}.y",
    "bool": "int({})",
    "float": "int({})",
}
_RESULTS: Final = {
    "int": "{}",
    "Pair": "Pair(first={}, second=x)",
    "Trio": "Trio(pair=Pair(first=x, second={}), third=5)",
    "ivec3": "ivec3(1, {}, x)",
    "float": "float({})",
}


class DiscardError(Exception):
    """Raised where Python runs `discard()`."""


class Writer:
    """Writes the methods of a stage."""

    def __init__(self, seed: int, stage: str) -> None:
        self._random = random.Random(f"{seed} {stage}")
        self._discards = stage in {"fragment", "depth"}
        self._stores = stage != "vertex"
        self._lines: list[str] = []
        self._names = 0
        self._kinds: list[str] = []
        self._calls = 0
        self._sizes: list[int] = []  # lines of each method, with those that it calls
        self._called_lines = self._first_line = 0
        self._array = ""

    def write(self) -> str:
        """Return the methods, and `select(which, x, i)`, which calls the method `which`."""
        for number in range(HELPERS + METHODS):
            self._write_method(number)
        self._add(4, "def select(self, which: int, x: int, i: int) -> int:")
        for which in range(METHODS):
            if which < METHODS - 1:
                self._add(8, f"if which == {which}:")
            self._add(12 if which < METHODS - 1 else 8, f"return {self._call(HELPERS + which, 'x')}")
        return "\n".join(self._lines) + "\n"

    def _write_method(self, number: int) -> None:
        kinds = _KINDS + ("None",) * (3 if number < HELPERS and self._stores else 0)
        self._kinds.append(self._random.choice(kinds))
        self._callable = range(min(number, HELPERS))
        self._calls, self._array = 0, ""
        self._called_lines, self._first_line = 0, len(self._lines)
        self._add(4, f"def f{number}(self, x: int, i: int) -> {self._kinds[-1]}:")
        if self._kinds[-1] == "None":
            self._add(8, f"self.log[i] = self.log[i] + {number + 1}")
        if self._random.random() < 0.4:
            self._array = self._name("a")
            self._add(8, f"{self._array} = array(int, 4)")
        if not self._write_block(8, 0, False):
            self._add(8, self._return())
        if self._random.random() < 0.3:
            self._write_dead(8, False)
        self._sizes.append(self._count_lines())

    def _count_lines(self) -> int:
        """Lines of the method so far, with those of the methods that it calls."""
        return len(self._lines) - self._first_line + self._called_lines

    def _add(self, indent: int, text: str) -> None:
        self._lines.append(" " * indent + text)

    def _name(self, prefix: str) -> str:
        self._names += 1
        return f"{prefix}{self._names}"

    def _call(self, number: int, argument: str) -> str:
        return _AS_INT[self._kinds[number]].format(f"self.f{number}({argument}, i)")

    def _pick_helper(self) -> int | None:
        """Return a method that may be called here; None if there is none, or calls enough are written."""
        room = MAX_LINES - self._count_lines()
        helpers = [number for number in self._callable if self._sizes[number] <= room]
        if not helpers or self._calls >= 4:
            return None
        self._calls += 1
        helper = self._random.choice(helpers)
        self._called_lines += self._sizes[helper]
        return helper

    def _operand(self) -> str:
        forms = ["x", "(x + {})", "(x * {})", "(7 - x)", "(x // {})", "(x % {})"]
        if self._array:
            forms.append(f"{self._array}[x % 4]")
        text = self._random.choice(forms).format(self._random.choice(_CONSTANTS))
        helper = self._pick_helper() if self._random.random() < 0.3 else None
        if helper is not None and self._kinds[helper] != "None":
            return self._call(helper, f"{text} % 50")
        return text

    def _value(self) -> str:
        form = self._random.random()
        if form < 0.6:
            text = self._operand()
        elif form < 0.8:
            text = f"({self._operand()} {self._random.choice('+-*')} {self._operand()})"
        else:
            text = f"({self._operand()} if {self._condition()} else {self._operand()})"
        return f"{text} % 97"

    def _condition(self, is_whole: bool = True) -> str:
        form = self._random.random()
        if is_whole and form < 0.3:
            joined = self._random.choice(("and", "or"))
            return f"({self._condition(False)} {joined} {self._condition(False)})"
        if is_whole and form < 0.4:
            return f"(not {self._condition(False)})"
        divisor = self._random.choice((2, 3, 4))
        compared = "x" if self._random.random() < 0.6 else self._operand()
        return f"{compared} % {divisor} {self._random.choice(('==', '!=', '<'))} {self._random.randrange(divisor)}"

    def _return(self) -> str:
        kind = self._kinds[-1]
        if kind == "None":
            return "return"
        return f"return {self._condition() if kind == 'bool' else _RESULTS[kind].format(self._value())}"

    def _exit(self, in_loop: bool) -> str:
        exits = [self._return()] + ["discard()"] * 2 * self._discards + ["break", "continue"] * in_loop
        return self._random.choice(exits)

    def _write_block(self, indent: int, depth: int, in_loop: bool) -> bool:
        """Write statements, and return whether none behind them is reached."""
        for _ in range(self._random.randint(1, 3)):
            if self._write_statement(indent, depth, in_loop):
                if self._random.random() < 0.5:
                    self._write_dead(indent, in_loop)
                return True
        return False

    def _write_statement(self, indent: int, depth: int, in_loop: bool) -> bool:
        form = self._random.random() * (0.35 if depth > 4 else 1.0)
        if form < 0.35:
            self._write_change(indent)
        elif form < 0.6:
            return self._write_branch(indent, depth, in_loop)
        elif form < 0.82:
            self._write_loop(indent, depth)
        elif depth or form > 0.93:
            self._add(indent, self._exit(in_loop))
            return True
        return False

    def _write_change(self, indent: int) -> None:
        form = self._random.random()
        if form < 0.3 and self._stores:
            salt = self._random.randrange(9)
            self._add(indent, f"self.log[i] = (self.log[i] * 3 + {self._value()} + {salt}) % 9973")
        elif form < 0.4:
            self._add(indent, f"x += {self._value()}")
            self._add(indent, "x = x % 97")
        elif form < 0.6 and self._array:
            self._add(indent, f"{self._array}[{self._value()} % 4] = {self._value()}")
        elif form < 0.75 and (helper := self._pick_helper()) is not None:
            call = f"self.f{helper}(x % 50, i)"
            is_value = self._kinds[helper] != "None"
            self._add(indent, f"x = {_AS_INT[self._kinds[helper]].format(call)} % 97" if is_value else call)
        else:
            self._add(indent, f"x = {self._value()}")

    def _write_branch(self, indent: int, depth: int, in_loop: bool) -> bool:
        self._add(indent, f"if {self._condition()}:")
        ends = self._write_block(indent + 4, depth + 1, in_loop)
        if self._random.random() < 0.3:
            self._add(indent, f"elif {self._condition()}:")
            ends &= self._write_block(indent + 4, depth + 1, in_loop)
        if self._random.random() < 0.5:
            return False
        self._add(indent, "else:")
        return self._write_block(indent + 4, depth + 1, in_loop) and ends

    def _write_loop(self, indent: int, depth: int) -> None:
        counter, form = self._name("n"), self._random.random()
        if form < 0.5:
            bounds = [
                str(self._random.randint(1, 4)),
                f"{self._value()} % 4",
                "3, -1, -1",
                "1, 6, 2",
                "x % 3, 4",
            ]
            self._add(indent, f"for {counter} in range({self._random.choice(bounds)}):")
            self._add(indent + 4, f"x = (x + {counter}) % 97")
        else:
            most = self._random.randint(1, 5)
            is_endless = form > 0.8
            condition = "True" if is_endless else f"{counter} < {most} and {self._condition()}"
            self._add(indent, f"{counter} = 0")
            self._add(indent, f"while {condition}:")
            self._add(indent + 4, f"{counter} += 1")
            if is_endless:
                exits = ["break", self._return()] + ["discard()"] * self._discards
                self._add(indent + 4, f"if {counter} > {most}:")
                self._add(indent + 8, self._random.choice(exits))
        self._write_block(indent + 4, depth + 1, True)

    def _write_dead(self, indent: int, in_loop: bool) -> None:
        """Write statements that are never reached."""
        name = self._name("dead")
        forms = [
            ["x = 1000"],
            [f"{name} = x * 1000", f"x = {name}"],
            [f"for {name} in range(x):", f"    x += {name}"],
            [f"if {self._condition()}:", f"    {self._exit(in_loop)}", "else:", "    x = 2000"],
            [f"while {self._condition()}:", "    x += 1", f"    {self._exit(True)}"],
            [self._exit(in_loop)],
        ]
        if self._stores:
            forms.append(["self.log[i] = 12345"])
        for line in self._random.choice(forms):
            self._add(indent, line)


def write_stage(seed: int, stage: str) -> str:
    """Return the text of structs and of the class `Stage`, with random methods."""
    head = STAGES[stage].format(arguments=ARGUMENTS, methods=METHODS, lean=seed % 2 == 1)
    return _STRUCTS + head + "\n" + Writer(seed, stage).write()


Results = tuple[NDArray[Any], NDArray[Any] | None]
"""The methods' results (method, argument), −1 where a fragment is discarded, and what they have stored."""


def expected(text: str) -> Results:
    """Run a text as Python."""

    class Value:
        """A struct's value, or a vector's."""

        def __init__(self, *components: int, **fields: Any) -> None:
            vars(self).update(zip("xyz", components, strict=False))
            vars(self).update(fields)

    def discard() -> None:
        raise DiscardError

    unused = ("ivec2", "ivec4", "uvec2", "vec2", "vec4", "global_id", "fragment_coordinate", "FragmentDepth")
    names: dict[str, Any] = dict.fromkeys(unused, Any)
    names |= {"Struct": Value, "Shader": object, "FullScreen": object, "StorageRW": list, "Flat": list}
    names |= {"discard": discard, "ivec3": Value, "array": lambda _, count: [0] * count}
    exec(text, names)
    stage, results = names["Stage"](), []
    stage.log = [0] * (METHODS * ARGUMENTS)
    for i in range(METHODS * ARGUMENTS):
        try:
            results.append(stage.select(i // ARGUMENTS, i % ARGUMENTS, i))
        except DiscardError:
            results.append(_DISCARDED)
    return _tabulate(np.array(results)), _tabulate(np.array(stage.log))


def _tabulate(values: NDArray[Any]) -> NDArray[Any]:
    return values.reshape(METHODS, ARGUMENTS)


def _shader(text: str) -> Any:
    return sl.from_source("from rhi.shading import *\n" + text)


def run_on_numpy(text: str, stage: str) -> Results:
    """Run a text as a stage with NumPy."""
    shader, count = _shader(text), METHODS * ARGUMENTS
    if stage == "compute":
        memory = sl.run_compute(shader, count, out=count, log=count)
        return _tabulate(memory["out"]), _tabulate(memory["log"])
    if stage == "vertex":
        return _tabulate(sl.run_vertex(shader, {}, vertex_index=np.arange(count)).varyings["value"]), None
    run = sl.run_fragment(shader, covered=np.ones((METHODS, ARGUMENTS), bool), log=count)
    values = next(iter(run.outputs.values()))[..., 0]
    return np.where(run.coverage, values, _DISCARDED), _tabulate(run.memory["log"])


def run_on_device(device: Device, text: str, stage: str) -> Results:
    """Run a text as a stage on a device. A depth and a second target are compared with the first."""
    program, count, size = device.program(_shader(text)), METHODS * ARGUMENTS, (ARGUMENTS, METHODS)
    clear = (_DISCARDED,) * 4
    with device.texture(size, Format.RGBA32I) as target, device.storage(int, count) as log:
        if stage == "compute":
            with device.storage(int, count) as out:
                device.dispatch(program, count, out=out, log=log)
                return _tabulate(out.read()), _tabulate(log.read())
        if stage == "vertex":
            with device.mesh(count, primitive=rhi.Primitive.POINTS) as points:
                with device.render_pass(target, clear=clear):
                    device.draw(program, points)
                return target.read()[..., 0], None
        with device.mesh(3) as triangle:
            if stage == "depth":
                _draw_depth(device, program, target, triangle, log)
            else:
                with device.render_pass(target, clear=clear):
                    device.draw(program, triangle, log=log)
        return target.read()[..., 0], _tabulate(log.read())


def _draw_depth(device: Device, program: Any, target: rhi.Texture, triangle: Any, log: Any) -> None:
    with (
        device.texture(target.size, Format.RG32UI) as second,
        device.texture(target.size, Format.D32F) as depth,
    ):
        with device.render_pass(
            [target, second], depth, clear=[(_DISCARDED,) * 4, (9, 9, 0, 0)], clear_depth=0.999
        ):
            with device.states(rhi.DepthFunction.ALWAYS):
                device.draw(program, triangle, log=log)
        values = target.read()[..., 0]
        is_discarded = values == _DISCARDED
        np.testing.assert_array_equal(second.read()[..., 0], np.where(is_discarded, 9, values))
        depths = np.where(is_discarded, np.float32(0.999), values / 128.0)
        np.testing.assert_allclose(depth.read().reshape(values.shape), depths, atol=1e-6)
