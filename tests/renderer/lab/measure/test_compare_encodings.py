"""`compare encodings`: its rows, and the chart."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from command_reports import read_report

from renderer.lab.measure.encoding_errors import ENCODINGS
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
