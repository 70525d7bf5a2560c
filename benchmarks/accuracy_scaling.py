"""How the sweep of all knobs (`python -m renderer accuracy`) scales with processes.

The jobs are those of the command, a knob each, at a small size. They run on 1, 2, 4 … processes, begun afresh for each
count and each with a device of its own, on the executor of `--executor processes:N`.

Every process has the same number of CPUs and of drivers' threads, however many there are: an N-th of the machine, N
being the largest count. So N processes have N times what one has. Left to itself, one process would use all CPUs in its
drivers' threads (PoCL, llvmpipe), and several would start as many threads as that each, on the same CPUs.

- seconds: by the clock, from the start of the first process to the last result.
- start: until the first job begins: the interpreter, imports and the driver.
- idle: the part of the processes' time in which they have no job any more, because others do the last ones.
- work: of the time in jobs, what one process takes for all of them, in that of N. Below 1, they slow each other.
- processor: the same by processor time, of start and jobs. Other programs disturb it less; it shows what is done more
  often by N processes, but not that they wait for memory or for the GPU.
- efficiency: the seconds of one process, in N times those of N.

A first run that isn't timed builds kernels into the caches on disk. On null, which draws nothing, a job records frames
with all values of a knob: this is the part of Python.

    python benchmarks/accuracy_scaling.py [--json] [--backend null|cl|gl] [--processes 1,2,4] [--knob K]
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Sequence
from concurrent.futures import as_completed
from dataclasses import asdict, dataclass, replace
from typing import Final

import rhi
from renderer.accuracy import KNOBS, Situation, SweepJob
from renderer.accuracy.sweep import DRAWS_NOTHING, find_lack, list_views, prepare_scene
from renderer.cli.executors import list_cpus, open_processes, share_cpus
from renderer.content import load_scene

SITUATION: Final = Situation("city", size=(240, 135), views=1, rounds=3)
NULL_FRAMES: Final = 24
"""Frames that are recorded with each value on null."""


@dataclass(frozen=True)
class JobTime:
    """When a job was done: the process, the clock's time at both ends, and the process's processor time until then."""

    process: int
    began: float
    ended: float
    processor: float


@dataclass(frozen=True)
class ScalingRow:
    """The figures of a number of processes, as the module describes them."""

    backend: str
    processes: int
    cpus_each: int
    seconds: float
    start: float
    idle: float
    work: float
    processor: float
    efficiency: float


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
                for number in range(NULL_FRAMES):
                    view = views[number % len(views)]
                    renderer.render(settings.aim(view.camera), view.seconds)
                    device.stream.clear()


def list_jobs(backend: str, knobs: Sequence[str]) -> list[SweepJob]:
    """Return the jobs of a backend. Those on null leave out what depends on what has been drawn."""
    situation = replace(SITUATION, backend=backend)
    is_recorded = backend == "null"
    chosen = (knob for knob in KNOBS.values() if not knobs or knob.name in knobs)
    return [
        SweepJob(situation, knob.name)
        for knob in chosen
        if not is_recorded or knob.within.get("algorithm") == "frustum"
    ]


def run_jobs(jobs: Sequence[SweepJob], shares: Sequence[Sequence[int]]) -> tuple[float, list[JobTime]]:
    """Do all jobs on a process for each share of the CPUs; return when the first process was started, and the times."""
    began = time.time()
    with open_processes(shares) as pool:
        return began, [one.result() for one in as_completed([pool.submit(run_job, job) for job in jobs])]


def measure(backend: str, counts: Sequence[int], knobs: Sequence[str]) -> list[ScalingRow]:
    """Return the figures of each number of processes; the first is what the others are compared with."""
    jobs, shares = list_jobs(backend, knobs), share_cpus(max(counts))
    if backend != "null":
        run_jobs([replace(job, situation=replace(job.situation, rounds=1)) for job in jobs], shares)
    rows: list[ScalingRow] = []
    base = (0.0, 0.0, 0.0)
    for count in counts:
        began, times = run_jobs(jobs, shares[:count])
        ended = max(one.ended for one in times)
        work = sum(one.ended - one.began for one in times)
        last = {one.process: one for one in sorted(times, key=lambda one: one.ended)}
        processor = sum(one.processor for one in last.values())
        spent = count * (ended - began)
        idle = sum(ended - one.ended for one in last.values()) + (count - len(last)) * (ended - began)
        if not rows:
            base = work, processor, spent
        first = min(one.began for one in times)
        figures = (first - began, idle / spent, base[0] / work, base[1] / processor, base[2] / spent)
        shown = (round(figure, 3) for figure in figures)
        rows.append(ScalingRow(backend, count, len(shares[0]), round(ended - began, 2), *shown))
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")
    parser.add_argument("--backend", action="append", choices=("null", "cl", "gl"), help="repeatable (default: all)")
    parser.add_argument("--processes", default="1,2,4", help="numbers of processes (default: %(default)s)")
    parser.add_argument(
        "--knob", action="append", default=[], choices=tuple(KNOBS), help="repeatable (default: all)"
    )
    options = parser.parse_args()
    counts = [int(text) for text in options.processes.split(",")]
    # By default optimised kernels are built meanwhile, in processes of their own.
    os.environ.setdefault("RHI_KERNELS", "quick")
    backends = options.backend or ("null", "cl", "gl")
    rows = [row for backend in backends for row in measure(backend, counts, options.knob)]
    if options.json:
        print(json.dumps({"cpus": len(list_cpus()), "rows": [asdict(row) for row in rows]}, indent=2))
        return
    for row in rows:
        print(
            f"{row.backend:<5} {row.processes} processes, {row.cpus_each} CPUs each: {row.seconds:7.1f} s, "
            f"start {row.start:.1f} s, idle {row.idle:4.0%}, work {row.work:4.0%}, "
            f"processor {row.processor:4.0%}, efficiency {row.efficiency:4.0%}"
        )


if __name__ == "__main__":
    main()
