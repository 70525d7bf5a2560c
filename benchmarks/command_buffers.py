"""What command buffers cost: recording a draw and replaying it, against drawing it at once.

    python benchmarks/command_buffers.py [--backend gl] [--json] [--draws 5000] [--rounds 15]

Each draw has its own constants, so it is two commands (bind_uniform, draw); triangles end before the rasteriser. The
variants take turns round by round in one process; figures are medians, in microseconds a draw. `first submission`
includes what is made once: the calls with their arguments, and the buffer of transient constants.
"""

from __future__ import annotations

import argparse
import gc
import json
import statistics
import threading
import time

from scenes import Scene

import rhi


def measure(backend: str, draws: int, rounds: int) -> dict[str, float]:
    """Microseconds a draw, by variant."""
    with rhi.create_device(backend, record=False) as device:
        scene = Scene(device, draws, scale=0.0)
        times: dict[str, list[float]] = {}

        def take(name: str, start: float) -> None:
            times.setdefault(name, []).append((time.perf_counter() - start) / draws * 1e6)

        with device.record() as kept:
            scene.draw(kept)
        device.submit(kept)
        for _ in range(rounds):
            device.finish()
            gc.collect()
            start = time.perf_counter()
            scene.draw(device)
            take("drawn at once", start)
            device.finish()
            start = time.perf_counter()
            device.submit(kept)
            take("replayed", start)
            device.finish()
            start = time.perf_counter()
            with device.record() as commands:
                scene.draw(commands)
            take("recorded", start)
            start = time.perf_counter()
            device.submit(commands)
            take("first submission", start)
            device.finish()
            start = time.perf_counter()
            with device.record() as transient:
                scene.draw_transient(transient)
            take("recorded, transient constants", start)
            start = time.perf_counter()
            device.submit(transient)
            take("first submission, transient constants", start)
            device.finish()
            start = time.perf_counter()
            scene.draw_transient(device)
            take("drawn at once, transient constants", start)
            device.finish()
            start = time.perf_counter()
            record_on_threads(scene, 4)
            take("recorded on 4 threads, together", start)
        return {name: statistics.median(each) for name, each in times.items()}


def record_on_threads(scene: Scene, count: int) -> None:
    """As many draws as one pass has, a part on each thread."""

    def work(part: int) -> None:
        ranges = scene.ranges[part::count]
        with scene.device.record() as commands, commands.render_pass(scene.image):
            for constants in ranges:
                commands.draw(scene.program, scene.mesh, object=constants)

    threads = [threading.Thread(target=work, args=(part,)) for part in range(count)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--backend", default="gl")
    parser.add_argument("--draws", type=int, default=5000, help="draws a round")
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")
    arguments = parser.parse_args()
    result = measure(arguments.backend, arguments.draws, arguments.rounds)
    if arguments.json:
        print(json.dumps(result, indent=2))
        return
    for name, microseconds in result.items():
        print(f"{name:40} {microseconds:8.2f} µs a draw")


if __name__ == "__main__":
    main()
