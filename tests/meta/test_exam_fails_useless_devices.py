"""A device that draws nothing, or tells nothing of what it has drawn, fails the exam wherever that draws."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest
import useless_devices

from renderer.lab.exam import select_cases
from renderer.lab.exam.case import COMPUTES, DRAWS, NOTHING


@pytest.mark.nightly
def test_useless_devices_pass_the_cases_that_do_not_depend_on_their_fault() -> None:
    run = subprocess.run(
        [sys.executable, useless_devices.__file__],
        capture_output=True,
        text=True,
        check=True,
        encoding="utf-8",
    )
    passed_by_device = json.loads(run.stdout)
    control = passed_by_device.pop("none of these faults")
    cases = {
        asked: [case.number for case in select_cases([]) if case.device_use == asked]
        for asked in (DRAWS, COMPUTES, NOTHING)
    }
    assert control == cases
    assert passed_by_device.pop("its draws do nothing") == {**cases, DRAWS: []}
    assert len(passed_by_device) == 4
    for passed in passed_by_device.values():
        assert passed == {DRAWS: [], COMPUTES: [], NOTHING: cases[NOTHING]}


def test_a_mute_device_fails_a_comparison_of_images() -> None:
    """One case in the default run: the mute device draws the same nothing with culling and without."""
    from faulty_backends import Faulty, replace_gl

    import rhi
    from renderer.lab.exam import examine
    from renderer.visibility.software_depth import can_rasterise

    for device, passes in ((useless_devices.Mute, False), (Faulty, True)):
        can_rasterise.cache_clear()  # there is no cl now, and was before
        try:
            with replace_gl(device), rhi.create_device("gl") as opened:
                (row,) = examine(opened, select_cases([11]))
        finally:
            can_rasterise.cache_clear()
        assert row.passed is passes
        assert row.error == 0.0
