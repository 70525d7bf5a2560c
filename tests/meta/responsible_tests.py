"""The tests that are responsible for a file, and those to run for the differences from another commit.

    python tests/meta/responsible_tests.py [--base REV]

prints the arguments of pytest for the files that differ from a commit, one a line; `test.sh --changed` passes
them on. By default that commit is where the branch left `main`; on `main` itself it is the last commit.

| changed file | tests |
|---|---|
| a module of the product | those named after it, and the files of its folder and elsewhere that use it most |
| a module of the product that hardly any test of its folder names | its folder, if that is small |
| a module named as its package | its folder, if that is small |
| a module of a backend | also the conformance kit on that backend |
| a part of the shading language | also the kit's tests of the language, on the devices that it is written for |
| a test file, or one of the kit | itself |
| a module that tests share | the test files that import it |
| a page | the tests of the documentation |
| any other file | those of the modules that name it |

`random_faults` tries its faults against the same tests first, then against wider ones.
"""

from __future__ import annotations

import argparse
import ast
import re
import subprocess
from collections import Counter
from collections.abc import Iterable
from functools import cache
from pathlib import Path, PurePosixPath
from typing import Final

ROOT: Final = Path(__file__).resolve().parents[2]
_KITS: Final = {"cl": "cl", "gl": "gl", "null": "null", "wgpu": "wgpu", "webgpu": "wgpu"}
"""The backend on which the kit examines the modules of a folder of `rhi/backends`. `web` needs a page."""

_MAX_USERS: Final = 8
"""Of the files of tests elsewhere that use a module, so many are run."""

_MAX_FOLDER: Final = 60
"""A folder of tests with more files is not run as a whole."""

_LANGUAGE: Final = "rhi/conformance/operation/test_language.py"
_DEVICES_OF_LANGUAGES: Final = {"glsl": ["gl"], "opencl": ["cl"], "numpy": ["null"], "wgsl": ["wgpu"]}
_DEVICES_OF_PARSER: Final = ["gl", "null"]

_EXAM: Final = "tests/renderer/lab/exam/test_cases.py"

_MEASURING: Final = ("lab", "cli")
"""Packages of the renderer whose tests are about measurements, not about what is measured."""

_ALWAYS: Final = ("tests/test_structure.py", "tests/test_words.py")
_DOCUMENTATION: Final = ("tests/test_docs.py", "tests/test_project.py")


@cache
def _read(path: Path) -> str:
    """Return a file's text, read once: a night asks about hundreds of modules."""
    return path.read_text(encoding="utf-8")


@cache
def _list_test_files(root: Path) -> tuple[tuple[str, Path], ...]:
    """Return the test files of a project, each with its name from the root."""
    files = sorted((root / "tests").rglob("test_*.py"))
    return tuple((file.relative_to(root).as_posix(), file) for file in files)


def list_files(root: Path) -> list[str]:
    """Return the files of a project that git tracks, or would."""
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=root,
        capture_output=True,
        text=True,
        check=True,
        encoding="utf-8",
    )
    return sorted(file for file in set(listed.stdout.split("\0")) if file and (root / file).is_file())


def choose_tests(root: Path, file: str) -> list[tuple[str, ...]]:
    """Return the stages of a module's tests, as arguments of pytest."""
    path = PurePosixPath(file)
    folder = root / "tests" / path.parent
    while not folder.is_dir():
        folder = folder.parent
    stem = path.stem.strip("_").removeprefix("test_")
    named = sorted(test for test in folder.rglob("test_*.py") if stem and stem in test.stem)
    folder_name = folder.relative_to(root).as_posix()
    stages = [(*(test.relative_to(root).as_posix() for test in named), folder_name)]
    if path.parts[0] == "rhi":
        is_examined = path.parts[1] == "backends" and path.parts[2] in _KITS
        backends = [_KITS[path.parts[2]]] if is_examined else []
        if not backends:
            backends = ["gl", "cl"] if path.parts[1] == "shading" else ["null", "gl"]
        stages += _list_wider(root, path, folder_name)
        stages += [("--pyargs", "rhi.conformance", "--rhi-backend", backend) for backend in backends]
    else:
        users = _list_users(root, path, folder)
        stages += [tuple(users)] if users else []
        stages += [(_EXAM,)] if (root / _EXAM).exists() else []
        stages += [(folder,) for folder in _list_importers(root, path)[:1]]
    return stages


