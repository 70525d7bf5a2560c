"""Mutated traces end no process, leak no exception but those of this package, and don't hang.

A process of its own loads, shows and replays each, with the shaders of the file trusted: what remains is then
only the checks of its commands. On a device that runs shaders the programs stay as they are, since their text
is code.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest
import trace_fuzz
from nightly_reasons import CHEAPER_TEST
from nights import rotate_seed
from testing_kit import backend_works
from trace_kit import record, record_draws

import rhi

SECONDS = 240.0  # the slowest, 101589 on cl, took 51 by itself
"""How long a mutation may take on a busy machine."""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    record(tmp_path / "much.zip")
    record_draws(tmp_path / "draws.zip")
    return tmp_path


def count_results(backend: str, seed: int, count: int, folder: Path, seconds: float) -> Counter[str]:
    """Try mutations in a process of their own; fail with the seed at which it died, hung or leaked."""
    command = [sys.executable, trace_fuzz.__file__, backend, str(seed), str(count), str(folder)]
    path = os.pathsep.join([str(Path(rhi.__file__).parents[1]), *sys.path])
    done = subprocess.run(
        command,
        capture_output=True,
        text=True,
        timeout=seconds,
        check=False,
        env=os.environ | {"PYTHONPATH": path, "RHI_KERNELS": "quick"},
        encoding="utf-8",
    )
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    assert done.returncode == 0, f"{backend}: died at {lines[-1:]}: {done.stderr[-500:]}"
    results = [line for line in lines if line[0] != "begin"]
    assert len(results) == count
    leaks = [line for line in results if line[0].split()[0] not in ("refused", "replayed")]
    assert not leaks
    slow = [line for line in results if line[2] > SECONDS]
    assert not slow
    return Counter(line[0].split()[0] for line in results)


def test_mutations_reach_the_code_behind_the_first_checks(folder: Path) -> None:
    """A control: enough of them still replay, and those that don't are refused for several reasons."""
    results = trace_fuzz.run("null", 0, 150, folder)
    assert results["replayed"] >= 10
    assert len([result for result in results if result.startswith("refused")]) >= 4


@pytest.mark.nightly_cases("cl", reason=CHEAPER_TEST)
@pytest.mark.parametrize("backend", ["gl", "cl"])
def test_mutated_traces_are_refused_or_replayed(folder: Path, backend: str) -> None:
    if not backend_works(backend):
        pytest.skip(f"no {backend} device here")
    results = count_results(backend, 0, 60, folder, 300.0)
    assert results["replayed"] >= 3


@pytest.mark.nightly
@pytest.mark.parametrize("backend", ["null", "gl", "cl"])
def test_many_mutated_traces_are_refused_or_replayed(folder: Path, backend: str) -> None:
    """Other mutations each night."""
    if not backend_works(backend):
        pytest.skip(f"no {backend} device here")
    results = count_results(backend, rotate_seed(100_000), 2500, folder, 1800.0)
    assert results["replayed"] >= 50
