"""Primitives in the window: their corners, what they cover, and the depth and color there.

Coverage is computed in integers on the grid of 1/256 texel to which window positions are rounded. A sample on
an edge belongs to it by the top-left rule. Where a position lies so close to the middle between two points of
the grid that float32 may round it to either, edges get a margin.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from rhi import CullMode, FrontFace, Primitive, Scissor, Viewport
from rhi.conformance.programs.intervals import Float, Interval, MaskBounds
from rhi.conformance.programs.model import Part, Shape
from rhi.conformance.programs.tolerances import Tolerances
from rhi.conformance.reference import edge_functions
from rhi.conformance.shapes import window_to_clip

SUBTEXELS: Final = 256
SAMPLES: Final[dict[int, tuple[tuple[int, int], ...]]] = {
    1: ((0, 0),),
    2: ((-32, -96), (32, 96)),
    4: ((-32, -96), (96, -32), (-96, 32), (32, 96)),
    8: ((16, -48), (-16, 48), (80, 16), (-48, -80), (-80, 80), (-112, -16), (48, 112), (112, -112)),
}
"""Places of the samples, in subtexels from the texel's center."""
_TIE: Final = 0.03  # subtexels: how far float32 may move a window position of these small targets


def list_corners(primitive: Primitive, elements: list[int]) -> Iterator[tuple[int, ...]]:
    """Yield the corners of each primitive, the provoking one first."""
    count = len(elements)
    match primitive:
        case Primitive.POINTS:
            yield from ((e,) for e in elements)
        case Primitive.TRIANGLES:
            yield from (tuple(elements[i : i + 3]) for i in range(0, count - 2, 3))
        case Primitive.TRIANGLE_STRIP:
            for i in range(count - 2):
                a, b, c = elements[i : i + 3]
                yield (a, c, b) if i % 2 else (a, b, c)
        case Primitive.TRIANGLE_FAN:
            yield from ((elements[i], elements[i + 1], elements[0]) for i in range(1, count - 1))
        case Primitive.QUADS:
            for i in range(0, count - 3, 4):
                a, b, c, d = elements[i : i + 4]
                yield (a, b, c)
                yield (a, c, d)
        case _:
            raise NotImplementedError(primitive)


