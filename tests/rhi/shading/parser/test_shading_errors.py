"""Every rule of the language: a shader that breaks it, and beside it one that doesn't."""

import bisect
import pickle
import textwrap

import pytest

from rhi.errors import RULES, ShaderError, ShaderWarning, ValidationError
from rhi.shading import (
    Shader,
    StorageRW,
    Struct,
    compile_shader,
    from_source,
    function,
    mat3,
    sin,
    uint,
    vec3,
    vec4,
)

PRELUDE = """
from rhi import Format
from rhi.shading import *
WEIGHTS = (1.0, 2.0)
def plain(x: float) -> float:
    return x
@function
def endless(x: float) -> float:
    return endless(x)
class Light(Struct):
    color: vec3
    power: float
class Varying(Struct):
    clip: vec4
    uv: vec2
class Base(Shader):
    lights: Storage[Light]
    out: StorageRW[float]
    counts: StorageRW[int]
    scale: Uniform[float]
    albedo: Texture2D
    shadow: DepthTexture2D
    level = 0.5
    def helper(self, x: float) -> float:
        return x
    def bump(self) -> int:
        return atomic_add(self.counts[0], 1)
"""


def define(source):
    """Return the last shader of a text made of the prelude and the source."""
    return from_source(PRELUDE + textwrap.dedent(source), file="test.py")


def body(*lines):
    """A compute shader with these lines as its body."""
    text = "\n".join("        " + line for line in lines)
    return f"class Test(Base):\n    def compute(self) -> None:\n{text}\n"


