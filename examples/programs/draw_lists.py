"""A user interface as Dear ImGui hands it over: lists of vertices, indices and commands with clip rectangles.

A vertex is a position in pixels, a uv in the font's atlas, and a color in four bytes. Solid shapes use one
white texel of the atlas. A command draws a range of indices inside a rectangle. The lists change each frame,
so they are transient.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

import rhi
from rhi import BlendFunction, CullMode, Filter, SamplerDescriptor
from rhi.shading import Shader, Struct, Texture2D, Uniform, vec2, vec4
from rhi_screen import save_image

Color = tuple[int, int, int, int]
VERTEX = np.dtype([("position", "f4", 2), ("uv", "f4", 2), ("color", "u1", 4)])  # 20 bytes, as ImDrawVert


class Corner(Struct):
    position: vec2
    uv: vec2
    color: vec4


class Colored(Struct):
    clip: vec4
    uv: vec2
    color: vec4


class Pixels(Struct):
    size: vec2


class Windows(Shader):
    """Positions are in pixels, from the top left corner; alpha comes from the atlas."""

    screen: Uniform[Pixels]
    atlas: Texture2D

    def vertex(self, v: Corner) -> Colored:
        position = v.position / self.screen.size
        return Colored(
            clip=vec4(position.x * 2.0 - 1.0, 1.0 - position.y * 2.0, 0.5, 1.0), uv=v.uv, color=v.color
        )

    def fragment(self, v: Colored) -> vec4:
        return vec4(v.color.rgb, v.color.a * self.atlas.sample(v.uv).x)


@dataclass
class DrawList:
    """Vertices, indices, and commands of (first index, number of indices, clip rectangle x, y, width,
    height)."""

    vertices: list[tuple[object, ...]] = field(default_factory=list)
    indices: list[int] = field(default_factory=list)
    commands: list[tuple[int, int, tuple[int, int, int, int]]] = field(default_factory=list)

    def add(
        self, x: float, y: float, width: float, height: float, color: Color, uv: tuple[float, ...]
    ) -> None:
        """Add a rectangle with the part of the atlas from (u0, v0) to (u1, v1)."""
        base, (u0, v0, u1, v1) = len(self.vertices), uv
        self.vertices += [
            ((x, y), (u0, v0), color),
            ((x + width, y), (u1, v0), color),
            ((x + width, y + height), (u1, v1), color),
            ((x, y + height), (u0, v1), color),
        ]
        self.indices += [base + i for i in (0, 1, 2, 0, 2, 3)]

    def clip(self, x: int, y: int, width: int, height: int) -> None:
        """End a command: all rectangles since the last one are drawn inside these pixels."""
        first = sum(count for _, count, _ in self.commands)
        self.commands.append((first, len(self.indices) - first, (x, y, width, height)))


GLYPHS = {
    "r": ("     ", "     ", "# ## ", "##   ", "#    ", "#    ", "#    "),
    "h": ("#    ", "#    ", "# ## ", "##  #", "#   #", "#   #", "#   #"),
    "i": ("  #  ", "     ", " ##  ", "  #  ", "  #  ", "  #  ", " ### "),
}
CELL = 8
WHITE = (1.5 / 32, 15.5 / 16) * 2


def make_atlas() -> np.ndarray:
    """Return (16, 32) texels: a cell of 8×8 per glyph, and white in the lower half."""
    atlas = np.zeros((16, 32), np.uint8)
    atlas[8:] = 255
    for number, rows in enumerate(GLYPHS.values()):
        bits = np.array([[character == "#" for character in row] for row in rows])
        atlas[:7, number * CELL : number * CELL + 5] = bits * 255
    return atlas


def make_windows(size: tuple[int, int]) -> DrawList:
    """Return three overlapping windows, with text that their edges cut off."""
    lists = DrawList()
    for number in range(3):
        x, y = size[0] // 10 + number * size[0] // 5, size[1] // 10 + number * size[1] // 6
        width, height = size[0] // 3, size[1] // 3
        lists.add(x, y, width, height, (30, 34, 42, 235), WHITE)
        lists.add(x, y, width, 16, (60 + 40 * number, 80, 150, 255), WHITE)
        for line in range(8):
            for column, letter in enumerate("rhi rhi rhi rhi rhi rhi"):
                if letter != " ":
                    u = list(GLYPHS).index(letter) * CELL / 32
                    corner = (x + 6 + column * 12, y + 22 + line * 20)
                    lists.add(*corner, 16, 16, (220, 225, 235, 255), (u, 0, u + 8 / 32, 8 / 16))
        lists.clip(x, y, width, height)
    return lists


def render(device: rhi.Device, size: tuple[int, int]) -> rhi.Texture:
    """Upload the lists and draw each command in its rectangle."""
    lists = make_windows(size)
    program = device.program(Windows)
    atlas = device.texture(make_atlas(), rhi.Format.R8)
    smooth = SamplerDescriptor(Filter.LINEAR, Filter.LINEAR, None)
    image = device.texture(size, rhi.Format.RGBA8)
    screen = device.transient.uniform(Pixels(size=size))
    indices = np.array(lists.indices, np.uint16)
    mesh = device.transient.mesh(program, np.array(lists.vertices, VERTEX), indices)
    firsts, counts, clips = zip(*lists.commands, strict=True)
    with (
        device.render_pass(image, clear=(0.2, 0.25, 0.3, 1)),
        device.states(BlendFunction.ALPHA, CullMode.NONE),
    ):
        draws = mesh.draws(firsts, counts)
        device.draw_clipped(program, mesh, draws, clips, screen=screen, atlas=atlas.sampled(smooth))
    return image


if __name__ == "__main__":
    save_image(render)
