"""The algorithms' queries and their order, on the null device, where an oracle tells what is visible."""

from __future__ import annotations

import tracemalloc
from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest
from nightly_reasons import FEWER_CASES
from occlusion_scenes import (
    OCCLUSION,
    WAITING,
    Oracle,
    delay_query_results,
    draw_with,
    make_boxes,
    make_cloud,
    visible,
)
from refusals import refused_rule

import rhi
from renderer import visibility
from renderer.renderer import Renderer
from renderer.scene import Camera, Perspective
from renderer.visibility import (
    Chc,
    ChcPlusPlus,
    ConditionalCulling,
    StopAndWait,
    VisibilitySettings,
    make_visibility,
)
from renderer.visibility.boxes.forest import Forest
from rhi import FixedQueue, Op, QuerySet
from rhi.device.core import containers

EYE = Camera.look_at((0.0, 0.0, 30.0), (0.0, 0.0, 0.0), projection=Perspective(near=0.1))


NAMES = {StopAndWait: "stop_and_wait", Chc: "chc", ChcPlusPlus: "chc_plus_plus"}
LOOKS = (0, 1, 20, 10**9)
"""How often an answer is looked at before it is there; the last stands for never: waiting always works."""


@pytest.fixture
def renderer(null: rhi.Device) -> Iterator[Renderer]:
    with Renderer(null, make_cloud(seed=1), size=(64, 36)) as created:
        yield created


def frames(
    renderer: Renderer, algorithm: object, oracle: Oracle, *visible_objects: set[int]
) -> list[set[int]]:
    """Return the objects drawn while the oracle sees each of these sets in turn."""
    drawn = []
    for rows in visible_objects:
        oracle.visible_objects = set(rows)
        drawn.append(visible(draw_with(renderer, algorithm, EYE)))
    return drawn


def make(renderer: Renderer, name: str) -> tuple[object, Oracle]:
    device, scene = renderer.device, renderer.scene
    return make_visibility(name, scene, device), Oracle(device, scene, name)


