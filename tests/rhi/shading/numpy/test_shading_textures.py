"""Textures and images in lanes and on NumPy, compared with OpenGL.

Tolerances and their reasons:
- Lanes against float64: 2e-6 for values up to 1 (float32 coordinates times a size, a curve of sRGB within
  1.8e-6).
- llvmpipe filters formats of 8 bits with weights of 8 bits, once for each of two directions and once for
  levels: 2/256 in all; its sRGB is a cubic within 1.3e-3. Everything else in it is float32, as in the lanes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from nightly_reasons import FEWER_CASES
from numpy.typing import NDArray
from opencl_runner import Kernel, run_opencl
from stage_runner import run_fragment_lanes, run_vertex_lanes
from texture_kit import assert_agree, nearest, random_levels, read_everywhere

import rhi
import rhi.shading as sl
from rhi import Comparison, Device, Filter, Format, SamplerDescriptor, TextureKind, Wrap
from rhi.conformance.shaders import Corner
from rhi.contract.formats import COLOR_FORMATS, ChannelKind
from rhi.errors import DeviceError, ShaderError, ValidationError

NEAREST, LINEAR = Filter.NEAREST, Filter.LINEAR
D2, ARRAY, D3, CUBE = TextureKind.D2, TextureKind.D2_ARRAY, TextureKind.D3, TextureKind.CUBE
EIGHT_BITS = 2 / 256
COUNT = 512


@pytest.fixture(scope="module")
def device() -> Iterator[Device]:
    try:
        created = rhi.create_device("gl")
    except DeviceError as error:
        pytest.skip(f"no OpenGL: {error}")
    with created:
        yield created


def name(value: Any) -> str:
    return value.name if hasattr(value, "name") else str(value)


class At(sl.Shader):
    work_group = (64,)
    coordinates: sl.Storage[sl.vec4]
    results: sl.StorageRW[sl.vec4]


class Sample2D(At):
    source: sl.Texture2D

    def compute(self) -> None:
        at = self.coordinates[sl.global_id().x]
        self.results[sl.global_id().x] = self.source.sample_lod(at.xy, at.w)


def sampling(annotation: Any) -> Any:
    class Sample(At):
        source: annotation

        def compute(self) -> None:
            at = self.coordinates[sl.global_id().x]
            self.results[sl.global_id().x] = self.source.sample_lod(at.xyz, at.w)

    return Sample


Sample3D = sampling(sl.Texture3D)
SHAPES: dict[TextureKind, tuple[type[sl.Shader], int]] = {
    D2: (Sample2D, 1),
    ARRAY: (sampling(sl.Texture2DArray), 5),
    D3: (Sample3D, 6),
    CUBE: (sampling(sl.TextureCube), 6),
}


def coordinates(seed: int = 0, count: int = COUNT) -> NDArray[Any]:
    """Generate coordinates in and around the texture, and levels in and around its range."""
    rng = np.random.default_rng(seed)
    return np.c_[rng.uniform(-2, 3, (count, 2)), rng.uniform(-1, 6, count), rng.uniform(-2, 6, count)].astype(
        "f4"
    )


def coordinates_by_block(seed: int = 0) -> NDArray[Any]:
    """Generate blocks of 16 whose texels all lie inside, or cross only the upper and lower edge, or lie
    anywhere."""
    at, rng = coordinates(seed), np.random.default_rng([seed, 1])
    at[: COUNT // 2, :2] = rng.uniform(0.1, 0.9, (COUNT // 2, 2))
    at[COUNT // 4 : COUNT // 2, 1] = rng.uniform(-2, 3, COUNT // 4)
    return at


def sample(device: Device, texture: sl.HostTexture, at: NDArray[Any]) -> dict[str, NDArray[Any]]:
    shader, _ = SHAPES[texture.kind]
    return read_everywhere(
        device, shader, {"source": texture}, len(at) // 64, coordinates=at, results=len(at)
    )


# -- formats, filters, edges -------------------------------------------------------------------------------


@pytest.mark.parametrize("format", [f for f in COLOR_FORMATS if not f.is_integer], ids=name)
@pytest.mark.parametrize("filter", [NEAREST, LINEAR], ids=name)
def test_every_format_is_decoded_and_filtered(device: Device, format: Format, filter: Filter) -> None:
    """A block that lies inside uses different loads for each size of a texel."""
    texture = sl.HostTexture(
        random_levels(format, 13, 7), format, D2, SamplerDescriptor(filter, filter, None)
    )
    slack = EIGHT_BITS if format.dtype.itemsize == 1 and filter is LINEAR else 2e-6
    slack = max(slack, 1.3e-3) if format.kind is ChannelKind.SRGB else slack
    assert_agree(sample(device, texture, coordinates_by_block()), slack)


@pytest.mark.nightly_cases("*-NEAREST-LINEAR-*", reason=FEWER_CASES)
@pytest.mark.parametrize("mip", [None, NEAREST, LINEAR], ids=name)
@pytest.mark.parametrize(
    ("minify", "magnify"), [(NEAREST, LINEAR), (LINEAR, NEAREST), (LINEAR, LINEAR)], ids=name
)
@pytest.mark.parametrize("kind", list(SHAPES), ids=name)
def test_levels_and_filters_are_chosen_by_the_level_of_detail(
    device: Device, kind: TextureKind, minify: Filter, magnify: Filter, mip: Filter | None
) -> None:
    size = (8, 8) if kind is CUBE else (16, 5)
    texels = random_levels(Format.RG32F, *size, SHAPES[kind][1], kind)
    at = coordinates(1)
    at[:8, 3] = (-1, 0, 0.25, 0.5, 1, 1.5, 2.5, 99)
    sampler = SamplerDescriptor(minify, magnify, mip)
    assert_agree(sample(device, sl.HostTexture(texels, Format.RG32F, kind, sampler), at), 3e-6, 3e-6)


@pytest.mark.parametrize("wrap", list(Wrap), ids=name)
@pytest.mark.parametrize("filter", [NEAREST, LINEAR], ids=name)
@pytest.mark.parametrize("kind", [D2, ARRAY, D3], ids=name)
@pytest.mark.parametrize("format", [Format.RGBA8, Format.R32F, Format.RG8_SNORM], ids=name)
def test_edges_wrap(device: Device, kind: TextureKind, wrap: Wrap, filter: Filter, format: Format) -> None:
    """A border has the channels of the format and lies within its range."""
    texels = random_levels(format, 5, 6, SHAPES[kind][1], kind, levels=1)
    sampler = SamplerDescriptor(filter, filter, None, wrap, wrap, wrap, border=(0.25, -0.5, 2.0, 0.5))
    slack = EIGHT_BITS if format is Format.RGBA8 and filter is LINEAR else 3e-6
    assert_agree(
        sample(device, sl.HostTexture(texels, format, kind, sampler), coordinates_by_block(2)), slack, 3e-6
    )


@pytest.mark.parametrize("wrap", list(Wrap), ids=name)
@pytest.mark.parametrize("filter", [NEAREST, LINEAR], ids=name)
@pytest.mark.parametrize("size", [(1, 1), (4, 4), (3, 5), (1, 7)], ids=str)
def test_hard_coordinates_read_the_same_texels_everywhere(
    device: Device, wrap: Wrap, filter: Filter, size: tuple[int, int]
) -> None:
    """Coordinates exactly on texels' borders and centers, one step beside them, denormals, thousands of
    repetitions."""
    hard = [0.0, -0.0, 1e-40, -1e-40, -1e-9, 0.5, 0.25, 0.125, 0.0625, 1.0, -1.0, 2.0, 1 - 2**-24, 1 + 2**-23]
    hard += [1e4 + 0.375, -1e4 - 0.375]
    at = np.zeros((256, 4), "f4")
    at[:, :2] = np.stack(np.meshgrid(hard, hard), -1).reshape(-1, 2)
    texture = sl.HostTexture(
        random_levels(Format.RG32F, *size, levels=1),
        Format.RG32F,
        D2,
        SamplerDescriptor(filter, filter, None, wrap, wrap, border=(0.25, 0.5, 0, 0)),
    )
    results = sample(device, texture, at)
    results["float64"] = results["float32"]  # which texel a border belongs to is decided in float32
    assert_agree(results, 2e-6)


@pytest.mark.parametrize("wrap", list(Wrap), ids=name)
@pytest.mark.parametrize("filter", [NEAREST, LINEAR], ids=name)
def test_coordinates_that_are_not_finite_or_too_large_read_a_texel_or_the_border(
    wrap: Wrap, filter: Filter
) -> None:
    """NaN, infinities and coordinates beyond integers are undefined in OpenGL (llvmpipe overflows); here all
    ways read the same texels or the border, and nothing else."""
    hard = np.array([np.nan, np.inf, -np.inf, 1e30, -1e30, 3.4e38, 0.3, 2.0**31], "f4")
    at = np.zeros((64, 4), "f4")
    at[:, :2] = np.stack(np.meshgrid(hard, hard), -1).reshape(-1, 2)
    at[:, 3] = np.resize(hard, 64)
    texels = random_levels(Format.R8, 7, 3)
    sampler = SamplerDescriptor(filter, filter, LINEAR, wrap, wrap, border=(0.5, 0, 0, 0))
    bindings: dict[str, Any] = {
        "source": sl.HostTexture(texels, Format.R8, D2, sampler),
        "coordinates": at,
        "results": 64,
    }
    expected = sl.run_compute(Sample2D, 1, **bindings)["results"]
    assert np.isfinite(expected).all()
    assert expected.max() <= 1
    for width in (1, 16):
        results = run_opencl(Sample2D, width, 1, **bindings)["results"]
        np.testing.assert_allclose(results, expected, rtol=0, atol=1e-6)


@pytest.mark.nightly_cases("8", reason=FEWER_CASES)
@pytest.mark.parametrize("width", [4, 8])
def test_other_widths_give_the_same(width: int) -> None:
    for kind, (shader, layers) in SHAPES.items():
        texels = random_levels(Format.RGBA8, 8, 8, layers, kind)
        bindings = {
            "source": sl.HostTexture(texels, Format.RGBA8, kind),
            "coordinates": coordinates(3),
            "results": COUNT,
        }
        one_lane = run_opencl(shader, 1, COUNT // 64, **bindings)["results"]
        np.testing.assert_array_equal(run_opencl(shader, width, COUNT // 64, **bindings)["results"], one_lane)


@st.composite
def textures(draw: st.DrawFn) -> sl.HostTexture:
    """Any format, shape, size and sampler that can be read as floats."""
    kind = draw(st.sampled_from(list(SHAPES)))
    format = draw(
        st.sampled_from([f for f in Format if not f.is_integer and not (f.is_depth and kind is D3)])
    )
    width, height, layers = (draw(st.integers(1, 9)) for _ in range(3))
    if kind is CUBE:
        height, layers = width, 6
    texels = random_levels(
        format, width, height, 1 if kind is D2 else layers, kind, seed=draw(st.integers(0, 99))
    )
    filters = st.sampled_from(Filter)
    wraps = (draw(st.sampled_from(Wrap)) for _ in range(3))
    border = tuple(draw(st.sampled_from([-0.5, 0.0, 0.25, 1.0])) for _ in range(4))
    mip = draw(st.one_of(st.none(), filters))
    sampler = SamplerDescriptor(draw(filters), draw(filters), mip, *wraps, border=border)  # type: ignore[arg-type]
    return sl.HostTexture(texels[: draw(st.integers(1, len(texels)))], format, kind, sampler)


@given(textures(), st.integers(0, 1000))
@settings(max_examples=50)
def test_any_texture_is_the_same_everywhere(device: Device, texture: sl.HostTexture, seed: int) -> None:
    """Within 8-bit weights for each of three directions, as llvmpipe may filter, and where that rounds
    coordinates to 8 bits between texels, too; lanes within float32."""
    at = coordinates(seed)
    small = texture.format.dtype.itemsize == 1
    assert_agree(sample(device, texture, at), 3 / 256 if small else 1e-5, 1e-5)


# -- cubes -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("size", [1, 2, 5], ids=str)
@pytest.mark.parametrize("filter", [NEAREST, LINEAR], ids=name)
def test_cubes_are_seamless_at_edges_and_corners(device: Device, size: int, filter: Filter) -> None:
    """The directions include those whose longest components are equal."""
    corners = np.stack(np.meshgrid(*[(-1, 0, 1, 0.999)] * 3), -1).reshape(-1, 3)
    rng = np.random.default_rng(4)
    directions = np.r_[corners, rng.normal(size=(COUNT - len(corners), 3))]
    directions[np.all(directions == 0, axis=1)] = (0, 0, 1)
    at = np.c_[directions, np.zeros(COUNT)].astype("f4")
    texels = random_levels(Format.RG32F, size, size, 6, CUBE, levels=1)
    texture = sl.HostTexture(texels, Format.RG32F, CUBE, SamplerDescriptor(filter, filter, None))
    assert_agree(sample(device, texture, at), 3e-6, 3e-6)


# -- levels from derivatives -------------------------------------------------------------------------------


class Graded2D(At):
    source: sl.Texture2D

    def compute(self) -> None:
        step = self.coordinates[sl.global_id().x]
        self.results[sl.global_id().x] = self.source.sample_grad(sl.vec2(0.3, 0.3), step.xy, step.zw)


class Graded3D(At):
    source: sl.Texture3D

    def compute(self) -> None:
        step = self.coordinates[sl.global_id().x]
        self.results[sl.global_id().x] = self.source.sample_grad(
            sl.vec3(0.3, 0.3, 0.3), sl.vec3(step.xy, 0.0), step.zwx
        )


class GradedCube(At):
    source: sl.TextureCube

    def compute(self) -> None:
        step = self.coordinates[sl.global_id().x]
        at = sl.vec3(0.3, -1.0, 0.5)
        self.results[sl.global_id().x] = self.source.sample_grad(at, sl.vec3(0.0, step.xy), step.zwx)


@pytest.mark.parametrize(
    ("shader", "kind", "layers"), [(Graded2D, D2, 1), (Graded3D, D3, 16), (GradedCube, CUBE, 6)], ids=name
)
def test_derivatives_choose_the_level(
    device: Device, shader: type[sl.Shader], kind: TextureKind, layers: int
) -> None:
    """Every level contains its own number, so that the result is the level. The logarithm of lanes is within
    1.2e-4; llvmpipe's is linear between powers of 2, up to 0.043 less."""
    rng = np.random.default_rng(5)
    steps = (rng.normal(size=(64, 4)) * 2 ** rng.uniform(-6, 1, (64, 1))).astype("f4")
    texels = random_levels(Format.R32F, 16, 16, layers, kind)
    for level, level_texels in enumerate(texels):
        level_texels[:] = level
    texture = sl.HostTexture(texels, Format.R32F, kind, SamplerDescriptor(LINEAR, LINEAR, LINEAR))
    results = read_everywhere(device, shader, {"source": texture}, 1, coordinates=steps, results=64)
    assert_agree(results, 0.045, 2e-4)
    assert len(np.unique(np.round(results["float64"][:, 0]))) > 1


