"""Buffers of a technique that are read back while a frame is made."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from frames import draw_each, first_view_camera, make_boxes, open_renderer

import rhi
from renderer.cli import main
from renderer.frame import make_plan
from renderer.scene import Camera, Scene
from renderer.techniques import Deferred, Forward, ResourceCapture, Technique
from renderer.techniques.resource_capture import list_resources

SIZE = (24, 16)


def boxes() -> Scene:
    """Make a box between a point light and a spot light."""
    builder = make_boxes((0, 0, 0))
    builder.lights.add_point((-1.2, 0, 1.2), 4.0, (1, 0, 0), 2.0)
    builder.lights.add_spot((1.2, 0, 1.2), (-1, 0, -1), 4.0, 0.4, 0.8, (0, 1, 0), 2.0)
    builder.views["eye"] = Camera.look_at((0, 0, 3), (0, 0, 0))
    return builder.build()


def watch(device: rhi.Device, technique: Technique, resource: str) -> ResourceCapture:
    """Draw two frames, and return what was watched."""
    scene, watched = boxes(), ResourceCapture(technique, resource)
    with open_renderer(device, scene, watched, size=SIZE) as renderer:
        for _ in range(2):
            renderer.render(first_view_camera(scene))
    return watched


def test_contents_are_those_before_a_later_pass_draws_over_them(gl: rhi.Device) -> None:
    first, with_spot = (watch(gl, Deferred(), name).texels for name in ("light", "light with spot lights"))
    assert first is not None
    assert with_spot is not None
    assert first.shape == with_spot.shape == (*SIZE[::-1], 4)
    assert first[..., 0].max() > 0.1
    assert first[..., 1].max() == 0.0  # the spot light is green
    assert with_spot[..., 1].max() > 0.1


def test_the_frame_is_the_same(gl: rhi.Device) -> None:
    images = draw_each(gl, boxes(), Deferred(), ResourceCapture(Deferred(), "surface"), size=SIZE)
    assert (images[0] == images[1]).all()


@pytest.mark.parametrize("name", ["lihgt", "light lists", "image_samples", ""])
def test_other_names_are_refused_with_those_of_the_plan(null: rhi.Device, name: str) -> None:
    with pytest.raises(rhi.ValidationError, match="plan-unknown-resource") as error:
        watch(null, Deferred(), name)
    assert "surface, material, depth, light, light with spot lights, image" in str(error.value)


def test_contents_of_several_samples_are_not_listed(null: rhi.Device) -> None:
    scene = boxes()
    with open_renderer(null, scene) as renderer:
        effects, _ = renderer.plan(first_view_camera(scene))
    assert list_resources(Forward(4).declare(effects)) == ["depth", "image"]
    plan = make_plan(list(ResourceCapture(Forward(4), "depth").declare(effects)))
    assert [frame_pass.name for frame_pass in plan.passes] == ["depth", "forward", "resolve", "read back"]


def test_render_writes_a_buffer_as_an_image(
    gl: rhi.Device, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    common = [
        "render",
        "grid:count=4,lights=2",
        "--size",
        "40x30",
        "--backend",
        "gl",
        "--visibility",
        "frustum",
    ]
    paths = [tmp_path / f"{name}.png" for name in ("material", "image")]
    for path in paths:
        options = ["--technique", "deferred", "--show", path.stem, "--output", str(path)]
        assert main([*common, *options]) == 0
    assert paths[0].read_bytes() != paths[1].read_bytes()
    with pytest.raises(SystemExit):
        main([*common, "--show", "surface"])  # forward shading has none
    assert "allowed: image, depth" in capsys.readouterr().err


def test_a_watched_buffer_is_exact(gl: rhi.Device) -> None:
    material = watch(gl, Deferred(), "material").texels
    assert material is not None
    assert material.dtype == np.uint32
    assert material[SIZE[1] // 2, SIZE[0] // 2] == 0
