"""`effect-costs` on the command line: counts, times, and the page."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from renderer.cli import main
from renderer.lab.effect_costs import EFFECT_STEPS


def test_counts_of_selected_effects_are_printed_as_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["effect-costs", "--effect", "sun", "--json"]) == 0
    (row,) = json.loads(capsys.readouterr().out)
    assert row["name"] == "sun"
    assert row["added"]["bindings"] == 1
    assert row["leftovers"]["differences"] == row["leftovers"]["calls"] == 0


def test_times_are_measured_on_each_backend_that_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["effect-costs", "--effect", "sun", "--backend", "null", "--rounds", "2", "--markdown"]) == 0
    added, removed = capsys.readouterr().out.strip().split("\n\n")
    assert added.splitlines()[0].endswith("ms on null |")
    assert len(added.splitlines()) == len(removed.splitlines()) == 3
    assert removed.splitlines()[0].endswith("time on null |")


@pytest.mark.usefixtures("gl")
def test_the_page_has_the_tables_and_the_image(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["effect-costs", "--effect", "box", "--rounds", "2", "--output", str(tmp_path)]) == 0
    table = capsys.readouterr().out
    page = (tmp_path / "effect-costs.md").read_text(encoding="utf-8")
    assert "| box | a box on a ground |" in page
    assert "a box on a ground" in table
    assert "python -m renderer effect-costs --effect box --rounds 2 --output docs" in page
    assert "% of a frame of the box on null" in page
    assert (tmp_path / "images" / "effect-costs.webp").stat().st_size > 1000


def test_every_effect_can_be_named() -> None:
    assert len({step.name for step in EFFECT_STEPS}) == len(EFFECT_STEPS)
