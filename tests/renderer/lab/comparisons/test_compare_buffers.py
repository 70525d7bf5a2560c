"""`compare buffers`: what layouts of the geometry buffer hold, take and lose."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from command_reports import read_report
from numpy.typing import NDArray

import rhi
from renderer.content import load_scene, parse_camera
from renderer.lab.comparisons.buffer_comparison import OWN
from renderer.lab.measure.published_buffers import LAYOUTS, PublishedBuffer
from renderer.renderer import Renderer
from renderer.techniques import ClusteredDeferred, Technique
from tests.renderer.conftest import open_device

SCENE = "hall:columns=4,rows=2,lights=8"
SIZE = (128, 72)


def draw(device: rhi.Device, technique: Technique) -> NDArray[np.int64]:
    scene = load_scene(SCENE)
    camera = parse_camera("ground", scene, 600)
    with Renderer(device, scene, technique=technique, visibility="frustum", size=SIZE) as renderer:
        return np.asarray(renderer.render(camera, 10.0).image.read()[..., :3], np.int64)


@pytest.fixture(scope="module")
def rows() -> dict[str, dict[str, Any]]:
    arguments = [SCENE, "--camera", "ground", "--frame", "600", "--size", "128x72", "--rounds", "2"]
    with open_device("gl"):
        report = read_report("compare", "buffers", *arguments, "--backend", "gl", "--json")
    return {row["layout"]: row for row in report["rows"]}


def test_each_layout_has_a_row_with_its_bytes(rows: dict[str, dict[str, Any]]) -> None:
    assert list(rows) == [OWN, *LAYOUTS]
    bytes_per_pixel = {name: row["bytes_per_pixel"] for name, row in rows.items()}
    # 8 of surface, 4 or 8 of material, 4 of depth; three or two times 8, light, depth; three times 4, a float, depth.
    assert bytes_per_pixel[OWN] in (16, 20)
    assert bytes_per_pixel["wilks_deferred"] == bytes_per_pixel["wilks_tiled"] == 36
    assert bytes_per_pixel["placeres"] == bytes_per_pixel["hargreaves"] == 20
    assert all(row["milliseconds"] > 0.0 for row in rows.values())


def test_layouts_that_store_less_are_farther_from_forward_shading(rows: dict[str, dict[str, Any]]) -> None:
    errors = [rows[name]["mean_error"] for name in (OWN, "hargreaves", "wilks_tiled", "placeres")]
    assert errors == sorted(errors)
    assert errors[0] < 0.1
    assert 0.1 < errors[1] < 3.0, "highlights in 8 bits"
    assert errors[2] > 3.0, "no highlights"
    assert errors[3] > 2.0 * errors[2], "no colors"


@pytest.mark.parametrize("name", LAYOUTS)
def test_a_layout_draws_the_same_image_on_all_devices(name: str) -> None:
    """But for rounding: a device may round a stored half or byte up or down."""
    images = []
    for backend in ("gl", "wgpu"):
        with open_device(backend) as device:
            images.append(draw(device, PublishedBuffer(name)))
    difference = np.abs(images[0] - images[1]).max(axis=2)
    assert images[0].std() > 20.0
    assert (difference > 2).mean() < 0.002


def test_hargreaves_layout_shows_highlights_and_wilks_does_not() -> None:
    with open_device("gl") as device:
        own, wilks, hargreaves = (
            draw(device, technique)
            for technique in (
                ClusteredDeferred(),
                PublishedBuffer("wilks_tiled"),
                PublishedBuffer("hargreaves"),
            )
        )
    is_highlight = (own - wilks).min(axis=2) > 30
    assert is_highlight.sum() > 20
    assert np.abs(own - hargreaves)[is_highlight].mean() < 0.2 * np.abs(own - wilks)[is_highlight].mean()
