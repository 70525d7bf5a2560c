"""How fast the simulated GPU takes commands, against the null device that only executes them.

    python benchmarks/simulation.py [--json] [--draws 5000] [--rounds 9]

Each draw has its own constants, so it is two commands (bind_uniform, draw); a frame is recorded, presented
and waited for. The variants take turns round by round in one process; figures are medians over the rounds.
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
    """A scene on a null device, simulated or not."""
    options = {} if simulation is None else {"simulation": simulation}
    return Scene(rhi.create_device("null", **options), draws, size=256)


def measure(draws: int, rounds: int) -> dict[str, float]:
    """Commands a second, by variant: with constants in memory of their own, or in the ring."""
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
    parser.add_argument("--draws", type=int, default=5000, help="draws a frame")
    parser.add_argument("--rounds", type=int, default=9)
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
