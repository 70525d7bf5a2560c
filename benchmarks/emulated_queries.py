"""Emulated occlusion queries (thesis 4.4.2): what they count on a GPU whose counter the CPU reads, and what
they cost.

The simulated GPU draws 1,000 samples inside a query and ten times 1,000 after it. Its sample counter is read
by a command, or by an interrupt handler 30 µs after an event, while the GPU halts or runs on; between the
query's begin and its draw the CPU works for 50 µs. For each way: the samples that the query reports, how long
the GPU halted, and the hazards that the device reports, with those that happened.

On each backend that draws, native and emulated queries of boxes take turns: many that are issued and then
read, and one after the other, each waited for.

    python benchmarks/emulated_queries.py [--json] [--queries 200] [--rounds 20]
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from functools import partial
from typing import Any, Final

import numpy as np

import rhi
from renderer.cli import options
from renderer.cli.comparison import run_benchmark
from renderer.lab.comparison import Record, Subject, compare, ratio, time
from rhi import Format
from rhi.backends.null import Activity, CostModel, Lane, SimulatedBackend, Simulation
from rhi.shading import Shader, Struct, vec2, vec4

INTERRUPT = 30_000
KINDS: Final = ("native", "emulated")


class Corner(Struct):
    position: vec2


class Flat(Shader):
    def vertex(self, v: Corner) -> vec4:
        return vec4(v.position, 0.5, 1.0)

    def fragment(self) -> vec4:
        return vec4(1.0, 1.0, 1.0, 1.0)


COUNTER_READS = {
    "the GPU writes the counter": {},
    "interrupts, the GPU halts": {"interrupt_latency": INTERRUPT},
    "interrupts, the GPU runs on (naive)": {"interrupt_latency": INTERRUPT, "halts_at_events": False},
}


def count(**times: Any) -> Record:
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


def measure_backend(backend: str, queries: int, rounds: int) -> Iterator[Record]:
    """Yield microseconds a query, native and emulated: issued together, and waited for one by one."""
    with rhi.create_device(backend) as device:
        flat, image = device.program(Flat), device.texture((256, 256), Format.RGBA8)
        box = device.mesh({"position": np.array([[-1, -1], [1, -1], [0, 1]], np.float32) / 16})
        kinds = KINDS if device.capabilities.sample_counter else KINDS[:1]
        query_lists = {
            kind: [device.occlusion_query(emulated=kind == "emulated") for _ in range(queries)]
            for kind in kinds
        }

        def ask(kind: str, waits: bool, _: int = 0) -> list[int]:
            samples = []
            with device.render_pass(image):
                for query in query_lists[kind]:
                    with query:
                        device.draw(flat, box)
                    if waits:
                        samples.append(query.wait())
            return samples or [query.wait() for query in query_lists[kind]]

        assert ask(kinds[0], False) == ask(kinds[-1], True)
        subjects = [
            Subject(
                {"backend": backend, "read": read, "queries": kind}, partial(ask, kind, waits), device=device
            )
            for read, waits in (("together", False), ("one by one", True))
            for kind in kinds
        ]
        columns = {"microseconds": time(1e6 / queries, 2), "ratio": ratio()}
        yield from compare(subjects, columns, range(rounds), group_by=("read",))


def measure(arguments: argparse.Namespace) -> Iterator[Record]:
    """Yield the counts of each way to read the counter, and the time of queries on each backend that draws."""
    yield from ({"the sample counter": name, **count(**times)} for name, times in COUNTER_READS.items())
    for report in rhi.report():
        if report.capabilities and report.capabilities.renders:
            yield from measure_backend(report.name, arguments.queries, arguments.rounds)


OPTIONS: Final = (options.count("--queries", "queries a round", 200), options.rounds("rounds", 20))


if __name__ == "__main__":
    run_benchmark(__doc__, OPTIONS, measure)
