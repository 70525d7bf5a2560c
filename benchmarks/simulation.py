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

import numpy as np

import rhi
from rhi.backends.null import Simulation
from rhi.shading import Shader, Struct, Uniform, vec2, vec4


class Corner(Struct):
    position: vec2


class Object(Struct):
    offset: vec4


class Flat(Shader):
    object: Uniform[Object]

    def vertex(self, v: Corner) -> vec4:
        return vec4(v.position, 0.5, 1.0) + self.object.offset

    def fragment(self) -> vec4:
        return vec4(1.0, 1.0, 1.0, 1.0)


class Scene:
    """A device, and a frame of it: constants in own memory (static) or in the ring (transient)."""

    def __init__(self, draws: int, simulation: Simulation | None, transient: bool) -> None:
        options = {} if simulation is None else {"simulation": simulation}
        self.device = rhi.create_device("null", **options)
        self.program = self.device.program(Flat)
        self.mesh = self.device.mesh({"position": np.array([[-1, -1], [1, -1], [0, 1]], np.float32)})
        self.image = self.device.texture((256, 256), rhi.Format.RGBA8)
        self.objects = self.device.uniform_array(Object, draws)
        self.transient = transient
        self.device.finish()

    def frame(self) -> int:
        """Record and execute one; returns how many commands it was."""
        device, program, mesh = self.device, self.program, self.mesh
        with device.render_pass(self.image, clear=(0, 0, 0, 1)):
            if self.transient:
                value = Object(offset=(0, 0, 0, 0))
                for _ in range(len(self.objects)):
                    device.draw(program, mesh, object=device.transient.uniform(value))
            else:
                for i in range(len(self.objects)):
                    device.draw(program, mesh, object=self.objects[i])
        device.present(self.image)
        device.finish()
        return len(device.stream)


def measure(draws: int, rounds: int) -> dict[str, float]:
    """Commands a second, by variant."""
    scenes = {
        "executed": Scene(draws, None, False),
        "simulated": Scene(draws, Simulation(), False),
        "executed, transient": Scene(draws, None, True),
        "simulated, transient": Scene(draws, Simulation(), True),
    }
    rates: dict[str, list[float]] = {name: [] for name in scenes}
    for _ in range(rounds):
        for name, scene in scenes.items():
            scene.device.stream.clear()
            gc.collect()
            start = time.perf_counter()
            commands = scene.frame()
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
