"""The rate at which commands are recorded on the null device, with call sites, and the memory that they use.

Each draw has constants of its own, so it is two commands (bind_uniform, draw). The variants take turns, round by
round, in one process, with the garbage collector on, as in a program. The figures are medians over the rounds.
`executed` includes the null backend's execution of the commands, which a fence causes.

    python benchmarks/recording.py [--json] [--draws 5000] [--rounds 15]
"""

from __future__ import annotations

import argparse
import gc
import json
import sys
from collections.abc import Callable

from scenes import Scene

import rhi
from renderer.lab.measure import alternate
from rhi.backends.null import create_backend
from rhi.commands.recorder import Recorder
from rhi.contract.descriptors import Primitive


def measure(draws: int, rounds: int) -> dict[str, dict[str, float]]:
    """Return the commands per second and the bytes per command of each variant."""
    device = rhi.create_device("null")
    scene = Scene(device, draws)

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

    def prepare(name: str) -> None:
        for _, finish, stream in variants.values():
            finish()
            stream.clear()
        gc.collect()

    def record_and_execute(name: str) -> None:
        run, finish, _ = variants[name]
        run()
        finish()

    work: dict[str, Callable[[int], object]] = {name: lambda _, run=run: run() for name, (run, *_) in variants.items()}
    work |= {f"{name}, executed": lambda _, name=name: record_and_execute(name) for name in variants}
    times = alternate(work, range(rounds), before=prepare)
    rows = {}
    for name, (run, _, stream) in variants.items():
        prepare(name)
        run()
        rows[name] = {
            "commands_per_second": len(stream) / times[name].median,
            "executed_per_second": len(stream) / times[f"{name}, executed"].median,
            "bytes_per_command": bytes_per_command(stream),
        }
    device.close()
    return rows


def bytes_per_command(stream: rhi.CommandStream) -> float:
    """Return the bytes of the list and of the instruction offsets in it; arguments are the caller's own objects."""
    offsets = sum(sys.getsizeof(command.offset) for command in stream)
    return (sys.getsizeof(stream.data) + offsets) / len(stream)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--draws", type=int, default=5000, help="draws per round (default: %(default)s)")
    parser.add_argument("--rounds", type=int, default=15, help="rounds (default: %(default)s)")
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")
    arguments = parser.parse_args()
    result = measure(arguments.draws, arguments.rounds)
    if arguments.json:
        print(json.dumps(result, indent=2))
        return
    print(f"{'':16} {'recorded/s':>12} {'executed/s':>12} {'bytes each':>11}")
    for name, row in result.items():
        numbers = row["commands_per_second"], row["executed_per_second"], row["bytes_per_command"]
        print("{:16} {:12,.0f} {:12,.0f} {:11.1f}".format(name, *numbers))


if __name__ == "__main__":
    main()
