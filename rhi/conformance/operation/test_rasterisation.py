"""The texels that a triangle covers, and its varyings there: fill rule, culling, scissor, viewport, clipping,
interpolation."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from rhi import BlendFunction, CullMode, Device, Format, FrontFace, Scissor, State, Viewport
from rhi.conformance.compare import assert_mask, assert_near, assert_same
from rhi.conformance.reference import SUBTEXELS, rasterise, rasterise_within
from rhi.conformance.shaders import Bare, Colored, Corner, Positions
from rhi.conformance.shapes import VertexRows, corners, rectangle, texel_rectangle, window_to_clip
from rhi.conformance.single_draws import draw_once
from rhi.shading import NoPerspective, Shader, Struct, front_facing, vec4

pytestmark = pytest.mark.requires("draws", "shading")

SIZE = (16, 16)


def counts(device: Device, rows: VertexRows, *states: State, size: tuple[int, int] = SIZE) -> NDArray[Any]:
    """Return the number of draws of each texel."""
    with device.states(CullMode.NONE, BlendFunction.ADDITIVE):
        return draw_once(device, size, Format.R16F, rows, *states)


def at_subtexels(points: Any, size: tuple[int, int] = SIZE) -> NDArray[np.float64]:
    """Return the clip positions of window points in 1/16 texel, exact in float32 for power-of-two sizes."""
    return window_to_clip(np.asarray(points) / SUBTEXELS, size)


# -- fill rule ---------------------------------------------------------------------------------------------

ON_TARGET = st.tuples(st.integers(0, 16 * SUBTEXELS), st.integers(0, 16 * SUBTEXELS))
ANYWHERE = st.tuples(st.integers(-4 * SUBTEXELS, 20 * SUBTEXELS), st.integers(-4 * SUBTEXELS, 20 * SUBTEXELS))
# Corners on texel centers make edges pass through other centers, where the fill rule decides.
CENTER = st.tuples(st.integers(0, 15), st.integers(0, 15)).map(
    lambda p: (p[0] * SUBTEXELS + SUBTEXELS // 2, p[1] * SUBTEXELS + SUBTEXELS // 2)
)


@settings(max_examples=40, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(triangle=st.tuples(ON_TARGET, ON_TARGET, ON_TARGET))
def test_a_triangle_covers_the_texels_whose_centers_it_contains(device: Device, triangle: Any) -> None:
    assert_mask(counts(device, corners(at_subtexels(triangle))), rasterise(triangle, *SIZE))


@settings(max_examples=60, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(triangle=st.tuples(CENTER, CENTER, CENTER))
def test_a_center_on_an_edge_belongs_to_top_and_left_edges(device: Device, triangle: Any) -> None:
    assert_mask(counts(device, corners(at_subtexels(triangle))), rasterise(triangle, *SIZE))


@settings(max_examples=40, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(triangle=st.tuples(ANYWHERE, ANYWHERE, ANYWHERE))
def test_a_triangle_that_reaches_beyond_the_target_keeps_its_edges(device: Device, triangle: Any) -> None:
    """Edges may move by up to 1/16 texel, because clipping may round the corners that it creates."""
    certain, possible = rasterise_within(triangle, *SIZE, 1 / 16)
    drawn = counts(device, corners(at_subtexels(triangle))) != 0
    assert_mask(drawn | certain, drawn)
    assert_mask(drawn & possible, drawn)


@settings(max_examples=20, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(center=CENTER | ON_TARGET, spokes=st.integers(3, 9))
def test_triangles_that_share_edges_cover_each_texel_once(device: Device, center: Any, spokes: int) -> None:
    """A fan around any point, out to a border beyond the target: no gap, no overlap."""
    angles = np.arange(spokes) * 2 * np.pi / spokes
    rim = (
        np.rint(np.stack([np.cos(angles), np.sin(angles)], axis=1) * 80 * SUBTEXELS).astype(int)
        + 8 * SUBTEXELS
    )
    fan = np.concatenate([[center, rim[i], rim[(i + 1) % spokes]] for i in range(spokes)])
    inside = all(
        (b[0] - a[0]) * (center[1] - a[1]) - (b[1] - a[1]) * (center[0] - a[0]) > 0
        for a, b in zip(rim, np.roll(rim, -1, axis=0), strict=True)
    )
    assert inside
    assert_same(counts(device, corners(at_subtexels(fan))), 1)


def test_a_rectangle_at_half_texels_takes_its_top_left_texels(device: Device) -> None:
    mask = np.zeros((16, 16), bool)
    mask[2:6, 3:9] = True
    assert_mask(counts(device, texel_rectangle(3.5, 2.5, 6, 4, SIZE)), mask)


def test_a_triangle_without_area_covers_nothing(device: Device) -> None:
    rows = corners(at_subtexels([(16, 16), (128, 128), (240, 240)]))
    assert_same(counts(device, rows), 0)


def test_a_triangle_smaller_than_a_texel_covers_one_center_or_none(device: Device) -> None:
    around = np.array([(-3, -2), (3, -2), (0, 4)])
    for offset, expected in (((72, 72), 1), ((80, 80), 0)):
        assert counts(device, corners(at_subtexels(around + offset))).sum() == expected


def test_a_huge_triangle_covers_the_whole_target(device: Device) -> None:
    assert_same(counts(device, corners([(-1, -1), (8000, -1), (-1, 8000)])), 1)


def test_a_triangle_far_outside_covers_nothing(device: Device) -> None:
    assert_same(counts(device, corners([(1000, 1000), (1001, 1000), (1000, 1001)])), 0)


def test_an_edge_across_a_large_target_is_exact(device: Device) -> None:
    size = (256, 256)
    triangle = np.array([(5, 3), (251, 97), (88, 254)]) * SUBTEXELS + (3, 7)
    mask = rasterise(triangle, *size)
    assert_mask(counts(device, corners(at_subtexels(triangle, size)), size=size), mask)


@pytest.mark.parametrize("size", [(1, 1), (1, 16), (16, 1), (7, 5), (33, 65)], ids=str)
def test_a_target_of_any_size_is_covered(device: Device, size: tuple[int, int]) -> None:
    assert_same(counts(device, rectangle(), size=size), 1)


# -- culling -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("front", list(FrontFace), ids=lambda f: f.name)
@pytest.mark.parametrize("cull", list(CullMode), ids=lambda c: c.name)
@pytest.mark.parametrize("winding", [1, -1], ids=["counter_clockwise", "clockwise"])
def test_a_face_is_culled_by_its_winding(
    device: Device, cull: CullMode, front: FrontFace, winding: int
) -> None:
    """Front faces are counter-clockwise with +Y up on every backend, whichever way up its images are
    stored."""
    is_front = (winding == 1) is (front is FrontFace.COUNTER_CLOCKWISE)
    seen = cull is CullMode.NONE or (cull is CullMode.FRONT) is not is_front
    assert_same(counts(device, rectangle()[::winding], cull, front), 1 if seen else 0)


def test_back_faces_are_culled_by_default(device: Device) -> None:
    with device.texture((2, 2), Format.R8) as image:
        for winding, expected in ((1, 255), (-1, 0)):
            with device.mesh(rectangle()[::winding]) as mesh, device.render_pass(image, clear=(0, 0, 0, 0)):
                device.draw(device.program(Colored), mesh)
            assert_same(image.read(), expected)


class Faces(Positions):
    """Draws front faces white and back faces gray."""

    def fragment(self, v: Bare) -> vec4:
        if front_facing():
            return vec4(1.0)
        return vec4(0.5)


@pytest.mark.parametrize("front", list(FrontFace), ids=lambda f: f.name)
def test_a_shader_sees_the_face_that_culling_sees(device: Device, front: FrontFace) -> None:
    with device.texture((2, 2), Format.R32F) as image:
        for winding in (1, -1):
            is_front = (winding == 1) is (front is FrontFace.COUNTER_CLOCKWISE)
            with (
                device.mesh(rectangle()[::winding]) as mesh,
                device.render_pass(image),
                device.states(CullMode.NONE, front),
            ):
                device.draw(device.program(Faces), mesh)
            assert_same(image.read(), 1.0 if is_front else 0.5)


# -- scissor and viewport ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "box",
    [
        (0, 0, 16, 16),
        (3, 5, 4, 2),
        (0, 0, 1, 1),
        (15, 15, 1, 1),
        (-5, -5, 8, 8),
        (10, 12, 100, 100),
        (20, 0, 4, 4),
    ],
    ids=str,
)
def test_a_scissor_counts_from_the_top_left(device: Device, box: tuple[int, int, int, int]) -> None:
    x, y, width, height = box
    rows, columns = np.mgrid[0:16, 0:16]
    mask = (columns >= x) & (columns < x + width) & (rows >= y) & (rows < y + height)
    assert_mask(counts(device, rectangle(), Scissor(*box)), mask)


@pytest.mark.parametrize("box", [(4, 4, 0, 4), (4, 4, 4, 0), (0, 0, 0, 0)], ids=str)
def test_an_empty_scissor_lets_nothing_through(device: Device, box: tuple[int, int, int, int]) -> None:
    assert_same(counts(device, rectangle(), Scissor(*box)), 0)


def test_a_scissor_ends_with_its_scope(device: Device) -> None:
    with device.texture(SIZE, Format.R16F) as image, device.mesh(rectangle()) as mesh:
        with device.render_pass(image), device.states(BlendFunction.ADDITIVE):
            with device.states(Scissor(0, 0, 8, 16)):
                device.draw(device.program(Colored), mesh)
            device.draw(device.program(Colored), mesh)
        assert_same(image.read(), np.where(np.arange(16) < 8, 2, 1)[None, :])


def test_a_scissor_holds_for_targets_of_other_sizes(device: Device) -> None:
    """A scissor that is kept across passes is measured from the top of each target."""
    with device.mesh(rectangle()) as mesh, device.states(Scissor(0, 0, 2, 1)):
        for size in ((4, 4), (4, 8), (4, 2)):
            with device.texture(size, Format.R8) as image:
                with device.render_pass(image, clear=(0, 0, 0, 0)):
                    device.draw(device.program(Colored), mesh)
                mask = np.zeros(size[::-1], bool)
                mask[0, :2] = True
                assert_mask(image.read(), mask)


@pytest.mark.parametrize("box", [(0, 0, 16, 16), (2, 3, 8, 4), (8, 8, 8, 8), (12, 12, 8, 8)], ids=str)
def test_a_viewport_counts_from_the_top_left(device: Device, box: tuple[int, int, int, int]) -> None:
    """The upper left triangle of clip space lands in the upper left of the viewport."""
    x, y, w, h = box
    triangle = [(-1, 1), (-1, -1), (1, 1)]
    window = np.array([(x, y), (x, y + h), (x + w, y)]) * SUBTEXELS
    assert_mask(counts(device, corners(triangle), Viewport(*box)), rasterise(window, *SIZE))


def test_a_viewport_may_lie_between_texels(device: Device) -> None:
    mask = np.zeros((16, 16), bool)
    mask[1:5, 3:8] = True
    assert_mask(counts(device, rectangle(), Viewport(2.75, 1.25, 5.5, 3.75)), mask)


def test_a_viewport_may_reach_beyond_the_target(device: Device) -> None:
    window = np.array([(-8, -8), (-8, 24), (24, -8)]) * SUBTEXELS
    rows = corners([(-1, 1), (-1, -1), (1, 1)])
    assert_mask(counts(device, rows, Viewport(-8, -8, 32, 32)), rasterise(window, *SIZE))


def test_the_default_viewport_is_the_target_of_each_pass(device: Device) -> None:
    with device.mesh(rectangle()) as mesh:
        for size in ((4, 4), (9, 5), (2, 7)):
            with device.texture(size, Format.R8) as image:
                with device.render_pass(image, clear=(0, 0, 0, 0)):
                    device.draw(device.program(Colored), mesh)
                assert_same(image.read(), 255)


def test_the_viewport_of_a_mip_level_is_the_level(device: Device) -> None:
    with device.texture((8, 8), Format.R8, levels=3) as image, device.mesh(rectangle()) as mesh:
        with device.render_pass(image.at(level=1)):
            device.draw(device.program(Colored), mesh)
        assert_same(image.read(0), 0)
        assert_same(image.read(1), 255)
        assert_same(image.read(2), 0)


def test_a_viewport_clips_geometry_outside_of_it(device: Device) -> None:
    """A viewport clips: geometry beyond clip space doesn't spill into the rest of the target."""
    mask = np.zeros((16, 16), bool)
    mask[4:12, 4:12] = True
    assert_mask(counts(device, rectangle(-2, -2, 2, 2), Viewport(4, 4, 8, 8)), mask)


