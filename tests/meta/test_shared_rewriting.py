"""Test workers share the rewriting of assertions: each rewrites its part of the files first."""

from __future__ import annotations

from pathlib import Path

import pytest
import shared_rewriting

pytest_plugins = ["pytester"]

TEXT = "def test_a_sum() -> None:\n    assert 1 + 1 == 2\n"


@pytest.fixture
def folder(pytester: pytest.Pytester) -> Path:
    """A folder of three files of tests, one of which isn't Python."""
    tests = pytester.mkdir("tests")
    for name in ("test_a.py", "test_b.py", "data.py"):
        (tests / name).write_text(TEXT, encoding="utf-8")
    (tests / "test_faulty.py").write_text("def", encoding="utf-8")
    return pytester.path


def test_files_of_tests_are_listed_in_one_order(folder: Path) -> None:
    names = [path.name for path in shared_rewriting.list_files(folder)]
    assert names == ["test_a.py", "test_b.py", "test_faulty.py"]


def test_pytest_takes_files_that_are_rewritten_already(
    folder: Path, pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.dont_write_bytecode", False)
    files = shared_rewriting.list_files(folder)
    config = pytester.parseconfigure()
    assert shared_rewriting.rewrite_files(config, files) == 2
    assert shared_rewriting.rewrite_files(config, files) == 0

    rewritten: list[str] = []
    rewrite = shared_rewriting.rewrite._rewrite_test

    def watch(path: Path, config: pytest.Config) -> object:
        rewritten.append(path.name)
        return rewrite(path, config)

    monkeypatch.setattr(shared_rewriting.rewrite, "_rewrite_test", watch)
    (folder / "tests" / "test_c.py").write_text(TEXT, encoding="utf-8")
    result = pytester.inline_run("-p", "no:cacheprovider", "--ignore=tests/test_faulty.py", "tests")
    result.assertoutcome(passed=3)
    assert rewritten == ["test_c.py"], "the control: pytest rewrites what isn't yet"


@pytest.mark.parametrize(
    ("arguments", "is_whole"),
    [(["tests", "rhi.conformance"], True), (["tests/meta"], False), (["rhi.conformance"], False)],
)
def test_only_a_run_of_all_tests_is_shared(arguments: list[str], is_whole: bool, tmp_path: Path) -> None:
    assert shared_rewriting.is_whole_run(arguments, tmp_path) == is_whole
    assert shared_rewriting.is_whole_run([str(tmp_path / "tests")], tmp_path)
