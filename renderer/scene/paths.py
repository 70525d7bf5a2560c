"""Camera paths: cameras along a route through the scene as arrays, one row for each frame at 60 Hz.

`make_path` makes a path of 30 seconds from the corners of a route. The speed is constant, corners are rounded
by averaging over a window of the route, and the camera looks at a point of the route ahead of it. So turns
are smooth, and the same input gives the same frames. `CameraPath.record` makes a path of given cameras: a
walk-through, which `save` writes to a file.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
from numpy.typing import ArrayLike

from renderer import rules
from renderer.scene.arrays import Floats
from renderer.scene.file_versions import KEY, FileVersions, rename_fields
from renderer.scene.files import read_json
from renderer.scene.finite import check_finite, read_points
from rhi.errors import RhiError, refuse
from rhi.math import Camera, Depth, Orthographic, Perspective, Projection
from rhi.math.arguments import read_floats

FRAMES_PER_SECOND: Final = 60
FRAME_COUNT: Final = 30 * FRAMES_PER_SECOND
_SAMPLES: Final = 8192  # of a route, before it is divided into frames: every 22 cm of a 1.8 km route


_PROJECTIONS: Final = {"perspective": Perspective, "orthographic": Orthographic}


@dataclass(frozen=True, eq=False, slots=True)
class PathFrame:
    """A frame to draw: its number, which is its time, and its camera."""

    number: int
    camera: Camera

    @property
    def seconds(self) -> float:
        """The time of the frame."""
        return self.number / FRAMES_PER_SECOND


@dataclass(frozen=True, eq=False, slots=True)
class CameraPath:
    """The cameras of a path.

    Attributes:
        positions, targets: (frames, 3) float64, where the cameras are and points that they look at.
        projection: the projection of all cameras.
        ups: (frames, 3) or (3,), the cameras' up directions.
    """

    positions: Floats
    targets: Floats
    projection: Projection
    ups: Floats = field(default_factory=lambda: np.array([0.0, 1.0, 0.0]))

    def __post_init__(self) -> None:
        for name in ("positions", "targets"):
            points = read_points(rules.BAD_PATH, f"CameraPath({name}=...)", getattr(self, name))
            object.__setattr__(self, name, points)
        shape = self.positions.shape
        if self.targets.shape != shape:
            refuse(rules.BAD_PATH, "CameraPath(targets=...)", f"shape {self.targets.shape}", f"shape {shape}")
        ups = read_floats("CameraPath(ups=...)", self.ups, 3, rule=rules.BAD_PATH)
        if ups.shape not in ((3,), shape) or not np.isfinite(ups).all():
            refuse(
                rules.BAD_PATH, "CameraPath(ups=...)", self.ups, f"finite numbers of shape (3,) or {shape}"
            )
        object.__setattr__(self, "ups", ups)

    def __len__(self) -> int:
        return len(self.positions)

    def camera(self, frame: int) -> Camera:
        """Return the camera of one frame, 0 to len - 1."""
        if not 0 <= frame < len(self):
            refuse(rules.FRAME_RANGE, "camera(frame=...)", frame, f"0 to {len(self) - 1}")
        up = np.broadcast_to(self.ups, self.positions.shape)[frame]
        return Camera.look_at(self.positions[frame], self.targets[frame], up, self.projection)

    def path_frame(self, frame: int) -> PathFrame:
        """Return one frame of the path, 0 to len - 1."""
        return PathFrame(frame, self.camera(frame))

    @classmethod
    def record(cls, cameras: Sequence[Camera]) -> Self:
        """Create a path of one or more cameras, one for each frame, with the projection of the first.

        Directions are reproduced to within the float64 rounding of a point a metre ahead.
        """
        if not cameras:
            refuse(rules.BAD_CAMERA_PATH, "CameraPath.record", "no camera", "one or more")
        for row, camera in enumerate(cameras):
            check_finite(
                f"CameraPath.record(cameras[{row}])", position=camera.position, rotation=camera.rotation
            )
        return cls(
            np.array([camera.position for camera in cameras]),
            np.array([camera.position + camera.forward for camera in cameras]),
            cameras[0].projection,
            np.array([camera.rotation[1] for camera in cameras]),
        )

    def save(self, path: Path) -> None:
        """Write the path as JSON: the projection, and for each frame position, target and up, nine
        numbers."""
        projection = self.projection
        kind = next(
            name for name, projection_type in _PROJECTIONS.items() if isinstance(projection, projection_type)
        )
        numbers = {entry.name: getattr(projection, entry.name) for entry in fields(_PROJECTIONS[kind])}
        numbers["depth"] = projection.depth.value
        rows = np.concatenate(
            [self.positions, self.targets, np.broadcast_to(self.ups, self.positions.shape)], axis=1
        )
        path.write_text(
            json.dumps(
                {KEY: VERSIONS.current, "projection": {"kind": kind, **numbers}, "frames": rows.tolist()}
            )
            + "\n",
            encoding="utf-8",
        )

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read a file that `save` has written.

        Raises:
            ValidationError: `camera-bad-path` if the file is no walk-through, `file-version` for a newer version,
                `camera-bad-value` for a bad projection.
            OSError: the file can't be read.
        """
        call = f"CameraPath.load({str(path)!r})"
        try:
            document = VERSIONS.migrate(dict(read_json(path)), call)
            fields = dict(document["projection"])
            projection = _PROJECTIONS[fields.pop("kind")](**fields | {"depth": Depth(fields["depth"])})
            rows = np.array(document["frames"], np.float64)
        except RhiError:  # the projection refuses a value
            raise
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            refuse(rules.BAD_CAMERA_PATH, call, f"{type(error).__name__}: {error}")
        if rows.ndim != 2 or rows.shape[1] != 9 or not len(rows) or not np.isfinite(rows).all():
            refuse(rules.BAD_CAMERA_PATH, call, f"frames of shape {rows.shape}", "(frames, 9) finite numbers")
        return cls(rows[:, :3], rows[:, 3:6], projection, rows[:, 6:])


