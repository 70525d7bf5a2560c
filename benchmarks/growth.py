"""The memory, descriptors and threads of a process after many programs, devices, reloads and edited frames.

Each row runs in a process of its own, which counts its resident memory, file descriptors, threads and memory maps
after a tenth of the repetitions, after half of them, and at the end. So a row that goes on growing shows a second
difference as large as the first.

    python benchmarks/growth.py [--json] [--backend gl --backend cl] [--only programs] [--scale 0.1]

- programs: each has a shader text of its own, draws once and is destroyed.
- devices: each draws once and is closed.
- reloads: a module of shaders gets a new text, and its program draws.
- frames with edits: each writes a uniform, vertices and texels, draws, and is presented; every 50th has new
  targets and states.
"""

from __future__ import annotations

import argparse
import gc
import os
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from importlib.util import module_from_spec, spec_from_file_location
from multiprocessing import get_context
from pathlib import Path
from types import ModuleType
from typing import Any, Final

import numpy as np
from memory import resident_bytes

import rhi
from renderer.cli import options
from renderer.cli.comparison import run_benchmark
from renderer.lab.comparison import Record
from rhi import Format, Scissor
from rhi.shading import from_source

TEXT: Final = """
import rhi.shading as sl

class Corner(sl.Struct):
    position: sl.vec2

class Tint(sl.Struct):
    color: sl.vec4

class Scaled(sl.Shader):
    tint: sl.Uniform[Tint]

    def vertex(self, v: Corner) -> sl.vec4:
        return sl.vec4(v.position, 0.5, 1.0)

    def fragment(self) -> sl.vec4:
        return self.tint.color * {factor!r}
"""
CORNERS: Final = np.array([[-1, -1], [3, -1], [-1, 3]], np.float32)
_TABLES: Final = 4096
"""How many shader texts differ."""


def write_text(number: int) -> str:
    """Return the text of a module of shaders that no other number has."""
    return TEXT.format(factor=1.0 - (number % _TABLES) / (2 * _TABLES))


class Drawing:
    """A device with what all rows draw with."""

    def __init__(self, backend: str) -> None:
        self.device = rhi.create_device(backend, record=False)
        self.image = self.device.texture((64, 48), Format.RGBA8)
        self.mesh = self.device.mesh({"position": CORNERS})

    def draw(self, program: rhi.Program[...], **values: Any) -> None:
        with self.device.render_pass(self.image, clear=(0, 0, 0, 0)):
            self.device.draw(program, self.mesh, **values or {"tint": {"color": (1, 1, 1, 1)}})


def repeat_programs(backend: str) -> Iterator[Callable[[int], None]]:
    """Yield a step that is repeated: a program of a text that is new."""
    drawing = Drawing(backend)
    with drawing.device:

        def repeat(number: int) -> None:
            program: rhi.Program[...] = drawing.device.program(from_source(write_text(number), "Scaled"))
            drawing.draw(program)
            drawing.device.present()
            program.destroy()

        yield repeat


def repeat_devices(backend: str) -> Iterator[Callable[[int], None]]:
    """Yield a step that is repeated: a device that is opened, draws and is closed."""
    shader = from_source(write_text(0), "Scaled")

    def repeat(number: int) -> None:
        drawing = Drawing(backend)
        with drawing.device:
            drawing.draw(drawing.device.program(shader))
            drawing.image.read()

    yield repeat


def _load_module(folder: Path) -> ModuleType:
    path = folder / "growing_shaders.py"
    path.write_text(write_text(0), encoding="utf-8")
    spec = spec_from_file_location("growing_shaders", path)
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def repeat_reloads(backend: str) -> Iterator[Callable[[int], None]]:
    """Yield a step that is repeated: an edit of a module of shaders, and a frame with its program."""
    drawing = Drawing(backend)
    with drawing.device, tempfile.TemporaryDirectory() as folder, rhi.Reloader(drawing.device) as reloader:
        module = _load_module(Path(folder))
        program: rhi.Program[...] = drawing.device.program(module.Scaled)
        drawing.draw(program)

        def repeat(number: int) -> None:
            assert reloader.reload(module, write_text(number + 1)) == 1
            drawing.draw(program)
            drawing.device.present()

        yield repeat


