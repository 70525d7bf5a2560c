"""The machine beside results: its parts, and where reports name it."""

from __future__ import annotations

import json
import platform
from pathlib import Path

import pytest

from renderer.cli import main
from renderer.lab.measure.machine import Machine, _read_model, describe_machine


def test_a_machine_names_its_parts() -> None:
    machine = describe_machine()
    assert machine.cores >= 1
    assert machine.memory_gib is None or 0.1 < machine.memory_gib < 1e6
    assert machine.python.split()[1] == platform.python_version()
    assert str(machine).startswith(machine.processor)


@pytest.mark.parametrize(
    ("cores", "memory", "text"),
    [
        (1, None, "Fast CPU, 1 core, Linux 6, CPython 3.11"),
        (2, 23.6, "Fast CPU, 2 cores, 24 GiB, Linux 6, CPython 3.11"),
    ],
)
def test_a_machine_is_one_line(cores: int, memory: float | None, text: str) -> None:
    assert str(Machine("Fast CPU", cores, memory, "Linux 6", "CPython 3.11")) == text


def test_the_model_is_that_of_the_first_processor(tmp_path: Path) -> None:
    listing = tmp_path / "cpuinfo"
    listing.write_text(
        "processor : 0\nmodel name\t: Fast  CPU @ 3 GHz\nmodel name\t: Other\n", encoding="utf-8"
    )
    assert _read_model(listing) == "Fast CPU @ 3 GHz"
    listing.write_text("processor : 0\n", encoding="utf-8")
    assert _read_model(listing) == ""
    assert _read_model(tmp_path / "missing") == ""


def test_comparisons_name_the_machine(capsys: pytest.CaptureFixture[str]) -> None:
    command = ["compare", "visibility", "city:blocks=2", "--backend", "null", "--frames", "1"]
    main([*command, "--algorithms", "frustum"])
    assert f"Measured on {describe_machine()}." in capsys.readouterr().out
    main([*command, "--algorithms", "frustum", "--json"])
    report = json.loads(capsys.readouterr().out)
    assert report["machine"]["processor"] == describe_machine().processor
