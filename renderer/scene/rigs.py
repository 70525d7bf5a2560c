"""Stereo rigs: a pair of cameras beside a camera, a view that encloses both, and the parallax between them.

The eyes of a rig stand half the eye distance e to the left and to the right of a camera, and look in its
direction. Their projections are skewed towards each other (*off-axis*), so that both images show the same
rectangle at the convergence distance c. With P00 the horizontal scale of the projection, a point at the
distance z along the view lies P00 · e · (1/c - 1/z) farther right in the right eye's image, of width 2, than
in the left eye's: 0 at z = c, in front of the screen to the left (negative), and P00 · e / c at infinity. It
never moves up or down.

Eyes that are *toed in* are turned towards the convergence point instead. Their images are planes at an angle,
so a point in a corner is higher in one than in the other. Toed-in rigs exist only to demonstrate this
artefact.

With an orthographic projection parallax is linear in the distance: P00 · e · (z/c - 1).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from renderer import rules
from renderer.scene.arrays import Floats
from renderer.scene.finite import read_points
from rhi.errors import refuse
from rhi.math import (
    Camera,
    Depth,
    Orthographic,
    Perspective,
    Projection,
    distance_at_depth,
    is_parallel,
)
from rhi.math.indexing import repeat_each

HUMAN_EYE_DISTANCE: Final = 0.063
"""The distance of human eyes in metres, the mean of adults."""
COMFORTABLE_PARALLAX: Final = 1.0 / 30.0
"""The share of the image's width that parallax may spread over without strain: a rule of stereographers."""
_MARGIN: Final = 1e-9  # of what encloses both views: their rounding
_CORNERS: Final = np.array([(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)])
_FLIP_Z: Final = np.array([1.0, 1.0, -1.0])


@dataclass(frozen=True)
class SkewedProjection:
    """A projection with a skewed axis: d metres along the view, the middle of its image is d · `skew` right
    of where `projection` has it."""

    projection: Projection
    skew: float

    def __post_init__(self) -> None:
        rules.check_numbers(rules.BAD_STEREO, "SkewedProjection", skew=self.skew)

    @property
    def depth(self) -> Depth:
        """The direction of depth."""
        return self.projection.depth

    @cached_property
    def matrix(self) -> Floats:
        """The matrix (4, 4) float64 from view space to clip space."""
        m = self.projection.matrix.copy()
        m[:, 2] += self.skew * m[:, 0]
        m.setflags(write=False)
        return m

    def with_aspect(self, aspect: float) -> SkewedProjection:
        """Return the same projection for an image of width / height = `aspect`."""
        return replace(self, projection=self.projection.with_aspect(aspect))


