"""Tone mapping, from the light of a scene to the colours of an image, and its inverse for colours that a
scene states as they appear.

The curve is Narkowicz's fit of the ACES filmic curve (2016): (x (a x + b)) / (x (c x + d) + e), where x is
the light times the exposure.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Final

import numpy as np

from rhi.shading import function, min, saturate, vec3

Color = tuple[float, float, float]

_EXPOSURE: Final = 0.6
_A: Final = 2.51
_B: Final = 0.03
_C: Final = 2.43
_D: Final = 0.59
_E: Final = 0.14


@function
def tone_map(color: vec3) -> vec3:
    """Map linear light of any strength to linear colours from 0 to 1."""
    color = min(color * _EXPOSURE, 1e4)  # 1e4 is far beyond white, and can be squared
    return saturate((color * (_A * color + _B)) / (color * (_C * color + _D) + _E))


@lru_cache
def inverse_tone_map(color: Color) -> Color:
    """Light that `tone_map` maps to a linear colour (3,) from 0 to 1; that of white is 12.07."""
    y = np.clip(np.asarray(color, np.float64), 0.0, 1.0)
    # x (a x + b) = y (x (c x + d) + e) is solved for x.
    square, linear, constant = _A - _C * y, _B - _D * y, -_E * y
    x = (-linear + np.sqrt(linear * linear - 4.0 * square * constant)) / (2.0 * square)
    red, green, blue = (x / _EXPOSURE).tolist()
    return red, green, blue
