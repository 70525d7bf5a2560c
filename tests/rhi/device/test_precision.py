"""The precision of shaders that say none themselves: a device's, by argument or by `RHI_PRECISION`."""

from __future__ import annotations

import importlib
import json
import logging
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from nightly_reasons import CHEAPER_TEST

import rhi
import rhi.shading as sl
from rhi.contract.descriptors import Stage
from rhi.device.device import FRAMES_BEFORE_PRECISION_LOG, SLOW_WAIT
from rhi.shading import Precision

FAST, EXACT = Precision.FAST, Precision.EXACT


class Wave(sl.Shader):
    work_group = (64,)
    source: sl.Storage[float]
    target: sl.StorageRW[float]

    def compute(self) -> None:
        i = sl.global_id().x
        self.target[i] = sl.sin(self.source[i]) / 3.0


class ExactWave(Wave):
    precision = EXACT


class FastWave(Wave):
    precision = FAST


class Heir(FastWave):
    pass


class Bell(Wave):
    """A function of which EXACT and FAST have other last digits."""

    def compute(self) -> None:
        i = sl.global_id().x
        self.target[i] = sl.exp(-0.1 * self.source[i] * self.source[i])


class ExactBell(Bell):
    precision = EXACT


class FastBell(Bell):
    precision = FAST


class Doubled(Wave):
    def compute(self) -> None:
        self.target[sl.global_id().x] *= 2.0


def kernel(program: rhi.Program[Any]) -> str:
    return program.descriptor.emit("opencl16", Stage.COMPUTE).text


def test_shaders_that_say_none_have_the_precision_of_the_device() -> None:
    for requested in (None, EXACT, FAST):
        with rhi.create_device("null", precision=requested) as device:
            assert device.precision is (requested or EXACT)
            for shader, precision in (
                (Wave, requested or EXACT),
                (ExactWave, EXACT),
                (FastWave, FAST),
                (Heir, FAST),
            ):
                program = device.program(shader)
                assert program is device.program(shader)
                assert ("rhi_fast_sin" in kernel(program)) == (precision is FAST), (requested, shader)
                assert program.descriptor.flushes_denormals == (precision is FAST)
                assert program.name == shader.__name__


@pytest.mark.parametrize(
    ("text", "expected"), [("fast", FAST), ("FAST", FAST), ("exact", EXACT), ("", EXACT)]
)
def test_the_environment_names_the_precision(
    monkeypatch: pytest.MonkeyPatch, text: str, expected: Precision
) -> None:
    monkeypatch.setenv("RHI_PRECISION", text)
    assert rhi.create_device("null").precision is expected
    assert rhi.create_device("null", precision=EXACT).precision is EXACT


def test_other_precisions_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(rhi.ValidationError, match=r"precision.*'fast'"):
        rhi.create_device("null", precision="fast")  # type: ignore[arg-type]
    monkeypatch.setenv("RHI_PRECISION", "quick")
    with pytest.raises(rhi.ValidationError, match="RHI_PRECISION=quick"):
        rhi.create_device("null")


@pytest.mark.nightly_cases(reason=CHEAPER_TEST)
def test_the_report_names_the_precision(monkeypatch: pytest.MonkeyPatch) -> None:
    def say(*options: str) -> str:
        command = [sys.executable, "-m", "rhi", *options]
        return subprocess.run(command, capture_output=True, text=True, check=False, encoding="utf-8").stdout

    monkeypatch.setenv("RHI_PRECISION", "fast")
    assert json.loads(say("--json"))["precision"] == "fast"
    assert "precision: fast, as RHI_PRECISION says" in say()


def test_opencl_computes_as_the_device_says() -> None:
    source = np.linspace(-9, 9, 1 << 10, dtype=np.float32)

    def run(shader: type[sl.Shader], precision: Precision) -> np.ndarray[Any, Any]:
        with rhi.create_device("cl", precision=precision) as device:
            target = device.storage(float, len(source))
            program: Any = device.program(shader)
            device.dispatch(program, len(source) // 64, source=device.storage(float, source), target=target)
            return target.read()

    if "cl" not in [backend.name for backend in rhi.report() if backend.usable]:
        pytest.skip("cl doesn't work here")
    fast, exact = run(Bell, FAST), run(Bell, EXACT)
    assert (fast != exact).any()
    assert np.abs(fast - exact).max() < 1e-6
    assert np.array_equal(fast, run(FastBell, EXACT))
    assert np.array_equal(exact, run(ExactBell, FAST))


def test_an_edit_keeps_the_precision(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = (
        "import rhi.shading as sl\nclass Edited(sl.Shader):\n    target: sl.StorageRW[float]\n"
        "    def compute(self) -> None:\n        self.target[0] = sl.sin(self.target[0])\n"
    )
    (tmp_path / "edited_precision.py").write_text(text, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    module = importlib.import_module("edited_precision")
    with rhi.create_device("null", precision=FAST) as device:
        program = device.program(module.Edited)
        assert "rhi_fast_sin" in kernel(program)
        assert rhi.Reloader(device).reload(module, text.replace("sl.sin", "sl.cos")) == 1
        assert "rhi_fast_cos" in kernel(program)


@pytest.mark.parametrize(
    ("shader", "precision", "language", "waited", "is_logged"),
    [
        (Wave, EXACT, "opencl16", 0.3, True),
        (Wave, EXACT, "opencl16", SLOW_WAIT, False),
        (Wave, EXACT, "glsl", 0.3, False),
        (Wave, FAST, "opencl16", 0.3, False),
        (FastWave, EXACT, "opencl16", 0.3, False),
        (Doubled, EXACT, "opencl16", 0.3, False),
    ],
    ids=["exact", "not slow", "another language", "a fast device", "a fast shader", "nothing to gain"],
)
def test_slow_frames_name_the_exact_shader_once(
    caplog: pytest.LogCaptureFixture,
    shader: Any,
    precision: Precision,
    language: str,
    waited: float,
    is_logged: bool,
) -> None:
    shader = type("Own", (shader,), {"__module__": __name__})  # with texts of its own
    with (
        rhi.create_device("null", precision=precision) as device,
        caplog.at_level(logging.WARNING, "rhi.device"),
    ):
        device.program(shader).descriptor.emit(language, Stage.COMPUTE)
        for frame in range(6):
            assert bool(caplog.records) == (is_logged and frame >= FRAMES_BEFORE_PRECISION_LOG)
            device._core.timeline.waited = waited
            device.present()
        shader_names = [record.args[1] for record in caplog.records if isinstance(record.args, tuple)]
        assert shader_names == ["Own (divide, sin)"] * is_logged


def test_only_time_spent_waiting_for_the_device_counts() -> None:
    with rhi.create_device("null") as device:
        timeline, slow = device._core.timeline, device.signal()
        timeline._backend = SlowFence(timeline._backend)  # type: ignore[assignment]
        device.wait(slow)
        assert timeline.waited >= 0.02
        device.present()
        assert timeline.waited == 0.0


class SlowFence:
    """A backend whose fence is reached late."""

    def __init__(self, backend: Any) -> None:
        self._backend = backend

    def __getattr__(self, name: str) -> Any:
        return getattr(self._backend, name)

    def completed(self) -> int:
        return 0

    def wait(self, value: int, seconds: float) -> bool:
        import time

        time.sleep(0.02)
        return True
