"""The pixels of all techniques, compared with those of forward shading."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from frames import draw_each, forget_variants, make_boxes, max_difference
from nightly_reasons import FEWER_CASES, ONLY_KERNELS
from numpy.typing import NDArray

import rhi
from renderer.content import BUILT_IN, load_scene
from renderer.renderer import Renderer
from renderer.scene import Camera, Depth, Orthographic, Perspective, Scene, SceneBuilder, scaling, translation
from renderer.techniques import (
    TECHNIQUES,
    Deferred,
    DeferredPlus,
    Forward,
    Inferred,
    LightPrePass,
    Technique,
    inferred,
)
from renderer.techniques.technique_settings import TechniqueSettings
from renderer.visibility import ALGORITHMS, NoCulling, list_algorithms, make_visibility
from tests.renderer.conftest import open_device

SIZE = (96, 64)
OTHERS: dict[str, Callable[[], Technique]] = {
    **{name: make for name, make in TECHNIQUES.items() if name not in ("forward", "inferred")},
    "deferred, stencil": lambda: Deferred(stencil=True),
    "light_pre_pass, stencil": lambda: LightPrePass(stencil=True),
    "inferred at full size": lambda: Inferred(scale=1.0),
    "deferred_plus, a pass for each material": lambda: DeferredPlus(multi_pass=True),
    "deferred_plus, rectangles of objects": lambda: DeferredPlus(object_rectangles=True),
    "deferred_plus, lists of pixels": lambda: DeferredPlus(binned=True),
    "deferred_plus, lists of tiles": lambda: DeferredPlus(tiled=True),
}
EYE = Camera.look_at((0, 3, 9), (0, 0.5, 0))


def stage(middle: tuple[float, float, float] = (0, 0, 0), *, textured: bool = False) -> SceneBuilder:
    """Make a floor with boxes and spheres, dark but for its lights."""
    random = np.random.default_rng(3)
    builder = SceneBuilder("stage")
    image = -1
    if textured:
        image = builder.add_image(random.integers(0, 256, (16, 16, 4), np.uint8))
    materials = [
        builder.add_material(
            base_color=(0.7, 0.6, 0.5), specular_color=(0.3, 0.2, 0.1), shininess=20.0, texture=image
        ),
        builder.add_material(
            base_color=(0.2, 0.4, 0.9), specular_color=(0.9, 0.9, 0.9), shininess=80.0, rim_strength=0.4
        ),
        builder.add_material(
            base_color=(0.9, 0.3, 0.0), specular_color=(0, 0, 0), emission=0.05, texture=image
        ),
    ]
    meshes = [builder.add_mesh(BUILT_IN[name]()) for name in ("box", "sphere")]
    at = translation(middle)
    builder.add_objects(
        builder.add_node(at @ translation((0, -0.5, 0)) @ scaling((24, 1, 24))), meshes[0], materials[0]
    )
    for number in range(14):
        position = (random.uniform(-6, 6), random.uniform(0, 1.5), random.uniform(-6, 5))
        builder.add_objects(
            builder.add_node(at @ translation(position) @ scaling((1.3, 1.3, 1.3))),
            meshes[number % 2],
            materials[number % 3],
        )
    builder.lights.sky = (0.02, 0.02, 0.03)
    builder.lights.ground = (0.01, 0.01, 0.01)
    return builder


def add_random_lights(builder: SceneBuilder, count: int, seed: int) -> None:
    """Add lights of all kinds and sizes; some behind `EYE`, around it, and below the floor."""
    random = np.random.default_rng(seed)
    for number in range(count):
        position = random.uniform((-8, -0.5, -8), (8, 4, 12))
        color = random.uniform(0.2, 1.0, 3)
        reach = float(random.choice([0.3, 1.0, 2.5, 6.0, 15.0]))
        if number % 2:
            builder.lights.add_point(position, reach, color, 0.8 * reach)
        else:
            outer = float(random.choice([0.1, 0.5, 0.9, 1.04, 1.06, 1.5, 2.2, np.pi]))
            direction = random.normal(size=3) - (0, 1, 0)
            builder.lights.add_spot(position, direction, reach, 0.6 * outer, outer, color, 1.5 * reach)


def check_all(
    device: rhi.Device, scene: Scene, camera: Camera = EYE, size: tuple[int, int] = SIZE
) -> NDArray[np.int64]:
    """Check that each technique gives forward shading's image, which is returned."""
    techniques = [Forward(), *(make() for make in OTHERS.values())]
    expected, *images = draw_each(device, scene, *techniques, camera=camera, size=size)
    off = {name: max_difference(image, expected) for name, image in zip(OTHERS, images, strict=True)}
    # Deferred+ filters textures by stored derivatives, which are at most 0.3 % off.
    slack = {name: int(bool(scene.images)) for name in OTHERS if name.startswith("deferred_plus")}
    assert all(most <= 2 + slack.get(name, 0) for name, most in off.items()), off
    return expected


