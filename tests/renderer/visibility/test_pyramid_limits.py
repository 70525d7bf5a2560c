"""Three cases in which a depth pyramid draws what is hidden, and rasterised boxes don't (Deferred+, Figures 1.8 to
1.10). Each has a control beside it, a scene of nearly the same shape in which the pyramid hides the object, too.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pytest
from nightly_reasons import ONLY_KERNELS
from tested_devices import open_device

import rhi
from renderer.content import BUILT_IN
from renderer.lab.measure.exact_visibility import ExactVisibility
from renderer.renderer import Renderer
from renderer.scene import Camera, Scene, SceneBuilder, rotation, scaling, translation
from rhi.math import multiply

SIZE = (256, 144)
EYE = Camera.look_at((0.0, 0.0, 0.0), (0.0, 0.0, -1.0))
OCCLUDER, OCCLUDEE = 0, 1


class Box(NamedTuple):
    """A box: its middle, its size, and the angle by which it is turned around an axis."""

    position: tuple[float, float, float]
    size: tuple[float, float, float]
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    degrees: float = 0.0


def make_scene(*boxes: Box) -> Scene:
    builder = SceneBuilder("boxes")
    mesh, grey = builder.add_mesh(BUILT_IN["box"]()), builder.add_material()
    for box in boxes:
        turned = multiply(rotation(box.axis, np.radians(box.degrees)), scaling(box.size))
        builder.add_objects(builder.add_node(multiply(translation(box.position), turned)), mesh, grey)
    return builder.build()


def make_bars(degrees: float) -> Scene:
    """A bar behind a longer and wider one, both turned around the view (Figure 1.8)."""
    return make_scene(
        Box((0.0, 0.0, -8.0), (6.0, 2.4, 0.1), degrees=degrees),
        Box((0.0, 0.0, -9.0), (4.0, 0.1, 0.1), degrees=degrees),
    )


def make_walls(degrees: float) -> Scene:
    """A wall that goes off into the distance, and a smaller one close behind it (Figure 1.9)."""
    away = rotation((0.0, 1.0, 0.0), np.radians(degrees)) @ (0.0, 0.0, -0.5, 1.0)
    behind = (0.0 + away[0], 0.0, -12.0 + away[2])
    return make_scene(
        Box((0.0, 0.0, -12.0), (14.0, 4.0, 0.05), (0.0, 1.0, 0.0), degrees),
        Box((float(behind[0]), 0.0, float(behind[2])), (8.0, 1.0, 0.05), (0.0, 1.0, 0.0), degrees),
    )


def make_panels(width: float) -> Scene:
    """A large panel behind a nearer one of this width, with the sky around both (Figure 1.10)."""
    return make_scene(Box((0.0, 0.0, -8.0), (width, width, 0.05)), Box((0.0, 0.0, -8.2), (6.0, 6.0, 0.05)))


CASES: dict[str, tuple[Any, float, float]] = {
    "1.8: an oblique object": (make_bars, 40.0, 0.0),
    "1.9: one depth for an object": (make_walls, 65.0, 0.0),
    "1.10: the sky in coarse levels": (make_panels, 6.15, 9.0),
}
"""By figure, what makes the scenes, the value of the figure's case, and that of its control."""


def draw_until_steady(device: rhi.Device, scene: Scene, visibility: str) -> set[int]:
    """The objects that an algorithm draws once it knows the view."""
    with Renderer(device, scene, size=SIZE, technique="forward", visibility=visibility) as renderer:
        for _ in range(4):
            result = renderer.render(EYE)
        return set(result.visible.tolist())


@pytest.mark.nightly_cases("cl*", "wgpu*", reason=ONLY_KERNELS)
@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("backend", ["gl", "cl", "wgpu"])
def test_a_pyramid_draws_a_hidden_object_that_rasterised_boxes_leave_out(backend: str, case: str) -> None:
    make, value, control_value = CASES[case]
    scene, control = make(value), make(control_value)
    with open_device(backend) as device:
        for tested in (scene, control):
            tested.update()
            assert ExactVisibility(device, tested, SIZE).visible_objects(EYE) == {OCCLUDER}
            assert draw_until_steady(device, tested, "frustum") == {OCCLUDER, OCCLUDEE}
            assert draw_until_steady(device, tested, "two_pass") == {OCCLUDER}
        assert draw_until_steady(device, scene, "depth_pyramid") == {OCCLUDER, OCCLUDEE}
        assert draw_until_steady(device, control, "depth_pyramid") == {OCCLUDER}
