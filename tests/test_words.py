"""Identifiers and prose say the words of docs/glossary.md, and none of those that it replaces.

    python tests/test_words.py [PATH …]

prints where retired words stand. The list is `tests/retired_words.toml`.
"""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path
from typing import Any, Final

import pytest

ROOT: Final = Path(__file__).resolve().parents[1]
LIST: Final = Path(__file__).with_name("retired_words.toml")
WORD: Final = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+")
TOKEN: Final = re.compile(
    r"""(?P<prose>\#[^\n]*|(?:[rbuf]|rb|br|rf|fr)?
    (?:\"{3}(?:[^\\]|\\.)*?\"{3}|'{3}(?:[^\\]|\\.)*?'{3}|"(?:[^\\"\n]|\\.)*"|'(?:[^\\'\n]|\\.)*'))
    |(?P<name>[^\W\d]\w*)|(?P<number>\d[\w.]*)|(?P<mark>\S)""",
    re.DOTALL | re.VERBOSE | re.IGNORECASE,
)
"""Comments and strings, and what else a program is made of. `tokenize` does the same in five times as long."""
CODE: Final = re.compile(r"```.*?```|``[^`]*``|`[^`\n]*`", re.DOTALL)
MAX_FIND_FUNCTIONS: Final = 60
"""So many functions may be called `find_…`: those that may find nothing, and then return None or raise."""


@dataclass(frozen=True, eq=False)
class RetiredWord:
    """A word that is no longer used: where it is looked for, in which forms, and what to say instead."""

    name: str
    new: str
    where: frozenset[str]
    forms: tuple[str, ...]
    allowed: dict[str, str]

    def allows(self, path: str, identifier: str) -> bool:
        """True if a listed exception lets an identifier of a file have the word."""
        for pattern in self.allowed:
            file_pattern, separator, identifier_pattern = pattern.partition("::")
            if not separator:
                file_pattern, identifier_pattern = "*", pattern
            if fnmatchcase(path, file_pattern) and fnmatchcase(
                identifier.lower(), identifier_pattern.lower()
            ):
                return True
        return False


def read_list(text: str) -> list[RetiredWord]:
    """Return the retired words of a list in TOML."""
    entries: dict[str, Any] = tomllib.loads(text)
    return [
        RetiredWord(
            name,
            entry["new"],
            frozenset(entry["where"]),
            tuple(entry["forms"]),
            dict(entry.get("allowed", {})),
        )
        for name, entry in entries.items()
    ]


RETIRED: Final = tuple(read_list(LIST.read_text(encoding="utf-8")))


@cache
def list_forms(retired: tuple[RetiredWord, ...], where: str) -> frozenset[str]:
    """Return all forms of the words that are looked for in one kind of text."""
    return frozenset(form for entry in retired if where in entry.where for form in entry.forms)


@cache
def compile_forms(forms: tuple[str, ...]) -> re.Pattern[str]:
    """Return the pattern of words that are one of the forms, in capitals or not."""
    return re.compile(r"(?<![\w-])(?:" + "|".join(map(re.escape, forms)) + r")(?![\w-])", re.IGNORECASE)


def list_files(*patterns: str) -> list[Path]:
    """The files that git tracks, or in a source distribution all that match."""
    if not (ROOT / ".git").exists():
        return sorted(
            path for pattern in patterns for path in ROOT.rglob(pattern) if ".venv" not in path.parts
        )
    listed = subprocess.run(
        ["git", "ls-files", *patterns], cwd=ROOT, capture_output=True, text=True, check=True, encoding="utf-8"
    )
    return [ROOT / name for name in listed.stdout.split() if (ROOT / name).exists()]


def check_identifier(path: str, identifier: str, retired: tuple[RetiredWord, ...] = RETIRED) -> Iterator[str]:
    """Yield the faults of an identifier of a file."""
    words = [word.lower() for word in WORD.findall(identifier)]
    is_whole = identifier.strip("._") in list_forms(retired, "identifier")
    if not is_whole and list_forms(retired, "word").isdisjoint(words):
        return  # as most: no entry is looked at
    for entry in retired:
        whole = "identifier" in entry.where and identifier.strip("._") in entry.forms
        part = "word" in entry.where and any(word in entry.forms for word in words)
        if (whole or part) and not entry.allows(path, identifier):
            yield f"`{identifier}`: instead of “{entry.name}” say {entry.new}"


