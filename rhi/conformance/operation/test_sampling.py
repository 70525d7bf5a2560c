"""Textures as shaders read them: filters, wraps, levels, kinds, formats, comparisons."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray

import rhi.shading as sl
from rhi import (
    Comparison,
    CompressedFormat,
    Device,
    Filter,
    Format,
    Program,
    SamplerDescriptor,
    Texture,
    TextureKind,
    Wrap,
)
from rhi.conformance.compare import assert_near, assert_same
from rhi.conformance.formats import random_texels, require_format, squeezed
from rhi.conformance.reference import channels_of, compare, decode, encode
from rhi.conformance.shaders import Colored, Shade, Shaded
from rhi.conformance.shapes import rectangle
from rhi.conformance.single_draws import draw_once
from rhi.contract.formats import COLOR_FORMATS, ChannelKind

pytestmark = pytest.mark.requires("shading", "compute", "max_texture_slots")

NEAREST = SamplerDescriptor(Filter.NEAREST, Filter.NEAREST, None, Wrap.CLAMP, Wrap.CLAMP, Wrap.CLAMP)
LINEAR = SamplerDescriptor(Filter.LINEAR, Filter.LINEAR, None, Wrap.CLAMP, Wrap.CLAMP, Wrap.CLAMP)
FILTERED = "linear filters have 8 fraction bits at least"


def identity(value: Any) -> str:
    return value.name if isinstance(value, Format | TextureKind | Wrap | Comparison) else str(value)


class Constant(sl.Struct):
    """A number in a uniform block."""

    value: sl.vec4


@sl.function
def coordinates_2d(at: sl.vec4) -> sl.vec2:
    """Return (u, v)."""
    return at.xy


@sl.function
def coordinates_3d(at: sl.vec4) -> sl.vec3:
    """Return (u, v, layer), (u, v, w) or a direction."""
    return at.xyz


def make_sampling_shader(kind: Any, convert: Any) -> type[sl.Shader]:
    """Return a shader that samples a texture of this type at each place, at the level in the place's w."""

    class Sampling(sl.Shader):
        """Samples a texture at the given places and levels."""

        source: kind
        coordinates: sl.Storage[sl.vec4]
        results: sl.StorageRW[sl.vec4]

        def compute(self) -> None:
            i = sl.global_id().x
            at = self.coordinates[i]
            self.results[i] = self.source.sample_lod(convert(at), at.w)

    return Sampling


Sample2D = make_sampling_shader(sl.Texture2D, coordinates_2d)
SampleArray = make_sampling_shader(sl.Texture2DArray, coordinates_3d)
Sample3D = make_sampling_shader(sl.Texture3D, coordinates_3d)
SampleCube = make_sampling_shader(sl.TextureCube, coordinates_3d)


class Gather2D(sl.Shader):
    """Gathers component 1 of the four texels around (u, v)."""

    source: sl.Texture2D
    coordinates: sl.Storage[sl.vec4]
    results: sl.StorageRW[sl.vec4]

    def compute(self) -> None:
        i = sl.global_id().x
        self.results[i] = self.source.gather(self.coordinates[i].xy, 1)


def sampled(device: Device, shader: Any, texture: Any, coordinates: ArrayLike) -> NDArray[Any]:
    """Return the samples of `shader` at (n, 2 to 4) `coordinates`: u, v, layer or w, level; missing ones are
    0."""
    values = np.asarray(coordinates, "f4")
    full = np.zeros((len(values), 4), "f4")
    full[:, : values.shape[1]] = values
    with device.storage(sl.vec4, full) as where, device.storage(sl.vec4, len(full)) as results:
        device.dispatch(device.program(shader), len(full), source=texture, coordinates=where, results=results)
        return results.read()


def texel_centers(width: int, height: int) -> NDArray[np.float64]:
    y, x = np.mgrid[0:height, 0:width]
    return np.stack([(x + 0.5) / width, (y + 0.5) / height], axis=-1).reshape(-1, 2)


# -- formats -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("format", [f for f in COLOR_FORMATS if not f.is_integer], ids=identity)
def test_a_shader_reads_the_decoded_values_of_each_format(device: Device, format: Format) -> None:
    require_format(device, format)
    data = random_texels(format, 4, 8)
    with device.texture(squeezed(format, data), format) as texture:
        back = sampled(device, Sample2D, texture.sampled(NEAREST), texel_centers(8, 4))
    expected = decode(format, channels_of(format, squeezed(format, data))).reshape(-1, 4)
    if format.kind is ChannelKind.SRGB:
        assert_near(
            encode(format, back), encode(format, expected), 0.5, "half a step of sRGB, as in Direct3D"
        )
    else:
        assert_near(back, expected, 1e-6, "conversion in float32")


class LoadUint(sl.Shader):
    """Loads unsigned integers by texel."""

    source: sl.UintTexture2D
    results: sl.StorageRW[sl.uvec4]

    def compute(self) -> None:
        at = sl.global_id().xy
        self.results[at.y * 4 + at.x] = self.source.load(at)


class LoadInt(sl.Shader):
    """Loads signed integers by texel."""

    source: sl.IntTexture2D
    results: sl.StorageRW[sl.ivec4]

    def compute(self) -> None:
        at = sl.global_id().xy
        self.results[at.y * 4 + at.x] = self.source.load(at)