# (rule, the lines that break it, the lines that don't, what the message must say)
BODIES = [
    ("unknown-name", ["x = wieght"], ["weight = 1.0", "x = weight"], "'wieght'"),
    ("unknown-name", ["weight = 1.0", "x = wieght"], ["weight = 1.0", "x = weight"], "did you mean 'weight'"),
    ("unknown-name", ["x = smoothstepp(0.0, 1.0, 0.5)"], ["x = smoothstep(0.0, 1.0, 0.5)"], "'smoothstep'"),
    ("unknown-member", ["x = self.lights[0].colour"], ["x = self.lights[0].color"], "did you mean 'color'"),
    ("unknown-member", ["x = vec3(1).w"], ["x = vec3(1).z"], "up to 4 of xyz"),
    ("unknown-member", ["x = vec3(1).xg"], ["x = vec3(1).xy"], "vec3.xg"),
    ("unknown-member", ["x = self.lihgts[0]"], ["x = self.lights[0]"], "did you mean 'lights'"),
    ("unknown-member", ["x = self.hepler(1.0)"], ["x = self.helper(1.0)"], "did you mean 'helper'"),
    ("unknown-member", ["x = self.albedo.smaple(vec2(0))"], ["x = self.albedo.sample(vec2(0))"], "'sample'"),
    (
        "unknown-member",
        ["x = Light(color=vec3(1), powr=1.0)"],
        ["x = Light(color=vec3(1), power=1.0)"],
        "'power'",
    ),
    ("unknown-member", ["x = self.lights.color"], ["x = self.lights[0].color"], "index it first"),
    ("not-shading", ["x = plain(1.0)"], ["x = self.helper(1.0)"], "@function"),
    ("not-shading", ["import_ = print(1)"], ["import_ = 1"], "print"),
    ("not-shading", ["x = plain"], ["x = 1.0"], "plain"),
    ("type", ["x = vec3(1) + vec2(1)"], ["x = vec3(1) + vec3(1)"], "vec3 + vec2"),
    ("type", ["x = 1.0 + True"], ["x = 1.0 + 1"], "float + bool"),
    ("type", ["n = 1", "x = uint(1) + n"], ["n = 1", "x = uint(1) + uint(n)"], "uint(…)"),
    ("type", ["x = ivec2(1) + vec2(1)"], ["x = vec2(ivec2(1)) + vec2(1)"], "ivec2 + vec2"),
    ("type", ["x = vec3(1) < vec3(2)"], ["x = less_than(vec3(1), vec3(2))"], "less_than"),
    ("type", ["x = mat3(1) * vec3(1)"], ["x = mat3(1) @ vec3(1)"], "use @"),
    ("type", ["x = mat4(1) @ vec3(1)"], ["x = mat4(1) @ vec4(vec3(1), 1.0)"], "vec4(v, 1.0)"),
    ("type", ["x = vec3(1) @ vec3(1)"], ["x = dot(vec3(1), vec3(1))"], "dot"),
    ("type", ["if self.scale:", "    pass"], ["if self.scale != 0:", "    pass"], "!= 0"),
    (
        "type",
        ["if equal(vec2(1), vec2(1)):", "    pass"],
        ["if all(equal(vec2(1), vec2(1))):", "    pass"],
        "all",
    ),
    ("type", ["x = 1 if self.scale > 0 else vec2(1)"], ["x = 1 if self.scale > 0 else 2.0"], "vec2"),
    ("type", ["x = self.helper(vec2(1))"], ["x = self.helper(1)"], "x: vec2"),
    ("type", ["x = self.out[0.5]"], ["x = self.out[0]"], "int or uint"),
    ("type", ["x = -True"], ["x = -1"], "neg bool"),
    ("type", ["x = ~1.0"], ["x = ~1"], "~ float"),
    ("type", ["n = 2", "x = 3 ** n"], ["n = 2", "x = 3.0 ** n"], "constant"),
    ("type", ["x = self.albedo"], ["x = self.albedo.load(ivec2(0))"], "in place"),
    ("type", ["self.counts[0] = 1.5"], ["self.counts[0] = int(1.5)"], "int(…)"),
    ("type", ["x = vec2(0)", "x = (1, 2, 3)"], ["x = vec2(0)", "x = (1, 2)"], "3 components"),
    ("arguments", ["x = vec3(1, 2)"], ["x = vec3(1, vec2(2))"], "vec3(int, int)"),
    ("arguments", ["x = sin(vec3(1), 2.0)"], ["x = sin(vec3(1))"], "sin(vec3) -> vec3"),
    ("arguments", ["x = self.helper()"], ["x = self.helper(1.0)"], "no 'x'"),
    ("arguments", ["x = self.helper(1.0, x=2.0)"], ["x = self.helper(x=2.0)"], "twice"),
    ("arguments", ["x = self.helper(1.0, 2.0)"], ["x = self.helper(1.0)"], "2 arguments"),
    ("arguments", ["x = Light(vec3(1), 1.0)"], ["x = Light(power=1.0, color=vec3(1))"], "by name"),
    ("arguments", ["x = Light(color=vec3(1))"], ["x = Light(power=1.0, color=vec3(1))"], "'power'"),
    ("type-changed", ["x = 1.0", "x = vec2(1)"], ["x = 1.0", "x = 2"], "x: vec2"),
    ("type-changed", ["x = 1", "x = 0.5"], ["x = 1", "x = 5"], "x: float"),
    (
        "type-changed",
        ["i = 0.5", "for i in range(3):", "    pass"],
        ["i = 0", "for i in range(3):", "    pass"],
        "i: int",
    ),
    ("unassigned", ["y = x", "x = 1"], ["x = 1", "y = x"], "'x'"),
    (
        "unassigned",
        ["if self.scale > 0:", "    x = 1", "y = x"],
        ["x = 0", "if self.scale > 0:", "    x = 1", "y = x"],
        "'x'",
    ),
    (
        "unassigned",
        ["for i in range(3):", "    x = i", "y = x"],
        ["x = 0", "for i in range(3):", "    x = i", "y = x"],
        "'x'",
    ),
    (
        "unassigned",
        ["for i in range(3):", "    pass", "y = i"],
        ["i = 0", "for i in range(3):", "    pass", "y = i"],
        "'i'",
    ),
    (
        "unassigned",
        ["while self.scale > 0:", "    x = 1", "y = x"],
        ["while True:", "    x = 1", "    break", "y = x"],
        "'x'",
    ),
    (
        "not-writable",
        ["self.lights[0].power = 1.0"],
        ["light = self.lights[0]", "light.power = 1.0"],
        "StorageRW[Light]",
    ),
    ("not-writable", ["self.scale = 1.0"], ["self.out[0] = 1.0"], "uniform"),
    ("not-writable", ["v = vec2(1)", "v.xx = vec2(1)"], ["v = vec2(1)", "v.xy = vec2(1)"], "twice"),
    ("not-writable", ["m = mat2(1)", "m[0] = vec2(1)"], ["m = mat2(1)", "m[0][1] = 1.0"], "m[row][column]"),
    ("not-writable", ["vec2(1).x = 1.0"], ["v = vec2(1)", "v.x = 1.0"], "temporary value"),
    (
        "not-writable",
        ["n = 0", "x = atomic_add(n, 1)"],
        ["x = atomic_add(self.counts[0], 1)"],
        "shared memory",
    ),
    ("recursion", ["x = endless(1.0)"], ["x = self.helper(1.0)"], "endless"),
    ("out-of-range", ["x = vec3(1)[3]"], ["x = vec3(1)[-3]"], "-3 to 2"),
    ("out-of-range", ["x = vec3(1)[-4]"], ["x = vec3(1)[2]"], "-3 to 2"),
    ("out-of-range", ["x = self.out[-1]"], ["x = self.out[len(self.out) - 1]"], "len"),
    (
        "out-of-range",
        ["n = 1 + len(self.out)", "x = n // 0"],
        ["n = 1 + len(self.out)", "x = n // 1"],
        "zero",
    ),
    ("out-of-range", ["x = 1 // 0"], ["x = 1 // 1"], "zero"),
    ("out-of-range", ["n = len(self.out)", "n %= 0"], ["n = len(self.out)", "n %= 5"], "zero"),
    ("out-of-range", ["x = ivec2(self.counts[0]) // 0"], ["x = ivec2(self.counts[0]) // 2"], "zero"),
    ("out-of-range", ["x = uint(self.counts[0]) % 0"], ["x = uint(self.counts[0]) % 3"], "zero"),
    (
        "out-of-range",
        ["for i in range(0, 4, 0):", "    pass"],
        ["for i in range(0, 4, 2):", "    pass"],
        "step",
    ),
    ("out-of-range", ["x = 4294967296"], ["x = uint(4294967295)"], "32 bits"),
    ("out-of-range", ["x = 2147483648"], ["x = 2147483647"], "uint(…)"),
    ("out-of-range", ["x = array(float, 0)"], ["x = array(float, 1)"], "1 or more"),
    (
        "out-of-range",
        ["x = self.albedo.gather(vec2(0), 4)"],
        ["x = self.albedo.gather(vec2(0), 3)"],
        "0 to 3",
    ),
    ("out-of-range", ["x = self.scale / 0.0"], ["x = self.scale / 0.5"], "division by zero"),
    ("out-of-range", ["x = self.scale / 0"], ["x = self.scale / 1"], "division by zero"),
    ("out-of-range", ["x = (-8.0) ** 0.5"], ["x = (-8.0) ** 3.0"], "a negative number to a fractional power"),
    ("out-of-range", ["x = vec4(self.scale) / 0.0"], ["x = vec4(self.scale) / 2.0"], "division by zero"),
    ("out-of-range", ["x = vec4(1.0) / 0.0"], ["x = vec4(1.0) / 2.0"], "division by zero"),
    ("out-of-range", ["x = 1.0 / vec2(1, 0)"], ["x = 1.0 / vec2(1, 2)"], "division by zero"),
    ("out-of-range", ["x = vec2(2) / vec2(0)"], ["x = vec2(0) / vec2(2)"], "division by zero"),
    ("out-of-range", ["x = vec2(2)", "x /= 0.0"], ["x = vec2(2)", "x /= 2.0"], "division by zero"),
    ("out-of-range", ["x = mat2(2) / 0.0"], ["x = mat2(2) / 1.0"], "division by zero"),
    ("out-of-range", ["x = self.scale // 0.0"], ["x = self.scale // 1.0"], "division by zero"),
    ("out-of-range", ["x = self.scale % 0.0"], ["x = self.scale % 1.0"], "division by zero"),
    ("out-of-range", ["x = ivec2(3) // ivec2(1, 0)"], ["x = ivec2(3) // ivec2(1, 1)"], "integer division"),
    ("out-of-range", ["x = ivec2(3) % 0"], ["x = ivec2(3) % 2"], "integer division"),
    ("out-of-range", ["x = vec2(0.0, 1.0) ** -1"], ["x = vec2(2.0, 1.0) ** -1"], "negative power"),
    ("out-of-range", ["x = self.counts[0] << 32"], ["x = self.counts[0] << 31"], "a shift by 32"),
    ("out-of-range", ["x = self.counts[0] >> -1"], ["x = self.counts[0] >> 0"], "a shift by -1"),
    ("too-large", ["x = array(float, 4097)"], ["x = array(float, 4096)"], "4097 numbers"),
    (
        "too-deep",
        ["x = " + "sin(" * 65 + "1.0" + ")" * 65],
        ["x = " + "sin(" * 60 + "1.0" + ")" * 60],
        "more than 64 levels",
    ),
    ("evaluated-twice", ["b = 0 < self.bump() < 4"], ["n = self.bump()", "b = 0 < n < 4"], ""),
    ("evaluated-twice", ["self.out[self.bump()] += 1.0"], ["n = self.bump()", "self.out[n] += 1.0"], ""),
    ("stage", ["x = ddx(1.0)"], ["x = sin(1.0)"], "ddx in the compute stage"),
    ("stage", ["x = vertex_index()"], ["x = local_index()"], "vertex"),
    ("unsupported", ["with self.scale:", "    pass"], ["pass"], "`with`"),
    ("unsupported", ["try:", "    pass", "finally:", "    pass"], ["pass"], "no exceptions"),
    ("unsupported", ["x = [1, 2]"], ["x = array(int, 2)"], "List"),
    ("unsupported", ["x = [1, 2]"], ["x = array(int, 2)"], "array(float, 4)"),
    ("unsupported", ["x = lambda: 1"], ["x = 1"], "Lambda"),
    ("unsupported", ["x = 'text'"], ["'''a docstring'''"], "str"),
    ("unsupported", ["x, y = vec2(1.0)"], ["x, y = 1, 2", "x, y = y, x + y"], "assignment for each"),
    ("unsupported", ["x = y = 1"], ["x = 1", "y = x"], "one target"),
    (
        "unsupported",
        ["for w in WEIGHTS:", "    pass"],
        ["for i in range(len(WEIGHTS)):", "    w = WEIGHTS[i]"],
        "range(len",
    ),
    (
        "unsupported",
        ["for i in range(3):", "    pass", "else:", "    pass"],
        ["for i in range(3):", "    pass"],
        "else",
    ),
    ("unsupported", ["x = self.out[1:2]"], ["x = self.out[1]"], "slice"),
    ("unsupported", ["x = mat2(1)[0, 1]"], ["x = mat2(1)[0][1]"], "m[row][column]"),
    ("unsupported", ["sin(1.0)"], ["self.bump()"], "unused"),
    ("unsupported", ["x = 1 in WEIGHTS"], ["x = 1 == 2"], "=="),
    ("unsupported", ["x = range(3)"], ["for x in range(3):", "    pass"], "for loop"),
    ("unsupported", ["def inner() -> None:", "    pass"], ["pass"], "@function"),
]


