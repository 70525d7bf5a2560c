"""Programs whose operands write what others read, and the same programs in plain Python.

A program is the body of a compute shader. Each of 16 invocations has its own part of every memory, so that
Python runs one after the other. All numbers are ints and stay small, so that results are equal or wrong.
"""

from __future__ import annotations

import ast
import random
import textwrap
from types import SimpleNamespace
from typing import Any, Final

INVOCATIONS: Final = 16
WORDS: Final = 16
"""Numbers of `mem` for each invocation; `part` has 8, `vecs` has 4 vectors, `texels` 4 texels."""

TURNS: Final = (((1.0, 2.0), (3.0, 4.0)), ((5.0, 6.0), (7.0, 8.0)))
ROWS: Final = ((1, 2), (3, 4), (5, 6), (7, 8))
"""The contents of `settings`."""

HEADER: Final = '''
import rhi.shading as sl
from rhi import Format

class Two(sl.Struct):
    a: int
    b: int

class Settings(sl.Struct):
    turns: sl.Array[sl.mat2] = sl.array(sl.mat2, 2)
    rows: sl.Array[sl.ivec2] = sl.array(sl.ivec2, 4)

class Base(sl.Shader):
    work_group = (16,)
    out: sl.StorageRW[int]
    mem: sl.StorageRW[int]
    vecs: sl.StorageRW[sl.ivec4]
    part = sl.shared(int, 128)
    settings: sl.Uniform[Settings]
    texels: sl.IntImage2D = sl.image(Format.R32I)

    def begin(self) -> None:
        """Give memory its first contents."""
        i = sl.local_index()
        for k in range(16):
            self.mem[i * 16 + k] = (k * 7 + i) % 13 + self.settings.rows[0].x - 1
        for k in range(8):
            self.part[i * 8 + k] = (k * 5 + i) % 11
        for k in range(4):
            self.vecs[i * 4 + k] = sl.ivec4(k, k + i, 3 - k, k * i)
            self.texels.store(sl.ivec2(k, i), sl.ivec4(k + 2 * i, 0, 0, 1))

    def reset(self) -> None:
        """Give what forms read most its first contents again."""
        i = sl.local_index()
        self.mem[i * 16 + 1] = 4 + i % 3
        self.mem[i * 16 + 2] = 3 + i % 5
        self.mem[i * 16 + 3] = 6
        self.part[i * 8 + 2] = 5 + i
        self.part[i * 8 + 3] = 7
        self.vecs[i * 4 + 1] = sl.ivec4(1, i, 2, 3)
        self.texels.store(sl.ivec2(1, i), sl.ivec4(9 + i, 0, 0, 1))

    def word(self, k: int) -> int:
        return sl.local_index() * 16 + (k & 15)

    def inc(self, k: int) -> int:
        at = self.word(k)
        self.mem[at] = self.mem[at] + 1
        return self.mem[at]

    def push(self, k: int) -> int:
        at = sl.local_index() * 8 + (k & 7)
        self.part[at] += 1
        return self.part[at]

    def shift(self, k: int) -> int:
        at = sl.local_index() * 4 + (k & 3)
        self.vecs[at].xy = sl.ivec2(self.vecs[at].y, self.vecs[at].x + 1)
        return self.vecs[at].x

    def put(self, k: int, value: int) -> int:
        at = sl.ivec2(k & 3, sl.local_index())
        self.texels.store(at, sl.ivec4(value & 255, 0, 0, 1))
        return k & 3

    def texel(self, k: int) -> int:
        return self.texels.load(sl.ivec2(k & 3, sl.local_index())).x

    def late(self, value: int) -> int:
        """Write before the argument is used."""
        self.mem[self.word(2)] += 1
        return (value * 10 + self.mem[self.word(2)]) & 1023

    def two(self, a: int, b: int) -> int:
        return (a * 10 + b) & 1023

    def flip(self, k: int) -> bool:
        return (self.inc(k) & 1) == 1

    def row(self, k: int) -> sl.vec2:
        at = self.word(k)
        self.mem[at] = (self.mem[at] + 1) & 15
        return sl.vec2(float(self.mem[at]), 1.0)

    def turn(self, k: int) -> sl.mat2:
        at = self.word(k)
        return sl.mat2(sl.vec2(float(self.mem[at] & 15), 2.0), sl.vec2(3.0, float(k & 15)))

    def both(self, k: int) -> int:
        return self.mem[self.word(k)] * 10 + self.inc(k)

    def nothing(self, a: int, b: int) -> None:
        self.mem[self.word(5)] = (a * 3 + b) & 255
'''


