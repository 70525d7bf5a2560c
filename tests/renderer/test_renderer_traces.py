"""Traces of the renderer's frames: recorded without a GPU, replayed later to the same image."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

import rhi
from renderer import cli
from renderer.content import load_scene
from renderer.renderer import Renderer
from renderer.scene import FRAMES_PER_SECOND
from renderer.visibility import FrustumCulling
from rhi.__main__ import main as rhi_main
from rhi.trace import load, replay, save


def render(device: rhi.Device, city: str, frames: int, size: tuple[int, int]) -> NDArray[np.generic] | None:
    """Render the city's first frames along the ground; return the last image, if there is one."""
    scene = load_scene(city)
    with Renderer(device, scene, visibility=FrustumCulling(scene), size=size) as renderer:
        for frame in range(frames):
            result = renderer.render(scene.paths["ground"].camera(frame), frame / FRAMES_PER_SECOND)
        return result.image.read() if device.capabilities.shading else None


def assert_replays(tmp_path: Path, gl: rhi.Device, city: str, size: tuple[int, int]) -> None:
    with rhi.create_device("null") as null:
        render(null, city, 10, size)
        save(null, tmp_path / "city.zip")
    with rhi.create_device("gl") as fresh:
        replayed = replay(load(tmp_path / "city.zip", trusted=True), on=fresh).image
    direct = render(gl, city, 10, size)
    assert replayed is not None
    assert direct is not None
    assert direct.std() > 10
    assert np.array_equal(replayed, direct)


def test_ten_frames_of_a_city_recorded_on_null_replay_on_gl(tmp_path: Path, gl: rhi.Device) -> None:
    assert_replays(tmp_path, gl, "city:blocks=4", (120, 68))


@pytest.mark.nightly
def test_the_default_citys_first_ten_frames_recorded_on_null_replay_on_gl(
    tmp_path: Path, gl: rhi.Device
) -> None:
    assert_replays(tmp_path, gl, "city", (960, 540))


@pytest.mark.usefixtures("gl")
def test_the_command_line_records_on_one_backend_and_replays_on_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    ways = ["--technique", "forward", "--visibility", "frustum"]  # what is automatic follows from time
    shared = ["render", "city:blocks=4", "--size", "80x60", "--frames", "3", "--camera", "ground", *ways]
    assert cli.main([*shared, "--backend", "null", "--trace", "new/city.zip"]) == 0
    assert cli.main([*shared, "--backend", "gl", "--output", "direct.png"]) == 0
    assert (
        rhi_main(
            ["trace", "replay", "new/city.zip", "--backend", "gl", "--trust", "--output", "replayed.png"]
        )
        == 0
    )
    direct, replayed = (np.asarray(Image.open(name)) for name in ("direct.png", "replayed.png"))
    assert np.array_equal(direct, replayed)


@pytest.mark.usefixtures("gl")
def test_a_trace_recorded_on_gl_has_its_commands_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert (
        cli.main(["render", "city:blocks=4", "--size", "16x16", "--backend", "gl", "--trace", "t.zip"]) == 0
    )
    trace = load("t.zip")
    assert trace.backend == "gl"
    assert len(trace.stream.draws()) >= 2
