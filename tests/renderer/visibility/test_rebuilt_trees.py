"""The tree of moving objects is rebuilt when it is worn, and what was known of its objects is kept."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from nightly_reasons import FEWER_CASES, ONLY_KERNELS
from occlusion_scenes import OCCLUSION, Uncut, delay_answers, draw_with, look, make_boxes, need_algorithm

import rhi
from renderer.renderer import Renderer
from renderer.scene import Scene
from renderer.visibility import Chc, VisibilitySettings, make_visibility
from renderer.visibility.boxes.forest import WORN, Forest
from renderer.visibility.queries.memory import NEVER, NodeMemory

EYE = look((0.0, 0.0, 0.0), (0.0, 0.0, -1.0), near=0.1)
BOXES = 80
SIZE = (64, 36)


def make_moving(motion: Callable[[np.ndarray, float], np.ndarray]) -> Scene:
    """Make boxes that move, `motion(places, seconds)` to places, and a wall that hides the left half."""
    rng = np.random.default_rng(5)
    places = rng.uniform((-12.0, -6.0, -60.0), (12.0, 6.0, -30.0), (BOXES, 3))
    sizes = [*rng.uniform(0.2, 0.8, (BOXES, 3)), (20.0, 60.0, 0.5)]
    return make_boxes(
        [*places, (-10.0, 0.0, -20.0)], sizes, lambda seconds: motion(places, seconds) - places, range(BOXES)
    )


def shuffle(places: np.ndarray, seconds: float) -> np.ndarray:
    """Swap all places after a second."""
    return np.random.default_rng(6).permutation(places) if seconds >= 1.0 else places


def drift(places: np.ndarray, seconds: float) -> np.ndarray:
    return places + np.array((3.0 * seconds, 0.0, 0.0))


def spread(places: np.ndarray, seconds: float) -> np.ndarray:
    return places * (1.0 + seconds)


@pytest.mark.parametrize(("motion", "is_worn"), [(shuffle, True), (drift, False), (spread, False)])
def test_a_tree_is_worn_when_its_objects_mix(motion: Callable[..., np.ndarray], is_worn: bool) -> None:
    # Not when all of them move together, nor when they fly apart: a fresh tree would be no better.
    scene = make_moving(motion)
    forest = Forest(scene)
    assert not forest.follow()
    scene.update(1.0)
    assert forest.follow() is is_worn
    forest.rebuild()
    assert not forest.follow()


def test_the_factor_is_the_boundary(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = make_moving(shuffle)
    forest = Forest(scene)
    before = forest._find_cost()
    scene.update(1.0)
    forest.follow()
    factor = forest._find_cost() / before
    assert factor > WORN
    for worn, wanted in ((factor * 1.001, False), (factor * 0.999, True)):
        monkeypatch.setattr("renderer.visibility.boxes.forest.WORN", worn)
        assert forest.follow() is wanted


def test_a_rebuilt_tree_holds_all_objects_once_and_is_that_of_a_new_forest() -> None:
    scene = make_moving(shuffle)
    forest = Forest(scene)
    scene.update(1.0)
    assert forest.follow()
    forest.rebuild()
    fresh = Forest(scene)
    assert sorted(forest.order.tolist()) == list(range(BOXES + 1))
    for name in ("parent", "child", "object", "roots"):
        assert getattr(forest, name) == getattr(fresh, name)
    for name in ("lower", "upper", "first", "count", "order", "tight", "tight_sizes"):
        assert np.array_equal(getattr(forest, name), getattr(fresh, name)), name


def test_what_is_known_of_objects_is_known_of_the_nodes_that_hold_them_now() -> None:
    scene = make_moving(shuffle)
    forest = Forest(scene)
    memory, last = NodeMemory(forest), 7
    root = forest.moving.start
    shown = {row for row in range(BOXES) if row % 3 == 0}
    unknown = {row for row in range(BOXES) if row % 3 == 1}
    for node in range(len(forest) - 1, root - 1, -1):  # children before their parents
        row, child = forest.object[node], forest.child[node]
        memory.visible[node] = row in shown if child < 0 else max(memory.visible[child : child + 2])
        is_known = row not in unknown if child < 0 else memory.visible[node]
        memory.visited[node] = last if is_known else NEVER
        memory.hidden_since[node], memory.next_query[node] = max(row, 0), 100 + row
    scene.update(1.0)
    assert forest.follow()
    memory._rebuild(last)
    for node in range(root, len(forest)):
        run = slice(forest.first[node], forest.first[node] + forest.count[node])
        below = set(forest.order[run].tolist())
        assert memory.visible[node] == bool(below & shown)
        assert memory.visited[node] == (last if below - unknown else NEVER)
        if len(below) == 1 and not below & unknown:
            assert (memory.hidden_since[node], memory.next_query[node]) == (min(below), 100 + min(below))


def test_what_is_below_a_hidden_node_is_known_to_be_hidden_as_long_as_that_node() -> None:
    scene = make_moving(shuffle)
    forest = Forest(scene)
    memory, last = NodeMemory(forest), 7
    memory.visited[forest.moving.start], memory.hidden_since[forest.moving.start] = last, 3
    scene.update(1.0)
    assert forest.follow()
    memory._rebuild(last)
    assert not any(memory.visible[forest.moving])
    assert set(memory.visited[forest.moving]) == {last}
    assert set(memory.hidden_since[forest.moving]) == {3}


def count_queries(device: rhi.Device, scene: Scene, name: str, frames: list[float]) -> list[int]:
    algorithm = make_visibility(name, scene, device, VisibilitySettings(persistence=1))
    with Renderer(device, scene, size=SIZE) as renderer:
        queries = [draw_with(renderer, algorithm, EYE, seconds).statistics.queries for seconds in frames]
    algorithm.destroy()
    return queries


@pytest.mark.nightly_cases("chc", reason=FEWER_CASES)
@pytest.mark.parametrize("name", ["chc", "chc_plus_plus"])
def test_after_a_shuffle_there_are_no_more_queries_than_with_a_new_tree(
    gl: rhi.Device, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    delay_answers(monkeypatch, 0)
    fresh = count_queries(gl, make_moving(lambda places, seconds: shuffle(places, 1.0)), name, [0.0] * 50)
    after = count_queries(gl, make_moving(shuffle), name, [0.0] * 25 + [1.0] * 25)
    assert np.mean(after[-20:]) <= 1.1 * np.mean(fresh[-20:])
    monkeypatch.setattr("renderer.visibility.boxes.forest.WORN", np.inf)  # the control: the old tree asks more
    worn = count_queries(gl, make_moving(shuffle), name, [0.0] * 25 + [1.0] * 25)
    assert np.mean(worn[-20:]) > 1.2 * np.mean(fresh[-20:])


def test_in_the_frame_of_a_rebuild_visible_objects_are_still_known(
    gl: rhi.Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    # What is known to be visible is drawn inside its query, without a box.
    delay_answers(monkeypatch, 0)
    scene = make_moving(drift)
    algorithm = Chc(scene, gl)
    with Renderer(gl, scene, size=SIZE) as renderer:

        def count_known() -> int:
            result = draw_with(renderer, algorithm, EYE)
            return result.statistics.queries - result.visibility.boxes

        settled = min([count_known() for _ in range(6)][2:])
        monkeypatch.setattr("renderer.visibility.boxes.forest.WORN", 0.0)
        assert min(count_known(), count_known()) >= settled > 5
        algorithm._visited[:] = [NEVER] * len(algorithm._visited)  # the control
        assert count_known() == 0
    algorithm.destroy()


@pytest.mark.nightly_cases("cl-*", reason=ONLY_KERNELS)
@pytest.mark.parametrize("leaf_size", [1, 3])
@pytest.mark.parametrize("name", OCCLUSION)
def test_objects_in_rebuilt_trees_look_as_without_culling(
    drawing_device: rhi.Device, monkeypatch: pytest.MonkeyPatch, name: str, leaf_size: int
) -> None:
    need_algorithm(drawing_device, name)
    monkeypatch.setattr("renderer.visibility.boxes.forest.WORN", 1.0)
    scene = make_moving(
        lambda places, seconds: places + 6.0 * np.sin(seconds * (1.0 + np.arange(3 * BOXES).reshape(-1, 3) % 7))
    )
    rebuilds = []
    rebuild = Forest.rebuild
    monkeypatch.setattr(Forest, "rebuild", lambda forest: (rebuilds.append(1), rebuild(forest)))
    with Uncut(drawing_device, scene, [(EYE, 0.1 * frame) for frame in range(8)], SIZE) as uncut:
        assert uncut.try_algorithm(name, leaf_size=leaf_size) == [0] * 8
    assert name == "stop_and_wait" or rebuilds
