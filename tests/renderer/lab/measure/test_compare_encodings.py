"""`compare encodings`: its rows, and the chart."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import rhi
from renderer.cli import main
from renderer.lab.measure.encoding_errors import ENCODINGS


def test_rows_have_the_errors_and_times_of_each_encoding(
    gl: rhi.Device, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    chart = tmp_path / "chart.svg"
    arguments = ["--backend", "gl", "--count", "256", "--rounds", "1", "--json", "--plot", str(chart)]
    assert main(["compare", "encodings", *arguments]) == 0
    report = json.loads(capsys.readouterr().out)
    rows = {row["name"]: row for row in report["rows"]}
    assert len(rows) == len(ENCODINGS)
    assert 0.2 < rows["octahedral 2 × 8, rounded"]["mean_error"] < 0.4
    assert rows["octahedral 2 × 16, best of 4"]["max_error"] < 0.0025
    reversed_depth, standard = (
        rows[f"position by a ray, D32F{name}"]["max_error"] for name in (" reversed", "")
    )
    assert reversed_depth < 0.5 < 1000.0 < standard < 5000.0
    assert rows["position by a ray, D32F reversed, in the image"]["max_error"] < 0.001
    assert rows["position by the world's matrix, in the image"]["max_error"] > 10.0
    assert all(row["nanoseconds"]["gl"] > 0.0 for row in rows.values())
    assert chart.stat().st_size > 0
