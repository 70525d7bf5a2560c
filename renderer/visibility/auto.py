"""The algorithm that measures: which one is fastest depends on the scene, the view and the device."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from time import perf_counter
from typing import Final

import numpy as np

from renderer.scene import Camera, Scene
from renderer.visibility.algorithm import VisibilityAlgorithm, VisibilityStatistics
from renderer.visibility.scene_pass import ScenePass
from rhi import Device

__rhi_internal__ = True

_TURNED: Final = float(np.cos(np.pi / 4))
_MOVED: Final = 0.15  # of the scene's diagonal
_CHANGED: Final = 1.5  # times as many objects drawn, or as few
_SETTLES: Final = 2  # frames
_HOPELESS: Final = 1.5  # times the best time so far
_CLOSE: Final = 1.25  # times the best
_LONGEST_REST: Final = 8  # times the shortest


class AutoCulling:
    """Tries each candidate for some frames, then stays with the fastest until the view is another.

    In a frame on trial the CPU waits for the GPU, so that the frame's cost is known; it counts as stalled. The
    view is another when the eye has moved by 0.15 of the scene's diagonal or turned by 45°, or when the number of
    objects drawn has become 1.5 times as large or as small. After a trial there is none for some frames, and for
    twice as many each time that it comes to the same end.

    Attributes:
        names: of what is tried; candidates: those of them that were made, each when it is first tried.
        chosen: the name of the fastest; the one on trial while there is a trial.
        is_trying: whether the next frame is on trial.
    """

    opens_pass: Final = False

    def __init__(
        self,
        scene: Scene,
        device: Device,
        makers: Mapping[str, Callable[[], VisibilityAlgorithm]],
        *,
        frames: int = 5,
        rest: int = 120,
    ) -> None:
        """`makers` make the candidates. `frames`, 3 or more, is how long each is tried: in two it settles, of the
        others the least time counts; it is given up when they leave it no hope. When the second is close to the
        fastest, both are tried again: what disturbs a machine lasts for some frames. `rest`: frames without a trial
        after one, at least."""
        self.names = tuple(makers)
        self.candidates: dict[str, VisibilityAlgorithm] = {}
        self.chosen = self.names[0]
        self._makers = dict(makers)
        self._device = device
        self._frames = max(frames, _SETTLES + 1)
        lower, upper = scene.bounds
        self._reach = _MOVED * float(np.linalg.norm(upper - lower))
        self._untried: list[str] = []  # last first
        self._times: list[float] = []  # of the one on trial
        self._least: dict[str, float] = {}  # of each that was tried
        self._is_final = False
        self._last = ""  # what the last trial came to
        self._shortest = self._rest = self._left = rest
        self._camera: Camera | None = None  # where the trial ended
        self._drawn = 0  # in the frame after it
        self._begin_trial()

    @property
    def is_trying(self) -> bool:
        """Whether the next frame is one of a trial."""
        return bool(self._untried)

    def render(self, camera: Camera, scene_pass: ScenePass) -> VisibilityStatistics:
        """Draw what the chosen algorithm draws."""
        if not self._untried and self._left <= 0 and self._is_elsewhere(camera):
            self._begin_trial()
        if self._untried:
            return self._try_next(camera, scene_pass)
        statistics = self._find(self.chosen).render(camera, scene_pass)
        self._left -= 1
        self._drawn = self._drawn or statistics.visible
        if self._left < 0 and max(statistics.visible, self._drawn) > _CHANGED * min(
            statistics.visible, self._drawn
        ):
            self._begin_trial()
        return statistics

    def destroy(self) -> None:
        """Give back what the candidates made on the device."""
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
        statistics = candidate.render(camera, scene_pass)
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
        return self.candidates[name]

    def _is_elsewhere(self, camera: Camera) -> bool:
        then = self._camera
        if then is None:
            return False
        moved = float(np.linalg.norm(camera.position - then.position))
        return moved > self._reach or float(camera.forward @ then.forward) < _TURNED
