"""The hard cases, one test each for each device. `renderer.exam` has them, with their references and tolerances."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

import rhi
from renderer.exam import CASES, examine

APPLIES = ("gl", "cl")
"""The backends that are examined in all cases. The null device takes those that need no device."""


@pytest.fixture(scope="module", params=[*APPLIES, "null"])
def examined(request: pytest.FixtureRequest) -> Iterator[rhi.Device]:
    try:
        device = rhi.create_device(request.param)
    except rhi.DeviceError as error:
        pytest.skip(f"no {request.param} device here: {error.given or error.rule.sentence}")
    with device:
        yield device


@pytest.mark.parametrize(
    "number",
    [pytest.param(number, marks=pytest.mark.nightly if case.is_long else ()) for number, case in CASES.items()],
)
def test_a_device_passes_each_case_that_applies(examined: rhi.Device, number: int) -> None:
    case = CASES[number]
    (row,) = examine(examined, [case])
    if row.passed is None:
        assert examined.backend_name == "null" or not getattr(examined.capabilities, row.remark.removeprefix("needs "))
        return
    assert row.passed, row


def test_every_known_hard_case_is_examined() -> None:
    assert set(range(1, 37)) <= CASES.keys()
    assert [number for number, case in CASES.items() if number != case.number] == []
    assert list(CASES) == sorted(CASES)