# -- anisotropy ----------------------------------------------------------------------------------------------


def grade(texture: sl.HostTexture, at: Any, right: Any, down: Any) -> NDArray[Any]:
    """Sample a 2D texture in float64 at places (n, 2), with steps (n, 2) to the next pixels."""
    (u, v), (ux, vx), (uy, vy) = (
        np.moveaxis(np.asarray(vector, float), -1, 0) for vector in (at, right, down)
    )
    return np.stack(texture.sample_grad(np.float64, u, v, 0.0, ux, vx, 0.0, uy, vy, 0.0, 0.0), -1)


def checkers(max_anisotropy: float, size: int = 64) -> sl.HostTexture:
    """Return squares of 4 by 4 texels and, in green, random texels; with levels that are means."""
    y, x = np.mgrid[:size, :size] // 4
    noise = np.random.default_rng(8).uniform(0, 1, (size, size))
    levels = [np.stack([(x + y) % 2, noise, noise, noise], -1).astype("f4")]
    while len(levels[-1]) > 1:
        half = len(levels[-1]) // 2
        levels.append(levels[-1].reshape(half, 2, half, 2, 4).mean((1, 3)))
    return sl.HostTexture(levels, Format.RGBA32F, sampler=SamplerDescriptor(max_anisotropy=max_anisotropy))


