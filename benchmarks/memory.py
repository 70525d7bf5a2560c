"""The memory that a process keeps of what it has made and destroyed or dropped, beside meshes that live on.

Each row repeats one thing, after a tenth as many repetitions to warm up, and shows by how much the resident
memory of the process has grown. Each row runs in a process of its own, so that no row reuses memory that
another has freed. Kernels are optimised from the beginning: quick ones are replaced after thousands of draws,
which costs some megabytes once and isn't growth.

    python benchmarks/memory.py [--json] [--backend gl --backend cl] [--only programs] [--scale 0.1]
"""

from __future__ import annotations

import argparse
import gc
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Final

import numpy as np

import rhi
from renderer.cli import options
from renderer.cli.comparison import run_benchmark
from renderer.lab.comparison import Record
from rhi import Format, Primitive, Scissor
from rhi.backends.cl.pocl.program_residency import trim_heap
from rhi.shading import Shader, StorageRW, Struct, Uniform, global_id, vec2, vec4


class Corner(Struct):
    position: vec2


class Tint(Struct):
    color: vec4


CORNERS = np.array([[-1, -1], [1, -1], [0, 1]], np.float32)


def make_draw_shader() -> type[Shader]:
    """Return a shader class that no program was made of yet."""

    class Flat(Shader):
        tint: Uniform[Tint]

        def vertex(self, v: Corner) -> vec4:
            return vec4(v.position, 0.5, 1.0)

        def fragment(self) -> vec4:
            return self.tint.color

    return Flat


def make_compute_shader() -> type[Shader]:
    """Return a compute shader class that no program was made of yet."""

    class Count(Shader):
        work_group = (16, 1, 1)
        out: StorageRW[float]

        def compute(self) -> None:
            self.out[global_id().x] = 1.0

    return Count


def record_a_clear(device: rhi.Device) -> None:
    """Record and submit a command buffer with a resource that nobody else holds."""
    with device.record() as commands:
        commands.clear(device.storage(float, 64))
    device.submit(commands)


DROPPED: Final[dict[str, Callable[[rhi.Device], object]]] = {
    "textures": lambda device: device.texture((128, 128), Format.RGBA8),
    "buffers": lambda device: device.buffer(np.zeros(16384)),
    "uniforms": lambda device: device.uniform(Tint(color=(1, 1, 1, 1))),
    "storages": lambda device: device.storage(float, 16384),
    "uniform arrays": lambda device: device.uniform_array(Tint, 256),
    "meshes": lambda device: device.mesh({"position": np.zeros((4500, 2), np.float32)}),
    "queries": lambda device: device.occlusion_query(),
    "query sets": lambda device: device.query_set(8),
    "reads": lambda device: device.storage(float, 1024).read_async(),
    "command buffers": record_a_clear,
}
"""What is made and dropped without being destroyed: garbage collection gives its memory back."""


