"""Images by size: few arrays, and little more memory than their texels take."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from frames import EYE, draw, make_boxes, max_difference, open_renderer
from hypothesis import given, settings
from hypothesis import strategies as st

import rhi
from renderer.frame import TextureSettings
from renderer.frame.scene_images import MAX_ARRAYS, MAX_MEMORY_RATIO, SceneImages, count_bytes, plan_arrays
from renderer.scene import AlphaMode, Camera, Orthographic, Scene, SceneBuilder, TextureMap
from renderer.techniques import TECHNIQUES, ForwardPlus
from rhi import Filter, Op, SamplerDescriptor, Wrap

CLAMPED = SamplerDescriptor(wrap_u=Wrap.CLAMP, wrap_v=Wrap.CLAMP)


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
    (array,) = plan_arrays([(8, 8), (8, 8), (8, 8)], [(0, True, 0), (1, True, 0), (2, True, 0), (1, True, 0)])
    assert array.images == (0, 1, 2)


def test_colours_and_data_and_sizes_have_arrays_of_their_own() -> None:
    sizes = [(8, 8), (16, 8), (1, 1), (8192, 1)]
    arrays = plan_arrays(sizes, [(0, True, 0), (0, False, 0), (1, True, 0), (2, True, 0), (3, True, 0)])
    assert [(array.size, array.is_color) for array in arrays] == [
        ((8, 8), True),
        ((8, 8), False),
        ((16, 8), True),
        ((1, 1), True),
        ((8192, 1), True),
    ]
    assert sum(array.bytes for array in arrays) == bytes_of([*sizes, sizes[0]])


def test_a_scene_of_many_sizes_joins_the_smallest_arrays() -> None:
    sizes = [(1 << k, 1 << k) for k in range(12)]
    arrays = plan_arrays(sizes, [(image, True, 0) for image in range(12)])
    assert len(arrays) == MAX_ARRAYS
    assert (2048, 2048) in {array.size for array in arrays}
    assert sum(array.bytes for array in arrays) <= 1.001 * bytes_of(sizes)


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.tuples(st.integers(1, 2048), st.integers(1, 2048)), min_size=1, max_size=24),
    st.randoms(use_true_random=False),
)
def test_arrays_take_little_more_memory_than_their_images(
    sizes: list[tuple[int, int]], random: object
) -> None:
    uses = [(image, bool(image % 3), image % 2) for image in range(len(sizes))]
    arrays = plan_arrays(sizes, uses)
    assert sum(len(array.samplers) for array in arrays) <= MAX_ARRAYS
    assert sum(array.bytes for array in arrays) <= MAX_MEMORY_RATIO * bytes_of(sizes) + 4 * len(sizes)
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


def test_rare_samplers_give_way_where_there_are_too_many(null: rhi.Device) -> None:
    builder = make_boxes()
    image = builder.add_image(np.zeros((8, 8, 4), np.uint8))
    for number in range(MAX_ARRAYS + 2):
        add_box(builder, texture=TextureMap(image, sampler=SamplerDescriptor(max_anisotropy=1.0 + number)))
    assert len(SceneImages(null, builder.build()).arrays) == MAX_ARRAYS // 2


@pytest.mark.parametrize("nearest", [True, False])
def test_images_in_an_array_of_another_size_are_resampled(null: rhi.Device, nearest: bool) -> None:
    """The smallest images of too many sizes share an array; each shows what it did, larger."""
    magnify = Filter.NEAREST if nearest else Filter.LINEAR
    random = np.random.default_rng(5)
    builder = make_boxes()
    images = [random.integers(0, 256, (1 << k, 1 << k, 4), np.uint8) for k in range(9)]
    for image in images:
        add_box(
            builder, texture=TextureMap(builder.add_image(image), sampler=SamplerDescriptor(magnify=magnify))
        )
    scene_images = SceneImages(null, builder.build())
    assert scene_images.table is not None
    joined = 0
    for image, use in zip(images, scene_images.table.read(), strict=True):
        layer = scene_images.textures[int(use["array"])].read(layer=int(use["layer"])).astype(int)
        factor = len(layer) // len(image)
        wider = image.repeat(factor, 0).repeat(factor, 1).astype(int)
        joined += factor > 1
        if nearest or factor == 1:
            assert np.array_equal(layer, wider)
        else:  # as smooth as noise becomes, and as bright
            assert np.abs(np.diff(layer, axis=0)).max() < 200
            assert np.abs(layer.mean((0, 1)) - wider.mean((0, 1))).max() < 40
    assert joined


def test_colors_and_data_are_in_arrays_of_their_own_that_passes_read_alone(null: rhi.Device) -> None:
    """A depth pass reads masks: colours, and no normals."""
    builder = make_boxes()
    for size in (8, 16):
        normal, color = (builder.add_image(np.zeros((size, size, 4), np.uint8)) for _ in range(2))
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
