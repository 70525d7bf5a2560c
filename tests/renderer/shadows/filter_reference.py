"""The filters of shadow maps once more, in NumPy and float64, written from docs/shadows.md."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from renderer.shadows import ShadowFilter
from renderer.shadows.filters import DISC

Floats = NDArray[np.float64]


def lit_fraction(
    filter: ShadowFilter, depths: Floats, at: Floats, depth: Floats, slope: Floats, tile: tuple[int, int, int]
) -> tuple[Floats, Floats]:
    """Return the lit share (n,) of points, and how near (n,) a texel's depth is to being neither lit nor in
    shadow.

    Args:
        depths: (height, width), those of the atlas.
        at: (n, 2) places.
        depth: (n,).
        slope: (n, 2).
        tile: x, y, size.
    """
    texels, weights = _list_texels(filter, at)
    corner, size = np.array(tile[:2]), tile[2]
    if filter is ShadowFilter.HARDWARE:
        at_inside = np.clip(at, corner + 0.5, corner + size - 0.5)
        texels, weights = _list_texels(filter, at_inside)
        clamped = np.clip(texels, corner, corner + size - 1)
        ahead = ((texels + 0.5 - at_inside) * slope).sum(-1).max(0)
        plane = depth + ((at_inside - at) * slope).sum(-1) + ahead
        plane = np.clip(plane, 0.0, 1.0) + np.zeros(weights.shape)
    else:
        clamped = np.clip(texels, corner, corner + size - 1)
        plane = depth + np.abs(((clamped + 0.5 - at) * slope).sum(-1))
    stored = depths[clamped[..., 1].astype(int), clamped[..., 0].astype(int)]
    return (weights * (plane >= stored)).sum(0) / weights.sum(0), np.abs(plane - stored).min(0)


def _list_texels(filter: ShadowFilter, at: Floats) -> tuple[Floats, Floats]:
    """Return texels (k, n, 2) and their weights (k, n)."""
    if filter is ShadowFilter.HARD:
        return np.floor(at)[None], np.ones((1, len(at)))
    if filter is ShadowFilter.POISSON:
        cell = np.floor(at * 8.0)
        angle = 2 * np.pi * _fract(52.982918 * _fract(cell @ (0.06711056, 0.00583715)))
        turn = np.stack([np.cos(angle), -np.sin(angle), np.sin(angle), np.cos(angle)], 1).reshape(-1, 2, 2)
        return np.floor(at + np.stack([turn @ tap for tap in DISC])), np.ones((len(DISC), len(at)))
    width = 3.0 if filter in (ShadowFilter.SMOOTH, ShadowFilter.PCSS) else 1.0
    first = np.floor(at - width / 2)
    texels = np.stack([first + step for step in product(range(int(width) + 1), repeat=2)])
    overlap = np.minimum(texels + 1.0, at + width / 2) - np.maximum(texels, at - width / 2)
    return texels, np.maximum(overlap, 0.0).prod(-1)


def _fract(numbers: Floats) -> Floats:
    return numbers - np.floor(numbers)
