"""The way back from colours of the image to light: colours that a scene gives as they are to be seen."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

Color = tuple[float, float, float]


@lru_cache
def find_light(color: Color) -> Color:
    """Return the light that `renderer.shaders.tone_map` maps to a linear colour (3,) from 0 to 1; white is 12.07."""
    y = np.clip(np.asarray(color, np.float64), 0.0, 1.0)
    # x (2.51 x + 0.03) = y (x (2.43 x + 0.59) + 0.14), where x is the light times the exposure.
    square, linear, constant = 2.51 - 2.43 * y, 0.03 - 0.59 * y, -0.14 * y
    x = (-linear + np.sqrt(linear * linear - 4.0 * square * constant)) / (2.0 * square)
    red, green, blue = (x / 0.6).tolist()
    return red, green, blue
