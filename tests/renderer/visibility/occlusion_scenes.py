"""Scenes and cameras for occlusion culling, and an oracle in place of a device that rasterises."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from hypothesis import strategies as st

import rhi
from renderer.content.shapes import box, sphere
from renderer.renderer import FrameResult, Renderer
from renderer.scene import Camera, Orthographic, Perspective, Scene
from renderer.scene.scene import SceneBuilder
from renderer.scene.transforms import multiply, rotation, scaling, translation
from renderer.visibility import NoCulling, VisibilityAlgorithm
from renderer.visibility.boxes.forest import Forest
from renderer.visibility.gpu.depth_pyramid import CompareBoxes
from renderer.visibility.gpu.occludees import DRAWN, HIDDEN, VISIBLE, MarkBoxes, MarkListedBoxes
from renderer.visibility.gpu.reprojection import WriteDepth
from renderer.visibility.queries.box_queries import QueryBoxShader
from rhi import OcclusionQuery, QuerySet
from rhi.backends.null import Draw, NullBackend

WAITING = ("stop_and_wait", "chc", "chc_plus_plus")
"""The algorithms that wait for answers, if they must."""
OCCLUSION = (*WAITING, "conditional")
"""The algorithms that ask the device."""
DEVICE = ("depth_pyramid", "two_pass")
"""The algorithms that run on the device."""


def make_boxes(
    places: object,
    sizes: object,
    motion: Callable[[float], object] | None = None,
    moving: Collection[int] = (),
    name: str = "boxes",
    turns: object = None,
) -> Scene:
    """Boxes and spheres in turn, each of a colour of its own, at `places` (k, 3) with `sizes` (k, 3).

    `moving` ones go along `motion`: seconds to an offset (3,). `turns` are rotations (k, 4, 4).
    """
    places, sizes = np.asarray(places, float).reshape(-1, 3), np.asarray(sizes, float).reshape(-1, 3)
    builder = SceneBuilder(name)
    meshes = [builder.add_mesh(box()), builder.add_mesh(sphere(8))]
    stretched = scaling(sizes) if turns is None else multiply(turns, scaling(sizes))
    local = multiply(translation(places), stretched)
    dynamic = np.isin(np.arange(len(places)), list(moving))
    nodes = builder.add_nodes(local, dynamic=dynamic)
    colors = np.random.default_rng(3).uniform(0.1, 1.0, (len(places), 4))
    materials = [builder.add_material(base_color=tuple(color)) for color in colors]
    builder.add_objects(nodes, [meshes[row % 2] for row in range(len(places))], materials)
    if motion is not None:
        rows = np.flatnonzero(dynamic)

        def move(seconds: float) -> np.ndarray:
            return multiply(translation(places[rows] + np.asarray(motion(seconds))), stretched[rows])

        builder.animate(nodes[rows], move)
    builder.lights.add_directional((-0.4, -1.0, -0.3), (1.0, 1.0, 1.0), 1.5)
    return builder.build()


@st.composite
def scenes(draw: st.DrawFn) -> Scene:
    """Boxes at random; of places with many digits, so that no two faces are in one plane: then the nearer
    object isn't decided by the order of draws."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    count = draw(st.integers(1, 24))
    places, sizes = rng.uniform(-8.0, 8.0, (count, 3)), rng.uniform(0.05, 5.0, (count, 3))
    axis = rng.normal(size=3)
    turns = rotation(axis / np.linalg.norm(axis), rng.uniform(0.0, 6.3, count))
    return make_boxes(places, sizes, turns=turns if draw(st.booleans()) else None)


coordinates = st.floats(-9.0, 9.0, width=32)
points = st.tuples(coordinates, coordinates, coordinates)


