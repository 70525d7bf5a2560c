"""The cost of command buffers: recording draws and replaying them, compared with drawing directly.

Each draw has constants of its own, so it is two commands (bind_uniform, draw). The triangles have no area, so
none is rasterised. The variants take turns, round by round, in one process; the figures are medians in
microseconds per draw.

- `drawn at once`: the draws are issued on the device.
- `recorded`: the draws are recorded into a new command buffer, which isn't submitted.
- `first submission`: a new command buffer is submitted. This includes what is created once: the calls with
  their arguments, and the buffer of transient constants.
- `replayed`: a command buffer that was submitted before is submitted again.
- `replayed, call by call`: the same without the bundle that WebGPU's backends make of it.
- `a frame replayed`, `a frame call by call`: these two, and `present`, with which the driver gets the commands.
- `recorded on 4 threads, together`: each of 4 threads records a quarter of the draws; the wall time is
  divided by the number of all draws.

With `transient constants` each draw allocates its constants from transient memory.

    python benchmarks/command_buffers.py [--backend gl] [--json] [--draws 5000] [--rounds 15]
"""

from __future__ import annotations

import argparse
import gc
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final

from scenes import Scene

import rhi
from renderer.cli import options
from renderer.cli.comparison import run_benchmark
from renderer.lab.comparison import Record, Subject, compare, time


def measure(arguments: argparse.Namespace) -> Iterator[Record]:
    """Yield the microseconds per draw of each variant."""
    with rhi.create_device(arguments.backend, record=False) as device:
        scene = Scene(device, arguments.draws, scale=0.0)

        def record(draw: Callable[[rhi.Encoder], None]) -> rhi.CommandBuffer:
            with device.record() as commands:
                draw(commands)
            return commands

        recorded, plain, fresh = record(scene.draw), record(scene.draw), [record(scene.draw)]
        for _ in range(2):  # the second makes a bundle, where there are any
            device.submit(recorded)
        with without_bundles(device):
            device.submit(plain)
        recorded_anew = {
            "first submission": scene.draw,
            "first submission, transient constants": scene.draw_transient,
        }

        def present(commands: rhi.CommandBuffer) -> None:
            device.submit(commands)
            device.present()

        def prepare(name: str) -> None:
            if name in recorded_anew:
                fresh[0] = record(recorded_anew[name])
            device.finish()
            gc.collect()

        work: dict[str, Callable[[int], object]] = {
            "drawn at once": lambda _: scene.draw(device),
            "replayed": lambda _: device.submit(recorded),
            "replayed, call by call": lambda _: device.submit(plain),
            "a frame replayed": lambda _: present(recorded),
            "a frame call by call": lambda _: present(plain),
            "recorded": lambda _: record(scene.draw),
            "first submission": lambda _: device.submit(fresh[0]),
            "recorded, transient constants": lambda _: record(scene.draw_transient),
            "first submission, transient constants": lambda _: device.submit(fresh[0]),
            "drawn at once, transient constants": lambda _: scene.draw_transient(device),
            "recorded on 4 threads, together": lambda _: record_on_threads(scene, 4),
        }
        subjects = [
            Subject({"variant": name}, run, lambda name=name: prepare(name), device=device)
            for name, run in work.items()
        ]
        yield from compare(subjects, {"µs per draw": time(1e6 / arguments.draws, 2)}, range(arguments.rounds))


@contextmanager
def without_bundles(device: rhi.Device) -> Iterator[None]:
    """Make the command buffers that are first submitted meanwhile have no bundles."""
    implementation = getattr(device._core.backend, "_implementation", None)
    bundles = getattr(implementation, "bundles", None)
    try:
        if implementation is not None:
            implementation.bundles = None
        yield
    finally:
        if implementation is not None:
            implementation.bundles = bundles


def record_on_threads(scene: Scene, count: int) -> None:
    """Record the draws of the scene on `count` threads, an equal share on each."""

    def work(part: int) -> None:
        ranges = scene.ranges[part::count]
        with scene.device.record() as commands, commands.render_pass(scene.image):
            for constants in ranges:
                commands.draw(scene.program, scene.mesh, object=constants)

    threads = [threading.Thread(target=work, args=(part,)) for part in range(count)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


OPTIONS: Final = (
    options.option("--backend", "backend to measure", "gl"),
    options.count("--draws", "draws per round", 5000),
    options.rounds("rounds", 15),
)


if __name__ == "__main__":
    run_benchmark(__doc__, OPTIONS, measure)
