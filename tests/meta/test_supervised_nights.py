"""A night goes on when a test ends the process or never ends, and keeps what there is to explain it."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest
from nights import read_record
from supervised_nights import choose_limit, is_core, read_backtrace, supervise

KITS = Path(__file__).parents[1] / "kits"
CONFTEST = f"""
import sys
from hypothesis import settings
sys.path.insert(0, {str(KITS)!r})
pytest_plugins = ["worker_errors"]
settings.register_profile("nightly")
"""
TESTS = """
import os, pytest, time
pytestmark = pytest.mark.nightly

def test_first(): pass

def test_ends():
    os.write(2, b"last words of a driver\\n")
    {end}

def test_last(): pass
"""


def run(folder: Path, end: str, *options: str, seconds: float = 60.0) -> subprocess.CompletedProcess[str]:
    (folder / "pytest.ini").write_text("[pytest]\nmarkers = nightly: takes long", encoding="utf-8")
    (folder / "conftest.py").write_text(CONFTEST, encoding="utf-8")
    (folder / "test_some.py").write_text(TESTS.format(end=end), encoding="utf-8")
    command = [
        sys.executable,
        str(KITS / "nights.py"),
        "--record",
        "record.tsv",
        "run",
        "--folder",
        "reports",
    ]
    command += [*options, "-p", "no:cacheprovider", "test_some.py"]
    environment = os.environ | {"RHI_NIGHT_LIMIT": f"{seconds}", "PYTHONPATH": str(KITS)}
    return subprocess.run(
        command,
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
        encoding="utf-8",
    )


def outcomes(folder: Path) -> dict[str, str]:
    record = read_record(folder / "record.tsv")
    return {test.partition("::")[2]: row.outcome for test, row in record.items()}


def test_a_night_goes_on_after_a_test_that_aborts(tmp_path: Path) -> None:
    done = run(tmp_path, "os.abort()")
    assert done.returncode == 1
    assert outcomes(tmp_path) == {"test_first": "passed", "test_ends": "started", "test_last": "passed"}
    assert not list(tmp_path.glob("core*"))


def test_a_death_is_reported_with_its_signal_output_and_stack(tmp_path: Path) -> None:
    done = run(tmp_path, "os.abort()")
    report = (tmp_path / "reports" / "deaths.txt").read_text(encoding="utf-8")
    assert report in done.stderr
    assert "test_some.py::test_ends ended the process: signal SIGABRT" in report
    assert "last words of a driver" in report
    assert "Fatal Python error: Aborted" in report


def test_the_next_night_removes_the_report_of_a_death_that_is_mended(tmp_path: Path) -> None:
    run(tmp_path, "os.abort()")
    assert (tmp_path / "reports" / "deaths.txt").exists()
    again = run(tmp_path, "pass")
    assert again.returncode == 0, again.stderr
    assert set(outcomes(tmp_path).values()) == {"passed"}
    assert not (tmp_path / "reports" / "deaths.txt").exists()


def test_a_test_that_never_ends_is_ended_with_its_stack(tmp_path: Path) -> None:
    begun = time.monotonic()
    done = run(tmp_path, "time.sleep(600)", seconds=3.0)
    assert time.monotonic() - begun < 200.0
    assert done.returncode == 1
    assert outcomes(tmp_path) == {"test_first": "passed", "test_ends": "started", "test_last": "passed"}
    assert 2.9 < read_record(tmp_path / "record.tsv")["test_some.py::test_ends"].seconds < 60.0  # rounded
    report = (tmp_path / "reports" / "deaths.txt").read_text(encoding="utf-8")
    assert "test_some.py::test_ends took too long" in report
    assert "last words of a driver" in report
    assert 'test_some.py", line 9 in test_ends' in report


def test_a_process_that_a_test_leaves_is_ended_too(tmp_path: Path) -> None:
    (tmp_path / "child.py").write_text("import time\ntime.sleep(60)", encoding="utf-8")
    child = "import subprocess, sys; print(subprocess.Popen([sys.executable, 'child.py']).pid, file=open('pid', 'w'))"
    run(tmp_path, f"{child}; os._exit(3)")
    number = int((tmp_path / "pid").read_text(encoding="utf-8"))
    until = time.monotonic() + 20.0
    while Path(f"/proc/{number}/cmdline").exists() and time.monotonic() < until:
        if not Path(f"/proc/{number}/cmdline").read_bytes():  # it waits for init to note its end
            break
        time.sleep(0.1)
    else:
        assert not Path(f"/proc/{number}").exists()


def test_a_failure_is_no_death(tmp_path: Path) -> None:
    """The control: the night ends as pytest does, in one process."""
    done = run(tmp_path, "assert False")
    assert done.returncode == 1
    assert outcomes(tmp_path) == {"test_first": "passed", "test_ends": "failed", "test_last": "passed"}
    assert not (tmp_path / "reports" / "deaths.txt").exists()
    assert done.stdout.count("test session starts") + done.stdout.count("1 failed") >= 1


def test_processes_side_by_side_run_each_test_once_and_report_their_deaths(tmp_path: Path) -> None:
    done = run(tmp_path, "os.abort()", "--processes", "2")
    assert done.returncode != 0
    assert outcomes(tmp_path) == {"test_first": "passed", "test_ends": "started", "test_last": "passed"}
    begun = [path.read_text(encoding="utf-8") for path in tmp_path.glob("reports/process-*/begun.tsv")]
    assert sum(text.count("::") for text in begun) == 3
    assert all("::" in text for text in begun), "both have tests"
    (report,) = tmp_path.glob("reports/process-*/deaths.txt")
    assert "SIGABRT" in report.read_text(encoding="utf-8")


@pytest.mark.nightly
def test_processes_side_by_side_pass_though_some_have_no_tests(tmp_path: Path) -> None:
    assert run(tmp_path, "pass", "--processes", "4").returncode == 0
    assert set(outcomes(tmp_path).values()) == {"passed"}


def test_a_night_in_which_nothing_can_begin_ends(tmp_path: Path) -> None:
    done = run(tmp_path, "pass", "--no-such-option")
    assert done.returncode != 0
    assert "no test began" in done.stderr
    assert "--no-such-option" in done.stderr


def test_a_budget_is_shared_by_the_processes_of_a_night(tmp_path: Path) -> None:
    """Each dies in a test after half a second, and is given what is left."""
    text = """
