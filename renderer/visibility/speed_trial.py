"""Trials find the fastest of some candidates by drawing some frames with each.

What is fastest depends on the scene, the view and the device, so a choice is looked at again when the view
has changed. `AutoCulling` chooses visibility algorithms like this, `renderer.techniques.AutoTechnique`
techniques."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from renderer.scene import Camera, Scene

_MIN_TURN_COSINE: Final = float(np.cos(np.pi / 4))
_MOVE_FRACTION: Final = 0.15  # of the scene's diagonal
_AMOUNT_RATIO: Final = 1.5  # ratio of the amounts drawn
_WARM_UP_FRAMES: Final = 2  # first frames of a candidate, which aren't counted
_GIVE_UP_RATIO: Final = 1.5  # ratio to the best time so far, from which a candidate is given up
_RETRY_RATIO: Final = 1.25  # ratio of the second best time to the best, below which both are tried again
_MAX_IDLE_RATIO: Final = 8  # ratio to the shortest rest


class SpeedTrial:
    """Tries each candidate for some frames, then stays with the fastest until the view has changed.

    The view has changed when the eye has moved by 0.15 of the scene's diagonal or turned by 45°, or when the
    amount drawn has grown or shrunk by a factor of 1.5. After a trial there is none for a number of frames,
    which doubles each time that a trial has the same result.

    Each frame goes like this: `check_view` from the camera; if `is_trying`, draw with `current_name`, wait
    for the device and `add_time`; otherwise draw with `current_name` and `idle`.

    Attributes:
        names: the names of all candidates.
        current_name: the name of the fastest candidate, or of the one on trial during a trial.
        times: the least time of each candidate in the last trial, in seconds.
    """

    def __init__(self, scene: Scene, names: Sequence[str], *, frames: int = 5, idle: int = 120) -> None:
        """Begin the first trial, if there are several candidates.

        Each is tried for `frames` frames, 3 or more: the first two aren't counted, and the least time of the
        others counts. A candidate is given up when they leave no hope that it is the fastest. When the second
        best is close to the fastest, both are tried again, because disturbances of a machine last for some
        frames. `idle` is the least number of frames without a trial after a trial.
        """
        self.names = tuple(names)
        self.current_name = self.names[0]
        self.times: dict[str, float] = {}
        self._frames = max(frames, _WARM_UP_FRAMES + 1)
        lower, upper = scene.bounds
        self._move_limit = _MOVE_FRACTION * float(np.linalg.norm(upper - lower))
        self._untried: list[str] = []  # in reverse order
        self._seconds: list[float] = []  # of the candidate on trial
        self._is_final = False
        self._last = ""  # the choice of the last trial
        self._min_idle = self._idle = self._left = idle
        self._camera: Camera | None = None  # the camera at the end of the trial
        self._amount = 0  # that of the frame after the trial
        self.begin()

    @property
    def is_trying(self) -> bool:
        """True if the next frame is a trial frame."""
        return bool(self._untried)

    def begin(self) -> None:
        """Begin a trial, from the first candidate on."""
        self._amount = 0
        self._seconds.clear()
        self._is_final = False
        if len(self.names) > 1:
            self.times = {}
            self._untried = list(self.names)[::-1]
            self.current_name = self.names[0]

    def check_view(self, camera: Camera) -> None:
        """Begin a trial if there was none for long enough and the view is another one."""
        if not self._untried and self._left <= 0 and self._has_view_changed(camera):
            self.begin()

    def add_time(self, seconds: float, camera: Camera) -> None:
        """Note the time of a trial frame, and go on to the next candidate or to the decision."""
        self._seconds.append(seconds)
        least = min(self._seconds[_WARM_UP_FRAMES:], default=np.inf)
        best = min(self.times.values(), default=np.inf)
        if len(self._seconds) == self._frames or (
            len(self._seconds) > _WARM_UP_FRAMES and least > _GIVE_UP_RATIO * best
        ):
            self.times[self.current_name] = min(self.times.get(self.current_name, np.inf), least)
            self._untried.pop()
            self._seconds.clear()
            if not self._untried:
                self._decide(camera)
            if self._untried:
                self.current_name = self._untried[-1]

    def idle(self, amount: int) -> None:
        """Note what a frame without a trial has drawn, and begin one if it is far more or less than
        before."""
        self._left -= 1
        self._amount = self._amount or amount
        if self._left < 0 and max(amount, self._amount) > _AMOUNT_RATIO * min(amount, self._amount):
            self.begin()

    def _decide(self, camera: Camera) -> None:
        times = self.times
        self.current_name, second = sorted(times, key=times.__getitem__)[:2]
        if not self._is_final and times[second] < _RETRY_RATIO * times[self.current_name]:
            self._is_final = True
            self._untried = [second, self.current_name]
            return
        again = self.current_name == self._last
        self._idle = min(2 * self._idle, _MAX_IDLE_RATIO * self._min_idle) if again else self._min_idle
        self._last, self._left, self._camera = self.current_name, self._idle, camera

    def _has_view_changed(self, camera: Camera) -> bool:
        then = self._camera
        if then is None:
            return False
        moved = float(np.linalg.norm(camera.position - then.position))
        return moved > self._move_limit or float(camera.forward @ then.forward) < _MIN_TURN_COSINE


class CandidateSelector:
    """Base class of what chooses among candidates by trial."""

    _trial: SpeedTrial

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the candidates; of techniques, for this device and what was in view so far."""
        return self._trial.names

    @property
    def current_name(self) -> str:
        """The name of the fastest candidate, or during a trial of the one on trial."""
        return self._trial.current_name

    @property
    def is_trying(self) -> bool:
        """True if the next frame is a trial frame."""
        return self._trial.is_trying
