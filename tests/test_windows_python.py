"""The interface on Python for Windows, under Wine (nightly)."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
sys.path.append(str(ROOT / "scripts"))

import run_on_windows  # noqa: E402
from run_on_pythons import MissingError  # noqa: E402
from run_on_windows import find_programs, run_python, run_tests, windows_path  # noqa: E402


def test_a_missing_program_is_named_with_its_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "version_info", (3, 11, 9))
    monkeypatch.setattr(shutil, "which", lambda name, path=None: None)
    with pytest.raises(MissingError, match=r"^Wine isn't installed: apt install wine64$"):
        find_programs()
    monkeypatch.setattr(shutil, "which", lambda name, path=None: "wine64" if name == "wine64" else None)
    with pytest.raises(MissingError, match=r"^MinGW isn't installed: apt install gcc-mingw"):
        find_programs()
    monkeypatch.setattr(shutil, "which", lambda name, path=None: name)
    assert find_programs() == ("wine64", "x86_64-w64-mingw32-gcc")
    monkeypatch.setattr(sys, "version_info", (3, 12, 1))
    with pytest.raises(MissingError, match=r"Python 3\.11 is needed"):
        find_programs()


def test_a_path_of_this_system_is_on_drive_z() -> None:
    assert windows_path(Path("/usr/lib")).startswith("Z:\\")


@pytest.mark.nightly
def test_the_interface_runs_on_windows() -> None:
    try:
        status, output = run_python(["-c", "import os, sys; print(os.name, sys.platform)"])
    except MissingError as missing:
        pytest.skip(str(missing))
    assert (status, output.split()[-2:]) == (0, ["nt", "win32"])
    assert run_tests(run_on_windows.TESTS) == 0
