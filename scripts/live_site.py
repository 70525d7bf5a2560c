"""The live programs of the site: an editor beside a canvas, in which a reader runs and changes a program.

`write_live` writes the folder `live` of a site: the page's script, the programs, this checkout as a zip,
the packages that it imports as another, and `manifest.json`. The manifest says where the parts of Pyodide are,
with their sizes and hashes. A page checks the hash of each file that it loads.

Pyodide comes from its own distribution, by addresses that have its version; or from a folder, of which the
files are copied to the site. `python scripts/run_in_node.py --fetch` makes such a folder: `out/web/pyodide`.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import re
import shutil
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final, NamedTuple

ROOT: Final = Path(__file__).resolve().parents[1]
SOURCES: Final = Path(__file__).resolve().parent / "live"
PROGRAMS: Final = ROOT / "examples" / "programs"
PACKAGES: Final = ("rhi", "rhi_screen", "renderer")
DISTRIBUTIONS: Final = ("rendercanvas", "typing_extensions")
"""Packages that they import, of which this environment's are taken."""
PACKAGE_FILES: Final = (".py", ".cl", ".html", ".md", ".toml", ".ttf", ".LICENSE", ".license")


class Part(NamedTuple):
    """A file of Pyodide's distribution: where it is, its size in bytes, and its hash."""

    name: str
    url: str
    bytes: int
    sha256: str


VERSION: Final = "0.27.7"
_CORE: Final = f"https://cdn.jsdelivr.net/npm/pyodide@{VERSION}/"
_FULL: Final = f"https://cdn.jsdelivr.net/pyodide/v{VERSION}/full/"
NUMPY: Final = "numpy-2.0.2-cp312-cp312-pyodide_2024_0_wasm32.whl"
PILLOW: Final = "pillow-10.2.0-cp312-cp312-pyodide_2024_0_wasm32.whl"
PYODIDE: Final = (
    Part(
        "pyodide.mjs",
        _CORE,
        13_931,
        "04c052c815abb0bf2981fa38c2dfa58e3120ee5288c956df2b2a15e301782c5f",
    ),
    Part(
        "pyodide.asm.js",
        _CORE,
        1_255_688,
        "6b4c90de5b7172873f04f21884d0e9d2274e305fe32116558fe3e4fbe3618d51",
    ),
    Part(
        "pyodide.asm.wasm",
        _CORE,
        10_105_545,
        "a50dd1843f805a0b7c45b61037ee0d7b26dfe85efe0e18ef95a34ad24e401f5f",
    ),
    Part(
        "python_stdlib.zip",
        _CORE,
        2_360_737,
        "16611534726e5d8ac2bd8f926410b2dcb8d6f49aa24913463533b457a2115c16",
    ),
    Part(
        NUMPY,
        _FULL,
        3_061_133,
        "ebb61241d962b98b21597d7ce43b67668a6d5bab3acec4fbe958657320d7cd08",
    ),
)
"""The files of Pyodide that all programs need."""


class Package(NamedTuple):
    """A package of Pyodide's distribution that few programs import: its name for Pyodide and for readers."""

    name: str
    title: str
    part: Part


FURTHER: Final = {
    "text": Package(
        "pillow",
        "Pillow",
        Part(
            PILLOW,
            _FULL,
            987_254,
            "43eab147a9355385a99eeac18fb577d4af2fe4bd0bbd23d3ba3ddb92e72c2815",
        ),
    )
}
"""The programs that import a further package, which is loaded for them alone."""


def _lock_package(name: str, module: str, version: str, part: Part) -> dict[str, Any]:
    return {
        "depends": [],
        "file_name": part.name,
        "imports": [module],
        "install_dir": "site",
        "name": name,
        "package_type": "package",
        "sha256": part.sha256,
        "unvendored_tests": False,
        "version": version,
    }


LOCK: Final = {
    "info": {
        "abi_version": "2024_0",
        "arch": "wasm32",
        "platform": "emscripten_3_1_58",
        "python": "3.12.7",
        "version": VERSION,
    },
    "packages": {
        "numpy": _lock_package("numpy", "numpy", "2.0.2", PYODIDE[-1]),
        "pillow": _lock_package("Pillow", "PIL", "10.2.0", FURTHER["text"].part),
    },
}

NOT_LIVE: Final = {
    "batch": "it starts processes",
    "beside_moderngl": "it draws beside moderngl",
    "boids": "it needs imgui-bundle",
    "deferred": "its targets have 40 bytes a sample, and the core profile allows 32",
    "engine_test": "it is a file for pytest",
    "film": "it starts processes",
    "life": "the core profile has no images of R8UI",
    "occlusion": "the core profile has no conditional rendering",
}
"""The programs of the gallery that run in no page, and why."""

LIVE: Final = tuple(sorted(path.stem for path in PROGRAMS.glob("*.py") if path.stem not in NOT_LIVE))


def list_absent(pyodide: Path | None = None) -> dict[str, str]:
    """Return the programs of the gallery that don't run in a site, and why.

    Args:
        pyodide: a folder with Pyodide's distribution; None: pages load it from Pyodide's own address.
    """
    lacking = {
        name: f"it needs {package.title}, which the site's Pyodide lacks"
        for name, package in FURTHER.items()
        if pyodide is not None and not (pyodide / package.part.name).is_file()
    }
    return NOT_LIVE | lacking