@pytest.mark.parametrize(
    ("rule", "bad", "good", "says"), BODIES, ids=[f"{b[0]}: {'; '.join(b[1])}" for b in BODIES]
)
def test_a_body_that_breaks_a_rule_is_refused_and_its_neighbour_is_not(rule, bad, good, says):
    with pytest.raises(ShaderError, match=rf"^\[shading-{rule}\]") as error:
        compile_shader(define(body(*bad)))
    assert says in str(error.value)
    assert "^" in str(error.value)
    assert str(error.value.site) in str(error.value)
    compile_shader(define(body(*good)))


GRAPHICS = """
class Test(Shader):
    def vertex(self) -> Varying:
        return Varying(clip=vec4(0), uv=vec2(0))
    def fragment(self, v: Varying) -> vec4:
        return vec4(v.uv, 0, 1)
"""
COMPUTE = """
class Test(Shader):
    out: StorageRW[float]
    def compute(self) -> None:
        self.out[0] = 1.0
"""
VARIANT = """
class Test(Base):
    spare: Uniform[float]
    def compute(self) -> None:
        if self.level > 9.0:
            self.out[0] = self.spare
        self.out[0] = self.scale
"""
# (rule, a shader, what to replace in it, by what, what the message must say)
DIVERGENT = """
class Test(Shader):
    work_group = (32,)
    out: StorageRW[float]
    def compute(self) -> None:
        i = local_index()
        if group_id().x > 0:
            barrier()
        self.out[i] = float(i)
        if i > 3:
            return
        self.out[i] = 0.0
"""
CLASSES = [
    ("unused-binding", VARIANT, "= self.spare", "= 2.0", "spare: Uniform[float]"),
    ("unused-binding", COMPUTE, "    def", "    memory = shared(float, 4)\n    def", "memory is never used"),
    ("shadowed-binding", VARIANT, "    def", "    scale: Uniform[int]\n    def", "float, as in the base"),
    ("shadowed-binding", VARIANT, "    def", "    scale = 3\n    def", "scale = 3"),
    (
        "shadowed-binding",
        VARIANT,
        "    def",
        "    def scale(self) -> float:\n        return 1.0\n    def",
        "scale",
    ),
    ("barrier", DIVERGENT, "group_id().x > 0", "i > 0", "part of a work-group"),
    ("barrier", DIVERGENT, "if group_id().x > 0:", "for _k in range(i):", "part of a work-group"),
    ("barrier", DIVERGENT, "self.out[i] = 0.0", "barrier()", "part of a work-group"),
    ("race", DIVERGENT, "self.out[i] = float(i)", "self.out[3] = float(i)", "one element of out"),
    ("annotation", COMPUTE, "-> None:", ":", "-> None"),
    ("annotation", GRAPHICS, "v: Varying)", "v)", "a type for 'v'"),
    ("annotation", GRAPHICS, "v: Varying)", "v: str)", "str"),
    ("unknown-name", GRAPHICS, "v: Varying)", "v: 'Varyin')", "did you mean 'Varying'"),
    ("missing-return", GRAPHICS, "return vec4(v.uv, 0, 1)", "x = v.uv", "vec4"),
    (
        "missing-return",
        GRAPHICS,
        "        return vec4(v.uv",
        "        if v.uv.x > 0:\n            return vec4(v.uv",
        "end",
    ),
    ("type", GRAPHICS, "return vec4(v.uv, 0, 1)", "return v.uv", "vec2"),
    ("type", COMPUTE, "self.out[0] = 1.0", "return 1.0", "no value"),
    ("stages", COMPUTE, "def compute", "def computer", "no stage"),
    ("stages", GRAPHICS, "def vertex", "def vortex", "fragment"),
    (
        "stages",
        COMPUTE,
        "    def compute",
        "    def vertex(self) -> vec4:\n        return vec4(0)\n    def compute",
        "vertex",
    ),
    ("stages", GRAPHICS, "v: Varying)", "v: Light)", "Light.color: vec3"),
    (
        "interface",
        GRAPHICS,
        "def vertex(self) -> Varying:\n        return Varying(clip=vec4(0), uv=vec2(0))",
        "def vertex(self) -> Light:\n        return Light(color=vec3(1), power=1.0)",
        "color: vec3 first",
    ),
    ("interface", COMPUTE, "(self)", "(self, x: float)", "compute(self)"),
    ("interface", GRAPHICS, "vertex(self)", "vertex(self, x: float)", "structs of attributes"),
    ("interface", GRAPHICS, "v: Varying)", "v: Varying, w: Varying)", "at most one"),
    (
        "interface",
        GRAPHICS,
        "-> vec4:\n        return vec4(v.uv, 0, 1)",
        "-> mat2:\n        return mat2(1)",
        "mat2",
    ),
    ("binding", COMPUTE, "StorageRW[float]", "StorageRW[bool]", "uint"),
    ("binding", COMPUTE, "StorageRW[float]", "float", "Uniform[T]"),
    ("binding", COMPUTE, "StorageRW[float]", "float", "`out: Uniform[float]`"),
    ("binding", COMPUTE, "StorageRW[float]", "'StorageRV[float]'", "did you mean 'StorageRW'"),
    ("binding", COMPUTE, "    out:", "    work_group: Uniform[int]\n    out:", "another name"),
    ("binding", COMPUTE, "    out:", "    target: Image2D\n    out:", "image(Format"),
    ("binding", COMPUTE, "    out:", "    target: Image2D = image(Format.R32UI)\n    out:", "R32UI"),
    ("binding", COMPUTE, "    out:", "    memory = shared(float, 0)\n    out:", "length"),
    ("out-of-range", COMPUTE, "    out:", "    work_group = (64, 64)\n    out:", "1024"),
    ("out-of-range", COMPUTE, "    out:", "    work_group = (0,)\n    out:", "positive"),
    ("out-of-range", COMPUTE, "    out:", "    work_group = 5\n    out:", "positive"),
    ("out-of-range", COMPUTE, "    out:", "    work_group = None\n    out:", "positive"),
    ("out-of-range", COMPUTE, "    out:", "    work_group = 'x'\n    out:", "positive"),
    ("out-of-range", COMPUTE, "    out:", "    work_group = (True,)\n    out:", "positive"),
    ("struct", COMPUTE, "class Test", "class S(Struct):\n    x: str\nclass Test", "str"),
    ("struct", COMPUTE, "class Test", "class S(Struct):\n    x: 'vec5'\nclass Test", "did you mean"),
    ("struct", COMPUTE, "class Test", "class S(Struct):\n    dtype: float\nclass Test", "another name"),
    ("struct", COMPUTE, "class Test", "class S(Struct):\n    x: Array[float]\nclass Test", "array(float, 4)"),
]


