"""Environments: the light that arrives from infinitely far away, from all directions, as an image has it.

The image is equirectangular: its rows are the polar angle from +y to -y, its columns the angle around y. Its
middle is seen along -z, and right of that is +x. Texels are linear light without an upper bound: 1 is what a
white surface reflects of a directional light of intensity 1 that falls straight on it.

A surface reflects the light L of an environment as it does that of lights, from each direction ω:

    ∫ L(ω) f(ω) cos θ dω                f = base colour / π, and the lobe of the shading model

Where a scene has an environment, it replaces the ambient light of `Lights.sky` and `Lights.ground`, and is
the background, unless it is hidden.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer import rules
from rhi.errors import refuse

_BRIGHTEST: Final = 1e8
_STRONGEST: Final = 1e6


@dataclass(frozen=True, slots=True, eq=False)
class Environment:
    """The light around a scene, the same at all of its points.

    Attributes:
        image: linear light (height, width, 3), float32, at most 10⁸, read-only; a fourth channel is left out.
        intensity: multiplies the light, 0 to 10⁶.
        turn: the angle about +y by which the image is turned, in radians; the light from -z comes from -x at
            a quarter turn.
        is_visible: whether the environment is seen as the background; otherwise it only gives light.
    """

    image: NDArray[Any]
    intensity: float = 1.0
    turn: float = 0.0
    is_visible: bool = True

    def __post_init__(self) -> None:
        """Check the values, and copy the image.

        Raises:
            ValidationError: `scene-bad-environment` for an image of another shape or type, for texels that
                aren't finite or below 0, and for other values out of range.
        """
        image = self.image
        if not isinstance(image, np.ndarray) or image.dtype not in (np.float16, np.float32):
            refuse(
                rules.BAD_ENVIRONMENT,
                "Environment(image=...)",
                f"{image.dtype}" if isinstance(image, np.ndarray) else repr(type(image).__name__),
                "linear light as float16 or float32",
            )
        if image.ndim != 3 or image.shape[2] not in (3, 4) or min(image.shape[:2]) < 2:
            allowed = "(height, width, 3 or 4), each side at least 2"
            refuse(rules.BAD_ENVIRONMENT, "Environment(image=...)", f"shape {image.shape}", allowed)
        texels = np.array(image[..., :3], np.float32)
        if not (np.isfinite(texels).all() and texels.min() >= 0.0 and texels.max() <= _BRIGHTEST):
            worst = texels[~(np.isfinite(texels) & (texels >= 0.0) & (texels <= _BRIGHTEST))].flat[0]
            allowed = f"finite texels from 0 to {_BRIGHTEST:g}"
            refuse(rules.BAD_ENVIRONMENT, "Environment(image=...)", f"a texel of {worst}", allowed)
        texels.setflags(write=False)
        object.__setattr__(self, "image", texels)
        for name, low, high in (("intensity", 0.0, _STRONGEST), ("turn", -_STRONGEST, _STRONGEST)):
            value = getattr(self, name)
            is_number = isinstance(value, int | float) and not isinstance(value, bool)
            if not is_number or not low <= value <= high:
                call = f"Environment({name}=...)"
                refuse(rules.BAD_ENVIRONMENT, call, repr(value), f"a number from {low:g} to {high:g}")

    @property
    def brightest(self) -> float:
        """The most light that arrives from any direction."""
        return float(self.image.max()) * self.intensity


def row_weights(height: int) -> NDArray[np.float64]:
    """Return the solid angle (height,) of each row of an equirectangular image, for all of its columns."""
    edges = np.cos(np.linspace(0.0, np.pi, height + 1))
    return np.asarray(2.0 * np.pi * (edges[:-1] - edges[1:]))


def texel_directions(height: int, width: int) -> NDArray[np.float64]:
    """Return the unit directions (height, width, 3) of the middles of an equirectangular image's texels."""
    polar = (np.arange(height) + 0.5)[:, None] * (np.pi / height)
    around = ((np.arange(width) + 0.5) / width - 0.5)[None, :] * (2.0 * np.pi)
    x, y, z = np.sin(polar) * np.sin(around), np.cos(polar), -np.sin(polar) * np.cos(around)
    return np.stack(np.broadcast_arrays(x, y, z), axis=-1)
