"""An orbit viewer: spheres that are drawn with several samples, and turned by dragging, in a window of any
size.

    pip install "rhi[viewer]"
    python examples/orbit_viewer.py [--backend cl] [--canvas page] [--frames N] [--immediate]

Drag to turn, scroll to zoom; F11 fills the display, F12 saves an image. It runs in a Qt widget, a browser
page and a notebook, too.
"""

from __future__ import annotations

import argparse
import sys
from typing import Any

import numpy as np

import rhi
import rhi.shading as sl
from rhi import Format
from rhi.math import make_sphere
from rhi.shading import FullScreen, Shader, Storage, Struct, Uniform, mat4, vec3, vec4
from rhi_screen import CANVASES, OrbitCamera, Screen, open_screen

COUNT = 125


class View(Struct):
    view_projection: mat4
    eye: vec3
    height: float


class Ball(Struct):
    position: vec3
    radius: float
    color: vec3


class Corner(Struct):
    position: vec3


class Surface(Struct):
    clip: vec4
    position: vec3
    normal: vec3
    color: vec3


class Balls(Shader):
    """Lights each ball by one light, with a highlight."""

    view: Uniform[View]
    balls: Storage[Ball]

    def vertex(self, v: Corner) -> Surface:
        ball = self.balls[sl.instance_index()]
        position = v.position * ball.radius + ball.position
        clip = self.view.view_projection @ vec4(position, 1.0)
        return Surface(clip=clip, position=position, normal=v.position, color=ball.color)

    def fragment(self, s: Surface) -> vec4:
        sun, normal = sl.normalize(vec3(0.4, 0.8, 0.5)), sl.normalize(s.normal)
        mirrored = sl.reflect(sl.normalize(s.position - self.view.eye), normal)
        shine = sl.pow(max(sl.dot(mirrored, sun), 0.0), 40.0) * 0.5
        return vec4(s.color * (max(sl.dot(normal, sun), 0.0) * 0.85 + 0.15) + shine, 1.0)


class Sky(FullScreen):
    view: Uniform[View]

    def fragment(self) -> vec4:
        part = sl.fragment_coordinate().y / self.view.height
        return vec4(vec3(0.05, 0.09, 0.16) * (1.0 - part) + vec3(0.25, 0.28, 0.3) * part, 1.0)


class Viewer:
    def __init__(self, screen: Screen, frames: int) -> None:
        device, self.screen, self.left = screen.device, screen, frames
        self.targets = screen.targets(Format.RGBA8_SRGB, Format.D32F, samples=4)
        self.camera = OrbitCamera(screen, distance=9.0)
        rows, rng = np.zeros(COUNT, Ball.dtype), np.random.default_rng(3)
        rows["position"] = np.indices((5, 5, 5)).reshape(3, -1).T - 2.0
        rows["radius"], rows["color"] = rng.uniform(0.15, 0.45, COUNT), rng.uniform(0.05, 0.8, (COUNT, 3))
        positions, indices = make_sphere()
        self.sphere, self.balls = device.mesh({"position": positions}, indices), device.storage(Ball, rows)
        self.ball, self.sky, self.triangle = device.program(Balls), device.program(Sky), device.mesh(3)
        screen.canvas.add_event_handler(self.on_key, "key_down")

    def on_key(self, event: dict[str, Any]) -> None:
        if event["key"] == "F11":
            self.screen.is_full_screen = not self.screen.is_full_screen
        elif event["key"] == "F12":
            self.screen.screenshot("orbit_viewer.png")

    def draw(self) -> None:
        camera, device = self.camera.update(), self.screen.device
        view = View(view_projection=camera.view_projection, eye=camera.position, height=self.screen.size[1])
        with self.targets.render_pass(clear=(0, 0, 0, 1)):
            device.draw(self.ball, self.sphere, COUNT, view=view, balls=self.balls)
            device.draw(self.sky, self.triangle, view=view)
        self.screen.show(self.targets.image)
        if self.screen.counter.frames == self.left:
            self.screen.canvas.close()
        elif self.left:
            self.screen.canvas.request_draw()


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--backend", help="gl, cl or wgpu (default: gl; in a page, web)")
    parser.add_argument("--canvas", choices=sorted(CANVASES), help="default: a window")
    parser.add_argument("--frames", type=int, default=0, help="how many; 0: until the window is closed")
    parser.add_argument("--immediate", action="store_true", help="don't wait for the display's refresh")
    options = parser.parse_args()
    try:
        with open_screen(
            options.backend, canvas=options.canvas, title="orbit", vsync=not options.immediate
        ) as screen:
            screen.run(Viewer(screen, options.frames).draw)
            print(f"{screen.counter.frames} frames, {screen.counter.describe()}")
    except rhi.DeviceError as error:
        sys.exit(f"{error.rule.sentence}: {error.given}; {error.tip}")


if __name__ == "__main__":
    main()
