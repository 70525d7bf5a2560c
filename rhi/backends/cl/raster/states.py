"""Render states as the `VIEW_STRUCT` of a draw: viewport, scissor, culling, depth bias,
line width, and the output merger's words.

Window y counts from the top. So the scale of y is negative, and a triangle that is counter-clockwise with +Y up has a
negative area.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from rhi.backends.cl.raster.merger import make_state
from rhi.backends.cl.raster.tables import VIEW_STRUCT
from rhi.contract.formats import Format
from rhi.contract.states import CullMode, DepthBias, FrontFace, LineWidth, PolygonOffset, Scissor, Viewport

__rhi_internal__ = True

_FAR: Final = 1 << 20


def make_view(
    values: Mapping[type, Any], size: tuple[int, int], colors: Sequence[Format], depth: Format | None
) -> NDArray[Any]:
    """Return a `VIEW_STRUCT`, shape ().

    Args:
        values: the value of each state type; a tuple of `MAX_TARGETS` for those of `PER_TARGET`.
        size: (width, height) of the pass.
        colors, depth: the formats of the pass's targets.
    """
    view = np.zeros((), VIEW_STRUCT)
    viewport, scissor = values[Viewport], values[Scissor]
    x, y, width, height = _place(viewport, size)
    view["scale"] = width / 2, -height / 2, viewport.far - viewport.near, 0
    view["shift"] = x + width / 2, y + height / 2, viewport.near, 0
    left, top, right, bottom = _find_box(viewport, size)
    view["box"] = (
        max(scissor.x, left),
        max(scissor.y, top),
        min(scissor.x + scissor.width - 1, right),
        min(scissor.y + scissor.height - 1, bottom),
    )
    front = values[FrontFace] is FrontFace.CLOCKWISE
    view["front"] = front
    if values[CullMode] is not CullMode.NONE:
        view["culled"] = 1 if (values[CullMode] is CullMode.FRONT) is front else 2
    offset = values[PolygonOffset]
    view["bias_units"], view["bias_slope"] = values[DepthBias].units, offset.slope
    view["bias_clamp"] = offset.clamp
    view["line_width"] = math.floor(values[LineWidth].width + 0.5)
    if depth is not None and depth.depth_steps:
        view["bias_step"] = 1 / depth.depth_steps
    view["state"] = make_state(values, colors)
    return view


def cut_views(view: bytes, viewport: Viewport, size: tuple[int, int], clips: NDArray[np.int64]) -> list[bytes]:
    """Return a `VIEW_STRUCT` for each of some scissors (n, 4): x, y, width and height; `view` is that of another."""
    views = np.frombuffer(view * len(clips), np.uint8).reshape(len(clips), -1).copy()
    at, width = VIEW_STRUCT.fields["box"][1], 16  # type: ignore[index]
    boxes = views[:, at : at + width].view(np.int32)
    box = np.array(_find_box(viewport, size))
    boxes[:, :2] = np.maximum(clips[:, :2], box[:2])
    boxes[:, 2:] = np.minimum(clips[:, :2] + clips[:, 2:] - 1, box[2:])
    cut, step = views.tobytes(), views.shape[1]
    return [cut[begin : begin + step] for begin in range(0, len(cut), step)]


def _place(viewport: Viewport, size: tuple[int, int]) -> tuple[float, float, float, float]:
    if viewport is Viewport.TARGET:
        return viewport.x, viewport.y, *size
    return viewport.x, viewport.y, viewport.width, viewport.height


def _find_box(viewport: Viewport, size: tuple[int, int]) -> tuple[int, int, int, int]:
    """Return the first and the last column and row of texels in a viewport: a texel is in it if its centre is."""
    x, y, width, height = _place(viewport, size)
    return (
        max(0, _first_centre(x)),
        max(0, _first_centre(y)),
        min(size[0], _first_centre(x + width)) - 1,
        min(size[1], _first_centre(y + height)) - 1,
    )


def _first_centre(edge: float) -> int:
    """Return the first texel whose centre lies at `edge` or beyond it."""
    return math.ceil(min(max(edge, -_FAR), _FAR) - 0.5)
