"""Ten thousand crates in one draw: a second vertex stream holds what differs from crate to crate."""

from __future__ import annotations

import numpy as np

import rhi
from rhi.math import look_at, make_cube, perspective
from rhi.shading import Shader, Struct, Uniform, cos, dot, exp, length, mat4, mix, normalize, sin, vec3, vec4
from rhi_screen import save_image


class Vertex(Struct):
    position: vec3
    normal: vec3
    offset: vec3
    angle: float
    color: vec4


class Surface(Struct):
    clip: vec4
    normal: vec3
    color: vec3
    view: vec3


class Camera(Struct):
    view_projection: mat4
    eye: vec3


class Crates(Shader):
    """Turns each crate about its vertical axis and moves it to its place."""

    camera: Uniform[Camera]

    def vertex(self, v: Vertex) -> Surface:
        c = cos(v.angle)
        s = sin(v.angle)
        p = v.position * 0.3
        n = v.normal
        offset = vec3(c * p.x + s * p.z, p.y, c * p.z - s * p.x) + v.offset
        return Surface(
            clip=self.camera.view_projection @ vec4(offset, 1.0),
            normal=vec3(c * n.x + s * n.z, n.y, c * n.z - s * n.x),
            color=v.color.rgb,
            view=offset - self.camera.eye,
        )

    def fragment(self, s: Surface) -> vec4:
        light = 0.1 + 0.8 * max(dot(normalize(s.normal), normalize(vec3(0.4, 1.0, 0.6))), 0.0)
        return vec4(mix(vec3(0.5, 0.6, 0.7), s.color * light, exp(-0.006 * length(s.view))), 1.0)


def make_instances(side: int = 100) -> dict[str, np.ndarray]:
    """Return arrays of side² crates: places, turns in radians, and colors as normalised bytes."""
    rng = np.random.default_rng(4)
    x, z = np.mgrid[0:side, 0:side] - side / 2
    height = 1.5 * np.sin(x * 0.21) * np.cos(z * 0.17)
    return {
        "offset": np.stack([x, height, z], axis=-1).reshape(-1, 3).astype(np.float32),
        "angle": rng.uniform(0, 2 * np.pi, side * side).astype(np.float32),
        "color": rng.integers(10, 200, (side * side, 4), dtype=np.uint8),
    }


def render(device: rhi.Device, size: tuple[int, int]) -> rhi.Texture:
    """Draw the crates."""
    positions, normals, _, indices = make_cube()
    instances = make_instances()
    mesh = device.mesh({"position": positions, "normal": normals}, indices, instances=instances)
    eye = (20.0, 9.0, 30.0)
    view_projection = perspective(np.radians(50), size[0] / size[1]) @ look_at(eye, (0, -2, 0))
    camera = device.uniform(Camera(view_projection=view_projection, eye=eye))
    image = device.texture(size, rhi.Format.RGBA8_SRGB)
    depth = device.texture(size, rhi.Format.D32F)
    with device.render_pass(image, depth, clear=(0.5, 0.6, 0.7, 1), clear_depth=0.0):
        device.draw(device.program(Crates), mesh, len(instances["offset"]), camera=camera)
    return image


if __name__ == "__main__":
    save_image(render)
