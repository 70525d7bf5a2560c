"""Lines with a width, and triangles drawn as their edges: coverage, facing, varyings, depth and its
offset."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import rhi
from rhi import (
    Comparison,
    CullMode,
    DepthFunction,
    Device,
    Format,
    FrontFace,
    LineWidth,
    PolygonMode,
    Primitive,
)
from rhi.conformance.compare import assert_near, assert_same
from rhi.conformance.formats import require_format, require_line_width, require_samples
from rhi.conformance.reference import SUBTEXELS, rasterise, rasterise_line
from rhi.conformance.shaders import Colored, FlatColored
from rhi.conformance.shapes import corners, window_to_clip
from rhi.conformance.single_draws import draw_once

pytestmark = pytest.mark.requires("draws", "shading")

SIZE = (32, 24)
GENTLE = [(4.3125, 7.4375), (26.5625, 13.1875)]
STEEP = [(9.4375, 3.1875), (15.3125, 20.5625)]
TRIANGLE = [(3.3125, 4.4375), (5.6875, 20.1875), (27.5625, 8.3125)]  # counter-clockwise, seen with +Y up

REQUIRES_PRECISION = pytest.mark.requires("precise_lines")

AREAS = [Primitive.TRIANGLES, Primitive.TRIANGLE_STRIP, Primitive.TRIANGLE_FAN, Primitive.QUADS]

Mask = NDArray[np.bool_]


def draw_image(
    device: Device,
    points: Any,
    *states: Any,
    primitive: Primitive = Primitive.LINES,
    color: Any = (1, 1, 1, 1),
    shader: Any = Colored,
    depth: Any = 0.5,
) -> NDArray[Any]:
    """Return the image of one draw of window positions."""
    rows = corners(window_to_clip(points, SIZE), color, depth)
    return draw_once(device, SIZE, Format.RGBA32F, rows, *states, shader=shader, primitive=primitive)


def draw_image_and_depth(
    device: Device,
    rows: NDArray[Any],
    *states: Any,
    primitive: Primitive = Primitive.TRIANGLES,
    clear: float = 0.0,
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the image and the depth of one draw."""
    with device.texture(SIZE, Format.RGBA32F) as image, device.texture(SIZE, Format.D32F) as depth:
        with device.mesh(rows, primitive=primitive) as mesh:
            with (
                device.render_pass(image, depth, clear=(0, 0, 0, 0), clear_depth=clear),
                device.states(*states),
            ):
                device.draw(device.program(Colored), mesh)
        return image.read(), depth.read()


def wired(device: Device, points: Any, *states: Any, **more: Any) -> NDArray[Any]:
    """Return the image of triangles drawn as lines."""
    return draw_image(device, points, PolygonMode.LINE, *states, primitive=Primitive.TRIANGLES, **more)


def line(points: Any, width: int = 1) -> tuple[Mask, Mask]:
    """Return the texels that a line covers for certain, and those that it may cover."""
    start, end = (np.round(np.multiply(point, SUBTEXELS)) for point in points)
    return rasterise_line(start, end, width, *SIZE)


def outline(points: Any, width: int = 1) -> tuple[Mask, Mask]:
    """Return the same for the three edges of each triangle."""
    certain, possible = np.zeros(SIZE[::-1], bool), np.zeros(SIZE[::-1], bool)
    for triangle in np.reshape(points, (-1, 3, 2)):
        for i in range(3):
            sure, maybe = line((triangle[i], triangle[(i + 1) % 3]), width)
            certain |= sure
            possible |= maybe
    return certain, possible


def assert_covers(image: NDArray[Any], expected: tuple[Mask, Mask]) -> None:
    """Assert that an image covers all certain texels and none but the possible ones."""
    __tracebackhide__ = True
    certain, possible = expected
    covered = image[..., 3] > 0
    assert certain.any()
    assert not (certain & ~covered).any(), f"not drawn (y, x): {np.argwhere(certain & ~covered)[:4].tolist()}"
    assert not (covered & ~possible).any(), (
        f"drawn beside (y, x): {np.argwhere(covered & ~possible)[:4].tolist()}"
    )


