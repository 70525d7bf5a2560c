"""Runs a night's tests in another process, and goes on with the next test when it dies.

The process that runs the tests (an attempt) and the one that supervises it share a folder:

| file | content |
|---|---|
| `begun.tsv` | a line when a test begins: seconds since the epoch, the test; and one at the night's end |
| `stacks.txt` | the stacks of all threads of an attempt in which a test took too long |
| `captured.txt` | what the running test has written to standard error |
| `errors.txt` | what was written there between tests, such as the stack of a fatal signal |
| `deaths.txt` | the report of each death: the test, the three files above, the backtrace of a core file |

A test takes too long after `_FACTOR` times what it took last, at the least after `_LEAST_LIMIT` seconds; with
a budget at the latest `_GRACE` seconds after the budget's end. Then the attempt writes its stacks and ends.

Core files need the system's leave (`ulimit -H -c`, a plain `kernel.core_pattern`), backtraces gdb. Without either, the
report says so.
"""

from __future__ import annotations

import faulthandler
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

ATTEMPT: Final = "attempt"
"""The command that runs tests in the calling process."""
ERRORS_VARIABLE: Final = "RHI_STANDARD_ERROR"
"""Names the file in which pytest captures standard error (`worker_errors`)."""
_FACTOR: Final = 8.0
_LEAST_LIMIT: Final = 300.0
_UNKNOWN_LIMIT: Final = 900.0
"""Seconds of a test that has never run to its end."""
_GRACE: Final = 60.0
_FINISHED: Final = "finished"
_MOST_BACKTRACES: Final = 8
"""Of a night. Some tests end processes on purpose."""
_LONGEST_BACKTRACE: Final = 120.0  # seconds of gdb
_CORE_PATTERN: Final = Path("/proc/sys/kernel/core_pattern")
_LIMIT_VARIABLE: Final = "RHI_NIGHT_LIMIT"  # seconds of a test, for the tests of this module


class Attempt:
    """The attempt's side: says which test runs, and ends the process if that takes too long.

    Attributes:
        options: further options of pytest.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.options = (
            [f"--basetemp={os.environ['RHI_NIGHT_TEMPORARY']}"] if "RHI_NIGHT_TEMPORARY" in os.environ else []
        )
        _allow_core_files()

    def list_begun(self) -> frozenset[str]:
        """Return the tests that have begun in this night."""
        return frozenset(test for _, test in _read_begun(self._folder))

    @contextmanager
    def limit(self, test: str, seconds: float, left: float | None) -> Iterator[None]:
        """Say that a test runs, and end the process if it takes too long.

        Args:
            seconds: how long it took last, 0 if that isn't known.
            left: seconds of the budget.
        """
        with (self._folder / "begun.tsv").open("a", encoding="utf-8") as file:
            file.write(f"{time.time():.1f}\t{test}\n")
        with (self._folder / "stacks.txt").open("w", encoding="utf-8") as stacks:
            faulthandler.dump_traceback_later(choose_limit(seconds, left), exit=True, file=stacks)
            try:
                yield
            finally:
                faulthandler.cancel_dump_traceback_later()

    def finish(self) -> None:
        """Say that this attempt has come to its end."""
        with (self._folder / "begun.tsv").open("a", encoding="utf-8") as file:
            file.write(f"{time.time():.1f}\t{_FINISHED}\n")


def choose_limit(seconds: float, left: float | None) -> float:
    """Return after how many seconds a test takes too long; see `Attempt.limit`."""
    if _LIMIT_VARIABLE in os.environ:
        return float(os.environ[_LIMIT_VARIABLE])
    limit = max(_LEAST_LIMIT, _FACTOR * seconds) if seconds else _UNKNOWN_LIMIT
    return limit if left is None else max(1.0, min(limit, left + _GRACE))


def _read_begun(folder: Path) -> list[tuple[float, str]]:
    path = folder / "begun.tsv"
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    return [(float(when), test) for when, _, test in (line.partition("\t") for line in lines)]


def _allow_core_files() -> None:
    with suppress(ImportError, ValueError, OSError):
        import resource

        _, most = resource.getrlimit(resource.RLIMIT_CORE)
        resource.setrlimit(resource.RLIMIT_CORE, (most, most))


def supervise(
    command: Sequence[str],
    rest: Sequence[str],
    folder: Path,
    budget: float | None,
    record_end: Callable[[str, float], None],
) -> int:
    """Run attempts until one comes to its end, or the budget is used up; return the exit status.

    Args:
        command: the attempt, without its folder and minutes.
        rest: the arguments of pytest.
        folder: where reports of deaths are kept; those of an earlier night are removed.
        budget: in seconds.
        record_end: called with a test in which an attempt ended, and its seconds.
    """
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    until = None if budget is None else time.monotonic() + budget
    temporary = Path(tempfile.mkdtemp(prefix="rhi-night-"))
    deaths = 0
    try:
        while True:
            left = None if until is None else until - time.monotonic()
            if left is not None and left <= 0:
                return 1
            begun = len(_read_begun(folder))
            options = ["--folder", str(folder), *([] if left is None else ["--minutes", f"{left / 60:.3f}"])]
            status = _run([*command, *options, *rest], folder, temporary)
            tests = _read_begun(folder)
            if tests[begun:] and tests[-1][1] == _FINISHED:
                print(read_end(folder / "errors.txt"), file=sys.stderr, end="", flush=True)
                return max(status, 1) if deaths else status
            if not tests[begun:]:
                print(
                    read_end(folder / "errors.txt"),
                    f"no test began: status {status}",
                    sep="\n",
                    file=sys.stderr,
                )
                return max(status, 1)
            deaths += 1
            when, test = tests[-1]
            record_end(test, time.time() - when)
            report = _report(test, status, folder, temporary)
            with (folder / "deaths.txt").open("a", encoding="utf-8") as file:
                file.write(report)
            print(report, file=sys.stderr, flush=True)
    finally:
        _keep_backtraces(folder, temporary)
        shutil.rmtree(temporary, ignore_errors=True)


def _run(command: Sequence[str], folder: Path, temporary: Path) -> int:
    """Run an attempt; end what it leaves behind, and return its exit status."""
    environment = os.environ | {
        ERRORS_VARIABLE: str(folder / "captured.txt"),
        "RHI_NIGHT_TEMPORARY": str(temporary / "tests"),
    }
    for name in ("captured.txt", "stacks.txt"):
        (folder / name).unlink(missing_ok=True)
    with (folder / "errors.txt").open("wb") as errors:
        process = subprocess.Popen(command, env=environment, stderr=errors, start_new_session=True)
        try:
            return process.wait()
        except KeyboardInterrupt:
            process.send_signal(signal.SIGINT)
            process.wait()
            raise
        finally:
            end_processes(process)


def end_processes(process: subprocess.Popen[bytes]) -> None:
    """Kill a process that leads a session, and those that it has started and left behind."""
    if hasattr(os, "killpg"):
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)
    else:
        process.kill()
    process.wait()


def _report(test: str, status: int, folder: Path, temporary: Path) -> str:
    """Return the report of an attempt that ended in a test."""
    stacks = read_end(folder / "stacks.txt")
    cause = "took too long" if stacks else f"ended the process: {name_status(status)}"
    parts = [f"-- {test} {cause}"]
    for title, text in (
        ("stacks", stacks),
        ("standard error of the test", read_end(folder / "captured.txt")),
        ("standard error", read_end(folder / "errors.txt")),
        ("backtrace", "" if stacks else _keep_backtraces(folder, temporary)),
    ):
        parts.append(f"-- {title}\n{text.rstrip() or 'nothing'}")
    return "\n".join(parts) + "\n\n"


def name_status(status: int) -> str:
    """Return a process's exit status in words."""
    try:
        return f"signal {signal.Signals(-status).name}" if status < 0 else f"status {status}"
    except ValueError:
        return f"status {status}"