# -- interpolation -----------------------------------------------------------------------------------------


class Straight(Struct):
    """A color that is interpolated linearly in the image, without perspective."""

    clip: vec4
    color: NoPerspective[vec4]


class StraightColored(Shader):
    """Interpolates colors without perspective."""

    def vertex(self, v: Corner) -> Straight:
        return Straight(clip=v.position, color=v.color)

    def fragment(self, v: Straight) -> vec4:
        return v.color


# A floor that recedes from w = 1 to w = 4, so barycentric weights in the image and in the world differ.
W = np.array([1.0, 4.0, 2.0])
TRIANGLE = np.array([(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0)])
RGB = np.array([(1.0, 0.0, 0.0, 1.0), (0.0, 1.0, 0.0, 1.0), (0.0, 0.0, 1.0, 1.0)])


def weights(size: tuple[int, int]) -> NDArray[np.float64]:
    """Return the (height, width, 3) barycentric weights of `TRIANGLE` at the texel centers."""
    w, h = size
    x, y = np.meshgrid((np.arange(w) + 0.5) * 2 / w - 1, 1 - (np.arange(h) + 0.5) * 2 / h)
    b, c = (x + 1) / 2, (y + 1) / 2
    return np.stack([1 - b - c, b, c], axis=-1)


def interpolated(device: Device, shader: type[Shader]) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    rows = corners(
        np.concatenate([TRIANGLE, np.full((3, 1), 0.5), np.ones((3, 1))], axis=1) * W[:, None], RGB
    )
    pixels = draw_once(device, SIZE, Format.RGBA32F, rows, shader=shader)
    return pixels, pixels[..., 3] > 0