@st.composite
def cameras(draw: st.DrawFn) -> Camera:
    """Draw cameras among the boxes, some of them inside a box, with all kinds of lenses."""
    eye, aim = np.array(draw(points)), np.array(draw(points))
    if np.abs(aim - eye).max() < 1e-3:
        aim = eye - np.array((0.0, 0.0, 1.0))
    lens: Perspective | Orthographic
    if draw(st.integers(0, 4)):
        far = draw(st.sampled_from([np.inf, 60.0]))
        lens = Perspective(draw(st.floats(0.2, 2.4)), near=draw(st.sampled_from([0.1, 1.0])), far=far)
    else:
        lens = Orthographic(draw(st.floats(2.0, 20.0)), near=draw(st.sampled_from([-5.0, 0.0])), far=40.0)
    return Camera.look_at(eye, aim, projection=lens)


def draw_with(
    renderer: Renderer, algorithm: VisibilityAlgorithm, camera: Camera, seconds: float = 0.0
) -> FrameResult:
    """Render one frame with this algorithm."""
    renderer.visibility = algorithm
    return renderer.render(camera, seconds)


@dataclass
class Oracle:
    """Tells the null device which objects show: `seen` holds their rows.

    A draw of the object passes samples then, and so does the box of each node above it. Algorithms of the device run
    on NumPy, but for what looks at depth: where a box shows, its object is marked; on the small image that two-pass
    culling guesses with, where it is `guessed`.
    """

    device: rhi.Device
    scene: Scene
    name: str = "chc_plus_plus"
    """The algorithm: it says what the boxes are."""
    seen: set[int] = field(default_factory=set)
    guessed: set[int] = field(default_factory=set)
    samples: int = 100
    helpers: set[int] = field(default_factory=set)
    """Programs that draw no objects."""
    executed: list[int] = field(default_factory=list)
    """Rows of the objects whose draws were executed, and not dropped by a condition."""

    def __post_init__(self) -> None:
        forest = Forest(self.scene)
        self.members: list[set[int]] = [set() for _ in range(len(forest))]
        for node in range(len(forest) - 1, -1, -1):
            if forest.object[node] >= 0:
                self.members[node].add(forest.object[node])
            if forest.parent[node] >= 0:
                self.members[forest.parent[node]] |= self.members[node]
        if self.name == "stop_and_wait":
            self.members = [{row} for row in range(len(self.scene.objects))]
        elif self.name in OCCLUSION and self.name != "chc":
            self.members = [self.members[node] for node in forest.tight.tolist()]
        self.boxes = self.device.program(QueryBoxShader).id
        backend = self.device.backend_as(NullBackend)
        if self.name in DEVICE:
            stand_ins = {MarkBoxes: self.guess, MarkListedBoxes: self.mark, CompareBoxes: self.compare}
            backend.run_shaders({self.device.program(one).id: by for one, by in stand_ins.items()})
            self.helpers = {self.device.program(one).id for one in (MarkBoxes, MarkListedBoxes, WriteDepth)}
        backend.count_samples(self.count)

    def guess(self, bound: Mapping[str, np.ndarray], draw: Draw | None) -> None:
        """Stand in for the fragments of `MarkBoxes`."""
        marks = bound["marks"]
        marks[[row for row in self.guessed if marks[row] == HIDDEN]] = VISIBLE

    def mark(self, bound: Mapping[str, np.ndarray], draw: Draw | None) -> None:
        """Stand in for the fragments of `MarkListedBoxes`."""
        assert draw is not None
        rows = bound["rows"][: draw.instances]
        bound["marks"][[row for row in rows if row in self.seen]] = VISIBLE

    def compare(self, bound: Mapping[str, np.ndarray], draw: Draw | None) -> None:
        """Stand in for `CompareBoxes`, without reading the pyramid."""
        marks = bound["marks"]
        shows = np.isin(np.arange(len(marks)), list(self.seen)) & ((marks == HIDDEN) | (marks == DRAWN))
        bound["seen"][:] = shows
        marks[shows & (marks == HIDDEN)] = VISIBLE

    def count(self, draw: Draw) -> int:
        """Return the samples of a draw."""
        if draw.program in self.helpers:
            return 0
        if draw.program == self.boxes:
            run = range(draw.base_instance, draw.base_instance + draw.instances)
            rows = set().union(*(self.members[box] for box in run))
        else:
            rows = {draw.base_instance}
            self.executed.append(draw.base_instance)
        return self.samples if rows & self.seen else 0


