"""The scene of the benchmarks of commands: many triangles, each drawn with constants of its own, so that a
draw is two commands (bind_uniform, draw)."""

from __future__ import annotations

import numpy as np

import rhi
from rhi.shading import Shader, Struct, Uniform, vec2, vec4


class Corner(Struct):
    position: vec2


class Object(Struct):
    offset: vec4


class Flat(Shader):
    object: Uniform[Object]

    def vertex(self, v: Corner) -> vec4:
        return vec4(v.position, 0.5, 1.0) + self.object.offset

    def fragment(self) -> vec4:
        return vec4(1.0, 1.0, 1.0, 1.0)


class Scene:
    """The resources on a device for a pass with a given number of draws."""

    def __init__(self, device: rhi.Device, draws: int, size: int = 64, scale: float = 1.0) -> None:
        """Create the resources. With a `scale` of 0 the triangles have no area, and none is rasterised."""
        self.device = device
        self.program = device.program(Flat)
        corners = np.array([[-1, -1], [1, -1], [0, 1]], np.float32) * scale
        self.mesh = device.mesh({"position": corners})
        self.image = device.texture((size, size), rhi.Format.RGBA8, label="image")
        self.objects = device.uniform_array(Object, draws, label="objects")
        self.ranges = [self.objects[i] for i in range(draws)]
        device.finish()

    def draw(self, encoder: rhi.Encoder) -> None:
        """Draw or record the pass."""
        draw, program, mesh = encoder.draw, self.program, self.mesh
        with encoder.render_pass(self.image, clear=(0, 0, 0, 1)):
            for constants in self.ranges:
                draw(program, mesh, object=constants)

    def draw_transient(self, encoder: rhi.Encoder) -> None:
        """Draw or record the pass with its constants in transient memory."""
        value = Object(offset=(0, 0, 0, 0))
        with encoder.render_pass(self.image, clear=(0, 0, 0, 1)):
            for _ in self.ranges:
                encoder.draw(self.program, self.mesh, object=encoder.transient.uniform(value))

    def present(self) -> None:
        """Present the frame and wait until its work is done."""
        self.device.present(self.image)
        self.device.finish()
