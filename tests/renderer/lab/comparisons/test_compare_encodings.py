"""`compare encodings`: its rows, and the chart."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_reports import read_report
from numpy.typing import NDArray

from renderer.lab.measure.encoding_errors import (
    ENCODINGS,
    QuaternionFrame,
    normal_errors,
    run_round_trip,
    tangent_errors,
)
from tests.renderer.conftest import open_device


@pytest.fixture(scope="module")
def chart_and_rows(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, dict[str, Any]]]:
    chart = tmp_path_factory.mktemp("encodings") / "chart.svg"
    arguments = ["--backend", "gl", "--count", "256", "--rounds", "1", "--json", "--plot", str(chart)]
    with open_device("gl"):
        report = read_report("compare", "encodings", *arguments)
    return chart, {row["name"]: row for row in report["rows"]}


@pytest.fixture(scope="module")
def rows(chart_and_rows: tuple[Path, dict[str, dict[str, Any]]]) -> dict[str, dict[str, Any]]:
    return chart_and_rows[1]


def test_each_encoding_has_a_row_with_its_time(rows: dict[str, dict[str, Any]]) -> None:
    assert len(rows) == len(ENCODINGS)
    assert all(row["nanoseconds"]["gl"] > 0.0 for row in rows.values())


def test_more_bits_of_a_direction_have_a_smaller_error(rows: dict[str, dict[str, Any]]) -> None:
    assert 0.2 < rows["octahedral 2 × 8, rounded"]["mean_error"] < 0.4
    assert rows["octahedral 2 × 16, best of 4"]["max_error"] < 0.0025


def test_reversed_depth_has_a_smaller_error_far_away(rows: dict[str, dict[str, Any]]) -> None:
    reversed_depth, standard = (
        rows[f"position by a ray, D32F{name}"]["max_error"] for name in (" reversed", "")
    )
    assert reversed_depth < 0.5 < 1000.0 < standard < 5000.0


def test_positions_in_the_image_are_nearer_by_a_ray_than_by_the_matrix_of_the_world(
    rows: dict[str, dict[str, Any]],
) -> None:
    assert rows["position by a ray, D32F reversed, in the image"]["max_error"] < 0.001
    assert rows["position by the world's matrix, in the image"]["max_error"] > 10.0


def test_the_chart_is_written(chart_and_rows: tuple[Path, dict[str, dict[str, Any]]]) -> None:
    assert chart_and_rows[0].stat().st_size > 0


def test_a_quaternion_has_nearer_tangents_than_32_bits_hold(rows: dict[str, dict[str, Any]]) -> None:
    """10 bits round a component by at most .00069 of a unit quaternion, which turns by at most .28 degrees."""
    by_square = rows["tangent by its way around a square"]
    for part in ("tangent", "normal"):
        quaternion = rows[f"quaternion 3 × 10, its {part} (McAuley)"]
        assert 0.02 < quaternion["mean_error"] < 0.5 * by_square["mean_error"]
        assert quaternion["max_error"] < 0.28


@pytest.mark.parametrize("largest", range(4))
def test_a_quaternion_restores_frames_whichever_component_is_the_largest(largest: int) -> None:
    """All components but one are small, so each branch is taken; the sign of a quaternion doesn't matter."""
    rng = np.random.default_rng(largest)
    quaternions = rng.uniform(-0.3, 0.3, (64, 4))
    quaternions[:, largest] = rng.choice([-1.0, 1.0], 64)
    values = np.zeros((64, 8))
    values[:, :3], values[:, 4:7] = (turn(quaternions, axis) for axis in ((0.0, 0.0, 1.0), (1.0, 0.0, 0.0)))
    values[:, 7] = rng.choice([-1.0, 1.0], 64)
    with open_device("gl") as device:
        decoded = run_round_trip(device, QuaternionFrame, values)
    assert normal_errors(values, decoded).max() < 0.28
    assert tangent_errors(values, decoded).max() < 0.28
    np.testing.assert_array_equal(decoded[:, 7], values[:, 7])


def turn(quaternions: NDArray[np.float64], axis: tuple[float, float, float]) -> NDArray[np.float64]:
    """The axis turned by quaternions (k, 4), of which the real part comes last: v + 2 w (u × v) + 2 u × (u × v)."""
    unit = quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)
    vectors = np.broadcast_to(axis, (len(unit), 3))
    across = np.cross(unit[:, :3], vectors)
    turned: NDArray[np.float64] = vectors + 2.0 * (unit[:, 3:] * across + np.cross(unit[:, :3], across))
    return turned