class Repetitions:
    """The calls that are repeated, on one device: a method for each row, which takes the number of the
    repetition."""

    def __init__(self, device: rhi.Device) -> None:
        self.device = device
        self.image = device.texture((32, 32), Format.RGBA8)
        self.depth = device.texture((32, 32), Format.D32F)
        self.meshes = [device.mesh({"position": CORNERS}) for _ in range(3)]
        indices = np.tile(np.arange(3, dtype=np.uint32), 300)
        self.strip = device.mesh({"position": CORNERS}, indices, primitive=Primitive.TRIANGLE_STRIP)
        self.indices = indices
        self.tint = device.uniform(Tint(color=(1, 0, 0, 1)))
        self.numbers = device.storage(float, 16)
        self.flat: rhi.Program[...] = device.program(make_draw_shader())
        self.count: rhi.Program[...] = device.program(make_compute_shader())
        self.query = device.occlusion_query()

    def draw(self, *meshes: rhi.Mesh, program: rhi.Program[...] | None = None) -> None:
        with self.device.render_pass(self.image, clear=(0, 0, 0, 0)):
            for mesh in meshes:
                self.device.draw(program or self.flat, mesh, tint=self.tint)

    def programs(self, number: int) -> None:
        program: rhi.Program[...] = self.device.program(make_draw_shader())
        self.draw(*self.meshes, program=program)
        program.destroy()
        self.device.present()

    def compute_programs(self, number: int) -> None:
        program: rhi.Program[...] = self.device.program(make_compute_shader())
        self.device.dispatch(program, 1, out=self.numbers)
        program.destroy()
        self.device.present()

    def scissors(self, number: int) -> None:
        with self.device.states(Scissor(number % 1000, number // 1000, 5 + number % 7, 5)):
            self.draw(self.meshes[0])
        self.device.present()

    def frames(self, number: int) -> None:
        with self.device.event("frame"):
            self.draw(*self.meshes)
        self.device.present()

    def frames_that_are_read(self, number: int) -> None:
        self.draw(*self.meshes)
        self.image.read()

    def buffers_without_a_fence(self, number: int) -> None:
        buffer = self.device.buffer(np.zeros(4096, np.float32))
        buffer.read(0, 1)
        buffer.destroy()

    def targets_beside_a_lasting_target(self, number: int) -> None:
        image = self.device.texture((32, 32), Format.RGBA8)
        with self.device.render_pass(image, self.depth, clear=(0, 0, 0, 0)):
            self.device.draw(self.flat, self.meshes[0], tint=self.tint)
        image.destroy()
        self.device.present()

    def indices_rewritten(self, number: int) -> None:
        assert self.strip.indices is not None
        self.strip.indices.write(self.indices)
        self.draw(self.strip)
        self.image.read(region=rhi.Region(0, 0, 1, 1))

    def meshes_sharing_a_buffer(self, number: int) -> None:
        assert self.meshes[0].vertices is not None
        mesh = self.device.mesh(self.meshes[0].vertices)
        self.draw(mesh)
        mesh.destroy()
        self.device.present()

    def queries_nobody_reads(self, number: int) -> None:
        with self.device.render_pass(self.image), self.query:
            self.device.draw(self.flat, self.meshes[0], tint=self.tint)
        self.device.present()

    def command_buffers(self, number: int) -> None:
        with self.device.record() as commands, commands.render_pass(self.image):
            tint = commands.transient.uniform(Tint(color=(1, 0, 0, 1)))
            commands.draw(self.flat, self.meshes[0], tint=tint)
        self.device.submit(commands)
        self.device.present()

    def writes_without_a_fence(self, number: int) -> None:
        self.tint.write(Tint(color=(1, 0, 0, 1)))
        self.device.dispatch(self.count, 1, out=self.numbers)
        self.numbers.read(0, 1)

    def drop(self, number: int, kind: str) -> None:
        DROPPED[kind](self.device)


ROWS: dict[str, tuple[int, Callable[[Repetitions, int], None]]] = {
    "programs": (2000, Repetitions.programs),
    "compute programs": (2000, Repetitions.compute_programs),
    "scissors": (50_000, Repetitions.scissors),
    "frames": (20_000, Repetitions.frames),
    "frames that are read": (10_000, Repetitions.frames_that_are_read),
    "buffers, no fence": (10_000, Repetitions.buffers_without_a_fence),
    "targets beside a lasting one": (10_000, Repetitions.targets_beside_a_lasting_target),
    "indices rewritten": (5000, Repetitions.indices_rewritten),
    "meshes of one buffer": (10_000, Repetitions.meshes_sharing_a_buffer),
    "queries nobody reads": (10_000, Repetitions.queries_nobody_reads),
    "command buffers": (5000, Repetitions.command_buffers),
    "writes, no fence": (10_000, Repetitions.writes_without_a_fence),
    **{f"dropped {kind}": (10_000, partial(Repetitions.drop, kind=kind)) for kind in DROPPED},
}


def resident_bytes() -> int:
    """Return the resident memory of this process, without what the C library keeps of memory that was
    freed."""
    trim_heap()
    lines = Path("/proc/self/smaps_rollup").read_text(encoding="utf-8").splitlines()
    return 1024 * next(int(line.split()[1]) for line in lines if line.startswith("Rss:"))


def measure_here(backend: str, row: str, scale: float) -> int:
    """Return the growth of one row in bytes, measured in this process."""
    count, repeat = ROWS[row]
    count = max(10, round(count * scale))
    with rhi.create_device(backend, record=False) as device:
        repetitions = Repetitions(device)
        warm_up = count // 10
        for number in range(warm_up):
            repeat(repetitions, number)
        device.finish()
        gc.collect()
        before = resident_bytes()
        for number in range(warm_up, warm_up + count):
            repeat(repetitions, number)
        device.finish()
        gc.collect()
        return resident_bytes() - before


def measure(arguments: argparse.Namespace) -> Iterator[Record]:
    """Yield the growth of each row, each measured in a process of its own."""
    for row in arguments.only or ROWS:
        grown = {}
        for backend in arguments.backend or ["gl", "cl"]:
            with ProcessPoolExecutor(1, get_context("spawn")) as alone:
                grown[f"{backend}, MiB"] = (
                    alone.submit(measure_here, backend, row, arguments.scale).result() / 2**20
                )
        yield {"repeated": row, "times": max(10, round(ROWS[row][0] * arguments.scale)), **grown}


OPTIONS: Final = (
    options.option(
        "--backend", "repeatable", None, "gl and cl", action="append", choices=rhi.backend_names()
    ),
    options.option("--only", "repeatable", None, "all", action="append", choices=list(ROWS)),
    options.option("--scale", "repetitions, as a part of those in the table", 1.0, type=options.parse_bound),
)


if __name__ == "__main__":
    run_benchmark(__doc__, OPTIONS, measure)
