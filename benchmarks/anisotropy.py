"""Gain of anisotropic filtering, and its cost on OpenCL.

- Error: footprints of pixels whose longer axis is 1 to 16 times the shorter one, turned at random in the texture and on
  the screen, over checkers of 8 × 8 texels and over random texels. The error is the root of the mean square of the
  distance to the mean of 1,600 bilinear samples all over the footprint, in float64. Beside it is that of the formula of
  EXT_texture_filter_anisotropic with 16 samples.
- Cost: a full screen with one sample per pixel, in processor time, as a multiple of that without anisotropy: seen from
  the front (a pixel is 1.8 times as long as wide) and at a grazing angle (up to 29 times). Anisotropies take turns in
  one process; ratios are medians of the rounds'.

    python benchmarks/anisotropy.py [--rounds 9] [--size 1280x720]
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from functools import partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

import rhi
from renderer.cli import options
from renderer.cli.comparison import run_benchmark
from renderer.lab.comparison import Record, Subject, compare
from renderer.lab.comparison import ratio as ratio_column
from rhi import CullMode, Format, SamplerDescriptor
from rhi.shading import HostTexture, Shader, Struct, Texture2D, vec2, vec4

Array = NDArray[np.float64]
MOST: Final = (1, 2, 4, 8, 16)
RATIOS: Final = (1, 2, 4, 8, 16)
SIZE: Final = 256
COUNT: Final = 400


class Corner(Struct):
    position: vec4
    uv: vec2


class Surface(Struct):
    clip: vec4
    uv: vec2


class Sampled(Shader):
    source: Texture2D

    def vertex(self, v: Corner) -> Surface:
        return Surface(clip=v.position, uv=v.uv)

    def fragment(self, s: Surface) -> vec4:
        return self.source.sample(s.uv)


def make_levels() -> list[NDArray[np.float32]]:
    """Return checkers in red and random texels in green, with levels that are means."""
    y, x = np.mgrid[:SIZE, :SIZE] // 8
    texels = np.random.default_rng(0).uniform(0, 1, (SIZE, SIZE, 4)).astype(np.float32)
    texels[..., 0] = (x + y) % 2
    levels = [texels]
    while len(levels[-1]) > 1:
        half = len(levels[-1]) // 2
        levels.append(levels[-1].reshape(half, 2, half, 2, 4).mean((1, 3)))
    return levels


def make_footprints(ratio: float) -> tuple[Array, Array]:
    """Return places (n, 2), and matrices (n, 2, 2) whose columns are the steps to the next pixels."""
    rng = np.random.default_rng(int(ratio))
    angles = rng.uniform(0, 2 * np.pi, (2, COUNT))
    turns = np.array([[np.cos(angles), -np.sin(angles)], [np.sin(angles), np.cos(angles)]])
    first, second = np.moveaxis(turns, (0, 1), (-2, -1))
    axes = np.exp(rng.uniform(0, 1.5, COUNT))[:, None, None] * np.diag([ratio, 1.0])
    return rng.uniform(0, 1, (COUNT, 2)), first @ axes @ second / SIZE


def sample(texture: HostTexture, at: Array, lod: Any) -> Array:
    return np.stack(texture.sample(np.float64, at[..., 0], at[..., 1], 0.0, lod), -1)[..., :2]


def find_mean(levels: list[NDArray[np.float32]], at: Array, steps: Array) -> Array:
    """Return the mean of bilinear samples all over each footprint."""
    part = (np.arange(40) + 0.5) / 40 - 0.5
    inside = np.stack(np.meshgrid(part, part), -1).reshape(-1, 1, 2, 1)
    texture = HostTexture(levels[:1], Format.RGBA32F)
    return sample(texture, at + (steps @ inside)[..., 0], 0.0).mean(0)


def sample_by_extension(levels: list[NDArray[np.float32]], at: Array, steps: Array) -> Array:
    """Sample as EXT_texture_filter_anisotropic suggests, along the longer step."""
    lengths = np.linalg.norm(steps, axis=1) * SIZE
    counts = np.ceil(np.minimum(lengths.max(1) / lengths.min(1), max(MOST)) - 1e-9)
    along = np.where((lengths[:, 0] > lengths[:, 1])[:, None], steps[..., 0], steps[..., 1])
    texture, lod = HostTexture(levels, Format.RGBA32F), np.log2(lengths.max(1) / counts)
    total = np.zeros((len(at), 2))
    for number in range(1, max(MOST) + 1):
        place = at + (number / (counts + 1) - 0.5)[:, None] * along
        total += np.where((number <= counts)[:, None], sample(texture, place, lod), 0)
    return total / counts[:, None]


def measure_errors() -> Iterator[Record]:
    """Yield the errors on checkers and on random texels for each ratio of a pixel's axes."""
    levels = make_levels()
    for ratio in RATIOS:
        at, steps = make_footprints(ratio)
        exact = find_mean(levels, at, steps)
        found = {}
        for most in MOST:
            texture = HostTexture(levels, Format.RGBA32F, sampler=SamplerDescriptor(max_anisotropy=most))
            right, down = ((*steps[:, :, i].T, 0.0) for i in range(2))
            colors = texture.sample_across(np.float64, at[:, 0], at[:, 1], 0.0, *right, *down, 0.0)
            found[f"up to {most}"] = np.stack(colors[:2], -1)
        found["the extension's, 16"] = sample_by_extension(levels, at, steps)
        errors = {name: np.sqrt(((each - exact) ** 2).mean(0)) for name, each in found.items()}
        for channel, texels in enumerate(("checkers", "random")):
            shown = {name: round(float(error[channel]), 3) for name, error in errors.items()}
            yield {"a pixel's axes": f"{ratio} : 1", "texels": texels, **shown}


