"""Scenes and cameras for occlusion culling, and an oracle in place of a device that rasterises."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from frames import require_algorithm as require_algorithm
from hypothesis import strategies as st

import rhi
from renderer.content.shapes import box
from renderer.lab.exam.late_queries import delay_methods
from renderer.lab.exam.scenes import ORIGIN as ORIGIN
from renderer.lab.exam.scenes import SIZE as SIZE
from renderer.lab.exam.scenes import WALL_POSITION as WALL_POSITION
from renderer.lab.exam.scenes import Shots as Shots
from renderer.lab.exam.scenes import UnculledFrames as UnculledFrames
from renderer.lab.exam.scenes import count_wrong_pixels as count_wrong_pixels
from renderer.lab.exam.scenes import draw_with as draw_with
from renderer.lab.exam.scenes import make_boxes as make_boxes
from renderer.lab.exam.scenes import make_camera as make_camera
from renderer.lab.exam.scenes import walk as walk
from renderer.renderer import FrameResult
from renderer.scene import Camera, MeshGeometry, Orthographic, Perspective, Scene, SceneBuilder
from renderer.visibility.boxes.forest import Forest
from renderer.visibility.gpu.depth_pyramid import CompareBoxes
from renderer.visibility.gpu.occludees import DRAWN, HIDDEN, VISIBLE, MarkBoxes, MarkListedBoxes
from renderer.visibility.gpu.reprojection import WriteDepth
from renderer.visibility.queries.box_queries import QueryBoxShader
from rhi.backends.null import Draw, NullBackend
from rhi.math import rotation

WAITING = ("stop_and_wait", "chc", "chc_plus_plus")
"""The algorithms that wait for answers, if they must."""
OCCLUSION = (*WAITING, "conditional")
"""The algorithms that ask the device."""
DEVICE = ("depth_pyramid", "two_pass")
"""The algorithms that run on the device."""


def mirrored_boxes(*, two_sides: bool = False) -> Scene:
    """Make boxes of which every other one is mirrored, and one is skewed flat; every third one may have two
    sides, and lacks a face, so that its inside is seen."""
    builder = SceneBuilder("mirrored")
    rng, whole = np.random.default_rng(4), box()
    mesh, opened = builder.add_mesh(whole), builder.add_mesh(MeshGeometry(whole.vertices, whole.indices[6:]))
    local = np.tile(np.eye(4), (30, 1, 1))
    local[:, :3, :3] = rng.normal(size=(30, 3, 3))
    local[:, :3, 3] = rng.uniform(-6.0, 6.0, (30, 3))
    local[0, :3, 2] = 0.3 * local[0, :3, 0] + 0.2 * local[0, :3, 1]
    turned = np.linalg.det(local[:, :3, :3]) < 0.0
    assert 5 < turned.sum() < 25
    nodes = builder.add_nodes(local)
    for row, color in enumerate(rng.uniform(0.2, 1.0, (30, 4))):
        has_two = two_sides and row % 3 == 0
        material = builder.add_material(base_color=tuple(color), double_sided=has_two)
        builder.add_objects(nodes[row], opened if has_two else mesh, material)
    builder.lights.add_directional((-0.4, -1.0, -0.3), (1.0, 1.0, 1.0), 1.5)
    return builder.build()


def make_cloud(count: int = 60, seed: int = 7, **motion: Any) -> Scene:
    """Make small boxes around the origin, all in view from z = 30."""
    rng = np.random.default_rng(seed)
    return make_boxes(rng.uniform(-6.0, 6.0, (count, 3)), rng.uniform(0.1, 0.8, (count, 3)), **motion)


@st.composite
def scenes(draw: st.DrawFn) -> Scene:
    """Boxes at random; of places with many digits, so that no two faces are in one plane: then the nearer
    object isn't decided by the order of draws."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    count = draw(st.integers(1, 24))
    object_positions, sizes = rng.uniform(-8.0, 8.0, (count, 3)), rng.uniform(0.05, 5.0, (count, 3))
    axis = rng.normal(size=3)
    turns = rotation(axis / np.linalg.norm(axis), rng.uniform(0.0, 6.3, count))
    return make_boxes(object_positions, sizes, rotations=turns if draw(st.booleans()) else None)


coordinates = st.floats(-9.0, 9.0, width=32)
points = st.tuples(coordinates, coordinates, coordinates)