import sys, time, os
folder, minutes = sys.argv[sys.argv.index("--folder") + 1], float(sys.argv[sys.argv.index("--minutes") + 1])
with open(folder + "/begun.tsv", "a") as file:
    file.write(f"{time.time()}\\t{minutes}\\n")
time.sleep(0.5)
os.abort()
"""
    ends: list[str] = []
    status = supervise(
        [sys.executable, "-c", text], [], tmp_path / "reports", 2.0, lambda test, seconds: ends.append(test)
    )
    assert status == 1
    minutes = [float(end) for end in ends]
    assert 1 <= len(minutes) <= 4
    assert minutes == sorted(minutes, reverse=True)
    assert all(0.0 <= end <= 2.0 / 60 for end in minutes)


@pytest.mark.parametrize(
    ("seconds", "left", "limit"),
    [(0.0, None, 900.0), (10.0, None, 300.0), (100.0, None, 800.0), (100.0, 200.0, 260.0), (0.0, -80.0, 1.0)],
)
def test_a_limit_follows_the_last_run_and_the_budget(
    seconds: float, left: float | None, limit: float
) -> None:
    assert choose_limit(seconds, left) == limit


def test_a_core_file_becomes_a_backtrace(tmp_path: Path) -> None:
    """Of a process that aborts on purpose, in a library's thread as drivers do."""
    resource = pytest.importorskip("resource")
    if shutil.which("gdb") is None:
        pytest.skip("gdb isn't installed")
    text = """
import ctypes, os, resource, threading
most = resource.getrlimit(resource.RLIMIT_CORE)[1]
resource.setrlimit(resource.RLIMIT_CORE, (most, most))
thread = threading.Thread(target=ctypes.CDLL(None).abort)
thread.start()
thread.join()
"""
    done = subprocess.run([sys.executable, "-c", text], cwd=tmp_path, check=False)
    assert done.returncode == -6
    cores = [path for path in tmp_path.iterdir() if is_core(path)]
    if not cores:
        pytest.skip(f"no core files here: limit {resource.getrlimit(resource.RLIMIT_CORE)}")
    backtrace = read_backtrace(cores[0])
    assert "abort" in backtrace
    assert backtrace.count("Thread ") >= 2
    (tmp_path / "core.txt").write_text("no core", encoding="utf-8")
    assert not is_core(tmp_path / "core.txt")
