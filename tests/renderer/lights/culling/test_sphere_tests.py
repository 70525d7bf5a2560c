"""Tests of spheres against cells: none drops a pair that overlaps, on any device."""

from __future__ import annotations

import numpy as np
import pytest
from shader_cells import evaluate_cells

import rhi
from renderer.lab.exam.cell_pairs import PROJECTIONS, Pairs, make_pairs
from renderer.lab.exam.light_culling_cases import exceeds_padding
from renderer.lab.exam.sphere_pairs import pack_pairs, run_sphere_tests
from renderer.lights.culling.cells import Cell, corner
from renderer.lights.culling.table import SPHERE_TESTS
from rhi.shading import evaluate

COUNT = 17_000  # of each of six projections


def run(device: rhi.Device, pairs: Pairs) -> dict[str, np.ndarray]:
    """Make all tests of pairs on a device, in float32."""
    return run_sphere_tests(device, pairs.grid, pack_pairs(pairs))


@pytest.fixture(scope="module", params=PROJECTIONS)
def pairs(request: pytest.FixtureRequest) -> Pairs:
    return make_pairs(request.param, COUNT)


def test_corners_are_those_of_the_inverse_projection(pairs: Pairs) -> None:
    for index in range(8):
        ours = evaluate(corner, evaluate_cells(pairs), index, dtype=np.float64)
        assert np.allclose(ours, pairs.corners[:, index], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("name", SPHERE_TESTS)
def test_no_pair_that_overlaps_is_dropped_in_float64(pairs: Pairs, name: str) -> None:
    test = SPHERE_TESTS[name]
    passed = evaluate(test.function, evaluate_cells(pairs), pairs.centres, pairs.radii, dtype=np.float64)
    certain = np.abs(pairs.distances - pairs.radii) > 1e-9 * (1.0 + np.abs(pairs.centres).sum(1))
    assert not (pairs.overlap & ~passed & certain).any()
    assert 0.2 < pairs.overlap.mean() < 0.8
    assert certain.mean() > 0.9
    is_box = not pairs.grid.slope_step.x and "box" in name  # of a parallel projection
    if test.is_exact or is_box:
        assert (passed == pairs.overlap)[certain].all()
    else:
        assert (passed & ~pairs.overlap & certain).any()  # otherwise the table calls it less than it is


SIDES = {"left": (-1, 0), "right": (1, 0), "bottom": (0, -1), "top": (0, 1)}


@pytest.mark.parametrize("slope", [-0.75, 0.0, 0.75, 2.4])
@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("name", [name for name in SPHERE_TESTS if "planes" in name])
def test_a_sphere_behind_a_plane_is_dropped_from_its_radius_on(name: str, side: str, slope: float) -> None:
    """Its centre lies before the middle of a side of a long thin cell, at a right angle to it."""
    cell = np.zeros((), Cell.dtype)
    cell["near"], cell["far"] = -100.0, 100.0
    cell["low"], cell["high"] = -1000.0, 1000.0
    across = np.array(SIDES[side], float)
    axis = int(np.abs(across).argmax())
    which = "low" if across.sum() < 0 else "high"
    cell[which][axis], cell[which + "_slope"][axis] = 0.0, slope
    normal = np.append(across, -slope * across.sum()) / np.hypot(1.0, slope)
    for radius, passed in ((4.999, False), (5.001, True)):
        assert evaluate(SPHERE_TESTS[name].function, cell, 5.0 * normal, radius, dtype=np.float64) == passed


def test_no_pair_that_overlaps_is_dropped_on_a_device(device: rhi.Device, pairs: Pairs) -> None:
    for name, passed in run(device, pairs).items():
        assert not (pairs.overlap & ~passed).any(), name


def test_padding_adds_few_pairs_on_a_device(device: rhi.Device, pairs: Pairs) -> None:
    """Of exact tests: beyond what the padding explains, they keep nothing that doesn't overlap."""
    passed = run(device, pairs)
    beyond = exceeds_padding(pairs)
    assert beyond.mean() > 0.2
    assert not (passed["exact"] & beyond).any()
    assert not (passed["all_axes"] & beyond).any()


@pytest.mark.nightly
@pytest.mark.parametrize("projection", PROJECTIONS)
def test_no_pair_of_a_hundred_thousand_is_dropped(device: rhi.Device, projection: str) -> None:
    many = make_pairs(projection, 100_000, seed=1)
    for name, passed in run(device, many).items():
        assert not (many.overlap & ~passed).any(), name
        test = SPHERE_TESTS[name].function
        exact = evaluate(
            test, evaluate_cells(many), many.centres, many.radii * (1 + 1e-9) + 1e-9, dtype=np.float64
        )
        assert not (many.overlap & ~exact).any(), name