def read_end(path: Path) -> str:
    """Return the last 20,000 characters of a file, an empty text if there is none."""
    return path.read_text(encoding="utf-8", errors="replace")[-20_000:] if path.exists() else ""


# -- core files ----------------------------------------------------------------------------------------------


def _keep_backtraces(folder: Path, temporary: Path) -> str:
    """Turn core files into backtraces in the folder, and remove them; return the backtraces, or why there are
    none."""
    cores = [path for path in (*Path.cwd().glob("core*"), *temporary.rglob("core*")) if is_core(path)]
    backtraces = []
    for path in _claim_files(cores, temporary / "cores"):
        count = len(list(folder.glob("backtrace-*.txt")))
        if count < _MOST_BACKTRACES:
            begun = [test for when, test in _read_begun(folder) if when <= path.stat().st_mtime]
            text = read_backtrace(path)
            backtraces.append(text)
            title = f"{path}, during {begun[-1] if begun else 'the start'}\n"
            (folder / f"backtrace-{count + 1}.txt").write_text(title + text, encoding="utf-8")
        path.unlink()
    return "\n".join(backtraces) or _explain_no_core()


def _claim_files(paths: Iterable[Path], folder: Path) -> list[Path]:
    """Move files to a folder, but for those that a process of the same night beside this one has taken."""
    folder.mkdir(exist_ok=True)
    claimed = []
    for number, path in enumerate(paths, len(list(folder.iterdir()))):
        with suppress(FileNotFoundError):
            claimed.append(Path(shutil.move(path, folder / f"{number}-{path.name}")))
    return claimed


def is_core(path: Path) -> bool:
    """True if a file is the core file of a process."""
    try:
        with path.open("rb") as file:
            head = file.read(18)
    except OSError:
        return False
    return head[:4] == b"\x7fELF" and head[16:18] in (b"\x04\0", b"\0\x04")


def read_backtrace(core: Path) -> str:
    """Return the backtraces of all threads of a core file, made by gdb."""
    gdb = shutil.which("gdb")
    if gdb is None:
        return f"{core}: no backtrace, since gdb isn't installed"
    command = [gdb, "-nx", "-batch", "-ex", "thread apply all backtrace 40", sys.executable, str(core)]
    try:
        done = subprocess.run(
            command,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=_LONGEST_BACKTRACE,
            check=False,
            encoding="utf-8",
        )
    except subprocess.TimeoutExpired:
        return f"{core}: gdb took longer than {_LONGEST_BACKTRACE:.0f} s"
    return done.stdout


def _explain_no_core() -> str:
    try:
        import resource

        if resource.getrlimit(resource.RLIMIT_CORE)[1] == 0:
            return "no core file: ulimit -H -c is 0"
        pattern = _CORE_PATTERN.read_text(encoding="utf-8").strip()
    except (ImportError, OSError):
        return "no core file: this system has none"
    return f"no core file: kernel.core_pattern is {pattern!r}"