class Composite(SimpleNamespace):
    """A vector or struct in Python."""

    def __getitem__(self, index: int) -> Any:
        return getattr(self, "xyzw"[index])

    def __setitem__(self, index: int, value: Any) -> None:
        setattr(self, "xyzw"[index], value)

    @property
    def xy(self) -> Composite:
        return Composite(x=self.x, y=self.y)

    @xy.setter
    def xy(self, pair: Composite) -> None:
        self.x, self.y = pair.x, pair.y

    @property
    def zx(self) -> Composite:
        return Composite(x=self.z, y=self.x)

    @zx.setter
    def zx(self, pair: Composite) -> None:
        self.z, self.x = pair.x, pair.y

    def __matmul__(self, other: Composite) -> Composite:
        """Return a mat2 of rows times a vec2, or a vec2 times a mat2."""
        if isinstance(self.x, Composite):
            return Composite(**{
                axis: row.x * other.x + row.y * other.y for axis, row in vars(self).items()
            })  # fmt: skip
        return Composite(**{axis: self.x * other.x[i] + self.y * other.y[i] for i, axis in enumerate("xy")})


def _vector(*parts: Any) -> Composite:
    """Return a vector or a matrix; one number is a 2×2 matrix's diagonal, and none is a vector of zeros."""
    if len(parts) == 1:
        parts = _vector(parts[0], 0.0), _vector(0.0, parts[0])
    parts = parts or (0, 0, 0, 0)
    return Composite(**dict(zip("xyzw", parts, strict=False)))


class _Texels(dict[tuple[int, int], int]):
    """An image in Python."""

    def load(self, at: Composite) -> Composite:
        return Composite(x=self[at.x, at.y])

    def store(self, at: Composite, value: Composite) -> None:
        self[at.x, at.y] = value.x


class _Atomics(ast.NodeTransformer):
    """Turns `sl.atomic_add(memory[i], value)` into `_atomic_add(memory, i, value)`, in the same order."""

    def visit_Call(self, node: ast.Call) -> ast.AST:
        self.generic_visit(node)
        if isinstance(node.func, ast.Attribute) and node.func.attr.startswith("atomic_"):
            target = node.args[0]
            assert isinstance(target, ast.Subscript)
            name = ast.Name("_" + node.func.attr, ast.Load())
            return ast.Call(name, [target.value, target.slice, *node.args[1:]], [])
        return node


def _atomic(operation: Any) -> Any:
    def run(memory: list[int], index: int, *values: int) -> int:
        old = memory[index]
        memory[index] = operation(old, *values)
        return old

    return run


_ATOMICS: Final = {
    "_atomic_add": _atomic(lambda old, value: old + value),
    "_atomic_max": _atomic(max),
    "_atomic_exchange": _atomic(lambda old, value: value),
    "_atomic_compare_exchange": _atomic(lambda old, expected, value: value if old == expected else old),
}


