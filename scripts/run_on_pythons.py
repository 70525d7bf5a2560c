"""Run tests on other versions of Python and NumPy:
`python scripts/run_on_pythons.py [--python X.Y …] [--numpy oldest|newest …] [PYTEST ARGUMENT …]`.

For each version of Python above 3.11 that this machine has, and the oldest and the newest NumPy that it can have,
an environment is created in the user's cache, with the packages that the tests of the interface need. Without
arguments for pytest these run: the tests of null, shading, device and contract, the conformance kit on null, gl and
cl, and the examples. A backend whose driver is missing is skipped, as everywhere.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).resolve().parents[1]
OLDEST_NUMPY: Final = {"3.11": "1.26.0", "3.12": "1.26.0", "3.13": "2.1.0", "3.14": "2.3.2"}
"""The oldest NumPy that pyproject.toml allows and that has wheels for a version of Python."""
PACKAGES: Final = (
    "typing-extensions>=4.9",
    "moderngl>=5.12",
    "pyopencl>=2024.1",
    "pillow>=10",
    "matplotlib>=3.8",
    "imgui-bundle>=1.92",
    "rendercanvas>=2.7,<3",
    "glfw>=2.5",
    "watchfiles>=1",
    "psutil>=5",
    "pytest>=9",
    "hypothesis>=6.90",
)
TESTS: Final = (
    "tests/rhi/backends/null",
    "tests/rhi/shading",
    "tests/rhi/device",
    "tests/rhi/contract",
    "tests/examples/test_programs.py",
    *("--pyargs", "rhi.conformance"),
    *("--rhi-backend", "null", "--rhi-backend", "gl", "--rhi-backend", "cl"),
)


class MissingError(Exception):
    """An interpreter or a package that can't be had here."""


def find_interpreter(version: str) -> str | None:
    """Return the path of a CPython such as "3.12" or "3.14t", on the path or in pyenv's folder."""
    candidates = [shutil.which(f"python{version}")]
    pyenv = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
    number, free_threaded = version.removesuffix("t"), version.endswith("t")
    for folder in sorted(pyenv.glob(f"{number}.*"), reverse=True):
        if folder.name.endswith("t") == free_threaded:
            candidates.append(str(folder / "bin" / "python"))
    for candidate in filter(None, candidates):
        ask = "import sys; print('%d.%d' % sys.version_info[:2] + ('t' if 't' in sys.abiflags else ''))"
        done = subprocess.run(
            [candidate, "-c", ask], capture_output=True, text=True, encoding="utf-8", check=False
        )
        if done.stdout.strip() == version:  # a shim of pyenv may have no interpreter behind it
            return candidate
    return None


def make_environment(version: str, numpy: str) -> Path:
    """Return the interpreter of an environment with a Python and a NumPy, making it if there is none.

    Args:
        numpy: "oldest" or "newest".

    Raises:
        MissingError: the interpreter isn't there, or pip can't install the packages.
    """
    interpreter = find_interpreter(version)
    if interpreter is None:
        raise MissingError(f"Python {version} isn't installed")
    requirement = f"numpy=={OLDEST_NUMPY[version.removesuffix('t')]}" if numpy == "oldest" else "numpy"
    requirements = (requirement, *PACKAGES)
    digest = hashlib.sha256("\n".join(requirements).encode()).hexdigest()[:8]
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "rhi-tests"
    folder = cache / f"python-{version}-numpy-{numpy}-{digest}"
    python = folder / "bin" / "python"
    done = folder / "complete"
    if not done.exists():
        subprocess.run([interpreter, "-m", "venv", "--clear", folder], check=True)
        command = [
            python,
            "-m",
            "pip",
            "install",
            "--quiet",
            "--disable-pip-version-check",
            "--only-binary=:all:",
        ]
        installed = subprocess.run(
            [*command, *requirements], capture_output=True, text=True, encoding="utf-8", check=False
        )
        if installed.returncode:
            raise MissingError(
                f"pip can't install {' '.join(requirements)}: {installed.stderr.strip()[-300:]}"
            )
        done.touch()
    return python


def run_tests(version: str, numpy: str, arguments: Sequence[str]) -> int:
    """Run tests on a Python and a NumPy; return pytest's exit status.

    Raises:
        MissingError: the interpreter or a package can't be had.
    """
    python = make_environment(version, numpy)
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    environment.setdefault("RHI_KERNELS", "quick")
    environment["RHI_TESTS_WITHOUT_DRIVERS"] = "1"
    report = (
        "import sys, numpy; print(f'[pythons] Python {sys.version.split()[0]}, NumPy {numpy.__version__}')"
    )
    subprocess.run([python, "-c", report], check=True)
    command = [python, "-m", "pytest", "-p", "rhi_pytest", "-p", "no:cacheprovider", *(arguments or TESTS)]
    return subprocess.run(command, cwd=ROOT, env=environment, check=False).returncode


def main() -> int:
    """Run the tests everywhere; return 1 if they fail anywhere."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--python", nargs="+", default=[python for python in OLDEST_NUMPY if python != "3.11"]
    )
    parser.add_argument("--numpy", nargs="+", default=["oldest", "newest"], choices=["oldest", "newest"])
    options, arguments = parser.parse_known_args()
    status = 0
    for version in options.python:
        for numpy in options.numpy:
            try:
                status |= run_tests(version, numpy, arguments) != 0
            except MissingError as missing:
                print(f"[pythons] skipped: {missing}")
    return status


if __name__ == "__main__":
    sys.exit(main())
