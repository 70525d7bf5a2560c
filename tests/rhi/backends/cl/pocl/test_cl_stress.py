"""A minute of processes that share a far too small folder of compiled kernels; some are killed."""

from __future__ import annotations

from pathlib import Path

import pytest
from cl_stress import Result, count_end, run_stress
from nights import rotate_seed


@pytest.mark.nightly
def test_no_process_dies_or_draws_wrong_pixels(tmp_path: Path) -> None:
    result = run_stress(tmp_path, 60.0, seed=rotate_seed(1))
    assert result.deaths == []
    assert result.counts["wrong"] == 0
    assert result.counts["uncached"] == 0
    assert result.counts["frames"] > 0
    assert result.ends["0"] > 0


def test_a_process_that_dies_is_counted_and_one_that_is_killed_on_purpose_is_not(tmp_path: Path) -> None:
    log = tmp_path / "1.log"
    log.write_text("Generic WG function binary does not exist", encoding="utf-8")
    result = Result()
    for status, was_due in ((-6, False), (-6, True), (-9, False), (-9, True)):
        count_end(result, status, was_due, log)
    assert len(result.deaths) == 3
    assert result.ends == {"-6": 2, "-9": 1, "killed": 1}
    log.write_text("frames=7 wrong=2", encoding="utf-8")
    count_end(result, 0, False, log)
    assert result.counts == {"frames": 7, "wrong": 2}
