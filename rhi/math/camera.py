"""Cameras: views and frustums, in float64.

The world is right-handed, view space looks along -Z with +Y up, vectors are columns (`matrix @ vector`).
A camera is an immutable value, so what follows from it is computed once, in arrays that can't be written to.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from enum import IntEnum
from functools import cached_property
from math import cos, isfinite, sin, sqrt
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rhi.errors.data_classes import dataclass
from rhi.errors.rules import CAMERA_VALUE
from rhi.math.arguments import check_angles, check_camera, check_real, read_finite, read_floats
from rhi.math.projections import Depth, Perspective, Projection
from rhi.math.transforms import Floats, freeze


class FrustumPlane(IntEnum):
    """The rows of `Frustum.planes`. FAR is missing when the projection reaches to infinity."""

    LEFT = 0
    RIGHT = 1
    BOTTOM = 2
    TOP = 3
    NEAR = 4
    FAR = 5


_FACES: Final = {
    Depth.REVERSED: np.array(
        [(1.0, 0, 0, 1), (-1, 0, 0, 1), (0, 1, 0, 1), (0, -1, 0, 1), (0, 0, -1, 1), (0, 0, 1, 0)]
    ),
    Depth.STANDARD: np.array(
        [(1.0, 0, 0, 1), (-1, 0, 0, 1), (0, 1, 0, 1), (0, -1, 0, 1), (0, 0, 1, 0), (0, 0, -1, 1)]
    ),
}
"""Weights of the rows of a clip matrix whose sums are the planes of the frustum."""


@dataclass(frozen=True, eq=False, slots=True)
class Frustum:
    """The visible volume: `planes` (5 or 6, 4) float64 in the order of `FrustumPlane`, unit normals inward.

    A point p is inside a plane when `n · p + d >= 0`. Five planes when the far plane is at infinity.
    """

    planes: Floats

    @classmethod
    def from_matrix(cls, matrix: ArrayLike, depth: Depth = Depth.REVERSED) -> Frustum:
        """Extract the planes of a clip matrix (4, 4) from its rows (Gribb and Hartmann, 2001)."""
        matrix = read_floats("Frustum.from_matrix(matrix=...)", matrix, 4, 4)
        return cls(_normalise_planes(_extract_planes(matrix, depth)))


@dataclass(frozen=True, eq=False)
class Camera:
    """A position, an orientation, and a projection.

    Attributes:
        position: (3,) float64, world.
        rotation: (3, 3) float64, world directions to view directions; rows are right, up, back.
        projection: the map from view space to clip space.
    """

    position: Floats
    rotation: Floats
    projection: Projection

    def __post_init__(self) -> None:
        # Arrays of floats that aren't finite are refused where the camera is used.
        position, rotation = self.position, self.rotation
        if not (position.__class__ is np.ndarray and position.shape == (3,) and position.dtype.kind == "f"):
            object.__setattr__(self, "position", read_finite("Camera(position=...)", position, 3))
        if not (rotation.__class__ is np.ndarray and rotation.shape == (3, 3) and rotation.dtype.kind == "f"):
            object.__setattr__(self, "rotation", read_finite("Camera(rotation=...)", rotation, 3, 3))

    @classmethod
    def look_at(
        cls,
        position: ArrayLike,
        target: ArrayLike,
        up: ArrayLike = (0.0, 1.0, 0.0),
        projection: Projection | None = None,
    ) -> Camera:
        """Create a camera at `position` that looks at `target`; looking along `up` is allowed.

        `projection` is a `Perspective` of 60 degrees and 16:9 by default: `Perspective(aspect=4 / 3)`.
        """
        eye, aim, above = (
            np.array(read_floats(f"look_at({name}=...)", value, rule=CAMERA_VALUE))
            for name, value in (("position", position), ("target", target), ("up", up))
        )
        for name, value in (("position", eye), ("target", aim), ("up", above)):
            fine = value.shape == (3,) and bool(np.isfinite(value).all())
            check_camera(f"look_at({name}=...)", value, fine, "three finite numbers")
        check_camera(
            "look_at(target=...)", target, bool((eye != aim).any()), "a point other than the position"
        )
        check_camera("look_at(up=...)", up, bool(above.any()), "not all 0")
        back = _normalised(eye - aim)
        right = np.cross(_normalised(above), back)
        if np.linalg.norm(right) < 1e-9:  # looking straight up or down: any perpendicular vector will do
            right = np.cross(np.eye(3)[np.argmin(np.abs(back))], back)
        right = _normalised(right)
        return cls(eye, np.stack([right, np.cross(back, right), back]), projection or Perspective())

    @cached_property
    def right(self) -> Floats:
        """The unit vector (3,) to the camera's right."""
        return freeze(np.array(self.rotation[0]))

    @cached_property
    def forward(self) -> Floats:
        """The unit vector (3,) along which the camera looks."""
        forward: Floats = -self.rotation[2]
        forward.setflags(write=False)
        return forward

    @cached_property
    def view(self) -> Floats:
        """The matrix (4, 4) float64 from world space to view space."""
        matrix = np.eye(4)
        matrix[:3, :3] = self.rotation
        matrix[:3, 3] = -(self.rotation @ self.position)
        return freeze(matrix)

    @cached_property
    def view_projection(self) -> Floats:
        """The matrix (4, 4) float64 from world space to clip space."""
        return freeze(self.projection.matrix @ self.view)

    @cached_property
    def relative_view_projection(self) -> NDArray[np.float32]:
        """The matrix (4, 4) float32 that shaders use: from world axes with the eye as origin to clip
        space."""
        return self._derive()[0]

    @cached_property
    def frustum(self) -> Frustum:
        """The visible volume in world space."""
        return self._derive()[1]

    def _derive(self) -> tuple[NDArray[np.float32], Frustum]:
        """Return `relative_view_projection` and `frustum`, which are cached together: every frame needs both, and one
        product turns the rows of the matrix and the planes, which are sums of them."""
        rows, normals = _clip_rows(self.projection.matrix, self.projection.depth)
        turned = rows.copy()
        turned[:, :3] = normals.dot(self.rotation)
        matrix = turned[:4].astype(np.float32)
        matrix.setflags(write=False)
        planes = _normalise_planes(turned[4:], self.position.tolist())
        planes.setflags(write=False)
        derived = matrix, Frustum(planes)
        self.__dict__["relative_view_projection"], self.__dict__["frustum"] = derived
        return derived

    def with_projection(self, projection: Projection) -> Camera:
        """Return the same camera with another projection."""
        if self.__class__ is Camera:  # mostly: `replace` takes five times as long
            return Camera(self.position, self.rotation, projection)
        return replace(self, projection=projection)

    def with_aspect(self, aspect: float) -> Camera:
        """Return the same camera for an image of width / height = `aspect`."""
        projection = self.projection.with_aspect(aspect)
        return self if projection is self.projection else self.with_projection(projection)


