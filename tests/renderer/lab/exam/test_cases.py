"""The hard cases, one test each for each device. `renderer.lab.exam` has them, with their references and tolerances."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

import rhi
from renderer.lab.exam import CASES, examine

LATE = (2, 4, 5, 8, 9, 15, 20, 22, 42, 43, 48, 57, 63, 64, 68, 69, 70, 71, 72, 74, 75)
BUSY = {("cl", number) for number in LATE}
"""Cases that take a backend seconds: walks with all algorithms of visibility, and kernels of shadows and of culling at
other sizes. By day they run on gl, and on cl `tests/renderer/visibility` draws walks (`test_device_culling.py`,
`test_software_depth.py`) and random scenes (`test_hard_cases.py`) with these algorithms, and
`tests/renderer/techniques/test_technique_pixels.py` compares the techniques of tiles and clusters under all lenses. Far
places are subtracted by NumPy (57), spheres are tested by `test_sphere_tests.py` on cl too (22), materials are found by
`test_deferred_plus.py` (42), what is asked seldom or with a threshold is the CPU's choice (8, 9), clipping at near
planes is the kit's (2), `test_culled_images.py` draws images of odd sizes (64), and
the judge's pictures are those of gl (69 to 75)."""


def list_exams() -> list[object]:
    """Each case on gl and cl, and on the null device those that need nothing of a device."""
    pairs = [(name, number) for name in ("gl", "cl", "null") for number in CASES]
    nightly = [pair in BUSY or CASES[pair[1]].is_long for pair in pairs]
    return [
        pytest.param(*pair, marks=pytest.mark.nightly if late else ())
        for pair, late in zip(pairs, nightly, strict=True)
        if pair[0] != "null" or not CASES[pair[1]].needs
    ]


@pytest.fixture(scope="module")
def examined(request: pytest.FixtureRequest) -> Iterator[rhi.Device]:
    try:
        device = rhi.create_device(request.param)
    except rhi.DeviceError as error:
        pytest.skip(f"no {request.param} device here: {error.given or error.rule.sentence}")
    with device:
        yield device


@pytest.mark.parametrize(("examined", "number"), list_exams(), indirect=["examined"])
def test_a_device_passes_each_case_that_applies(examined: rhi.Device, number: int) -> None:
    (row,) = examine(examined, [CASES[number]])
    if row.passed is None:
        assert not getattr(examined.capabilities, row.remark.removeprefix("needs "))
        pytest.skip(f"this {row.backend} device {row.remark}")
    assert row.passed, row


def test_every_known_hard_case_is_examined() -> None:
    assert set(range(1, 52)) <= CASES.keys()
    assert [number for number, case in CASES.items() if number != case.number] == []
    assert list(CASES) == sorted(CASES)