def _list_wider(root: Path, path: PurePosixPath, folder_name: str) -> list[tuple[str, ...]]:
    """Return the stage of a module's package of `rhi`, and for a backend of what stands beside all."""
    is_backend = path.parts[1] == "backends"
    top = "/".join(("tests", *path.parts[: 3 if is_backend else 2]))
    beside = [
        test.relative_to(root).as_posix() for test in sorted((root / "tests/rhi/backends").glob("test_*.py"))
    ]
    wider = ([top] if top != folder_name and (root / top).is_dir() else []) + (beside if is_backend else [])
    return [tuple(wider)] if wider else []


def _list_users(root: Path, path: PurePosixPath, folder: Path, *, inside: bool = False) -> list[str]:
    """Return the files of tests outside a folder that import a module's package and name most of what it
    defines; or `inside` the folder, whatever they import, with the constants that it defines."""
    module = path.with_suffix("").as_posix().replace("/", ".")
    package = ".".join(path.with_suffix("").parts[:2])
    named = re.compile(rf"\b{re.escape(package)}\b")
    tree = ast.parse((root / path).read_text(encoding="utf-8"))
    names = [
        re.escape(definition.name)
        for definition in tree.body
        if isinstance(definition, ast.ClassDef | ast.FunctionDef)
    ]
    if inside:
        assigned = [definition.target for definition in tree.body if isinstance(definition, ast.AnnAssign)]
        names += [re.escape(target.id) for target in assigned if isinstance(target, ast.Name)]
    words = re.compile(
        "|".join(rf"\b{name}\b" for name in [*names, re.escape(module)] if not name.startswith("_"))
    )
    counts = Counter[str]()
    within = f"{folder.relative_to(root).as_posix()}/"
    for file, full_path in _list_test_files(root):
        if file.startswith(within) == inside:
            text = _read(full_path)
            if inside or (package in text and named.search(text)):
                counts[file] = len(set(words.findall(text)))
    return [file for file, count in counts.most_common(_MAX_USERS) if count]


def _list_importers(root: Path, path: PurePosixPath) -> list[str]:
    """Return the folders of tests of the packages that import what a module defines, most often first,
    without those that measure."""
    package, module = (
        path.parent.as_posix().replace("/", "."),
        path.with_suffix("").as_posix().replace("/", "."),
    )
    defined = re.findall(
        r"^(?:class |def )?([A-Za-z]\w*)(?:\(|:|\[| =)",
        (root / path).read_text(encoding="utf-8"),
        re.MULTILINE,
    )
    names = rf"\b(?:{'|'.join(defined)})\b"
    listed = rf"(?:[^(\n]*?|\([^()]*?){names}"
    imports = re.compile(
        rf"^from (?:{re.escape(module)} import |{re.escape(package)} import {listed})", re.MULTILINE
    )
    counts = Counter[str]()
    for file in sorted((root / path.parts[0]).rglob("*.py")):
        folder_name = file.relative_to(root).parts
        if len(folder_name) <= 2 or folder_name[1] in (path.parts[1], *_MEASURING):
            continue
        text = _read(file)
        if f"from {package}" in text and imports.search(text):
            counts["/".join(("tests", *folder_name[:2]))] += 1
    return [folder for folder, _ in counts.most_common() if (root / folder).is_dir()]


# -- what differs from another commit ------------------------------------------------------------------------


def list_changed_files(root: Path, base: str | None = None) -> list[str]:
    """Return the files that differ from a commit, new ones among them, but not those that are deleted."""

    def run_git(*arguments: str) -> str:
        return subprocess.run(
            ["git", *arguments], cwd=root, capture_output=True, text=True, check=True, encoding="utf-8"
        ).stdout.strip()

    if base is None:
        base = run_git("merge-base", "HEAD", "main")
        if base == run_git("rev-parse", "HEAD"):
            base = "HEAD"
    differing = run_git("diff", "--name-only", base).splitlines()
    untracked = run_git("ls-files", "--others", "--exclude-standard").splitlines()
    return sorted(file for file in {*differing, *untracked} if (root / file).is_file())