# -- width ---------------------------------------------------------------------------------------------------


@pytest.mark.recorded_too
@pytest.mark.parametrize("width", [1, 2, 3, 4, 7])
@pytest.mark.parametrize(
    "points", [GENTLE, GENTLE[::-1], STEEP, STEEP[::-1]], ids=["right", "left", "down", "up"]
)
@REQUIRES_PRECISION
def test_a_line_is_as_many_texels_wide_as_its_width(device: Device, points: Any, width: int) -> None:
    require_line_width(device, width)
    assert_covers(draw_image(device, points, LineWidth(width)), line(points, width))


@pytest.mark.parametrize(
    ("width", "texels"), [(1.0, 1), (1.375, 1), (1.625, 2), (2.375, 2), (2.625, 3), (3.0, 3)]
)
def test_a_width_is_rounded_to_whole_texels(device: Device, width: float, texels: int) -> None:
    require_line_width(device, width)
    image = draw_image(device, [(2.5, 10.25), (29.5, 10.25)], LineWidth(width))
    assert_same((image[:, 5:25, 3] > 0).sum(axis=0), texels)


def test_a_line_of_width_1_is_the_default(device: Device) -> None:
    assert_same(draw_image(device, GENTLE, LineWidth(1.0)), draw_image(device, GENTLE))


def test_a_line_may_be_as_wide_as_the_device_says(device: Device) -> None:
    most = device.capabilities.max_line_width
    height = int(most) + 9
    rows = corners([(-1, 1 / 64), (1, 1 / 64)])
    back = draw_once(device, (4, height), Format.R8, rows, LineWidth(most), primitive=Primitive.LINES)
    assert_same((back[:, 1:3] > 0).sum(axis=0), np.floor(most + 0.5))


def test_a_strip_of_wide_lines_is_a_line_for_each_segment(device: Device) -> None:
    require_line_width(device, 3)
    path = [GENTLE[0], STEEP[1], GENTLE[1]]
    parts = [line(path[i : i + 2], 3) for i in range(2)]
    image = draw_image(device, path, LineWidth(3), primitive=Primitive.LINE_STRIP)
    assert_covers(image, (parts[0][0] | parts[1][0], parts[0][1] | parts[1][1]))


def test_values_and_depth_run_along_a_wide_line(device: Device) -> None:
    """They are those of the middle: nothing changes across the line."""
    require_line_width(device, 5)
    points, width = [(4.0, 7.25), (28.0, 13.25)], 5
    rows = corners(window_to_clip(points, SIZE), [(0, 0, 0, 1), (1, 0.5, 0, 1)], [0.25, 0.75])
    back, stored = draw_image_and_depth(device, rows, LineWidth(width), primitive=Primitive.LINES)
    y, x = np.nonzero(line(points, width)[0])
    share = (x + 0.5 - 4.0) / 24
    assert_near(back[y, x, 0], share, 2e-3, "8 fraction bits of the window position over 24 texels")
    assert_near(back[y, x, 1], share / 2, 1e-3, "8 fraction bits of the window position over 24 texels")
    assert_near(stored[y, x], 0.25 + share / 2, 1e-3, "8 fraction bits of the window position over 24 texels")


def test_a_wide_line_is_cut_by_the_scissor(device: Device) -> None:
    require_line_width(device, 4)
    whole = draw_image(device, GENTLE, LineWidth(4))
    cut = draw_image(device, GENTLE, LineWidth(4), rhi.Scissor(8, 9, 10, 3))
    assert_same(cut[9:12, 8:18], whole[9:12, 8:18])
    assert (cut[..., 3] > 0).sum() == (cut[9:12, 8:18, 3] > 0).sum() > 0