def random_ellipses(ratio: float, count: int, seed: int) -> tuple[NDArray[Any], ...]:
    """Return places and the steps of ellipses whose axes have this ratio, turned at random in both spaces."""
    rng = np.random.default_rng(seed)
    angles = rng.uniform(0, 2 * np.pi, (2, count))
    cosines, sines = np.cos(angles), np.sin(angles)
    turns = np.moveaxis(np.array([[cosines, -sines], [sines, cosines]]), (0, 1), (-2, -1))
    axes = np.exp(rng.uniform(0, 1, count))[:, None, None] * np.diag([ratio, 1.0])
    steps = turns[0] @ axes @ turns[1] / 64
    return rng.uniform(0, 1, (count, 2)), steps[..., 0], steps[..., 1]


@pytest.mark.parametrize("max_anisotropy", [2.0, 16.0])
@pytest.mark.parametrize(
    ("shader", "kind", "layers"), [(Graded2D, D2, 1), (Graded3D, D3, 16), (GradedCube, CUBE, 6)], ids=name
)
def test_anisotropic_averages_are_the_same_in_lanes_and_in_numpy(
    shader: type[sl.Shader], kind: TextureKind, layers: int, max_anisotropy: float
) -> None:
    """Levels differ by up to 1.2e-4, neighbouring levels by up to 1. Some derivatives are 0, some parallel,
    some too large or too small for their squares."""
    rng = np.random.default_rng(9)
    steps = (rng.normal(size=(128, 4)) * 2 ** rng.uniform(-7, 1, (128, 4))).astype("f4")
    steps[:6] = np.array([0, 1e-42, 1e-22, 1e18, 3e38, 0.1])[:, None]
    steps[6:8], steps[8:10, :2], steps[10:12, 2:] = (0.1, 0, 0, 0.1), 0, 0
    steps[12:20, 2:] = 3 * steps[12:20, :2]
    sampler = SamplerDescriptor(max_anisotropy=max_anisotropy)
    texture = sl.HostTexture(random_levels(Format.RGBA8, 16, 16, layers, kind), Format.RGBA8, kind, sampler)
    bindings: dict[str, Any] = {"source": texture, "coordinates": steps, "results": 128}
    exact = sl.run_compute(shader, 2, dtype=np.float64, **bindings)["results"]
    for width in (1, 16):
        np.testing.assert_allclose(
            run_opencl(shader, width, 2, **bindings)["results"], exact, rtol=0, atol=2e-4
        )
    plain = sl.HostTexture(texture.levels, Format.RGBA8, kind)
    level = sl.run_compute(shader, 2, dtype=np.float64, **{**bindings, "source": plain})["results"]
    assert np.abs(exact - level).max() > 0.05


