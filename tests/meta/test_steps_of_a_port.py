"""The road of a port can be walked in its order: no step needs a later one."""

from __future__ import annotations

import re
from pathlib import Path

import partial_backends
import pytest
from conformance_kit import take_the_kit

import rhi
from rhi.conformance.port_steps import STEPS


def run_step(number: int, written: int) -> tuple[int, str]:
    """Run the groups of a step on a port that has been written up to another one; return exit status and
    output."""
    modules = [
        "rhi.conformance." + group.replace(" · ", ".test_").replace(" ", "_")
        for group in STEPS[number - 1].groups
    ]
    folder = Path(partial_backends.__file__).parent
    return take_the_kit(
        "partial_backends:create_backend", folder, *modules, **{partial_backends.STEP: str(written)}
    )


@pytest.fixture(autouse=True)
def gl() -> None:
    try:
        rhi.create_device("gl").close()
    except rhi.DeviceError as error:
        pytest.skip(f"no GL device here: {error.given or error.rule.sentence}")


@pytest.mark.nightly
@pytest.mark.parametrize("number", range(1, len(STEPS) + 1))
def test_a_step_passes_with_the_methods_of_it_and_those_before(number: int) -> None:
    status, output = run_step(number, number)
    assert status == 0, output
    assert re.search(r"total +[1-9]\d* passed +0 failed", output), output


@pytest.mark.nightly
@pytest.mark.parametrize("number", range(1, len(STEPS)))
def test_a_step_fails_without_its_own_methods(number: int) -> None:
    status, output = run_step(number, number - 1)
    assert status == 1, output
    assert f"next: step {number}, {STEPS[number - 1].title} (python -m rhi docs porting)" in output, output
