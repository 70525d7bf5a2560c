"""Tests of bounding volumes against planes, on arrays: aligned boxes, oriented boxes and spheres (thesis 5.2, 6.1).

All three kinds are tested in one way: by the signed distance of the centre from a plane, and by the reach of the
volume along the plane's normal. This is the thesis's test of n- and p-vertex without choosing corners: the p-vertex
is centre plus reach, the n-vertex centre minus reach. A margin wider than all rounding makes the test conservative:
volumes classified as outside are outside, and those classified as inside are inside.

An oriented box is its mesh's aligned box under the object's transform: a parallelepiped if that shears. It is never
larger than the aligned box around it. A sphere usually is, but it has only a few numbers, and its test is the same
for all rotations.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from enum import IntEnum
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from renderer.scene import Camera, Scene
from renderer.scene.arrays import Floats, Rows

_MARGIN: Final = 64.0 * float(np.finfo(np.float64).eps)  # of the terms' sum; they round by 16 eps at most

_RIGHT: Final = 1e-9  # largest cosine of an angle that counts as right
_WORTH: Final = 0.98  # of the aligned box's surface: a smaller saving isn't worth another box


class Containment(IntEnum):
    """The position of a volume relative to planes: outside of some plane, crossing one, or inside of all."""

    OUTSIDE = 0
    CROSSING = 1
    INSIDE = 2


class Volumes(Protocol):
    """A set of n bounding volumes: `centre` (n, 3), and `scale` (n,), the magnitude of the numbers they are made of."""

    @property
    def centre(self) -> Floats: ...

    @property
    def scale(self) -> Floats: ...

    def reach(self, normals: Floats) -> Floats:
        """Return (n, p): how far the volumes reach from their centres along `normals` (p, 3)."""
        ...


@dataclass(frozen=True, eq=False, slots=True)
class AlignedBoxes:
    """Boxes along the world's axes: corners `lower` and `upper` (n, 3)."""

    lower: Floats
    upper: Floats

    @property
    def centre(self) -> Floats:
        return 0.5 * self.lower + 0.5 * self.upper

    @property
    def scale(self) -> Floats:
        return np.asarray(np.maximum(np.abs(self.lower), np.abs(self.upper)).sum(axis=1))

    def reach(self, normals: Floats) -> Floats:
        """Return (n, p): how far the volumes reach from their centres along `normals` (p, 3)."""
        return (0.5 * self.upper - 0.5 * self.lower) @ np.abs(normals).T


@dataclass(frozen=True, eq=False, slots=True)
class OrientedBoxes:
    """Boxes of any orientation: the rows of `axes` (n, 3, 3) are vectors from `centre` (n, 3) to three faces."""

    centre: Floats
    axes: Floats
    scale: Floats

    def reach(self, normals: Floats) -> Floats:
        """Return (n, p): how far the volumes reach from their centres along `normals` (p, 3)."""
        return np.asarray(np.abs(self.axes @ normals.T).sum(axis=1))


@dataclass(frozen=True, eq=False, slots=True)
class Spheres:
    """Spheres with `centre` (n, 3) and `radius` (n,)."""

    centre: Floats
    radius: Floats
    scale: Floats

    def reach(self, normals: Floats) -> Floats:
        """Return (n, p): the radii, for unit `normals` (p, 3)."""
        return np.broadcast_to(self.radius[:, None], (len(self.radius), len(normals)))


Fit = Callable[[Scene, Rows], Volumes]
"""A function that makes one kind of volume around the objects with given rows."""


def classify(planes: Floats, volumes: Volumes) -> NDArray[np.uint8]:
    """Return (n,) of `Containment`: the volumes' positions relative to `planes` (p, 4) with unit normals inward."""
    normals, offsets = planes[:, :3], planes[:, 3]
    before = volumes.centre @ normals.T + offsets
    reach = volumes.reach(normals)
    margin = _MARGIN * (volumes.scale[:, None] + reach + np.abs(offsets))
    inside = (before - reach >= margin).all(axis=1)
    outside = (before + reach < -margin).any(axis=1)
    side = np.where(inside, Containment.INSIDE, Containment.CROSSING)
    return np.where(outside, Containment.OUTSIDE, side).astype(np.uint8)


def fit_aligned(scene: Scene, rows: Rows) -> AlignedBoxes:
    """Return the aligned boxes around the objects `rows` (n,)."""
    return AlignedBoxes(scene.objects.lower[rows], scene.objects.upper[rows])


