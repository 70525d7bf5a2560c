"""Moving objects are culled like static ones: all trees are walked together, front to back.

Images can't show that: an algorithm that asks about moving objects too early draws all of them and still
gives the right image. So objects and queries are counted, in a scene and in copies of it whose objects are
declared as moving.
"""

from __future__ import annotations

from collections.abc import Callable, Collection

import numpy as np
import pytest
from frames import require_algorithm
from hypothesis import given, settings
from hypothesis import strategies as st
from nightly_reasons import FEWER_CASES, ONLY_KERNELS
from occlusion_scenes import (
    SIZE,
    UnculledFrames,
    cameras,
    delay_query_results,
    draw_with,
    make_boxes,
    make_camera,
    visible,
)

import rhi
from renderer.renderer import Renderer
from renderer.scene import Camera, Scene
from renderer.visibility import ALGORITHMS, VisibilitySettings, make_visibility
from renderer.visibility.boxes.bounds import squared_distances
from renderer.visibility.boxes.forest import Forest, Frontier

EYE = make_camera((0.0, 0.0, 0.0), (0.0, 0.0, -1.0), near=0.1)
BOXES = 120
WALLS = {"all": [((0.0, 0.0, -20.0), (100.0, 60.0, 0.5))], "half": [((-10.0, 0.0, -20.0), (20.0, 60.0, 0.5))]}
"""The place and size of the wall that hides all boxes, and of the one that hides the left half."""
SETTLING = 14
FRAMES = 8
SPREAD, DETOUR = 0.15, 7
"""By how much the numbers of queries may differ, as a share and in each frame: the trees differ in their
splits. The wall's leaf is at the root of a tree by surface area, and log2 of 121 levels below it in a
balanced one."""

NAMES = tuple(name for name in ALGORITHMS if name != "auto")  # whose choice depends on the time


def stand_still(seconds: float) -> tuple[float, float, float]:
    return (0.0, 0.0, 0.0)


def make_walled(wall: str, moving: Collection[int], motion: Callable[[float], object] = stand_still) -> Scene:
    """Make boxes behind a wall, the last object; those of `moving` go along `motion`."""
    rng = np.random.default_rng(3)
    object_positions = rng.uniform((-12.0, -6.0, -60.0), (12.0, 6.0, -30.0), (BOXES, 3))
    object_positions = [*object_positions, *(position for position, _ in WALLS[wall])]
    sizes = [*rng.uniform(0.2, 0.8, (BOXES, 3)), *(size for _, size in WALLS[wall])]
    return make_boxes(object_positions, sizes, motion=motion if len(moving) else None, moving=moving)


def count(device: rhi.Device, scene: Scene, name: str) -> tuple[list[set[int]], int]:
    """Return the objects drawn in each of some frames, when all is settled, and the number of queries in
    them."""
    drawn, queries = [], 0
    algorithm = make_visibility(name, scene, device, VisibilitySettings(batch=4, persistence=4))
    with Renderer(device, scene, size=SIZE) as renderer:
        for frame in range(SETTLING + FRAMES):
            result = draw_with(renderer, algorithm, EYE, frame / 60)
            if frame >= SETTLING:
                drawn.append(visible(result))
                queries += result.statistics.queries
    algorithm.destroy()
    return drawn, queries


@pytest.mark.nightly_cases("cl-*", reason=ONLY_KERNELS)
@pytest.mark.nightly_cases("gl-all-stop_and_wait", "gl-half-*", reason=FEWER_CASES)
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("wall", WALLS)
def test_a_moving_copy_of_a_scene_draws_the_same_objects_with_about_as_many_queries(
    device: rhi.Device, monkeypatch: pytest.MonkeyPatch, name: str, wall: str
) -> None:
    require_algorithm(device, name)
    delay_query_results(monkeypatch, 0)
    still, asked = count(device, make_walled(wall, ()), name)
    for moving in (range(BOXES), range(BOXES + 1)):  # the boxes; all objects
        drawn, queries = count(device, make_walled(wall, moving), name)
        assert drawn == still
        assert abs(queries - asked) <= SPREAD * asked + FRAMES * DETOUR


