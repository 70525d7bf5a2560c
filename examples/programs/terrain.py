"""A landscape from a texture of heights: the vertex stage reads it, and no vertices are stored."""

from __future__ import annotations

import numpy as np

import rhi
import rhi.shading as sl
from rhi.math import look_at, perspective
from rhi_screen import save_image

GRID = 256


class Camera(sl.Struct):
    view_projection: sl.mat4
    eye: sl.vec3


class Ground(sl.Struct):
    clip: sl.vec4
    normal: sl.vec3
    position: sl.vec3


class Terrain(sl.Shader):
    """A grid of GRID² points; grass, rock and snow by height and slope."""

    camera: sl.Uniform[Camera]
    heights: sl.Texture2D

    def vertex(self) -> Ground:
        at = sl.ivec2(sl.vertex_index() % GRID, sl.vertex_index() // GRID)
        east = self.heights.load(sl.ivec2(min(at.x + 1, GRID - 1), at.y)).x
        west = self.heights.load(sl.ivec2(max(at.x - 1, 0), at.y)).x
        south = self.heights.load(sl.ivec2(at.x, min(at.y + 1, GRID - 1))).x
        north = self.heights.load(sl.ivec2(at.x, max(at.y - 1, 0))).x
        position = sl.vec3(float(at.x) - GRID / 2, self.heights.load(at).x, float(at.y) - GRID / 2)
        normal = sl.normalize(sl.vec3(west - east, 2.0, north - south))
        return Ground(
            clip=self.camera.view_projection @ sl.vec4(position, 1.0), normal=normal, position=position
        )

    def fragment(self, g: Ground) -> sl.vec4:
        normal = sl.normalize(g.normal)
        color = sl.mix(
            sl.vec3(0.15, 0.3, 0.08), sl.vec3(0.35, 0.3, 0.25), sl.smoothstep(0.1, 0.35, 1.0 - normal.y)
        )
        color = sl.mix(color, sl.vec3(0.9), sl.smoothstep(16.0, 20.0, g.position.y))
        light = 0.2 + 0.8 * max(sl.dot(normal, sl.normalize(sl.vec3(0.7, 0.6, 0.2))), 0.0)
        return sl.vec4(
            sl.mix(
                sl.vec3(0.55, 0.65, 0.8),
                color * light,
                sl.exp(-0.0016 * sl.length(g.position - self.camera.eye)),
            ),
            1.0,
        )


def make_heights() -> np.ndarray:
    """Return (GRID, GRID) float32 heights from -8 to 30: noise of six octaves with the spectrum of hills."""
    rng = np.random.default_rng(12)
    frequency = np.hypot(np.fft.fftfreq(GRID)[:, None], np.fft.fftfreq(GRID)[None, :]) + 1 / GRID
    spectrum = np.fft.fft2(rng.normal(size=(GRID, GRID))) / frequency**2.2
    spectrum[0, 0] = 0
    noise = np.fft.ifft2(spectrum).real
    heights: np.ndarray = (11 + noise / np.abs(noise).max() * 19).astype(np.float32)
    return heights


def make_strips() -> np.ndarray:
    """Return uint32 indices of one triangle strip per row of the grid, restarted by the largest index."""
    rows = np.arange(GRID - 1)[:, None] * GRID + np.arange(GRID)
    strips = np.stack([rows, rows + GRID], axis=-1).reshape(GRID - 1, -1)
    restart = np.full((GRID - 1, 1), 0xFFFFFFFF)
    return np.hstack([strips, restart]).ravel()[:-1].astype(np.uint32)


def render(device: rhi.Device, size: tuple[int, int]) -> rhi.Texture:
    """Draw the grid as strips."""
    heights = device.texture(make_heights(), rhi.Format.R32F)
    mesh = device.mesh(GRID * GRID, make_strips(), primitive=rhi.Primitive.TRIANGLE_STRIP)
    eye = (0.0, 42.0, 120.0)
    view_projection = perspective(np.radians(50), size[0] / size[1]) @ look_at(eye, (0, 5, 0))
    camera = device.uniform(Camera(view_projection=view_projection, eye=eye))
    image = device.texture(size, rhi.Format.RGBA8_SRGB)
    depth = device.texture(size, rhi.Format.D32F)
    with device.render_pass(image, depth, clear=(0.55, 0.65, 0.8, 1), clear_depth=0.0):
        device.draw(device.program(Terrain), mesh, camera=camera, heights=heights)
    return image


if __name__ == "__main__":
    save_image(render)
