"""The reference ray tracer's images are what can be worked out by hand."""

from __future__ import annotations

import ast
from pathlib import Path

import numpy as np
import pytest

import renderer.lab.measure.ray_tracer
from renderer import scene as scenes
from renderer.content import BUILT_IN
from renderer.lab.measure.ray_tracer import RayTracer
from renderer.lab.measure.ray_tracer.shading import optical_depth
from renderer.lab.measure.ray_tracer.surfaces import decode_srgb, encode_srgb
from renderer.lab.measure.ray_tracer.tracer import inverse_tone_map, tone_map
from renderer.scene import (
    Bloom,
    Camera,
    Fog,
    Orthographic,
    Perspective,
    SceneBuilder,
    StereoRig,
    scaling,
    translation,
)
from tests.renderer.fog_reference import integrate_fog

PROJECTION = Perspective(fov=1.0, aspect=1.0)


def make_floor(**material: object) -> SceneBuilder:
    """Begin a scene of a floor at y = 0, of which only the light that it scatters is seen."""
    builder = SceneBuilder("floor")
    builder.background = (0.0, 0.0, 0.0)
    builder.lights.sky = builder.lights.ground = (0.0, 0.0, 0.0)
    mesh = builder.add_mesh(BUILT_IN["box"]())
    options = {"base_color": (0.5, 0.25, 0.125), "specular_color": (0, 0, 0), **material}
    builder.add_objects(
        builder.add_node(translation((0, -0.5, 0)) @ scaling((20, 1, 20))),
        mesh,
        builder.add_material(**options),
    )
    return builder


def trace_light(
    builder: SceneBuilder, eye: tuple[float, float, float], at: tuple[float, float, float]
) -> np.ndarray:
    """Return the light (3,) that comes to an eye from the middle of its image."""
    camera = Camera.look_at(eye, at, projection=PROJECTION)
    color = RayTracer(builder.build()).trace(camera, (8, 8), np.array([(4.0, 4.0)]))
    return inverse_tone_map(color)[0]


def test_a_point_light_lights_by_the_square_of_its_distance_and_the_cosine() -> None:
    builder = make_floor()
    builder.lights.add_point((0, 3, 4), 1e6, (1, 1, 0.5), intensity=50.0)
    want = np.array((0.5, 0.25, 0.0625)) * 50.0 / 25.0 * 0.6
    assert trace_light(builder, (3, 2, 0), (0, 0, 0)) == pytest.approx(want, rel=1e-6)


@pytest.mark.parametrize("height", [2.0, 0.4, -0.3])
def test_a_sphere_lights_as_the_points_of_its_surface_do(height: float) -> None:
    builder, radius = make_floor(base_color=(1, 1, 1)), 0.8
    builder.lights.add_point((0, height, 0), 1e6, intensity=2.0, source_radius=radius)
    outward = np.random.default_rng(0).normal(size=(400_000, 3))
    outward /= np.linalg.norm(outward, axis=1)[:, None]
    way = np.array((0, height, 0)) + radius * outward - (1.0, 0.0, 0.0)
    squared = (way**2).sum(1)
    seen = np.maximum(-(way * outward).sum(1), 0.0) * np.maximum(way[:, 1], 0.0) / squared**2
    want = 4.0 * 2.0 * seen.mean()  # of radiance 2 / (π radius²) from 4 π radius²
    assert trace_light(builder, (1, 2, 0.5), (1, 0, 0))[0] == pytest.approx(want, rel=0.01)


@pytest.mark.parametrize(("angle", "share"), [(0.1, 1.0), (0.3, 1.0), (0.4, 0.3127), (0.5, 0.0), (0.6, 0.0)])
def test_a_spot_fades_between_its_angles(angle: float, share: float) -> None:
    builder = make_floor(base_color=(1, 1, 1))
    builder.lights.add_spot((0, 1, 0), (0, -1, 0), 1e6, 0.3, 0.5, intensity=1.0)
    x = np.tan(angle)
    light = trace_light(builder, (x, 2, 0.5), (x, 0, 0))[0]
    assert light == pytest.approx(share * np.cos(angle) ** 3, abs=2e-3)


def test_an_eye_with_a_squeezed_image_sees_as_far_to_the_sides_as_a_full_image() -> None:
    builder = make_floor()
    builder.lights.add_point((0, 3, 4), 1e6, (1, 1, 0.5), intensity=50.0)
    camera = Camera.look_at((3, 2, 0), (0, 0, 0), projection=Perspective(fov=1.0, aspect=2.0))
    eye, ray_tracer = StereoRig(0.1, 2.0).place_eyes(camera)[1], RayTracer(builder.build())
    whole, squeezed = (
        ray_tracer.trace(eye, (16, 8), np.array([(2.0, 6.0)])),
        ray_tracer.trace(eye, (8, 8), np.array([(1.0, 6.0)])),
    )
    assert whole.max() > 0.1
    assert squeezed == pytest.approx(whole, rel=1e-12)


