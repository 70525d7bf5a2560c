"""The rate at which the simulated GPU processes commands, compared with the null device, which only executes them.

Each draw has constants of its own, so it is two commands (bind_uniform, draw). A frame is recorded, presented and
waited for. The variants take turns, round by round, in one process; figures are medians over the rounds.

    python benchmarks/simulation.py [--json] [--draws 5000] [--rounds 9]
"""

from __future__ import annotations

import argparse
import gc
import json

from scenes import Scene

import rhi
from renderer.measure import alternate
from rhi.backends.null import Simulation


def make(draws: int, simulation: Simulation | None) -> Scene:
    """Create the scene on a null device, with or without a simulation."""
    options = {} if simulation is None else {"simulation": simulation}
    return Scene(rhi.create_device("null", **options), draws, size=256)


def measure(draws: int, rounds: int) -> dict[str, float]:
    """Return the commands per second of each variant, with constants in a uniform array or in transient memory."""
    scenes = {
        "executed": make(draws, None),
        "simulated": make(draws, Simulation()),
        "executed, transient": make(draws, None),
        "simulated, transient": make(draws, Simulation()),
    }

    def clear(name: str) -> None:
        scenes[name].device.stream.clear()
        gc.collect()

    def frame(name: str) -> None:
        scene = scenes[name]
        draw = scene.draw_transient if "transient" in name else scene.draw
        draw(scene.device)
        scene.present()

    times = alternate({name: lambda _, name=name: frame(name) for name in scenes}, range(rounds), before=clear)
    return {name: len(scenes[name].device.stream) / each.median for name, each in times.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--draws", type=int, default=5000, help="draws per frame (default: %(default)s)")
    parser.add_argument("--rounds", type=int, default=9, help="rounds (default: %(default)s)")
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")
    arguments = parser.parse_args()
    result = measure(arguments.draws, arguments.rounds)
    if arguments.json:
        print(json.dumps(result, indent=2))
        return
    for name, rate in result.items():
        print(f"{name:22} {rate:12,.0f} commands/s")


if __name__ == "__main__":
    main()
