"""Many pictures without a window, on all cores: each process has a device of its own and renders a share of the frames.

    python examples/programs/batch.py --backend cl --frames 48 --output frames

Processes are spawned: a forked copy of a driver's threads and contexts doesn't work.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
from frame import Screen
from numpy.typing import NDArray

import rhi
from rhi.shading import Struct, Uniform, cos, fragment_coordinate, length, sin, vec2, vec3, vec4


class Moment(Struct):
    size: vec2
    seconds: float


class Plasma(Screen):
    """Waves that move over the picture."""

    moment: Uniform[Moment]

    def fragment(self) -> vec4:
        place = fragment_coordinate().xy / self.moment.size.y * 6.0 - 3.0
        t = self.moment.seconds
        wave = sin(place.x + t) + sin(place.y * 1.3 - t) + sin(length(place) * 2.0 + t * 2.0)
        return vec4(vec3(0.5) + vec3(cos(wave), cos(wave + 2.1), cos(wave + 4.2)) * 0.5, 1.0)


class Worker:
    """A device and what it needs for one frame after the other."""

    def __init__(self, device: rhi.Device, size: tuple[int, int]) -> None:
        self.device, self.size = device, size
        self.program, self.triangle = device.program(Plasma), device.mesh(3)
        self.image = device.texture(size, rhi.Format.RGBA8)

    def draw(self, seconds: float) -> rhi.Texture:
        """Draw the frame at a time."""
        moment = Moment(size=self.size, seconds=seconds)
        with self.device.render_pass(self.image), self.device.states(rhi.CullMode.NONE):
            self.device.draw(self.program, self.triangle, moment=moment)
        self.device.present(self.image)
        return self.image


WORKERS: list[Worker] = []  # one in each process


def start(backend: str | None, size: tuple[int, int]) -> None:
    """Open the device of this process."""
    WORKERS.append(Worker(rhi.create_device(backend), size))


def render_frame(seconds: float) -> NDArray[np.uint8]:
    """Return the pixels (height, width, 4) of one frame."""
    return WORKERS[0].draw(seconds).read()


def render_frames(
    times: Iterable[float], size: tuple[int, int], backend: str | None = None, processes: int | None = None
) -> Iterable[NDArray[np.uint8]]:
    """Yield the frames at these times in order, rendered by several processes."""
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(processes or os.cpu_count(), spawn, start, (backend, size)) as pool:
        yield from pool.map(render_frame, times, chunksize=4)


def render(device: rhi.Device, size: tuple[int, int]) -> rhi.Texture:
    """Draw one frame in this process."""
    return Worker(device, size).draw(1.5)


if __name__ == "__main__":
    from PIL import Image

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--backend")
    parser.add_argument("--size", default="640x480", metavar="WxH")
    parser.add_argument("--frames", type=int, default=1, help="default: 1, which is saved as a picture")
    parser.add_argument("--output", type=Path, default=Path("batch"), help="a folder, or the name of the picture")
    given = parser.parse_args()
    width, _, height = given.size.partition("x")
    times = np.arange(given.frames) / 24 + 1.5
    many = given.frames > 1
    for number, pixels in enumerate(render_frames(times.tolist(), (int(width), int(height)), given.backend)):
        path = given.output / f"{number:04}.png" if many else given.output.with_suffix(".png")
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(pixels[..., :3]).save(path)
        print(path)
