"""The conformance kit on wgpu: by day the groups that prove most for their time, all of it at night."""

from __future__ import annotations

import os
import re
import subprocess
import sys

import pytest

BY_DAY = (
    "buffers", "textures", "time", "compute", "orientation", "draw_times", "transient", "depth", "stencil", "blending",
    "targets", "clears", "sampling", "queries", "query_sets", "interplay", "command_buffers",
)  # fmt: skip
"""Groups of operations that take a third of the time of all, and find what most changes break."""


def run(*tests: str) -> tuple[int, int]:
    """Return how many tests of the kit pass and fail on wgpu."""
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--tb=short", "--pyargs", *tests]
    done = subprocess.run(
        [*command, "--rhi-backend", "wgpu"], capture_output=True, text=True, check=False,
        env={**os.environ, "RHI_KERNELS": "quick"},
    )  # fmt: skip
    found = re.search(r"total +(\d+) passed +(\d+) failed", done.stdout)
    assert found is not None, done.stdout + done.stderr
    assert found[2] == "0", done.stdout
    return int(found[1]), int(found[2])


def test_the_groups_of_the_day_pass(usable: None) -> None:
    passed, failed = run(*(f"rhi.conformance.operation.test_{group}" for group in BY_DAY))
    assert passed > 800
    assert not failed


@pytest.mark.nightly
def test_the_kit_passes(usable: None) -> None:
    passed, failed = run("rhi.conformance")
    assert passed > 2200
    assert not failed
