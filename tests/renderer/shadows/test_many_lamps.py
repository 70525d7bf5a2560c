"""A hall in which a thousand lamps cast shadows, compared with rays."""

from __future__ import annotations

import numpy as np
import pytest
from frames import open_renderer, read_colors
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

import rhi
from renderer.content import load_scene
from renderer.lab.measure.judge import Judge
from renderer.techniques import TECHNIQUES

SIZE = 240, 135


def look_around(picture: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the 3 × 3 pixels around each pixel, in the last axes."""
    return sliding_window_view(np.pad(picture, ((1, 1), (1, 1), (0, 0)), mode="edge"), (3, 3), axis=(0, 1))


@pytest.mark.nightly
@pytest.mark.parametrize("view", ["aisle", "overview"])
def test_a_thousand_lamps_have_maps_and_light_nothing_through_a_wall(drawing_device: rhi.Device, view: str) -> None:
    scene = load_scene("hall:shadows=1,lights=1000,fountains=0")
    camera = scene.views[view].with_aspect(SIZE[0] / SIZE[1])
    truth, unshaded = (Judge(scene, has_shadows=has_shadows).draw(camera, SIZE) for has_shadows in (True, False))
    with open_renderer(drawing_device, scene, TECHNIQUES["clustered"](), size=SIZE) as renderer:
        picture = read_colors(renderer.render(camera)).astype(np.float64)
        assert renderer.shadows.dark_lamps == 0
        assert len(renderer.shadows.tiles) > 5000
    in_shadow = (look_around(unshaded - truth) > 4.0).all((-1, -2))  # well inside: an edge may be blurred
    assert in_shadow.sum() > 200
    assert not (picture > look_around(truth).max((-1, -2)) + 4.0)[in_shadow].any()
    assert np.abs(picture - truth).mean() < 1.0  # of 255: and neither are they dark