@pytest.mark.parametrize(
    ("rule", "shader", "old", "new", "says"), CLASSES, ids=[f"{c[0]}: {c[3]}" for c in CLASSES]
)
def test_a_class_that_breaks_a_rule_is_refused_and_the_original_is_not(rule, shader, old, new, says):
    assert old in shader
    with pytest.raises(ShaderError, match=rf"^\[shading-{rule}\]") as error:
        compile_shader(define(shader.replace(old, new)), strict=True)
    assert says in str(error.value)
    compile_shader(define(shader), strict=True)


def test_all_faults_of_a_shader_are_a_single_error():
    """A helper for each faulty body, called from one stage, with bodies that are right between them."""
    bodies = [lines for _, bad, good, _ in BODIES for lines in (bad, good)]
    text, calls, first = ["class Test(Base):"], [], []
    for number, lines in enumerate(bodies):
        first.append(PRELUDE.count("\n") + len(text) + 1)
        text += [f"    def part_{number}(self) -> None:", *(f"        {line}" for line in lines)]
        calls.append(f"        self.part_{number}()")
    text += ["    def compute(self) -> None:", *calls]
    with pytest.raises(ShaderError) as caught:
        compile_shader(define("\n".join(text)))
    reported = {}
    for error in (caught.value, *caught.value.others):
        part = bisect.bisect(first, error.site.line) - 1
        reported.setdefault(part, []).append(error.rule.id.removeprefix("shading-"))
    assert reported.pop(-1) == ["recursion"]  # in the prelude's `endless`
    expected = {2 * number: rule for number, (rule, *_) in enumerate(BODIES)}
    missing = [bodies[part] for part, rule in expected.items() if rule not in reported.get(part, ())]
    assert missing == [
        ["x = endless(1.0)"],
        ["x = 2147483648"],
    ]  # the second only shows in a tree without other errors
    assert reported.keys() < expected.keys(), "bodies that are right are said to be wrong"


