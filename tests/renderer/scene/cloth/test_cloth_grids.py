"""Sheets: their constraints, what holds them, and what can't be one."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from cloth_scenes import make_square
from refusals import refused_rule

from renderer.content.hall import make_banner
from renderer.scene.cloth import ClothSimulation, Fabric, Gust, Wind, make_cloth_grid

GRID = np.stack([*np.meshgrid(np.arange(3.0), -np.arange(3.0)), np.zeros((3, 3))], 2)
PINS = np.eye(3, dtype=bool)


@pytest.mark.parametrize(("rows", "columns"), [(2, 2), (3, 3), (4, 7), (9, 5)])
def test_constraints_of_a_batch_share_no_point_and_each_is_there_once(rows: int, columns: int) -> None:
    cloth_grid = make_square(rows, columns)
    constraints = cloth_grid.constraints
    for begin, end in pairwise(cloth_grid.batches.tolist()):
        ends = np.concatenate([constraints["a"][begin:end], constraints["b"][begin:end]])
        assert len(np.unique(ends)) == len(ends) > 0
    steps = {
        tuple(np.subtract(np.divmod(b, columns), np.divmod(a, columns)).tolist())
        for a, b in zip(constraints["a"].tolist(), constraints["b"].tolist(), strict=True)
    }
    assert steps <= {(0, 1), (1, 0), (1, 1), (1, -1), (0, 2), (2, 0)}
    expected = (  # without those between the pins of the first row
        (rows - 1) * (columns - 1)
        + (rows - 1) * columns
        + 2 * (rows - 1) * (columns - 1)
        + (rows - 1) * max(columns - 2, 0)
        + max(rows - 2, 0) * columns
    )
    assert (
        len({*zip(constraints["a"].tolist(), constraints["b"].tolist(), strict=True)})
        == len(constraints)
        == expected
    )


def test_each_point_is_tethered_to_its_nearest_pin() -> None:
    cloth_grid = make_cloth_grid(GRID, PINS)
    assert cloth_grid.anchors.reshape(3, 3, 3)[0, 1].tolist() in ([0, 0, 0], [1, -1, 0])
    assert cloth_grid.reaches.reshape(3, 3)[0].tolist() == pytest.approx([0.0, 1.01, 1.01 * 2**0.5], abs=1e-4)


def test_a_room_is_no_larger_than_pins_allow_and_no_smaller_than_its_points() -> None:
    free = make_square()
    assert free.lower.tolist() == pytest.approx([-1.51, -1.01, -1.01], abs=1e-4)
    roomy = make_square(bounds=((-9.0, -9.0, -0.25), (9.0, 0.0, np.inf)))
    assert roomy.lower.tolist() == pytest.approx([-1.51, -1.01, -0.25], abs=1e-4)
    assert roomy.upper.tolist() == pytest.approx([1.51, 0.0, 1.01], abs=1e-4)
    assert free.diameter == pytest.approx(2.02, abs=1e-3)  # from end to end of a ball
    narrow = make_square(bounds=((-0.5, -1.0, -0.1), (0.5, 0.0, 0.1)))
    assert narrow.diameter == pytest.approx(np.hypot(np.hypot(1.0, 1.0), 0.2), abs=1e-3)


def test_folds_are_as_long_as_the_flat_cloth() -> None:
    cloth_grid = make_banner(8)
    at = cloth_grid.points.reshape(cloth_grid.rows, cloth_grid.columns, 3)[5].astype(np.float64)
    assert np.linalg.norm(np.diff(at, axis=0), axis=1).sum() == pytest.approx(2.4, rel=0.03)


@pytest.mark.parametrize(
    "make",
    [
        lambda: make_cloth_grid(GRID[:1], PINS[:1]),
        lambda: make_cloth_grid(GRID[0], PINS),
        lambda: make_cloth_grid(np.zeros((200, 200, 3)), np.ones((200, 200), bool)),
        lambda: make_cloth_grid(GRID, np.zeros((3, 3), bool)),
        lambda: make_cloth_grid(GRID, np.ones((3, 3), bool)),
        lambda: make_cloth_grid(GRID, PINS.astype(int)),
        lambda: make_cloth_grid(GRID, PINS[:2]),
        lambda: make_cloth_grid(np.full_like(GRID, np.nan), PINS),
        lambda: make_cloth_grid(GRID * 1e4, PINS),
        lambda: make_cloth_grid(GRID * 0.0, PINS),
        lambda: make_cloth_grid(GRID, PINS, flat=np.full_like(GRID, np.inf)),
        lambda: make_cloth_grid(GRID, PINS, bounds=((0, -2, 0), (1.9, 0, 0))),
        lambda: make_cloth_grid(GRID, PINS, bounds=((0, -2, np.nan), (2, 0, 0))),
        lambda: Fabric(density=0.0),
        lambda: Fabric(drag=-1.0),
        lambda: Fabric(stretch=np.nan),
        lambda: Wind((np.nan, 0, 0)),
        lambda: Wind((1001.0, 0, 0)),
        lambda: Wind((0, 0, 0), (Gust((1, 0, 0), (0, 0, 0), 1.0),) * 5),
        lambda: Gust((0, 0, 0), (np.inf, 0, 0), 1.0),
        lambda: Gust((0, 0, 0), (0, 0, 0), 0.001),
        lambda: Gust((0, 0), (0, 0, 0), 1.0),
        lambda: ClothSimulation(0, make_square()),
        lambda: ClothSimulation(65_536, make_square()),
        lambda: make_square(sub_steps=0),
        lambda: make_square(sub_steps=65),
        lambda: make_square(100, 100, sub_steps=14),
        lambda: make_square(interval=0.00099),
        lambda: make_square(interval=0.101),
        lambda: make_square(interval=np.nan),
    ],
)
def test_invalid_cloths_are_refused(make: object) -> None:
    assert refused_rule(make) == "scene-bad-cloth"
    assert make_square(100, 100, sub_steps=13).sub_steps == 13
    assert (make_square(interval=0.001).interval, make_square(interval=0.1).interval) == (0.001, 0.1)


def test_cloths_at_the_limits_are_accepted() -> None:
    make_cloth_grid(GRID, PINS, flat=GRID * 2.0, bounds=((0, -2, 0), (2, 0, 0)))
    make_cloth_grid(GRID * 5000.0, PINS)
    Fabric(1e-6, 0.0, 0.0, 0.0, 0.0, 0.0)
    Wind((1000.0, 0, 0), (Gust((1, 0, 0), (0, 0, 0), 1.0 / 60.0),) * 4)
