"""Times of frames and of their passes, frame by frame, as a CSV table for other tools."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from renderer.inspection.frame_cost import measure_frame
from renderer.renderer import Renderer
from renderer.scene import PathFrame


@dataclass(frozen=True, slots=True)
class PassTime:
    """The time of a pass in milliseconds: `gpu` between its timestamps, None if the device has none; `cpu`
    for recording its commands."""

    gpu: float | None
    cpu: float


@dataclass(frozen=True, slots=True)
class CapturedFrame:
    """The times of one frame: milliseconds from the scene's update until the GPU is finished, and the time of
    each pass by name."""

    frame: int
    milliseconds: float
    passes: dict[str, PassTime]


def capture_frames(renderer: Renderer, path_frames: Iterable[PathFrame]) -> Iterator[CapturedFrame]:
    """Render each frame, wait for it, and yield its times. The device's timing is switched on meanwhile."""
    device = renderer.device
    has_timestamps, before = device.capabilities.timestamps, device.timing
    device.timing = has_timestamps
    try:
        for path_frame in path_frames:
            _, cost = measure_frame(renderer, path_frame)
            passes = {
                node.name: PassTime(node.gpu_milliseconds if has_timestamps else None, node.cpu_milliseconds)
                for node in device.timers
            }
            yield CapturedFrame(path_frame.number, cost.milliseconds, passes)
    finally:
        device.timing = before


def list_passes(frames: Sequence[CapturedFrame]) -> list[str]:
    """The names of all passes, in the order in which frames have them."""
    return list(dict.fromkeys(name for frame in frames for name in frame.passes))


def write_frames(path: Path, frames: Sequence[CapturedFrame]) -> None:
    """Write a CSV row for each frame: number, milliseconds, and the time of each pass on the GPU and on the
    CPU. Missing values are empty."""
    names = list_passes(frames)
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        columns = [f"{name} {where} ms" for name in names for where in ("gpu", "cpu")]
        table.writerow(["frame", "ms", *columns])
        for frame in frames:
            times = [frame.passes.get(name) for name in names]
            cells = [
                _format_milliseconds(value)
                for time in times
                for value in ((time.gpu, time.cpu) if time else (None, None))
            ]
            table.writerow([frame.frame, _format_milliseconds(frame.milliseconds), *cells])


def _format_milliseconds(milliseconds: float | None) -> str:
    return "" if milliseconds is None else f"{milliseconds:.4f}"
