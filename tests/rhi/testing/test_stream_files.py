"""Streams in files that tests compare with what a device has recorded."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest
from testing_kit import Light, SampleFrame, backend_works

import rhi
from rhi import CullMode, Device
from rhi.testing import assert_stream_matches
from rhi.trace import load

pytest_plugins = ["pytester"]


def render(device: Device, x: float = 1.0) -> SampleFrame:
    frame = SampleFrame(device)
    for _ in range(4):  # more than are in flight: backends wait at times of their own
        frame.render()
    with device.event("last"), device.render_pass(depth=frame.map), device.states(CullMode.BACK):
        device.draw(frame.shadow, frame.walls, light=Light(offset=(x, 0, 0, 0)))
    return frame


@pytest.fixture
def expected(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The file of a null device's stream."""
    path = tmp_path / "streams" / "frame.zip"
    monkeypatch.setenv("RHI_UPDATE_STREAMS", "1")
    with rhi.create_device("null") as device:
        render(device)
        assert_stream_matches(device, path)
    monkeypatch.delenv("RHI_UPDATE_STREAMS")
    return path


@pytest.mark.parametrize("backend", ["null", "gl", "cl", "wgpu"])
def test_one_file_holds_the_stream_of_every_backend(expected: Path, backend: str) -> None:
    if not backend_works(backend):
        pytest.skip(f"no device of {backend} here")
    with rhi.create_device(backend, record=True) as device:
        render(device)
        assert_stream_matches(device, expected)
        assert_stream_matches(device.stream, str(expected))


CHANGES: dict[str, tuple[Callable[[Device, SampleFrame], object], str]] = {
    "a command more": (lambda d, f: d.event("more").__enter__(), r"\+ +\d+  push_label"),
    "other bytes": (lambda d, f: f.light.write(Light(offset=(3, 0, 0, 0))), r"\+ +\d+  write_buffer"),
    "a resource more": (lambda d, f: d.texture((4, 4), rhi.Format.RGBA8), r"\+ +\d+  create_texture"),
    "a refused call": (lambda d, f: refuse(d), r"REFUSED \[device-argument\]"),
}


def refuse(device: Device) -> None:
    with pytest.raises(rhi.ValidationError):
        device.sampler(3)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", CHANGES)
def test_a_change_fails_with_the_differences(expected: Path, null_device: Device, name: str) -> None:
    change, message = CHANGES[name]
    frame = render(null_device)
    assert_stream_matches(null_device, expected)
    change(null_device, frame)
    with pytest.raises(AssertionError, match=message) as caught:
        assert_stream_matches(null_device, expected)
    assert "--rhi-update-streams" in str(caught.value)


def test_another_number_is_shown_as_a_change(expected: Path, null_device: Device) -> None:
    render(null_device, 2.0)
    with pytest.raises(
        AssertionError, match=r"in 1 places(.|\n)*last\n.*write_buffer: data: 2 of 16 bytes differ"
    ):
        assert_stream_matches(null_device, expected)


def test_a_missing_file_fails_and_is_not_written(tmp_path: Path, null_device: Device) -> None:
    render(null_device)
    with pytest.raises(AssertionError, match=r"there is no file(.|\n)*--rhi-update-streams"):
        assert_stream_matches(null_device, tmp_path / "none.zip")
    assert not list(tmp_path.iterdir())


def test_a_file_that_is_no_trace_is_refused(tmp_path: Path, null_device: Device) -> None:
    render(null_device)
    (tmp_path / "broken.zip").write_bytes(b"no trace")
    with pytest.raises(rhi.RhiError, match="trace-file"):
        assert_stream_matches(null_device, tmp_path / "broken.zip")


@pytest.mark.parametrize("loses", ["clear", "pause"])
def test_an_incomplete_stream_is_refused(expected: Path, null_device: Device, loses: str) -> None:
    render(null_device)
    if loses == "clear":
        null_device.stream.clear()
        render(null_device)
    else:
        with null_device._backend.paused():  # type: ignore[attr-defined]
            null_device.signal()
    with pytest.raises(rhi.ValidationError, match="assertion-argument"):
        assert_stream_matches(null_device, expected)


def test_the_file_names_no_folder_and_loads_as_a_trace(expected: Path) -> None:
    stream = load(expected).stream
    assert {command.site for command in stream} == {None}
    assert len(stream.draws()) == 13


def test_an_equal_stream_leaves_the_file_as_it_is(expected: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rhi.testing.stream_files._written", set[Path]())
    monkeypatch.setenv("RHI_UPDATE_STREAMS", "1")
    before = expected.stat().st_mtime_ns
    with rhi.create_device("null") as device:
        render(device)
        assert_stream_matches(device, expected)
    assert expected.stat().st_mtime_ns == before


TESTS = """
import pytest
from pathlib import Path
from rhi.testing import assert_stream_matches
import rhi

def test_stream(rhi_device):
    image = rhi_device.texture((8, 8), rhi.Format.RGBA8)
    with rhi_device.render_pass(image, clear=(VALUE, 0, 0, 1)):
        pass
    assert_stream_matches(rhi_device, Path(__file__).with_name("stream.zip"))
"""


def test_the_option_writes_files_and_only_it(pytester: pytest.Pytester) -> None:
    file = pytester.path / "test_it.py"
    file.write_text(TESTS.replace("VALUE", "0.5"), encoding="utf-8")
    pytester.runpytest("-p", "no:cacheprovider").assert_outcomes(failed=1)
    pytester.runpytest("-p", "no:cacheprovider", "--rhi-update-streams").assert_outcomes(passed=1)
    pytester.runpytest("-p", "no:cacheprovider").assert_outcomes(passed=1)
    file.write_text(TESTS.replace("VALUE", "0.25"), encoding="utf-8")
    run = pytester.runpytest("-p", "no:cacheprovider")
    run.assert_outcomes(failed=1)
    assert re.search(r"begin_pass: descriptor: .*0\.5.* → .*0\.25", run.stdout.str())


@pytest.mark.skipif(not backend_works("cl"), reason="no device of cl here")
def test_backends_of_one_update_must_agree(pytester: pytest.Pytester) -> None:
    """Else the last of them would be the one that is expected."""
    file = pytester.path / "test_it.py"
    value = "0.5 if rhi_device.backend_name == 'null' else 0.25"
    file.write_text(TESTS.replace("VALUE", value), encoding="utf-8")
    options = ("--rhi-backend", "null", "--rhi-backend", "cl", "--rhi-update-streams")
    run = pytester.runpytest("-p", "no:cacheprovider", *options)
    run.assert_outcomes(passed=1, failed=1)
