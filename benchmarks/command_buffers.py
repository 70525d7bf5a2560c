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
import threading
from collections.abc import Callable

from scenes import Scene

import rhi
from renderer.measure import alternate


def measure(backend: str, draws: int, rounds: int) -> dict[str, float]:
    """Microseconds a draw, by variant."""
    with rhi.create_device(backend, record=False) as device:
        scene = Scene(device, draws, scale=0.0)

        def record(draw: Callable[[rhi.Encoder], None]) -> rhi.CommandBuffer:
            with device.record() as commands:
                draw(commands)
            return commands

        kept, fresh = record(scene.draw), [record(scene.draw)]
        device.submit(kept)
        makes_anew = {
            "first submission": scene.draw,
            "first submission, transient constants": scene.draw_transient,
        }

        def get_ready(name: str) -> None:
            if name in makes_anew:
                fresh[0] = record(makes_anew[name])
            device.finish()
            gc.collect()

        work: dict[str, Callable[[int], object]] = {
            "drawn at once": lambda _: scene.draw(device),
            "replayed": lambda _: device.submit(kept),
            "recorded": lambda _: record(scene.draw),
            "first submission": lambda _: device.submit(fresh[0]),
            "recorded, transient constants": lambda _: record(scene.draw_transient),
            "first submission, transient constants": lambda _: device.submit(fresh[0]),
            "drawn at once, transient constants": lambda _: scene.draw_transient(device),
            "recorded on 4 threads, together": lambda _: record_on_threads(scene, 4),
        }
        times = alternate(work, range(rounds), before=get_ready)
        return {name: each.median / draws * 1e6 for name, each in times.items()}


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