@pytest.mark.parametrize("format", [f for f in COLOR_FORMATS if f.is_integer], ids=identity)
def test_integers_are_read_as_they_are(device: Device, format: Format) -> None:
    require_format(device, format)
    data = random_texels(format, 2, 4)
    expected = np.zeros((8, 4))
    expected[:, 3] = 1
    expected[:, : format.channels] = channels_of(format, squeezed(format, data)).reshape(8, -1)
    shader, element = cast(
        "tuple[Any, Any]", (LoadUint, sl.uvec4) if format.kind is ChannelKind.UINT else (LoadInt, sl.ivec4)
    )
    with device.texture(squeezed(format, data), format) as texture, device.storage(element, 8) as results:
        device.dispatch(device.program(shader), (4, 2), source=texture, results=results)
        assert_same(results.read(), expected)


@pytest.mark.parametrize(
    "format", [Format.D16, Format.D24, Format.D32F, Format.D24S8, Format.D32FS8], ids=identity
)
def test_depth_is_read_as_red(device: Device, format: Format) -> None:
    require_format(device, format)
    with device.texture((4, 4), format) as depth:
        with device.render_pass(depth=depth, clear_depth=0.25):
            pass
        back = sampled(device, Sample2D, depth, [(0.5, 0.5)])
    assert_near(back[:, 0], 0.25, 2.0**-16, "16 bits of depth")


# -- filters -----------------------------------------------------------------------------------------------


ROW = np.array([[0, 100, 40, 200]], np.uint8)


def test_nearest_takes_the_texel_that_contains_the_coordinates(device: Device) -> None:
    u = np.array([0.0, 0.2, 0.26, 0.49, 0.51, 0.74, 0.76, 0.99])
    with device.texture(ROW, Format.R8) as texture:
        back = sampled(device, Sample2D, texture.sampled(NEAREST), np.stack([u, u * 0], axis=1))
    assert_near(back[:, 0] * 255, ROW[0, np.floor(u * 4).astype(int)], 1e-4, "conversion in float32")


def test_linear_mixes_the_texels_around_the_coordinates(device: Device) -> None:
    u = np.linspace(0, 1, 33)
    with device.texture(ROW, Format.R8) as texture:
        back = sampled(device, Sample2D, texture.sampled(LINEAR), np.stack([u, u * 0 + 0.5], axis=1))
    expected = np.interp(u * 4 - 0.5, np.arange(4), ROW[0])
    assert_near(back[:, 0] * 255, expected, 200 / 256 + 0.01, FILTERED)


def test_linear_mixes_in_both_directions(device: Device) -> None:
    data = np.array([[0, 64], [128, 255]], np.uint8)
    with device.texture(data, Format.R8) as texture:
        back = sampled(device, Sample2D, texture.sampled(LINEAR), [(0.5, 0.5), (0.375, 0.625)])
    expected = (data.mean(), 0.25 * (0.75 * 0 + 0.25 * 64) + 0.75 * (0.75 * 128 + 0.25 * 255))
    assert_near(back[:, 0] * 255, expected, 2.1, FILTERED)


def test_linear_filters_floats_beyond_1(device: Device) -> None:
    with device.texture(np.array([[-1000.0, 3000.0]], "f2"), Format.R16F) as texture:
        back = sampled(device, Sample2D, texture.sampled(LINEAR), [(0.5, 0.5)])
    assert_near(back[:, 0], 1000, 4000 / 256, FILTERED)


def test_srgb_is_filtered_in_linear_light(device: Device) -> None:
    data = np.array([[(0, 0, 0, 0), (255, 255, 255, 255)]], np.uint8)
    with device.texture(data, Format.RGBA8_SRGB) as texture:
        back = sampled(device, Sample2D, texture.sampled(LINEAR), [(0.5, 0.5)])
    assert_near(back, 0.5, 1 / 128, FILTERED)


class SampledDraw(Shaded):
    """Samples a texture over the whole target, at the level that the derivatives choose."""

    source: sl.Texture2D

    def fragment(self, v: Shade) -> sl.vec4:
        return self.source.sample(v.color.xy)


@pytest.mark.parametrize(
    ("minify", "magnify", "size", "smooth"),
    [
        (Filter.NEAREST, Filter.LINEAR, 4, True),
        (Filter.LINEAR, Filter.NEAREST, 4, False),
        (Filter.NEAREST, Filter.LINEAR, 64, False),
        (Filter.LINEAR, Filter.NEAREST, 64, True),
    ],
)
@pytest.mark.requires("draws")
def test_minifying_and_magnifying_have_filters_of_their_own(
    device: Device, minify: Filter, magnify: Filter, size: int, smooth: bool
) -> None:
    """A checkerboard of 0 and 255, drawn to 16×16 texels. The uv are shifted so that a linear filter always
    mixes."""
    board = ((np.indices((size, size)).sum(axis=0) % 2) * 255).astype(np.uint8)
    rows = rectangle()
    rows["color"][:, :2] = (rows["position"][:, :2] + 1) / 2 + 0.3 / size
    sampler = SamplerDescriptor(minify, magnify, None)
    with device.texture(board, Format.R8) as texture:
        values = np.unique(
            draw_once(device, (16, 16), Format.R8, rows, shader=SampledDraw, source=texture.sampled(sampler))
        )
    assert (set(values) <= {0, 255}) is not smooth, values


# -- wrap modes --------------------------------------------------------------------------------------------


def wrapped(index: NDArray[np.int64], wrap: Wrap, size: int) -> NDArray[np.int64]:
    """Return the index of the texel that is read for `index`, −1 for the border."""
    if wrap is Wrap.REPEAT:
        return index % size
    if wrap is Wrap.MIRROR:
        turn = index % (2 * size)
        return np.where(turn < size, turn, 2 * size - 1 - turn)
    if wrap is Wrap.CLAMP:
        return np.clip(index, 0, size - 1)
    return np.where((index >= 0) & (index < size), index, -1)


