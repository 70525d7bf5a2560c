"""`device.capture()`, with a stand-in for RenderDoc: a table of C functions, as RenderDoc's header has it."""

from __future__ import annotations

import ctypes
import logging
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from nightly_reasons import CHEAPER_TEST
from tested_devices import open_device

import rhi
from rhi import Device
from rhi.device import capture as module

NAMES = module._NAMES


class StandIn:
    """RenderDoc's API in Python. `calls` are the functions that were called, in order."""

    def __init__(self) -> None:
        self.calls: list[Any] = []
        self.template = b"renderdoc"
        self.files: list[bytes] = []
        self.works = True
        self.captures = 0
        self.device: Device | None = None
        functions = {
            "SetCaptureFilePathTemplate": self.set_template,
            "GetNumCaptures": lambda: len(self.files),
            "GetCapture": self.get_capture,
            "StartFrameCapture": self.start,
            "IsFrameCapturing": lambda: self.captures,
            "EndFrameCapture": self.end,
        }
        self._functions = {name: module._TYPES[name](function) for name, function in functions.items()}
        addresses = [
            ctypes.cast(self._functions[name], ctypes.c_void_p).value if name in self._functions else None
            for name in NAMES
        ]
        self.table = (ctypes.c_void_p * len(NAMES))(*addresses)

    def get_api(self, version: int, result: Any) -> int:
        assert version == 10102
        result._obj.value = ctypes.addressof(self.table)
        return 1

    def set_template(self, template: bytes) -> None:
        self.template = template

    def get_capture(self, index: int, name: Any, length: Any, time: Any) -> int:
        if index >= len(self.files):
            return 0
        if name is not None:
            ctypes.memmove(name, self.files[index] + b"\0", len(self.files[index]) + 1)
        length[0] = len(self.files[index])
        return 1

    def start(self, device: Any, window: Any) -> None:
        assert device is None
        assert window is None
        self.captures = 1
        self.calls.append(("start", len(self.device.stream) if self.device else 0))

    def end(self, device: Any, window: Any) -> int:
        self.captures = 0
        self.calls.append(("end", len(self.device.stream) if self.device else 0))
        if self.works:
            self.files.append(self.template + b"_frame%d.rdc" % len(self.files))
        return int(self.works)


@pytest.fixture
def stand_in(monkeypatch: pytest.MonkeyPatch, null_device: Device) -> StandIn:
    result = StandIn()
    result.device = null_device
    monkeypatch.setattr(module, "_find_library", lambda: result.get_api)
    return result


def test_the_work_of_the_block_is_captured(stand_in: StandIn, null_device: Device) -> None:
    with null_device.capture("out/city") as capture:
        begin = len(null_device.stream)
        assert capture.is_active
        null_device.present()
        end = len(null_device.stream)
    assert capture.file == Path("out/city_frame0.rdc")
    assert not capture.is_active
    (start, first), (stop, last) = stand_in.calls
    assert (start, stop) == ("start", "end")
    assert first <= begin < end <= last  # after earlier work was finished, and its own work too
    with null_device.capture() as second:
        null_device.present()
    assert second.file == Path("out/city_frame1.rdc")


def test_the_functions_are_where_the_header_has_them(stand_in: StandIn) -> None:
    assert len(NAMES) == 22
    assert [
        NAMES.index(name) for name in ("SetCaptureFilePathTemplate", "GetCapture", "EndFrameCapture")
    ] == [11, 14, 21]
    api = module.find_renderdoc()
    assert api is not None
    api.SetCaptureFilePathTemplate(b"other")
    assert stand_in.template == b"other"
    assert (api.GetNumCaptures(), api.IsFrameCapturing()) == (0, 0)


def test_an_error_in_the_block_ends_the_capture(stand_in: StandIn, null_device: Device) -> None:
    with pytest.raises(ZeroDivisionError), null_device.capture():
        raise ZeroDivisionError
    assert [name for name, _ in stand_in.calls] == ["start", "end"]


def test_a_capture_inside_another_does_nothing(
    stand_in: StandIn, null_device: Device, caplog: pytest.LogCaptureFixture
) -> None:
    with null_device.capture() as outer, null_device.capture() as inner:
        assert not inner.is_active
    assert inner.file is None
    assert outer.file is not None
    assert [name for name, _ in stand_in.calls] == ["start", "end"]
    assert "captures a frame already" in caplog.text


def test_a_capture_that_fails_is_logged(
    stand_in: StandIn, null_device: Device, caplog: pytest.LogCaptureFixture
) -> None:
    stand_in.works = False
    with null_device.capture() as capture:
        null_device.present()
    assert capture.file is None
    assert "could not capture" in caplog.text


def test_without_renderdoc_the_block_runs_and_a_warning_says_so(
    null_device: Device, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING), null_device.capture() as capture:
        null_device.present()
    assert (capture.is_active, capture.file) == (False, None)
    assert "RenderDoc isn't loaded" in caplog.text


@pytest.mark.parametrize("path", [3, b"out", ["out"]])
def test_an_argument_other_than_a_path_is_refused(null_device: Device, path: Any) -> None:
    with pytest.raises(rhi.ValidationError, match="device-argument"):
        null_device.capture(path)


PROGRAM = """
import sys
import rhi
import rhi.shading as sl

class Plain(sl.FullScreen):
    def fragment(self) -> sl.vec4:
        return sl.vec4(1.0, 0.5, 0.0, 1.0)

with rhi.create_device(sys.argv[1]) as device:
    image = device.texture((64, 64), rhi.Format.RGBA8)
    for frame in range(2):
        with device.capture(sys.argv[2]) as capture:
            with device.render_pass(image):
                device.draw(device.program(Plain), device.mesh(3))
            device.present(image)
        print(capture.file)
"""


@pytest.mark.nightly_cases(reason=CHEAPER_TEST)
@pytest.mark.parametrize(("backend", "draw"), [("gl", "glDraw"), ("wgpu", "vkCmdDraw")])
def test_renderdoc_captures_the_draws_of_each_block(tmp_path: Path, backend: str, draw: str) -> None:
    command = shutil.which("renderdoccmd")
    if command is None:
        pytest.skip("no renderdoccmd: apt install renderdoc")
    with open_device(backend):
        pass
    (tmp_path / "program.py").write_text(PROGRAM, encoding="utf-8")
    program = [sys.executable, tmp_path / "program.py", backend, tmp_path / "city"]
    captured = subprocess.run(
        [command, "capture", "--wait-for-exit", "--working-dir", tmp_path, *program],
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
        encoding="utf-8",
    )
    files = [Path(line) for line in captured.stdout.splitlines() if line.endswith(".rdc")]
    assert len(set(files)) == 2, captured.stdout + captured.stderr
    for file in files:
        text = tmp_path / "capture.xml"
        convert = [command, "convert", "-f", file, "-o", text, "-i", "rdc", "-c", "xml"]
        subprocess.run(convert, capture_output=True, check=True, timeout=300)
        assert text.read_text(encoding="utf-8").count(f'name="{draw}') == 1
