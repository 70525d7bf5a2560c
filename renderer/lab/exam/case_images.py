"""Images of a case side by side: frames as they are, errors as brightness."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.lab.exam.case import CaseImage
from rhi.math.indexing import repeat_each

_MIN_WIDTH: Final = 256  # pixels of height, so that single ones can be seen
_GAP: Final = 4


def join_images(images: Mapping[str, CaseImage]) -> NDArray[np.uint8]:
    """Join images in a row, (height, width, 4) uint8, each enlarged by an integer factor."""
    images_to_join = [
        _enlarge(errors_to_image(image) if image.dtype != np.uint8 else image) for image in images.values()
    ]
    height = max(len(image) for image in images_to_join)
    row: list[NDArray[Any]] = []
    for image in images_to_join:
        padded = np.full((height, image.shape[1] + _GAP, 4), 255, np.uint8)
        padded[: len(image), : image.shape[1]] = image
        row.append(padded)
    return np.concatenate(row, axis=1)[:, :-_GAP]


def errors_to_image(errors: NDArray[Any]) -> NDArray[np.uint8]:
    """Errors (height, width) as an image: black is none, white the largest, by their cube roots; NaN and
    infinity are red."""
    is_finite = np.isfinite(errors)
    sizes = np.where(is_finite, np.abs(errors), 0.0).astype(np.float64)
    max_size = float(sizes.max(initial=0.0))
    shares = np.cbrt(sizes / max_size) if max_size else sizes
    image = repeat_each(np.round(255.0 * shares).astype(np.uint8)[..., None], 4, axis=2)
    image[~is_finite] = (255, 0, 0, 255)
    image[..., 3] = 255
    return image


def _enlarge(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    times = max(1, -(-_MIN_WIDTH // len(image)))
    return image.repeat(times, axis=0).repeat(times, axis=1)
