"""The memory that a device on gl or cl keeps after it has created, drawn and destroyed.

Objects are counted, since memory that the C heap keeps hides small leaks. The memory itself is measured by
`benchmarks/memory.py`: its rows are nightly here, with the programs of a long day.
"""

from __future__ import annotations

import gc
import json
import runpy
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from harness_kit import CALLS, SIZE, Count, DeviceHarness, draw_many, make_things_to_destroy, wait_for_a_query

import rhi
from rhi import Format, Primitive
from rhi.backends.cl.cl_backend import ClBackend
from rhi.backends.gl.gl_backend import GlBackend

pytestmark = pytest.mark.usefixtures("quick_collections")

BENCHMARK = Path(__file__).parents[3] / "benchmarks" / "memory.py"


def dispatch_a_new_program(harness: DeviceHarness) -> None:
    class Copy(Count): ...

    harness.created.append(harness.device.program(Copy))
    harness.device.dispatch(harness.created[-1], 1, out=harness.out, numbers=harness.numbers)


def draw_beside_a_lasting_target(harness: DeviceHarness) -> None:
    harness.created.append(harness.device.texture((SIZE, SIZE), Format.RGBA8))
    with harness.device.render_pass(harness.created[-1], harness.depth, clear=(0, 0, 0, 0)):
        harness.device.draw(harness.flat, harness.full, tint=harness.tints[0])


def rewrite_indices(harness: DeviceHarness) -> None:
    assert harness.half.indices is not None
    harness.half.indices.write(np.array([0, 1, 2], "u4"))
    draw_many(harness)


def draw_new_quads(harness: DeviceHarness) -> None:
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], np.float32)
    harness.created.append(
        harness.device.mesh({"position": corners}, np.arange(4, dtype="u4"), primitive=Primitive.QUADS)
    )
    with harness.device.render_pass(harness.other):
        harness.device.draw(harness.flat, harness.created[-1], tint=harness.tints[0])


REPEATED = [
    *CALLS,
    make_things_to_destroy,
    dispatch_a_new_program,
    draw_beside_a_lasting_target,
    rewrite_indices,
    draw_new_quads,
]
COMPILED = {make_things_to_destroy: 4, dispatch_a_new_program: 4}
"""How often, where each time programs are compiled; other calls are repeated `TIMES` times."""
TIMES = 20


@pytest.fixture(params=["gl", "cl"], scope="module")
def harness(request: pytest.FixtureRequest) -> Iterator[DeviceHarness]:
    with rhi.create_device(request.param) as device:
        harness = DeviceHarness(device)
        for _ in range(70):  # memos fill up to their bounds
            harness.draw_image()
            device.present()
        yield harness


def count_reachable(harness: DeviceHarness) -> int:
    """Return the number of objects that the device keeps alive, those that its front end and backend refer
    to, and of the elements of its sets; without the marks of rings, of which as many come together as fit
    into a ring."""
    elements = 0
    seen: set[int] = set()
    shared = {id(module.__dict__) for module in list(sys.modules.values()) if hasattr(module, "__dict__")}
    shared |= {id(mark) for ring in harness.device._core.frame_rings for mark in getattr(ring, "_marks", ())}
    waiting: list[Any] = [harness.device]
    while waiting:
        value = waiting.pop()
        if id(value) in seen or id(value) in shared or isinstance(value, (type, str, bytes, int, float)):
            continue
        seen.add(id(value))
        elements += len(value) if isinstance(value, set) else 0
        waiting += gc.get_referents(value)
    return len(seen) + elements


@pytest.mark.parametrize("call", REPEATED, ids=lambda call: call.__name__)
def test_repeating_leaves_no_objects_behind(
    harness: DeviceHarness, call: Callable[[DeviceHarness], None]
) -> None:
    def repeat(times: int) -> int:
        for _ in range(times):
            call(harness)
            harness.settle()
        wait_for_a_query(harness)  # looks at all batches, of which up to 64 may be waiting
        harness.image.read()
        gc.collect()
        return count_reachable(harness)

    times = COMPILED.get(call, TIMES)
    before = repeat(times)
    grown = repeat(times) - before
    assert grown < times, f"{grown} objects in {times} repetitions"


def test_the_count_of_reachable_objects_includes_live_buffers(harness: DeviceHarness) -> None:
    before = count_reachable(harness)
    buffers = [harness.device.buffer(16) for _ in range(10)]
    assert count_reachable(harness) - before >= len(buffers)


