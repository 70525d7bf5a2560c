"""The hard cases, one test each for each device. `renderer.lab.exam` has them, with their references and
tolerances."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from nightly_reasons import COVERED_ON_GL, FEWER_CASES

import rhi
from renderer.lab.exam import CASES, examine
from renderer.lab.exam.table import MEASURES
from tests.renderer.conftest import open_device


def list_exams() -> list[object]:
    """Each case on gl, cl and in the nightly run wgpu, and on the null device those that need nothing of a
    device."""
    return [
        pytest.param(name, number, marks=pytest.mark.nightly if case.is_long or name == "wgpu" else ())
        for name in ("gl", "cl", "wgpu", "null")
        for number, case in CASES.items()
        if name != "null" or not case.requires
    ]


@pytest.fixture(scope="module")
def examined(request: pytest.FixtureRequest) -> Iterator[rhi.Device]:
    with open_device(request.param) as device:
        yield device


@pytest.mark.nightly_cases(
    "cl-[2-9]",
    "cl-1[013456789]",
    "cl-2[01236]",
    "cl-3[357]",
    "cl-4[2-68]",
    "cl-5[12356-9]",
    "cl-6[3-9]",
    "cl-7[0-5]",
    "cl-80",
    reason=COVERED_ON_GL,
)
@pytest.mark.nightly_cases(
    "gl-2",
    "gl-3",
    "gl-4",
    "gl-5",
    "gl-9",
    "gl-15",
    "gl-20",
    "gl-33",
    "gl-51",
    "gl-59",
    "gl-69",
    "gl-7[12]",
    reason=FEWER_CASES,
)
@pytest.mark.parametrize(("examined", "number"), list_exams(), indirect=["examined"])
def test_a_device_passes_each_case_that_applies(examined: rhi.Device, number: int) -> None:
    (row,) = examine(examined, [CASES[number]])
    if row.passed is None:
        assert not getattr(examined.capabilities, row.remark.removeprefix("needs "))
        pytest.skip(f"this {row.backend} device {row.remark}")
    assert row.passed, row


def test_all_51_hard_cases_are_examined() -> None:
    assert set(range(1, 52)) <= CASES.keys() == MEASURES.keys()
    assert [number for number, case in CASES.items() if number != case.number] == []
    assert list(CASES) == sorted(CASES)