@pytest.mark.parametrize(("ratio", "part_of_error"), [(2.0, 0.65), (5.0, 0.25), (16.0, 0.25)])
def test_an_anisotropic_average_is_nearer_to_the_mean_of_the_covered_texels(
    ratio: float, part_of_error: float
) -> None:
    """And an anisotropy that doesn't reach as far as the sampling area lies between that and none."""
    at, right, down = random_ellipses(ratio, 64, seed=2)
    part = ((np.arange(24) + 0.5) / 24 - 0.5)[:, None, None, None]
    inside = at + part * right + np.moveaxis(part, 0, 1) * down
    flat = sl.HostTexture(checkers(1).levels[:1], Format.RGBA32F)
    exact = grade(flat, inside, right, down).mean((0, 1))[:, :2]
    errors = [
        np.sqrt(((grade(checkers(max_anisotropy), at, right, down)[:, :2] - exact) ** 2).mean())
        for max_anisotropy in (1, 4, 16)
    ]
    assert errors[2] <= part_of_error * errors[0]
    assert errors[2] <= errors[1] <= errors[0]


def test_a_round_sampling_area_is_sampled_once_as_without_anisotropy() -> None:
    """As is one within a texel, where more samples would show the same texels."""
    at, right, down = random_ellipses(1.0, 64, seed=3)
    once = grade(checkers(1), at, right, down)
    np.testing.assert_allclose(grade(checkers(16), at, right, down), once, rtol=0, atol=1e-7)
    at, right, down = random_ellipses(9.0, 64, seed=4)
    within = grade(checkers(16), at, right / 30, down / 30)
    np.testing.assert_allclose(within, grade(checkers(1), at, right / 30, down / 30), rtol=0, atol=1e-9)


def test_an_anisotropic_average_is_continuous_where_it_takes_another_sample() -> None:
    """Rounded up to whole samples of equal weight, results would change by up to 0.1 there."""
    ratios = np.linspace(0.5, 20.0, 8001)[:, None]
    turned = np.array([0.6, 0.8]) / 64
    down = np.array([-0.8, 0.6]) / 64 * 1.3
    at = np.broadcast_to((0.37, 0.61), (len(ratios), 2))
    results = grade(checkers(16), at, 1.3 * ratios * turned, np.broadcast_to(down, at.shape))
    assert np.abs(np.diff(results, axis=0)).max() < 0.006
    assert np.ptp(results, axis=0).min() > 0.05


@pytest.mark.parametrize("width", [1, 16])
def test_derivatives_that_are_not_finite_read_a_texel(width: int) -> None:
    hard = np.array([np.nan, np.inf, -np.inf, 3e38], "f4")
    steps = np.zeros((256, 4), "f4")
    steps[:] = np.stack(np.meshgrid(*[hard] * 4), -1).reshape(-1, 4)
    sampler = SamplerDescriptor(max_anisotropy=16)
    texture = sl.HostTexture(random_levels(Format.RGBA8, 16, 16), Format.RGBA8, sampler=sampler)
    bindings: dict[str, Any] = {"source": texture, "coordinates": steps, "results": 256}
    for results in (sl.run_compute(Graded2D, 4, **bindings), run_opencl(Graded2D, width, 4, **bindings)):
        texels = results["results"]
        assert np.isfinite(texels).all()
        assert 0 <= texels.min() <= texels.max() <= 1


# -- error and time ----------------------------------------------------------------------------------------


class FastSample2D(Sample2D):
    precision = sl.Precision.FAST


class FastGraded2D(Graded2D):
    precision = sl.Precision.FAST


@pytest.mark.parametrize("filter", [NEAREST, LINEAR], ids=name)  # each decodes in a place of its own
@pytest.mark.parametrize("width", [1, 16])
def test_srgb_is_decoded_as_exactly_as_is_asked_for(width: int, filter: Filter) -> None:
    """All 256 stored values: within 2e-6, or within 1.3e-3 and 0.35 of the step to the next one. White is
    white."""
    texels = np.repeat(np.arange(256, dtype="u1"), 4).reshape(1, 256, 4)
    sampler = SamplerDescriptor(filter, filter, None)
    bindings: dict[str, Any] = {"source": sl.HostTexture(texels, Format.RGBA8_SRGB, sampler=sampler)}
    bindings["coordinates"] = np.zeros((256, 4), "f4")
    bindings["coordinates"][:, 0] = (np.arange(256) + 0.5) / 256
    reference = sl.run_compute(Sample2D, 4, dtype=np.float64, results=256, **bindings)["results"]
    exact, fast = (
        run_opencl(shader, width, 4, results=256, **bindings)["results"]
        for shader in (Sample2D, FastSample2D)
    )
    step = np.diff(reference[:, :3], axis=0, append=reference[-1:, :3] + 1.0)
    np.testing.assert_allclose(exact, reference, rtol=0, atol=2e-6)
    np.testing.assert_allclose(fast, reference, rtol=0, atol=1.3e-3)
    assert (np.abs(fast[:, :3] - reference[:, :3]) <= 0.35 * step).all()
    assert np.abs(fast - reference).max() > 1e-3  # what is stated is what is paid
    for colors in (exact, fast):
        assert (colors[-1] == 1).all()
        assert (colors[0] == 0).all()


@pytest.mark.parametrize("width", [1, 16])
def test_fast_levels_are_up_to_a_23rd_less(width: int) -> None:
    """A logarithm that is linear between powers of 2, where it is exact; the other is within 1.2e-4."""
    steps = np.zeros((256, 4), "f4")
    steps[:, 0] = 2.0 ** np.linspace(-3, 3, 256) / 16
    texels = random_levels(Format.R32F, 16, 16)
    for level, level_texels in enumerate(texels):
        level_texels[:] = level
    bindings: dict[str, Any] = {"source": sl.HostTexture(texels, Format.R32F), "coordinates": steps}
    reference = sl.run_compute(Graded2D, 4, dtype=np.float64, results=256, **bindings)["results"][:, 0]
    exact, fast = (
        run_opencl(shader, width, 4, results=256, **bindings)["results"][:, 0]
        for shader in (Graded2D, FastGraded2D)
    )
    np.testing.assert_allclose(exact, reference, rtol=0, atol=1.2e-4)
    less = reference - fast
    assert less.min() > -1e-6
    assert 0.04 < less.max() < 0.0434
    powers = [0, 85, 170, 255]
    np.testing.assert_allclose(fast[powers], reference[powers], rtol=0, atol=1e-6)


