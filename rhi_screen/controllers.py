"""Controllers: they turn gestures and held keys into cameras, flying freely or circling a point.

A controller knows no events: it is turned by angles, dragged by parts of the image's height, zoomed by
notches, and pushed along its axes for some seconds. Positions and angles are float64. Motion depends on time
and not on frames: the speed approaches what the keys ask for exponentially, and the way is that speed's
integral, so a second in one step ends where a second in sixty steps does.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import atan2, exp, hypot, inf, isnan, pi
from typing import Final, Protocol

import numpy as np
from numpy.typing import ArrayLike

from rhi.errors.rules import CAMERA_VALUE
from rhi.math import Camera, Floats, Orthographic, Perspective, Projection, yaw_pitch_rotation
from rhi.math.arguments import check_camera, check_real, read_floats
from rhi_screen.arguments import are_gestures, check_number

NOTCH: Final = 1.15
"""The ratio of distances by which a notch of the wheel brings nearer."""
FAST_FACTOR: Final = 4.0
"""The factor of motion's speed with Shift."""
MIN_DISTANCE: Final = 1e-6
MAX_DISTANCE: Final = 1e12
"""Metres of an orbit, of a parallel projection's height, and of coordinates that gestures reach. One that
begins farther out isn't pulled in."""
_MAX_NOTCHES: Final = 1000.0  # from the smallest distance to the largest it is 297

_ACCELERATION_RATE: Final = 12.0  # a second: how quickly the speed approaches what the keys ask for
_TURN_RATE: Final = 1.6  # radians a second, by keys
_MIN_SPEED: Final = 1e-3  # of the full speed: below it, motion has ended


@dataclass(slots=True)
class Heading:
    """A direction of view without roll: `yaw` to the left around +Y, `pitch` upwards, in radians."""

    yaw: float = 0.0
    pitch: float = 0.0

    @classmethod
    def of(cls, camera: Camera) -> Heading:
        """Return where a camera looks. Looking straight up or down, its up direction is that of the yaw."""
        x, y, z = camera.forward.tolist()
        if hypot(x, z) > 1e-9:
            return cls(atan2(-x, -z), atan2(y, hypot(x, z)))
        up = -np.sign(y) * camera.rotation[1]
        return cls(atan2(-up[0], -up[2]), float(np.sign(y)) * pi / 2)

    def turn(self, left: float, up: float) -> None:
        """Turn by angles; the pitch stays between straight down and straight up."""
        if not are_gestures(left, up):
            return
        self.yaw = (self.yaw + left + pi) % (2.0 * pi) - pi
        self.pitch = min(max(self.pitch + up, -pi / 2), pi / 2)

    @property
    def rotation(self) -> Floats:
        """The camera's rotation (3, 3): rows are right, up, back."""
        return yaw_pitch_rotation(self.yaw, self.pitch)


@dataclass(slots=True)
class Glide:
    """A speed (3,) that approaches the one that is asked for, and the way it goes meanwhile."""

    speed: Floats = field(default_factory=lambda: np.zeros(3))

    def advance(self, target_speed: Floats, seconds: float) -> Floats:
        """Return the way (3,) of some seconds in which `target_speed` (3,) is asked for."""
        remaining = exp(-_ACCELERATION_RATE * seconds)
        gap = self.speed - target_speed
        way = target_speed * seconds + gap * ((1.0 - remaining) / _ACCELERATION_RATE)
        self.speed = target_speed + gap * remaining
        if not target_speed.any() and float(np.abs(self.speed).max()) < _MIN_SPEED:
            self.speed = np.zeros(3)
        return np.asarray(way)

    @property
    def is_moving(self) -> bool:
        """True if there is any speed left."""
        return bool(self.speed.any())