@pytest.mark.parametrize(
    "wrap",
    [
        pytest.param(wrap, marks=[pytest.mark.requires("border_colors")] * (wrap is Wrap.BORDER))
        for wrap in Wrap
    ],
    ids=identity,
)
@pytest.mark.parametrize("axis", [0, 1], ids=["u", "v"])
def test_each_wrap_mode_defines_the_texels_beyond_the_edges(device: Device, wrap: Wrap, axis: int) -> None:
    index = np.arange(-9, 14)
    coordinates = np.full((len(index), 2), 0.5)
    coordinates[:, axis] = (index + 0.5) / 4
    border = (0.5, 0.25, 1.0, 0.75)
    wrap_u, wrap_v = (wrap, Wrap.CLAMP) if axis == 0 else (Wrap.CLAMP, wrap)
    descriptor = SamplerDescriptor(Filter.NEAREST, Filter.NEAREST, None, wrap_u, wrap_v, border=border)
    data = np.zeros((4, 4, 4), np.float32)
    data[:] = np.array([(i, 10 + i, 20 + i, 30 + i) for i in range(4)])[None, :]
    if axis == 1:
        data = data.swapaxes(0, 1)
    with device.texture(np.ascontiguousarray(data), Format.RGBA32F) as texture:
        back = sampled(device, Sample2D, texture.sampled(descriptor), coordinates)
    texel = wrapped(index, wrap, 4)
    expected = np.where(texel[:, None] < 0, border, texel[:, None] + (0, 10, 20, 30))
    assert_same(back, expected)


@pytest.mark.requires("border_colors")
def test_a_border_mixes_in_under_a_linear_filter(device: Device) -> None:
    descriptor = SamplerDescriptor(
        Filter.LINEAR, Filter.LINEAR, None, Wrap.BORDER, Wrap.CLAMP, border=(1, 1, 1, 1)
    )
    with device.texture(np.zeros((1, 4), np.uint8), Format.R8) as texture:
        back = sampled(device, Sample2D, texture.sampled(descriptor), [(0.0, 0.5), (0.125, 0.5), (-1.0, 0.5)])
    assert_near(back[:, 0], (0.5, 0, 1), 1 / 256, FILTERED)


@pytest.mark.requires("border_colors")
@pytest.mark.parametrize(
    ("format", "expected"),
    [
        (Format.RGBA32F, (-0.5, 2.0, -3.0)),
        (Format.R11G11B10F, (0.0, 2.0, 0.0)),
        (Format.RGBA8, (0.0, 1.0, 0.0)),
        (Format.RGBA8_SNORM, (-0.5, 1.0, -1.0)),
    ],
    ids=identity,
)
def test_a_border_color_is_clamped_to_the_range_of_its_format(
    device: Device, format: Format, expected: tuple[float, ...]
) -> None:
    descriptor = SamplerDescriptor(
        Filter.NEAREST, Filter.NEAREST, None, Wrap.BORDER, Wrap.BORDER, border=(-0.5, 2.0, -3.0, 1.0)
    )
    with device.texture((1, 1), format) as texture:
        back = sampled(device, Sample2D, texture.sampled(descriptor), [(-1.0, 0.5), (0.5, 0.5)])
    if format is Format.R11G11B10F:  # GL doesn't say whether negative numbers are clamped
        assert_near(np.maximum(back[0, :3], 0.0), expected, 1 / 127, "8 bits")
    else:
        assert_near(back[0, :3], expected, 1 / 127, "8 bits")
    assert_near(back[1, :3], (0.0, 0.0, 0.0), 0.0, "zeroed")


def test_w_wraps_too(device: Device) -> None:
    data = np.arange(4, dtype=np.uint8).reshape(4, 1, 1, 1) * 60
    descriptor = SamplerDescriptor(Filter.NEAREST, Filter.NEAREST, None, wrap_w=Wrap.MIRROR)
    index = np.arange(-4, 8)
    coordinates = np.stack([index * 0 + 0.5, index * 0 + 0.5, (index + 0.5) / 4], axis=1)
    with device.texture(data, Format.R8, kind=TextureKind.D3) as texture:
        back = sampled(device, Sample3D, texture.sampled(descriptor), coordinates)
    assert_near(back[:, 0] * 255, wrapped(index, Wrap.MIRROR, 4) * 60, 1e-3, "conversion in float32")


# -- mip levels --------------------------------------------------------------------------------------------


def leveled_texture(device: Device, levels: int = 4) -> Any:
    """Return an 8×8 texture whose levels have one color each: 0, 10, 20, 30."""
    texture = device.texture((8, 8), Format.R16F, levels=levels)
    for level in range(levels):
        texture.write(np.full((8 >> level, 8 >> level), level * 10.0, "f2"), level=level)
    return texture


@pytest.mark.parametrize(
    ("mip", "expected"),
    [
        (None, [0, 0, 0, 0, 0, 0]),
        (Filter.NEAREST, [0, 0, 10, 20, 30, 30]),
        (Filter.LINEAR, [0, 2.5, 7.5, 20, 30, 30]),
    ],
    ids=["none", "nearest", "linear"],
)
def test_the_mip_filter_chooses_levels(device: Device, mip: Filter | None, expected: list[float]) -> None:
    lods = [-1.0, 0.25, 0.75, 2.0, 3.0, 9.0]
    with leveled_texture(device) as texture:
        sampler = SamplerDescriptor(Filter.NEAREST, Filter.NEAREST, mip)
        back = sampled(device, Sample2D, texture.sampled(sampler), [(0.5, 0.5, 0.0, lod) for lod in lods])
    assert_near(back[:, 0], expected, 10 / 256 + 1e-3, "levels are mixed with 8 fraction bits at least")


