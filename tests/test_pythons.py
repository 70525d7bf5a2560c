"""The interface on other versions of Python and NumPy (nightly)."""

from __future__ import annotations

import sys
from itertools import product
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
sys.path.append(str(ROOT / "scripts"))

import run_on_pythons  # noqa: E402
from run_on_pythons import OLDEST_NUMPY, MissingError, find_interpreter, run_tests  # noqa: E402


def test_an_interpreter_is_looked_for_by_its_version(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setenv("PYENV_ROOT", str(tmp_path))
    assert find_interpreter("3.12") is None
    for name, version in (("3.12.1", "3.12"), ("3.12.2", "3.9"), ("3.13.0t", "3.13t"), ("3.13.0", "3.13")):
        python = tmp_path / "versions" / name / "bin" / "python"
        python.parent.mkdir(parents=True)
        python.write_text(f"#!/bin/sh\necho {version}\n", encoding="utf-8")
        python.chmod(0o755)
    for version, folder in (("3.12", "3.12.1"), ("3.13", "3.13.0"), ("3.13t", "3.13.0t")):
        assert find_interpreter(version) == str(tmp_path / "versions" / folder / "bin" / "python")
    with pytest.raises(MissingError, match=r"^Python 3\.14 isn't installed$"):
        run_tests("3.14", "newest", ())


def test_the_oldest_numpy_is_one_that_the_project_allows() -> None:
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    (lowest,) = set(OLDEST_NUMPY["3.11"].rsplit(".", 1)[:1])
    assert f'"numpy>={lowest}"' in text


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("version", "numpy"), list(product(["3.12", "3.13", "3.14", "3.14t"], ["oldest", "newest"]))
)
def test_the_interface_passes_on_other_pythons(version: str, numpy: str) -> None:
    try:
        status = run_tests(version, numpy, run_on_pythons.TESTS)
    except MissingError as missing:
        pytest.skip(str(missing))
    assert status == 0