def choose_changed_tests(root: Path, files: Iterable[str]) -> list[str]:
    """Return the arguments of pytest for the tests that are responsible for files."""
    paths: dict[str, None] = {}
    kits: dict[str, None] = {}
    languages: dict[str, None] = {}
    for file in files:
        path = PurePosixPath(file)
        if path.suffix == ".md":
            paths |= dict.fromkeys(_DOCUMENTATION)
        elif path.suffix not in (".py", ".cl"):
            paths |= dict.fromkeys(_list_readers(root, path))
        elif path.name.startswith("test_"):
            paths[file] = None
        elif path.parts[0] == "tests":
            paths |= dict.fromkeys(_list_test_importers(root, path))
        elif path.parts[0] in ("rhi", "rhi_pytest", "rhi_screen", "renderer"):
            paths |= dict.fromkeys(_choose_near_tests(root, path))
            if path.parts[:2] == ("rhi", "backends") and path.parts[2] in _KITS:
                kits[_KITS[path.parts[2]]] = None
            if path.parts[:2] == ("rhi", "shading"):
                languages |= dict.fromkeys(_DEVICES_OF_LANGUAGES.get(path.parts[2], _DEVICES_OF_PARSER))
        elif (root / "tests" / path.parts[0]).is_dir():
            paths[f"tests/{path.parts[0]}"] = None
    paths |= dict.fromkeys(_ALWAYS)
    existing = [candidate for candidate in paths if (root / candidate).exists()]
    if kits:
        existing += [
            "--pyargs",
            "rhi.conformance",
            *(part for kit in kits for part in ("--rhi-backend", kit)),
        ]
    elif any(candidate.startswith("rhi/conformance") for candidate in existing):
        existing += ["--rhi-backend", "gl", "--rhi-backend", "cl", "--rhi-backend", "null"]
    elif languages and (root / _LANGUAGE).exists():
        existing += [_LANGUAGE, *(part for device in languages for part in ("--rhi-backend", device))]
    return existing


def _choose_near_tests(root: Path, path: PurePosixPath) -> list[str]:
    """Return the tests that are named after a module and those that use it most, or else its folder's."""
    if path.suffix == ".cl":
        return ["tests/rhi/backends/cl/raster"]
    *named, folder_tests = choose_tests(root, path.as_posix())[0]
    beside = _list_users(root, path, root / folder_tests, inside=True)
    is_small = len(list((root / folder_tests).rglob("test_*.py"))) <= _MAX_FOLDER
    is_main = path.stem in ("__init__", path.parent.name)
    is_hardly_named = not named and len(beside) < 2
    near = [folder_tests] if is_small and (is_main or is_hardly_named) else [*named, *beside]
    return [*near, *_list_users(root, path, root / folder_tests)]


def _list_readers(root: Path, path: PurePosixPath) -> list[str]:
    """Return the tests of what names a file of data: files of tests, and modules in its folder."""
    readers: list[str] = []
    for file in sorted((root / path.parent).glob("*.py")):
        if path.name in _read(file):
            module = PurePosixPath(file.relative_to(root).as_posix())
            is_shared = module.parts[0] == "tests"
            readers += _list_test_importers(root, module) if is_shared else _choose_near_tests(root, module)
    tests = _list_test_files(root) if path.parent.parts else ()
    return readers + [test for test, full_path in tests if path.name in _read(full_path)]


def _list_test_importers(root: Path, path: PurePosixPath) -> list[str]:
    """Return the files of tests that import what a module of the tests defines."""
    imports = re.compile(
        rf"^(?:from {re.escape(path.stem)} import|import {re.escape(path.stem)}\b)", re.MULTILINE
    )
    texts = ((test, _read(full_path)) for test, full_path in _list_test_files(root))
    return [test for test, text in texts if path.stem in text and imports.search(text)]


def main() -> None:
    """Print the arguments of pytest."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--base", metavar="REV", help="the commit to compare with")
    print("\n".join(choose_changed_tests(ROOT, list_changed_files(ROOT, parser.parse_args().base))))


if __name__ == "__main__":
    main()
