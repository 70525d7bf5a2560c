"""Water: waves against their analytic solution, the same steps on devices, and steps only where it is
seen."""

from __future__ import annotations

from copy import deepcopy
from typing import Any

import numpy as np
import pytest
from refusals import refused_rule

import rhi
from renderer.content import load_scene
from renderer.renderer import Renderer
from renderer.scene import Camera, Scene, SceneBuilder, translation
from renderer.scene.water import WaterPool, WaterSimulation
from renderer.scene.water.water_pools import FORGOTTEN_FRACTION
from renderer.visibility import FrustumCulling
from rhi import Op
from rhi.backends.null import NullBackend

RAIN: dict[str, Any] = {"size": (1.5, 1.0), "cells": (24, 20), "rain": 20.0}


def advance(water: WaterSimulation, first: int, last: int, members: Any = None) -> None:
    """Ask for the steps from `first` to `last`."""
    members = np.arange(len(water)) if members is None else np.asarray(members)
    for number in range(first, last + 1):
        water.step(members, np.full(len(members), number))


def deform(device: rhi.Device, water: WaterSimulation) -> np.ndarray:
    """Take the steps that are due on a device; return the vertices (k, n, 6): positions and normals."""
    count, points = len(water), int(np.prod(water.pool.shape))
    with device.storage(float, 6 * points * count) as vertices:
        water.deform(device, np.arange(count), vertices, points * np.arange(count), 6)
        return vertices.read().reshape(count, points, 6).copy()


def measure_error(device: rhi.Device, cells: int, damping: float) -> float:
    """Return the greatest error in 5 s of a standing wave of 2 m and 1 cm, in its height."""
    start = 0.01 * np.cos(np.pi * np.linspace(0.0, 1.0, cells + 1)) * np.ones((cells + 1, 1))
    water, worst = (
        WaterSimulation(
            1, WaterPool(cells=(cells, cells), depth=0.1, damping=damping, rain=0.0, start=start)
        ),
        0.0,
    )
    rate = np.sqrt(9.81 * 0.1) * np.pi / 2.0
    for number in range(10, 301, 10):
        advance(water, number - 9, number)
        heights = deform(device, water)[0, :, 1].reshape(start.shape)
        seconds = number / 60.0
        exact = start * np.cos(rate * seconds) * np.exp(-0.5 * damping * seconds)
        worst = max(worst, float(np.abs(heights - exact).max()) / 0.01)
    water.release(device)
    return worst


@pytest.mark.parametrize("damping", [0.0, 0.8])
def test_a_standing_wave_is_the_analytic_one_to_the_square_of_the_cells(
    device: rhi.Device, damping: float
) -> None:
    """The scheme's error of speed is the 1/24 of (π cell / 2 m)², less what the length of a step gives
    back."""
    coarse, fine = measure_error(device, 8, damping), measure_error(device, 32, damping)
    assert 0.005 < coarse < 0.05
    assert fine < coarse / 14.0


def test_devices_take_the_same_steps_as_numpy(device: rhi.Device) -> None:
    there, here = (WaterSimulation(3, WaterPool(**RAIN), seed=2) for _ in range(2))
    for first in (1, 41):
        for water in (there, here):
            advance(water, first, first + 39, [2, 0])
        vertices = deform(device, there)
    expected = here.vertices(np.arange(3)).reshape(3, -1)
    assert np.abs(expected["position"][..., 1]).max() > 1e-3
    assert np.abs(vertices[..., 1] - expected["position"][..., 1]).max() < 1e-6
    assert np.abs(vertices[..., 3:] - expected["normal"]).max() < 1e-5
    assert (vertices[1, :, 1] == 0.0).all()  # it takes no step
    copied = deepcopy(there)
    there.release(device)
    assert np.abs(copied.read() - here.read()).max() < 1e-6


