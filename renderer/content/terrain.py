"""The terrain: an island of mountains in the sea, with firs on its slopes.

Its ground is a height field, whose triangles are chosen for each view. Heights are a sum of noise in which
each octave is damped where the coarser ones are steep, so that ridges stay sharp and valleys smooth, as if
eroded (Quilez, 2008). Colours follow from height and slope; the sun's shadows are painted into them. A normal
map of the same resolution has the slopes, so the light on the ground doesn't depend on the triangles that
show it.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from renderer.content.shapes import cone, plane
from renderer.content.specs import SEED, Generator, Option
from renderer.scene.arrays import Floats
from renderer.scene.height_fields import HeightField, make_height_field
from renderer.scene.images import ImagePixels, make_opaque
from renderer.scene.meshes import MeshGeometry, join
from renderer.scene.paths import make_path
from renderer.scene.scene import Scene
from renderer.scene.scene_builder import SceneBuilder
from rhi import to_srgb
from rhi.math import Camera, Perspective, multiply, rotation, scaling, translation

_SIZE: Final = 4096.0
_PEAK: Final = 760.0
_SEA: Final = 24.0 * _SIZE
_SUN: Final = np.array([-0.62, -0.50, -0.45])
"""The direction of the sun's light."""
_ROTATION: Final = np.array([[0.8, -0.6], [0.6, 0.8]])  # between octaves, so that their grids don't coincide

_ROCK, _GRASS, _MEADOW, _SNOW, _SAND = (
    np.array(color)
    for color in (
        (0.20, 0.175, 0.155),
        (0.055, 0.10, 0.028),
        (0.13, 0.145, 0.045),
        (0.86, 0.89, 0.95),
        (0.40, 0.33, 0.22),
    )
)
"""Linear colours."""


def make_terrain(cells: int, trees: int, limit: int, seed: int) -> Scene:
    """Make an island 4 km wide of `cells` × `cells` cells, with `trees` firs, and at most `limit`
    triangles."""
    builder = SceneBuilder(f"terrain:cells={cells},trees={trees},limit={limit},seed={seed}")
    heights = _make_heights(cells, seed)
    field = make_height_field(heights, _SIZE, limit=limit, has_normal_map=True)
    normals = field.normals()
    ground = builder.add_material(
        texture=builder.add_image(_paint(field, normals, seed)),
        normal_texture=builder.add_image(_paint_normals(normals)),
        roughness=0.92,
        metallic=0.0,
    )
    builder.add_objects(
        builder.add_node(), builder.add_height_field(field, "island"), ground, casts_shadow=False
    )
    water = builder.add_material(base_color=(0.012, 0.055, 0.075), roughness=0.16, metallic=0.0)
    sea = builder.add_mesh(plane(16), "sea")
    builder.add_objects(builder.add_node(scaling((_SEA, 1.0, _SEA))), sea, water, casts_shadow=False)
    _plant(builder, field, normals, trees, seed)

    builder.background, builder.haze = (0.44, 0.60, 0.78), 1.0 / 9000.0
    builder.lights.sky, builder.lights.ground = (0.31, 0.41, 0.58), (0.10, 0.10, 0.09)
    builder.lights.add_directional(_SUN.tolist(), (1.0, 0.88, 0.70), 3.2)
    projection = Perspective(fov=np.radians(50.0), near=0.5)

    def above(x: float, z: float, height: float) -> tuple[float, float, float]:
        """Return a point above the ground or the sea."""
        return x, max(float(field.sample_heights(x, z)), 0.0) + height, z

    peak = _highest_point(field)
    inland = -peak * (1.0, 0.0, 1.0)
    inland /= np.linalg.norm(inland) or 1.0
    eye = above(peak[0] + 1450.0, peak[2] - 1200.0, 70.0)
    builder.views["shore"] = Camera.look_at(eye, peak * (1.0, 0.42, 1.0), projection=projection)
    builder.views["overview"] = Camera.look_at(
        (2300.0, 1500.0, 2900.0), (0.0, 100.0, 100.0), projection=projection
    )
    top = peak - 120.0 * inland + (0.0, 60.0, 0.0)
    builder.views["summit"] = Camera.look_at(
        top, top + 600.0 * inland - (0.0, 170.0, 0.0), projection=projection
    )
    walk = np.array(
        [above(x, z, 12.0) for x, z in np.linspace((-1300.0, 700.0), (1300.0, -300.0), 160).tolist()]
    )
    walk[:, 1] = np.lib.stride_tricks.sliding_window_view(np.pad(walk[:, 1], 8, "edge"), 17).max(-1)
    builder.paths["ground"] = make_path(walk, projection, rounding=220.0, ahead=220.0)
    angles = np.linspace(0.0, 1.9 * np.pi, 40)
    circle = np.stack([2300.0 * np.cos(angles), np.full(40, 620.0), 2300.0 * np.sin(angles)], axis=1)
    builder.paths["sky"] = make_path(circle, projection, rounding=600.0, ahead=1900.0, sink=420.0)
    return builder.build()