@pytest.mark.parametrize("looks", LOOKS)
@pytest.mark.parametrize("name", OCCLUSION)
def test_visible_objects_are_drawn_in_the_frame_in_which_they_become_visible(
    renderer: Renderer, name: str, looks: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    delay_query_results(monkeypatch, looks)
    algorithm, oracle = make(renderer, name)
    sets = [{1, 5, 9}, {5}, set(), set(range(60)), {59, 0}, {7}]
    drawn = frames(renderer, algorithm, oracle, *sets)
    assert all(visible_set <= got for visible_set, got in zip(sets, drawn, strict=True))


@pytest.mark.parametrize("looks", LOOKS)
@pytest.mark.parametrize("name", WAITING)
def test_in_the_long_run_nothing_else_is_drawn(
    renderer: Renderer, name: str, looks: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    delay_query_results(monkeypatch, looks)
    algorithm, oracle = make(renderer, name)
    drawn = frames(renderer, algorithm, oracle, set(range(60)), *[{3, 4}] * 60)
    assert drawn[0] == set(range(60))
    # CHC++ looks once a frame at answers that it doesn't wait for.
    assert drawn[-1] == {3, 4} or (name == "chc_plus_plus" and looks > 1)


def test_stop_and_wait_asks_for_every_object_in_the_frustum(renderer: Renderer) -> None:
    oracle = Oracle(renderer.device, renderer.scene, "stop_and_wait")
    oracle.visible_objects = {1, 2}
    result = draw_with(renderer, StopAndWait(renderer.scene, renderer.device), EYE)
    assert result.statistics.queries == result.visibility.boxes == 60
    assert visible(result) == {1, 2}


@pytest.mark.parametrize("name", OCCLUSION)
def test_objects_outside_the_frustum_are_neither_queried_nor_drawn(renderer: Renderer, name: str) -> None:
    algorithm, oracle = make(renderer, name)
    oracle.visible_objects = set(range(60))
    away = Camera.look_at((0.0, 0.0, 30.0), (0.0, 0.0, 60.0))
    result = draw_with(renderer, algorithm, away)
    assert result.statistics.queries == result.statistics.draws == 0


@pytest.mark.parametrize("name", OCCLUSION)
def test_around_the_eye_nothing_is_asked_for(null: rhi.Device, name: str) -> None:
    scene = make_boxes([(0.0, 0.0, 30.0)], [(2.0, 2.0, 2.0)])
    Oracle(null, scene, name)  # sees nothing
    with Renderer(null, scene, size=(64, 36)) as renderer:
        for _ in range(3):
            result = draw_with(renderer, make_visibility(name, scene, null), EYE)
            assert visible(result) == {0}
            assert result.statistics.queries == 0


def test_chc_asks_for_visible_leaves_by_their_own_geometry(renderer: Renderer) -> None:
    oracle = Oracle(renderer.device, renderer.scene, "chc", visible_objects=set(range(60)))
    algorithm = Chc(renderer.scene, renderer.device)
    draw_with(renderer, algorithm, EYE)
    second = draw_with(renderer, algorithm, EYE)
    assert second.statistics.queries == 60  # none for inner nodes
    assert second.visibility.boxes == 0
    oracle.visible_objects = set()
    assert len(visible(draw_with(renderer, algorithm, EYE))) == 60  # drawn, and found to be hidden
    last = draw_with(renderer, algorithm, EYE)
    assert visible(last) == set()
    assert last.visibility.boxes == last.statistics.queries


def test_chc_pulls_up_visibility_so_hidden_trees_cost_one_query(renderer: Renderer) -> None:
    Oracle(renderer.device, renderer.scene, "chc")  # sees nothing
    algorithm = Chc(renderer.scene, renderer.device)
    for _ in range(3):
        assert draw_with(renderer, algorithm, EYE).statistics.queries == 1


def test_objects_that_came_into_view_are_queried_as_leaves_in_the_next_frame(null: rhi.Device) -> None:
    """Once it has been found, nodes above it are visible too, though what made them so before is out of
    view."""
    scene = make_boxes(np.array([(x, y, 0.0) for x in (-40.0, 40.0) for y in range(4)]), np.full((8, 3), 0.4))
    left, right = (
        Camera.look_at((x, 1.5, 12.0), (x, 1.5, 0.0), projection=Perspective(0.6)) for x in (-40.0, 40.0)
    )
    with Renderer(null, scene, size=(64, 36)) as renderer:
        Oracle(null, scene, visible_objects=set(range(8)))
        algorithm = ChcPlusPlus(scene, null, VisibilitySettings(persistence=1000))
        before = [draw_with(renderer, algorithm, left) for _ in range(9)][-1]
        draw_with(renderer, algorithm, right)
        result = draw_with(renderer, algorithm, right)
        assert (visible(before), visible(result)) == ({0, 1, 2, 3}, {4, 5, 6, 7})
        assert result.statistics.queries == 0


def test_chc_plus_plus_draws_in_fewer_batches_and_asks_with_fewer_queries(renderer: Renderer) -> None:
    costs = []
    for make_one in (Chc, ChcPlusPlus):
        oracle = Oracle(
            renderer.device, renderer.scene, NAMES[make_one], visible_objects=set(range(0, 60, 4))
        )
        algorithm = make_one(renderer.scene, renderer.device)
        for _ in range(12):
            result = draw_with(renderer, algorithm, EYE)
        assert visible(result) >= oracle.visible_objects
        costs.append(
            (result.visibility.batches, result.statistics.queries, result.statistics.hardware_state_changes)
        )
    assert all(new < 0.5 * old for old, new in zip(*costs, strict=True)), costs


def test_a_visible_leaf_is_asked_for_every_n_frames_and_first_at_random(renderer: Renderer) -> None:
    Oracle(renderer.device, renderer.scene, visible_objects=set(range(60)))
    algorithm = ChcPlusPlus(renderer.scene, renderer.device, VisibilitySettings(persistence=10))
    queries = [draw_with(renderer, algorithm, EYE).statistics.queries for _ in range(41)]
    spread = queries[1:11]
    assert sum(spread) == 60
    assert max(spread) < 20  # no frame bears them all
    assert queries[11:21] == queries[21:31] == queries[31:41]


def test_persistence_of_one_asks_in_every_frame(renderer: Renderer) -> None:
    Oracle(renderer.device, renderer.scene, visible_objects=set(range(60)))
    algorithm = ChcPlusPlus(renderer.scene, renderer.device, VisibilitySettings(persistence=1))
    queries = [draw_with(renderer, algorithm, EYE).statistics.queries for _ in range(4)]
    assert queries[1:] == [60] * 3


@pytest.mark.parametrize(("batch", "least", "most"), [(1, 12, 60), (1000, 1, 3)])
def test_hidden_nodes_gather_until_there_is_a_batch(
    renderer: Renderer, batch: int, least: int, most: int
) -> None:
    oracle = Oracle(renderer.device, renderer.scene, visible_objects=set(range(0, 60, 3)))
    algorithm = ChcPlusPlus(renderer.scene, renderer.device, VisibilitySettings(batch=batch, persistence=50))
    for _ in range(3):
        draw_with(renderer, algorithm, EYE)
    before = renderer.device.statistics.software_state_changes
    draw_with(renderer, algorithm, EYE)
    scopes = (renderer.device.statistics.software_state_changes - before) / 4
    assert least <= scopes <= most
    assert oracle.visible_objects


def test_a_multiquery_that_shows_something_is_asked_again_one_by_one(renderer: Renderer) -> None:
    oracle = Oracle(renderer.device, renderer.scene, visible_objects={0})
    algorithm = ChcPlusPlus(renderer.scene, renderer.device)
    settled = [draw_with(renderer, algorithm, EYE).statistics.queries for _ in range(12)][-1]
    oracle.visible_objects = {0, 1, 2, 30}
    changed = draw_with(renderer, algorithm, EYE)
    assert visible(changed) == oracle.visible_objects
    assert changed.statistics.queries > settled


def test_conditional_culling_never_waits_and_the_gpu_drops_hidden_objects(renderer: Renderer) -> None:
    oracle = Oracle(renderer.device, renderer.scene)
    algorithm = ConditionalCulling(renderer.scene, renderer.device, VisibilitySettings(persistence=2))
    for visible_objects in ({3, 4, 50}, set(range(20)), {3}):
        oracle.visible_objects = visible_objects
        for _ in range(30):
            oracle.executed.clear()
            result = draw_with(renderer, algorithm, EYE)
            renderer.device.finish()
            assert visible_objects <= set(oracle.executed) <= visible(result)
            assert result.visibility.stalled_milliseconds == 0.0
        assert set(oracle.executed) == visible_objects


def test_conditional_culling_asks_once_a_frame_in_one_pass(renderer: Renderer) -> None:
    device, oracle = renderer.device, Oracle(renderer.device, renderer.scene, "conditional")
    algorithm = ConditionalCulling(renderer.scene, device, VisibilitySettings(persistence=5))
    operations = frozenset({Op.BEGIN_QUERY, Op.BEGIN_CONDITIONAL, Op.DRAW_INDIRECT, Op.BEGIN_PASS, Op.WAIT})
    for frame in range(40):
        oracle.visible_objects = set(range(frame // 8, 60, 7))
        before = len(device.stream)
        result = draw_with(renderer, algorithm, EYE)
        ops = [command.op for command in device.stream[before:].filter(operations)]
        # What was visible, all questions, and then all conditions: nothing is asked in between.
        phases = [op for index, op in enumerate(ops) if op is not Op.DRAW_INDIRECT and op not in ops[:index]]
        assert phases == [op for op in (Op.BEGIN_PASS, Op.BEGIN_QUERY, Op.BEGIN_CONDITIONAL) if op in ops]
        assert ops.count(Op.BEGIN_PASS) == 1
        assert ops.count(Op.BEGIN_QUERY) == result.statistics.queries
        assert ops.count(Op.BEGIN_CONDITIONAL) <= result.statistics.queries
        assert result.visibility.batches <= 2


def test_conditional_culling_gives_up_queries_without_a_result(
    renderer: Renderer, monkeypatch: pytest.MonkeyPatch
) -> None:
    delay_query_results(monkeypatch, 10**9)
    oracle = Oracle(renderer.device, renderer.scene, "conditional", visible_objects={3, 4})
    algorithm = ConditionalCulling(renderer.scene, renderer.device)
    sets = renderer.device.query_set
    set_sizes: list[int] = []
    monkeypatch.setattr(
        renderer.device, "query_set", lambda size, emulated: set_sizes.append(size) or sets(size)
    )
    for _ in range(40):
        assert visible(draw_with(renderer, algorithm, EYE)) >= oracle.visible_objects
    assert len(set_sizes) <= 9, "questions that were given up are asked with the same sets"


@pytest.mark.parametrize("raises", [False, True])
@pytest.mark.parametrize("kind", [ConditionalCulling, ChcPlusPlus, Chc])
def test_questions_in_flight_may_be_destroyed(
    renderer: Renderer, kind: type[ChcPlusPlus], raises: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    delay_query_results(monkeypatch, 20)
    oracle = Oracle(renderer.device, renderer.scene, visible_objects=set(range(0, 60, 3)))
    algorithm = kind(renderer.scene, renderer.device, VisibilitySettings(persistence=1))
    for _ in range(3):
        draw_with(renderer, algorithm, EYE)
    assert oracle.visible_objects
    if raises:
        draws = iter([algorithm._draw] * 5)  # then StopIteration
        monkeypatch.setattr(algorithm, "_draw", lambda *arguments: next(draws)(*arguments))
        oracle.visible_objects = set(range(60))
        with pytest.raises(StopIteration) if kind is Chc else nullcontext():
            draw_with(renderer, algorithm, EYE)
    algorithm.destroy()
    renderer.device.finish()
    stream = renderer.device.backend_as(rhi.Recorder).stream
    created = {command["query"] for command in stream.filter(Op.CREATE_QUERY)}
    gone = {command["resource"] for command in stream.filter(Op.DESTROY)}
    assert created
    assert created <= gone


@pytest.fixture
def query_calls(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The number of queries of each call that draws queries."""
    counts: list[int] = []
    draw = QuerySet.draw

    def count(queries: QuerySet, *arguments: object) -> object:
        queried = draw(queries, *arguments)  # type: ignore[arg-type]
        counts.append(len(queried))
        return queried

    monkeypatch.setattr(QuerySet, "draw", count)
    return counts


def test_chc_plus_plus_queries_a_batch_in_one_call(renderer: Renderer, query_calls: list[int]) -> None:
    Oracle(renderer.device, renderer.scene, visible_objects=set(range(0, 60, 3)))
    algorithm = ChcPlusPlus(renderer.scene, renderer.device, VisibilitySettings(batch=1000, persistence=3))
    for _ in range(12):
        query_calls.clear()
        result = draw_with(renderer, algorithm, EYE)
        assert sum(query_calls) == result.statistics.queries
    assert 1 <= len(query_calls) <= 3
    assert result.statistics.queries > 2 * len(query_calls)


@pytest.mark.parametrize(("persistence", "due_leaves"), [(1000, 0), (1, 20)])
def test_chc_plus_plus_queries_hidden_nodes_and_due_leaves_in_the_call_that_it_waits_for(
    renderer: Renderer, query_calls: list[int], persistence: int, due_leaves: int
) -> None:
    Oracle(renderer.device, renderer.scene, visible_objects=set(range(0, 60, 3)))
    settings = VisibilitySettings(batch=1000, persistence=persistence)
    algorithm = ChcPlusPlus(renderer.scene, renderer.device, settings)
    for _ in range(20):
        query_calls.clear()
        result = draw_with(renderer, algorithm, EYE)
        assert sum(query_calls) == result.statistics.queries
    assert query_calls == [result.statistics.queries]
    assert 0 < result.statistics.queries - due_leaves < 20, "hidden nodes share queries"


def test_a_leaf_that_was_queried_with_hidden_nodes_is_gone_in_the_next_frame(renderer: Renderer) -> None:
    oracle = Oracle(renderer.device, renderer.scene)
    algorithm = ChcPlusPlus(renderer.scene, renderer.device, VisibilitySettings(persistence=1))
    drawn = frames(renderer, algorithm, oracle, {3, 4}, {3, 4}, {4}, {4})
    assert drawn == [{3, 4}, {3, 4}, {3, 4}, {4}]


QUEUES = ("_i_queue", "_requery", "_v_queue", "_i_queries", "_v_queries", "_results", "_render_queue")


@pytest.mark.nightly_cases("ConditionalCulling", reason=FEWER_CASES)
@pytest.mark.parametrize("kind", [ChcPlusPlus, ConditionalCulling])
def test_the_queues_allocate_nothing_in_a_hundred_frames(renderer: Renderer, kind: type[ChcPlusPlus]) -> None:
    device, oracle = renderer.device, Oracle(renderer.device, renderer.scene)
    algorithm = kind(renderer.scene, device, VisibilitySettings(persistence=4))

    def render(frames: int) -> None:
        for frame in range(frames):
            oracle.visible_objects = set(range(frame % 5, 60, 3))
            draw_with(renderer, algorithm, EYE)
            device.stream.clear()

    def memory() -> dict[str, tuple[int, int]]:
        return {name: (id(queue._data), len(queue._data)) for name, queue in queues.items()}

    queues = {name: getattr(algorithm, name) for name in QUEUES}
    assert all(isinstance(queue, FixedQueue) for queue in queues.values())
    render(20)
    before = memory()
    container_lines = tracemalloc.Filter(True, containers.__file__)
    tracemalloc.start()
    try:
        render(10)
        first = tracemalloc.take_snapshot().filter_traces([container_lines])
        render(100)
        last = tracemalloc.take_snapshot().filter_traces([container_lines])
    finally:
        tracemalloc.stop()
    grown = sum(line.size for line in last.statistics("lineno")) - sum(
        line.size for line in first.statistics("lineno")
    )
    assert memory() == before
    assert grown <= 32 * len(QUEUES), "a position of each queue, which is a number"


@pytest.mark.parametrize(("native", "listed"), [(True, True), (False, False)])
def test_conditional_culling_is_listed_where_queries_are_native(native: bool, listed: bool) -> None:
    with rhi.create_device("null") as device:
        device._core.capabilities = replace(
            device.capabilities, shading=True, sample_counter=True, occlusion_queries=native
        )
        names = visibility.list_algorithms(device)
        assert ("conditional" in names) is listed
        assert "chc_plus_plus" in names  # emulated queries are enough
        assert (visibility.find_missing_feature("conditional", device) is None) is listed
        if listed:
            ConditionalCulling(make_cloud(3, seed=1), device)
        else:
            assert (
                refused_rule(lambda: ConditionalCulling(make_cloud(3, seed=1), device))
                == "visibility-no-conditional-rendering"
            )


@pytest.mark.parametrize("threshold", [99, 100])
@pytest.mark.parametrize("name", [StopAndWait, Chc, ChcPlusPlus])
def test_objects_with_more_samples_than_the_threshold_are_visible(
    renderer: Renderer, name: type[ChcPlusPlus], threshold: int
) -> None:
    Oracle(renderer.device, renderer.scene, NAMES[name], visible_objects=set(range(60)), samples=100)
    algorithm = name(renderer.scene, renderer.device, VisibilitySettings(threshold=threshold))
    assert len(visible(draw_with(renderer, algorithm, EYE))) == (60 if threshold < 100 else 0)


@pytest.mark.parametrize("name", OCCLUSION)
def test_boxes_leave_no_trace(renderer: Renderer, name: str) -> None:
    algorithm, oracle = make(renderer, name)
    oracle.visible_objects = {1}
    draw_with(renderer, algorithm, EYE)
    device = renderer.device
    states = device.backend_as(rhi.Recorder).stream
    state_commands = [command for command in states if command.op is Op.SET_STATES]
    assert any(
        any(change.value in (rhi.ColorWrite.OFF, (rhi.ColorWrite.OFF,) * 8) for change in command.values[0])
        for command in state_commands
    )


@pytest.mark.parametrize("name", OCCLUSION)
def test_a_frame_that_was_broken_off_does_not_disturb_the_next(renderer: Renderer, name: str) -> None:
    algorithm, oracle = make(renderer, name)
    oracle.visible_objects = {1, 2, 3}
    draw_with(renderer, algorithm, EYE)

    def fail(rows: object) -> None:
        raise RuntimeError("no")

    with renderer.device.render_pass(renderer._targets.image, renderer._targets.depth):
        with pytest.raises(RuntimeError):
            algorithm.render(EYE, visibility.CallbackDrawer(fail))
    assert visible(draw_with(renderer, algorithm, EYE)) >= oracle.visible_objects


@pytest.mark.parametrize("first", [0, 1])
def test_leaves_are_asked_about_again_after_asking_has_failed(
    renderer: Renderer, first: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    algorithm, oracle = make(renderer, "chc_plus_plus")
    oracle.visible_objects = set(range(60))
    for _ in range(20):
        assert visible(draw_with(renderer, algorithm, EYE)) >= oracle.visible_objects
    with monkeypatch.context() as patch, pytest.raises(StopIteration):
        patch.setattr(algorithm._queries, "issue_set", lambda *_: next(iter(())))
        draw_with(renderer, algorithm, EYE)
    oracle.visible_objects = set(range(first, 60, 2))
    for _ in range(30):
        drawn = visible(draw_with(renderer, algorithm, EYE))
    assert drawn == oracle.visible_objects


def test_the_second_tree_keeps_its_nodes_while_its_bounds_follow(null: rhi.Device) -> None:
    scene = make_boxes(
        [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (2.0, 0.0, 0.0)],
        [(0.5, 0.5, 0.5)] * 3,
        motion=lambda seconds: (0.0, seconds, 0.0),
        moving=(1, 2),
    )
    forest = Forest(scene)
    assert len(forest.roots) == 2
    leaf = forest.object_index.index(1)
    heights = []
    for seconds in (0.0, 5.0):
        scene.update(seconds)
        assert not forest.refit()
        heights.append((forest.lower[leaf][1], forest.upper[forest.roots[1]][1]))
    assert np.subtract(heights[1], heights[0]) == pytest.approx([5.0, 5.0], abs=0.05)


@pytest.mark.parametrize("count", [1, 2, 60])
def test_tight_bounds_cover_their_node(count: int) -> None:
    scene = make_cloud(count, seed=count)
    forest = Forest(scene)
    members: list[set[int]] = [set() for _ in range(len(forest))]
    for node in reversed(range(len(forest))):
        members[node].add(forest.object_index[node])
        if forest.parent[node] >= 0:
            members[forest.parent[node]] |= members[node]
    runs = np.split(forest.tight, np.cumsum(forest.tight_sizes)[:-1])
    for node, tight in enumerate(runs):
        assert set().union(*(members[tight_node] for tight_node in tight)) - {-1} == members[node] - {-1}
        assert 1 <= len(tight) <= 8
    assert count < 60 or max(len(tight) for tight in runs) > 1


def test_the_null_device_refuses_to_guess(renderer: Renderer) -> None:
    algorithm = ChcPlusPlus(renderer.scene, renderer.device)
    assert refused_rule(lambda: draw_with(renderer, algorithm, EYE)) == "null-samples"
    draw_with(renderer, visibility.FrustumCulling(renderer.scene), EYE)
