"""rhi in Pyodide, the Python of browsers: the null device, the shading language and the conformance kit (nightly)."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from web_kit import require_node, run_in_node, run_kit, run_program

from rhi.conformance.plugin import has_threads

ROOT = Path(__file__).parents[4]


def readme_example() -> str:
    """The README's shader and its program on the null device."""
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), re.DOTALL)
    shader = next(block for block in blocks if "class Triangle(" in block)
    null = next(block for block in blocks if 'create_device("null")' in block)
    return shader.partition("with rhi.create_device()")[0] + null


def test_threads_are_missing_only_where_python_lacks_them(monkeypatch: pytest.MonkeyPatch) -> None:
    assert has_threads()
    for pthreads in (False, True):
        monkeypatch.setattr(sys, "_emscripten_info", SimpleNamespace(pthreads=pthreads), raising=False)
        assert has_threads() is pthreads


@pytest.mark.nightly
def test_the_readmes_example_runs_in_pyodide(tmp_path: Path) -> None:
    require_node(gpu=False)
    output = run_program(readme_example(), tmp_path, gpu=False)
    assert re.fullmatch(r"draw\(.*count=3,.*\)  /host\S*/program.py:\d+\n", output), output


@pytest.mark.nightly
def test_the_conformance_kit_passes_in_pyodide() -> None:
    """Tests that start threads are skipped, since a browser's Python has none."""
    require_node(gpu=False)
    done = run_kit("null", gpu=False)
    assert done.returncode == 0, done.stdout[-8000:] + done.stderr
    (passed,) = re.findall(r"(\d+) passed, ", done.stdout)
    assert int(passed) > 800
    assert "Python can't start threads here" in done.stdout


@pytest.mark.nightly
@pytest.mark.parametrize(("program", "status"), [("import sys\nsys.exit(3)", 3), ("assert False", 1)])
def test_a_failure_in_pyodide_is_seen(program: str, status: int, tmp_path: Path) -> None:
    require_node(gpu=False)
    (tmp_path / "program.py").write_text(program, encoding="utf-8")
    assert run_in_node.run(tmp_path / "program.py", gpu=False, capture=True).returncode == status


_INSTALLED = """
import json, sys
import micropip

sys.path[:] = [path for path in sys.path if not path.startswith("/host")]
for wheel in sys.argv[1:]:
    await micropip.install(f"emfs:/host{wheel}")
import rhi, rhi.shading, rhi_screen, renderer
loaded = {name.partition(".")[0] for name in sys.modules}
with rhi.create_device("null") as device:
    device.buffer(16)
print(json.dumps([rhi.__file__, sorted(loaded & {"trimesh", "PIL", "moderngl", "pyopencl", "multiprocessing"})]))
"""


@pytest.mark.nightly
def test_the_wheel_is_installed_by_micropip_and_needs_no_driver(tmp_path: Path) -> None:
    require_node(gpu=False)
    wheels = tmp_path / "wheels"
    pip = [sys.executable, "-m", "pip", "--quiet"]
    source = tmp_path / "source"
    shutil.copytree(
        ROOT, source, ignore=shutil.ignore_patterns(".venv", ".git", "out", "build", "*.egg-info")
    )
    for command in (
        [*pip, "wheel", "--no-deps", "-w", str(wheels), str(source)],
        [*pip, "download", "--no-deps", "-d", str(wheels), "typing-extensions==4.15.0"],
    ):
        done = subprocess.run(command, capture_output=True, text=True, check=False, encoding="utf-8")
        if done.returncode:
            pytest.skip(f"the wheel can't be built or had: {done.stderr.strip()[-300:]}")
    (rhi_wheel,) = wheels.glob("rhi-*.whl")
    assert rhi_wheel.name.endswith("-py3-none-any.whl")
    (typing_wheel,) = wheels.glob("typing_extensions-*.whl")
    output = run_program(
        _INSTALLED, tmp_path, str(typing_wheel), str(rhi_wheel), gpu=False, packages=("numpy", "micropip")
    )
    file, drivers = json.loads(output.strip().splitlines()[-1])
    assert file.endswith("site-packages/rhi/__init__.py")
    assert drivers == []
