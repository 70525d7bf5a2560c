"""Triangles that the view or the eye plane cuts, and triangles too thin for careless planes: coverage, depth,
weights.

`rhi.conformance.triangles` makes them and computes in float64 what they must give.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import pytest
from numpy.typing import NDArray

from rhi import BlendFunction, CullMode, DepthFunction, DepthWrite, Device, Format, Scissor
from rhi.conformance import triangles as exam
from rhi.conformance.compare import assert_same
from rhi.conformance.formats import require_blendable
from rhi.conformance.shaders import Bare, Corner, FlatColored
from rhi.conformance.shapes import corners
from rhi.conformance.single_draws import draw_once
from rhi.conformance.triangles import CUT, WHOLE, Family, examine, make_triangles
from rhi.contract.states import MAX_VIEWPORT_SIZE
from rhi.shading import Shader, vec4

pytestmark = pytest.mark.requires("draws", "shading")

DEPTH_BOUND: Final = 2e-5
DISTANCE_BOUND: Final = 5e-6
"""2^-9 of a depth for a texel by a rounding of 1/512 texel, and a few roundings of float32."""
WEIGHT_BOUND: Final = 1e-6
"""Float32's rounding of what is interpolated with weights of 0 to 1."""
SIZE: Final = (64, 64)
AT_THE_EYE: Final = np.array([
    (482.9281921386719, -521.9058837890625, 31.785295486450195, 176.1521453857422),
    (-0.01326920185238123, -0.007043696474283934, -0.006913322024047375, -0.0061768461818800735),
    (142.3650665283203, 248.6844482421875, 165.19955444335938, 111.3580551147461),
])  # fmt: skip
"""A triangle of which one corner lies just behind the eye."""

Floats = NDArray[np.float64]


def named(family: Family) -> str:
    return family.__name__


def count(device: Device, triangles: Any, *states: Any) -> NDArray[Any]:
    """Return the number of draws of each texel by triangles (n, 3, 4)."""
    rows = corners(np.asarray(triangles, np.float64).reshape(-1, 4))
    return draw_once(
        device, SIZE, Format.R16F, rows, CullMode.NONE, BlendFunction.ADDITIVE, *states, shader=FlatColored
    )


# -- coverage ------------------------------------------------------------------------------------------------


def test_a_triangle_with_a_corner_just_behind_the_eye_is_drawn(device: Device) -> None:
    assert count(device, AT_THE_EYE).sum() == 289


@pytest.mark.parametrize(
    "family", [family for family in CUT if family is not exam.beyond_the_guard_band], ids=named
)
def test_a_clipped_triangle_covers_the_texels_that_float64_computes(device: Device, family: Family) -> None:
    """Texels farther than 1/256 texel from every edge and cut."""
    require_blendable(device, Format.RGBA32F)
    drawn = 0
    for seed in range(2):
        result = examine(device, family, seed)
        assert_same(result.wrong, 0)
        drawn += result.drawn
    assert drawn > 25_000


@pytest.mark.requires("precise_triangles")
@pytest.mark.parametrize("wide", [exam.CELL, MAX_VIEWPORT_SIZE])
def test_a_triangle_that_reaches_far_beyond_the_view_covers_the_texels_that_float64_computes(
    device: Device, wide: int
) -> None:
    wide = min(wide, device.capabilities.max_texture_size)
    result = examine(device, exam.beyond_the_guard_band, 0, wide)
    assert_same(result.wrong, 0)
    assert result.drawn > 40_000


def test_triangles_around_the_eye_share_their_edges(device: Device) -> None:
    """A fan whose centre lies in the view and whose rim lies before and behind the eye covers each texel
    once."""
    rng = np.random.default_rng(2)
    for _ in range(12):
        spokes = int(rng.integers(5, 12))
        angles = 2 * np.pi * (np.arange(spokes) + rng.uniform(-0.2, 0.2, spokes)) / spokes
        # A plane through the middle of the view, tilted so that a part of the rim passes the eye.
        tilt = rng.uniform(-1, 1, 2)
        rim = np.stack([np.cos(angles), np.sin(angles)], 1) * 50
        w = 1 + rim @ tilt / 10
        ring = np.concatenate([rim, np.full((spokes, 1), 0.5) * w[:, None] * (w[:, None] > 0), w[:, None]], 1)
        centre = np.array([*rng.uniform(-0.5, 0.5, 2), 0.5, 1.0])
        fan = [[centre, ring[i], ring[(i + 1) % spokes]] for i in range(spokes)]
        counts = count(device, np.array(fan).astype(np.float32))
        assert counts.max() <= 1
        assert (counts == 1).sum() > 1000


