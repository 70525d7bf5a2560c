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
from rhi.backends.cl import context, create_backend
from rhi.backends.cl.context import choose_device, describe, find_devices, open_context
from rhi.errors import DeviceError

REAL_PROBE = context.probe
BROKEN = "__kernel void probe(__global uint *words) { words[0] = undeclared; }"
WRONG = "__kernel void probe(__global uint *words) { words[get_global_id(0)] = 1; }"


def devices_twice(monkeypatch: pytest.MonkeyPatch, first_probe: str) -> None:
    """The machine's device listed twice, the first with another probe kernel."""
    probes = [first_probe, context._PROBE]

    def probe(*given: Any) -> tuple[cl.Program, bool]:
        with monkeypatch.context() as patch:
            patch.setattr(context, "_PROBE", probes.pop(0))
            return REAL_PROBE(*given)

    monkeypatch.delenv("RHI_CL_DEVICE", raising=False)
    monkeypatch.setattr(context, "find_devices", lambda: find_devices()[:1] * 2)
    monkeypatch.setattr(context, "probe", probe)


def test_a_device_that_compiles_and_runs_is_taken() -> None:
    opened = open_context()
    assert opened.passed_over == ()
    assert opened.device in find_devices()


def test_a_device_that_cannot_compile_is_passed_over_with_the_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    devices_twice(monkeypatch, BROKEN)
    (passed_over,) = create_backend().capabilities.passed_over
    assert describe(find_devices()[0]) in passed_over
    assert "undeclared" in passed_over
    assert "\n" not in passed_over


def test_a_device_that_computes_wrong_numbers_is_passed_over(monkeypatch: pytest.MonkeyPatch) -> None:
    devices_twice(monkeypatch, WRONG)
    (passed_over,) = open_context().passed_over
    assert "wrong numbers" in passed_over


def test_where_no_device_works_each_is_named_with_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("RHI_CL_DEVICE", raising=False)
    monkeypatch.setattr(context, "_PROBE", BROKEN)
    with pytest.raises(DeviceError, match=r"^\[device-driver\]") as caught:
        open_context()
    assert len(caught.value.given.splitlines()) == len(find_devices())
    assert "pocl-opencl-icd" in caught.value.tip


def test_without_any_opencl_driver_the_error_says_what_to_install() -> None:
    code = "import rhi\ntry: rhi.create_device('cl')\nexcept rhi.DeviceError as e: print(e.rule.id, e.given, e.tip)"
    environment = os.environ | {"OCL_ICD_VENDORS": "/nowhere"}
    output = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment
    ).stdout
    assert output.startswith("device-driver no OpenCL device")
    assert "pocl-opencl-icd" in output


def test_without_pyopencl_the_error_says_what_to_install() -> None:
    code = (
        "import sys, rhi\nsys.modules['pyopencl'] = None\n"
        "try: rhi.create_device('cl')\nexcept rhi.DeviceError as e: print(e.rule.id, e.tip)"
    )
    output = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert output == "device-driver pip install pyopencl\n"


def test_a_compiler_older_than_the_cpu_is_told_from_other_failures(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> tuple[cl.Program, bool]:
        raise RuntimeError("error: unknown target CPU 'generic'\nand more")

    monkeypatch.delenv("RHI_CL_DEVICE", raising=False)
    monkeypatch.setattr(context, "probe", refuse)
    with pytest.raises(DeviceError) as caught:
        open_context()
    assert "older than the CPU" in caught.value.tip
    assert "pocl-opencl-icd" in caught.value.tip


def test_the_report_says_why_a_device_was_passed_over(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    devices_twice(monkeypatch, BROKEN)
    main([])
    (line,) = [row for row in capsys.readouterr().out.splitlines() if "passed over:" in row]
    assert "undeclared" in line
    assert describe(find_devices()[0]) in line


@pytest.mark.parametrize("wanted", ["", "0"])
def test_a_driver_without_a_device_is_told_from_no_driver(monkeypatch: pytest.MonkeyPatch, wanted: str) -> None:
    monkeypatch.setenv("RHI_CL_DEVICE", wanted)
    for platforms, says in (
        ([], "apt install"),
        ([SimpleNamespace(name="Empty", get_devices=list)], "POCL_CACHE_DIR"),
    ):
        monkeypatch.setattr(context.cl, "get_platforms", lambda found=platforms: found)
        with pytest.raises(DeviceError) as caught:
            open_context()
        assert says in caught.value.tip
        assert ("Empty" in caught.value.given) == bool(platforms)


def test_the_report_says_what_to_install_where_no_device_works(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("RHI_CL_DEVICE", raising=False)
    monkeypatch.setattr(context, "_PROBE", BROKEN)
    main([])
    told = capsys.readouterr().out
    assert "cl     not usable: " in told
    assert "undeclared" in told
    assert "pocl-opencl-icd" in told


def test_a_device_is_chosen_by_its_number_or_a_part_of_its_name() -> None:
    devices = find_devices()
    assert choose_device("0", devices) is devices[0]
    assert choose_device(devices[-1].name[2:9].upper(), devices[-1:]) is devices[-1]


@pytest.mark.parametrize("wanted", ["no such name", "99"])
def test_an_unknown_device_is_refused_with_those_there_are(monkeypatch: pytest.MonkeyPatch, wanted: str) -> None:
    monkeypatch.setenv("RHI_CL_DEVICE", wanted)
    with pytest.raises(DeviceError) as caught:
        open_context()
    assert repr(wanted) in caught.value.given
    assert describe(find_devices()[0]) in caught.value.given
    assert "RHI_CL_DEVICE" in caught.value.tip


def test_the_report_keeps_the_devices_there_are_in_its_column(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("RHI_CL_DEVICE", "no such name")
    main([])
    told = capsys.readouterr().out.splitlines()
    begin = next(i for i, row in enumerate(told) if row.startswith("cl     not usable: RHI_CL_DEVICE="))
    assert told[begin + 1].startswith(" " * 11 + f"0: {describe(find_devices()[0])}")
    assert "unset RHI_CL_DEVICE" in told[begin + 1 + len(find_devices())]


def test_a_device_that_was_asked_for_is_the_only_one_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    devices_twice(monkeypatch, BROKEN)
    monkeypatch.setenv("RHI_CL_DEVICE", "0")
    with pytest.raises(DeviceError, match="undeclared"):
        open_context()


def test_a_folder_named_later_leaves_that_of_the_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """PoCL, which has read its variable, would not be found in another."""
    told = os.environ["POCL_CACHE_DIR"]
    assert open_context().cache.works
    monkeypatch.setenv("RHI_CACHE", str(tmp_path))
    assert open_context().cache.works
    assert os.environ["POCL_CACHE_DIR"] == told