def measure_costs(rounds: int, size: tuple[int, int]) -> Iterator[Record]:
    """Yield the ratios of processor times for each way to see a plane."""
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, -1), (1, 1), (-1, 1)], np.float32)
    with rhi.create_device("cl") as device:
        source = device.texture((1024, 1024), Format.RGBA8, levels=None)
        rng = np.random.default_rng(0)
        for level in range(11):
            side = 1024 >> level
            source.write(rng.integers(0, 256, (side, side, 4), np.uint8), level=level)
        image, program = device.texture(size, Format.RGBA8), device.program(Sampled)
        for name, far in (("from the front", 1.0), ("at a grazing angle", 16.0)):
            w = np.where(corners[:, 1] > 0, far, 1.0)[:, None]
            position = np.concatenate([corners * w, 0.5 * w, w], axis=1).astype(np.float32)
            mesh = device.mesh({"position": position, "uv": (corners * w + 1).astype(np.float32)})

            def draw(most: int, _: int, mesh: rhi.Mesh = mesh) -> None:
                sampled = source.sampled(SamplerDescriptor(max_anisotropy=most))
                with device.render_pass(image), device.states(CullMode.NONE):
                    device.draw(program, mesh, source=sampled)
                device.finish()

            subjects = [Subject({}, partial(draw, most), device=device) for most in MOST]
            rows = compare(subjects, {"ratio": ratio_column(1, processor=True)}, range(rounds))
            costs = {f"up to {most}": row["ratio"] for most, row in zip(MOST, rows, strict=True)}
            yield {"a plane seen": name, **costs, "kernels": rows[0]["kernels"]}


def measure(given: argparse.Namespace) -> Iterator[Record]:
    """Yield the errors, and then the costs."""
    yield from measure_errors()
    yield from measure_costs(given.rounds, given.size)


OPTIONS: Final = (options.rounds("rounds of each cost", 9), options.size((1280, 720)))


if __name__ == "__main__":
    run_benchmark(__doc__, OPTIONS, measure)
