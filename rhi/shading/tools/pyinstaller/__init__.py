"""Instructions for PyInstaller: a program that imports `rhi` gets all backends, their kernels, and the
sources of shaders, without an option. `docs/errors.md` says what a program's own shaders need.
"""

from __future__ import annotations

from pathlib import Path


def hook_directories() -> list[str]:
    """Return the folder of the hook; PyInstaller calls this, by the entry point `hook-dirs`."""
    return [str(Path(__file__).parent)]
