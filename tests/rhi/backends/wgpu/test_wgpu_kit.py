"""The conformance kit on wgpu: some fast groups in the default run, all groups in the nightly run."""

from __future__ import annotations

import os
import re
import subprocess
import sys

import pytest

DEFAULT_GROUPS = (
    "buffers",
    "textures",
    "compute",
    "depth",
    "stencil",
    "blending",
    "targets",
    "sampling",
    "queries",
)
"""Groups of operations that take a sixth of the whole kit's time, and find most faults."""


def run(*tests: str, profile: str = "native") -> int:
    """Run tests of the kit on wgpu, assert that none fails, and return the number of those that pass."""
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-p",
        "no:cacheprovider",
        "--tb=short",
        "--pyargs",
        *tests,
    ]
    done = subprocess.run(
        [*command, "--rhi-backend", "wgpu"],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "RHI_WGPU_PROFILE": profile},
        encoding="utf-8",
    )
    totals = re.findall(
        r"total +(\d+) passed +(\d+) failed", done.stdout
    )  # of tests of any backend, and of wgpu's
    assert totals, done.stdout + done.stderr
    assert all(failed == "0" for _, failed in totals), done.stdout
    return sum(int(passed) for passed, _ in totals)


def test_the_default_groups_pass(usable: None) -> None:
    assert run(*(f"rhi.conformance.operation.test_{group}" for group in DEFAULT_GROUPS)) > 800


@pytest.mark.nightly
@pytest.mark.parametrize(("profile", "min_passed"), [("native", 2400), ("core", 2200)])
def test_the_kit_passes(usable: None, profile: str, min_passed: int) -> None:
    assert run("rhi.conformance", profile=profile) > min_passed
