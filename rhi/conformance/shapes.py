"""Geometry for tests, in clip space: +Y up, depth 0 to 1, near 1 by default.

Rows have the fields of `shaders.Corner`: position (4) and color (4).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rhi.conformance.shaders import Corner

Rows = NDArray[Any]
WHITE = (1.0, 1.0, 1.0, 1.0)


def corners(positions: ArrayLike, color: ArrayLike = WHITE, depth: ArrayLike = 0.5) -> Rows:
    """Vertices at (n, 2), (n, 3) or (n, 4) clip positions, with one color or (n, 4) of them."""
    given = np.asarray(positions, np.float64)
    rows = np.zeros(len(given), Corner.dtype)
    rows["position"][:, 2] = depth
    rows["position"][:, 3] = 1.0
    rows["position"][:, : given.shape[1]] = given
    rows["color"] = color
    return rows


def rectangle(
    left: float = -1.0, bottom: float = -1.0, right: float = 1.0, top: float = 1.0, *,
    depth: ArrayLike = 0.5, color: ArrayLike = WHITE,
) -> Rows:  # fmt: skip
    """A rectangle as two triangles, front faces (counter-clockwise with +Y up)."""
    a, b, c, d = (left, bottom), (right, bottom), (right, top), (left, top)
    return corners([a, b, c, a, c, d], color, depth)


def texel_rectangle(
    x: float, y: float, width: float, height: float, size: Sequence[int], **more: Any
) -> Rows:
    """A rectangle in texels from the top left of a (width, height) target."""
    w, h = size
    return rectangle(2 * x / w - 1, 1 - 2 * (y + height) / h, 2 * (x + width) / w - 1, 1 - 2 * y / h, **more)


def centers(texels: ArrayLike, size: Sequence[int]) -> NDArray[np.float64]:
    """Clip positions (n, 2) of the centers of texels (n, 2) given as (x, y) from the top left."""
    return window_to_clip(np.asarray(texels, np.float64) + 0.5, size)


def window_to_clip(points: ArrayLike, size: Sequence[int]) -> NDArray[np.float64]:
    """Clip positions of window points (n, 2): x right, y down, in texels."""
    w, h = size
    return np.asarray(points, np.float64) * (2.0 / w, -2.0 / h) + (-1.0, 1.0)