TERRAIN: Final = Generator(
    "terrain",
    "an island of mountains, whose triangles are chosen for each view; ground and sky paths",
    (
        Option("cells", 1024, "cells along each side of its map of heights", 4, 4096),
        Option("trees", 6000, "firs on its slopes", 0, 1_000_000),
        Option("limit", 262_144, "the largest number of triangles of the ground", 2, 1 << 23),
        SEED,
    ),
    make_terrain,
)


def _make_heights(cells: int, seed: int) -> Floats:
    """Return the heights of an island, (cells + 1, cells + 1)."""
    along = np.linspace(-1.0, 1.0, cells + 1)
    x, z = np.broadcast_arrays(along[None, :], along[:, None])
    table = np.random.default_rng([seed, 41]).random((256, 256))
    octaves = max(int(np.log2(cells)) + 1, 3)
    noise = _eroded(table, np.stack([x, z], axis=-1) * 1.15 + 7.3, octaves)
    coast = np.hypot(x, z) + 0.22 * (_eroded(table, np.stack([x, z], axis=-1) * 1.9 + 31.7, 4) - 0.9)
    border = 6.0 * (0.97 - np.maximum(np.abs(x), np.abs(z)))
    rise = np.clip(np.minimum((0.93 - coast) / 0.62, border), -0.6, 1.0)
    land = np.clip(rise, 0.0, 1.0)
    peak = land * land * (3.0 - 2.0 * land)
    relief = np.clip(noise - 0.45, 0.0, None) ** 1.25
    return np.asarray(_PEAK * (peak * relief * 1.25 + 0.10 * rise))


def _eroded(table: Floats, positions: Floats, octaves: int) -> Floats:
    """Return a sum of octaves of noise at the places (r, c, 2), from 0 to 2."""
    total, weight = np.zeros(positions.shape[:2]), 1.0
    slope = np.zeros(positions.shape)
    turned = np.eye(2)
    for _ in range(octaves):
        value, change = _noise(table, positions @ turned.T)
        slope += change @ turned / np.linalg.norm(turned, axis=1)[0]
        total += weight * value / (1.0 + (slope * slope).sum(-1))
        weight *= 0.5
        turned = 2.0 * _ROTATION @ turned
    return total


def _noise(table: Floats, positions: Floats) -> tuple[Floats, Floats]:
    """Return smooth noise at the places (..., 2), from 0 to 1, and its gradient."""
    cell = np.floor(positions)
    part = positions - cell
    column, row = (cell.astype(np.int64) % len(table))[..., 0], (cell.astype(np.int64) % len(table))[..., 1]
    right, below = (column + 1) % len(table), (row + 1) % len(table)
    a = table[row, column]
    b = table[row, right]
    c = table[below, column]
    d = table[below, right]
    fade = part**3 * (part * (part * 6.0 - 15.0) + 10.0)
    rate = 30.0 * part**2 * (part * (part - 2.0) + 1.0)
    u, v = fade[..., 0], fade[..., 1]
    twist = a - b - c + d
    gradient = rate * np.stack([b - a + twist * v, c - a + twist * u], axis=-1)
    return a + (b - a) * u + (c - a) * v + twist * u * v, gradient


def _ramp(values: Floats, low: float, high: float) -> Floats:
    """Return 0 up to `low` and 1 from `high` on, smooth between."""
    part = np.clip((values - low) / (high - low), 0.0, 1.0)
    return np.asarray(part * part * (3.0 - 2.0 * part))


def _paint(field: HeightField, normals: Floats, seed: int) -> ImagePixels:
    """Paint the ground by height and slope, with the sun's shadows."""
    heights = field.heights[:-1, :-1].astype(np.float64)
    level = normals[:-1, :-1, 1]
    n = len(heights)
    rng = np.random.default_rng([seed, 43])
    table = rng.random((256, 256))
    along = np.arange(n) / n * _SIZE
    positions = np.stack(np.broadcast_arrays(along[None, :], along[:, None]), axis=-1)
    patches = _noise(table, positions / 190.0)[0] * 0.6 + _noise(table, positions / 37.0)[0] * 0.4
    grain = 0.88 + 0.24 * rng.random((n, n))
    strata = 0.85 + 0.3 * _noise(table, np.stack([0.004 * positions[..., 0], 0.09 * heights], axis=-1))[0]

    color = _ROCK * strata[..., None]
    green = _mix(_GRASS, _MEADOW, _ramp(patches, 0.35, 0.65))
    color = _mix(
        color, green, _ramp(level, 0.72, 0.86) * (1.0 - _ramp(heights + 90.0 * patches, 300.0, 400.0))
    )
    color = _mix(color, _SNOW, _ramp(heights + 110.0 * patches, 400.0, 470.0) * _ramp(level, 0.60, 0.78))
    color = _mix(color, _SAND, 1.0 - _ramp(heights + 5.0 * patches, 5.0, 10.0))
    color = _mix(color, np.array([0.02, 0.08, 0.09]), 1.0 - _ramp(heights, -14.0, 0.0))
    light = 0.42 + 0.58 * _compute_sunlit(heights, _SIZE / n)
    linear = np.clip(color * (grain * light)[..., None], 0.0, 1.0)
    return make_opaque(to_srgb(linear))


