"""The algorithm that measures others: which one is fastest depends on the scene, the view and the device."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from time import perf_counter
from typing import Final

from renderer.scene import Camera, Depth, Scene
from renderer.scene.arrays import Indices
from renderer.visibility.algorithm import VisibilityAlgorithm, VisibilityStatistics, to_selecting
from renderer.visibility.scene_drawer import SceneDrawer
from renderer.visibility.speed_trial import CandidateSelector, SpeedTrial
from renderer.visibility.traversal import CullingTraversal, TraversalSource
from rhi import Device, Preparation

_WARM_UP_FRAMES: Final = 3
"""The frame by which it shows which kernels are hot. These are optimised before those that only a candidate
needs."""


class AutoCulling(CandidateSelector):
    """Tries each candidate for some frames, then stays with the fastest until the view has changed
    (`SpeedTrial`).

    In a trial frame the CPU waits for the GPU, so that the frame's cost is known; the wait counts as stalled.
    While code is built in the background there is no trial: the frame would wait, or its time say little.

    Attributes:
        latest: the algorithm of the latest frame, None before the first.
        candidates: those that were made, each when it is first tried.
    """

    opens_pass: Final = True

    def __init__(
        self,
        scene: Scene,
        device: Device,
        factories: Mapping[str, Callable[[], VisibilityAlgorithm]],
        *,
        prepare: Callable[[Depth], Preparation] | None = None,
        frames: int = 5,
        idle: int = 120,
    ) -> None:
        """`factories` make the candidates, `prepare` begins to build what they need for a direction of depth;
        `frames` and `idle` are those of a `SpeedTrial`."""
        self.candidates: dict[str, VisibilityAlgorithm] = {}
        self.latest: VisibilityAlgorithm | None = None
        self._factories = dict(factories)
        self._prepare = prepare
        self._preparation: Preparation | None = None
        self._device = device
        self._warm_up_left = _WARM_UP_FRAMES
        self._trial = SpeedTrial(scene, list(factories), frames=frames, idle=idle)

    @property
    def is_trying(self) -> bool:
        """True if the next frame is a trial frame, or before the first one."""
        return self._trial.is_trying and (self._warm_up_left > 0 or self._is_ready)

    def render(self, camera: Camera, scene_drawer: SceneDrawer) -> VisibilityStatistics:
        """Draw what the chosen algorithm draws."""
        trial = self._trial
        trial.check_view(camera)
        self._warm_up_left = max(self._warm_up_left - 1, 0)
        if not self._warm_up_left and self._prepare is not None and not self._device.is_building:
            self._preparation, self._prepare = self._prepare(camera.projection.depth), None
        if trial.is_trying and not self._is_ready:
            return _render(self.latest or self._get_candidate(trial.current_name), camera, scene_drawer)
        candidate = self._get_candidate(trial.current_name)
        if trial.is_trying:
            return self._try(candidate, camera, scene_drawer)
        statistics = _render(candidate, camera, scene_drawer)
        trial.idle(statistics.visible)
        return statistics

    def select(self, camera: Camera) -> tuple[Indices, VisibilityStatistics] | None:
        """Select what the chosen algorithm does, unless the frame is on trial or something is being prepared."""
        trial, latest = self._trial, self.latest
        trial.check_view(camera)
        if (
            trial.is_trying
            or self._warm_up_left
            or self._prepare is not None
            or latest is not self.candidates.get(trial.current_name)
            or (selecting := to_selecting(latest)) is None
        ):
            return None
        selected = selecting.select(camera)
        if selected is not None:
            trial.idle(selected[1].visible)
        return selected

    def traversal(self) -> CullingTraversal | None:
        """Return the nodes that the last frame's algorithm reached, None if it walked no hierarchy."""
        return self.latest.traversal() if isinstance(self.latest, TraversalSource) else None

    def destroy(self) -> None:
        """Destroy the candidates."""
        for candidate in self.candidates.values():
            candidate.destroy()

    @property
    def _is_ready(self) -> bool:
        """True if nothing is being built, of what candidates need or else."""
        is_prepared = self._prepare is None and (self._preparation is None or self._preparation.done())
        return is_prepared and not self._device.is_building

    def _try(
        self, candidate: VisibilityAlgorithm, camera: Camera, scene_drawer: SceneDrawer
    ) -> VisibilityStatistics:
        device = self._device
        device.finish()
        began = perf_counter()
        statistics = _render(candidate, camera, scene_drawer)
        submitted = perf_counter()
        device.finish()
        done = perf_counter()
        self._trial.add_time(done - began, camera)
        waited = 1e3 * (done - submitted)
        return replace(statistics, stalled_milliseconds=statistics.stalled_milliseconds + waited)

    def _get_candidate(self, name: str) -> VisibilityAlgorithm:
        if name not in self.candidates:
            self.candidates[name] = self._factories[name]()
        self.latest = self.candidates[name]
        return self.latest


def _render(
    algorithm: VisibilityAlgorithm, camera: Camera, scene_drawer: SceneDrawer
) -> VisibilityStatistics:
    """Draw what an algorithm draws, in an open pass if it doesn't open the pass itself."""
    if not algorithm.opens_pass:
        scene_drawer.open()
    return algorithm.render(camera, scene_drawer)
