"""The objects that may cast a shadow on what is visible, found for each map.

Casters that can't move are kept apart from those that may: the former are drawn once, the latter over a copy of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from renderer.lights.lists import list_lights
from renderer.scene import AlphaMode, Camera, Scene
from renderer.scene.arrays import Floats, Rows, list_ranges
from renderer.shadows.cascades import Cascade
from renderer.shadows.lamps import find_shadow_boxes, pair_by_light
from renderer.visibility.boxes.volumes import Containment, classify

_MARGIN = 1e-9  # by which boxes are too large, relative to their coordinates


@dataclass(frozen=True, eq=False, slots=True)
class Casters:
    """The casters of a map: rows of objects that can't move, and of those that may."""

    still: Rows
    moving: Rows

    def __len__(self) -> int:
        return len(self.still) + len(self.moving)


class SceneCasters:
    """The casters of a scene. Transparent objects cast no shadows, and masks those of what they leave.

    Attributes:
        still, moving: the rows of objects that cast shadows: those that can't move, and those that may.
        is_masked: (n,) bool, whether an object's material is a mask.
        coverage: bytes that change when what materials cover does (`find_coverage`).
        looks: bytes that change when objects are hidden or shown, or have other materials (`find_looks`).
    """

    def __init__(self, scene: Scene) -> None:
        objects = scene.objects
        may_move, casts = objects.dynamic | objects.simulated, objects.casts_shadow & objects.shown
        may_move[list(scene.height_fields)] = True  # their triangles do
        self.coverage, self.looks = find_coverage(scene), find_looks(scene)
        self.is_masked: NDArray[np.bool_] = (scene.materials["alpha_mode"] == AlphaMode.MASK)[objects.material]
        casts[scene.find_transparent()] = False
        self.still: Rows = np.flatnonzero(casts & ~may_move)
        self.moving: Rows = np.flatnonzero(casts & may_move)
        self._scene = scene
        self._lamps: dict[str, tuple[bytes, list[Rows]]] = {}
        self._turned: dict[int, tuple[bytes, tuple[Floats, Floats]]] = {}  # boxes of what can't move, by the light

    def find_in_reach(self, kind: str, lights: NDArray[Any]) -> tuple[list[Rows], list[Rows]]:
        """Return, for each of the lights of one kind, the rows of the casters in its range: those that can't move, and
        those that may. The former are found again only if a light has changed."""
        positions, ranges = lights["position"], lights["range"].astype(np.float64)
        key = positions.tobytes() + ranges.tobytes()
        if kind not in self._lamps or self._lamps[kind][0] != key:
            self._lamps[kind] = key, self._pair(self.still, positions, ranges)
        return self._lamps[kind][1], self._pair(self.moving, positions, ranges)

    def _pair(self, rows: Rows, positions: Floats, ranges: Floats) -> list[Rows]:
        lower, upper = self._scene.objects.lower[rows], self._scene.objects.upper[rows]
        return [rows[some] for some in pair_by_light(*list_lights(lower, upper, positions, ranges), len(positions))]

    def turn(self, row: int, axes: Floats) -> LightBoxes:
        """Return the boxes of all casters along the axes of the directional light `row`. Those of what can't move are
        found again only if the light has changed."""
        key = axes.tobytes()
        if row not in self._turned or self._turned[row][0] != key:
            self._turned[row] = key, turn_boxes(self._scene, self.still, axes)
        return LightBoxes(self, self._turned[row][1], turn_boxes(self._scene, self.moving, axes))


def find_looks(scene: Scene) -> bytes:
    """Return bytes that change when objects are hidden or shown, or have other materials."""
    return scene.objects.shown.tobytes() + scene.objects.material.tobytes()


def find_coverage(scene: Scene) -> bytes:
    """Return bytes that change when materials are transparent, cut, or drawn from two sides otherwise than before."""
    materials = scene.materials
    cut = materials["alpha_mode"] == AlphaMode.MASK
    covers = [materials["alpha_mode"], materials["double_sided"]]
    covers += [np.where(cut, values, 0) for values in (materials["alpha_cutoff"], materials["base_color"][:, 3])]
    return np.stack([*covers, np.where(cut, materials["texture"], -1)]).tobytes()


