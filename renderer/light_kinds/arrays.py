"""The arrays of a scene's lights: how lights are added to them, and which of their values are allowed."""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from renderer import rules
from renderer.light_kinds.kind import LightKind
from rhi.errors import refuse
from rhi.math import Floats
from rhi.math.arguments import read_floats

_ROUNDING: Final = 2.0**-23  # of a unit vector's components in float32
_OFF_UNIT: Final = 1e-3  # by so much the light of a direction may be off before it shows
_NON_NEGATIVE: Final = ("range", "color", "intensity", "source_radius", "angular_diameter")  # 0 or more
WIDEST_SOURCE: Final = float(np.float32(np.pi / 2))
"""The largest angle in radians that the source of a directional light fills."""
_LARGEST: Final = float(np.finfo(np.float32).max)


@dataclass(eq=False)
class LightArrays:
    """The base of a kind's array, which is an attribute of the kind's name, and of the methods that add
    lights to it.

    Attributes:
        kind: the kind of the lights.
    """

    kind: ClassVar[LightKind]

    def _add(
        self, kind: str, call: str, count: int, casts_shadow: bool, **values: ArrayLike
    ) -> NDArray[np.int64]:
        """Add `count` lights of a kind, with `values` of its fields for each light or once for all; returns
        their indices (count,)."""
        before: NDArray[Any] = getattr(self, kind)
        lights = np.zeros(count, before.dtype)
        checked = {
            name: _check_numbers(call, name, value, lights[name].shape) for name, value in values.items()
        }
        _check_related_fields(call, checked, checked)
        for name, numbers in checked.items():
            lights[name] = _normalize(call, numbers) if name == "direction" else numbers
        lights["casts_shadow"] = casts_shadow
        setattr(self, kind, np.concatenate([before, lights]))
        return np.arange(len(before), len(before) + count)


def check_lights(call: str, lights: NDArray[Any]) -> None:
    """Refuse lights of a kind (k,) that were written to, if a value is out of its range:
    `scene-bad-light`."""
    fields = lights.dtype.names or ()
    for name in _NON_NEGATIVE:
        if name in fields:
            _check_numbers(call, name, lights[name], lights[name].shape)
    _check_related_fields(call, fields, lights)
    if "direction" in fields:
        directions = lights["direction"].astype(np.float64)
        allowed = np.abs(np.linalg.norm(directions, axis=1) - 1.0) <= _OFF_UNIT
        if not allowed.all():
            value = _describe(allowed, lambda light_index: f"{directions[light_index]}")
            refuse(rules.BAD_LIGHT, f"{call}: direction", value, "a unit vector", "divide it by its length")


def count_positions(call: str, position: ArrayLike) -> int:
    """The number of positions (k, 3)."""
    positions = read_floats(f"{call}(position=...)", position, rule=rules.BAD_LIGHT)
    if positions.ndim != 2 or positions.shape[1] != 3:
        refuse(rules.BAD_LIGHT, f"{call}(position=...)", f"shape {positions.shape}", "(k, 3)")
    return len(positions)


def check_side(call: str, name: str, value: ArrayLike) -> float:
    """A side of a source in metres: a finite number, 0 or more."""
    return float(_check_numbers(call, name, value, (1,), minimum=0.0)[0])


def check_direction(call: str, name: str, value: ArrayLike) -> Floats:
    """The unit vector (3,) along a direction."""
    return np.asarray(_normalize(call, _check_numbers(call, name, value, (1, 3)), name)[0])


def _check_related_fields(
    call: str, fields: Container[str], values: Mapping[str, Any] | NDArray[Any]
) -> None:
    """Refuse half angles (k,) unless 0 <= inner <= outer <= pi, sources (k,) that are too wide, and sources (k,)
    beyond the ranges: a light ends at its range from the centre."""
    columns: Any = values
    if "source_radius" in fields:
        radii, ranges = columns["source_radius"], columns["range"]
        allowed = radii <= ranges
        if not allowed.all():
            value = _describe(allowed, lambda index: f"source_radius={radii[index]}, range={ranges[index]}")
            tip = "let the light reach farther than its source"
            refuse(rules.BAD_LIGHT, call, value, "source_radius <= range", tip)
    if "source_right" in fields:
        _check_shapes(call, fields, columns)
    if "angular_diameter" in fields:
        diameters = columns["angular_diameter"]
        allowed = diameters <= WIDEST_SOURCE
        if not allowed.all():
            value = _describe(allowed, lambda index: f"angular_diameter={diameters[index]}")
            refuse(rules.BAD_LIGHT, call, value, "0 <= angular_diameter <= pi / 2", "give it in radians")
    if "inner" in fields:
        low, high = columns["inner"], columns["outer"]
        allowed = (low >= 0.0) & (low <= high) & (high <= np.float32(np.pi))
        if not allowed.all():
            value = _describe(allowed, lambda index: f"inner={low[index]}, outer={high[index]}")
            refuse(rules.BAD_LIGHT, call, value, "0 <= inner <= outer <= pi")


