"""The arguments of this package's functions: real numbers, alone and in stacks, as float64."""

from __future__ import annotations

from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rhi.errors import Rule, refuse
from rhi.errors.array_likes import to_real, to_real_array
from rhi.errors.rules import CAMERA_VALUE, DEVICE_ARGUMENT


def read_floats(
    call: str, value: ArrayLike, *shape: int, rule: Rule = DEVICE_ARGUMENT
) -> NDArray[np.float64]:
    """Return real numbers whose last axes have these lengths, as float64. They aren't copied if they need no
    conversion.

    Raises:
        ValidationError: `rule` in the name of `call`, for other numbers and shapes.
    """
    try:
        numbers = np.asarray(to_real_array(value), np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        refuse(rule, call, value, f"real numbers: {error}")
    if shape and numbers.shape[-len(shape) :] != shape:
        refuse(rule, call, f"shape {numbers.shape}", f"shape (..., {', '.join(map(str, shape))})")
    return numbers


def read_finite(call: str, value: ArrayLike, *shape: int) -> NDArray[np.float64]:
    """Return finite real numbers of exactly this shape, as float64, of a camera or projection.

    Raises:
        ValidationError: `camera-bad-value` in the name of `call`, for other numbers and shapes.
    """
    numbers = read_floats(call, value, rule=CAMERA_VALUE)
    if numbers.shape != shape or not np.isfinite(numbers).all():
        refuse(CAMERA_VALUE, call, value, f"finite numbers of shape {shape}")
    return numbers


def check_camera(call: str, value: object, is_valid: bool, allowed: str, tip: str = "") -> None:
    """Refuse an invalid value of a camera or projection."""
    if not is_valid:
        refuse(CAMERA_VALUE, call, value, allowed, tip)


def check_real(call: str, **values: Any) -> None:
    """Refuse values of a camera or projection that aren't real numbers, before any of them is compared."""
    for name, value in values.items():
        try:
            float(to_real(value))
        except (TypeError, ValueError, OverflowError):
            refuse(CAMERA_VALUE, f"{call}({name}=...)", value, "a real number")


def check_angles(call: str, **angles: Any) -> None:
    """Refuse angles that aren't finite real numbers."""
    check_real(call, **angles)
    for name, angle in angles.items():
        if not isfinite(angle):
            refuse(CAMERA_VALUE, f"{call}({name}=...)", angle, "a finite angle in radians")
