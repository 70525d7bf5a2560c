"""Bounding volumes against planes, on arrays: aligned boxes, oriented boxes and spheres (thesis 5.2, 6.1).

All three are tested in one way: how far the centre lies before a plane, and how far the volume reaches along
the plane's normal. That is the thesis's n- and p-vertex without choosing corners: the p-vertex is centre plus
reach, the n-vertex centre minus reach. A margin wider than all rounding goes to the side of caution: what is
said to be outside is, and what is said to be inside is.

An oriented box is its mesh's aligned box under the object's transform, a parallelepiped if that shears. It is
never larger than the aligned box around it, a sphere mostly is; but of a few numbers, and one test for all turns.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from enum import IntEnum
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from renderer.scene import Scene
from renderer.scene.arrays import Floats, Rows

__rhi_internal__ = True

_MARGIN: Final = 64.0 * float(np.finfo(np.float64).eps)  # of the terms' sum; they round by 16 at most

_RIGHT: Final = 1e-9  # cosine of an angle that is right
_WORTH: Final = 0.98  # of the aligned box's surface: a hair less isn't worth another box


class Containment(IntEnum):
    """Where a volume is: outside some plane, across one, or inside all."""

    OUTSIDE = 0
    CROSSING = 1
    INSIDE = 2


class Volumes(Protocol):
    """n bounding volumes; `centre` is (n, 3), `scale` (n,) the size of the numbers that they were made of."""

    @property
    def centre(self) -> Floats: ...

    @property
    def scale(self) -> Floats: ...

    def reach(self, normals: Floats) -> Floats:
        """(n, p): how far they reach from their centres along `normals` (p, 3)."""
        ...


@dataclass(frozen=True, eq=False, slots=True)
class AlignedBoxes:
    """Boxes with the world's axes: `lower`, `upper` (n, 3)."""

    lower: Floats
    upper: Floats

    @property
    def centre(self) -> Floats:
        return 0.5 * self.lower + 0.5 * self.upper

    @property
    def scale(self) -> Floats:
        return np.asarray(np.maximum(np.abs(self.lower), np.abs(self.upper)).sum(axis=1))

    def reach(self, normals: Floats) -> Floats:
        """(n, p): how far they reach from their centres along `normals` (p, 3)."""
        return (0.5 * self.upper - 0.5 * self.lower) @ np.abs(normals).T


@dataclass(frozen=True, eq=False, slots=True)
class OrientedBoxes:
    """Boxes of any direction: `axes` (n, 3, 3), row by row the vectors from `centre` (n, 3) to three faces."""

    centre: Floats
    axes: Floats
    scale: Floats

    def reach(self, normals: Floats) -> Floats:
        """(n, p): how far they reach from their centres along `normals` (p, 3)."""
        return np.asarray(np.abs(self.axes @ normals.T).sum(axis=1))


@dataclass(frozen=True, eq=False, slots=True)
class Spheres:
    """`centre` (n, 3) and `radius` (n,)."""

    centre: Floats
    radius: Floats
    scale: Floats

    def reach(self, normals: Floats) -> Floats:
        """(n, p): the radius, along unit `normals` (p, 3)."""
        return np.broadcast_to(self.radius[:, None], (len(self.radius), len(normals)))


Fit = Callable[[Scene, Rows], Volumes]
"""Makes one kind of volume around objects."""


def classify(planes: Floats, volumes: Volumes) -> NDArray[np.uint8]:
    """(n,) of `Containment`: where volumes are by `planes` (p, 4), unit normals inward."""
    normals, offsets = planes[:, :3], planes[:, 3]
    before = volumes.centre @ normals.T + offsets
    reach = volumes.reach(normals)
    margin = _MARGIN * (volumes.scale[:, None] + reach + np.abs(offsets))
    inside = (before - reach >= margin).all(axis=1)
    outside = (before + reach < -margin).any(axis=1)
    side = np.where(inside, Containment.INSIDE, Containment.CROSSING)
    return np.where(outside, Containment.OUTSIDE, side).astype(np.uint8)


def fit_aligned(scene: Scene, rows: Rows) -> AlignedBoxes:
    """Around the objects with these rows (n,)."""
    return AlignedBoxes(scene.objects.lower[rows], scene.objects.upper[rows])


