"""Blending: every factor, operation, target and constant against NumPy."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from rhi import BlendColor, BlendFactor, BlendFunction, BlendOperation, ColorWrite, Device, Format, Primitive
from rhi.conformance.compare import assert_near, assert_same
from rhi.conformance.formats import require_blendable, require_renderable
from rhi.conformance.reference import blend, channels_of, decode, encode, rounding
from rhi.conformance.shaders import Colored, UintColored
from rhi.conformance.shapes import centers, corners, rectangle
from rhi.conformance.single_draws import draw_once

pytestmark = pytest.mark.requires("draws", "shading")

CONSTANT = (0.2, 0.4, 0.6, 0.8)
LEVELS = np.array([0.0, 0.25, 0.5, 1.0])
# 16 source colors are blended with 16 destination colors in one 16×16 image.
_GRID = np.stack(np.meshgrid(LEVELS, LEVELS, indexing="ij"), axis=-1).reshape(16, 2)
COLORS = np.stack([_GRID[:, 0], 1 - _GRID[:, 0], _GRID[:, 1] * 0.7 + 0.1, _GRID[:, 1]], axis=-1).astype("f4")


def blended(device: Device, function: BlendFunction, bits: int = 32) -> tuple[Any, Any, float, str]:
    """Return result, expected, tolerance and its reason, with source color x in column x and destination
    color y in row y of a target of 8 bits, or of 32 where floats of so many blend, and 16 where not."""
    if Format.RGBA32F in device.capabilities.unblendable_formats:
        bits = min(bits, 16)
    format, tolerance = {
        8: (Format.RGBA8, 1.01 / 255),
        16: (Format.RGBA16F, 2e-3),
        32: (Format.RGBA32F, 1e-6),
    }[bits]
    reason = f"blending in {bits} bits, before and after"
    destination = np.broadcast_to(COLORS[:, None], (16, 16, 4))
    source = np.broadcast_to(COLORS[None, :], (16, 16, 4))
    columns = [rectangle(-1 + x / 8, -1, -1 + (x + 1) / 8, 1, color=COLORS[x]) for x in range(16)]
    stored = np.rint(destination * 255).astype("u1") if bits == 8 else destination.astype(format.dtype)
    result = draw_once(device, stored, format, np.concatenate(columns), function, BlendColor(*CONSTANT))
    if bits == 8:
        return result / 255, np.clip(blend(function, source, stored / 255, CONSTANT), 0, 1), tolerance, reason
    return result, blend(function, source, destination, CONSTANT), tolerance, reason


@pytest.mark.parametrize("format", [Format.RGB10A2, Format.R11G11B10F], ids=lambda f: f.name)
def test_packed_formats_blend_by_channel(device: Device, format: Format) -> None:
    require_renderable(device, format)
    function = BlendFunction(BlendFactor.SOURCE_ALPHA, BlendFactor.ONE_MINUS_SOURCE_ALPHA)
    old, new = (0.25, 0.5, 0.75, 1.0), (0.9, 0.1, 0.3, 2 / 3)
    with device.texture((2, 2), format) as image, device.mesh(rectangle(color=new)) as mesh:
        with device.render_pass(image, clear=old):
            pass
        stored = decode(format, channels_of(format, image.read()))
        with device.render_pass(image), device.states(function):
            device.draw(device.program(Colored), mesh)
        back = channels_of(format, image.read())
    expected = encode(format, blend(function, new, stored, (0, 0, 0, 0)))
    assert_near(back, expected, *rounding(format, expected))


@pytest.mark.parametrize("factor", list(BlendFactor), ids=lambda f: f.name)
def test_a_source_factor_scales_the_source(device: Device, factor: BlendFactor) -> None:
    assert_near(*blended(device, BlendFunction(factor, BlendFactor.ZERO)))


@pytest.mark.parametrize("factor", list(BlendFactor), ids=lambda f: f.name)
def test_a_destination_factor_scales_the_destination(device: Device, factor: BlendFactor) -> None:
    assert_near(*blended(device, BlendFunction(BlendFactor.ZERO, factor)))


@pytest.mark.parametrize("operation", list(BlendOperation), ids=lambda f: f.name)
def test_an_operation_combines_source_and_destination(device: Device, operation: BlendOperation) -> None:
    function = BlendFunction(BlendFactor.SOURCE_ALPHA, BlendFactor.CONSTANT, operation)
    assert_near(*blended(device, function))


@pytest.mark.parametrize("name", ["OFF", "ALPHA", "ADDITIVE", "PREMULTIPLIED", "MULTIPLY"])
def test_each_named_blend_function_blends_as_its_name_says(device: Device, name: str) -> None:
    assert_near(*blended(device, getattr(BlendFunction, name)))


def test_alpha_can_be_blended_differently_from_color(device: Device) -> None:
    function = BlendFunction(
        BlendFactor.ONE,
        BlendFactor.ONE,
        BlendOperation.ADD,
        BlendFactor.ZERO,
        BlendFactor.CONSTANT,
        BlendOperation.REVERSE_SUBTRACT,
    )
    assert_near(*blended(device, function))


@pytest.mark.parametrize("operation", list(BlendOperation), ids=lambda f: f.name)
def test_blending_of_normalised_targets_is_clamped(device: Device, operation: BlendOperation) -> None:
    function = BlendFunction(BlendFactor.ONE, BlendFactor.ONE, operation)
    assert_near(*blended(device, function, 8))


@pytest.mark.parametrize("format", [Format.RGBA8, Format.RGBA32F], ids=lambda f: f.name)
@pytest.mark.parametrize(
    ("source", "destination"),
    [
        (BlendFactor.DESTINATION_COLOR, BlendFactor.ONE),
        (BlendFactor.ZERO, BlendFactor.CONSTANT),
        (BlendFactor.ZERO, BlendFactor.ONE_MINUS_CONSTANT),
    ],
)
def test_colors_and_constants_are_clamped_before_they_are_blended_but_not_for_floats(
    device: Device, source: BlendFactor, destination: BlendFactor, format: Format
) -> None:
    """OpenGL 4.5, 17.3.6.1: clamping the result alone would give others."""
    require_blendable(device, format)
    new, constant = np.array([1.5, -0.5, 1.25, -0.25]), np.array([-0.5, 1.25, -0.25, 1.5])
    function = BlendFunction(source, destination)
    with device.texture((2, 2), format) as image, device.mesh(rectangle(color=new)) as mesh:
        with device.render_pass(image, clear=(0.2, 0.2, 0.2, 0.2)):
            pass
        with device.render_pass(image), device.states(function, BlendColor(*constant)):
            device.draw(device.program(Colored), mesh)
        back = decode(format, image.read())
    if format is Format.RGBA8:
        new, constant = np.clip(new, 0, 1), np.clip(constant, 0, 1)
    assert_near(back, blend(function, new, np.full(4, 0.2), constant), 1.01 / 255, "8 bits, before and after")


FUNCTIONS = st.builds(
    BlendFunction,
    st.sampled_from(BlendFactor),
    st.sampled_from(BlendFactor),
    st.sampled_from(BlendOperation),
    st.none() | st.sampled_from(BlendFactor),
    st.none() | st.sampled_from(BlendFactor),
    st.none() | st.sampled_from(BlendOperation),
)


@settings(max_examples=40, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(function=FUNCTIONS)
def test_any_function_blends_as_numpy_does(device: Device, function: BlendFunction) -> None:
    result, expected, tolerance, reason = blended(device, function)
    assert_near(result, expected, 2 * tolerance, reason)


def test_without_a_scope_nothing_blends(device: Device) -> None:
    assert_same(
        draw_once(device, (2, 2), Format.RGBA8, rectangle(color=(0.2, 0.2, 0.2, 0.2)), clear=(1, 1, 1, 1)), 51
    )


def test_draws_blend_in_order(device: Device) -> None:
    """The order of two blended draws matters: white over black at half opacity isn't black over white."""
    rows = np.concatenate([rectangle(color=(1, 1, 1, 0.5)), rectangle(color=(0, 0, 0, 0.5))])
    with device.texture((2, 2), Format.RGBA16F) as image, device.mesh(rows) as mesh:
        for order, expected in (((0, 6), 0.25), ((6, 0), 0.5)):
            with device.render_pass(image, clear=(0, 0, 0, 0)), device.states(BlendFunction.ALPHA):
                for first in order:
                    device.draw(device.program(Colored), mesh.view(first, 6))
            assert_same(image.read()[..., 0], expected)


