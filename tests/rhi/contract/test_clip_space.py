"""Projections of OpenGL's libraries, converted to depth from 0 to 1."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

import rhi
from rhi import ValidationError, convert_projection

NEAR, FAR = 0.1, 1000.0
GL = np.array([
    (1.2, 0, 0, 0), (0, 1.7, 0, 0), (0, 0, -(FAR + NEAR) / (FAR - NEAR), -2 * FAR * NEAR / (FAR - NEAR)), (0, 0, -1, 0),
])  # fmt: skip
"""glFrustum's matrix."""


def depth(projection: NDArray[np.float64], distance: float) -> float:
    _, _, z, w = projection @ (0, 0, -distance, 1)
    return float(z / w)


@pytest.mark.parametrize(("reverse", "near", "far"), [(True, 1, 0), (False, 0, 1)])
def test_near_and_far_planes_end_where_they_should(reverse: bool, near: float, far: float) -> None:
    assert depth(GL, NEAR) == pytest.approx(-1)  # the control: it is a matrix with -1…1
    converted = convert_projection(GL, reverse=reverse)
    assert depth(converted, NEAR) == pytest.approx(near, abs=1e-12)
    assert depth(converted, FAR) == pytest.approx(far, abs=1e-12)


def test_x_y_and_w_stay() -> None:
    converted = convert_projection(GL)
    assert np.array_equal(converted[[0, 1, 3]], GL[[0, 1, 3]])


def test_many_are_converted_at_once_and_none_in_place() -> None:
    cameras = np.stack([GL, GL * 2])
    before = cameras.copy()
    assert np.array_equal(convert_projection(cameras)[1], convert_projection(GL * 2))
    assert np.array_equal(cameras, before)


def test_reversed_depth_of_a_parallel_projection_is_linear() -> None:
    parallel = np.diag((1.0, 1.0, -2 / (FAR - NEAR), 1.0))
    parallel[2, 3] = -(FAR + NEAR) / (FAR - NEAR)
    middle = (NEAR + FAR) / 2
    assert depth(convert_projection(parallel), middle) == pytest.approx(0.5, abs=1e-12)


@pytest.mark.parametrize(
    "wrong", [np.eye(3), np.ones(16), np.full((4, 4), np.nan), np.diag((1, 1, 1, np.inf))]
)
def test_a_matrix_that_is_not_a_projection_is_refused(wrong: NDArray[np.float64]) -> None:
    with pytest.raises(ValidationError, match=r"^\[device-argument\]"):
        convert_projection(wrong)
    assert rhi.convert_projection(np.eye(4)).shape == (4, 4)
