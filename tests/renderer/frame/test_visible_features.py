"""The features of surfaces in view: found by witnesses, and settled upon after a while."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from frames import EYE, make_boxes, open_renderer
from hypothesis import given
from hypothesis import strategies as st

import rhi
from renderer.content import BUILT_IN
from renderer.frame import Effect, VisibleFeatures, collect_frame_effects
from renderer.frame.visible_features import PATIENCE
from renderer.scene import AlphaMode, Bloom, Camera, Scene, SceneBuilder, make_height_field, translation
from renderer.techniques import TECHNIQUES
from renderer.visibility.boxes.volumes import select_in_view
from rhi import Op
from rhi.testing import frames

BEHIND, BEFORE = (0.0, 0.0, 60.0), (3.0, 0.0, -2.0)
AWAY = Camera.look_at((0, 0, 10), (0, 0, 60))


def add_box(builder: SceneBuilder, position: tuple[float, float, float], **material: Any) -> None:
    row = builder.add_material(**material)
    builder.add_objects(builder.add_node(translation(position)), builder.add_mesh(BUILT_IN["box"]()), row)


def add_image(builder: SceneBuilder) -> int:
    return builder.add_image(np.full((4, 4, 4), (128, 128, 255, 255), np.uint8))


HOLES = np.full((4, 4, 4), 255, np.uint8)
HOLES[:2, :, 3] = 0
MATERIALS: dict[str, Callable[[SceneBuilder], dict[str, Any]]] = {
    "images": lambda b: {"texture": add_image(b)},
    "emission": lambda b: {"emission": 0.5},
    "metals": lambda b: {"metallic": 1.0},
    "emissive colors": lambda b: {"emissive": (0.5, 0.0, 0.0)},
    "normal maps": lambda b: {"normal_texture": add_image(b)},
    "occlusion maps": lambda b: {"occlusion_texture": add_image(b)},
    "light maps": lambda b: {"light_map_texture": add_image(b)},
    "two sides": lambda b: {"double_sided": True},
}


def make(name: str, position: tuple[float, float, float]) -> Scene:
    builder = make_boxes((0, 0, 0))
    add_box(builder, position, **MATERIALS[name](builder))
    return builder.build()


def test_a_mask_is_needed_where_an_object_that_it_cuts_is_in_view() -> None:
    def enable(position: tuple[float, float, float]) -> frozenset[Effect]:
        builder = make_boxes((0, 0, 0))
        add_box(builder, position, alpha_mode=AlphaMode.MASK, texture=builder.add_image(HOLES))
        return collect_frame_effects(builder.build(), EYE).enabled

    assert enable(BEFORE) - enable(BEHIND) == {Effect.MASKS, Effect.IMAGES}


@pytest.mark.parametrize("name", MATERIALS)
def test_a_feature_is_needed_where_an_object_that_has_it_is_in_view(name: str) -> None:
    before, behind = (
        collect_frame_effects(make(name, BEFORE), EYE),
        collect_frame_effects(make(name, BEHIND), EYE),
    )
    assert before.enabled == {Effect(name)}
    assert not behind.enabled
    assert behind.explain(Effect(name)).endswith(", none in view")


def test_bloom_is_needed_where_something_that_shines_is_in_view() -> None:
    scene = make_boxes((0, 0, 0), emission=3.0, base_color=(1.0, 1.0, 1.0)).build()
    scene.bloom = Bloom(0.1)
    assert Effect.BLOOM in collect_frame_effects(scene, EYE).enabled
    unseen = collect_frame_effects(scene, AWAY)
    assert Effect.BLOOM not in unseen.enabled
    assert (
        unseen.explain(Effect.BLOOM) == "1 object emits more light than a white surface reflects, out of view"
    )


@given(
    st.lists(
        st.tuples(*[st.floats(-30, 30)] * 3, st.sampled_from(sorted(MATERIALS))), min_size=1, max_size=12
    )
)
def test_no_feature_in_view_is_left_out_whatever_was_seen_before(
    placed: list[tuple[float, float, float, str]],
) -> None:
    builder = make_boxes((0, 0, 0))
    for x, y, z, name in placed:
        add_box(builder, (x, y, z), **MATERIALS[name](builder))
    scene = builder.build()
    seen = VisibleFeatures(scene)
    for target in ((0, 0, 0), (0, 0, 60), (40, 0, 10), (0, 9, 0), (0, 0, 0)):
        camera = Camera.look_at((0, 0, 10), target)
        visible = select_in_view(scene, camera, np.arange(len(scene.objects)))
        assert seen.collect(camera) == {name for row, (*_, name) in enumerate(placed, 1) if row in visible}


def test_features_out_of_view_leave_the_shaders_after_a_while_and_come_back_at_once() -> None:
    scene = make("metals", BEHIND)
    seen = VisibleFeatures(scene)
    assert [seen.choose_shader_features(EYE) for _ in range(PATIENCE + 1)] == [{"metals"}] * PATIENCE + [
        set()
    ]
    assert seen.choose_shader_features(AWAY) == {"metals"}
    assert [seen.choose_shader_features(EYE) for _ in range(10)][-1] == set()
    scene.materials["emission"] = 1.0
    scene.refresh()
    assert "emission" in seen.choose_shader_features(EYE)


@pytest.mark.parametrize(("name", "technique"), [("metals", "forward"), ("normal maps", "deferred")])
def test_the_image_stays_when_shaders_become_leaner(name: str, technique: str) -> None:
    scene = make(name, BEHIND)
    scene.lights.add_directional((0.3, -1.0, -0.5))
    with rhi.create_device("gl") as device, open_renderer(device, scene, TECHNIQUES[technique]()) as renderer:
        images, programs = [], []
        for _ in range(PATIENCE + 1):
            result = renderer.render(EYE)
            programs.append(Effect(name) in result.frames[0].effects.enabled)
            if len(programs) in (1, PATIENCE + 1):
                images.append(result.image.read())
    assert programs == [True] * PATIENCE + [False]
    assert images[0][..., :3].any()
    assert np.array_equal(*images)


def test_a_mask_behind_the_eye_still_cuts_its_shadow() -> None:
    images = []
    for alpha in (255, 0):
        builder = make_boxes((0, 0, 0))
        builder.lights.add_directional((0.0, -0.2, -1.0), casts_shadow=True)
        texels = np.full((4, 4, 4), (255, 255, 255, alpha), np.uint8)
        add_box(builder, (0, 2.6, 13.0), texture=builder.add_image(texels), alpha_mode=AlphaMode.MASK)
        with (
            rhi.create_device("gl") as device,
            open_renderer(device, builder.build(), size=(192, 128)) as renderer,
        ):
            for frame in range(PATIENCE + 2):  # the eye moves, so the map of the sun is drawn again
                result = renderer.render(Camera.look_at((0.05 * frame, 0, 10), (0, 0, 0)))
            assert Effect.MASKS not in result.frames[0].effects.enabled
            images.append(result.image.read()[..., :3].astype(int))
    solid, cut = images
    assert (np.abs(solid - cut).max(-1) > 8).sum() > 40


@pytest.mark.parametrize("has_shadow", [False, True])
def test_a_terrain_behind_the_eye_is_tessellated_only_for_its_shadow(has_shadow: bool) -> None:
    builder = make_boxes((0, 0, 0))
    builder.lights.add_directional((0.3, -1.0, 0.2), casts_shadow=has_shadow)
    mesh = builder.add_height_field(make_height_field(np.zeros((33, 33)), 16.0))
    builder.add_objects(builder.add_node(translation((0, -2, 60))), mesh, builder.add_material())
    with (
        rhi.create_device("null") as device,
        open_renderer(device, builder.build(), visibility="frustum") as renderer,
    ):
        for frame in range(3):
            renderer.render(Camera.look_at((0, 0.01 * frame, 10), (0, 0, 0)))
        away = len(frames(device)[-1].filter(Op.DISPATCH))
        renderer.render(Camera.look_at((0, 0, 10), (0, 0, 60)))
        seen = len(frames(device)[-1].filter(Op.DISPATCH))
    assert (away > 0) is has_shadow
    assert seen > 0


def make_shining() -> Scene:
    """Return a box that blooms, in sunlight with shadows."""
    builder = make_boxes((0, 0, 0), emission=3.0, base_color=(1.0, 1.0, 1.0))
    builder.lights.add_directional((-0.3, -1, -0.5), casts_shadow=True)
    builder.bloom = Bloom(0.1)
    return builder.build()


SKY = Camera.look_at((0, 0, 10), (0, 60, 11))


def list_commands(device: rhi.Device, scene: Scene, camera: Camera) -> list[Op]:
    """Return the commands of the second frame of a view."""
    with open_renderer(device, scene, visibility="frustum") as renderer:
        renderer.render(camera)
        device.stream.clear()
        renderer.render(camera)
        return [command.op for command in device.stream]


def test_a_view_without_objects_has_the_commands_of_a_scene_without_effects(null: rhi.Device) -> None:
    """Bloom had 12 passes there for 60 frames, and the sun's shadows an empty pair of labels for ever."""
    assert list_commands(null, make_shining(), SKY) == list_commands(null, make_boxes((0, 0, 0)).build(), SKY)
    seen = list_commands(null, make_shining(), EYE)
    assert seen.count(Op.BEGIN_PASS) > 12, "control: it blooms where it is in view"


