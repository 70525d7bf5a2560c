"""Tests of spot lights' cones against cells in float64: none drops a pair that overlaps, at any angle. On
devices the exam runs them."""

from __future__ import annotations

import numpy as np
import pytest
from shader_cells import evaluate_cells

from renderer.lab.exam.cell_pairs import PROJECTIONS
from renderer.lab.exam.cone_pairs import ANGLES, ConePairs, make_cone_pairs
from renderer.light_kinds.volumes import Cone, bounding_sphere
from renderer.lights.culling.cells import Cell
from renderer.lights.culling.sphere_tests import overlaps_exactly
from renderer.lights.culling.table import CONE_TESTS
from rhi.shading import evaluate


@pytest.fixture(scope="module", params=PROJECTIONS)
def pairs(request: pytest.FixtureRequest) -> ConePairs:
    return make_cone_pairs(request.param)


def test_the_sphere_around_a_cone_holds_its_rim_its_tip_and_its_apex() -> None:
    for angle in ANGLES:
        sphere = evaluate(bounding_sphere, make_cone(angle), dtype=np.float64)
        angles = np.linspace(0.0, angle, 50)
        rim = 3.0 * np.column_stack([np.sin(angles), np.zeros(50), np.cos(angles)])
        away = np.linalg.norm(np.vstack([rim, np.zeros(3)]) - sphere[:3], axis=1)
        assert away.max() <= sphere[3] * (1 + 1e-12)
        assert sphere[3] <= 3.0
        assert away.max() >= sphere[3] * (1 - 1e-6)


def make_cone(angle: float, apex: tuple[float, float, float] = (0, 0, 0)) -> Cone:
    return Cone(apex=apex, range=3.0, axis=(0, 0, 1), cosine=np.cos(angle))


def overlaps_sphere_first(pairs: ConePairs) -> np.ndarray:
    sphere = evaluate(bounding_sphere, pairs.cones, dtype=np.float64)
    return evaluate(
        overlaps_exactly, evaluate_cells(pairs), sphere[:, :3], sphere[:, 3] * (1 + 1e-12), dtype=np.float64
    )


def test_the_sphere_around_a_cone_overlaps_every_cell_that_the_cone_overlaps(pairs: ConePairs) -> None:
    assert not (pairs.overlap & ~overlaps_sphere_first(pairs)).any()


@pytest.mark.parametrize("name", CONE_TESTS)
def test_no_cone_that_overlaps_is_dropped_in_float64(pairs: ConePairs, name: str) -> None:
    passed = evaluate(CONE_TESTS[name].function, evaluate_cells(pairs), pairs.cones, 1e-12, dtype=np.float64)
    assert not (pairs.overlap & ~passed).any()


def test_tighter_cone_tests_pass_fewer_pairs(pairs: ConePairs) -> None:
    around = overlaps_sphere_first(pairs)
    passed = {
        name: int(
            (
                around & evaluate(test.function, evaluate_cells(pairs), pairs.cones, 0.0, dtype=np.float64)
            ).sum()
        )
        for name, test in CONE_TESTS.items()
    }
    assert passed["tight"] < passed["planes"] < passed["sphere"]
    assert passed["cone_sphere"] < passed["sphere"]
    assert passed["tight"] < 1.1 * pairs.overlap.sum()


ASIDE, BEHIND = 1.0, -1.0
"""Where a point a metre beside the axis is along it: at 45° from the axis, and at 135°."""


@pytest.mark.parametrize(
    ("along", "angle", "passed"),
    [
        (ASIDE, 0.1, False),
        (ASIDE, 44.0, False),
        (ASIDE, 46.0, True),
        (ASIDE, 90.0, True),
        (ASIDE, 120.0, True),
        (ASIDE, 180.0, True),
        (BEHIND, 89.0, False),
        (BEHIND, 91.0, False),
        (BEHIND, 134.0, False),
        (BEHIND, 136.0, True),
        (BEHIND, 180.0, True),
    ],
)
def test_a_cell_that_is_a_point_passes_if_the_cone_s_angle_reaches_it(
    along: float, angle: float, passed: bool
) -> None:
    cell = Cell(low=(1, 0), low_slope=(0, 0), high=(1, 0), high_slope=(0, 0), near=along, far=along)
    for name in ("cone_sphere", "tight"):
        test = CONE_TESTS[name].function
        assert evaluate(test, cell, make_cone(np.radians(angle)), 0.0, dtype=np.float64) == passed