@pytest.mark.nightly_cases("cl-*", reason=ONLY_KERNELS)
@pytest.mark.nightly_cases("*-True-*", "*-False-[12]", reason=FEWER_CASES)
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("textured", [False, True])
def test_random_lights_give_the_image_of_forward_shading(
    drawing_device: rhi.Device, seed: int, textured: bool
) -> None:
    builder = stage(textured=textured)
    add_random_lights(builder, 40, seed)
    check_all(drawing_device, builder.build())


@pytest.mark.nightly_cases("cl", reason=ONLY_KERNELS)
def test_spheres_give_the_image_of_forward_shading(drawing_device: rhi.Device) -> None:
    builder = stage()
    metal = builder.add_material(base_color=(0.9, 0.8, 0.5), metallic=1.0, roughness=0.3)
    builder.add_objects(builder.add_node(translation((0, 1, 3))), 1, metal)
    add_random_lights(builder, 40, 6)
    for lights in (builder.lights.point, builder.lights.spot):
        lights["source_radius"] = lights["range"] * np.random.default_rng(7).uniform(0.0, 0.3, len(lights))
    check_all(drawing_device, builder.build())


@pytest.mark.nightly
def test_the_core_profile_of_webgpu_suffices_for_all_techniques_but_light_indexed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Light is added up in half floats there; the lists of `light_indexed` are numbers that need 32 bits."""
    monkeypatch.setenv("RHI_WGPU_PROFILE", "core")
    builder = stage()
    add_random_lights(builder, 12, seed=4)
    scene = builder.build()
    with open_device("wgpu") as device:
        names = [name for name in TECHNIQUES if name != "light_indexed"]
        techniques = [TechniqueSettings(name, scale=1.0).make(scene, device) for name in names]
        expected, *images = draw_each(device, scene, *techniques, camera=EYE, size=SIZE)
        assert np.ptp(expected[:, :, :3]) > 20
        assert max(max_difference(image, expected) for image in images) <= 3
        assert {"two_pass", "conditional"} == ALGORITHMS.keys() - set(list_algorithms(device))
        with pytest.raises(rhi.ValidationError, match="unblendable_formats"):
            draw_each(
                device, scene, TechniqueSettings("light_indexed").make(scene, device), camera=EYE, size=SIZE
            )


CAMERAS = {
    "standard depth": EYE.with_projection(Perspective(depth=Depth.STANDARD)),
    "a far plane through lights": EYE.with_projection(Perspective(far=11.0)),
    "a far plane through lights, standard depth": EYE.with_projection(
        Perspective(far=11.0, depth=Depth.STANDARD)
    ),
    "a near plane through lights": EYE.with_projection(Perspective(near=8.0)),
    "parallel": EYE.with_projection(Orthographic(9.0, near=0.0, far=40.0)),
    "parallel, from behind the eye, standard depth": EYE.with_projection(
        Orthographic(9.0, near=-3.0, far=12.0, depth=Depth.STANDARD)
    ),
    "a narrow field of view": EYE.with_projection(Perspective(fov=0.2)),
    "a wide field of view": EYE.with_projection(Perspective(fov=2.6)),
    "a near plane of a millimetre": EYE.with_projection(Perspective(near=1e-3, far=1e7)),
    "straight down": Camera.look_at((0, 9, 0), (0, 0, 0)),
}


@pytest.mark.nightly_cases(
    "*-a far plane *",
    "*-a near plane of a millimetre",
    "*-a wide field of view",
    "*-parallel*",
    reason=FEWER_CASES,
)
@pytest.mark.parametrize("projection", CAMERAS)
def test_any_projection_gives_the_image_of_forward_shading(
    drawing_device: rhi.Device, projection: str
) -> None:
    builder = stage()
    add_random_lights(builder, 30, seed=7)
    builder.haze, builder.background = 0.05, (0.3, 0.5, 0.7)
    builder.add_objects(builder.add_node(translation((-1, 1, 4)) @ scaling((-1, 1, 1))), 0, 1)
    image = check_all(drawing_device, builder.build(), CAMERAS[projection])
    assert np.ptp(image[:, :, :3]) > 20, "the scene can be seen"


@pytest.mark.nightly
@pytest.mark.parametrize("size", [(1, 1), (7, 3), (85, 48)])
def test_any_size_of_the_image_gives_the_image_of_forward_shading(
    drawing_device: rhi.Device, size: tuple[int, int]
) -> None:
    builder = stage()
    add_random_lights(builder, 12, seed=1)
    builder.lights.add_directional((0, -1, -1), intensity=0.5)
    check_all(drawing_device, builder.build(), EYE, size)


def add_sparks(builder: SceneBuilder) -> None:
    for x in np.linspace(-3, 3, 12):
        for z in np.linspace(0, 6, 12):
            builder.lights.add_point((x, 0.02, z), 0.07, intensity=0.5)


EYE_TO_STAGE = EYE.position
LIGHTS: dict[str, Callable[[SceneBuilder], object]] = {
    "around the eye": lambda b: b.lights.add_point(EYE_TO_STAGE, 14.0, intensity=60.0),
    "behind the eye": lambda b: b.lights.add_point((0, 3, 13), 16.0, intensity=60.0),
    "of a radius of 1,000 km": lambda b: b.lights.add_point((1, 3, 0), 1e6, intensity=8.0),
    "far away and larger": lambda b: b.lights.add_point((3e5, 6e5, 2e5), 1e6, intensity=4e11),
    "that touches a surface": lambda b: b.lights.add_point((0, 0.01, 3), 2.0, intensity=0.5),
    "smaller than a pixel": lambda b: add_sparks(b),
    "a spot at the eye": lambda b: b.lights.add_spot(
        EYE_TO_STAGE, (0, -0.3, -1), 20.0, 0.2, 0.4, intensity=50.0
    ),
    "a spot behind the eye": lambda b: b.lights.add_spot(
        (0, 4, 14), (0, -0.4, -1), 30, 0.3, 0.8, intensity=90.0
    ),
    "a spot of 0.1 degrees": lambda b: b.lights.add_spot(
        (0, 400, 3), (0, -1, 0), 600, 0.0017, 0.00175, intensity=1e8
    ),
    "a spot of 90 degrees": lambda b: b.lights.add_spot(
        (0, 2, 1), (0, -1, 0), 6, 1.2, np.pi / 2, intensity=9
    ),
    "a spot of 120 degrees": lambda b: b.lights.add_spot((0, 2, 1), (0, 1, 0), 6, 1.2, 2.1, intensity=9),
    "a spot of 1,000 km": lambda b: b.lights.add_spot((0, 5, 2), (0, -1, 0), 1e6, 0.4, 0.9, intensity=20),
}


@pytest.mark.nightly
@pytest.mark.parametrize("where", LIGHTS)
def test_a_light_lights_the_same_pixels_as_in_forward_shading(drawing_device: rhi.Device, where: str) -> None:
    light = stage()
    LIGHTS[where](light)
    image = check_all(drawing_device, light.build())
    (unlit,) = draw_each(drawing_device, stage().build(), Forward(), camera=EYE, size=SIZE)
    assert max_difference(image, unlit) > 2, "the light can be seen"


@pytest.mark.nightly_cases("cl", reason=ONLY_KERNELS)
def test_a_light_of_radius_0_lights_nothing(drawing_device: rhi.Device) -> None:
    builder = stage()
    builder.lights.add_point((0, 0.5, 3), 0.0, intensity=1e4)
    builder.lights.add_spot((0, 0.5, 3), (0, -1, 0), 0.0, 0.3, 0.5, intensity=1e4)
    builder.lights.add_point((0, 2.0, 3), 5.0, intensity=9.0)
    builder.haze, builder.background = (
        0.05,
        (0.3, 0.5, 0.7),
    )  # the shaders of the test of projections, built already
    check_all(drawing_device, builder.build())


@pytest.mark.nightly_cases("cl", reason=ONLY_KERNELS)
def test_light_beyond_the_range_of_a_half_is_white(drawing_device: rhi.Device) -> None:
    # 20 times infinity in the light buffer, on surfaces some of which mirror nothing.
    builder = stage()
    for number in range(20):
        builder.lights.add_point((0.1 * number, 3.0, 2), 30.0, (1.0, 0.5, 0.1), intensity=1e7)
    image = check_all(drawing_device, builder.build())
    assert (image[:, :, 0] == 255).mean() > 0.3


@pytest.mark.nightly_cases("cl", reason=ONLY_KERNELS)
def test_a_place_far_from_the_origin_is_as_exact(drawing_device: rhi.Device) -> None:
    middle = (1e6 + 0.3, -2e5, 3e6)
    builder = stage(middle)
    for offset in ((-2, 1.5, 0), (2, 1.0, 2)):
        builder.lights.add_point(np.add(offset, middle), 5.0, intensity=6.0)
    camera = replace(EYE, position=EYE.position + np.array(middle))
    check_all(drawing_device, builder.build(), camera)


@pytest.mark.nightly
@pytest.mark.parametrize("text", ["city:blocks=6", "hall:columns=6,flags=4", "grid:count=9"])
def test_the_scenes_of_the_library_look_as_with_forward_shading(
    drawing_device: rhi.Device, text: str
) -> None:
    scene = load_scene(text)
    check_all(drawing_device, scene, scene.paths["ground"].camera(300), (160, 90))


def test_every_visibility_algorithm_draws_to_geometry_buffers(gl: rhi.Device) -> None:
    scene = load_scene("city:blocks=6")
    none, path = NoCulling(scene), scene.paths["ground"]
    with Renderer(gl, scene, visibility=none, technique=Forward(), size=(160, 90)) as renderer:
        expected = renderer.render(path.camera(308)).image.read().astype(np.int64)
        for renderer.technique in (Deferred(stencil=True), LightPrePass()):
            for name in sorted({*ALGORITHMS} - {"auto"}):
                renderer.visibility = visibility = make_visibility(name, scene, gl)
                for frame in (300, 304, 308):
                    image = renderer.render(path.camera(frame)).image.read().astype(np.int64)
                assert max_difference(image, expected) <= 2, (name, renderer.technique)
                renderer.visibility = none
                visibility.destroy()


@pytest.mark.nightly_cases("cl-*", reason=ONLY_KERNELS)
@pytest.mark.parametrize("count", [16, 1500])
def test_light_of_many_local_lights_is_added_up_as_exactly_by_blending_as_in_a_shader(
    drawing_device: rhi.Device, count: int
) -> None:
    builder = make_boxes(
        translation((0, -0.5, 0)) @ scaling((20, 1, 20)), name="lit by many", specular_color=(0.1, 0.1, 0.1)
    )
    builder.lights.sky = builder.lights.ground = (0.0, 0.0, 0.0)
    positions = np.random.default_rng(0).normal((0, 1.5, 0), 0.3, (count, 3))
    builder.lights.add_points(positions, 8.0, (1, 0.8, 0.6), 3.0 / count)
    scene, camera, size = builder.build(), Camera.look_at((0, 3, 6), (0, 0, 0)), (32, 18)
    kinds: tuple[Callable[..., Technique], ...] = (
        TECHNIQUES["forward_multipass"],
        Deferred,
        LightPrePass,
        partial(LightPrePass, specular_channels=1),
        partial(Inferred, scale=1.0),
    )
    for kind in kinds:
        expected, image, halves = draw_each(
            drawing_device, scene, Forward(), kind(), kind(light_bits=16), camera=camera, size=size
        )
        assert max_difference(image, expected) <= 1, kind
        assert (max_difference(halves, expected) > 1) == (count > 16), kind  # the control


@pytest.mark.nightly_cases("cl", reason=ONLY_KERNELS)
def test_a_missing_light_is_seen_by_the_comparison(drawing_device: rhi.Device) -> None:
    # The control of all comparisons above.
    builder, without = stage(), stage()
    for lit in (builder, without):
        lit.lights.add_point((0, 1.5, 3), 2.0, intensity=2.0)
    builder.lights.add_spot((0, 3.5, 3), (0, -1, 0), 5.0, 0.4, 0.8, intensity=6.0)
    (expected,) = draw_each(drawing_device, builder.build(), Forward(), camera=EYE, size=SIZE)
    images = draw_each(
        drawing_device, without.build(), *(make() for make in OTHERS.values()), camera=EYE, size=SIZE
    )
    assert min(max_difference(image, expected) for image in images) > 2


@pytest.mark.nightly_cases("cl", reason=ONLY_KERNELS)
def test_one_specular_channel_is_exact_for_one_light_and_loses_hues_for_two(
    drawing_device: rhi.Device,
) -> None:
    techniques: list[Technique] = [Forward(), LightPrePass(specular_channels=1), LightPrePass()]
    builder = stage()
    builder.lights.add_point((-3, 2, 3), 9.0, (1.0, 0.2, 0.1), intensity=9.0)
    expected, one_channel, three = draw_each(
        drawing_device, builder.build(), *techniques, camera=EYE, size=SIZE
    )
    assert max_difference(one_channel, expected) <= 2
    assert max_difference(three, expected) <= 2
    builder.lights.add_point((3, 2, 3), 9.0, (0.1, 0.2, 1.0), intensity=9.0)
    expected, one_channel, three = draw_each(
        drawing_device, builder.build(), *techniques, camera=EYE, size=SIZE
    )
    assert max_difference(one_channel, expected) > 2
    assert max_difference(three, expected) <= 2


def find_signal_to_noise(image: NDArray[np.int64], expected: NDArray[np.int64]) -> float:
    """Return the signal-to-noise ratio of an image against the expected one, in dB."""
    return float(10.0 * np.log10(255.0**2 / ((image - expected)[:, :, :3] ** 2).mean()))


@pytest.mark.nightly_cases("cl", reason=ONLY_KERNELS)
def test_inferred_light_is_near_and_nearer_with_more_of_it(drawing_device: rhi.Device) -> None:
    builder = stage(textured=True)
    add_random_lights(builder, 20, seed=4)
    techniques: list[Technique] = [Forward(), *(Inferred(scale=scale) for scale in (0.4, 0.6, 0.8))]
    expected, *images = draw_each(drawing_device, builder.build(), *techniques, camera=EYE, size=(192, 128))
    quality = [find_signal_to_noise(image, expected) for image in images]
    assert quality[0] > 24
    assert quality[1] > 26
    assert quality[0] < quality[2]


def test_light_does_not_leak_over_edges(gl: rhi.Device, monkeypatch: pytest.MonkeyPatch) -> None:
    # A bright floor far below a dark table: beside the edges, four texels are of both.
    floor, table = scaling((40, 1, 40)), translation((0, 8, 0)) @ scaling((3, 0.1, 3))
    builder = make_boxes(floor, table, name="table", base_color=(0.8, 0.8, 0.8), specular_color=(0, 0, 0))
    for x in (-3, 3):
        for z in (-3, 3):
            builder.lights.add_point((x, 5, z), 30.0, intensity=40.0)
    builder.lights.sky = (0.01, 0.01, 0.01)
    scene, camera = builder.build(), Camera.look_at((0.5, 14, 1), (0, 8, 0))
    expected, image = draw_each(gl, scene, Forward(), Inferred(), camera=camera, size=SIZE)
    forget_variants()
    monkeypatch.setattr(inferred, "_NEAR_PLANE", 1e6)  # the control: a bilinear filter
    (blurred,) = draw_each(gl, scene, Inferred(), camera=camera, size=SIZE)
    forget_variants()
    assert (np.abs(image - expected) > 16).any(2).mean() < 0.002
    assert (np.abs(blurred - expected) > 16).any(2).mean() > 0.02
