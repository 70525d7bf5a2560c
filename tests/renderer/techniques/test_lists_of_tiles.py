"""Lists of tiles: pixels of Deferred+ and transparent surfaces of Forward+ that are lit by them."""

from __future__ import annotations

from typing import Any

import pytest
from frames import draw_each, make_boxes, max_difference, open_renderer
from nightly_reasons import ONLY_KERNELS

import rhi
from renderer.frame import Blending
from renderer.lab.measure.light_evaluations import count_light_evaluations
from renderer.lab.measure.plan_report import describe_plan
from renderer.renderer import Renderer
from renderer.scene import (
    AlphaMode,
    Camera,
    Depth,
    Orthographic,
    Perspective,
    Scene,
    SceneBuilder,
    scaling,
    translation,
)
from renderer.techniques import DeferredPlus, ForwardPlus
from renderer.techniques.parts.light_list_reader import TILES, ClusterSettings, TilesInFront
from renderer.visibility import NoCulling
from tests.renderer.techniques.test_technique_pixels import EYE, SIZE, add_random_lights, stage


def wall(distance_to_light: float, reach: float) -> Scene:
    """Make a wall that fills the image, 5 m from the eye, a light before it, and one that reaches all of it."""
    builder = make_boxes(translation((0, 0, -5.05)) @ scaling((40, 40, 0.1)))
    builder.lights.add_point((0, 0, -1), 100.0)
    builder.lights.add_point((0, 0, distance_to_light - 5.0), reach)
    builder.views["eye"] = Camera.look_at((0, 0, 0), (0, 0, -1))
    return builder.build()


def count(device: rhi.Device, scene: Scene, technique: DeferredPlus) -> int | None:
    with Renderer(device, scene, technique=technique, visibility=NoCulling(scene), size=(64, 48)) as renderer:
        return count_light_evaluations(renderer, scene.views["eye"])


@pytest.mark.nightly_cases("cl-*", reason=ONLY_KERNELS)
@pytest.mark.parametrize("options", [{}, {"multi_pass": True}, {"binned": True}, {"samples": 4}], ids=str)
def test_lists_of_tiles_give_the_image_of_lists_of_clusters(
    drawing_device: rhi.Device, options: dict[str, Any]
) -> None:
    """Both add up the same lights; those that reach a pixel are in both lists, in the same order."""
    builder = stage()
    add_random_lights(builder, 40, seed=5)
    by_clusters, by_tiles = DeferredPlus(**options), DeferredPlus(**options, tiled=True)
    expected, image = draw_each(drawing_device, builder.build(), by_clusters, by_tiles, camera=EYE, size=SIZE)
    assert max_difference(image, expected) <= 1


def test_tiles_end_at_their_surfaces_and_clusters_behind_them(gl: rhi.Device) -> None:
    """The first light ends 0.1 m before the wall, in the cluster that the wall is in; the second one reaches it."""
    pixels = 64 * 48
    for reach, looked_at in ((0.3, (2 * pixels, pixels)), (0.5, (2 * pixels, 2 * pixels))):
        scene = wall(0.4, reach)
        by_clusters = count(gl, scene, DeferredPlus())
        by_tiles = count(gl, scene, DeferredPlus(tiled=True, tiles=ClusterSettings(64)))
        assert (by_clusters, by_tiles) == looked_at


def test_tiles_end_at_depth_with_one_sample_only() -> None:
    for samples, reads in ((1, ["depth"]), (4, [])):
        report = describe_plan(wall(0.4, 1.0), DeferredPlus(samples, tiled=True), EYE, SIZE)
        assert next(entry for entry in report.passes if entry.name == "light lists").reads == reads


@pytest.mark.parametrize(("tiles", "cells"), [(TILES, 6 * 4), (ClusterSettings(32), 3 * 2)])
def test_the_size_of_tiles_is_a_setting(null: rhi.Device, tiles: ClusterSettings, cells: int) -> None:
    with open_renderer(null, wall(0.4, 1.0), DeferredPlus(tiled=True, tiles=tiles), size=SIZE) as renderer:
        renderer.render(EYE)
        assert renderer.view.workspace(tiles).cells == cells


# transparent surfaces of Forward+


CAMERAS = {
    "reversed depth": EYE,
    "standard depth": EYE.with_projection(Perspective(depth=Depth.STANDARD)),
    "a far plane through lights": EYE.with_projection(Perspective(far=11.0)),
    "parallel, from behind the eye": EYE.with_projection(
        Orthographic(9.0, near=-3.0, far=12.0, depth=Depth.STANDARD)
    ),
}


