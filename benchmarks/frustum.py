"""The cost of frustum culling through the bounding volume hierarchy, compared with testing every box with
NumPy.

The scene is 100,000 boxes on a plain, like a city, seen along a camera path of 200 frames; about 5 % of the
boxes are visible. The reference, "every box", is the fastest plain NumPy form that was found: for each plane
it tests the p-vertex of every box (the corner farthest along the plane's normal), with contiguous columns.
Each other method alternates with it, frame by frame, in one process. Times are medians over the frames, and a
ratio is the median of the frames' ratios. "cold" is the same measurement with 64 MB of other memory read
before each call, as in a busy frame.

    python benchmarks/frustum.py [--json] [--boxes 100000] [--cube]
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from renderer.cli.comparison import run_benchmark
from renderer.cli.options import count, switch
from renderer.lab.comparison import Record, Subject, compare, ratio, time
from renderer.scene import Camera, Perspective
from renderer.visibility import HierarchyCuller, build_by_area, select_visible

Indices = NDArray[np.int64]
Floats = NDArray[np.float64]
FRAMES = 200
COLUMNS = {"microseconds": time(1e6, 1), "ratio": ratio(4)}


def make_boxes(count: int, cube: bool) -> tuple[Floats, Floats]:
    """Return the lower and upper corners (count, 3) of boxes of .4 to 6 m in a square of 1 km, 60 m high, or
    in a cube of 1 km."""
    rng = np.random.default_rng(0)
    centre = rng.uniform(-500.0, 500.0, (count, 3))
    if not cube:
        centre[:, 1] = rng.uniform(0.0, 60.0, count)
    half = rng.uniform(0.2, 3.0, (count, 3))
    return centre - half, centre + half


def make_cameras(cube: bool) -> list[Camera]:
    """Return the cameras of a path around the center that also turns, by up to 2 degrees per frame."""
    perspective = Perspective(fov=np.radians(60.0), far=390.0 if cube else 220.0)
    step = np.arange(FRAMES)
    eyes = np.stack([10 * np.sin(step / 30), np.full(FRAMES, 10.0), 10 * np.cos(step / 30)], axis=1)
    aims = np.stack([100 * np.sin(step / 50), np.full(FRAMES, 8.0), -100 * np.cos(step / 50)], axis=1)
    return [Camera.look_at(eye, aim, projection=perspective) for eye, aim in zip(eyes, aims, strict=True)]


def cull_with_early_out(planes: Floats, lower: Floats, upper: Floats) -> Indices:
    """Return the visible boxes; each plane is tested only on the boxes that passed the planes before it."""
    left: Indices | None = None
    for *normal, d in planes.tolist():
        far = [(upper if n > 0.0 else lower)[:, axis] for axis, n in enumerate(normal)]
        if left is not None:
            far = [column.take(left) for column in far]
        x, y, z = (column * n for column, n in zip(far, normal, strict=True))
        x += y
        x += z
        inside = (x >= -d).nonzero()[0]
        left = inside if left is None else left.take(inside)
    assert left is not None
    return left


OPTIONS: Final = (
    count("--boxes", "number of boxes", 100_000),
    switch("--cube", "spread the boxes in a cube: more cross planes"),
)


def measure(arguments: argparse.Namespace) -> Iterator[Record]:
    """Yield a row for each method.

    Raises:
        AssertionError: if a method finds other boxes than the reference.
    """
    lower, upper = make_boxes(arguments.boxes, arguments.cube)
    columns = np.ascontiguousarray(lower.T).T, np.ascontiguousarray(upper.T).T
    culler = HierarchyCuller(build_by_area(lower, upper), lower, upper)
    ways: dict[str, Callable[[Floats], Indices]] = {
        "every box": lambda planes: select_visible(planes, *columns).nonzero()[0],
        "every box, early out": lambda planes: cull_with_early_out(planes, *columns),
        "every box, rows of three": lambda planes: select_visible(planes, lower, upper).nonzero()[0],
        "hierarchy": lambda planes: culler.select_visible(planes)[0],
    }
    frames = [camera.frustum.planes for camera in make_cameras(arguments.cube)]
    expected = [ways["every box"](planes) for planes in frames]
    for memory, other in (("warm", np.ones(0)), ("cold", np.ones(8_000_000))):
        for name, way in ways.items():  # in pairs: what else runs in a round decides what is in the caches
            visible: list[Indices] = []

            def run(
                number: int, way: Callable[[Floats], Indices] = way, visible: list[Indices] = visible
            ) -> None:
                visible[:] = [way(frames[number])]

            def rounds(name: str = name, visible: list[Indices] = visible) -> Iterator[int]:
                for number in range(FRAMES):
                    yield number
                    if not np.array_equal(visible[0], expected[number]):
                        raise AssertionError(f"{name}: finds other boxes than the test of every box")

            base = Subject({}, lambda number: ways["every box"](frames[number]), other.sum)
            subject = Subject({"way": name, "memory": memory}, run, other.sum)
            yield compare([base, subject], COLUMNS, rounds())[1]


if __name__ == "__main__":
    run_benchmark(__doc__, OPTIONS, measure)
