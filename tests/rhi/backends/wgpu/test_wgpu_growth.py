"""The memory that wgpu keeps of frames and of closed devices: the same, however many there were."""

from __future__ import annotations

import gc
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from wgpu.backends.wgpu_native._helpers import generate_report

import rhi
from rhi import BlendFactor, BlendFunction, ColorWrite, CullMode, Device, Format
from rhi.backends.webgpu import webgpu_pipelines
from rhi.backends.wgpu import native
from rhi.backends.wgpu.wgpu_backend import WgpuBackend
from rhi.conformance.shaders import Colored, Count
from rhi.conformance.shapes import rectangle


def count_native_objects() -> dict[str, int]:
    """Return the number of objects of each kind in wgpu-native."""
    gc.collect()
    return {kind: row["allocated"] for kind, row in generate_report()["hub"].items()}


def open_and_close(use: Callable[[Device], None]) -> None:
    with rhi.create_device("wgpu") as device:
        use(device)


def draw_and_read(device: Device) -> None:
    image = device.texture((8, 8), Format.RGBA8)
    with device.render_pass(image, clear=(0, 0, 0, 0)):
        query = device.occlusion_query()
        with query:
            device.draw(device.program(Colored), device.mesh(rectangle()))
    image.read()


def dispatch_and_leave(device: Device) -> None:
    out, zero = device.storage(float, 64), device.storage(rhi.shading.uint, 64)
    del zero
    device.program(Count)
    out.read_async()


@pytest.mark.parametrize("use", [lambda device: None, draw_and_read, dispatch_and_leave])
def test_a_closed_device_leaves_nothing(usable: None, use: Callable[[Device], None]) -> None:
    for _ in range(2):  # what is kept once for an adapter
        open_and_close(use)
    before, threads = count_native_objects(), len(os.listdir("/proc/self/task"))
    records = len(native._records_in_use) + len(native._spare_records)
    for _ in range(6):
        open_and_close(use)
    assert count_native_objects() == before
    assert len(os.listdir("/proc/self/task")) <= threads
    assert len(native._records_in_use) + len(native._spare_records) == records


def test_a_device_that_is_open_is_counted(usable: None) -> None:
    before = count_native_objects()
    with rhi.create_device("wgpu"):
        assert count_native_objects() != before


def test_queries_that_nobody_reads_use_the_same_sets(device: Device) -> None:
    image, mesh, program = (
        device.texture((8, 8), Format.R8),
        device.mesh(rectangle()),
        device.program(Colored),
    )

    def draw(count: int) -> dict[str, int]:
        for _ in range(count):
            with device.render_pass(image, clear=(0, 0, 0, 0)):
                with device.occlusion_query() as query:
                    device.draw(program, mesh)
            query.destroy()
            device.present(image)
        device.finish()
        return count_native_objects()

    before = draw(20)
    after = draw(60)
    assert {kind: after[kind] - before[kind] for kind in before if after[kind] - before[kind] > 2} == {}


def test_pipelines_of_many_states_are_bounded(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(webgpu_pipelines, "MAX_PIPELINES", 8)
    image, mesh, program = (
        device.texture((8, 8), Format.R8),
        device.mesh(rectangle()),
        device.program(Colored),
    )
    backend: Any = device.backend_as(WgpuBackend)  # type: ignore[arg-type]
    pipelines = backend._programs[program.id]
    factors = [factor for factor in BlendFactor if factor.name in ("ZERO", "ONE", "SOURCE_ALPHA")]
    for source in factors:
        for destination in factors:
            for cull in (CullMode.NONE, CullMode.FRONT):
                states = (BlendFunction(source, destination), cull, ColorWrite(True, True, True, True))
                with device.render_pass(image, clear=(0, 0, 0, 0)):
                    with device.states(*states):
                        device.draw(program, mesh)
                    device.draw(program, mesh)
                assert (image.read() == 255).all()
                assert len(pipelines.pipelines) <= len(backend._pipelines._cached) <= 8
    program.destroy()
    device.finish()
    assert backend._pipelines._cached == []


_INTERRUPTED = """
import os, signal, sys, threading, time
import rhi
from rhi.shading import Shader, StorageRW, Uniform, global_id

class Long(Shader):
    work_group = (64,)
    out: StorageRW[float]
    turns: Uniform[int]

    def compute(self) -> None:
        x = float(global_id().x)
        for _ in range(self.turns):
            x = x * 1.0000001 + 0.5
        self.out[global_id().x] = x

signal.signal(signal.SIGINT, signal.default_int_handler)  # shells ignore it for background jobs
raised = 0
with rhi.create_device("wgpu") as device:
    program, out, turns = device.program(Long), device.storage(float, 64 * 64), 2000
    while True:
        begin = time.perf_counter()
        device.dispatch(program, 64, out=out, turns=turns)
        out.read()
        seconds = time.perf_counter() - begin
        if seconds > 0.15 or turns > 100000:
            break
        turns *= 2
    parts = [float(part) for part in sys.argv[1:]]
    for part in parts:
        timer = threading.Timer(seconds * part, os.kill, (os.getpid(), signal.SIGINT))
        try:
            timer.start()
            device.dispatch(program, 64, out=out, turns=turns)
            out.read()
            timer.join()
            time.sleep(0.01)
        except KeyboardInterrupt:
            raised += 1
            timer.join()
        device.dispatch(program, 64, out=out, turns=1)
        assert out.read()[:2].tolist() == [0.5, 1.5000001192092896]
print(raised, len(parts))
"""


def interrupt_reads(count: int, folder: Path) -> str:
    """The output of a program whose reads are interrupted at parts of their time."""
    parts = [str(round(1.05 * (i + 0.5) / count, 4)) for i in range(count)]
    program = folder / "interrupted.py"  # shaders are compiled from files
    program.write_text(_INTERRUPTED, encoding="utf-8")
    command = [sys.executable, str(program), *parts]
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=60 + 2 * count, check=False, encoding="utf-8"
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert "ignored" not in done.stderr, done.stderr[-2000:]
    return done.stdout.strip()


def test_a_read_that_waits_can_be_interrupted(usable: None, tmp_path: Path) -> None:
    assert interrupt_reads(10, tmp_path) == "10 10"


@pytest.mark.nightly
def test_reads_can_be_interrupted_at_any_time(usable: None, tmp_path: Path) -> None:
    assert interrupt_reads(200, tmp_path) == "200 200"


@pytest.mark.nightly
def test_hundreds_of_devices_and_thousands_of_frames_take_no_memory(usable: None) -> None:
    program = """
import gc, rhi
from rhi import Format
from rhi.conformance.shaders import Colored
from rhi.conformance.shapes import rectangle

def resident():
    gc.collect()
    return int(open("/proc/self/statm").read().split()[1]) / 256

def open_devices(count):
    for _ in range(count):
        rhi.create_device("wgpu").close()

open_devices(40)
before = resident()
open_devices(500)
print(resident() - before)
with rhi.create_device("wgpu") as device:
    image, mesh, program = device.texture((16, 16), Format.R8), device.mesh(rectangle()), device.program(Colored)

    def draw(count):
        for _ in range(count):
            with device.render_pass(image, clear=(0, 0, 0, 0)), device.occlusion_query() as query:
                device.draw(program, mesh)
            query.destroy()
            device.present(image)
        device.finish()

    draw(2000)
    before = resident()
    draw(30000)
    print(resident() - before)
"""
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True, encoding="utf-8"
    )
    assert max(map(float, done.stdout.split())) < 20.0
