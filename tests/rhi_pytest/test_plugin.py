"""The pytest plugin costs nothing where no test uses it, and gives devices where one does."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
OPTIONS = (
    "-q",
    "-p",
    "no:cacheprovider",
    "-p",
    "no:rhi.conformance.plugin",
    "-p",
    "rhi_pytest",
    "-c",
    os.devnull,
)
REPORT = "import sys\ndef test_imports():\n    print('rhi' in sys.modules, 'numpy' in sys.modules)\n"


def run_pytest(
    folder: Path, test: str, *options: str, **environment: str
) -> subprocess.CompletedProcess[str]:
    """Run a test file with the plugin in a process of its own."""
    (folder / "test_it.py").write_text(test, "utf-8")
    variables = {name: value for name, value in os.environ.items() if name != "RHI_BACKEND"}
    return subprocess.run(
        [sys.executable, "-m", "pytest", *OPTIONS, "-s", *options, "test_it.py"],
        cwd=folder,
        env=variables | {"PYTHONPATH": str(ROOT)} | environment,
        capture_output=True,
        text=True,
        encoding="utf-8",
    )


def test_tests_without_a_fixture_import_neither_rhi_nor_numpy(tmp_path: Path) -> None:
    run = run_pytest(tmp_path, REPORT)
    assert "False False" in run.stdout, run.stdout + run.stderr


def test_a_fixture_imports_rhi(tmp_path: Path) -> None:
    run = run_pytest(tmp_path, REPORT.replace("test_imports()", "test_imports(null_device)"))
    assert "True True" in run.stdout, run.stdout + run.stderr


def test_the_stream_is_that_of_the_null_device(tmp_path: Path) -> None:
    test = "def test_it(null_device, command_stream):\n    assert command_stream is null_device.stream\n"
    run = run_pytest(tmp_path, test)
    assert "1 passed" in run.stdout, run.stdout + run.stderr


def test_a_test_runs_once_on_each_backend_named(tmp_path: Path) -> None:
    test = "def test_it(rhi_device):\n    print('on', rhi_device.backend_name)\n"
    run = run_pytest(tmp_path, test, "--rhi-backend", "null", "--rhi-backend", "null")
    assert run.stdout.count("on null") == 1, run.stdout + run.stderr


def test_an_unknown_backend_stops_the_run_with_one_line(tmp_path: Path) -> None:
    run = run_pytest(tmp_path, REPORT, "--rhi-backend", "vulcan")
    assert run.returncode == 4
    assert "--rhi-backend: there is no backend 'vulcan'" in run.stderr, run.stdout + run.stderr


def test_an_unknown_backend_of_the_environment_matters_to_tests_on_it_only(tmp_path: Path) -> None:
    assert run_pytest(tmp_path, REPORT, RHI_BACKEND="vulcan").returncode == 0
    run = run_pytest(tmp_path, "def test_it(rhi_device): ...\n", RHI_BACKEND="vulcan")
    assert run.returncode == 4
    assert "RHI_BACKEND: there is no backend 'vulcan'" in run.stderr, run.stdout + run.stderr
