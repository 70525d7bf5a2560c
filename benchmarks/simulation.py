"""The rate at which the simulated GPU processes commands, compared with the null device, which only executes
them.

Each draw has constants of its own, so it is two commands (bind_uniform, draw). A frame is recorded, presented
and waited for. The variants take turns, round by round, in one process; figures are medians over the rounds.

    python benchmarks/simulation.py [--json] [--draws 5000] [--rounds 9]
"""

from __future__ import annotations

import argparse
import gc
from collections.abc import Iterator
from typing import Final

from scenes import Scene

import rhi
from renderer.cli import options
from renderer.cli.comparison import run_benchmark
from renderer.lab.comparison import Record, Subject, compare, rate
from rhi.backends.null import Simulation


def make(draws: int, simulation: Simulation | None) -> Scene:
    """Create the scene on a null device, with or without a simulation."""
    options = {} if simulation is None else {"simulation": simulation}
    return Scene(rhi.create_device("null", **options), draws, size=256)


def measure(arguments: argparse.Namespace) -> Iterator[Record]:
    """Yield the commands per second of each variant, with constants in a uniform array or in transient
    memory."""
    subjects, scenes = [], []
    for suffix, transient in (("", False), (", transient", True)):
        for name, simulation in (("executed", None), ("simulated", Simulation())):
            scene = make(arguments.draws, simulation)

            def frame(_: int, scene: Scene = scene, draw: bool = transient) -> None:
                (scene.draw_transient if draw else scene.draw)(scene.device)
                scene.present()

            subjects.append(Subject({"variant": name + suffix}, frame, gc.collect, device=scene.device))
            scenes.append(scene)
    rows = compare(subjects, {"commands/s": rate(1.0)}, range(arguments.rounds))
    for row, scene in zip(rows, scenes, strict=True):
        yield row | {"commands/s": round(len(scene.device.stream) * row["commands/s"])}


OPTIONS: Final = (options.count("--draws", "draws per frame", 5000), options.rounds("rounds", 9))


if __name__ == "__main__":
    run_benchmark(__doc__, OPTIONS, measure)
