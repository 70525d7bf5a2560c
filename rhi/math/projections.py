"""Projections from view space to clip space: classes and matrices, in float64.

View space looks along -Z with +Y up. Clip depth runs from 0 to 1, reversed by default: 1 at the near plane
and 0 at the far one, as the default depth function (GREATER) and a `clear_depth` of 0 expect. Standard depth,
near 0 and far 1, exists for comparison: it is less accurate. Matrices are row-major, for column vectors:
`matrix @ vector`.
"""

from __future__ import annotations

from dataclasses import replace
from enum import Enum
from functools import cached_property
from math import isfinite
from typing import Protocol

import numpy as np

from rhi.errors.data_classes import dataclass
from rhi.errors.rules import CAMERA_VALUE
from rhi.math.arguments import check_camera, check_real, read_floats
from rhi.math.transforms import Floats, freeze


class Depth(Enum):
    """The direction of clip depth."""

    REVERSED = "reversed"
    """Near 1, far 0: in floats, precise at every distance. Test with GREATER."""
    STANDARD = "standard"
    """Near 0, far 1. Test with LESS."""

    __hash__ = object.__hash__  # Enum's own is a Python function, which each frame would call many times


class Projection(Protocol):
    """The projection of a camera, an immutable value."""

    def __hash__(self) -> int: ...

    @property
    def depth(self) -> Depth:
        """The direction of depth."""

    @property
    def matrix(self) -> Floats:
        """The matrix (4, 4) float64 from view space to clip space."""
        ...

    def with_aspect(self, aspect: float) -> Projection:
        """Return the same projection for an image of width / height = `aspect`."""
        ...


@dataclass(frozen=True)
class Perspective:
    """A perspective projection: vertical field of view in radians, distances in metres; `far` may be
    infinite."""

    fov: float = np.pi / 3
    aspect: float = 16 / 9
    near: float = 0.1
    far: float = np.inf
    depth: Depth = Depth.REVERSED

    def __post_init__(self) -> None:
        check_real("Perspective", fov=self.fov, aspect=self.aspect, near=self.near, far=self.far)
        tip = "angles are in radians: np.radians(60)" if np.pi <= self.fov < 180.0 else ""
        check_camera("Perspective(fov=...)", self.fov, 0.0 < self.fov < np.pi, "between 0 and pi", tip)
        check_camera("Perspective(aspect=...)", self.aspect, 0.0 < self.aspect < np.inf, "above 0, finite")
        check_camera("Perspective(near=...)", self.near, 0.0 < self.near < np.inf, "above 0, finite")
        check_camera(
            "Perspective(far=...)", self.far, self.near < self.far, f"above near={self.near}; may be inf"
        )

    @cached_property
    def matrix(self) -> Floats:
        """The matrix (4, 4) float64 from view space to clip space."""
        focal = 1.0 / np.tan(0.5 * self.fov)
        near, far = self.near, self.far
        m = np.zeros((4, 4))
        m[0, 0] = focal / self.aspect
        m[1, 1] = focal
        m[3, 2] = -1.0
        if self.depth is Depth.REVERSED:
            m[2, 2], m[2, 3] = (
                (0.0, near) if np.isinf(far) else (near / (far - near), near * far / (far - near))
            )
        else:
            m[2, 2], m[2, 3] = (
                (-1.0, -near) if np.isinf(far) else (far / (near - far), near * far / (near - far))
            )
        return freeze(m)

    def with_aspect(self, aspect: float) -> Perspective:
        """Return the same projection for an image of width / height = `aspect`."""
        return self if aspect == self.aspect else replace(self, aspect=aspect)


@dataclass(frozen=True)
class Orthographic:
    """An orthographic projection: `height` of the image in metres; `near` may be 0 or negative."""

    height: float
    aspect: float = 16 / 9
    near: float = 0.0
    far: float = 1000.0
    depth: Depth = Depth.REVERSED

    def __post_init__(self) -> None:
        check_real("Orthographic", height=self.height, aspect=self.aspect, near=self.near, far=self.far)
        check_camera("Orthographic(height=...)", self.height, 0.0 < self.height < np.inf, "above 0, finite")
        check_camera("Orthographic(aspect=...)", self.aspect, 0.0 < self.aspect < np.inf, "above 0, finite")
        check_camera("Orthographic(near=...)", self.near, bool(np.isfinite(self.near)), "finite")
        check_camera("Orthographic(far=...)", self.far, self.near < self.far < np.inf, "above near, finite")

    @cached_property
    def matrix(self) -> Floats:
        """The matrix (4, 4) float64 from view space to clip space."""
        x, y = 0.5 * (self.height * self.aspect), 0.5 * self.height
        return freeze(_project_box(-x, x, -y, y, self.near, self.far, self.depth))

    def with_aspect(self, aspect: float) -> Orthographic:
        """Return the same projection for an image of width / height = `aspect`."""
        return self if aspect == self.aspect else replace(self, aspect=aspect)