_CLIP_ROWS: Final[dict[int, tuple[Floats, Depth, tuple[Floats, Floats]]]] = {}
"""The last results of `_clip_rows` by the identity of the matrix, which is beside them."""
_MOST_CLIP_ROWS: Final = 64


def _clip_rows(matrix: Floats, depth: Depth) -> tuple[Floats, Floats]:
    """Return the rows (9 or 10, 4) of a projection's matrix and of the planes that are sums of them, and the first
    three numbers of each. Those of a matrix that can't be written are cached."""
    cached = _CLIP_ROWS.get(id(matrix))
    if cached is not None and cached[0] is matrix and cached[1] is depth:
        return cached[2]
    rows = np.concatenate([matrix, _extract_planes(matrix, depth)])
    result = freeze(rows), freeze(np.ascontiguousarray(rows[:, :3]))
    if not matrix.flags.writeable:
        if len(_CLIP_ROWS) >= _MOST_CLIP_ROWS:
            _CLIP_ROWS.clear()
        _CLIP_ROWS[id(matrix)] = matrix, depth, result
    return result


def _extract_planes(matrix: Floats, depth: Depth) -> Floats:
    """Return the planes (5 or 6, 4) of a clip matrix (4, 4), which aren't normalised. An infinite far plane has no
    normal, and is left out."""
    rows: Floats = _FACES[depth] @ matrix
    return rows[rows[:, :3].any(axis=1)]


