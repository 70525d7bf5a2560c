"""Shadow casters: the objects drawn to each shadow map, since their shadows may fall on something visible.

Casters that can't move are kept apart from those that may: the former are drawn once, the latter over a copy
of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from renderer.lights.object_lists import list_lights
from renderer.scene import AlphaMode, Camera, Scene
from renderer.scene.arrays import Floats, Indices, list_ranges
from renderer.shadows.cascades import Cascade
from renderer.shadows.local_light_maps import pair_by_light, shadow_boxes
from renderer.visibility.boxes.volumes import Containment, classify

_MARGIN = 1e-9  # by which boxes are too large, relative to their coordinates


@dataclass(frozen=True, eq=False, slots=True)
class Casters:
    """The casters of a map: rows of objects that can't move, and of those that may."""

    static: Indices
    dynamic: Indices

    def __len__(self) -> int:
        return len(self.static) + len(self.dynamic)


class SceneCasters:
    """The casters of a scene. Transparent objects cast no shadows; a mask casts one where its alpha isn't
    cut.

    Attributes:
        static, dynamic: the rows of objects that cast shadows: those that can't move, and those that may.
        is_masked: (n,) bool, whether an object's material is a mask.
        coverage: bytes that change when what materials cover does (`coverage_key`).
        appearance: bytes that change when objects are hidden or shown, or have other materials
            (`appearance_key`).
    """

    def __init__(self, scene: Scene) -> None:
        objects = scene.objects
        may_move, casts = objects.dynamic | objects.simulated, objects.casts_shadow & objects.is_shown
        may_move[list(scene.height_fields)] = True  # their triangles do
        self.coverage, self.appearance = coverage_key(scene), appearance_key(scene)
        self.is_masked: NDArray[np.bool_] = (scene.materials["alpha_mode"] == AlphaMode.MASK)[
            objects.material
        ]
        casts[scene.list_transparent()] = False
        self.static: Indices = np.flatnonzero(casts & ~may_move)
        self.dynamic: Indices = np.flatnonzero(casts & may_move)
        self._scene = scene
        self._casters_by_kind: dict[str, tuple[bytes, list[Indices]]] = {}
        self._turned: dict[
            int, tuple[bytes, tuple[Floats, Floats]]
        ] = {}  # boxes of what can't move, by the light

    def casters_in_range(self, kind: str, lights: NDArray[Any]) -> tuple[list[Indices], list[Indices]]:
        """Return the rows of the casters in the range of each light of a kind: lists of those that can't
        move, and of those that may. The former are computed again only if a light has changed."""
        positions, ranges = lights["position"], lights["range"].astype(np.float64)
        key = positions.tobytes() + ranges.tobytes()
        if kind not in self._casters_by_kind or self._casters_by_kind[kind][0] != key:
            self._casters_by_kind[kind] = key, self._pair(self.static, positions, ranges)
        return self._casters_by_kind[kind][1], self._pair(self.dynamic, positions, ranges)

    def _pair(self, rows: Indices, positions: Floats, ranges: Floats) -> list[Indices]:
        lower, upper = self._scene.objects.lower[rows], self._scene.objects.upper[rows]
        return [
            rows[box_indices]
            for box_indices in pair_by_light(*list_lights(lower, upper, positions, ranges), len(positions))
        ]

    def rotate_casters(self, row: int, axes: Floats) -> LightBoxes:
        """Return the boxes of all casters along the axes of the directional light `row`. Those of what can't
        move are computed again only if the light has changed."""
        key = axes.tobytes()
        if row not in self._turned or self._turned[row][0] != key:
            self._turned[row] = key, rotate_boxes(self._scene, self.static, axes)
        return LightBoxes(self, self._turned[row][1], rotate_boxes(self._scene, self.dynamic, axes))


def appearance_key(scene: Scene) -> bytes:
    """Return bytes that change when objects are hidden or shown, or have other materials."""
    return scene.objects.is_shown.tobytes() + scene.objects.material.tobytes()


