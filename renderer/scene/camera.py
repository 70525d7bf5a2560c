"""Cameras: projections, views and frustums, in float64.

The world is right-handed, view space looks along -Z with +Y up, vectors are columns (`matrix @ vector`).
Clip depth runs from 0 to 1: reversed by default (near 1, far 0), standard on request so that its cost in
accuracy can be shown. A camera is an immutable value.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum, IntEnum
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from renderer import rules
from renderer.scene.arrays import Floats
from rhi.errors import refuse


class Depth(Enum):
    """The direction of clip depth."""

    REVERSED = "reversed"
    """Near 1, far 0: in floats, precise at every distance. Test with GREATER."""
    STANDARD = "standard"
    """Near 0, far 1. Test with LESS."""


class FrustumPlane(IntEnum):
    """The rows of `Frustum.planes`. FAR is missing when the projection reaches to infinity."""

    LEFT = 0
    RIGHT = 1
    BOTTOM = 2
    TOP = 3
    NEAR = 4
    FAR = 5


class Projection(Protocol):
    """The lens of a camera, an immutable value."""

    def __hash__(self) -> int: ...

    @property
    def depth(self) -> Depth:
        """The direction of depth."""

    @property
    def matrix(self) -> Floats:
        """The matrix (4, 4) float64 from view space to clip space."""
        ...

    def with_aspect(self, aspect: float) -> Projection:
        """Return the same lens for an image of width / height = `aspect`."""
        ...


@dataclass(frozen=True, slots=True)
class Perspective:
    """A perspective lens: vertical field of view in radians, distances in metres; `far` may be infinite."""

    fov: float = np.pi / 3
    aspect: float = 16 / 9
    near: float = 0.1
    far: float = np.inf
    depth: Depth = Depth.REVERSED

    def __post_init__(self) -> None:
        _check("Perspective(fov=...)", self.fov, 0.0 < self.fov < np.pi, "between 0 and pi")
        _check("Perspective(aspect=...)", self.aspect, 0.0 < self.aspect < np.inf, "above 0, finite")
        _check("Perspective(near=...)", self.near, 0.0 < self.near < np.inf, "above 0, finite")
        _check("Perspective(far=...)", self.far, self.near < self.far, f"above near={self.near}; may be inf")

    @property
    def matrix(self) -> Floats:
        """The matrix (4, 4) float64 from view space to clip space."""
        focal = 1.0 / np.tan(0.5 * self.fov)
        near, far = self.near, self.far
        m = np.zeros((4, 4))
        m[0, 0], m[1, 1], m[3, 2] = focal / self.aspect, focal, -1.0
        if self.depth is Depth.REVERSED:
            m[2, 2], m[2, 3] = (0.0, near) if np.isinf(far) else (near / (far - near), near * far / (far - near))
        else:
            m[2, 2], m[2, 3] = (-1.0, -near) if np.isinf(far) else (far / (near - far), near * far / (near - far))
        return m

    def with_aspect(self, aspect: float) -> Perspective:
        """Return the same lens for an image of width / height = `aspect`."""
        return replace(self, aspect=aspect)


@dataclass(frozen=True, slots=True)
class Orthographic:
    """A parallel lens: `height` of the image in metres; `near` may be 0 or negative."""

    height: float
    aspect: float = 16 / 9
    near: float = 0.0
    far: float = 1000.0
    depth: Depth = Depth.REVERSED

    def __post_init__(self) -> None:
        _check("Orthographic(height=...)", self.height, 0.0 < self.height < np.inf, "above 0, finite")
        _check("Orthographic(aspect=...)", self.aspect, 0.0 < self.aspect < np.inf, "above 0, finite")
        _check("Orthographic(near=...)", self.near, bool(np.isfinite(self.near)), "finite")
        _check("Orthographic(far=...)", self.far, self.near < self.far < np.inf, "above near, finite")

    @property
    def matrix(self) -> Floats:
        """The matrix (4, 4) float64 from view space to clip space."""
        length = self.far - self.near
        m = np.zeros((4, 4))
        m[0, 0], m[1, 1], m[3, 3] = 2.0 / (self.height * self.aspect), 2.0 / self.height, 1.0
        if self.depth is Depth.REVERSED:
            m[2, 2], m[2, 3] = 1.0 / length, self.far / length
        else:
            m[2, 2], m[2, 3] = -1.0 / length, -self.near / length
        return m

    def with_aspect(self, aspect: float) -> Orthographic:
        """Return the same lens for an image of width / height = `aspect`."""
        return replace(self, aspect=aspect)


@dataclass(frozen=True, eq=False, slots=True)
class Frustum:
    """The visible volume: `planes` (5 or 6, 4) float64 in the order of `FrustumPlane`, unit normals inward.

    A point p is inside a plane when `n · p + d >= 0`. Five planes when the far plane is at infinity.
    """

    planes: Floats

    @classmethod
    def from_matrix(cls, matrix: ArrayLike, depth: Depth = Depth.REVERSED) -> Frustum:
        """Extract the planes of a clip matrix (4, 4) from its rows (Gribb and Hartmann, 2001)."""
        x, y, z, w = np.asarray(matrix, np.float64)
        ends = (w - z, z) if depth is Depth.REVERSED else (z, w - z)
        rows = np.stack([w + x, w - x, w + y, w - y, *ends])
        length = np.linalg.norm(rows[:, :3], axis=1)
        faces = length > 0.0  # an infinite far plane has no normal
        return cls(rows[faces] / length[faces, None])


@dataclass(frozen=True, eq=False, slots=True)
class Camera:
    """A position, an orientation, and a lens.

    Attributes:
        position: (3,) float64, world.
        rotation: (3, 3) float64, world directions to view directions; rows are right, up, back.
        projection: the lens.
    """

    position: Floats
    rotation: Floats
    projection: Projection

    @classmethod
    def look_at(
        cls,
        position: ArrayLike,
        target: ArrayLike,
        up: ArrayLike = (0.0, 1.0, 0.0),
        projection: Projection | None = None,
    ) -> Camera:
        """Create a camera at `position` that looks at `target`; looking along `up` is allowed."""
        eye, aim, above = (np.array(v, np.float64) for v in (position, target, up))
        for name, value in (("position", eye), ("target", aim), ("up", above)):
            fine = value.shape == (3,) and bool(np.isfinite(value).all())
            _check(f"look_at({name}=...)", value, fine, "three finite numbers")
        _check("look_at(target=...)", target, bool((eye != aim).any()), "a point other than the position")
        _check("look_at(up=...)", up, bool(above.any()), "not all 0")
        back = _normalised(eye - aim)
        right = np.cross(_normalised(above), back)
        if np.linalg.norm(right) < 1e-9:  # looking straight up or down: any perpendicular vector will do
            right = np.cross(np.eye(3)[np.argmin(np.abs(back))], back)
        right = _normalised(right)
        return cls(eye, np.stack([right, np.cross(back, right), back]), projection or Perspective())

    @property
    def right(self) -> Floats:
        """The unit vector (3,) to the camera's right."""
        return np.array(self.rotation[0])

    @property
    def forward(self) -> Floats:
        """The unit vector (3,) along which the camera looks."""
        x, y, z = self.rotation[2]
        return np.array([-x, -y, -z])

    @property
    def view(self) -> Floats:
        """The matrix (4, 4) float64 from world space to view space."""
        m = np.eye(4)
        m[:3, :3] = self.rotation
        m[:3, 3] = -(self.rotation @ self.position)
        return m

    @property
    def view_projection(self) -> Floats:
        """The matrix (4, 4) float64 from world space to clip space."""
        return self.projection.matrix @ self.view

    @property
    def relative_view_projection(self) -> NDArray[np.float32]:
        """The matrix (4, 4) float32 that shaders use: from world axes with the eye as origin to clip space."""
        m = np.eye(4)
        m[:3, :3] = self.rotation
        return (self.projection.matrix @ m).astype(np.float32)

    @property
    def frustum(self) -> Frustum:
        """The visible volume in world space."""
        m = np.eye(4)
        m[:3, :3] = self.rotation
        planes = Frustum.from_matrix(self.projection.matrix @ m, self.projection.depth).planes
        planes[:, 3] -= planes[:, :3] @ self.position  # after normalising: no loss far from the origin
        return Frustum(planes)

    def with_projection(self, projection: Projection) -> Camera:
        """Return the same camera with another projection."""
        return replace(self, projection=projection)

    def with_aspect(self, aspect: float) -> Camera:
        """Return the same camera for an image of width / height = `aspect`."""
        return replace(self, projection=self.projection.with_aspect(aspect))


def is_parallel(lens: Projection) -> bool:
    """Return whether a projection is parallel (orthographic)."""
    return bool(lens.matrix[3, 3] != 0.0)


def find_distance(matrix: Floats, depth: float) -> float:
    """Return the distance along the view at which the matrix (4, 4) of a projection gives a clip depth; it may be
    infinite."""
    below = float(matrix[2, 2] - matrix[3, 2] * depth)
    return float(matrix[2, 3] - matrix[3, 3] * depth) / below if below else np.inf


def _check(call: str, value: object, fine: bool, allowed: str) -> None:
    if not fine:
        refuse(rules.BAD_CAMERA, call, value, allowed)


def _normalised(vector: Floats) -> Floats:
    scaled = vector / np.abs(vector).max()
    return np.asarray(scaled / np.linalg.norm(scaled))