class LoadLevels(sl.Shader):
    """Writes one texel and the size of each level."""

    source: sl.Texture2D
    results: sl.StorageRW[sl.vec4]

    def compute(self) -> None:
        level = sl.global_id().x
        size = self.source.size(level)
        texel = self.source.load(size - sl.ivec2(1, 1), level)
        self.results[level] = sl.vec4(sl.vec2(size), texel.x, float(self.source.levels()))


def test_levels_are_loaded_and_measured(device: Device) -> None:
    with leveled_texture(device) as texture, device.storage(sl.vec4, 4) as results:
        device.dispatch(device.program(LoadLevels), 4, source=texture, results=results)
        assert_same(results.read(), [(8, 8, 0, 4), (4, 4, 10, 4), (2, 2, 20, 4), (1, 1, 30, 4)])


# -- texture kinds -----------------------------------------------------------------------------------------


def test_the_layer_of_an_array_texture_is_selected_by_its_number(device: Device) -> None:
    data = np.arange(4, dtype="f4").reshape(4, 1, 1, 1) * np.ones((4, 2, 2, 1), "f4")
    layers = [-1.0, 0.0, 0.4, 0.6, 2.0, 3.4, 9.0]
    with device.texture(data, Format.R32F, kind=TextureKind.D2_ARRAY) as texture:
        back = sampled(device, SampleArray, texture.sampled(LINEAR), [(0.5, 0.5, layer) for layer in layers])
    assert_same(back[:, 0], [0, 0, 0, 1, 2, 3, 3])


def test_a_volume_is_filtered_in_three_directions(device: Device) -> None:
    data = np.arange(8, dtype="f2").reshape(2, 2, 2, 1)
    with device.texture(data, Format.R16F, kind=TextureKind.D3) as texture:
        coordinates = [
            (0.25, 0.25, 0.25),
            (0.75, 0.25, 0.25),
            (0.25, 0.75, 0.25),
            (0.25, 0.25, 0.75),
            (0.5, 0.5, 0.5),
        ]
        back = sampled(device, Sample3D, texture.sampled(LINEAR), coordinates)
    assert_near(back[:, 0], (0, 1, 2, 4, 3.5), 7 / 256, FILTERED)


FACES = [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)]


def test_a_cube_s_faces_lie_around_it(device: Device) -> None:
    data = np.arange(6, dtype="f4").reshape(6, 1, 1, 1) * np.ones((6, 4, 4, 1), "f4")
    with device.texture(data, Format.R32F, kind=TextureKind.CUBE) as texture:
        back = sampled(device, SampleCube, texture.sampled(NEAREST), np.array(FACES) * 3.0)
    assert_same(back[:, 0], np.arange(6))


def test_the_faces_of_a_cube_may_be_blocks(device: Device) -> None:
    format = CompressedFormat.BC4
    blocks = np.zeros((6, 1, 1, 8), np.uint8)
    blocks[..., 0] = blocks[..., 1] = np.arange(1, 7)[:, None, None] * 40
    with device.texture((4, 4), format, kind=TextureKind.CUBE) as texture:
        texture.write(blocks)
        colors = sampled(device, SampleCube, texture.sampled(NEAREST), FACES)
    assert_near(colors[:, 0] * 255, np.arange(1, 7) * 40, 1e-3, "conversion in float32")


def face_coordinates(face: int, direction: tuple[float, float, float]) -> tuple[float, float]:
    """Return (u, v) on a cube's face, v down, by table 8.19 of OpenGL 4.3."""
    x, y, z = direction
    s, t, m = [(-z, -y, x), (z, -y, -x), (x, z, y), (x, -z, -y), (x, -y, z), (-x, -y, -z)][face]
    return (s / m + 1) / 2, (t / m + 1) / 2


def test_a_cube_s_faces_are_turned_as_in_opengl(device: Device) -> None:
    data = np.arange(96, dtype="f4").reshape(6, 4, 4, 1)
    rng = np.random.default_rng(5)
    directions: list[NDArray[np.float64]] = []
    expected: list[float] = []
    while len(directions) < 60:
        d = rng.normal(size=3)
        face = int(np.abs(d).argmax()) * 2 + int(d[np.abs(d).argmax()] < 0)
        u, v = face_coordinates(face, tuple(d))
        if (
            min(abs(u * 4 - round(u * 4)), abs(v * 4 - round(v * 4))) > 0.02
        ):  # away from the borders between texels
            directions.append(d)
            expected.append(data[face, int(v * 4), int(u * 4), 0])
    with device.texture(data, Format.R32F, kind=TextureKind.CUBE) as texture:
        back = sampled(device, SampleCube, texture.sampled(NEAREST), directions)
    assert_same(back[:, 0], expected)


def test_a_cube_is_filtered_across_its_edges(device: Device) -> None:
    data = np.zeros((6, 2, 2, 1), "f2")
    data[0] = 1.0
    with device.texture(data, Format.R16F, kind=TextureKind.CUBE) as texture:
        back = sampled(device, SampleCube, texture.sampled(LINEAR), [(1.0, 0.0, 1.0)])
    assert_near(back[:, 0], 0.5, 1 / 64, FILTERED)


# -- gathers and comparisons -------------------------------------------------------------------------------


