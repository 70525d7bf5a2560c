"""The cost of a frame: the time until the GPU is finished, and counters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from statistics import median
from time import perf_counter

from renderer.renderer import FrameResult, FrameStatistics, Renderer
from renderer.scene import Camera, PathFrame


@dataclass(frozen=True, slots=True)
class FrameCost:
    """The cost of one frame: milliseconds from the scene's update until the GPU is finished, and counters."""

    milliseconds: float
    statistics: FrameStatistics

    @staticmethod
    def summarize(costs: Sequence[FrameCost]) -> dict[str, float | dict[str, float]]:
        """Summarize costs: minimum, median and maximum of the milliseconds, and the rounded mean of each
        counter.

        There must be at least one frame.
        """
        times = [cost.milliseconds for cost in costs]
        return {
            "milliseconds": {"min": min(times), "median": median(times), "max": max(times)},
        } | {
            field.name: round(sum(getattr(cost.statistics, field.name) for cost in costs) / len(costs))
            for field in fields(FrameStatistics)
        }


def measure_frame(renderer: Renderer, path_frame: PathFrame) -> tuple[FrameResult, FrameCost]:
    """Render a frame, wait for the device, and return the result and its cost."""
    began = perf_counter()
    result = renderer.render(path_frame.camera, path_frame.seconds)
    renderer.device.finish()
    return result, FrameCost(1e3 * (perf_counter() - began), result.statistics)


def settle(renderer: Renderer, camera: Camera, seconds: float = 0.0) -> None:
    """Render a frame, and further ones while trials of visibility algorithms or techniques run."""
    renderer.render(camera, seconds)
    while renderer.is_trying:
        renderer.render(camera, seconds)