class Controller(Protocol):
    """A way to move a camera. Motion by numbers that aren't finite is none, and all motion keeps the camera's
    numbers finite: whatever a gesture does, another undoes.

    Attributes:
        name: the word for it in commands.
        speed: metres a second at which keys move.
    """

    name: str
    speed: float

    @property
    def camera(self) -> Camera:
        """The camera as of now."""
        ...

    @property
    def is_moving(self) -> bool:
        """True if it still glides."""
        ...

    @property
    def angle(self) -> float:
        """The angle in radians by which dragging all over the image's height turns."""
        ...

    def turn(self, left: float, up: float) -> None:
        """Turn the view by angles in radians."""
        ...

    def drag(self, right: float, up: float) -> None:
        """Move what is seen by parts of the image's height, as if it were held."""
        ...

    def zoom(self, notches: float) -> None:
        """Go nearer, or with a negative number away."""
        ...

    def advance(self, push: Floats, turn: Floats, seconds: float) -> None:
        """Move for some seconds.

        Args:
            push: (3,) how keys push to the right, up and back, each from -1 to 1, more with Shift.
            turn: (3,) how they turn to the left and up; the third is unused.
        """
        ...


class _GlidingController:
    """Base of controllers: a projection, a heading that they turn, and motion that fades out."""

    def __init__(self, camera: Camera, speed: float) -> None:
        self.speed = speed
        self._heading = Heading.of(camera)
        self._projection = camera.projection
        self._move, self._swing = Glide(), Glide()

    @property
    def speed(self) -> float:
        """Metres a second at which keys move.

        Raises:
            ValidationError: `device-argument` for a new speed that isn't finite.
        """
        return self._speed

    @speed.setter
    def speed(self, speed: float) -> None:
        self._speed = check_number(type(self).__name__, "speed", speed)

    @property
    def is_moving(self) -> bool:
        """True if it still glides."""
        return self._move.is_moving or self._swing.is_moving

    def turn(self, left: float, up: float) -> None:
        """Turn the view by angles in radians."""
        self._heading.turn(left, up)


class Fly(_GlidingController):
    """Flies freely: keys move along the axes of the view, dragging turns it."""

    name = "fly"

    def __init__(self, camera: Camera, speed: float) -> None:
        super().__init__(camera, speed)
        self._position: Floats = np.array(camera.position, np.float64)

    @property
    def camera(self) -> Camera:
        """The camera as of now."""
        return Camera(self._position.copy(), self._heading.rotation, self._projection)

    @property
    def angle(self) -> float:
        """The angle between the image's top and bottom; with a parallel projection, that of a usual
        projection."""
        return self._projection.fov if isinstance(self._projection, Perspective) else pi / 3

    def drag(self, right: float, up: float) -> None:
        """Move sideways and up or down, by parts of a second's way."""
        if not are_gestures(right, up):
            return
        self._move_by(np.array((-right, -up, 0.0)) * self.speed)

    def zoom(self, notches: float) -> None:
        """Go ahead a quarter of a second's way for each notch; a parallel projection shows less."""
        if isinstance(self._projection, Orthographic):
            self._projection = zoom_projection(self._projection, notches)
        elif are_gestures(notches):
            self._move_by(np.array((0.0, 0.0, -0.25 * notches)) * self.speed)

    def advance(self, push: Floats, turn: Floats, seconds: float) -> None:
        """Move for some seconds."""
        if not _can_advance(push, turn, seconds):
            return
        left, up, _ = (_TURN_RATE * self._swing.advance(turn, seconds)).tolist()
        self._heading.turn(left, up)
        self._move_by(self._move.advance(push, seconds) * self.speed)

    def _move_by(self, way: Floats) -> None:
        self._position = _bound(self._position, way @ self._heading.rotation)


