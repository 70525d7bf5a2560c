"""Rays that go on from surfaces bring what the laws of mirrors and of Snell and Fresnel say."""

from __future__ import annotations

import numpy as np
import pytest

from renderer.content import BUILT_IN
from renderer.lab.measure.ray_tracer import RayTracer
from renderer.lab.measure.ray_tracer.bounces import bend_rays
from renderer.lab.measure.ray_tracer.tracer import inverse_tone_map, tone_map
from renderer.scene import (
    AlphaMode,
    Camera,
    Environment,
    Perspective,
    Scene,
    SceneBuilder,
    scaling,
    translation,
)

PROJECTION = Perspective(fov=1.0, aspect=1.0)
BLACK = (0.0, 0.0, 0.0)
ALPHA = 0.01  # of glass; without any, it isn't drawn
GLASS = {"base_color": (1.0, 1.0, 1.0, ALPHA), "specular_color": BLACK, "alpha_mode": AlphaMode.BLEND}


def begin_scene(sky: tuple[float, float, float] = BLACK) -> SceneBuilder:
    """Begin a scene with light from the sky and the ground alone, and a black background."""
    builder = SceneBuilder("bounces")
    builder.background = BLACK
    builder.lights.sky = builder.lights.ground = sky
    return builder


def add_box(
    builder: SceneBuilder, middle: tuple[float, ...], sides: tuple[float, ...], **material: object
) -> None:
    """Add a box of a material of its own."""
    mesh, node = builder.add_mesh(BUILT_IN["box"]()), builder.add_node(translation(middle) @ scaling(sides))
    builder.add_objects(node, mesh, builder.add_material(**material))


def trace_light(
    scene: Scene, eye: tuple[float, ...], target: tuple[float, ...], **options: float
) -> np.ndarray:
    """Return the light (3,) that comes to an eye from the middle of its image."""
    camera = Camera.look_at(eye, target, projection=PROJECTION)
    color = RayTracer(scene, **options).trace(camera, (8, 8), np.array([(4.0, 4.0)]))
    return inverse_tone_map(color)[0]


def make_mirror(roughness: float = 0.0) -> SceneBuilder:
    """A mirror of metal in the plane z = 0, and a bright box to the right in front of it, which the eye doesn't see."""
    builder = begin_scene()
    add_box(
        builder, (0, 0, -0.5), (20, 20, 1), base_color=(0.9, 0.6, 0.3, 1.0), metallic=1.0, roughness=roughness
    )
    add_box(
        builder, (4, 0, 4), (1, 1, 1), base_color=(0, 0, 0, 1), specular_color=BLACK, emissive=(2.0, 1.0, 4.0)
    )
    return builder


def test_a_mirror_of_metal_returns_the_share_of_light_that_fresnels_approximation_says() -> None:
    scene = make_mirror().build()
    light = trace_light(scene, (-4, 0, 4), (0, 0, 0), bounces=1)
    base = np.array((0.9, 0.6, 0.3))
    share = base + (1.0 - base) * (1.0 - np.sqrt(0.5)) ** 5
    assert light == pytest.approx(share * (2.0, 1.0, 4.0), rel=2e-2)  # the model is as rough as .1


def test_a_mirror_shows_nothing_of_other_objects_without_bounces() -> None:
    assert trace_light(make_mirror().build(), (-4, 0, 4), (0, 0, 0)).max() < 1e-6


def test_an_object_beside_the_mirrored_ray_is_not_seen() -> None:
    assert trace_light(make_mirror().build(), (-4, 0, 4), (-1, 0, 0), bounces=1).max() < 1e-3


def test_a_mirror_in_a_mirror_takes_two_bounces() -> None:
    builder = begin_scene()
    metal = {"base_color": (1.0, 1.0, 1.0, 1.0), "metallic": 1.0, "roughness": 0.0}
    add_box(builder, (0, 0, -0.5), (20, 20, 1), **metal)
    add_box(builder, (6, 0, 4.5), (4, 20, 1), **metal)
    add_box(
        builder,
        (9.5, 0, 1),
        (1, 20, 1.9),
        base_color=(0, 0, 0, 1),
        specular_color=BLACK,
        emissive=(1.0, 1.0, 1.0),
    )
    scene = builder.build()
    once, twice = (trace_light(scene, (-2, 0, 4), (2, 0, 0), bounces=count)[0] for count in (1, 2))
    assert once < 1e-3
    assert twice == pytest.approx(1.0, rel=0.02)


