"""Rows of the exam: what passes, what fails, and what doesn't apply."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from refusals import refused_rule

import rhi
from renderer.cli import main
from renderer.cli.exam import format_rows_by_backend
from renderer.lab.exam import (
    CASES,
    Case,
    CaseResult,
    ExamRow,
    examine,
    select_cases,
    stop_at_first_failure,
)
from renderer.lab.exam.case import check_early
from renderer.lab.exam.case_images import errors_to_image, join_images

CASE = Case(7, "a thing", "another", 0.5, "metres", "reason", lambda _: CaseResult(0.25))


def run(null: rhi.Device, *cases: Case) -> list[ExamRow]:
    return list(examine(null, cases))


@pytest.mark.parametrize(("error", "passed"), [(0.0, True), (0.5, True), (0.5001, False), (np.inf, False)])
def test_a_case_passes_up_to_its_tolerance(null: rhi.Device, error: float, passed: bool) -> None:
    (row,) = run(null, replace(CASE, measure=lambda _: CaseResult(error)))
    assert (row.error, row.passed, row.remark) == (error, passed, "")


def test_an_error_that_is_no_number_fails(null: rhi.Device) -> None:
    (row,) = run(null, replace(CASE, measure=lambda _: CaseResult(np.nan)))
    assert row.passed is False
    assert json.loads(json.dumps(row.as_record(), allow_nan=False))["error"] == "nan"


def test_a_condition_that_fails_is_named_in_the_remark(null: rhi.Device) -> None:
    holds = {"it rains": True, "it snows": False}
    (row,) = run(null, replace(CASE, measure=lambda _: CaseResult(0.0, holds=holds)))
    assert row.passed is False
    assert row.remark == "not: it snows"


def test_a_case_that_a_device_lacks_something_for_does_not_apply(null: rhi.Device) -> None:
    def fail(_: rhi.Device) -> CaseResult:
        raise AssertionError("not to be measured")

    (row,) = run(null, replace(CASE, requires=("compute", "shading"), measure=fail))
    assert (row.error, row.passed, row.remark) == (None, None, "needs shading")
    (row,) = run(null, replace(CASE, requires=("compute",)))
    assert row.passed


def test_a_case_may_end_at_the_first_condition_that_does_not_hold(null: rhi.Device) -> None:
    measured: list[bool] = []

    def measure(is_seen: bool) -> CaseResult:
        holds = {"something is seen": is_seen}
        check_early(holds)
        measured.append(is_seen)
        return CaseResult(0.0, holds=holds)

    blind, seeing = (
        replace(CASE, measure=lambda _, is_seen=is_seen: measure(is_seen)) for is_seen in (False, True)
    )
    with stop_at_first_failure():
        failed, passed = run(null, blind, seeing)
    assert (failed.passed, failed.remark) == (False, "FirstFailureError: something is seen")
    assert passed.passed
    assert measured == [True]
    assert run(null, blind)[0].remark == "not: something is seen", "control: measured to its end"


def test_a_case_that_raises_has_failed_and_the_next_one_follows(null: rhi.Device) -> None:
    def fail(_: rhi.Device) -> CaseResult:
        raise ZeroDivisionError("by nothing\nat all")

    first, second = run(null, replace(CASE, measure=fail), CASE)
    assert (first.error, first.passed, first.remark) == (None, False, "ZeroDivisionError: by nothing")
    assert second.passed


def test_every_requirement_is_a_boolean_capability(null: rhi.Device) -> None:
    for case in CASES.values():
        assert all(isinstance(getattr(null.capabilities, name), bool) for name in case.requires), case.number


def test_every_case_states_its_subject_and_the_reason_of_its_tolerance() -> None:
    for case in CASES.values():
        assert all(
            text and not text.endswith(".")
            for text in (case.description, case.reference, case.unit, case.why)
        )
        assert case.tolerance >= 0.0
    assert len({case.description for case in CASES.values()}) == len(CASES)


def test_long_cases_are_left_out_unless_they_are_asked_for() -> None:
    named = [number for number, case in CASES.items() if case.is_long][:1]
    assert not any(case.is_long for case in select_cases([]))
    assert [case.number for case in select_cases(named, are_long=False)] == named or not named
    assert len(select_cases([], are_long=True)) == len(CASES)


def test_a_port_is_examined_in_the_capabilities_that_it_declares(monkeypatch: pytest.MonkeyPatch) -> None:
    """The port of the examples, which computes on NumPy and doesn't draw, is named by its function."""
    monkeypatch.syspath_prepend(str(Path(__file__).parents[4] / "examples" / "numpy_backend"))
    with rhi.create_device("rhi_numpy:create_backend") as port:
        rows = {row.case: row for row in examine(port, select_cases([27, 31, 32, 36, 41, 42]))}
    assert [number for number, row in rows.items() if not row.passed] == [42]
    assert (rows[42].passed, rows[42].remark) == (None, "needs renders")


def test_an_unknown_case_is_refused() -> None:
    assert refused_rule(lambda: select_cases([1, 4711])) == "exam-unknown-case"


def test_the_table_has_a_column_for_each_backend_and_counts(null: rhi.Device) -> None:
    computes = replace(CASE, requires=("compute",))
    rows = run(
        null,
        computes,
        replace(CASE, number=8, requires=("shading",)),
        replace(computes, number=9, tolerance=0.1),
    )
    alone = run(null, replace(CASE, number=10))
    text = format_rows_by_backend([*rows, *alone, replace(rows[0], backend="other")])
    counts = "null: 1 of 2 passed, 1 not applicable; other: 1 of 1 passed, 0 not applicable"
    assert f"{counts}; that ask nothing of a device: 1 of 1 passed" in text
    assert "needs shading" in text
    assert "FAILED: 0.25" in text


def test_the_command_prints_rows_and_shows_a_case(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["exam", "--backend", "null", "--case", "1", "--case", "2", "--json"]) == 0
    first, second = json.loads(capsys.readouterr().out)
    assert (first["case"], first["backend"], first["error"], first["passed"]) == (1, "null", 0.0, True)
    assert (second["passed"], second["remark"]) == (None, "needs renders")
    assert main(["exam", "--backend", "null", "--show", "12"]) == 0
    assert "ring of 3: 0" in capsys.readouterr().out


def test_the_command_fails_where_a_case_does(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(CASES, 1, replace(CASES[1], tolerance=-1.0))
    with pytest.raises(SystemExit) as left:
        main(["exam", "--backend", "null", "--case", "1"])
    assert left.value.code == 1
    assert "FAILED" in capsys.readouterr().out


def test_images_stand_side_by_side_and_errors_are_bright() -> None:
    errors = np.array([[0.0, 1.0], [np.nan, 0.216]])
    image = errors_to_image(errors)
    assert image[..., 0].tolist() == [[0, 255], [255, 153]]
    assert image[1, 0].tolist() == [255, 0, 0, 255]
    frame = np.zeros((10, 20, 4), np.uint8)
    joined = join_images({"errors": errors, "frame": frame})
    assert joined.shape == (260, 256 + 4 + 520, 4)
