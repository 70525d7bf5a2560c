"""The rules that the tests break, and those that they keep, line by line.

`python rule_coverage.py FOLDER… [-- OPTIONS OF PYTEST]` runs tests and prints a line of JSON: for each rule,
how often a test broke it and how often one came to the same check and passed it.

- A check is a call that names a rule (`refuse(PASS_NESTED, …)`) and the condition it stands under. It is
  passed by a call of its function that gets to the condition and returns without getting to the refusal. A
  call of a helper that does nothing but refuse (`-> NoReturn`) counts as naming its rules.
- A call that is given a rule to refuse by (`ArgumentChecker(call, rule=DRAW_COUNT)`) is a check of what
  follows it: broken if an error of that rule leaves its function, passed if the function gets to it and
  returns.
- One that is yielded (`yield lack(…, rule=STATE_CAPABILITY)`) is a refusal: who gets it raises it.
- Only functions with a check in them are traced, so the tests take about twice their time.
"""

from __future__ import annotations

import ast
import contextlib
import importlib
import json
import os
import sys
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import pytest
from hypothesis import settings

import rhi
from rhi.errors import RULES, RhiError, Rule

PACKAGE = Path(rhi.__file__).parent
RULE_MODULES = ("rhi.errors.rules", "rhi.shading.language.rules", "rhi.trace.rules")
LEFT_OUT = ("conformance",)


@dataclass(frozen=True)
class Check:
    """A refusal: the lines of the call, and those of the condition it stands under, none if it has none. A
    loop around it is part of the condition: one that isn't entered has nothing to refuse.

    Of a call that is given a rule, the condition is the call, and there is no refusal."""

    rule: str
    refusal: frozenset[int]
    condition: frozenset[int] = frozenset()


def collect_rules() -> dict[str, Rule]:
    """All rules by the names of their constants."""
    modules = [importlib.import_module(name) for name in RULE_MODULES]
    return {
        name: value for module in modules for name, value in vars(module).items() if isinstance(value, Rule)
    }


def collect_checks(tree: ast.Module, rules: dict[str, Rule]) -> Iterator[tuple[int, Check]]:
    """The checks of a module, with the first line of the function that each is in."""
    helpers: dict[str, set[str]] = {}
    yielded = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Yield)}

    def named_rules(call: ast.Call) -> set[str]:
        first = call.args[0] if call.args else None
        name = first.attr if isinstance(first, ast.Attribute) else getattr(first, "id", "")
        called = call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")
        return {rules[name].id} if name in rules else helpers.get(called, set())

    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef) and getattr(node.returns, "id", "") == "NoReturn":
            inner = [named_rules(call) for call in ast.walk(node) if isinstance(call, ast.Call)]
            helpers[node.name] = set().union(*inner)

    def visit(
        node: ast.AST,
        function: int,
        loop: frozenset[int],
        condition: frozenset[int],
        statement: frozenset[int],
    ) -> Iterator[tuple[int, Check]]:
        if isinstance(node, (ast.FunctionDef, ast.Lambda)):
            decorators = getattr(node, "decorator_list", [])
            function = min([node.lineno, *(decorator.lineno for decorator in decorators)])
            loop = condition = frozenset()
            if getattr(node, "name", "") in helpers:
                return
        if isinstance(node, ast.stmt):
            statement = lines(node)
        if isinstance(node, ast.Call) and function:
            for rule in named_rules(node):
                yield function, Check(rule, statement, condition)
            for argument in [*node.args[1:], *(keyword.value for keyword in node.keywords)]:
                name = argument.attr if isinstance(argument, ast.Attribute) else getattr(argument, "id", "")
                if name not in rules:
                    continue
                if id(node) in yielded:
                    yield function, Check(rules[name].id, statement, condition)
                else:
                    yield function, Check(rules[name].id, frozenset(), lines(node))
        for field, value in ast.iter_fields(node):
            around, under = loop, condition
            if isinstance(node, (ast.If, ast.While)) and field == "body":
                around = lines(node.test) if isinstance(node, ast.While) else loop
                under = around | lines(node.test)
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST):
                    yield from visit(child, function, around, under, statement)

    yield from visit(tree, 0, frozenset(), frozenset(), frozenset())


def lines(node: Any) -> frozenset[int]:
    return frozenset(range(node.lineno, node.end_lineno + 1))


class Coverage:
    """A pytest plugin that counts the checks of a package that tests pass and break."""

    def __init__(self, package: Path = PACKAGE) -> None:
        self.broken: Counter[str] = Counter()
        self.passed: Counter[str] = Counter()
        self.checks: dict[tuple[str, int], list[Check]] = defaultdict(list)
        rules = collect_rules()
        for path in sorted(package.rglob("*.py")):
            if path.relative_to(package).parts[0] not in LEFT_OUT:
                for function, check in collect_checks(ast.parse(path.read_text(encoding="utf-8")), rules):
                    self.checks[str(path), function].append(check)
        self._checks_of_code: dict[CodeType, list[Check] | None] = {}

    def trace(self, frame: FrameType, event: str, argument: object) -> Any:
        code = frame.f_code
        try:
            checks = self._checks_of_code[code]
        except KeyError:
            checks = self._checks_of_code[code] = self.checks.get((code.co_filename, code.co_firstlineno))
        return None if checks is None else self._follow(checks)

    def _follow(self, checks: list[Check]) -> Any:
        seen: set[int] = set()
        raised = ""  # the rule of the error that is leaving the function

        def local(frame: FrameType, event: str, argument: Any) -> Any:
            nonlocal raised
            if event == "line":
                seen.add(frame.f_lineno)
                raised = ""
            elif event == "exception":
                raised = argument[1].rule.id if isinstance(argument[1], RhiError) else "another"
            elif event == "return":
                for check in checks:
                    if not check.refusal:
                        if raised == check.rule:
                            self.broken[check.rule] += 1
                        elif not raised and not seen.isdisjoint(check.condition):
                            self.passed[check.rule] += 1
                    elif not seen.isdisjoint(check.refusal):
                        self.broken[check.rule] += 1
                    elif not check.condition or not seen.isdisjoint(check.condition):
                        self.passed[check.rule] += 1
            return local

        return local

    def pytest_runtest_call(self) -> None:
        sys.settrace(self.trace)

    def pytest_runtest_teardown(self) -> None:
        sys.settrace(None)


def main(arguments: list[str]) -> None:
    settings.register_profile("traced", derandomize=True, deadline=None, max_examples=10)
    coverage = Coverage()
    marks = ["-m", "not slow and not nightly"]
    options = ["-q", "-p", "no:cacheprovider", "-c", os.devnull, *marks, "--rootdir", str(PACKAGE.parent)]
    options += ["--hypothesis-profile", "traced"]
    with open(os.devnull, "w", encoding="utf-8") as nowhere, contextlib.redirect_stdout(nowhere):
        status = pytest.main([*options, *arguments], [coverage])
    if status not in (pytest.ExitCode.OK, pytest.ExitCode.TESTS_FAILED):
        raise RuntimeError(f"the tests did not run: {status!r}")
    rule_ids = [rule.id for rule in collect_rules().values()]
    assert set(rule_ids) <= RULES.keys()
    print(json.dumps({rule: [coverage.broken[rule], coverage.passed[rule]] for rule in rule_ids}))


if __name__ == "__main__":
    main(sys.argv[1:])
