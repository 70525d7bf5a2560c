"""Wide lines and wireframe on cl, beyond what the conformance kit asks of all backends.

The facing of stencil tests, cuts by the near plane, samples, and the memory for records.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import rhi
from rhi import (
    BlendFunction,
    Comparison,
    CullMode,
    Device,
    Format,
    LineWidth,
    PolygonMode,
    Primitive,
    StencilTest,
)
from rhi.backends.cl.raster import launcher
from rhi.conformance.compare import assert_same
from rhi.conformance.shaders import Colored
from rhi.conformance.shapes import corners, window_to_clip
from rhi.conformance.single_draws import draw_once

SIZE = (96, 80)  # four tiles
TRIANGLE = [(3.3125, 4.4375), (5.6875, 70.1875), (87.5625, 18.3125)]


def count_overdraw(
    device: Device,
    rows: NDArray[Any],
    *states: Any,
    primitive: Primitive = Primitive.TRIANGLES,
    samples: int = 1,
) -> NDArray[Any]:
    """Return the number of draws of each texel, (height, width)."""
    states = (BlendFunction.ADDITIVE, *states)
    return draw_once(device, SIZE, Format.RGBA32F, rows, *states, primitive=primitive, samples=samples)[
        ..., 3
    ]


def many_triangles(count: int) -> NDArray[Any]:
    rng = np.random.default_rng(7)
    positions = rng.uniform(-4, 90, (count, 1, 2)) + rng.uniform(-6, 6, (count, 3, 2))
    return corners(window_to_clip(np.round(positions * 16).reshape(-1, 2) / 16, SIZE))


@pytest.mark.parametrize("slice_groups", [1, 2, 3, 7])
def test_edges_in_several_slices_draw_the_same_image_as_in_a_single_slice(
    device: Device, monkeypatch: pytest.MonkeyPatch, slice_groups: int
) -> None:
    """Each slice has room for the edges of all its triangles."""
    rows = many_triangles(500)
    whole = count_overdraw(device, rows, CullMode.NONE, PolygonMode.LINE)
    monkeypatch.setattr(launcher, "_SLICE_GROUPS", slice_groups)
    assert whole.max() > 3
    assert_same(count_overdraw(device, rows, CullMode.NONE, PolygonMode.LINE), whole)


def test_edges_are_the_lines_between_the_corners(device: Device) -> None:
    rows = many_triangles(300)
    ends = rows.reshape(-1, 3)[:, [0, 1, 1, 2, 2, 0]].reshape(-1)
    for width in (1, 2, 5):
        lines = count_overdraw(device, ends, LineWidth(width), primitive=Primitive.LINES)
        assert_same(count_overdraw(device, rows, CullMode.NONE, PolygonMode.LINE, LineWidth(width)), lines)


def test_modes_alternate_within_a_pass(device: Device) -> None:
    rows = many_triangles(40)
    filled, wired = (count_overdraw(device, rows, CullMode.NONE, mode) for mode in PolygonMode)
    with device.texture(SIZE, Format.RGBA32F) as image, device.mesh(rows) as mesh:
        with (
            device.render_pass(image, clear=(0, 0, 0, 0)),
            device.states(CullMode.NONE, BlendFunction.ADDITIVE),
        ):
            for mode in [
                PolygonMode.FILL,
                PolygonMode.LINE,
                PolygonMode.LINE,
                PolygonMode.FILL,
                PolygonMode.LINE,
            ]:
                with device.states(mode):
                    device.draw(device.program(Colored), mesh)
        assert_same(image.read()[..., 3], 2 * filled + 3 * wired)


@pytest.mark.parametrize("order", [1, -1], ids=["front", "back"])
def test_edges_have_the_stencil_test_of_their_face(device: Device, order: int) -> None:
    rows = corners(window_to_clip(TRIANGLE[::order], SIZE))
    with (
        device.texture(SIZE, Format.RGBA8) as image,
        device.texture(SIZE, Format.D24S8) as depth,
        device.mesh(rows) as mesh,
    ):
        for front, back in ((Comparison.ALWAYS, Comparison.NEVER), (Comparison.NEVER, Comparison.ALWAYS)):
            with (
                device.render_pass(image, depth, clear=(0, 0, 0, 0), clear_depth=0.0, clear_stencil=0),
                device.states(StencilTest.ON, rhi.StencilFront(front), rhi.StencilBack(back)),
                device.states(CullMode.NONE, PolygonMode.LINE),
            ):
                device.draw(device.program(Colored), mesh)
            assert image.read().any() == ((front if order > 0 else back) is Comparison.ALWAYS)


@pytest.mark.parametrize("cull", list(CullMode), ids=lambda cull: cull.name)
def test_a_triangle_with_a_corner_behind_the_eye_has_the_facing_of_its_visible_part(
    device: Device, cull: CullMode
) -> None:
    """Its edges are cut one by one; no line is drawn along the cut."""
    positions = np.array([(-0.5, -0.5, 0.5, 1), (0.5, -0.5, 0.5, 1), (0.25, -2.0, -1.5, -1)])
    filled = count_overdraw(device, corners(positions), cull)
    wired = count_overdraw(device, corners(positions), cull, PolygonMode.LINE)
    lines = count_overdraw(device, corners(positions[[0, 1, 1, 2, 2, 0]]), primitive=Primitive.LINES)
    assert lines.any()
    assert_same(wired, lines if filled.any() else 0)


def test_a_wide_line_of_several_samples_has_upright_ends(device: Device) -> None:
    rows = corners(window_to_clip([(10.0, 20.0), (60.0, 45.0)], SIZE))
    image = count_overdraw(device, rows, LineWidth(6), primitive=Primitive.LINES, samples=4)
    assert_same(image[:, :10], 0)
    assert_same(image[:, 60:], 0)
    assert_same(image[:, 10:60].sum(axis=0), 6)


@pytest.mark.parametrize("width", [1, 256])
def test_a_line_through_everything_is_whole(device: Device, width: int) -> None:
    """It is cut by the guard band only, 16,380 texels away."""
    rows = corners(np.array([(-1e4, -1e4, 0.5, 1), (1e4, 1e4, 0.5, 1)]))
    image = count_overdraw(device, rows, LineWidth(width), primitive=Primitive.LINES)
    y, x = np.mgrid[0 : SIZE[1], 0 : SIZE[0]] + 0.5
    away = np.abs((SIZE[1] - y) - x * SIZE[1] / SIZE[0])
    assert image[away < width / 2 - 0.1].all()
    assert not image[away > width / 2 + 0.1].any()