class Infinite(Shader):
    """Adds infinity to the components of a position whose color is huge."""

    def vertex(self, v: Corner) -> Bare:
        return Bare(clip=v.position + v.color * v.color)

    def fragment(self, v: Bare) -> vec4:
        return vec4(1.0)


class MinusInfinite(Infinite):
    """Subtracts infinity."""

    def vertex(self, v: Corner) -> Bare:
        return Bare(clip=v.position - v.color * v.color)


class Undefined(Infinite):
    """Makes the components NaN."""

    def vertex(self, v: Corner) -> Bare:
        return Bare(clip=v.position + (v.color * v.color - v.color * v.color))


@pytest.mark.parametrize("shader", [Infinite, MinusInfinite, Undefined])
@pytest.mark.parametrize("component", range(4))
def test_a_corner_that_is_no_number_harms_no_other_triangle(
    device: Device, component: int, shader: type[Shader]
) -> None:
    """The pixels of such a triangle are undefined; the ones around it are drawn as without it."""
    left = np.array([(-1, -1, 0.5, 1), (0, -1, 0.5, 1), (-1, 1, 0.5, 1)])
    right, broken = left * (-1, 1, 1, 1), np.zeros((9, 4))
    broken[4, component] = 3e38
    program: Any = device.program(shader)
    results = []
    for rows in (
        corners(np.concatenate([left, right]), np.zeros(4)),
        corners(np.concatenate([left, left + np.array((0.5, 0, 0, 0)), right]), broken),
    ):
        with device.texture(SIZE, Format.R16F) as image, device.mesh(rows) as mesh:
            with device.render_pass(image), device.states(CullMode.NONE, BlendFunction.ADDITIVE):
                device.draw(program, mesh)
            results.append(image.read())
    alone, mixed = results
    assert alone.sum() > 1000
    assert (mixed >= alone).all()
    assert (mixed <= alone + 1).all()


# -- depth and weights ---------------------------------------------------------------------------------------


@pytest.mark.requires("precise_triangles")
@pytest.mark.parametrize("family", [*CUT, *WHOLE], ids=named)
def test_depth_is_that_of_float64_and_stays_in_the_range_of_the_corners(
    device: Device, family: Family
) -> None:
    """Also of triangles of a pixel and of slivers."""
    result = examine(device, family, 5)
    assert_same(result.wrong, 0)
    assert result.drawn > 100
    assert result.depth_error <= DEPTH_BOUND
    assert result.depth_beyond <= 2.0**-23  # rounding of the corners' depths


@pytest.mark.requires("precise_triangles")
@pytest.mark.parametrize("family", [*CUT, *WHOLE], ids=named)
def test_weights_lie_between_0_and_1(device: Device, family: Family) -> None:
    """So varyings lie in the range of the corners', with perspective and without."""
    result = examine(device, family, 6)
    assert result.drawn > 100
    assert result.weight_beyond <= WEIGHT_BOUND


@pytest.mark.requires("precise_triangles")
@pytest.mark.parametrize("samples", [1, 4, 8])
@pytest.mark.parametrize("family", [exam.of_a_pixel, exam.slivers], ids=named)
def test_no_sample_lies_beyond_the_corners_depths(device: Device, samples: int, family: Family) -> None:
    """Against a target as near as the nearest corner nothing passes, nor against one as far as the
    farthest."""
    if samples not in device.capabilities.sample_counts:
        pytest.skip(f"sample_counts is {device.capabilities.sample_counts}")
    program, seen = device.program(FlatColored), 0
    with (
        device.texture(SIZE, Format.R32F, samples=samples) as image,
        device.texture(SIZE, Format.D32F, samples=samples) as depth,
        device.texture(SIZE, Format.R32F) as resolved,
    ):
        for triangle in make_triangles(family, 7)[:64]:
            depths = triangle[:, 2].astype(np.float32) / triangle[:, 3].astype(np.float32)
            drawn = []
            with device.mesh(corners(triangle)) as mesh:
                for clear, function in (
                    (0.0, DepthFunction.ALWAYS),
                    (depths.max() * (1 + 2e-7), DepthFunction.GREATER),
                    (depths.min() * (1 - 2e-7), DepthFunction.LESS),
                ):
                    with (
                        device.render_pass(
                            image,
                            depth,
                            clear=(0, 0, 0, 0),
                            clear_depth=float(clear),
                            resolve=resolved if samples > 1 else None,
                        ),
                        device.states(CullMode.NONE, function),
                    ):
                        device.draw(program, mesh)
                    drawn.append(int(np.count_nonzero((resolved if samples > 1 else image).read())))
            assert drawn[1:] == [0, 0], triangle.tolist()
            seen += drawn[0]
    assert seen > 30


