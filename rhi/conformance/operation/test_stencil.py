"""Stencil: tests, operations, masks and references, for front and back faces."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from rhi import (
    ColorWrite,
    Comparison,
    CullMode,
    Device,
    Format,
    FrontFace,
    Mesh,
    Primitive,
    State,
    StencilBack,
    StencilFront,
    StencilOperation,
    StencilReadMask,
    StencilReference,
    StencilTest,
    StencilWriteMask,
)
from rhi.conformance.compare import assert_same
from rhi.conformance.reference import compare, stencil
from rhi.conformance.shaders import Colored, Shade, Shaded
from rhi.conformance.shapes import VertexRows, rectangle
from rhi.shading import discard, fragment_coordinate, vec4

pytestmark = pytest.mark.requires("draws", "shading", "stencil")

SIZE = (2, 2)
KEEP, REPLACE = StencilOperation.KEEP, StencilOperation.REPLACE


def after(
    device: Device,
    *states: State,
    stored: int,
    rows: VertexRows | None = None,
    depth: float = 0.0,
    primitive: Primitive = Primitive.TRIANGLES,
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return color and stencil after one draw over a cleared buffer."""
    rows = rectangle() if rows is None else rows
    with (
        device.texture(SIZE, Format.R8) as image,
        device.texture(SIZE, Format.D24S8) as target,
        device.mesh(rows, primitive=primitive) as mesh,
    ):
        with (
            device.render_pass(image, target, clear=(0, 0, 0, 0), clear_depth=depth, clear_stencil=stored),
            device.states(CullMode.NONE, StencilTest.ON, *states),
        ):
            device.draw(device.program(Colored), mesh)
        return image.read(), target.read_stencil()


@pytest.mark.parametrize("function", list(Comparison), ids=lambda f: f.name)
def test_a_stencil_function_compares_reference_with_stored(device: Device, function: Comparison) -> None:
    for reference in (99, 100, 101):
        color, _ = after(device, StencilFront(function), StencilReference(reference, reference), stored=100)
        assert_same(color, 255 if compare(function, reference, 100) else 0)


@pytest.mark.parametrize("operation", list(StencilOperation), ids=lambda f: f.name)
@pytest.mark.parametrize("stored", [0, 1, 100, 254, 255])
def test_each_stencil_operation_computes_the_stored_value(
    device: Device, operation: StencilOperation, stored: int
) -> None:
    _, value = after(device, StencilFront(both_pass=operation), StencilReference(77, 77), stored=stored)
    assert_same(value, stencil(operation, stored, 77))


@pytest.mark.parametrize(
    ("function", "depth", "expected"),
    [
        (Comparison.NEVER, 0.0, 1),
        (Comparison.NEVER, 1.0, 1),
        (Comparison.ALWAYS, 1.0, 0),
        (Comparison.ALWAYS, 0.0, 255),
    ],
    ids=["stencil fails", "both fail", "depth fails", "both pass"],
)
def test_each_outcome_has_its_own_operation(
    device: Device, function: Comparison, depth: float, expected: int
) -> None:
    front = StencilFront(function, StencilOperation.REPLACE, StencilOperation.ZERO, StencilOperation.INVERT)
    color, value = after(
        device, front, StencilReference(1, 1), stored=0 if expected == 255 else 5, depth=depth
    )
    assert_same(value, expected)
    assert_same(color, 255 if expected == 255 else 0)


def test_when_stencil_is_off_nothing_is_tested_or_written(device: Device, mesh: Mesh) -> None:
    with device.texture(SIZE, Format.R8) as image, device.texture(SIZE, Format.D24S8) as target:
        with (
            device.render_pass(image, target, clear=(0, 0, 0, 0), clear_depth=0.0, clear_stencil=9),
            device.states(StencilFront(Comparison.NEVER, REPLACE, REPLACE, REPLACE), StencilReference(3, 3)),
        ):
            device.draw(device.program(Colored), mesh)
        assert_same(image.read(), 255)
        assert_same(target.read_stencil(), 9)


@pytest.mark.parametrize(("mask", "passes"), [(0xFF, False), (0x0F, True), (0x1F, False), (0x00, True)])
def test_the_read_mask_applies_to_both_sides(device: Device, mask: int, passes: bool) -> None:
    states = (StencilFront(Comparison.EQUAL), StencilReference(0x35, 0x35), StencilReadMask(mask, mask))
    color, _ = after(device, *states, stored=0x25)
    assert_same(color, 255 if passes else 0)


@pytest.mark.parametrize("operation", list(StencilOperation), ids=lambda f: f.name)
def test_the_write_mask_chooses_the_bits_that_change(device: Device, operation: StencilOperation) -> None:
    states = (StencilFront(both_pass=operation), StencilReference(0xC3, 0xC3), StencilWriteMask(0x5A, 0x5A))
    _, value = after(device, *states, stored=0xFF)
    assert_same(value, stencil(operation, 0xFF, 0xC3, 0x5A))


def test_the_read_mask_does_not_touch_writes(device: Device) -> None:
    states = (StencilFront(both_pass=REPLACE), StencilReference(0xC3, 0xC3), StencilReadMask(0x0F, 0x0F))
    _, value = after(device, *states, stored=0)
    assert_same(value, 0xC3)


