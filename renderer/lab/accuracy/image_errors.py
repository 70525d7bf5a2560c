"""The errors of images that a sweep compares: flicker, FLIP, the worst region, distances and reached lights."""

from __future__ import annotations

import io
from base64 import b64encode
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.scene import Camera, Orthographic, Perspective, Scene
from renderer.scene.arrays import Floats

_CROP: Final = (112, 63)
"""Width and height of the crop around the worst pixel of an image."""


def distances_from_depth(camera: Camera, depth: Floats) -> Floats:
    """The distances from the eye's plane, computed back from depths."""
    projection = camera.projection
    assert isinstance(projection, Perspective | Orthographic)
    matrix = projection.matrix
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray((matrix[2, 3] - depth * matrix[3, 3]) / (matrix[2, 2] - depth * matrix[3, 2]))


def count_reached(scene: Scene, camera: Camera, positions: Floats) -> int:
    """The number of pairs of a position (k, 3), relative to the eye, and a local light whose range and cone
    contain it."""
    total = 0
    for lights in (scene.lights.point, scene.lights.spot):
        for light in lights:
            away = positions - (light["position"] - camera.position)
            squares = np.einsum("ij,ij->i", away, away)
            reached = squares <= float(light["range"]) ** 2
            if lights is scene.lights.spot:
                reached &= away @ light["direction"] >= np.cos(float(light["outer"])) * np.sqrt(squares)
            total += int(np.count_nonzero(reached))
    return total


def compute_flicker(before: Floats, after: Floats) -> float:
    """The mean change of a pixel's error from one frame to the next, in levels: how much more or less an image
    changes than its reference.

    It is the temporal loss of Chaitanya and others, Interactive Reconstruction of Monte Carlo Image Sequences
    using a Recurrent Denoising Autoencoder, 2017, of the worst channel.

    Args:
        before, after: images minus their references (h, w, 3) in levels; NaN in pixels that don't count.
    """
    change = np.abs(after - before).max(axis=2)
    return float(np.nanmean(change)) if np.isfinite(change).any() else 0.0


def compute_flip_error(reference: Floats, rendered: Floats) -> float | None:
    """The mean FLIP error of an image, 0 to 1: how visible the difference is when switching between image and
    reference, at 67 pixels a degree (Andersson and others, FLIP: A Difference Evaluator for Alternating
    Images, 2020). None without `flip-evaluator`. Images: (h, w, 3), levels of 255."""
    try:
        import flip_evaluator
    except ImportError:
        return None
    images = [np.clip(image / 255.0, 0.0, 1.0).astype(np.float32) for image in (reference, rendered)]
    return float(flip_evaluator.evaluate(*images, "LDR", applyMagma=False)[1])


def crop_worst_region(reference: Floats, rendered: Floats, x: int, y: int) -> str:
    """The region around a pixel as PNG in base64: the reference, the value's image, and four times the
    difference."""
    (width, height), (rows, columns) = _CROP, reference.shape[:2]
    left = min(max(x - width // 2, 0), max(columns - width, 0))
    top = min(max(y - height // 2, 0), max(rows - height, 0))
    part = slice(top, top + height), slice(left, left + width)
    difference = np.abs(rendered[part] - reference[part]).max(axis=2, keepdims=True).repeat(3, axis=2)
    panels: NDArray[Any] = np.concatenate([reference[part], rendered[part], 4.0 * difference], axis=1)
    file = io.BytesIO()
    from PIL import Image  # optional

    Image.fromarray(np.clip(np.round(panels), 0, 255).astype(np.uint8)).save(file, "PNG", optimize=True)
    return b64encode(file.getvalue()).decode()