def fit_oriented(scene: Scene, rows: Rows) -> OrientedBoxes:
    """Around the objects with these rows (n,)."""
    centre, half, linear, scale = _locate(scene, rows)
    return OrientedBoxes(centre, np.swapaxes(linear, 1, 2) * half[:, :, None], scale)


def fit_spheres(scene: Scene, rows: Rows) -> Spheres:
    """Around the objects with these rows (n,): their mesh's sphere, stretched as its longest direction is."""
    centre, _, linear, scale = _locate(scene, rows)
    stretch = np.linalg.norm(linear, 2, axis=(1, 2))
    radius = scene.meshes.radius[scene.objects.mesh[rows]] * stretch
    return Spheres(centre, radius * (1.0 + _MARGIN), scale)


@dataclass(frozen=True, eq=False, slots=True)
class TurnedBoxes:
    """Rectangular boxes, k of them, that fit their objects closer than aligned ones.

    Attributes:
        rows: (k,) objects.
        centre, half: (k, 3) in the world, and along their own axes.
        turn: (k, 3, 3) those axes: unit vectors, row by row, right-handed.
    """

    rows: Rows
    centre: Floats
    half: Floats
    turn: Floats


class TightestBoxes:
    """Which objects of a scene are asked for by a turned box; of those that move, as they are now."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._static = find_turned(scene, scene.objects.static_rows)

    def find(self) -> TurnedBoxes:
        """All turned boxes."""
        moving = self._scene.objects.dynamic_rows
        if not len(moving):
            return self._static
        both = (self._static, find_turned(self._scene, moving))
        return TurnedBoxes(
            *(np.concatenate([getattr(one, field.name) for one in both]) for field in fields(TurnedBoxes))
        )


def find_turned(scene: Scene, rows: Rows) -> TurnedBoxes:
    """Of the objects with these rows (n,), those whose oriented box is rectangular and of a smaller surface than
    their aligned one."""
    oriented, aligned = fit_oriented(scene, rows), fit_aligned(scene, rows)
    half = np.sqrt((oriented.axes**2).sum(axis=2))
    turn = oriented.axes / np.where(half > 0.0, half, 1.0)[:, :, None]
    flat = half == 0.0
    for axis in range(3):  # a flat box's axis is at right angles to the others
        first, second = (axis + 1) % 3, (axis + 2) % 3
        turn[flat[:, axis], axis] = np.cross(turn[flat[:, axis], first], turn[flat[:, axis], second])
    turn[:, 2] *= np.sign(np.linalg.det(turn))[:, None]  # right-handed; of a box, all signs are the same
    off = np.abs(np.einsum("nij,nkj->nik", turn, turn) - np.eye(3)).max(axis=(1, 2))
    # The rounding of the oriented box's corners, which the aligned one has within it.
    half += _MARGIN * oriented.scale[:, None]
    better = _surface(half) < _WORTH * _surface(0.5 * (aligned.upper - aligned.lower))
    chosen = np.flatnonzero((off < _RIGHT) & better)
    return TurnedBoxes(rows[chosen], oriented.centre[chosen], half[chosen], turn[chosen])


def _surface(half: Floats) -> Floats:
    return np.asarray((half * np.roll(half, 1, axis=1)).sum(axis=1))


def _locate(scene: Scene, rows: Rows) -> tuple[Floats, Floats, Floats, Floats]:
    """Centres in the world (n, 3), half sizes in mesh space (n, 3), linear parts (n, 3, 3), and scales (n,)."""
    mesh, world = scene.objects.mesh[rows], scene.nodes.world[scene.objects.node[rows]]
    lower, upper = scene.meshes.lower[mesh], scene.meshes.upper[mesh]
    linear, offset = world[:, :3, :3], world[:, :3, 3]
    middle = 0.5 * (lower + upper)
    centre = np.einsum("nij,nj->ni", linear, middle) + offset
    furthest = np.maximum(np.abs(lower), np.abs(upper))
    scale = (np.einsum("nij,nj->ni", np.abs(linear), furthest) + np.abs(offset)).sum(axis=1)
    return centre, 0.5 * (upper - lower), linear, scale
