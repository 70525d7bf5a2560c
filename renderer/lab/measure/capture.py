"""The times of frames and of their passes, frame by frame: a table for other tools to read."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from renderer.lab.measure.frames import measure_frame
from renderer.renderer import Renderer
from renderer.scene import Shot


@dataclass(frozen=True, slots=True)
class PassTime:
    """The time of a pass in milliseconds: `gpu` between its timestamps, None if the device has none; `cpu` to issue its
    commands."""

    gpu: float | None
    cpu: float


@dataclass(frozen=True, slots=True)
class CapturedFrame:
    """The times of one frame: milliseconds from the scene's update until the GPU is finished, and those of its passes
    by name."""

    frame: int
    milliseconds: float
    passes: dict[str, PassTime]


def capture_frames(renderer: Renderer, shots: Iterable[Shot]) -> Iterator[CapturedFrame]:
    """Render each frame, wait for it, and yield its times. The device's events take timestamps meanwhile."""
    device = renderer.device
    has_timestamps, before = device.capabilities.timestamps, device.timing
    device.timing = has_timestamps
    try:
        for shot in shots:
            _, cost = measure_frame(renderer, shot)
            passes = {
                node.name: PassTime(node.gpu_milliseconds if has_timestamps else None, node.cpu_milliseconds)
                for node in device.timers
            }
            yield CapturedFrame(shot.number, cost.milliseconds, passes)
    finally:
        device.timing = before


def list_passes(frames: Sequence[CapturedFrame]) -> list[str]:
    """Return the names of all passes, in the order in which frames have them."""
    return list(dict.fromkeys(name for one in frames for name in one.passes))


def write_frames(path: Path, frames: Sequence[CapturedFrame]) -> None:
    """Write a row for each frame: its number, its milliseconds, then those of each pass on the GPU and on the CPU. What
    a frame doesn't have is empty."""
    names = list_passes(frames)
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        columns = [f"{name} {where} ms" for name in names for where in ("gpu", "cpu")]
        table.writerow(["frame", "ms", *columns])
        for one in frames:
            times = [one.passes.get(name) for name in names]
            cells = [_show(value) for time in times for value in ((time.gpu, time.cpu) if time else (None, None))]
            table.writerow([one.frame, _show(one.milliseconds), *cells])


def _show(milliseconds: float | None) -> str:
    return "" if milliseconds is None else f"{milliseconds:.4f}"
