"""The cost of `software_depth` on its own OpenCL device: building the depth, and testing boxes against it.

The camera stands at the middle of each path of the scene. `depth_milliseconds` is the time to draw the depth
of the occluders that the algorithm chooses and to reduce it to the farthest depth of each tile.
`test_milliseconds` is the time to test `--boxes` boxes in one batch, including the upload and the readback;
the boxes are those of the objects in the frustum, repeated. Times are medians.

    python benchmarks/software_depth.py [--json] [--scene city] [--boxes 10000] [--size 960x540] [--rounds 60]
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator

import numpy as np

import rhi
from renderer.cli import options
from renderer.cli.comparison import run_benchmark
from renderer.content import load_scene
from renderer.lab.comparison import Record, Subject, compare, time
from renderer.scene import Scene
from renderer.visibility import FrustumCulling, SoftwareDepth, VisibilitySettings, list_visible_objects
from renderer.visibility.boxes.bounds import near_mask, pad_boxes
from renderer.visibility.gpu.occluder_depth import OccluderDepth
from renderer.visibility.software_depth import BACKEND

COLUMNS = {"milliseconds": time()}


def measure_path(scene: Scene, path: str, boxes: int, size: tuple[int, int], rounds: int) -> Record:
    """Measure one path; return its row."""
    frames = scene.paths[path]
    camera = frames.camera(len(frames) // 2).with_aspect(size[0] / size[1])
    rows = list_visible_objects(FrustumCulling(scene), camera)
    algorithm = SoftwareDepth(scene)
    occluders = algorithm.choose_occluders(camera, rows)
    algorithm.destroy()
    lower, upper, far = pad_boxes(camera, scene.objects.lower[rows], scene.objects.upper[rows])
    tested = np.resize(np.flatnonzero(~near_mask(camera, lower, upper, far)), boxes)
    centre, half = 0.5 * (lower + upper)[tested] - camera.position, 0.5 * (upper - lower)[tested]
    with rhi.create_device(BACKEND) as device:
        depth = OccluderDepth(device, scene, VisibilitySettings().occluders, boxes)

        def build(_: int) -> None:
            depth.render(camera, occluders, size)
            device.finish()

        steps = [Subject({}, build, device=device), Subject({}, lambda _: depth.test_boxes(centre, half))]
        built, tested_boxes = compare(steps, COLUMNS, range(rounds), warm_ups=3)
        visible = depth.test_boxes(centre, half)
        depth.destroy()
    return {
        "path": path,
        "occluders": len(occluders),
        "triangles": scene.count_triangles(occluders),
        "boxes": boxes,
        "hidden_share": round(1.0 - float(visible.mean()), 3),
        "depth_milliseconds": built["milliseconds"],
        "test_milliseconds": tested_boxes["milliseconds"],
        "kernels": built["kernels"],
    }


def measure(arguments: argparse.Namespace) -> Iterator[Record]:
    """Yield the row of each path."""
    scene = load_scene(arguments.scene)
    for path in ("ground", "sky"):
        yield measure_path(scene, path, arguments.boxes, arguments.size, arguments.rounds)


OPTIONS = (
    options.option("--scene", "a scene with paths `ground` and `sky`", "city"),
    options.count("--boxes", "boxes to test in one batch", 10_000),
    options.size(),
    options.rounds("rounds for each path", 60),
)


if __name__ == "__main__":
    run_benchmark(__doc__, OPTIONS, measure)
