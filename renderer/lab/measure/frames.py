"""The cost of frames: the time until the GPU is finished, and the counters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from statistics import median
from time import perf_counter

from renderer.renderer import FrameResult, FrameStatistics, Renderer
from renderer.scene import Camera, Shot


@dataclass(frozen=True, slots=True)
class FrameCost:
    """The cost of one frame: milliseconds from the scene's update until the GPU is finished, and counters."""

    milliseconds: float
    statistics: FrameStatistics

    @staticmethod
    def summarize(costs: Sequence[FrameCost]) -> dict[str, float | dict[str, float]]:
        """Return the minimum, median and maximum of the milliseconds, and the rounded mean of each counter.

        There must be at least one frame.
        """
        times = [cost.milliseconds for cost in costs]
        return {
            "milliseconds": {"min": min(times), "median": median(times), "max": max(times)},
        } | {
            field.name: round(sum(getattr(cost.statistics, field.name) for cost in costs) / len(costs))
            for field in fields(FrameStatistics)
        }


def measure_frame(renderer: Renderer, shot: Shot) -> tuple[FrameResult, FrameCost]:
    """Render a shot, wait for the device, and return the result and its cost."""
    began = perf_counter()
    result = renderer.render(shot.camera, shot.seconds)
    renderer.device.finish()
    return result, FrameCost(1e3 * (perf_counter() - began), result.statistics)


def settle(renderer: Renderer, camera: Camera, seconds: float = 0.0) -> None:
    """Draw a frame, and more as long as visibility algorithms or techniques are on trial."""
    renderer.render(camera, seconds)
    while renderer.is_trying:
        renderer.render(camera, seconds)
