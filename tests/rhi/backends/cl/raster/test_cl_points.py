"""Points of one sample, which are set up 16 at a time, and those of several samples, one by one."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from rhi import BlendFunction, Device, Format, Primitive, Scissor
from rhi.conformance.compare import assert_same
from rhi.conformance.shaders import Sized
from rhi.conformance.shapes import point_square, point_vertices
from rhi.conformance.single_draws import draw_once

SIZE = (150, 90)  # six tiles, which the target's right and lower edges cut
COUNT = 37  # two whole groups and a part of one


def random_points(count: int) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return points as rows, and their places and sizes in texels: (count, 3)."""
    rng = np.random.default_rng(3)
    positions = (
        rng.integers(0, np.multiply(SIZE, 4), (count, 2)) / 4 + 1 / 32
    )  # no edge passes through a centre
    sizes = np.where(np.arange(count) % 3 == 0, 1.0, rng.integers(2, 140, count) / 2)
    return point_vertices(positions, SIZE, sizes), np.column_stack([positions, sizes])


def expected_overdraw(points: NDArray[Any], indices: Any = slice(None)) -> NDArray[np.int64]:
    """Return the number of points that cover each texel."""
    return np.sum([point_square(x, y, side, SIZE) for x, y, side in points[indices]], 0)


def count_overdraw(
    device: Device, rows: NDArray[Any], indices: Any = None, *states: Any, samples: int = 1
) -> NDArray[Any]:
    """Return the number of draws of each texel."""
    options: dict[str, Any] = {
        "shader": Sized,
        "indices": indices,
        "primitive": Primitive.POINTS,
        "samples": samples,
    }
    return draw_once(device, SIZE, Format.RGBA32F, rows, BlendFunction.ADDITIVE, *states, **options)[..., 3]


@pytest.mark.parametrize("count", [15, 16, 17, COUNT])
def test_points_of_a_whole_group_and_a_part_of_one_are_drawn_once(device: Device, count: int) -> None:
    rows, points = random_points(count)
    assert_same(count_overdraw(device, rows), expected_overdraw(points))


@pytest.mark.parametrize("kind", ["u2", "u4"])
def test_points_are_picked_by_indices(device: Device, kind: str) -> None:
    rows, points = random_points(COUNT)
    indices = np.random.default_rng(4).integers(5, COUNT, 50).astype(kind)
    assert_same(count_overdraw(device, rows, indices), expected_overdraw(points, indices))


def test_a_scissor_cuts_each_of_many_points(device: Device) -> None:
    rows, points = random_points(COUNT)
    expected = expected_overdraw(points)
    expected[:30] = expected[70:] = 0
    expected[:, :41] = expected[:, 101:] = 0
    assert_same(count_overdraw(device, rows, None, Scissor(41, 30, 60, 40)), expected)


def test_points_behind_the_eye_leave_gaps_in_a_group(device: Device) -> None:
    rows, points = random_points(COUNT)
    behind = np.arange(COUNT) % 4 == 1
    rows["position"][behind] *= -1
    assert_same(count_overdraw(device, rows), expected_overdraw(points[~behind]))


@pytest.mark.parametrize("samples", [4, 8])
def test_whole_texels_agree_between_one_sample_and_several(device: Device, samples: int) -> None:
    rows, _ = random_points(COUNT)
    rows["size"] = np.ceil(rows["size"])
    rows["position"][:, :2] = (
        np.round((rows["position"][:, :2] + 1) * np.divide(SIZE, 2)) / np.divide(SIZE, 2) - 1
    )
    rows["size"] += rows["size"] % 2
    assert_same(count_overdraw(device, rows), count_overdraw(device, rows, samples=samples))