def test_consequences_of_an_error_are_not_reported():
    lines = (
        "a = wieght",
        "b = a.x + 1.0",
        "if a > 1.0:",
        "    c = 2.0",
        "else:",
        "    c = 3.0",
        "for i in range(b):",
        "    c = c + lost",
        "d = a",
        "d = 1",
        "d = vec2(c, d)",
        "self.out[0] = d",
    )
    with pytest.raises(ShaderError) as caught:
        compile_shader(define(body(*lines)))
    errors = [
        (error.site.line - PRELUDE.count("\n") - 2, error.given)
        for error in (caught.value, *caught.value.others)
    ]
    assert errors == [(1, "'wieght'"), (8, "'lost'"), (11, "d: vec2")]
    text, copy = str(caught.value), pickle.loads(pickle.dumps(caught.value))
    assert str(copy) == text
    assert all(f"{error.site}" in text for error in caught.value.others)


def test_more_errors_than_are_shown_are_counted():
    for count, rest in ((10, ""), (11, "and 1 more errors"), (13, "and 3 more errors")):
        with pytest.raises(ShaderError) as caught:
            compile_shader(define(body(*(f"x{number} = lost{number}" for number in range(count)))))
        assert len(caught.value.others) == count - 1
        assert str(caught.value).count("[shading-unknown-name]") == 10
        assert str(caught.value).endswith(rest)