class Surface(sl.Struct):
    clip: sl.vec4
    uv: sl.vec2
    material: int


class Textured(sl.Shader):
    """Implicit levels, with and without a bias; a comparison; and a level for the whole block."""

    source: sl.Texture2D
    around: sl.TextureCube
    shadow: sl.DepthTexture2D

    def vertex(self, v: Corner) -> Surface:
        return Surface(clip=v.position, uv=v.position.xy, material=0)

    def fragment(self, s: Surface) -> sl.vec4:
        if s.material == 1:
            return sl.vec4(self.source.sample(sl.vec2(0.5, 0.5)).x, 0.0, 0.0, 0.0)
        biased = self.source.sample_bias(s.uv, 1.5).x
        cube = self.around.sample(sl.vec3(s.uv, -0.75)).x
        return sl.vec4(self.source.sample(s.uv).x, biased, cube, self.shadow.sample_compare(s.uv, 0.5))


def test_a_fragment_finds_its_level_from_its_quad() -> None:
    """Every level is its number. On the diagonal of a quad 2 texels at level 0 are a step: 1 for `sample`."""
    rows, columns = np.mgrid[:8, :16]
    uv = np.stack([columns * 2 / 32, rows * 0.5 / 32], -1).astype("f4")

    def mip_chain(format: Format, kind: TextureKind, layers: int) -> list[NDArray[Any]]:
        levels = random_levels(format, 32, 32, layers, kind)
        for level, level_texels in enumerate(levels):
            level_texels[:] = level
        return levels

    shadow = SamplerDescriptor(NEAREST, NEAREST, NEAREST, compare=Comparison.LESS)
    bindings: dict[str, Any] = {
        "source": sl.HostTexture(mip_chain(Format.R32F, D2, 1), Format.R32F),
        "around": sl.HostTexture(mip_chain(Format.R32F, CUBE, 6), Format.R32F, CUBE),
        "shadow": sl.HostTexture(mip_chain(Format.D32F, D2, 1), Format.D32F, D2, shadow),
    }
    varyings: dict[str, Any] = {"uv": uv, "material": np.int32(0)}
    exact = sl.run_fragment(Textured, varyings, dtype=np.float64, **bindings).outputs
    (output,) = exact
    expected = exact[output]
    np.testing.assert_allclose(expected[..., 0], 1, atol=1e-6)
    np.testing.assert_allclose(expected[..., 1], 2.5, atol=1e-6)
    assert (expected[..., 3] == 1).all()
    assert len(np.unique(expected[..., 2].round(3))) > 2
    lanes = run_fragment_lanes(Textured, varyings, (8, 16), **bindings)[output]
    np.testing.assert_allclose(lanes, expected, rtol=0, atol=3e-4)
    flat = run_fragment_lanes(Textured, {**varyings, "material": np.int32(1)}, (8, 16), **bindings)[output]
    assert (flat[..., 0] == 0).all()
    for binding in bindings.values():
        binding.sampler = replace(binding.sampler, max_anisotropy=3.0)
    narrow = sl.run_fragment(Textured, varyings, dtype=np.float64, **bindings).outputs[output]
    np.testing.assert_allclose(narrow[..., 0], 0, atol=1e-6)  # 2 texels long, and half a texel wide
    np.testing.assert_allclose(narrow[..., 1], 1.5, atol=1e-6)
    assert (narrow[..., 3] == 0).all()  # the comparison is with level 0 as well
    lanes = run_fragment_lanes(Textured, varyings, (8, 16), **bindings)[output]
    np.testing.assert_allclose(lanes, narrow, rtol=0, atol=3e-4)


class Heights(sl.Shader):
    """A vertex stage has no quads, so it samples level 0."""

    source: sl.Texture2D

    def vertex(self, v: Corner) -> sl.vec4:
        return self.source.sample(v.position.xy) + self.source.load(sl.ivec2(v.position.xy * 8.0))


def test_a_vertex_stage_reads_textures() -> None:
    texture = sl.HostTexture(random_levels(Format.RGBA16F, 8, 8), Format.RGBA16F)
    at = np.zeros((20, 4), "f4")
    at[:, :2] = np.random.default_rng(15).random((20, 2))
    attributes = {"position": at, "color": at}
    expected = sl.run_vertex(Heights, attributes, dtype=np.float64, source=texture).position
    positions = run_vertex_lanes(Heights, attributes, 20, source=texture)["position"]
    np.testing.assert_allclose(positions, expected, rtol=0, atol=3e-6)


# -- single texels -----------------------------------------------------------------------------------------


class Gather2D(At):
    source: sl.Texture2D

    def compute(self) -> None:
        i = sl.global_id().x
        at = self.coordinates[i].xy
        self.results[i] = self.source.gather(at) + 2.0 * self.source.gather(at, 2)


class GatherCube(At):
    source: sl.TextureCube

    def compute(self) -> None:
        self.results[sl.global_id().x] = self.source.gather(self.coordinates[sl.global_id().x].xyz, 1)


@pytest.mark.parametrize(
    ("shader", "kind", "wrap"),
    [(Gather2D, D2, Wrap.REPEAT), (Gather2D, D2, Wrap.MIRROR), (GatherCube, CUBE, Wrap.REPEAT)],
    ids=name,
)
def test_gather_gives_a_component_of_four_texels(
    device: Device, shader: type[sl.Shader], kind: TextureKind, wrap: Wrap
) -> None:
    texels = random_levels(Format.RGBA32F, 5, 5, SHAPES[kind][1], kind, levels=1)
    texture = sl.HostTexture(
        texels, Format.RGBA32F, kind, SamplerDescriptor(LINEAR, LINEAR, None, wrap, wrap)
    )
    results = read_everywhere(
        device, shader, {"source": texture}, 8, coordinates=coordinates(6), results=COUNT
    )
    assert_agree(results, 1e-6, 1e-6)


