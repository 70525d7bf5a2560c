"""Assertions on the commands of an engine's frame, without a GPU: `python examples/frame_commands.py`.

The engine draws opaque boxes front to back, then transparent ones back to front. Break it, and run it again:
draw `boxes` instead of `opaque`, or leave `DepthWrite.OFF` out.
"""

from __future__ import annotations

from dataclasses import dataclass

import rhi
from rhi import BlendFunction, DepthWrite, Format, Op
from rhi.math import make_cube
from rhi.shading import Shader, Struct, Uniform, vec3, vec4


class Vertex(Struct):
    position: vec3


class Shape(Struct):
    offset: vec4  # w: the scale
    color: vec4


class Plain(Shader):
    shape: Uniform[Shape]

    def vertex(self, v: Vertex) -> vec4:
        return vec4(v.position * self.shape.offset.w + self.shape.offset.xyz, 1.0)

    def fragment(self) -> vec4:
        return self.shape.color


@dataclass(frozen=True)
class Box:
    """A box at a distance of 0 (near) to 1."""

    x: float
    distance: float
    alpha: float


class Engine:
    """Draws boxes to an image."""

    def __init__(self, device: rhi.Device) -> None:
        positions, _, _, indices = make_cube()
        self.device, self.program = device, device.program(Plain)
        self.cube = device.mesh({"position": positions}, indices, label="cube")
        self.image = device.texture((64, 48), Format.RGBA8, label="image")
        self.depth = device.texture((64, 48), Format.D32F, label="depth")

    def draw(self, boxes: list[Box]) -> None:
        """Draw a frame."""
        near_first = sorted(boxes, key=lambda box: box.distance)
        opaque = [box for box in near_first if box.alpha == 1.0]
        transparent = [box for box in reversed(near_first) if box.alpha < 1.0]
        with self.device.render_pass(self.image, self.depth, clear=(0, 0, 0, 1), clear_depth=0.0):
            with self.device.event("opaque"):
                self.draw_boxes(opaque)
            with (
                self.device.event("transparent"),
                self.device.states(BlendFunction.ALPHA, DepthWrite.OFF),
            ):
                self.draw_boxes(transparent)
        self.device.present(self.image)

    def draw_boxes(self, boxes: list[Box]) -> None:
        """Draw boxes in this order."""
        for box in boxes:
            offset = (box.x, 0, 0.9 - 0.8 * box.distance, 0.1)
            self.device.draw(self.program, self.cube, shape=Shape(offset=offset, color=(1, 1, 1, box.alpha)))


BOXES = [Box(-0.5, 0.8, 1.0), Box(0.5, 0.2, 1.0), Box(0.45, 0.1, 0.5), Box(-0.45, 0.6, 0.5)]

device = rhi.create_device("null")
engine = Engine(device)
begun = len(device.stream)
engine.draw(BOXES)
frame = device.stream[begun:]
draws = frame.draws()

assert len(frame.filter(Op.BEGIN_PASS)) == 1, "a frame is one pass"
assert [draw.labels[-1] for draw in draws] == ["opaque", "opaque", "transparent", "transparent"]
assert [draw.states[DepthWrite] for draw in draws] == [DepthWrite.ON] * 2 + [DepthWrite.OFF] * 2

engine.draw(BOXES)
steady = device.stream[begun + len(frame) :]
assert not [command for command in steady if command.op.name.startswith("CREATE")], "it creates nothing"
print(f"{len(frame)} commands a frame, {len(draws)} draws; all assertions hold")
