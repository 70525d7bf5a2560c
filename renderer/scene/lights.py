"""Lights: a structured array for each kind, with positions in float64, which shaders read relative to the eye.

A point or spot light of intensity i gives i / d² at d metres, windowed to reach exactly 0 at its range,
so that a light has a volume outside which it can be ignored. A spot fades from its inner to its
outer half angle. Ambient light is a hemisphere: sky colour from above, ground colour from below.

No light casts shadows unless it says so (`casts_shadow`, or `Lights.cast_shadows` for all of them).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from renderer import rules
from renderer.scene.arrays import Floats, Rows
from rhi.errors import refuse

DIRECTIONAL: Final = np.dtype(
    [("direction", "<f4", 3), ("intensity", "<f4"), ("color", "<f4", 3), ("casts_shadow", "<u4")]
)
"""32 bytes. `direction` is the unit vector along which the light travels; `casts_shadow` is 0 or 1."""

POINT: Final = np.dtype(
    [("position", "<f8", 3), ("range", "<f4"), ("color", "<f4", 3), ("intensity", "<f4"), ("casts_shadow", "?")]
)
SPOT: Final = np.dtype(
    [
        *((name, POINT[name]) for name in ("position", "range", "color", "intensity", "casts_shadow")),
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

_ROUNDED: Final = 2.0**-23  # of a unit vector's components in float32
_LARGEST: Final = float(np.finfo(np.float32).max)


@dataclass(frozen=True, eq=False, slots=True)
class RelativeLights:
    """Lights for the device: directional (d,) of `DIRECTIONAL`, point (p,) of `RELATIVE_POINT`,
    spot (s,) of `RELATIVE_SPOT`."""

    directional: NDArray[Any]
    point: NDArray[Any]
    spot: NDArray[Any]


@dataclass(eq=False, slots=True)
class Lights:
    """The lights of a scene: added one by one or as arrays, read as arrays.

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

    def cast_shadows(self) -> None:
        """Let all lights that were added so far cast shadows."""
        for lights in (self.directional, self.point, self.spot):
            lights["casts_shadow"] = True

    def add_directional(
        self,
        direction: Sequence[float],
        color: Sequence[float] = (1, 1, 1),
        intensity: float = 1.0,
        casts_shadow: bool = False,
    ) -> int:
        """Add light that travels along `direction`; returns its index."""
        call = "add_directional"
        light = np.zeros(1, DIRECTIONAL)
        light["direction"] = _units(call, direction, 1)
        _fill(light, call, color=color, intensity=intensity)
        light["casts_shadow"] = casts_shadow
        self.directional = np.concatenate([self.directional, light])
        return len(self.directional) - 1

    def add_point(
        self,
        position: ArrayLike,
        range: float,
        color: Sequence[float] = (1, 1, 1),
        intensity: float = 1.0,
        casts_shadow: bool = False,
    ) -> int:
        """Add a point light, `position` and `range` in metres; returns its index."""
        where = _numbers("add_point", "position", position, (1, 3))
        return int(self._add_points("add_point", where, range, color, intensity, casts_shadow)[0])

    def add_points(
        self,
        position: ArrayLike,
        range: ArrayLike,
        color: ArrayLike = (1, 1, 1),
        intensity: ArrayLike = 1.0,
        casts_shadow: bool = False,
    ) -> Rows:
        """Add point lights at positions (k, 3); returns their indices (k,).

        `range` and `intensity` are (k,) or one for all, `color` is (k, 3) or one for all.
        """
        where = np.asarray(position, np.float64)
        return self._add_points("add_points", where, range, color, intensity, casts_shadow)

    def _add_points(
        self,
        call: str,
        position: Floats,
        range: ArrayLike,
        color: ArrayLike,
        intensity: ArrayLike,
        casts_shadow: bool,
    ) -> Rows:
        lights = np.zeros(_count(call, position), POINT)
        _fill(lights, call, position=position, range=range, color=color, intensity=intensity)
        lights["casts_shadow"] = casts_shadow
        self.point = np.concatenate([self.point, lights])
        return np.arange(len(self.point) - len(lights), len(self.point))

    def add_spot(
        self,
        position: ArrayLike,
        direction: Sequence[float],
        range: float,
        inner: float,
        outer: float,
        color: Sequence[float] = (1, 1, 1),
        intensity: float = 1.0,
        casts_shadow: bool = False,
    ) -> int:
        """Add a spot light with half angles 0 <= inner <= outer <= pi radians; returns its index."""
        where = _numbers("add_spot", "position", position, (1, 3))
        added = self._add_spots(
            "add_spot", where, direction, range, inner, outer, color, intensity, casts_shadow
        )
        return int(added[0])

    def add_spots(
        self,
        position: ArrayLike,
        direction: ArrayLike,
        range: ArrayLike,
        inner: ArrayLike,
        outer: ArrayLike,
        color: ArrayLike = (1, 1, 1),
        intensity: ArrayLike = 1.0,
        casts_shadow: bool = False,
    ) -> Rows:
        """Add spot lights at positions (k, 3); returns their indices (k,).

        `direction` and `color` are (k, 3) or one for all, all else is (k,) or one for all.
        """
        where = np.asarray(position, np.float64)
        return self._add_spots(
            "add_spots", where, direction, range, inner, outer, color, intensity, casts_shadow
        )

    def _add_spots(
        self,
        call: str,
        position: Floats,
        direction: ArrayLike,
        range: ArrayLike,
        inner: ArrayLike,
        outer: ArrayLike,
        color: ArrayLike,
        intensity: ArrayLike,
        casts_shadow: bool,
    ) -> Rows:
        lights = np.zeros(_count(call, position), SPOT)
        _fill(lights, call, position=position, range=range, color=color, intensity=intensity)
        lights["casts_shadow"] = casts_shadow
        lights["direction"] = _units(call, direction, len(lights))
        low = _numbers(call, "inner", inner, (len(lights),))
        high = _numbers(call, "outer", outer, (len(lights),))
        allowed = (low >= 0.0) & (low <= high) & (high <= np.pi)
        if not allowed.all():
            given = _describe(allowed, lambda row: f"inner={low[row]}, outer={high[row]}")
            refuse(rules.BAD_LIGHT, call, given, "0 <= inner <= outer <= pi")
        lights["inner"], lights["outer"] = low, high
        self.spot = np.concatenate([self.spot, lights])
        return np.arange(len(self.spot) - len(lights), len(self.spot))

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


