"""Materials: one structured array in std430 layout, so that it can be uploaded unchanged."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer import rules
from rhi.errors import refuse

__rhi_internal__ = True

MATERIAL: Final = np.dtype(
    [
        ("base_color", "<f4", 4),  # linear, alpha last; multiplies the texture
        ("specular_color", "<f4", 3),  # linear
        ("shininess", "<f4"),  # Blinn-Phong exponent
        ("rim_strength", "<f4"),  # Fresnel rim term: strength * (1 - n.v) ** power
        ("rim_power", "<f4"),
        ("texture", "<i4"),  # index into the scene's images, or -1
        ("emission", "<f4"),  # emitted light, as a multiple of the base colour
    ]
)
"""48 bytes: a std430 struct {vec4, vec3, float, float, float, int, float} without padding."""

ImagePixels = NDArray[np.uint8]
"""A texture's pixels: (height, width, 4), sRGB with linear alpha, top row first."""

_RANGES: Final = {
    "base_color": (0.0, 1e4),
    "specular_color": (0.0, 1e4),
    "shininess": (1.0, 1e5),
    "rim_strength": (0.0, 1e4),
    "rim_power": (0.1, 100.0),
    "emission": (0.0, 1e6),
}


def make_material(
    base_color: Sequence[float] = (0.8, 0.8, 0.8, 1.0),
    specular_color: Sequence[float] = (0.04, 0.04, 0.04),
    shininess: float = 32.0,
    rim_strength: float = 0.0,
    rim_power: float = 4.0,
    texture: int = -1,
    emission: float = 0.0,
) -> NDArray[Any]:
    """Create one material, () of `MATERIAL`; a base colour of three numbers gets alpha 1."""
    color = (*base_color, 1.0) if len(base_color) == 3 else tuple(base_color)
    values: dict[str, object] = {
        "base_color": color,
        "specular_color": tuple(specular_color),
        "shininess": shininess,
        "rim_strength": rim_strength,
        "rim_power": rim_power,
        "emission": emission,
    }
    material = np.zeros((), MATERIAL)
    for name, value in values.items():
        low, high = _RANGES[name]
        array = np.asarray(value, np.float64)
        if array.shape != MATERIAL[name].shape or not ((array >= low) & (array <= high)).all():
            refuse(rules.BAD_MATERIAL, f"make_material({name}=...)", value, f"{low:g} to {high:g}")
        material[name] = array
    if texture < -1:
        refuse(rules.BAD_MATERIAL, "make_material(texture=...)", texture, "-1 or an image's index")
    material["texture"] = texture
    return material


def check_image(image: NDArray[Any]) -> ImagePixels:
    """Return `image` as the scene keeps it; refuse arrays that aren't images."""
    if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 4 or not image.size:
        refuse(rules.BAD_IMAGE, "add_image", f"{image.dtype}, shape {image.shape}")
    return np.ascontiguousarray(image)