def test_the_sun_casts_the_shadow_of_a_box_where_it_must_lie() -> None:
    builder = make_floor()
    builder.add_objects(
        builder.add_node(translation((0, 1.5, 0))),
        builder.add_mesh(BUILT_IN["box"]()),
        builder.add_material(),
    )
    builder.lights.add_directional((1, -1, 0), intensity=1.0, casts_shadow=True)
    camera = Camera.look_at(
        (1.5, 30, 0), (1.5, 0, 0), (0, 0, -1), projection=Orthographic(6.0, 1.0, 0.0, 100.0)
    )
    scene = builder.build()
    x = np.array([0.6, 0.99, 1.01, 2.49, 2.51])  # the box is seen up to 0.5; its shadow goes from 0.5 to 2.5
    pixels = np.stack([(x - 1.5) / 6.0 * 64 + 32, np.full(5, 32.0)], axis=1)
    lit = RayTracer(scene).trace(camera, (64, 64), pixels)[:, 0] > 0.0
    assert lit.tolist() == [False, False, False, False, True]
    assert RayTracer(scene, has_shadows=False).trace(camera, (64, 64), pixels)[:, 0].min() > 0.0


@pytest.mark.parametrize("changes", ["nothing", "moves", "appears"])
def test_a_ray_tracer_that_follows_an_earlier_one_renders_the_same(changes: str) -> None:
    builder = make_floor()
    mesh, material = builder.add_mesh(BUILT_IN["sphere"]()), builder.add_material()
    nodes = [builder.add_node(translation((x, 1.0, 0.0)), dynamic=True) for x in (-1.5, 0.0, 1.5)]
    for node in nodes:
        builder.add_objects(node, mesh, material)
    builder.hide(nodes[2])
    builder.lights.add_directional((1, -1, 0.5), intensity=1.0, casts_shadow=True)
    scene = builder.build()
    camera = Camera.look_at((0, 5, 9), (0, 0, 0), projection=PROJECTION)
    earlier = RayTracer(scene)
    before = earlier.draw(camera, (24, 24))
    if changes == "moves":
        scene.nodes.set_local([nodes[0]], translation((-1.0, 2.5, 1.0)))
    elif changes == "appears":
        scene.nodes.show([nodes[2]])
    scene.update(0.0)
    images = [RayTracer(scene, earlier=tracer).draw(camera, (24, 24)) for tracer in (None, earlier)]
    assert np.array_equal(*images)
    assert np.array_equal(images[0], before) == (changes == "nothing")


@pytest.mark.parametrize("near", [0, -3, np.int64(2)])
def test_distances_of_planes_may_be_whole_numbers(near: int) -> None:
    builder = make_floor(emissive=(4.0, 4.0, 4.0))
    images = []
    for kind in (int, float):
        camera = Camera.look_at(
            (0, 30, 0), (0, 0, 0), (0, 0, -1), projection=Orthographic(kind(4), 1, kind(near), kind(100))
        )
        images.append(RayTracer(builder.build()).draw(camera, (5, 5)))
    assert np.array_equal(*images)
    assert images[0].min() > 0.0


def test_a_light_inside_a_closed_object_shines_and_one_behind_it_does_not() -> None:
    for height, lit in ((2.0, True), (4.0, False)):
        builder = make_floor()
        builder.add_objects(
            builder.add_node(translation((0, 2.0, 0))),
            builder.add_mesh(BUILT_IN["box"]()),
            builder.add_material(),
        )
        builder.lights.add_point((0.0, height, 0.0), 90.0, intensity=30.0, casts_shadow=True)
        assert bool(trace_light(builder, (0, 1, 3), (0, 0, 0.2))[0] > 1e-6) is lit


def test_panes_are_blended_from_back_to_front() -> None:
    builder = make_floor(emissive=(0.2, 0.2, 0.2), base_color=(0, 0, 0))
    mesh = builder.add_mesh(BUILT_IN["box"]())
    for height, color, alpha in ((1.0, (0.9, 0.0, 0.0), 0.5), (2.0, (0.0, 0.9, 0.0), 0.25)):
        pane = builder.add_material(
            base_color=(*color, alpha),
            emission=1.0,
            specular_color=(0, 0, 0),
            alpha_mode=scenes.AlphaMode.BLEND,
        )
        builder.add_objects(builder.add_node(translation((0, height, 0)) @ scaling((9, 0.1, 9))), mesh, pane)
    camera = Camera.look_at((0, 5, 0.1), (0, 0, 0.1), (0, 0, -1), projection=PROJECTION)
    (color,) = RayTracer(builder.build()).trace(camera, (8, 8), np.array([(4.0, 4.0)]))
    floor, bright = tone_map(np.array([0.2, 0.9]))
    want = 0.25 * np.array((0, bright, 0)) + 0.75 * (0.5 * np.array((bright, 0, 0)) + 0.5 * np.full(3, floor))
    assert color == pytest.approx(want, abs=1e-6)


