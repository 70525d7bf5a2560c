"""How fast the simulated GPU takes commands, against the null device that only executes them.

    python benchmarks/simulation.py [--json] [--draws 5000] [--rounds 9]

Each draw has its own constants, so it is two commands (bind_uniform, draw); a frame is recorded, presented
and waited for. The variants take turns round by round in one process; figures are medians over the rounds.
"""

from __future__ import annotations

import argparse
import gc
import json
import statistics
import time

from scenes import Scene

import rhi
from rhi.backends.null import Simulation


def make(draws: int, simulation: Simulation | None) -> Scene:
    """A scene on a null device, simulated or not."""
    options = {} if simulation is None else {"simulation": simulation}
    return Scene(rhi.create_device("null", **options), draws, size=256)


def frame(scene: Scene, transient: bool) -> int:
    """Record and execute one, with constants in own memory or in the ring; returns how many commands it was."""
    if transient:
        scene.draw_transient(scene.device)
    else:
        scene.draw(scene.device)
    scene.present()
    return len(scene.device.stream)


def measure(draws: int, rounds: int) -> dict[str, float]:
    """Commands a second, by variant."""
    scenes = {
        "executed": (make(draws, None), False),
        "simulated": (make(draws, Simulation()), False),
        "executed, transient": (make(draws, None), True),
        "simulated, transient": (make(draws, Simulation()), True),
    }
    rates: dict[str, list[float]] = {name: [] for name in scenes}
    for _ in range(rounds):
        for name, (scene, transient) in scenes.items():
            scene.device.stream.clear()
            gc.collect()
            start = time.perf_counter()
            commands = frame(scene, transient)
            rates[name].append(commands / (time.perf_counter() - start))
    return {name: statistics.median(each) for name, each in rates.items()}


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
