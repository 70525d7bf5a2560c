"""The rate at which commands are recorded on the null device, with call sites, and the memory that they use.

Each draw has constants of its own, so it is two commands (bind_uniform, draw). The variants take turns, round
by round, in one process, with the garbage collector on, as in a program. The figures are medians over the
rounds. `executed` includes the null backend's execution of the commands, which a fence causes.

    python benchmarks/recording.py [--json] [--draws 5000] [--rounds 15]
"""

from __future__ import annotations

import argparse
import gc
import sys
from collections.abc import Callable, Iterator

from scenes import Scene

import rhi
from renderer.cli import options
from renderer.cli.comparison import run_benchmark
from renderer.lab.comparison import Record, Subject, compare, rate
from rhi.backends.null import create_backend
from rhi.commands.recorder import Recorder
from rhi.contract.descriptors import Primitive


def measure(arguments: argparse.Namespace) -> Iterator[Record]:
    """Yield the commands per second and the bytes per command of each variant."""
    device = rhi.create_device("null")
    scene = Scene(device, arguments.draws)

    def through_program() -> None:
        draw, mesh = scene.program.draw, scene.mesh
        with device.render_pass(scene.image, clear=(0, 0, 0, 1)):
            for constants in scene.ranges:
                draw(mesh, object=constants)

    backend = create_backend()
    recorder = Recorder(backend)
    offsets = [constants.offset for constants in scene.ranges]

    def bare() -> None:
        bind_uniform, draw = recorder.bind_uniform, recorder.draw
        for offset in offsets:
            bind_uniform(1, 2, offset, 16)
            draw(1, Primitive.TRIANGLES, 0, 3, 1, 0, 0)

    fences = iter(range(1, 1 << 30))
    variants: dict[str, tuple[Callable[[], None], Callable[[], object], rhi.CommandStream]] = {
        "device.draw": (lambda: scene.draw(device), device.finish, device.stream),
        "program.draw": (through_program, device.finish, device.stream),
        "recorder alone": (bare, lambda: recorder.signal(next(fences)), recorder.stream),
    }

    def prepare() -> None:
        for _, finish, stream in variants.values():
            finish()
            stream.clear()
        gc.collect()

    def record_and_execute(name: str) -> None:
        run, finish, _ = variants[name]
        run()
        finish()

    subjects = []
    for name, (run, *_) in variants.items():
        subjects.append(Subject({"variant": name}, lambda _, run=run: run(), prepare))
        subjects.append(Subject({}, lambda _, name=name: record_and_execute(name), prepare))
    rows = compare(subjects, {"rate": rate(1.0)}, range(arguments.rounds))
    for row, executed, (run, _, stream) in zip(rows[::2], rows[1::2], variants.values(), strict=True):
        prepare()
        run()
        yield {
            "variant": row["variant"],
            "recorded/s": round(len(stream) * row["rate"]),
            "executed/s": round(len(stream) * executed["rate"]),
            "bytes each": bytes_per_command(stream),
        }
    device.close()


def bytes_per_command(stream: rhi.CommandStream) -> float:
    """Return the bytes of the list and of the instruction offsets in it; arguments are the caller's own
    objects."""
    offsets = sum(sys.getsizeof(command.offset) for command in stream)
    return (sys.getsizeof(stream.data) + offsets) / len(stream)


OPTIONS = (options.count("--draws", "draws per round", 5000), options.rounds("rounds", 15))


if __name__ == "__main__":
    run_benchmark(__doc__, OPTIONS, measure)
