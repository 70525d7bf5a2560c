"""Geometry for tests, in clip space: +Y up, depth 0 to 1, near 1 by default.

Rows have the fields of `shaders.Corner`: position (4) and color (4).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rhi.conformance.shaders import Corner

VertexRows = NDArray[Any]
WHITE = (1.0, 1.0, 1.0, 1.0)


def corners(positions: ArrayLike, color: ArrayLike = WHITE, depth: ArrayLike = 0.5) -> VertexRows:
    """Return vertices at (n, 2), (n, 3) or (n, 4) clip positions, with one color or (n, 4) colors."""
    coordinates = np.asarray(positions, np.float64)
    rows = np.zeros(len(coordinates), Corner.dtype)
    rows["position"][:, 2] = depth
    rows["position"][:, 3] = 1.0
    rows["position"][:, : coordinates.shape[1]] = coordinates
    rows["color"] = color
    return rows


def rectangle(
    left: float = -1.0,
    bottom: float = -1.0,
    right: float = 1.0,
    top: float = 1.0,
    *,
    depth: ArrayLike = 0.5,
    color: ArrayLike = WHITE,
) -> VertexRows:
    """Return a rectangle as two front-facing triangles (counter-clockwise with +Y up)."""
    a, b, c, d = (left, bottom), (right, bottom), (right, top), (left, top)
    return corners([a, b, c, a, c, d], color, depth)


def texel_rectangle(
    x: float, y: float, width: float, height: float, size: Sequence[int], **more: Any
) -> VertexRows:
    """Return a rectangle given in texels from the top left of a (width, height) target."""
    w, h = size
    return rectangle(2 * x / w - 1, 1 - 2 * (y + height) / h, 2 * (x + width) / w - 1, 1 - 2 * y / h, **more)


def centers(texels: ArrayLike, size: Sequence[int]) -> NDArray[np.float64]:
    """Return the (n, 2) clip positions of texel centers; texels are (n, 2), x and y from the top left."""
    return window_to_clip(np.asarray(texels, np.float64) + 0.5, size)


def window_to_clip(points: ArrayLike, size: Sequence[int]) -> NDArray[np.float64]:
    """Return the clip positions of (n, 2) window points in texels, x to the right and y down."""
    w, h = size
    return np.asarray(points, np.float64) * (2.0 / w, -2.0 / h) + (-1.0, 1.0)


def point_vertices(
    positions: ArrayLike,
    size: Sequence[int],
    sizes: ArrayLike,
    colors: ArrayLike = (1, 1, 1, 1),
    depth: float = 0.5,
    w: float = 1.0,
) -> NDArray[Any]:
    """Return vertices of `shaders.Sized` at window positions in texels, with their sizes."""
    plane = window_to_clip(positions, size)
    rows = np.zeros(len(plane), [("position", "f4", 4), ("color", "f4", 4), ("size", "f4")])
    rows["position"][:, :2], rows["position"][:, 2:] = plane, (depth, 1.0)
    rows["position"] *= w
    rows["color"], rows["size"] = colors, sizes
    return rows


def point_square(x: float, y: float, side: float, size: Sequence[int]) -> NDArray[np.bool_]:
    """Return the texels whose centres lie in a square; its left and top edges belong to it."""
    columns, rows = np.arange(size[0]) + 0.5, np.arange(size[1])[:, None] + 0.5
    half = side / 2
    return (columns >= x - half) & (columns < x + half) & (rows >= y - half) & (rows < y + half)
