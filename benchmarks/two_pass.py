"""Findings, misses and costs of culling on the device: `two_pass` and `depth_pyramid`.

- Visibility along a path, compared with exact counts: every object is drawn with its number as its color, and the
  nearest one is kept for each pixel. `culled_share` is the share of the hidden objects in the frustum that weren't
  drawn. `second_share` is the number of objects in the second draw list, as a share of those in the frustum.
  `wrong_pixels` is the largest number of pixels in a frame that differ from the image without culling. The path is
  followed by `--teleports` frames at random places. These and the first frame count only for `wrong_pixels`.
- CPU time of a frame with 10,000 and with 100,000 objects: the processor time of the whole of `Renderer.render`, on
  the null device, which executes no draws. The two scenes take turns, frame by frame; figures are medians, and ratios
  are to the smaller scene.

    python benchmarks/two_pass.py [--json] [--scene city] [--frames 60] [--teleports 12] [--size 960x540]
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Final

import numpy as np

import rhi
from renderer.cli import options
from renderer.cli.comparison import run_benchmark
from renderer.content import load_scene
from renderer.lab.comparison import Frames, Record, Subject, compare, ratio, time
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
COLUMNS: Final = {"milliseconds": time(processor=True), "ratio": ratio(processor=True)}
"""The goals are a ratio of 1.2, .95 of the hidden culled, .03 in the second list, and no wrong pixels."""
COUNTS = (10_000, 100_000)
ROUNDS = 60


def measure_path(
    device: rhi.Device, scene: Scene, path: str, frames: int, teleports: int, size: tuple[int, int]
) -> Iterator[Record]:
    """Yield the row of each algorithm along a path."""
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
    for name, samples in counts.items():
        total = np.array(samples).sum(0)
        yield {
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


def measure_cpu() -> Iterator[Record]:
    """Yield the processor time of a frame with each algorithm and each number of objects."""
    scenes = {count: load_scene(f"grid:mesh=box,count={count}") for count in COUNTS}
    for name, make in ALGORITHMS.items():
        with ExitStack() as opened:
            subjects = []
            for count, scene in scenes.items():
                device = opened.enter_context(rhi.create_device("null"))
                renderer = Renderer(device, scene, visibility=make(scene, device), size=(64, 36))
                opened.enter_context(renderer)
                cameras = [scene.paths["ground"].camera(600 + frame) for frame in range(ROUNDS)]
                about = {"algorithm": name, "objects": count}
                subjects.append(Subject(about, Frames(renderer, *cameras)))
            yield from compare(subjects, COLUMNS, range(ROUNDS), warm_ups=3)


def measure(given: argparse.Namespace) -> Iterator[Record]:
    """Yield the rows of what is found along the paths, and of what it costs the CPU."""
    scene = load_scene(given.scene)
    with rhi.create_device(given.backend) as device:
        for path in given.paths.split(","):
            yield from measure_path(device, scene, path, given.frames, given.teleports, given.size)
    yield from measure_cpu()


OPTIONS: Final = (
    options.option("--scene", "a scene with paths", "city"),
    options.option("--paths", "paths to measure", "ground,sky"),
    options.frames(60, "frames of each path"),
    options.count("--teleports", "teleports after each path", 12, least=0),
    options.size(),
    options.option("--backend", "a backend that draws", None, "the first that works"),
)


if __name__ == "__main__":
    run_benchmark(__doc__, OPTIONS, measure)
