"""Lights: a structured array for each kind, with positions in float64, which shaders read relative to the eye.

A point or spot light of intensity i gives i / d² at d metres, windowed to reach exactly 0 at its range,
so that a light has a volume outside which it can be ignored. Its light comes from a point, or from a sphere of
`source_radius` metres around it. A spot fades from its inner to its outer half angle. Ambient light is a hemisphere:
sky colour from above, ground colour from below.

No light casts shadows unless it says so (`casts_shadow`, or `Lights.cast_shadows` for all of them).
"""

from __future__ import annotations

from collections.abc import Callable, Container, Sequence
from dataclasses import dataclass, field, replace
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
    [
        ("position", "<f8", 3), ("range", "<f4"), ("color", "<f4", 3), ("intensity", "<f4"), ("casts_shadow", "?"),
        ("source_radius", "<f4"),
    ]
)  # fmt: skip
SPOT: Final = np.dtype(
    [
        *((name, POINT[name]) for name in POINT.names or ()),
        ("direction", "<f4", 3),
        ("inner", "<f4"),  # half angles in radians, inner <= outer
        ("outer", "<f4"),
    ]
)

RELATIVE_POINT: Final = np.dtype([("position", "<f4", 3), ("range", "<f4"), ("color", "<f4", 3), ("intensity", "<f4")])
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
_OFF_UNIT: Final = 1e-3  # by so much the light of a direction may be off before it shows
_AMOUNTS: Final = ("range", "color", "intensity", "source_radius")  # 0 or more
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
        directional, point, spot: (k,) of `DIRECTIONAL`, `POINT`, `SPOT`; may be written to. A frame refuses what
            `add_…` would, and directions that aren't unit vectors (`scene-bad-light`).
        sky, ground: linear colours (3,) of the ambient hemisphere.
        contents: the bytes of the lights of each kind, as of the last `refresh`; the same object while they are equal.
    """

    directional: NDArray[Any] = field(default_factory=lambda: np.zeros(0, DIRECTIONAL))
    point: NDArray[Any] = field(default_factory=lambda: np.zeros(0, POINT))
    spot: NDArray[Any] = field(default_factory=lambda: np.zeros(0, SPOT))
    sky: tuple[float, float, float] = (0.10, 0.12, 0.16)
    ground: tuple[float, float, float] = (0.05, 0.045, 0.04)
    contents: tuple[bytes, bytes, bytes] = (b"", b"", b"")

    def refresh(self) -> None:
        """Find out whether lights have changed."""
        contents = self.directional.tobytes(), self.point.tobytes(), self.spot.tobytes()
        if contents != self.contents:
            self.contents = contents

    def cut(self, least: float) -> Lights:
        """Return lights of which each ends where less than `least` of its light arrives, above 0: 1 is what a
        directional light of intensity 1 gives. They fade to that place, so nothing has an edge, and of no lamp's light
        is more than 1.1 `least` missing anywhere."""
        cut = replace(self, point=self.point.copy(), spot=self.spot.copy())
        for some in (cut.point, cut.spot):
            brightest = some["intensity"].astype(np.float64) * some["color"].max(axis=1, initial=0.0)
            farthest = np.maximum(np.sqrt(brightest / least), some["source_radius"])
            some["range"] = np.minimum(some["range"], farthest)
        cut.refresh()
        return cut

    def __len__(self) -> int:
        return len(self.directional) + len(self.point) + len(self.spot)

    def cast_shadows(self, casts: bool = True) -> None:
        """Let all lights that were added so far cast shadows, or none of them."""
        for lights in (self.directional, self.point, self.spot):
            lights["casts_shadow"] = casts

    def add_directional(
        self,
        direction: Sequence[float],
        color: Sequence[float] = (1, 1, 1),
        intensity: float = 1.0,
        casts_shadow: bool = False,
    ) -> int:
        """Add light that travels along `direction`; returns its index."""
        given: dict[str, ArrayLike] = {"direction": direction, "color": color, "intensity": intensity}
        return int(self._add("directional", "add_directional", 1, casts_shadow, **given)[0])

    def add_point(
        self,
        position: ArrayLike,
        range: float,
        color: Sequence[float] = (1, 1, 1),
        intensity: float = 1.0,
        casts_shadow: bool = False,
        source_radius: float = 0.0,
    ) -> int:
        """Add a point light, `position`, `range` and `source_radius` <= range in metres; returns its index."""
        given = {"position": position, "range": range, "color": color, "intensity": intensity}
        return int(self._add("point", "add_point", 1, casts_shadow, **given, source_radius=source_radius)[0])

    def add_points(
        self,
        position: ArrayLike,
        range: ArrayLike,
        color: ArrayLike = (1, 1, 1),
        intensity: ArrayLike = 1.0,
        casts_shadow: bool = False,
        source_radius: ArrayLike = 0.0,
    ) -> Rows:
        """Add point lights at positions (k, 3); returns their indices (k,).

        `range`, `intensity` and `source_radius` are (k,) or one for all, `color` is (k, 3) or one for all.
        """
        given = {"position": position, "range": range, "color": color, "intensity": intensity}
        count = _count("add_points", position)
        return self._add("point", "add_points", count, casts_shadow, **given, source_radius=source_radius)

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
        source_radius: float = 0.0,
    ) -> int:
        """Add a spot light with half angles 0 <= inner <= outer <= pi radians; returns its index."""
        given = {"position": position, "range": range, "color": color, "intensity": intensity}
        given |= {"direction": direction, "inner": inner, "outer": outer, "source_radius": source_radius}
        return int(self._add("spot", "add_spot", 1, casts_shadow, **given)[0])

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
        source_radius: ArrayLike = 0.0,
    ) -> Rows:
        """Add spot lights at positions (k, 3); returns their indices (k,).

        `direction` and `color` are (k, 3) or one for all, all else is (k,) or one for all.
        """
        given = {"position": position, "range": range, "color": color, "intensity": intensity}
        given |= {"direction": direction, "inner": inner, "outer": outer, "source_radius": source_radius}
        return self._add("spot", "add_spots", _count("add_spots", position), casts_shadow, **given)

    def _add(self, kind: str, call: str, count: int, casts_shadow: bool, **given: ArrayLike) -> Rows:
        """Add lights of a kind, `count` of them, whose fields are `given` for each or once for all; return their
        indices (count,)."""
        before: NDArray[Any] = getattr(self, kind)
        lights = np.zeros(count, before.dtype)
        values = {name: _numbers(call, name, one, lights[name].shape) for name, one in given.items()}
        _check_pairs(call, values, values)
        for name, numbers in values.items():
            lights[name] = _units(call, numbers) if name == "direction" else numbers
        lights["casts_shadow"] = casts_shadow
        setattr(self, kind, np.concatenate([before, lights]))
        return np.arange(len(before), len(before) + count)

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


def check_lights(call: str, lights: NDArray[Any]) -> None:
    """Refuse lights of a kind (k,) that were written to, if a value is out of its range: `scene-bad-light`."""
    fields = lights.dtype.names or ()
    for name in _AMOUNTS:
        if name in fields:
            _numbers(call, name, lights[name], lights[name].shape)
    _check_pairs(call, fields, lights)
    if "direction" in fields:
        directions = lights["direction"].astype(np.float64)
        allowed = np.abs(np.linalg.norm(directions, axis=1) - 1.0) <= _OFF_UNIT
        if not allowed.all():
            shown = _describe(allowed, lambda row: f"{directions[row]}")
            refuse(rules.BAD_LIGHT, f"{call}: direction", shown, "a unit vector", "divide it by its length")


def _check_pairs(call: str, fields: Container[str], given: Any) -> None:
    """Refuse half angles (k,) unless 0 <= inner <= outer <= pi, and radii of sources (k,) above the ranges: a light
    ends at its range from the centre."""
    if "source_radius" in fields:
        radii, ranges = given["source_radius"], given["range"]
        if not (allowed := radii <= ranges).all():
            shown = _describe(allowed, lambda row: f"source_radius={radii[row]}, range={ranges[row]}")
            refuse(
                rules.BAD_LIGHT, call, shown, "source_radius <= range", "let the light reach farther than its source"
            )
    if "inner" in fields:
        low, high = given["inner"], given["outer"]
        if not (allowed := (low >= 0.0) & (low <= high) & (high <= np.float32(np.pi))).all():
            shown = _describe(allowed, lambda row: f"inner={low[row]}, outer={high[row]}")
            refuse(rules.BAD_LIGHT, call, shown, "0 <= inner <= outer <= pi")


def _count(call: str, position: ArrayLike) -> int:
    """Return the number of positions (k, 3)."""
    given = np.asarray(position, np.float64)
    if given.ndim != 2 or given.shape[1] != 3:
        refuse(rules.BAD_LIGHT, f"{call}(position=...)", f"shape {given.shape}", "(k, 3)")
    return len(given)


def _numbers(call: str, name: str, given: ArrayLike, shape: tuple[int, ...]) -> Floats:
    """Return finite numbers of `shape`, (k,) or (k, 3), which are given for each light or once for all."""
    least = 0.0 if name in _AMOUNTS else -np.inf
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


def _units(call: str, given: Floats) -> Floats:
    """Return unit vectors (k, 3) along directions."""
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
