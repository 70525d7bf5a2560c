"""`python -m rhi warm` builds the kernels that every program needs."""

from __future__ import annotations

import os
import subprocess
import sys
from concurrent.futures import Future
from pathlib import Path

import pytest

from rhi.__main__ import main
from rhi.backends.cl.builds import Builds, Optimisation
from rhi.backends.cl.warm import warm

_DRAW = """
import rhi
from rhi.backends.cl.builds import Builds
from rhi.conformance.shaders import Colored
from rhi.conformance.shapes import rectangle
compiled, compile_kernels = [], Builds.compile
def note(self, request, quick=False):
    compiled.extend(request.kernels if self._cache.find(request.key) is None else ())
    return compile_kernels(self, request, quick)
Builds.compile = note
with rhi.create_device("cl") as device:
    image, mesh = device.texture((8, 8), rhi.Format.RGBA8), device.mesh(rectangle())
    with device.render_pass(image):
        device.draw(device.program(Colored), mesh)
    image.read()
print(*sorted(compiled))
"""


@pytest.fixture
def begun(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The kernels whose builds have begun, none of which is built."""
    names: list[str] = []

    def begin(self: Builds, optimisation: Optimisation) -> Future[None]:
        names.extend(optimisation.launch.names)
        done: Future[None] = Future()
        done.set_result(None)
        return done

    monkeypatch.setattr(Builds, "begin", begin)
    monkeypatch.setattr(Builds, "is_cached", lambda *_: False)
    return names


def test_warming_builds_set_up_raster_and_texture_kernels_of_both_precisions(begun: list[str]) -> None:
    reports: list[tuple[int, int]] = []
    assert warm(lambda done, count: reports.append((done, count))) == 5
    assert sorted(begun) == ["prefix", "raster", "raster", "scatter", "set_up", "textures", "textures"]
    assert reports[0] == (0, 5)
    assert reports[-1] == (5, 5)


def test_warming_builds_nothing_that_is_in_the_cache(
    begun: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Builds, "is_cached", lambda *_: True)
    assert warm() == 0
    assert begun == []


def test_the_command_says_how_many_programs_are_built(
    begun: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["warm"]) == 0
    assert capsys.readouterr().out == "5 programs built\n"
    assert begun


def test_the_command_names_a_missing_device(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("RHI_CL_DEVICE", "no such device")
    assert main(["warm"]) == 2
    assert "no such device" in capsys.readouterr().err


@pytest.mark.nightly
def test_after_warming_a_program_builds_its_own_kernels_alone(tmp_path: Path) -> None:
    environment = os.environ | {"RHI_CACHE": str(tmp_path), "RHI_KERNELS": "quick"}

    def run(*arguments: str) -> str:
        command = [sys.executable, *arguments]
        return subprocess.run(
            command, env=environment, check=True, capture_output=True, text=True, encoding="utf-8"
        ).stdout

    assert run("-m", "rhi", "warm") == "5 programs built\n"
    script = tmp_path / "draw.py"
    script.write_text(_DRAW, encoding="utf-8")
    assert run(str(script)).split() == ["measure", "stage", "transform"]
    assert run("-m", "rhi", "warm") == "nothing to build\n"
