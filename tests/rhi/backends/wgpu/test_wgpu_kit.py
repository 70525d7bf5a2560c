"""The conformance kit on wgpu: by day the groups that prove most for their time, all of it at night."""

from __future__ import annotations

import os
import re
import subprocess
import sys

import pytest

BY_DAY = ("buffers", "textures", "compute", "depth", "stencil", "blending", "targets", "sampling", "queries")
"""Groups of operations that take a sixth of the time of all, and find what most changes break."""


def run(*tests: str, profile: str = "native") -> int:
    """Run tests of the kit on wgpu, of which none may fail; return how many pass."""
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--tb=short", "--pyargs", *tests]
    done = subprocess.run(
        [*command, "--rhi-backend", "wgpu"], capture_output=True, text=True, check=False,
        env={**os.environ, "RHI_WGPU_PROFILE": profile},
    )  # fmt: skip
    totals = re.findall(r"total +(\d+) passed +(\d+) failed", done.stdout)  # of tests of any backend, and of wgpu's
    assert totals, done.stdout + done.stderr
    assert all(failed == "0" for _, failed in totals), done.stdout
    return sum(int(passed) for passed, _ in totals)


def test_the_groups_of_the_day_pass(usable: None) -> None:
    assert run(*(f"rhi.conformance.operation.test_{group}" for group in BY_DAY)) > 800


@pytest.mark.nightly
@pytest.mark.parametrize(("profile", "least"), [("native", 2400), ("core", 2200)])
def test_the_kit_passes(usable: None, profile: str, least: int) -> None:
    assert run("rhi.conformance", profile=profile) > least
