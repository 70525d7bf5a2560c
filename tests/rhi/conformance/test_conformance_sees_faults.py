"""The kit can fail: each fault of a backend is seen by the group that should see it."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import faulty_backends
import pytest


@pytest.fixture(scope="module")
def failures() -> dict[str, list[str]]:
    """Failed tests by fault, from a process of its own: this one may hold devices."""
    run = subprocess.run(
        [sys.executable, Path(faulty_backends.__file__)], capture_output=True, text=True, check=False
    )
    assert run.returncode == 0, run.stderr
    found: dict[str, list[str]] = json.loads(run.stdout)
    return found


@pytest.mark.slow
@pytest.mark.parametrize("fault", list(faulty_backends.FAULTS))
def test_a_fault_of_a_backend_is_seen(failures: dict[str, list[str]], fault: str) -> None:
    assert failures[fault]


@pytest.mark.slow
def test_a_backend_without_faults_passes(failures: dict[str, list[str]]) -> None:
    assert failures[faulty_backends.CONTROL] == []
