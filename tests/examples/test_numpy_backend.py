"""The example port passes the kit, but for what it declares missing."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import numpy as np
import pytest

import rhi
from rhi.shading import Shader, StorageRW, Struct, Uniform, barrier, global_id, local_index, shared
from rhi.trace import load, replay, save

PACKAGE = Path(__file__).parents[2] / "examples" / "numpy_backend"
FUNCTION = "rhi_numpy:create_backend"
PASSES = (
    "operation · buffers",
    "operation · textures",
    "operation · time",
    "operation · compute",
    "operation · language",
)


@pytest.fixture(autouse=True)
def on_the_path(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(PACKAGE))


def test_its_entry_point_is_the_function() -> None:
    project = tomllib.loads((PACKAGE / "pyproject.toml").read_text())
    assert project["project"]["entry-points"]["rhi.backends"] == {"numpy": FUNCTION}


class Scale(Struct):
    factor: float


class PrefixSum(Shader):
    """The sums up to each number, times a factor: shared memory and barriers."""

    work_group = (8,)
    scale: Uniform[Scale]
    numbers: StorageRW[float]
    sums = shared(float, 8)

    def compute(self) -> None:
        i = local_index()
        self.sums[i] = self.numbers[global_id().x]
        barrier()
        total = 0.0
        for j in range(8):
            if j <= i:
                total += self.sums[j]
        self.numbers[global_id().x] = total * self.scale.factor


def test_a_dispatch_computes_what_numpy_does() -> None:
    numbers = np.arange(24, dtype=np.float32)
    with rhi.create_device(FUNCTION) as device:
        scale, rows = device.uniform(Scale(factor=2.0)), device.storage(float, numbers)
        device.dispatch(device.program(PrefixSum), 3, scale=scale, numbers=rows)
        assert rows.read().tolist() == (2 * numbers.reshape(3, 8).cumsum(axis=1)).reshape(-1).tolist()


def test_what_it_lacks_is_refused_by_name() -> None:
    with rhi.create_device(FUNCTION) as device, pytest.raises(rhi.ValidationError, match=r"^\[device-capability\]"):
        device.occlusion_query()


@pytest.mark.slow
def test_it_passes_every_group_that_it_declares() -> None:
    run = subprocess.run(
        [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-q", "--color=no", "--tb=short",
         "--rhi-backend", FUNCTION, "--pyargs", "rhi.conformance"],
        capture_output=True, text=True, check=False, cwd=PACKAGE, env=os.environ | {"PYTHONPATH": str(PACKAGE)},
    )  # fmt: skip
    assert run.returncode == 0, run.stdout
    board = run.stdout.partition(f"rhi conformance: {FUNCTION}")[2]  # what runs on no backend stands before it
    rows = {
        name: int(passed) for name, passed in re.findall(r"^ \d (\w+ · [\w ]+?) +(\d+) passed", board, re.MULTILINE)
    }
    assert all(rows[group] > 10 for group in PASSES), run.stdout
    assert rows["validation · refusals"] > 5, run.stdout
    assert rows["validation · capabilities"] > 5, run.stdout
    reasons = re.findall(r"^ +\d+ × numpy declares (?:no )?(\w+)", run.stdout, re.MULTILINE)
    assert {"draws", "occlusion_queries"} <= set(reasons)
    assert "compute" not in reasons


def test_a_trace_brings_no_python_to_run(tmp_path: Path) -> None:
    """A kernel for NumPy is code of this process: it comes from a shader class, never from a file."""
    with rhi.create_device("null") as device:
        numbers = device.storage(float, 8)
        device.dispatch(device.program(PrefixSum), 1, scale=device.uniform(Scale(factor=1.0)), numbers=numbers)
        save(device, tmp_path / "t.zip")
    (creation,) = load(tmp_path / "t.zip").stream.filter(rhi.Op.CREATE_PROGRAM)
    with zipfile.ZipFile(tmp_path / "t.zip", "a") as file:
        assert not [name for name in file.namelist() if name.endswith("numpy")]
        file.writestr(f"programs/{creation['program']}.compute.numpy", "raise SystemExit")
    with rhi.create_device(FUNCTION) as device, pytest.raises(rhi.ShaderError) as caught:
        replay(load(tmp_path / "t.zip", trusted=True), on=device)
    assert caught.value.rule.id == "trace-source"