def find_in_view(scene: Scene, camera: Camera, rows: Rows) -> Rows:
    """Return those of the objects `rows` (k,) whose bounds are not outside the view."""
    if not len(rows):
        return rows
    side = classify(camera.frustum.planes, fit_aligned(scene, rows))
    return np.asarray(rows.take(np.flatnonzero(side != Containment.OUTSIDE)))


def fit_oriented(scene: Scene, rows: Rows) -> OrientedBoxes:
    """Return the oriented boxes around the objects `rows` (n,)."""
    centre, half, linear, scale = _locate(scene, rows)
    return OrientedBoxes(centre, np.swapaxes(linear, 1, 2) * half[:, :, None], scale)


def fit_spheres(scene: Scene, rows: Rows) -> Spheres:
    """Return spheres around the objects `rows` (n,): those of their meshes, scaled by the largest stretch."""
    centre, _, linear, scale = _locate(scene, rows)
    stretch = np.linalg.norm(linear, 2, axis=(1, 2))
    radius = scene.objects.boxes.radius[rows] * stretch
    return Spheres(centre, radius * (1.0 + _MARGIN), scale)


@dataclass(frozen=True, eq=False, slots=True)
class RotatedBoxes:
    """Rectangular boxes, k of them, that fit their objects more closely than aligned ones.

    Attributes:
        rows: (k,) the rows of the objects.
        centre: (k, 3) world positions. half: (k, 3) half sizes along the boxes' own axes.
        axes: (k, 3, 3) those axes: the rows are unit vectors, right-handed.
    """

    rows: Rows
    centre: Floats
    half: Floats
    axes: Floats


class TightestBoxes:
    """Finds the objects of a scene whose tightest box is a rotated one. Those with fixed bounds are examined once."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._static = find_rotated(scene, scene.objects.fixed_rows)

    def find(self) -> RotatedBoxes:
        """Return the rotated boxes of all such objects, of moving ones as they are now."""
        moving = self._scene.objects.following_rows
        if not len(moving):
            return self._static
        both = (self._static, find_rotated(self._scene, moving))
        return RotatedBoxes(
            *(np.concatenate([getattr(one, field.name) for one in both]) for field in fields(RotatedBoxes))
        )


def find_rotated(scene: Scene, rows: Rows) -> RotatedBoxes:
    """Return rotated boxes of those of the objects `rows` (n,) whose oriented box is rectangular and has a smaller
    surface than the aligned one."""
    oriented, aligned = fit_oriented(scene, rows), fit_aligned(scene, rows)
    half = np.sqrt((oriented.axes**2).sum(axis=2))
    axes = oriented.axes / np.where(half > 0.0, half, 1.0)[:, :, None]
    flat = half == 0.0
    for axis in range(3):  # the axis along which a box is flat is at right angles to the others
        first, second = (axis + 1) % 3, (axis + 2) % 3
        axes[flat[:, axis], axis] = np.cross(axes[flat[:, axis], first], axes[flat[:, axis], second])
    axes[:, 2] *= np.sign(np.linalg.det(axes))[
        :, None
    ]  # right-handed; a box looks the same with an axis reversed
    off = np.abs(np.einsum("nij,nkj->nik", axes, axes) - np.eye(3)).max(axis=(1, 2))
    # The rounding of the oriented box's corners; the aligned box already includes its own.
    half += _MARGIN * oriented.scale[:, None]
    better = _surface(half) < _WORTH * _surface(0.5 * (aligned.upper - aligned.lower))
    chosen = np.flatnonzero((off < _RIGHT) & better)
    return RotatedBoxes(rows[chosen], oriented.centre[chosen], half[chosen], axes[chosen])


def _surface(half: Floats) -> Floats:
    return np.asarray((half * np.roll(half, 1, axis=1)).sum(axis=1))


def _locate(scene: Scene, rows: Rows) -> tuple[Floats, Floats, Floats, Floats]:
    """Return world centres (n, 3), half sizes in the boxes' own spaces (n, 3), linear parts (n, 3, 3), and scales
    (n,)."""
    boxes = scene.objects.boxes
    world, lower, upper = boxes.place(scene.nodes, rows), boxes.lower[rows], boxes.upper[rows]
    linear, offset = world[:, :3, :3], world[:, :3, 3]
    middle = 0.5 * (lower + upper)
    centre = np.einsum("nij,nj->ni", linear, middle) + offset
    furthest = np.maximum(np.abs(lower), np.abs(upper))
    scale = (np.einsum("nij,nj->ni", np.abs(linear), furthest) + np.abs(offset)).sum(axis=1)
    return centre, 0.5 * (upper - lower), linear, scale
