"""Programs without the metadata of packages: vendored, as an archive, and frozen by PyInstaller. All backends
are there."""

from __future__ import annotations

import importlib.metadata
import os
import shutil
import subprocess
import sys
import zipapp
from collections.abc import Iterator
from pathlib import Path

import pytest

import rhi
from rhi.device import registry

ROOT = Path(__file__).parents[1]
BACKENDS = ["gl", "cl", "wgpu", "web", "null"]
SHADERS = """
import rhi.shading as sl


class Red(sl.FullScreen):
    def fragment(self) -> sl.vec4:
        return sl.vec4(1.0, 0.0, 0.0, 1.0)
"""
PROGRAM = """
import sys

import rhi
from shaders import Red

print(*rhi.backend_names())
for name in rhi.backend_names():
    try:
        device = rhi.create_device(name)
    except rhi.DeviceError as error:
        print(name, error.rule.id, error.given)
        continue
    with device:
        image = device.texture((4, 4), rhi.Format.RGBA8)
        with device.render_pass(image), device.states(rhi.DepthTest.OFF):
            device.draw(device.program(Red), device.mesh(3))
        print(name, *image.read()[0, 0].tolist())
"""


@pytest.fixture
def without_metadata(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """As in a frozen program: no distribution has entry points."""
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda **_: importlib.metadata.EntryPoints(()))
    registry._entry_points.cache_clear()
    yield
    registry._entry_points.cache_clear()


@pytest.mark.usefixtures("without_metadata")
def test_the_package_has_its_backends_without_metadata() -> None:
    assert sorted(rhi.backend_names()) == sorted(BACKENDS)
    assert {backend.name for backend in rhi.report()} == set(BACKENDS)
    with rhi.create_device("null") as device:
        assert device.backend_name == "null"
    with pytest.raises(rhi.DeviceError, match=r"(?s)device-unknown.*did you mean 'null'"):
        rhi.create_device("nul")


@pytest.mark.usefixtures("without_metadata")
@pytest.mark.parametrize("name", BACKENDS)
def test_the_module_of_a_backend_that_was_not_packaged_is_named(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, f"rhi.backends.{name}", None)
    with pytest.raises(
        rhi.DeviceError, match=rf"(?s)device-driver.*packaged without it.*rhi\.backends\.{name}"
    ):
        rhi.create_device(name)


def test_backends_of_ports_are_still_found_by_metadata(monkeypatch: pytest.MonkeyPatch) -> None:
    point = importlib.metadata.EntryPoint("port", "rhi.backends.null:create_backend", registry.GROUP)
    monkeypatch.setattr(
        importlib.metadata, "entry_points", lambda **_: importlib.metadata.EntryPoints((point,))
    )
    registry._entry_points.cache_clear()
    try:
        assert rhi.backend_names() == ["gl", "cl", "port", "web", "wgpu", "null"]
        with rhi.create_device("port") as device:
            assert device.backend_name == "null"
    finally:
        registry._entry_points.cache_clear()


def write_program(folder: Path) -> Path:
    folder.mkdir()
    (folder / "shaders.py").write_text(SHADERS, encoding="utf-8")
    (folder / "__main__.py").write_text(PROGRAM, encoding="utf-8")
    return folder


def copy_package(folder: Path) -> None:
    shutil.copytree(ROOT / "rhi", folder / "rhi", ignore=shutil.ignore_patterns("__pycache__", "conformance"))


def run(command: list[str], folder: Path, **variables: str) -> list[str]:
    """Run a program where neither this checkout nor its metadata is on the path; return its lines."""
    environment = {**os.environ, "RHI_KERNELS": "quick", "XDG_CACHE_HOME": str(folder / "cache"), **variables}
    if "PYTHONPATH" not in variables:
        environment.pop("PYTHONPATH", None)
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, encoding="utf-8", check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


def check(lines: list[str]) -> None:
    """Check what the program has printed: all backends, red where they draw."""
    assert sorted(lines[0].split()) == sorted(BACKENDS)
    drawn = dict(line.split(" ", 1) for line in lines[1:])
    expected = dict.fromkeys(BACKENDS, "255 0 0 255") | {"null": "0 0 0 0"}
    usable = {backend.name for backend in rhi.report() if backend.usable}
    assert {name: drawn[name] for name in usable} == {name: expected[name] for name in usable}


def link_dependencies(folder: Path) -> Path:
    """A folder with all that this interpreter has installed, but `rhi` and its metadata."""
    site = Path(importlib.metadata.distribution("numpy").locate_file("")).resolve()
    folder.mkdir()
    for path in site.iterdir():
        if not path.name.startswith(("rhi", "__editable__")) and path.suffix != ".pth":
            (folder / path.name).symlink_to(path)
    return folder


@pytest.mark.nightly
def test_a_folder_that_was_copied_has_all_backends(tmp_path: Path) -> None:
    program = write_program(tmp_path / "app")
    copy_package(program)
    site = link_dependencies(tmp_path / "site")
    check(run([sys.executable, "-S", str(program)], tmp_path, PYTHONPATH=str(site)))


@pytest.mark.nightly
def test_an_archive_has_all_backends(tmp_path: Path) -> None:
    program = write_program(tmp_path / "app")
    copy_package(program)
    zipapp.create_archive(program, tmp_path / "app.pyz")
    shutil.rmtree(program)
    site = link_dependencies(tmp_path / "site")
    check(run([sys.executable, "-S", str(tmp_path / "app.pyz")], tmp_path, PYTHONPATH=str(site)))


@pytest.mark.nightly
def test_a_frozen_program_has_all_backends(tmp_path: Path) -> None:
    """PyInstaller finds the hook by the metadata of `rhi`; here it is named, as the checkout may not be
    installed."""
    pytest.importorskip("PyInstaller", reason="no PyInstaller: pip install pyinstaller")
    program = write_program(tmp_path / "app")
    unused = (
        "matplotlib",
        "PIL",
        "pygame",
        "hypothesis",
        "pytest",
        "trimesh",
        "scipy",
        "distributed",
        "IPython",
    )
    options = [text for name in unused for text in ("--exclude-module", name)]
    hooks = ["--additional-hooks-dir", str(ROOT / "rhi/shading/tools/pyinstaller"), "--paths", str(ROOT)]
    shaders = ["--add-data", f"{program / 'shaders.py'}{os.pathsep}."]
    subprocess.run(
        [sys.executable, "-m", "PyInstaller", "--noconfirm", "--log-level", "ERROR", "--name", "app", *hooks, *shaders,
         *options, str(program / "__main__.py")],
        cwd=tmp_path, check=True,
    )  # fmt: skip
    shutil.rmtree(program)
    check(run([str(tmp_path / "dist/app/app")], tmp_path))
