"""Conway's Game of Life: a compute shader steps between two images, and the last one is drawn enlarged."""

from __future__ import annotations

import numpy as np

import rhi
import rhi.shading as sl
from rhi_screen import save_image

CELLS = (128, 96)
GENERATIONS = 100
GROUP = 8


class Generation(sl.Shader):
    """A shader of one generation on a torus."""

    work_group = (GROUP, GROUP)
    now: sl.UintImage2D = sl.image(rhi.Format.R8UI)
    then: sl.UintImage2D = sl.image(rhi.Format.R8UI)

    def compute(self) -> None:
        at = sl.ivec2(sl.global_id().xy)
        size = self.now.size()
        alive = 0
        for dy in range(-1, 2):
            for dx in range(-1, 2):
                alive += int(self.now.load((at + sl.ivec2(dx, dy) + size) % size).x)
        cell = int(self.now.load(at).x)
        lives = alive == 3 or (alive == 4 and cell == 1)  # the cell itself is counted, too
        self.then.store(at, sl.uvec4(sl.uint(lives), 0, 0, 0))


class Window(sl.Struct):
    size: sl.vec2


class Enlarged(sl.FullScreen):
    """Each cell as a square."""

    window: sl.Uniform[Window]
    cells: sl.UintTexture2D

    def fragment(self) -> sl.vec4:
        cell = sl.ivec2(sl.fragment_coordinate().xy / self.window.size * sl.vec2(self.cells.size()))
        return (
            sl.vec4(0.3, 0.9, 0.5, 1.0)
            if int(self.cells.load(cell).x) == 1
            else sl.vec4(0.03, 0.05, 0.08, 1.0)
        )


def make_cells() -> np.ndarray:
    """Return (height, width) cells, a third of them alive."""
    return (np.random.default_rng(3).random(CELLS[::-1]) < 1 / 3).astype(np.uint8)


def step(cells: np.ndarray) -> np.ndarray:
    """Return the next generation, on the CPU: what the shader must compute."""
    count = np.sum([np.roll(cells, (dy, dx), (0, 1)) for dy in (-1, 0, 1) for dx in (-1, 0, 1)], axis=0)
    return np.asarray((count == 3) | (count == 4) & (cells == 1), np.uint8)


def simulate(device: rhi.Device) -> rhi.Texture:
    """Return the texture of the last generation."""
    now = device.texture(make_cells(), rhi.Format.R8UI)
    then = device.texture(CELLS, rhi.Format.R8UI)
    program = device.program(Generation)
    for _ in range(GENERATIONS):
        device.dispatch(program, (CELLS[0] // GROUP, CELLS[1] // GROUP), now=now.image(), then=then.image())
        now, then = then, now
    return now


def render(device: rhi.Device, size: tuple[int, int]) -> rhi.Texture:
    """Step GENERATIONS times and draw the cells."""
    cells = simulate(device)
    image = device.texture(size, rhi.Format.RGBA8)
    window = device.uniform(Window(size=size))
    with device.render_pass(image):
        device.draw(device.program(Enlarged), device.mesh(3), window=window, cells=cells)
    return image


if __name__ == "__main__":
    save_image(render)
