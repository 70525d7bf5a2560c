"""Spheres on a plane, found by sphere tracing in the fragment stage; no vertices at all."""

from __future__ import annotations

import rhi
import rhi.shading as sl
from rhi_screen import save_image


class View(sl.Struct):
    size: sl.vec2


@sl.function
def nearest(p: sl.vec3) -> float:
    """Return the distance from `p` to the nearest surface."""
    cell = sl.vec3(p.x - 3.0 * sl.floor(p.x / 3.0 + 0.5), p.y - 1.0, p.z - 3.0 * sl.floor(p.z / 3.0 + 0.5))
    return min(sl.length(cell) - 1.0, p.y)


@sl.function
def trace(origin: sl.vec3, direction: sl.vec3, farthest: float) -> float:
    """Return the distance along a ray to the first surface, or a number beyond `farthest`."""
    t = 0.02
    for _ in range(96):
        step = nearest(origin + direction * t)
        t += step
        if step < 0.001 or t > farthest:
            break
    return t


class Spheres(sl.FullScreen):
    """A shader of one ray for the eye and one for the shadow."""

    view: sl.Uniform[View]

    def fragment(self) -> sl.vec4:
        position = (sl.fragment_coordinate().xy - self.view.size * 0.5) / self.view.size.y
        eye = sl.vec3(0.0, 2.5, 6.0)
        direction = sl.normalize(sl.vec3(position.x, -position.y - 0.25, -1.0))
        sun = sl.normalize(sl.vec3(0.6, 0.9, 0.3))
        sky = sl.mix(sl.vec3(0.7, 0.75, 0.8), sl.vec3(0.2, 0.4, 0.7), sl.clamp(direction.y * 2.0, 0.0, 1.0))
        t = trace(eye, direction, 40.0)
        color = sky
        if t < 40.0:
            p = eye + direction * t
            e = 0.002
            normal = sl.normalize(
                sl.vec3(
                    nearest(p + sl.vec3(e, 0.0, 0.0)) - nearest(p - sl.vec3(e, 0.0, 0.0)),
                    nearest(p + sl.vec3(0.0, e, 0.0)) - nearest(p - sl.vec3(0.0, e, 0.0)),
                    nearest(p + sl.vec3(0.0, 0.0, e)) - nearest(p - sl.vec3(0.0, 0.0, e)),
                )
            )
            light = max(sl.dot(normal, sun), 0.0)
            if light > 0.0 and trace(p + normal * 0.02, sun, 12.0) < 12.0:
                light = 0.0
            tint = sl.vec3(0.85, 0.35, 0.2) if p.y > 0.01 else sl.vec3(0.5, 0.5, 0.45)
            color = sl.mix(sky, tint * (0.08 + 0.92 * light), sl.exp(-0.02 * t))
        return sl.vec4(color, 1.0)


def render(device: rhi.Device, size: tuple[int, int]) -> rhi.Texture:
    """Draw one triangle that covers the image."""
    image = device.texture(size, rhi.Format.RGBA8_SRGB)
    view = device.uniform(View(size=size))
    with device.render_pass(image):
        device.draw(device.program(Spheres), device.mesh(3), view=view)
    return image


if __name__ == "__main__":
    save_image(render)
