"""What leaves of several objects cost and save: queries, draws and time of CHC and CHC++ on both paths of the city.

A leaf of several objects is queried once and drawn as a whole. For each largest number of objects in a leaf, the table
shows means per frame, and the median of the frames' ratios to the time with leaves of one object; the frames of all
sizes take turns. `objects` are those that were drawn, `draws` include boxes, and `of stop-and-wait` is the share of the
queries in the objects in the frustum, each of which stop-and-wait asks about.

    python benchmarks/leaf_size.py [--json] [--scene city] [--backend gl] [--frames 60] [--sizes 1 2 4 8 16]
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

import rhi
from renderer.content import load_scene
from renderer.measure import alternate, format_records
from renderer.renderer import FrameResult, Renderer
from renderer.scene import Scene
from renderer.visibility import FrustumCulling, Settings, find_visible_objects, make_visibility

FIRST = 600


def _count_draws(result: FrameResult) -> int:
    return result.statistics.draws + result.visibility.box_draws


def measure(
    device: rhi.Device, scene: Scene, path: str, sizes: list[int], frames: int
) -> list[dict[str, Any]]:
    """Measure both algorithms with all sizes of leaves on one path."""
    cameras = [scene.paths[path].camera(FIRST + frame) for frame in range(frames + 1)]
    frustum = FrustumCulling(scene)
    inside = np.mean([len(find_visible_objects(frustum, camera)) for camera in cameras[1:]])
    rows = []
    with Renderer(device, scene, size=(960, 540)) as renderer:
        for name in ("chc", "chc_plus_plus"):
            algorithms = {
                str(size): make_visibility(name, scene, device, Settings(leaf_size=size)) for size in sizes
            }
            results: dict[str, list[FrameResult]] = {size: [] for size in algorithms}

            def render(size: str, frame: int) -> None:
                renderer.visibility = algorithms[size]  # noqa: B023
                results[size].append(renderer.render(cameras[frame]))  # noqa: B023
                device.finish()

            work = {size: lambda frame, size=size: render(size, frame) for size in algorithms}
            times = alternate(work, range(1, frames + 1))
            for size, found in results.items():
                counted = found[1:]
                queries = np.mean([one.statistics.queries for one in counted])
                rows.append(
                    {
                        "path": path,
                        "algorithm": name,
                        "leaf size": int(size),
                        "queries": round(float(queries), 1),
                        "of stop-and-wait": round(float(queries / inside), 2),
                        "objects": round(float(np.mean([one.visibility.visible for one in counted])), 1),
                        "draws": round(float(np.mean([_count_draws(one) for one in counted])), 1),
                        "ms": round(1e3 * times[size].median, 1),
                        "ratio": round(times[size].ratio_to(times[str(sizes[0])]), 2),
                    }
                )
            for algorithm in algorithms.values():
                algorithm.destroy()
    return rows


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--scene", default="city", help="a scene with both paths (default: %(default)s)")
    parser.add_argument("--backend", default="gl", help="a backend that draws (default: %(default)s)")
    parser.add_argument("--frames", type=int, default=60, help="frames of each path (default: %(default)s)")
    parser.add_argument(
        "--sizes", type=int, nargs="+", default=[1, 2, 4, 8, 16], help="largest leaves to try"
    )
    given = parser.parse_args()
    scene = load_scene(given.scene)
    with rhi.create_device(given.backend) as device:
        rows = [
            row
            for path in ("ground", "sky")
            for row in measure(device, scene, path, given.sizes, given.frames)
        ]
    print(format_records(rows, as_json=given.json))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