def test_points_and_triangles_have_no_line_width(device: Device) -> None:
    require_line_width(device, 4)
    for primitive in (Primitive.POINTS, Primitive.TRIANGLES):
        plain = draw_image(device, TRIANGLE, primitive=primitive)
        assert plain.any()
        assert_same(draw_image(device, TRIANGLE, LineWidth(4), primitive=primitive), plain)


def test_the_width_ends_with_its_scope(device: Device) -> None:
    require_line_width(device, 4)
    rows = corners(window_to_clip(GENTLE, SIZE))
    with device.texture(SIZE, Format.RGBA32F) as image, device.mesh(rows, primitive=Primitive.LINES) as mesh:
        with device.render_pass(image, clear=(0, 0, 0, 0)):
            with device.states(LineWidth(4), rhi.Scissor(0, 0, 0, 0)):
                device.draw(device.program(Colored), mesh)
            device.draw(device.program(Colored), mesh)
        assert_same(image.read(), draw_image(device, GENTLE))


def test_a_wide_line_covers_samples(device: Device) -> None:
    """Platforms differ in the texels at its border, and in its ends: a rectangle's, or upright."""
    require_line_width(device, 5)
    require_samples(device, 4)
    rows = corners(window_to_clip(GENTLE, SIZE))
    back = draw_once(device, SIZE, Format.RGBA8, rows, LineWidth(5), primitive=Primitive.LINES, samples=4)[
        ..., 3
    ]
    assert_same(back[line(GENTLE, 3)[0]], 255)
    columns = slice(7, 24)
    assert_same(back[:, columns][~line(GENTLE, 8)[1][:, columns]], 0)


# -- wireframe -----------------------------------------------------------------------------------------------


@pytest.mark.recorded_too
@pytest.mark.requires("wireframe")
@pytest.mark.parametrize("order", [(0, 1, 2), (1, 2, 0), (2, 0, 1), (0, 2, 1), (2, 1, 0), (1, 0, 2)], ids=str)
@REQUIRES_PRECISION
def test_a_triangle_is_drawn_as_its_edges(device: Device, order: tuple[int, int, int]) -> None:
    points = [TRIANGLE[i] for i in order]
    assert_covers(wired(device, points, CullMode.NONE), outline(points))


@pytest.mark.requires("wireframe")
def test_a_filled_triangle_is_filled(device: Device) -> None:
    inside = rasterise(np.multiply(TRIANGLE, SUBTEXELS), *SIZE)
    image = draw_image(device, TRIANGLE, PolygonMode.FILL, primitive=Primitive.TRIANGLES)
    assert_covers(image, (inside, inside))
    assert (inside & ~outline(TRIANGLE)[1]).any(), "the outline is less"


@pytest.mark.requires("wireframe")
@pytest.mark.parametrize("width", [2, 3, 6])
def test_edges_have_the_line_width(device: Device, width: int) -> None:
    require_line_width(device, width)
    assert_covers(wired(device, TRIANGLE, LineWidth(width)), outline(TRIANGLE, width))


@pytest.mark.requires("wireframe")
@pytest.mark.parametrize("front", list(FrontFace), ids=lambda front: front.name)
@pytest.mark.parametrize("cull", list(CullMode), ids=lambda cull: cull.name)
@REQUIRES_PRECISION
def test_edges_are_culled_by_the_facing_of_their_triangle(
    device: Device, cull: CullMode, front: FrontFace
) -> None:
    for points in (TRIANGLE, TRIANGLE[::-1]):
        faces_front = (points is TRIANGLE) == (front is FrontFace.COUNTER_CLOCKWISE)
        seen = cull is CullMode.NONE or (cull is CullMode.BACK) == faces_front
        image = wired(device, points, cull, front)
        if seen:
            assert_covers(image, outline(points))
        else:
            assert_same(image, 0)


