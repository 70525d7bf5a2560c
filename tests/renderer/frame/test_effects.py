"""The effects of a frame: those that the scene has and the view shows."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from frames import EYE, make_boxes
from hypothesis import given
from hypothesis import strategies as st

from renderer.content import load_scene
from renderer.frame import Effect, collect_frame_effects
from renderer.lights.frustum_culling import select_lights_in_view
from renderer.scene import Camera, Frustum, Scene, SceneBuilder

AWAY = Camera.look_at((0, 0, 10), (0, 0, 20))


def build(change: Callable[[SceneBuilder], object] = lambda _: None, emission: float = 0.0) -> Scene:
    builder = make_boxes((0, 0, 0), emission=emission)
    change(builder)
    return builder.build()


CHANGES: dict[Effect, Callable[[SceneBuilder], object]] = {
    Effect.DIRECTIONAL_LIGHTS: lambda b: b.lights.add_directional((0, -1, 0)),
    Effect.POINT_LIGHTS: lambda b: b.lights.add_point((0, 2, 0), 4.0),
    Effect.SPOT_LIGHTS: lambda b: b.lights.add_spot((0, 2, 0), (0, -1, 0), 4.0, 0.3, 0.5),
    Effect.HAZE: lambda b: setattr(b, "haze", 0.1),
}


def test_a_plain_scene_needs_nothing() -> None:
    effects = collect_frame_effects(build(), EYE)
    assert not effects.enabled
    assert effects.explain(Effect.POINT_LIGHTS) == "the scene has no point light"
    assert effects.explain(Effect.HAZE) == "the scene has no haze"


@pytest.mark.parametrize("effect", CHANGES)
def test_each_part_of_a_scene_calls_for_its_effect_alone(effect: Effect) -> None:
    assert collect_frame_effects(build(CHANGES[effect]), EYE).enabled == {effect}


@pytest.mark.parametrize(("emission", "enabled"), [(0.0, set()), (0.5, {Effect.EMISSION})])
def test_a_material_that_emits_light_calls_for_emission(emission: float, enabled: set[Effect]) -> None:
    assert collect_frame_effects(build(emission=emission), EYE).enabled == enabled


@pytest.mark.parametrize("effect", [Effect.POINT_LIGHTS, Effect.SPOT_LIGHTS])
def test_lights_are_needed_where_their_light_is_in_view(effect: Effect) -> None:
    scene = build(CHANGES[effect])
    assert collect_frame_effects(scene, EYE).enabled == {effect}
    unseen = collect_frame_effects(scene, AWAY)
    assert not unseen.enabled
    assert unseen.explain(effect) == f"the only {effect.value[:-1]} doesn't reach what is in view"


@pytest.mark.parametrize(("reaches", "count"), [((True, True), 2), ((False, True), 1), ((False, False), 0)])
def test_lights_that_reach_no_object_are_not_needed(reaches: tuple[bool, bool], count: int) -> None:
    scene = build(lambda b: (CHANGES[Effect.POINT_LIGHTS](b), CHANGES[Effect.SPOT_LIGHTS](b)))
    assert len(collect_frame_effects(scene, EYE, reaches=reaches).enabled) == count


@pytest.mark.parametrize(("count", "has_single_directional_light"), [(0, False), (1, True), (2, False)])
def test_a_single_directional_light_is_a_sun(count: int, has_single_directional_light: bool) -> None:
    scene = build(lambda b: [b.lights.add_directional((0, -1, 0)) for _ in range(count)])
    assert collect_frame_effects(scene, EYE).has_single_directional_light is has_single_directional_light


def test_the_key_is_the_same_while_the_effects_are() -> None:
    city = load_scene("city:blocks=6")
    path = city.paths["ground"]
    here, there = (collect_frame_effects(city, path.camera(frame)) for frame in (0, 1))
    assert here.key == there.key
    assert collect_frame_effects(build(), EYE).key != here.key


def test_frame_effects_are_reused_until_the_scene_or_the_lights_in_view_change() -> None:
    scene = build(CHANGES[Effect.POINT_LIGHTS])
    effects = collect_frame_effects(scene, EYE)
    assert collect_frame_effects(scene, EYE, last=effects) is effects
    unseen = collect_frame_effects(scene, AWAY, last=effects)
    assert (unseen is effects, unseen.sources is effects.sources) == (False, True)
    scene.lights.point["source_radius"] = 0.5
    assert collect_frame_effects(scene, EYE, last=effects).enabled == effects.enabled | {Effect.POINT_SPHERES}


def test_the_reasons_count_the_lights() -> None:
    scene = build(lambda b: [b.lights.add_point((0, 2, z), 4.0) for z in (0, 0, 40)])
    effects = collect_frame_effects(scene, EYE)
    assert effects.in_view[Effect.POINT_LIGHTS].tolist() == [0, 1]
    assert effects.explain(Effect.POINT_LIGHTS) == "2 of 3 point lights reach what is in view"
    assert (
        collect_frame_effects(scene, AWAY).explain(Effect.POINT_LIGHTS)
        == "1 of 3 point lights reaches what is in view"
    )
    away = Camera.look_at((0, 0, 10), (0, 40, 10))
    assert (
        collect_frame_effects(scene, away).explain(Effect.POINT_LIGHTS)
        == "none of 3 point lights reach what is in view"
    )


positions = st.tuples(*[st.floats(-50, 50)] * 3)


@given(st.lists(st.tuples(positions, st.floats(0, 30)), min_size=1, max_size=20))
def test_no_light_that_reaches_a_point_in_view_is_left_out(
    lights: list[tuple[tuple[float, ...], float]],
) -> None:
    where, ranges = np.array([p for p, _ in lights]), np.array([r for _, r in lights])
    planes = EYE.frustum.planes
    selected = select_lights_in_view(planes, where, ranges)
    # The point of each light's sphere that is farthest inside along each direction, and the centre.
    rng = np.random.default_rng(0)
    ways = rng.normal(size=(200, 3))
    ways = np.vstack([np.zeros(3), ways / np.linalg.norm(ways, axis=1, keepdims=True), planes[:, :3]])
    for row in range(len(where)):
        points = where[row] + ranges[row] * ways
        if ((points @ planes[:, :3].T + planes[:, 3]) >= 0).all(1).any():
            assert row in selected


@pytest.mark.parametrize(("distance", "expected"), [(-1e-9, [0]), (1e-9, [])])
def test_a_light_is_in_view_if_its_range_reaches_the_plane(distance: float, expected: list[int]) -> None:
    planes = Frustum(np.array([[1.0, 0.0, 0.0, 0.0]])).planes
    assert (
        select_lights_in_view(planes, np.array([[-3.0 - distance, 0, 0]]), np.array([3.0])).tolist()
        == expected
    )
