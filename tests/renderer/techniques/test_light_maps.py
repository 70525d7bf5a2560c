"""Light maps: baked light is what a light that isn't baked would give, the same in all techniques, and costs nothing
where no material has any."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from frames import make_boxes, open_renderer, record
from hypothesis import given
from hypothesis import strategies as st
from nightly_reasons import ONLY_KERNELS
from numpy.typing import NDArray

import rhi
from renderer.content import BUILT_IN, load_model, save_scene
from renderer.content.material_shaders import Marble
from renderer.content.skies import paint_sky
from renderer.frame import Effect, LightComponent, collect_frame_effects
from renderer.lab.exam.ray_traced_cases import trace_image
from renderer.lab.measure.ray_tracer import RayTracer
from renderer.scene import (
    AmbientOcclusion,
    Camera,
    Environment,
    Perspective,
    Scene,
    SceneBuilder,
    TextureMap,
    make_geometry,
    scaling,
    translation,
)
from renderer.scene.arrays import Floats
from renderer.techniques import TECHNIQUES, Deferred
from renderer.techniques.parts.geometry_buffer import decode_irradiance, encode_irradiance
from rhi import Format, Op, SamplerDescriptor, ValidationError, Wrap
from rhi.shading import evaluate

SIZE = (96, 64)
EYE = Camera.look_at((-2.0, 2.6, -2.2), (0.0, 0.0, -0.1), projection=Perspective(0.8, 1.5))
CLAMPED = SamplerDescriptor(wrap_u=Wrap.CLAMP, wrap_v=Wrap.CLAMP)
TO_SUN = np.array((0.5, 0.7, 0.4)) / np.linalg.norm((0.5, 0.7, 0.4))
SUN_DIAMETER = 0.3
HALF = 2.0
UV = np.array([[0, 0], [1, 0], [0, 1], [1, 1]], np.float64)
EXACT = sorted(set(TECHNIQUES) - {"inferred"})  # which shades pixels by the light of their neighbours
Image = NDArray[np.int64]


def spread_over_sun(count: int = 300) -> Floats:
    """Directions (count, 3) to points that are spread over the sun."""
    number = np.arange(count) + 0.5
    sine = np.sqrt(number / count) * np.sin(0.5 * SUN_DIAMETER)
    angle = number * np.pi * (3.0 - np.sqrt(5.0))
    right = np.cross(TO_SUN, (0.0, 1.0, 0.0))
    right /= np.linalg.norm(right)
    up = np.cross(right, TO_SUN)
    aside = np.cos(angle)[:, None] * right + np.sin(angle)[:, None] * up
    return np.asarray(aside * sine[:, None] + TO_SUN * np.sqrt(1.0 - sine**2)[:, None])


def bake_floor(texels: int = 64) -> NDArray[np.float32]:
    """The irradiance (texels, texels, 3) of a floor, of half the side `HALF`, on which a box of side 0.8 stands: the
    part of the sun that isn't behind the box, by its slabs."""
    middle = ((np.arange(texels) + 0.5) / texels * 2.0 - 1.0) * HALF
    directions, lit = spread_over_sun(), np.zeros((texels, texels))
    for x, z in np.ndindex(texels, texels):
        origin = np.array((middle[x], 0.0, middle[z]))
        near, far = (np.array((-0.4, 0.0, -0.4)) - origin) / directions, (0.4, 0.8, 0.4) - origin
        far = far / directions
        enter, leave = np.minimum(near, far).max(axis=1), np.maximum(near, far).min(axis=1)
        lit[z, x] = 1.0 - (np.maximum(enter, 0.0) < leave).mean()
    return np.repeat((lit * TO_SUN[1])[..., None], 3, axis=2).astype(np.float32)