class Load2D(At):
    source: sl.Texture2D
    volume: sl.Texture3D

    def compute(self) -> None:
        i = sl.global_id().x
        at = self.coordinates[i]
        texel = sl.ivec2(int(at.x), int(at.y))
        flat = self.source.load(texel, int(at.w))
        solid = self.volume.load(sl.ivec3(texel, int(at.z)))
        self.results[i] = flat + 2.0 * solid


def test_loads_name_texel_and_level_and_give_zeros_outside(device: Device) -> None:
    at = coordinates(7)
    at[:, :3] *= 3
    textures = {
        "source": sl.HostTexture(random_levels(Format.RGBA32F, 6, 9), Format.RGBA32F),
        "volume": sl.HostTexture(random_levels(Format.RGBA32F, 5, 5, 5, D3), Format.RGBA32F, D3),
    }
    results = read_everywhere(device, Load2D, textures, 8, coordinates=at, results=COUNT)
    assert (results["float64"] == 0).all(axis=1).any()
    assert_agree(results, 0.0, 0.0)


class LoadUint(At):
    source: sl.UintTexture2D

    def compute(self) -> None:
        i = sl.global_id().x
        at = self.coordinates[i]
        texel = self.source.sample_lod(at.xy, at.w)
        self.results[i] = sl.vec4(
            sl.vec2(texel.xy % sl.uvec4(10007).xy), sl.vec2(texel.zw // sl.uvec4(65536).zw)
        )


class LoadInt(At):
    source: sl.IntTexture2D

    def compute(self) -> None:
        i = sl.global_id().x
        at = self.coordinates[i]
        texel = self.source.sample_lod(at.xy, at.w)
        self.results[i] = sl.vec4(
            float(texel.x // 65536), float(texel.y % 9973), float(texel.z), float(texel.w)
        )


@pytest.mark.parametrize("format", [f for f in COLOR_FORMATS if f.is_integer], ids=name)
def test_integers_are_read_whole(device: Device, format: Format) -> None:
    shader = LoadUint if format.kind is ChannelKind.UINT else LoadInt
    sampler = SamplerDescriptor(NEAREST, NEAREST, NEAREST)
    texture = sl.HostTexture(random_levels(format, 7, 5), format, D2, sampler)
    results = read_everywhere(
        device, shader, {"source": texture}, 8, coordinates=coordinates(8), results=COUNT
    )
    if format is Format.RGBA32I:  # whose last components are beyond what a float holds
        results = {way: texels.astype("f4") for way, texels in results.items()}
    assert_agree(results, 0.0, 0.0)


class Sizes(At):
    flat: sl.Texture2D
    layers: sl.Texture2DArray
    volume: sl.Texture3D
    around: sl.TextureCube

    def compute(self) -> None:
        i = sl.global_id().x
        total = sl.vec4(0.0)
        for level in range(3):
            flat = self.flat.size(level)
            total = total * 100.0 + sl.vec4(
                float(flat.x + 1000 * self.flat.levels()),
                float(flat.y + self.layers.size().z * 1000),
                float(self.around.size(level).x),
                float(self.volume.size(level).z + self.volume.size().x * 1000),
            )
        self.results[i] = total


class SizesOfLanes(At):
    source: sl.Texture3D

    def compute(self) -> None:
        i = sl.global_id().x
        size = self.source.size(i % 4)
        self.results[i] = sl.vec4(sl.vec3(size), float(i % 4))


def test_sizes_are_those_of_each_level(device: Device) -> None:
    textures = {
        "flat": sl.HostTexture(random_levels(Format.R8, 13, 7), Format.R8),
        "layers": sl.HostTexture(random_levels(Format.R8, 4, 4, 5, ARRAY), Format.R8, ARRAY),
        "volume": sl.HostTexture(random_levels(Format.R8, 9, 8, 7, D3), Format.R8, D3),
        "around": sl.HostTexture(random_levels(Format.R8, 4, 4, 6, CUBE), Format.R8, CUBE),
    }
    at = np.zeros((64, 4), "f4")
    assert_agree(read_everywhere(device, Sizes, textures, 1, coordinates=at, results=64), 0.0, 0.0)


def test_each_lane_may_ask_for_another_level_s_size() -> None:
    """llvmpipe returns the first lane's size in all lanes, so it isn't compared."""
    bindings = {"source": sl.HostTexture(random_levels(Format.R8, 9, 8, 7, D3), Format.R8, D3)}
    at = np.zeros((64, 4), "f4")
    expected = np.resize([(9, 8, 7, 0), (4, 4, 3, 1), (2, 2, 1, 2), (1, 1, 1, 3)], (64, 4))
    for width in (1, 16):
        sizes = run_opencl(SizesOfLanes, width, 1, coordinates=at, results=64, **bindings)["results"]
        np.testing.assert_array_equal(sizes, expected)
    sizes = sl.run_compute(SizesOfLanes, 1, coordinates=at, results=64, **bindings)["results"]
    np.testing.assert_array_equal(sizes, expected)


# -- comparisons -------------------------------------------------------------------------------------------


class Compare2D(At):
    source: sl.DepthTexture2D

    def compute(self) -> None:
        i = sl.global_id().x
        at = self.coordinates[i]
        four = self.source.gather_compare(at.xy, at.z)
        implicit = self.source.sample_compare(at.xy, at.z)
        level = self.source.sample_compare_lod(at.xy, at.z, at.w)
        self.results[i] = sl.vec4(implicit, level, four.x + 2.0 * four.y, four.z + 2.0 * four.w)


def comparing(annotation: Any) -> Any:
    class Compare(At):
        source: annotation

        def compute(self) -> None:
            at = self.coordinates[sl.global_id().x]
            self.results[sl.global_id().x] = sl.vec4(self.source.sample_compare(at.xyz, abs_half(at.w)))

    return Compare


@rhi.shading.function
def abs_half(x: float) -> float:
    return (x if x > 0.0 else -x) * 0.15


@pytest.mark.parametrize("comparison", list(Comparison), ids=name)
@pytest.mark.parametrize("filter", [NEAREST, LINEAR], ids=name)
def test_depths_are_compared_before_they_are_filtered(
    device: Device, comparison: Comparison, filter: Filter
) -> None:
    """Some references equal depths. llvmpipe's weights have more than 8 bits here."""
    depths = np.random.default_rng(9).integers(0, 5, (1, 6, 5, 1)).astype("f4") / 4
    sampler = SamplerDescriptor(
        filter, filter, None, Wrap.BORDER, Wrap.BORDER, border=(0.5, 0, 0, 0), compare=comparison
    )
    at = coordinates(10)
    at[:, 2] = np.random.default_rng(11).integers(0, 5, COUNT) / 4
    texture = sl.HostTexture(depths, Format.D32F, D2, sampler)
    results = read_everywhere(device, Compare2D, {"source": texture}, 8, coordinates=at, results=COUNT)
    assert_agree(results, 2e-6)


@pytest.mark.parametrize("format", [Format.D16, Format.D24, Format.D32F], ids=name)
@pytest.mark.parametrize(
    "comparison", [Comparison.LESS_EQUAL, Comparison.EQUAL, Comparison.GREATER], ids=name
)
def test_references_of_fixed_point_depths_are_clamped(
    device: Device, format: Format, comparison: Comparison
) -> None:
    at = np.zeros((64, 4), "f4")
    at[:, :3] = np.c_[
        np.resize([0.25, 0.75], 64), np.full(64, 0.5), np.repeat([-1, 0, 0.5, 1, 1.5, np.inf, -np.inf, 2], 8)
    ]
    sampler = nearest(Wrap.CLAMP, compare=comparison)
    texture = sl.HostTexture(np.float32([[0, 1]]), format, D2, sampler)
    assert_agree(
        read_everywhere(device, Compare2D, {"source": texture}, 1, coordinates=at, results=64), 0.0, 0.0
    )


@pytest.mark.parametrize(
    ("annotation", "kind"), [(sl.DepthTexture2DArray, ARRAY), (sl.DepthTextureCube, CUBE)]
)
def test_layers_and_cubes_are_compared(device: Device, annotation: Any, kind: TextureKind) -> None:
    texels = random_levels(Format.D32F, 4, 4, SHAPES[kind][1], kind, levels=1)
    sampler = SamplerDescriptor(LINEAR, LINEAR, None, compare=Comparison.LESS)
    texture = sl.HostTexture(texels, Format.D32F, kind, sampler)
    results = read_everywhere(
        device, comparing(annotation), {"source": texture}, 8, coordinates=coordinates(12), results=COUNT
    )
    assert_agree(results, 3e-6, 3e-6)


# -- control flow ------------------------------------------------------------------------------------------


class Branches(At):
    source: sl.Texture2D

    def compute(self) -> None:
        i = sl.global_id().x
        at = self.coordinates[i]
        total = self.source.sample(sl.vec2(0.25, 0.75))
        if at.x > 0.0:
            total += self.source.sample_lod(at.xy, at.w)
            for k in range(i % 4):
                total += self.source.load(sl.ivec2(k, i % 5))
        elif at.y > 0.5:
            total = self.source.sample_lod(self.source.load(sl.ivec2(0, 0)).xy, 1.0)
        self.results[i] = total


def test_textures_are_read_in_branches_and_loops_and_by_all_lanes_at_once(device: Device) -> None:
    texture = sl.HostTexture(random_levels(Format.RGBA16F, 7, 5), Format.RGBA16F)
    results = read_everywhere(
        device, Branches, {"source": texture}, 8, coordinates=coordinates(13), results=COUNT
    )
    assert_agree(results, 5e-6, 5e-6)


def test_a_kernel_holds_each_function_of_textures_once() -> None:
    at = coordinates(14, 64)
    texture = sl.HostTexture(random_levels(Format.R8, 4, 4), Format.R8)
    text = Kernel(Branches, 16, source=texture, coordinates=at, results=64).text
    assert text.count("void rhi_walk(") == 1
    assert "rhi_walk(" not in Kernel(NoTexture, 16, coordinates=at, results=64).text


class NoTexture(At):
    def compute(self) -> None:
        self.results[sl.global_id().x] = self.coordinates[sl.global_id().x]


# -- images ------------------------------------------------------------------------------------------------


def copying(format: Format, annotation: Any) -> Any:
    class Copy(sl.Shader):
        work_group = (8, 8)
        source: annotation = sl.image(format)
        target: annotation = sl.image(format)

        def compute(self) -> None:
            at = sl.global_id().xy
            if (at.x + at.y) % 3 != 0:
                self.target.store(at + sl.ivec2(1, -1), self.source.load(at))

    return Copy


_IMAGES: dict[ChannelKind, Any] = {ChannelKind.UINT: sl.UintImage2D, ChannelKind.INT: sl.IntImage2D}


@pytest.mark.parametrize("format", [f for f in COLOR_FORMATS if f.kind is not ChannelKind.SRGB], ids=name)
def test_images_keep_every_bit_and_nothing_is_written_outside(format: Format) -> None:
    source = random_levels(format, 11, 6, levels=1)[0]
    expected = np.zeros_like(source)
    for y in range(6):
        for x in range(11):
            if (x + y) % 3 != 0 and x + 1 < 11 and y >= 1:
                expected[0, y - 1, x + 1] = source[0, y, x]
    # Beyond the source zeros are loaded, and beyond the target nothing is stored.
    shader = copying(format, _IMAGES.get(format.kind, sl.Image2D))
    bindings = {
        "source": sl.HostTexture(source, format),
        "target": sl.HostTexture(np.zeros_like(source), format),
    }
    for width in (1, 16):
        np.testing.assert_array_equal(run_opencl(shader, width, (2, 1), **bindings)["target"], expected)
    np.testing.assert_array_equal(sl.run_compute(shader, (2, 1), **bindings)["target"], expected)


class Rounded(sl.Shader):
    work_group = (16,)
    values: sl.Storage[sl.vec4]
    target: sl.Image2D = sl.image(Format.RGBA8)
    signed: sl.Image2D = sl.image(Format.RGBA8_SNORM)
    halves: sl.Image2D = sl.image(Format.RGBA16F)

    def compute(self) -> None:
        i = sl.global_id().x
        self.target.store(sl.ivec2(i, 0), self.values[i])
        self.signed.store(sl.ivec2(i, 0), self.values[i])
        self.halves.store(sl.ivec2(i, 0), self.values[i])


def test_stored_values_are_clamped_and_rounded_to_nearest() -> None:
    hard = [
        -np.inf,
        -2,
        -1,
        -0.5,
        0,
        0.31,
        0.51,
        0.4 / 255,
        0.6 / 255,
        1,
        1.5,
        np.inf,
        65519,
        65520,
        1e-7,
        2.4 / 127,
    ]
    values = np.zeros((16, 4), "f4")
    values[:] = np.array(hard, "f4")[:, None]
    bindings: dict[str, Any] = {"values": values}
    for field, format in (
        ("target", Format.RGBA8),
        ("signed", Format.RGBA8_SNORM),
        ("halves", Format.RGBA16F),
    ):
        bindings[field] = sl.HostTexture(np.zeros((1, 16, 4), format.dtype), format)
    expected = sl.run_compute(Rounded, 1, **bindings)
    for width in (1, 16):
        results = run_opencl(Rounded, width, 1, **bindings)
        for field, texels in expected.items():
            np.testing.assert_array_equal(results[field], texels)


class Layered(sl.Shader):
    work_group = (4, 4)
    target: sl.Image3D = sl.image(Format.R32F)

    def compute(self) -> None:
        at = sl.global_id()
        self.target.store(at, sl.vec4(float(at.x + 10 * at.y + 100 * at.z)))


def test_all_layers_of_an_image_are_written() -> None:
    bindings = {"target": sl.HostTexture(np.zeros((3, 4, 4, 1), "f4"), Format.R32F, D3)}
    z, y, x = np.indices((3, 4, 4))
    for width in (1, 16):
        texels = run_opencl(Layered, width, (1, 1, 4), **bindings)["target"]
        np.testing.assert_array_equal(texels[..., 0], x + 10 * y + 100 * z)


class Beyond(sl.Shader):
    """`Layered` with a texel and a level of a texture."""

    work_group = (4, 4)
    checked = True
    target: sl.Image3D = sl.image(Format.R32F)
    source: sl.Texture2D
    which: sl.Storage[int]

    def compute(self) -> None:
        at = sl.global_id()
        texel = self.source.load(sl.ivec2(at.x, self.which[0]), self.which[1])
        self.target.store(sl.ivec3(at.xy, self.which[2]), texel)


@pytest.mark.parametrize(
    ("which", "coordinates", "line"),
    [
        ((7, 0, 0), "index 7", "load"),
        ((0, 2, 0), "index 2", "load"),
        ((0, 0, 3), "index 3", "store"),
        ((4, 1, 0), "index 4", "load"),
        ((-1, 0, 0), "index -1", "load"),
    ],
)
def test_a_checked_shader_reports_texels_outside(
    which: tuple[int, int, int], coordinates: str, line: str
) -> None:
    bound: dict[str, Any] = {
        "target": sl.HostTexture(np.zeros((3, 4, 4, 1), "f4"), Format.R32F, D3),
        "source": sl.HostTexture(random_levels(Format.R8, 8, 7, levels=2), Format.R8),
    }
    ways = [partial(run_opencl, Beyond, 1), partial(run_opencl, Beyond, 16), partial(sl.run_compute, Beyond)]
    for run in ways:
        run(1, which=np.int32([2, 1, 2]), **bound)
        with pytest.raises(ShaderError, match=coordinates) as caught:
            run(1, which=np.int32(which), **bound)
        assert f".{line}(" in str(caught.value)


class ReadSamples(sl.Shader):
    """Reads a sample of a texel for each row of `which`."""

    checked = True
    source: sl.UintTexture2DSamples
    which: sl.Storage[sl.ivec4]
    results: sl.StorageRW[sl.uvec4]

    def compute(self) -> None:
        i = sl.global_id().x
        self.results[i] = self.source.load(self.which[i].xy, self.which[i].z) + sl.uint(self.source.size().x)


def test_samples_are_the_layers_of_a_host_texture() -> None:
    texels = random_levels(Format.RGBA8UI, 5, 3, 4, ARRAY)[:1]
    which = np.int32([(4, 2, 3, 0), (0, 1, 2, 0), (3, 0, 0, 0)])
    bindings = {"source": sl.HostTexture(texels, Format.RGBA8UI, ARRAY), "results": 3}
    expected = texels[0][which[:, 2], which[:, 1], which[:, 0]].astype(np.uint32) + 5
    for run in (
        partial(run_opencl, ReadSamples, 1),
        partial(run_opencl, ReadSamples, 16),
        partial(sl.run_compute, ReadSamples),
    ):
        np.testing.assert_array_equal(run(3, which=which, **bindings)["results"], expected)
        with pytest.raises(ShaderError, match="index 4"):
            run(3, which=np.int32([(4, 2, 4, 0)] * 3), **bindings)


# -- HostTexture -------------------------------------------------------------------------------------------


def test_a_host_texture_of_another_shape_or_format_is_refused() -> None:
    bindings: dict[str, Any] = {"coordinates": coordinates(0, 64), "results": 64}
    fitting = sl.HostTexture(np.zeros((4, 4), "u1"), Format.R8)
    sl.run_compute(Sample2D, 1, source=fitting, **bindings)
    with pytest.raises(ValidationError, match="shading-arguments"):
        sl.run_compute(Sample3D, 1, source=fitting, **bindings)
    with pytest.raises(ValidationError, match="shading-arguments"):
        sl.run_compute(ReadSamples, 1, source=fitting, which=np.zeros((1, 4), "i4"), results=1)
    with pytest.raises(ValidationError, match="shading-arguments"):
        sl.HostTexture(np.zeros((4, 4), "f4"), Format.R8)
    with pytest.raises(ValidationError, match="shading-arguments"):
        sl.run_compute(Layered, 1, target=sl.HostTexture(np.zeros((1, 1, 1, 1), "f2"), Format.R16F, D3))


def test_images_passed_to_run_compute_are_not_modified() -> None:
    texels = np.zeros((3, 4, 4, 1), "f4")
    texture = sl.HostTexture(texels, Format.R32F, D3)
    after = sl.run_compute(Layered, (1, 1, 3), target=texture)["target"]
    assert after[2, 3, 3, 0] == 233
    assert not texture.levels[0].any()


def test_integer_textures_default_to_a_nearest_sampler() -> None:
    assert sl.HostTexture(np.zeros((1, 1), "u4"), Format.R32UI).sampler.minify is NEAREST
    assert sl.HostTexture(np.zeros((1, 1), "u1"), Format.R8, sampler=nearest()).sampler == nearest()
    assert sl.HostTexture(np.zeros((1, 1), "u1"), Format.R8).sampler == SamplerDescriptor()
