"""Texture tables: each image is read as a texture of its own would be, whatever its size and its number."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import rhi.shading as sl
from rhi import Device, Filter, Format, SamplerDescriptor, Wrap
from rhi.conformance.compare import assert_near, assert_same
from rhi.conformance.formats import random_texels, require_format

pytestmark = pytest.mark.requires("shading", "max_texture_slots")

SIZES = ((30, 20), (8, 8), (17, 5), (3, 40), (1, 1), (64, 2))
"""Width and height of the images: even, odd, long along each axis, a single texel."""
TILE = 16
"""Pixels of the square in which an image is drawn."""
FILTERED = "linear filters have 8 fraction bits at least, here two at a time"
SELECTED = "devices approximate the level that a pixel needs"


def make_images(seed: int = 1) -> list[NDArray[Any]]:
    """Return images of random texels."""
    rng = np.random.default_rng(seed)
    return [rng.integers(0, 256, (height, width, 4), dtype=np.uint8) for width, height in SIZES]


def make_waves() -> list[NDArray[Any]]:
    """Return images whose texels differ little from their neighbours, also across their edges."""
    waves = []
    for width, height in SIZES:
        x, y = np.meshgrid(np.arange(width) / width, np.arange(height) / height)
        parts = (
            np.sin(2 * np.pi * (x + phase)) * np.cos(2 * np.pi * (y - phase)) for phase in (0, 0.2, 0.4, 0.7)
        )
        waves.append((np.stack(list(parts), -1) * 100 + 127).astype(np.uint8))
    return waves


class Placement(sl.Struct):
    """The repetitions of an image in a tile, their start, and the tile that is drawn (-1: all)."""

    scale: sl.vec2
    offset: sl.vec2
    tile: int


class TileShader(sl.FullScreen):
    """The base of shaders that draw an image in each tile."""

    placement: sl.Uniform[Placement]

    def uv(self) -> sl.vec2:
        pixel = sl.fragment_coordinate().xy
        x = pixel.x - float(self.tile() * TILE)
        return sl.vec2(x, pixel.y) / float(TILE) * self.placement.scale + self.placement.offset

    def tile(self) -> int:
        return int(sl.fragment_coordinate().x) // TILE


class TableTiles(TileShader):
    """Reads the image of each tile from a table: the index differs from pixel to pixel."""

    images: sl.TextureTable

    def fragment(self) -> sl.vec4:
        return self.images[self.tile()].sample(self.uv())


class OneTile(TileShader):
    """Reads a texture of its own, in one tile."""

    image: sl.Texture2D

    def fragment(self) -> sl.vec4:
        color = self.image.sample(self.uv())
        if self.tile() != self.placement.tile:
            sl.discard()
        return color


class ReadTable(sl.Shader):
    """Reads the images at (column, row, level, image): a texel, sizes, and the texel by an unsigned index."""

    images: sl.TextureTable
    positions: sl.Storage[sl.ivec4]
    results: sl.StorageRW[sl.vec4]

    def compute(self) -> None:
        i = sl.global_id().x
        at = self.positions[i]
        size = self.images[at.w].size(at.z)
        levels = self.images[at.w].levels()
        self.results[3 * i] = self.images[at.w].load(at.xy, at.z)
        self.results[3 * i + 1] = sl.vec4(sl.vec2(size), float(levels), float(len(self.images)))
        self.results[3 * i + 2] = self.images[sl.uint(at.w)].load(at.xy, at.z)


class SampleTable(sl.Shader):
    """Samples the images at (u, v, level, image)."""

    images: sl.TextureTable
    positions: sl.Storage[sl.vec4]
    results: sl.StorageRW[sl.vec4]

    def compute(self) -> None:
        at = self.positions[sl.global_id().x]
        self.results[sl.global_id().x] = self.images[int(at.w)].sample_lod(at.xy, at.z)


class SampleTexture(sl.Shader):
    """Samples a texture at (u, v, level)."""

    image: sl.Texture2D
    positions: sl.Storage[sl.vec4]
    results: sl.StorageRW[sl.vec4]

    def compute(self) -> None:
        at = self.positions[sl.global_id().x]
        self.results[sl.global_id().x] = self.image.sample_lod(at.xy, at.z)


class TwoTables(sl.Shader):
    """Reads an image of each of two tables."""

    colors: sl.TextureTable
    heights: sl.TextureTable
    results: sl.StorageRW[sl.vec4]

    def compute(self) -> None:
        i = int(sl.global_id().x)
        self.results[2 * i] = self.colors[i].load(sl.ivec2(0, 0))
        self.results[2 * i + 1] = self.heights[i].load(sl.ivec2(0, 0))


def draw_tiles(
    device: Device,
    images: list[NDArray[Any]],
    sampler: SamplerDescriptor,
    scale: tuple[float, float],
    form: Format = Format.RGBA8,
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the pixels of one draw that reads a table, and of a draw for each texture."""
    size = TILE * len(images), TILE
    values = {"scale": scale, "offset": (-0.3, -0.6)}
    with (
        device.texture(size, Format.RGBA8) as target,
        device.mesh(3) as whole,
        device.texture_table(images, form, samplers=sampler) as table,
    ):
        program = device.program(TableTiles)
        with device.render_pass(target, clear=(0, 0, 0, 0)):
            device.draw(program, whole, images=table, placement=Placement(**values, tile=-1))
        together = target.read()
        textures = [device.texture(image, form, levels=None) for image in images]
        with device.render_pass(target, clear=(0, 0, 0, 0)):
            for tile, texture in enumerate(textures):
                placement = Placement(**values, tile=tile)
                device.draw(
                    device.program(OneTile), whole, image=texture.sampled(sampler), placement=placement
                )
        apart = target.read()
        for texture in textures:
            texture.destroy()
    return together.astype(int), apart.astype(int)


