"""Long and deep shaders: what generators write works, and what can't work is refused at a stated limit."""

import sys

import numpy as np
import pytest

from rhi.contract.descriptors import Stage
from rhi.errors import ShaderError
from rhi.shading import compile_shader, from_source, run_compute
from rhi.shading.ir import tree

HEAD = """
from rhi.shading import *
class Test(Shader):
    work_group = (64,)
    out: StorageRW[float]
"""
BODY = "    def compute(self) -> None:\n        i = global_id().x\n        x = float(i)\n"


def shader(*lines, before="", group=64):
    head = HEAD.replace("(64,)", f"({group},)")
    return from_source(head + before + BODY + "".join(f"        {line}\n" for line in lines))


def store(expression):
    return [f"self.out[i] = {expression}"]


def arms(count, of):
    lines = ["y = 0.0"]
    for k in range(count):
        lines += [f"{'el' * (k > 0)}if i == {k}:", f"    {of(k)}"]
    return [*lines, "else:", "    y = -1.0", "self.out[i] = y"]


# -- flat chains of any length, by all emitters

I = range(128)  # noqa: E741 (the invocations)
EVEN = [f"i {{}} {2 * k}" for k in range(60)]
FLAT = {
    "elif": (arms(60, lambda k: f"y = {k}.5"), [i + 0.5 if i < 60 else -1 for i in I]),
    "or": (
        store(f"1.0 if {' or '.join(EVEN).format(*['=='] * 60)} else 2.0"),
        [1 + (i % 2 or i >= 120) for i in I],
    ),
    "and": (
        store(f"1.0 if {' and '.join(EVEN).format(*['!='] * 60)} else 2.0"),
        [2 - (i % 2 or i >= 120) for i in I],
    ),
    "compare": (
        store("1.0 if i < " + " < ".join(f"i + {k}" for k in range(1, 40)) + " < 160 else 2.0"),
        [1 + (i + 39 >= 160) for i in I],
    ),
    "sum": (store(" + ".join(["x"] * 50) + " - x" * 30), [20 * i for i in I]),
    "sum of products": (store(" + ".join(f"x * {k}.0" for k in range(50))), [1225 * i for i in I]),
    "product": (store("x" + " * 2.0 / 2.0" * 20), list(I)),
    "shifts and bits": (store("float(i" + " ^ 3" * 41 + ")"), [i ^ 3 for i in I]),
    "remainders": (
        store("float(i" + " % 100 + 1" * 20 + ")"),
        [eval("i" + " % 100 + 1" * 20, {"i": i}) for i in I],
    ),
}


@pytest.mark.parametrize("name", FLAT)
def test_a_flat_chain_has_pythons_value_in_every_language(run_everywhere, name):
    lines, expected = FLAT[name]
    assert run_everywhere(shader(*lines), 2, out=128)["out"].tolist() == np.array(expected, "f4").tolist()


LONG = {
    "elif": arms(400, lambda k: f"y = {k}.5"),
    "elif with variables of its branches": arms(100, lambda k: f"z = {k}.5; y = z"),
    "or": store(f"1.0 if {' or '.join(f'i == {2 * k}' for k in range(1000))} else 2.0"),
    "compare": store(f"1.0 if {' < '.join(f'i + {k}' for k in range(300))} else 2.0"),
    "sum": store(" + ".join(f"x * {k}.0" for k in range(1500))),
    "product": store("x" + " * 1.0" * 1500),
    "integers": store("float(i" + " + 1" * 1500 + ")"),
    "constants": store("x * (1.0" + " + 1.0" * 1500 + ")"),
    "statements": [*(f"x{k} = {f'x{k - 1}' if k else 'x'} + 1.0" for k in range(1000)), "self.out[i] = x999"],
}


@pytest.mark.parametrize("name", LONG)
def test_a_long_flat_chain_is_written_in_every_language(name):
    descriptor = compile_shader(shader(*LONG[name]))
    for language in ("glsl", "opencl16", "opencl1"):
        text = descriptor.emit(language, Stage.COMPUTE).text
        depth = deepest = 0
        for letter in text:
            depth += (letter in "([{") - (letter in ")]}")
            deepest = max(depth, deepest)
        assert deepest < 80, language  # clang refuses 256; Mesa computes wrong results beyond 80 branches
    assert descriptor.emit("numpy", Stage.COMPUTE).text