def test_both_stages_their_interface_and_a_shared_function_are_checked():
    shader = (
        GRAPHICS.replace("vec4(0)", "lost")
        .replace("v.uv, 0", "v.lost, wieght")
        .replace("v: V", "v: int, w: V")
    )
    with pytest.raises(ShaderError) as caught:
        compile_shader(define(shader))
    errors = [(error.rule.id, error.call.split("\n")[0]) for error in (caught.value, *caught.value.others)]
    assert errors == [
        ("shading-interface", "Test.fragment"),
        ("shading-unknown-name", "Test.vertex"),
        ("shading-unknown-member", "Test.fragment"),
    ]


def test_all_wrong_bindings_are_a_single_error():
    with pytest.raises(ShaderError) as caught:
        define("class Test(Base):\n    a: Uniform[str]\n    b: Uniform[float]\n    c: int\n")
    assert [error.call for error in (caught.value, *caught.value.others)] == [
        "class Test: a",
        "class Test: c",
    ]


def test_an_unused_binding_is_a_warning_once():
    shader = define(VARIANT.replace("= self.spare", "= 2.0"))
    with pytest.warns(ShaderWarning, match="spare is never used") as caught:
        program = compile_shader(shader)
    assert [warning.lineno for warning in caught] == [PRELUDE.count("\n") + 3]
    assert compile_shader(shader) is program
    assert "spare" in [binding.name for binding in program.bindings]
    with pytest.raises(ShaderError, match="spare is never used"):
        compile_shader(shader, strict=True)


