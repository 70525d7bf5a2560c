"""A window with GLFW: a turning triangle, drawn by gl beside the window's context, or by cl and copied to it.

    pip install "rhi[viewer]"
    python examples/window.py [--backend cl] [--frames N] [--immediate]

Each frame is drawn in the size that the window has then, so no old picture is ever scaled. A minimised window draws
nothing and waits for events.
"""

from __future__ import annotations

import argparse
import sys
import time

import numpy as np

import rhi
from rhi.shading import Shader, Struct, Uniform, cos, sin, vec2, vec3, vec4


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


class Screen:
    """Shows pictures of any device in the window whose context is current."""

    def __init__(self, backend: str) -> None:
        self.shown = rhi.create_device("gl", context="current")
        self.device = self.shown if backend == "gl" else rhi.create_device(backend)

    def show(self, image: rhi.Texture) -> None:
        self.device.present(image)
        if self.device is not self.shown:
            with self.shown.texture(image.read(), image.format) as copy:
                self.shown.present(copy)

    def close(self) -> None:
        self.device.close()
        if self.device is not self.shown:
            self.shown.close()


def draw(device: rhi.Device, corners: rhi.Mesh, size: tuple[int, int], angle: float) -> rhi.Texture:
    """Draw a frame into a new texture; of a size that stays the driver gives the same memory again."""
    image = device.texture(size, rhi.Format.RGBA8, label="frame")
    turn = device.transient.uniform(Turn(angle=angle, aspect=size[0] / size[1]))
    with device.render_pass(image, clear=(0.1, 0.1, 0.15, 1.0)):
        device.draw(device.program(Turning), corners, turn=turn)
    return image


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--backend", default="gl", choices=("gl", "cl"))
    parser.add_argument("--frames", type=int, default=0, help="how many; 0: until the window is closed")
    parser.add_argument("--immediate", action="store_true", help="don't wait for the display's refresh")
    options = parser.parse_args()
    try:
        import glfw
    except ImportError:
        sys.exit('GLFW is missing: pip install "rhi[viewer]"')
    if not glfw.init():
        sys.exit("no window can be opened: is there a display? (DISPLAY, WAYLAND_DISPLAY)")
    window = glfw.create_window(480, 320, "rhi", None, None)
    if not window:
        sys.exit("no window with OpenGL can be opened: on Debian apt install libgl1-mesa-dri")
    glfw.make_context_current(window)
    glfw.swap_interval(0 if options.immediate else 1)
    screen = Screen(options.backend)
    rows = np.zeros(3, Corner.dtype)
    rows["position"] = [(0.0, 0.8), (-0.7, -0.4), (0.7, -0.4)]
    rows["color"] = np.eye(3)
    corners = screen.device.mesh(rows)
    begun, frames = time.perf_counter(), 0
    while not glfw.window_should_close(window) and (not options.frames or frames < options.frames):
        glfw.poll_events()
        if glfw.get_window_attrib(window, glfw.ICONIFIED) or not all(glfw.get_framebuffer_size(window)):
            glfw.wait_events_timeout(0.5)  # nothing is drawn
            continue
        size = glfw.get_framebuffer_size(window)
        glfw.make_context_current(window)
        image = draw(screen.device, corners, size, 0.02 * frames)
        screen.show(image)
        image.destroy()
        glfw.swap_buffers(window)
        frames += 1
    seconds = time.perf_counter() - begun
    print(f"{frames} frames, {frames / seconds:.1f} a second")
    screen.close()
    glfw.terminate()


if __name__ == "__main__":
    main()