def test_many_primitives_of_one_draw_blend_in_order(device: Device) -> None:
    """Each of 40 rectangles on one texel maps x to x/2 + i mod 2, so the last ones weigh most."""
    require_blendable(device, Format.R32F)
    count = 40
    rows = np.concatenate([rectangle(color=(i % 2, 0, 0, 0.5)) for i in range(count)])
    value = 0.0
    for i in range(count):
        value = 0.5 * value + 0.5 * (i % 2)
    drawn = draw_once(device, (1, 1), Format.R32F, rows, BlendFunction.ALPHA)
    assert_near(drawn, value, 1e-5, "40 roundings in float32")


def test_overlapping_points_all_add_up(device: Device) -> None:
    count = 100
    rows = corners(np.repeat(centers([(1, 1)], (3, 3)), count, axis=0), (1, 0, 0, 1))
    drawn = draw_once(device, (3, 3), Format.R16F, rows, BlendFunction.ADDITIVE, primitive=Primitive.POINTS)
    assert_same(drawn, [[0, 0, 0], [0, count, 0], [0, 0, 0]])


def test_integer_targets_do_not_blend(device: Device) -> None:
    rows, clear = rectangle(color=(3, 4, 5, 6)), (100, 100, 100, 100)
    drawn = draw_once(
        device, (2, 2), Format.RGBA8UI, rows, BlendFunction.ADDITIVE, shader=UintColored, clear=clear
    )
    assert_same(drawn, (3, 4, 5, 6))


def test_half_float_targets_blend(device: Device) -> None:
    rows = rectangle(color=(3, -4, 0.5, 1))
    drawn = draw_once(device, (2, 2), Format.RGBA16F, rows, BlendFunction.ADDITIVE, clear=(1, 1, 1, 1))
    assert_same(drawn, (4, -3, 1.5, 2))


def test_srgb_targets_blend_in_linear_light(device: Device) -> None:
    drawn = draw_once(device, (2, 2), Format.RGBA8_SRGB, rectangle(color=(1, 1, 1, 0.5)), BlendFunction.ALPHA)
    assert_near(drawn, (187.5, 187.5, 187.5, 127.5), 1.0, "half of the light is 188 in sRGB")


# -- color write -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("format", "mask"),
    [
        *((Format.RGBA8, mask) for mask in range(16)),
        *(
            (f, mask)
            for f in (Format.RG16F, Format.RGB10A2, Format.RGBA16F, Format.RGBA32F)
            for mask in (5, 6, 9, 10)
        ),
    ],
)
def test_color_write_chooses_channels(device: Device, format: Format, mask: int) -> None:
    require_renderable(device, format)
    channels = [bool(mask >> i & 1) for i in range(4)]
    drawn = draw_once(device, (2, 2), format, rectangle(color=(1, 1, 1, 1)), ColorWrite(*channels))
    assert_same(channels_of(format, drawn), encode(format, np.array(channels)))
