"""Objects that change nothing: they cover no pixel, whatever the view.

They are left out as if they weren't in the scene: no command, no texture, no part of a shader. So are lights
that shine nothing (`Lights.without_dark`), and air that is too thin to be seen (`renderer.frame.thin_air`).
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.scene.arrays import Floats, Indices
from renderer.scene.materials import AlphaMode
from renderer.scene.objects import Objects

_ROUNDING: Final = 2.0**-15
"""By so much alpha may be below a cutoff and still count as equal to it; shaders allow half of that."""


def flag_unseen_materials(materials: NDArray[Any], max_alpha: float) -> NDArray[np.bool_]:
    """Return which materials (k,) cover nothing: blended ones of alpha 0, and masks whose alpha is below
    their cutoff.

    Args:
        max_alpha: the largest alpha of the vertices of all meshes, which multiplies that of materials.
    """
    mode, alpha = materials["alpha_mode"], materials["base_color"][:, 3].astype(np.float64)
    is_clear = (mode == AlphaMode.BLEND) & (alpha * max_alpha <= 0.0)
    is_cut = (mode == AlphaMode.MASK) & (alpha * max_alpha < materials["alpha_cutoff"] - _ROUNDING)
    return np.asarray((is_clear | is_cut) & (materials["shader"] == 0))


def flag_points(transforms: Floats) -> NDArray[np.bool_]:
    """Return which transforms (k, 4, 4) leave no area of any triangle: a scale of 0 along two axes or
    more."""
    return np.asarray(transforms[:, :3, :3].any(axis=1).sum(axis=1) <= 1)


def select_static(objects: Objects) -> Indices:
    """Return the indices of the objects that are boxes of their own node, which can't move."""
    return np.flatnonzero((objects.boxes.node == objects.node) & ~objects.dynamic & (objects.node >= 0))
