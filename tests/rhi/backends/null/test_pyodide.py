"""rhi in Pyodide, the Python of browsers: the null device, the shading language and the conformance kit (nightly)."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from pyodide_kit import run_in_pyodide

from rhi.conformance.plugin import has_threads

ROOT = Path(__file__).parents[4]
KIT = """
import os
import pytest
os.makedirs("/work")
os.chdir("/work")
options = ["-q", "--capture=sys", "-rs", "-p", "no:cacheprovider", "-p", "rhi_pytest", "--tb=short"]
sys.exit(int(pytest.main([*options, "--pyargs", "rhi.conformance", "--rhi-backend", "null"])))
"""


def readme_example() -> str:
    """The README's shader and its program on the null device."""
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), re.DOTALL)
    shader = next(block for block in blocks if "class Lit(" in block)
    null = next(block for block in blocks if 'create_device("null")' in block)
    return shader.partition("with rhi.create_device()")[0] + null


def test_threads_are_missing_only_where_python_lacks_them(monkeypatch: pytest.MonkeyPatch) -> None:
    assert has_threads()
    for pthreads in (False, True):
        monkeypatch.setattr(sys, "_emscripten_info", SimpleNamespace(pthreads=pthreads), raising=False)
        assert has_threads() is pthreads


@pytest.mark.nightly
def test_the_readmes_example_runs_in_pyodide() -> None:
    text = f"source = {readme_example()!r}\n"
    run = "open('/app.py', 'w').write(source)\nimport runpy\nrunpy.run_path('/app.py')\n"
    done = run_in_pyodide(text + run)
    assert done.returncode == 0, done.stdout + done.stderr
    assert re.fullmatch(r"draw\(.*count=3,.*\)  /app.py:\d+\n", done.stdout), done.stdout


@pytest.mark.nightly
def test_the_conformance_kit_passes_in_pyodide() -> None:
    """Tests that start threads are skipped, since a browser's Python has none."""
    done = run_in_pyodide(KIT)
    assert done.returncode == 0, done.stdout[-8000:] + done.stderr
    (passed,) = re.findall(r"(\d+) passed", done.stdout)
    assert int(passed) > 800
    assert "Python can't start threads here" in done.stdout


@pytest.mark.nightly
@pytest.mark.parametrize(("program", "status"), [("sys.exit(3)", 3), ("assert False", 1)])
def test_a_failure_in_pyodide_is_seen(program: str, status: int) -> None:
    assert run_in_pyodide(program).returncode == status