def make_floor(*, light_map: NDArray[Any] | None = None, shadow: bool = False, **values: Any) -> Scene:
    """A box on a floor, under a sun with or without a shadow, or with a light map on the floor and no sun."""
    builder = SceneBuilder("floor")
    corners = np.array([[-1, 0, -1], [1, 0, -1], [-1, 0, 1], [1, 0, 1]], np.float64) * HALF
    geometry = make_geometry(corners, [0, 2, 1, 1, 2, 3], np.tile([0.0, 1.0, 0.0], (4, 1)), UV * 5.0, uv2=UV)
    tiles = np.full((8, 8, 4), 255, np.uint8)
    tiles[:4, :, :3] = 140
    arguments: dict[str, Any] = {"specular_color": (0.0, 0.0, 0.0), "texture": builder.add_image(tiles)}
    if light_map is not None:
        image = builder.add_image(light_map)
        arguments["light_map_texture"] = TextureMap(image, uv_set=1, sampler=CLAMPED)
    floor = builder.add_material(base_color=(0.9, 0.8, 0.7), **(arguments | values))
    builder.add_objects(builder.add_node(), builder.add_mesh(geometry), floor)
    black = builder.add_material(base_color=(0.0, 0.0, 0.0), specular_color=(0.0, 0.0, 0.0))
    box = builder.add_node(translation((0.0, 0.4, 0.0)) @ scaling((0.8, 0.8, 0.8)))
    builder.add_objects(box, builder.add_mesh(BUILT_IN["box"]()), black)
    builder.background = (0.0, 0.0, 0.0)
    builder.lights.sky = builder.lights.ground = (0.0, 0.0, 0.0) if light_map is None else (0.6, 0.3, 0.9)
    if light_map is None:
        builder.lights.add_directional(-TO_SUN, casts_shadow=shadow, angular_diameter=SUN_DIAMETER)
    return builder.build()


def draw(device: rhi.Device, scene: Scene, technique: str = "forward", **options: Any) -> Image:
    with open_renderer(
        device, scene, TECHNIQUES[technique](), visibility="none", size=SIZE, **options
    ) as renderer:
        return np.asarray(renderer.render(EYE).image.read()[..., :3], np.int64)


@pytest.fixture(scope="module")
def baked() -> NDArray[np.float32]:
    return bake_floor()


@pytest.fixture(scope="module")
def traced() -> Floats:
    """The floor by float64 rays to a sun that isn't baked."""
    return RayTracer(make_floor(shadow=True), has_penumbras=True).draw(EYE, SIZE)


@pytest.mark.nightly_cases("cl-*", "wgpu-*", reason=ONLY_KERNELS)
@pytest.mark.parametrize("technique", ["forward", "deferred", "deferred_plus"])
def test_a_baked_penumbra_is_that_of_rays_to_a_light_that_is_not_baked(
    drawing_device: rhi.Device, baked: NDArray[np.float32], traced: Floats, technique: str
) -> None:
    image = draw(drawing_device, make_floor(light_map=baked), technique)
    hard = draw(drawing_device, make_floor(), technique)
    off = np.abs(image - traced).max(axis=2)
    assert np.median(off) < 2.0
    assert (off < 6.0).mean() > 0.95, "all but edges"
    assert (np.abs(image - hard).max(axis=2) > 60).mean() > 0.03, "a light without a shadow is another"


