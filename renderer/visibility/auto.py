"""The algorithm that measures others: which one is fastest depends on the scene, the view and the device."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from time import perf_counter
from typing import Final

import numpy as np

from renderer.scene import Camera, Scene
from renderer.visibility.algorithm import VisibilityAlgorithm, VisibilityStatistics
from renderer.visibility.scene_pass import ScenePass
from renderer.visibility.walk import CullingWalk, WalksNodes
from rhi import Device

__rhi_internal__ = True

_TURNED: Final = float(np.cos(np.pi / 4))
_MOVED: Final = 0.15  # of the scene's diagonal
_CHANGED: Final = 1.5  # ratio of the numbers of objects drawn
_SETTLES: Final = 2  # first frames of a candidate, which aren't counted
_HOPELESS: Final = 1.5  # ratio to the best time so far, from which a candidate is given up
_CLOSE: Final = 1.25  # ratio of the second best time to the best, below which both are tried again
_LONGEST_REST: Final = 8  # ratio to the shortest rest


class AutoCulling:
    """Tries each candidate for some frames, then stays with the fastest until the view has changed.

    In a trial frame the CPU waits for the GPU, so that the frame's cost is known; the wait counts as stalled. The
    view has changed when the eye has moved by 0.15 of the scene's diagonal or turned by 45°, or when the number of
    objects drawn has grown or shrunk by a factor of 1.5. After a trial there is none for a number of frames, which
    doubles each time that a trial has the same result.

    Attributes:
        latest: the algorithm of the latest frame, None before the first.
        names: the names of all candidates. candidates: those that were made, each when it is first tried.
        chosen: the name of the fastest, or during a trial of the one on trial.
    """

    opens_pass: Final = True

    def __init__(
        self,
        scene: Scene,
        device: Device,
        makers: Mapping[str, Callable[[], VisibilityAlgorithm]],
        *,
        frames: int = 5,
        rest: int = 120,
    ) -> None:
        """`makers` make the candidates.

        Each is tried for `frames` frames, 3 or more: the first two aren't counted, and the least time of the others
        counts. A candidate is given up when they leave no hope that it is the fastest. When the second best is close
        to the fastest, both are tried again, because disturbances of a machine last for some frames. `rest` is the
        least number of frames without a trial after a trial.
        """
        self.names = tuple(makers)
        self.candidates: dict[str, VisibilityAlgorithm] = {}
        self.chosen = self.names[0]
        self.latest: VisibilityAlgorithm | None = None
        self._makers = dict(makers)
        self._device = device
        self._frames = max(frames, _SETTLES + 1)
        lower, upper = scene.bounds
        self._reach = _MOVED * float(np.linalg.norm(upper - lower))
        self._untried: list[str] = []  # in reverse order
        self._times: list[float] = []  # of the candidate on trial
        self._least: dict[str, float] = {}  # the least time of each candidate that was tried
        self._is_final = False
        self._last = ""  # the choice of the last trial
        self._shortest = self._rest = self._left = rest
        self._camera: Camera | None = None  # the camera at the end of the trial
        self._drawn = 0  # number of objects in the frame after the trial
        self._begin_trial()

    @property
    def is_trying(self) -> bool:
        """Whether the next frame is a trial frame."""
        return bool(self._untried)

    def render(self, camera: Camera, scene_pass: ScenePass) -> VisibilityStatistics:
        """Draw what the chosen algorithm draws."""
        if not self._untried and self._left <= 0 and self._is_elsewhere(camera):
            self._begin_trial()
        if self._untried:
            return self._try_next(camera, scene_pass)
        statistics = _render(self._find(self.chosen), camera, scene_pass)
        self._left -= 1
        self._drawn = self._drawn or statistics.visible
        if self._left < 0 and max(statistics.visible, self._drawn) > _CHANGED * min(
            statistics.visible, self._drawn
        ):
            self._begin_trial()
        return statistics

    def walk(self) -> CullingWalk | None:
        """Return the nodes that the last frame's algorithm reached, None if it walked no hierarchy."""
        return self.latest.walk() if isinstance(self.latest, WalksNodes) else None

    def destroy(self) -> None:
        """Destroy the candidates."""
        for candidate in self.candidates.values():
            candidate.destroy()

    def _begin_trial(self) -> None:
        self._drawn = 0
        self._times.clear()
        self._least.clear()
        self._is_final = False
        if len(self.names) > 1:
            self._untried = list(self.names)[::-1]

    def _try_next(self, camera: Camera, scene_pass: ScenePass) -> VisibilityStatistics:
        device, self.chosen = self._device, self._untried[-1]
        candidate = self._find(self.chosen)
        device.finish()
        began = perf_counter()
        statistics = _render(candidate, camera, scene_pass)
        submitted = perf_counter()
        device.finish()
        done = perf_counter()
        self._times.append(done - began)
        least = min(self._times[_SETTLES:], default=np.inf)
        best = min(self._least.values(), default=np.inf)
        if len(self._times) == self._frames or (len(self._times) > _SETTLES and least > _HOPELESS * best):
            self._least[self.chosen] = min(self._least.get(self.chosen, np.inf), least)
            self._untried.pop()
            self._times.clear()
            if not self._untried:
                self._decide(camera)
        waited = 1e3 * (done - submitted)
        return replace(statistics, stalled_milliseconds=statistics.stalled_milliseconds + waited)

    def _decide(self, camera: Camera) -> None:
        least = self._least
        self.chosen, second = sorted(least, key=least.__getitem__)[:2]
        if not self._is_final and least[second] < _CLOSE * least[self.chosen]:
            self._is_final = True
            self._untried = [second, self.chosen]
            return
        again = self.chosen == self._last
        self._rest = min(2 * self._rest, _LONGEST_REST * self._shortest) if again else self._shortest
        self._last, self._left, self._camera = self.chosen, self._rest, camera

    def _find(self, name: str) -> VisibilityAlgorithm:
        if name not in self.candidates:
            self.candidates[name] = self._makers[name]()
        self.latest = self.candidates[name]
        return self.latest

    def _is_elsewhere(self, camera: Camera) -> bool:
        then = self._camera
        if then is None:
            return False
        moved = float(np.linalg.norm(camera.position - then.position))
        return moved > self._reach or float(camera.forward @ then.forward) < _TURNED


def _render(algorithm: VisibilityAlgorithm, camera: Camera, scene_pass: ScenePass) -> VisibilityStatistics:
    """Draw what an algorithm draws, in an open pass if it doesn't open the pass itself."""
    if not algorithm.opens_pass:
        scene_pass.open()
    return algorithm.render(camera, scene_pass)