def run_in_python(text: str, count: int) -> dict[str, list[int]]:
    """Run a program's text in Python, one invocation after the other; return what each memory contains."""
    module = _Atomics().visit(ast.parse(text))
    remaining = [node for node in module.body if not isinstance(node, ast.Import | ast.ImportFrom)]
    for node in remaining:
        if isinstance(node, ast.ClassDef):
            node.body = [part for part in node.body if isinstance(part, ast.FunctionDef)] or [ast.Pass()]
            node.bases = [base for base in node.bases if isinstance(base, ast.Name)]
            for part in node.body:
                if isinstance(part, ast.FunctionDef):
                    part.returns = None
                    for argument in part.args.args:
                        argument.annotation = None
    module.body = remaining
    invocation = [0]
    scope: dict[str, Any] = {
        "sl": SimpleNamespace(
            local_index=lambda: invocation[0],
            ivec2=_vector,
            ivec3=_vector,
            ivec4=_vector,
            vec2=_vector,
            mat2=_vector,
            array=lambda element, length: [element() for _ in range(length)],
            min=min,
            max=max,
            clamp=lambda x, low, high: max(low, min(x, high)),
        ),
        **_ATOMICS,
    }
    exec(compile(ast.fix_missing_locations(module), "<program>", "exec"), scope)
    scope["Two"] = Composite
    shader = scope["Program"]()
    shader.out, shader.mem = [0] * (count * INVOCATIONS), [0] * (WORDS * INVOCATIONS)
    shader.part, shader.vecs = [0] * (8 * INVOCATIONS), [None] * (4 * INVOCATIONS)
    shader.texels = _Texels()
    shader.settings = SimpleNamespace(
        turns=[_vector(*(_vector(*row) for row in turn)) for turn in TURNS],
        rows=[_vector(*row) for row in ROWS],
    )
    for invocation[0] in range(INVOCATIONS):
        shader.compute()
    return {
        "out": shader.out,
        "mem": shader.mem,
        "vecs": [number for row in shader.vecs for number in (row.x, row.y, row.z, row.w)],
        "texels": [shader.texels[x, y] for y in range(INVOCATIONS) for x in range(4)],
    }


# -- forms -------------------------------------------------------------------------------------------------