def test_an_object_that_comes_into_an_empty_view_has_its_effects_in_that_frame(null: rhi.Device) -> None:
    scene = make_shining()
    needed = {Effect.BLOOM, Effect.DIRECTIONAL_SHADOWS}
    with open_renderer(null, scene, visibility="frustum") as renderer:
        for camera, frames_of_view in ((SKY, 15), (EYE, 1), (SKY, 11), (EYE, 1)):
            for _ in range(frames_of_view):
                null.stream.clear()
                renderer.render(camera)
            labels = [command["text"] for command in null.stream.filter(Op.PUSH_LABEL)]
            assert {"bloom", "shadow maps"}.issubset(labels) is (camera is EYE)
            enabled = renderer.plan(camera)[0].enabled
            assert needed.issubset(enabled) is (camera is EYE)
            assert needed.isdisjoint(enabled) is (camera is SKY)


@given(st.lists(st.tuples(st.floats(-90, 90), st.booleans()), min_size=1, max_size=40))
def test_no_view_with_an_object_counts_as_empty(turns: list[tuple[float, bool]]) -> None:
    builder = make_boxes((0, 0, 0))
    add_box(builder, (6.0, 3.0, -4.0))
    scene = builder.build()
    seen = VisibleFeatures(scene)
    for x, is_up in turns:
        camera = Camera.look_at((0, 0, 10), (x, 80.0 if is_up else 0.0, 0))
        seen.choose_shader_features(camera)
        visible = select_in_view(scene, camera, np.arange(len(scene.objects)))
        assert seen.shows_objects or not len(visible)
