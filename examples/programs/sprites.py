"""A sprite batch: 3,000 rotated sprites of one atlas, drawn by immediate mode in one upload and one draw.

`Batch.add` takes arrays of sprites. What is added between `begin` and `end` is sorted by layer and drawn as
quads.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

import rhi
from rhi import BlendFunction, CullMode, Filter, Primitive, SamplerDescriptor
from rhi.shading import Shader, Struct, Texture2D, vec2, vec4
from rhi_screen import save_image

SPRITE = np.dtype(
    [
        ("center", "f4", 2),
        ("size", "f4"),
        ("angle", "f4"),
        ("cell", "i4"),
        ("layer", "i4"),
        ("color", "f4", 4),
    ]
)
CELLS = 4  # sprites side by side in the atlas


class Corner(Struct):
    position: vec2
    uv: vec2
    color: vec4


class Colored(Struct):
    clip: vec4
    uv: vec2
    color: vec4


class Sprites(Shader):
    """A piece of the atlas, times a color; alpha is premultiplied."""

    atlas: Texture2D

    def vertex(self, v: Corner) -> Colored:
        return Colored(clip=vec4(v.position, 0.5, 1.0), uv=v.uv, color=v.color)

    def fragment(self, v: Colored) -> vec4:
        return self.atlas.sample(v.uv) * v.color


class Batch:
    """Collects sprites, which are given in pixels, and draws them with one command."""

    def __init__(self, device: rhi.Device, atlas: rhi.Texture) -> None:
        self.device, self.program = device, device.program(Sprites)
        self.atlas = atlas.sampled(SamplerDescriptor(Filter.LINEAR, Filter.LINEAR, None))
        self.added: list[NDArray[np.void]] = []

    def add(self, sprites: ArrayLike) -> None:
        """Add rows (n,) of `SPRITE`."""
        self.added.append(np.asarray(sprites, SPRITE))

    def draw(self, size: tuple[int, int]) -> None:
        """Draw what was added, lower layers first, in the open pass, whose targets have that size."""
        rows = np.concatenate(self.added)
        rows = rows[np.argsort(rows["layer"], kind="stable")]
        self.added.clear()
        corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)], np.float32)
        cos, sin = np.cos(rows["angle"]), np.sin(rows["angle"])
        turned = corners @ np.stack([cos, sin, -sin, cos], -1).reshape(-1, 2, 2)  # (n, 4, 2)
        corner_positions = rows["center"][:, None] + turned * (rows["size"] / 2)[:, None, None]
        uvs = (corners + 1) / 2 * (1, -1) + (0, 1) + rows["cell"][:, None, None] * (1, 0)
        with (
            self.device.states(BlendFunction.PREMULTIPLIED, CullMode.NONE),
            self.device.immediate(self.program, Primitive.QUADS, atlas=self.atlas) as quads,
        ):
            quads.vertices(
                {
                    "position": (corner_positions / size * (2, -2) + (-1, 1)).reshape(-1, 2),
                    "uv": (uvs / (CELLS, 1)).reshape(-1, 2),
                    "color": rows["color"].repeat(4, axis=0),
                }
            )


def make_atlas(cell: int = 64) -> NDArray[np.uint8]:
    """Return (cell, CELLS * cell, 4) texels: a disc, a ring, a star and a square, white with premultiplied
    alpha."""
    y, x = (np.mgrid[0:cell, 0:cell] + 0.5) / cell * 2 - 1
    radius, angle = np.hypot(x, y), np.arctan2(y, x)
    disc, ring, square = 0.9 - radius, 0.15 - abs(radius - 0.7), 0.7 - np.maximum(abs(x), abs(y))
    shapes = (disc, ring, 0.6 + 0.3 * np.cos(5 * angle) - radius, square)
    alpha = np.concatenate([np.clip(shape * cell / 2, 0, 1) for shape in shapes], axis=1)
    return (alpha[..., None] * 255).round().astype(np.uint8).repeat(4, axis=2)


def make_sprites(count: int, size: tuple[int, int]) -> NDArray[np.void]:
    """Return random rows (count,) of `SPRITE` all over an image."""
    rng = np.random.default_rng(12)
    rows = np.zeros(count, SPRITE)
    rows["center"], rows["angle"] = rng.uniform(0, size, (count, 2)), rng.uniform(0, 7, count)
    rows["size"] = rng.uniform(0.02, 0.09, count) * size[1]
    rows["cell"], rows["layer"] = rng.integers(0, CELLS, count), rng.integers(0, 3, count)
    alpha = rng.uniform(0.4, 1, (count, 1))
    rows["color"] = np.concatenate([rng.uniform(0, 1, (count, 3)) * alpha, alpha], axis=1)
    return rows


def render(device: rhi.Device, size: tuple[int, int]) -> rhi.Texture:
    """Draw three thousand sprites."""
    batch = Batch(device, device.texture(make_atlas(), rhi.Format.RGBA8))
    image = device.texture(size, rhi.Format.RGBA8)
    batch.add(make_sprites(3000, size))
    with device.render_pass(image, clear=(0.06, 0.07, 0.1, 1)):
        batch.draw(size)
    return image


if __name__ == "__main__":
    save_image(render)
