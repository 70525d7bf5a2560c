"""Lights: a structured array for each kind, with positions in float64, which shaders read relative to the
eye.

A point or spot light of intensity i gives i / d² at d metres, windowed to reach exactly 0 at its range, so
that a light has a volume outside which it can be ignored. Its light comes from a point, or from a sphere of
`source_radius` metres around it; point lights may be rectangles and tubes, too (`renderer.light_kinds.shapes`).
A spot light fades from its inner to its outer half angle. Ambient light is a hemisphere: sky colour from above,
ground colour from below.

No light casts shadows unless it says so (`casts_shadow`, or `Lights.cast_shadows` for all of them).
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from renderer.light_kinds.kind import LightKind
from renderer.light_kinds.shapes import flag_discs, flag_spheres, measure_extent
from renderer.light_kinds.table import LIGHT_KINDS, LOCAL_LIGHT_KINDS, AllLightArrays
from renderer.scene.arrays import Floats
from renderer.scene.negligible import LEAST_LIGHT

KIND_NAMES: Final = tuple(kind.name for kind in LIGHT_KINDS)
"""The names of the kinds of lights, which are those of their arrays in `Lights`."""


@dataclass(eq=False)
class Lights(AllLightArrays):
    """The lights of a scene: added one by one or as arrays, read as arrays.

    Attributes:
        directional, point, spot, …: the lights (k,) of each kind, of its dtype; may be written to. A frame
            refuses what `add_…` would, and directions that aren't unit vectors (`scene-bad-light`).
        sky, ground: linear colours (3,) of the ambient hemisphere.
        snapshot: the bytes of the lights of each kind, as of the last `refresh`; the same object while they
            are equal.
        has_faint: whether any light is so faint that it may make no difference, as of the last `refresh`.
        hidden: by the name of a kind which of its lights (k,) are at hidden nodes, and shine nowhere; kinds
            without any are left out. The scene writes it. Lights that were added since are shown.
    """

    sky: tuple[float, float, float] = (0.10, 0.12, 0.16)
    ground: tuple[float, float, float] = (0.05, 0.045, 0.04)
    snapshot: tuple[bytes, ...] = (b"",) * len(LIGHT_KINDS)
    has_faint: bool = False
    hidden: dict[str, NDArray[np.bool_]] = field(default_factory=dict)

    def of_kind(self, kind: LightKind) -> NDArray[Any]:
        """The lights (k,) of a kind."""
        lights: NDArray[Any] = getattr(self, kind.name)
        return lights

    @property
    def local_snapshot(self) -> tuple[bytes, ...]:
        """The bytes of `snapshot` of the kinds with a position."""
        return self.snapshot[-len(LOCAL_LIGHT_KINDS) :]

    @property
    def local_count(self) -> int:
        """The number of lights that have a position."""
        return sum(len(self.of_kind(kind)) for kind in LOCAL_LIGHT_KINDS)

    @property
    def has_shadows(self) -> bool:
        """True if any light casts shadows."""
        return any(bool(self.of_kind(kind)["casts_shadow"].any()) for kind in LIGHT_KINDS)

    @property
    def has_wide_shadows(self) -> bool:
        """True if any light casts shadows from a source that has a size."""
        return bool((self.directional["casts_shadow"] & flag_discs(self.directional)).any()) or any(
            bool((lights["casts_shadow"] & flag_spheres(lights)).any())
            for lights in map(self.of_kind, LOCAL_LIGHT_KINDS)
        )

    def refresh(self) -> None:
        """Update `snapshot` if lights have changed."""
        snapshot = tuple([getattr(self, name).tobytes() for name in KIND_NAMES])
        if self.hidden:
            snapshot = tuple(
                [
                    values + self.hidden[name].tobytes() if name in self.hidden else values
                    for name, values in zip(KIND_NAMES, snapshot, strict=True)
                ]
            )
        if snapshot != self.snapshot:
            self.snapshot = snapshot
            self.has_faint = self._has_faint_lights()

    def with_cutoff(self, cutoff: float) -> Lights:
        """A copy whose lights end where less than `cutoff` of their light arrives, above 0: 1 is what a
        directional light of intensity 1 gives. They fade to that distance, so nothing has an edge, and no
        light is off by more than 1.1 `cutoff` anywhere."""
        shorter = copy(self)
        for kind in LOCAL_LIGHT_KINDS:
            lights = self.of_kind(kind).copy()
            brightest = lights["intensity"].astype(np.float64) * lights["color"].max(axis=1, initial=0.0)
            farthest = np.maximum(np.sqrt(brightest / cutoff), lights["source_radius"])
            if kind.has_shapes:  # the range is that from the middle
                farthest += measure_extent(lights)
            lights["range"] = np.minimum(lights["range"], farthest)
            setattr(shorter, kind.name, lights)
        shorter.refresh()
        return shorter

    def _has_faint_lights(self) -> bool:
        """True if any light is so faint that it may make no difference."""
        return any(
            bool((_strongest_irradiance(self.of_kind(kind)) < LEAST_LIGHT).any()) for kind in LIGHT_KINDS
        )

    def without_hidden(self) -> Lights:
        """The lights that aren't at hidden nodes: these, or a copy without the others."""
        if not self.hidden:
            return self
        return self._select({name: self._flag_visible(name) for name in self.hidden})

    def _flag_visible(self, name: str) -> NDArray[np.bool_]:
        """The mask of the lights of a kind that aren't at hidden nodes. `hidden` is as of the scene's last refresh:
        lights that were added since follow no node yet, and masks may be longer than what is left."""
        hidden = self.hidden.get(name, np.zeros(0, bool))
        visible = np.ones(len(getattr(self, name)), bool)
        count = min(len(hidden), len(visible))
        visible[:count] = ~hidden[:count]
        return visible

    def _select(self, selected: Mapping[str, NDArray[np.bool_]]) -> Lights:
        """Return a copy with the lights that are `selected`, by the name of their kind; other kinds keep all."""
        left = copy(self)
        left.hidden = {}
        for name, is_kept in selected.items():
            setattr(left, name, getattr(self, name)[is_kept])
        left.refresh()
        return left

    def without_dark(self, response: float = np.inf) -> Lights:
        """The lights that shine: these, or a copy without those of no intensity or color, without local
        lights of no range or angle, and without those at hidden nodes. Their indices are those among what is left.

        Args:
            response: the most light that a surface sends to the eye for each unit of irradiance. Lights
                that together make less of it than `LEAST_LIGHT` are left out as well; with 0 all are.
        """
        if response <= 0.0:
            return self._select({kind.name: np.zeros(len(self.of_kind(kind)), bool) for kind in LIGHT_KINDS})
        shining = {kind.name: _shine(self.of_kind(kind)) for kind in LIGHT_KINDS}
        for name in self.hidden:
            shining[name] &= self._flag_visible(name)
        if self._has_faint_lights():
            self._leave_out_faint(shining, LEAST_LIGHT / response)
        if all(shines.all() for shines in shining.values()):
            return self
        return self._select(shining)

    def _leave_out_faint(self, shining: dict[str, NDArray[np.bool_]], limit: float) -> None:
        """Mark the faintest lights of all kinds as dark, as many as together give an irradiance of at most
        `limit`."""
        strengths = {kind.name: _strongest_irradiance(self.of_kind(kind)) for kind in LIGHT_KINDS}
        ascending = np.sort(np.concatenate(list(strengths.values())))
        faint = ascending[np.cumsum(ascending) <= limit]
        for name, strength in strengths.items():
            shining[name] &= strength > faint.max(initial=0.0)

    def __len__(self) -> int:
        return sum(len(self.of_kind(kind)) for kind in LIGHT_KINDS)

    def cast_shadows(self, casts: bool = True) -> None:
        """Switch shadows on or off for all lights that were added so far."""
        for kind in LIGHT_KINDS:
            self.of_kind(kind)["casts_shadow"] = casts

    def relative_to(self, eye: ArrayLike) -> dict[str, NDArray[Any]]:
        """The lights with a position as shaders read them, by the name of their kind: in float32, with
        positions relative to `eye` (3,), subtracted in float64."""
        return {
            kind.name: kind.pack_lights(self.of_kind(kind), np.asarray(eye, np.float64))
            for kind in LOCAL_LIGHT_KINDS
        }


def _shine(lights: NDArray[Any]) -> NDArray[np.bool_]:
    """The mask of lights (k,) of a kind that light anything: float32 has their light, and they reach anywhere."""
    brightest = lights["color"].max(axis=1, initial=0.0) * lights["intensity"]
    shines = brightest >= np.finfo(np.float32).tiny
    if "range" in (lights.dtype.names or ()):
        shines &= lights["range"] > 0.0
    if "outer" in (lights.dtype.names or ()):
        shines &= lights["outer"] > 0.0
    return np.asarray(shines)


def _strongest_irradiance(lights: NDArray[Any]) -> Floats:
    """The irradiance (k,) that lights of a kind may have at most, of local lights next to them."""
    strength: Floats = lights["color"].max(axis=1, initial=0.0).astype(np.float64) * lights["intensity"]
    return strength / _NEAREST**2 if "range" in (lights.dtype.names or ()) else strength


_NEAREST: Final = 1e-12
"""The least distance of a surface from a local light, in metres: nearer ones are lit as from there."""
