"""Trials: which of some candidates is the fastest is found by trying each for some frames.

What is fastest depends on the scene, the view and the device, so a choice is looked at again when the view has changed.
`AutoCulling` chooses visibility algorithms like this, `renderer.techniques.AutoTechnique` techniques.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from renderer.scene import Camera, Scene

_TURNED: Final = float(np.cos(np.pi / 4))
_MOVED: Final = 0.15  # of the scene's diagonal
_CHANGED: Final = 1.5  # ratio of the amounts drawn
_SETTLES: Final = 2  # first frames of a candidate, which aren't counted
_HOPELESS: Final = 1.5  # ratio to the best time so far, from which a candidate is given up
_CLOSE: Final = 1.25  # ratio of the second best time to the best, below which both are tried again
_LONGEST_REST: Final = 8  # ratio to the shortest rest


class SpeedTrial:
    """Tries each candidate for some frames, then stays with the fastest until the view has changed.

    The view has changed when the eye has moved by 0.15 of the scene's diagonal or turned by 45°, or when the amount
    drawn has grown or shrunk by a factor of 1.5. After a trial there is none for a number of frames, which doubles each
    time that a trial has the same result.

    Each frame goes like this: `look` from the camera; if `is_trying`, draw with `chosen`, wait for the device and
    `add_time`; otherwise draw with `chosen` and `rest`.

    Attributes:
        names: the names of all candidates.
        chosen: the name of the fastest, or during a trial of the one on trial.
        times: the least time of each candidate in the last trial, in seconds.
    """

    def __init__(self, scene: Scene, names: Sequence[str], *, frames: int = 5, rest: int = 120) -> None:
        """Begin the first trial, if there are several candidates.

        Each is tried for `frames` frames, 3 or more: the first two aren't counted, and the least time of the others
        counts. A candidate is given up when they leave no hope that it is the fastest. When the second best is close
        to the fastest, both are tried again, because disturbances of a machine last for some frames. `rest` is the
        least number of frames without a trial after a trial.
        """
        self.names = tuple(names)
        self.chosen = self.names[0]
        self.times: dict[str, float] = {}
        self._frames = max(frames, _SETTLES + 1)
        lower, upper = scene.bounds
        self._reach = _MOVED * float(np.linalg.norm(upper - lower))
        self._untried: list[str] = []  # in reverse order
        self._seconds: list[float] = []  # of the candidate on trial
        self._is_final = False
        self._last = ""  # the choice of the last trial
        self._shortest = self._rest = self._left = rest
        self._camera: Camera | None = None  # the camera at the end of the trial
        self._amount = 0  # that of the frame after the trial
        self.begin()

    @property
    def is_trying(self) -> bool:
        """Whether the next frame is a trial frame."""
        return bool(self._untried)

    def begin(self) -> None:
        """Begin a trial, from the first candidate on."""
        self._amount = 0
        self._seconds.clear()
        self._is_final = False
        if len(self.names) > 1:
            self.times = {}
            self._untried = list(self.names)[::-1]
            self.chosen = self.names[0]

    def look(self, camera: Camera) -> None:
        """Begin a trial if there was none for long enough and the view is another one."""
        if not self._untried and self._left <= 0 and self._is_elsewhere(camera):
            self.begin()

    def add_time(self, seconds: float, camera: Camera) -> None:
        """Note the time of a trial frame, and go on to the next candidate or to the decision."""
        self._seconds.append(seconds)
        least = min(self._seconds[_SETTLES:], default=np.inf)
        best = min(self.times.values(), default=np.inf)
        if len(self._seconds) == self._frames or (len(self._seconds) > _SETTLES and least > _HOPELESS * best):
            self.times[self.chosen] = min(self.times.get(self.chosen, np.inf), least)
            self._untried.pop()
            self._seconds.clear()
            if not self._untried:
                self._decide(camera)
            if self._untried:
                self.chosen = self._untried[-1]

    def rest(self, amount: int) -> None:
        """Note what a frame without a trial has drawn, and begin one if it is far more or less than before."""
        self._left -= 1
        self._amount = self._amount or amount
        if self._left < 0 and max(amount, self._amount) > _CHANGED * min(amount, self._amount):
            self.begin()

    def _decide(self, camera: Camera) -> None:
        times = self.times
        self.chosen, second = sorted(times, key=times.__getitem__)[:2]
        if not self._is_final and times[second] < _CLOSE * times[self.chosen]:
            self._is_final = True
            self._untried = [second, self.chosen]
            return
        again = self.chosen == self._last
        self._rest = min(2 * self._rest, _LONGEST_REST * self._shortest) if again else self._shortest
        self._last, self._left, self._camera = self.chosen, self._rest, camera

    def _is_elsewhere(self, camera: Camera) -> bool:
        then = self._camera
        if then is None:
            return False
        moved = float(np.linalg.norm(camera.position - then.position))
        return moved > self._reach or float(camera.forward @ then.forward) < _TURNED


class OnTrial:
    """The base of what tries candidates."""

    _trial: SpeedTrial

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the candidates; of techniques, for this device and what was in view so far."""
        return self._trial.names

    @property
    def chosen(self) -> str:
        """The name of the fastest candidate, or during a trial of the one on trial."""
        return self._trial.chosen

    @property
    def is_trying(self) -> bool:
        """Whether the next frame is a trial frame."""
        return self._trial.is_trying