def visible(result: FrameResult) -> set[int]:
    """Return the objects drawn, and check that each is drawn once."""
    rows = result.visible.tolist()
    assert len(rows) == len(set(rows))
    return set(rows)


Shots = list[tuple[Camera, float]]
"""Cameras and times, frame by frame."""


class Uncut:
    """The frames of a scene without culling, drawn once, with which any number of algorithms are compared."""

    def __init__(
        self, device: rhi.Device, scene: Scene, shots: Shots, size: tuple[int, int] = (97, 55)
    ) -> None:
        self.scene, self.shots = scene, shots
        self._renderer = Renderer(device, scene, size=size)
        self._expected = self._draw(NoCulling(scene))

    def _draw(self, algorithm: VisibilityAlgorithm) -> list[np.ndarray]:
        return [draw_with(self._renderer, algorithm, *shot).image.read() for shot in self.shots]

    def count_wrong_pixels(self, algorithm: VisibilityAlgorithm) -> list[int]:
        """Count the pixels of each frame that differ."""
        pairs = zip(self._draw(algorithm), self._expected, strict=True)
        return [int((given != expected).any(2).sum()) for given, expected in pairs]

    def destroy(self) -> None:
        self._renderer.destroy()


def count_wrong_pixels(
    device: rhi.Device,
    scene: Scene,
    algorithm: VisibilityAlgorithm,
    shots: Shots,
    size: tuple[int, int] = (97, 55),
) -> list[int]:
    """Count the pixels of each frame that differ from no culling."""
    uncut = Uncut(device, scene, shots, size)
    wrong = uncut.count_wrong_pixels(algorithm)
    uncut.destroy()
    return wrong


def delay_answers(monkeypatch: pytest.MonkeyPatch, looks: int) -> None:
    """Let every query and query set be looked at (`is_finished`) so many times before its answer is there, and no more
    often, as quick or slow as the GPU may be; waiting for it always helps."""
    left: dict[int, int] = {}

    def delay(kind: type, begins: str) -> None:
        begin, read, wait = (getattr(kind, name) for name in (begins, "_read", "wait"))

        def begin_late(query: Any, *arguments: object) -> object:
            left[query.id] = looks
            return begin(query, *arguments)

        def read_late(query: Any) -> object:
            left[query.id] -= 1
            answer = None
            while left[query.id] < 0 and answer is None:
                answer = read(query)
            return answer

        def wait_late(query: Any) -> object:
            left[query.id] = 0
            return wait(query)

        for name, late in ((begins, begin_late), ("_read", read_late), ("wait", wait_late)):
            monkeypatch.setattr(kind, name, late)

    delay(OcclusionQuery, "begin")
    delay(QuerySet, "draw")


SIZE = (97, 55)
ORIGIN = (0.0, 0.0, 0.0)
WALL = (0.0, 0.0, -5.0)


def look(eye: object, aim: object, **lens: float) -> Camera:
    """Create a perspective camera."""
    return Camera.look_at(eye, aim, projection=Perspective(**lens))


def walk(scene: Scene, path: str, frames: Iterable[int]) -> Shots:
    """Return the cameras of these frames of a path, and their times."""
    return [(scene.paths[path].camera(frame), frame / 60) for frame in frames]


def _make_grey_boxes(places: object, sizes: object) -> Scene:
    scene = make_boxes(places, sizes)
    scene.materials["base_color"] = 0.5
    scene.objects.mesh[:] = 0
    return scene


_TOUCH = [0.25 * (1.0 + ulps * 2.0**-52) for ulps in (-1, 0, 1)]

