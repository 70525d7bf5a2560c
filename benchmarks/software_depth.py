"""The cost of `software_depth` on its own OpenCL device: building the depth, and testing boxes against it.

The camera stands at the middle of each path of the scene. `depth_milliseconds` is the time to draw the depth of the
occluders that the algorithm chooses and to reduce it to the farthest depth of each tile. `test_milliseconds` is the
time to test `--boxes` boxes in one batch, including the upload and the readback; the boxes are those of the objects
in the frustum, repeated. Times are medians.

    python benchmarks/software_depth.py [--json] [--scene city] [--boxes 10000] [--size 960x540] [--rounds 60]
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

import rhi
from renderer.cli.options import parse_size
from renderer.content import load_scene
from renderer.scene import Scene
from renderer.visibility import FrustumCulling, SoftwareDepth, VisibilitySettings, find_visible_objects
from renderer.visibility.boxes.bounds import find_near, pad_boxes
from renderer.visibility.gpu.occluder_depth import OccluderDepth
from renderer.visibility.software_depth import BACKEND

TARGET = 2.0
"""The goal for testing 10,000 boxes, in milliseconds."""


def measure(scene: Scene, path: str, boxes: int, size: tuple[int, int], rounds: int) -> dict[str, Any]:
    """Measure one path; return its row."""
    frames = scene.paths[path]
    camera = frames.camera(len(frames) // 2).with_aspect(size[0] / size[1])
    rows = find_visible_objects(FrustumCulling(scene), camera)
    algorithm = SoftwareDepth(scene)
    chosen = algorithm.choose_occluders(camera, rows)
    algorithm.destroy()
    lower, upper, far = pad_boxes(camera, scene.objects.lower[rows], scene.objects.upper[rows])
    tested = np.resize(np.flatnonzero(~find_near(camera, lower, upper, far)), boxes)
    centre, half = 0.5 * (lower + upper)[tested] - camera.position, 0.5 * (upper - lower)[tested]
    times = []
    with rhi.create_device(BACKEND) as device:
        depth = OccluderDepth(device, scene, VisibilitySettings().occluders, boxes)
        for _ in range(rounds + 3):  # the first rounds compile, and are dropped
            begin = time.perf_counter()
            depth.render(camera, chosen, size)
            device.finish()
            built = time.perf_counter()
            shown = depth.find_shown(centre, half)
            times.append((built - begin, time.perf_counter() - built))
        depth.destroy()
    build, test = 1e3 * np.median(times[3:], axis=0)
    return {
        "path": path,
        "occluders": len(chosen),
        "triangles": scene.count_triangles(chosen),
        "boxes": boxes,
        "hidden_share": round(1.0 - float(shown.mean()), 3),
        "depth_milliseconds": round(float(build), 3),
        "test_milliseconds": round(float(test), 3),
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument(
        "--scene", default="city", help="a scene with paths `ground` and `sky` (default: %(default)s)"
    )
    parser.add_argument("--boxes", type=int, default=10_000, help="boxes to test in one batch (default: %(default)s)")
    parser.add_argument(
        "--size", type=parse_size, default=(960, 540), metavar="WxH", help="size of the image (default: 960x540)"
    )
    parser.add_argument("--rounds", type=int, default=60, help="rounds for each path (default: %(default)s)")
    given = parser.parse_args()
    scene = load_scene(given.scene)
    rows = [measure(scene, path, given.boxes, given.size, given.rounds) for path in ("ground", "sky")]
    if given.json:
        print(json.dumps({"target_milliseconds": TARGET, "rows": rows}, indent=2))
        return 0
    for row in rows:
        print("  ".join(f"{key} {value}" for key, value in row.items()))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