def check_prose(
    path: str, text: str, retired: tuple[RetiredWord, ...] = RETIRED
) -> Iterator[tuple[int, str]]:
    """Yield (line, what is wrong) of a text, whose code in back-ticks doesn't count."""
    plain = CODE.sub(lambda code: "\n" * code[0].count("\n"), text)
    if not compile_forms(tuple(sorted(list_forms(retired, "prose")))).search(plain):
        return  # as most texts: one search instead of one for each entry
    for entry in retired:
        if "prose" in entry.where:
            for match in compile_forms(entry.forms).finditer(plain):
                if not entry.allows(path, match[0]):
                    line = plain.count("\n", 0, match.start())
                    yield line, f"“{match[0]}”: say {entry.new}"


def list_foreign_names(text: str) -> set[str]:
    """The names that a program imports from packages that aren't this project's: their words are theirs."""

    def walk(
        block: Iterable[ast.AST],
    ) -> Iterator[ast.ImportFrom]:  # statements alone: `ast.walk` takes longer
        for statement in block:
            if isinstance(statement, ast.ImportFrom):
                yield statement
            for name in ("body", "orelse", "finalbody", "handlers", "cases"):
                inner = getattr(statement, name, ())
                yield from walk(inner if isinstance(inner, list) else ())

    nodes = walk(ast.parse(text).body)
    packages = ("rhi", "rhi_pytest", "rhi_screen", "renderer")
    return {
        alias.name
        for node in nodes
        if (node.module or "").split(".")[0] not in packages
        for alias in node.names
    }


def check_program(path: Path) -> Iterator[str]:
    """Yield the faults of the identifiers, strings and comments of a Python file. An attribute is
    written with its dot, so that an exception can be made for it."""
    name = path.relative_to(ROOT).as_posix()
    text = path.read_text(encoding="utf-8")
    checked = list_foreign_names(text)
    before = ""
    for token in TOKEN.finditer(text):
        kind = token.lastgroup
        identifier = f".{token[0]}" if before == "." else token[0]
        before = token[0]
        faults: Iterable[tuple[int, str]] = ()
        if kind == "name" and identifier not in checked:
            checked.add(identifier)
            faults = ((0, wrong) for wrong in check_identifier(name, identifier))
        elif kind == "prose":
            faults = check_prose(name, token[0])
        for line, wrong in faults:
            begin = text.count("\n", 0, token.start()) + 1
            yield f"{name}:{begin + line}: {wrong}"


def check_page(path: Path) -> Iterator[str]:
    """Yield the faults of the prose of a page."""
    name = path.relative_to(ROOT).as_posix()
    for line, wrong in check_prose(name, path.read_text(encoding="utf-8")):
        yield f"{name}:{line + 1}: {wrong}"


PAGES_ABOUT_WORDS: Final = ("docs/decisions/new-names.md", "docs/glossary.md", "tests/test_words.py")
"""These name the old words."""


def check_tree(paths: Sequence[Path]) -> list[str]:
    """Return all that is wrong in files."""
    wrong: list[str] = []
    for path in paths:
        if path.relative_to(ROOT).as_posix() in PAGES_ABOUT_WORDS:
            continue
        wrong += check_program(path) if path.suffix == ".py" else check_page(path)
    return wrong


@pytest.mark.parametrize(
    "top", ["rhi", "rhi_pytest", "rhi_screen", "renderer", "examples", "benchmarks", "scripts", "tests"]
)
def test_no_program_says_a_retired_word(top: str) -> None:
    assert check_tree(list_files(f"{top}/**.py")) == []


def test_no_page_says_a_retired_word() -> None:
    assert check_tree(list_files("*.md")) == []