def perspective(
    fov: float, aspect: float, near: float = 0.1, far: float = np.inf, depth: Depth = Depth.REVERSED
) -> Floats:
    """Return the (4, 4) matrix of a perspective projection.

    Args:
        fov: the vertical field of view, in radians.
        aspect: width / height of the image.
        near: the distance of the near plane.
        far: the distance of the far plane; it may be infinite.
        depth: the direction of clip depth.

    Raises:
        ValidationError: `camera-bad-value` for a value out of its range.

    Examples:
        >>> matrix = perspective(np.radians(60), 4 / 3, near=0.1)
        >>> clip = matrix @ (0, 0, -0.1, 1)
        >>> float(clip[2] / clip[3])  # depth is reversed: near is 1
        1.0
    """
    return Perspective(fov, aspect, near, far, depth).matrix.copy()


def orthographic(
    left: float,
    right: float,
    bottom: float,
    top: float,
    near: float = -1.0,
    far: float = 1.0,
    depth: Depth = Depth.REVERSED,
) -> Floats:
    """Return the (4, 4) matrix of an orthographic projection of the box between these planes.

    `orthographic(0, width, height, 0)` is for 2D: positions in pixels from the top left corner.

    Args:
        left: the edge of the image in view space; two opposite edges may change sides.
        right: the right edge.
        bottom: the lower edge.
        top: the upper edge.
        near: the distance of the near plane; it may be negative.
        far: the distance of the far plane.
        depth: the direction of clip depth.

    Raises:
        ValidationError: `camera-bad-value` for values that aren't finite, and for two equal edges or planes.
    """
    check_real("orthographic", left=left, right=right, bottom=bottom, top=top, near=near, far=far)
    for name, low, high in (("right", left, right), ("top", bottom, top), ("far", near, far)):
        fine = bool(np.isfinite([low, high]).all()) and low != high
        check_camera(f"orthographic({name}=...)", high, fine, f"finite, and another number than {low}")
    return _project_box(left, right, bottom, top, near, far, depth)


def _project_box(
    left: float, right: float, bottom: float, top: float, near: float, far: float, depth: Depth
) -> Floats:
    m = np.zeros((4, 4))
    m[0, 0] = 2.0 / (right - left)
    m[1, 1] = 2.0 / (top - bottom)
    m[3, 3] = 1.0
    m[0, 3], m[1, 3] = 0.0 - (right + left) / (right - left), 0.0 - (top + bottom) / (top - bottom)
    length = far - near
    if depth is Depth.REVERSED:
        m[2, 2], m[2, 3] = 1.0 / length, far / length
    else:
        m[2, 2], m[2, 3] = -1.0 / length, -near / length
    return m


def is_parallel(projection: Projection) -> bool:
    """True if a projection is orthographic."""
    return bool(projection.matrix[3, 3] != 0.0)


def distance_at_depth(matrix: Floats, depth: float) -> float:
    """Distance along the view at which a projection's matrix (4, 4) gives this clip depth; it may be
    infinite.

    Raises:
        ValidationError: `camera-bad-value` for a depth that isn't a finite number.
    """
    if not (depth.__class__ is float and isfinite(depth)):
        check_real("distance_at_depth", depth=depth)
        check_camera("distance_at_depth(depth=...)", depth, isfinite(depth), "a finite number")
    if not (matrix.__class__ is np.ndarray and matrix.shape == (4, 4) and matrix.dtype.kind == "f"):
        matrix = read_floats("distance_at_depth(matrix=...)", matrix, 4, 4, rule=CAMERA_VALUE)
    below = float(matrix[2, 2] - matrix[3, 2] * depth)
    return float(matrix[2, 3] - matrix[3, 3] * depth) / below if below else np.inf