def test_a_long_elif_computes_the_same_as_python(run_everywhere):
    result = run_everywhere(shader(*arms(120, lambda k: f"y = {k}.5")), 2, out=128)["out"]
    assert result.tolist() == [i + 0.5 if i < 120 else -1 for i in I]


def test_variables_that_all_branches_of_a_long_elif_assign_have_a_value():
    lines = arms(40, lambda k: f"z = {k}.5")
    compile_shader(shader(*lines[1:-2], "    z = 1.0", "self.out[i] = z"))
    without = [line.replace("z = 33.5", "y = 33.5") for line in lines[1:-2]]
    with pytest.raises(ShaderError, match=r"^\[shading-unassigned\]"):
        compile_shader(shader(*without, "    z = 1.0", "self.out[i] = z"))


def test_a_long_elif_of_returns_returns_the_same_as_python(run_everywhere):
    text = "".join(f"        if i == {k}:\n            return {k}.5\n" for k in range(100))
    method = f"    def pick(self, i: int) -> float:\n{text}        return -1.0\n"
    result = run_everywhere(shader(*store("self.pick(i)"), before=method), 2, out=128)["out"]
    assert result.tolist() == [i + 0.5 if i < 100 else -1 for i in I]


# -- nesting

NESTED = {
    "calls": (lambda n: store("sin(" * n + "x" + ")" * n), 62),
    "brackets": (lambda n: store("1.0 - (x * " * n + "x" + ")" * n), 61),
    "conditions": (lambda n: store("".join(f"{k}.0 if i == {k} else " for k in range(n)) + "2.0"), 61),
    "not": (lambda n: ["y = " + "not " * n + "(i > 3)", *store("1.0 if y else 2.0")], 61),
    "indices": (lambda n: store("self.out[int(" * n + "0" + ")]" * n), 31),
    "blocks": (
        lambda n: [*("    " * k + f"if i > {k}:" for k in range(n)), "    " * n + "self.out[i] = 2.0"],
        61,
    ),
}


@pytest.mark.parametrize("name", NESTED)
def test_nesting_works_up_to_its_limit_and_is_refused_beyond_it(name):
    lines, most = NESTED[name]
    descriptor = compile_shader(shader(*lines(most)))
    for language in ("glsl", "opencl16", "opencl1", "numpy"):
        assert descriptor.emit(language, Stage.COMPUTE).text
    with pytest.raises(ShaderError, match=r"^\[shading-too-deep\]") as error:
        compile_shader(shader(*lines(most + 1)))
    assert "64" in str(error.value)
    assert error.value.site.file == "<shader>"


def chain_of_functions(count):
    last = "    def f0(self, x: float) -> float:\n        return x + 1.0\n"
    return last + "".join(
        f"    def f{k}(self, x: float) -> float:\n        return self.f{k - 1}(x)\n" for k in range(1, count)
    )


def test_functions_that_call_each_other_work_up_to_the_limit():
    deepest = shader(*store("self.f28(x)"), before=chain_of_functions(29))
    assert run_compute(deepest, 2, out=128)["out"].tolist() == [i + 1 for i in I]
    with pytest.raises(ShaderError, match=r"^\[shading-too-deep\]"):
        compile_shader(shader(*store("self.f399(x)"), before=chain_of_functions(400)))


def test_conditions_at_the_limit_have_pythons_value(run_everywhere):
    lines, most = NESTED["conditions"]
    assert run_everywhere(shader(*lines(most)), 2, out=128)["out"].tolist() == [
        i if i < most else 2 for i in I
    ]


def test_a_shader_within_the_limit_is_refused_where_the_stack_is_deep_already():
    lines, most = NESTED["calls"]
    fine = shader(*lines(most))
    frame, depth = sys._getframe(), 0
    while frame is not None:
        frame, depth = frame.f_back, depth + 1
    before = sys.getrecursionlimit()
    sys.setrecursionlimit(depth + 120)
    try:
        with pytest.raises(ShaderError, match=r"^\[shading-too-deep\]"):
            compile_shader(fine)
    finally:
        sys.setrecursionlimit(before)
    compile_shader(fine)


