"""The tree of moving objects is rebuilt when it is worn, and what was known of its objects is kept."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from nightly_reasons import FEWER_CASES, ONLY_KERNELS
from occlusion_scenes import (
    OCCLUSION,
    UnculledFrames,
    delay_query_results,
    draw_with,
    make_boxes,
    make_camera,
    require_algorithm,
)

import rhi
from renderer.renderer import Renderer
from renderer.scene import Scene
from renderer.visibility import Chc, VisibilitySettings, make_visibility
from renderer.visibility.boxes.forest import REBUILD_RATIO, Forest
from renderer.visibility.queries.node_history import NEVER, NodeHistory

EYE = make_camera((0.0, 0.0, 0.0), (0.0, 0.0, -1.0), near=0.1)
BOXES = 80
SIZE = (64, 36)


def make_moving(motion: Callable[[np.ndarray, float], np.ndarray]) -> Scene:
    """Make boxes that move, `motion(object_positions, seconds)` to places, and a wall that hides the left
    half."""
    rng = np.random.default_rng(5)
    object_positions = rng.uniform((-12.0, -6.0, -60.0), (12.0, 6.0, -30.0), (BOXES, 3))
    sizes = [*rng.uniform(0.2, 0.8, (BOXES, 3)), (20.0, 60.0, 0.5)]
    return make_boxes(
        [*object_positions, (-10.0, 0.0, -20.0)],
        sizes,
        lambda seconds: motion(object_positions, seconds) - object_positions,
        range(BOXES),
    )


def shuffle(positions: np.ndarray, seconds: float) -> np.ndarray:
    """Swap all places after a second."""
    return np.random.default_rng(6).permutation(positions) if seconds >= 1.0 else positions


def drift(positions: np.ndarray, seconds: float) -> np.ndarray:
    return positions + np.array((3.0 * seconds, 0.0, 0.0))


def spread(positions: np.ndarray, seconds: float) -> np.ndarray:
    return positions * (1.0 + seconds)


@pytest.mark.parametrize(("motion", "is_worn"), [(shuffle, True), (drift, False), (spread, False)])
def test_a_tree_is_worn_when_its_objects_mix(motion: Callable[..., np.ndarray], is_worn: bool) -> None:
    # Not when all of them move together, nor when they fly apart: a fresh tree would be no better.
    scene = make_moving(motion)
    forest = Forest(scene)
    assert not forest.refit()
    scene.update(1.0)
    assert forest.refit() is is_worn
    forest.rebuild()
    assert not forest.refit()


def test_the_factor_is_the_boundary(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = make_moving(shuffle)
    forest = Forest(scene)
    before = forest._compute_cost()
    scene.update(1.0)
    forest.refit()
    factor = forest._compute_cost() / before
    assert factor > REBUILD_RATIO
    for worn, is_rebuilt in ((factor * 1.001, False), (factor * 0.999, True)):
        monkeypatch.setattr("renderer.visibility.boxes.forest.REBUILD_RATIO", worn)
        assert forest.refit() is is_rebuilt


def test_a_rebuilt_tree_holds_all_objects_once_and_is_that_of_a_new_forest() -> None:
    scene = make_moving(shuffle)
    forest = Forest(scene)
    scene.update(1.0)
    assert forest.refit()
    forest.rebuild()
    fresh = Forest(scene)
    assert sorted(forest.order.tolist()) == list(range(BOXES + 1))
    for name in ("parent", "child", "object_index", "roots"):
        assert getattr(forest, name) == getattr(fresh, name)
    for name in ("lower", "upper", "first", "count", "order", "tight", "tight_sizes"):
        assert np.array_equal(getattr(forest, name), getattr(fresh, name)), name


def test_the_history_of_objects_carries_over_to_their_new_nodes() -> None:
    scene = make_moving(shuffle)
    forest = Forest(scene)
    memory, last = NodeHistory(forest), 7
    root = forest.moving.start
    visible_rows = {row for row in range(BOXES) if row % 3 == 0}
    unknown = {row for row in range(BOXES) if row % 3 == 1}
    for node in range(len(forest) - 1, root - 1, -1):  # children before their parents
        row, child = forest.object_index[node], forest.child[node]
        memory.visible[node] = row in visible_rows if child < 0 else max(memory.visible[child : child + 2])
        is_known = row not in unknown if child < 0 else memory.visible[node]
        memory.visited[node] = last if is_known else NEVER
        memory.hidden_since[node], memory.next_query[node] = max(row, 0), 100 + row
    scene.update(1.0)
    assert forest.refit()
    memory._rebuild(last)
    for node in range(root, len(forest)):
        run = slice(forest.first[node], forest.first[node] + forest.count[node])
        below = set(forest.order[run].tolist())
        assert memory.visible[node] == bool(below & visible_rows)
        assert memory.visited[node] == (last if below - unknown else NEVER)
        if len(below) == 1 and not below & unknown:
            assert (memory.hidden_since[node], memory.next_query[node]) == (min(below), 100 + min(below))


def test_after_a_rebuild_nodes_below_a_hidden_node_are_hidden_since_the_same_frame() -> None:
    scene = make_moving(shuffle)
    forest = Forest(scene)
    memory, last = NodeHistory(forest), 7
    memory.visited[forest.moving.start], memory.hidden_since[forest.moving.start] = last, 3
    scene.update(1.0)
    assert forest.refit()
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
    delay_query_results(monkeypatch, 0)
    fresh = count_queries(
        gl, make_moving(lambda object_positions, seconds: shuffle(object_positions, 1.0)), name, [0.0] * 50
    )
    after = count_queries(gl, make_moving(shuffle), name, [0.0] * 25 + [1.0] * 25)
    assert np.mean(after[-20:]) <= 1.1 * np.mean(fresh[-20:])
    monkeypatch.setattr(
        "renderer.visibility.boxes.forest.REBUILD_RATIO", np.inf
    )  # the control: the old tree asks more
    worn = count_queries(gl, make_moving(shuffle), name, [0.0] * 25 + [1.0] * 25)
    assert np.mean(worn[-20:]) > 1.2 * np.mean(fresh[-20:])


def test_a_rebuild_keeps_the_visible_objects_of_its_frame(
    gl: rhi.Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    # What is known to be visible is drawn inside its query, without a box.
    delay_query_results(monkeypatch, 0)
    scene = make_moving(drift)
    algorithm = Chc(scene, gl)
    with Renderer(gl, scene, size=SIZE) as renderer:

        def count_visited() -> int:
            result = draw_with(renderer, algorithm, EYE)
            return result.statistics.queries - result.visibility.boxes

        settled = min([count_visited() for _ in range(6)][2:])
        monkeypatch.setattr("renderer.visibility.boxes.forest.REBUILD_RATIO", 0.0)
        assert min(count_visited(), count_visited()) >= settled > 5
        algorithm._visited[:] = [NEVER] * len(algorithm._visited)  # the control
        assert count_visited() == 0
    algorithm.destroy()


@pytest.mark.nightly_cases("cl-*", reason=ONLY_KERNELS)
@pytest.mark.parametrize("leaf_size", [1, 3])
@pytest.mark.parametrize("name", OCCLUSION)
def test_objects_in_rebuilt_trees_look_as_without_culling(
    drawing_device: rhi.Device, monkeypatch: pytest.MonkeyPatch, name: str, leaf_size: int
) -> None:
    require_algorithm(drawing_device, name)
    monkeypatch.setattr("renderer.visibility.boxes.forest.REBUILD_RATIO", 1.0)
    scene = make_moving(
        lambda object_positions, seconds: (
            object_positions + 6.0 * np.sin(seconds * (1.0 + np.arange(3 * BOXES).reshape(-1, 3) % 7))
        )
    )
    rebuilds = []
    rebuild = Forest.rebuild
    monkeypatch.setattr(Forest, "rebuild", lambda forest: (rebuilds.append(1), rebuild(forest)))
    with UnculledFrames(drawing_device, scene, [(EYE, 0.1 * frame) for frame in range(8)], SIZE) as uncut:
        assert uncut.try_algorithm(name, leaf_size=leaf_size) == [0] * 8
    assert name == "stop_and_wait" or rebuilds