class Orbit(_GlidingController):
    """Circles a point at a distance: dragging turns the view around it, the wheel goes nearer."""

    name = "orbit"

    def __init__(self, camera: Camera, target: Floats, speed: float) -> None:
        """`target` (3,) is the point in the middle; the camera keeps its place and turns towards it."""
        away = camera.position - target
        aimed = (
            Camera.look_at(camera.position, target, projection=camera.projection) if away.any() else camera
        )
        super().__init__(aimed, speed)
        self.target = target
        self.distance = max(float(np.linalg.norm(away)), MIN_DISTANCE)

    @property
    def target(self) -> Floats:
        """The point (3,) in the middle.

        Raises:
            ValidationError: `camera-bad-value` for a new one that isn't three finite numbers.
        """
        return self._target

    @target.setter
    def target(self, target: ArrayLike) -> None:
        point = np.array(read_floats("Orbit(target=...)", target, rule=CAMERA_VALUE))
        fine = point.shape == (3,) and bool(np.isfinite(point).all())
        check_camera("Orbit(target=...)", target, fine, "three finite numbers")
        self._target: Floats = point

    @property
    def distance(self) -> float:
        """Metres from the point to the camera.

        Raises:
            ValidationError: `camera-bad-value` for a new one that isn't finite and above 0.
        """
        return self._distance

    @distance.setter
    def distance(self, distance: float) -> None:
        check_real("Orbit", distance=distance)
        check_camera("Orbit(distance=...)", distance, 0.0 < distance < inf, "above 0, finite")
        self._distance = float(distance)

    @property
    def camera(self) -> Camera:
        """The camera as of now."""
        rotation = self._heading.rotation
        return Camera(self.target + self.distance * rotation[2], rotation, self._projection)

    @property
    def angle(self) -> float:
        """Half a turn."""
        return pi

    def drag(self, right: float, up: float) -> None:
        """Move the point with what is seen: it stays below the pointer."""
        if not are_gestures(right, up):
            return
        high = image_height(self._projection, self.distance)
        self._target = _bound(self._target, np.array((-right, -up, 0.0)) * high @ self._heading.rotation)

    def zoom(self, notches: float) -> None:
        """Go nearer by a ratio; a parallel projection shows less."""
        self._distance = _zoom(self._distance, notches)
        self._projection = zoom_projection(self._projection, notches)

    def advance(self, push: Floats, turn: Floats, seconds: float) -> None:
        """Move for some seconds: keys to the side and up turn around the point, those ahead go nearer."""
        if not _can_advance(push, turn, seconds):
            return
        around = np.array((turn[0] + push[0], turn[1] + push[1], 0.0))
        left, up, _ = (_TURN_RATE * self._swing.advance(around, seconds)).tolist()
        self._heading.turn(left, -up)
        ahead = -float(self._move.advance(np.array((0.0, 0.0, push[2])), seconds)[2])
        if ahead:
            self.zoom(8.0 * ahead)


def zoom_projection(projection: Projection, notches: float) -> Projection:
    """Return the projection that shows less after some notches of the wheel; one with perspective stays as it
    is."""
    return (
        replace(projection, height=_zoom(projection.height, notches))
        if isinstance(projection, Orthographic)
        else projection
    )


def _zoom(length: float, notches: float) -> float:
    """Return a length that some notches make shorter, between the smallest and the largest."""
    if isnan(notches):
        return length
    shorter = float(length * NOTCH ** -min(max(notches, -_MAX_NOTCHES), _MAX_NOTCHES))
    return min(max(shorter, min(length, MIN_DISTANCE)), max(length, MAX_DISTANCE))


def _bound(position: Floats, way: Floats) -> Floats:
    """Return a position (3,) that has moved, at most to the largest coordinates."""
    if not np.isfinite(way).all():
        return position
    farthest = np.maximum(np.abs(position), MAX_DISTANCE)
    return np.clip(position + way, -farthest, farthest)


def _can_advance(push: Floats, turn: Floats, seconds: float) -> bool:
    """True if keys and time can be a person's, and time doesn't run backwards."""
    return are_gestures(*push.tolist(), *turn.tolist(), seconds) and seconds >= 0.0


def image_height(projection: Projection, distance: float) -> float:
    """Return the height of the image in metres at a distance from the eye."""
    if isinstance(projection, Orthographic):
        return projection.height
    assert isinstance(projection, Perspective)
    return 2.0 * distance * float(np.tan(0.5 * projection.fov))