def repeat_frames(backend: str) -> Iterator[Callable[[int], None]]:
    """Yield a step that is repeated: a frame in which all that it draws with is edited."""
    drawing = Drawing(backend)
    device = drawing.device
    with device, tempfile.TemporaryDirectory() as folder:
        module = _load_module(Path(folder))
        program: rhi.Program[...] = device.program(module.Scaled)
        texture = device.texture((16, 16), Format.RGBA8)
        tint = device.uniform_array(module.Tint, 2)
        texels = np.zeros((1, 16, 4), np.uint8)
        assert drawing.mesh.vertices is not None
        vertices = np.zeros(3, drawing.mesh.vertices.dtype)

        def repeat(number: int) -> None:
            if number % 50 == 0:
                drawing.image = device.texture((16 + number // 50 % 64, 48), Format.RGBA8)
            texels[:] = number % 256
            vertices["position"] = CORNERS * (1 + number % 5)
            texture.write(texels, y=number % 16)
            rows = np.zeros(2, tint.dtype)
            rows["color"] = number % 7 / 7
            tint.write(rows)
            drawing.mesh.vertices.write(vertices)
            with device.states(Scissor(number // 50 % 16, 0, 16, 48)):
                drawing.draw(program, tint=tint[number % 2])
            device.present()

        yield repeat


ROWS: Final[dict[str, tuple[int, Callable[[str], Iterator[Callable[[int], None]]]]]] = {
    "programs": (2_000, repeat_programs),
    "devices": (500, repeat_devices),
    "reloads": (500, repeat_reloads),
    "frames with edits": (30_000, repeat_frames),
}


def count_here() -> dict[str, float]:
    """Return the resources of this process."""
    gc.collect()
    process_folder = Path("/proc/self")
    return {
        "RSS, MiB": round(resident_bytes() / 2**20, 1),
        "descriptors": len(os.listdir(process_folder / "fd")),
        "threads": len(os.listdir(process_folder / "task")),
        "maps": len((process_folder / "maps").read_bytes().splitlines()),
    }


def measure_here(backend: str, row: str, scale: float) -> dict[str, list[float]]:
    """Return the resources of this process after a tenth, half and all of the repetitions, by name."""
    count, make = ROWS[row]
    count = max(10, round(count * scale))
    counts: dict[str, list[float]] = {}
    for repeat in make(backend):
        for number in range(count):
            repeat(number)
            if number + 1 in (count // 10, count // 2, count):
                for name, value in count_here().items():
                    counts.setdefault(name, []).append(value)
    return counts


def measure(arguments: argparse.Namespace) -> Iterator[Record]:
    """Yield the resources of processes, each row of a backend in a process of its own."""
    for row in arguments.only or ROWS:
        for backend in arguments.backend or ["null", "gl", "cl", "wgpu"]:
            with ProcessPoolExecutor(1, get_context("spawn")) as alone:
                measured = alone.submit(measure_here, backend, row, arguments.scale).result()
            counts = {name: " → ".join(f"{value:g}" for value in values) for name, values in measured.items()}
            yield {
                "repeated": row,
                "times": max(10, round(ROWS[row][0] * arguments.scale)),
                "backend": backend,
                **counts,
            }


OPTIONS: Final = (
    options.option("--backend", "repeatable", None, "all", action="append", choices=rhi.backend_names()),
    options.option("--only", "repeatable", None, "all", action="append", choices=list(ROWS)),
    options.option("--scale", "repetitions, as a part of those in the table", 1.0, type=options.parse_bound),
)


if __name__ == "__main__":
    run_benchmark(__doc__, OPTIONS, measure, kernels="quick")
