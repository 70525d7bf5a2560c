"""Media between the scene and the eye: fog in the air, and bloom, light that scatters in the eye or the
camera."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from renderer import rules
from rhi.errors import refuse

_MAX_DENSITY: Final = 1e6
"""The largest density and falloff per metre: beyond it, nothing is seen through a thousandth of a
millimetre."""


@dataclass(frozen=True, slots=True)
class Fog:
    """Fog whose density falls with height: `density · e^(-falloff · (y - base))` per metre. A ray that
    collects a thickness of t loses all but e^-t of its light, and gets the rest from the fog.

    Attributes:
        density: per metre, at the height `base`. More than 0.
        color: what endless fog looks like, as a linear colour from 0 to 1; that of the scene's background
            hides where one ends and the other begins.
        falloff: per metre; 0 is the same fog at all heights.
        base: a height in the world, in metres.
    """

    density: float
    color: tuple[float, float, float] = (0.5, 0.55, 0.6)
    falloff: float = 0.0
    base: float = 0.0

    def __post_init__(self) -> None:
        rules.check_types(self, rules.BAD_EFFECT)
        _check(
            "Fog(density=...)",
            self.density,
            0.0 < self.density <= _MAX_DENSITY,
            f"more than 0, at most {_MAX_DENSITY:g}",
        )
        _check(
            "Fog(falloff=...)",
            self.falloff,
            0.0 <= self.falloff <= _MAX_DENSITY,
            f"from 0 to {_MAX_DENSITY:g}",
        )
        _check("Fog(base=...)", self.base, bool(np.isfinite(self.base)), "a finite height")
        is_color = len(self.color) == 3 and all(0.0 <= channel <= 1.0 for channel in self.color)
        _check("Fog(color=...)", self.color, is_color, "three numbers from 0 to 1")


@dataclass(frozen=True, slots=True)
class Bloom:
    """Bloom: light of pixels brighter than white spills over, as it scatters in the eye or the camera.

    Attributes:
        strength: how much of all light is scattered, more than 0 and at most 1; 0.02 to 0.1 look natural.
    """

    strength: float = 0.05

    def __post_init__(self) -> None:
        rules.check_types(self, rules.BAD_EFFECT)
        _check("Bloom(strength=...)", self.strength, 0.0 < self.strength <= 1.0, "more than 0, at most 1")


def _check(call: str, value: object, is_allowed: bool, allowed: str) -> None:
    if not is_allowed:
        refuse(rules.BAD_EFFECT, call, value, allowed)
