"""Rectangles far from the target: scissors, clips and viewports cut what they cut in plain arithmetic.

Drivers store edges in 16 or 32 bits, so positions lie on both sides of each power of two.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from rhi import CullMode, DepthTest, Device, Format, Primitive, Scissor, Viewport
from rhi.conformance.compare import assert_mask
from rhi.conformance.shaders import Colored
from rhi.conformance.shapes import rectangle
from rhi.contract.states import MAX_VIEWPORT_OFFSET, MAX_VIEWPORT_SIZE

pytestmark = [pytest.mark.requires("draws", "shading"), pytest.mark.recorded_too]

SIZE = (12, 8)
FARTHEST = 1 << 30
CLEAR = (0.0, 0.0, 0.0, 0.0)

Box = tuple[int, int, int, int]


def list_edges(farthest: int) -> list[int]:
    """Return positions inside a target, and around each power of two and its negative."""
    near = [0, 1, 3, 7, 8, 11, 12, 13]
    far = [(1 << bits) + step for bits in range(7, 31) for step in (-1, 0, 1, 4)]
    both = {*near, *far, *(-edge for edge in near + far)}
    return sorted(edge for edge in both if abs(edge) <= farthest)


def draw_boxes(count: int, farthest: int, largest: int, seed: int) -> list[Box]:
    """Return rectangles: each has random edges of which one axis may be near, so that many touch the
    target."""
    rng = np.random.default_rng(seed)
    edges, sizes = list_edges(farthest), [size for size in list_edges(largest) if size >= 0]
    boxes = []
    for _ in range(count):
        x, y = (int(rng.choice(edges)) if rng.random() < 0.7 else int(rng.integers(-4, 8)) for _ in range(2))
        width, height = (int(rng.choice(sizes)) for _ in range(2))
        if rng.random() < 0.4:  # far to the left, and as wide as needed to reach the target
            width = min(max(0, -x) + int(rng.integers(1, 16)), largest)
            height = min(max(0, -y) + int(rng.integers(1, 16)), largest)
        boxes.append((x, y, width, height))
    return boxes


def mark(box: Box, size: tuple[int, int] = SIZE) -> NDArray[np.bool_]:
    """Return the texels of a target whose centres lie in a rectangle, (height, width)."""
    x, y, width, height = box
    columns, rows = np.arange(size[0]) + 0.5, np.arange(size[1]) + 0.5
    inside = (columns > x) & (columns < x + width), (rows > y) & (rows < y + height)
    return inside[1][:, None] & inside[0][None]


SCISSORS: list[Box] = [
    *((edge, 0, 8, 8) for edge in list_edges(FARTHEST)),
    *((0, edge, 8, 8) for edge in list_edges(FARTHEST)),
    (1 << 17, 1 << 16, 8, 8),
    (-FARTHEST, -FARTHEST, FARTHEST, FARTHEST),
    (-FARTHEST, -FARTHEST, FARTHEST, FARTHEST),
    (FARTHEST, FARTHEST, FARTHEST, FARTHEST),
    *draw_boxes(300, FARTHEST, FARTHEST, 1),
]


def show(device: Device, draw: Any, size: tuple[int, int] = SIZE) -> NDArray[np.bool_]:
    """Return the texels that a draw covers."""
    with device.texture(size, Format.RGBA8) as image:
        with device.render_pass(image, clear=CLEAR), device.states(DepthTest.OFF, CullMode.NONE):
            draw()
        return np.asarray(image.read()[..., 0] > 0)


def test_a_scissor_at_any_position_cuts_the_texels_outside(device: Device) -> None:
    """The boxes are drawn into one column of targets each, since a pass costs more than a draw."""
    program = device.program(Colored)
    with device.mesh(rectangle(-1, -1, 1, 1), primitive=Primitive.TRIANGLES) as whole:
        for box in SCISSORS:

            def draw(box: Box = box) -> None:
                with device.states(Scissor(*box)):
                    device.draw(program, whole)

            assert_mask(show(device, draw), mark(box))


@pytest.mark.parametrize("last", ["near", "far"])
def test_a_clip_at_any_position_cuts_the_texels_outside(device: Device, last: str) -> None:
    """Each clip alone, and all in one call: then the texels of any."""
    program = device.program(Colored)
    boxes = SCISSORS[:: 3 if last == "near" else 5] + ([(2, 2, 3, 3)] if last == "near" else [])
    with device.mesh(rectangle(-1, -1, 1, 1), primitive=Primitive.TRIANGLES) as whole:
        for box in boxes:
            image = show(device, lambda box=box: device.draw_clipped(program, whole, whole.draws([0]), [box]))
            assert_mask(image, mark(box))
        far = [box for box in boxes if not mark(box).all()]
        draws = whole.draws([0] * len(far))
        together = show(device, lambda: device.draw_clipped(program, whole, draws, far))
    assert_mask(together, np.any([mark(box) for box in far], axis=0))


def test_a_scissor_is_the_same_in_the_next_pass_of_another_size(device: Device) -> None:
    """It reaches as far there, although what lay outside the smaller target was cut."""
    program, sizes = device.program(Colored), [(4, 4), (40, 3), (12, 8)]
    with device.mesh(rectangle(-1, -1, 1, 1), primitive=Primitive.TRIANGLES) as whole:
        for box in ((2, 1, FARTHEST, FARTHEST), (30 - FARTHEST, 0, FARTHEST, 6), (1 << 16, 0, 8, 8)):
            with device.states(Scissor(*box)):
                for size in sizes:
                    image = show(device, lambda: device.draw(program, whole), size)
                    assert_mask(image, mark(box, size))


def list_viewports(largest: int) -> list[Box]:
    """Return viewports of at most `largest` texels a side at all offsets that the rules allow."""
    edges = list_edges(MAX_VIEWPORT_OFFSET)
    return [
        *((edge, 0, 8, 8) for edge in edges),
        *((0, edge, 8, 8) for edge in edges),
        *((edge, 1, largest, 4) for edge in edges),
        *draw_boxes(100, MAX_VIEWPORT_OFFSET, largest, 2),
    ]


def test_a_viewport_anywhere_shows_the_image_inside_it(device: Device) -> None:
    """A rectangle over all of clip space covers the texels of the viewport."""
    program = device.program(Colored)
    largest = min(MAX_VIEWPORT_SIZE, device.capabilities.max_texture_size)
    with device.mesh(rectangle(-1, -1, 1, 1), primitive=Primitive.TRIANGLES) as whole:
        for box in list_viewports(largest):

            def draw(box: Box = box) -> None:
                with device.states(Viewport(*box)):
                    device.draw(program, whole)

            assert_mask(show(device, draw), mark(box))


def test_a_draw_after_a_far_viewport_is_whole(device: Device) -> None:
    program = device.program(Colored)
    with device.mesh(rectangle(-1, -1, 1, 1), primitive=Primitive.TRIANGLES) as whole:

        def draw() -> None:
            for box in ((MAX_VIEWPORT_OFFSET, 0, 4, 4), (-MAX_VIEWPORT_OFFSET, 0, 4, 4)):
                with device.states(Viewport(*box)):
                    device.draw(program, whole)
                    device.draw_clipped(program, whole, whole.draws([0]), [(0, 0, 4, 4)])
            with device.states(Scissor(1 << 16, 0, 8, 8)):
                device.draw(program, whole)
            device.draw_clipped(program, whole, whole.draws([0]), [(3, 2, FARTHEST, 1)])

        assert_mask(show(device, draw), mark((3, 2, FARTHEST, 1)))
