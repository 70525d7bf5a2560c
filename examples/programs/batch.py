"""Many images without a window, on all cores, and their tests: each process has a device of its own.

    python examples/programs/batch.py --backend cl --frames 48 --output frames
    python -m pytest examples/programs/batch.py

Processes are spawned: a forked copy of a driver's threads and contexts doesn't work.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np

import rhi
from rhi.shading import FullScreen, Struct, Uniform, cos, fragment_coordinate, length, sin, vec2, vec3, vec4


class Moment(Struct):
    size: vec2
    seconds: float


class Plasma(FullScreen):
    """Waves that move over the image."""

    moment: Uniform[Moment]

    def fragment(self) -> vec4:
        position = fragment_coordinate().xy / self.moment.size.y * 6.0 - 3.0
        t = self.moment.seconds
        wave = sin(position.x + t) + sin(position.y * 1.3 - t) + sin(length(position) * 2.0 + t * 2.0)
        return vec4(vec3(0.5) + vec3(cos(wave), cos(wave + 2.1), cos(wave + 4.2)) * 0.5, 1.0)


class Worker:
    """A device and what it needs for one frame after the other."""

    def __init__(self, device: rhi.Device, size: tuple[int, int]) -> None:
        self.device, self.program, self.triangle = device, device.program(Plasma), device.mesh(3)
        self.image = device.texture(size, rhi.Format.RGBA8)

    def draw(self, seconds: float) -> rhi.Texture:
        """Draw the frame at a time."""
        moment = Moment(size=self.image.size, seconds=seconds)
        with self.device.render_pass(self.image):
            self.device.draw(self.program, self.triangle, moment=moment)
        self.device.present(self.image)
        return self.image


def render(device: rhi.Device, size: tuple[int, int]) -> rhi.Texture:
    """Draw one frame in this process."""
    return Worker(device, size).draw(1.5)


WORKERS: list[Worker] = []  # one in each process


def start(backend: str | None, size: tuple[int, int]) -> None:
    """Open the device of this process."""
    WORKERS.append(Worker(rhi.create_device(backend), size))


def save_frame(seconds: float, path: Path) -> Path:
    """Draw the frame at a time, and write it."""
    WORKERS[0].draw(seconds).save(path)
    return path


def save_frames(
    times: list[float],
    paths: list[Path],
    size: tuple[int, int],
    backend: str | None = None,
    processes: int | None = None,
) -> Iterator[Path]:
    """Draw the frames at these times by several processes, and yield each path in order once it is
    written."""
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(processes or os.cpu_count(), spawn, start, (backend, size)) as pool:
        yield from pool.map(save_frame, times, paths, chunksize=4)


def test_a_frame_is_one_draw_and_a_second_one_creates_nothing(null_device: rhi.Device) -> None:
    worker = Worker(null_device, (64, 48))
    worker.draw(0.0)
    begun = len(null_device.stream)
    worker.draw(1.0)
    assert len(null_device.stream.draws()) == 2
    assert not [command for command in null_device.stream[begun:] if command.op.name.startswith("CREATE")]


def test_the_waves_move(rhi_device: rhi.Device) -> None:  # on each of --rhi-backend
    if rhi_device.capabilities.renders:
        worker = Worker(rhi_device, (64, 48))
        first, second, again = (worker.draw(seconds).read().astype(int) for seconds in (0.0, 0.5, 0.0))
        assert np.array_equal(first, again)
        assert np.abs(first - second).mean() > 10


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--backend")
    parser.add_argument("--size", default="640x480", metavar="WxH")
    parser.add_argument("--frames", type=int, default=1, help="default: 1, which is saved as an image")
    parser.add_argument(
        "--output", type=Path, default=Path("batch"), help="a folder, or the name of the image"
    )
    options = parser.parse_args()
    width, height = (int(side) for side in options.size.split("x"))
    times, paths = np.arange(options.frames) / 24 + 1.5, [options.output.with_suffix(".png")]
    if options.frames > 1:
        options.output.mkdir(parents=True, exist_ok=True)
        paths = [options.output / f"{number:04}.png" for number in range(options.frames)]
    for path in save_frames(times.tolist(), paths, (width, height), options.backend):
        print(path)
