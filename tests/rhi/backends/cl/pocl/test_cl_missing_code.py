"""Machine code that vanishes while a program runs: no launch ends the process.

PoCL looks for a kernel's machine code again at each launch that has more items than all before.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

from rhi.backends.cl.pocl import binaries, kernel_cache, leases
from rhi.backends.cl.pocl.kernel_cache import KernelCache

RUN = """
import hashlib, os, shutil, subprocess, sys
from pathlib import Path
import rhi
from rhi.conformance.shaders import Checkered, Colored
from rhi.conformance.shapes import rectangle

TRIM = '''
import rhi
from rhi.backends.cl.pocl import kernel_cache
from rhi.conformance.shaders import Checkered
from rhi.conformance.shapes import rectangle
kernel_cache.LIMIT = 1000
with rhi.create_device("cl") as device:
    image = device.texture((64, 48), rhi.Format.RGBA8)
    with device.render_pass(image, clear=(0, 0, 0, 0)):
        device.draw(device.program(Checkered), device.mesh(rectangle(color=(1, 1, 1, 1))))
    image.read()
'''
folder = Path(os.environ["RHI_CACHE"]) / "pocl"

def show(device, shader, size):
    with device.texture(size, rhi.Format.RGBA8) as image, device.mesh(rectangle(color=(1, 0, 0.5, 1))) as mesh:
        with device.render_pass(image, clear=(0, 0, 0, 0)):
            device.draw(device.program(shader), mesh)
        print(hashlib.sha256(image.read().tobytes()).hexdigest())

with rhi.create_device("cl") as device:
    show(device, Colored, (130, 70))
    way = sys.argv[1]
    if way == "trim":
        subprocess.run([sys.executable, "-c", TRIM], check=True)
    elif way == "empty":
        for path in folder.iterdir():
            shutil.rmtree(path) if path.is_dir() else path.unlink()
    elif way == "remove":
        shutil.rmtree(folder)
    elif way == "one kernel":
        for path in folder.glob("RH/*/*/*/*/*.so"):
            path.unlink()
    for size in ((130, 70), (1300, 700), (20, 20), (2000, 1100)):
        show(device, Colored, size)
"""
"""Draws, loses machine code in the way that is named, and draws again, also larger. Prints checksums."""


def run(folder: Path, way: str) -> list[str]:
    environment = {name: value for name, value in os.environ.items() if name != "POCL_CACHE_DIR"}
    environment |= {"RHI_CACHE": str(folder), "RHI_KERNELS": "quick"}
    command = [sys.executable, "-W", "ignore", "-c", RUN, way]
    result = subprocess.run(
        command, capture_output=True, text=True, env=environment, timeout=300, check=False, encoding="utf-8"
    )
    assert result.returncode == 0, (way, result.returncode, result.stderr[-2000:])
    return result.stdout.split()


@pytest.fixture(scope="module")
def filled(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[str]]:
    """A folder that has all machine code, and the checksums of the images."""
    folder = tmp_path_factory.mktemp("kernels")
    return folder, run(folder, "nothing")


@pytest.mark.parametrize("way", ["nothing", "trim", "empty", "remove", "one kernel"])
def test_larger_draws_live_on_without_machine_code(
    filled: tuple[Path, list[str]], tmp_path: Path, way: str
) -> None:
    """With the images that a process draws whose machine code stays: the first way is the control."""
    folder, images = filled
    copy = tmp_path / "kernels"
    shutil.copytree(folder, copy)
    assert run(copy, way) == images


def test_links_of_a_process_that_lives_stay(tmp_path: Path) -> None:
    name = leases.take(tmp_path)
    assert name is not None
    assert len(binaries.folder_name("k" * 24, name)) == 40
    folder_name = tmp_path / binaries.LINKS / name
    (folder_name / "KEY").mkdir()
    code = f"""
from pathlib import Path
from rhi.backends.cl.pocl import leases
print(leases.take(Path({str(tmp_path)!r})))
"""
    other = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, encoding="utf-8"
    ).stdout.strip()
    assert (folder_name / "KEY").is_dir()
    assert other != name
    assert (tmp_path / binaries.LINKS / other).is_dir()
    leases.remove_stale(tmp_path)  # that process has ended
    assert not (tmp_path / binaries.LINKS / other).exists()
    assert (folder_name / "KEY").is_dir()
    assert leases.take(tmp_path) == name


def test_links_that_nobody_can_lock_are_removed_after_a_day(tmp_path: Path) -> None:
    for name, age in (("NEW", 0.0), ("OLD", 2 * 86400.0)):
        (tmp_path / binaries.LINKS / name).mkdir(parents=True)
        os.utime(tmp_path / binaries.LINKS / name, (time.time() - age,) * 2)
    leases.remove_stale(tmp_path)
    assert [path.name for path in (tmp_path / binaries.LINKS).iterdir()] == ["NEW"]


def test_a_process_whose_folder_was_emptied_gets_another_name(tmp_path: Path) -> None:
    name = leases.take(tmp_path)
    assert name is not None
    shutil.rmtree(tmp_path / binaries.LINKS)
    again = leases.take(tmp_path)
    assert again not in (None, name)
    assert (tmp_path / binaries.LINKS / str(again)).is_dir()


USE = """
import sys
import rhi
from rhi.conformance.shaders import Colored
from rhi.conformance.shapes import rectangle

