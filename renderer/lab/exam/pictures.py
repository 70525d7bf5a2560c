"""Pictures of a case side by side: frames as they are, errors as brightness."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.lab.exam.case import Picture

_LEAST: Final = 256  # pixels of height, so that single ones can be seen
_GAP: Final = 4


def join_pictures(pictures: Mapping[str, Picture]) -> NDArray[np.uint8]:
    """Return the pictures in a row, (height, width, 4) uint8, each in whole multiples of its size."""
    shown = [_enlarge(show_errors(one) if one.dtype != np.uint8 else one) for one in pictures.values()]
    height = max(len(one) for one in shown)
    row: list[NDArray[Any]] = []
    for one in shown:
        padded = np.full((height, one.shape[1] + _GAP, 4), 255, np.uint8)
        padded[: len(one), : one.shape[1]] = one
        row.append(padded)
    return np.concatenate(row, axis=1)[:, :-_GAP]


def show_errors(errors: NDArray[Any]) -> NDArray[np.uint8]:
    """Return errors (height, width) as a picture: black is none, white the largest, by their cube roots; what isn't a
    number is red."""
    known = np.isfinite(errors)
    sizes = np.where(known, np.abs(errors), 0.0).astype(np.float64)
    largest = float(sizes.max(initial=0.0))
    shares = np.cbrt(sizes / largest) if largest else sizes
    picture = np.repeat(np.round(255.0 * shares).astype(np.uint8)[..., None], 4, axis=2)
    picture[~known] = (255, 0, 0, 255)
    picture[..., 3] = 255
    return picture


def _enlarge(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    times = max(1, -(-_LEAST // len(picture)))
    return picture.repeat(times, axis=0).repeat(times, axis=1)
