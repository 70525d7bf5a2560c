"""Tests of the kit's references, which devices are compared with."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rhi import BlendColor, BlendFunction, Comparison, Format, StencilOperation
from rhi.conformance import reference
from rhi.conformance.compare import assert_mask, assert_near, assert_same

POINT = st.tuples(st.integers(-64, 320), st.integers(-64, 320))


@given(a=POINT, b=POINT, c=POINT, d=POINT)
def test_two_triangles_that_share_an_edge_cover_no_texel_twice(
    a: tuple, b: tuple, c: tuple, d: tuple
) -> None:
    def side(p: tuple) -> int:
        return int(np.sign((b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0])))

    if side(c) * side(d) < 0:
        assert not (reference.rasterise([a, b, c], 16, 16) & reference.rasterise([a, b, d], 16, 16)).any()


def test_a_square_of_two_triangles_covers_its_texels() -> None:
    a, b, c, d = (np.array(p) * reference.SUBTEXELS for p in ((2, 3), (7, 3), (7, 9), (2, 9)))
    mask = np.zeros((16, 16), bool)
    mask[3:9, 2:7] = True
    assert np.array_equal(
        reference.rasterise([a, b, c], 16, 16) | reference.rasterise([a, c, d], 16, 16), mask
    )


@given(a=POINT, b=POINT, c=POINT)
def test_winding_does_not_change_the_coverage_of_a_triangle(a: tuple, b: tuple, c: tuple) -> None:
    assert np.array_equal(reference.rasterise([a, b, c], 16, 16), reference.rasterise([c, b, a], 16, 16))


@given(a=POINT, b=POINT, c=POINT)
def test_the_exact_coverage_lies_between_certain_and_possible(a: tuple, b: tuple, c: tuple) -> None:
    exact = reference.rasterise([a, b, c], 16, 16)
    certain, possible = reference.rasterise_within([a, b, c], 16, 16, 0.125)
    assert not (certain & ~exact).any()
    assert not (exact & ~possible).any()


def test_top_and_left_edges_own_their_centers() -> None:
    half = reference.SUBTEXELS // 2
    square = [(half, half), (half + 2 * reference.SUBTEXELS, half), (half, half + 2 * reference.SUBTEXELS)]
    assert reference.rasterise(square, 4, 4)[0, :3].tolist() == [True, True, False]
    assert reference.rasterise(square, 4, 4)[:3, 0].tolist() == [True, True, False]
    above = [
        (half, half),
        (half + 2 * reference.SUBTEXELS, half + 2 * reference.SUBTEXELS),
        (half, half + 2 * reference.SUBTEXELS),
    ]
    assert reference.rasterise(above, 4, 4)[:3, 0].tolist() == [False, True, False]  # a bottom edge owns none


@pytest.mark.parametrize(("margin", "sure"), [(0.6, True), (0.8, False)])
def test_a_margin_is_measured_across_an_edge(margin: float, sure: bool) -> None:
    """The texel beside the diagonal has its center 0.71 texels from it."""
    certain, possible = reference.rasterise_within(
        np.array([(0, 0), (8, 8), (0, 8)]) * reference.SUBTEXELS, 8, 8, margin
    )
    assert (certain[4, 3], possible[4, 3]) == (sure, True)
    assert (certain[3, 4], possible[3, 4]) == (False, not sure)


@given(st.floats(0, 1))
def test_srgb_goes_there_and_back(value: float) -> None:
    assert abs(float(reference.srgb_to_linear(reference.linear_to_srgb(value))) - value) < 1e-6


def test_the_srgb_curve_passes_through_published_points() -> None:
    assert_near(
        reference.linear_to_srgb([0, 0.0031308, 0.5, 1]),
        [0, 0.04045, 0.735357, 1],
        1e-5,
        "published to 5 digits",
    )


def test_the_reference_s_alpha_blending_equals_a_result_computed_by_hand() -> None:
    over = reference.blend(BlendFunction.ALPHA, (1, 0, 0, 0.25), (0, 1, 0, 1), (0, 0, 0, 0))
    assert_near(over, (0.25, 0.75, 0, 1.0), 1e-12, "float64")
    assert BlendColor().alpha == 0


def test_stencil_keeps_the_bits_outside_its_mask() -> None:
    assert reference.stencil(StencilOperation.INVERT, 0b1010, 0, 0b0011) == 0b1001
    assert reference.stencil(StencilOperation.DECREMENT, 0, 9) == 0
    assert reference.stencil(StencilOperation.DECREMENT_WRAP, 0, 9) == 255


def test_comparisons_take_the_new_value_first() -> None:
    assert reference.compare(Comparison.LESS, [1, 2, 3], 2).tolist() == [True, False, False]


def test_encoding_clamps_and_decoding_fills_in() -> None:
    assert_same(reference.encode(Format.RG8, (-1.0, 2.0, 0.5, 0.5)), (0, 255))
    assert_same(reference.decode(Format.R8, [[255]]), [(1, 0, 0, 1)])
    assert_same(reference.decode(Format.RGBA8_SNORM, [[-128, -127, 0, 127]]), [(-1, -1, 0, 1)])


def test_half_of_the_light_is_188_in_srgb() -> None:
    board = np.zeros((2, 2, 4), np.uint8)
    board[0] = 255
    assert_near(reference.halve(Format.RGBA8_SRGB, board), (187.5, 187.5, 187.5, 127.5), 0.1, "187.516")


def test_a_difference_is_reported_with_its_index_and_values() -> None:
    with pytest.raises(
        AssertionError,
        match=r"1 of 4 values differ .* worst 3\n.*at \(1, 0\): got np.int64\(5\), expected np.float64\(2.0\)",
    ):
        assert_same(np.array([[1, 2], [5, 2]]), np.array([[1, 2], [2, 2]]))


def test_nan_differs_from_all_numbers() -> None:
    with pytest.raises(AssertionError, match="1 of 2"):
        assert_near([np.nan, 1.0], 1.0, 10.0, "never enough")


def test_a_wrong_mask_is_drawn() -> None:
    with pytest.raises(AssertionError, match=r"\+#\n-\."):
        assert_mask(np.array([[1, 1], [0, 0]]), np.array([[False, True], [True, False]]))