def run(
    device: Device, shader: Any, positions: NDArray[Any], count: int = 1, **bindings: Any
) -> NDArray[Any]:
    """Return the results of a compute shader, `count` for each position."""
    element = sl.ivec4 if positions.dtype == np.int32 else sl.vec4
    with (
        device.storage(element, positions) as storage,
        device.storage(sl.vec4, count * len(positions)) as results,
    ):
        device.dispatch(
            device.program(shader), len(positions), positions=storage, results=results, **bindings
        )
        return results.read()


@pytest.mark.requires("draws")
@pytest.mark.parametrize("filter", Filter, ids=lambda filter: filter.name)
@pytest.mark.parametrize(
    ("wrap_u", "wrap_v"),
    [(Wrap.REPEAT, Wrap.REPEAT), (Wrap.MIRROR, Wrap.CLAMP), (Wrap.CLAMP, Wrap.MIRROR)],
    ids=lambda wrap: wrap.name,
)
def test_an_enlarged_image_of_a_table_is_filtered_and_wrapped_as_a_texture(
    device: Device, wrap_u: Wrap, wrap_v: Wrap, filter: Filter
) -> None:
    sampler = SamplerDescriptor(filter, filter, None, wrap_u, wrap_v)
    together, apart = draw_tiles(device, make_images(), sampler, (1.7, 2.3))
    if filter is Filter.NEAREST:
        assert_same(together, apart)
    else:
        assert_near(together, apart, tolerance=3, reason=FILTERED)


@pytest.mark.requires("draws")
@pytest.mark.parametrize("form", [Format.RGBA8, Format.RGBA8_SRGB], ids=lambda form: form.name)
def test_a_reduced_image_of_a_table_is_read_from_its_own_mip_levels(device: Device, form: Format) -> None:
    together, apart = draw_tiles(device, make_waves(), SamplerDescriptor(), (4.3, 5.9), form)
    assert_near(together, apart, tolerance=14, reason=SELECTED)
    assert np.abs(together - apart).mean() < 1.5


