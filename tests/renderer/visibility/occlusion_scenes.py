"""Scenes and cameras for occlusion culling, and an oracle in place of a device that rasterises."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, field

import numpy as np
from hypothesis import strategies as st

import rhi
from renderer.renderer import FrameResult, Renderer
from renderer.scene import Camera, Orthographic, Perspective, Scene
from renderer.scene.scene import SceneBuilder
from renderer.scene.shapes import box, sphere
from renderer.scene.transforms import multiply, scaling, translation
from renderer.visibility import VisibilityAlgorithm
from renderer.visibility.box_queries import BoxShader
from renderer.visibility.forest import Forest
from rhi.backends.null import NullBackend
from rhi.backends.null.queries import Draw

WAITING = ("stop_and_wait", "chc", "chc_plus_plus")
"""The algorithms that wait for answers, if they must."""
OCCLUSION = (*WAITING, "conditional")
"""The algorithms that ask the device."""


def make_boxes(
    places: object,
    sizes: object,
    motion: Callable[[float], object] | None = None,
    moving: Collection[int] = (),
    name: str = "boxes",
) -> Scene:
    """Boxes and spheres in turn, each of a colour of its own, at `places` (k, 3) with `sizes` (k, 3).

    `moving` ones go along `motion`: seconds to an offset (3,).
    """
    places, sizes = np.asarray(places, float).reshape(-1, 3), np.asarray(sizes, float).reshape(-1, 3)
    builder = SceneBuilder(name)
    meshes = [builder.add_mesh(box()), builder.add_mesh(sphere(8))]
    local = multiply(translation(places), scaling(sizes))
    dynamic = np.isin(np.arange(len(places)), list(moving))
    nodes = builder.add_nodes(local, dynamic=dynamic)
    colors = np.random.default_rng(3).uniform(0.1, 1.0, (len(places), 4))
    materials = [builder.add_material(base_color=tuple(color)) for color in colors]
    builder.add_objects(nodes, [meshes[row % 2] for row in range(len(places))], materials)
    if motion is not None:
        rows = np.flatnonzero(dynamic)

        def move(seconds: float) -> np.ndarray:
            return multiply(translation(places[rows] + np.asarray(motion(seconds))), scaling(sizes[rows]))

        builder.animate(nodes[rows], move)
    builder.lights.add_directional((-0.4, -1.0, -0.3), (1.0, 1.0, 1.0), 1.5)
    return builder.build()


@st.composite
def scenes(draw: st.DrawFn) -> Scene:
    """Boxes at random; of places with many digits, so that no two faces are in one plane: then the nearer
    object isn't decided by the order of draws."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    count = draw(st.integers(1, 24))
    return make_boxes(rng.uniform(-8.0, 8.0, (count, 3)), rng.uniform(0.05, 5.0, (count, 3)))


coordinates = st.floats(-9.0, 9.0, width=32)
points = st.tuples(coordinates, coordinates, coordinates)


@st.composite
def cameras(draw: st.DrawFn) -> Camera:
    """Anywhere among the boxes, inside some, with all kinds of lenses."""
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
    """One frame with this algorithm."""
    renderer.visibility = algorithm
    return renderer.render(camera, seconds)


@dataclass
class Oracle:
    """Tells the null device which objects show: `seen` holds their rows.

    A draw of the object passes samples then, and so does the box of each node above it.
    """

    device: rhi.Device
    scene: Scene
    name: str = "chc_plus_plus"
    """The algorithm: it says what the boxes are."""
    seen: set[int] = field(default_factory=set)
    samples: int = 100
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
        elif self.name != "chc":
            self.members = [self.members[node] for node in forest.tight.tolist()]
        self.boxes = self.device.program(BoxShader).id
        self.device.backend_as(NullBackend).count_samples(self.count)

    def count(self, draw: Draw) -> int:
        """The samples of a draw."""
        if draw.program == self.boxes:
            run = range(draw.base_instance, draw.base_instance + draw.instances)
            rows = set().union(*(self.members[box] for box in run))
        else:
            rows = {draw.base_instance}
            self.executed.append(draw.base_instance)
        return self.samples if rows & self.seen else 0


def visible(result: FrameResult) -> set[int]:
    """The objects drawn, each of them once."""
    rows = result.visible.tolist()
    assert len(rows) == len(set(rows))
    return set(rows)
