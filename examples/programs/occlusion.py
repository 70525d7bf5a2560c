"""Occlusion culling: the GPU counts the samples of 2,000 boxes, and draws the spheres in those that are
visible.

`draw_counted` asks about all boxes in one call, `draw_conditional` draws by the answers; the CPU never waits.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import rhi
from rhi import ColorWrite, CullMode, DepthWrite, Format
from rhi.math import look_at, make_cube, make_sphere, perspective
from rhi.shading import Shader, Storage, Struct, Uniform, dot, instance_index, mat4, normalize, vec3, vec4
from rhi_screen import save_image

COUNT = 2000


class Camera(Struct):
    view_projection: mat4


class Vertex(Struct):
    position: vec3


class Instance(Struct):
    center: vec3
    size: vec3
    color: vec3


class Surface(Struct):
    clip: vec4
    normal: vec3
    color: vec3


class InstancedShape(Shader):
    """Draws a shape at the place of its instance; a shape's positions are its normals."""

    camera: Uniform[Camera]
    instances: Storage[Instance]

    def vertex(self, v: Vertex) -> Surface:
        thing = self.instances[instance_index()]
        clip = self.camera.view_projection @ vec4(v.position * thing.size + thing.center, 1.0)
        return Surface(clip=clip, normal=v.position, color=thing.color)

    def fragment(self, s: Surface) -> vec4:
        light = 0.15 + 0.85 * max(dot(normalize(s.normal), normalize(vec3(0.5, 0.8, 0.6))), 0.0)
        return vec4(s.color * light, 1.0)


def make_instances() -> NDArray[np.void]:
    """Return a wall with a gap, as the first two rows, and spheres on both sides of it."""
    rng = np.random.default_rng(4)
    rows = np.zeros(COUNT + 2, Instance.dtype)
    rows["center"][:2], rows["size"][:2], rows["color"] = (
        [(-6, 2, 0), (6, 2, 0)],
        (5, 4, 0.3),
        (0.35, 0.32, 0.3),
    )
    rows["center"][2:] = rng.uniform((-12, -2, -22), (12, 6, 3), (COUNT, 3))
    rows["size"][2:] = rng.uniform(0.1, 0.3, (COUNT, 1))
    rows["color"][2:] = rng.uniform(0.1, 0.8, (COUNT, 3))
    return rows


def draw(device: rhi.Device, size: tuple[int, int]) -> tuple[rhi.Texture, rhi.QuerySet]:
    """Draw the wall, ask about the boxes, draw the spheres of visible boxes; return the image and the
    answers."""
    cube, _, _, cube_indices = make_cube()
    sphere, sphere_indices = make_sphere()
    boxes, spheres = (
        device.mesh({"position": cube}, cube_indices),
        device.mesh({"position": sphere}, sphere_indices),
    )
    camera = device.uniform(
        Camera(
            view_projection=perspective(np.radians(50), size[0] / size[1])
            @ look_at((0, 2.5, 11), (0, 1.5, 0))
        )
    )
    instances = device.storage(Instance, make_instances())
    program, queries = device.program(InstancedShape), device.query_set(COUNT)
    image, depth = device.texture(size, Format.RGBA8_SRGB), device.texture(size, Format.D32F)
    numbers = np.arange(2, COUNT + 2)  # instance i of a draw reads row i
    ask = boxes.draws(np.zeros(COUNT, int), len(cube_indices), base_instance=numbers)
    show = spheres.draws(np.zeros(COUNT, int), len(sphere_indices), base_instance=numbers)
    with device.render_pass(image, depth, clear=(0.4, 0.55, 0.75, 1), clear_depth=0.0):
        device.draw(program, boxes, 2, camera=camera, instances=instances)
        with device.states(
            ColorWrite.OFF, DepthWrite.OFF, CullMode.NONE
        ):  # a camera inside a box sees its back
            device.draw_counted(program, boxes, ask, queries, camera=camera, instances=instances)
        device.draw_conditional(program, spheres, show, queries, camera=camera, instances=instances)
    return image, queries


def render(device: rhi.Device, size: tuple[int, int]) -> rhi.Texture:
    """Draw the scene."""
    return draw(device, size)[0]


if __name__ == "__main__":
    save_image(render)
