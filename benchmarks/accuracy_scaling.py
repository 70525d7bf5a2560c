"""Scaling of the sweep of all knobs (`python -m renderer accuracy`) with processes.

The jobs are those of the command, shares of knobs, in its order, the longest first, at a small size. They run on 1, 2,
4 … processes, begun afresh for each count and each with a device of its own, on the executor of `--executor
processes:N`.

Every process has the same number of CPUs and of drivers' threads, however many there are: an N-th of the machine, N
being the largest count. So N processes have N times what one has. Left to itself, one process would use all CPUs in its
drivers' threads (PoCL, llvmpipe), and several would start as many threads as that each, on the same CPUs.

- seconds: by the clock, from the start of the first process to the last result.
- start: until the first job begins: the interpreter, imports and the driver.
- longest: the longest job.
- idle: the part of the processes' time in which they have no job any more, because others do the last ones.
- work: of the time in jobs, what one process takes for all of them, in that of N. Below 1, they slow each other.
- processor: the same by processor time, of start and jobs. Other programs disturb it less; it shows what is done more
  often by N processes, but not that they wait for memory or for the GPU.
- efficiency: the seconds of one process, in N times those of N.
- predicted: the efficiency that N processes would have if each job took as long as in the first run, and starts too:
  every job, in order, goes to the process that is free first. It is computed, for numbers of processes that the
  machine has no CPUs for, as well. It knows of idle processes, but not of processes that slow each other.

A first run that isn't timed builds kernels into the caches on disk. On null, which draws nothing, a job records frames
with all values of a knob: this is the part of Python. What is done is said on stderr, job by job.

    python benchmarks/accuracy_scaling.py [--json] [--backend null|cl|gl] [--processes 1,2,4] [--knob K]
"""

from __future__ import annotations

import argparse
import heapq
import os
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass, replace
from typing import Final

import rhi
from renderer.cli import options
from renderer.cli.comparison import run_benchmark
from renderer.cli.executors import open_processes, share_cpus
from renderer.content import load_scene
from renderer.lab.accuracy import KNOBS, Situation, SweepJob, list_jobs
from renderer.lab.accuracy.jobs import order_jobs
from renderer.lab.accuracy.sweep import DRAWS_NOTHING, find_lack, list_views, prepare_scene
from renderer.lab.comparison import Record, forget_commands

SITUATION: Final = Situation("city", size=(240, 135), views=3, rounds=6)
NULL_FRAMES: Final = 24
"""Frames that are recorded with each value on null, by all shares together."""
PREDICTED: Final = (1, 2, 4, 8)
"""Numbers of processes of which a prediction is made in any case."""


@dataclass(frozen=True)
class JobTime:
    """The record of a job: the process, the clock's time at both ends, and the process's processor time until then."""

    process: int
    began: float
    ended: float
    processor: float


def run_job(job: SweepJob) -> JobTime:
    """Do a job in this process."""
    began = time.time()
    if job.situation.backend == "null":
        record_frames(job)
    else:
        job.run()
    return JobTime(os.getpid(), began, time.time(), time.process_time())


def record_frames(job: SweepJob) -> None:
    """Record frames with all values of a knob."""
    situation, knob = job.situation, KNOBS[job.knob]
    scene = load_scene(situation.scene)
    if prepare_scene(scene, knob) is not None:
        return
    views = list_views(scene, situation)
    with rhi.create_device("null") as device:
        for settings in (knob.set(situation.settings, value) for value in knob.values):
            if find_lack(device, settings) not in (None, DRAWS_NOTHING):
                continue
            with settings.open(device, scene, situation.size) as renderer:
                for number in job.share.take(range(NULL_FRAMES)):
                    view = views[number % len(views)]
                    renderer.render(settings.aim(view.camera), view.seconds)
                    forget_commands(device)