@st.composite
def cameras(draw: st.DrawFn) -> Camera:
    """Draw cameras among the boxes, some of them inside a box, with all kinds of projections."""
    eye, aim = np.array(draw(points)), np.array(draw(points))
    if np.abs(aim - eye).max() < 1e-3:
        aim = eye - np.array((0.0, 0.0, 1.0))
    projection: Perspective | Orthographic
    if draw(st.integers(0, 4)):
        far = draw(st.sampled_from([np.inf, 60.0]))
        projection = Perspective(draw(st.floats(0.2, 2.4)), near=draw(st.sampled_from([0.1, 1.0])), far=far)
    else:
        projection = Orthographic(
            draw(st.floats(2.0, 20.0)), near=draw(st.sampled_from([-5.0, 0.0])), far=40.0
        )
    return Camera.look_at(eye, aim, projection=projection)


@dataclass
class Oracle:
    """Tells the null device which objects show: `visible_objects` holds their rows.

    A draw of the object passes samples then, and so does the box of each node above it. Algorithms of the
    device run on NumPy, but for what looks at depth: where a box shows, its object is marked; on the small
    image that two-pass culling guesses with, where it is `guessed`.
    """

    device: rhi.Device
    scene: Scene
    name: str = "chc_plus_plus"
    """The algorithm: it says what the boxes are."""
    visible_objects: set[int] = field(default_factory=set)
    guessed: set[int] = field(default_factory=set)
    samples: int = 100
    helpers: set[int] = field(default_factory=set)
    """Programs that draw no objects."""
    executed: list[int] = field(default_factory=list)
    """Indices of the objects whose draws were executed, and not dropped by a condition; of draws that the device
    lists, those of the instances."""

    def __post_init__(self) -> None:
        forest = Forest(self.scene)
        self.members: list[set[int]] = [set() for _ in range(len(forest))]
        for node in range(len(forest) - 1, -1, -1):
            if forest.object_index[node] >= 0:
                self.members[node].add(forest.object_index[node])
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
            backend.run_shaders({self.device.program(program).id: by for program, by in stand_ins.items()})
            self.helpers = {
                self.device.program(program).id for program in (MarkBoxes, MarkListedBoxes, WriteDepth)
            }
        backend.count_samples(self.count)

    def guess(self, bound: Mapping[str, np.ndarray], draw: Draw | None) -> None:
        """Stand in for the fragments of `MarkBoxes`."""
        marks = bound["marks"]
        marks[[row for row in self.guessed if marks[row] == HIDDEN]] = VISIBLE

    def mark(self, bound: Mapping[str, np.ndarray], draw: Draw | None) -> None:
        """Stand in for the fragments of `MarkListedBoxes`."""
        assert draw is not None
        rows = bound["object_indices"][: draw.instances]
        bound["marks"][[row for row in rows if row in self.visible_objects]] = VISIBLE

    def compare(self, bound: Mapping[str, np.ndarray], draw: Draw | None) -> None:
        """Stand in for `CompareBoxes`, without reading the pyramid."""
        marks = bound["marks"]
        shows = np.isin(np.arange(len(marks)), list(self.visible_objects)) & (
            (marks == HIDDEN) | (marks == DRAWN)
        )
        bound["was_visible"][:] = shows
        marks[shows & (marks == HIDDEN)] = VISIBLE

    def count(self, draw: Draw) -> int:
        """Return the samples of a draw."""
        if draw.program in self.helpers:
            return 0
        if draw.program == self.boxes:
            run = range(draw.base_instance, draw.base_instance + draw.instances)
            rows = set().union(*(self.members[box] for box in run))
        else:
            run = range(draw.base_instance, draw.base_instance + draw.instances)
            rows = set(run)
            self.executed += run
        return self.samples if rows & self.visible_objects else 0


def visible(result: FrameResult) -> set[int]:
    """Return the objects drawn, and check that each is drawn once."""
    rows = result.visible.tolist()
    assert len(rows) == len(set(rows))
    return set(rows)


def delay_query_results(monkeypatch: pytest.MonkeyPatch, looks: int) -> None:
    """Delay every query and query set by this many reads of `is_finished` before its answer is there,
    until the test ends."""
    for kind, name, method in delay_methods(looks):
        monkeypatch.setattr(kind, name, method)
