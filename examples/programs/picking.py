"""Picking: a second render target holds the number of the box in each pixel; a click reads one texel of
it."""

from __future__ import annotations

import numpy as np

import rhi
from rhi import Format
from rhi.math import look_at, make_cube, perspective
from rhi.shading import (
    Shader,
    Storage,
    Struct,
    Uniform,
    dot,
    instance_index,
    mat4,
    normalize,
    uint,
    vec3,
    vec4,
)
from rhi_screen import save_image

BOXES = 300


class Vertex(Struct):
    position: vec3
    normal: vec3


class Camera(Struct):
    view_projection: mat4


class Box(Struct):
    center: vec3
    color: vec3


class Choice(Struct):
    box: int


class Surface(Struct):
    clip: vec4
    normal: vec3
    color: vec3
    number: int


class PickingOutput(Struct):
    color: vec4
    number: uint


class Boxes(Shader):
    """Writes a color and a number; the chosen box is white."""

    camera: Uniform[Camera]
    choice: Uniform[Choice]
    boxes: Storage[Box]

    def vertex(self, v: Vertex) -> Surface:
        number = instance_index()
        box = self.boxes[number]
        clip = self.camera.view_projection @ vec4(v.position * 0.4 + box.center, 1.0)
        return Surface(clip=clip, normal=v.normal, color=box.color, number=number)

    def fragment(self, s: Surface) -> PickingOutput:
        light = 0.25 + 0.75 * max(dot(s.normal, normalize(vec3(0.4, 0.9, 0.6))), 0.0)
        color = vec3(1.0) if s.number == self.choice.box else s.color
        return PickingOutput(color=vec4(color * light, 1.0), number=uint(s.number))


class Scene:
    """Boxes that can be drawn and picked."""

    def __init__(self, device: rhi.Device, size: tuple[int, int]) -> None:
        rng = np.random.default_rng(8)
        self.rows = np.zeros(BOXES, Box.dtype)
        self.rows["center"], self.rows["color"] = (
            rng.uniform(-5, 5, (BOXES, 3)),
            rng.uniform(0.1, 0.6, (BOXES, 3)),
        )
        positions, normals, _, indices = make_cube()
        self.device, self.program = device, device.program(Boxes)
        self.cube = device.mesh({"position": positions, "normal": normals}, indices)
        self.view_projection = perspective(np.radians(45), size[0] / size[1]) @ look_at((8, 7, 10), (0, 0, 0))
        self.camera = device.uniform(Camera(view_projection=self.view_projection))
        self.choice = device.uniform(Choice(box=-1))
        self.boxes = device.storage(Box, self.rows)
        self.image = device.texture(size, Format.RGBA8_SRGB)
        self.numbers = device.texture(size, Format.R32UI)
        self.depth = device.texture(size, Format.D32F)

    def draw(self) -> None:
        """Draw all boxes to the image and to the numbers."""
        clear = [(0.02, 0.03, 0.05, 1), (BOXES, 0, 0, 0)]
        with self.device.render_pass([self.image, self.numbers], self.depth, clear=clear, clear_depth=0.0):
            self.device.draw(
                self.program, self.cube, BOXES, camera=self.camera, choice=self.choice, boxes=self.boxes
            )

    def pick(self, x: int, y: int) -> int | None:
        """Return the number of the box in a pixel, or None. Only that texel is read back."""
        number = int(self.numbers.read(region=rhi.Region(x, y, 1, 1)).item())
        return None if number == BOXES else number


def render(device: rhi.Device, size: tuple[int, int]) -> rhi.Texture:
    """Draw the boxes, click into the middle, and draw them with the box that was hit in white."""
    scene = Scene(device, size)
    scene.draw()
    picked = scene.pick(size[0] // 2, size[1] // 2)
    scene.choice.write(Choice(box=-1 if picked is None else picked))
    scene.draw()
    return scene.image


if __name__ == "__main__":
    save_image(render)
