"""Generated programs: GLSL and one lane have real branches, 16 lanes and NumPy have masks; all must agree.

Numbers are ints, so that agreement is equality. Programs nest loops with varying bounds, breaks, continues
and early returns, write local arrays at varying places, store where a mask says so, and add atomically.
"""

import itertools

import numpy as np
import pytest
from hypothesis import Phase, given, seed, settings
from hypothesis import strategies as st
from opencl_runner import built_together, run_opencl

from rhi.shading import from_source, run_compute

N = 64
HEADER = """from rhi.shading import *

class Buffers(Shader):
    given: Storage[int]
    out: StorageRW[int]
    sums: StorageRW[int]

class Test(Buffers):
    work_group = (32,)

    def helper(self, x: int, y: int) -> int:
{helper}
        return x

    def compute(self) -> None:
        i = global_id().x
        x = self.given[i]
        y = i % 7
        z = 1
        table = array(int, 4)
{body}
        self.out[i] = x * 31 + y * 7 + z + table[1] + table[3]
"""
NAMES = ("x", "y", "z")
SCALES = ("0.25", "67108864.0", "1e30")
numbers = itertools.count()


def masks(count):
    """Masks that keep an index within `count` elements, or none."""
    return st.sampled_from([f" & {count - 1}", " | x - x"])  # no constant: one outside would be refused


@st.composite
def expressions(draw, depth=2, names=NAMES, calls=True):
    """An int expression; whatever operands and indices are, the result is defined (docs/shading.md)."""
    if depth == 0 or draw(st.integers(0, 3)) == 0:
        return draw(st.one_of(st.sampled_from(names), st.integers(-9, 9).map(str)))
    left = draw(expressions(depth - 1, names, calls))
    right = draw(expressions(depth - 1, names, calls))
    form = draw(st.integers(0, 9 if calls else 6))
    if form < 3:
        return f"({left} {draw(st.sampled_from('+-*&|^'))} {right})"
    if form == 3:
        divisor = right if draw(st.booleans()) else draw(st.sampled_from([-7, -2, 3, 4, 5]))
        return f"({left} {draw(st.sampled_from(['//', '%']))} ({divisor} | x - x))"  # no constant: 0 would be refused
    if form == 4:
        return f"({left} if {draw(conditions(depth - 1, names, calls))} else {right})"
    if form == 5:
        return (
            f"min({left}, {right})"
            if draw(st.booleans())
            else f"int(float(({left}) | x - x) * {draw(st.sampled_from(SCALES))})"
        )
    if form == 6:
        return f"({left} {draw(st.sampled_from(['>>', '<<']))} ({right} | x - x))"
    if form == 7:
        return f"self.given[({left}){draw(masks(N))}]"
    if form == 8:
        return f"table[({left}){draw(masks(4))}]"
    return f"self.helper({left}, {right})"


@st.composite
def conditions(draw, depth=1, names=NAMES, calls=True):
    left, right = draw(expressions(depth, names, calls)), draw(expressions(max(depth - 1, 0), names, calls))
    comparison = f"{left} {draw(st.sampled_from(['<', '>', '==', '!=', '<=']))} {right}"
    if depth > 0 and draw(st.integers(0, 2)) == 0:
        other = draw(conditions(depth - 1, names, calls))
        return f"({comparison} {draw(st.sampled_from(['and', 'or']))} {other})"
    return comparison


