"""Shared parts of this folder's programs: a command line that saves a picture, vertex stages, cameras, and a cube.

Each program is one file with one function, `render(device, size)`, which returns the texture it has drawn.

    python examples/programs/terrain.py --backend cl --size 640x480 --output terrain.png
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

import rhi
from rhi.shading import Shader, Struct, Uniform, mat4, vec2, vec3, vec4, vertex_index


class Vertex(Struct):
    """A corner with a normal."""

    position: vec3
    normal: vec3


class Camera(Struct):
    """A matrix from world to clip space."""

    view_projection: mat4


class Screen(Shader):
    """A triangle that covers the target: draw it with `device.mesh(3)`."""

    def vertex(self) -> vec4:
        corner = vec2(float(vertex_index() & 1), float(vertex_index() >> 1))
        return vec4(corner * 4.0 - 1.0, 0.5, 1.0)


class FlatVertex(Struct):
    """A corner in the plane, with a place in an atlas and a color."""

    position: vec2
    uv: vec2
    color: vec4


class Colored(Struct):
    """The varyings between such corners."""

    clip: vec4
    uv: vec2
    color: vec4


class Pixels(Struct):
    """The size of the target."""

    size: vec2


class Interface(Shader):
    """The vertex stage of user interfaces: positions are in pixels, from the top left corner."""

    screen: Uniform[Pixels]

    def vertex(self, v: FlatVertex) -> Colored:
        place = v.position / self.screen.size
        return Colored(clip=vec4(place.x * 2.0 - 1.0, 1.0 - place.y * 2.0, 0.5, 1.0), uv=v.uv, color=v.color)


INTERFACE_VERTEX = np.dtype([("position", "f4", 2), ("uv", "f4", 2), ("color", "u1", 4)])  # as ImDrawVert: 20 bytes


def main(render: Callable[[rhi.Device, tuple[int, int]], rhi.Texture]) -> None:
    """Render one picture and save it; the program's module docstring is the help text."""
    program = Path(sys.argv[0])
    parser = argparse.ArgumentParser(description=sys.modules["__main__"].__doc__)
    parser.add_argument("--backend", help="gl, cl or the name of another backend (default: the first that draws)")
    parser.add_argument("--size", default="640x480", metavar="WxH", help="pixels (default: 640x480)")
    parser.add_argument("--output", type=Path, default=Path(f"{program.stem}.png"), help="default: %(default)s")
    given = parser.parse_args()
    width, _, height = given.size.partition("x")
    with rhi.create_device(given.backend) as device:
        pixels = render(device, (int(width), int(height))).read()
    from PIL import Image

    Image.fromarray(pixels[..., :3]).save(given.output)
    print(given.output)


def look_at(eye: ArrayLike, target: ArrayLike, up: ArrayLike = (0, 1, 0)) -> NDArray[np.float64]:
    """Return the (4, 4) view matrix of a camera at `eye` that looks at `target`."""
    back = np.subtract(eye, target) / np.linalg.norm(np.subtract(eye, target))
    right = np.cross(np.asarray(up, float), back)
    right /= np.linalg.norm(right)
    view = np.eye(4)
    view[:3, :3] = right, np.cross(back, right), back
    view[:3, 3] = -view[:3, :3] @ np.asarray(eye, float)
    return view


def perspective(fov: float, aspect: float, near: float = 0.1) -> NDArray[np.float64]:
    """Return a (4, 4) projection with reversed depth: 1 at `near`, 0 at infinity. `fov` is vertical, in degrees."""
    f = 1 / np.tan(np.radians(fov) / 2)
    return np.array([(f / aspect, 0, 0, 0), (0, f, 0, 0), (0, 0, 0, near), (0, 0, -1, 0)], float)


def make_cube() -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32], NDArray[np.uint16]]:
    """Return (24, 3) positions from -1 to 1, (24, 3) normals, (24, 2) uvs and 36 indices, counter-clockwise outside."""
    positions, normals = np.zeros((24, 3), np.float32), np.zeros((24, 3), np.float32)
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)], np.float32)
    for face in range(6):
        axis, sign = face // 2, 1 if face % 2 else -1
        rows = slice(face * 4, face * 4 + 4)
        normals[rows, axis] = positions[rows, axis] = sign
        positions[rows, (axis + 1) % 3] = corners[:, 0] * sign
        positions[rows, (axis + 2) % 3] = corners[:, 1]
    uvs = np.tile((corners + 1) / 2, (6, 1)).astype(np.float32)
    indices = (np.arange(6)[:, None] * 4 + (0, 1, 2, 0, 2, 3)).ravel().astype(np.uint16)
    return positions, normals, uvs, indices
