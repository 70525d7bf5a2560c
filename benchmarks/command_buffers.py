"""The cost of command buffers: recording draws and replaying them, compared with drawing directly.

Each draw has constants of its own, so it is two commands (bind_uniform, draw). The triangles have no area, so none is
rasterised. The variants take turns, round by round, in one process; the figures are medians in microseconds per draw.

- `drawn at once`: the draws are issued on the device.
- `recorded`: the draws are recorded into a new command buffer, which isn't submitted.
- `first submission`: a new command buffer is submitted. This includes what is created once: the calls with their
  arguments, and the buffer of transient constants.
- `replayed`: a command buffer that was submitted before is submitted again.
- `recorded on 4 threads, together`: each of 4 threads records a quarter of the draws; the wall time is divided by the
  number of all draws.

With `transient constants` each draw allocates its constants from transient memory.

    python benchmarks/command_buffers.py [--backend gl] [--json] [--draws 5000] [--rounds 15]
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
    """Return the microseconds per draw of each variant."""
    with rhi.create_device(backend, record=False) as device:
        scene = Scene(device, draws, scale=0.0)

        def record(draw: Callable[[rhi.Encoder], None]) -> rhi.CommandBuffer:
            with device.record() as commands:
                draw(commands)
            return commands

        kept, fresh = record(scene.draw), [record(scene.draw)]
        device.submit(kept)
        recorded_anew = {
            "first submission": scene.draw,
            "first submission, transient constants": scene.draw_transient,
        }

        def prepare(name: str) -> None:
            if name in recorded_anew:
                fresh[0] = record(recorded_anew[name])
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
        times = alternate(work, range(rounds), before=prepare)
        return {name: each.median / draws * 1e6 for name, each in times.items()}


def record_on_threads(scene: Scene, count: int) -> None:
    """Record the draws of the scene on `count` threads, an equal share on each."""

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
    parser.add_argument("--backend", default="gl", help="backend to measure (default: %(default)s)")
    parser.add_argument("--draws", type=int, default=5000, help="draws per round (default: %(default)s)")
    parser.add_argument("--rounds", type=int, default=15, help="rounds (default: %(default)s)")
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")
    arguments = parser.parse_args()
    result = measure(arguments.backend, arguments.draws, arguments.rounds)
    if arguments.json:
        print(json.dumps(result, indent=2))
        return
    for name, microseconds in result.items():
        print(f"{name:40} {microseconds:8.2f} µs per draw")


if __name__ == "__main__":
    main()