@st.composite
def blocks(draw, depth=3, in_loop=False, result="", names=NAMES, discards=False):
    """Draw the lines of a block. `result` is the expression that `return` returns, if the function has a
    result."""
    is_helper = names != NAMES
    lines = []
    for _ in range(draw(st.integers(1, 3))):
        kind = draw(st.integers(0, 11))
        expression = draw(expressions(2, names, not is_helper))
        if kind < 4 or depth == 0:
            lines.append(f"{draw(st.sampled_from(names))} = {expression}")
        elif kind == 4 and not is_helper:
            lines.append(f"table[({expression}){draw(masks(4))}] = {draw(st.sampled_from(names))}")
        elif kind == 5 and not is_helper:
            lines.append(
                draw(
                    st.sampled_from(
                        [
                            f"atomic_add(self.sums[({expression}) & 7], x & 255)",
                            # sums 8 and 9 have operations of their own
                            f"atomic_add(self.sums[min({expression}, 7)], x & 255)",
                            f"x += atomic_add(self.sums[max({expression}, 16)], 1)",  # outside, so 0
                            "atomic_add(self.sums[8], 1)",
                            f"atomic_max(self.sums[9], {expression})",
                        ]
                    )
                )
            )
        elif kind == 6 and in_loop:
            word = draw(st.sampled_from(["break", "continue"]))
            lines += [f"if {draw(conditions(1, names, not is_helper))}:", f"    {word}"]
        elif kind == 7:
            lines += [f"if {draw(conditions(1, names, not is_helper))}:"]
            lines += ["    self.out[i] = " + draw(st.sampled_from(names))] if not is_helper else []
            lines += (
                ["    discard()"] if discards and draw(st.booleans()) else [f"    return {result}".rstrip()]
            )
        elif kind in (8, 9):
            inner = draw(blocks(depth - 1, in_loop, result, names, discards))
            lines += [f"if {draw(conditions(1, names, not is_helper))}:", *indent(inner)]
            if draw(st.integers(0, 3)):
                lines += ["else:", *indent(draw(blocks(depth - 1, in_loop, result, names, discards)))]
        elif kind == 10:
            counter = f"k{next(numbers)}"
            bound = f"({expression}) & 3" if draw(st.booleans()) else str(draw(st.integers(0, 4)))
            inner = draw(blocks(depth - 1, True, result, names, discards))
            lines += [f"for {counter} in range({bound}):", f"    x += {counter}", *indent(inner)]
        else:
            counter = f"n{next(numbers)}"
            inner = draw(blocks(depth - 1, True, result, names, discards))
            condition = draw(conditions(1, names, not is_helper))
            lines += [f"{counter} = 0", f"while {counter} < 4 and {condition}:", f"    {counter} += 1"]
            lines += indent(inner)
    return lines


def indent(lines):
    return ["    " + line for line in lines]


@st.composite
def programs(draw):
    def text(block):
        return "\n".join("        " + line for line in block)

    helper = draw(blocks(2, result="y", names=("x", "y")))
    return HEADER.format(helper=text(helper), body=text(draw(blocks())))


def check_shader(shader, source, run):
    given_values = (np.arange(N, dtype="i4") * 37) % 23 - 8
    values = {"given": given_values, "out": N, "sums": 16}
    expected = run(shader, N // 32, **values)
    others = {
        "one lane": run_opencl(shader, 1, N // 32, **values),
        "16 lanes": run_opencl(shader, 16, N // 32, **values),
        "NumPy": run_compute(shader, N // 32, **values),
    }
    for language, results in others.items():
        for name in ("out", "sums"):
            np.testing.assert_array_equal(results[name], expected[name], f"{language}: {name}\n{source}")


def program_settings(count):
    return settings(
        max_examples=count,
        phases=[Phase.generate],  # a failure prints its program; shrinking builds hundreds of kernels
        report_multiple_bugs=False,
        database=None,
    )


def check_together(sources, run):
    """Check programs whose kernels are built as one OpenCL program per width."""
    shaders = {source: from_source(source) for source in sources}
    with built_together(shaders.values(), 1), built_together(shaders.values(), 16):
        for source, shader in shaders.items():
            check_shader(shader, source, run)


def test_programs_mean_the_same_in_every_language(run):
    sources = []

    @program_settings(12)
    @given(source=programs())
    def make(source):
        sources.append(source)

    make()
    check_together(sources, run)


@pytest.mark.parametrize(
    ("helper", "body"),
    [
        pytest.param(
            "return 1 if y + x < y else 0",
            "z = self.helper(min(-5, x << 28), min(-5, self.given[0] << 28))",
            id="ints wrap",
        ),
        pytest.param("return 1 if -x < 1 else 0", "z = self.helper(min(-5, x << 28), y)", id="negated"),
        pytest.param(
            "if x < y:\n            return y\n        return x",
            "while z < 4 and x < 9:\n            z += 1\n            x += "
            "atomic_add(self.sums[self.helper(64, 9)], 1)",
            id="a function with an early return, in a loop that lanes leave one by one",
        ),
    ],
)
def test_a_program_that_once_differed_means_the_same_in_every_language(helper, body, run):
    source = HEADER.format(helper=f"        {helper}", body=f"        {body}")
    assert helper in source
    check_shader(from_source(source), source, run)


@pytest.mark.nightly
@pytest.mark.parametrize("piece", range(20))
def test_two_thousand_programs_mean_the_same_in_every_language(piece, run):
    """A hundred programs for each seed; `-k "[7]"` repeats one seed."""

    sources = []

    @seed(piece)
    @settings(program_settings(100), derandomize=False)
    @given(source=programs())
    def make(source):
        sources.append(source)

    make()
    check_together(sources, run)
