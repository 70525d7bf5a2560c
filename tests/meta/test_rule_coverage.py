"""The gate: for each rule there is a test that breaks it, and one that comes to the same check and passes."""

from __future__ import annotations

import ast
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import rule_coverage
from rule_coverage import Check, collect_checks

from rhi.errors import Rule, ValidationError, refuse
from rhi.errors.rules import (
    DEVICE_FORKED,
    DEVICE_LOST,
    DEVICE_WAIT,
    DRAW_COUNT,
    PASS_NESTED,
    PASS_OPEN,
    SHADER_DRIVER,
)
from rhi.shading.language.rules import DEVICE_ONLY

TESTS = Path(__file__).parents[1] / "rhi"
ALWAYS_BROKEN = {
    SHADER_DRIVER.id: "the check is the driver's: a program that it takes passes",
    DEVICE_ONLY.id: "to call it is the fault: a shader that compiles passes",
    DEVICE_LOST.id: "the check is the driver's",
}
"""Rules whose refusals stand under no condition of ours, and what passes them."""

BROKEN_IN_A_CHILD = {
    DEVICE_FORKED.id: "device/test_forks.py",
    DEVICE_WAIT.id: "backends/web/test_web_in_node.py",
}
"""Rules that are broken in processes which tests start, where calls aren't counted, and the file of those
tests."""


# They compare numbers and images, and break no rule that others don't; traced they would take minutes.
NOT_ABOUT_RULES = (
    "accuracy",
    "agreement",
    "lane_programs",
    "fragment_programs",
    "shading_textures",
    "cl_targets",
)


@pytest.mark.nightly
def test_each_rule_is_broken_by_a_test_and_passed_by_another() -> None:
    """By the tests of rhi and the conformance kit on the null device, all run again in another process."""
    ignored = [path for path in TESTS.rglob("test_*.py") if path.stem.endswith(NOT_ABOUT_RULES)]
    left_out = [TESTS / "conformance", *ignored]
    arguments = [str(TESTS), *(text for path in left_out for text in ("--ignore", str(path)))]
    kit = ["--pyargs", "rhi.conformance.validation", "--rhi-backend", "null"]
    path = os.pathsep.join(
        path for path in sys.path if path
    )  # the kits of the tests, which no setting of pytest names
    run = subprocess.run(
        [sys.executable, rule_coverage.__file__, *arguments, *kit],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"PYTHONPATH": path},
        encoding="utf-8",
    )
    assert run.returncode == 0, run.stderr
    counts: dict[str, tuple[int, int]] = json.loads(run.stdout)
    never_broken = [
        rule for rule, (broken, _) in counts.items() if not broken and rule not in BROKEN_IN_A_CHILD
    ]
    never_passed = [rule for rule, (_, passed) in counts.items() if not passed and rule not in ALWAYS_BROKEN]
    assert (never_broken, never_passed) == ([], [])


@pytest.mark.parametrize("rule", BROKEN_IN_A_CHILD)
def test_a_rule_that_is_broken_in_a_child_is_named_by_its_tests(rule: str) -> None:
    assert f'"{rule}"' in (TESTS / BROKEN_IN_A_CHILD[rule]).read_text(encoding="utf-8")


# -- the gate itself -----------------------------------------------------------------------------------------

SOURCE = """
def check(core, value):
    if core.nested:
        refuse(
            PASS_NESTED, "here",
        )
    elif value:
        fail(value)
    return value

def fail(value) -> NoReturn:
    raise ValidationError(rules.PASS_OPEN, value)
"""


def test_checks_are_found_with_their_conditions() -> None:
    checks = list(collect_checks(ast.parse(SOURCE), {"PASS_NESTED": PASS_NESTED, "PASS_OPEN": PASS_OPEN}))
    assert checks == [
        (2, Check("pass-nested", frozenset({4, 5, 6}), frozenset({3}))),
        (2, Check("pass-open", frozenset({8}), frozenset({7}))),
    ]


