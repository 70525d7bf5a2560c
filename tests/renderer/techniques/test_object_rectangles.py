"""Rectangles of materials around the boxes of their objects (Deferred+, Listing 1.7)."""

from __future__ import annotations

import numpy as np
import pytest
from frames import draw_each, max_difference, open_renderer
from nightly_reasons import ONLY_KERNELS

import rhi
from renderer.content import load_scene
from renderer.scene import Camera, Depth, Orthographic, Perspective
from renderer.techniques import DeferredPlus
from renderer.techniques.parts.material_rectangles import MaterialRectangles, bound_materials
from tests.renderer.techniques.test_deferred_plus import EYE, SIZE, scatter

CAMERAS = {
    "reversed depth": EYE,
    "standard depth": EYE.with_projection(Perspective(depth=Depth.STANDARD)),
    "parallel": EYE.with_projection(Orthographic(9.0, near=0.0, far=40.0)),
    "inside of objects": Camera.look_at((0, 0.5, 1), (0, 0, -3)),
    "at the edge": Camera.look_at((9, 2, 9), (30, 2, 0)),
}


@pytest.mark.nightly_cases("cl-*", reason=ONLY_KERNELS)
@pytest.mark.parametrize("camera", CAMERAS)
def test_no_pixel_differs_from_rectangles_around_pixels(drawing_device: rhi.Device, camera: str) -> None:
    techniques = DeferredPlus(multi_pass=True), DeferredPlus(object_rectangles=True)
    around_pixels, around_boxes = draw_each(
        drawing_device, scatter(20, unused=3), *techniques, camera=CAMERAS[camera], size=SIZE
    )
    assert max_difference(around_pixels, around_boxes) == 0
    assert np.ptp(around_pixels[..., :3]) > 20


@pytest.mark.parametrize("camera", CAMERAS)
def test_rectangles_around_boxes_hold_those_around_pixels(gl: rhi.Device, camera: str) -> None:
    scene, eye = scatter(20, unused=3), CAMERAS[camera].with_aspect(SIZE[0] / SIZE[1])
    with open_renderer(gl, scene, DeferredPlus(multi_pass=True), size=SIZE) as renderer:
        renderer.render(eye)
        tight = renderer.view.workspace(MaterialRectangles).read()
        renderer.technique = DeferredPlus(object_rectangles=True)
        renderer.render(eye)
        drawn = renderer.view.workspace(MaterialRectangles).read()
    around = {material: (x, y, x + width, y + height) for material, x, y, width, height in drawn.tolist()}
    assert len(around) == len(drawn)
    for material, x, y, width, height in tight.tolist():
        left, top, right, bottom = around[material]
        assert left <= x
        assert top <= y
        assert x + width <= right
        assert y + height <= bottom


def test_a_scene_out_of_view_has_no_rectangle() -> None:
    away = Camera.look_at((0, 40, 0), (0, 80, 1))
    assert len(bound_materials(scatter(5), away, SIZE)) == 0
    assert len(bound_materials(scatter(5), EYE, SIZE)) == 5


def test_a_box_that_the_near_plane_cuts_has_the_whole_image() -> None:
    inside = bound_materials(scatter(1, objects=0), Camera.look_at((0, -1, 0), (1, -1, 0)), SIZE)
    assert inside.tolist() == [[0, 0, 0, *SIZE]]


def test_rectangles_of_objects_are_smaller_than_the_image() -> None:
    _, _, _, width, height = bound_materials(scatter(60), EYE, SIZE).T
    assert (width * height).min() < 0.05 * SIZE[0] * SIZE[1]


def test_boxes_save_the_dispatches_that_look_for_pixels(null: rhi.Device) -> None:
    scene, counts = load_scene("grid:count=4"), []
    for technique in (DeferredPlus(multi_pass=True), DeferredPlus(object_rectangles=True)):
        null.stream.clear()
        with open_renderer(null, scene, technique, size=SIZE) as renderer:
            renderer.render(next(iter(scene.views.values())))
            counts.append([len(null.stream.filter(op)) for op in (rhi.Op.DISPATCH, rhi.Op.DRAW_INDIRECT)])
    assert counts == [[4, 2], [3, 2]]
