"""A film on several processes: the frames of a spiral of cubes, drawn by any number of workers to a video.

    python examples/programs/film.py --frames 120 --executor processes:2 --output spiral.mp4

Each worker opens a device of its own, once. A frame depends on its number alone, so the video has the same bytes from
one worker as from ten, and an interrupted film goes on where it stopped.
"""

from __future__ import annotations

import argparse
from typing import Self

import numpy as np

import rhi
from rhi.math import make_cube, perspective, rotation, translation
from rhi.shading import Shader, Struct, Uniform, cos, dot, instance_index, mat4, normalize, sin, vec3, vec4
from rhi_screen import film

COUNT = 60
FRAMES = 120


class Vertex(Struct):
    position: vec3
    normal: vec3


class Moment(Struct):
    view_projection: mat4
    turn: float


class Varying(Struct):
    clip: vec4
    normal: vec3
    color: vec3


class Spiral(Shader):
    """Places a cube for each instance along a spiral that turns."""

    moment: Uniform[Moment]

    def vertex(self, v: Vertex) -> Varying:
        along = float(instance_index()) / 60.0
        angle = along * 18.0 + self.moment.turn
        center = vec3(cos(angle) * 2.0, along * 4.0 - 2.0, sin(angle) * 2.0)
        return Varying(
            clip=self.moment.view_projection @ vec4(center + v.position * (0.15 + 0.2 * along), 1.0),
            normal=v.normal,
            color=vec3(0.2 + 0.8 * along, 0.5, 1.0 - 0.8 * along),
        )

    def fragment(self, v: Varying) -> vec4:
        light = 0.25 + 0.75 * max(dot(normalize(v.normal), normalize(vec3(0.4, 0.8, 0.6))), 0.0)
        return vec4(v.color * light, 1.0)


def draw(device: rhi.Device, size: tuple[int, int], frame: int) -> rhi.Texture:
    """Draw a frame; `FRAMES` of them are a turn."""
    positions, normals, _, indices = make_cube()
    view = translation((0, 0, -8)) @ rotation((1, 0, 0), 0.3)
    moment = Moment(
        view_projection=perspective(0.8, size[0] / size[1], 0.1) @ view, turn=frame / FRAMES * 2.0 * np.pi
    )
    cube = device.mesh({"position": positions, "normal": normals}, indices)
    image = device.texture(size, rhi.Format.RGBA8)
    depth = device.texture(size, rhi.Format.D32F)
    with device.render_pass(image, depth, clear=(0.02, 0.02, 0.05, 1.0), clear_depth=0.0):
        device.draw(device.program(Spiral), cube, COUNT, moment=moment)
    for resource in (cube, depth):
        resource.destroy()
    return image


class Worker:
    """Draws frames on a device that is opened where the frames are drawn."""

    def __init__(self, size: tuple[int, int], backend: str | None) -> None:
        self.size, self.backend = size, backend

    def __enter__(self) -> Self:
        self.device = rhi.create_device(self.backend)
        return self

    def __call__(self, frame: int) -> np.ndarray:
        image = draw(self.device, self.size, frame)
        pixels = image.read()
        image.destroy()
        return pixels

    def __exit__(self, *_: object) -> None:
        self.device.close()


def render(device: rhi.Device, size: tuple[int, int]) -> rhi.Texture:
    """Draw one frame."""
    return draw(device, size, 20)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--backend")
    parser.add_argument("--size", default="640x480", metavar="WxH")
    parser.add_argument("--frames", type=int, default=FRAMES)
    parser.add_argument("--executor", default="serial", help="serial, processes:N or dask:ADDRESS")
    parser.add_argument("--output", default="film.mp4", help="a video, or images: spiral/%%03d.png")
    options = parser.parse_args()
    width, height = map(int, options.size.split("x"))
    worker = Worker((width, height), options.backend)
    result = film(worker, range(options.frames), options.executor, options.output, fps=30.0)
    print(f"{result.output}: {result.frames} frames, {result.drawn} drawn now")
