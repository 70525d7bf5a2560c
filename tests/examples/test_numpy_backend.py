"""The example port passes the kit, but for what it declares missing."""

from __future__ import annotations

import re
import tomllib
import zipfile
from pathlib import Path

import pytest
from conformance_kit import take_the_kit
from nightly_reasons import CHEAPER_TEST

import rhi
from rhi.conformance.shaders import Count
from rhi.shading import uint
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
    project = tomllib.loads((PACKAGE / "pyproject.toml").read_text(encoding="utf-8"))
    assert project["project"]["entry-points"]["rhi.backends"] == {"numpy": FUNCTION}


def test_a_capability_that_the_numpy_backend_lacks_is_refused_by_name() -> None:
    with (
        rhi.create_device(FUNCTION) as device,
        pytest.raises(rhi.ValidationError, match=r"^\[device-capability\]"),
    ):
        device.occlusion_query()


@pytest.mark.nightly_cases(reason=CHEAPER_TEST)
@pytest.mark.slow
def test_it_passes_every_group_that_it_declares() -> None:
    status, output = take_the_kit(FUNCTION, PACKAGE, "rhi.conformance")
    assert status == 0, output
    board = output.partition(f"rhi conformance: {FUNCTION}")[2]  # what runs on no backend stands before it
    rows = {
        name: int(passed)
        for name, passed in re.findall(r"^ \d (\w+ · [\w ]+?) +(\d+) passed", board, re.MULTILINE)
    }
    assert all(rows[group] > 10 for group in PASSES), output
    assert rows["validation · refusals"] > 5, output
    assert rows["validation · capabilities"] > 5, output
    reasons = re.findall(r"^ +\d+ × numpy declares (?:no )?(\w+)", output, re.MULTILINE)
    assert {"draws", "occlusion_queries"} <= set(reasons)
    assert "compute" not in reasons


def test_a_trace_brings_no_python_to_run(tmp_path: Path) -> None:
    """A kernel for NumPy is code of this process: it comes from a shader class, never from a file."""
    with rhi.create_device("null") as device:
        device.dispatch(device.program(Count), 1, total=device.storage(uint, 1))
        save(device, tmp_path / "t.zip")
    (creation,) = load(tmp_path / "t.zip").stream.filter(rhi.Op.CREATE_PROGRAM)
    with zipfile.ZipFile(tmp_path / "t.zip", "a") as file:
        assert not [name for name in file.namelist() if name.endswith("numpy")]
        file.writestr(f"programs/{creation['program']}.compute.numpy", "raise SystemExit")
    with rhi.create_device(FUNCTION) as device, pytest.raises(rhi.ShaderError) as caught:
        replay(load(tmp_path / "t.zip", trusted=True), on=device)
    assert caught.value.rule.id == "trace-source"
