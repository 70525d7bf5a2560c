"""The speed of traces: replayed on the null device, compared, saved and loaded.

The trace is frames of draws in labelled passes, each object with a binding of its own. `replay` includes everything
that the null device does, the recording of the replayed commands included; `replay, not recorded` is the same on a
device without a recorder. The variants take turns, round by round; figures are medians.

    python benchmarks/traces.py [--commands N] [--rounds N] [--json]
"""

from __future__ import annotations

import argparse
import gc
import json
import tempfile
from collections.abc import Callable
from pathlib import Path

from scenes import Scene

import rhi
from renderer.lab.measure import alternate
from rhi import CullMode, DepthWrite
from rhi.trace import Trace, diff, load, replay, save


def record(commands: int, changed: int = -1) -> Trace:
    """Return a trace of at least `commands` commands. The draw with the number `changed` has two instances, all others
    have one."""
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


def measure(commands: int = 10_000, rounds: int = 7) -> dict[str, float]:
    """Return the commands per second of each kind of work, and the seconds of each diff."""
    trace, other = record(commands), record(commands, commands // 4)
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
        times = alternate(work, range(rounds), before=lambda name: gc.collect())
    medians = {name: each.median for name, each in times.items()}
    rates = {f"{name} commands_per_second": len(trace) / medians[name] for name in work if "diff" not in name}
    return rates | {f"{name} seconds": medians[name] for name in work if "diff" in name}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--commands", type=int, default=10_000, help="length of the trace (default: %(default)s)")
    parser.add_argument("--rounds", type=int, default=7, help="rounds (default: %(default)s)")
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")
    options = parser.parse_args()
    result = measure(options.commands, options.rounds)
    if options.json:
        print(json.dumps(result, indent=2))
        return
    for name, value in result.items():
        print(f"{name:<44} {value:14,.3f}" if "seconds" in name[-8:] else f"{name:<44} {value:14,.0f}")


if __name__ == "__main__":
    main()
