"""The speed of traces: replayed on the null device, compared, saved and loaded.

The trace is frames of draws in labelled passes, each object with a binding of its own. `replay` includes
everything that the null device does, the recording of the replayed commands included; `replay, not recorded`
is the same on a device without a recorder. The variants take turns, round by round; figures are medians.

    python benchmarks/traces.py [--commands N] [--rounds N] [--json]
"""

from __future__ import annotations

import argparse
import gc
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

from scenes import Scene

import rhi
from renderer.cli import options
from renderer.cli.comparison import run_benchmark
from renderer.lab.comparison import Record, Subject, compare, rate, time
from rhi import CullMode, DepthWrite
from rhi.trace import Trace, diff, load, replay, save


def record(commands: int, changed: int = -1) -> Trace:
    """Return a trace of at least `commands` commands. The draw with the number `changed` has two instances,
    all others have one."""
    with rhi.create_device("null") as device:
        scene = Scene(device, 64)
        drawn = 0
        while len(device.stream) < commands:
            with device.event("frame"):
                for state in (CullMode.NONE, DepthWrite.OFF):
                    with device.event(state.name), device.render_pass(scene.image), device.states(state):
                        for constants in scene.ranges:
                            device.draw(scene.program, scene.mesh, 1 + (drawn == changed), object=constants)
                            drawn += 1
            device.present(scene.image)
        return Trace(device.stream, "null")


def measure(arguments: argparse.Namespace) -> Iterator[Record]:
    """Yield the commands per second of each kind of work, and its milliseconds."""
    trace, other = record(arguments.commands), record(arguments.commands, arguments.commands // 4)
    folder = tempfile.TemporaryDirectory()
    file = Path(folder.name) / "trace.zip"

    def replay_on(**options: bool) -> None:
        with rhi.create_device("null", **options) as device:
            replay(trace, on=device)
            device.finish()

    work: dict[str, Callable[[int], object]] = {
        "replay": lambda _: replay_on(),
        "replay, not recorded": lambda _: replay_on(record=False),
        "diff, one change": lambda _: diff(trace, other),
        "diff, equal": lambda _: diff(trace, trace),
        "save": lambda _: save(trace, file),
        "load": lambda _: load(file),
    }
    with folder:
        save(trace, file)
        subjects = [Subject({"work": name}, run, gc.collect) for name, run in work.items()]
        columns = {"commands/s": rate(len(trace)), "milliseconds": time()}
        for row in compare(subjects, columns, range(arguments.rounds)):
            yield row | {"commands/s": round(row["commands/s"])}


OPTIONS = (options.count("--commands", "length of the trace", 10_000), options.rounds("rounds", 7))


if __name__ == "__main__":
    run_benchmark(__doc__, OPTIONS, measure)
