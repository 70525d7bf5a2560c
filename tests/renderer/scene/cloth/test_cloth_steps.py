"""Steps of cloths: what no wind does, what time doesn't change, and the same on devices as on NumPy."""

from __future__ import annotations

from copy import deepcopy

import numpy as np
import pytest
from cloth_scenes import BREEZE, advance, make_scene, make_square, read_points
from hypothesis import given, settings
from hypothesis import strategies as st
from nightly_reasons import FEWER_CASES

import rhi
from renderer.content.hall import DRAUGHT, make_banner
from renderer.scene import Scene, Simulator
from renderer.scene.cloth import ClothSimulation, Fabric, Gust, Wind
from rhi.backends.null import NullBackend

speeds = st.tuples(*[st.sampled_from([0.0, 1e-40, 3.0, -40.0, 1000.0, -1000.0])] * 3)
amounts = st.sampled_from([0.0, 1e-40, 1e-4, 1.0, 1e6])


@settings(max_examples=8)
@given(speeds, speeds, st.tuples(*[amounts] * 5), st.sampled_from([1e-3, 1.0, 1000.0]), st.booleans())
def test_no_wind_and_no_fabric_takes_a_cloth_out_of_its_bounds(
    constant: tuple[float, float, float],
    gust: tuple[float, float, float],
    values: tuple[float, ...],
    size: float,
    is_narrow: bool,
) -> None:
    bounds = (
        ((-0.6 * size, -1.1 * size, -0.1 * size), (0.6 * size, 0.1 * size, 0.1 * size)) if is_narrow else None
    )
    cloth_grid = make_square(4, 3, size, fabric=Fabric(0.2, *values), bounds=bounds)
    cloths = ClothSimulation(2, cloth_grid, Wind(constant, (Gust(gust, (0.4, 0.3, 0.1), 0.1),)))
    (low, high), away = cloth_grid.bounds, np.linalg.norm(cloth_grid.bounds[1] - cloth_grid.bounds[0])
    for number in range(1, 7):
        advance(cloths, number, number)
        points = read_points(cloths)
        assert (points >= low).all()
        assert (points <= high).all()
        assert (
            np.linalg.norm(points - cloth_grid.anchors, axis=-1) <= cloth_grid.reaches * (1.0 + 1e-5)
        ).all()
        assert (points[:, ~cloth_grid.is_free] == cloth_grid.points[~cloth_grid.is_free]).all()
        assert np.abs(cloths.read()[1]).max() <= 960.0 * away
    assert np.isfinite(cloths.vertices(np.arange(2))["normal"]).all()


def test_a_strong_wind_takes_it_to_the_end_of_its_bounds() -> None:
    """The control: they are no wider than they must be."""
    cloths = ClothSimulation(1, make_square(), Wind((0.0, 0.0, 60.0)))
    advance(cloths, 1, 30)
    assert read_points(cloths)[..., 2].max() > 0.8 * cloths.cloth_grid.upper[2]


def advance_on(device: rhi.Device, cloths: ClothSimulation, first: int, last: int) -> np.ndarray:
    """Take steps on a device; return the points (k, n, 3)."""
    advance(cloths, first, last)
    members, points = np.arange(len(cloths)), len(cloths.cloth_grid.points)
    with device.storage(float, 6 * points * len(cloths)) as vertices:
        cloths.deform(device, members, vertices, members * points, 6)
        return vertices.read().reshape(len(cloths), points, 6)[..., :3].copy()


def test_a_cloth_comes_to_rest_straight_below_its_pins(device: rhi.Device) -> None:
    cloths = ClothSimulation(1, make_square(), Wind())
    points, moving = advance_on(device, cloths, 1, 240), cloths.read()[1]
    cloths.release(device)
    assert points[0, :, 1].min() == pytest.approx(-1.0, abs=0.02)
    assert np.abs(points[0, :, 2]).max() < 1e-3
    assert np.abs(moving).max() < 0.05


