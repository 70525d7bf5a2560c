"""The gate: for each rule there is a test that breaks it, and one that comes to the same check and passes."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
from pathlib import Path

import pytest
import rule_coverage
from rule_coverage import Check, find_checks, find_rules

from rhi.rules import DEVICE_LOST, PASS_NESTED, PASS_OPEN, SHADER_DRIVER
from rhi.shading.rules import DEVICE_ONLY

HERE = Path(__file__).parent
ALWAYS_BROKEN = {
    SHADER_DRIVER.id: "the check is the driver's: a program that it takes passes",
    DEVICE_ONLY.id: "to call it is the fault: a shader that compiles passes",
    DEVICE_LOST.id: "the check is the driver's",
}
"""Rules whose refusals stand under no condition of ours, and what passes them."""


@pytest.fixture(scope="module")
def counts() -> dict[str, tuple[int, int]]:
    """By rule, how often it was broken and how often passed, by the tests of rhi and the conformance kit."""
    arguments = [
        str(HERE), "--ignore", str(HERE / "conformance"), "--ignore", str(HERE / "test_rule_coverage.py"),
        "--pyargs", "rhi.conformance.validation", "--rhi-backend", "null",
    ]  # fmt: skip
    run = subprocess.run(
        [sys.executable, rule_coverage.__file__, *arguments], capture_output=True, text=True, check=False
    )
    assert run.returncode == 0, run.stderr
    counts: dict[str, tuple[int, int]] = json.loads(run.stdout)
    return counts


RULES = sorted(rule.id for rule in find_rules().values())


@pytest.mark.slow
@pytest.mark.parametrize("rule", RULES)
def test_a_rule_is_broken_by_a_test(counts: dict[str, tuple[int, int]], rule: str) -> None:
    assert counts[rule][0] > 0


@pytest.mark.slow
@pytest.mark.parametrize("rule", [rule for rule in RULES if rule not in ALWAYS_BROKEN])
def test_a_rule_is_passed_by_a_test(counts: dict[str, tuple[int, int]], rule: str) -> None:
    assert counts[rule][1] > 0


# -- the gate itself -----------------------------------------------------------------------------------------------

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
    found = list(find_checks(ast.parse(SOURCE), {"PASS_NESTED": PASS_NESTED, "PASS_OPEN": PASS_OPEN}))
    assert found == [
        (2, Check("pass-nested", frozenset({4, 5, 6}), frozenset({3}))),
        (2, Check("pass-open", frozenset({8}), frozenset({7}))),
    ]


def test_a_loop_is_part_of_the_condition() -> None:
    source = "def wait(self):\n    while self.late:\n        if self.gone:\n            refuse(PASS_OPEN)"
    (found,) = find_checks(ast.parse(source), {"PASS_OPEN": PASS_OPEN})
    assert found == (1, Check("pass-open", frozenset({4}), frozenset({2, 3})))


@pytest.mark.parametrize(
    ("nested", "value", "broken", "passed"),
    [
        (True, False, {"pass-nested": 1}, {}),
        (False, True, {"pass-open": 1}, {"pass-nested": 1}),
        (False, False, {}, {"pass-nested": 1, "pass-open": 1}),
    ],
)
def test_a_call_breaks_or_passes_the_checks_it_comes_to(
    monkeypatch: pytest.MonkeyPatch, nested: bool, value: bool, broken: dict[str, int], passed: dict[str, int]
) -> None:
    coverage = rule_coverage.Coverage()
    for first, check in find_checks(ast.parse(SOURCE), {"PASS_NESTED": PASS_NESTED, "PASS_OPEN": PASS_OPEN}):
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
