"""Names of new projects: each is that of a module, of a distribution and of a folder, and no other has it.

A project's folder is first on Python's path while one works in it. So a module that is called as a package is
imported instead of it, and `setup.py` or `conftest.py` are run by tools that find them.
"""

from __future__ import annotations

import importlib.util
import keyword
import re
import sys
from contextlib import suppress
from importlib import metadata
from typing import Final

_MAX_LENGTH: Final = 64
_RUN_BY_TOOLS: Final = frozenset(
    {
        "setup",
        "conftest",
        "test",
        "tests",
        "build",
        "dist",
        "docs",
        "noxfile",
        "fabfile",
        "tasks",
        "manage",
        "dodo",
    }
    | {"sitecustomize", "usercustomize"}
)
"""Files and folders that build tools, test runners and Python itself find by their names."""
_DEVICES: Final = frozenset(
    {"con", "prn", "aux", "nul", *(f"{port}{i}" for port in ("com", "lpt") for i in range(10))}
)
"""Names that Windows keeps for devices."""
_OWN = """
rhi rhi_screen renderer numpy pytest py pluggy iniconfig packaging pygments setuptools pkg_resources wheel pip mypy
mypyc mypy_extensions typing_extensions ruff hypothesis attr attrs sortedcontainers xdist execnet
"""
_GRAPHICS = """
moderngl glcontext pyopencl pytools platformdirs wgpu cffi pycparser glfw rendercanvas jupyter_rfb imgui_bundle pillow
trimesh tqdm matplotlib av flip_evaluator watchfiles websockets pygame pyglet moderngl_window pyglm pyrr vispy pygfx
panda3d arcade vtk pyvista open3d sdl2
"""
_OTHERS = """
scipy pandas sympy numba cupy jax torch tensorflow sklearn skimage cv2 imageio networkx dask distributed cloudpickle
joblib requests urllib3 httpx aiohttp flask django fastapi uvicorn sqlalchemy pydantic yaml toml click rich typer six
dateutil pytz certifi idna cython nox tox coverage black flake8 pylint isort sphinx jupyter notebook ipython ipywidgets
poetry hatch hatchling flit pdm invoke
"""
_PACKAGES: Final = frozenset(f"{_OWN} {_GRAPHICS} {_OTHERS}".split())
"""Modules and distributions that a project may need, or that its tools do, whether they are installed or
not."""


def describe_fault(name: str) -> str:
    """Return the reason why a project can't have a name; "" if it can."""
    if not re.fullmatch(r"[a-z](?:[a-z0-9_]*[a-z0-9])?", name):
        return (
            "it isn't made of lower-case letters, digits and underscores, from a letter to a letter or digit"
        )
    if len(name) > _MAX_LENGTH:
        return f"it has {len(name)} letters, and {_MAX_LENGTH} are the most"
    if keyword.iskeyword(name):
        return "it is a word of Python's"
    if name in sys.stdlib_module_names:
        return "it is a module of Python's"
    if name in _RUN_BY_TOOLS:
        return "tools look for files of this name"
    if name.startswith("test_") or name.endswith("_test"):
        return "pytest would take it for a file of tests"
    if name in _DEVICES:
        return "Windows keeps it for a device"
    if name in _PACKAGES or name in _list_distributions() or _is_module(name):
        return "it is a package's"
    return ""


def _list_distributions() -> set[str]:
    """Return the names of all installed distributions and their packages, and of what this one can need."""
    names = [str(distribution.metadata["Name"] or "") for distribution in metadata.distributions()]
    names += metadata.packages_distributions()
    with suppress(metadata.PackageNotFoundError):
        names += [
            re.split(r"[^\w.-]", distribution, maxsplit=1)[0]
            for distribution in metadata.requires("rhi") or ()
        ]
    return {re.sub(r"[-_.]+", "_", name).lower() for name in names}


def _is_module(name: str) -> bool:
    """True if Python finds a module or a package of this name; a mere folder is none."""
    try:
        spec = importlib.util.find_spec(name)
    except (ImportError, ValueError):
        return True
    return spec is not None and spec.origin is not None
