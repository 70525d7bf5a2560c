"""Lights: a structured array for each kind, with positions in float64, which are uploaded relative to the eye.

A point or spot light of intensity i gives i / d² at d metres, windowed to reach exactly 0 at its range,
so that a light has a volume outside which it can be ignored. A spot fades from its inner to its
outer half angle. Ambient light is a hemisphere: sky colour from above, ground colour from below.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from renderer import rules
from rhi.errors import refuse

__rhi_internal__ = True

DIRECTIONAL: Final = np.dtype(
    [("direction", "<f4", 3), ("intensity", "<f4"), ("color", "<f4", 3), ("pad", "<f4")]
)
"""32 bytes. `direction` is the unit vector along which the light travels."""

POINT: Final = np.dtype([("position", "<f8", 3), ("range", "<f4"), ("color", "<f4", 3), ("intensity", "<f4")])
SPOT: Final = np.dtype(
    [
        *((name, POINT[name]) for name in ("position", "range", "color", "intensity")),
        ("direction", "<f4", 3),
        ("inner", "<f4"),  # half angles in radians, inner <= outer
        ("outer", "<f4"),
    ]
)

RELATIVE_POINT: Final = np.dtype(
    [("position", "<f4", 3), ("range", "<f4"), ("color", "<f4", 3), ("intensity", "<f4")]
)
"""32 bytes, std430 without padding; positions relative to the eye."""

RELATIVE_SPOT: Final = np.dtype(
    [
        *((name, RELATIVE_POINT[name]) for name in ("position", "range", "color", "intensity")),
        ("direction", "<f4", 3),
        ("cos_inner", "<f4"),
        ("cos_outer", "<f4"),
        ("pad", "<f4", 3),
    ]
)
"""64 bytes, std430; positions relative to the eye."""


@dataclass(frozen=True, eq=False, slots=True)
class RelativeLights:
    """Lights for the device: directional (d,) of `DIRECTIONAL`, point (p,) of `RELATIVE_POINT`,
    spot (s,) of `RELATIVE_SPOT`."""

    directional: NDArray[Any]
    point: NDArray[Any]
    spot: NDArray[Any]


@dataclass(eq=False, slots=True)
class Lights:
    """All lights of a scene: added one by one, read as arrays.

    Attributes:
        directional, point, spot: (k,) of `DIRECTIONAL`, `POINT`, `SPOT`; may be written to.
        sky, ground: linear colours (3,) of the ambient hemisphere.
    """

    directional: NDArray[Any] = field(default_factory=lambda: np.zeros(0, DIRECTIONAL))
    point: NDArray[Any] = field(default_factory=lambda: np.zeros(0, POINT))
    spot: NDArray[Any] = field(default_factory=lambda: np.zeros(0, SPOT))
    sky: tuple[float, float, float] = (0.10, 0.12, 0.16)
    ground: tuple[float, float, float] = (0.05, 0.045, 0.04)

    def __len__(self) -> int:
        return len(self.directional) + len(self.point) + len(self.spot)

    def add_directional(
        self, direction: Sequence[float], color: Sequence[float] = (1, 1, 1), intensity: float = 1.0
    ) -> int:
        """Add light that travels along `direction`; returns its index."""
        call = "add_directional"
        light = np.zeros(1, DIRECTIONAL)
        light["direction"] = _unit(call, direction)
        light["color"], light["intensity"] = _color(call, color), _at_least_zero(call, "intensity", intensity)
        self.directional = np.concatenate([self.directional, light])
        return len(self.directional) - 1

    def add_point(
        self,
        position: ArrayLike,
        range: float,
        color: Sequence[float] = (1, 1, 1),
        intensity: float = 1.0,
    ) -> int:
        """Add a point light, `position` and `range` in metres; returns its index."""
        light = np.zeros(1, POINT)
        _fill(light, "add_point", position, range, color, intensity)
        self.point = np.concatenate([self.point, light])
        return len(self.point) - 1

    def add_spot(
        self,
        position: ArrayLike,
        direction: Sequence[float],
        range: float,
        inner: float,
        outer: float,
        color: Sequence[float] = (1, 1, 1),
        intensity: float = 1.0,
    ) -> int:
        """Add a spot light with half angles 0 <= inner <= outer <= pi radians; returns its index."""
        light = np.zeros(1, SPOT)
        _fill(light, "add_spot", position, range, color, intensity)
        light["direction"] = _unit("add_spot", direction)
        if not 0.0 <= inner <= outer <= np.pi:
            refuse(rules.BAD_LIGHT, "add_spot", f"inner={inner}, outer={outer}", "0 <= inner <= outer <= pi")
        light["inner"], light["outer"] = inner, outer
        self.spot = np.concatenate([self.spot, light])
        return len(self.spot) - 1

    def relative_to(self, eye: ArrayLike) -> RelativeLights:
        """Return all lights in float32, with positions relative to `eye` (3,), subtracted in float64."""
        point = np.zeros(len(self.point), RELATIVE_POINT)
        spot = np.zeros(len(self.spot), RELATIVE_SPOT)
        for packed, lights in ((point, self.point), (spot, self.spot)):
            packed["position"] = lights["position"] - np.asarray(eye, np.float64)
            for name in ("range", "color", "intensity"):
                packed[name] = lights[name]
        spot["direction"] = self.spot["direction"]
        spot["cos_inner"], spot["cos_outer"] = np.cos(self.spot["inner"]), np.cos(self.spot["outer"])
        return RelativeLights(self.directional.copy(), point, spot)


def _fill(
    light: NDArray[Any],
    call: str,
    position: ArrayLike,
    range: float,
    color: Sequence[float],
    intensity: float,
) -> None:
    where = np.asarray(position, np.float64)
    if where.shape != (3,) or not np.isfinite(where).all():
        refuse(rules.BAD_LIGHT, f"{call}(position=...)", position, "three finite numbers")
    light["position"] = where
    light["range"] = _at_least_zero(call, "range", range)
    light["color"], light["intensity"] = _color(call, color), _at_least_zero(call, "intensity", intensity)


def _at_least_zero(call: str, name: str, value: float) -> float:
    if not 0.0 <= value < np.inf:
        refuse(rules.BAD_LIGHT, f"{call}({name}=...)", value, "a finite number, 0 or more")
    return value


def _color(call: str, color: Sequence[float]) -> NDArray[np.float64]:
    given = np.asarray(color, np.float64)
    if given.shape != (3,) or not (np.isfinite(given) & (given >= 0.0)).all():
        refuse(rules.BAD_LIGHT, f"{call}(color=...)", color, "three finite numbers, 0 or more")
    return given


def _unit(call: str, direction: Sequence[float]) -> NDArray[np.float64]:
    given = np.asarray(direction, np.float64)
    if given.shape != (3,) or not np.isfinite(given).all() or not given.any():
        refuse(rules.BAD_LIGHT, f"{call}(direction=...)", direction, "three finite numbers, not all 0")
    scaled = given / np.abs(given).max()
    return np.asarray(scaled / np.linalg.norm(scaled))
