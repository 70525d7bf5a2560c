"""Test files that run in processes of their own report as in one process."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from file_processes import divide

KITS = Path(__file__).parents[1] / "kits"
CONFTEST = f"""
import sys
sys.path.insert(0, {str(KITS)!r})
import file_processes, worker_errors

def pytest_addoption(parser):
    file_processes.add_options(parser)

def pytest_configure(config):
    config.pluginmanager.register(worker_errors)
    file_processes.register_side(config)
"""
ORDINARY = """
import pytest

@pytest.mark.parametrize("number", range(3))
def test_passes(number):
    pass

def test_is_skipped():
    pytest.skip("not here")

@pytest.mark.xfail(reason="never works")
def test_fails_as_expected():
    assert False

def test_fails():
    assert 1 == 2
"""
DYING = """
import os

def test_before():
    pass

def test_dies():
    os.write(2, b"last words")
    os.abort()

def test_after():
    pass
"""


def run_pytest(folder: Path, *options: str, **files: str) -> subprocess.CompletedProcess[str]:
    """Write test files and run them."""
    for name, text in ({"conftest": CONFTEST} | files).items():
        (folder / f"{name}.py").write_text(text, encoding="utf-8")
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-p",
        "no:cacheprovider",
        f"--rootdir={folder}",
        *options,
        str(folder),
    ]
    return subprocess.run(command, capture_output=True, text=True, encoding="utf-8", check=False)


def last_line(output: str) -> str:
    """Return the counts of pytest's closing line."""
    return output.strip().splitlines()[-1].strip("= ").rpartition(" in ")[0]


def test_outcomes_are_those_of_one_process(tmp_path: Path) -> None:
    alone = run_pytest(tmp_path, test_ordinary=ORDINARY)
    apart = run_pytest(tmp_path, "--file-processes", "2")
    assert last_line(apart.stdout) == last_line(alone.stdout) == "1 failed, 3 passed, 1 skipped, 1 xfailed"
    assert apart.returncode == alone.returncode == 1
    assert "assert 1 == 2" in apart.stdout


def test_options_reach_the_processes(tmp_path: Path) -> None:
    run = run_pytest(tmp_path, "--file-processes=1", "-k", "passes", test_ordinary=ORDINARY)
    assert (last_line(run.stdout), run.returncode) == ("3 passed", 0)


def test_a_process_that_dies_fails_its_test_alone(tmp_path: Path) -> None:
    run = run_pytest(tmp_path, "--file-processes", "1", test_dying=DYING, test_other="def test_other(): pass")
    assert last_line(run.stdout) == "1 failed, 3 passed"
    assert "the process ended: signal SIGABRT" in run.stdout
    assert "last words" in run.stdout


def test_a_file_that_cant_be_imported_is_an_error_and_others_run(tmp_path: Path) -> None:
    run = run_pytest(
        tmp_path,
        "--file-processes",
        "1",
        test_broken="import no_such_module",
        test_other="def test_other(): pass",
    )
    assert last_line(run.stdout) == "1 passed, 1 error"
    assert run.returncode == 1
    assert "No module named 'no_such_module'" in run.stdout


def test_without_tests_the_status_is_that_of_pytest(tmp_path: Path) -> None:
    run = run_pytest(tmp_path, "--file-processes", "1", "-k", "nothing", test_ordinary=ORDINARY)
    assert run.returncode == pytest.ExitCode.NO_TESTS_COLLECTED


def test_the_first_failure_ends_the_run_where_that_is_asked(tmp_path: Path) -> None:
    slow = "import time\ndef test_slow(): time.sleep(600)"
    run = run_pytest(
        tmp_path, "--file-processes", "2", "-x", test_ordinary=ORDINARY + "# " * 200_000, test_slow=slow
    )
    assert "1 failed" in last_line(run.stdout)
    assert "stopping after 1 failures" in run.stdout


def test_processes_end_when_the_controller_is_killed(tmp_path: Path) -> None:
    text = """
import os, pathlib, pytest, time
@pytest.mark.parametrize("number", range(600))
def test_waits(number):
    pathlib.Path(__file__).with_name("process").write_text(str(os.getpid()), encoding="utf-8")
    time.sleep(0.1)
"""
    for name, content in (("conftest", CONFTEST), ("test_waiting", text)):
        (tmp_path / f"{name}.py").write_text(content, encoding="utf-8")
    controller = subprocess.Popen(
        [sys.executable, "-m", "pytest", f"--rootdir={tmp_path}", "--file-processes", "1", str(tmp_path)],
        stdout=subprocess.DEVNULL,
    )
    number = tmp_path / "process"
    while not (number.exists() and number.read_text(encoding="utf-8")):
        assert controller.poll() is None
        time.sleep(0.05)
    process = int(number.read_text(encoding="utf-8"))
    os.kill(controller.pid, signal.SIGKILL)
    controller.wait()
    deadline = time.monotonic() + 60
    with pytest.raises(ProcessLookupError):
        while time.monotonic() < deadline:
            os.kill(process, 0)
            time.sleep(0.05)


def test_groups_have_all_files_once_and_files_of_both_kinds(tmp_path: Path) -> None:
    files = []
    for folder in ("tests", "conformance"):
        (tmp_path / folder).mkdir()
        for number in range(40):
            path = tmp_path / folder / f"test_{number}.py"
            path.write_text("#" * (1000 * number), encoding="utf-8")
            files.append(path)
    groups = list(divide(files, 2))
    assert len(groups) == 8
    assert sorted(path for group in groups for path in group) == sorted(files)
    for group in groups:
        assert {path.parent.name for path in group} == {"tests", "conformance"}
        assert sum(path.stat().st_size for path in group) < 300_000
    assert len(list(divide(files[1:3], 2))) == 2
