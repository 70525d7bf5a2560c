"""Simulations: members are stepped where they are drawn, skipped elsewhere, and catch up exactly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from renderer import scene as scenes
from renderer.content import BUILT_IN, load_scene
from renderer.content.fountains import BOUNDS, DROPS, FountainSimulation, make_drops
from rhi.errors import ValidationError


class Clock:
    """Counts each member's steps; the height of its one vertex is their number."""

    interval = 0.5

    def __init__(self, count: int, memory: int | None = None, steps_per_frame: int = 10_000) -> None:
        self.catch_up = scenes.Stepwise(steps_per_frame, memory)
        self.taken: list[list[int]] = [[] for _ in range(count)]

    def step(self, members, numbers):
        for member, number in zip(members.tolist(), numbers.tolist(), strict=True):
            self.taken[member].append(number)

    def vertices(self, members):
        vertices = np.zeros(len(members), scenes.VERTEX)
        vertices["position"][:, 1] = [len(self.taken[member]) for member in members]
        return vertices


def make_scene(count: int = 3, memory: int | None = None, apart: float = 0.0) -> scenes.Scene:
    builder = scenes.SceneBuilder("clocks")
    bounds = (np.full(3, -9.0), np.full(3, 9.0))
    meshes = [builder.add_mesh(BUILT_IN["box"](), bounds=bounds) for _ in range(count)]
    still = builder.add_mesh(BUILT_IN["sphere"]())
    material = builder.add_material()
    builder.add_objects(builder.add_node(), still, material)  # row 0 isn't simulated
    objects = builder.add_objects(
        builder.add_nodes(scenes.translation(np.outer(np.arange(count), (-apart, 0, 0)))), meshes, material
    )
    builder.simulate(objects, Clock(count, memory))
    return builder.build()


def make_simulator(scene: scenes.Scene) -> tuple[scenes.Simulator, Clock]:
    simulator = scene.make_simulator()
    return simulator, simulator.simulations[0]


def taken(simulator: scenes.Simulator) -> list[list[int]]:
    return simulator.simulations[0].taken


def show(simulator: scenes.Simulator, seconds: float, rows: list[int]) -> list[tuple[int, int]]:
    simulator.begin_frame(seconds)
    return states(simulator, np.array(rows, np.int64))


def states(simulator: scenes.Simulator, rows: np.ndarray) -> list[tuple[int, int]]:
    deformed = simulator.advance(rows).deformed
    return [
        pair
        for objects in deformed
        for pair in zip(objects.object_indices.tolist(), objects.states.tolist(), strict=True)
    ]


def test_drawn_members_are_stepped_and_others_are_not() -> None:
    simulator, clock = make_simulator(make_scene())
    assert show(simulator, 1.0, [0, 1, 3]) == [(1, 2), (3, 2)]
    assert clock.taken == [[1, 2], [], [1, 2]]
    assert (simulator.steps, simulator.drawn_count, len(simulator)) == (4, 2, 3)


def test_drawn_members_are_listed_by_simulation() -> None:
    simulator, clock = make_simulator(make_scene())
    show(simulator, 1.0, [0, 1, 3])
    ((simulation, rows, members),) = simulator.list_drawn_members()
    assert simulation is clock
    assert (rows.tolist(), members.tolist()) == ([1, 3], [0, 2])
    simulator.begin_frame(2.0)
    assert simulator.list_drawn_members() == []


def test_a_returning_member_catches_up() -> None:
    simulator, clock = make_simulator(make_scene())
    show(simulator, 0.5, [1, 2])
    show(simulator, 1.5, [1])
    assert show(simulator, 2.0, [1, 2]) == [(1, 4), (2, 4)]
    assert clock.taken[0] == clock.taken[1] == [1, 2, 3, 4]
    assert simulator.steps == 1 + 3


def test_catching_up_takes_as_many_steps_as_anything_is_remembered_for() -> None:
    simulator, clock = make_simulator(make_scene(memory=3))
    show(simulator, 1.0, [1])
    assert show(simulator, 50.0, [1, 2]) == [(1, 100), (2, 100)]
    assert clock.taken[:2] == [[1, 2, 98, 99, 100], [98, 99, 100]]