@dataclass(frozen=True, slots=True)
class StereoRig:
    """The eyes beside a camera.

    Attributes:
        eye_distance: between the eyes, in metres. At 0 both are the camera itself.
        convergence: the distance in metres at which parallax is 0: that of the screen. It may be infinite.
        is_toed_in: whether the eyes are turned towards each other instead of having skewed projections.
    """

    eye_distance: float = HUMAN_EYE_DISTANCE
    convergence: float = 3.0
    is_toed_in: bool = False

    def __post_init__(self) -> None:
        rules.check_types(self, rules.BAD_STEREO)
        rules.check_non_negative(rules.BAD_STEREO, "StereoRig(eye_distance=...)", self.eye_distance)
        if not self.convergence > 0.0:
            refuse(rules.BAD_STEREO, "StereoRig(convergence=...)", self.convergence, "above 0; may be inf")

    @classmethod
    def comfortable(
        cls,
        projection: Projection,
        nearest: float,
        farthest: float,
        max_parallax: float = COMFORTABLE_PARALLAX,
    ) -> StereoRig:
        """Return the rig for what is from `nearest` to `farthest` metres along the view: its parallax spreads
        over at most `max_parallax` of the image's width, as far in front of the screen as behind it.

        The eyes are never farther apart than human ones.
        """
        if not 0.0 < nearest <= farthest:
            distances = f"{nearest} to {farthest}"
            refuse(
                rules.BAD_STEREO, "StereoRig.comfortable(nearest, farthest)", distances, "above 0, ascending"
            )
        scale = float(projection.matrix[0, 0])
        if is_parallel(projection):
            convergence = 0.5 * (nearest + farthest)
            spread = scale * (farthest - nearest) / convergence
        else:
            convergence = 2.0 / (1.0 / nearest + 1.0 / farthest)
            spread = scale * (1.0 / nearest - 1.0 / farthest)
        widest = 2.0 * max_parallax / spread if spread else np.inf
        return cls(min(HUMAN_EYE_DISTANCE, widest), convergence)

    def place_eyes(self, camera: Camera) -> tuple[Camera, Camera]:
        """Return the left and the right eye beside a camera."""
        if not self.eye_distance:
            return camera, camera
        left, right = (self._make_eye(camera, side * 0.5 * self.eye_distance) for side in (-1.0, 1.0))
        return left, right

    def _make_eye(self, camera: Camera, offset: float) -> Camera:
        position = camera.position + offset * camera.right
        if not self.is_toed_in:
            return Camera(
                position, camera.rotation, SkewedProjection(camera.projection, -offset / self.convergence)
            )
        angle = np.arctan(offset / self.convergence)  # about the camera's up, to the left
        cosine, sine = float(np.cos(angle)), float(np.sin(angle))
        turn = np.array([[cosine, 0.0, -sine], [0.0, 1.0, 0.0], [sine, 0.0, cosine]])
        return Camera(position, turn @ camera.rotation, camera.projection)

    def enclose(self, camera: Camera) -> Camera:
        """Return a camera that sees all that either eye sees: a little behind `camera`, with a wider
        projection.

        Nothing outside its frustum is in either image.
        """
        if not self.eye_distance:
            return camera
        projection, back = _enclose(self, camera.projection)
        return Camera(camera.position - back * camera.forward, camera.rotation, projection)

    def _enclose_projection(self, projection: Projection) -> tuple[Projection, float]:
        """Return the projection that encloses both eyes' views, and its distance behind the camera: the same
        wherever the camera is."""
        camera = Camera(np.zeros(3), np.eye(3), projection)
        eyes = self.place_eyes(camera)
        nearest, farthest = (1.0, 0.0) if projection.depth is Depth.REVERSED else (0.0, 1.0)
        end_of_view = distance_at_depth(projection.matrix, farthest)
        has_far = bool(np.isfinite(end_of_view))
        begin_of_view = distance_at_depth(projection.matrix, nearest)
        near = np.concatenate([_frustum_corners(camera, eye, begin_of_view) for eye in eyes])
        far = (
            np.concatenate([_frustum_corners(camera, eye, end_of_view) for eye in eyes]) if has_far else near
        )
        widened = 1.0 + _MARGIN
        if is_parallel(projection):
            ends = np.concatenate([near, far])
            (half, high), back = np.abs(ends[:, :2]).max(axis=0) * widened, 0.0
            begin, end = ends[:, 2].min(), ends[:, 2].max()
            slack = _MARGIN * float(np.abs(ends).max())
            wide: Projection = Orthographic(
                2.0 * high, half / high, begin - slack, end + slack, depth=projection.depth
            )
        else:
            offsets = (
                repeat_each([eye.position - camera.position for eye in eyes], 4, axis=0) @ camera.rotation.T
            )
            ahead = near - offsets * _FLIP_Z
            if not (ahead[:, 2] > 0.0).all():
                refuse(rules.BAD_STEREO, "StereoRig.enclose", self, "eyes that see less than a half space")
            half, high = (np.abs(ahead[:, :2]) / ahead[:, 2:]).max(axis=0) * widened
            back = 0.5 * self.eye_distance / half * widened
            begin, end = near[:, 2].min() + back, far[:, 2].max() + back
            wide = Perspective(
                2.0 * float(np.arctan(high)),
                float(half / high),
                float(begin / widened),
                float(end * widened) if has_far else np.inf,
                projection.depth,
            )
        return wide, float(back)

    def compute_parallax(self, projection: Projection, distance: ArrayLike) -> Floats:
        """Return the distance to the right of a point at `distance` along the view, in the right eye's image of
        where it is in the left one's, in units of half the image's width; for eyes that aren't toed in."""
        z = np.asarray(distance, np.float64)
        scale = float(projection.matrix[0, 0]) * self.eye_distance
        if is_parallel(projection):
            return np.asarray(scale * (z / self.convergence - 1.0))
        return np.asarray(scale * (1.0 / self.convergence - 1.0 / z))


@lru_cache(maxsize=16)
def _enclose(rig: StereoRig, projection: Projection) -> tuple[Projection, float]:
    """Cached `StereoRig._enclose_projection`: rig and projection mostly stay the same from frame to frame."""
    return rig._enclose_projection(projection)


def measure_parallax(eyes: tuple[Camera, Camera], points: ArrayLike) -> Floats:
    """Return (n, 2), how far points (n, 3) of the world are to the right and upwards in the right eye's image
    of where they are in the left one's, in units of half the image's width and height."""
    world = read_points(rules.BAD_STEREO, "measure_parallax(points=...)", points)
    positions = []
    for eye in eyes:
        relative = (world - eye.position) @ eye.rotation.T
        clip = np.concatenate([relative, np.ones((len(relative), 1))], axis=1) @ eye.projection.matrix.T
        positions.append(clip[:, :2] / clip[:, 3:])
    return np.asarray(positions[1] - positions[0])


def _frustum_corners(camera: Camera, eye: Camera, distance: float) -> Floats:
    """Return the corners (4, 3) of what an eye sees at a distance along its view, as `camera` sees them:
    rightwards, upwards, ahead."""
    m = eye.projection.matrix
    clip = _CORNERS * (m[3, 3] - m[3, 2] * distance)
    points = np.full((4, 3), -distance)
    points[:, :2] = (clip + m[:2, 2] * distance - m[:2, 3]) / m[[0, 1], [0, 1]]
    seen = points @ eye.rotation + (eye.position - camera.position)
    return np.asarray(seen @ camera.rotation.T * _FLIP_Z)