@pytest.mark.requires("compute")
def test_texels_sizes_and_levels_of_images_are_their_own(device: Device) -> None:
    images, positions, expected = make_images(), [], []
    for index, image in enumerate(images):
        height, width = image.shape[:2]
        levels = max(width, height).bit_length()
        for x, y in ((0, 0), (width - 1, height - 1), (width // 2, height // 3)):
            positions.append((x, y, 0, index))
            texel = image[y, x] / 255
            expected += [texel, (width, height, levels, len(images)), texel]
        positions.append((0, 0, levels - 1, index))
        mean = image.reshape(-1, 4).mean(0) / 255
        expected += [mean, (1, 1, levels, len(images)), mean]
    with device.texture_table(images) as table:
        results = run(device, ReadTable, np.array(positions, np.int32), 3, images=table)
    reason = "each of up to 6 levels is rounded to 8 bits"
    assert_near(results, np.array(expected), tolerance=3.5 / 255, reason=reason)


@pytest.mark.requires("compute")
def test_texels_levels_and_images_outside(device: Device) -> None:
    """A texel or level that doesn't exist is zeros; the nearest image stands for one that doesn't."""
    images = make_images()
    first, last = images[0][0, 0] / 255, images[-1][0, 0] / 255
    zeros = np.zeros(4)
    cases: list[tuple[tuple[int, int, int, int], Any, Any]] = [
        ((30, 0, 0, 0), zeros, zeros),
        ((-1, 0, 0, 0), zeros, zeros),
        ((0, 20, 0, 0), zeros, zeros),
        ((0, -1, 0, 0), zeros, zeros),
        ((0, 0, 5, 0), zeros, zeros),
        ((0, 0, -1, 0), zeros, zeros),
        ((0, 0, 0, 6), last, last),
        ((0, 0, 0, 2**31 - 1), last, last),
        ((0, 0, 0, -1), first, last),  # as a uint it is the largest
        ((0, 0, 0, -(2**31)), first, last),
    ]
    with device.texture_table(images) as table:
        positions = np.array([position for position, _, _ in cases], np.int32)
        results = run(device, ReadTable, positions, 3, images=table).reshape(-1, 3, 4)
    assert_same(np.round(results[:, 0] * 255), np.round([signed * 255 for _, signed, _ in cases]))
    assert_same(np.round(results[:, 2] * 255), np.round([unsigned * 255 for _, _, unsigned in cases]))


@pytest.mark.requires("compute")
@pytest.mark.parametrize("mip", [None, *Filter], ids=lambda mip: getattr(mip, "name", "NO"))
def test_explicit_levels_are_those_of_a_texture(device: Device, mip: Filter | None) -> None:
    rng, images = np.random.default_rng(3), make_images()
    sampler = SamplerDescriptor(mip=mip, wrap_u=Wrap.MIRROR)
    lods = (-1.0, 0.0, 0.25, 1.0, 1.75, 3.0, 40.0)
    positions = np.array(
        [
            (*rng.uniform(-1.5, 1.5, 2), lod, index)
            for index in range(len(images))
            for lod in lods
            for _ in range(4)
        ],
        np.float32,
    )
    with device.texture_table(images, samplers=sampler) as table:
        together = run(device, SampleTable, positions, images=table)
    for index, image in enumerate(images):
        with device.texture(image, levels=None) as texture:
            selected = positions[:, 3] == index
            apart = run(device, SampleTexture, positions[selected], image=texture.sampled(sampler))
        assert_near(together[selected], apart, tolerance=4 / 255, reason=FILTERED)


@pytest.mark.requires("compute")
def test_each_image_has_its_own_sampler_and_a_border_needs_no_capability(device: Device) -> None:
    image = np.full((4, 4, 4), 255, np.uint8)
    border = SamplerDescriptor(wrap_u=Wrap.BORDER, wrap_v=Wrap.BORDER, border=(1.0, 0.0, 0.0, 0.0), mip=None)
    positions = np.array(
        [(-0.5, 0.5, 0, 0), (0.5, 1.5, 0, 0), (0.5, 0.5, 0, 0), (-0.5, 0.5, 0, 1)], np.float32
    )
    with device.texture_table([image, image], samplers=[border, SamplerDescriptor()]) as table:
        results = run(device, SampleTable, positions, images=table)
    expected = [[1, 0, 0, 0], [1, 0, 0, 0], [1, 1, 1, 1], [1, 1, 1, 1]]
    assert_near(results, expected, tolerance=1e-6, reason="coordinates of pages are rounded")


@pytest.mark.requires("compute")
@pytest.mark.parametrize(
    "form",
    [Format.R8, Format.RG8, Format.RGBA8_SRGB, Format.RGBA8_SNORM, Format.RGB10A2, Format.RGBA16F],
    ids=lambda form: form.name,
)
def test_images_keep_the_texels_of_their_format(device: Device, form: Format) -> None:
    require_format(device, form)
    if form in device.capabilities.unfilterable_formats:
        pytest.skip(f"the device can't filter {form.name}")
    images = [random_texels(form, height, width) for width, height in SIZES]
    positions, single = [], []
    for index, (width, height) in enumerate(SIZES):
        at = [(x / width + 0.5 / width, 0.5 / height, 0, index) for x in range(width)]
        positions += at
        with device.texture(images[index], form) as texture:
            sampler = SamplerDescriptor(Filter.NEAREST, Filter.NEAREST, None)
            points = np.array(at, np.float32)
            single.append(run(device, SampleTexture, points, image=texture.sampled(sampler)))
    with device.texture_table(images, form, samplers=sampler, levels=1) as table:
        together = run(device, SampleTable, np.array(positions, np.float32), images=table)
    assert_same(together, np.concatenate(single))


@pytest.mark.requires("compute")
def test_two_tables_are_read_in_one_program(device: Device) -> None:
    colors = [np.full((n, 7 - n, 4), 40 * n, np.uint8) for n in (1, 2, 3)]
    heights = [np.full((2 * n, n), n / 4, np.float16) for n in (1, 2, 3)]
    with (
        device.texture_table(colors) as first,
        device.texture_table(heights) as second,
        device.storage(sl.vec4, 6) as results,
    ):
        device.dispatch(device.program(TwoTables), 3, colors=first, heights=second, results=results)
        numbers = results.read()
    assert_near(numbers[::2, 0] * 255, [40, 80, 120], tolerance=1e-3, reason="fractions of 255")
    assert_same(numbers[1::2, 0], [0.25, 0.5, 0.75])


@pytest.mark.requires("compute")
def test_textures_bring_their_own_levels_and_are_copied_again(device: Device) -> None:
    level = np.full((4, 8, 4), 10, np.uint8)
    with device.texture((8, 4), Format.RGBA8, levels=3) as texture:
        for number in range(3):
            texture.write(level[: 4 >> number, : 8 >> number] * (number + 1), level=number)
        with device.texture_table([level * 0, texture]) as table:
            positions = np.array([(0, 0, number, 1) for number in range(4)], np.int32)
            before = run(device, ReadTable, positions, 3, images=table)[::3, 0] * 255
            texture.write(level * 9)
            unchanged = run(device, ReadTable, positions, 3, images=table)[::3, 0] * 255
            table.copy_from(texture, 1)
            after = run(device, ReadTable, positions, 3, images=table)[::3, 0] * 255
    assert_same(np.round(before), [10, 20, 30, 0])
    assert_same(np.round(unchanged), [10, 20, 30, 0])
    assert_same(np.round(after), [90, 20, 30, 0])


@pytest.mark.requires("compute")
def test_images_of_sizes_are_zero_until_textures_are_copied_to_them(device: Device) -> None:
    texels = np.full((4, 8, 4), 90, np.uint8)
    positions = np.array([(7, 3, 0, 0), (0, 0, 2, 1), (1, 3, 1, 2)], np.int32)
    with (
        device.texture_table([(8, 4), texels, (4, 8)], Format.RGBA8) as table,
        device.texture(texels, levels=None) as wide,
        device.texture(texels.swapaxes(0, 1).copy() // 2, levels=None) as tall,
    ):
        assert table.sizes == ((8, 4), (8, 4), (4, 8))
        assert table.levels == (4, 4, 4)
        before = run(device, ReadTable, positions, 3, images=table)[::3, 0] * 255
        table.copy_from(wide, 0)
        table.copy_from(tall, 2)
        after = run(device, ReadTable, positions, 3, images=table)[::3, 0] * 255
    assert_same(np.round(before), [0, 90, 0])
    assert_same(np.round(after), [90, 90, 45])


@pytest.mark.requires("compute")
@pytest.mark.parametrize("wrap", Wrap, ids=lambda wrap: wrap.name)
def test_long_strips_along_both_axes_need_no_square_page(device: Device, wrap: Wrap) -> None:
    rng = np.random.default_rng(7)
    sizes = ((256, 4), (4, 256), (3, 200))
    images = [rng.integers(0, 256, (height, width, 4), dtype=np.uint8) for width, height in sizes]
    sampler = SamplerDescriptor(wrap_u=wrap, wrap_v=Wrap.CLAMP, border=(1.0, 0.5, 0.0, 1.0))
    positions = np.array(
        [(*rng.uniform(-1, 2, 2), lod, index) for index in range(3) for lod in (0, 0.5, 2) for _ in range(8)],
        np.float32,
    )
    with device.texture_table(images, samplers=sampler) as table:
        assert table.bytes < 2.5 * table.image_bytes
        width, height = table.pages.size
        assert width * height * table.pages.layers < 256 * 64
        together = run(device, SampleTable, positions, images=table)
    if sampler.uses_border and not device.capabilities.border_colors:
        pytest.skip("the device has no border colors to compare with")
    for index, image in enumerate(images):
        with device.texture(image, levels=None) as texture:
            selected = positions[:, 3] == index
            apart = run(device, SampleTexture, positions[selected], image=texture.sampled(sampler))
        assert_near(together[selected], apart, tolerance=4 / 255, reason=FILTERED)
