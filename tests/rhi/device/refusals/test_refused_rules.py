"""The gate: every rule that a user can break has a test here, or in the kit where a capability decides."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

import rhi.conformance
from rhi import Rule
from rhi.errors import rules

ELSEWHERE = {
    rules.CONTAINER_CAPACITY: "no device is needed",
    rules.CONTAINER_FULL: "no device is needed",
    rules.CONTAINER_EMPTY: "no device is needed",
    rules.DEVICE_FORKED: "needs a process that is forked: asserted on in test_forks",
    rules.DEVICE_DRIVER: "needs a machine without a driver",
    rules.DEVICE_MEMORY: "needs a device without memory",
    rules.DEVICE_LOST: "needs a device that is lost",
    rules.DEVICE_DEBUG: "needs a driver that complains",
    rules.DEVICE_CONTEXT: "needs a platform with contexts",
    rules.DEVICE_ANSWER: "needs a device that never answers",
    rules.SHADER_DRIVER: "needs native source, which belongs to one backend",
    rules.TRANSIENT_SIZE: "needs more memory than a test should take",
    rules.QUERY_UNFINISHED: "depends on the device's speed: asserted on where it shows",
    rules.RELOAD_WATCH: "of files, not of a device: asserted on in tests of reloading",
    rules.CAMERA_VALUE: "no device is needed",
    rules.ASSERTION_ARGUMENT: "of assertions: asserted on in test_misuse",
    rules.DEVICE_COPY: "of copies and pickles: asserted on in test_device_copies",
    rules.IMAGE_FILE: "of files: asserted on in test_image_files",
    rules.IMAGE_LIBRARY: "needs a machine without Pillow: asserted on in test_image_files",
    rules.DEVICE_WAIT: "needs a page whose Python can't wait: asserted on in test_web_in_node",
    rules.PLOT_LIBRARY: "needs a machine without matplotlib: asserted on in test_missing_extras",
    rules.NULL_SAMPLES: "a rule of the null device",
    rules.NULL_ANSWER: "a rule of the null device",
}
"""Rules that are not tested here, and why."""

NAMES = sorted(
    name for name, value in vars(rules).items() if isinstance(value, Rule) and value not in ELSEWHERE
)
FOLDERS = (Path(__file__).parent, Path(rhi.conformance.__file__).parent / "validation")
SOURCES = [path for folder in FOLDERS for path in sorted(folder.glob("test_*.py"))]


def collect_refused_rules(text: str) -> set[str]:
    """Return the names of the rules that calls of `refuses` expect in the text of a module."""
    calls = (node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Call) and node.args)
    first = (call.args[0] for call in calls if isinstance(call.func, ast.Name) and call.func.id == "refuses")
    return {
        rule.attr
        for rule in first
        if isinstance(rule, ast.Attribute) and isinstance(rule.value, ast.Name) and rule.value.id == "rules"
    }


REFUSED = set().union(*(collect_refused_rules(path.read_text(encoding="utf-8")) for path in SOURCES))


@pytest.mark.parametrize("name", NAMES)
def test_each_rule_has_a_failing_case(name: str) -> None:
    assert name in REFUSED


def test_a_rule_whose_name_begins_another_s_or_stands_in_prose_has_no_case() -> None:
    text = (
        "with refuses(rules.TEXTURE_SIZE_LIMIT, device):\n"
        "    'refuses(rules.QUERY_INDICES'  # refuses(rules.QUADS, x)"
    )
    assert collect_refused_rules(text) == {"TEXTURE_SIZE_LIMIT"}


@pytest.mark.parametrize(
    "name", sorted(name for name, value in vars(rules).items() if isinstance(value, Rule))
)
def test_a_rule_is_a_sentence_with_a_name(name: str) -> None:
    rule: Rule = getattr(rules, name)
    assert rule.id == rule.id.lower()
    assert " " not in rule.id
    assert len(rule.sentence.split()) >= 3
    assert not rule.sentence.endswith(".")
