"""Operands are evaluated in Python's order, on every device: what an operand reads isn't what a later one
writes."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from functools import cache
from typing import Any

import numpy as np
import pytest
from nightly_reasons import FEWER_CASES
from nights import rotate_seed
from ordered_programs import FORMS, INVOCATIONS, ROWS, TURNS, WORDS, program_of, random_program, run_in_python

import rhi
import rhi.shading as sl
from rhi.backends.null import NullBackend
from rhi.contract.descriptors import Stage

BACKENDS = ("gl", "cl", "wgpu", "null")
GROUPS = [list(FORMS)[start : start + 15] for start in range(0, len(FORMS), 15)]
SOME = range(1)
BODIES = 3
MANY = range(1000, 1010)


@pytest.fixture(scope="module", params=BACKENDS)
def running_device(request: pytest.FixtureRequest) -> Iterator[rhi.Device]:
    """A device of each backend; the null device runs compute shaders."""
    if request.param not in [backend.name for backend in rhi.report() if backend.usable]:
        pytest.skip(f"{request.param} doesn't work here")
    with rhi.create_device(request.param) as device:
        if request.param == "null":
            device.backend_as(NullBackend).run_shaders()
        yield device


def run(device: rhi.Device, text: str, count: int) -> dict[str, list[int]]:
    """Run a program; return what each memory contains."""
    memory: dict[str, Any] = {
        "out": device.storage(int, count * INVOCATIONS),
        "mem": device.storage(int, WORDS * INVOCATIONS),
        "vecs": device.storage(sl.ivec4, 4 * INVOCATIONS),
        "texels": device.texture((4, INVOCATIONS), rhi.Format.R32I),
    }
    shader, settings = sl.from_source(text, "Program", "Settings")
    program: Any = device.program(shader)
    values = {"settings": settings(turns=np.array(TURNS), rows=np.array(ROWS))}
    device.dispatch(program, 1, **memory | values | {"texels": memory["texels"].image()})
    return {name: np.ravel(memory[name].read()).tolist() for name in memory}


def results_by_form(results: list[int], forms: Sequence[str]) -> dict[str, list[int]]:
    return {form: results[number :: len(forms)] for number, form in enumerate(forms)}


@cache
def group_results(device: rhi.Device, group: int) -> dict[str, list[int]]:
    """Run the forms of a group in one program, since compilers take most of the time."""
    forms = GROUPS[group]
    return results_by_form(run(device, program_of([FORMS[form] for form in forms]), len(forms))["out"], forms)


@cache
def expected_results(group: int) -> dict[str, list[int]]:
    forms = GROUPS[group]
    text = program_of([FORMS[form] for form in forms])
    return results_by_form(run_in_python(text, len(forms))["out"], forms)


@pytest.mark.nightly_cases("cl-*", "wgpu-*", reason=FEWER_CASES)
@pytest.mark.parametrize("form", FORMS)
def test_each_form_has_the_result_of_python(running_device: rhi.Device, form: str) -> None:
    group = next(number for number, forms in enumerate(GROUPS) if form in forms)
    assert group_results(running_device, group)[form] == expected_results(group)[form]


@pytest.mark.parametrize("seed", [*SOME, *(pytest.param(n, marks=pytest.mark.nightly) for n in MANY)])
def test_random_programs_leave_the_same_memory_as_python(running_device: rhi.Device, seed: int) -> None:
    text = random_program(rotate_seed(seed), BODIES)
    assert run(running_device, text, BODIES) == run_in_python(text, BODIES), text


# -- what stays one expression -----------------------------------------------------------------------------


class Sources(sl.Shader):
    """Memory, and functions that change some of it."""

    source: sl.Storage[int]
    mem: sl.StorageRW[int]
    other: sl.StorageRW[int]
    scale: sl.Uniform[int]
    part = sl.shared(int, 4)
    out: sl.StorageRW[int]

    def inc(self) -> int:
        self.mem[0] += 1
        return self.mem[0]

    def wait(self) -> int:
        sl.barrier()
        return 1

    @sl.native("glsl", "return 1;")
    def native(self) -> int: ...  # type: ignore[empty-body]

    def pure(self, x: int) -> int:
        return x * x


PROGRAM = """
class Program(Sources):
    def compute(self) -> None:
        x = self.source[1] + self.scale
        self.out[0] = {expression}
"""


def glsl_of(expression: str) -> str:
    text = PROGRAM.format(expression=expression)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rhi.errors.ShaderWarning)  # of bindings that a form doesn't use
        program = sl.compile_shader(sl.from_source(text, "Program", scope={"Sources": Sources, "sl": sl}))
    return program.emit("glsl", Stage.COMPUTE).text


@pytest.mark.parametrize(
    "expression",
    [
        "self.source[0] + self.inc()",
        "self.other[0] + self.inc()",
        "self.part[0] * self.inc()",
        "self.scale - self.inc()",
        "len(self.mem) + self.inc()",
        "x * x + self.inc()",
        "self.pure(x) + self.inc()",
        "self.mem[0] + self.mem[1] + self.pure(self.mem[2])",
        "self.inc() if self.mem[0] > 3 else self.mem[1]",
        "int(self.mem[0] > 3 and self.inc() > 3)",
        "self.source[0] + self.wait()",
    ],
)
def test_operands_whose_order_cannot_be_observed_stay_in_one_expression(expression: str) -> None:
    assert "operand" not in glsl_of(expression)


@pytest.mark.parametrize(
    ("expression", "first"),
    [
        ("self.mem[0] + self.inc()", "operand = mem[0];"),
        ("self.inc() + self.mem[0]", "operand = inc();"),
        ("self.part[0] + self.wait()", "operand = part[0];"),
        ("self.other[0] + self.native()", "operand = other[0];"),
        ("self.native() + self.inc()", "operand = native();"),
        ("(self.other[0] + self.inc()) + self.mem[0]", "operand = (other[0] + inc());"),
    ],
)
def test_an_operand_is_evaluated_before_a_later_one_that_may_change_it(expression: str, first: str) -> None:
    text = glsl_of(expression).replace("clamp(0, 0, int(mem.length()) - 1)", "0")
    assert first in text.replace("clamp(0, 0, int(other.length()) - 1)", "0")


def test_a_write_precedes_a_later_operand_that_discards() -> None:
    class Discarding(sl.Shader):
        count: sl.StorageRW[int]

        def drop(self, x: float) -> float:
            if x > 3.0:
                sl.discard()
            return x

        def vertex(self) -> sl.vec4:
            return sl.vec4(0.0)

        def fragment(self) -> sl.vec4:
            x = sl.fragment_coordinate().x
            return sl.vec4(float(sl.atomic_add(self.count[0], 1)) + self.drop(x))

    text = sl.compile_shader(Discarding).emit("glsl", Stage.FRAGMENT).text
    assert "float operand = float(" in text


def test_an_index_of_an_augmented_target_is_evaluated_once() -> None:
    class Adds(sl.Shader):
        mem: sl.StorageRW[int]

        def inc(self) -> int:
            self.mem[0] += 1
            return self.mem[0]

        def compute(self) -> None:
            self.mem[self.mem[0]] += self.inc()

    memory = sl.run_compute(Adds, 1, mem=np.array([2, 10, 20, 30], "i4"))
    assert memory["mem"].tolist() == [3, 10, 23, 30]
