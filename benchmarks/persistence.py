"""The n of CHC++ (thesis 6.4.5, 6.5.1): for how many frames a visible object isn't asked about.

CHC++ with each n draws the same frames of a scene's ground path in turn in one process, in three stretches. The first
40 frames of a stretch aren't counted: the first of all draws everything in view, and what is hidden then is drawn until
it is asked about.

- queries, draws, triangles: the mean of a frame. p95: the queries of the frame that 5 % of them exceed.
- clock, processor: the time of a frame in that of n = 20, the default; medians of the frames' ratios.

    python benchmarks/persistence.py [--json] [--backend gl] [--size 320x180] [--frames 50] [--n 60,20,…] [SCENE …]
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

import rhi
from renderer.content import load_scene
from renderer.measure.alternate import alternate
from renderer.measure.frames import measure_frame
from renderer.renderer import FrameStatistics
from renderer.scene import FRAMES_PER_SECOND
from renderer.settings import RenderSettings
from renderer.visibility import Settings, VisibilityAlgorithm, make_visibility

HISTORY: Final = 40
PLACES: Final = (0.2, 0.5, 0.8)
_DEFAULT: Final = Settings().persistence


@dataclass(frozen=True)
class PersistenceRow:
    """The figures of a number of frames, as the module describes them."""

    scene: str
    backend: str
    n: int
    queries: float
    p95: float
    draws: float
    triangles: float
    clock: float
    processor: float


def measure(
    name: str, backend: str, size: tuple[int, int], frames: int, numbers: Sequence[int]
) -> list[PersistenceRow]:
    """Return a row for each n."""
    scene = load_scene(name)
    path = scene.paths["ground"]
    settings = RenderSettings().change_all({"technique.name": "forward", "algorithm": "frustum"})
    counted: dict[int, list[FrameStatistics]] = {n: [] for n in numbers}
    ratios: dict[int, list[tuple[float, float]]] = {n: [] for n in numbers}
    with rhi.create_device(backend) as device, settings.open(device, scene, size) as renderer:
        def draw(algorithm: VisibilityAlgorithm, first: int, n: int, frame: int) -> None:
            renderer.visibility = algorithm
            number = (first + frame) % len(path)
            result, _ = measure_frame(renderer, path.camera(number), number / FRAMES_PER_SECOND)
            if frame >= HISTORY:
                counted[n].append(result.statistics)

        for place in PLACES:
            first = int(place * len(path))
            algorithms = {n: make_visibility("chc_plus_plus", scene, device, Settings(persistence=n)) for n in numbers}

            work: dict[str, Callable[[int], object]] = {
                str(n): partial(draw, algorithm, first, n) for n, algorithm in algorithms.items()
            }
            for frame in range(HISTORY):
                for one in work.values():
                    one(frame)
            times = alternate(work, range(HISTORY, HISTORY + frames), 0)
            base = times[str(_DEFAULT)]
            for n in numbers:
                time = times[str(n)]
                clock = np.divide(time.seconds, base.seconds).tolist()
                processor = np.divide(time.processor_seconds, base.processor_seconds).tolist()
                ratios[n] += zip(clock, processor, strict=True)
                algorithms[n].destroy()
    rows = []
    for n in numbers:
        queries = [one.queries for one in counted[n]]
        means = [np.mean([getattr(one, what) for one in counted[n]]) for what in ("draws", "triangles")]
        figures = (np.mean(queries), np.quantile(queries, 0.95), *means, *np.median(ratios[n], axis=0))
        rows.append(PersistenceRow(name, backend, n, *(round(float(figure), 3) for figure in figures)))
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", nargs="*", metavar="SCENE", help="default: city, hall and night")
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")
    parser.add_argument("--backend", default="gl", choices=("cl", "gl"), help="default: %(default)s")
    parser.add_argument("--size", default="320x180", help="of the picture (default: %(default)s)")
    parser.add_argument("--frames", type=int, default=50, help="that count, of a stretch (default: %(default)s)")
    parser.add_argument("--n", default="60,20,10,5,2,1", help="the default among them (default: %(default)s)")
    options = parser.parse_args()
    width, height = (int(side) for side in options.size.split("x"))
    numbers = sorted({int(text) for text in options.n.split(",")} | {_DEFAULT}, reverse=True)
    rows = []
    for name in options.scene or ("city", "hall", "night"):
        for row in measure(name, options.backend, (width, height), options.frames, numbers):
            rows.append(row)
            if not options.json:
                print(
                    f"{row.scene:<6} {row.backend} n={row.n:<3} queries {row.queries:6.1f} (p95 {row.p95:4.0f}), draws "
                    f"{row.draws:6.1f}, triangles {row.triangles:8,.0f}, clock {row.clock:.2f}, "
                    f"processor {row.processor:.2f}",
                    flush=True,
                )
    if options.json:
        print(json.dumps({"rows": [asdict(row) for row in rows]}, indent=2))


if __name__ == "__main__":
    main()