def test_a_loop_is_part_of_the_condition() -> None:
    source = "def wait(self):\n    while self.late:\n        if self.gone:\n            refuse(PASS_OPEN)"
    (check,) = collect_checks(ast.parse(source), {"PASS_OPEN": PASS_OPEN})
    assert check == (1, Check("pass-open", frozenset({4}), frozenset({2, 3})))


def test_a_yielded_fault_is_a_refusal_and_another_is_a_check_of_the_lines_below() -> None:
    source = "def faults(state):\n    if state:\n        yield lack(state, rule=rules.PASS_OPEN)"
    (check,) = collect_checks(ast.parse(source), {"PASS_OPEN": PASS_OPEN})
    assert check == (1, Check("pass-open", frozenset({3}), frozenset({2})))
    (check,) = collect_checks(ast.parse(source.replace("yield ", "")), {"PASS_OPEN": PASS_OPEN})
    assert check == (1, Check("pass-open", frozenset(), frozenset({3})))


class Checked:
    """Checks a value by a rule that it is given."""

    def __init__(self, rule: Rule) -> None:
        self._rule = rule

    def whole(self, value: int) -> None:
        if value < 0:
            refuse(self._rule, "here")


PASSED_RULE = """
def draw(count):
    checked = Checked(rule=DRAW_COUNT)
    checked.whole(count)
"""


@pytest.mark.parametrize(
    ("count", "broken", "passed"), [(-1, {"draw-count": 1}, {}), (1, {}, {"draw-count": 1})]
)
def test_a_call_that_passes_a_rule_to_a_check_breaks_or_passes_that_rule(
    tmp_path: Path, count: int, broken: dict[str, int], passed: dict[str, int]
) -> None:
    coverage = rule_coverage.Coverage(tmp_path)
    for first, check in collect_checks(ast.parse(PASSED_RULE), {"DRAW_COUNT": DRAW_COUNT}):
        coverage.checks["<given>", first].append(check)
    scope: dict[str, Any] = {"Checked": Checked, "DRAW_COUNT": DRAW_COUNT}
    exec(compile(PASSED_RULE, "<given>", "exec"), scope)
    before = sys.gettrace()
    sys.settrace(coverage.trace)
    try:
        scope["draw"](count)
    except ValidationError:
        pass
    finally:
        sys.settrace(before)
    assert (dict(coverage.broken), dict(coverage.passed)) == (broken, passed)


@pytest.mark.parametrize(
    ("nested", "value", "broken", "passed"),
    [
        (True, False, {"pass-nested": 1}, {}),
        (False, True, {"pass-open": 1}, {"pass-nested": 1}),
        (False, False, {}, {"pass-nested": 1, "pass-open": 1}),
    ],
)
def test_a_call_breaks_or_passes_the_checks_it_comes_to(
    tmp_path: Path, nested: bool, value: bool, broken: dict[str, int], passed: dict[str, int]
) -> None:
    coverage = rule_coverage.Coverage(tmp_path)
    for first, check in collect_checks(
        ast.parse(SOURCE), {"PASS_NESTED": PASS_NESTED, "PASS_OPEN": PASS_OPEN}
    ):
        coverage.checks["<example>", first].append(check)
    scope: dict[str, object] = {"NoReturn": None}
    exec(compile("from __future__ import annotations" + SOURCE, "<example>", "exec"), scope)
    check_function = scope["check"]
    assert callable(check_function)

    class Core:
        pass

    Core.nested = nested  # type: ignore[attr-defined]
    before = sys.gettrace()
    sys.settrace(coverage.trace)
    try:
        check_function(Core, value)
    except NameError:  # refuse and rules aren't there: that is where it was broken
        pass
    finally:
        sys.settrace(before)
    assert (dict(coverage.broken), dict(coverage.passed)) == (broken, passed)