def test_stencil_clears_ignore_the_write_mask(device: Device) -> None:
    with device.texture(SIZE, Format.D24S8) as target:
        with device.states(StencilWriteMask(0, 0)), device.render_pass(depth=target, clear_stencil=0xAB):
            pass
        assert_same(target.read_stencil(), 0xAB)


BOTH_SIDES = (
    StencilFront(both_pass=StencilOperation.INCREMENT),
    StencilBack(both_pass=StencilOperation.DECREMENT),
)


@pytest.mark.parametrize("front_face", list(FrontFace), ids=lambda f: f.name)
def test_back_faces_have_operations_of_their_own(device: Device, front_face: FrontFace) -> None:
    front = 1 if front_face is FrontFace.COUNTER_CLOCKWISE else -1
    _, value = after(device, front_face, *BOTH_SIDES, stored=10)
    assert_same(value, 10 + front)
    _, value = after(device, front_face, *BOTH_SIDES, stored=10, rows=rectangle()[::-1])
    assert_same(value, 10 - front)


def test_back_faces_have_a_function_of_their_own(device: Device) -> None:
    states = (StencilFront(Comparison.NEVER), StencilBack(Comparison.EQUAL), StencilReference(0x31, 0x31))
    color, _ = after(device, *states, stored=0x31, rows=rectangle()[::-1])
    assert_same(color, 255)
    color, _ = after(device, *states, stored=0x31)
    assert_same(color, 0)


@pytest.mark.requires("stencil_per_face")
def test_back_faces_have_a_reference_and_masks_of_their_own(device: Device) -> None:
    states = (
        StencilFront(Comparison.NEVER),
        StencilBack(Comparison.EQUAL, both_pass=REPLACE),
        StencilReference(0, 0x31),
        StencilReadMask(0xFF, 0x0F),
        StencilWriteMask(0, 0xF0),
    )
    color, value = after(device, *states, stored=0x21, rows=rectangle()[::-1])
    assert_same(color, 255)
    assert_same(value, 0x31)
    color, value = after(device, *states, stored=0x21)
    assert_same(color, 0)
    assert_same(value, 0x21)


def test_points_count_as_front_faces(device: Device) -> None:
    rows = rectangle(-0.5, -0.5, 0.5, 0.5)
    _, value = after(device, *BOTH_SIDES, stored=10, rows=rows[[0, 1, 2, 5]], primitive=Primitive.POINTS)
    assert_same(value, 11)


def test_stencil_counts_overdraw(device: Device) -> None:
    rows = np.concatenate([rectangle(-1, -1, 0, 1), rectangle(), rectangle()])
    _, value = after(
        device,
        StencilFront(both_pass=StencilOperation.INCREMENT),
        ColorWrite.OFF,
        stored=0,
        rows=rows,
        depth=0.0,
    )
    assert_same(value, [[1, 1], [1, 1]])  # of equal depths, only the first one passes the depth test


def test_draws_through_a_stencil_mask_are_cut_to_its_shape(device: Device) -> None:
    with (
        device.texture((4, 4), Format.R8) as image,
        device.texture((4, 4), Format.D24S8) as target,
        device.mesh(rectangle(-1, 0, 0, 1)) as mask,
        device.mesh(rectangle(depth=0.75)) as whole,
    ):
        with (
            device.render_pass(image, target, clear=(0, 0, 0, 0), clear_depth=0.0, clear_stencil=0),
            device.states(StencilTest.ON, StencilReference(1, 1)),
        ):
            with device.states(StencilFront(both_pass=REPLACE), ColorWrite.OFF):
                device.draw(device.program(Colored), mask)
            with device.states(StencilFront(Comparison.EQUAL)):
                device.draw(device.program(Colored), whole)
        expected = np.zeros((4, 4))
        expected[:2, :2] = 255
        assert_same(image.read(), expected)


class Checkered(Shaded):
    """Discards every other fragment of a row."""

    def fragment(self, v: Shade) -> vec4:
        if int(fragment_coordinate().x) % 2 == 1:
            discard()
        return v.color


@pytest.mark.parametrize(
    ("stored", "reference", "depth"),
    [(5, 6, 0.0), (5, 5, 1.0), (5, 5, 0.0)],
    ids=["stencil fails", "depth fails", "both pass"],
)
def test_a_discarded_fragment_changes_no_stencil_whatever_the_tests_say(
    device: Device, stored: int, reference: int, depth: float, mesh: Mesh
) -> None:
    front = StencilFront(
        Comparison.EQUAL, StencilOperation.INVERT, StencilOperation.INVERT, StencilOperation.INVERT
    )
    with device.texture((4, 2), Format.R8) as image, device.texture((4, 2), Format.D24S8) as target:
        with (
            device.render_pass(image, target, clear=(0, 0, 0, 0), clear_depth=depth, clear_stencil=stored),
            device.states(StencilTest.ON, front, StencilReference(reference, reference)),
        ):
            device.draw(device.program(Checkered), mesh)
        covered = np.arange(4) % 2 == 0
        assert_same(target.read_stencil(), np.broadcast_to(np.where(covered, ~stored & 255, stored), (2, 4)))
        passes = stored == reference and depth == 0.0
        assert_same(image.read(), np.broadcast_to(np.where(covered & passes, 255, 0), (2, 4)))