def _mix(first: Floats, second: Floats, part: Floats) -> Floats:
    return np.asarray(first + (second - first) * part[..., None])


def _compute_sunlit(heights: Floats, step: float) -> Floats:
    """Return the part of the sun that each point sees, (r, c): rays towards it are followed for 2 km."""
    toward = -_SUN / np.hypot(_SUN[0], _SUN[2])
    lit = np.ones_like(heights)
    away = 1.5 * step
    while away < 2000.0:
        columns, rows = (round(away * toward[axis] / step) for axis in (0, 2))
        above = _shift(heights, rows, columns) - heights - away * toward[1]
        lit = np.minimum(lit, 0.5 - above / (0.05 * away + step))
        away *= 1.09
    return np.clip(lit, 0.0, 1.0)


def _shift(values: Floats, rows: int, columns: int) -> Floats:
    """Return each value `rows` and `columns` ahead; beyond the border, the border's value."""
    n = len(values)
    return values[np.ix_(*(np.clip(np.arange(n) + ahead, 0, n - 1) for ahead in (rows, columns)))]


def _paint_normals(normals: Floats) -> ImagePixels:
    """Paint the normals for vertices that point straight up, with tangents along x."""
    directions = np.stack([normals[..., 0], -normals[..., 2], normals[..., 1]], axis=-1)[:-1, :-1]
    return make_opaque(0.5 + 0.5 * directions)


def _plant(builder: SceneBuilder, field: HeightField, normals: Floats, count: int, seed: int) -> None:
    """Plant firs where there is grass, in groves."""
    if not count:
        return
    rng = np.random.default_rng([seed, 47])
    n = len(field.heights) - 1
    heights, level = field.heights.astype(np.float64), normals[..., 1]
    along = np.linspace(0.0, _SIZE, n + 1)
    positions = np.stack(np.broadcast_arrays(along[None, :], along[:, None]), axis=-1)
    groves = _ramp(_noise(rng.random((256, 256)), positions / 260.0)[0], 0.45, 0.7)
    likely = groves * _ramp(level, 0.78, 0.90) * (heights > 14.0) * (1.0 - _ramp(heights, 230.0, 330.0))
    chance = np.cumsum(likely.reshape(-1))
    if chance[-1] <= 0.0:
        return
    selected = np.searchsorted(chance, rng.random(count) * chance[-1])
    row, column = np.divmod(np.minimum(selected, likely.size - 1), n + 1)
    size = rng.uniform(9.0, 19.0, count)
    x, z = ((at / n - 0.5) * _SIZE for at in (column, row))
    foot = translation(np.stack([x, heights[row, column] - 0.04 * size, z], axis=1))
    turned = multiply(foot, rotation((0, 1, 0), rng.uniform(0.0, 6.28, count)))
    nodes = builder.add_nodes(multiply(turned, scaling(np.stack([0.42 * size, size, 0.42 * size], axis=1))))
    greens = np.array(
        [
            builder.add_material(
                base_color=(0.055 * shade, 0.105 * shade, 0.04 * shade), roughness=0.95, metallic=0.0
            )
            for shade in (0.7, 0.9, 1.15)
        ]
    )
    selected = greens[rng.integers(0, 3, count)]
    builder.add_objects(nodes, builder.add_mesh(_make_fir(), "fir"), selected, casts_shadow=False)


def _make_fir() -> MeshGeometry:
    """Make a fir a metre high, of three cones."""
    tiers = ((0.10, 0.50, 1.0), (0.36, 0.42, 0.74), (0.62, 0.38, 0.48))
    cones = [
        cone(7).transformed(multiply(translation((0.0, low, 0.0)), scaling((wide, high, wide))))
        for low, high, wide in tiers
    ]
    return join(cones)


def _highest_point(field: HeightField) -> Floats:
    """Return the highest point of a field, (3,)."""
    points = field.positions().reshape(-1, 3)
    return np.asarray(points[points[:, 1].argmax()])
