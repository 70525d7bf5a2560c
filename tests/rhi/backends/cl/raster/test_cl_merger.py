"""The output merger in isolation: rounding of every number, keys of states, and that special kernels do the
same.

What states do to an image, the kit and `test_programs_against_float64` show.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from merger_kit import Planes, describe, run, state_values
from numpy.typing import NDArray

from rhi.backends.cl.raster.merger import MergerKey, TestOrder, make_key
from rhi.conformance import reference
from rhi.conformance.formats import random_texels
from rhi.contract.formats import COLOR_FORMATS, DEPTH_FORMATS, ChannelKind, Format
from rhi.contract.states import (
    AlphaReference,
    AlphaTest,
    AlphaToCoverage,
    BlendColor,
    BlendFactor,
    BlendFunction,
    ColorWrite,
    Comparison,
    DepthFunction,
    DepthTest,
    DepthWrite,
    State,
    StencilFront,
    StencilReference,
    StencilTest,
)
from rhi.contract.texels import encode, pack, unpack

SIZE = (8, 12)  # height, width
STENCILS = np.array([0, 1, 2, 77, 100, 128, 254, 255], np.uint8)
FLOATS = [f for f in COLOR_FORMATS if not f.is_integer]
name = lambda f: f.name  # noqa: E731


def texels(format: Format, samples: int = 1, seed: int = 0) -> NDArray[Any]:
    """Random contents of a target."""
    rng = np.random.default_rng(seed)
    shape = (samples, *SIZE, format.components)
    if format.is_packed:
        return random_texels(format, samples, *SIZE, seed=seed)
    if format.kind is ChannelKind.FLOAT:
        return rng.normal(0, 2, shape).astype(format.dtype)
    limits = np.iinfo(format.dtype)  # type: ignore[type-var]
    low = -limits.max if format.kind is ChannelKind.SNORM else limits.min
    return rng.integers(low, limits.max, shape, endpoint=True).astype(format.dtype)


def fragments(formats: list[Format], samples: int = 1, seed: int = 1) -> NDArray[np.uint32]:
    """Random outputs, some of them out of range, as words."""
    rng = np.random.default_rng(seed)
    words = np.empty((samples, *SIZE, 4 * len(formats)), np.uint32)
    for i, format in enumerate(formats):
        part = words[..., 4 * i : 4 * i + 4]
        if format.kind is ChannelKind.UINT:
            part[...] = rng.integers(0, 1 << 32, part.shape) >> rng.integers(0, 32, part.shape)
        elif format.kind is ChannelKind.INT:
            part[...] = rng.integers(-(1 << 31), 1 << 31, part.shape).astype(np.int32).view(np.uint32)
        else:
            part[...] = rng.uniform(-0.3, 1.3, part.shape).astype(np.float32).view(np.uint32)
    return words


def coverage(samples: int = 1, seed: int = 2) -> NDArray[np.bool_]:
    return np.random.default_rng(seed).random((samples, *SIZE)) < 0.7


def depths(format: Format | None, samples: int = 1, seed: int = 3) -> NDArray[np.float32]:
    """Return few distinct depths, so that equal ones meet."""
    values = np.random.default_rng(seed).integers(0, 5, (samples, *SIZE)) / 4 * 0.7 + 0.1
    return values.astype(np.float32) if format is None else encode(format, values).astype(np.float32)


# -- formats -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("format", COLOR_FORMATS, ids=name)
def test_merged_colors_are_stored_as_texels_stores_them(format: Format) -> None:
    """All bits agree, except for sRGB, a polynomial: a value within 1/1000 of a tie may round either way."""
    image, words, covered = texels(format), fragments([format]), coverage()
    got = run([format], None, [], Planes([image]), words, depths(None), covered)
    kinds = {ChannelKind.UINT: np.uint32, ChannelKind.INT: np.int32}
    color = words.view(kinds.get(format.kind, np.float32)).astype(np.float64)
    if format.kind is ChannelKind.SRGB:
        exact = np.where(covered[..., None], reference.encode(format, color), image)
        assert np.abs(got.colors[0] - exact).max() <= 0.501
    else:
        stored = pack(format, unpack(format, encode(format, color[..., : format.channels])))
        np.testing.assert_array_equal(got.colors[0], np.where(covered[..., None], stored, image))


SPECIAL = [
    0.0, -0.0, 1.0, -1.0, 0.5, np.nan, np.inf, -np.inf, 1e-8, 5.9e-8, 2.98e-8, 2.9802322e-8, 2.9802326e-8, 6.1e-5,
    6.103515625e-05, 6.0975e-5, 65504.0, 65519.996, 65520.0, 65536.0, 1e30, -65504.0, -65520.0, -3e-8, 1e-40, 3.4e38,
    1.00048828125, 1.00048840046, 1.0014648, 2049.0, 2051.0, 0.33333334, 1e-5,
]  # fmt: skip


@pytest.mark.parametrize("format", FLOATS, ids=name)
def test_special_numbers_are_stored_as_texels_stores_them(format: Format) -> None:
    values = np.resize(np.array(SPECIAL, np.float32), (1, *SIZE, 4))
    everywhere = np.ones((1, *SIZE), bool)
    got = run([format], None, [], Planes([texels(format)]), values.view(np.uint32), depths(None), everywhere)
    stored = encode(format, values[..., : format.channels].astype(np.float64))
    if format is Format.R11G11B10F:  # NaN has no sign and no fixed bits
        np.testing.assert_array_equal(unpack(format, got.colors[0]), unpack(format, stored))
    else:
        np.testing.assert_array_equal(got.colors[0], stored)


def test_every_half_float_is_read_and_stored_as_numpy_does() -> None:
    """Blending x + 0 reads and stores each of the 65,536 bit patterns."""
    halves = np.arange(1 << 16, dtype=np.uint16).view(np.float16)
    image = halves.reshape(1, 256, 64, 4)
    words = np.zeros((1, 256, 64, 4), np.uint32)
    states = [BlendFunction(BlendFactor.ONE, BlendFactor.ONE)]
    everywhere = np.ones((1, 256, 64), bool)
    got = run(
        [Format.RGBA16F], None, states, Planes([image]), words, np.zeros((1, 256, 64), "f4"), everywhere
    )
    np.testing.assert_array_equal(got.colors[0], image)


@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1))
def test_any_float_becomes_the_half_that_numpy_makes(seed: int) -> None:
    words = np.random.default_rng(seed).integers(0, 1 << 32, (1, 64, 64, 4), dtype=np.uint32)
    words[..., 2:] = words[..., 2:] & 0x8FFFFFFF | 0x30000000  # near the range of halves
    with np.errstate(over="ignore", invalid="ignore"):
        halves = words.view(np.float32).astype(np.float16)
    got = run(
        [Format.RGBA16F],
        None,
        [],
        Planes([np.zeros_like(halves)]),
        words,
        np.zeros((1, 64, 64), "f4"),
        np.ones((1, 64, 64), bool),
    )
    np.testing.assert_array_equal(got.colors[0], halves)


def test_every_srgb_number_survives_blending() -> None:
    image = np.resize(np.arange(256, dtype=np.uint8), (1, 16, 64, 4))
    states = [BlendFunction(BlendFactor.ONE, BlendFactor.ONE)]
    got = run(
        [Format.RGBA8_SRGB],
        None,
        states,
        Planes([image]),
        np.zeros((1, 16, 64, 4), "u4"),
        np.zeros((1, 16, 64), "f4"),
        np.ones((1, 16, 64), bool),
    )
    np.testing.assert_array_equal(got.colors[0], image)


def test_srgb_rounds_within_a_thousandth_of_a_step() -> None:
    linear = np.linspace(0, 1, 1 << 16, dtype=np.float32).reshape(1, 256, 64, 4)
    got = run(
        [Format.RGBA8_SRGB],
        None,
        [],
        Planes([np.zeros((1, 256, 64, 4), "u1")]),
        linear.view(np.uint32),
        np.zeros((1, 256, 64), "f4"),
        np.ones((1, 256, 64), bool),
    )
    wide = linear.astype(np.float64)
    curve = np.where(
        wide <= 0.0031308, wide * 12.92, 1.055 * np.maximum(wide, 0.0031308) ** (1 / 2.4) - 0.055
    )
    assert np.abs(got.colors[0] - 255 * curve)[..., :3].max() <= 0.501


# -- depth ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("format", DEPTH_FORMATS, ids=name)
def test_depth_is_rounded_as_texels_rounds_it(format: Format) -> None:
    rng = np.random.default_rng(0)
    z = rng.uniform(-0.1, 1.1, (1, 256, 256)).astype(np.float32)
    z[0, :128] = 2.0 ** rng.uniform(-30, 0, (128, 256))
    z[0, 0, :8] = 0.0, 1.0, 0.5, np.nan, np.float32(0.5) - np.float32(2.0**-25), 1 - 2.0**-24, 2.0**-24, 0.75
    everywhere = np.ones(z.shape, bool)
    planes = Planes([], np.full(z.shape, 0.5, np.float32), np.zeros(z.shape, np.uint8))
    got = run([], format, [DepthFunction.ALWAYS], planes, np.zeros((*z.shape, 4), "u4"), z, everywhere)
    np.testing.assert_array_equal(got.depth, encode(format, z.astype(np.float64)))


# -- keys ----------------------------------------------------------------------------------------------------


def key_of(
    *states: State,
    formats: tuple[Format, ...] = (Format.RGBA8,),
    depth: Format | None = Format.D24S8,
    samples: int = 1,
    **program: Any,
) -> MergerKey:
    return make_key(describe(formats, **program), state_values(*states), formats, depth, samples)


@pytest.mark.parametrize(
    "states",
    [
        [BlendFunction.ALPHA, BlendColor(1, 2, 3, 4)],
        [BlendFunction.ADDITIVE],
        [BlendFunction.ALPHA, ColorWrite(alpha=False)],
        [BlendFunction.ALPHA, StencilReference(3), StencilFront(Comparison.LESS)],
        [BlendFunction.ALPHA, AlphaReference(0.3)],
    ],
)
def test_numbers_and_factors_share_a_key(states: list[State]) -> None:
    assert key_of(*states) == key_of(BlendFunction.ALPHA)


def test_states_of_targets_that_are_not_written_are_not_part_of_a_key() -> None:
    bare = key_of(ColorWrite.OFF, BlendFunction.ALPHA)
    assert not bare.colors
    assert bare == key_of(ColorWrite.OFF) == key_of(formats=())
    assert not bare.shades
    assert key_of(ColorWrite(False, False, False, True), formats=(Format.RG8,)).colors == ()
    assert key_of(DepthTest.OFF, DepthWrite.OFF) == key_of(depth=None)
    assert key_of(DepthFunction.LESS, depth=None) == key_of(depth=None)
    assert key_of(StencilTest.ON, depth=Format.D32F) == key_of(depth=Format.D32F)
    assert key_of(AlphaToCoverage.ON) == key_of()


@pytest.mark.parametrize(
    ("program", "states", "order", "shades"),
    [
        ({}, [], TestOrder.EARLY, True),
        ({}, [ColorWrite.OFF], TestOrder.EARLY, False),
        ({"discards": True}, [], TestOrder.SPLIT, True),
        ({"discards": True}, [ColorWrite.OFF], TestOrder.SPLIT, True),
        ({"discards": True}, [StencilTest.ON], TestOrder.LATE, True),
        ({"discards": True, "early_depth": True}, [], TestOrder.EARLY, True),
        ({"writes_depth": True}, [ColorWrite.OFF], TestOrder.LATE, True),
        ({"writes_depth": True, "early_depth": True}, [ColorWrite.OFF], TestOrder.EARLY, False),
        ({"writes_memory": True}, [ColorWrite.OFF], TestOrder.LATE, True),
        ({"writes_memory": True, "early_depth": True}, [], TestOrder.EARLY, True),
        ({}, [AlphaTest.ON], TestOrder.SPLIT, True),
    ],
)
def test_the_order_of_tests_follows_the_program(
    program: dict[str, bool], states: list[State], order: TestOrder, shades: bool
) -> None:
    key = key_of(*states, **program)
    assert (key.order, key.shades) == (order, shades)


@pytest.mark.parametrize("samples", [1, 4, 8])
@pytest.mark.parametrize(
    "formats", [[Format.RGBA8_SRGB, Format.R32F], [Format.RGBA16F], [Format.R8_SNORM]], ids=str
)
def test_a_kernel_for_one_combination_merges_the_same_bits(formats: list[Format], samples: int) -> None:
    states: list[State] = [
        BlendFunction.ALPHA,
        DepthTest.ON,
        DepthFunction.LESS,
        DepthWrite.ON,
        StencilTest.ON,
        ColorWrite(alpha=False),
    ]
    planes = Planes(
        [texels(f, samples, seed) for seed, f in enumerate(formats)],
        depths(Format.D24S8, samples),
        np.random.default_rng(4).choice(STENCILS, (samples, *SIZE)),
    )
    inputs = fragments(formats, samples), depths(None, samples, 5), coverage(samples)
    general, special = (
        run(formats, Format.D24S8, states, planes, *inputs, special=special) for special in (False, True)
    )
    for plane, special_plane in zip(general.colors, special.colors, strict=True):
        np.testing.assert_array_equal(plane.view(np.uint8), special_plane.view(np.uint8))
    np.testing.assert_array_equal(general.depth, special.depth)
    np.testing.assert_array_equal(general.stencil, special.stencil)
    assert not np.array_equal(general.colors[0], planes.colors[0])
