"""Boids with a panel: a flock that a compute shader moves, drawn as one instanced draw, and sliders that
steer it.

    python examples/programs/boids.py                  a window: drag, scroll, and move the sliders
    python examples/programs/boids.py --output a.png   an image

It needs `pip install "rhi[viewer]"`.
"""

from __future__ import annotations

import sys

import numpy as np
from imgui_bundle import imgui

import rhi
import rhi.shading as sl
from rhi import Format
from rhi.shading import Shader, Storage, StorageRW, Struct, Uniform, mat4, vec3, vec4
from rhi_screen import FixedSteps, OrbitCamera, Screen, open_screen, save_image
from rhi_screen.imgui import ImGui

COUNT, GROUP = 1024, 64


class Boid(Struct):
    position: vec3
    velocity: vec3


class Rules(Struct):
    cohesion: float
    alignment: float
    separation: float
    reach: float
    seconds: float


class Flock(Shader):
    """A shader of one step: each boid looks at all others, and turns back at the edge of a sphere."""

    work_group = (GROUP,)
    rules: Uniform[Rules]
    now: Storage[Boid]
    then: StorageRW[Boid]

    def compute(self) -> None:
        boid = self.now[sl.global_id().x]
        middle, heading, away = vec3(0.0), vec3(0.0), vec3(0.0)
        near = 0.0
        for i in range(COUNT):
            other = self.now[i]
            gap = other.position - boid.position
            far = sl.length(gap)
            if far < self.rules.reach and far > 0.0:
                near += 1.0
                middle += gap
                heading += other.velocity - boid.velocity
                away -= gap / (far * far)
        home = 0.3 if sl.length(boid.position) > 3.0 else 0.0
        push = self.rules.separation * away * 0.02 - boid.position * home
        if near > 0.0:
            push += (self.rules.cohesion * middle + self.rules.alignment * heading) / near
        velocity = boid.velocity + push * self.rules.seconds * 4.0
        velocity = sl.normalize(velocity) * min(max(sl.length(velocity), 0.6), 1.6)
        position = boid.position + velocity * self.rules.seconds
        self.then[sl.global_id().x] = Boid(position=position, velocity=velocity)


class View(Struct):
    view_projection: mat4


class Corner(Struct):
    position: vec3


class DartVarying(Struct):
    clip: vec4
    color: vec3


class Darts(Shader):
    """Draws each boid as a dart along its velocity, colored by where it flies."""

    view: Uniform[View]
    flock: Storage[Boid]

    def vertex(self, v: Corner) -> DartVarying:
        boid = self.flock[sl.instance_index()]
        ahead = sl.normalize(boid.velocity)
        side = sl.normalize(sl.cross(ahead, vec3(0.03, 1.0, 0.01)))
        position = (
            boid.position
            + (side * v.position.x + sl.cross(side, ahead) * v.position.y + ahead * v.position.z) * 0.06
        )
        return DartVarying(clip=self.view.view_projection @ vec4(position, 1.0), color=ahead * 0.4 + 0.5)

    def fragment(self, s: DartVarying) -> vec4:
        return vec4(s.color, 1.0)


class Demo:
    def __init__(self, screen: Screen) -> None:
        device, rng = screen.device, np.random.default_rng(2)
        self.screen, self.gui, self.camera = screen, ImGui(screen), OrbitCamera(screen, distance=8.0)
        self.targets, self.steps = screen.targets(Format.RGBA8_SRGB, Format.D32F, samples=4), FixedSteps(60)
        rows = np.zeros(COUNT, Boid.dtype)
        rows["position"], rows["velocity"] = rng.normal(size=(2, COUNT, 3))
        self.flocks = [device.storage(Boid, rows), device.storage(Boid, COUNT)]
        self.move, self.show = device.program(Flock), device.program(Darts)
        self.rules = {"cohesion": 0.4, "alignment": 0.6, "separation": 1.0, "reach": 0.7}
        corners = np.array([(0, 0, 2), (-0.6, 0, -1), (0.6, 0, -1), (0, 0.5, -1)], np.float32)
        triangles = np.array([0, 2, 1, 0, 3, 2, 0, 1, 3, 1, 2, 3], np.uint16)
        self.dart = device.mesh({"position": corners}, triangles)

    def draw(self, seconds: float | None = None) -> None:
        device = self.screen.device
        for _ in self.steps.advance(seconds):
            rules = Rules(**self.rules, seconds=self.steps.seconds)
            device.dispatch(self.move, COUNT // GROUP, rules=rules, now=self.flocks[0], then=self.flocks[1])
            self.flocks.reverse()
        view = View(view_projection=self.camera.update().view_projection)
        with self.targets.render_pass((0.01, 0.015, 0.03, 1)):
            device.draw(self.show, self.dart, COUNT, view=view, flock=self.flocks[0])
        with self.gui.frame(self.targets.image):
            imgui.set_next_window_pos(imgui.ImVec2(8, 8), imgui.Cond_.once)
            imgui.begin("flock", None, imgui.WindowFlags_.always_auto_resize)
            for name, value in self.rules.items():
                imgui.set_next_item_width(90)
                self.rules[name] = imgui.slider_float(name, value, 0.0, 2.0)[1]
            imgui.end()
        self.screen.show(self.targets.image)


def render(device: rhi.Device, size: tuple[int, int], frames: int = 30) -> rhi.Texture:
    """Draw half a second, and return a copy of the last frame."""
    with open_screen(device, canvas="offscreen", size=size) as screen:
        demo = Demo(screen)
        screen.canvas.request_draw(lambda: demo.draw(1 / 60))
        for _ in range(frames):
            screen.canvas.draw()
        return device.texture(demo.targets.image.read(), Format.RGBA8_SRGB)


if __name__ == "__main__":
    if "--output" in sys.argv:
        save_image(render)
    else:
        with open_screen(title="boids", update_mode="continuous") as window:
            window.run(Demo(window).draw)
