"""When the tree of moving objects is worth rebuilding, and how it is best split.

600 boxes move before and behind two static walls, in one of four ways:

- shuffle: they swap places, then rest, again and again;
- drift: all go to the right, each a little faster or slower than the others;
- orbit: they circle a vertical axis, each at a speed of its own;
- explosion: they fly apart from one point.

For each factor by which the tree's cost may grow before it is rebuilt, the table shows the queries per frame of CHC and
CHC++, the number of rebuilds, and the processor time per frame for all that the forest does (bounds, rebuilds, status
and order of all nodes). `0` rebuilds in each frame, `inf` never. Answers to queries are taken at once, so that the
counts are the same in each run. `--splits` compares ways to split, at the factor that is in use.

    python benchmarks/moving.py [--json] [--splits] [--frames 90] [--boxes 600] [--backend gl]
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

import rhi
from renderer.content import BUILT_IN
from renderer.measure import format_records
from renderer.renderer import Renderer
from renderer.scene import Camera, Scene, SceneBuilder, scaling, translation
from renderer.scene.arrays import Floats
from renderer.scene.transforms import multiply
from renderer.visibility import Chc, ChcPlusPlus, build_by_area, build_by_middle
from renderer.visibility.boxes import forest
from renderer.visibility.queries.memory import NodeMemory

FACTORS = (0.0, 1.05, 1.1, 1.2, 1.4, 2.0, np.inf)
SPLITS = {"middle": build_by_middle, "area": build_by_area}
LOWER, UPPER = np.array((-12.0, -6.0, -60.0)), np.array((12.0, 6.0, -30.0))
WALLS = [((-10.0, 0.0, -20.0), (20.0, 40.0, 0.5)), ((8.0, 0.0, -40.0), (6.0, 10.0, 0.5))]

Motion = Callable[[float], Floats]
"""Seconds to the places (n, 3) of all boxes."""


def make_motions(count: int) -> dict[str, Motion]:
    """Return each motion of `count` boxes."""
    rng = np.random.default_rng(3)
    home = rng.uniform(LOWER, UPPER, (count, 3))
    orders = [rng.permutation(count) for _ in range(64)]
    speed = rng.normal(size=(count, 3))
    turning = rng.uniform(-1.0, 1.0, count)
    centre = 0.5 * (LOWER + UPPER)

    def shuffle(seconds: float) -> Floats:
        turn, part = divmod(seconds, 0.75)  # half a second on the way, a quarter at rest
        share = min(part / 0.5, 1.0)
        old, new = (home[orders[(int(turn) + one) % len(orders)]] for one in (0, 1))
        return np.asarray((1.0 - share) * old + share * new)

    def drift(seconds: float) -> Floats:
        return home + seconds * (np.array((2.0, 0.0, 0.0)) + speed)

    def orbit(seconds: float) -> Floats:
        x, y, z = (home - centre).T
        sine, cosine = np.sin(turning * seconds), np.cos(turning * seconds)
        return np.stack([cosine * x - sine * z, y, sine * x + cosine * z], axis=1) + centre

    def explosion(seconds: float) -> Floats:
        return centre + (0.05 + 3.0 * seconds) * speed

    return {"shuffle": shuffle, "drift": drift, "orbit": orbit, "explosion": explosion}


def make_scene(motion: Motion, count: int) -> Scene:
    """Return the walls and `count` boxes that move."""
    rng = np.random.default_rng(4)
    sizes = rng.uniform(0.2, 0.8, (count, 3))
    sizes[rng.random(count) < 0.05] *= 4.0  # a few large ones
    builder = SceneBuilder("moving boxes")
    mesh, material = builder.add_mesh(BUILT_IN["box"]()), builder.add_material()
    walls = np.stack([multiply(translation(place), scaling(size)) for place, size in WALLS])
    builder.add_objects(builder.add_nodes(walls), mesh, material)
    places = multiply(translation(motion(0.0)), scaling(sizes))
    nodes = builder.add_nodes(places, dynamic=np.ones(count, bool))
    builder.add_objects(nodes, mesh, material)
    builder.animate(nodes, lambda seconds: multiply(translation(motion(seconds)), scaling(sizes)))
    return builder.build()


@contextmanager
def measured(worn: float, split: str) -> Iterator[dict[str, float]]:
    """Rebuild at this factor and split like this; yield the number of rebuilds and the processor time."""
    counted = {"rebuilds": 0.0, "seconds": 0.0}
    follow, update = NodeMemory.follow, forest.Forest.update

    def timed(method: Callable[..., Any]) -> Callable[..., Any]:
        def call(*given: Any) -> Any:
            began = time.process_time()
            result = method(*given)
            counted["seconds"] += time.process_time() - began
            counted["rebuilds"] += result is True
            return result

        return call

    look = rhi.OcclusionQuery.is_finished.fget
    assert look is not None

    def answer(query: rhi.OcclusionQuery) -> bool:
        while not look(query):
            pass
        return True

    with (
        patch.object(forest, "WORN", worn),
        patch.object(forest, "build_by_middle", SPLITS[split]),
        patch.object(NodeMemory, "follow", timed(follow)),
        patch.object(forest.Forest, "update", timed(update)),
        patch.object(rhi.OcclusionQuery, "is_finished", property(answer)),
    ):
        yield counted


def measure(
    device: rhi.Device, motion: Motion, boxes: int, frames: int, worn: float, split: str
) -> dict[str, float]:
    """Measure one motion with one factor and one way to split."""
    scene = make_scene(motion, boxes)
    row = {}
    for name, make in (("chc", Chc), ("chc_plus_plus", ChcPlusPlus)):
        with measured(worn, split) as counted, Renderer(device, scene, size=(240, 135)) as renderer:
            renderer.visibility = algorithm = make(scene, device)
            queries = []
            for frame in range(frames):
                eye = np.array((0.01 * frame, 0.0, 0.0))
                camera = Camera.look_at(eye, eye - (0.0, 0.0, 1.0))
                queries.append(renderer.render(camera, frame / 60).statistics.queries)
            algorithm.destroy()
        row[name] = round(float(np.mean(queries[1:])), 1)
    row["rebuilds"] = counted["rebuilds"]
    row["update_ms"] = round(1e3 * counted["seconds"] / frames, 2)
    return row


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--splits", action="store_true", help="compare ways to split instead of factors")
    parser.add_argument("--frames", type=int, default=90, help="frames of each run (default: %(default)s)")
    parser.add_argument("--boxes", type=int, default=600, help="moving boxes (default: %(default)s)")
    parser.add_argument("--backend", default="gl", help="a backend that draws (default: %(default)s)")
    given = parser.parse_args()
    tried = [(forest.WORN, split) for split in SPLITS] if given.splits else [(f, "middle") for f in FACTORS]
    rows = []
    with rhi.create_device(given.backend) as device:
        for name, motion in make_motions(given.boxes).items():
            for worn, split in tried:
                row = measure(device, motion, given.boxes, given.frames, worn, split)
                rows.append({"motion": name, "factor": worn, "split": split, **row})
                if not given.json:
                    print(".", end="", file=sys.stderr, flush=True)
    print(format_records(rows, as_json=given.json))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
