"""The gate: a backend without any one method of the contract fails the kit."""

from __future__ import annotations

import json
import subprocess
import sys

import incomplete_backends
import pytest

import rhi
from rhi.conformance.port_steps import STEPS, step_of


def test_every_method_of_the_contract_has_a_group_or_a_reason() -> None:
    methods = {name for name in vars(rhi.Backend) if not name.startswith("_")}
    assert incomplete_backends.GROUPS.keys() | incomplete_backends.UNDETECTABLE.keys() == methods
    assert not incomplete_backends.GROUPS.keys() & incomplete_backends.UNDETECTABLE.keys()


def test_no_method_is_written_after_the_group_that_must_see_it() -> None:
    written = {method: number for number, step in enumerate(STEPS, 1) for method in step.methods}
    for method, group in incomplete_backends.GROUPS.items():
        assert written[method] <= step_of(f"operation · {group}"), method


@pytest.mark.nightly
def test_a_backend_without_any_one_method_fails() -> None:
    """In one process of its own: this one may hold devices."""
    try:
        rhi.create_device("gl").close()
    except rhi.DeviceError as error:
        pytest.skip(f"no GL device here: {error.given or error.rule.sentence}")
    run = subprocess.run(
        [sys.executable, incomplete_backends.__file__],
        capture_output=True,
        text=True,
        check=False,
        encoding="utf-8",
    )
    assert run.returncode == 0, run.stderr
    failures: dict[str, list[str]] = json.loads(run.stdout)
    assert failures.pop(incomplete_backends.LATE) == []
    assert failures.keys() == incomplete_backends.GROUPS.keys()
    assert [method for method, failed in failures.items() if not failed] == []
