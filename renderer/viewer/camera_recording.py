"""Records the cameras of frames, and replays them in real time, however long frames take. Shows views that move.

A recording is a walk-through (`CameraPath`) at 60 cameras a second, as `render --camera` and `capture
--camera` take.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from renderer.scene import FRAMES_PER_SECOND, Camera, CameraPath, Scene
from renderer.scene.arrays import Floats

MAX_SECONDS: Final = 600.0
"""Seconds after which a recording ends by itself."""


class CameraRecorder:
    """Records the camera of each frame and its time."""

    def __init__(self) -> None:
        self._times: list[float] = []
        self._cameras: list[Camera] = []

    def __len__(self) -> int:
        return len(self._times)

    @property
    def seconds(self) -> float:
        """The time from the first frame to the last."""
        return self._times[-1] - self._times[0] if self._times else 0.0

    def add(self, time: float, camera: Camera) -> None:
        """Record a frame. Times grow; a time equal to the last replaces its camera."""
        if self._times and time <= self._times[-1]:
            self._cameras[-1] = camera
            return
        self._times.append(time)
        self._cameras.append(camera)

    def make_path(self) -> CameraPath:
        """The walk-through, with the projection of the first frame. Between frames, position and direction
        are interpolated linearly."""
        path = CameraPath.record(self._cameras)
        times = np.array(self._times) - self._times[0]
        frame_seconds = np.arange(int(self.seconds * FRAMES_PER_SECOND + 1e-6) + 1) / FRAMES_PER_SECOND

        def at(values: Floats) -> Floats:
            return np.stack([np.interp(frame_seconds, times, column) for column in values.T], axis=1)

        positions = at(path.positions)
        return CameraPath(
            positions,
            positions + at(path.targets - path.positions),
            path.projection,
            at(np.asarray(path.ups)),
        )


class CameraReplay:
    """Replays a walk-through from its beginning.

    Attributes:
        name: the walk-through's name.
        seconds: the time since its beginning.
    """

    def __init__(self, path: CameraPath, name: str) -> None:
        self.name = name
        self.seconds = 0.0
        self._path = path

    def advance(self, step: float, scene_seconds: float) -> None:
        """Go on by `step` seconds of real time."""
        self.seconds += step

    @property
    def is_over(self) -> bool:
        """True if the last camera is reached."""
        return self.seconds * FRAMES_PER_SECOND >= len(self._path) - 1

    @property
    def camera(self) -> Camera:
        """The camera of the latest frame that has begun."""
        return self._path.camera(min(int(self.seconds * FRAMES_PER_SECOND + 1e-6), len(self._path) - 1))


class ViewFollower:
    """Shows a view that follows its node (`SceneBuilder.attach_view`).

    Attributes:
        name: the view's name.
        seconds: the scene's time.
    """

    is_over: Final = False

    def __init__(self, scene: Scene, name: str, seconds: float) -> None:
        self.name = name
        self.seconds = seconds
        self._scene = scene

    def advance(self, step: float, scene_seconds: float) -> None:
        """Go on to the scene's time, which stands still while it is paused."""
        self.seconds = scene_seconds

    @property
    def camera(self) -> Camera:
        """The view as of the scene's time."""
        return self._scene.view_at(self.name, self.seconds)
