"""The API reference: every public name is documented, and what docstrings say of parameters and rules is
true."""

from __future__ import annotations

import importlib
import inspect
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import rhi
from rhi.errors import RULES

ROOT = Path(__file__).parents[1]
sys.path.append(str(ROOT / "scripts"))

from build_site import MODULES  # noqa: E402

SECTION = re.compile(r"^(Args|Attributes|Raises|Returns|Yields):\n((?:[ ]+.*\n?|\n)*)", re.MULTILINE)
RULE = re.compile(r"`([a-z]+(?:-[a-z0-9]+)+)(?:-\*)?`")


def public_objects() -> Iterator[tuple[str, object]]:
    """Yield the public classes and functions of the reference with their qualified names, and the classes'
    members."""
    for module in MODULES:
        imported = importlib.import_module(module)
        for name in getattr(imported, "__all__", ()):
            entry = getattr(imported, name)
            if inspect.isclass(entry) and entry.__module__.startswith("rhi."):
                yield f"{module}.{name}", entry
                for member, value in vars(entry).items():
                    function = (
                        value.fget if isinstance(value, property) else getattr(value, "__func__", value)
                    )
                    if not member.startswith("_") and inspect.isfunction(function):
                        yield f"{module}.{name}.{member}", function
            elif inspect.isfunction(entry):
                yield f"{module}.{name}", entry


OBJECTS = dict(public_objects())


def test_there_is_something_to_document() -> None:
    assert len(OBJECTS) > 400
    assert "rhi.Device.mesh" in OBJECTS


def test_every_public_name_has_a_docstring_of_its_own() -> None:
    """The methods of the contract are documented in `Backend`, not again in each implementation."""
    missing = [name for name, entry in OBJECTS.items() if not (entry.__doc__ or "").strip()]
    assert [name for name in missing if name.rpartition(".")[2] not in vars(rhi.Backend)] == []
    assert all(getattr(rhi.Backend, name).__doc__ for name in vars(rhi.Backend) if not name.startswith("_"))


def sections(text: object) -> dict[str, str]:
    return dict(SECTION.findall(inspect.cleandoc(text.__doc__ or "") + "\n"))


def documented_parameters(text: str) -> list[str]:
    first = re.findall(r"^    ([\w *,]+):", text, re.MULTILINE)
    return [name.strip(" *") for names in first for name in names.split(",")]


def test_documented_parameters_exist() -> None:
    wrong = []
    for name, entry in OBJECTS.items():
        if inspect.isfunction(entry) and "Args" in sections(entry):
            parameters = set(inspect.signature(entry).parameters)
            wrong += [
                f"{name}: {parameter}"
                for parameter in documented_parameters(sections(entry)["Args"])
                if parameter not in parameters
            ]
    assert wrong == []


def test_rules_that_docstrings_name_exist() -> None:
    rule_ids = {rule.id for rule in RULES.values()}
    wrong, seen = [], 0
    for name, entry in OBJECTS.items():
        for rule in RULE.findall(sections(entry).get("Raises", "")):
            seen += 1
            if rule not in rule_ids and not any(rule_id.startswith(rule) for rule_id in rule_ids):
                wrong.append(f"{name}: {rule}")
    assert wrong == []
    assert seen >= 50


def test_a_wrong_parameter_or_rule_would_be_found() -> None:
    def example(size: int) -> None:
        """Do something.

        Args:
            size: in bytes.
            weight, color: both unknown.

        Raises:
            ValidationError: `no-such-rule` always.
        """

    assert documented_parameters(sections(example)["Args"]) == ["size", "weight", "color"]
    assert RULE.findall(sections(example)["Raises"]) == ["no-such-rule"]
