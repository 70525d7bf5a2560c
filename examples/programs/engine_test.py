"""The tests of an engine on the null device: what a frame sends, without a GPU, a driver or an image.

    python -m pytest examples/programs/engine_test.py

The engine draws opaque things front to back, then transparent ones back to front, with one program.
"""

from __future__ import annotations

from dataclasses import dataclass

import pytest

import rhi
from rhi import BlendFunction, DepthWrite, Format, Op
from rhi.math import make_cube
from rhi.shading import Shader, Struct, Uniform, vec3, vec4
from rhi_screen import save_image


class Vertex(Struct):
    position: vec3


class Thing(Struct):
    offset: vec4  # w: the scale
    color: vec4


class Plain(Shader):
    thing: Uniform[Thing]

    def vertex(self, v: Vertex) -> vec4:
        return vec4(v.position * self.thing.offset.w + self.thing.offset.xyz, 1.0)

    def fragment(self) -> vec4:
        return self.thing.color


@dataclass(frozen=True)
class Box:
    """A box at a distance of 0 (near) to 1."""

    x: float
    distance: float
    color: tuple[float, float, float, float]


class Engine:
    """Draws boxes to an image."""

    def __init__(self, device: rhi.Device, size: tuple[int, int]) -> None:
        positions, _, _, indices = make_cube()
        self.device, self.program = device, device.program(Plain)
        self.cube = device.mesh({"position": positions}, indices, label="cube")
        self.image = device.texture(size, Format.RGBA8, label="image")
        self.depth = device.texture(size, Format.D32F, label="depth")

    def draw(self, boxes: list[Box]) -> None:
        """Draw a frame of boxes; depth is reversed."""
        near_first = sorted(boxes, key=lambda box: box.distance)
        solid = [box for box in near_first if box.color[3] == 1.0]
        clear = [box for box in reversed(near_first) if box.color[3] < 1.0]
        with self.device.render_pass(self.image, self.depth, clear=(0, 0, 0, 1), clear_depth=0.0):
            with self.device.event("solid"):
                self._draw_each(solid)
            if clear:
                with self.device.event("clear"), self.device.states(BlendFunction.ALPHA, DepthWrite.OFF):
                    self._draw_each(clear)
        self.device.present(self.image)

    def _draw_each(self, boxes: list[Box]) -> None:
        for box in boxes:
            thing = Thing(offset=(box.x, 0, 0.9 - 0.8 * box.distance, 0.1), color=box.color)
            self.device.draw(self.program, self.cube, thing=thing)


BOXES = [
    Box(-0.5, 0.8, (1, 0, 0, 1)),
    Box(0.5, 0.2, (0, 1, 0, 1)),
    Box(0.45, 0.1, (0, 0, 1, 0.5)),
    Box(-0.45, 0.6, (1, 1, 0, 0.5)),
]


@pytest.fixture
def engine(null_device: rhi.Device) -> Engine:
    return Engine(null_device, (64, 48))


def test_a_frame_is_one_pass(engine: Engine, command_stream: rhi.CommandStream) -> None:
    engine.draw(BOXES)
    assert len(command_stream.filter(Op.BEGIN_PASS)) == 1
    assert len(command_stream.draws()) == len(BOXES)


def test_transparent_boxes_come_last(engine: Engine, command_stream: rhi.CommandStream) -> None:
    engine.draw(BOXES)
    assert [draw.labels[-1] for draw in command_stream.draws()] == ["solid", "solid", "clear", "clear"]


def test_without_transparent_boxes_nothing_blends(engine: Engine, command_stream: rhi.CommandStream) -> None:
    engine.draw(BOXES[:2])
    assert not [draw for draw in command_stream.draws() if "clear" in draw.labels]


def test_a_steady_frame_creates_nothing(engine: Engine, command_stream: rhi.CommandStream) -> None:
    engine.draw(BOXES)
    begun = len(command_stream)
    engine.draw(BOXES)
    assert not [command for command in command_stream[begun:] if command.op.name.startswith("CREATE")]


def render(device: rhi.Device, size: tuple[int, int]) -> rhi.Texture:
    """Draw the boxes on a device that draws."""
    engine = Engine(device, size)
    engine.draw(BOXES)
    return engine.image


if __name__ == "__main__":
    save_image(render)