def _migrate_1(document: dict[str, Any]) -> dict[str, Any]:
    rename_fields(document, {"lens": "projection"})
    return document


VERSIONS: Final = FileVersions("walk-throughs", (_migrate_1,))
"""The versions of files of walk-throughs."""


def make_path(
    corners: ArrayLike,
    projection: Projection,
    rounding: float,
    ahead: float,
    sink: float = 0.0,
    frames: int = FRAME_COUNT,
) -> CameraPath:
    """Create a path along a route with the `corners` (k, 3), k >= 2.

    `rounding` is the length of the route in metres over which a corner is spread, `ahead` the distance in
    metres from the camera to its target along the route, and `sink` how far the target lies below the route.

    Raises:
        ValidationError: `camera-bad-route` for numbers that aren't finite, fewer than two corners, or corners
            in the same place.
    """
    route = read_points(rules.BAD_PATH, "make_path(corners=...)", corners)
    numbers = rules.check_numbers(rules.BAD_PATH, "make_path", rounding=rounding, ahead=ahead, sink=sink)
    rounding, ahead, sink = numbers
    frames = rules.check_count(rules.BAD_PATH, "make_path(frames=...)", frames)
    for name, number in (("rounding", rounding), ("ahead", ahead)):
        rules.check_non_negative(rules.BAD_PATH, f"make_path({name}=...)", number)
    if len(route) < 2 or not np.linalg.norm(np.diff(route, axis=0), axis=1).all():
        refuse(
            rules.BAD_PATH, "make_path(corners=...)", corners, "two corners or more, each apart from the next"
        )
    lengths = np.linalg.norm(np.diff(route, axis=0), axis=1)
    total = float(lengths.sum())
    # The route is extended at both ends, to keep the averages centred and to give the last frames a target.
    reach = rounding + ahead
    first, last = (route[1] - route[0]) / lengths[0], (route[-1] - route[-2]) / lengths[-1]
    route = np.concatenate([[route[0] - reach * first], route, [route[-1] + reach * last]])
    way = np.concatenate([[-reach, 0.0], np.cumsum(lengths), [total + reach]])

    samples = np.linspace(-reach, total + reach, _SAMPLES)
    points = np.stack([np.interp(samples, way, route[:, axis]) for axis in range(3)], axis=1)
    spacing = samples[1] - samples[0]
    window = np.hanning(max(int(rounding / spacing) | 1, 3) + 2)
    window /= window.sum()
    margin = len(window) // 2
    padded = np.pad(points, ((margin, margin), (0, 0)), "edge")
    smooth = np.stack([np.convolve(padded[:, axis], window, "valid") for axis in range(3)], axis=1)

    step = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(smooth, axis=0), axis=1))])
    start, end = np.interp([0.0, total], samples, step)
    when = np.linspace(start, end, frames)

    def at(distance: Floats) -> Floats:
        return np.stack([np.interp(distance, step, smooth[:, axis]) for axis in range(3)], axis=1)

    return CameraPath(at(when), at(when + ahead) - (0.0, sink, 0.0), projection)
