"""What culling on the device finds, misses and costs: `two_pass` and `depth_pyramid`.

- Visibility along a path, compared with exact counts: every object is drawn with its number as its color, and the
  nearest one is kept for each pixel. `culled_share` is the share of the hidden objects in the frustum that weren't
  drawn. `second_share` is the number of objects in the second draw list, as a share of those in the frustum.
  `wrong_pixels` is the largest number of pixels in a frame that differ from the image without culling. The path is
  followed by `--teleports` frames at random places. These and the first frame count only for `wrong_pixels`.
- CPU time of a frame with 10,000 and with 100,000 objects: the processor time of the whole of `Renderer.render`, on
  the null device, which executes no draws. The two scenes take turns, frame by frame; figures are medians.

    python benchmarks/two_pass.py [--json] [--scene city] [--frames 60] [--teleports 12] [--size 960x540]
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
from renderer.lab.measure.exact import ExactVisibility
from renderer.lab.visibility import Picture
from renderer.renderer import Renderer
from renderer.scene import Scene
from renderer.visibility import (
    DepthPyramidCulling,
    DeviceCulling,
    FrustumCulling,
    NoCulling,
    TwoPassCulling,
    find_visible_objects,
)

ALGORITHMS = {"depth_pyramid": DepthPyramidCulling, "two_pass": TwoPassCulling}
TARGETS = {"culled_share": 0.95, "second_share": 0.03, "cpu_ratio": 1.2, "wrong_pixels": 0}
COUNTS = (10_000, 100_000)
ROUNDS = 60


def measure_path(
    device: rhi.Device, scene: Scene, path: str, frames: int, teleports: int, size: tuple[int, int]
) -> list[dict[str, Any]]:
    """Measure a path; return one row for each algorithm."""
    aspect, middle = size[0] / size[1], len(scene.paths[path]) // 2
    smooth = [scene.paths[path].camera(middle - frames // 2 + frame) for frame in range(frames + 1)]
    rng = np.random.default_rng(1)
    places = [scene.paths[name] for name in rng.choice(list(scene.paths), teleports)]
    cameras = smooth + [place.camera(int(rng.integers(len(place)))) for place in places]
    exact, frustum, none = ExactVisibility(device, scene, size), FrustumCulling(scene), NoCulling(scene)
    algorithms: dict[str, DeviceCulling] = {name: make(scene, device) for name, make in ALGORITHMS.items()}
    counts: dict[str, list[tuple[int, ...]]] = {name: [] for name in algorithms}
    wrong = dict.fromkeys(algorithms, 0)
    with Renderer(device, scene, size=size) as renderer:
        for frame, camera in enumerate(cameras):
            camera = camera.with_aspect(aspect)
            renderer.visibility = none
            expected = Picture.of(renderer.render(camera, frame / 60))
            in_frustum = set(find_visible_objects(frustum, camera).tolist())
            seen = exact.find(camera)
            hidden = in_frustum - seen
            for name, algorithm in algorithms.items():
                renderer.visibility = algorithm
                result = renderer.render(camera, frame / 60)
                wrong[name] = max(wrong[name], Picture.of(result).compare(expected)[0])
                drawn, second = set(result.visible.tolist()), len(algorithm.second.read_rows())
                if 0 < frame <= frames:
                    counts[name].append((len(in_frustum), len(seen), len(drawn), len(hidden - drawn), second))
    rows = []
    for name, samples in counts.items():
        total = np.array(samples).sum(0)
        rows.append(
            {
                "algorithm": name,
                "path": path,
                "in_frustum": round(total[0] / frames, 1),
                "seen": round(total[1] / frames, 1),
                "drawn": round(total[2] / frames, 1),
                "culled_share": round(total[3] / max(total[0] - total[1], 1), 4),
                "second": round(total[4] / frames, 1),
                "second_share": round(total[4] / total[0], 4),
                "wrong_pixels": wrong[name],
            }
        )
    return rows


def measure_cpu() -> list[dict[str, Any]]:
    """Measure the processor time of the thread that renders; return one row for each algorithm."""
    rows = []
    scenes = [load_scene(f"grid:mesh=box,count={count}") for count in COUNTS]
    for name, make in ALGORITHMS.items():
        times: list[list[float]] = [[] for _ in scenes]
        devices = [rhi.create_device("null") for _ in scenes]
        renderers = [
            Renderer(device, scene, visibility=make(scene, device), size=(64, 36))
            for device, scene in zip(devices, scenes, strict=True)
        ]
        for frame in range(ROUNDS + 3):
            for renderer, spent in zip(renderers, times, strict=True):
                camera = renderer.scene.paths["ground"].camera(600 + frame)
                renderer.device.stream.clear()
                began = time.thread_time()
                renderer.render(camera, frame / 60)
                spent.append(time.thread_time() - began)
        few, many = (np.array(spent[3:]) for spent in times)
        rows.append(
            {
                "algorithm": name,
                "objects": list(COUNTS),
                "cpu_milliseconds": [round(1e3 * float(np.median(spent)), 3) for spent in (few, many)],
                "cpu_ratio": round(float(np.median(many / few)), 3),
            }
        )
        for device in devices:
            device.close()
    return rows


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--scene", default="city", help="a scene with paths (default: %(default)s)")
    parser.add_argument("--paths", default="ground,sky", help="paths to measure (default: %(default)s)")
    parser.add_argument("--frames", type=int, default=60, help="frames of each path (default: %(default)s)")
    parser.add_argument("--teleports", type=int, default=12, help="teleports after each path (default: %(default)s)")
    parser.add_argument(
        "--size", type=parse_size, default=(960, 540), metavar="WxH", help="size of the image (default: 960x540)"
    )
    parser.add_argument("--backend", help="a backend that draws (default: the first that works)")
    given = parser.parse_args()
    scene = load_scene(given.scene)
    with rhi.create_device(given.backend) as device:
        found = [
            row
            for path in given.paths.split(",")
            for row in measure_path(device, scene, path, given.frames, given.teleports, given.size)
        ]
        report = {
            "scene": scene.name,
            "backend": device.backend_name,
            "size": list(given.size),
            "frames": given.frames,
            "teleports": given.teleports,
            "visibility": found,
            "cpu": measure_cpu(),
            "targets": TARGETS,
        }
    if given.json:
        print(json.dumps(report, indent=2))
        return 0
    for row in [*found, *report["cpu"]]:
        print("  ".join(f"{key.replace('_', ' ')} {value}" for key, value in row.items()))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
