"""Hard water: waves of extreme numbers, sizes and heights, and eyes below, beside and on the surface.

Heights are those of the leapfrog scheme in closed form; images are those of a still mesh at these heights, by
rays in float64.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from frames import open_renderer
from nightly_reasons import FEWER_CASES, ONLY_KERNELS
from numpy.typing import NDArray

import rhi
from renderer.lab.measure.ray_tracer import RayTracer
from renderer.scene import Camera, MeshGeometry, Perspective, Scene, SceneBuilder
from renderer.scene.water import WaterPool, WaterSimulation
from renderer.techniques import TECHNIQUES
from rhi.errors import ValidationError

Floats = NDArray[np.float64]
GRAVITY, STEP = 9.81, 1.0 / 60.0
SIZE = (64, 36)


@dataclass(frozen=True)
class Wave:
    """A standing wave of a pool: half waves along x and z, and the height of its crests."""

    modes: tuple[int, int]
    cells: tuple[int, int] = (24, 16)
    size: tuple[float, float] = (1.5, 1.0)
    depth: float = 0.02
    height: float = 0.01

    def shape(self) -> Floats:
        """The wave of height 1, (rows + 1, columns + 1)."""
        across, along = (
            np.cos(np.pi * mode * np.arange(cells + 1) / cells)
            for mode, cells in zip(self.modes, self.cells, strict=True)
        )
        return along[:, None] * across

    def cosine(self) -> float:
        """cos(ω dt) of the scheme."""
        square = GRAVITY * self.depth * STEP**2
        return 1.0 - square * sum(
            2.0 * (cells / size) ** 2 * np.sin(0.5 * np.pi * mode / cells) ** 2
            for mode, cells, size in zip(self.modes, self.cells, self.size, strict=True)
        )

    def make_pool(self) -> WaterPool:
        """The pool with this wave, undamped, without rain."""
        return WaterPool(
            size=self.size,
            cells=self.cells,
            depth=self.depth,
            damping=0.0,
            rain=0.0,
            radius=0.1 * self.size[0],
            drop=0.5 * self.height,
            max_height=max(2.0 * self.height, 1e-6),
            start=self.height * self.shape(),
        )


WAVES = {
    "flat and raised": Wave((0, 0)),
    "the longest": Wave((1, 0)),
    "the shortest along x": Wave((24, 0)),
    "the shortest along z": Wave((0, 16)),
    "the shortest": Wave((24, 16)),
    "all but the shortest": Wave((23, 15)),
    "of a molecule": Wave((3, 2), height=1e-30),
    "of denormal height": Wave((3, 2), height=1e-40),
    "in a tiny pool": Wave((3, 2), cells=(6, 4), size=(1.5e-3, 1e-3), depth=1e-6, height=1e-5),
    "in an ocean": Wave((3, 2), size=(9e3, 6e3), depth=4e3, height=100.0),
    "high": Wave((3, 2), height=10.0),
    "of two cells": Wave((2, 2), cells=(2, 2)),
    "in a long pool": Wave((128, 1), cells=(128, 2), size=(8.0, 0.125)),
    "in uneven cells": Wave((4, 64), cells=(4, 64), size=(8.0, 4.0)),
}


def heights_after(device: rhi.Device, pool: WaterPool, steps: int) -> Floats:
    """The heights after 0 to `steps` steps: (steps + 1, rows + 1, columns + 1)."""
    water = WaterSimulation(1, pool)
    rows, columns = (cells + 1 for cells in pool.cells[::-1])
    frames = []
    for number in range(steps + 1):
        if number:
            water.step(np.zeros(1, np.int64), np.full(1, number))
        with device.storage(float, 6 * rows * columns) as vertices:
            water.deform(device, np.zeros(1, np.int64), vertices, np.zeros(1, np.int64), 6)
            frames.append(vertices.read().reshape(rows, columns, 6)[..., 1].astype(np.float64))
    water.release(device)
    return np.stack(frames)


@pytest.mark.nightly_cases("cl-*", reason=ONLY_KERNELS)
@pytest.mark.parametrize("name", WAVES)
def test_hard_waves_are_those_of_the_scheme(device: rhi.Device, name: str) -> None:
    wave = WAVES[name]
    shape = wave.shape()
    frames = heights_after(device, wave.make_pool(), 90) / wave.height
    parts = (frames * shape).sum(axis=(1, 2)) / (shape**2).sum()
    if name == "of denormal height":  # devices may take it for zero
        assert np.abs(frames).max() < 1.01
        return
    tolerance = 2e-4
    assert frames - parts[:, None, None] * shape == pytest.approx(0.0, abs=tolerance)  # it stays that wave
    angle = np.arccos(wave.cosine())
    assert parts == pytest.approx(np.cos(angle * np.arange(len(parts))), abs=50 * tolerance)


@pytest.mark.parametrize("sides", [(1.0, 1.0), (1.0, 3.0), (9.0, 1.0), (1.0, 1e4)])
def test_every_accepted_depth_is_stable(device: rhi.Device, sides: tuple[float, float]) -> None:
    cells = (8, 8)
    size = (0.2 * sides[0], 0.2 * sides[1])
    rng = np.random.default_rng(5)
    start = 1e-3 * rng.uniform(-1.0, 1.0, (9, 9))

    def make(depth: float) -> WaterPool:
        return WaterPool(size=size, cells=cells, depth=depth, damping=0.0, rain=0.0, start=start)

    low, high = 1e-6, 1e6
    for _ in range(60):
        middle = float(np.sqrt(low * high))
        try:
            make(middle)
            low = middle
        except ValidationError:
            high = middle
    frames = heights_after(device, make(low), 400)
    assert np.abs(frames).max() < 40e-3  # a wave of each mode in phase is far below
    assert np.abs(frames[-50:]).max() > 1e-4


@pytest.mark.nightly_cases("cl-*", reason=ONLY_KERNELS)
@pytest.mark.nightly_cases("*-[2-5]", reason=FEWER_CASES)
@pytest.mark.parametrize("seed", range(6))
def test_random_pools_are_those_of_the_scheme(device: rhi.Device, seed: int) -> None:
    rng = np.random.default_rng(seed)
    cells = tuple(int(count) for count in rng.integers(2, 40, 2))
    modes = tuple(int(rng.integers(0, count + 1)) for count in cells)
    size = tuple(float(side) for side in 10.0 ** rng.uniform(-2.5, 3.5, 2))
    fraction = rng.uniform(0.01, 0.99)
    depth = fraction / (GRAVITY * STEP**2 * sum((n / side) ** 2 for n, side in zip(cells, size, strict=True)))
    height = float(10.0 ** rng.uniform(-4.0, 3.0))
    wave = Wave(modes, cells, size, float(np.clip(depth, 1e-6, 9e3)), height)
    damping = float(rng.choice([0.0, 0.3, 30.0]))
    frames = heights_after(device, replace(wave.make_pool(), damping=damping), 60) / height
    steps = np.arange(len(frames))
    expected = np.cos(np.arccos(wave.cosine()) * steps) * np.exp(-0.5 * damping * STEP * steps)
    assert frames == pytest.approx(expected[:, None, None] * wave.shape(), abs=5e-3)


def surface(wave: Wave, height: float) -> Scene:
    """A still surface of this height of the wave, in float64, with normals of central differences."""
    pool = wave.make_pool()
    heights = height * wave.shape()
    geometry = pool.make_mesh()
    vertices = geometry.vertices.copy()
    rows, columns = heights.shape
    padded = np.pad(heights, 1, mode="reflect")
    slopes = (
        (padded[1:-1, 2:] - padded[1:-1, :-2]) / (2.0 * wave.size[0] / (columns - 1)),
        (padded[2:, 1:-1] - padded[:-2, 1:-1]) / (2.0 * wave.size[1] / (rows - 1)),
    )
    x, z = np.meshgrid(
        np.linspace(-0.5, 0.5, columns) * wave.size[0], np.linspace(-0.5, 0.5, rows) * wave.size[1]
    )
    normals = np.stack([-slopes[0], np.ones_like(heights), -slopes[1]], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    vertices["position"] = np.stack([x, heights, z], axis=-1).reshape(-1, 3)
    vertices["normal"] = normals.reshape(-1, 3)
    return light(MeshGeometry(vertices, geometry.indices), wave, None)


def light(mesh: MeshGeometry, wave: Wave, pool: WaterPool | None) -> Scene:
    """A scene of a surface in the light of a sun and the sky; simulated with a `pool`."""
    builder = SceneBuilder("water")
    bounds = {} if pool is None else {"bounds": pool.bounds}
    row = builder.add_objects(
        builder.add_node(),
        builder.add_mesh(mesh, **bounds),
        builder.add_material(base_color=(0.3, 0.5, 0.6), specular_color=(0.4, 0.4, 0.4), shininess=30.0,
                             double_sided=True),
    )  # fmt: skip
    if pool is not None:
        builder.simulate(row, WaterSimulation(1, pool))
    builder.lights.add_directional((-0.3, -1.0, -0.5))
    builder.lights.sky, builder.lights.ground = (0.3, 0.4, 0.5), (0.2, 0.15, 0.1)
    return builder.build()


EYES: dict[str, tuple[tuple[float, float, float], tuple[float, float, float]]] = {
    "above": ((0.2, 0.8, 1.0), (0.0, 0.0, 0.0)),
    "below": ((0.2, -0.6, 0.7), (0.0, 0.0, 0.0)),
    "straight below": ((0.01, -0.9, 0.02), (0.0, 0.0, 0.0)),
    "grazing": ((0.1, 0.06, 1.6), (0.0, 0.0, 0.0)),
    "grazing from below": ((0.1, -0.06, 1.6), (0.0, 0.0, 0.0)),
    "in the surface": ((0.1, 0.0, 0.2), (0.0, 0.0, -0.7)),
    "in the surface, downwards": ((0.1, 0.0, 0.2), (0.0, -1.0, -0.1)),
    "in the surface, upwards": ((0.1, 0.0, 0.2), (0.0, 1.0, -0.1)),
    "in the surface, level from outside": ((0.0, 0.0, 1.5), (0.0, 0.0, 0.0)),
}
SEEN = {
    "flat": Wave((0, 0), height=0.0),
    "long": Wave((3, 2), height=0.03),
    "short": Wave((12, 16), height=0.004),
    "steep": Wave((12, 8), height=0.06),
}


def levels_off(
    device: rhi.Device, wave: Wave, eye: str, technique: Any = None, steps: int = 0
) -> tuple[float, float, int]:
    """The greatest and mean difference in levels between a frame and rays, and the pixels compared."""
    up = (0, 0, 1) if eye in ("straight below",) else (0, 1, 0)
    height = wave.height * float(np.cos(np.arccos(wave.cosine()) * steps))
    if eye == "on a vertex":
        row, column = wave.cells[1] // 3, wave.cells[0] // 3
        position = (
            float(np.float32((column / wave.cells[0] - 0.5) * wave.size[0])),
            float(np.float32(height * wave.shape()[row, column])),
            float(np.float32((row / wave.cells[1] - 0.5) * wave.size[1])),
        )
        target = (0.3, -0.05, -0.2)
    else:
        position, target = EYES[eye]
    camera = Camera.look_at(position, target, up, Perspective(1.0, SIZE[0] / SIZE[1], 0.01, 50.0))
    still, pool = surface(wave, height), wave.make_pool()
    tracer = RayTracer(still)
    offsets = [(0.5, 0.5), *((0.5 + x, 0.5 + y) for x in (-0.2, 0.2) for y in (-0.2, 0.2))]
    traced = np.stack([tracer.draw(camera, SIZE, at=offset) for offset in offsets])
    with open_renderer(device, light(pool.make_mesh(), wave, pool), technique, size=SIZE) as renderer:
        image = renderer.render(camera, steps * STEP + 1e-4).image.read()[..., :3].astype(np.float64)
    low, high = traced.min(axis=0), traced.max(axis=0)
    is_smooth = (high - low).max(axis=2) < 8.0
    off = np.maximum(low - image, image - high).max(axis=2)[is_smooth]
    return float(off.max()), float(np.maximum(off, 0.0).mean()), int(is_smooth.sum())


@pytest.mark.nightly_cases("cl-*", reason=ONLY_KERNELS)
@pytest.mark.nightly_cases("*-0", "gl-long-*", "gl-short-*", reason=FEWER_CASES)
@pytest.mark.parametrize("steps", [0, 31])
@pytest.mark.parametrize("eye", [*EYES, "on a vertex"])
@pytest.mark.parametrize("name", SEEN)
def test_water_from_hard_eyes_is_as_rays_see_it(
    drawing_device: rhi.Device, name: str, eye: str, steps: int
) -> None:
    worst, mean, compared = levels_off(drawing_device, SEEN[name], eye, steps=steps)
    assert compared > 150
    assert worst < 1.0, (worst, mean)


@pytest.mark.nightly_cases("*light*", "*multi*", reason=FEWER_CASES)
@pytest.mark.parametrize("technique", [name for name in TECHNIQUES if name not in ("auto", "inferred")])
def test_every_technique_sees_water_from_below(gl: rhi.Device, technique: str) -> None:
    worst, mean, compared = levels_off(
        gl, SEEN["long"], "grazing from below", TECHNIQUES[technique](), steps=31
    )
    assert compared > 150
    assert worst < 1.5, (worst, mean)