def test_more_rays_take_the_mean_of_the_light_of_a_pixel() -> None:
    builder = make_floor(emissive=(4.0, 4.0, 4.0))
    camera = Camera.look_at(
        (10, 30, 0), (10, 0, 0), (0, 0, -1), projection=Orthographic(4.0, 1.0, 0.0, 100.0)
    )
    image = RayTracer(builder.build()).draw(camera, (9, 9), rays=16)[4]
    half = 255.0 * encode_srgb(0.5 * tone_map(np.array([4.0])))[0]
    assert image[3, 0] == pytest.approx(255.0 * encode_srgb(tone_map(np.array([4.0])))[0])
    assert image[4, 0] == pytest.approx(half, abs=4.0)  # the floor ends in the middle of this pixel
    assert image[5, 0] == 0.0


@pytest.mark.parametrize("falloff", [0.0, 1e-9, 0.4])
@pytest.mark.parametrize("rise", [-3.0, 0.0, 2.0])
def test_fog_is_as_thick_as_its_density_added_up(falloff: float, rise: float) -> None:
    fog = Fog(0.2, falloff=falloff, base=1.0)
    ray = np.array((4.0, rise, 1.0))
    thickness = optical_depth(fog, 2.0, ray[1:2], np.array([np.linalg.norm(ray)]))
    assert np.exp(-thickness[0]) == pytest.approx(integrate_fog(fog, 2.0, ray), rel=1e-9)


@pytest.mark.parametrize("density", [1e-300, 1e-30, 1.0])
@pytest.mark.parametrize("heights", [(80.0, -80.0), (80.0, 0.0), (3.0, -60.0), (-60.0, 3.0), (5.0, 5.0)])
def test_fog_that_is_far_thinner_at_one_end_has_a_finite_depth(
    density: float, heights: tuple[float, float]
) -> None:
    """The reference adds logarithms of the integral's factors, which neither overflow nor vanish."""
    falloff = 10.0
    eye, end = heights
    depth = optical_depth(
        Fog(density, falloff=falloff), np.array([eye]), np.array([end - eye]), np.array([7.0])
    )
    lowest, highest = min(heights), max(heights)
    span = falloff * (highest - lowest)
    share = -np.expm1(-span) / span if span else 1.0
    exponent = min(-falloff * eye, 60.0) + max(falloff * (eye - end), 0.0)
    expected = np.log(density) + exponent + np.log(7.0 * share)
    assert np.exp(-depth[0]) == pytest.approx(np.exp(-np.exp(min(expected, 700.0))), rel=1e-9, abs=1e-12)


def test_tones_and_srgb_have_their_published_values() -> None:
    assert encode_srgb(np.array([0.0, 0.002, 0.2140411, 1.0])) == pytest.approx(
        [0.0, 0.02584, 0.5, 1.0], abs=1e-6
    )
    assert decode_srgb(encode_srgb(np.linspace(0, 1, 99))) == pytest.approx(np.linspace(0, 1, 99), abs=1e-7)
    assert tone_map(np.array([1.0 / 0.6])) == pytest.approx(2.54 / 3.16)
    assert tone_map(inverse_tone_map(np.linspace(0, 1, 9))) == pytest.approx(np.linspace(0, 1, 9), abs=1e-12)


def test_bloom_is_refused() -> None:
    builder = make_floor()
    builder.bloom = Bloom()
    with pytest.raises(ValueError, match="bloom"):
        RayTracer(builder.build())


def test_the_ray_tracer_imports_the_scene_alone() -> None:
    folder = Path(renderer.lab.measure.ray_tracer.__file__).parent
    imported = set()
    for path in folder.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom):
                imported.add(str(node.module))
            elif isinstance(node, ast.Import):
                imported.update(alias.name for alias in node.names)
    modules = {name for name in imported if name.startswith("renderer.lab.measure.ray_tracer")}
    assert imported - modules <= {
        "__future__",
        "collections.abc",
        "dataclasses",
        "functools",
        "typing",
        "numpy",
        "numpy.typing",
        "renderer.scene",
    }
