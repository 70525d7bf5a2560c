"""Catching up: what a member shows after an absence, and what that may cost."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from renderer.content import BUILT_IN
from renderer.scene import Leap, Recompute, Scene, SceneBuilder, Simulator, Stepwise, translation
from renderer.scene.catch_up import distribute_steps
from rhi.errors import ValidationError

HOUR = 3600.0
BUDGET = 64


class Sliders:
    """Points on rails that follow a swinging target, a part of the distance in each step.

    Far from the target's present place lies what was averaged over its past, which a leap leaves out. In a
    step the target moves by at most SPEED * interval, and the average looks back by (1 - PULL) / PULL steps.
    """

    interval = 1 / 60
    PULL = 0.2
    SPEED = 1.3
    ERROR = SPEED * interval * (1.0 - PULL) / PULL

    def __init__(self, catch_up: Stepwise | Leap, count: int) -> None:
        self.catch_up = catch_up
        self.position = np.zeros(count)
        self.taken = np.zeros(count, np.int64)
        self.calls = 0

    def target(self, numbers: np.ndarray) -> np.ndarray:
        return np.asarray(np.sin(self.SPEED * self.interval * numbers))

    def step(self, members: np.ndarray, numbers: np.ndarray) -> None:
        self.calls += 1
        self.taken[members] += 1
        self.position[members] += self.PULL * (self.target(numbers) - self.position[members])

    def leap(self, members: np.ndarray, numbers: np.ndarray, counts: np.ndarray) -> None:
        self.calls += 1
        self.taken[members] += 1
        left = (1.0 - self.PULL) ** counts
        self.position[members] = left * self.position[members] + (1.0 - left) * self.target(numbers)

    def transforms(self, members: np.ndarray) -> np.ndarray:
        return translation(np.stack([self.position[members], *np.zeros((2, len(members)))], axis=1))


class Swings:
    """Points that swing: functions of the time."""

    catch_up = Recompute()

    def __init__(self, count: int) -> None:
        self.position = np.zeros(count)
        self.calls = 0

    def set_time(self, members: np.ndarray, seconds: float) -> None:
        self.calls += 1
        self.position[members] = np.sin(1.3 * seconds + members)

    transforms = Sliders.transforms


def make_scene(simulation: Sliders | Swings) -> Scene:
    count = len(simulation.position)
    builder = SceneBuilder("points")
    nodes = builder.add_nodes(np.tile(np.eye(4), (count, 1, 1)), dynamic=True)
    builder.add_objects(nodes, builder.add_mesh(BUILT_IN["box"]()), builder.add_material())
    builder.animate(nodes, simulation, ((-2, -1, -1), (2, 1, 1)))
    return builder.build()


def start(simulation: Sliders | Swings) -> tuple[Simulator, Sliders, Scene]:
    scene = make_scene(simulation)
    simulator = scene.make_simulator()
    running = simulator.simulations[0]
    running.calls = 0
    return simulator, running, scene


def run_always(steps: int) -> float:
    """Return the place of a slider that has taken all `steps`."""
    always = Sliders(Stepwise(1), 1)
    for number in range(1, steps + 1):
        always.step(np.zeros(1, np.int64), np.array([number]))
    return float(always.position[0])


def frame(simulator: Simulator, seconds: float, rows: object) -> None:
    simulator.begin_frame(seconds)
    simulator.advance(np.asarray(rows, np.int64))


@given(st.lists(st.integers(0, 40), min_size=1, max_size=12), st.integers(0, 300))
def test_each_step_of_the_budget_goes_to_the_member_with_the_fewest(missed: list[int], budget: int) -> None:
    share = distribute_steps(np.array(missed), budget)
    dealt = np.zeros(len(missed), int)
    for _ in range(min(budget, sum(missed))):
        open_ = np.flatnonzero(dealt < missed)
        dealt[open_[np.argmin(dealt[open_])]] += 1
    assert sorted(share) == sorted(dealt)
    assert (share <= missed).all()
    assert (share >= 0).all()


def test_of_two_who_can_not_both_go_on_the_one_further_behind_does() -> None:
    assert distribute_steps(np.array([3, 9, 5]), 1).tolist() == [0, 1, 0]


def test_missed_steps_are_taken_and_give_the_state_of_having_taken_them_in_time() -> None:
    simulator, sliders, scene = start(Sliders(Stepwise(1000), 2))
    frame(simulator, 0.1, [0, 1])
    frame(simulator, 0.7, [0])
    assert sliders.position.tolist() == [run_always(42), run_always(6)]
    frame(simulator, 1.0, [0, 1])
    # The same operations in the same order: equal to the last bit.
    assert sliders.position.tolist() == [run_always(60)] * 2
    assert scene.nodes.world[:, 0, 3].tolist() == sliders.position.tolist()
    assert simulator.late == 0


def test_after_hours_a_frame_takes_at_most_its_steps_and_the_rest_follow() -> None:
    simulator, sliders, _ = start(Sliders(Stepwise(BUDGET), 1))
    most = int(HOUR * 60 / 200)  # 18 s, to keep the test short
    seconds, frames = most / 60, 0
    while True:
        before = int(sliders.taken[0])
        frame(simulator, seconds, [0])
        frames += 1
        assert simulator.steps == sliders.taken[0] - before <= BUDGET
        if not simulator.late:
            break
    assert frames == -(-most // BUDGET)
    assert sliders.position[0] == run_always(most)


def test_memory_bounds_the_steps_of_a_member() -> None:
    simulator, sliders, _ = start(Sliders(Stepwise(10 * BUDGET, memory=20), 3))
    frame(simulator, 5 * HOUR, [0, 1, 2])
    assert sliders.taken.tolist() == [20] * 3
    assert simulator.late == 0


@pytest.mark.parametrize("policy", [Stepwise(BUDGET), Leap(BUDGET, Sliders.ERROR)])
def test_many_that_show_at_once_share_the_steps_of_a_frame_evenly(policy: Stepwise | Leap) -> None:
    simulator, sliders, _ = start(Sliders(policy, 20))
    frame(simulator, 10 * HOUR, range(20))
    leaps = 20 if isinstance(policy, Leap) else 0
    assert simulator.steps == sliders.taken.sum() == BUDGET + leaps
    assert np.ptp(sliders.taken) <= 1
    assert simulator.late == (0 if leaps else 20)


def test_of_many_that_show_at_once_all_catch_up() -> None:
    simulator, sliders, _ = start(Sliders(Stepwise(BUDGET), 20))
    for _ in range(20 * 60 // BUDGET + 1):
        frame(simulator, 1.0, range(20))
        assert simulator.steps <= BUDGET
    assert simulator.late == 0
    assert sliders.position.tolist() == [run_always(60)] * 20


def test_a_budget_below_one_step_for_each_serves_all_in_turn() -> None:
    simulator, sliders, _ = start(Sliders(Stepwise(3), 7))
    for number in range(1, 50):
        frame(simulator, number / 60, range(7))
    assert sliders.taken.sum() == 49 * 3
    assert np.ptp(sliders.taken) <= 1


@pytest.mark.parametrize("seconds", [1.7, 8.9, 18.0, 33.3])
def test_a_leap_is_wrong_by_its_error_at_most_and_late_by_nothing(seconds: float) -> None:
    simulator, sliders, _ = start(Sliders(Leap(3, Sliders.ERROR), 1))
    frame(simulator, 0.05, [0])
    value = float(sliders.position[0])
    frame(simulator, seconds, [0])
    expected = run_always(round(seconds * 60))
    # 2,000 steps of float64 round by less than 1e-12.
    assert abs(sliders.position[0] - expected) <= Sliders.ERROR + 1e-12
    assert simulator.late == 0
    assert abs(value - expected) > 2 * Sliders.ERROR  # without the leap


def test_a_leap_alone_comes_near_its_error() -> None:
    # The control: the bound is not so wide that anything would pass.
    errors = []
    for seconds in np.linspace(2.0, 8.0, 61):
        simulator, sliders, _ = start(Sliders(Leap(1, Sliders.ERROR), 1))
        frame(simulator, seconds, [0])
        errors.append(abs(float(sliders.position[0]) - run_always(round(seconds * 60))))
    assert 0.5 * Sliders.ERROR < max(errors) <= Sliders.ERROR


def test_an_absence_within_the_budget_is_stepped_instead_of_leapt() -> None:
    simulator, sliders, _ = start(Sliders(Leap(BUDGET, Sliders.ERROR), 1))
    frame(simulator, 1.0, [0])
    assert sliders.position[0] == run_always(60)


def test_a_function_of_the_time_misses_nothing() -> None:
    simulator, swings, scene = start(Swings(3))
    frame(simulator, 0.25, [0, 1])
    frame(simulator, 9 * HOUR, [2, 0])
    assert swings.calls == 2
    assert simulator.steps == 0
    always = Swings(3)
    always.set_time(np.arange(3), 9 * HOUR)
    assert swings.position[[0, 2]].tolist() == always.position[[0, 2]].tolist()
    assert scene.nodes.world[[0, 2], 0, 3].tolist() == always.position[[0, 2]].tolist()
    assert swings.position[1] == np.sin(1.3 * 0.25 + 1)  # it was left alone


def test_a_leap_gives_another_state_than_steps_of_the_same_number() -> None:
    # Its states are therefore never mistaken for those of another run.
    states = []
    for budget in (2, 3):
        simulator, sliders, _ = start(Sliders(Leap(budget, Sliders.ERROR), 1))
        frame(simulator, 5.0, [0])
        states.append((float(sliders.position[0]), float(simulator._states[0])))
    assert states[0][0] != states[1][0]
    assert states[0][1] != states[1][1]


@pytest.mark.parametrize(
    "make",
    [
        lambda: Stepwise(0),
        lambda: Stepwise(5, memory=0),
        lambda: Leap(0, 1.0),
        lambda: Leap(5, -1.0),
        lambda: Leap(5, np.inf),
    ],
)
def test_a_policy_without_a_bound_is_refused(make: Callable[[], object]) -> None:
    with pytest.raises(ValidationError, match=r"^\[scene-bad-simulation\]"):
        make()


def test_a_member_with_memory_returns_exactly_if_the_budget_covers_its_steps() -> None:
    for count, budget in ((2, 10), (3, 14)):
        policy = Stepwise(budget, memory=5)
        assert policy.returns_exactly(count) == (count == 2)
        sliders = Sliders(policy, count)
        simulator, _, _ = start(sliders)
        frame(simulator, HOUR, range(count))
        assert (simulator.late == 0) == policy.returns_exactly(count)
    others = (Recompute(), Stepwise(10**6), Leap(10**6, 0.0))
    assert [simulation.returns_exactly(1) for simulation in others] == [True, False, False]
