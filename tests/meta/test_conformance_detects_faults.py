"""The kit can fail: each fault of a backend is seen by the group that should see it."""

from __future__ import annotations

import json
import subprocess
import sys

import faulty_backends
import pytest


@pytest.mark.nightly
def test_each_fault_of_a_backend_is_detected_and_a_backend_without_passes() -> None:
    """In one process of its own: this one may hold devices."""
    run = subprocess.run(
        [sys.executable, faulty_backends.__file__],
        capture_output=True,
        text=True,
        check=False,
        encoding="utf-8",
    )
    assert run.returncode == 0, run.stderr
    failures: dict[str, list[str]] = json.loads(run.stdout)
    assert failures.pop(faulty_backends.CONTROL) == []
    assert failures.keys() == faulty_backends.FAULTS.keys()
    assert [fault for fault, failed in failures.items() if not failed] == []
