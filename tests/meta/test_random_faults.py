"""Random faults: which there are, and that a trial tells what the tests notice."""

from __future__ import annotations

import ast
import subprocess
from pathlib import Path

import pytest
import random_faults
from random_faults import ROOT, Fault, choose_faults, list_faults, try_faults
from undetectable_faults import UNDETECTABLE_FAULTS, explain


def changes(text: str, file: str = "a.py") -> list[tuple[str, str]]:
    return [(fault.old, fault.new) for fault in list_faults(file, text)]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("x = a + b", [("+", "-")]),
        ("x = (a) * (b)", [("*", "/")]),
        ("x = (a +\n    # so - much\n    b)", [("+", "-")]),
        ("é = 'é' if a else b; x = c - d", [("a", "not (a)"), ("-", "+")]),
        ("x <<= a", [("<<=", ">>=")]),
        ("x = a < b <= c", [("<", "<="), ("<=", "<")]),
        ("x = a is not b", [("is not", "is")]),
        ("x = a not in b", [("not in", "in")]),
        ("x = a and b or c", [("and", "or"), ("or", "and")]),
        ("x = not a", [("not a", "(a)")]),
        ("x = -a", [("-a", "(a)")]),
        (
            "x = 7, 0.0, 2.5, True, 'text', None",
            [("7", "8"), ("0.0", "1.0"), ("2.5", "5.0"), ("True", "False")],
        ),
        ("if a:\n    f(b)", [("a", "not (a)"), ("f(b)", "pass")]),
        ("while a:\n    b = 1", [("a", "not (a)"), ("1", "2")]),
        ("def f(a: int = 1) -> Final[2]:\n    return a", [("1", "2")]),
    ],
)
def test_operators_constants_conditions_and_calls_have_faults(
    text: str, expected: list[tuple[str, str]]
) -> None:
    assert changes(text) == expected


@pytest.mark.parametrize(
    "text",
    [
        '"""Return 1 + 1."""',
        "import a",
        "x: Array[3] = y",
        "def f(a: X | None) -> Y | None: ...",
        "assert a == 1",
        "x = 'a %d' % b",
        "T = X | None",
        "if TYPE_CHECKING:\n    import b",
        "x = f'{a + 1}'",
        "x = zip(a, b, strict=True)",
    ],
)
def test_texts_types_and_assertions_have_none(text: str) -> None:
    assert changes(text) == []


def test_kernels_have_faults_but_their_comments_and_directives_have_none() -> None:
    text = "#define A 1\nint x = y + 2;  // 3 - 4\nfloat z = a <= 0.5f && b;\n"
    assert changes(text, "a.cl") == [("+", "-"), ("2", "3"), ("<=", "<"), ("0.5", "1.5"), ("&&", "||")]


def test_a_fault_is_one_change_at_its_line_of_a_module_that_parses() -> None:
    faults = choose_faults(ROOT, ["rhi.device", "rhi.backends.cl", "renderer.frame"], 60, 3)
    assert len({(fault.file, fault.line) for fault in faults}) == 60
    for fault in faults:
        text = (ROOT / fault.file).read_text(encoding="utf-8")
        assert text.split("\n")[fault.line - 1].strip() == fault.text
        changed = fault.apply(text)
        assert changed != text
        assert len(changed) - len(text) == len(fault.new) - len(fault.old)
        if fault.file.endswith(".py"):
            ast.parse(changed)


def test_a_seed_has_always_the_same_faults() -> None:
    first, again, other = (choose_faults(ROOT, ["rhi.trace"], 8, seed) for seed in (1, 1, 2))
    assert first == again
    assert first != other
    assert all(fault.file.startswith("rhi/trace/") for fault in first)


TESTED = (
    "def scale(x):\n    return 2 * x\n\n\ndef count(n):\n    while n > 0:\n        n -= 1\n    return n\n"
)
TESTS = "from thing.numbers import count, scale\n\n\ndef test_it():\n    assert scale(0) == count(3) == 0\n"


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A project of one module and its test."""
    texts = {"thing/numbers.py": TESTED, "thing/__init__.py": "", "tests/thing/test_numbers.py": TESTS}
    for file, text in texts.items():
        (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / file).write_text(text, encoding="utf-8")
    subprocess.run(["git", "init", "-q"], cwd=tmp_path, check=True)
    return tmp_path


@pytest.mark.nightly
def test_an_undetected_fault_is_printed_with_its_line_and_the_project_is_unchanged(
    project: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(random_faults, "_PATIENCE", (2.0, 60.0))  # what doesn't end is noticed by then
    by_change = {(fault.old, fault.new): fault for fault in list_faults("thing/numbers.py", TESTED)}
    changes = [("2", "3"), ("-=", "+="), ("n > 0", "not (n > 0)")]
    survivors = try_faults(project, [by_change[change] for change in changes], jobs=2)
    assert [(fault.line, fault.old) for fault in survivors] == [(2, "2")]
    output = capsys.readouterr().out
    assert "ESCAPED  thing/numbers.py:2: '2' → '3' in: return 2 * x" in output
    assert "Timeout (0:00:02)!" in output
    assert output.endswith("2 of 3 that can be seen are noticed; 0 can't be seen\n")
    assert (project / "thing/numbers.py").read_text(encoding="utf-8") == TESTED


@pytest.mark.nightly
def test_a_fault_that_is_explained_is_no_survivor(
    project: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(random_faults, "explain", lambda *fault: "for a reason")
    (fault,) = (listed for listed in list_faults("thing/numbers.py", TESTED) if listed.old == "2")
    assert try_faults(project, [fault]) == []
    assert capsys.readouterr().out.endswith(
        "for a reason\n0 of 0 that can be seen are noticed; 1 can't be seen\n"
    )


@pytest.mark.nightly
def test_tests_that_fail_without_a_fault_are_reported(project: Path) -> None:
    (project / "tests/thing/test_numbers.py").write_text(
        "def test_it():\n    assert False\n", encoding="utf-8"
    )
    with pytest.raises(AssertionError, match="without a fault"):
        try_faults(project, list_faults("thing/numbers.py", TESTED)[:1])


@pytest.mark.parametrize("unseen", UNDETECTABLE_FAULTS, ids=lambda fault: f"{fault.file}: {fault.text[:40]}")
def test_each_undetectable_fault_exists_and_has_a_reason(unseen: tuple[str, ...]) -> None:
    file, text, old, new, why = unseen
    there = {
        (listed.text, listed.old, listed.new)
        for listed in list_faults(file, (ROOT / file).read_text(encoding="utf-8"))
    }
    assert (text, old, new) in there
    assert explain(file, text, old, new) == why
    assert not explain(file, text, old, "another")


@pytest.mark.nightly
def test_a_sample_of_faults_is_noticed() -> None:
    """A few, of packages whose tests are quick; `random_faults.py` tries more."""
    packages = ["rhi.trace", "rhi.testing", "rhi.backends.null", "renderer.lights"]
    faults: list[Fault] = choose_faults(ROOT, packages, 6, 1)
    assert try_faults(ROOT, faults) == []
