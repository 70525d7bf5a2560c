"""Selection of the device, and the errors without one."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pyopencl as cl
import pytest

from rhi.__main__ import main
from rhi.backends.cl import cl_context, create_backend
from rhi.backends.cl.cl_context import choose_device, describe, list_devices, open_context
from rhi.errors import DeviceError

REAL_PROBE = cl_context.probe
BROKEN = "__kernel void probe(__global uint *words) { words[0] = undeclared; }"
WRONG = "__kernel void probe(__global uint *words) { words[get_global_id(0)] = 1; }"


def devices_twice(monkeypatch: pytest.MonkeyPatch, first_probe: str) -> None:
    """The machine's device listed twice, the first with another probe kernel."""
    probes = [first_probe, cl_context._PROBE]

    def probe(*args: Any) -> tuple[cl.Program, bool]:
        with monkeypatch.context() as patch:
            patch.setattr(cl_context, "_PROBE", probes.pop(0))
            return REAL_PROBE(*args)

    monkeypatch.delenv("RHI_CL_DEVICE", raising=False)
    monkeypatch.setattr(cl_context, "list_devices", lambda: list_devices()[:1] * 2)
    monkeypatch.setattr(cl_context, "probe", probe)


def test_a_device_that_compiles_and_runs_is_taken() -> None:
    opened = open_context()
    assert opened.rejected_devices == ()
    assert opened.device in list_devices()


def test_a_device_that_cannot_compile_is_passed_over_with_the_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    devices_twice(monkeypatch, BROKEN)
    (rejected_devices,) = create_backend().capabilities.rejected_devices
    assert describe(list_devices()[0]) in rejected_devices
    assert "undeclared" in rejected_devices
    assert "\n" not in rejected_devices


def test_a_device_that_computes_wrong_numbers_is_passed_over(monkeypatch: pytest.MonkeyPatch) -> None:
    devices_twice(monkeypatch, WRONG)
    (rejected_devices,) = open_context().rejected_devices
    assert "wrong numbers" in rejected_devices


def test_where_no_device_works_each_is_named_with_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("RHI_CL_DEVICE", raising=False)
    monkeypatch.setattr(cl_context, "_PROBE", BROKEN)
    with pytest.raises(DeviceError, match=r"^\[device-driver\]") as caught:
        open_context()
    assert len(caught.value.given.splitlines()) == len(list_devices())
    assert "pocl-opencl-icd" in caught.value.tip


def test_without_any_opencl_driver_the_error_says_what_to_install() -> None:
    code = "import rhi\ntry: rhi.create_device('cl')\nexcept rhi.DeviceError as e: print(e.rule.id, e.given, e.tip)"
    environment = os.environ | {"OCL_ICD_VENDORS": "/nowhere"}
    output = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        env=environment,
        encoding="utf-8",
    ).stdout
    assert output.startswith("device-driver no OpenCL device")
    assert "pocl-opencl-icd" in output


def test_without_pyopencl_the_error_says_what_to_install() -> None:
    code = (
        "import sys, rhi\nsys.modules['pyopencl'] = None\n"
        "try: rhi.create_device('cl')\nexcept rhi.DeviceError as e: print(e.rule.id, e.tip)"
    )
    output = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, encoding="utf-8"
    ).stdout
    assert output == "device-driver pip install pyopencl\n"


def test_a_compiler_older_than_the_cpu_is_distinguished_from_other_failures(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refuse(*_: object) -> tuple[cl.Program, bool]:
        raise RuntimeError("error: unknown target CPU 'generic'\nand more")

    monkeypatch.delenv("RHI_CL_DEVICE", raising=False)
    monkeypatch.setattr(cl_context, "probe", refuse)
    with pytest.raises(DeviceError) as caught:
        open_context()
    assert "older than the CPU" in caught.value.tip
    assert "pocl-opencl-icd" in caught.value.tip


def test_the_report_says_why_a_device_was_passed_over(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    devices_twice(monkeypatch, BROKEN)
    main([])
    (line,) = [row for row in capsys.readouterr().out.splitlines() if "rejected:" in row]
    assert "undeclared" in line
    assert describe(list_devices()[0]) in line


@pytest.mark.parametrize("selection", ["", "0"])
def test_a_driver_without_a_device_is_distinguished_from_no_driver(
    monkeypatch: pytest.MonkeyPatch, selection: str
) -> None:
    monkeypatch.setenv("RHI_CL_DEVICE", selection)
    for platforms, says in (
        ([], "apt install"),
        ([SimpleNamespace(name="Empty", get_devices=list)], "POCL_CACHE_DIR"),
    ):
        monkeypatch.setattr(cl_context.cl, "get_platforms", lambda installed=platforms: installed)
        with pytest.raises(DeviceError) as caught:
            open_context()
        assert says in caught.value.tip
        assert ("Empty" in caught.value.given) == bool(platforms)


def test_the_report_says_what_to_install_where_no_device_works(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("RHI_CL_DEVICE", raising=False)
    monkeypatch.setattr(cl_context, "_PROBE", BROKEN)
    main([])
    report = capsys.readouterr().out
    assert "cl     not usable: " in report
    assert "undeclared" in report
    assert "pocl-opencl-icd" in report


def test_a_device_is_chosen_by_its_number_or_a_part_of_its_name() -> None:
    devices = list_devices()
    assert choose_device("0", devices) is devices[0]
    assert choose_device(devices[-1].name[2:9].upper(), devices[-1:]) is devices[-1]


@pytest.mark.parametrize("name", ["no such name", "99"])
def test_an_unknown_device_is_refused_with_those_there_are(
    monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.setenv("RHI_CL_DEVICE", name)
    with pytest.raises(DeviceError) as caught:
        open_context()
    assert repr(name) in caught.value.given
    assert describe(list_devices()[0]) in caught.value.given
    assert "RHI_CL_DEVICE" in caught.value.tip


def test_the_report_keeps_the_devices_there_are_in_its_column(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("RHI_CL_DEVICE", "no such name")
    main([])
    lines = capsys.readouterr().out.splitlines()
    begin = next(i for i, row in enumerate(lines) if row.startswith("cl     not usable: RHI_CL_DEVICE="))
    assert lines[begin + 1].startswith(" " * 11 + f"0: {describe(list_devices()[0])}")
    assert "unset RHI_CL_DEVICE" in lines[begin + 1 + len(list_devices())]


def test_a_device_that_was_asked_for_is_the_only_one_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    devices_twice(monkeypatch, BROKEN)
    monkeypatch.setenv("RHI_CL_DEVICE", "0")
    with pytest.raises(DeviceError, match="undeclared"):
        open_context()


def test_a_folder_named_later_leaves_that_of_the_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """PoCL, which has read its variable, would not be found in another."""
    folder = os.environ["POCL_CACHE_DIR"]
    assert open_context().cache.works
    monkeypatch.setenv("RHI_CACHE", str(tmp_path))
    assert open_context().cache.works
    assert os.environ["POCL_CACHE_DIR"] == folder
