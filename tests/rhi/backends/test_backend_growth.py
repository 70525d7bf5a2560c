"""What a device keeps on gl and cl of what it has made, drawn and destroyed.

Objects are counted, since memory that the C heap keeps hides small leaks. The memory itself is measured by
`benchmarks/memory.py`: its rows are nightly here, with the programs of a long day.
"""

from __future__ import annotations

import gc
import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rhi
from rhi import Device, Format, Primitive, Region
from rhi.backends.cl.backend import ClBackend
from rhi.backends.gl.backend import GlBackend
from rhi.shading import Shader, StorageRW, Struct, Uniform, global_id, vec2, vec4

pytestmark = pytest.mark.usefixtures("quick_collections")

BENCHMARK = Path(__file__).parents[3] / "benchmarks" / "memory.py"
CORNERS = np.array([[-1, -1], [1, -1], [0, 1]], np.float32)


class Corner(Struct):
    position: vec2


class Tint(Struct):
    color: vec4


class Flat(Shader):
    tint: Uniform[Tint]

    def vertex(self, v: Corner) -> vec4:
        return vec4(v.position, 0.5, 1.0)

    def fragment(self) -> vec4:
        return self.tint.color


class Count(Shader):
    work_group = (16, 1, 1)
    out: StorageRW[float]

    def compute(self) -> None:
        self.out[global_id().x] = 1.0


class House:
    """A device with meshes, targets and bindings that outlive what the tests repeat."""

    def __init__(self, device: Device) -> None:
        self.device = device
        self.image = device.texture((16, 16), Format.RGBA8)
        self.depth = device.texture((16, 16), Format.D32F)
        self.meshes = [device.mesh({"position": CORNERS}) for _ in range(2)]
        indices = np.tile(np.arange(3, dtype=np.uint32), 300)
        self.strip = device.mesh({"position": CORNERS}, indices, primitive=Primitive.TRIANGLE_STRIP)
        self.indices = indices
        self.tint = device.uniform(Tint(color=(1, 0, 0, 1)))
        self.flat = device.program(Flat)
        self.numbers = device.storage(float, 16)
        self.query = device.occlusion_query()

    def draw(self, *meshes: rhi.Mesh, program: rhi.Program[Any] | None = None) -> None:
        with self.device.render_pass(self.image, clear=(0, 0, 0, 0)):
            for mesh in meshes:
                self.device.draw(program or self.flat, mesh, tint=self.tint)

    def make_and_destroy_a_program(self) -> None:
        class Copy(Flat): ...

        program: rhi.Program[Any] = self.device.program(Copy)
        self.draw(*self.meshes, program=program)
        with self.device.render_pass(self.image):
            self.device.draw_many(program, self.strip, self.strip.draws([0, 3], 3), tint=self.tint)
        program.destroy()
        self.device.finish()

    def make_and_destroy_a_compute_program(self) -> None:
        class Copy(Count): ...

        program: rhi.Program[Any] = self.device.program(Copy)
        self.device.dispatch(program, 1, out=self.numbers)
        program.destroy()
        self.device.finish()

    def draw_beside_a_lasting_target(self) -> None:
        image = self.device.texture((16, 16), Format.RGBA8)
        with self.device.render_pass(image, self.depth, clear=(0, 0, 0, 0)):
            self.device.draw(self.flat, self.meshes[0], tint=self.tint)
        image.destroy()
        self.device.finish()

    def draw_and_read(self) -> None:
        self.draw(*self.meshes)
        self.image.read()

    def draw_and_present(self) -> None:
        self.draw(*self.meshes)
        self.device.present()

    def rewrite_indices(self) -> None:
        assert self.strip.indices is not None
        self.strip.indices.write(self.indices)
        self.draw(self.strip)
        with self.device.render_pass(self.image):
            self.device.draw_many(self.flat, self.strip, self.strip.draws([0, 3], 9), tint=self.tint)
        self.image.read(region=Region(0, 0, 1, 1))

    def count_without_reading(self) -> None:
        with self.device.render_pass(self.image), self.query:
            self.device.draw(self.flat, self.meshes[0], tint=self.tint)
        self.device.present()

    def write_and_read(self) -> None:
        self.tint.write(Tint(color=(1, 0, 0, 1)))
        self.numbers.read(0, 1)


REPEATED: list[tuple[Callable[[House], None], int]] = [
    (House.make_and_destroy_a_program, 4),
    (House.make_and_destroy_a_compute_program, 4),
    (House.draw_beside_a_lasting_target, 100),
    (House.draw_and_read, 100),
    (House.draw_and_present, 200),
    (House.rewrite_indices, 50),
    (House.count_without_reading, 200),
    (House.write_and_read, 100),
]


@pytest.fixture(params=["gl", "cl"])
def house(request: pytest.FixtureRequest) -> Iterator[House]:
    with rhi.create_device(request.param) as device:
        yield House(device)


def count_reachable(house: House) -> int:
    """Return the number of objects that the device keeps alive: those that its front end and backend refer to."""
    seen: set[int] = set()
    shared = {id(module.__dict__) for module in list(sys.modules.values()) if hasattr(module, "__dict__")}
    waiting: list[Any] = [house.device]
    while waiting:
        found = waiting.pop()
        if id(found) in seen or id(found) in shared or isinstance(found, (type, str, bytes, int, float)):
            continue
        seen.add(id(found))
        waiting += gc.get_referents(found)
    return len(seen)


@pytest.mark.parametrize(("repeat", "times"), REPEATED, ids=lambda value: getattr(value, "__name__", ""))
def test_repeating_leaves_no_objects_behind(
    house: House, repeat: Callable[[House], None], times: int
) -> None:
    def settle() -> int:
        house.count_without_reading()
        house.query.wait()  # looks at all batches, of which up to 64 may be waiting
        house.image.read()
        gc.collect()
        return count_reachable(house)

    for _ in range(70):  # memos fill up to their bounds
        house.draw_and_present()
    for _ in range(times):
        repeat(house)
    before = settle()
    for _ in range(times):
        repeat(house)
    grown = settle() - before
    assert grown < max(times, 16), f"{grown} objects in {times} repetitions"


def test_the_count_sees_what_is_kept(house: House) -> None:
    before = count_reachable(house)
    buffers = [house.device.buffer(16) for _ in range(10)]
    assert count_reachable(house) - before >= len(buffers)


def test_the_tables_of_a_backend_shrink_with_what_is_destroyed(house: House) -> None:
    backend: Any = house.device.backend_as(
        GlBackend if house.device.backend_name == "gl" else ClBackend  # type: ignore[arg-type]
    )

    def repeat() -> set[int]:
        house.make_and_destroy_a_program()
        house.make_and_destroy_a_compute_program()
        house.draw_beside_a_lasting_target()
        return set(backend._destroyers)

    assert repeat() == repeat()


def grow(row: str, scale: float) -> dict[str, float]:
    command = [sys.executable, str(BENCHMARK), "--json", "--only", row, "--scale", str(scale)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    grown: dict[str, float] = json.loads(done.stdout)[row]
    return grown


@pytest.mark.nightly
@pytest.mark.parametrize("row", ["programs", "compute programs"])
def test_two_thousand_programs_leave_less_than_20_mib(row: str) -> None:
    grown = grow(row, 1.0)
    assert max(grown.values()) < 20 << 20, grown


@pytest.mark.nightly
def test_as_many_scissors_as_one_likes_stay_below_30_mib() -> None:
    grown = grow("scissors", 1.0)
    assert max(grown.values()) < 30 << 20, grown