@pytest.mark.parametrize(("seconds", "steps"), [(0.0, 0), (0.49, 0), (0.5, 1), (0.999, 1), (1.0, 2)])
def test_a_step_is_taken_when_its_time_has_come(seconds: float, steps: int) -> None:
    simulator, clock = make_simulator(make_scene())
    show(simulator, seconds, [1])
    assert len(clock.taken[0]) == steps


def test_times_of_frames_are_on_their_steps() -> None:
    fountains = load_scene("hall:columns=6,flags=0,fountains=1").make_simulator()
    for frame in range(0, 3000, 7):
        fountains.begin_frame(frame / 60)
        assert [state for _, state in states(fountains, fountains.objects)] == [frame]


def test_within_a_frame_a_step_is_taken_once() -> None:
    simulator, clock = make_simulator(make_scene())
    simulator.begin_frame(1.0)
    for rows in ([1], [1, 2], [2]):
        simulator.advance(np.array(rows))
    assert clock.taken == [[1, 2], [1, 2], []]
    assert (simulator.steps, simulator.drawn_count) == (4, 2)


def test_a_time_before_the_last_one_starts_again() -> None:
    simulator, clock = make_simulator(make_scene())
    show(simulator, 5.0, [1])
    assert show(simulator, 1.0, [1]) == [(1, 2)]
    assert taken(simulator)[0] == [1, 2]
    assert len(clock.taken[0]) == 10  # the one before is left alone


def test_simulators_of_one_scene_go_their_own_ways() -> None:
    scene = make_scene()
    first, second = (make_simulator(scene)[0] for _ in range(2))
    show(first, 1.0, [1])
    show(second, 2.0, [2])
    assert (taken(first), taken(second)) == ([[1, 2], [], []], [[], [1, 2, 3, 4], []])


LAG = 0.5
HEIGHT = 100
DIAMETER = 18.0 * np.sqrt(3.0)
"""That of the clocks' bounds, 9 m around the origin."""


def look_from(pixels: float) -> scenes.Camera:
    """Return a camera to which the bounds of the clocks are as large as that, by their nearest point."""
    eye = (9.0 + 0.5 * HEIGHT * DIAMETER / pixels, 0.0, 0.0)
    return scenes.Camera.look_at(eye, (0.0, 0.0, 0.0), projection=scenes.Perspective(fov=np.pi / 2))


def count_moves(
    camera: scenes.Camera, lag: float = LAG, seconds: float = 8.0, interval: float = 1 / 64
) -> list[int]:
    """Return in how many of 64 frames a second each of nine clocks has moved on."""
    simulator, clock = make_simulator(make_scene(9))
    clock.interval, moves = interval, np.zeros(9, int)
    for frame in range(1, int(64 * seconds) + 1):
        before = np.array([len(steps) for steps in clock.taken])
        simulator.begin_frame(frame / 64)
        simulator.slow_down(camera, HEIGHT, lag)
        simulator.advance(simulator.objects)
        moves += np.array([len(steps) for steps in clock.taken]) > before
    assert all(steps == list(range(1, len(steps) + 1)) for steps in clock.taken)
    return moves.tolist()


@pytest.mark.parametrize(
    ("pixels", "moves"), [(0.499, 0), (0.501, 64), (0.999, 64), (1.001, 128), (3.99, 256), (4.01, 512)]
)
def test_small_members_are_stepped_less_often_and_members_smaller_than_the_lag_are_suspended(
    pixels: float, moves: int
) -> None:
    move_count = count_moves(look_from(pixels))
    assert max(move_count) == moves
    assert min(move_count) >= moves - (moves < 512)  # the first part of a period is shorter for some


def test_an_orthographic_projection_shows_all_at_the_same_size() -> None:
    for distance in (20.0, 2000.0):
        projection = scenes.Orthographic(1000.0 * DIAMETER, far=9999.0)
        camera = scenes.Camera.look_at((distance, 0.0, 0.0), (0.0, 0.0, 0.0), projection=projection)
        assert max(count_moves(camera, lag=0.0999)) == 64  # it is of 0.1 pixels
        assert max(count_moves(camera, lag=0.1001)) == 0


def test_without_lag_and_without_bounds_all_moves_on_in_each_frame() -> None:
    assert count_moves(look_from(1.0), lag=0.0) == [512] * 9
    scene = make_scene(1)
    scene.simulated = (replace(scene.simulated[0], is_bounded=False),)
    simulator, clock = make_simulator(scene)
    for frame in (1, 2, 3):
        simulator.begin_frame(frame / 2)
        simulator.slow_down(look_from(1e-3), HEIGHT, LAG)
    assert clock.taken == [[1, 2, 3]]


