"""A turning triangle in a window, drawn by gl beside the window's context, or by cl and copied to it.

    pip install "rhi[viewer]"
    python examples/window.py [--backend cl] [--canvas page] [--frames N] [--immediate]

Dragging turns it, too. The same program runs in a Qt widget, a browser page and a notebook.
"""

from __future__ import annotations

import argparse
import sys
import time
from typing import Any

import numpy as np

import rhi
from rhi.shading import Shader, Struct, Uniform, cos, sin, vec2, vec3, vec4
from rhi_screen import CANVASES, Screen, open_screen


class Corner(Struct):
    position: vec2
    color: vec3


class Turn(Struct):
    angle: float
    aspect: float


class Varying(Struct):
    clip: vec4
    color: vec3


class Turning(Shader):
    turn: Uniform[Turn]

    def vertex(self, v: Corner) -> Varying:
        s = sin(self.turn.angle)
        c = cos(self.turn.angle)
        x = (c * v.position.x - s * v.position.y) / self.turn.aspect
        y = s * v.position.x + c * v.position.y
        return Varying(clip=vec4(x, y, 0.5, 1.0), color=v.color)

    def fragment(self, v: Varying) -> vec4:
        return vec4(v.color, 1.0)


class Demo:
    """Draws the triangle on a screen; of frames with one size the driver gives the same memory again."""

    def __init__(self, screen: Screen, frames: int) -> None:
        self.screen, self.left, self.drawn, self.angle = screen, frames, 0, 0.0
        rows = np.zeros(3, Corner.dtype)
        rows["position"] = [(0.0, 0.8), (-0.7, -0.4), (0.7, -0.4)]
        rows["color"] = np.eye(3)
        self.program, self.corners = screen.device.program(Turning), screen.device.mesh(rows)
        screen.canvas.add_event_handler(self.on_move, "pointer_move")

    def on_move(self, event: dict[str, Any]) -> None:
        if event["buttons"]:
            self.angle = event["x"] / 100

    def draw(self) -> None:
        """Draw a frame in the size that the canvas has now, and show it."""
        screen, self.angle, self.drawn = self.screen, self.angle + 0.02, self.drawn + 1
        width, height = screen.size
        turn = Turn(angle=self.angle, aspect=width / height)
        with screen.device.texture((width, height), rhi.Format.RGBA8, label="frame") as image:
            with screen.device.render_pass(image, clear=(0.1, 0.1, 0.15, 1.0)):
                screen.device.draw(self.program, self.corners, turn=turn)
            screen.show(image)
        if self.drawn == self.left:
            screen.canvas.close()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--backend", default="gl", choices=("gl", "cl"))
    parser.add_argument("--canvas", default="window", choices=sorted(CANVASES))
    parser.add_argument("--frames", type=int, default=0, help="how many; 0: until the window is closed")
    parser.add_argument("--immediate", action="store_true", help="don't wait for the display's refresh")
    options = parser.parse_args()
    try:
        screen = open_screen(
            options.backend, canvas=options.canvas, title="rhi, $fps frames a second", size=(480, 320),
            update_mode="fastest", vsync=not options.immediate,
        )  # fmt: skip
    except rhi.DeviceError as error:
        sys.exit(f"{error.rule.sentence}: {error.given}; {error.tip}")
    with screen:
        demo, begun = Demo(screen, options.frames), time.perf_counter()
        screen.run(demo.draw)
        print(f"{demo.drawn} frames, {demo.drawn / (time.perf_counter() - begun):.1f} a second")


if __name__ == "__main__":
    main()