def test_an_error_names_file_line_and_column_and_points_at_the_word():
    with pytest.raises(ShaderError) as error:
        compile_shader(define(body("x = 1.0", "y = x * wieght")))
    line = PRELUDE.count("\n") + 4
    text = str(error.value)
    assert error.value.site.line == line
    assert error.value.site.file.endswith(".py")
    assert f"{error.value.site.file}:{line}:17\n" in text
    lines = text.splitlines()
    at = next(i for i, row in enumerate(lines) if row.strip() == "y = x * wieght")
    assert lines[at + 1].index("^") == lines[at].index("wieght")
    assert lines[at + 1].count("^") == len("wieght")


def test_a_traceback_is_not_filled_with_the_compiler():
    with pytest.raises(ShaderError) as error:
        compile_shader(define(body("x = wieght")))
    assert len(error.traceback) <= 2  # this line, and the function it calls


def test_a_caret_counts_characters_and_not_bytes():
    with pytest.raises(ShaderError) as error:
        compile_shader(define(body("größe = 1.0", "y = größe + nnn")))
    lines = str(error.value).splitlines()
    at = next(i for i, row in enumerate(lines) if row.strip() == "y = größe + nnn")
    assert lines[at + 1].index("^") == lines[at].index("nnn")


@pytest.mark.parametrize(
    ("name", "source"),
    [
        ("uint", body("x = uint(self.counts[0])")),
        ("dot", body("x = dot(vec2(1), vec2(1))")),
        ("vec4", "class Test(Shader):\n    def vertex(self) -> 'vec4':\n        return 0\n"),
        ("uint", "class Test(Struct):\n    x: 'uint'\n"),
        ("Uniform", "class Test(Base):\n    x: 'Uniform[float]'\n"),
    ],
    ids=["a type", "a function", "an annotation", "a field", "a binding"],
)
def test_a_name_of_the_language_that_is_not_imported_is_to_be_imported(name, source):
    with pytest.raises(ShaderError) as caught:
        compile_shader(define(f"del {name}\n{source}"))
    assert caught.value.tip == f"import it: from rhi.shading import {name}"


