"""Run tests on Python for Windows under Wine: `python scripts/run_on_windows.py [PYTEST ARGUMENT …]`.

The interpreter is assembled in the user's cache from packages of PyPI and Debian. CPython's libraries for Windows are
part of Panda3D's wheel, the standard library is that of the running Python, and MinGW compiles a `python.exe` of six
lines. Without arguments for pytest the tests of the null device, the shading language, contract, traces, commands and
examples run, and the conformance kit on null. No driver runs: Wine has neither OpenGL 4.5 without a screen nor OpenCL.

Debian's packages: `apt install wine64 gcc-mingw-w64-x86-64-win32`.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Final

from run_on_pythons import ROOT, MissingError

PYTHON_WHEEL: Final = "panda3d==1.10.16"
"""A wheel whose folder `deploy_libs` holds CPython 3.11 for Windows, to be packed with games."""
PACKAGES: Final = (
    "numpy==1.26.4",  # NumPy 2 calls `crealf`, which the C library of Wine 8 lacks
    "typing-extensions>=4.9",
    "moderngl>=5.12",  # the tests import it; it draws nothing under Wine without a screen
    "pyopencl>=2024.1",
    "pillow>=10",
    "matplotlib>=3.8,<3.11",
    "imgui-bundle>=1.92",
    "rendercanvas>=2.7,<3",
    "glfw>=2.5",
    "psutil>=5",
    "pytest>=9",
    "hypothesis>=6.90",
    "colorama>=0.4",  # pytest asks for it on Windows alone, and pip evaluates that for the running system
)
LAUNCHER: Final = """\
#include <windows.h>
typedef int (*main_function)(int, wchar_t **);
int wmain(int count, wchar_t **arguments) {
    HMODULE library = LoadLibraryW(L"python311.dll");
    return library ? ((main_function)GetProcAddress(library, "Py_Main"))(count, arguments) : 90;
}
"""
TESTS: Final = (
    "tests/rhi/backends/null",
    "tests/rhi/shading",
    "tests/rhi/contract",
    "tests/rhi/commands",
    "tests/rhi/trace",
    "tests/examples/test_programs.py",
    # The draw lists that imgui-bundle returns there are of another class, on any backend.
    *("--deselect", "tests/examples/test_programs.py::test_a_program_draws_as_often_as_it_must[boids]"),
    *("--pyargs", "rhi.conformance", "--rhi-backend", "null"),
)


def find_programs() -> tuple[str, str]:
    """Return the paths of Wine and of a C compiler for Windows.

    Raises:
        MissingError: one of them isn't installed, or the running Python isn't 3.11.
    """
    if sys.version_info[:2] != (3, 11):
        raise MissingError("The standard library of Python 3.11 is needed, and this is another Python")
    wine = shutil.which("wine64") or shutil.which("wine64", path="/usr/lib/wine")
    if wine is None:
        raise MissingError("Wine isn't installed: apt install wine64")
    compiler = shutil.which("x86_64-w64-mingw32-gcc")
    if compiler is None:
        raise MissingError("MinGW isn't installed: apt install gcc-mingw-w64-x86-64-win32")
    return wine, compiler


def download(requirements: Iterable[str], folder: Path) -> None:
    """Download wheels for Windows, with all that they depend on, into a folder.

    Raises:
        MissingError: pip can't find one of them.
    """
    command = [
        sys.executable,
        "-m",
        "pip",
        "download",
        "--quiet",
        "--disable-pip-version-check",
        "--dest",
        folder,
    ]
    command += ["--platform", "win_amd64", "--python-version", "3.11", "--only-binary=:all:"]
    done = subprocess.run(
        [*command, *requirements], capture_output=True, text=True, encoding="utf-8", check=False
    )
    if done.returncode:
        raise MissingError(f"pip can't download {' '.join(requirements)}: {done.stderr.strip()[-300:]}")


def assemble_python(folder: Path, compiler: str) -> None:
    """Assemble Python for Windows in an empty folder: `python.exe`, its libraries and packages."""
    wheels = folder / "wheels"
    download([PYTHON_WHEEL, "--no-deps"], wheels)
    (wheel,) = wheels.glob("panda3d-*.whl")
    with zipfile.ZipFile(wheel) as archive:
        for name in archive.namelist():
            if name.startswith("deploy_libs/"):
                (folder / Path(name).name).write_bytes(archive.read(name))
    wheel.unlink()
    standard = Path(sysconfig.get_path("stdlib"))
    ignored = shutil.ignore_patterns(
        "site-packages", "__pycache__", "test", "lib-dynload", "config-*", "idlelib"
    )
    shutil.copytree(standard, folder / "Lib", ignore=ignored)
    finder = folder / "Lib" / "importlib" / "metadata" / "__init__.py"
    text = finder.read_text(encoding="utf-8")  # the library is 3.11.9's, where this became a class method
    mended = re.sub(r"(?<!@classmethod)\n    def invalidate_caches\(cls\)", "\n    @classmethod\\g<0>", text)
    finder.write_text(mended, encoding="utf-8")
    download(PACKAGES, wheels)
    for wheel in wheels.glob("*.whl"):
        with zipfile.ZipFile(wheel) as archive:
            archive.extractall(folder / "Lib" / "site-packages")
    shutil.rmtree(wheels)
    source = folder / "python.c"
    source.write_text(LAUNCHER, encoding="utf-8")
    subprocess.run([compiler, "-municode", "-O1", "-o", folder / "python.exe", source], check=True)


def make_environment() -> tuple[Path, dict[str, str]]:
    """Return a folder with Python for Windows, and the variables that Wine needs; both are made once.

    Raises:
        MissingError: a program or package can't be had.
    """
    wine, compiler = find_programs()
    recipe = Path(__file__).read_bytes() + sys.version.encode()
    digest = hashlib.sha256(recipe).hexdigest()[:8]
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "rhi-tests"
    folder = cache / f"windows-{digest}"
    if not (folder / "python.exe").exists():
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        assemble_python(folder, compiler)
    variables = {
        **os.environ,
        "WINEPREFIX": str(folder / "prefix"),
        "WINEARCH": "win64",
        "WINEDEBUG": "-all",
        "DISPLAY": "",
        "RHI_TESTS_WITHOUT_DRIVERS": "1",
        "PYTHONHOME": windows_path(folder),
        "PYTHONPATH": windows_path(ROOT),
        "PYTHONDONTWRITEBYTECODE": "1",
        "PATH": os.pathsep.join((str(Path(wine).parent), os.environ.get("PATH", ""))),
    }
    return folder, variables


def windows_path(path: Path) -> str:
    """Return the path of a file of this system as Windows programs under Wine write it."""
    return "Z:" + str(path.resolve()).replace("/", "\\")


def run_python(arguments: Sequence[str], echo: bool = False) -> tuple[int, str]:
    """Run Python for Windows in the project's folder; return its exit status, and what it wrote to both streams.

    Args:
        echo: print each line as it comes.

    Raises:
        MissingError: a program or package can't be had.
    """
    folder, variables = make_environment()
    process = subprocess.Popen(
        ["wine64", str(folder / "python.exe"), *arguments],
        cwd=ROOT,
        env=variables,
        stdin=subprocess.DEVNULL,  # Wine's console waits for a terminal that listens
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        encoding="cp1252",  # of the locale, which Python for Windows writes into pipes
        errors="replace",
    )
    lines = []
    with process:
        assert process.stdout is not None
        for line in process.stdout:
            lines.append(line)
            if echo:
                print(line, end="", flush=True)
    return process.returncode, "".join(lines)


def run_tests(arguments: Sequence[str]) -> int:
    """Run tests on Windows and print their report; return pytest's exit status.

    Raises:
        MissingError: a program or package can't be had.
    """
    options = ["-m", "pytest", "-q", "-p", "rhi_pytest", "-p", "no:cacheprovider", "--tb=short"]
    return run_python([*options, *(arguments or TESTS)], echo=True)[0]


def main() -> int:
    """Run the tests that the command line names; return pytest's exit status, 0 where Wine is missing."""
    try:
        return run_tests(sys.argv[1:])
    except MissingError as missing:
        print(f"[windows] skipped: {missing}")
        return 0


if __name__ == "__main__":
    sys.exit(main())