def test_small_things_move_on_in_different_frames() -> None:
    simulator, clock = make_simulator(make_scene(8))
    clock.interval = 1 / 64
    steps = []
    for frame in range(1, 129):
        simulator.begin_frame(frame / 64)
        simulator.slow_down(look_from(0.6), HEIGHT, LAG)
        simulator.advance(simulator.objects)
        steps.append(simulator.steps)
    assert steps[16:] == [0, 16] * 56  # two of eight in every second frame, and not all eight in every eighth


def test_an_approaching_member_catches_up_and_a_receding_member_waits() -> None:
    simulator, clock = make_simulator(make_scene(2, apart=1e6))  # the other one is small throughout
    clock.interval, steps = 1e-3, []
    for seconds, pixels in ((1.007, 0.4), (1.007, 5.0), (2.007, 0.4), (2.011, 500.0)):
        simulator.begin_frame(seconds)
        simulator.slow_down(look_from(pixels), HEIGHT, LAG)
        simulator.advance(simulator.objects)
        steps.append(simulator.steps)
    assert steps == [0, 1007, 0, 1004]


def test_flags_that_are_late_are_off_by_less_than_the_lag() -> None:
    halls = [load_scene("hall:columns=6,flags=8") for _ in range(2)]
    simulators = [hall.make_simulator() for hall in halls]
    camera = scenes.Camera.look_at((0.0, 2.0, 120.0), (0.0, 2.0, 0.0))
    off = []
    for frame in range(60):
        positions = []
        for scene, simulator, lag in zip(halls, simulators, (LAG, 0.0), strict=True):
            simulator.begin_frame(frame / 60)
            simulator.slow_down(camera, HEIGHT, lag)
            simulator.advance(simulator.objects)
            corner = np.array([1.0, 1.0, 0.0, 1.0])  # of the segments, which are less than a metre wide
            clip = (
                scene.nodes.world[scene.objects.node[simulator.objects]] @ corner @ camera.view_projection.T
            )
            positions.append(0.5 * HEIGHT * clip[:, :2] / clip[:, 3:])
        off.append(np.linalg.norm(positions[0] - positions[1], axis=1).max())
    assert 0.0 < max(off) < LAG


@settings(max_examples=25)
@given(st.lists(st.booleans(), min_size=1, max_size=40), st.floats(0.3, 6.0))
def test_the_lag_of_a_member_does_not_depend_on_when_it_was_drawn(drawn: list[bool], pixels: float) -> None:
    (always, all_steps), (now_and_then, steps) = (make_simulator(make_scene(9)) for _ in range(2))
    for frame, is_drawn in enumerate([*drawn, True], 1):
        for simulator in (always, now_and_then):
            simulator.begin_frame(0.09 * frame)
            simulator.slow_down(look_from(pixels), HEIGHT, LAG)
            if is_drawn or simulator is always:
                simulator.advance(simulator.objects)
    assert steps.taken == all_steps.taken


@settings(max_examples=25)
@given(st.lists(st.tuples(st.integers(0, 400), st.sets(st.integers(0, 2))), max_size=12), st.integers(0, 400))
def test_a_fountain_that_was_not_looked_at_is_as_if_it_had_been(
    glances: list[tuple[int, set[int]]], last: int
) -> None:
    always, now_and_then = FountainSimulation(3, 7), FountainSimulation(3, 7)
    everyone = np.arange(3)
    frames = sorted(frame for frame, _ in glances)
    last = max([last, *frames])
    for number in range(1, last + 1):
        always.step(everyone, np.full(3, number))
    scene = load_scene("hall:columns=6,flags=0,fountains=3")
    simulator = scene.make_simulator()
    simulator.simulations[0] = now_and_then
    rows = simulator.objects
    for frame, (_, seen) in zip(frames, glances, strict=True):
        simulator.begin_frame(frame / 60)
        simulator.advance(rows[sorted(seen)])
    simulator.begin_frame(last / 60)
    simulator.advance(rows)
    assert np.array_equal(now_and_then.position, always.position)
    assert (now_and_then.vertices(everyone) == always.vertices(everyone)).all()


