"""Each name that a docstring's `Args:` or `Attributes:` explains exists in the code below it."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FOLDERS = ("rhi", "rhi_pytest", "rhi_screen", "renderer", "scripts", "benchmarks", "examples", "tests")
Definition = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef
SECTION = re.compile(r"( *)(Args|Attributes|Raises|Returns|Yields):\s*")
EXTRA_NAMES = {
    ("renderer/scene/lights.py", "Lights"): {"directional", "point", "spot"},  # its base makes these
    ("tests/test_reference.py", "example"): {"weight", "color"},  # a sample for the reference's writer
}
"""Names that no statement of the class defines."""


def read_sections(docstring: str) -> Iterator[tuple[str, str]]:
    """The sections `Args:` and `Attributes:`, as pairs of the section's name and an entry."""
    section, section_indent, entry_indent = "", 0, 0
    for line in docstring.split("\n"):
        indent = len(line) - len(line.lstrip())
        heading = SECTION.fullmatch(line)
        if heading:
            section, section_indent, entry_indent = heading[2], indent, 0
        elif not line.strip() or indent <= section_indent:
            section = "" if line.strip() else section
        elif section in ("Args", "Attributes"):
            entry_indent = entry_indent or indent
            if indent == entry_indent:
                yield section, line.strip()


def list_explained_names(docstring: str) -> list[str]:
    """The names before the colons of all entries."""
    names: list[str] = []
    for section, entry in read_sections(docstring):
        subject, colon, _ = entry.partition(":")
        assert colon, f"an entry of {section} without a colon: {entry}"
        names += [name.strip().strip("`*") for name in subject.split(",")]
    return [name for name in names if name != "…"]


def list_parameters(function: ast.FunctionDef | ast.AsyncFunctionDef) -> set[str]:
    """The names of all parameters."""
    arguments = function.args
    named = [
        *arguments.posonlyargs,
        *arguments.args,
        *arguments.kwonlyargs,
        arguments.vararg,
        arguments.kwarg,
    ]
    return {argument.arg for argument in named if argument is not None}


def list_members(definition: ast.ClassDef) -> set[str]:
    """The names that the class's statements and methods define, and the constructor's parameters."""
    names: set[str] = set()
    for statement in definition.body:
        if isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef):
            names.add(statement.name)
            if statement.name in ("__init__", "__new__", "__call__"):
                names |= list_parameters(statement)
            for node in ast.walk(statement):
                if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
                    names |= {node.attr} if node.value.id == "self" else set()
        elif isinstance(statement, ast.AnnAssign | ast.Assign):
            targets = statement.targets if isinstance(statement, ast.Assign) else [statement.target]
            names |= {n.id for target in targets for n in ast.walk(target) if isinstance(n, ast.Name)}
    return names


def list_stale_names(file: str, text: str) -> list[str]:
    """The names that docstrings explain and that aren't there, each with its class or function."""
    stale: list[str] = []
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, Definition):
            existing = list_members(node) if isinstance(node, ast.ClassDef) else list_parameters(node)
            existing = existing | EXTRA_NAMES.get((file, node.name), set())
            names = list_explained_names(ast.get_docstring(node) or "")
            stale += [f"{node.name}: {name}" for name in names if name not in existing]
    return stale


@pytest.mark.parametrize("folder", FOLDERS)
def test_docstrings_explain_names_that_exist(folder: str) -> None:
    files = sorted((ROOT / folder).rglob("*.py"))
    assert files
    stale = {}
    for path in files:
        file = path.relative_to(ROOT).as_posix()
        if names := list_stale_names(file, path.read_text("utf-8")):
            stale[file] = names
    assert not stale, f"rename these entries of docstrings, or remove them: {stale}"


def test_a_stale_parameter_is_reported() -> None:
    text = 'def f(size):\n    """F.\n\n    Args:\n        size: s.\n        color: c,\n            more: m.\n    """\n'
    assert list_stale_names("a.py", text) == ["f: color"]


def test_attributes_are_fields_properties_and_names_assigned_in_methods() -> None:
    text = (
        'class A:\n    """A.\n\n    Attributes:\n        x, y: fields.\n        z: assigned.\n        w: a property.\n'
        '        v: nothing.\n    """\n    x: int\n    y = 1\n\n    def __init__(self):\n        self.z = 1\n\n'
        "    @property\n    def w(self): ...\n"
    )
    assert list_stale_names("a.py", text) == ["A: v"]


def test_text_after_a_section_is_no_entry_of_it() -> None:
    text = 'def f(a):\n    """F.\n\n    Args:\n        a: number.\n\n    Note: that is all.\n    """\n'
    assert list_stale_names("a.py", text) == []


RIDDLING_FIRST_WORDS = re.compile(r"(?:Return (?:what|how)|Yield what|What|How|Which|Whether|Lets?)\b")
"""First lines that begin so describe a thing without naming it."""


def list_riddling_docstrings(text: str) -> list[str]:
    """The docstrings' first lines that begin with `RIDDLING_FIRST_WORDS`."""
    kinds = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    documented = [node for node in ast.walk(ast.parse(text)) if isinstance(node, kinds)]
    lines = [(ast.get_docstring(node) or "").partition("\n")[0] for node in documented]
    return [line for line in lines if RIDDLING_FIRST_WORDS.match(line)]


@pytest.mark.parametrize("folder", FOLDERS)
def test_first_lines_of_docstrings_name_their_subject(folder: str) -> None:
    riddling = {
        path.relative_to(ROOT).as_posix(): lines
        for path in sorted((ROOT / folder).rglob("*.py"))
        if (lines := list_riddling_docstrings(path.read_text(encoding="utf-8")))
    }
    assert not riddling, "name the thing: “The bindings of …” instead of “What … binds”"


@pytest.mark.parametrize(
    "line",
    [
        "What it binds.",
        "Let it end.",
        "Return what it has.",
        "Yield what is wrong.",
        "Return how it ends.",
        "Whether.",
    ],
)
def test_a_riddling_first_line_is_reported(line: str) -> None:
    assert list_riddling_docstrings(f'def f():\n    """{line}"""\n') == [line]


@pytest.mark.parametrize("line", ["Whatever.", "Letters of a font.", "Return the value that `what` names."])
def test_other_first_lines_are_left_alone(line: str) -> None:
    assert list_riddling_docstrings(f'def f():\n    """{line}"""\n') == []
