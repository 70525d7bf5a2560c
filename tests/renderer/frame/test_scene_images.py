"""Images by size: few arrays, and little more memory than their texels take."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from frames import EYE, draw, make_boxes, max_difference, open_renderer
from hypothesis import given
from hypothesis import strategies as st
from nightly_reasons import ONLY_KERNELS

import rhi
from renderer.frame import TextureSettings
from renderer.frame.scene_images import (
    MAX_ARRAYS,
    SceneImages,
    count_bindings,
    count_bytes,
    plan_arrays,
)
from renderer.scene import AlphaMode, Camera, Orthographic, Scene, SceneBuilder, TextureMap
from renderer.techniques import TECHNIQUES, ForwardPlus
from rhi import Format, Op, SamplerDescriptor, Wrap
from rhi.backends.null.null_capabilities import get_profile

CLAMPED = SamplerDescriptor(wrap_u=Wrap.CLAMP, wrap_v=Wrap.CLAMP)


@pytest.fixture
def few_slots() -> Iterator[rhi.Device]:
    """A device with the slots that WebGPU promises."""
    profile = replace(get_profile("everything"), max_storage_slots=8, max_texture_slots=16)
    with rhi.create_device("null", profile=profile) as device:
        yield device


def scene_of(*sizes: tuple[int, int]) -> Scene:
    """Make boxes in one place, each with a black image of one of these sizes."""
    builder = make_boxes()
    for width, height in sizes:
        add_box(builder, texture=builder.add_image(np.zeros((height, width, 4), np.uint8)))
    return builder.build()


def add_box(builder: SceneBuilder, **material: Any) -> None:
    builder.add_objects(builder.add_node(), 0, builder.add_material(**material))


def bytes_of(sizes: list[tuple[int, int]]) -> int:
    return sum(map(count_bytes, sizes))


def test_the_bytes_of_an_image_are_those_of_all_its_levels() -> None:
    assert count_bytes((1, 1)) == 4
    assert count_bytes((4, 2)) == 4 * (8 + 2 + 1)
    assert count_bytes((8192, 1)) == 4 * (2 * 8192 - 1)


def test_images_of_one_size_are_the_layers_of_one_array() -> None:
    uses = [(0, True, 0), (1, True, 0), (2, True, 0), (1, True, 0)]
    (array,) = plan_arrays([(8, 8)] * 3, uses, [Format.RGBA8_SRGB] * 4)
    assert array.images == (0, 1, 2)


def test_colours_and_data_and_sizes_have_arrays_of_their_own() -> None:
    sizes = [(8, 8), (16, 8), (1, 1), (8192, 1)]
    uses = [(0, True, 0), (0, False, 0), (1, True, 0), (2, True, 0), (3, True, 0)]
    arrays = plan_arrays(sizes, uses, [Format.RGBA8] * 5)
    assert [(array.size, array.is_color) for array in arrays] == [
        ((8, 8), True),
        ((8, 8), False),
        ((16, 8), True),
        ((1, 1), True),
        ((8192, 1), True),
    ]
    assert sum(array.bytes for array in arrays) == bytes_of([*sizes, sizes[0]])


@given(st.lists(st.tuples(st.integers(1, 40), st.integers(1, 40)), min_size=1, max_size=24))
def test_arrays_take_the_memory_of_their_images(sizes: list[tuple[int, int]]) -> None:
    uses = [(image, bool(image % 3), image % 2) for image in range(len(sizes))]
    formats = [Format.RGBA8] * len(uses)
    arrays = plan_arrays(sizes, uses, formats)
    assert sum(array.bytes for array in arrays) == bytes_of(sizes)
    assert sum(len(array.samplers) for array in arrays) == count_bindings(sizes, uses, formats)
    for image, is_color, sampler in uses:
        assert [a for a in arrays if a.is_color == is_color and image in a.images and sampler in a.samplers]


def test_the_device_has_the_memory_that_is_counted(null: rhi.Device) -> None:
    sizes = [(64, 64), (64, 64), (1, 1), (256, 16)]
    images = SceneImages(null, scene_of(*sizes))
    assert images.image_bytes == images.bytes == bytes_of(sizes)
    assert sorted((texture.size, texture.layers) for texture in images.textures) == [
        ((1, 1), 1),
        ((64, 64), 2),
        ((256, 16), 1),
    ]


def test_plain_textures_need_no_table(null: rhi.Device) -> None:
    assert SceneImages(null, scene_of((8, 8), (8, 8))).table is None
    assert SceneImages(null, scene_of((8, 8), (16, 8))).table is not None


def test_an_image_with_two_samplers_is_there_once(null: rhi.Device) -> None:
    builder = make_boxes()
    image = builder.add_image(np.zeros((8, 8, 4), np.uint8))
    for texture in (TextureMap(image), TextureMap(image, sampler=CLAMPED)):
        add_box(builder, texture=texture)
    images = SceneImages(null, builder.build())
    assert len(images.textures) == 1
    assert len(images.arrays) == 2
    assert images.bytes == count_bytes((8, 8))


def test_more_samplers_than_arrays_are_those_of_a_table(few_slots: rhi.Device) -> None:
    builder = make_boxes()
    image = builder.add_image(np.zeros((8, 8, 4), np.uint8))
    for number in range(MAX_ARRAYS + 2):
        add_box(builder, texture=TextureMap(image, sampler=SamplerDescriptor(max_anisotropy=1.0 + number)))
    images = SceneImages(few_slots, builder.build())
    assert images.tables is not None
    assert images.tables[0] is not None
    assert [sampler.max_anisotropy for sampler in images.tables[0].samplers] == [
        1.0 + number for number in range(MAX_ARRAYS + 2)
    ]


@pytest.mark.parametrize("technique", TECHNIQUES)
def test_techniques_draw_images_of_many_sizes_within_the_slots_of_webgpu(
    few_slots: rhi.Device, technique: str
) -> None:
    builder = make_boxes()
    sizes = [(30 + number, 20) for number in range(MAX_ARRAYS + 1)]
    for width, height in sizes:
        image = builder.add_image(np.zeros((height, width, 4), np.uint8))
        normal = builder.add_image(np.zeros((height, width, 4), np.uint8))
        add_box(builder, texture=image, normal_texture=normal)
    builder.lights.add_point((0, 0, 2), 5.0)
    with open_renderer(few_slots, builder.build(), TECHNIQUES[technique]()) as renderer:
        renderer.render(EYE)
    created = [command["descriptor"] for command in few_slots.stream.filter(Op.CREATE_PROGRAM)]
    names = {binding.name for program in created for binding in program.bindings}
    assert {"image_table_words", "map_table_words"} <= names


def test_colors_and_data_are_in_arrays_of_their_own_that_passes_read_alone(null: rhi.Device) -> None:
    """A depth pass reads masks: colours, and no normals."""
    builder = make_boxes()
    for size in (8, 16):
        texels = np.full((size, size, 4), 255, np.uint8)
        texels[0, 0, 3] = 0  # else no pixel is masked
        normal, color = (builder.add_image(texels) for _ in range(2))
        add_box(builder, texture=color, normal_texture=normal, alpha_mode=AlphaMode.MASK)
    builder.lights.add_point((0, 0, 2), 5.0)  # without one, no depth is drawn first
    scene = builder.build()
    images = SceneImages(null, scene)
    assert (len(images.colors), len(images.data)) == (2, 2)
    assert images.table is not None
    arrays, materials = images.table.read()["array"], scene.materials[1:]
    assert arrays[materials["texture"]].tolist() == arrays[materials["normal_texture"]].tolist() == [0, 1]
    with open_renderer(null, scene, ForwardPlus()) as renderer:
        renderer.render(EYE)
    names = [
        {binding.name for binding in c["descriptor"].bindings} for c in null.stream.filter(Op.CREATE_PROGRAM)
    ]
    reading = [name & {"images", "images_1", "maps", "maps_1"} for name in names if "images" in name]
    assert reading == [{"images", "images_1"}, {"images", "images_1", "maps", "maps_1"}]


@pytest.mark.parametrize("size", [(1, 1), (8192, 1)])
def test_extreme_images_are_drawn(gl: rhi.Device, size: tuple[int, int]) -> None:
    images = SceneImages(gl, scene_of(size))
    assert images.textures[0].size == size


TEXELS = 32


def draw_texels(
    device: rhi.Device, image: Any, bias: float, technique: str = "forward", more: int = 0
) -> Any:
    """Draw a face of a box, on which an image of `TEXELS` has a texel for each pixel; with `more`, by a
    table."""
    builder = make_boxes()
    for texels in (image, *[np.zeros((8, 8, 4), np.uint8)] * more):
        add_box(builder, texture=builder.add_image(texels), emission=1.0)
    camera = Camera.look_at((0, 0, 10), (0, 0, 0)).with_projection(Orthographic(1.0, 1.0))
    textures = TextureSettings(mip_bias=bias)
    scene = builder.build()
    scene.objects.is_shown[1:] = False
    return draw(device, scene, TECHNIQUES[technique](), camera, size=(TEXELS, TEXELS), textures=textures)


@pytest.mark.nightly_cases("cl-*", reason=ONLY_KERNELS)
@pytest.mark.parametrize(("technique", "more"), [("forward", 0), ("forward", 1), ("deferred_plus", 0)])
def test_a_bias_of_a_level_shows_half_as_many_texels(
    drawing_device: rhi.Device, technique: str, more: int
) -> None:
    """Blocks of 2 × 2 equal texels are what an image of half the size has; one level more shows that."""
    small = np.full((TEXELS // 2, TEXELS // 2, 4), 255, np.uint8)
    small[..., :3] = np.random.default_rng(1).integers(0, 256, small.shape[:2])[..., None]
    image = small.repeat(2, 0).repeat(2, 1)
    arguments = technique, more
    coarse, fine = (draw_texels(drawing_device, image, bias, *arguments) for bias in (1.0, 0.0))
    assert max_difference(coarse, draw_texels(drawing_device, small, 0.0, *arguments)) <= 1
    assert max_difference(coarse, fine) > 50
    assert (
        max_difference(fine, draw_texels(drawing_device, image, -1.0, *arguments)) <= 1
    )  # there is no finer level
    assert np.ptp(draw_texels(drawing_device, image, 16.0, *arguments), axis=(0, 1)).max() <= 1


def test_images_of_many_sizes_keep_their_texels_in_tables(gl: rhi.Device) -> None:
    """A 300 × 200 image isn't resampled, whatever the sizes of the others."""
    random = np.random.default_rng(6)
    sizes = [(300, 200), *((8 + 5 * number, 9 + 3 * number) for number in range(2 * MAX_ARRAYS))]
    texels = [random.integers(0, 256, (height, width, 4), np.uint8) for width, height in sizes]
    builder = make_boxes()
    for image in texels:
        add_box(builder, texture=builder.add_image(image))
    images = SceneImages(gl, builder.build())
    assert images.tables is not None
    colors, data = images.tables
    assert colors is not None
    assert data is None
    assert list(colors.sizes) == sizes
    assert images.image_bytes < images.bytes < 1.5 * images.image_bytes
    assert images.table is not None
    (page,) = colors.pages.read_layers()
    blocks = {tuple(rows.reshape(-1)) for rows in page.reshape(-1, 4)}
    assert {tuple(texel) for image in texels for texel in image.reshape(-1, 4)} <= blocks
    images.destroy()


