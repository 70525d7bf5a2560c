"""The memory that a process keeps of what it has made and destroyed, beside meshes that live on.

Each row repeats one thing, after a tenth as many repetitions to warm up, and shows by how much the resident memory of
the process has grown. Each row runs in a process of its own, so that no row reuses memory that another has freed.
Kernels are optimised from the beginning: quick ones are replaced after thousands of draws, which costs some megabytes
once and isn't growth.

    python benchmarks/memory.py [--json] [--backend gl --backend cl] [--only programs] [--scale 0.1]
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

import rhi
from rhi import Format, Primitive, Scissor
from rhi.shading import Shader, StorageRW, Struct, Uniform, global_id, vec2, vec4

os.environ.setdefault("RHI_KERNELS", "optimised")


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


class Repetitions:
    """What is repeated, on one device: a method for each row, which takes the number of the repetition."""

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

    def targets_beside_a_lasting_one(self, number: int) -> None:
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

    def meshes_of_one_buffer(self, number: int) -> None:
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


ROWS: dict[str, tuple[int, Callable[[Repetitions, int], None]]] = {
    "programs": (2000, Repetitions.programs),
    "compute programs": (2000, Repetitions.compute_programs),
    "scissors": (50_000, Repetitions.scissors),
    "frames": (20_000, Repetitions.frames),
    "frames that are read": (10_000, Repetitions.frames_that_are_read),
    "buffers, no fence": (10_000, Repetitions.buffers_without_a_fence),
    "targets beside a lasting one": (10_000, Repetitions.targets_beside_a_lasting_one),
    "indices rewritten": (5000, Repetitions.indices_rewritten),
    "meshes of one buffer": (10_000, Repetitions.meshes_of_one_buffer),
    "queries nobody reads": (10_000, Repetitions.queries_nobody_reads),
    "command buffers": (5000, Repetitions.command_buffers),
    "writes, no fence": (10_000, Repetitions.writes_without_a_fence),
}


def resident_bytes() -> int:
    """Return the resident memory of this process."""
    lines = Path("/proc/self/smaps_rollup").read_text().splitlines()
    return 1024 * next(int(line.split()[1]) for line in lines if line.startswith("Rss:"))


def measure(backend: str, row: str, scale: float) -> float:
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
        return float(resident_bytes() - before)


def measure_alone(backend: str, row: str, scale: float) -> float:
    """Return the growth of one row in bytes, measured in a process of its own."""
    command = [sys.executable, __file__, "--measure", backend, row, str(scale)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return float(done.stdout.splitlines()[-1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--backend", action="append", choices=rhi.backend_names())
    parser.add_argument("--only", action="append", choices=list(ROWS))
    parser.add_argument("--scale", type=float, default=1.0, help="repetitions, as a part of those in the table")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--measure", nargs=3, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.measure:
        print(measure(options.measure[0], options.measure[1], float(options.measure[2])))
        return
    grown = {
        row: {backend: measure_alone(backend, row, options.scale) for backend in options.backend or ["gl", "cl"]}
        for row in options.only or ROWS
    }
    if options.json:
        print(json.dumps(grown))
        return
    for row, growth in grown.items():
        count = max(10, round(ROWS[row][0] * options.scale))
        cells = "  ".join(f"{backend} {size / 2**20:7.1f} MiB" for backend, size in growth.items())
        print(f"{row:30} {count:7,}  {cells}", flush=True)


if __name__ == "__main__":
    main()
