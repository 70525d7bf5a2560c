"""The exact set of visible objects, found pixel by pixel."""

from __future__ import annotations

from occlusion_scenes import ORIGIN, WALL_POSITION, make_boxes, make_camera

import rhi
from renderer.lab.measure.exact_visibility import ExactVisibility

POSITIONS = [WALL_POSITION, (0.0, 0.0, -9.0), (3.0, 0.0, -9.0), (0.0, 0.0, 9.0), (0.013, 0.0, -2.0)]
SIZES = [(3.0, 3.0, 0.1), (1.0, 1.0, 1.0), (2.0, 1.0, 1.0), (1.0, 1.0, 1.0), (0.001, 0.001, 0.001)]


def test_an_object_that_covers_a_pixel_is_visible(device: rhi.Device) -> None:
    scene = make_boxes(POSITIONS, SIZES)
    scene.objects.mesh[:] = 0
    exact = ExactVisibility(device, scene, (64, 36))
    # 1 is behind the wall, 2 beside it, 3 behind the eye; 4 lies between centres of pixels, before the wall.
    assert exact.visible_objects(make_camera(ORIGIN, WALL_POSITION)) == {0, 2}
    assert exact.visible_objects(make_camera(ORIGIN, (0.0, 0.0, 9.0))) == {3}
    assert exact.visible_objects(make_camera((0.0, 0.0, -7.0), (0.0, 0.0, -9.0))) >= {1}
    exact.destroy()