def test_gather_gives_the_four_texels_of_a_linear_filter(device: Device) -> None:
    """OpenGL gathers counter-clockwise from the lower left, with v up. With v down that is (0,1) (1,1) (1,0)
    (0,0)."""
    data = np.zeros((4, 4, 4), np.float32)
    data[..., 1] = np.arange(16).reshape(4, 4)
    with device.texture(data, Format.RGBA32F) as texture:
        back = sampled(device, Gather2D, texture.sampled(LINEAR), [(0.5, 0.5), (0.25, 0.75)])
    assert_same(back[0], (9, 10, 6, 5))
    assert_same(back[1], (12, 13, 9, 8))
    # Each of the two texels along an axis is wrapped by itself, so that reflected ones are in reverse order.
    index = np.arange(-9, 14)
    for wrap in (Wrap.REPEAT, Wrap.MIRROR, Wrap.CLAMP):
        x0, x1 = wrapped(index, wrap, 4), wrapped(index + 1, wrap, 4)
        sampler = SamplerDescriptor(Filter.LINEAR, Filter.LINEAR, None, wrap, wrap)
        beside = np.full(len(index), 0.4375)  # between rows and columns 1 and 2
        along_u = np.stack([(index + 0.75) / 4, beside], axis=1)
        with device.texture(data, Format.RGBA32F) as texture:
            back = sampled(device, Gather2D, texture.sampled(sampler), along_u)
            assert_same(back, np.stack([8 + x0, 8 + x1, 4 + x1, 4 + x0], axis=1))
            back = sampled(device, Gather2D, texture.sampled(sampler), along_u[:, ::-1])
            assert_same(back, np.stack([1 + 4 * x1, 2 + 4 * x1, 2 + 4 * x0, 1 + 4 * x0], axis=1))


class Compared(sl.Shader):
    """Compares a shadow map at (x, y) with a reference z."""

    source: sl.DepthTexture2D
    coordinates: sl.Storage[sl.vec4]
    results: sl.StorageRW[sl.vec4]

    def compute(self) -> None:
        i = sl.global_id().x
        at = self.coordinates[i]
        gathered = self.source.gather_compare(at.xy, at.z)
        self.results[i] = sl.vec4(
            self.source.sample_compare_lod(at.xy, at.z, 0.0), gathered.x, gathered.y, gathered.z + gathered.w
        )


@pytest.mark.parametrize("function", list(Comparison), ids=identity)
def test_a_comparison_is_reference_against_texel(device: Device, function: Comparison) -> None:
    sampler = SamplerDescriptor(Filter.NEAREST, Filter.NEAREST, None, compare=function)
    references = np.array([0.25, 0.5, 0.75])
    with device.texture((4, 4), Format.D32F) as depth:
        with device.render_pass(depth=depth, clear_depth=0.5):
            pass
        coordinates = np.stack([references * 0 + 0.5, references * 0 + 0.5, references], axis=1)
        back = sampled(device, Compared, depth.sampled(sampler), coordinates)
    assert_same(back[:, 0], compare(function, references, 0.5))
    assert_same(back[:, 1], compare(function, references, 0.5))


@pytest.mark.requires("draws")
def test_a_linear_comparison_filters_the_answers(device: Device) -> None:
    """With half of the texels nearer the result is 0.5, whatever their depths are."""
    sampler = SamplerDescriptor(
        Filter.LINEAR, Filter.LINEAR, None, Wrap.CLAMP, Wrap.CLAMP, compare=Comparison.LESS
    )
    with (
        device.texture((2, 2), Format.D32F) as depth,
        device.mesh(rectangle(-1, -1, 0, 1, depth=0.9)) as left,
    ):
        with device.render_pass(depth=depth, clear_depth=0.1):
            device.draw(device.program(Colored), left)
        back = sampled(
            device, Compared, depth.sampled(sampler), [(0.5, 0.5, 0.5), (0.25, 0.5, 0.5), (0.75, 0.5, 0.5)]
        )
    assert_near(back[:, 0], (0.5, 1, 0), 1 / 128, FILTERED)


# -- bindings ----------------------------------------------------------------------------------------------


def test_one_texture_is_read_through_several_samplers(device: Device) -> None:
    with device.texture(ROW, Format.R8) as texture:
        nearest = sampled(device, Sample2D, texture.sampled(NEAREST), [(0.25, 0.5)])
        linear = sampled(device, Sample2D, texture.sampled(LINEAR), [(0.25, 0.5)])
        again = sampled(device, Sample2D, texture.sampled(device.sampler(NEAREST)), [(0.25, 0.5)])
    assert_same(nearest, again)
    assert_near(linear[:, 0] * 255, 50, 1, FILTERED)


class TwoTextures(sl.Shader):
    """Reads three textures at once."""

    first: sl.Texture2D
    second: sl.Texture2D
    volume: sl.Texture3D
    results: sl.StorageRW[sl.vec4]

    def compute(self) -> None:
        a = self.first.load(sl.ivec2(0, 0)).x
        b = self.second.load(sl.ivec2(0, 0)).x
        c = self.volume.load(sl.ivec3(0, 0, 1)).x
        self.results[0] = sl.vec4(a, b, c, a - b)


def test_several_textures_stay_apart(device: Device) -> None:
    textures = [device.texture(np.full((2, 2), value, "f4"), Format.R32F) for value in (3.0, 5.0)]
    volume = device.texture(np.arange(8, dtype="f4").reshape(2, 2, 2, 1), Format.R32F, kind=TextureKind.D3)
    a, b = textures
    with device.storage(sl.vec4, 1) as results:
        for first, second in ((a, b), (b, a), (a, a)):
            device.dispatch(
                device.program(TwoTextures), 1, first=first, second=second, volume=volume, results=results
            )
            values = {id(a): 3.0, id(b): 5.0}
            x, y = values[id(first)], values[id(second)]
            assert_same(results.read(), [(x, y, 4, x - y)])
    for texture in (*textures, volume):
        texture.destroy()