@pytest.mark.parametrize("steps", [1, 2])
def test_released_water_restarts_at_its_first_heights(null: rhi.Device, steps: int) -> None:
    start = 0.01 * np.cos(np.pi * np.linspace(0.0, 1.0, 7)) * np.ones((6, 1))
    again, new = (WaterSimulation(1, WaterPool(cells=(6, 5), rain=0.0, start=start)) for _ in range(2))
    advance(again, 1, steps)
    deform(null, again)
    again.release(null)
    assert (again.read()[0] == start.astype(np.float32)).all()
    advance(again, steps + 1, steps + 1)
    advance(new, 1, 1)
    assert (again.read() == new.read()).all()


def test_the_shader_takes_the_same_steps_on_numpy(null: rhi.Device) -> None:
    null.backend_as(NullBackend).run_shaders()
    there, here = (WaterSimulation(2, WaterPool(cells=(6, 5), rain=60.0), seed=2) for _ in range(2))
    for water in (there, here):
        advance(water, 1, 4)
    vertices = deform(null, there)
    assert np.abs(vertices[..., 1].reshape(-1) - here.vertices(np.arange(2))["position"][:, 1]).max() < 1e-7


@pytest.mark.parametrize(("missed", "is_forgotten"), [(1, True), (0, False)])
def test_water_absent_for_longer_than_its_memory_equals_water_that_was_always_simulated(
    missed: int, is_forgotten: bool
) -> None:
    pool = WaterPool(**{**RAIN, "damping": 6.0})
    memory = pool.memory
    assert memory is not None
    assert pool.damping_factor**memory <= FORGOTTEN_FRACTION < pool.damping_factor ** (memory - 1)
    always, away = (WaterSimulation(1, pool, seed=5) for _ in range(2))
    advance(always, 1, 500)
    advance(away, 1, 50)
    advance(away, 500 - memory + 1 if missed else 480, 500)
    error = np.abs(always.read() - away.read()).max() / np.abs(always.read()).max()
    assert (error < 2.0 * FORGOTTEN_FRACTION) == is_forgotten


def test_without_damping_no_step_is_left_out() -> None:
    assert WaterSimulation(1, WaterPool(damping=0.0)).catch_up.memory is None
    assert WaterSimulation(1, WaterPool(damping=1.0)).catch_up.memory == 829


def test_no_rain_takes_water_out_of_its_bounds() -> None:
    wild, calm = (
        WaterPool(**{**RAIN, "rain": 60.0, "max_height": max_height, "drop": 0.1, "damping": 0.0})
        for max_height in (0.1, 4.0)
    )
    heights = []
    for pool in (wild, calm):
        water = WaterSimulation(1, pool)
        advance(water, 1, 120)
        heights.append(np.abs(water.read()).max())
    assert heights[0] <= np.float32(0.1)
    assert heights[1] > 0.1  # the control: it would have


@pytest.mark.parametrize("seed", range(5))
def test_neighbours_are_drawn_with_a_difference_within_the_greatest_height(
    device: rhi.Device, seed: int
) -> None:
    """Between -H and H two neighbours may differ by 2 H. Where all are within H of each other, nothing moves."""
    heights = 0.1 * np.random.default_rng(seed).choice([-1.0, -0.4, 0.3, 1.0], (21, 25))
    pool = WaterPool(**{**RAIN, "rain": 0.0, "start": heights})
    water = WaterSimulation(1, pool)
    drawn = [
        deform(device, water)[0, :, 1].reshape(pool.shape),
        pool.make_vertices(heights[None])["position"],
    ]
    drawn[1] = drawn[1][:, 1].reshape(pool.shape)
    water.release(device)
    for surface in drawn:
        differences = np.concatenate([np.abs(np.diff(surface, axis=axis)).reshape(-1) for axis in (0, 1)])
        assert differences.max() <= 0.1 * (1.0 + 1e-6)
        np.testing.assert_allclose(surface, limit_by_loops(heights, 0.1), atol=1e-7)
    calm = 0.5 * heights
    np.testing.assert_array_equal(pool.break_waves(calm[None])[0], calm)
    assert np.abs(np.diff(heights)).max() == pytest.approx(0.2), "control: the wave was steeper"