def choose_jobs(backend: str, knobs: Sequence[str]) -> list[SweepJob]:
    """Return the jobs of a backend. Those on null leave out what depends on what has been drawn."""
    is_recorded = backend == "null"
    chosen = (knob for knob in KNOBS.values() if not knobs or knob.name in knobs)
    names = [knob.name for knob in chosen if not is_recorded or knob.within.get("algorithm") == "frustum"]
    return order_jobs(list_jobs(replace(SITUATION, backend=backend), names))


def run_jobs(jobs: Sequence[SweepJob], shares: Sequence[Sequence[int]], what: str) -> tuple[float, list[JobTime]]:
    """Do all jobs on a process for each share of the CPUs; return when the first process was started, and the times in
    the jobs' order."""
    began = time.time()
    with open_processes(shares) as pool:
        futures = [pool.submit(run_job, job) for job in jobs]
        for done, _ in enumerate(as_completed(futures), 1):
            print(f"{what}: {done} of {len(jobs)} jobs, {time.time() - began:.0f} s", file=sys.stderr)
        return began, [one.result() for one in futures]


def find_makespan(durations: Sequence[float], processes: int) -> float:
    """Return when the last job ends if each, in order, goes to the process that is free first."""
    free = [0.0] * processes
    for duration in durations:
        heapq.heapreplace(free, free[0] + duration)
    return max(free)


def measure_backend(backend: str, counts: Sequence[int], knobs: Sequence[str]) -> Iterator[Record]:
    """Yield the figures of each number of processes, and then what those of the first predict."""
    jobs, shares = choose_jobs(backend, knobs), share_cpus(max(counts))
    if backend != "null":
        warm_ups = [replace(job, situation=replace(job.situation, rounds=job.share.count)) for job in jobs]
        run_jobs(warm_ups, shares, f"{backend}, untimed")
    base: tuple[float, float, float] | None = None
    predicted: list[Record] = []
    for count in counts:
        began, times = run_jobs(jobs, shares[:count], f"{backend}, {count} processes")
        ended = max(one.ended for one in times)
        durations = [one.ended - one.began for one in times]
        last = {one.process: one for one in sorted(times, key=lambda one: one.ended)}
        processor = sum(one.processor for one in last.values())
        spent = count * (ended - began)
        idle = sum(ended - one.ended for one in last.values()) + (count - len(last)) * (ended - began)
        start = min(one.began for one in times) - began
        if base is None:
            base = sum(durations), processor, spent
            makespans = {more: start + find_makespan(durations, more) for more in sorted({*PREDICTED, *counts})}
            predicted = [
                {"backend": backend, "predicted for": more, "seconds": round(seconds, 2),
                 "efficiency": round(spent / (more * seconds), 3)}
                for more, seconds in makespans.items()
            ]  # fmt: skip
        figures = {
            "start": start, "longest": max(durations), "idle": idle / spent, "work": base[0] / sum(durations),
            "processor": base[1] / processor, "efficiency": base[2] / spent,
        }  # fmt: skip
        about = {"backend": backend, "processes": count, "cpus_each": len(shares[0])}
        shown = {name: round(figure, 3) for name, figure in figures.items()}
        yield {**about, "seconds": round(ended - began, 2), **shown}
    yield from predicted


def measure(given: argparse.Namespace) -> Iterator[Record]:
    """Yield the rows of all backends."""
    for backend in given.backend or ("null", "cl", "gl"):
        yield from measure_backend(backend, given.processes, given.knob)


OPTIONS: Final = (
    options.option("--backend", "repeatable", None, "all", action="append", choices=("null", "cl", "gl")),
    options.several("--processes", "numbers of processes", options.parse_count, [1, 2, 4], "1,2,4", "N,N,…"),
    options.option("--knob", "repeatable", [], "all", action="append", choices=tuple(KNOBS)),
)


if __name__ == "__main__":
    # Optimised kernels would be built meanwhile, in processes of their own.
    run_benchmark(__doc__, OPTIONS, measure, kernels="quick")
