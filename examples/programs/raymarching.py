"""Spheres on a plane, found by sphere tracing in the fragment stage; no vertices at all."""

from __future__ import annotations

import rhi
from rhi.shading import (
    FullScreen,
    Struct,
    Uniform,
    clamp,
    dot,
    exp,
    floor,
    fragment_coordinate,
    function,
    length,
    mix,
    normalize,
    vec2,
    vec3,
    vec4,
)
from rhi_screen import save_picture


class View(Struct):
    size: vec2


@function
def nearest(p: vec3) -> float:
    """Return the distance from `p` to the nearest surface."""
    cell = vec3(p.x - 3.0 * floor(p.x / 3.0 + 0.5), p.y - 1.0, p.z - 3.0 * floor(p.z / 3.0 + 0.5))
    return min(length(cell) - 1.0, p.y)


@function
def trace(origin: vec3, direction: vec3, farthest: float) -> float:
    """Return the distance along a ray to the first surface, or a number beyond `farthest`."""
    t = 0.02
    for _ in range(96):
        step = nearest(origin + direction * t)
        t += step
        if step < 0.001 or t > farthest:
            break
    return t


class Spheres(FullScreen):
    """A shader of one ray for the eye and one for the shadow."""

    view: Uniform[View]

    def fragment(self) -> vec4:
        place = (fragment_coordinate().xy - self.view.size * 0.5) / self.view.size.y
        eye = vec3(0.0, 2.5, 6.0)
        direction = normalize(vec3(place.x, -place.y - 0.25, -1.0))
        sun = normalize(vec3(0.6, 0.9, 0.3))
        sky = mix(vec3(0.7, 0.75, 0.8), vec3(0.2, 0.4, 0.7), clamp(direction.y * 2.0, 0.0, 1.0))
        t = trace(eye, direction, 40.0)
        color = sky
        if t < 40.0:
            p = eye + direction * t
            e = 0.002
            normal = normalize(vec3(
                nearest(p + vec3(e, 0.0, 0.0)) - nearest(p - vec3(e, 0.0, 0.0)),
                nearest(p + vec3(0.0, e, 0.0)) - nearest(p - vec3(0.0, e, 0.0)),
                nearest(p + vec3(0.0, 0.0, e)) - nearest(p - vec3(0.0, 0.0, e)),
            ))  # fmt: skip
            light = max(dot(normal, sun), 0.0)
            if light > 0.0 and trace(p + normal * 0.02, sun, 12.0) < 12.0:
                light = 0.0
            tint = vec3(0.85, 0.35, 0.2) if p.y > 0.01 else vec3(0.5, 0.5, 0.45)
            color = mix(sky, tint * (0.08 + 0.92 * light), exp(-0.02 * t))
        return vec4(color, 1.0)


def render(device: rhi.Device, size: tuple[int, int]) -> rhi.Texture:
    """Draw one triangle that covers the image."""
    image = device.texture(size, rhi.Format.RGBA8_SRGB)
    view = device.uniform(View(size=size))
    with device.render_pass(image):
        device.draw(device.program(Spheres), device.mesh(3), view=view)
    return image


if __name__ == "__main__":
    save_picture(render)