def draw_many_sizes(device: rhi.Device, technique: str, more: int) -> Any:
    """Draw a face of a box with an image of 30 × 20 texels in as many pixels, beside images of more sizes."""
    random = np.random.default_rng(8)
    builder = make_boxes()
    shapes = [(20, 30), *((3 + number, 5) for number in range(more))]
    for height, width in shapes:
        image = np.full((height, width, 4), 255, np.uint8)
        image[..., :3] = random.integers(0, 256, (height, width, 3))
        add_box(builder, texture=builder.add_image(image), emission=1.0)
    camera = Camera.look_at((0, 0, 10), (0, 0, 0)).with_projection(Orthographic(1.0, 1.0))
    scene = builder.build()
    scene.objects.is_shown[1:] = False
    return draw(device, scene, TECHNIQUES[technique](), camera, size=(30, 20))


@pytest.mark.nightly_cases("cl-d*", reason=ONLY_KERNELS)
@pytest.mark.parametrize("technique", ["forward", "deferred", "deferred_plus"])
def test_a_table_shows_the_texels_that_an_array_shows(drawing_device: rhi.Device, technique: str) -> None:
    table, array = (draw_many_sizes(drawing_device, technique, more) for more in (MAX_ARRAYS, 1))
    assert np.ptp(array, axis=(0, 1)).max() > 100
    assert max_difference(table, array) <= 4  # a weight of 8 bits of a neighbour, along two axes
