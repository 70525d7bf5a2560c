"""The renderer and its viewer work without the lab: only commands import it."""

from __future__ import annotations

import pkgutil
import subprocess
import sys
from typing import Final

import renderer

PROGRAM: Final = """
import importlib, sys
sys.modules["renderer.lab"] = None  # importing it raises ImportError
for name in sys.argv[1:]:
    importlib.import_module(name)
"""
EXCLUDED: Final = ("renderer.cli", "renderer.lab", "renderer.__main__")


def list_modules() -> list[str]:
    """The names of all modules of the renderer but those of commands and of the lab."""
    names = [module.name for module in pkgutil.walk_packages(renderer.__path__, "renderer.")]
    return [name for name in names if not f"{name}.".startswith(tuple(f"{prefix}." for prefix in EXCLUDED))]


def test_every_module_but_the_commands_imports_without_the_lab() -> None:
    names = list_modules()
    assert {"renderer.viewer.viewer", "renderer.inspection.texture_images", "renderer.renderer"} <= set(names)
    run = subprocess.run(
        [sys.executable, "-c", PROGRAM, *names], capture_output=True, text=True, check=False, encoding="utf-8"
    )
    assert run.returncode == 0, run.stderr