def test_a_fountain_s_memory_is_no_longer_than_it_must_be() -> None:
    # The control: one step less, and a drop is where it was.
    always, late = FountainSimulation(1, 7), FountainSimulation(1, 7)
    for number in range(1, 301):
        always.step(np.zeros(1, np.int64), np.array([number]))
    for number in range(302 - DROPS, 301):
        late.step(np.zeros(1, np.int64), np.array([number]))
    assert (always.position != late.position).any(axis=2).sum() == 1


def test_a_fountain_with_fewer_drops_has_a_subset_of_all_drops() -> None:
    all_, fewer = FountainSimulation(2, 7), FountainSimulation(2, 7, 45)
    assert fewer.interval == 2.0 * all_.interval
    for number in range(1, 301):
        all_.step(np.arange(2), np.full(2, number))
        if number % 2 == 0:
            fewer.step(np.arange(2), np.full(2, number // 2))
    assert fewer.position[:, (np.arange(106, 151)) % 45] == pytest.approx(
        all_.position[:, np.arange(212, 301, 2) % 90]
    )


def test_drops_stay_within_their_bounds_rise_and_fall() -> None:
    fountains = FountainSimulation(4, 1)
    highest = 0.0
    for number in range(1, 4 * DROPS):
        fountains.step(np.arange(4), np.full(4, number))
        points = fountains.vertices(np.arange(4))["position"]
        assert ((points >= BOUNDS[0]) & (points <= BOUNDS[1])).all()
        highest = max(highest, float(points[:, 1].max()))
    assert highest > 0.9 * BOUNDS[1][1]  # and the bounds are no larger than they must be
    assert len(np.unique(fountains.position[0].round(6), axis=0)) > 0.6 * DROPS
    assert not np.array_equal(fountains.position[0], fountains.position[1])


def test_a_drop_flies_along_its_parabola() -> None:
    fountains, seconds, heights = FountainSimulation(1, 1), np.arange(60) / 60, []
    for number in range(1, 61):
        fountains.step(np.zeros(1, np.int64), np.array([number]))
        heights.append(fountains.position[0, 1, 1])
    up = fountains.velocity[0, 1, 1] + 9.81 * (seconds[-1] - 0.5 * seconds)
    assert heights == pytest.approx(up * seconds, abs=1e-12)


def test_a_fountain_begins_as_its_mesh() -> None:
    assert (make_drops().vertices == FountainSimulation(1, 0).vertices(np.zeros(1, np.int64))).all()
    assert np.linalg.norm(make_drops().vertices["normal"], axis=1) == pytest.approx(1.0)


def refusal(change: object) -> str:
    builder = scenes.SceneBuilder("bad")
    bounds = (np.full(3, -9.0), np.full(3, 9.0))
    bound, free = builder.add_mesh(BUILT_IN["box"](), bounds=bounds), builder.add_mesh(BUILT_IN["box"]())
    nodes = builder.add_nodes(np.tile(np.eye(4), (3, 1, 1)))
    with pytest.raises(ValidationError) as refused:
        change(builder, nodes, bound, free, builder.add_material())
        builder.build()
    return refused.value.rule.id


@pytest.mark.parametrize(
    ("change", "rule"),
    [
        (
            lambda b, n, bound, free, m: b.simulate(b.add_objects(n[0], free, m), Clock(1)),
            "scene-unbounded-mesh",
        ),
        (
            lambda b, n, bound, free, m: b.simulate(b.add_objects(n[:2], bound, m), Clock(2)),
            "scene-shared-mesh",
        ),
        (
            lambda b, n, bound, free, m: b.simulate(b.add_objects(n[0], bound, m).repeat(2), Clock(2)),
            "scene-shared-mesh",
        ),
        (lambda b, n, bound, free, m: b.simulate([4], Clock(1)), "scene-bad-index"),
        (
            lambda b, n, bound, free, m: b.add_mesh(BUILT_IN["box"](), bounds=(np.zeros(3), np.ones(3))),
            "scene-small-bounds",
        ),
    ],
)
def test_invalid_simulations_are_refused(change: object, rule: str) -> None:
    assert refusal(change) == rule


def test_declared_bounds_are_those_of_the_object() -> None:
    scene = make_scene()
    assert scene.objects.lower[1] == pytest.approx([-9.0] * 3)
    assert scene.objects.upper[0] == pytest.approx([0.5] * 3)