FORMS: Final = {
    "a + f()": "r = self.mem[b + 2] * 10 + self.inc(2)",
    "f() + a": "r = self.inc(2) * 10 + self.mem[b + 2]",
    "f() - g()": "r = self.inc(2) * 10 - self.both(2)",
    "a + b + f()": "r = self.mem[b + 1] + self.mem[b + 2] * 10 + self.inc(2)",
    "a == f()": "r = 1 if self.mem[b + 2] == self.inc(2) else 0",
    "a < f()": "r = 1 if self.mem[b + 2] < self.inc(2) else 0",
    "0 < a < f()": "r = 1 if 0 < self.mem[b + 2] < self.inc(2) else 0",
    "call(a, f())": "r = self.two(self.mem[b + 2], self.inc(2))",
    "call(f(), a)": "r = self.two(self.inc(2), self.mem[b + 2])",
    "a parameter that the callee overwrites": "r = self.late(self.mem[b + 2])",
    "late(a) + a": "r = self.late(self.mem[b + 2]) * 3 + self.mem[b + 2]",
    "x, y = a, f()": "x, y = self.mem[b + 2], self.inc(2)\nr = x * 100 + y",
    "a[f()], x = x, a": "x = 3\nself.mem[self.word(self.inc(2))], x = x, self.mem[b + 2]\nr = x",
    "a + atomic": "r = self.mem[b + 3] * 10 + sl.atomic_add(self.mem[b + 3], 1)",
    "atomic + a": "r = sl.atomic_add(self.mem[b + 3], 1) * 10 + self.mem[b + 3]",
    "atomic(a[f()], g())": "r = sl.atomic_add(self.mem[self.word(self.inc(2))], self.inc(2))",
    "atomic(a[f() & 15], a)": "r = sl.atomic_exchange(self.mem[b + (self.inc(2) & 15)], self.mem[b + 2])",
    "atomic(a[a], f())": "r = sl.atomic_add(self.mem[b + self.mem[b + 2]], self.inc(2))",
    "compare_exchange(a[f()], a, g())": (
        "r = sl.atomic_compare_exchange(self.mem[b + (self.inc(2) & 15)], self.mem[b + 2], self.inc(2))"
    ),
    "return a + f()": "r = self.both(2)",
    "a += f()": "self.mem[b + 2] += self.inc(2)\nr = self.mem[b + 2]",
    "a -= f(), in shared memory": "self.part[s + 2] -= self.push(2)\nr = self.part[s + 2]",
    "a[a] += f()": "self.mem[b + (self.mem[b + 2] & 7)] += self.inc(2)\nr = 0",
    "a[a] |= f(), a vector": "self.vecs[v + (self.vecs[v + 1].x & 3)].y |= self.shift(1)\nr = 0",
    "x += f()": "x = self.mem[b + 2]\nx += self.inc(2) * 10\nr = x",
    "table[a] += f()": (
        "table = sl.array(int, 16)\ntable[self.mem[b + 2] & 15] += self.inc(2)\nr = table[self.mem[b + 2] & 15]"
    ),
    "a[f()] = a": "self.mem[self.word(self.inc(2))] = self.mem[b + 2]\nr = 0",
    "a[f() & 15] = a": "self.mem[b + (self.inc(2) & 15)] = self.mem[b + 2]\nr = 0",
    "a[a & 15] = f()": "self.mem[b + (self.mem[b + 2] & 15)] = self.inc(2)\nr = 0",
    "v[f()][a] = a": "self.vecs[v + (self.inc(2) & 3)][self.mem[b + 2] & 3] = self.mem[b + 2]\nr = 0",
    "v[f()].xy = w": "self.vecs[v + (self.inc(2) & 3)].xy = sl.ivec2(self.mem[b + 2], self.inc(2))\nr = 0",
    "v[v[1].x].xy = w": "self.vecs[v + (self.vecs[v + 1].x & 3)].xy = sl.ivec2(7, 8)\nr = self.vecs[v + 1].y",
    "v[f()].x": "r = self.vecs[v + (self.shift(1) & 3)].x * 10 + self.shift(2)",
    "v[f()][g()]": "r = self.vecs[v + (self.shift(1) & 3)][self.shift(2) & 3]",
    "shared + f()": "r = self.part[s + 3] * 10 + self.push(3)",
    "shared + atomic": "r = self.part[s + 3] * 10 + sl.atomic_max(self.part[s + 3], 90) + self.part[s + 3]",
    "texel + store": "r = self.texels.load(sl.ivec2(1, i)).x * 10 + self.put(1, 77) + self.texel(1)",
    "store(f(), a)": "self.texels.store(sl.ivec2(self.inc(2) & 3, i), sl.ivec4(self.mem[b + 2], 0, 0, 1))\nr = 0",
    "load(f()) + a": "r = self.texels.load(sl.ivec2(self.inc(2) & 3, i)).x + self.mem[b + 2]",
    "ivec(a, f())": "x2 = sl.ivec2(self.mem[b + 2], self.inc(2))\nr = x2.x * 100 + x2.y",
    "ivec(a, f()).x": "r = sl.ivec2(self.mem[b + 2], self.inc(2)).x",
    "Struct(a, f())": "pair = Two(a=self.mem[b + 2], b=self.inc(2))\nr = pair.a * 100 + pair.b",
    "max(a, f())": "r = sl.max(self.mem[b + 2] * 3, self.inc(2))",
    "clamp(a, f(), g())": "r = sl.clamp(self.mem[b + 2], self.inc(2), self.inc(2) + self.mem[b + 2])",
    "m @ f()": "x3 = self.turn(2) @ self.row(2)\nr = int(x3.x) * 100 + int(x3.y)",
    "f() @ m": "x3 = self.row(2) @ self.turn(2)\nr = int(x3.x) * 100 + int(x3.y)",
    "mat(f())": "x4 = sl.mat2(self.row(2), self.row(2)) @ sl.vec2(1.0, 2.0)\nr = int(x4.x) * 100 + int(x4.y)",
    "a if f() else g()": "r = self.mem[b + 2] if self.flip(2) else self.inc(2) * 100",
    "a + (f() if a else g())": "r = self.mem[b + 2] * 10 + (self.inc(2) if self.mem[b + 2] > 3 else self.inc(3))",
    "(a + f()) if c else (a - f())": (
        "r = self.mem[b + 2] * 7 + self.inc(2) if (i & 1) == 0 else self.mem[b + 2] * 5 - self.inc(2)"
    ),
    "f() and a == f()": "r = 1 if self.flip(2) and self.mem[b + 2] + 1 == self.inc(2) else 0",
    "f() or a == f()": "r = 1 if self.flip(2) or self.mem[b + 2] == self.inc(2) else 0",
    "a > 3 and f()": "r = 1 if self.mem[b + 2] > 3 and self.inc(2) > 3 and self.mem[b + 2] > 3 else 0",
    "(a == f()) == (a == f())": (
        "r = 1 if (self.mem[b + 2] == self.inc(2)) == (self.mem[b + 2] + 1 == self.inc(2)) else 0"
    ),
    "not a == f()": "r = 0\nif not self.mem[b + 2] == self.inc(2):\n    r = 5",
    "if, elif": (
        "if self.mem[b + 2] == self.inc(2):\n    r = 1\nelif self.mem[b + 2] + 1 == self.inc(2):\n    r = 2\n"
        "else:\n    r = 3"
    ),
    "while a + f() < 40": "r = 0\nwhile self.mem[b + 2] * 2 + self.inc(2) < 40:\n    r += 1",
    "while with continue and break": (
        "r = 0\nwhile self.mem[b + 2] * 2 + self.inc(2) < 60:\n    if (self.mem[b + 2] & 1) == 0:\n"
        "        continue\n    r += self.mem[b + 2]\n    if r > 20:\n        break"
    ),
    "pairs[f()].xy = w": (
        "pairs = sl.array(sl.ivec3, 4)\npairs[self.inc(2) & 3].zx = sl.ivec2(self.mem[b + 2], 5)\n"
        "r = pairs[0].x + pairs[1].x * 7 + pairs[2].z * 3 + pairs[3].x * 5"
    ),
    "pairs[pairs[1].x].xy = w": (
        "pairs = sl.array(sl.ivec3, 4)\npairs[1].x = 1\npairs[pairs[1].x & 3].xy = sl.ivec2(2, 3)\n"
        "r = pairs[1].x * 100 + pairs[1].y * 10 + pairs[2].y"
    ),
    "mat(f()), a diagonal": (
        "x5 = sl.mat2(float(self.inc(2))) @ sl.vec2(1.0, 2.0)\nr = int(x5.x) * 100 + int(x5.y)"
    ),
    "mat[f()] @ v": (
        "x6 = self.settings.turns[self.inc(2) & 1] @ sl.vec2(1.0, 2.0)\nr = int(x6.x) * 100 + self.mem[b + 2]"
    ),
    "v and mat[f()] @ v": (
        "r = 0\nif i > 3 and int((self.settings.turns[self.inc(2) & 1] @ sl.vec2(1.0, 2.0)).x) > 3:\n    r = 4\n"
        "r = r * 100 + self.mem[b + 2]"
    ),
    "uniform[f()] + a": "r = self.settings.rows[self.inc(2) & 3].y * 100 + self.mem[b + 2]",
    "range(a, f())": "r = 0\nfor k in range(self.mem[b + 2], self.inc(2) + 3):\n    r = r * 2 + (k & 3)",
    "range(a, f(), g())": (
        "r = 0\nfor k in range(self.mem[b + 2], self.inc(2) + 9, (self.inc(2) & 3) + 1):\n    r = r + k"
    ),
    "range(f(), a)": "r = 0\nfor k in range(self.inc(2) & 3, self.mem[b + 2]):\n    r = r + k + self.inc(2)",
    "f(a, f(a, f()))": "r = self.two(self.mem[b + 2], self.two(self.mem[b + 2], self.inc(2)))",
    "a + (b * (a - f()))": "r = self.mem[b + 2] + (self.mem[b + 1] * (self.mem[b + 2] * 2 - self.inc(2)))",
    "f(a) as a statement": "self.nothing(self.mem[b + 2], self.inc(2))\nr = 0",
    "a // f()": "r = (self.mem[b + 2] * 100) // self.inc(2) + (self.mem[b + 2] * 9) % self.inc(2)",
    "a << f()": "r = self.mem[b + 2] << (self.inc(2) & 3)",
    "-a + f()": "r = -self.mem[b + 2] * 10 + self.inc(2)",
    "float(a) + f()": "r = int(float(self.mem[b + 2]) * 10.0 + float(self.inc(2)))",
    "a + g()  # of other memory": "r = self.mem[b + 2] * 10 + self.push(2)",
}
"""A name and statements that end with `r`: `i` is the invocation, `b`, `s` and `v` begin its parts of
memory."""

