"""Shadow casters: the objects drawn to each shadow map, since their shadows may fall on something visible.

Casters that can't move are kept apart from those that may: the former are drawn once, the latter over a copy
of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from renderer.lights.object_lists import list_lights
from renderer.scene import AlphaMode, Camera, Scene
from renderer.scene.arrays import Floats, Indices, list_ranges
from renderer.shadows.cascades import Cascade
from renderer.shadows.huge_casters import can_be_cut, is_huge, largest_extent
from renderer.shadows.local_light_maps import pair_by_light, shadow_boxes
from renderer.visibility.boxes.volumes import Containment, classify
from rhi.math.indexing import count_indices, repeat_each

_OCTAVES = 2  # of heights above a map whose casters share a camera
_MARGIN = 1e-9  # by which boxes are too large, relative to their coordinates


@dataclass(frozen=True, eq=False, slots=True)
class Casters:
    """The casters of a map.

    Attributes:
        static: the rows of objects that can't move.
        dynamic: the rows of those that may.
        upper: of those that reach above the map's depth range, the rows and the camera that sees their upper
            part.
        beyond: the rows of those that are wholly above the range.
        huge: the rows of those that have to be cut to the map.
        uncut: the rows of those that would have to be, and can't.
    """

    static: Indices
    dynamic: Indices
    upper: tuple[tuple[Camera, Indices], ...] = ()
    beyond: Indices = field(default_factory=lambda: np.zeros(0, np.int64))
    huge: Indices = field(default_factory=lambda: np.zeros(0, np.int64))
    uncut: Indices = field(default_factory=lambda: np.zeros(0, np.int64))

    def __len__(self) -> int:
        return len(self.static) + len(self.dynamic)


class SceneCasters:
    """The casters of a scene. Transparent objects cast no shadows; a mask casts one where its alpha isn't
    cut.

    Attributes:
        scene: the scene.
        static, dynamic: the rows of objects that cast shadows: those that can't move, and those that may.
        is_masked: (n,) bool, whether an object's material is a mask.
        coverage: bytes that change when what materials cover does (`coverage_key`).
        appearance: bytes that change when objects are hidden or shown, or have other materials
            (`appearance_key`).
    """

    def __init__(self, scene: Scene) -> None:
        objects = scene.objects
        may_move, casts = objects.dynamic | objects.simulated, objects.casts_shadow & objects.is_shown
        may_move[list(scene.tessellated)] = True  # their triangles do
        self.coverage, self.appearance = coverage_key(scene), appearance_key(scene)
        self.is_masked: NDArray[np.bool_] = scene.flag_cut()[objects.material]
        casts[scene.list_transparent()] = False
        self.static: Indices = np.flatnonzero(casts & ~may_move)
        self.dynamic: Indices = np.flatnonzero(casts & may_move)
        self.scene = scene
        self._casters_by_kind: dict[str, tuple[bytes, list[Indices]]] = {}
        self._turned: dict[int, tuple[bytes, tuple[Floats, Floats], float, float]] = {}
        """By light, its axes, and the boxes of what can't move with their top and extent."""

    def casters_in_range(self, kind: str, lights: NDArray[Any]) -> tuple[list[Indices], list[Indices]]:
        """Return the rows of the casters in the range of each light of a kind: lists of those that can't
        move, and of those that may. The former are computed again only if a light has changed."""
        positions, ranges = lights["position"], lights["range"].astype(np.float64)
        key = positions.tobytes() + ranges.tobytes()
        if kind not in self._casters_by_kind or self._casters_by_kind[kind][0] != key:
            self._casters_by_kind[kind] = key, self._pair(self.static, positions, ranges)
        return self._casters_by_kind[kind][1], self._pair(self.dynamic, positions, ranges)

    def _pair(self, rows: Indices, positions: Floats, ranges: Floats) -> list[Indices]:
        lower, upper = self.scene.objects.lower[rows], self.scene.objects.upper[rows]
        return [
            rows[box_indices]
            for box_indices in pair_by_light(*list_lights(lower, upper, positions, ranges), len(positions))
        ]

    def rotate_casters(self, row: int, axes: Floats) -> LightBoxes:
        """Return the boxes of all casters along the axes of the directional light `row`. Those of what can't
        move are computed again only if the light has changed."""
        key = axes.tobytes()
        if row not in self._turned or self._turned[row][0] != key:
            static = rotate_boxes(self.scene, self.static, axes)
            self._turned[row] = key, static, *_top_and_extent(static)
        _, static, static_top, static_extent = self._turned[row]
        dynamic = rotate_boxes(self.scene, self.dynamic, axes)
        top, extent = _top_and_extent(dynamic)
        return LightBoxes(self, static, dynamic, max(top, static_top), max(extent, static_extent))


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
    """The boxes of all casters along the axes of a directional light.

    Attributes:
        casters: those of the scene.
        static: the lower and the upper corners (k, 3) of casters that can't move.
        dynamic: those of casters that may.
        top: the largest coordinate along the axis towards the light, in metres from the world's origin.
        extent: the largest extent of a box along any of the axes, in metres.
    """

    casters: SceneCasters
    static: tuple[Floats, Floats]
    dynamic: tuple[Floats, Floats]
    top: float
    extent: float

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
        static, dynamic = _boxes_above(self.static, low, high), _boxes_above(self.dynamic, low, high)
        selected = Casters(self.casters.static[static], self.casters.dynamic[dynamic])
        if self.top <= cascade.top and self.extent <= largest_extent(cascade):
            return selected
        lower, upper = (
            np.concatenate([self.static[corner][static], self.dynamic[corner][dynamic]]) for corner in (0, 1)
        )
        return self._add_far_and_huge(selected, cascade, lower, upper)

    def _add_far_and_huge(self, selected: Casters, cascade: Cascade, lower: Floats, upper: Floats) -> Casters:
        """Return casters of a map, with boxes (k, 3) along the light's axes, and which of them reach above
        its depth range or are huge."""
        tops, huge = upper[:, 2], is_huge(lower, upper, cascade)
        rows = np.concatenate([selected.static, selected.dynamic])
        cuttable = can_be_cut(self.casters.scene, rows) & ~self.casters.is_masked[rows]
        uncut, huge = rows[huge & ~cuttable], huge & cuttable
        beyond = ~huge & (lower[:, 2] > cascade.top)
        # Cameras are near what they draw: float32 rounds a distance from them as it does a depth.
        above = ~huge & (tops > cascade.top)
        heights = np.maximum(tops - cascade.shelf, cascade.length)
        bands = np.where(above, np.floor(np.log2(heights) / _OCTAVES), -1.0)
        cameras = [
            (cascade.upper_camera(float(tops[bands == band].max())), rows[bands == band])
            for band in np.unique(bands[above])
        ]
        return replace(selected, upper=tuple(cameras), beyond=rows[beyond], huge=rows[huge], uncut=uncut)


def _top_and_extent(boxes: tuple[Floats, Floats]) -> tuple[float, float]:
    """Return the largest coordinate of boxes (k, 3) along the third axis, and their largest extent."""
    lower, upper = boxes
    return float(upper[:, 2].max(initial=-np.inf)), float((upper - lower).max(initial=0.0))


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
    shadows = shadow_boxes(lower, upper, repeat_each(positions, counts, axis=0), repeat_each(ranges, counts))
    shades = np.any(
        [classify(camera.frustum.planes, *shadows) != Containment.OUTSIDE for camera in cameras], axis=0
    )
    # Each caster is tested against each map of its light.
    maps, first = repeat_each(sizes, counts), repeat_each(np.cumsum(sizes) - sizes, counts)
    caster = repeat_each(np.arange(len(rows)), maps)
    of = list_ranges(first, maps)
    inside = classify(np.concatenate(planes)[of], lower[caster], upper[caster]) != Containment.OUTSIDE
    of, caster = of[inside], caster[inside]
    ends = np.cumsum(count_indices(of, minlength=sum(sizes)))
    map_casters = np.split(rows[caster[np.argsort(of, kind="stable")]], ends[:-1])
    return map_casters, count_indices(of, shades[caster], sum(sizes)) > 0.0
