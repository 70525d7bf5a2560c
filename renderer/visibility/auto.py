"""The algorithm that measures: which one is fastest depends on the scene, the view and the device."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from time import perf_counter
from typing import Final

import numpy as np

from renderer.scene import Camera, Scene
from renderer.visibility.algorithm import DrawObjects, Statistics, VisibilityAlgorithm
from renderer.visibility.chc import Chc
from renderer.visibility.chc_plus_plus import ChcPlusPlus
from renderer.visibility.frustum import FrustumCulling
from rhi import Device

__rhi_internal__ = True

_TURNED: Final = float(np.cos(np.pi / 4))
_MOVED: Final = 0.15  # of the scene's diagonal
_CHANGED: Final = 1.5  # times as many objects drawn, or as few


class AutoCulling:
    """Tries each candidate for some frames, then stays with the fastest until the view is another.

    In a frame on trial the CPU waits for the GPU, so that the frame's cost is known; it counts as stalled. The
    view is another when the eye has moved by 0.15 of the scene's diagonal or turned by 45°, or when the number of
    objects drawn has become 1.5 times as large or as small.

    Attributes:
        candidates: what is tried, by name.
        chosen: the name of the fastest; the one on trial while there is a trial.
        is_trying: whether the next frame is on trial.
    """

    def __init__(
        self,
        scene: Scene,
        device: Device,
        *,
        frames: int = 6,
        candidates: Mapping[str, VisibilityAlgorithm] | None = None,
    ) -> None:
        """`frames`, 2 or more, is how long each of `candidates` is tried: in the first half it settles, of the
        others the least time counts. Without candidates: frustum and, where a device answers queries, chc and
        chc_plus_plus.
        """
        if candidates is None:
            candidates = {"frustum": FrustumCulling(scene)}
            can = device.capabilities
            if can.shading and (can.occlusion_queries or can.sample_counter):
                candidates |= {"chc": Chc(scene, device), "chc_plus_plus": ChcPlusPlus(scene, device)}
        self.candidates = dict(candidates)
        self.chosen = next(iter(self.candidates))
        self._device = device
        self._frames = max(frames, 2)
        lower, upper = scene.bounds
        self._reach = _MOVED * float(np.linalg.norm(upper - lower))
        self._order: list[str] = []  # the frames of a trial that are left, last first
        self._times: dict[str, list[float]] = {}
        self._camera: Camera | None = None  # where the trial took place
        self._drawn = 0  # in the frame after it
        self._begin_trial()

    @property
    def is_trying(self) -> bool:
        """Whether the next frame is one of a trial."""
        return bool(self._order)

    def render(self, camera: Camera, draw: DrawObjects) -> Statistics:
        """Draw what the chosen algorithm draws."""
        if not self._order and self._is_elsewhere(camera):
            self._begin_trial()
        if self._order:
            return self._try_next(camera, draw)
        statistics = self.candidates[self.chosen].render(camera, draw)
        self._drawn = self._drawn or statistics.visible
        if max(statistics.visible, self._drawn) > _CHANGED * min(statistics.visible, self._drawn):
            self._begin_trial()
        return statistics

    def _begin_trial(self) -> None:
        self._drawn = 0
        if len(self.candidates) > 1:
            self._times = {name: [] for name in self.candidates}
            self._order = [name for name in self.candidates for _ in range(self._frames)][::-1]

    def _try_next(self, camera: Camera, draw: DrawObjects) -> Statistics:
        device, self.chosen = self._device, self._order.pop()
        device.finish()
        began = perf_counter()
        statistics = self.candidates[self.chosen].render(camera, draw)
        submitted = perf_counter()
        device.finish()
        done = perf_counter()
        self._times[self.chosen].append(done - began)
        if not self._order:
            self.chosen = min(self._times, key=lambda name: min(self._times[name][self._frames // 2 :]))
            self._camera = camera
        waited = 1e3 * (done - submitted)
        return replace(statistics, stalled_milliseconds=statistics.stalled_milliseconds + waited)

    def _is_elsewhere(self, camera: Camera) -> bool:
        then = self._camera
        if then is None:
            return False
        moved = float(np.linalg.norm(camera.position - then.position))
        return moved > self._reach or float(camera.forward @ then.forward) < _TURNED
