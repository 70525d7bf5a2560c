"""The pixels of materials: the same in all techniques, and what their parameters say."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from frames import draw, draw_each, first_view_camera, max_difference, open_renderer, read_colors
from material_scene import build_materials, make_noise
from nightly_reasons import FEWER_CASES, ONLY_KERNELS
from numpy.typing import NDArray

import rhi
from renderer.scene import AlphaMode, Camera, SceneBuilder, TextureMap, make_geometry
from renderer.techniques import TECHNIQUES, Deferred, Forward, Inferred, Technique
from rhi import Filter, SamplerDescriptor

COMPARED: dict[str, Callable[[], Technique]] = {
    **{name: make for name, make in TECHNIQUES.items() if name != "forward"},
    "inferred": lambda: Inferred(scale=1.0),
}
"""All techniques but forward shading, with whose image theirs are compared; `inferred` at full size."""
SIZE = (120, 90)
NEAREST = SamplerDescriptor(Filter.NEAREST, Filter.NEAREST, None)


@pytest.mark.nightly_cases("cl-*", reason=ONLY_KERNELS)
@pytest.mark.nightly_cases("gl-True", reason=FEWER_CASES)
@pytest.mark.parametrize("lights", [True, False])
def test_all_techniques_draw_the_same_materials(drawing_device: rhi.Device, lights: bool) -> None:
    scene = build_materials(lights=lights)
    techniques, camera = (
        (Forward(), *(make() for make in COMPARED.values())),
        first_view_camera(scene).with_aspect(4 / 3),
    )
    expected, *images = draw_each(drawing_device, scene, *techniques, camera=camera, size=SIZE)
    assert expected[..., :3].std() > 30.0
    off = {name: max_difference(image, expected) for name, image in zip(COMPARED, images, strict=True)}
    assert max(off.values()) <= 2, off


def square(**material: Any) -> SceneBuilder:
    """Make a square that faces the eye and fills the image."""
    builder = SceneBuilder("square")
    builder.lights.sky = builder.lights.ground = (0.5, 0.5, 0.5)
    positions = [(-2, -2, 0), (2, -2, 0), (2, 2, 0), (-2, 2, 0)]
    images = {
        name: builder.add_image(value) for name, value in material.items() if isinstance(value, np.ndarray)
    }
    geometry = make_geometry(positions, [0, 1, 2, 0, 2, 3], uv=[(0, 1), (1, 1), (1, 0), (0, 0)])
    builder.add_objects(
        builder.add_node(), builder.add_mesh(geometry), builder.add_material(**{**material, **images})
    )
    builder.views["front"] = Camera.look_at((0, 0, 3), (0, 0, 0))
    return builder


SMALL = (16, 16)


def look(device: rhi.Device, builder: SceneBuilder) -> NDArray[Any]:
    scene = builder.build()
    return draw(device, scene, camera=first_view_camera(scene).with_aspect(1.0), size=SMALL)


@pytest.mark.parametrize(("alpha", "drawn"), [(0.25, True), (0.2499, False), (0.2501, True)])
def test_a_mask_keeps_an_alpha_equal_to_the_cutoff(gl: rhi.Device, alpha: float, drawn: bool) -> None:
    mask = square(base_color=(1, 1, 1, alpha), alpha_mode=AlphaMode.MASK, alpha_cutoff=0.25)
    assert (look(gl, mask) > 60).all() == drawn


@pytest.mark.parametrize(("texel", "drawn"), [(63, False), (64, True), (65, True)])
def test_a_texel_exactly_at_the_cut_is_kept(gl: rhi.Device, texel: int, drawn: bool) -> None:
    texture = np.full((4, 4, 4), (255, 255, 255, texel), np.uint8)
    mask = square(base_color=(1, 1, 1), texture=texture, alpha_mode=AlphaMode.MASK, alpha_cutoff=64 / 255)
    assert (look(gl, mask) > 60).all() == drawn


def test_alpha_of_an_opaque_material_means_nothing(gl: rhi.Device) -> None:
    assert (look(gl, square(base_color=(1, 1, 1, 0.0))) > 60).all()


@pytest.mark.parametrize("two_sides", [False, True])
def test_backs_are_drawn_of_materials_with_two_sides_alone(gl: rhi.Device, two_sides: bool) -> None:
    builder = square(base_color=(1, 1, 1), double_sided=two_sides)
    builder.add_material(double_sided=True)  # so that one-sided materials share the scene with two-sided ones
    builder.lights.add_directional((0, 0, 1), (1, 1, 1), 3.0)  # lights the back
    builder.views["front"] = Camera.look_at((0, 0, -3), (0, 0, 0))
    image = look(gl, builder)
    assert (image > 200).all() if two_sides else (image < 60).all()


@pytest.mark.parametrize("technique", [Forward, Deferred, TECHNIQUES["deferred_plus"]])
def test_a_material_that_gets_a_second_side_shows_its_back_from_then_on(
    gl: rhi.Device, technique: Any
) -> None:
    builder = square(base_color=(1, 1, 1))
    builder.lights.add_directional((0, 0, 1), (1, 1, 1), 3.0)  # lights the back
    behind, scene = Camera.look_at((0, 0, -3), (0, 0, 0)), builder.build()
    with open_renderer(gl, scene, technique(), size=SMALL) as renderer:
        seen = []
        for sides in (0, 1, 0):
            scene.materials["double_sided"] = sides
            seen.append(bool((read_colors(renderer.render(behind)) > 200).all()))
    assert seen == [False, True, False]


@pytest.mark.parametrize(
    ("texel", "bends"), [((127, 127, 127), False), ((128,) * 3, False), ((131, 128, 128), True)]
)
def test_a_normal_map_without_a_direction_leaves_the_normal(gl: rhi.Device, texel: Any, bends: bool) -> None:
    texture = np.full((4, 4, 4), (*texel, 255), np.uint8)
    images = []
    for maps in ({}, {"normal_texture": texture}):
        builder = square(roughness=0.5, **maps)
        builder.lights.add_directional((0, -1, -1), (1, 1, 1), 1.0)
        images.append(look(gl, builder))
    assert (max_difference(images[0], images[1]) > 10) == bends


@pytest.mark.parametrize(("texel", "towards"), [((255, 128, 128), (-1, 0, 0)), ((128, 255, 128), (0, -1, 0))])
def test_red_bends_normals_along_u_and_green_up(gl: rhi.Device, texel: Any, towards: Any) -> None:
    """Light that comes from where the bent normal points to reaches the square, and from the other side
    doesn't."""
    texture = np.full((4, 4, 4), (*texel, 255), np.uint8)
    lit = []
    for sign in (1.0, -1.0):
        builder = square(base_color=(1, 1, 1), roughness=1.0, metallic=0.0, normal_texture=texture)
        builder.lights.sky = builder.lights.ground = (0.0, 0.0, 0.0)
        builder.lights.add_directional(np.multiply(towards, sign), (1, 1, 1), 1.0)
        lit.append(look(gl, builder).mean())
    assert lit[0] > 150
    assert lit[1] < 10