class Slots(sl.Shader):
    """Uses as many textures, storage buffers, uniforms and images as every device has."""

    t0: sl.Texture2D
    t1: sl.Texture2D
    t2: sl.Texture2D
    t3: sl.Texture2D
    t4: sl.Texture2D
    t5: sl.Texture2D
    t6: sl.Texture2D
    t7: sl.Texture2D
    s0: sl.Storage[sl.vec4]
    s1: sl.Storage[sl.vec4]
    s2: sl.Storage[sl.vec4]
    results: sl.StorageRW[sl.vec4]
    u0: sl.Uniform[Constant]
    u1: sl.Uniform[Constant]
    u2: sl.Uniform[Constant]
    u3: sl.Uniform[Constant]
    i0: sl.Image2D = sl.image(Format.R32F)
    i1: sl.Image2D = sl.image(Format.R32F)

    def compute(self) -> None:
        o = sl.ivec2(0, 0)
        self.results[0] = sl.vec4(self.t0.load(o).x, self.t1.load(o).x, self.t2.load(o).x, self.t3.load(o).x)
        self.results[1] = sl.vec4(self.t4.load(o).x, self.t5.load(o).x, self.t6.load(o).x, self.t7.load(o).x)
        self.results[2] = sl.vec4(self.s0[0].x, self.s1[0].x, self.s2[0].x, self.i0.load(o).x)
        self.results[3] = sl.vec4(self.u0.value.x, self.u1.value.x, self.u2.value.x, self.u3.value.x)
        self.i1.store(o, sl.vec4(77.0))


def test_many_bindings_of_every_kind_stay_apart(device: Device) -> None:
    def texture(value: float) -> Any:
        return device.texture(np.full((1, 1), value, "f4"), Format.R32F)

    textures = {f"t{i}": texture(i + 1.0) for i in range(8)}
    images = {"i0": texture(50.0), "i1": texture(0.0)}
    storage = {f"s{i}": device.storage(sl.vec4, np.full((1, 4), i + 20.0, "f4")) for i in range(3)}
    uniforms = {f"u{i}": device.uniform(Constant(value=(i + 30.0, 0, 0, 0))) for i in range(4)}
    with device.storage(sl.vec4, 4) as results:
        bound = {**textures, **storage, **uniforms, **{name: image.image() for name, image in images.items()}}
        device.dispatch(device.program(Slots), 1, results=results, **bound)
        expected = [(1, 2, 3, 4), (5, 6, 7, 8), (20, 21, 22, 50), (30, 31, 32, 33)]
        assert_same(results.read(), expected)
        assert_same(images["i1"].read(), 77)
    for resource in (*textures.values(), *images.values(), *storage.values(), *uniforms.values()):
        resource.destroy()


class Graded(Shaded):
    """Samples at the level of explicit derivatives, and at that of implicit ones with a bias of 1, −1 and
    0."""

    source: sl.Texture2D

    def fragment(self, v: Shade) -> sl.vec4:
        graded = self.source.sample_grad(v.color.xy, sl.vec2(4.0 / 64.0, 0.0), sl.vec2(0.0, 4.0 / 64.0)).x
        biased = self.source.sample_bias(v.color.xy, 1.0).x
        plain = self.source.sample(v.color.xy).x
        return sl.vec4(graded, biased, self.source.sample_bias(v.color.xy, -1.0).x, plain)


@pytest.mark.requires("draws")
def test_derivatives_choose_the_level(device: Device) -> None:
    """64 texels drawn on 16 use level 2. Explicit derivatives and biases are tested by the same draw, since
    building a program takes seconds."""
    rows = rectangle()
    rows["color"][:, :2] = (rows["position"][:, :2] + 1) / 2
    with (
        device.texture((64, 64), Format.R16F, levels=None) as texture,
        device.texture((16, 16), Format.RGBA32F) as image,
        device.mesh(rows) as mesh,
    ):
        for level in range(7):
            texture.write(np.full((64 >> level, 64 >> level), float(level), "f2"), level=level)
        with device.render_pass(image):
            device.draw(device.program(Graded), mesh, source=texture)
        assert_near(image.read(), (2, 3, 1, 2), 1 / 16, "the level is a logarithm of differences")


def test_anisotropy_may_be_asked_for(device: Device) -> None:
    most = max(1.0, device.capabilities.max_anisotropy)
    sampler = SamplerDescriptor(max_anisotropy=most)
    with device.texture(np.full((8, 8), 100, "u1"), Format.R8, levels=None) as texture:
        back = sampled(device, Sample2D, texture.sampled(sampler), [(0.5, 0.5)])
    assert_near(back[:, 0] * 255, 100, 0.5, FILTERED)