def test_the_tables_of_a_backend_shrink_when_resources_are_destroyed(harness: DeviceHarness) -> None:
    backend: Any = harness.device.backend_as(
        GlBackend if harness.device.backend_name == "gl" else ClBackend  # type: ignore[arg-type]
    )

    def repeat() -> set[int]:
        for call in (make_things_to_destroy, dispatch_a_new_program, draw_beside_a_lasting_target):
            call(harness)
            harness.settle()
        return set(backend._destroyers)

    assert repeat() == repeat()


def grow(*options: str) -> dict[str, float]:
    """Return by how many MiB the memory grows, by row of the benchmark and backend."""
    command = [sys.executable, str(BENCHMARK), "--json", *options]
    done = subprocess.run(command, capture_output=True, text=True, check=True, encoding="utf-8")
    rows = json.loads(done.stdout)["rows"]
    return {f"{row['repeated']}, {name}": row[name] for row in rows for name in row if name.endswith("MiB")}


GROWTH = BENCHMARK.with_name("growth.py")
MOST_MIB, MOST_MAPS, MOST_THREADS = 60.0, 300.0, 4.0
"""That the second half of the repetitions may add."""
MAPS_OF_A_PROGRAM = 16.0
"""On cl: PoCL never unloads the three kernels of a program."""
SCALES = {("cl", "programs"): 0.2, ("cl", "reloads"): 0.2, ("wgpu", "programs"): 0.5}
"""Parts of the benchmark's repetitions, where each takes half a second; elsewhere all."""


@pytest.mark.nightly
@pytest.mark.parametrize("row", ["programs", "devices", "reloads", "frames with edits"])
@pytest.mark.parametrize("backend", ["null", "gl", "cl", "wgpu"])
def test_the_second_half_of_many_repetitions_adds_little(backend: str, row: str) -> None:
    if backend == "wgpu":
        pytest.importorskip("wgpu")
    scale = str(SCALES.get((backend, row), 1.0))
    command = [sys.executable, str(GROWTH), "--json", "--backend", backend, "--only", row, "--scale", scale]
    done = subprocess.run(command, capture_output=True, text=True, check=True, encoding="utf-8")
    (counts,) = json.loads(done.stdout)["rows"]

    def added(name: str) -> float:
        _, half, end = map(float, counts[name].split(" → "))
        return end - half

    builds = counts["times"] / 2 if row in ("programs", "reloads") and backend == "cl" else 0.0
    assert added("descriptors") <= 0, counts
    assert added("threads") <= MOST_THREADS, counts
    assert added("maps") <= MOST_MAPS + MAPS_OF_A_PROGRAM * builds, counts
    assert added("RSS, MiB") <= MOST_MIB, counts


@pytest.mark.nightly
@pytest.mark.parametrize(("row", "bound"), [("programs", 20), ("compute programs", 20), ("scissors", 30)])
def test_thousands_of_programs_and_scissors_leave_little(row: str, bound: int) -> None:
    grown = grow("--only", row)
    assert len(grown) == 2
    assert max(grown.values()) < bound, grown


@pytest.mark.nightly
@pytest.mark.parametrize("backend", ["gl", "cl", "null"])
def test_ten_thousand_dropped_resources_of_a_kind_keep_less_than_20_mib(backend: str) -> None:
    kinds = [row for row in runpy.run_path(str(BENCHMARK))["ROWS"] if row.startswith("dropped ")]
    grown = grow("--backend", backend, *(text for row in kinds for text in ("--only", row)))
    assert len(grown) == len(kinds) == 10
    assert {row: growth for row, growth in grown.items() if growth > 20.0} == {}


@pytest.mark.nightly
def test_the_same_measure_detects_textures_that_are_kept() -> None:
    """A tenth as many take 62 MiB."""
    program = """
import memory
held, make = [], memory.DROPPED["textures"]
memory.DROPPED["textures"] = lambda device: held.append(make(device))
print(memory.measure_here("null", "dropped textures", 0.1))
"""
    command = [sys.executable, "-c", program]
    done = subprocess.run(
        command, cwd=BENCHMARK.parent, capture_output=True, text=True, check=True, encoding="utf-8"
    )
    assert int(done.stdout) > 20 << 20