def test_emissive_texels_multiply_the_emissive_color(gl: rhi.Device) -> None:
    texture = np.full((4, 4, 4), (255, 0, 255, 255), np.uint8)
    builder = square(
        base_color=(0, 0, 0), emissive=(0.5, 0.5, 0.0), emissive_texture=texture, specular_color=(0, 0, 0)
    )
    red, green, blue = look(gl, builder).reshape(-1, 3).max(0)
    assert red > 150
    assert green == blue == 0


def test_occlusion_darkens_by_its_strength(gl: rhi.Device) -> None:
    texture = np.zeros((4, 4, 4), np.uint8)
    seen = [
        look(
            gl, square(base_color=(1, 1, 1), roughness=1.0, occlusion_texture=texture, occlusion_strength=s)
        ).mean()
        for s in (0.0, 0.5, 1.0)
    ]
    assert seen[0] > seen[1] > seen[2] == 0.0


@pytest.mark.parametrize("uv", [(1000.3, -0.25), (-0.25, 1000.3), (0.3, 0.75)])
def test_texture_coordinates_beyond_1_repeat(gl: rhi.Device, uv: tuple[float, float]) -> None:
    """The square shows one texel: that of the fractional parts of its texture coordinates."""
    texture = make_noise((32, 32), 1)
    texture = texture[::4, ::4].copy()  # 8 × 8 different texels
    texture_map = TextureMap(0, scale=(0.0, 0.0), offset=uv, sampler=NEAREST)
    builder = SceneBuilder("square")
    builder.add_image(texture)
    builder.lights.sky = builder.lights.ground = (0.5, 0.5, 0.5)
    geometry = make_geometry([(-2, -2, 0), (2, -2, 0), (2, 2, 0), (-2, 2, 0)], [0, 1, 2, 0, 2, 3])
    white = {"base_color": (1, 1, 1), "specular_color": (0, 0, 0)}
    material = builder.add_material(texture=texture_map, **white)
    builder.add_objects(builder.add_node(), builder.add_mesh(geometry), material)
    builder.views["front"] = Camera.look_at((0, 0, 3), (0, 0, 0))
    column, row = (int(np.floor(x % 1.0 * 8)) for x in uv)
    alike = np.full((8, 8, 4), texture[row, column], np.uint8)
    assert max_difference(look(gl, builder), look(gl, square(texture=alike, **white))) <= 1


@pytest.mark.parametrize("name", ["frustum", "two_pass", "chc_plus_plus"])
def test_masks_hide_nothing_behind_their_holes(gl: rhi.Device, name: str) -> None:
    scene = build_materials(lights=False)
    camera = scene.views["front"].with_aspect(SIZE[0] / SIZE[1])
    images = [
        draw(gl, scene, camera=camera, visibility=algorithm, frames=3, size=SIZE)
        for algorithm in ("none", name)
    ]
    assert np.array_equal(*images)


@pytest.mark.nightly_cases("cl-*", reason=ONLY_KERNELS)
@pytest.mark.parametrize("axis", [0, 1])
def test_images_at_the_second_coordinates_are_filtered_by_their_changes(
    drawing_device: rhi.Device, axis: int
) -> None:
    """Stripes far narrower than pixels are grey, whichever way the second coordinates change; the first
    don't."""
    builder = SceneBuilder("stripes")
    builder.lights.sky = builder.lights.ground = (0.5, 0.5, 0.5)
    stripes = np.full((16, 16, 4), 255, np.uint8)
    stripes[(slice(None, None, 2),) if axis else (slice(None), slice(None, None, 2))] = (0, 0, 0, 255)
    positions = np.array([(-2, -2, 0), (2, -2, 0), (2, 2, 0), (-2, 2, 0)], float)
    fast = np.zeros((4, 2))
    fast[:, axis] = 100.0 * positions[:, axis]
    geometry = make_geometry(positions, [0, 1, 2, 0, 2, 3], uv=np.zeros((4, 2)), uv2=fast)
    material = builder.add_material(texture=TextureMap(builder.add_image(stripes), uv_set=1))
    builder.add_objects(builder.add_node(), builder.add_mesh(geometry), material)
    builder.views["front"] = Camera.look_at((0, 0, 3), (0, 0, 0))
    drawn = look(drawing_device, builder)[..., :3]
    assert np.ptp(drawn) <= 2
    assert 60 < drawn.mean() < 200