def test_few_functions_are_called_find() -> None:
    defined = re.compile(r"^\s*(?:async )?def (_?find_\w+)", re.MULTILINE)
    functions = [
        name for path in list_files("*.py") for name in defined.findall(path.read_text(encoding="utf-8"))
    ]
    assert len(functions) < MAX_FIND_FUNCTIONS, (
        "say what they do: compute, lookup, collect, select, nearest …"
    )


GRAMMAR_OF_TESTS: Final = re.compile(r"_(?:what(?!_to_install)|such|these|given|told)(?=_|$)")
"""Words that stand for a subject which the name of a test doesn't name."""


def check_name_of_test(name: str) -> Iterator[str]:
    """Yield the words of a test's name that stand for its subject or object."""
    for match in GRAMMAR_OF_TESTS.finditer(name):
        yield f"{name}: name the thing instead of “{match[0].strip('_')}”"


def test_names_of_tests_name_their_subject() -> None:
    defined = re.compile(r"^\s*def (test_\w+)", re.MULTILINE)
    files = list_files("tests/**.py", "rhi/conformance/**.py")
    names = [name for path in files for name in defined.findall(path.read_text(encoding="utf-8"))]
    assert len(names) > 4000
    assert [wrong for name in names for wrong in check_name_of_test(name)] == []


# -- the check itself ----------------------------------------------------------------------------------------

SAMPLE: Final = tuple(
    read_list(
        """
[lamp]
new = "light"
where = ["word", "prose"]
forms = ["lamp", "lamps"]
allowed = { "*street_lamp*" = "furniture", "rhi/old.py::lamp" = "an example" }

[given]
new = "value"
where = ["identifier"]
forms = ["given"]
"""
    )
)


@pytest.mark.parametrize("identifier", ["lamp", "find_lamps", "LampCount", "_LAMPS", "given", "_given"])
def test_a_retired_word_of_an_identifier_is_found_with_the_new_word(identifier: str) -> None:
    (wrong,) = check_identifier("rhi/a.py", identifier, SAMPLE)
    assert identifier in wrong
    assert "light" in wrong or "value" in wrong


@pytest.mark.parametrize(
    "identifier", ["clamp", "Lampoon", "light", "given_count", "forgiven", "make_street_lamp"]
)
def test_other_words_and_exceptions_are_left_alone(identifier: str) -> None:
    assert list(check_identifier("rhi/a.py", identifier, SAMPLE)) == []


def test_names_of_other_packages_are_theirs() -> None:
    text = "from hypothesis import given\nfrom renderer.scene import lamp\nimport lamps\n"
    assert list_foreign_names(text) == {"given"}


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("test_what_is_no_zip_is_refused", 1),
        ("test_such_a_draw_is_given_what_it_needs", 3),
        ("test_a_missing_package_says_what_to_install", 0),
        ("test_whatever_is_forgiven", 0),
    ],
)
def test_pronouns_in_a_name_of_a_test_are_faults(name: str, words: int) -> None:
    assert len(list(check_name_of_test(name))) == words


def test_an_exception_of_a_file_holds_in_that_file_only() -> None:
    assert list(check_identifier("rhi/old.py", "lamp", SAMPLE)) == []
    assert len(list(check_identifier("rhi/new.py", "lamp", SAMPLE))) == 1


def test_prose_is_read_without_its_code() -> None:
    text = "A Lamp.\n```\nlamp = 1\n```\nThe `lamp` is\nthe lamps, but not clamps, and given is no word of prose.\n"
    assert [line for line, _ in check_prose("docs/a.md", text, SAMPLE)] == [0, 5]


def test_every_exception_has_a_reason_and_every_word_a_new_one() -> None:
    for entry in RETIRED:
        assert entry.new
        assert entry.where <= {"identifier", "word", "prose"}
        assert all(entry.allowed.values())


if __name__ == "__main__":
    named_paths = [Path(argument).resolve() for argument in sys.argv[1:]] or list_files("*.py", "*.md")
    files = [
        file
        for path in named_paths
        for file in (sorted([*path.rglob("*.py"), *path.rglob("*.md")]) if path.is_dir() else [path])
    ]
    print("\n".join(check_tree(files)))