def test_values_are_interpolated_in_the_world(device: Device) -> None:
    pixels, inside = interpolated(device, Colored)
    bary = weights(SIZE) / W
    expected = (bary / bary.sum(axis=-1, keepdims=True)) @ RGB
    assert inside.sum() > 100
    assert_near(pixels[inside], expected[inside], 2e-6, "interpolation in float32")


def test_values_without_perspective_are_interpolated_in_the_image(device: Device) -> None:
    pixels, inside = interpolated(device, StraightColored)
    assert inside.sum() > 100
    assert_near(pixels[inside], (weights(SIZE) @ RGB)[inside], 2e-6, "interpolation in float32")


def test_a_clipped_triangle_keeps_its_values(device: Device) -> None:
    """Clipping creates corners, whose varyings are those of the triangle at these points."""
    big = corners(
        [(-3, -1), (3, -1), (3, 1), (-3, -1), (3, 1), (-3, 1)],
        [(x / 6 + 0.5, 0, 0, 1) for x in (-3, 3, 3, -3, 3, -3)],
    )
    expected = ((np.arange(8) + 0.5) / 4 - 1) / 6 + 0.5
    assert_near(
        draw_once(device, (8, 2), Format.R32F, big),
        np.stack([expected] * 2),
        1e-6,
        "interpolation in float32",
    )