@pytest.mark.parametrize("family", [exam.at_the_eye, exam.through_the_near_plane, exam.slivers], ids=named)
def test_a_triangle_has_the_same_depth_under_any_scissor(device: Device, family: Family) -> None:
    """The same triangle drawn again, in four windows, passes EQUAL in every texel."""
    program, seen = device.program(FlatColored), 0
    windows = [Scissor(0, 0, 23, 31), Scissor(23, 0, 41, 31), Scissor(0, 31, 23, 33), Scissor(23, 31, 41, 33)]
    with device.texture(SIZE, Format.R16F) as image, device.texture(SIZE, Format.D32F) as depth:
        for triangle in make_triangles(family, 8)[:48]:
            with (
                device.mesh(corners(triangle)) as mesh,
                device.render_pass(image, depth, clear=(0, 0, 0, 0), clear_depth=0.0),
                device.states(CullMode.NONE, BlendFunction.ADDITIVE),
            ):
                with device.states(DepthFunction.ALWAYS):
                    device.draw(program, mesh)
                for window in windows:
                    with device.states(DepthFunction.EQUAL, DepthWrite.OFF, window):
                        device.draw(program, mesh)
            counts = image.read()
            assert set(np.unique(counts)) <= {0.0, 2.0}, triangle.tolist()
            seen += int((counts == 2).sum())
    assert seen > 30


def tilted_grid(degrees: float, distance: float, cells: int = 24) -> tuple[Floats, Floats]:
    """Return the clip positions (n, 4) of the triangles of a plane that a 90° projection with reversed depth
    sees from a height, turned by an angle from facing the eye; and the inverse distances (h, w) at the
    middles of its pixels."""
    tilt, along = np.radians(degrees), np.linspace(-0.7, 0.7, cells + 1)
    x, y = np.meshgrid(along, along)
    points = np.stack([x, y * np.cos(tilt), 1.0 + y * np.sin(tilt), np.ones_like(x)], axis=2) * distance
    first = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).reshape(-1)
    corner = np.stack(
        [first, first + 1, first + cells + 2, first, first + cells + 2, first + cells + 1], axis=1
    )
    homogeneous = points.reshape(-1, 4)[corner.reshape(-1)]
    clip = np.stack(
        [homogeneous[:, 0], homogeneous[:, 1], np.full(len(homogeneous), 0.5), homogeneous[:, 2]], axis=1
    )
    up = (
        1.0 - (np.arange(SIZE[1]) + 0.5) / SIZE[1] * 2.0
    )  # a ray is (x, up, 1): it meets the sheet at this distance
    inverse = (np.cos(tilt) - up * np.sin(tilt)) / (distance * np.cos(tilt))
    return clip, np.repeat(inverse[:, None], SIZE[0], axis=1)


@pytest.mark.parametrize(
    ("distance", "is_reversed"), [(1.0, True), (1e3, True), (1e6, True), (1.0, False), (100.0, False)]
)
@pytest.mark.parametrize("degrees", [60.0, 80.0, 85.0])
def test_small_triangles_of_a_tilted_plane_have_the_distance_of_the_plane(
    device: Device, degrees: float, distance: float, is_reversed: bool
) -> None:
    """Within a share of the distance that doesn't grow with it: what two surfaces must be apart to be told
    apart. Of standard depth, which is 1 less that, as far as its digits reach."""
    clip, inverse = tilted_grid(degrees, distance)
    if not is_reversed:
        clip[:, 2] = clip[:, 3] - 0.5
    with (
        device.texture(SIZE, Format.R32F) as image,
        device.texture(SIZE, Format.D32F) as depth,
        device.mesh(corners(clip)) as mesh,
    ):
        with (
            device.render_pass(image, depth, clear=(0, 0, 0, 0), clear_depth=0.0 if is_reversed else 1.0),
            device.states(CullMode.NONE, DepthFunction.GREATER if is_reversed else DepthFunction.LESS),
        ):
            device.draw(device.program(FlatColored), mesh)
        depths = depth.read().astype(np.float64)
    depths = depths if is_reversed else 1.0 - depths
    drawn = depths > 0.0
    assert drawn.sum() > 100
    digits = 0.0 if is_reversed else 2.0**-22
    off = np.abs(depths[drawn] - 0.5 * inverse[drawn])
    assert (off < 0.5 * inverse[drawn] * DISTANCE_BOUND + digits).all()
