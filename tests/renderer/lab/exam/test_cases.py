"""The hard cases, one test each for each device. `renderer.lab.exam` has them, with their references and tolerances."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

import rhi
from renderer.lab.exam import CASES, examine
from renderer.lab.exam.table import MEASURES
from tests.renderer.conftest import open_device


def list_exams() -> list[object]:
    """Each case on gl, cl and by night wgpu, and on the null device those that need nothing of a device."""
    return [
        pytest.param(name, number, marks=pytest.mark.nightly if case.is_long or name == "wgpu" else ())
        for name in ("gl", "cl", "wgpu", "null")
        for number, case in CASES.items()
        if name != "null" or not case.needs
    ]


@pytest.fixture(scope="module")
def examined(request: pytest.FixtureRequest) -> Iterator[rhi.Device]:
    with open_device(request.param) as device:
        yield device


@pytest.mark.parametrize(("examined", "number"), list_exams(), indirect=["examined"])
def test_a_device_passes_each_case_that_applies(examined: rhi.Device, number: int) -> None:
    (row,) = examine(examined, [CASES[number]])
    if row.passed is None:
        assert not getattr(examined.capabilities, row.remark.removeprefix("needs "))
        pytest.skip(f"this {row.backend} device {row.remark}")
    assert row.passed, row


def test_every_known_hard_case_is_examined() -> None:
    assert set(range(1, 52)) <= CASES.keys() == MEASURES.keys()
    assert [number for number, case in CASES.items() if number != case.number] == []
    assert list(CASES) == sorted(CASES)
