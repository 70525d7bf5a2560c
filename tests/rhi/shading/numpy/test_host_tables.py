"""Texture tables on NumPy: an image of a table is sampled as a texture of its own, in float64."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from nights import rotate_seed
from numpy.typing import NDArray

import rhi.shading as sl
from rhi import Filter, Format, SamplerDescriptor, ValidationError, Wrap
from rhi.contract.texels import halve
from rhi.shading.ir.texture_pages import GUTTER, plan_pages

SIZES = ((9, 6), (4, 4), (2, 31), (1, 1))
SAMPLERS = [
    SamplerDescriptor(
        minify, magnify, mip, wrap_u, wrap_v, border=(0.25, 0.5, 1.0, 0.0), max_anisotropy=anisotropy
    )
    for minify, magnify, mip, wrap_u, wrap_v, anisotropy in (
        (Filter.LINEAR, Filter.LINEAR, Filter.LINEAR, Wrap.REPEAT, Wrap.REPEAT, 1),
        (Filter.LINEAR, Filter.NEAREST, Filter.NEAREST, Wrap.MIRROR, Wrap.CLAMP, 1),
        (Filter.NEAREST, Filter.LINEAR, Filter.LINEAR, Wrap.CLAMP, Wrap.BORDER, 1),
        (Filter.NEAREST, Filter.NEAREST, None, Wrap.BORDER, Wrap.MIRROR, 1),
        (Filter.LINEAR, Filter.LINEAR, None, Wrap.BORDER, Wrap.REPEAT, 1),
        (Filter.LINEAR, Filter.LINEAR, Filter.LINEAR, Wrap.MIRROR, Wrap.REPEAT, 4),
        (Filter.LINEAR, Filter.LINEAR, Filter.NEAREST, Wrap.CLAMP, Wrap.CLAMP, 2.5),
        (Filter.LINEAR, Filter.LINEAR, Filter.LINEAR, Wrap.REPEAT, Wrap.MIRROR, 16),
    )
]


class Query(sl.Struct):
    """Coordinates, differences, a level and an image."""

    at: sl.vec2
    dx: sl.vec2
    dy: sl.vec2
    lod: float
    index: int


class SampleTable(sl.Shader):
    """Samples a table in both ways that name the level."""

    images: sl.TextureTable
    queries: sl.Storage[Query]
    results: sl.StorageRW[sl.vec4]

    def compute(self) -> None:
        i = int(sl.global_id().x)
        query = self.queries[i]
        self.results[3 * i] = self.images[query.index].sample_lod(query.at, query.lod)
        self.results[3 * i + 1] = self.images[query.index].sample_grad(query.at, query.dx, query.dy)
        self.results[3 * i + 2] = self.images[query.index].sample(query.at)


class SampleTexture(sl.Shader):
    """Samples a texture in the same ways."""

    image: sl.Texture2D
    queries: sl.Storage[Query]
    results: sl.StorageRW[sl.vec4]

    def compute(self) -> None:
        i = int(sl.global_id().x)
        query = self.queries[i]
        self.results[3 * i] = self.image.sample_lod(query.at, query.lod)
        self.results[3 * i + 1] = self.image.sample_grad(query.at, query.dx, query.dy)
        self.results[3 * i + 2] = self.image.sample(query.at)


class Uv(sl.Struct):
    """A clip position and texture coordinates."""

    clip: sl.vec4
    uv: sl.vec2


class DrawnTable(sl.Shader):
    """Samples a table by the derivatives of its coordinates."""

    images: sl.TextureTable

    def vertex(self) -> Uv:
        return Uv(clip=sl.vec4(0.0), uv=sl.vec2(0.0))

    def fragment(self, v: Uv) -> sl.vec4:
        return self.images[0].sample(v.uv) + self.images[1].sample_bias(v.uv, 1.5) * 2.0


class DrawnTextures(sl.Shader):
    """Samples two textures by the derivatives of its coordinates."""

    first: sl.Texture2D
    second: sl.Texture2D

    def vertex(self) -> Uv:
        return Uv(clip=sl.vec4(0.0), uv=sl.vec2(0.0))

    def fragment(self, v: Uv) -> sl.vec4:
        return self.first.sample(v.uv) + self.second.sample_bias(v.uv, 1.5) * 2.0


def make_texture(
    rng: np.random.Generator, size: tuple[int, int], sampler: SamplerDescriptor, form: Format
) -> sl.HostTexture:
    width, height = size
    levels: list[NDArray[Any]] = [rng.integers(0, 256, (1, height, width, 4), dtype=np.uint8)]
    while max(levels[-1].shape[1:3]) > 1:
        levels.append(halve(form, levels[-1], 1))
    return sl.HostTexture(levels, form, sampler=sampler)


def make_queries(rng: np.random.Generator, count: int, index: int) -> NDArray[Any]:
    queries = np.zeros(count, Query.dtype)
    queries["at"] = rng.uniform(-2.5, 2.5, (count, 2))
    sizes = 2.0 ** rng.uniform(-7, 2, (2, count, 1))
    queries["dx"] = rng.normal(size=(count, 2)) * sizes[0]
    queries["dy"] = rng.normal(size=(count, 2)) * sizes[1]
    queries["dx"][0] = 0
    queries["lod"] = rng.uniform(-2, 7, count)
    queries["index"] = index
    return queries


@pytest.mark.parametrize("number", range(len(SAMPLERS)))
@pytest.mark.parametrize("form", [Format.RGBA8, Format.RGBA8_SRGB], ids=lambda form: form.name)
def test_an_image_of_a_table_is_sampled_as_a_texture_of_its_own(number: int, form: Format) -> None:
    rng = np.random.default_rng(rotate_seed(number))
    samplers = [SAMPLERS[(number + shift) % len(SAMPLERS)] for shift in range(len(SIZES))]
    textures = [make_texture(rng, *pair, form) for pair in zip(SIZES, samplers, strict=True)]
    table = sl.HostTextureTable(textures)
    for index, texture in enumerate(textures):
        queries = make_queries(rng, 60, index)
        arguments: dict[str, Any] = {"queries": queries, "results": 3 * len(queries), "dtype": np.float64}
        actual = sl.run_compute(SampleTable, len(queries), images=table, **arguments)["results"]
        expected = sl.run_compute(SampleTexture, len(queries), image=texture, **arguments)["results"]
        # A border has the bytes of its format, which are nearest to the border's color.
        step = 1 / 255 if samplers[index].uses_border else 2e-6
        np.testing.assert_allclose(actual, expected, atol=step)


def test_derivatives_select_the_levels_of_an_image() -> None:
    rng = np.random.default_rng(rotate_seed(4))
    sizes, samplers = ((24, 14), (8, 9)), (SAMPLERS[0], SAMPLERS[5])
    textures = [make_texture(rng, *pair, Format.RGBA8) for pair in zip(sizes, samplers, strict=True)]
    y, x = np.mgrid[:8, :8]
    uv = np.stack([x * 0.11 + y * 0.03, y * 0.2 - x * 0.05], -1)
    actual = sl.run_fragment(DrawnTable, {"uv": uv}, images=sl.HostTextureTable(textures), dtype=np.float64)
    first, second = textures
    expected = sl.run_fragment(DrawnTextures, {"uv": uv}, first=first, second=second, dtype=np.float64)
    np.testing.assert_allclose(actual.outputs["color"], expected.outputs["color"], atol=2e-6)


def levels_of(width: int, height: int) -> list[tuple[int, int]]:
    count = max(width, height).bit_length()
    return [(max(width >> level, 1), max(height >> level, 1)) for level in range(count)]


@pytest.mark.parametrize("case", range(8))
def test_rectangles_of_pages_are_apart_and_waste_little(case: int) -> None:
    rng = np.random.default_rng(rotate_seed(case))
    least, most = ((16, 64), (16, 600), (100, 300), (256, 256))[case % 4]
    count = (1, 3, 40, 120)[case // 2]
    sizes = [tuple(rng.integers(least, most + 1, 2).tolist()) for _ in range(count)]
    images = [levels_of(*size) for size in sizes]
    plan = plan_pages(images, 2048, 64)
    assert plan is not None
    covered = np.zeros((plan.layers, plan.size[1], plan.size[0]), np.uint8)
    for levels, rectangles, turned in zip(images, plan.levels, plan.transposed, strict=True):
        assert [(r.height, r.width) if turned else (r.width, r.height) for r in rectangles] == levels
        for r in rectangles:
            rows = slice(r.y - GUTTER, r.y + r.height + GUTTER)
            part = covered[r.layer, rows, r.x - GUTTER : r.x + r.width + GUTTER]
            assert part.shape == (r.height + 2 * GUTTER, r.width + 2 * GUTTER)
            part += 1
    assert covered.max() == 1
    assert covered.size < 2 * sum(width * height for levels in images for width, height in levels)


def test_images_beyond_all_pages_have_no_plan() -> None:
    assert plan_pages([[(63, 1)]], 64, 1) is None
    assert plan_pages([[(62, 1)]], 64, 1) is not None
    assert plan_pages([[(62, 62)]] * 3, 64, 2) is None
    assert plan_pages([[(62, 62)]] * 2, 64, 2) is not None


@pytest.mark.parametrize(
    ("textures", "part"),
    [
        ([], "no images"),
        ([Format.RGBA8, Format.R8], "D2 of R8"),
        ([Format.R8UI], "R8UI"),
    ],
)
def test_images_that_share_no_table_are_refused(textures: list[Format], part: str) -> None:
    images = [sl.HostTexture(np.zeros((2, 2, form.components), form.dtype), form) for form in textures]
    with pytest.raises(ValidationError, match=part):
        sl.HostTextureTable(images)
    sl.HostTextureTable([sl.HostTexture(np.zeros((2, 2, 4), np.uint8), Format.RGBA8)])