def write_live(folder: Path, pyodide: Path | None = None) -> None:
    """Write the folder `live` of a site.

    Args:
        folder: where to; it is created.
        pyodide: a folder with Pyodide's distribution, whose files are copied; None: pages load them from
            Pyodide's own address.

    Raises:
        SystemExit: if a package isn't installed, or a file of `pyodide` is missing or another one.
    """
    (folder / "programs").mkdir(parents=True, exist_ok=True)
    absent = list_absent(pyodide)
    live = [name for name in LIVE if name not in absent]
    further = {name: package for name, package in FURTHER.items() if name in live}
    for name in live:
        shutil.copyfile(PROGRAMS / f"{name}.py", folder / "programs" / f"{name}.py")
    for name in ("orbit_viewer", "frame_commands"):
        shutil.copyfile(ROOT / "examples" / f"{name}.py", folder / "programs" / f"{name}.py")
    for source in SOURCES.iterdir():
        if source.is_file():
            shutil.copyfile(source, folder / source.name)
    (folder / "lock.json").write_text(json.dumps(LOCK), encoding="utf-8")
    _write_zip(folder / "rhi.zip", _list_packages())
    _write_zip(folder / "packages.zip", (file for name in DISTRIBUTIONS for file in _list_files(name)))
    files: dict[str, dict[str, Any]] = {}
    for part in (*PYODIDE, *(package.part for package in further.values())):
        url = part.url + part.name
        if pyodide is not None:
            _copy_part(part, pyodide, folder / "pyodide")
            url = f"pyodide/{part.name}"
        files[part.name] = {"url": url, "bytes": part.bytes, "sha256": part.sha256}
    for name in ("lock.json", "runner.py", "rhi.zip", "packages.zip"):
        data = (folder / name).read_bytes()
        files[name] = {"url": name, "bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()}
    manifest = {
        "origin": "this site" if pyodide is not None else "this site and cdn.jsdelivr.net",
        "files": files,
        "contents": [f"Python (Pyodide {VERSION})", "NumPy", "rhi"],
        "core": [name for name in files if name not in {package.part.name for package in further.values()}],
        "packages": ["numpy"],
        "further": {
            f"{name}.py": {
                "contents": [package.title],
                "packages": [package.name],
                "files": [package.part.name],
            }
            for name, package in further.items()
        },
        "archives": ["rhi.zip", "packages.zip"],
    }
    (folder / "manifest.json").write_text(json.dumps(manifest, indent=1), encoding="utf-8")


def _copy_part(part: Part, source: Path, target: Path) -> None:
    path = source / part.name
    if not path.is_file():
        raise SystemExit(f"{source} has no {part.name}: a folder of Pyodide {VERSION} is needed")
    data = path.read_bytes()
    if hashlib.sha256(data).hexdigest() != part.sha256:
        raise SystemExit(f"{path} isn't the file of Pyodide {VERSION}: it has another SHA-256")
    target.mkdir(exist_ok=True)
    (target / part.name).write_bytes(data)


def _list_packages() -> Iterator[tuple[str, bytes]]:
    """Yield the files of this checkout's packages that programs in a page import."""
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*")):
            if path.is_file() and path.suffix in PACKAGE_FILES and "conformance" not in path.parts:
                yield path.relative_to(ROOT).as_posix(), path.read_bytes()
    for path in sorted((ROOT / "rhi" / "conformance").glob("*.py")):
        yield path.relative_to(ROOT).as_posix(), path.read_bytes()


def _list_files(name: str) -> Iterator[tuple[str, bytes]]:
    """Yield the files of a pure package that is installed here."""
    try:
        distribution = importlib.metadata.distribution(name)
    except importlib.metadata.PackageNotFoundError:
        raise SystemExit(f'live programs need {name}: pip install "rhi[viewer]"') from None
    for file in sorted(distribution.files or (), key=str):
        path = Path(str(distribution.locate_file(file)))
        if path.suffix in (".py", ".js", ".css") or path.name in ("LICENSE", "METADATA"):
            yield file.as_posix(), path.read_bytes()


def _write_zip(path: Path, files: Iterable[tuple[str, bytes]]) -> None:
    """Write files to a zip whose bytes depend on nothing else."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in files:
            archive.writestr(zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0)), data, zipfile.ZIP_DEFLATED)


_SHOWN: Final = re.compile(r"^!\[[^\]]*\]\(images/gallery/(\w+)\.webp\)$", re.MULTILINE)
_MARKED: Final = re.compile(r"^<!-- live: (\S+) on (\w+) -->$", re.MULTILINE)


def add_live_programs(page: str, absent: Mapping[str, str] = NOT_LIVE) -> str:
    """Return a page with its live programs.

    Args:
        page: its Markdown.
        absent: the programs that don't run in the site, and why: `list_absent`.

    One stands below each image of the gallery whose program runs in a page, and in place of each mark
    `<!-- live: frame_commands.py on null -->`. Pages without any stay as they are.
    """

    def add(image: re.Match[str]) -> str:
        name = image[1]
        if name in absent:
            return f"{image[0]}\n\n*It doesn't run in this page: {absent[name]}.*"
        return f"{image[0]}\n\n{make_element(f'{name}.py')}"

    live = _MARKED.sub(lambda mark: make_element(mark[1], mark[2]), _SHOWN.sub(add, page))
    return page if live == page else add_script(live)


def make_element(program: str, device: str = "web") -> str:
    """Return the element of a live program; one on "null" needs no WebGPU."""
    return f'<div class="rhi-live" data-program="{program}" data-device="{device}"></div>'


def add_script(page: str, home: str = "live/") -> str:
    """Return a page with the script of live programs; `home` is their folder, as seen from the page's file."""
    head = f'<link rel="stylesheet" href="{home}live.css">'
    return f'{page.rstrip()}\n\n{head}\n<script type="module" src="{home}live.mjs"></script>\n'