@pytest.mark.requires("wireframe")
@pytest.mark.parametrize("dtype", [None, "u2", "u4"])
@pytest.mark.parametrize("primitive", AREAS, ids=lambda primitive: primitive.name)
@REQUIRES_PRECISION
def test_every_topology_of_triangles_has_edges(
    device: Device, primitive: Primitive, dtype: str | None
) -> None:
    points = [(3.3125, 4.4375), (5.6875, 20.1875), (15.4375, 18.8125), (17.5625, 3.3125)]
    triangles = {
        Primitive.TRIANGLES: [points[:3]],
        Primitive.TRIANGLE_STRIP: [points[:3], points[1:]],
        Primitive.TRIANGLE_FAN: [points[:3], [points[0], *points[2:]]],
        Primitive.QUADS: [points[:3], [points[0], *points[2:]]],
    }[primitive]
    rows = corners(window_to_clip(points, SIZE))
    indices = None if dtype is None else np.arange(4, dtype=dtype)
    back = draw_once(
        device,
        SIZE,
        Format.RGBA32F,
        rows,
        CullMode.NONE,
        PolygonMode.LINE,
        indices=indices,
        primitive=primitive,
    )
    assert_covers(back, outline(triangles))


@pytest.mark.requires("wireframe")
@pytest.mark.parametrize("dtype", [None, "u2", "u4"])
def test_many_triangles_have_all_their_edges(device: Device, dtype: str | None) -> None:
    """More triangles than are processed at a time, among them some beyond the target."""
    origins = np.stack(np.meshgrid(np.arange(-8, 40, 4), np.arange(-4, 28, 4)), -1).reshape(-1, 1, 2)
    points = (origins + np.array([(0.3125, 0.4375), (0.6875, 3.1875), (3.5625, 2.3125)])).reshape(-1, 2)
    rows = corners(window_to_clip(points, SIZE))
    indices = None if dtype is None else np.arange(len(points), dtype=dtype)
    assert_covers(
        draw_once(device, SIZE, Format.RGBA32F, rows, PolygonMode.LINE, indices=indices), outline(points)
    )


@pytest.mark.requires("wireframe")
def test_an_edge_of_two_triangles_is_drawn_twice(device: Device) -> None:
    points = [(3.3125, 4.4375), (5.6875, 20.1875), (25.4375, 18.8125), (27.5625, 3.3125)]
    image = wired(device, [*points[:3], points[0], *points[2:]], rhi.BlendFunction.ADDITIVE)
    left, *rest = (line((points[i], points[(i + 1) % 4])) for i in range(4))
    shared, beside = line((points[0], points[2])), np.any([possible for _, possible in rest], axis=0)
    assert_same(image[shared[0] & ~beside & ~left[1]], 2)
    assert_same(image[left[0] & ~beside & ~shared[1]], 1)


@pytest.mark.requires("wireframe")
def test_a_flat_value_of_edges_is_that_of_their_triangle(device: Device) -> None:
    color = [(0.25, 0.5, 0.75, 1), (1, 0, 0, 1), (0, 1, 0, 1)]
    image = wired(device, TRIANGLE, color=color, shader=FlatColored)
    assert_same(image[outline(TRIANGLE)[0]], color[0])


@pytest.mark.requires("wireframe")
@REQUIRES_PRECISION
def test_values_and_depth_run_along_edges(device: Device) -> None:
    points = [(4.0, 4.25), (8.25, 20.0), (28.0, 8.25)]
    color, depths = np.array([(1, 0, 0, 1), (0, 1, 0, 1), (0, 0, 1, 1)]), [0.2, 0.5, 0.8]
    rows = corners(window_to_clip(points, SIZE), color, depths)
    back, stored = draw_image_and_depth(device, rows, PolygonMode.LINE)
    for i in range(3):
        ends = np.array([points[i], points[(i + 1) % 3]])
        others = line(ends)[0]
        for j in (1, 2):
            others &= ~line((points[(i + j) % 3], points[(i + j + 1) % 3]))[1]
        y, x = np.nonzero(others)
        along = ends[1] - ends[0]
        coordinate = np.array([x, y])[int(abs(along[1]) > abs(along[0]))] + 0.5
        share = (coordinate - ends[0][int(abs(along[1]) > abs(along[0]))]) / along[
            int(abs(along[1]) > abs(along[0]))
        ]
        expected = color[i] * (1 - share)[:, None] + color[(i + 1) % 3] * share[:, None]
        assert len(x) > 8
        assert_near(back[y, x], expected, 4e-3, "8 fraction bits of the window position over 16 texels")
        expected_depth = depths[i] * (1 - share) + depths[(i + 1) % 3] * share
        assert_near(
            stored[y, x], expected_depth, 2e-3, "8 fraction bits of the window position over 16 texels"
        )


