"""Bloom once more, in NumPy and float64, written from docs/effects.md: what shaders must show."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def halve(image: Floats, *, karis_average: bool = False) -> Floats:
    """Return an image (h, w, 3) of half the size, rounded up: of 6 × 6 texels, half of the mean of the 4 × 4
    in the middle, and an eighth of that of each 4 × 4 at a corner."""
    height, width = -(-image.shape[0] // 2), -(-image.shape[1] // 2)
    rows = np.clip(2 * np.arange(height)[:, None] + np.arange(-2, 4), 0, image.shape[0] - 1)
    columns = np.clip(2 * np.arange(width)[:, None] + np.arange(-2, 4), 0, image.shape[1] - 1)
    texels = image[rows[:, None, :, None], columns[None, :, None, :]]  # (h, w, 6, 6, 3)
    boxes = [(1, 1, 0.5), (0, 0, 0.125), (0, 2, 0.125), (2, 0, 0.125), (2, 2, 0.125)]
    result, total = np.zeros((height, width, 3)), np.zeros((height, width, 1))
    for y, x, share in boxes:
        mean = texels[:, :, y : y + 4, x : x + 4].mean(axis=(2, 3))
        weight = share / (1.0 + mean @ (0.2126, 0.7152, 0.0722))[..., None] if karis_average else share
        result, total = result + weight * mean, total + weight
    return np.asarray(result / total)


def spread(level: Floats, size: tuple[int, int]) -> Floats:
    """Return a level spread over an image of twice its size, `size` (height, width): a tent of 3 × 3 bilinear
    samples, along one axis after the other."""
    for axis, count in enumerate(size):
        position = (np.arange(count) + 0.5) / 2.0 - 0.5
        first = np.floor(position).astype(int)
        part = (position - first).reshape(-1, *(1,) * (2 - axis))
        total = np.zeros(1)
        for offset, weight in ((-1, 0.25), (0, 0.5), (1, 0.25)):
            near, far = (
                np.take(level, np.clip(first + offset + step, 0, level.shape[axis] - 1), axis)
                for step in (0, 1)
            )
            total = total + weight * (near * (1 - part) + far * part)
        level = total
    return level


def add_bloom(light: Floats, share: float, count: int, *, karis_average: bool = False) -> Floats:
    """Return light (h, w, 3) of which a share is scattered: the mean of `count` copies, each spread twice as
    far."""
    clean = np.where(np.isfinite(light).all(axis=2, keepdims=True), light, 0.0)
    levels = [halve(clean, karis_average=karis_average)]
    while len(levels) < count:
        levels.append(halve(levels[-1]))
    bloom = levels[-1]
    for n, level in enumerate(reversed(levels[:-1]), 2):
        bloom = (level + (n - 1) * spread(bloom, level.shape[:2])) / n
    height, width, _ = light.shape
    return (1.0 - share) * clean + share * spread(bloom, (height, width))