def make_rich(**changes: Any) -> Scene:
    """Balls of three materials, all with a light map of a high range, and one without."""
    builder = SceneBuilder("rich")
    ball = builder.add_mesh(BUILT_IN["sphere"]())
    rows, columns = np.indices((16, 16)) / 16.0
    light = np.stack([0.2 + 2.0 * rows, 0.6 + 0.0 * rows, 1.5 - columns], axis=-1).astype(np.float32)
    shade = np.full((4, 4, 4), 255, np.uint8)
    shade[:2, :, 0] = 100
    lit = {
        "light_map_texture": TextureMap(builder.add_image(light), scale=(1.0, 0.9), sampler=CLAMPED),
        "light_map_color": (0.5, 0.7, 0.3),
    }
    for number, material in enumerate(
        (
            {"base_color": (0.9, 0.7, 0.3), "metallic": 1.0, "roughness": 0.3, **lit},
            {"metallic": 0.2, "roughness": 0.6, "occlusion_texture": builder.add_image(shade), **lit},
            {"specular_color": (0.3, 0.3, 0.3), "shininess": 40.0, "rim_strength": 0.5, **lit},
            {"base_color": (0.5, 0.2, 0.2)},
        )
    ):
        node = builder.add_node(translation((1.15 * (number % 2) - 0.6, 0.55, 1.15 * (number // 2) - 0.6)))
        builder.add_objects(node, ball, builder.add_material(**material))
    builder.lights.sky, builder.lights.ground = (0.2, 0.3, 0.5), (0.1, 0.05, 0.0)
    builder.lights.add_point((1.5, 2.0, 2.0), 6.0, (2.0, 1.5, 1.0))
    for name, value in changes.items():
        setattr(builder, name, value)
    return builder.build()


@pytest.mark.nightly_cases("cl-*", "wgpu-*", reason=ONLY_KERNELS)
@pytest.mark.parametrize("technique", ["forward", "deferred", "deferred_plus", "light_pre_pass"])
def test_metal_and_rims_mirror_the_mean_light_of_the_map(drawing_device: rhi.Device, technique: str) -> None:
    traced = trace_image(make_rich(), EYE, SIZE)
    image = draw(drawing_device, make_rich(), technique)
    off = np.where(traced.is_smooth, np.maximum(traced.low - image, image - traced.high).max(axis=2), 0.0)
    assert traced.is_smooth.mean() > 0.9
    assert np.quantile(off, 0.999) < 3.0, "texels of some pixels on the left border are stretched"


@pytest.mark.parametrize("technique", ["forward", "clustered_deferred"])
def test_an_environment_is_mirrored_beside_the_light_of_the_map(gl: rhi.Device, technique: str) -> None:
    scene = make_rich(environment=Environment(paint_sky(height=64)))
    traced, image = RayTracer(scene).draw(EYE, SIZE), draw(gl, scene, technique)
    ball = np.abs(draw(gl, make_rich(), technique) - image).max(axis=2) > 30  # mirrors another sky
    off = np.abs(traced - image).max(axis=2)
    assert ball.sum() > 200
    assert np.percentile(off[ball], 90) < 8.0, "lobes are prefiltered"


@pytest.mark.parametrize("technique", ["forward", "deferred"])
def test_baked_light_is_not_occluded_once_more(gl: rhi.Device, technique: str) -> None:
    occlusion = AmbientOcclusion(0.6)
    flat = np.full((4, 4, 3), 0.5, np.float32)
    plain, occluded, other = (make_floor(light_map=flat) for _ in range(3))
    occluded.ambient_occlusion = other.ambient_occlusion = occlusion
    other.materials["light_map_texture"] = -1
    assert np.array_equal(draw(gl, plain, technique), draw(gl, occluded, technique))
    without = make_floor(light_map=flat)
    without.materials["light_map_texture"] = -1
    assert np.abs(draw(gl, without, technique) - draw(gl, other, technique)).max() > 20


@pytest.mark.nightly_cases("cl-*", "wgpu-*", reason=ONLY_KERNELS)
@pytest.mark.parametrize("values", [{}, {"shader": Marble, "frequency": 3.0}], ids=["plain", "marble"])
def test_techniques_agree_about_materials_with_and_without_shaders_of_their_own(
    drawing_device: rhi.Device, values: dict[str, Any], baked: NDArray[np.float32]
) -> None:
    scene = make_floor(light_map=baked, **values)
    images = [draw(drawing_device, scene, name) for name in EXACT]
    scene.materials["light_map_texture"] = -1
    assert np.abs(images[0] - draw(drawing_device, scene)).max() > 60
    assert [
        name for name, image in zip(EXACT, images, strict=True) if np.abs(image - images[0]).max() > 2
    ] == []


def test_normals_of_8_bits_have_16_beside_a_light_map(gl: rhi.Device) -> None:
    images = []
    for bits in (8, 16):
        technique = Deferred(normal_bits=bits)
        with open_renderer(gl, make_rich(), technique, visibility="none", size=SIZE) as renderer:
            images.append(renderer.render(EYE).image.read())
    assert np.array_equal(images[0], images[1])


@given(st.tuples(*[st.floats(2.0**-15, 64000.0)] * 3))
def test_a_geometry_buffer_stores_irradiance_to_1_1_percent(light: tuple[float, float, float]) -> None:
    bits = evaluate(encode_irradiance, np.array(light, np.float32))
    decoded = np.asarray(evaluate(decode_irradiance, bits), np.float64)
    assert np.abs(decoded / light - 1.0).max() < 0.0112


def test_a_geometry_buffer_tells_no_light_map_from_one_without_light() -> None:
    words = [int(evaluate(encode_irradiance, np.full(3, value, np.float32))) for value in (-1.0, 0.0)]
    assert words[0] != words[1]
    none, dark = (np.asarray(evaluate(decode_irradiance, np.uint32(word))) for word in words)
    assert (none < 0.0).all()
    assert (dark == 0.0).all()


# -- costs ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("technique", sorted(TECHNIQUES))
def test_a_light_map_adds_no_pass_and_no_draw(null: rhi.Device, technique: str) -> None:
    counts = []
    for has_map in (True, False):
        scene = make_rich()
        if not has_map:
            scene.materials["light_map_texture"] = -1
        stream = record(null, scene, TECHNIQUES[technique](), EYE)
        counts.append(
            (len(stream.filter(Op.BEGIN_PASS)), len(stream.draws()), len(stream.filter(Op.DISPATCH)))
        )
    assert counts[0] == counts[1]
    assert counts[0][1] > 0


def test_a_light_map_takes_8_bytes_a_pixel_in_geometry_buffers_and_none_elsewhere(null: rhi.Device) -> None:
    def list_surfaces(scene: Scene) -> list[Format]:
        null.stream.clear()
        with open_renderer(null, scene, TECHNIQUES["deferred"](), visibility="none", size=SIZE) as renderer:
            renderer.render(EYE)
            created = null.stream.filter(Op.CREATE_TEXTURE)
        return [
            command["descriptor"].format
            for command in created
            if "surface" in str(command["descriptor"].label)
        ]

    scene = make_rich()
    without = make_rich()
    without.materials["light_map_texture"] = -1
    assert (list_surfaces(scene), list_surfaces(without)) == ([Format.RGBA32UI], [Format.RG32UI])


def test_light_maps_belong_to_the_ambient_component() -> None:
    def look(component: LightComponent) -> bool:
        effects = collect_frame_effects(make_rich(), EYE, component=component)
        return Effect.LIGHT_MAPS in effects.enabled

    parts = {component for component in LightComponent if look(component)}
    assert parts == {LightComponent.ALL, LightComponent.AMBIENT}


# -- files and values ----------------------------------------------------------------------------------------


def test_a_light_map_and_its_color_are_saved_and_read_again(tmp_path: Path) -> None:
    scene = make_rich()
    scene.materials["light_map_color"][1] = 3.0
    assert save_scene(scene, tmp_path / "baked.glb") == ()
    loaded = load_model(tmp_path / "baked.glb")
    assert np.array_equal(loaded.materials, scene.materials)
    assert np.array_equal(loaded.textures, scene.textures)
    assert all(np.array_equal(*images) for images in zip(loaded.images, scene.images, strict=True))


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"light_map_color": (1.0, -0.1, 1.0)}, "0 to 1e\\+06"),
        ({"light_map_color": 2.0}, "light_map_color"),
        ({"light_map_texture": 7}, "an image's id"),
    ],
)
def test_values_of_light_maps_are_checked(values: dict[str, Any], message: str) -> None:
    builder = make_boxes()
    with pytest.raises(ValidationError, match=rf"scene-(bad-material|bad-index)(.|\n)*{message}"):
        builder.add_material(**values)
    builder.add_material(light_map_color=(0.0, 1e6, 1.0))