@dataclass(frozen=True, eq=False, slots=True)
class LightBoxes:
    """The boxes of all casters along the axes of a directional light: lower and upper corners (k, 3) each."""

    casters: SceneCasters
    still: tuple[Floats, Floats]
    moving: tuple[Floats, Floats]

    @property
    def top(self) -> float:
        """The distance to which casters reach to the light, from the world's origin."""
        return float(max(np.max(upper[:, 2], initial=-np.inf) for _, upper in (self.still, self.moving)))

    def find(self, cascade: Cascade, receivers: tuple[Floats, Floats]) -> Casters | None:
        """Return the casters whose shadows may fall on receivers in a cascade; None without receivers.

        Args:
            receivers: the boxes of what may be visible, along the same axes.
        """
        middle = cascade.camera.rotation @ cascade.camera.position
        low, high = middle - (cascade.inner, cascade.inner, cascade.length), middle + cascade.inner
        lower, upper = receivers
        inside = ((lower[:, :2] <= high[:2]) & (upper[:, :2] >= low[:2])).all(1) & (upper[:, 2] >= low[2])
        if not inside.any():
            return None
        border = 1.0 / cascade.camera.projection.matrix[0, 0] - cascade.inner  # read by filters
        low = np.maximum(low, lower[inside].min(0)) - (border, border, 0.0)
        high = np.minimum(high, upper[inside].max(0)) + border
        return Casters(
            self.casters.still[_find_above(self.still, low, high)],
            self.casters.moving[_find_above(self.moving, low, high)],
        )


def _find_above(boxes: tuple[Floats, Floats], low: Floats, high: Floats) -> Rows:
    """Return the boxes (k,) that meet a column: between `low` and `high` to the sides, above `low` to the light."""
    lower, upper = boxes
    meets = ((lower[:, :2] <= high[:2]) & (upper[:, :2] >= low[:2])).all(1) & (upper[:, 2] >= low[2])
    return np.flatnonzero(meets)


def turn_boxes(scene: Scene, rows: Rows, axes: Floats) -> tuple[Floats, Floats]:
    """Return the lower and the upper corners (k, 3) of the boxes of the objects `rows` along other axes, whose unit
    vectors are the rows of `axes`."""
    lower, upper = scene.objects.lower[rows], scene.objects.upper[rows]
    middle = (0.5 * lower + 0.5 * upper) @ axes.T
    half = (0.5 * upper - 0.5 * lower) @ np.abs(axes).T
    half += _MARGIN * (np.abs(middle) + half)
    return middle - half, middle + half


def find_moving(
    scene: Scene,
    positions: Floats,
    ranges: Floats,
    planes: Sequence[Floats],
    casters: Sequence[Rows],
    cameras: Sequence[Camera],
) -> tuple[list[Rows], NDArray[np.bool_]]:
    """Return the casters that may move in each map of some lamps, and (m,) whether any of them shades what is in view.

    Args:
        positions, ranges: (l, 3) and (l,) of the lamps. planes: of each lamp the planes (k, p, 4) of its k maps.
        casters: those in reach of each lamp. cameras: of the views.
    """
    counts, sizes, rows = [len(some) for some in casters], [len(maps) for maps in planes], np.concatenate(casters)
    lower, upper = scene.objects.lower[rows], scene.objects.upper[rows]
    shadows = find_shadow_boxes(lower, upper, np.repeat(positions, counts, axis=0), np.repeat(ranges, counts))
    shades = np.any([classify(camera.frustum.planes, *shadows) != Containment.OUTSIDE for camera in cameras], axis=0)
    # Each caster is tested against each map of its lamp.
    maps, first = np.repeat(sizes, counts), np.repeat(np.cumsum(sizes) - sizes, counts)
    caster = np.repeat(np.arange(len(rows)), maps)
    of = list_ranges(first, maps)
    inside = classify(np.concatenate(planes)[of], lower[caster], upper[caster]) != Containment.OUTSIDE
    of, caster = of[inside], caster[inside]
    ends = np.cumsum(np.bincount(of, minlength=sum(sizes)))
    shown = np.split(rows[caster[np.argsort(of, kind="stable")]], ends[:-1])
    return shown, np.bincount(of, shades[caster], sum(sizes)) > 0.0