@pytest.mark.parametrize("rate", [2.0, 4.0])
def test_a_steady_wind_holds_it_at_the_angle_at_which_forces_balance(device: rhi.Device, rate: float) -> None:
    """Along its swing a point of a stiff cloth has g sin a of its weight, and `rate` (w cos a) of the
    wind."""
    cloths = ClothSimulation(
        1, make_square(fabric=Fabric(drag=rate, damping=2.0, bend=0.0)), Wind((0.0, 0.0, 2.0))
    )
    edge = advance_on(device, cloths, 1, 300)[0].reshape(6, 5, 3)[-1].mean(0)
    cloths.release(device)
    assert np.arctan2(edge[2], -edge[1]) == pytest.approx(np.arctan(2.0 * rate / 9.81), abs=0.03)


def test_steps_are_the_same_whenever_they_are_taken_and_with_whom() -> None:
    first, second = (ClothSimulation(3, make_square(), BREEZE, seed=1) for _ in range(2))
    for number in range(1, 11):
        advance(first, number, number)
        read_points(first)
    advance(second, 1, 10, [1])
    advance(second, 1, 7, [0, 2])
    read_points(second)
    advance(second, 8, 10, [2])
    advance(second, 8, 10, [0])
    assert np.array_equal(read_points(first), read_points(second))
    assert not np.array_equal(
        read_points(first)[0], read_points(first)[1]
    )  # gusts reach each at a time of its own


def test_a_step_of_any_length_is_its_sub_steps(device: rhi.Device) -> None:
    """In a wind that doesn't change, two steps of 8 sub-steps are one of 16 that is twice as long."""
    wind = Wind((0.3, 0.0, 2.0))
    short, long = (ClothSimulation(1, make_square(sub_steps=8 * n, interval=n / 60), wind) for n in (1, 2))
    points = [advance_on(device, short, 1, 20), advance_on(device, long, 1, 10)]
    for cloths in (short, long):
        cloths.release(device)
    assert points[0] == pytest.approx(points[1], abs=1e-6)
    assert np.abs(points[0] - short.cloth_grid.points).max() > 0.05