_START: Final = "i = sl.local_index()\nb = i * 16\ns = i * 8\nv = i * 4\n"


def program_of(bodies: list[str]) -> str:
    """Return the text of a program that runs one body after the other."""
    lines = [_START, "self.begin()"]
    for number, body in enumerate(bodies):
        lines += ["self.reset()", body, f"self.out[i * {len(bodies)} + {number}] = r"]
    method = "    def compute(self) -> None:\n" + textwrap.indent("\n".join(lines), " " * 8)
    return f"{HEADER}\nclass Program(Base):\n{method}\n"


# -- random programs ---------------------------------------------------------------------------------------


class Generator:
    """Draws programs of random expressions and statements."""

    def __init__(self, seed: int) -> None:
        self.rng = random.Random(seed)
        self.loops = 0

    def expression(self, depth: int, acts: bool = True) -> str:
        """Return an int expression, without side effects unless `acts`."""
        rng = self.rng

        def sub() -> str:
            return self.expression(depth - 1, acts)

        if depth <= 0:
            return rng.choice(["x", "y", "i", str(rng.randint(0, 9)), self.read("2"), self.read("3")])
        form = rng.randint(0, 22 if acts else 10)
        if form <= 2:
            return f"(({sub()} {rng.choice('+-*&|^')} {sub()}) & 255)"
        if form == 3:
            return f"({sub()} {rng.choice(['//', '%'])} (({sub()} & 7) + 1))"
        if form == 4:
            return f"({sub()} if {self.condition(depth - 1, acts)} else {sub()})"
        if form <= 6:
            return self.read(sub())
        if form == 7:
            return f"self.vecs[v + ({sub()} & 3)][{sub()} & 3]"
        if form == 8:
            return f"sl.{rng.choice(['min', 'max'])}({sub()}, {sub()})"
        if form == 9:
            return f"sl.ivec3({sub()}, {sub()}, {sub()}).{rng.choice('xyz')}"
        if form == 10:
            return f"Two(a={sub()}, b={sub()}).{rng.choice('ab')}"
        if form <= 13:
            return f"self.{rng.choice(['inc', 'push', 'shift', 'both'])}({sub()})"
        if form == 14:
            return f"self.two({sub()}, {sub()})"
        if form == 15:
            return f"self.late({sub()})"
        if form <= 17:
            atomic = rng.choice(["add", "max", "exchange"])
            memory = f"self.mem[b + ({sub()} & 15)]" if rng.randint(0, 2) else f"self.part[s + ({sub()} & 7)]"
            return f"(sl.atomic_{atomic}({memory}, {sub()} & 63) & 255)"
        if form == 18:
            return f"(sl.atomic_compare_exchange(self.mem[b + ({sub()} & 15)], {sub()}, {sub()} & 63) & 255)"
        if form == 19:
            return f"self.put({sub()}, {sub()})"
        if form == 20:
            return f"self.texel({sub()})"
        if form == 21:
            matrix, vector = f"self.turn({sub()})", f"self.row({sub()})"
            return f"(int(({matrix} @ {vector}).{rng.choice('xy')}) & 255)"
        return f"(int(({self.expression(0)} + 1)) & 255)"

    def read(self, index: str) -> str:
        """Return a read of memory."""
        return self.rng.choice(
            [
                f"self.mem[b + ({index} & 15)]",
                f"self.mem[b + ({index} & 15)]",
                f"self.part[s + ({index} & 7)]",
                f"self.vecs[v + ({index} & 3)].{self.rng.choice('xyzw')}",
                f"self.texels.load(sl.ivec2({index} & 3, i)).x",
            ]
        )

    def condition(self, depth: int, acts: bool = True) -> str:
        form = self.rng.randint(0, 3) if depth > 0 else 0
        if form == 1:
            word = self.rng.choice(["and", "or"])
            return f"({self.condition(depth - 1, acts)} {word} {self.condition(depth - 1, acts)})"
        if form == 2:
            return f"(not {self.condition(depth - 1, acts)})"
        comparison = self.rng.choice(["<", ">", "==", "!=", "<=", ">="])
        return f"({self.expression(depth, acts)} {comparison} {self.expression(depth, acts)})"

    def statements(self, depth: int, count: int) -> list[str]:
        lines: list[str] = []
        for _ in range(count):
            lines += self.statement(depth)
        return lines

    def statement(self, depth: int) -> list[str]:
        rng = self.rng

        def e(acts: bool = True) -> str:
            return self.expression(rng.randint(1, 3), acts)

        form = rng.randint(0, 15 if depth > 0 else 10)
        match form:
            case 0 | 1:
                return [f"{rng.choice('xy')} = {e()}"]
            case 2:
                return [f"x, y = {e()}, {e()}"]
            case 3:
                return [f"self.mem[b + ({e()} & 15)] = {e()}"]
            case 4:
                return [f"self.mem[b + ({e(False)} & 15)] {rng.choice('+-|^')}= {e()}"]
            case 5:
                return [f"self.vecs[v + ({e()} & 3)].xy = sl.ivec2({e()}, {e()})"]
            case 6:
                return [f"self.vecs[v + ({e()} & 3)][{e()} & 3] = {e()}"]
            case 7:
                return [f"self.part[s + ({e(False)} & 7)] {rng.choice(['', '+', '^'])}= {e()}"]
            case 8:
                return [f"self.nothing({e()}, {e()})"]
            case 9:
                return [f"self.texels.store(sl.ivec2({e()} & 3, i), sl.ivec4({e()} & 255, 0, 0, 1))"]
            case 10:
                return [f"self.mem[b + ({e()} & 15)], x = {e()}, {e()}"]
            case 11 | 12:
                lines = [f"if {self.condition(2)}:", *self.inner(depth)]
                lines += [f"elif {self.condition(2)}:", *self.inner(depth)] if rng.randint(0, 1) else []
                return lines + (["else:", *self.inner(depth)] if rng.randint(0, 1) else [])
            case 13 | 14:
                self.loops += 1
                n = f"n{self.loops}"
                test = rng.choice([f"{n} < 3 and {self.condition(2)}", f"{self.condition(2)} and {n} < 3"])
                skip = [f"    if {self.condition(1)}:", f"        {rng.choice(['continue', 'break'])}"]
                return [
                    f"{n} = 0",
                    f"while {test}:",
                    f"    {n} += 1",
                    *(skip if rng.randint(0, 1) else []),
                    *self.inner(depth),
                ]
            case _:
                self.loops += 1
                step = f", ({e()} & 1) + 1" if rng.randint(0, 1) else ""
                return [f"for k{self.loops} in range({e()} & 1, {e()} & 3{step}):", *self.inner(depth)]

    def inner(self, depth: int) -> list[str]:
        return [f"    {line}" for line in self.statements(depth - 1, self.rng.randint(1, 2))]


def random_program(seed: int, count: int) -> str:
    """Return the text of a program of `count` random bodies."""
    generator = Generator(seed)
    bodies = []
    for _ in range(count):
        lines = ["x = 5", "y = i + 3", *generator.statements(2, 3), "r = x * 1000 + y"]
        bodies.append("\n".join(lines))
    return program_of(bodies)
