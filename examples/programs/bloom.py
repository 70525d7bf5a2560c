"""Bloom: a bright pass into half floats, a separable Gaussian blur, and a sum with tone mapping; four passes."""

from __future__ import annotations

import rhi
import rhi.shading as sl
from rhi import Filter, Format, SamplerDescriptor, Wrap
from rhi.shading import (
    FullScreen,
    Struct,
    Texture2D,
    Uniform,
    cos,
    exp,
    fragment_coordinate,
    length,
    sin,
    vec2,
    vec3,
    vec4,
)
from rhi_screen import save_picture

RADIUS = 12


class Window(Struct):
    size: vec2


class Axis(Struct):
    step: vec2


class Lamps(FullScreen):
    """Small lamps on a spiral, up to 20 times as bright as white."""

    window: Uniform[Window]

    def fragment(self) -> vec4:
        place = (fragment_coordinate().xy - self.window.size * 0.5) / self.window.size.y
        color = vec3(0.01, 0.012, 0.02)
        for i in range(24):
            angle = float(i) * 0.8
            at = vec2(cos(angle), sin(angle)) * (0.05 + 0.017 * float(i))
            near = max(1.0 - length(place - at) * 90.0, 0.0)
            color += vec3(1.0 + sin(angle), 0.8, 1.2 + cos(angle)) * (near * 10.0)
        return vec4(color, 1.0)


class Bright(FullScreen):
    """A shader that keeps what is brighter than white."""

    source: Texture2D
    window: Uniform[Window]

    def fragment(self) -> vec4:
        return vec4(sl.max(self.source.sample(fragment_coordinate().xy / self.window.size).rgb - 1.0, vec3(0.0)), 1.0)


class Blur(FullScreen):
    """A Gaussian of 2 RADIUS + 1 taps along one axis."""

    source: Texture2D
    window: Uniform[Window]
    axis: Uniform[Axis]

    def fragment(self) -> vec4:
        place = fragment_coordinate().xy / self.window.size
        total = vec3(0.0)
        weights = 0.0
        for i in range(-RADIUS, RADIUS + 1):
            weight = exp(-4.0 * float(i * i) / float(RADIUS * RADIUS))
            total += self.source.sample_lod(place + self.axis.step * float(i), 0.0).rgb * weight
            weights += weight
        return vec4(total / weights, 1.0)


class Composite(FullScreen):
    """The picture and its glow."""

    source: Texture2D
    glow: Texture2D
    window: Uniform[Window]

    def fragment(self) -> vec4:
        place = fragment_coordinate().xy / self.window.size
        light = self.source.sample(place).rgb + self.glow.sample(place).rgb * 1.5
        return vec4(1.0 - exp(-light), 1.0)


def render(device: rhi.Device, size: tuple[int, int]) -> rhi.Texture:
    """Draw the lamps, then what glows, at half the size."""
    half = (size[0] // 2, size[1] // 2)
    scene = device.texture(size, Format.RGBA16F)
    a, b = device.texture(half, Format.RGBA16F), device.texture(half, Format.RGBA16F)
    image = device.texture(size, Format.RGBA8_SRGB)
    window, small = device.uniform(Window(size=size)), device.uniform(Window(size=half))
    across, down = device.uniform(Axis(step=(1 / half[0], 0))), device.uniform(Axis(step=(0, 1 / half[1])))
    clamped = SamplerDescriptor(Filter.LINEAR, Filter.LINEAR, None, Wrap.CLAMP, Wrap.CLAMP)
    screen = device.mesh(3)
    blur = device.program(Blur)
    with device.render_pass(scene):
        device.draw(device.program(Lamps), screen, window=window)
    with device.render_pass(a):
        device.draw(device.program(Bright), screen, source=scene.sampled(clamped), window=small)
    for source, target, axis in ((a, b, across), (b, a, down)):
        with device.render_pass(target):
            device.draw(blur, screen, source=source.sampled(clamped), window=small, axis=axis)
    with device.render_pass(image):
        device.draw(
            device.program(Composite), screen, source=scene.sampled(clamped), glow=a.sampled(clamped), window=window
        )
    return image


if __name__ == "__main__":
    save_picture(render)
