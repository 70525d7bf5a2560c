"""When compute stages are lowered: for a language that needs lane code, or to check a doubtful barrier or
store.

Every device must refuse the same shaders. So whatever lowering would refuse counts as doubtful; random stages
show it.
"""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given, reject
from hypothesis import strategies as st

import rhi
import rhi.shading as sl
from rhi.contract.descriptors import Stage
from rhi.errors import Rule, ShaderError
from rhi.shading import compile as compiler
from rhi.shading import from_source
from rhi.shading.compile import compile_shader, stage_trees
from rhi.shading.language import rules
from rhi.shading.lowering import functions
from rhi.shading.parser.group_rules import may_break_group_rules

pytestmark = pytest.mark.filterwarnings(
    "ignore::rhi.errors.ShaderWarning"
)  # most stages leave bindings unused


@pytest.fixture
def lowered_widths(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The widths that compute stages were lowered for during the test."""
    widths: list[int] = []
    lower = functions.lower_compute

    def count(stage: Any, name: str, work_group: Any, width: int, checked: bool = False) -> Any:
        widths.append(width)
        return lower(stage, name, work_group, width, checked)

    monkeypatch.setattr(functions, "lower_compute", count)
    return widths


class Doubling(sl.Shader):
    work_group = (64,)
    values: sl.Storage[float]
    out: sl.StorageRW[float]

    def compute(self) -> None:
        i = sl.global_id().x
        if i < len(self.values):
            self.out[i] = self.values[i] * 2.0


class DoublingOnGl(Doubling):
    """A class of its own: texts of classes are kept."""


class GroupSums(sl.Shader):
    work_group = (64,)
    values: sl.Storage[float]
    out: sl.StorageRW[float]
    shared = sl.shared(float, 64)

    def compute(self) -> None:
        lane = sl.local_index()
        self.shared[lane] = self.values[sl.global_id().x]
        for step in range(6):
            sl.barrier()
            if lane % (2 << step) == 0:
                self.shared[lane] += self.shared[lane + (1 << step)]
        if lane == 0:
            self.out[sl.group_id().x] = self.shared[0]


def test_only_languages_of_lanes_lower_a_compute_stage(lowered_widths: list[int]) -> None:
    program = compile_shader(Doubling)
    for language in ("glsl", "vulkan", "wgsl"):
        program.emit(language, Stage.COMPUTE)
    assert lowered_widths == []
    program.emit("opencl16", Stage.COMPUTE)
    assert lowered_widths == [16]
    program.emit("numpy", Stage.COMPUTE)
    assert lowered_widths == [16, 0]


def test_a_program_of_gl_is_never_lowered(lowered_widths: list[int]) -> None:
    if "gl" not in [backend.name for backend in rhi.report() if backend.usable]:
        pytest.skip("gl doesn't work here")
    with rhi.create_device("gl") as device:
        program: Any = device.program(DoublingOnGl)
        out = device.storage(float, 64)
        device.dispatch(program, 1, values=device.storage(float, [1.5] * 64), out=out)
        assert (out.read() == 3.0).all()
    assert lowered_widths == []


def test_a_barrier_in_a_loop_that_the_group_shares_isnt_doubtful(lowered_widths: list[int]) -> None:
    compile_shader(GroupSums)
    assert lowered_widths == []


HEAD = """
from rhi.shading import *

class Test(Shader):
    work_group = {work_group}
    values: Storage[int]
    n: Uniform[int]
    out: StorageRW[int]
    group_memory = shared(int, 64)

    def helper(self) -> None:
        barrier()

    def compute(self) -> None:
        i = global_id().x
        j = local_index()
        g = group_id().x
"""


def make_shader(body: str, work_group: tuple[int, ...] = (64,)) -> type[sl.Shader]:
    lines = "".join(f"        {line}\n" for line in body.splitlines())
    return from_source(HEAD.format(work_group=work_group) + lines)


REFUSED = {
    "a barrier under a condition that differs": (rules.BARRIER, "if i < 3:\n    barrier()"),
    "a barrier after a return": (rules.BARRIER, "if i < 3:\n    return\nbarrier()"),
    "a barrier of a method that is called under a condition": (rules.BARRIER, "if i < 3:\n    self.helper()"),
    "a barrier in a loop with a bound that differs": (rules.BARRIER, "for k in range(i):\n    barrier()"),
    "a barrier in a loop that some leave": (
        rules.BARRIER,
        "for k in range(4):\n    if i == k:\n        break\n    barrier()",
    ),
    "a barrier in a loop while a value differs": (
        rules.BARRIER,
        "k = i\nwhile k > 0:\n    k -= 1\n    barrier()",
    ),
    "a store at a constant": (rules.RACE, "self.out[3] = i"),
    "a store at the group's index": (rules.RACE, "self.out[g] = i"),
    "a store at an index that cancels": (rules.RACE, "self.out[i - i] = i"),
    "a store at two indices that cancel": (rules.RACE, "k = 5 - i\nself.out[i + k] = i"),
    "a store in shared memory": (rules.RACE, "self.group_memory[g] = j"),
    "a store under a condition of the group": (rules.RACE, "if g == 3:\n    self.out[0] = i"),
}


@pytest.mark.parametrize(("rule", "body"), list(REFUSED.values()), ids=list(REFUSED))
def test_shaders_that_break_a_work_group_rule_are_refused_at_compilation(rule: Rule, body: str) -> None:
    with pytest.raises(ShaderError) as caught:
        compile_shader(make_shader(body))
    assert caught.value.rule is rule


ACCEPTED = {
    "a barrier under a condition of the group": "if g < self.n:\n    barrier()",
    "a barrier of a method": "self.helper()",
    "a barrier in a loop whose bound the group shares": "for k in range(self.n):\n    barrier()",
    "a store at the invocation's index": "self.out[i] = i",
    "a store behind the group's part": "self.out[g * 64 + j] = i",
    "a store of several elements": "for k in range(4):\n    self.out[i * 4 + k] = k",
    "a store at an index that was read": "self.out[self.values[i]] = i",
    "a store of what the group shares": "self.out[0] = self.n",
    "a store of one invocation": "if j == 0:\n    self.out[g] = i",
}


@pytest.mark.parametrize("body", list(ACCEPTED.values()), ids=list(ACCEPTED))
def test_shaders_that_obviously_keep_the_work_group_rules_are_compiled_without_lane_code(
    body: str, lowered_widths: list[int]
) -> None:
    compile_shader(make_shader(body))
    assert lowered_widths == []


def test_rows_of_a_group_that_are_as_long_as_16_lanes_share_their_number() -> None:
    body = "self.out[global_id().y] = i"
    with pytest.raises(ShaderError, match="by all invocations of a work-group"):
        compile_shader(make_shader(body, (16, 4)))
    compile_shader(make_shader(body, (8, 8)))


INDICES = st.recursive(
    st.sampled_from(
        ["i", "j", "g", "k", "self.n", "self.values[i]", "self.values[g]", "global_id().y", "0", "1", "2"]
    ),
    lambda inner: st.builds("({} {} {})".format, inner, st.sampled_from("+-*"), inner),
    max_leaves=4,
)
CONDITIONS = st.builds("{} {} {}".format, INDICES, st.sampled_from(["<", "=="]), INDICES)


def indented(text: str) -> str:
    return "    " + text.replace("\n", "\n    ")


def make_loop(stop: str, body: str) -> str:
    """Return a loop whose counter differs from those of the loops in it."""
    return f"for m in range({stop}):\n{indented(body.replace('m in range', 'mm in range'))}"


STATEMENTS = st.recursive(
    st.builds("self.out[{}] = {}".format, INDICES, INDICES)
    | st.builds("self.group_memory[{}] = {}".format, INDICES, INDICES)
    | st.just("barrier()")
    | st.just("self.helper()")
    | st.builds("k = {}".format, INDICES),
    lambda inner: (
        st.builds("if {}:\n{}".format, CONDITIONS, inner.map(indented))
        | st.builds(make_loop, INDICES, inner)
        | st.builds("{}\n{}".format, inner, inner)
        | st.builds("if {}:\n    return".format, CONDITIONS)
    ),
    max_leaves=4,
)


@given(body=STATEMENTS, work_group=st.sampled_from([(64,), (16, 4), (8, 8), (1, 64), (5, 3), (1,)]))
def test_whatever_lowering_refuses_is_doubtful(body: str, work_group: tuple[int, ...]) -> None:
    shader = make_shader("k = 0\n" + body, work_group)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compiler, "may_break_group_rules", lambda *_: False)
        try:
            stage = stage_trees(shader)[Stage.COMPUTE]
        except ShaderError:  # a constant index that is outside
            reject()
    x, y, z = (*work_group, 1, 1)[:3]
    sizes = x, y, z
    refused_rule: Rule | None = None
    try:
        functions.lower_compute(stage, "Test", sizes, 16)
    except ShaderError as error:
        refused_rule = error.rule
    assert refused_rule in (None, rules.BARRIER, rules.RACE)
    assert refused_rule is None or may_break_group_rules(stage, sizes)
