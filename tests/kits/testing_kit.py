"""A small frame to assert on: a shadow pass inside "sun", then a lit one."""

from __future__ import annotations

from functools import cache

import numpy as np

import rhi
from rhi import CullMode, DepthBias, DepthFunction, Format
from rhi.shading import Shader, Struct, Uniform, vec2, vec4


def gl_works() -> bool:
    """Return whether a GL device can be created on this machine."""
    return backend_works("gl")


@cache
def backend_works(name: str) -> bool:
    """Return whether a device of a backend can be created on this machine."""
    try:
        rhi.create_device(name).close()
    except rhi.DeviceError:
        return False
    return True


class Corner(Struct):
    position: vec2


class Light(Struct):
    offset: vec4


class Tint(Struct):
    color: vec4


class Shadow(Shader):
    light: Uniform[Light]

    def vertex(self, v: Corner) -> vec4:
        return vec4(v.position, 0.5, 1.0) + self.light.offset


class Lit(Shader):
    light: Uniform[Light]
    tint: Uniform[Tint]

    def vertex(self, v: Corner) -> vec4:
        return vec4(v.position, 0.5, 1.0) + self.light.offset

    def fragment(self) -> vec4:
        return self.tint.color


class SampleFrame:
    """The resources of a frame, and the frame itself."""

    def __init__(self, device: rhi.Device) -> None:
        self.device = device
        self.shadow = device.program(Shadow)
        self.lit = device.program(Lit)
        corners = np.zeros(3, Corner.dtype)
        corners["position"] = [[-1, -1], [1, -1], [0, 1]]
        self.walls = device.mesh(corners, label="walls")
        self.roof = device.mesh(corners[::-1].copy(), label="roof")
        self.map = device.texture((32, 32), Format.D32F, label="shadow map")
        self.image = device.texture((64, 48), Format.RGBA8, label="image")
        self.depth = device.texture((64, 48), Format.D32F)
        self.light = device.uniform(Light(offset=(0, 0, 0, 0)), label="light")
        self.tint = device.uniform(Tint(color=(1, 0.5, 0, 1)), label="tint")

    def render(self) -> None:
        device = self.device
        with (
            device.event("sun"),
            device.render_pass(depth=self.map, clear_depth=0),
            device.states(CullMode.FRONT, DepthBias(-2.0)),
        ):
            with device.event("casters"):
                device.draw(self.shadow, self.walls, light=self.light)
                device.draw(self.shadow, self.roof, light=self.light)
        with (
            device.event("view"),
            device.render_pass(self.image, self.depth, clear=(0, 0, 0, 1), clear_depth=0),
            device.states(DepthFunction.GREATER_EQUAL),
        ):
            device.draw(self.lit, self.walls, 4, light=self.light, tint=self.tint)
        device.present(self.image)