def test_structs_lie_in_each_other_up_to_a_limit():
    def structs(count):
        text = "from rhi.shading import *\nclass S1(Struct):\n    x: float\n"
        return text + "".join(f"class S{k}(Struct):\n    inner: S{k - 1}\n" for k in range(2, count + 1))

    assert from_source(structs(32), "S32").dtype.itemsize == 4
    with pytest.raises(ShaderError, match=r"^\[shading-too-deep\]"):
        from_source(structs(33), "S33")


def test_structs_have_a_greatest_number_of_fields():
    def structs(doublings):
        text = "from rhi.shading import *\nclass S0(Struct):\n    x: float\n"
        return text + "".join(
            f"class S{k}(Struct):\n    a: S{k - 1}\n    b: S{k - 1}\n" for k in range(1, doublings + 1)
        )

    assert from_source(structs(10), "S10").dtype.itemsize == 4096
    with pytest.raises(ShaderError, match=r"^\[shading-too-deep\]") as error:
        from_source(structs(40), "S40")  # would take 2^40 fields
    assert error.value.given == "2048 fields"


# -- sizes


def test_a_local_array_is_refused_beyond_its_limit():
    lines = ["a[i] = x", *store("a[i + 1]")]
    compile_shader(shader("a = array(float, 4096)", *lines))
    for size in ("4097", "1000000", "2147483647"):
        with pytest.raises(ShaderError, match=r"^\[shading-too-large\]") as error:
            compile_shader(shader(f"a = array(float, {size})", *lines))
        assert error.value.allowed == "up to 4096 numbers for each invocation"
    with pytest.raises(ShaderError, match="4100 numbers"):
        compile_shader(shader("a = array(vec4, 1025)", *store("a[0].x")))


def test_a_local_struct_with_an_array_is_refused_beyond_its_limit():
    struct = "from rhi.shading import *\nclass Big(Struct):\n    a: Array[float] = array(float, {})\n"
    rest = HEAD.replace("out:", "big: Uniform[Big]\n    out:") + BODY
    read, copy = (
        "        self.out[i] = self.big.a[i]\n",
        "        b = self.big\n        self.out[i] = b.a[i]\n",
    )
    compile_shader(from_source(struct.format(4096) + rest + copy))
    compile_shader(from_source(struct.format(5000) + rest + read))
    with pytest.raises(ShaderError, match="b: Big, 5000 numbers"):
        compile_shader(from_source(struct.format(5000) + rest + copy))


def test_the_arrays_of_a_work_group_are_refused_beyond_their_limit():
    def arrays(count, group):
        names = [f"a{k}" for k in range(count)]
        lines = [f"{name} = array(float, 1024)" for name in names] + [
            f"{name}[i % 1024] = x" for name in names
        ]
        return shader(*lines, *store(" + ".join(f"{name}[0]" for name in names)), group=group)

    compile_shader(arrays(1, 1024))
    compile_shader(arrays(16, 64))
    for count, group in ((2, 1024), (17, 64)):
        with pytest.raises(ShaderError, match=r"^\[shading-too-large\]") as error:
            compile_shader(arrays(count, group))
        assert str(2**20) in error.value.allowed


def test_the_arrays_of_every_call_count():
    method = """    def last(self, x: float) -> float:
        a = array(float, 1024)
        a[int(x)] = x
        return a[3]
"""
    compile_shader(shader(*store(" + ".join(["self.last(x)"] * 16)), before=method))
    with pytest.raises(ShaderError, match="17408 numbers"):
        compile_shader(shader(*store(" + ".join(["self.last(x)"] * 17)), before=method))


def test_a_constant_array_is_refused_beyond_its_limit():
    lines = store("TABLE[i]")
    text = "".join([HEAD, BODY, *(f"        {line}\n" for line in lines)])
    compile_shader(from_source(text, scope={"TABLE": (0.5,) * 16384}))
    for table in ((0.5,) * 16385, np.zeros(10**6, "f4")):
        with pytest.raises(ShaderError, match=r"^\[shading-too-large\]") as error:
            compile_shader(from_source(text, scope={"TABLE": table}))
        assert "Storage" in str(error.value)


def test_nodes_are_compared_by_identity_and_can_be_keys():
    """Two reads of one local at one place of the text are two nodes."""
    kinds = [
        node for node in vars(tree).values() if isinstance(node, type) and issubclass(node, tree.Expression)
    ]
    assert len(kinds) > 10
    assert [
        kind.__name__ for kind in kinds if (kind.__eq__, kind.__hash__) != (object.__eq__, object.__hash__)
    ] == []