def test_a_mirror_of_the_specular_model_returns_its_specular_color() -> None:
    builder = begin_scene()
    add_box(
        builder,
        (0, 0, -0.5),
        (20, 20, 1),
        base_color=(0, 0, 0, 1),
        specular_color=(0.5, 0.25, 0.125),
        shininess=1e5,
    )
    add_box(
        builder, (4, 0, 4), (1, 1, 1), base_color=(0, 0, 0, 1), specular_color=BLACK, emissive=(2.0, 2.0, 2.0)
    )
    light = trace_light(builder.build(), (-4, 0, 4), (0, 0, 0), bounces=1)
    assert light == pytest.approx((1.0, 0.5, 0.25), rel=1e-2)


@pytest.mark.parametrize(
    "material",
    [
        *({"metallic": 1.0, "roughness": roughness} for roughness in (0.3, 0.6, 1.0)),
        *({"specular_color": (0.5, 0.5, 0.5), "shininess": shininess} for shininess in (8.0, 200.0)),
    ],
    ids=repr,
)
def test_many_rays_to_an_environment_bring_its_integral(material: dict[str, object]) -> None:
    row, column = np.mgrid[:32, :64]
    waves = [0.6 + 0.4 * np.sin(row / 4.0 + phase) * np.cos(column * np.pi / 8.0) for phase in range(3)]
    image = np.stack(waves, axis=2).astype(np.float32)
    builder = begin_scene()
    builder.environment = Environment(image, is_visible=False)
    add_box(builder, (0, 0, -0.5), (20, 20, 1), base_color=(0.8, 0.8, 0.8, 1.0), **material)
    scene = builder.build()
    camera = Camera.look_at((-1, 0.5, 2), (0, 0, 0), projection=PROJECTION)
    pixels = np.tile((4.0, 4.0), (4096, 1))
    expected = inverse_tone_map(RayTracer(scene).trace(camera, (8, 8), pixels[:1]))[0]
    traced = inverse_tone_map(RayTracer(scene, bounces=1).trace(camera, (8, 8), pixels)).mean(axis=0)
    assert traced == pytest.approx(expected, rel=0.015)


@pytest.mark.parametrize("degrees", [0.0, 20.0, 60.0, 85.0])
def test_rays_bend_by_snells_law(degrees: float) -> None:
    sine, normal = np.sin(np.radians(degrees)), np.array([[0.0, 1.0, 0.0]])
    direction = np.array([[sine, -np.cos(np.radians(degrees)), 0.0]])
    bent, _ = bend_rays(direction, normal, np.array([False]), 1.5)
    assert bent[0, 0] == pytest.approx(sine / 1.5, abs=1e-12)
    back, _ = bend_rays(bent, normal, np.array([True]), 1.5)
    assert back == pytest.approx(direction, abs=1e-12)


@pytest.mark.parametrize(("degrees", "share"), [(41.0, None), (42.5, 1.0), (80.0, 1.0)])
def test_beyond_the_critical_angle_all_light_stays_inside(degrees: float, share: float | None) -> None:
    direction = np.array([[np.sin(np.radians(degrees)), -np.cos(np.radians(degrees)), 0.0]])
    _, mirrored = bend_rays(direction, np.array([[0.0, 1.0, 0.0]]), np.array([True]), 1.5)  # critical: 41.8°
    assert (mirrored[0] == share) if share else (0.04 < mirrored[0] < 1.0)


