"""Without the packages of an extra each command ends in one line that names what to install."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from rhi.testing.projects import write_project

HIDE = """
import importlib.abc, runpy, sys
hidden, sys.argv = sys.argv[1].split(","), sys.argv[2:]
class Hide(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in hidden:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Hide())
if sys.argv[0].endswith(".py"):
    runpy.run_path(sys.argv[0], run_name="__main__")
else:
    runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)
"""


def run(hidden: str, *command: str) -> tuple[int, str, str]:
    """Run a module or a file in a process that has none of these packages."""
    done = subprocess.run(
        [sys.executable, "-c", HIDE, hidden, *command],
        capture_output=True,
        text=True,
        check=False,
        timeout=100,
        encoding="utf-8",
    )
    return done.returncode, done.stdout, done.stderr


@pytest.mark.parametrize("hidden", ["PIL", "tqdm", "PIL,tqdm,matplotlib,trimesh,rendercanvas,imgui_bundle"])
def test_the_renderers_help_needs_no_extra(hidden: str) -> None:
    code, out, err = run(hidden, "renderer", "--help")
    assert (code, err) == (0, "")
    assert "view" in out


@pytest.mark.parametrize(
    "hidden", ["PIL,rendercanvas", "rendercanvas", "PIL,tqdm,rendercanvas,imgui_bundle,glfw"]
)
def test_the_viewer_names_all_that_it_needs_at_once(hidden: str) -> None:
    code, _, err = run(hidden, "renderer", "view", "city", "--backend", "null")
    assert code == 2
    assert len(err.splitlines()) == 1
    assert err.startswith("error: ")
    assert "rhi[viewer]" in err  # which has what rhi[renderer] has


def test_the_kit_needs_pytest() -> None:
    assert run("pytest,_pytest", "rhi.conformance") == (
        2,
        "",
        "error: pytest is missing; install it with: pip install pytest\n",
    )


def test_the_kit_runs_as_a_module() -> None:
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "rhi.conformance",
            "--rhi-backend",
            "null",
            "-q",
            "-k",
            "nothing_of_this_name",
        ],
        capture_output=True,
        text=True,
        check=False,
        encoding="utf-8",
    )
    assert done.returncode == 5, done.stderr  # no test was collected


PLOT = """
import rhi
from rhi.backends.null import SimulatedBackend, Simulation
with rhi.create_device("null", simulation=Simulation()) as device:
    device.present()
    device.backend_as(SimulatedBackend).timeline.plot("timeline.png")
"""


def test_a_timelines_plot_needs_matplotlib(tmp_path: Path) -> None:
    file = tmp_path / "program.py"
    file.write_text(PLOT, encoding="utf-8")
    code, _, err = run("matplotlib", str(file))
    assert code == 1
    lines = err.rstrip().splitlines()
    assert "[plot-library] plots need a library" in err
    assert 'pip install "rhi[renderer]"' in lines[-1]


@pytest.mark.parametrize("kind", ["game", "tool"])
@pytest.mark.parametrize("hidden", ["imgui_bundle", "imgui_bundle,rendercanvas,glfw"])
def test_a_generated_program_says_how_to_install_it(kind: str, hidden: str, tmp_path: Path) -> None:
    root = write_project(kind, "paint", tmp_path)
    code, _, err = run(hidden, str(root / "paint.py"))
    assert code == 1
    assert err == "error: imgui_bundle is missing; install it with: pip install --editable .\n"
