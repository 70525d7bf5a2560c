"""Processes that share a folder of compiled kernels far too small for them, until a process ends that shouldn't.

    python tests/kits/cl_stress.py FOLDER [--minutes 30] [--processes 2] [--megabytes 3] [--seed 1]

Each process opens device after device on cl, builds new programs, resizes its targets, draws, and compares
pixels. The folder's limit makes each of them remove programs that the others use. Some are killed in the
middle, so that locks and files are left half done; others begin in their place.

Prints a line for each process that ends, and the counts; fails if one died or drew a wrong pixel. `FOLDER` keeps
what the processes wrote to standard error.
"""

from __future__ import annotations

import argparse
import faulthandler
import os
import random
import signal
import subprocess
import sys
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

SHADER: Final = """
import rhi.shading as sl

class Corner(sl.Struct):
    position: sl.vec4
    color: sl.vec4

class Varying(sl.Struct):
    clip: sl.vec4
    color: sl.vec4

class Scaled(sl.Shader):
    def vertex(self, v: Corner) -> Varying:
        return Varying(clip=v.position, color=v.color)

    def fragment(self, v: Varying) -> sl.vec4:
        return v.color * {factor!r}
"""
_KILLED: Final = 0.15
"""Share of the processes that are killed in the middle."""
_LIVES: Final = (20.0, 150.0)
"""Seconds of a process."""
_MOST_PROGRAMS: Final = 12
_FACTORS: Final = 40
"""How many programs there are: each process builds some that another has removed."""


@dataclass
class Result:
    """Counts of starts, ends and frames of the processes.

    Attributes:
        ends: how many processes ended with each status; those that were killed count as `killed`.
        counts: devices, programs, frames, wrong pixels, and devices without a cache, of those not killed.
        deaths: of each process that died, its status and the end of its standard error.
    """

    ends: Counter[str] = field(default_factory=Counter)
    counts: Counter[str] = field(default_factory=Counter)
    deaths: list[str] = field(default_factory=list)


def run_stress(
    folder: Path, seconds: float, processes: int = 2, limit: int = 3 << 20, seed: int = 1
) -> Result:
    """Run processes for some seconds; `limit`: bytes of the folder of compiled kernels."""
    chance = random.Random(seed)
    until = time.monotonic() + seconds
    environment = {name: value for name, value in os.environ.items() if name != "POCL_CACHE_DIR"}
    environment |= {"RHI_CACHE": str(folder / "kernels")}
    living: dict[subprocess.Popen[bytes], tuple[Path, float]] = {}
    result = Result()
    number = 0

    def begin() -> None:
        nonlocal number
        number += 1
        log = folder / f"{number}.log"
        life = min(chance.uniform(*_LIVES), max(5.0, until - time.monotonic()))
        is_killed = chance.random() < _KILLED
        kernels = {"RHI_KERNELS": "quick"} if number % 2 else {}
        command = [
            sys.executable,
            "-W",
            "ignore",
            __file__,
            "--live",
            f"{seed * 1000 + number}",
            f"{life}",
            f"{limit}",
        ]
        with log.open("wb") as file:
            process = subprocess.Popen(command, env=environment | kernels, stdout=file, stderr=file)
        living[process] = log, time.monotonic() + life * chance.random() if is_killed else float("inf")

    try:
        for _ in range(processes):
            begin()
        while living:
            time.sleep(0.2)
            for process, (log, end) in list(living.items()):
                if process.poll() is None and time.monotonic() >= end:
                    process.kill()
                    process.wait()
                if process.poll() is None:
                    continue
                del living[process]
                count_end(result, process.returncode, end <= time.monotonic(), log)
                if time.monotonic() < until:
                    begin()
    finally:
        for process in living:
            process.kill()
            process.wait()
    return result