def limit_by_loops(heights: np.ndarray, limit: float) -> np.ndarray:
    """Return each height within `limit` of its four neighbours, one point after another."""
    limited = heights.copy()
    for row, column in np.ndindex(heights.shape):
        for down, across in ((0, 1), (0, -1), (1, 0), (-1, 0)):
            neighbour = (row + down, column + across)
            if min(neighbour) >= 0 and neighbour[0] < heights.shape[0] and neighbour[1] < heights.shape[1]:
                lowest, highest = heights[neighbour] - limit, heights[neighbour] + limit
                limited[row, column] = min(max(limited[row, column], lowest), highest)
    return limited


def make_pools() -> Scene:
    """Make three pools in a row along x, 4 m apart."""
    builder, pool = SceneBuilder("pools"), WaterPool(**RAIN)
    meshes = [builder.add_mesh(pool.make_mesh(), f"water {number}", pool.bounds) for number in range(3)]
    nodes = builder.add_nodes(translation([(4.0 * number, 0.0, 0.0) for number in range(3)]))
    builder.simulate(builder.add_objects(nodes, meshes, builder.add_material()), WaterSimulation(3, pool))
    builder.lights.add_directional((-0.3, -1.0, -0.6))
    return builder.build()


@pytest.mark.parametrize("width", [1.1, 2.6, 5.0137, 0.3])
def test_bounds_hold_vertices_that_are_rounded_outwards(width: float) -> None:
    """0.55 is less than the nearest float32."""
    pool = WaterPool((width, width), cells=(8, 8), depth=0.01, max_height=0.1)
    lower, upper = pool.bounds
    positions = pool.make_vertices(np.full((1, *pool.shape), np.float32(0.1)))["position"]
    assert (positions >= lower).all()
    assert (positions <= upper).all()


def test_only_visible_members_take_steps_in_a_single_dispatch(null: rhi.Device) -> None:
    scene = make_pools()
    every, single = (Camera.look_at((4.0, height, 0.5 * height), (4.0, 0.0, 0.0)) for height in (9.0, 1.5))
    away = Camera.look_at((0.0, 2.0, 5.0), (0.0, 40.0, 60.0))
    with Renderer(null, scene, size=(64, 36), visibility=FrustumCulling(scene)) as renderer:
        counts = []
        for camera, frame in ((every, 1), (single, 2), (single, 3), (away, 4), (away, 900), (single, 901)):
            null.stream.clear()
            steps = renderer.render(camera, frame / 60).statistics.simulation_steps
            counts.append((len(null.stream.filter((Op.DISPATCH,))), steps))
    assert counts == [(1, 3), (1, 1), (1, 1), (0, 0), (0, 0), (1, WaterPool().memory)]


def test_waves_are_seen_on_each_device(drawing_device: rhi.Device) -> None:
    scene = load_scene("yard:pools=1,columns=0")
    with Renderer(drawing_device, scene, size=(96, 54)) as renderer:
        flat, waves = (
            renderer.render(scene.views["pool"], seconds).image.read().astype(int) for seconds in (0.0, 2.0)
        )
    changed = np.abs(waves - flat).max(axis=2) > 4
    assert 0.01 < changed.mean() < 0.6
    assert not changed[:10].any()  # only the water moves


@pytest.mark.parametrize(
    "wrong",
    [
        {"size": (0.0, 1.0)},
        {"depth": float("nan")},
        {"damping": -1.0},
        {"rain": 61.0},
        {"drop": 0.2},
        {"radius": 0.0},
        {"max_height": 0.0},
        {"cells": (1, 4)},
        {"cells": (128, 128)},
        {"cells": (100, 100), "depth": 1.0},
        {"start": np.zeros((3, 3))},
        {"start": np.full((49, 49), 0.11)},
    ],
    ids=lambda wrong: "-".join(wrong),
)
def test_invalid_water_pools_are_refused(wrong: dict[str, Any]) -> None:
    WaterPool(start=np.full((49, 49), 0.1), rain=60.0, drop=0.1, cells=(48, 48), depth=0.3)  # the control
    assert refused_rule(lambda: WaterPool(**wrong)) == "scene-bad-water"


@pytest.mark.parametrize("count", [0, 65_536])
def test_pools_are_as_many_as_a_dispatch_has_groups(count: int) -> None:
    assert refused_rule(lambda: WaterSimulation(count, WaterPool())) == "scene-bad-water"
