"""The limit of the errors of levels of detail: what a view allows an object, on the CPU and on the device.

A level's error bounds its distance from the mesh. Seen from a distance, it is fewer pixels than a limit: so the image
of the level is nowhere farther than that from the mesh's. The coarsest level within the limit is drawn. A change of
levels moves no edge by more than twice the limit, so there is no hysteresis.

- With perspective, a point that is moved by e at a distance d from the eye, e < d, moves on the image plane by at most
  f e / (d - e) / cos²: f is the focal length in pixels, and the cosine that of the angle to the image's corner.
- The distance is that from the eye to the box along the world's axes around the object's transformed mesh box, so a
  turn of the camera changes no level.
- An object's transform stretches an error by at most the square root of the largest row sum of |AᵀA|, A being its
  linear part: exact for rotations and uniform scales.
- All passes of a frame, and both eyes, have the same limit, and so the same levels. Shadow maps have limits of their
  own: those of their cameras, in texels.

The CPU computes in float64 (`DetailLimit.count_levels`), the device the same in float32 (`ChooseLevels`), with the
distance less its rounding: so it draws no coarser level than the CPU would, and a finer one only where the CPU's choice
changes within `ROUNDING` of the distance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

import rhi.shading as sl
from renderer.scene import Camera
from renderer.scene.arrays import Floats, Indices
from renderer.shaders import MeshPart, Object, ObjectPosition
from renderer.visibility.boxes.bounds import ROUNDING
from rhi.math import is_parallel

_STEPS: Final = 256.0
"""Limits are rounded down to such parts of a power of two, so that offsets of samples don't change them, and float32
holds them exactly."""
GROUP: Final = 64
"""Number of objects per work-group."""


class DetailConstants(sl.Struct):
    """A `DetailLimit` on the device: two eyes, the same twice where there is one, each as a pair of floats for each
    double. Without a limit the constant is negative."""

    eye_high: sl.vec3
    constant: float
    eye_low: sl.vec3
    slope: float
    other_high: sl.vec3
    other_low: sl.vec3


@dataclass(frozen=True, eq=False, slots=True)
class DetailLimit:
    """The largest error, in metres, that an object at a distance may have: `constant` + `slope` times the distance.

    Attributes:
        eyes: (e, 3) positions, the nearest of which counts.
    """

    eyes: Floats
    constant: float
    slope: float

    @classmethod
    def compute(cls, cameras: Sequence[Camera], size: tuple[int, int], pixels: float) -> DetailLimit | None:
        """Return the limit of images of this size whose errors are at most so many pixels, None for no error."""
        if not pixels > 0.0:
            return None
        constants, slopes = [], []
        for camera in cameras:
            matrix = camera.projection.matrix
            scale = 0.5 * max(abs(matrix[0, 0]) * size[0], abs(matrix[1, 1]) * size[1])
            if is_parallel(camera.projection):
                constants.append(pixels / scale)
                slopes.append(0.0)
                continue
            tangents = [(1.0 + abs(matrix[axis, 2])) / abs(matrix[axis, axis]) for axis in (0, 1)]
            angle = pixels / (scale * (1.0 + tangents[0] ** 2 + tangents[1] ** 2))
            constants.append(0.0)
            slopes.append(angle / (1.0 + angle))
        eyes = np.array([camera.position for camera in cameras])
        return cls(eyes, _round_down(min(constants)), _round_down(min(slopes)))

    def allow(self, lower: Floats, upper: Floats) -> Floats:
        """Return the largest errors (k,) of objects with these bounds (k, 3)."""
        away = np.maximum(np.maximum(lower - self.eyes[:, None], self.eyes[:, None] - upper), 0.0)
        distances = np.sqrt((away * away).sum(axis=-1)).min(axis=0)
        errors: Floats = self.constant + self.slope * distances
        return errors

    def count_levels(self, world: Floats, lower: Floats, upper: Floats, errors: Floats) -> Indices:
        """Return the level (k,) that each object is drawn as, 0 for its mesh.

        Args:
            world: the transforms (k, 4, 4).
            lower, upper: the boxes (k, 3) of the meshes.
            errors: those of the meshes' levels (k, most levels), ascending, infinite where there is none.
        """
        linear = world[:, :3, :3]
        gram = linear.transpose(0, 2, 1) @ linear
        stretch = np.sqrt(np.abs(gram).sum(axis=2).max(axis=1))
        centre = world[:, :3, 3] + (linear @ (0.5 * (lower + upper))[..., None])[..., 0]
        half = (np.abs(linear) @ (0.5 * (upper - lower))[..., None])[..., 0]
        allowed = self.allow(centre - half, centre + half)
        levels: Indices = (errors * stretch[:, None] <= allowed[:, None]).sum(axis=1)
        return levels


def make_constants(limit: DetailLimit | None) -> DetailConstants:
    """Return a limit as shaders read it; without one, no level is coarse enough to be left."""
    if limit is None:
        zero = (0.0, 0.0, 0.0)
        return DetailConstants(
            eye_high=zero, constant=-1.0, eye_low=zero, slope=0.0, other_high=zero, other_low=zero
        )
    eyes = limit.eyes[[0, -1]]
    high = eyes.astype(np.float32)
    low = (eyes - high).astype(np.float32)
    return DetailConstants(
        eye_high=high[0],
        constant=limit.constant,
        eye_low=low[0],
        slope=limit.slope,
        other_high=high[1],
        other_low=low[1],
    )


@sl.function
def least_distance(to_object: sl.vec3, middle: sl.vec3, half: sl.vec3, reach: float) -> float:
    """Return at least how far an eye is from a box, given the vector from the eye to the object's position, the box's
    middle from there and its half sizes, and a bound of their lengths."""
    away = sl.max(sl.abs(to_object + middle) - half, sl.vec3(0.0))
    return sl.max(sl.length(away) - ROUNDING * (sl.length(to_object) + 2.0 * reach), 0.0)


class ChooseLevels(sl.Shader):
    """Writes the mesh part that each object is drawn as: that of its mesh, or of the coarsest level within the
    limit. Computes what `DetailLimit.count_levels` does."""

    work_group = (GROUP,)
    detail: sl.Uniform[DetailConstants]
    objects: sl.Storage[Object]
    object_positions: sl.Storage[ObjectPosition]
    object_meshes: sl.Storage[int]
    mesh_parts: sl.Storage[MeshPart]
    drawn_parts: sl.StorageRW[int]

    def compute(self) -> None:
        index = sl.global_id().x
        if index >= len(self.drawn_parts):
            return
        drawn = self.object_meshes[index]
        part = self.mesh_parts[drawn]
        if part.level_count > 0:
            linear = self.objects[index].linear
            columns = sl.transpose(linear)
            xx = sl.dot(columns[0], columns[0])
            yy = sl.dot(columns[1], columns[1])
            zz = sl.dot(columns[2], columns[2])
            xy = sl.abs(sl.dot(columns[0], columns[1]))
            yz = sl.abs(sl.dot(columns[1], columns[2]))
            zx = sl.abs(sl.dot(columns[2], columns[0]))
            rows = sl.max(sl.max(xx + xy + zx, xy + yy + yz), zx + yz + zz)
            stretch = sl.sqrt(rows) * (1.0 + 2.0 * ROUNDING)
            mesh_middle = 0.5 * (part.lower + part.upper)
            mesh_half = 0.5 * (part.upper - part.lower)
            middle = linear @ mesh_middle
            half = (
                sl.abs(columns[0]) * mesh_half.x
                + sl.abs(columns[1]) * mesh_half.y
                + sl.abs(columns[2]) * mesh_half.z
            )
            reach = stretch * (sl.length(mesh_middle) + sl.length(mesh_half))
            position = self.object_positions[index]
            detail = self.detail
            first = (position.high - detail.eye_high) + (position.low - detail.eye_low)
            second = (position.high - detail.other_high) + (position.low - detail.other_low)
            distance = sl.min(
                least_distance(first, middle, half, reach), least_distance(second, middle, half, reach)
            )
            allowed = detail.constant + detail.slope * distance
            for number in range(part.level_count):
                level = part.first_level + number
                if self.mesh_parts[level].error * stretch <= allowed:
                    drawn = level
        self.drawn_parts[index] = drawn


def _round_down(value: float) -> float:
    mantissa, exponent = np.frexp(value)
    return float(np.ldexp(np.floor(mantissa * _STEPS) / _STEPS, exponent))
