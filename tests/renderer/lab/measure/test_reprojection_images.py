"""Images of the depth that a frame begins with: what counts as a hole, and as nearer than it should be."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Final

import numpy as np
import pytest
from frames import open_renderer

import rhi
from renderer.cli import main
from renderer.content.shapes import BUILT_IN
from renderer.lab.measure.reprojection_images import ReprojectedDepths, reproject_depth
from renderer.scene import Camera, PathFrame, Perspective, Scene, SceneBuilder, scaling, translation

SIZE: Final = (160, 96)


def make_wall() -> Scene:
    """Make a box 10 m ahead in front of a wall at 30 m that fills the view."""
    builder = SceneBuilder("wall")
    mesh, material = builder.add_mesh(BUILT_IN["box"]()), builder.add_material()
    for distance, width in ((10.0, 2.0), (30.0, 200.0)):
        transform = translation((0.0, 0.0, -distance)) @ scaling((width, width, 0.5))
        builder.add_objects(builder.add_node(transform), mesh, material)
    return builder.build()


def reproject(device: rhi.Device, x: float) -> ReprojectedDepths:
    """Move the depth of a camera at the origin to one at (x, 0, 0) that looks in the same direction."""
    frames = [
        PathFrame(number, Camera.look_at((at, 0.0, 0.0), (at, 0.0, -1.0), projection=Perspective(near=0.1)))
        for number, at in enumerate((0.0, x))
    ]
    with open_renderer(device, make_wall(), visibility="frustum", size=SIZE) as renderer:
        return reproject_depth(renderer, *frames)


def test_a_camera_that_stays_leaves_no_holes_and_hides_no_more(gl: rhi.Device) -> None:
    depths = reproject(gl, 0.0)
    assert depths.exact.shape == (24, 40)
    assert depths.moved == pytest.approx(depths.exact, rel=1e-5)
    assert not depths.holes.any()
    assert not depths.hides_too_much.any()


def test_a_camera_that_steps_aside_leaves_holes_beside_the_box_and_at_the_edge(gl: rhi.Device) -> None:
    """The camera goes to the right: the box moves more than the wall, so its right side uncovers what nothing is known
    about, and so does the right edge of the image."""
    depths, row = reproject(gl, 1.0), 12  # through the box
    is_box = np.abs(0.1 / depths.exact[row] - 9.5) < 1.0
    right = int(np.flatnonzero(is_box)[-1])
    assert depths.holes[row, right + 1 : right + 4].any()
    assert depths.holes[row, -1]
    assert not depths.holes[row, :4].any()
    assert not (depths.filled[depths.holes] == depths.far).any(), "all holes are filled"
    assert np.array_equal(depths.filled[~depths.holes], depths.moved[~depths.holes])


def test_only_filled_holes_and_edges_hide_more_than_this_frame_does(gl: rhi.Device) -> None:
    depths = reproject(gl, 1.0)
    assert depths.hides_too_much.any()
    assert (depths.hides_too_much & ~depths.holes).mean() < 0.05


def test_the_image_has_three_depths_of_one_scale_and_holes_in_magenta(gl: rhi.Device) -> None:
    depths = reproject(gl, 1.0)
    image = depths.draw()
    assert image.shape == (24, 120, 3)
    is_magenta = (image == (255, 0, 255)).all(axis=2)
    assert np.array_equal(is_magenta[:, 40:80], depths.holes)
    assert is_magenta[:, :40].sum() == is_magenta[:, 80:].sum() == 0
    is_same = ~depths.holes & (np.abs(depths.exact - depths.filled) < 1e-6)
    assert is_same.sum() > 100
    difference = image[:, :40].astype(int) - image[:, 80:]
    assert np.abs(difference[is_same]).max() <= 1


def test_the_command_writes_the_image_and_counts_holes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, reports = tmp_path / "moved.png", []
    arguments = ["debug", "reprojection", "city:blocks=3", "--frame", "600", "--size", "160x96"]
    for step in ("4", "24"):
        assert main([*arguments, "--step", step, "--backend", "gl", "--output", str(path), "--json"]) == 0
        reports.append(json.loads(capsys.readouterr().out))
    assert path.stat().st_size > 0
    assert 0.0 < reports[0]["holes"] < reports[1]["holes"] < 1.0


def test_a_device_that_draws_nothing_has_no_image_of_its_depth(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "moved.png"
    with pytest.raises(SystemExit):
        main(["debug", "reprojection", "city:blocks=3", "--backend", "null", "--output", str(path)])
    assert "there is no image" in capsys.readouterr().err
    assert not path.exists()
