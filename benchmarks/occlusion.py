"""The CPU cost of CHC++ without the device's calls: microseconds per visited node.

The camera follows the city's ground path for 60 frames. Queries go to an oracle instead of a device, and are
answered at once: an object is visible if it is within 150 m of the eye, which is about as much as is visible
from a street. The update of all nodes for the camera (`update_milliseconds`: NumPy, over all nodes) is timed
apart from the traversal (`walk_microseconds_per_node`: Python, node by node).

On a backend that draws, the benchmark also measures how frame time grows when the scene has twice as many
objects but the same number are visible: boxes behind a wall, and 40 in front of it. The frames of the two
scenes take turns.

    python benchmarks/occlusion.py [--json] [--scene city] [--backend gl] [--boxes 10000]
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, nullcontext
from time import perf_counter
from typing import Any, Final

import numpy as np
from typing_extensions import override

import rhi
from renderer.cli import options
from renderer.cli.comparison import run_benchmark
from renderer.content import BUILT_IN, load_scene
from renderer.lab.comparison import Column, Frames, Record, Subject, average, compare, median_of, ratio, time
from renderer.renderer import Renderer
from renderer.scene import Camera, Scene, SceneBuilder, scaling, translation
from renderer.visibility import CallbackDrawer, ChcPlusPlus
from renderer.visibility.queries.box_queries import BoxQueries
from rhi.math import multiply

FRAMES = 60
TARGET = 4.0
COLUMNS: Final[dict[str, Column]] = {"milliseconds": time(digits=2), "ratio": ratio()}
"""The columns of the frames' costs; the goal of the ratio is 1.2."""
WALK: Final[dict[str, Column]] = {
    "visited_per_frame": average(1),
    "queries_per_frame": average(1),
    "walk_microseconds_per_node": median_of(digits=2),
    "update_milliseconds": median_of(),
}
"""The columns of the traversal, by clocks of its own."""
VISIBLE_DISTANCE = 150.0


class OracleSet:
    """A query set that is answered at once."""

    is_finished = True

    def __init__(self, shows: list[bool]) -> None:
        self.shows = shows


class OracleQueries(BoxQueries):
    """Queries that no device runs, with a list `nodes` (m,) of bool: whether each node is visible.

    Its methods override those of `BoxQueries`, so a type checker notices if those get other names.
    """

    def __init__(self, boxes: int) -> None:
        self.boxes = self.draws = self.issued = 0
        self.stalled = 0.0
        self.queried = bytearray(boxes)
        self.nodes: list[bool] = []

    @override
    def begin_frame(self, camera: Camera, boxes: object) -> None:
        self.issued = 0

    @override
    def states(self) -> Any:
        return nullcontext()

    @override
    def issue_set(self, nodes: Sequence[int], query_indices: Sequence[int]) -> Any:
        shows = [False] * (query_indices[-1] + 1)
        for node, row in zip(nodes, query_indices, strict=True):
            shows[row] |= self.nodes[node]
        self.issued += len(shows)
        return OracleSet(shows)

    @override
    def read(self, queries: Any) -> list[bool]:
        shows: list[bool] = queries.shows
        return shows

    @override
    def release_set(self, queries: Any) -> None:
        pass


def measure_walk(text: str) -> Record:
    """Measure the traversal of the scene `text` names; times are medians over the frames."""
    scene = load_scene(text)
    with rhi.create_device("null") as device:
        algorithm = ChcPlusPlus(scene, device)
    forest = algorithm._forest
    algorithm._queries = oracle = OracleQueries(len(forest))
    begin, spent = algorithm._begin, [0.0, 0.0]

    def timed_begin(camera: Camera, size: tuple[int, int]) -> None:
        began = perf_counter()
        begin(camera, size)
        spent[0] = perf_counter() - began
        away = np.maximum(np.maximum(forest.lower - camera.position, camera.position - forest.upper), 0.0)
        oracle.nodes = (np.linalg.norm(away, axis=1) < VISIBLE_DISTANCE).tolist()
        spent[1] = perf_counter() - began

    algorithm._begin = timed_begin  # type: ignore[method-assign]
    nothing, counts = CallbackDrawer(lambda rows: None), dict[str, float]()

    def walk(frame: int) -> None:
        camera = scene.paths["ground"].camera(frame)
        began = perf_counter()
        result = algorithm.render(camera, nothing)
        taken = perf_counter() - began - spent[1]
        counts.update(
            visited_per_frame=result.nodes_tested,
            queries_per_frame=result.queries,
            walk_microseconds_per_node=1e6 * taken / result.nodes_tested,
            update_milliseconds=1e3 * spent[0],
        )

    labels = {"scene": scene.name, "nodes": len(forest)}
    subject = Subject(
        labels, walk, count=counts.copy, summarize=lambda: {"target_microseconds_per_node": TARGET}
    )
    return compare([subject], WALK, range(600, 600 + FRAMES), warm_ups=0)[0]


def make_hidden(count: int) -> Scene:
    """Return a scene of `count` boxes behind a wall, in a region of fixed size, and 40 in front of it."""
    rng = np.random.default_rng(3)
    builder = SceneBuilder(f"{count} boxes")
    mesh, material = builder.add_mesh(BUILT_IN["box"]()), builder.add_material()
    hidden = rng.uniform((-60.0, -30.0, -160.0), (60.0, 30.0, -60.0), (count, 3))
    visible = rng.uniform((-14.0, -7.0, -40.0), (14.0, 7.0, -20.0), (40, 3))
    wall = multiply(translation((0.0, 0.0, -50.0)), scaling((200.0, 120.0, 1.0)))
    transforms = np.concatenate([translation(hidden), translation(visible), wall[None]])
    builder.add_objects(builder.add_nodes(transforms), mesh, material)
    builder.views["front"] = Camera.look_at((0.0, 0.0, 0.0), (0.0, 0.0, -1.0))
    return builder.build()


def measure_doubling(backend: str | None, boxes: int) -> Iterator[Record]:
    """Yield the time of a frame, and of one with twice as many boxes; the eye moves a little each frame."""
    positions = [np.array([0.02 * frame, 0.0, 0.0]) for frame in range(FRAMES + 1)]
    eyes = [Camera.look_at(eye, eye - (0.0, 0.0, 1.0)) for eye in positions]
    with rhi.create_device(backend) as device, ExitStack() as stack:
        if not device.capabilities.renders:
            return
        subjects = []
        for count, scene in zip((boxes, 2 * boxes), map(make_hidden, (boxes, 2 * boxes)), strict=True):
            renderer = stack.enter_context(Renderer(device, scene, visibility=ChcPlusPlus(scene, device)))
            labels = {"backend": device.backend_name, "boxes": count}
            subjects.append(Subject(labels, Frames(renderer, *eyes)))
        yield from compare(subjects, COLUMNS, range(1, FRAMES + 1), warm_ups=5)


def measure(arguments: argparse.Namespace) -> Iterator[Record]:
    """Yield the row of the traversal, and those of frames of the two scenes."""
    yield measure_walk(arguments.scene)
    yield from measure_doubling(arguments.backend, arguments.boxes)


OPTIONS: Final = (
    options.option("--scene", "a scene with a ground path", "city"),
    options.option("--backend", "backend for the doubled scene", None, "the first that works"),
    options.count("--boxes", "hidden boxes of the smaller scene", 10_000),
)


if __name__ == "__main__":
    run_benchmark(__doc__, OPTIONS, measure)