@pytest.mark.requires("wireframe")
@pytest.mark.parametrize(
    "function", [DepthFunction.GREATER, DepthFunction.LESS], ids=lambda function: function.name
)
@REQUIRES_PRECISION
def test_each_texel_of_an_edge_is_tested_for_depth(device: Device, function: DepthFunction) -> None:
    points = [(4.0, 4.25), (4.25, 20.0), (28.0, 8.25)]
    depths = (np.array(points)[:, 0] - 4.0) / 24  # 0.5 at x = 16
    rows = corners(window_to_clip(points, SIZE), depth=depths)
    covered, _ = draw_image_and_depth(device, rows, rhi.DepthTest.ON, function, PolygonMode.LINE, clear=0.5)
    certain, possible = outline(points)
    near = slice(16, None) if function is DepthFunction.GREATER else slice(None, 16)
    half = np.zeros_like(certain)
    half[:, near] = True
    assert_covers(covered, (certain & half, possible & half))


@pytest.mark.requires("wireframe")
@REQUIRES_PRECISION
@pytest.mark.parametrize(("axis", "far"), [(0, 1.0), (1, 0.5)])
def test_edges_are_offset_as_their_triangle_is(device: Device, axis: int, far: float) -> None:
    """By a bias in steps, and by the slope of the triangle rather than of the edge. Lines are not."""
    points = [(4.0, 4.25), (4.25, 20.0), (28.0, 8.25)]
    depths = 0.25 + (np.array(points)[:, axis] - 4.0) / 48 / far
    view = rhi.Viewport(0.0, 0.0, *SIZE, 0.0, far)

    def stored(primitive: Primitive, *states: Any) -> NDArray[Any]:
        rows = corners(window_to_clip(points, SIZE), depth=depths)
        return draw_once(device, SIZE, Format.D32F, rows, view, *states, primitive=primitive)

    seen = outline(points)[0] & ~(np.arange(SIZE[0]) > 26)  # at the last corner two edges cross
    plain = stored(Primitive.TRIANGLES, PolygonMode.LINE)
    for states, moved in (
        ([rhi.PolygonOffset(2.0)], 2 / 48),
        ([rhi.PolygonOffset(-1.0)], -1 / 48),
        ([rhi.DepthBias(0.0)], 0.0),
    ):
        after = stored(Primitive.TRIANGLES, PolygonMode.LINE, *states)
        assert_near((after - plain)[seen], moved, 1e-4, "8 fraction bits of the window position in the slope")
    biased = (stored(Primitive.TRIANGLES, PolygonMode.LINE, rhi.DepthBias(1000.0)) - plain)[seen]
    assert (biased > 400 * 2.0**-24).all()
    lines = stored(Primitive.LINE_STRIP)
    assert_same(
        stored(Primitive.LINE_STRIP, PolygonMode.LINE, rhi.DepthBias(1000.0), rhi.PolygonOffset(2.0)), lines
    )


