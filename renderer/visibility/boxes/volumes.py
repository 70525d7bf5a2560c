"""Boxes of objects: where the aligned ones are relative to planes, and the rotated ones that fit more
closely.

A box is tested by the signed distance of its centre from a plane, and by its reach along the plane's normal.
This is the thesis's test of n- and p-vertex (5.2, 6.1) without choosing corners: the p-vertex is centre plus
reach, the n-vertex centre minus reach. A margin wider than all rounding makes the test conservative: boxes
classified as outside are outside, and those classified as inside are inside.

A rotated box is its mesh's aligned box under the object's transform, where that is rectangular.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from enum import IntEnum
from typing import Final

import numpy as np
from numpy.typing import NDArray

from renderer.scene import Camera, Scene
from renderer.scene.arrays import Floats, Indices

_MARGIN: Final = 64.0 * float(np.finfo(np.float64).eps)  # of the terms' sum; they round by 16 eps at most

_MAX_RIGHT_COSINE: Final = 1e-9  # largest cosine of an angle that counts as right
_MAX_AREA_RATIO: Final = 0.98  # of the aligned box's surface: a smaller saving isn't worth another box


class Containment(IntEnum):
    """The position of a box relative to planes: outside of some plane, crossing one, or inside of all."""

    OUTSIDE = 0
    CROSSING = 1
    INSIDE = 2


def classify(planes: Floats, lower: Floats, upper: Floats) -> NDArray[np.uint8]:
    """Return (n,) of `Containment`: the positions of boxes (n, 3) relative to `planes` (p, 4) with unit
    normals inward, or each relative to planes of its own (n, p, 4)."""
    before, reach, margin = _measure(planes, lower, upper)
    inside = (before - reach >= margin).all(axis=1)
    side = np.where(inside, Containment.INSIDE, Containment.CROSSING)
    return np.where(_is_outside(before, reach, margin), Containment.OUTSIDE, side).astype(np.uint8)


def _measure(planes: Floats, lower: Floats, upper: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the signed distance of the centre of each box from each plane (n, p), the box's reach along the
    normal, and the margin of both."""
    normals, offsets = planes[..., :3], planes[..., 3]
    centre, half, extents = 0.5 * lower + 0.5 * upper, 0.5 * upper - 0.5 * lower, np.abs(normals)
    if normals.ndim == 2:
        before, reach = centre @ normals.T + offsets, half @ extents.T
    else:
        before, reach = _project(normals, centre) + offsets, _project(extents, half)
    scale = np.add.reduce(np.maximum(np.abs(lower), np.abs(upper)), axis=1)
    return before, reach, _MARGIN * (scale[:, None] + reach + np.abs(offsets))


def _is_outside(before: Floats, reach: Floats, margin: Floats) -> NDArray[np.bool_]:
    """A mask (n,) of the measured boxes that lie outside of one of their planes."""
    return np.asarray(np.logical_or.reduce(before + reach < -margin, axis=1))


def _project(normals: Floats, vectors: Floats) -> Floats:
    return np.asarray((normals @ vectors[:, :, None])[..., 0])


def select_in_view(scene: Scene, camera: Camera, object_indices: Indices) -> Indices:
    """Return those of the objects `object_indices` (k,) that are shown and whose bounds are not outside the
    view."""
    return (
        select_inside(scene, camera.frustum.planes, object_indices) if len(object_indices) else object_indices
    )


def select_inside(scene: Scene, planes: Floats, object_indices: Indices) -> Indices:
    """Return those of the objects `object_indices` (k,) that are shown and whose bounds are not outside of
    `planes` (p, 4)."""
    object_indices = scene.objects.select_shown(object_indices)
    lower, upper = scene.objects.lower[object_indices], scene.objects.upper[object_indices]
    return object_indices[~_is_outside(*_measure(planes, lower, upper))]


@dataclass(frozen=True, eq=False, slots=True)
class RotatedBoxes:
    """Rectangular boxes, k of them, that fit their objects more closely than aligned ones.

    Attributes:
        object_indices: (k,) the indices of the objects.
        centre: (k, 3) world positions.
        half: (k, 3) half sizes along the boxes' own axes.
        axes: (k, 3, 3) those axes: the rows are unit vectors, right-handed.
    """

    object_indices: Indices
    centre: Floats
    half: Floats
    axes: Floats


class TightestBoxes:
    """Finds the objects of a scene whose tightest box is a rotated one. Those with fixed bounds are examined
    once."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._static = compute_rotated_boxes(scene, scene.objects.fixed_indices)

    def collect(self) -> RotatedBoxes:
        """Return the rotated boxes of all such objects, of moving ones as they are now."""
        moving = self._scene.objects.following_indices
        if not len(moving):
            return self._static
        box_sets = (self._static, compute_rotated_boxes(self._scene, moving))
        return RotatedBoxes(
            *(
                np.concatenate([getattr(boxes, field.name) for boxes in box_sets])
                for field in fields(RotatedBoxes)
            )
        )


def compute_rotated_boxes(scene: Scene, object_indices: Indices) -> RotatedBoxes:
    """Return rotated boxes of those of the objects `object_indices` (n,) whose oriented box is rectangular
    and has a smaller surface than the aligned one."""
    boxes = scene.objects.boxes
    world = boxes.transforms(scene.nodes, object_indices)
    lower = boxes.lower[object_indices]
    upper = boxes.upper[object_indices]
    linear, offset = world[:, :3, :3], world[:, :3, 3]
    centre = np.einsum("nij,nj->ni", linear, 0.5 * (lower + upper)) + offset
    furthest = np.maximum(np.abs(lower), np.abs(upper))
    scale = (np.einsum("nij,nj->ni", np.abs(linear), furthest) + np.abs(offset)).sum(axis=1)
    axes = np.swapaxes(linear, 1, 2) * (0.5 * (upper - lower))[:, :, None]
    half = np.sqrt((axes**2).sum(axis=2))
    axes = axes / np.where(half > 0.0, half, 1.0)[:, :, None]
    flat = half == 0.0
    for axis in range(3):  # the axis along which a box is flat is at right angles to the others
        first, second = (axis + 1) % 3, (axis + 2) % 3
        axes[flat[:, axis], axis] = np.cross(axes[flat[:, axis], first], axes[flat[:, axis], second])
    # Right-handed; a box looks the same with an axis reversed.
    axes[:, 2] *= np.sign(np.linalg.det(axes))[:, None]
    off = np.abs(np.einsum("nij,nkj->nik", axes, axes) - np.eye(3)).max(axis=(1, 2))
    # The rounding of the oriented box's corners; the aligned box already includes its own.
    half += _MARGIN * scale[:, None]
    better = _surface(half) < _MAX_AREA_RATIO * _surface(
        0.5 * (scene.objects.upper[object_indices] - scene.objects.lower[object_indices])
    )
    tighter = np.flatnonzero((off < _MAX_RIGHT_COSINE) & better)
    return RotatedBoxes(object_indices[tighter], centre[tighter], half[tighter], axes[tighter])


def _surface(half: Floats) -> Floats:
    return np.asarray((half * np.roll(half, 1, axis=1)).sum(axis=1))