HARD_CASES = {
    "camera 1.5 near from a corner, at 60°": (
        make_boxes([(0.0, 0.0, 0.0), (0.0, 0.0, -6.0)], [(2.0, 2.0, 2.0), (1.0, 1.0, 1.0)]),
        look((1.1, 1.1, 1.05), (-2.0, -2.0, -1.0), near=0.1),
    ),
    "camera inside a box": (
        make_boxes([ORIGIN, (0.0, 0.0, -0.5)], [(4.0, 4.0, 4.0), (0.5, 0.5, 0.5)]),
        look((0.0, 0.0, 1.0), (0.0, 0.0, -1.0), near=0.1),
    ),
    "everything visible": (
        make_boxes([(x, y, -9.0) for x in (-2, 0, 2) for y in (-2, 0, 2)], [(0.9, 0.9, 0.9)] * 9),
        look(ORIGIN, WALL),
    ),
    "everything hidden but a wall": (
        make_boxes(
            [WALL, *((x, y, -9.0) for x in (-1, 0, 1) for y in (-1, 0, 1))],
            [(30.0, 30.0, 0.1)] + [(0.5, 0.5, 0.5)] * 9,
        ),
        look(ORIGIN, WALL),
    ),
    "boxes without thickness": (
        make_boxes([WALL, (1.0, 0.0, -6.0), (0.0, 3.0, -5.5)], [(3.0, 3.0, 0.0), (3.0, 0.0, 3.0), (0.0, 3.0, 3.0)]),
        look(ORIGIN, WALL),
    ),
    "one object": (
        make_boxes([WALL], [(1.0, 1.0, 1.0)]),
        look(ORIGIN, WALL),
    ),
    "corner where w is 0": (
        make_boxes([(2.0, 0.0, 0.0), (0.0, 0.0, -4.0)], [(2.0, 2.0, 0.0), (1.0, 1.0, 1.0)]),
        look(ORIGIN, WALL, fov=2.2, near=0.1),
    ),
    "corners where w is negative": (
        make_boxes([(3.0, 0.0, 0.0), (2.5, 0.0, -6.0)], [(2.0, 2.0, 30.0), (3.0, 1.0, 1.0)]),
        look(ORIGIN, WALL, fov=2.2, near=0.1),
    ),
    "spheres that touch the near plane, to an ulp": (
        make_boxes(
            [(9.0, 9.0, -9.0)] + [(0.5 * (x - 1), 0.0, -0.1 - r) for x, r in enumerate(_TOUCH)] + [(0.0, 0.0, -4.0)],
            [(1.0, 1.0, 1.0)] + [(2.0 * r,) * 3 for r in _TOUCH] + [(9.0, 9.0, 1.0)],
        ),
        look(ORIGIN, WALL, fov=2.0, near=0.1),
    ),
    "slit of a pixel": (
        make_boxes(
            [(-5.03, 0.0, -5.0), (5.03, 0.0, -5.0), (0.0, 0.0, -20.0)],
            [(10.0, 9.0, 1.0), (10.0, 9.0, 1.0), (6.0, 6.0, 6.0)],
        ),
        look(ORIGIN, WALL),
    ),
    "two faces in one plane": (
        # Of one colour: which of the two shows where both are is up to the order of draws.
        _make_grey_boxes([WALL, WALL], [(1.0, 1.0, 1.0), (4.0, 0.5, 1.0)]),
        look(ORIGIN, WALL),
    ),
    "far from the world's origin": (
        make_boxes([(1e6, 0.0, -1e6), (1e6 + 0.3, 0.0, -1e6 - 3.0)], [(1.0, 1.0, 1.0), (1.0, 1.0, 1.0)]),
        look((1e6, 0.0, 5.0 - 1e6), (1e6, 0.0, -1e6)),
    ),
    "a parallel projection whose near plane cuts boxes": (
        make_boxes(
            [(0.0, 0.0, 0.5), (1.0, 0.2, -4.0), (1.0, 0.0, -9.0)],
            [(1.0, 1.0, 2.0), (1.5, 1.5, 1.0), (1.2, 1.2, 1.0)],
        ),
        Camera.look_at(ORIGIN, WALL, projection=Orthographic(6.0, near=0.0, far=40.0)),
    ),
}  # fmt: skip
"""A scene, and from where it is looked at."""
