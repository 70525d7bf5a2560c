"""Surfaces painted with NumPy, each as three images that belong together: colour, normals, and metal with
roughness.

A surface is a height field that repeats seamlessly. Its colour and its roughness follow from the height, and
its normal map is the slope, so that light and colour agree. Images are as glTF has them: normals with +Y up
in the image, roughness in green and metal in blue.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from renderer.scene.arrays import Floats
from renderer.scene.images import ImagePixels, make_opaque

KINDS: Final = ("bricks", "planks", "tiles", "plaster", "cloth", "studs", "stone", "grooves")
"""The kinds of surfaces."""

_STEEP: Final = 6.0  # texels of height for a difference of 1


@dataclass(frozen=True, eq=False, slots=True)
class Surface:
    """The images (size, size, 4) of a surface: sRGB `color`, `normal`, `metal_roughness`, and grey
    `height`."""

    color: ImagePixels
    normal: ImagePixels
    metal_roughness: ImagePixels
    height: ImagePixels


def paint_surface(kind: str, size: int, seed: int) -> Surface:
    """Paint a surface of one of `KINDS`, almost white, to be tinted by a material's base colour."""
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    noise = _noise(rng, size)
    at = (np.arange(size) + 0.5) / size
    height = np.clip(_HEIGHTS[kind](*np.meshgrid(at, at), noise), 0.0, 1.0)
    bright = 0.5 + 0.42 * height + 0.10 * (noise - 0.5)
    rough = np.clip(0.9 - 0.45 * height + 0.25 * (noise - 0.5), 0.05, 1.0)
    metal = np.full_like(height, float(kind in ("studs", "grooves")))
    warm = np.array([1.0, 0.98, 0.94]) if kind != "grooves" else np.array([0.96, 0.98, 1.0])
    slope = [0.5 * _STEEP * (np.roll(height, 1, axis) - np.roll(height, -1, axis)) for axis in (1, 0)]
    # Rows run down the image, green runs up.
    normal = np.stack([slope[0], -slope[1], np.ones_like(height)], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    return Surface(
        make_opaque(bright[..., None] * warm),
        make_opaque(0.5 + 0.5 * normal),
        make_opaque(np.stack([np.ones_like(rough), rough, metal], axis=-1)),
        make_opaque(np.stack([height] * 3, axis=-1)),
    )


def _noise(rng: np.random.Generator, size: int) -> Floats:
    """Return seamless noise from 0 to 1: waves with amplitudes that fall with their frequency."""
    frequency = np.fft.fftfreq(size) * size
    length = np.hypot(frequency[:, None], frequency[None, :])
    waves = np.exp(2j * np.pi * rng.random((size, size))) / np.maximum(length, 1.0) ** 1.4
    waves[0, 0] = 0.0
    noise = np.fft.ifft2(waves).real
    return np.asarray((noise - noise.min()) / np.ptp(noise))


def _joints(x: Floats, y: Floats, width: float) -> Floats:
    """Return 0 in joints at whole numbers, `width` wide, and 1 between them, with slanting edges."""
    away = [np.minimum(value % 1.0, 1.0 - value % 1.0) for value in (x, y)]
    return np.asarray(np.clip(np.minimum(*away) / width - 0.5, 0.0, 1.0))


def _bricks(x: Floats, y: Floats, noise: Floats) -> Floats:
    row = np.floor(8.0 * y)
    return _joints(4.0 * x + 0.5 * (row % 2.0), 8.0 * y, 0.06) * (0.75 + 0.25 * noise)


def _planks(x: Floats, y: Floats, noise: Floats) -> Floats:
    grain = 0.5 + 0.5 * np.sin(2.0 * np.pi * (16.0 * x + 2.0 * noise))
    return _joints(4.0 * x, y, 0.05) * (0.7 + 0.2 * grain + 0.1 * noise)


def _tiles(x: Floats, y: Floats, noise: Floats) -> Floats:
    return _joints(6.0 * x, 6.0 * y, 0.05) * (0.92 + 0.08 * noise)


def _plaster(x: Floats, y: Floats, noise: Floats) -> Floats:
    return np.asarray(0.35 + 0.6 * noise)


def _cloth(x: Floats, y: Floats, noise: Floats) -> Floats:
    threads = np.sin(2.0 * np.pi * 32.0 * x) * np.sin(2.0 * np.pi * 32.0 * y)
    return np.asarray(0.5 + 0.35 * threads + 0.1 * (noise - 0.5))


def _studs(x: Floats, y: Floats, noise: Floats) -> Floats:
    away = np.hypot((6.0 * x) % 1.0 - 0.5, (6.0 * y) % 1.0 - 0.5)
    return np.asarray(0.3 + 0.6 * np.sqrt(np.clip(1.0 - (away / 0.32) ** 2, 0.0, 1.0)) + 0.1 * noise)


def _stone(x: Floats, y: Floats, noise: Floats) -> Floats:
    bent = 0.12 * (noise - 0.5)
    return _joints(3.0 * x + 3.0 * bent + 0.5 * (np.floor(3.0 * y) % 2.0), 3.0 * y, 0.08) * (
        0.6 + 0.4 * noise
    )


def _grooves(x: Floats, y: Floats, noise: Floats) -> Floats:
    return np.asarray(0.5 + 0.4 * np.sin(2.0 * np.pi * 12.0 * y) + 0.1 * noise)


_HEIGHTS: Final = {
    "bricks": _bricks,
    "planks": _planks,
    "tiles": _tiles,
    "plaster": _plaster,
    "cloth": _cloth,
    "studs": _studs,
    "stone": _stone,
    "grooves": _grooves,
}