def count_end(result: Result, status: int, was_due: bool, log: Path) -> None:
    """Add the end of a process to a result; `was_due`: whether it was to be killed."""
    output = log.read_text(encoding="utf-8", errors="replace")
    was_killed = was_due and status == -getattr(signal, "SIGKILL", 9)
    result.ends["killed" if was_killed else str(status)] += 1
    print(
        time.strftime("%T"), log.name, "killed" if was_killed else status, output.strip()[-200:], flush=True
    )
    if status == 0:
        for part in output.split():
            name, _, value = part.partition("=")
            result.counts[name] += int(value) if value.isdecimal() else 0
    elif not was_killed:
        result.deaths.append(f"{log.name}: status {status}\n{output[-4000:]}")


def live(seed: int, seconds: float, limit: int) -> None:
    """Draw for some seconds, and print the counts."""
    import numpy as np

    import rhi
    from rhi.backends.cl.cl_backend import ClBackend
    from rhi.backends.cl.pocl import kernel_cache
    from rhi.conformance.shapes import corners, rectangle
    from rhi.shading import from_source

    vars(kernel_cache)["LIMIT"] = limit
    chance = random.Random(seed)
    until = time.monotonic() + seconds
    counts: Counter[str] = Counter(devices=0, programs=0, frames=0, wrong=0, uncached=0)
    while time.monotonic() < until:
        with rhi.create_device("cl") as device:
            counts["devices"] += 1
            counts["uncached"] += not device.backend_as(ClBackend).context.cache.works
            programs: list[tuple[float, rhi.Program]] = []
            end = min(until, time.monotonic() + chance.uniform(2.0, 25.0))
            size = [chance.randint(8, 200), chance.randint(8, 200)]
            while time.monotonic() < end:
                if not programs or (chance.random() < 0.1 and len(programs) < _MOST_PROGRAMS):
                    factor = chance.randrange(1, _FACTORS) / 64
                    shader = from_source(SHADER.format(factor=factor), "Scaled")
                    programs.append((factor, device.program(shader)))
                    counts["programs"] += 1
                if chance.random() < 0.3:
                    size = [max(8, min(1600, int(side * chance.uniform(0.6, 1.9)))) for side in size]
                factor, program = chance.choice(programs)
                triangles = chance.choice([0, 0, 1, 50, 900])  # more items than all launches before
                whole = rectangle(color=(1.0, 0.5, 0.25, 1.0))
                with (
                    device.texture((size[0], size[1]), rhi.Format.RGBA8) as image,
                    device.mesh(whole) as mesh,
                ):
                    with device.render_pass(image, clear=(0, 0, 0, 0)):
                        device.draw(program, mesh)
                        if triangles:
                            points = np.ones((3 * triangles, 4))
                            points[:, :2] = np.random.default_rng(seed).uniform(-1, 1, (3 * triangles, 2))
                            points[:, 2] = 0.5
                            small = device.mesh(corners(points, (0.5, 0.5, 0.5, 1.0)))
                            with device.states(rhi.CullMode.NONE):
                                device.draw(program, small)
                    pixel = image.read()[size[1] // 2, size[0] // 2]
                    counts["frames"] += 1
                    if not triangles and abs(int(pixel[0]) - factor * 255) > 1:
                        counts["wrong"] += 1
    print(*(f"{name}={count}" for name, count in counts.items()))


def main() -> int:
    """Run the command; return the exit status."""
    if sys.argv[1:2] == ["--live"]:
        faulthandler.enable()
        live(int(sys.argv[2]), float(sys.argv[3]), int(sys.argv[4]))
        return 0
    parser = argparse.ArgumentParser(prog="cl_stress.py", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--megabytes", type=float, default=3.0, help="the limit of the folder of kernels")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    limit = int(options.megabytes * (1 << 20))
    result = run_stress(
        options.folder.resolve(), 60.0 * options.minutes, options.processes, limit, options.seed
    )
    print("ends", dict(result.ends), "counts", dict(result.counts))
    print(*result.deaths, sep="\n")
    return 1 if result.deaths or result.counts["wrong"] else 0


if __name__ == "__main__":
    sys.exit(main())
