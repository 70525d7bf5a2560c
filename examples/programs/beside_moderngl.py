"""A device beside a moderngl engine: it reads the engine's texture, and shows its image in the engine's
framebuffer.

The engine has a context of its own, as with moderngl-window, pyglet or Qt, and draws discs. On `gl` the
device shares its textures both ways, and neither sees the other's states. On other backends the same image
takes two copies.
"""

from __future__ import annotations

from typing import Any

import moderngl
import numpy as np

import rhi
from rhi.shading import FullScreen, Texture2D, fragment_coordinate, length, vec2, vec4
from rhi_screen import save_image

EGL: dict[str, Any] = {"backend": "egl", "libgl": "libEGL.so.1", "libegl": "libEGL.so.1"}
DISC = """
#version 330
in vec4 disc; in vec3 tint; out vec3 color; out vec2 corner;
void main() {
    corner = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0 - 1.0;
    color = tint;
    gl_Position = vec4(disc.xy + corner * disc.zw, 0.0, 1.0);
}
"""
DISC_FRAGMENT = """
#version 330
in vec3 color; in vec2 corner; out vec4 light;
void main() { light = vec4(color * max(1.0 - dot(corner, corner), 0.0), 1.0); }
"""


class Engine:
    """Draws with moderngl, and knows nothing of rhi."""

    def __init__(self, size: tuple[int, int]) -> None:
        self.context = moderngl.create_context(330, standalone=True, **EGL)
        self.texture = self.context.texture(size, 4)
        self.target = self.context.framebuffer([self.texture])
        self.screen = self.context.simple_framebuffer(size)  # with a window: its own
        self.program = self.context.program(DISC, DISC_FRAGMENT)
        rng = np.random.default_rng(3)
        radius = rng.uniform(0.05, 0.3, (60, 1)) * (size[1] / size[0], 1)
        rows = np.hstack([rng.uniform(-1, 1, (60, 2)), radius, rng.uniform(0, 0.9, (60, 3))])
        discs = self.context.buffer(rows.astype("f4").tobytes())
        self.discs = self.context.vertex_array(self.program, [(discs, "4f 3f /i", "disc", "tint")])

    def draw(self) -> None:
        """Add up the discs in the texture."""
        self.context.enable(moderngl.BLEND)
        self.context.blend_func = moderngl.ONE, moderngl.ONE
        self.target.use()
        self.target.clear(0.02, 0.02, 0.05, 1.0)
        self.discs.render(moderngl.TRIANGLE_STRIP, vertices=4, instances=60)
        self.screen.use()
        self.context.finish()

    def read(self, what: moderngl.Texture | moderngl.Framebuffer) -> np.ndarray:
        """Return texels, their first row first."""
        size = what.size
        data = what.read() if isinstance(what, moderngl.Texture) else what.read(components=4)
        return np.frombuffer(data, np.uint8).reshape(size[1], size[0], 4)


class Magnifier(FullScreen):
    """Enlarges the middle of an image, and darkens its corners."""

    source: Texture2D

    def fragment(self) -> vec4:
        size = vec2(self.source.size())
        uv = fragment_coordinate().xy / size
        away = uv - 0.5
        far = length(away * vec2(size.x / size.y, 1.0))
        enlarged = min(0.55 + 2.0 * far * far, 1.0)
        color = self.source.sample(0.5 + away * enlarged).rgb
        return vec4(color * (1.0 - 0.8 * far * far), 1.0)


def magnify(device: rhi.Device, source: rhi.Texture) -> rhi.Texture:
    """Draw an image through the projection."""
    image = device.texture(source.size, rhi.Format.RGBA8)
    with device.render_pass(image):
        device.draw(device.program(Magnifier), device.mesh(3), source=source)
    return image


def render(device: rhi.Device, size: tuple[int, int]) -> rhi.Texture:
    """Draw the engine's image through the projection: beside its context on gl, with copies elsewhere."""
    engine = Engine(size)
    engine.draw()
    if device.backend_name == "gl":
        with rhi.create_device("gl", context=engine.context) as beside:
            beside.present(magnify(beside, beside.adopt_texture(engine.texture)))
        pixels = engine.read(engine.screen)[::-1]  # OpenGL's first row is the lowest
        image = device.texture(np.ascontiguousarray(pixels), rhi.Format.RGBA8)
    else:
        image = magnify(device, device.texture(engine.read(engine.texture), rhi.Format.RGBA8))
    engine.context.release()
    return image


if __name__ == "__main__":
    save_image(render)
