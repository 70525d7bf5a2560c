"""The grid on the ground: where its lines are, what hides them, and what it costs."""

from __future__ import annotations

import numpy as np
import pytest
from frames import make_boxes, open_renderer

import rhi
from renderer.layers.ground_grid import GroundGrid
from renderer.scene import Camera, translation

SIZE = (180, 120)


@pytest.mark.parametrize("x", [0.0, 3.25, 1e6 - 0.5, -7.0])
def test_grid_lines_are_a_metre_apart_and_hidden_by_nearer_objects(
    drawing_device: rhi.Device, x: float
) -> None:
    scene = make_boxes(translation((x, 0.5, 3.0)), name="box").build()
    camera = Camera.look_at((x, 10.0, 0.0), (x, 0.0, 0.0), up=(0, 0, -1)).with_aspect(1.5)
    with open_renderer(drawing_device, scene, size=SIZE) as renderer:
        plain = renderer.render(camera).image.read().astype(int)
        layer = GroundGrid(drawing_device)
        renderer.layers.append(layer)
        result = renderer.render(camera)
        with_grid, depth = result.image.read().astype(int), result.depth.read()
        layer.destroy()
    changed = (with_grid - plain).max(-1)
    width, height = SIZE
    metres = 10.0 / (0.5 * height * camera.projection.matrix[1, 1])  # a pixel
    across = x + (np.arange(width) + 0.5 - 0.5 * width) * metres
    row = height // 2 + int(0.5 / metres)  # between two lines along x
    from_line = np.abs(across - np.round(across))
    assert (changed[row] > 10)[from_line < 0.4 * metres].all()
    assert not changed[row][from_line > 1.5 * metres].any()
    strong = (from_line < 0.4 * metres) & (np.round(across) % 10 == 0)
    weak = (from_line < 0.4 * metres) & ~strong
    if strong.any():
        assert changed[row][strong].min() > changed[row][weak].max()
    is_box = depth > 1.001 * depth[0, 0]
    assert is_box.sum() > 20
    assert not changed[is_box].any()


def test_it_is_one_draw(null: rhi.Device) -> None:
    with open_renderer(null, make_boxes(translation((0, 0, 0)), name="box").build(), size=SIZE) as renderer:
        camera = Camera.look_at((0, 5, 5), (0, 0, 0))
        renderer.render(camera)
        counts = [null.statistics.draws]
        for layers in ([], [GroundGrid(null)]):
            renderer.layers[:] = layers
            renderer.render(camera)
            counts.append(null.statistics.draws)
        renderer.layers.pop().destroy()
    assert np.diff(np.diff(counts)) == 1