@pytest.mark.requires("wireframe", "stencil")
@REQUIRES_PRECISION
def test_edges_of_a_front_face_have_its_stencil_test(device: Device) -> None:
    require_format(device, Format.D24S8)
    rows = corners(window_to_clip(TRIANGLE, SIZE))
    with (
        device.texture(SIZE, Format.RGBA32F) as image,
        device.texture(SIZE, Format.D24S8) as depth,
        device.mesh(rows) as mesh,
    ):
        for front, back in ((Comparison.ALWAYS, Comparison.NEVER), (Comparison.NEVER, Comparison.ALWAYS)):
            with (
                device.render_pass(image, depth, clear=(0, 0, 0, 0), clear_depth=0.0, clear_stencil=0),
                device.states(
                    rhi.StencilTest.ON, rhi.StencilFront(front), rhi.StencilBack(back), PolygonMode.LINE
                ),
            ):
                device.draw(device.program(Colored), mesh)
            if front is Comparison.ALWAYS:
                assert_covers(image.read(), outline(TRIANGLE))
            else:
                assert_same(image.read(), 0)


@pytest.mark.requires("wireframe")
@REQUIRES_PRECISION
def test_a_triangle_without_an_area_is_a_back_face(device: Device) -> None:
    points = [GENTLE[0], GENTLE[1], GENTLE[0]]
    assert_covers(wired(device, points, CullMode.FRONT), line(GENTLE))
    assert_same(wired(device, points, CullMode.BACK), 0)


@pytest.mark.requires("wireframe")
def test_lines_and_points_are_the_same_in_wireframe(device: Device) -> None:
    for primitive in (Primitive.LINES, Primitive.LINE_STRIP, Primitive.POINTS):
        plain = draw_image(device, TRIANGLE, CullMode.FRONT, primitive=primitive)
        assert plain.any()
        assert_same(
            draw_image(device, TRIANGLE, CullMode.FRONT, PolygonMode.LINE, primitive=primitive), plain
        )


@pytest.mark.requires("wireframe")
@REQUIRES_PRECISION
def test_filled_triangles_and_edges_are_drawn_in_order(device: Device) -> None:
    rows = corners(window_to_clip(TRIANGLE, SIZE))
    inside = rasterise(np.multiply(TRIANGLE, SUBTEXELS), *SIZE)
    with device.texture(SIZE, Format.RGBA32F) as image, device.mesh(rows) as mesh:
        program = device.program(Colored)
        with device.render_pass(image, clear=(0, 0, 0, 0)), device.states(rhi.BlendFunction.ADDITIVE):
            device.draw(program, mesh)
            with device.states(PolygonMode.LINE, rhi.ColorWrite(green=False)):
                device.draw(program, mesh)
            with device.states(rhi.BlendFunction.OFF, rhi.ColorWrite(red=False, alpha=False)):
                device.draw(program, mesh)
        back = image.read()
    certain, possible = outline(TRIANGLE)
    assert (back[certain & inside, 0] >= 2).all(), "where two edges meet, both are drawn"
    assert_same(back[inside & ~possible, 0], 1)
    assert_same(back[inside, 1], 1)
    assert_same(back[~inside, 1], 0)


@pytest.mark.requires("wireframe")
@REQUIRES_PRECISION
def test_edges_of_a_triangle_that_reaches_beyond_the_view_are_drawn_where_visible(device: Device) -> None:
    points = [(-40.3125, 4.4375), (5.6875, 70.1875), (27.5625, 8.3125)]
    assert_covers(wired(device, points), outline(points))


@pytest.mark.requires("wireframe")
@pytest.mark.requires("precise_clipping")
@pytest.mark.parametrize("beyond", [-0.5, 1.5], ids=["near", "far"])
def test_no_line_is_drawn_where_a_plane_cuts_a_triangle(device: Device, beyond: float) -> None:
    """The edges end there."""
    image = wired(device, TRIANGLE, depth=[0.5, 0.5, beyond])
    (ax, ay), (bx, by), (cx, cy) = TRIANGLE
    y, x = np.mgrid[0 : SIZE[1], 0 : SIZE[0]] + 0.5
    share = ((bx - ax) * (y - ay) - (by - ay) * (x - ax)) / ((bx - ax) * (cy - ay) - (by - ay) * (cx - ax))
    certain, possible = outline(TRIANGLE)
    assert_covers(image, (certain & (share < 0.45), possible & (share < 0.55)))