def clip_corners(shape: Shape, frame: tuple[int, int]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return clip positions (n, 4) and colors (n, 4) as a mesh holds them."""
    shape_corners = np.array(shape.corners, np.float64).reshape(-1, 8)
    clip = np.empty((len(shape_corners), 4))
    clip[:, :2] = window_to_clip(shape_corners[:, :2], frame)
    clip[:, 2], clip[:, 3] = shape_corners[:, 2], 1.0
    clip *= shape_corners[:, 3:4]
    return clip.astype(np.float32), shape_corners[:, 4:].astype(np.float32)


@dataclass(slots=True)
class CoveredPrimitive:
    """A primitive in the window, over the (rows, columns) of its box."""

    rows: slice
    columns: slice
    coverage_mask: MaskBounds  # (rows, columns, samples)
    depth: Interval  # before the bias; (rows, columns, samples)
    slope: float
    is_front: bool
    color: Interval  # (rows, columns, 4)
    is_polygon: bool  # a point, or cut by the view


def list_primitives(shape: Shape, part: Part) -> Iterator[tuple[tuple[int, ...], int]]:
    """Yield the corners of each primitive of a part, and its instance's number."""
    vertices = range(part.first, part.first + part.count)
    elements = list(vertices) if shape.indices is None else [shape.indices[i] for i in vertices]
    for instance in range(part.instances):
        for corners in list_corners(shape.primitive, elements):
            yield corners, part.base_instance + instance


def compute_coverage(
    states: Mapping[type, Any],
    size: tuple[int, int],
    samples: int,
    clip: NDArray[np.float32],
    colors: Float,
    tolerances: Tolerances,
    *,
    smooth: bool = False,
    spills: bool = False,
) -> CoveredPrimitive | None:
    """Samples that a primitive covers inside viewport and scissor, or None if it covers none.

    Args:
        states: the value of each state type.
        size, samples: of the pass's targets.
        clip, colors: (n, 4) of its corners.
        smooth: whether colors are interpolated; else the first one is that of all.
        spills: whether the primitive may reach a texel beyond the left and the upper edge.
    """
    view: Viewport = states[Viewport]
    left, top, wide, high = (
        (0.0, 0.0, *map(float, size))
        if view is Viewport.TARGET
        else (view.x, view.y, view.width, view.height)
    )
    exact = clip.astype(np.float64)
    ndc = exact[:, :3] / exact[:, 3:]
    x, y = left + (ndc[:, 0] + 1) / 2 * wide, top + (1 - ndc[:, 1]) / 2 * high
    z = view.near + ndc[:, 2] * (view.far - view.near)
    scissor: Scissor = states[Scissor]
    # A texel lies in the viewport if its center does. That a point reaches out of it by half a texel is
    # allowed.
    beyond = int(len(clip) == 1)
    first_x, last_x = max(0, scissor.x), min(size[0], scissor.x + scissor.width)
    first_y, last_y = max(0, scissor.y), min(size[1], scissor.y + scissor.height)
    first_x = max(first_x, int(np.ceil(left - 0.5)) - beyond)
    first_y = max(first_y, int(np.ceil(top - 0.5)) - beyond)
    last_x = min(last_x, int(np.ceil(left + wide - 0.5)) + beyond)
    last_y = min(last_y, int(np.ceil(top + high - 0.5)) + beyond)
    lawful_x, lawful_y = first_x, first_y
    if spills:
        first_x, first_y = max(0, first_x - 1), max(0, first_y - 1)
    fine = np.stack([x, y], axis=1) * SUBTEXELS
    spots = np.rint(fine).astype(np.int64)
    inside = bool(((np.abs(ndc[:, :2]) <= 1).all(axis=1) & (ndc[:, 2] >= 0) & (ndc[:, 2] <= 1)).all())
    certain = bool((np.abs(np.abs(fine - spots) - 0.5) > _TIE).all())
    margin = (0.0 if inside else tolerances.clip_margin) + (0.0 if certain else 1.0)
    # Two texels around the box, for the margin and for samples that lie off the centers.
    columns = slice(max(first_x, int(x.min()) - 2), max(first_x, min(last_x, int(x.max()) + 3)))
    rows = slice(max(first_y, int(y.min()) - 2), max(first_y, min(last_y, int(y.max()) + 3)))
    if columns.start >= columns.stop or rows.start >= rows.stop:
        return None
    at_y, at_x = np.mgrid[rows, columns].astype(np.int64) * SUBTEXELS + SUBTEXELS // 2
    offsets = np.array(SAMPLES[samples])
    sample_x, sample_y = at_x[..., None] + offsets[:, 0], at_y[..., None] + offsets[:, 1]
    if len(clip) == 1:
        if not inside:
            return None
        # A square of one texel. A sample near its edge may belong to it or not.
        away = np.maximum(np.abs(sample_x - fine[0, 0]), np.abs(sample_y - fine[0, 1]))
        near, hit = away < SUBTEXELS // 2 - 16, away < SUBTEXELS // 2 + 16
        center_x, center_y = at_x / SUBTEXELS, at_y / SUBTEXELS
        lawful = (center_x >= max(left, lawful_x)) & (center_x < left + wide)
        near &= (lawful & (center_y >= max(top, lawful_y)) & (center_y < top + high))[..., None]
        depth = Interval.of(np.full(hit.shape, z[0]))
        color = Interval.of(np.broadcast_to(colors[0], (*at_x.shape, 4)))
        return CoveredPrimitive(rows, columns, MaskBounds(near, hit), depth, -1.0, True, color, True)
    (ax, ay), (bx, by), (cx, cy) = ((int(u), int(v)) for u, v in spots)
    area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    if area == 0:
        return None
    is_front = (area < 0) == (states[FrontFace] is FrontFace.COUNTER_CLOCKWISE)
    if states[CullMode] is (CullMode.FRONT if is_front else CullMode.BACK):
        return None
    may = np.ones(sample_x.shape, bool)
    lawful = (at_x // SUBTEXELS >= lawful_x) & (at_y // SUBTEXELS >= lawful_y)
    must = may & lawful[..., None]
    for edge, owns, length in edge_functions([(ax, ay), (bx, by), (cx, cy)], sample_x, sample_y):
        if margin:
            must &= edge > margin * length
            may &= edge >= -margin * length
        else:
            hits = edge >= 0 if owns else edge > 0
            must &= hits
            may &= hits

    def weigh(px: NDArray[Any], py: NDArray[Any]) -> tuple[Float, Float, Float]:
        second = ((px - ax) * (cy - ay) - (py - ay) * (cx - ax)) / area
        third = ((bx - ax) * (py - ay) - (by - ay) * (px - ax)) / area
        return 1.0 - second - third, second, third

    weight_0, weight_1, weight_2 = weigh(sample_x.astype(np.float64), sample_y.astype(np.float64))
    grad_x = ((z[1] - z[0]) * (cy - ay) - (z[2] - z[0]) * (by - ay)) / area * SUBTEXELS
    grad_y = ((z[2] - z[0]) * (bx - ax) - (z[1] - z[0]) * (cx - ax)) / area * SUBTEXELS
    if z[0] == z[1] == z[2]:
        depth = Interval.of(np.full(must.shape, z[0])).widen(
            0.0 if inside or not tolerances.clip_margin else 4e-7
        )
    else:
        error = 4e-6 + (abs(grad_x) + abs(grad_y)) / 64
        depth = Interval.of(z[0] * weight_0 + z[1] * weight_1 + z[2] * weight_2).widen(error)
    if not ((ndc[:, 2] >= 0) & (ndc[:, 2] <= 1)).all():  # the near or far plane cuts it
        plain = Interval.of(ndc[0, 2] * weight_0 + ndc[1, 2] * weight_1 + ndc[2, 2] * weight_2)
        slack = 1e-5 + (abs(grad_x) + abs(grad_y)) / max(1e-3, abs(view.far - view.near)) / 32
        must &= (plain.low >= slack) & (plain.low <= 1 - slack)
        may &= (plain.low >= -slack) & (plain.low <= 1 + slack)
    if smooth:
        w = weigh(at_x.astype(np.float64), at_y.astype(np.float64))
        parts = [weight / exact[i, 3] for i, weight in enumerate(w)]
        whole = sum(parts)
        with np.errstate(all="ignore"):
            mean = sum(parts[i][..., None] * colors[i] for i in range(3)) / np.asarray(whole)[..., None]
        spread = np.ptp(colors, axis=0)
        mean = np.where(spread > 0, mean, colors[0])
        steep = max(abs(by - cy) + abs(bx - cx), abs(cy - ay) + abs(cx - ax), abs(ay - by) + abs(ax - bx))
        error = np.where(spread > 0, spread * (steep / abs(area) * 4 + 4e-6), 0.0)
        if np.ptp(exact[:, 3]):  # divided and multiplied by w
            error = error + 1e-6 * np.abs(colors[0])
        color = Interval.of(mean).widen(np.broadcast_to(error, mean.shape))
    else:
        color = Interval.of(np.broadcast_to(colors[0], (*at_x.shape, 4)))
    slope = max(abs(grad_x), abs(grad_y))
    return CoveredPrimitive(rows, columns, MaskBounds(must, may), depth, slope, is_front, color, not inside)
