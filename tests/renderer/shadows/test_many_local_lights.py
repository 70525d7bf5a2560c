"""A hall in which a thousand local lights cast shadows, compared with rays."""

from __future__ import annotations

import numpy as np
import pytest
from frames import open_renderer, read_colors
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

import rhi
from renderer.content import load_scene
from renderer.lab.measure.ray_tracer import RayTracer
from renderer.techniques import TECHNIQUES

SIZE = 240, 135


def look_around(image: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the 3 × 3 pixels around each pixel, in the last axes."""
    return sliding_window_view(np.pad(image, ((1, 1), (1, 1), (0, 0)), mode="edge"), (3, 3), axis=(0, 1))


@pytest.mark.nightly
@pytest.mark.parametrize("view", ["aisle", "overview"])
def test_a_thousand_local_lights_have_maps_and_light_nothing_through_a_wall(
    drawing_device: rhi.Device, view: str
) -> None:
    scene = load_scene("hall:shadows=1,lights=1000,fountains=0")
    camera = scene.views[view].with_aspect(SIZE[0] / SIZE[1])
    reference, unshaded = (
        RayTracer(scene, has_shadows=has_shadows).draw(camera, SIZE) for has_shadows in (True, False)
    )
    with open_renderer(drawing_device, scene, TECHNIQUES["clustered"](), size=SIZE) as renderer:
        image = read_colors(renderer.render(camera)).astype(np.float64)
        assert renderer.shadows.unshadowed_lights == 0
        assert len(renderer.shadows.tiles) > 5000
    in_shadow = (look_around(unshaded - reference) > 4.0).all((-1, -2))  # well inside: an edge may be blurred
    assert in_shadow.sum() > 200
    assert not (image > look_around(reference).max((-1, -2)) + 4.0)[in_shadow].any()
    assert np.abs(image - reference).mean() < 1.0  # of 255: and neither are they dark