def add_panes(builder: SceneBuilder) -> None:
    """Add panes before, between and beside the objects of a stage, some before the background."""
    for number, position in enumerate([(-2, 1, 5), (1, 1, 3), (3, 2, 0), (0, 6, -4), (-5, 1, -3)]):
        pane = builder.add_material(
            base_color=(0.9, 0.5, 0.2 * number, 0.6),
            alpha_mode=AlphaMode.BLEND,
            specular_color=(0.4, 0.4, 0.4),
        )
        builder.add_objects(builder.add_node(translation(position) @ scaling((3, 3, 0.2))), 0, pane)


@pytest.mark.nightly_cases("cl-*", reason=ONLY_KERNELS)
@pytest.mark.parametrize("blending", Blending)
@pytest.mark.parametrize("projection", CAMERAS)
def test_lists_of_tiles_give_transparent_surfaces_the_light_of_their_objects_lists(
    drawing_device: rhi.Device, projection: str, blending: Blending
) -> None:
    builder = stage()
    add_random_lights(builder, 40, seed=6)
    without_panes = builder.build()
    add_panes(builder)
    scene = builder.build()
    images = [
        draw_each(drawing_device, drawn, technique, camera=CAMERAS[projection], size=SIZE, blending=blending)[
            0
        ]
        for drawn, technique in (
            (scene, ForwardPlus()),
            (scene, ForwardPlus(tiled_transparency=True)),
            (without_panes, ForwardPlus()),
        )
    ]
    assert max_difference(images[0], images[1]) <= 1
    assert max_difference(images[0], images[2]) > 20, "panes are seen"


def test_transparent_surfaces_of_several_samples_are_lit_by_the_tiles_of_opaque_ones(gl: rhi.Device) -> None:
    builder = stage()
    add_random_lights(builder, 40, seed=6)
    add_panes(builder)
    techniques = ForwardPlus(4), ForwardPlus(4, tiled_transparency=True)
    expected, image = draw_each(gl, builder.build(), *techniques, camera=EYE, size=SIZE)
    assert max_difference(image, expected) <= 1


def pane_before_a_wall(*distances: float, has_wall: bool = True, has_pane: bool = True) -> Scene:
    """Make a pane 3 m from the eye, a wall 5 m from it, and lights of a range of 0.5 m straight ahead at these
    distances."""
    walls = [translation((0, 0, -5.05)) @ scaling((40, 40, 0.1))] if has_wall else []
    builder = make_boxes(*walls)
    if has_pane:
        pane = builder.add_material(base_color=(1, 1, 1, 0.5), alpha_mode=AlphaMode.BLEND)
        builder.add_objects(builder.add_node(translation((0, 0, -3)) @ scaling((4, 4, 0.1))), 0, pane)
    for distance in distances:
        builder.lights.add_point((0, 0, -distance), 0.5)
    builder.views["eye"] = Camera.look_at((0, 0, 0), (0, 0, -1))
    return builder.build()


@pytest.mark.parametrize(
    ("distance", "is_before_the_wall"),
    [(0.7, True), (3.0, True), (4.6, True), (5.3, True), (5.6, False), (8.0, False)],
)
def test_tiles_of_transparent_surfaces_reach_from_the_eye_to_the_farthest_opaque_one(
    gl: rhi.Device, distance: float, is_before_the_wall: bool
) -> None:
    """The list of opaque surfaces has the light only where it reaches the wall. The last light reaches farthest: a
    grid ends where its lights do."""
    technique = ForwardPlus(tiled_transparency=True)
    for has_wall, is_listed in ((True, is_before_the_wall), (False, True)):
        scene = pane_before_a_wall(3.0, distance, 20.0, has_wall=has_wall)
        with open_renderer(gl, scene, technique, size=SIZE) as renderer:
            renderer.render(scene.views["eye"])
            listed = renderer.view.workspace(TilesInFront(TILES)).read().lights
            opaque = renderer.view.workspace(TILES).read().lights
        assert (1 in listed) is is_listed
        assert (1 in opaque) is (has_wall and abs(distance - 5.0) < 0.5)
        assert 0 in listed
        assert 0 not in opaque


@pytest.mark.parametrize("has_pane", [False, True])
def test_only_frames_with_transparent_surfaces_have_lists_for_them(has_pane: bool) -> None:
    scene = pane_before_a_wall(5.0, 3.0, has_pane=has_pane)
    reports = [
        describe_plan(scene, ForwardPlus(tiled_transparency=on), scene.views["eye"], SIZE)
        for on in (False, True)
    ]
    usual, tiled = (
        [(entry.name, entry.dispatches, entry.draws) for entry in report.passes] for report in reports
    )
    added = [("transparent light lists", 4, 0)] if has_pane else []
    assert [entry for entry in tiled if entry not in usual] == added
    assert [entry for entry in tiled if entry in usual] == usual