def _normalise_planes(rows: Floats, position: Sequence[float] = (0.0, 0.0, 0.0)) -> Floats:
    """Return planes (p, 4) around `position` with unit normals. They are so few numbers that Python's floats take half
    the time of NumPy's arrays."""
    x, y, z = position
    planes = []
    for a, b, c, d in rows.tolist():
        length = sqrt(a * a + b * b + c * c)
        if length != 0.0:
            a, b, c = a / length, b / length, c / length
            planes.append((a, b, c, d / length - (a * x + b * y + c * z)))  # no loss far from the origin
    return np.array(planes).reshape(-1, 4)


def look_at(eye: ArrayLike, target: ArrayLike, up: ArrayLike = (0.0, 1.0, 0.0)) -> Floats:
    """Return the (4, 4) view matrix of an eye (3,) that looks at `target` (3,); looking along `up` is
    allowed.

    Raises:
        ValidationError: `camera-bad-value` if the eye is the target, or for numbers that aren't finite.

    Examples:
        >>> matrix = look_at((0, 0, 5), (0, 0, 0))
        >>> (matrix @ (0, 0, 0, 1)).tolist()  # five units in front of the eye
        [0.0, 0.0, -5.0, 1.0]
    """
    return Camera.look_at(eye, target, up).view.copy()


def orbit(target: ArrayLike, distance: float, yaw: float = 0.0, pitch: float = 0.0) -> Floats:
    """Return the (4, 4) view matrix of an eye that circles a point, and looks at it.

    Args:
        target: (3,), the point.
        distance: from the eye to `target`.
        yaw: the angle of the eye around +Y, in radians; at 0 the eye is towards +Z, at pi / 2 towards +X.
        pitch: angle of the eye above the horizontal through `target`, in radians, from -pi / 2 to pi / 2.

    Raises:
        ValidationError: `camera-bad-value` for a distance that isn't above 0, or numbers that aren't finite.

    Examples:
        >>> orbit((0, 0, 0), 5.0).shape
        (4, 4)
    """
    check_real("orbit", distance=distance)
    check_angles("orbit", yaw=yaw, pitch=pitch)
    middle = read_finite("orbit(target=...)", target, 3)
    check_camera("orbit(distance=...)", distance, 0.0 < distance < np.inf, "above 0, finite")
    turned = yaw_pitch_rotation(float(yaw), -float(pitch))
    return Camera(middle + distance * turned[2], turned, Perspective()).view.copy()


def yaw_pitch_rotation(yaw: float, pitch: float) -> Floats:
    """Return the rotation (3, 3) of a camera without roll, turned to the left by `yaw` around +Y, then
    upwards by `pitch`, in radians: rows are right, up, back.

    Raises:
        ValidationError: `camera-bad-value` for an angle that isn't finite.
    """
    if not (yaw.__class__ is pitch.__class__ is float and isfinite(yaw + pitch)):
        check_angles("yaw_pitch_rotation", yaw=yaw, pitch=pitch)
    s, c, t, d = sin(yaw), cos(yaw), sin(pitch), cos(pitch)
    return np.array([(c, 0.0, -s), (s * t, d, c * t), (s * d, -t, c * d)])


def _normalised(vector: Floats) -> Floats:
    scaled = vector / np.abs(vector).max()
    return np.asarray(scaled / np.linalg.norm(scaled))