def _count(call: str, position: Floats) -> int:
    """Return the number of positions (k, 3)."""
    if position.ndim != 2 or position.shape[1] != 3:
        refuse(rules.BAD_LIGHT, f"{call}(position=...)", f"shape {position.shape}", "(k, 3)")
    return len(position)


def _fill(lights: NDArray[Any], call: str, **values: ArrayLike) -> None:
    """Set fields of `lights` (k,) to one value for each or one for all."""
    for name, given in values.items():
        least = -np.inf if name == "position" else 0.0
        lights[name] = _numbers(call, name, given, lights[name].shape, least)


def _numbers(
    call: str, name: str, given: ArrayLike, shape: tuple[int, ...], least: float = -np.inf
) -> Floats:
    """Return finite numbers of `shape`, (k,) or (k, 3), which are given for each light or once for all."""
    values = np.asarray(given, np.float64)
    kind = "a finite number" if len(shape) == 1 else "three finite numbers"
    wanted = kind if least < 0.0 else f"{kind}, {least:g} or more"
    if values.shape not in (shape, shape[1:]):
        refuse(rules.BAD_LIGHT, f"{call}({name}=...)", f"shape {values.shape}", f"{wanted}, or shape {shape}")
    rows = np.broadcast_to(values, shape)
    fits = (np.abs(rows) <= _LARGEST) & (rows >= least)
    allowed = np.asarray(fits if len(shape) == 1 else fits.all(1))
    if not allowed.all():
        refuse(rules.BAD_LIGHT, f"{call}({name}=...)", _describe(allowed, lambda row: f"{rows[row]}"), wanted)
    return rows


def _units(call: str, direction: ArrayLike, count: int) -> Floats:
    """Return unit vectors (count, 3) along directions, which are given for each light or once for all."""
    given = _numbers(call, "direction", direction, (count, 3))
    allowed = np.asarray(given.any(1))
    if not allowed.all():
        shown = _describe(allowed, lambda row: f"{given[row]}")
        refuse(rules.BAD_LIGHT, f"{call}(direction=...)", shown, "three finite numbers, not all 0")
    scaled = given / np.abs(given).max(axis=1, keepdims=True)  # no under- or overflow
    units = np.asarray(scaled / np.linalg.norm(scaled, axis=1, keepdims=True))
    is_unit = np.abs(units - given).max(axis=1, keepdims=True) <= _ROUNDED
    return np.where(is_unit, given, units)  # what has been rounded to float32 isn't rounded again


def _describe(allowed: NDArray[np.bool_], show: Callable[[int], str]) -> str:
    """Describe the first light whose value isn't `allowed` (k,)."""
    row = int(allowed.argmin())
    return show(row) if len(allowed) == 1 else f"{show(row)} in row {row}"
