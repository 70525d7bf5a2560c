"""Depth: the conventions, the test, the writes, biases, ranges and clipping."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import rhi
from rhi.conformance.compare import assert_mask, assert_near, assert_same
from rhi.conformance.formats import require_format
from rhi.conformance.reference import compare
from rhi.conformance.shaders import Colored, Positions
from rhi.conformance.shapes import VertexRows, corners, rectangle
from rhi.conformance.single_draws import draw_once
from rhi.contract.formats import DEPTH_FORMATS
from rhi.shading import vec4

pytestmark = pytest.mark.requires("draws", "shading")

SIZE = (4, 4)
BITS = {
    rhi.Format.D16: 16,
    rhi.Format.D24: 24,
    rhi.Format.D24S8: 24,
    rhi.Format.D32F: 24,
    rhi.Format.D32FS8: 24,
}


def depth_after(
    device: rhi.Device,
    *draws: VertexRows,
    clear: float = 0.0,
    states: tuple[rhi.State, ...] = (rhi.DepthTest.ON,),
    format: rhi.Format = rhi.Format.D32F,
    size: tuple[int, int] = SIZE,
) -> NDArray[Any]:
    """Return the depth buffer after one draw for each of `draws`, in order."""
    with device.texture(size, format) as depth:
        with device.render_pass(depth=depth, clear_depth=clear), device.states(*states):
            for rows in draws:
                with device.mesh(rows) as mesh:
                    device.draw(device.program(Colored), mesh)
        return depth.read()


def test_by_default_the_larger_depth_wins(device: rhi.Device) -> None:
    """Reversed depth: near is 1, far is 0, cleared to 0."""
    near, far = rectangle(depth=0.75), rectangle(depth=0.25)
    assert_same(depth_after(device, near, far), 0.75)
    assert_same(depth_after(device, far, near), 0.75)


def test_standard_depth_is_a_function_and_a_clear_away(device: rhi.Device) -> None:
    near, far = rectangle(depth=0.25), rectangle(depth=0.75)
    states = (rhi.DepthFunction.LESS,)
    assert_same(depth_after(device, near, far, clear=1.0, states=states), 0.25)
    assert_same(depth_after(device, far, near, clear=1.0, states=states), 0.25)


@pytest.mark.parametrize("format", DEPTH_FORMATS, ids=lambda f: f.name)
@pytest.mark.parametrize("depth", [0.0, 0.3, 0.5, 1.0])
def test_clip_depth_is_stored_as_it_is(device: rhi.Device, format: rhi.Format, depth: float) -> None:
    """Clip depth runs from 0 to 1, not from −1 to 1."""
    require_format(device, format)
    after = depth_after(
        device, rectangle(depth=depth), clear=0.6, states=(rhi.DepthFunction.ALWAYS,), format=format
    )
    assert_near(after, depth, 2.0 ** -BITS[format], "the format's bits")


@pytest.mark.parametrize("near", [0.25, 0.5, 0.75], ids=str)
def test_16_bits_of_depth_are_the_nearest(device: rhi.Device, near: float) -> None:
    """Whole steps and parts of one, of both halves of a step, in all parts of the range."""
    require_format(device, rhi.Format.D16)
    steps = np.round(65535 * near) + np.array([-0.4, -0.2, 0.0, 0.2, 0.4, 0.6, 0.8, 1.0, 1.4])
    columns = [
        rectangle(-1 + 2 * i / 9, -1, -1 + 2 * (i + 1) / 9, 1, depth=s / 65535) for i, s in enumerate(steps)
    ]
    after = depth_after(device, np.concatenate(columns), format=rhi.Format.D16, size=(9, 2))
    assert_near(after * 65535, np.broadcast_to(np.round(steps), (2, 9)), 1e-2, "whole steps, read as float32")


def test_16_bits_of_depth_are_compared_as_they_are_stored(device: rhi.Device) -> None:
    """A fifth of a step nearer is as far; four fifths are a step nearer."""
    require_format(device, rhi.Format.D16)
    first, fifth = rectangle(depth=30000 / 65535), rectangle(depth=30000.2 / 65535)
    most = rectangle(depth=30000.8 / 65535)
    with device.texture(SIZE, rhi.Format.R8) as image, device.texture(SIZE, rhi.Format.D16) as depth:
        for rows, seen in ((fifth, 0), (most, 255)):
            rows["color"] = 1
            first["color"] = 0
            with device.render_pass(image, depth, clear=(0, 0, 0, 0), clear_depth=0.0):
                with device.mesh(first) as below, device.mesh(rows) as above:
                    device.draw(device.program(Colored), below)
                    device.draw(device.program(Colored), above)
            assert_same(image.read(), seen)


def test_float_depth_is_precise_near_zero(device: rhi.Device) -> None:
    """The purpose of reversed depth: far away (near 0), 5e-7 and 1e-6 are different depths."""
    far, nearer = rectangle(depth=5e-7), rectangle(depth=1e-6)
    assert_near(depth_after(device, far), 5e-7, 1e-12, "float32 keeps 24 significant bits")
    assert_near(depth_after(device, far, nearer), 1e-6, 1e-12, "float32 keeps 24 significant bits")
    assert_near(depth_after(device, nearer, far), 1e-6, 1e-12, "float32 keeps 24 significant bits")


def test_float_depth_is_not_squeezed_on_its_way(device: rhi.Device) -> None:
    """An intermediate mapping to −1…1 would lose the low bits of depths near 0."""
    depths = np.float32(2.0) ** -np.arange(8, 24, dtype=np.float32)
    for depth in depths[::5]:
        assert_near(
            depth_after(device, rectangle(depth=depth)), depth, depth * 2.0**-20, "interpolation in float32"
        )


@pytest.mark.parametrize("function", list(rhi.DepthFunction), ids=lambda f: f.name)
def test_a_depth_function_compares_fragment_with_stored(
    device: rhi.Device, function: rhi.DepthFunction
) -> None:
    stored = 0.5
    for new in (0.25, 0.5, 0.75):
        passes = bool(compare(function, new, stored))
        after = depth_after(device, rectangle(depth=new), clear=stored, states=(function,))
        assert_same(after, new if passes else stored)


@pytest.mark.parametrize("function", list(rhi.DepthFunction), ids=lambda f: f.name)
def test_a_fragment_that_fails_the_depth_test_writes_no_color(
    device: rhi.Device, function: rhi.DepthFunction
) -> None:
    with device.texture((3, 1), rhi.Format.R8) as image, device.texture((3, 1), rhi.Format.D32F) as depth:
        columns = [
            rectangle(-1 + 2 * i / 3, -1, -1 + 2 * (i + 1) / 3, 1, depth=d)
            for i, d in enumerate((0.25, 0.5, 0.75))
        ]
        with (
            device.mesh(np.concatenate(columns)) as mesh,
            device.render_pass(image, depth, clear=(0, 0, 0, 0), clear_depth=0.5),
            device.states(function),
        ):
            device.draw(device.program(Colored), mesh)
        assert_same(image.read(), compare(function, [[0.25, 0.5, 0.75]], 0.5) * 255)


def test_without_depth_write_the_stored_depth_stays(device: rhi.Device) -> None:
    assert_same(depth_after(device, rectangle(depth=0.75), clear=0.5, states=(rhi.DepthWrite.OFF,)), 0.5)


def test_without_depth_write_the_test_still_drops_fragments(device: rhi.Device) -> None:
    with device.texture(SIZE, rhi.Format.R8) as image, device.texture(SIZE, rhi.Format.D32F) as depth:
        for value, seen in ((0.25, 0), (0.75, 255)):
            with (
                device.mesh(rectangle(depth=value)) as mesh,
                device.render_pass(image, depth, clear=(0, 0, 0, 0), clear_depth=0.5),
                device.states(rhi.DepthWrite.OFF),
            ):
                device.draw(device.program(Colored), mesh)
            assert_same(image.read(), seen)


@pytest.mark.parametrize("drawn", [0.25, 0.75], ids=["nearer", "farther"])
def test_without_depth_test_every_fragment_passes_and_is_written(device: rhi.Device, drawn: float) -> None:
    assert_same(depth_after(device, rectangle(depth=drawn), clear=0.5, states=(rhi.DepthTest.OFF,)), drawn)


def test_without_depth_test_and_write_depth_stays(device: rhi.Device) -> None:
    states = (rhi.DepthTest.OFF, rhi.DepthWrite.OFF)
    assert_same(depth_after(device, rectangle(depth=0.25), clear=0.5, states=states), 0.5)


def test_without_a_depth_target_nothing_is_tested(device: rhi.Device) -> None:
    assert_same(draw_once(device, SIZE, rhi.Format.R8, rectangle(depth=0.0)), 255)


def test_depth_is_kept_between_passes(device: rhi.Device) -> None:
    with device.texture(SIZE, rhi.Format.D32F) as depth, device.mesh(rectangle(depth=0.5)) as mesh:
        with device.render_pass(depth=depth, clear_depth=0.75):
            pass
        with device.render_pass(depth=depth):
            device.draw(device.program(Colored), mesh)
        assert_same(depth.read(), 0.75)


def test_depth_is_interpolated_linearly_in_the_window(device: rhi.Device) -> None:
    ramp = rectangle(depth=0.5)
    ramp["position"][:, 2] = np.where(ramp["position"][:, 0] < 0, 0.0, 1.0)
    expected = np.broadcast_to((np.arange(8) + 0.5) / 8, (2, 8))
    assert_near(depth_after(device, ramp, size=(8, 2)), expected, 2.0**-22, "interpolation in float32")


def test_depth_is_divided_by_w(device: rhi.Device) -> None:
    rows = rectangle(depth=0.5)
    rows["position"] *= 4.0
    assert_same(depth_after(device, rows), 0.5)


# -- clipping and ranges -----------------------------------------------------------------------------------


@pytest.mark.parametrize(("depth", "drawn"), [(-0.01, False), (0.0, True), (1.0, True), (1.01, False)])
def test_depths_below_0_or_above_1_are_clipped(device: rhi.Device, depth: float, drawn: bool) -> None:
    after = depth_after(device, rectangle(depth=depth), clear=0.5, states=(rhi.DepthFunction.ALWAYS,))
    assert_same(after, depth if drawn else 0.5)


def test_a_ramp_is_clipped_where_it_leaves_the_range(device: rhi.Device) -> None:
    ramp = rectangle()
    ramp["position"][:, 2] = np.where(ramp["position"][:, 0] < 0, -0.5, 1.5)
    assert_same(draw_once(device, (8, 1), rhi.Format.R8, ramp), [[0, 0, 255, 255, 255, 255, 0, 0]])


def test_an_infinite_far_plane_can_be_drawn_to(device: rhi.Device) -> None:
    """Points at infinity are homogeneous vectors with w = 0; reversed depth maps them to exactly 0."""
    rows = rectangle(depth=0.0)
    assert_same(depth_after(device, rows, clear=0.0, states=(rhi.DepthFunction.GREATER_EQUAL,)), 0.0)


def test_the_part_of_a_triangle_behind_the_camera_is_clipped(device: rhi.Device) -> None:
    """One corner has w < 0. Only the part in front of the camera is drawn, not a mirrored triangle."""
    rows = corners([(-1, -1, 0.5, 1), (1, -1, 0.5, 1), (0, 2, -0.5, -1)])
    seen = draw_once(device, (8, 8), rhi.Format.R8, rows, rhi.CullMode.NONE)
    # Homogeneous edge functions: a texel is inside where all three weights and the sum of them, which is
    # 1/w there, are positive.
    x, y = np.meshgrid((np.arange(8) + 0.5) / 4 - 1, 1 - (np.arange(8) + 0.5) / 4)
    matrix = rows["position"].astype(np.float64)[:, [0, 1, 3]].T
    weights = np.stack([x, y, np.ones((8, 8))], axis=-1) @ np.linalg.inv(matrix).T
    inside = (weights > 0).all(axis=-1)
    assert inside.any()
    assert_same(seen, np.where(inside, 255, 0))


@pytest.mark.parametrize(("near", "far"), [(0.0, 1.0), (0.25, 0.5), (1.0, 0.0), (0.5, 0.5)])
def test_a_viewport_maps_depth_into_its_range(device: rhi.Device, near: float, far: float) -> None:
    viewport = rhi.Viewport(0, 0, *SIZE, near, far)
    after = depth_after(device, rectangle(depth=0.25), states=(rhi.DepthFunction.ALWAYS, viewport))
    assert_near(after, near + 0.25 * (far - near), 2.0**-23, "a multiplication in float32")


# -- biases ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("format", [rhi.Format.D16, rhi.Format.D24S8, rhi.Format.D32F], ids=lambda f: f.name)
def test_a_depth_bias_is_counted_in_steps_of_the_format(device: rhi.Device, format: rhi.Format) -> None:
    """The unit of a bias is the smallest difference in depth that is certain to be distinguished: one or two
    steps of the format."""
    require_format(device, format)
    step = 2.0 ** -BITS[format]
    plain = depth_after(device, rectangle(depth=0.6), format=format)
    for units in (16.0, 160.0, -16.0, -160.0):
        biased = depth_after(device, rectangle(depth=0.6), states=(rhi.DepthBias(units),), format=format)
        assert_near(biased - plain, 1.5 * units * step, (0.5 * abs(units) + 1.1) * step, "one or two steps")


def test_a_positive_bias_is_nearer_under_reversed_depth(device: rhi.Device) -> None:
    """Coplanar geometry passes the depth test with a bias, and fails it without."""
    with device.texture(SIZE, rhi.Format.R8) as image, device.texture(SIZE, rhi.Format.D24S8) as depth:
        for units, seen in ((0.0, 0), (32.0, 255), (-32.0, 0)):
            with (
                device.mesh(rectangle(depth=0.5, color=(0, 0, 0, 0))) as below,
                device.mesh(rectangle(depth=0.5)) as above,
                device.render_pass(image, depth, clear=(0, 0, 0, 0), clear_depth=0.0),
            ):
                device.draw(device.program(Colored), below)
                with device.states(rhi.DepthBias(units)):
                    device.draw(device.program(Colored), above)
            assert_same(image.read(), seen)


@pytest.mark.parametrize("slope", [1.0, 2.0, -1.0])
def test_a_polygon_offset_is_counted_in_the_polygon_s_slope(device: rhi.Device, slope: float) -> None:
    ramp = rectangle()
    ramp["position"][:, 2] = np.where(ramp["position"][:, 0] < 0, 0.25, 0.75)
    plain = depth_after(device, ramp, size=(8, 4))
    offset = depth_after(device, ramp, size=(8, 4), states=(rhi.PolygonOffset(slope),))
    assert_near(offset - plain, slope * 0.5 / 8, 2.0**-20, "slopes are computed in float32")


def test_a_polygon_offset_does_not_move_triangles_that_face_the_camera(device: rhi.Device) -> None:
    assert_near(
        depth_after(device, rectangle(depth=0.5), states=(rhi.PolygonOffset(4.0),)), 0.5, 2.0**-22, "float32"
    )


@pytest.mark.requires("depth_bias_clamp")
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_polygon_offset_is_kept_within_its_clamp(device: rhi.Device, sign: float) -> None:
    ramp = rectangle()
    ramp["position"][:, 2] = np.where(ramp["position"][:, 0] < 0, 0.25, 0.75)
    plain = depth_after(device, ramp, size=(8, 4))
    offset = depth_after(device, ramp, size=(8, 4), states=(rhi.PolygonOffset(4.0 * sign, 0.01 * sign),))
    assert_near(offset - plain, 0.01 * sign, 2.0**-20, "slopes are computed in float32")


@pytest.mark.parametrize(
    ("function", "units", "end"),
    [(rhi.DepthFunction.LESS_EQUAL, 1e9, 1.0), (rhi.DepthFunction.GREATER_EQUAL, -1e9, 0.0)],
    ids=["standard", "reversed"],
)
@pytest.mark.parametrize("format", [rhi.Format.D16, rhi.Format.D24S8, rhi.Format.D32F], ids=lambda f: f.name)
def test_depth_that_a_bias_moves_beyond_the_range_is_its_end(
    device: rhi.Device, format: rhi.Format, function: rhi.DepthFunction, units: float, end: float
) -> None:
    """A depth that is biased beyond the range is clamped to its end: it passes a test for equality with the
    end."""
    require_format(device, format)
    with (
        device.texture(SIZE, rhi.Format.R8) as image,
        device.texture(SIZE, format) as depth,
        device.mesh(rectangle()) as mesh,
    ):
        for stored, seen in ((end, 255), (0.5 + (end - 0.5) / 2, 0)):
            with device.render_pass(image, depth, clear=(0, 0, 0, 0), clear_depth=stored):
                with device.states(function, rhi.DepthBias(units)):
                    device.draw(device.program(Colored), mesh)
            assert_same(image.read(), seen)


def test_lines_and_points_are_not_offset(device: rhi.Device) -> None:
    rows = rectangle(depth=0.5)
    stored = draw_once(
        device, SIZE, rhi.Format.D24S8, rows, rhi.DepthBias(1000.0), primitive=rhi.Primitive.POINTS
    )
    assert_near(stored[stored > 0], 0.5, 2.0**-23, "24 bits of depth")


class Elsewhere(Positions):
    """Has the positions of `Colored`, but other varyings and another fragment stage."""

    def fragment(self) -> vec4:
        return vec4(0.25)


def test_two_programs_with_the_same_positions_give_the_same_depth(device: rhi.Device) -> None:
    """The basis of a depth pre-pass: in the second pass EQUAL holds everywhere."""
    rng = np.random.default_rng(3)
    rows = corners(rng.uniform(-1, 1, (60, 3)) * (1, 1, 0.5) + (0, 0, 0.5))
    rows["position"] *= rng.uniform(0.5, 4, (60, 1)).astype("f4")
    size = (64, 64)
    with (
        device.texture(size, rhi.Format.R32F) as first,
        device.texture(size, rhi.Format.R32F) as second,
        device.texture(size, rhi.Format.D32F) as depth,
        device.mesh(rows) as mesh,
    ):
        with device.render_pass(first, depth, clear_depth=0.0), device.states(rhi.CullMode.NONE):
            device.draw(device.program(Colored), mesh)
        with (
            device.render_pass(second, depth, clear=(0, 0, 0, 0)),
            device.states(rhi.CullMode.NONE, rhi.DepthFunction.EQUAL, rhi.DepthWrite.OFF),
        ):
            device.draw(device.program(Elsewhere), mesh)
        covered = first.read() > 0
        assert covered.sum() > 1000
        assert_same(second.read() > 0, covered)


@pytest.mark.parametrize("nearest", [0.05, -0.5], ids=["whole", "clipped"])
@pytest.mark.parametrize("window", [(3, 2), (23, 17), (70, 64)], ids=str)
def test_the_same_triangle_has_the_same_depth_whatever_the_scissor(
    device: rhi.Device, nearest: float, window: tuple[int, int]
) -> None:
    """OpenGL 4.5, appendix A, rule 2: geometry drawn scissor by scissor passes EQUAL against the depth of one
    draw of the whole."""
    size = (90, 70)
    rng = np.random.default_rng(0)
    positions = np.ones((30, 4))
    positions[:, :2] = rng.uniform(-1.5, 1.5, (30, 2))
    positions[:, 2] = rng.uniform(nearest, 0.95, 30)
    positions *= rng.uniform(1, 3, (30, 1))
    program = device.program(Colored)
    with (
        device.texture(size, rhi.Format.RGBA8) as image,
        device.texture(size, rhi.Format.D32F) as depth,
        device.mesh(corners(positions)) as mesh,
        device.states(rhi.CullMode.NONE),
    ):
        with (
            device.render_pass(image, depth, clear=(0, 0, 0, 0), clear_depth=0),
            device.states(rhi.ColorWrite.OFF),
        ):
            device.draw(program, mesh)
        width, height = window
        with device.render_pass(image, depth), device.states(rhi.DepthFunction.EQUAL, rhi.DepthWrite.OFF):
            for x in range(0, size[0], width):
                for y in range(0, size[1], height):
                    with device.states(rhi.Scissor(x, y, min(width, size[0] - x), min(height, size[1] - y))):
                        device.draw(program, mesh)
        assert_mask(image.read()[..., 0], depth.read() > 0)