def test_gusts_last_as_long_in_steps_of_any_length() -> None:
    assert Wind(gusts=(Gust((1.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.5),)).count_steps(1 / 60).tolist() == [
        30,
        1,
        1,
        1,
    ]
    assert BREEZE.count_steps(0.1).tolist() == [7, 4, 1, 1]


def test_a_step_after_years_equals_the_step_at_the_beginning() -> None:
    """10⁸ s are 6 · 10⁹ steps, more than 32 bits; gusts of 42 and 24 steps repeat every 168."""
    young, old = (ClothSimulation(1, make_square(), BREEZE) for _ in range(2))
    years = 168 * (int(1e8 * 60) // 168)
    advance(young, 1, 8)
    advance(old, years + 1, years + 8)
    assert np.array_equal(read_points(young), read_points(old))
    other = ClothSimulation(1, make_square(), BREEZE)
    advance(other, years + 2, years + 9)
    assert not np.array_equal(read_points(young), read_points(other))


def run_frames(scene: Scene, seconds: list[float]) -> tuple[Simulator, list[int]]:
    """Advance all objects to each time; return the simulator and the steps of each frame."""
    simulator, steps = scene.make_simulator(), []
    for time in seconds:
        simulator.begin_frame(time)
        simulator.advance(simulator.objects)
        steps.append(simulator.steps)
        assert simulator.late == 0
    return simulator, steps


def test_any_frame_costs_a_bounded_number_of_steps_and_shows_its_time() -> None:
    scene = make_scene(3, steps_per_frame=12)
    simulator, steps = run_frames(scene, [0.0, 1 / 60, 1 / 60, 10.0, 3610.0, 1e8, 1e8 + 1 / 60])
    assert steps == [0, 3, 0, 15, 15, 15, 3]  # a leap counts as a step
    scene.check_bounds([0.5, 10.0, 1e8])
    assert np.isfinite(simulator.read_vertices(1)["position"]).all()


@pytest.mark.nightly_cases("gl", reason=FEWER_CASES)
def test_a_cloth_that_leaps_is_soon_where_it_would_be(device: rhi.Device) -> None:
    stepped, leapt = (ClothSimulation(2, make_banner(4), DRAUGHT, seed=3) for _ in range(2))
    there = advance_on(device, stepped, 1, 300)
    leapt.leap(np.arange(2), np.full(2, 300), np.full(2, 300))
    away = np.linalg.norm(there - read_points(leapt), axis=-1).mean()
    points = [advance_on(device, cloths, 301, 540) for cloths in (stepped, leapt)]
    assert np.linalg.norm(points[0] - points[1], axis=-1).mean() < 0.1 * away
    assert np.linalg.norm(points[0] - there, axis=-1).mean() > 0.5 * away  # meanwhile it has moved
    for cloths in (stepped, leapt):
        cloths.release(device)


def test_steps_before_a_leap_are_taken_in_their_wind() -> None:
    """True if somebody has looked at the cloth before the leap or not."""
    seen, unseen = (ClothSimulation(2, make_square(), BREEZE, seed=3) for _ in range(2))
    for cloths in (seen, unseen):
        advance(cloths, 1, 4)
        if cloths is seen:
            read_points(cloths)
        cloths.leap(np.array([0, 1]), np.array([50, 50]), np.array([46, 46]))
        advance(cloths, 51, 53)
    assert np.array_equal(read_points(seen), read_points(unseen))


def test_copies_go_their_own_ways() -> None:
    cloths = ClothSimulation(1, make_square(), BREEZE)
    advance(cloths, 1, 5)
    copied = deepcopy(cloths)
    before = read_points(copied).copy()
    advance(cloths, 6, 9)
    assert not np.array_equal(read_points(cloths), before)
    assert np.array_equal(read_points(copied), before)


def compare(device: rhi.Device, steps: int) -> tuple[float, float]:
    """Take steps on the device and on NumPy; return how far points and normals differ at most."""
    cloth_grid = make_square(fabric=Fabric(stretch=1e-4))
    there, here = (ClothSimulation(3, cloth_grid, BREEZE, seed=2) for _ in range(2))
    count, members = len(cloth_grid.points), np.array([2, 0])
    with device.storage(float, 9 * (2 * count + 1)) as vertices:
        begins = np.array([1, 1 + count])
        for first in (1, steps // 2 + 1):
            last = steps if first > 1 else steps // 2
            for cloths in (there, here):
                advance(cloths, first, last, members)
            there.deform(device, members, vertices, begins, 9)
        written = vertices.read().reshape(-1, 9)
        assert (written[0] == 0.0).all()  # what lies before isn't written
        assert (written[:, 6:] == 0.0).all()  # nor what is between
        expected = here.vertices(members)
        assert np.allclose(there.vertices(members)["position"], written[1:, :3], atol=1e-7)
        there.release(device)
    return (
        float(np.abs(written[1:, :3] - expected["position"]).max()),
        float(np.abs(written[1:, 3:6] - expected["normal"]).max()),
    )


def test_devices_take_the_same_steps_as_numpy(device: rhi.Device) -> None:
    points, normals = compare(device, 2)
    assert points < 2e-6
    assert normals < 2e-5
    points, normals = compare(device, 20)  # each step adds to what differs
    assert points < 5e-5
    assert normals < 5e-4


def test_the_shader_takes_the_same_steps_on_numpy(null: rhi.Device) -> None:
    null.backend_as(NullBackend).run_shaders()
    points, normals = compare(null, 2)
    assert points < 2e-6
    assert normals < 2e-5


def test_a_state_moves_from_numpy_to_a_device_and_back(null: rhi.Device) -> None:
    null.backend_as(NullBackend).run_shaders()
    cloths = ClothSimulation(1, make_square(), BREEZE)
    advance(cloths, 1, 2)
    here = deepcopy(cloths)
    before = read_points(here).copy()
    with null.storage(float, 8 * 30) as vertices:
        cloths.deform(null, np.zeros(1, np.int64), vertices, np.zeros(1, np.int64), 8)
        assert np.abs(read_points(deepcopy(cloths)) - before).max() < 1e-5
        cloths.release(null)
