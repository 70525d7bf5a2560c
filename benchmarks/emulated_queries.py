"""Emulated occlusion queries (thesis 4.4.2): what they count on a GPU whose counter the CPU reads, and what they cost.

The simulated GPU draws 1,000 samples inside a query and ten times 1,000 after it. Its sample counter is read by a
command, or by an interrupt handler 30 µs after an event, while the GPU halts or runs on; between the query's begin and
its draw the CPU works for 50 µs. For each way: the samples that the query reports, how long the GPU halted, and the
hazards that the device reports, with those that happened.

On each backend that draws, native and emulated queries of boxes take turns: many that are issued and then read, and
one after the other, each waited for.

    python benchmarks/emulated_queries.py [--json] [--queries 200] [--rounds 20]
"""

from __future__ import annotations

import argparse
import json
import os
from typing import Any

import numpy as np

os.environ.setdefault("RHI_KERNELS", "optimised")  # what is measured is the speed of a long run

import rhi
from renderer.lab.measure import alternate, format_table
from rhi import Format
from rhi.backends.null import Activity, CostModel, Lane, SimulatedBackend, Simulation
from rhi.shading import Shader, Struct, vec2, vec4

INTERRUPT = 30_000


class Corner(Struct):
    position: vec2


class Flat(Shader):
    def vertex(self, v: Corner) -> vec4:
        return vec4(v.position, 0.5, 1.0)

    def fragment(self) -> vec4:
        return vec4(1.0, 1.0, 1.0, 1.0)


WAYS = {
    "the GPU writes the counter": {},
    "interrupts, the GPU halts": {"interrupt_latency": INTERRUPT},
    "interrupts, the GPU runs on (naive)": {"interrupt_latency": INTERRUPT, "halts_at_events": False},
}


def count(**times: Any) -> dict[str, Any]:
    """Count a draw of 1,000 samples on a simulated GPU, and return what the query and the device report."""
    with rhi.create_device("null", simulation=Simulation(CostModel(pixel=1), **times)) as device:
        gpu = device.backend_as(SimulatedBackend)
        gpu.count_samples(lambda draw: 1_000)
        flat, image = device.program(Flat), device.texture((64, 64), Format.RGBA8)
        box = device.mesh({"position": np.array([[-1, -1], [1, -1], [0, 1]], np.float32)})
        query = device.occlusion_query(emulated=True)
        with device.render_pass(image):
            with query:
                gpu.spend(50_000)
                device.draw(flat, box)
            for _ in range(10):
                device.draw(flat, box)
        return {
            "samples": query.wait(),
            "halted_microseconds": gpu.timeline.total(Lane.GPU, Activity.HALTED) / 1000,
            "hazards": len(gpu.hazards),
            "happened": sum(hazard.happened for hazard in gpu.hazards),
        }


def measure(backend: str, queries: int, rounds: int) -> dict[str, float]:
    """Return microseconds a query, native and emulated: issued together, and waited for one by one."""
    with rhi.create_device(backend) as device:
        flat, image = device.program(Flat), device.texture((256, 256), Format.RGBA8)
        box = device.mesh({"position": np.array([[-1, -1], [1, -1], [0, 1]], np.float32) / 16})
        kinds = {"native": False, "emulated": True}
        made = {kind: [device.occlusion_query(emulated=value) for _ in range(queries)] for kind, value in kinds.items()}

        def ask(kind: str, waits: bool) -> list[int]:
            samples = []
            with device.render_pass(image):
                for query in made[kind]:
                    with query:
                        device.draw(flat, box)
                    if waits:
                        samples.append(query.wait())
            return samples or [query.wait() for query in made[kind]]

        assert ask("native", False) == ask("emulated", True)
        work = {
            f"{kind}, {'waited for' if waits else 'together'}": lambda _, kind=kind, waits=waits: ask(kind, waits)
            for waits in (False, True)
            for kind in made
        }
        times = alternate(work, range(rounds))
        return {name: round(1e6 * each.median / queries, 2) for name, each in times.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--queries", type=int, default=200, help="queries a round (default: %(default)s)")
    parser.add_argument("--rounds", type=int, default=20, help="rounds (default: %(default)s)")
    parser.add_argument("--json", action="store_true", help="print JSON instead of tables")
    given = parser.parse_args()
    race = {name: count(**times) for name, times in WAYS.items()}
    drawing = [report.name for report in rhi.report() if report.capabilities and report.capabilities.renders]
    costs = {backend: measure(backend, given.queries, given.rounds) for backend in drawing}
    if given.json:
        print(json.dumps({"race": race, "microseconds_per_query": costs}, indent=2))
        return
    header = ["the sample counter", "samples", "halted µs", "hazards", "happened"]
    print(format_table(header, [[name, *found.values()] for name, found in race.items()], markdown=True))
    print()
    names = list(next(iter(costs.values()), {}))
    print(format_table(["µs a query", *names], [[b, *found.values()] for b, found in costs.items()], markdown=True))


if __name__ == "__main__":
    main()