@pytest.mark.parametrize(
    ("degrees", "share"),
    [(0.0, 0.04), (np.degrees(np.arctan(1.5)), 0.5 * ((1.0 - 1.5**2) / (1.0 + 1.5**2)) ** 2), (90.0, 1.0)],
)
def test_the_mirrored_share_is_that_of_fresnels_equations(degrees: float, share: float) -> None:
    """At Brewster's angle light of one polarisation isn't mirrored at all."""
    direction = np.array([[np.sin(np.radians(degrees)), -np.cos(np.radians(degrees)), 0.0]])
    _, mirrored = bend_rays(direction, np.array([[0.0, 1.0, 0.0]]), np.array([False]), 1.5)
    assert mirrored[0] == pytest.approx(share, abs=1e-9)


def make_slab(offset: float) -> SceneBuilder:
    """A slab of glass, 2 m thick, and 4 m behind its back a strip of light, 2 mm wide, at `offset` to the right."""
    builder = begin_scene()
    add_box(builder, (0, 0, -1), (20, 20, 2), **GLASS)
    add_box(
        builder,
        (offset, 0, -6),
        (0.002, 20, 0.002),
        base_color=(0, 0, 0, 1),
        specular_color=BLACK,
        emissive=(1, 1, 1),
    )
    return builder


def cover_by_glass(light: float) -> float:
    """The light that has the colour of `light` behind glass: colours are covered, as in the renderer's images."""
    return float(inverse_tone_map((1.0 - ALPHA) * tone_map(np.array([light])))[0])


def test_a_slab_of_glass_shifts_objects_behind_it() -> None:
    slope = 0.5 / np.sqrt(0.75)  # 30° before and behind the slab
    inside = np.tan(np.arcsin(0.5 / 1.5))
    offset = 2.0 * inside + 4.0 * slope
    eye, target = (-3.0 * slope, 0, 3), (0, 0, 0)
    light = trace_light(make_slab(offset).build(), eye, target, bounces=3, refraction_index=1.5)
    mirrored = bend_rays(
        np.array([[0.5, -np.sqrt(0.75), 0]]), np.array([[0.0, 1, 0]]), np.array([False]), 1.5
    )[1][0]
    assert light[0] == pytest.approx(cover_by_glass((1.0 - mirrored) ** 2 * (1.0 - ALPHA)), rel=1e-6)


def test_without_refraction_the_slab_shifts_nothing() -> None:
    slope = 0.5 / np.sqrt(0.75)
    eye, target = (-3.0 * slope, 0, 3), (0, 0, 0)
    light = trace_light(make_slab(6.0 * slope).build(), eye, target, bounces=3)
    assert light[0] == pytest.approx(cover_by_glass(1.0), rel=1e-6)


def test_glass_adds_no_light_and_loses_none_in_a_room_of_equal_light() -> None:
    """All rays end in the same light, however they are mirrored and bent."""
    builder = begin_scene(sky=(0.5, 0.5, 0.5))
    image = np.full((4, 8, 3), 0.5, np.float32)
    builder.environment = Environment(image)
    mesh = builder.add_mesh(BUILT_IN["sphere"]())
    builder.add_objects(builder.add_node(translation((0, 0, 0))), mesh, builder.add_material(**GLASS))
    tracer = RayTracer(builder.build(), bounces=6, refraction_index=1.5)
    camera = Camera.look_at((0, 0.3, 2), (0, 0, 0), projection=PROJECTION)
    pixels = np.stack(np.meshgrid(np.linspace(1, 7, 7), np.linspace(1, 7, 7)), axis=-1).reshape(-1, 2)
    light = inverse_tone_map(tracer.trace(camera, (8, 8), pixels))
    assert light == pytest.approx(np.full_like(light, 0.5), abs=1e-3)


@pytest.mark.parametrize(
    "options", [{"bounces": -1}, {"bounces": 17}, {"refraction_index": 0.0}, {"refraction_index": 5.0}]
)
def test_options_out_of_range_are_refused(options: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(options))):
        RayTracer(make_mirror().build(), **options)


def test_options_at_their_ends_are_accepted() -> None:
    RayTracer(make_mirror().build(), bounces=16, refraction_index=4.0)
    RayTracer(make_mirror().build(), bounces=0, refraction_index=0.25)
