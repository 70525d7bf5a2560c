"""Bloom: a bright pass into half floats, a separable Gaussian blur, and a sum with tone mapping; four
passes."""

from __future__ import annotations

import rhi
import rhi.shading as sl
from rhi import Filter, Format, SamplerDescriptor, Wrap
from rhi_screen import save_image

RADIUS = 12


class Window(sl.Struct):
    size: sl.vec2


class Axis(sl.Struct):
    step: sl.vec2


class Lights(sl.FullScreen):
    """Small lights on a spiral, up to 20 times as bright as white."""

    window: sl.Uniform[Window]

    def fragment(self) -> sl.vec4:
        position = (sl.fragment_coordinate().xy - self.window.size * 0.5) / self.window.size.y
        color = sl.vec3(0.01, 0.012, 0.02)
        for i in range(24):
            angle = float(i) * 0.8
            at = sl.vec2(sl.cos(angle), sl.sin(angle)) * (0.05 + 0.017 * float(i))
            near = max(1.0 - sl.length(position - at) * 90.0, 0.0)
            color += sl.vec3(1.0 + sl.sin(angle), 0.8, 1.2 + sl.cos(angle)) * (near * 10.0)
        return sl.vec4(color, 1.0)


class Bright(sl.FullScreen):
    """A shader that keeps what is brighter than white."""

    source: sl.Texture2D
    window: sl.Uniform[Window]

    def fragment(self) -> sl.vec4:
        return sl.vec4(
            sl.max(
                self.source.sample(sl.fragment_coordinate().xy / self.window.size).rgb - 1.0, sl.vec3(0.0)
            ),
            1.0,
        )


class Blur(sl.FullScreen):
    """A Gaussian of 2 RADIUS + 1 taps along one axis."""

    source: sl.Texture2D
    window: sl.Uniform[Window]
    axis: sl.Uniform[Axis]

    def fragment(self) -> sl.vec4:
        uv = sl.fragment_coordinate().xy / self.window.size
        total = sl.vec3(0.0)
        weights = 0.0
        for i in range(-RADIUS, RADIUS + 1):
            weight = sl.exp(-4.0 * float(i * i) / float(RADIUS * RADIUS))
            total += self.source.sample_lod(uv + self.axis.step * float(i), 0.0).rgb * weight
            weights += weight
        return sl.vec4(total / weights, 1.0)


class Composite(sl.FullScreen):
    """The image and its bloom."""

    source: sl.Texture2D
    bloom: sl.Texture2D
    window: sl.Uniform[Window]

    def fragment(self) -> sl.vec4:
        uv = sl.fragment_coordinate().xy / self.window.size
        light = self.source.sample(uv).rgb + self.bloom.sample(uv).rgb * 1.5
        return sl.vec4(1.0 - sl.exp(-light), 1.0)


def render(device: rhi.Device, size: tuple[int, int]) -> rhi.Texture:
    """Draw the lights, then what shines, at half the size."""
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
        device.draw(device.program(Lights), screen, window=window)
    with device.render_pass(a):
        device.draw(device.program(Bright), screen, source=scene.sampled(clamped), window=small)
    for source, target, axis in ((a, b, across), (b, a, down)):
        with device.render_pass(target):
            device.draw(blur, screen, source=source.sampled(clamped), window=small, axis=axis)
    with device.render_pass(image):
        device.draw(
            device.program(Composite),
            screen,
            source=scene.sampled(clamped),
            bloom=a.sampled(clamped),
            window=window,
        )
    return image


if __name__ == "__main__":
    save_image(render)