def _check_shapes(call: str, fields: Container[str], columns: Any) -> None:
    """Refuse rectangles (k,) whose sides aren't at right angles, and sources that reach beyond the range."""
    right = np.asarray(columns["source_right"], np.float64)
    up = np.asarray(columns["source_up"], np.float64) if "source_up" in fields else np.zeros_like(right)
    length, height = np.linalg.norm(right, axis=1), np.linalg.norm(up, axis=1)
    slant = np.abs((right * up).sum(axis=1))
    allowed = (slant <= _OFF_UNIT * length * height) & ((height == 0.0) | (length > 0.0))
    if not allowed.all():
        value = _describe(allowed, lambda index: f"source_right={right[index]}, source_up={up[index]}")
        refuse(rules.BAD_LIGHT, call, value, "sides at right angles, or source_up = 0 for a tube")
    ranges = np.asarray(columns["range"], np.float64)
    radii = np.where(height > 0.0, 0.0, np.asarray(columns["source_radius"], np.float64))
    extent = np.sqrt(length**2 + height**2 + radii**2)
    allowed = (extent <= ranges * (1.0 + _ROUNDING)) | (length == 0.0)
    if not allowed.all():
        value = _describe(allowed, lambda index: f"a source of {extent[index]:g} m, range={ranges[index]}")
        tip = "let the light reach farther than its source"
        refuse(rules.BAD_LIGHT, call, value, "half the diagonal or axis <= range", tip)


def _check_numbers(
    call: str, name: str, value: ArrayLike, shape: tuple[int, ...], *, minimum: float = -np.inf
) -> Floats:
    """Finite numbers of `shape`, (k,) or (k, 3), from a `value` for each light or one for all."""
    minimum = 0.0 if name in _NON_NEGATIVE else minimum
    numbers = read_floats(f"{call}({name}=...)", value, rule=rules.BAD_LIGHT)
    expected = "a finite number" if len(shape) == 1 else "three finite numbers"
    if minimum >= 0.0:
        expected = f"{expected}, {minimum:g} or more"
    if numbers.shape not in (shape, shape[1:]):
        refuse(
            rules.BAD_LIGHT, f"{call}({name}=...)", f"shape {numbers.shape}", f"{expected}, or shape {shape}"
        )
    by_light = np.broadcast_to(numbers, shape)
    fits = (np.abs(by_light) <= _LARGEST) & (by_light >= minimum)
    allowed = np.asarray(fits if len(shape) == 1 else fits.all(1))
    if not allowed.all():
        described = _describe(allowed, lambda light_index: f"{by_light[light_index]}")
        refuse(rules.BAD_LIGHT, f"{call}({name}=...)", described, expected)
    return by_light


def _normalize(call: str, directions: Floats, name: str = "direction") -> Floats:
    """Unit vectors (k, 3) along directions."""
    allowed = np.asarray(directions.any(1))
    if not allowed.all():
        value = _describe(allowed, lambda light_index: f"{directions[light_index]}")
        refuse(rules.BAD_LIGHT, f"{call}({name}=...)", value, "three finite numbers, not all 0")
    scaled = directions / np.abs(directions).max(axis=1, keepdims=True)  # no under- or overflow
    units = np.asarray(scaled / np.linalg.norm(scaled, axis=1, keepdims=True))
    is_unit = np.abs(units - directions).max(axis=1, keepdims=True) <= _ROUNDING
    return np.where(is_unit, directions, units)  # what has been rounded to float32 isn't rounded again


def _describe(allowed: NDArray[np.bool_], describe: Callable[[int], str]) -> str:
    """Describe the first light whose value isn't `allowed` (k,)."""
    light_index = int(allowed.argmin())
    return describe(light_index) if len(allowed) == 1 else f"{describe(light_index)} in row {light_index}"