def test_a_moving_copy_is_a_tree_of_its_own() -> None:
    # The control: the copies that are compared differ in what their trees hold.
    sizes = [
        forest.count[forest.roots].tolist()
        for forest in (Forest(make_walled("all", moving)) for moving in ((), range(BOXES), range(BOXES + 1)))
    ]
    assert sizes == [[BOXES + 1], [1, BOXES], [BOXES + 1]]


def walk_all(forest: Forest) -> list[int]:
    """Visit all nodes in view as if all of them were visible, and return them in this order."""
    frontier, visited = Frontier(forest), []
    frontier.begin()
    while frontier:
        visited.append(frontier.pop())
        if forest.child[visited[-1]] >= 0:
            frontier.open(visited[-1])
    return visited


@settings(max_examples=30)
@given(st.integers(1, 40), st.integers(0, 2**32 - 1), st.floats(0.0, 1.0), cameras())
def test_all_trees_are_walked_front_to_back_together(
    objects: int, seed: int, share: float, camera: Camera
) -> None:
    # From inside boxes too; with no moving objects, with nothing else, and with boxes at equal distances.
    rng = np.random.default_rng(seed)
    object_positions = rng.integers(-4, 5, (objects, 3)) if seed % 2 else rng.uniform(-8.0, 8.0, (objects, 3))
    moving = np.flatnonzero(rng.uniform(size=objects) < share)
    forest = Forest(
        make_boxes(object_positions, rng.uniform(0.05, 5.0, (objects, 3)), stand_still, moving.tolist())
    )
    forest.update(camera)
    visited = walk_all(forest)
    assert sorted(visited) == np.flatnonzero(np.frombuffer(forest.status, np.uint8)).tolist()
    distances = squared_distances(camera.position, forest.lower[visited], forest.upper[visited])
    assert (np.diff(distances) >= 0.0).all()


def test_equally_near_nodes_are_ordered_by_the_distance_of_their_centres() -> None:
    object_positions, sizes = (
        [(0.0, 0.0, -0.1), (0.0, 0.0, -1.0)],
        [(1.0, 1.0, 1.0), (4.0, 4.0, 4.0)],
    )  # around the eye
    for order in ([0, 1], [1, 0]):
        forest = Forest(
            make_boxes(np.array(object_positions)[order], np.array(sizes)[order], stand_still, (1,))
        )
        forest.update(EYE)
        assert [forest.object_index[node] for node in walk_all(forest)] == [order.index(0), order.index(1)]


def test_an_aborted_traversal_leaves_nothing_behind() -> None:
    forest = Forest(make_walled("half", range(BOXES)))
    forest.update(EYE)
    frontier = Frontier(forest)
    frontier.begin()
    frontier.open(frontier.pop() if forest.child[forest.roots[0]] >= 0 else forest.roots[1])
    assert frontier
    frontier.begin()
    assert sorted(frontier.pop() for _ in range(len(frontier))) == forest.roots


@pytest.mark.parametrize("name", [name for name in NAMES if name != "none"])
def test_objects_that_move_through_the_near_plane_look_as_without_culling(
    drawing_device: rhi.Device, name: str
) -> None:
    require_algorithm(drawing_device, name)
    scene = make_walled("half", range(BOXES + 1), motion=lambda seconds: (0.0, 0.0, 60.0 * seconds))
    shots = [(EYE, second) for second in (0.0, 0.2, 0.33, 0.334, 0.5, 0.7, 1.1, 0.0, 0.3)]
    with UnculledFrames(drawing_device, scene, shots) as uncut:
        assert uncut.try_algorithm(name) == [0] * len(shots)
