"""The folder of compiled kernels: chosen, shared by processes, checked for damage, bounded; and nothing is printed."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from rhi.backends.cl import cache
from rhi.backends.cl.cache import KernelCache

DRAW = """
import hashlib, sys, threading, warnings
import numpy as np
import rhi
from rhi.backends.cl.raster import builds
from rhi.conformance.shaders import Colored
from rhi.conformance.shapes import rectangle

warnings.simplefilter("always")
builds.HOT = int(sys.argv[1])
with rhi.create_device("cl") as device:
    image = device.texture((64, 48), rhi.Format.RGBA8)
    program, mesh = device.program(Colored), device.mesh(rectangle(color=(0.2, 0.4, 0.6, 0.8)))
    for _ in range(2):
        with device.render_pass(image, clear=(0, 0, 0, 0)):
            device.draw(program, mesh)
        if builds.HOT == 0:
            device.prepare(program, mesh, targets=(image,)).result(120)
    made = device.backend_as(object)._rasteriser._builds.built
    print(hashlib.sha256(image.read().tobytes()).hexdigest(), made)
"""
"""Draws, and prints a picture's checksum and the number of programs that were compiled. The argument: `HOT`."""


def start(folder: Path, hot: int = 1 << 30, **variables: str) -> subprocess.Popen[str]:
    environment = {name: value for name, value in os.environ.items() if name != "POCL_CACHE_DIR"}
    return subprocess.Popen(
        [sys.executable, "-c", DRAW, str(hot)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env=environment | {"RHI_CACHE": str(folder)} | variables,
    )  # fmt: skip


def draw(folder: Path, hot: int = 1 << 30) -> tuple[str, int]:
    """Draw in a new process; return the picture's checksum and the number of programs that were compiled."""
    return finish(start(folder, hot))


def finish(process: subprocess.Popen[str]) -> tuple[str, int]:
    output, errors = process.communicate(timeout=300)
    assert process.returncode == 0, errors
    assert errors == ""
    picture, made = output.split()
    return picture, int(made)


def records(folder: Path) -> list[Path]:
    return [path for path in (folder / "pocl" / "rhi").iterdir() if not path.suffix]


def test_a_first_run_and_its_optimisation_print_nothing(tmp_path: Path) -> None:
    """Neither the driver's count of warnings nor Python's warnings appear, from no thread and no process."""
    picture, made = draw(tmp_path, hot=0)
    assert made == 3  # set-up, vertices and raster, compiled quickly
    assert draw(tmp_path) == (picture, 0)


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A folder that a first run has filled, not to be written, and the checksum of its picture."""
    folder = tmp_path_factory.mktemp("kernels")
    picture, made = draw(folder)
    assert made == 3
    return folder, picture


@pytest.fixture
def filled(drawn: tuple[Path, str], tmp_path: Path) -> tuple[Path, str]:
    """A copy of the folder that a first run has filled, and the checksum of its picture."""
    return shutil.copytree(drawn[0], tmp_path / "copy"), drawn[1]


def test_a_folder_may_be_moved_and_shipped(filled: tuple[Path, str]) -> None:
    folder, picture = filled
    assert draw(folder) == (picture, 0)


def test_processes_that_begin_together_share_the_work(tmp_path: Path) -> None:
    pictures = {finish(process)[0] for process in [start(tmp_path) for _ in range(3)]}
    assert len(pictures) == 1
    assert draw(tmp_path) == (*pictures, 0)


@pytest.mark.parametrize("name", ["program.bc", "*.so"])
@pytest.mark.parametrize("damage", [bytes.upper, lambda content: content[:100], lambda content: b""])
def test_a_damaged_file_is_built_again(
    filled: tuple[Path, str], name: str, damage: Callable[[bytes], bytes]
) -> None:
    folder, picture = filled
    (kernel,) = folder.rglob("transform.so")  # the vertices', the smallest of the three programs
    damaged = list(kernel.parents[2].rglob(name))
    assert damaged
    for path in damaged:
        path.write_bytes(damage(path.read_bytes()))
    assert draw(folder) == (picture, 1)
    assert draw(folder) == (picture, 0)


def test_a_damaged_record_is_made_again(filled: tuple[Path, str]) -> None:
    folder, picture = filled
    for path, content in zip(records(folder), [b"", b"{}", b"[1]", b'{"folder": 1, "files": 2}'], strict=False):
        path.write_bytes(content)
    assert draw(folder)[0] == picture
    assert draw(folder) == (picture, 0)


@pytest.mark.parametrize("place", ["", ".", "..", "AB", "AB/..", "../mine", "AB/key/more", "{outside}"])
def test_a_record_that_names_another_place_removes_nothing_there(tmp_path: Path, place: str) -> None:
    """Records may come from elsewhere, and what they name may be removed."""
    folder, outside = tmp_path / "kernels", tmp_path / "mine"
    for each in (folder / "rhi", folder / "AB" / "key", outside):
        each.mkdir(parents=True)
        (each / "kept").write_bytes(b"kept")
    record = folder / "rhi" / "evil"
    record.write_text(json.dumps({"folder": place.format(outside=outside), "files": {"kept": 0}}))
    assert not KernelCache(folder, "driver").knows("evil")
    assert not record.exists()
    for each in (folder / "rhi", folder / "AB" / "key", outside):
        assert (each / "kept").read_bytes() == b"kept"


def make(folder: Path, key: str, size: int, since: float) -> None:
    """Write a program of some bytes that was last used some seconds ago, with its record."""
    kernels = KernelCache(folder, "driver")
    place = folder / "AB" / key
    place.mkdir(parents=True)
    (place / "program.bc").write_bytes(f"rhi_{key}".encode() + bytes(size))
    kernels.record(key)
    record = folder / "rhi" / key
    used = record.stat().st_mtime - since
    os.utime(record, (used, used))


def test_the_programs_used_least_recently_are_removed_beyond_the_limit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "rhi").mkdir()
    for number, key in enumerate(("oldest", "older", "newer", "newest")):
        make(tmp_path, key, 1000, 100.0 - number)
    kernels = KernelCache(tmp_path, "driver")
    assert kernels.knows("oldest")  # which uses it
    for limit, left in ((4300, ["newer", "newest", "older", "oldest"]), (2500, ["newest", "oldest"])):
        monkeypatch.setattr(cache, "LIMIT", limit)
        kernels.record("newest")
        kernels.finish()
        for part in ("AB", "rhi"):
            assert sorted(path.name for path in (tmp_path / part).iterdir()) == left


def test_another_driver_source_or_option_is_another_program(tmp_path: Path) -> None:
    mine, other = KernelCache(tmp_path, "driver 1"), KernelCache(tmp_path, "driver 2")
    requests = [mine.request("a", ()), mine.request("b", ()), mine.request("a", ["-w"]), other.request("a", ())]
    assert len({each.key for each in requests}) == 4
    assert mine.request("a", ()) == requests[0]


def test_machine_code_of_a_kernel_is_told_from_its_absence(tmp_path: Path) -> None:
    (tmp_path / "rhi").mkdir()
    make(tmp_path, "key", 10, 0.0)
    kernels = KernelCache(tmp_path, "driver")
    assert kernels.knows("key")
    assert not kernels.knows("key", ["draw"])
    (tmp_path / "AB" / "key" / "draw" / "1-1-1").mkdir(parents=True)
    (tmp_path / "AB" / "key" / "draw" / "1-1-1" / "draw.so").write_bytes(b"code")
    assert not kernels.knows("key", ["draw"])  # it isn't known to be complete
    kernels.record("key")
    assert kernels.knows("key", ["draw"])


def test_a_folder_that_cannot_be_made_leaves_the_driver_s(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").touch()
    monkeypatch.delenv("POCL_CACHE_DIR", raising=False)
    monkeypatch.setenv("RHI_CACHE", str(tmp_path / "file"))
    assert cache.choose_folder() is None
    assert "POCL_CACHE_DIR" not in os.environ
    kernels = KernelCache(None, "driver")
    assert not kernels.works
    assert not kernels.knows("key")
    with kernels.writing("key"):
        kernels.record("key")
    kernels.finish()


def test_the_driver_s_own_variable_is_respected(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("RHI_CACHE", raising=False)
    monkeypatch.setenv("POCL_CACHE_DIR", str(tmp_path))
    assert cache.choose_folder() == tmp_path
    monkeypatch.setenv("RHI_CACHE", str(tmp_path / "mine"))
    assert cache.choose_folder() == tmp_path / "mine" / "pocl"