@pytest.mark.requires("draws")
def test_a_floor_at_a_grazing_angle_has_more_contrast_with_more_anisotropy(device: Device) -> None:
    """Stripes that run to the horizon, and pixels that are the longer along them the farther away. What
    exactly is averaged is up to each device, but it shows more of the stripes than one level for both axes,
    nowhere less."""
    most = device.capabilities.max_anisotropy
    if most < 2:
        pytest.skip("no anisotropic filtering")
    rows = rectangle()
    far = rows["position"][:, 1] > 0
    rows["color"][:, 0] = (rows["position"][:, 0] + 1) * 0.125
    rows["color"][:, 1] = far * 16.0
    rows["position"][far] *= 16.0
    contrasts = []
    with (
        device.texture((64, 64), Format.R16F, levels=None) as texture,
        device.texture((32, 32), Format.RGBA32F) as image,
        device.mesh(rows) as mesh,
    ):
        texels = np.tile((np.arange(64) // 2 % 2).astype("f2"), (64, 1))
        for level in range(7):
            texture.write(texels, level=level)
            texels = (texels[::2, ::2] + texels[::2, 1::2]) / 2 if len(texels) > 1 else texels
        for anisotropy in (1.0, 2.0, most):
            with device.render_pass(image):
                source = texture.sampled(SamplerDescriptor(max_anisotropy=anisotropy))
                device.draw(device.program(Graded), mesh, source=source)
            contrasts.append(image.read()[..., 3].std(axis=1))
    none, little, full = contrasts
    assert (full >= little - 0.02).all()
    assert (little >= none - 0.02).all()
    assert full.sum() > 3 * none.sum() > 0


class ComparedLayers(Shaded):
    """Compares a layered and a cube shadow map."""

    layers: sl.DepthTexture2DArray
    around: sl.DepthTextureCube
    results: sl.StorageRW[sl.vec4]

    def fragment(self, v: Shade) -> sl.vec4:
        first = self.layers.sample_compare(sl.vec3(0.5, 0.5, 0.0), 0.5)
        second = self.layers.sample_compare(sl.vec3(0.5, 0.5, 1.0), 0.5)
        left = self.around.sample_compare(sl.vec3(-1.0, 0.0, 0.0), 0.5)
        up = self.around.sample_compare(sl.vec3(0.0, 1.0, 0.0), 0.5)
        self.results[0] = sl.vec4(first, second, left, up)
        return v.color


@pytest.mark.requires("draws")
def test_depth_arrays_and_cubes_are_compared(device: Device) -> None:
    sampler = SamplerDescriptor(Filter.NEAREST, Filter.NEAREST, None, compare=Comparison.LESS)
    with (
        device.texture((4, 4), Format.D32F, kind=TextureKind.D2_ARRAY, layers=2) as layers,
        device.texture((4, 4), Format.D32F, kind=TextureKind.CUBE) as around,
        device.texture((1, 1), Format.R8) as image,
        device.storage(sl.vec4, 1) as results,
        device.mesh(rectangle()) as mesh,
    ):
        for texture, layer in ((layers, 1), (around, 2)):
            with device.render_pass(depth=texture.at(layer=layer), clear_depth=0.75):
                pass
        with device.render_pass(image):
            device.draw(
                device.program(ComparedLayers),
                mesh,
                layers=layers.sampled(sampler),
                around=around.sampled(sampler),
                results=results,
            )
        assert_same(results.read(), [(0, 1, 0, 1)])


@pytest.mark.requires("border_colors")
def test_beyond_a_shadow_map_its_border_is_compared(device: Device) -> None:
    sampler = SamplerDescriptor(
        Filter.NEAREST,
        Filter.NEAREST,
        None,
        Wrap.BORDER,
        Wrap.BORDER,
        border=(1, 1, 1, 1),
        compare=Comparison.LESS,
    )
    with device.texture((2, 2), Format.D32F) as depth:
        with device.render_pass(depth=depth, clear_depth=0.25):
            pass
        back = sampled(
            device, Compared, depth.sampled(sampler), [(0.5, 0.5, 0.5), (1.5, 0.5, 0.5), (0.5, -0.5, 0.5)]
        )
    assert_same(back[:, 0], (0, 1, 1))


class Texels(sl.Shader):
    """Loads and stores of texels in and around a texture of 8 by 8, and of levels that it lacks."""

    work_group = (16,)
    source: sl.Texture2D
    at: sl.Storage[int]
    target: sl.Image2D = sl.image(Format.RGBA32F)
    out: sl.StorageRW[sl.vec4]

    def compute(self) -> None:
        i = sl.global_id().x
        k = self.at[i]
        self.target.store(sl.ivec2(k, 3), sl.vec4(2.0))
        self.out[2 * i] = self.source.load(sl.ivec2(k, 3))
        self.out[2 * i + 1] = self.source.load(sl.ivec2(0, 0), k)


@pytest.mark.requires("max_image_slots")
def test_texels_outside_are_zeros_and_stores_outside_are_dropped(device: Device) -> None:
    at = np.resize(np.array([0, 1, 7, 8, -1, 2, 3, 100, -(2**31), 2**31 - 1, 65536, -9], np.int32), 64)
    source = device.texture(np.full((8, 8, 4), 255, "u1"), Format.RGBA8, levels=2)
    target, out = device.texture((8, 8), Format.RGBA32F), device.storage(sl.vec4, 2 * len(at))
    device.dispatch(
        device.program(Texels),
        len(at) // 16,
        source=source,
        at=device.storage(int, at),
        target=target.image(),
        out=out,
    )
    back = out.read()
    assert_same(back[0::2], ((at >= 0) & (at < 8))[:, None])
    assert_same(back[1::2], ((at >= 0) & (at < 2))[:, None])
    stored = np.isin(np.arange(8), at)[None, :] & (np.arange(8) == 3)[:, None]
    assert_same(target.read(), 2.0 * stored[..., None])


# -- levels and layers beyond all bounds ---------------------------------------------------------------------


class Levels(sl.Shader):
    """Samples the middle of a texture at each level of detail."""

    work_group = (64, 1, 1)
    source: sl.Texture2D
    numbers: sl.Storage[float]
    results: sl.StorageRW[float]

    def compute(self) -> None:
        i = sl.global_id().x
        if i < len(self.numbers):
            self.results[i] = self.source.sample_lod(sl.vec2(0.5, 0.5), self.numbers[i]).x


class Layers(sl.Shader):
    """Samples the middle of each layer."""

    work_group = (64, 1, 1)
    source: sl.Texture2DArray
    numbers: sl.Storage[float]
    results: sl.StorageRW[float]

    def compute(self) -> None:
        i = sl.global_id().x
        if i < len(self.numbers):
            self.results[i] = self.source.sample_lod(sl.vec3(0.5, 0.5, self.numbers[i]), 0.0).x


class Gradients(sl.Shader):
    """Samples the middle of a texture with each gradient, and with its opposite."""

    work_group = (64, 1, 1)
    source: sl.Texture2D
    numbers: sl.Storage[float]
    results: sl.StorageRW[float]

    def compute(self) -> None:
        i = sl.global_id().x
        if i < len(self.numbers):
            x = self.numbers[i]
            first = self.source.sample_grad(sl.vec2(0.5, 0.5), sl.vec2(x, 0.0), sl.vec2(0.0, 0.0)).x
            second = self.source.sample_grad(sl.vec2(0.5, 0.5), sl.vec2(0.0, 0.0), sl.vec2(-x, -x)).x
            self.results[i] = 0.5 * (first + second)


class Sizes(sl.Shader):
    """Asks for the sizes of levels."""

    work_group = (64, 1, 1)
    source: sl.Texture2D
    layers: sl.Texture2DArray
    numbers: sl.Storage[int]
    results: sl.StorageRW[sl.ivec3]

    def compute(self) -> None:
        i = sl.global_id().x
        if i < len(self.numbers):
            self.results[2 * i] = sl.ivec3(self.source.size(self.numbers[i]), self.source.size(9).x)
            self.results[2 * i + 1] = self.layers.size(self.numbers[i])


FAR = [2147483520.0, 2147483648.0, 3e9, 4294967296.0, 1e10, 1e20, 3e38, np.inf]
"""Numbers beyond what an integer of 32 bits holds."""


def sample_at(
    device: Device, shader: type[sl.Shader], texture: Texture, numbers: list[float], mip: Filter
) -> NDArray[Any]:
    """The nearest texel that a shader samples for each number."""
    values = np.array(numbers, np.float32)
    sampler = SamplerDescriptor(Filter.NEAREST, Filter.NEAREST, mip=mip)
    with device.storage(float, values) as levels, device.storage(float, len(values)) as results:
        program: Program[...] = device.program(shader)
        device.dispatch(
            program, -(-len(values) // 64), source=texture.sampled(sampler), numbers=levels, results=results
        )
        return np.asarray(results.read())


@pytest.mark.parametrize("mip", [Filter.NEAREST, Filter.LINEAR], ids=lambda f: f.name)
def test_levels_of_detail_are_clamped_to_the_first_and_last_level(device: Device, mip: Filter) -> None:
    levels = [0.0, 1.0, 2.0, 3.0, 4.0, 100.0, 1e6, 2e9, *FAR]
    with device.texture((8, 8), Format.R32F, levels=4) as texture:
        for level in range(4):
            texture.write(np.full((8 >> level, 8 >> level), level + 1, np.float32), level=level)
        expected = np.clip(levels, 0, 3) + 1
        assert_same(sample_at(device, Levels, texture, levels, mip), expected)
        assert_same(sample_at(device, Levels, texture, [-level for level in levels], mip), 1)


def test_the_longest_gradients_choose_the_last_level(device: Device) -> None:
    numbers = [1.0, 1e6, 2e9, *FAR, -1e20, -np.inf]
    with device.texture((8, 8), Format.R32F, levels=4) as texture:
        for level in range(4):
            texture.write(np.full((8 >> level, 8 >> level), level + 1, np.float32), level=level)
        assert_same(sample_at(device, Gradients, texture, [0.0, 1e-3], Filter.LINEAR), 1)
        assert_same(sample_at(device, Gradients, texture, numbers, Filter.LINEAR), 4)


def test_a_level_that_does_not_exist_has_the_size_of_the_nearest(device: Device) -> None:
    numbers = np.array([0, 1, 2, 3, 4, 5, 31, 32, 1000, -1, -2, 2**31 - 1, -(2**31)], np.int32)
    nearest = np.clip(numbers, 0, 3)
    with (
        device.texture((8, 4), Format.R32F, levels=4) as texture,
        device.texture((8, 4), Format.R32F, kind=TextureKind.D2_ARRAY, layers=5, levels=4) as layers,
        device.storage(int, numbers) as levels,
        device.storage(sl.ivec3, 2 * len(numbers)) as results,
    ):
        device.dispatch(
            device.program(Sizes), 1, source=texture, layers=layers, numbers=levels, results=results
        )
        back = results.read()[:, :3]
    width, height = np.maximum(8 >> nearest, 1), np.maximum(4 >> nearest, 1)
    assert_same(back[0::2], np.stack([width, height, np.ones_like(width)], 1))
    assert_same(back[1::2], np.stack([width, height, np.full_like(width, 5)], 1))


@pytest.mark.parametrize("layers", [1, 4, 7])
def test_layers_are_rounded_to_the_nearest_halves_up(device: Device, layers: int) -> None:
    numbers = [*np.arange(-2, layers + 2, 0.25).tolist(), *FAR, *(-number for number in FAR)]
    with device.texture((2, 2), Format.R32F, kind=TextureKind.D2_ARRAY, layers=layers) as texture:
        texture.write(
            np.broadcast_to(np.arange(layers, dtype=np.float32)[:, None, None, None], (layers, 2, 2, 1))
        )
        expected = np.clip(np.floor(np.array(numbers) + 0.5), 0, layers - 1)
        assert_same(sample_at(device, Layers, texture, numbers, Filter.NEAREST), expected)