def test_a_struct_value_must_fit_its_fields():
    class Pose(Struct):
        turn: mat3
        at: vec3
        count: uint

    good = {"turn": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "at": (1, 2, 3), "count": 3}
    Pose(**good)
    for name, value in (
        ("turn", 1.0),
        ("at", (1, 2)),
        ("at", "abc"),
        ("count", -1),
        ("count", 1.5),
        ("count", 2**32),
        ("at", (0, 0, 1e39)),
        ("att", 1),
    ):
        with pytest.raises(ValidationError, match=r"^\[shading-struct-value\]") as error:
            Pose(**{**good, name: value})
        assert name in str(error.value)
    with pytest.raises(ValidationError, match="no count"):
        Pose(turn=good["turn"], at=good["at"])


def test_a_refused_field_leaves_the_value_as_it_was():
    class Spot(Struct):
        at: vec3

    spot = Spot(at=(1, 2, 3))
    with pytest.raises(ValidationError):
        spot.at = (1, 2)
    assert spot == Spot(at=(1, 2, 3))


def test_shading_functions_and_shaders_do_not_run_on_the_cpu():
    @function
    def f(x: float) -> float:
        return x

    for call in (lambda: f(1.0), lambda: sin(1.0), lambda: Shader()):
        with pytest.raises(ValidationError, match=r"^\[shading-device-only\]"):
            call()


def test_a_shader_without_source_is_refused():
    space = {"Shader": Shader, "StorageRW": StorageRW, "vec4": vec4, "vec3": vec3, "__name__": __name__}
    exec("class Hidden(Shader):\n    def vertex(self) -> vec4:\n        return vec4(0)\n", space)
    with pytest.raises(ShaderError, match=r"^\[shading-no-source\]"):
        compile_shader(space["Hidden"])


TESTED_ELSEWHERE = {
    "shading-vector-value",  # test_hostile_values.py
    *("shading-text", "shading-spirv", "shading-language"),
    *("shading-no-source", "shading-native", "shading-struct-value", "shading-device-only"),
    *("shading-index", "shading-nonuniform", "shading-endless"),  # checked shaders
    "shading-reload",
}


def test_every_rule_of_the_language_has_a_failing_case():
    tested = {f"shading-{case[0]}" for case in (*BODIES, *CLASSES)} | TESTED_ELSEWHERE
    assert {id for id in RULES if id.startswith("shading-")} == tested