def coverage_key(scene: Scene) -> bytes:
    """Return bytes that change when a material's transparency, mask or two-sidedness changes."""
    materials = scene.materials
    cut = materials["alpha_mode"] == AlphaMode.MASK
    covers = [materials["alpha_mode"], materials["double_sided"]]
    covers += [
        np.where(cut, values, 0) for values in (materials["alpha_cutoff"], materials["base_color"][:, 3])
    ]
    return np.stack([*covers, np.where(cut, materials["texture"], -1)]).tobytes()


@dataclass(frozen=True, eq=False, slots=True)
class LightBoxes:
    """The boxes of all casters along the axes of a directional light: lower and upper corners (k, 3) each."""

    casters: SceneCasters
    static: tuple[Floats, Floats]
    dynamic: tuple[Floats, Floats]

    @property
    def top(self) -> float:
        """The largest coordinate of all casters along the axis towards the light, in metres from the world's
        origin."""
        return float(max(np.max(upper[:, 2], initial=-np.inf) for _, upper in (self.static, self.dynamic)))

    def select_casters(self, cascade: Cascade, receivers: tuple[Floats, Floats]) -> Casters | None:
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
            self.casters.static[_boxes_above(self.static, low, high)],
            self.casters.dynamic[_boxes_above(self.dynamic, low, high)],
        )


def _boxes_above(boxes: tuple[Floats, Floats], low: Floats, high: Floats) -> Indices:
    """Return the indices (k,) of the boxes that meet a column: between `low` and `high` in x and y, above
    `low` in z, towards the light."""
    lower, upper = boxes
    meets = ((lower[:, :2] <= high[:2]) & (upper[:, :2] >= low[:2])).all(1) & (upper[:, 2] >= low[2])
    return np.flatnonzero(meets)


def rotate_boxes(scene: Scene, rows: Indices, axes: Floats) -> tuple[Floats, Floats]:
    """Return the lower and the upper corners (k, 3) of the boxes of the objects `rows` along other axes,
    whose unit vectors are the rows of `axes`."""
    lower, upper = scene.objects.lower[rows], scene.objects.upper[rows]
    middle = (0.5 * lower + 0.5 * upper) @ axes.T
    half = (0.5 * upper - 0.5 * lower) @ np.abs(axes).T
    half += _MARGIN * (np.abs(middle) + half)
    return middle - half, middle + half


def cull_dynamic_casters(
    scene: Scene,
    positions: Floats,
    ranges: Floats,
    planes: Sequence[Floats],
    casters: Sequence[Indices],
    cameras: Sequence[Camera],
) -> tuple[list[Indices], NDArray[np.bool_]]:
    """Return the dynamic casters in each map of some local lights, and (m,) whether any shadow in it may be
    in view.

    Args:
        positions, ranges: (l, 3) and (l,) of the lights.
        planes: of each light the planes (k, p, 4) of its k maps.
        casters: those in reach of each light.
        cameras: of the views.
    """
    counts = [len(light_casters) for light_casters in casters]
    sizes = [len(maps) for maps in planes]
    rows = np.concatenate(casters)
    lower, upper = scene.objects.lower[rows], scene.objects.upper[rows]
    shadows = shadow_boxes(lower, upper, np.repeat(positions, counts, axis=0), np.repeat(ranges, counts))
    shades = np.any(
        [classify(camera.frustum.planes, *shadows) != Containment.OUTSIDE for camera in cameras], axis=0
    )
    # Each caster is tested against each map of its light.
    maps, first = np.repeat(sizes, counts), np.repeat(np.cumsum(sizes) - sizes, counts)
    caster = np.repeat(np.arange(len(rows)), maps)
    of = list_ranges(first, maps)
    inside = classify(np.concatenate(planes)[of], lower[caster], upper[caster]) != Containment.OUTSIDE
    of, caster = of[inside], caster[inside]
    ends = np.cumsum(np.bincount(of, minlength=sum(sizes)))
    map_casters = np.split(rows[caster[np.argsort(of, kind="stable")]], ends[:-1])
    return map_casters, np.bincount(of, shades[caster], sum(sizes)) > 0.0