with rhi.create_device("cl") as device:
    image, mesh = device.texture((64, 48), rhi.Format.RGBA8), device.mesh(rectangle(color=(1, 0, 0.5, 1)))
    with device.render_pass(image, clear=(0, 0, 0, 0)):
        device.draw(device.program(Colored), mesh)
    image.read()
    print("drawn", flush=True)
    sys.stdin.readline()
"""
"""Builds a program of LLVM code, and lives on until it is told to end."""

TRIM_ALL = """
import rhi
from rhi.backends.cl.pocl import kernel_cache

kernel_cache.LIMIT = 0
with rhi.create_device("cl") as device:
    cache = device.backend_as(object).context.cache
    cache._written.add("nothing")  # so that closing trims
"""


def list_programs(folder: Path) -> set[Path]:
    """The folders of programs that have LLVM code, without the one that each process runs to try a device."""
    programs = folder.glob("pocl/[A-Z][A-Z]/*/program.bc")
    return {path.parent for path in programs if not (path.parent / "probe").exists()}


def test_a_program_in_use_is_trimmed_only_when_its_process_has_ended(tmp_path: Path) -> None:
    """PoCL writes machine code beside LLVM code at launches, and ends the process where the folder vanishes
    meanwhile."""
    environment = {name: value for name, value in os.environ.items() if name != "POCL_CACHE_DIR"}
    environment |= {"RHI_CACHE": str(tmp_path), "RHI_KERNELS": "quick"}

    def trim() -> None:
        command = [sys.executable, "-W", "ignore", "-c", TRIM_ALL]
        subprocess.run(command, env=environment, timeout=120, check=True)

    process = subprocess.Popen(
        [sys.executable, "-W", "ignore", "-c", USE],
        env=environment,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        encoding="utf-8",
    )
    with process:
        assert process.stdin is not None
        assert process.stdout is not None
        assert process.stdout.readline() == "drawn\n"
        used = list_programs(tmp_path)
        assert len(used) >= 1
        trim()
        assert list_programs(tmp_path) >= used
        process.stdin.write("end\n")
        process.stdin.flush()
    assert process.returncode == 0
    trim()
    assert not list_programs(tmp_path) & used


def test_a_damaged_program_that_was_built_again_meanwhile_stays(
    tmp_path: Path,
) -> None:
    """One process reads a record, another trims the program, a third builds it again in the same folder."""
    cache = KernelCache(tmp_path, "driver")
    program = tmp_path / "AB" / "C"
    record = tmp_path / "rhi" / "key"
    record.parent.mkdir()

    def write(content: bytes) -> None:
        program.mkdir(parents=True, exist_ok=True)
        (program / "program.bc").write_bytes(content)
        checksum = cache._sign("key", "program.bc", content)
        record.write_text(
            json.dumps({"folder": "AB/C", "files": {"program.bc": checksum}, "bytes": 1}), encoding="utf-8"
        )

    write(b"first")
    (program / "program.bc").unlink()
    stale = kernel_cache._read_record(tmp_path, record)
    write(b"second")
    cache._remove_damaged("key", stale, True)
    assert cache.contains("key")
    (program / "program.bc").write_bytes(b"third")  # the control: it is damaged
    assert not cache.contains("key")
    assert not program.exists()


def test_a_program_in_use_keeps_its_folder_where_files_are_missing(tmp_path: Path) -> None:
    for key, stays in (("held", True), ("other", False)):
        cache = KernelCache(tmp_path, "driver")
        program = tmp_path / "AB" / key
        program.mkdir(parents=True)
        (tmp_path / "rhi").mkdir(exist_ok=True)
        record = tmp_path / "rhi" / key
        record.write_text(
            json.dumps({"folder": f"AB/{key}", "files": {"program.bc": "0"}, "bytes": 1}), encoding="utf-8"
        )
        if stays:
            cache.hold(key)
        assert not cache.contains(key)
        assert not record.exists()
        assert program.exists() == stays


def test_unrecorded_programs_stay_as_long_as_an_older_process_lives(
    tmp_path: Path,
) -> None:
    """The process may have built them, and lives for days."""
    cache = KernelCache(tmp_path, "driver")
    (tmp_path / "rhi").mkdir()
    cache.hold("key")
    for name in ("OLD", "NEW"):
        (tmp_path / "AB" / name).mkdir(parents=True)
    days = time.time() - 3 * 86400.0
    (begun,) = tmp_path.glob("RH/*/begun")
    os.utime(begun, (days, days))
    os.utime(tmp_path / "AB" / "OLD", (days - 60, days - 60))
    os.utime(tmp_path / "AB" / "NEW", (days + 60, days + 60))
    cache._written.add("key")
    cache.finish()
    assert not (tmp_path / "AB" / "OLD").exists()
    assert (tmp_path / "AB" / "NEW").exists()
