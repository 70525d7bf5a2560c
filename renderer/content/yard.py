"""A yard whose materials have shaders of their own: walls of bricks in relief, columns and balls of marble,
and a floor of squares. Materials of one shader are instances of one parent, which differ in a colour or in a
parameter."""

from __future__ import annotations

from typing import Final

import numpy as np

from renderer.content.material_shaders import Checker, Marble, Parallax
from renderer.content.shapes import BUILT_IN, cylinder, plane
from renderer.content.skies import add_sky
from renderer.content.specs import ENVIRONMENT, SEED, Generator, Option
from renderer.content.surfaces import paint_surface
from renderer.scene.paths import make_path
from renderer.scene.scene import Scene
from renderer.scene.scene_builder import SceneBuilder
from renderer.scene.water import WaterPool, WaterSimulation
from rhi.math import Camera, Perspective, multiply, rotation, scaling, translation

_SIDE: Final = 8.0
"""Metres between two walls."""
_HEIGHT: Final = 3.0
_POOL: Final = (2.6, 1.4)  # metres along x and z
_RIM: Final = (0.12, 0.22)  # width and height of a pool's rim, metres


def make_yard(
    columns: int, lights: int, pools: int, shadows: int, seed: int, environment: float = 0.0
) -> Scene:
    """Make a yard with `columns` columns, each with a ball beside it, and `pools` pools, lit by the sun and
    by `lights` point lights."""
    rng = np.random.default_rng([seed, 29])
    wet = f"pools={pools}," if pools else ""
    builder = SceneBuilder(f"yard:columns={columns},lights={lights},{wet}shadows={shadows},seed={seed}")
    builder.background = (0.30, 0.42, 0.58)
    half = 0.5 * _SIDE

    bricks = paint_surface("bricks", 256, 3)
    texture, normal, height = (
        builder.add_image(image) for image in (bricks.color, bricks.normal, bricks.height)
    )
    wall = builder.add_material(
        shader=Parallax,
        base_color=(0.55, 0.25, 0.17),
        texture=texture,
        normal_texture=normal,
        height_texture=height,
        roughness=0.85,
        metallic=0.0,
    )
    walls = [
        wall,
        *(
            builder.add_material(parent=wall, base_color=tint)
            for tint in ((0.5, 0.42, 0.3), (0.4, 0.4, 0.42))
        ),
    ]
    wall_mesh = builder.add_mesh(plane(uv_scale=(4.0, 1.5)), "wall")
    upright = multiply(rotation((1, 0, 0), 0.5 * np.pi), scaling((_SIDE, 1.0, _HEIGHT)))
    for turn, material in zip((0.0, 0.5 * np.pi, -0.5 * np.pi), walls, strict=True):
        transform = translation((0.0, 0.5 * _HEIGHT, -half))
        builder.add_objects(
            builder.add_node(multiply(multiply(rotation((0, 1, 0), turn), transform), upright)),
            wall_mesh,
            material,
        )

    floor = builder.add_material(
        shader=Checker, base_color=(0.62, 0.6, 0.55), second_color=(0.25, 0.22, 0.2), squares=(8, 14)
    )
    ground = builder.add_mesh(plane(), "floor")
    builder.add_objects(
        builder.add_node(multiply(translation((0, 0, 3.0)), scaling((_SIDE, 1.0, 14.0)))), ground, floor
    )

    marble = builder.add_material(shader=Marble, base_color=(0.85, 0.83, 0.8), roughness=0.15, metallic=0.0)
    veins = 0.35 + 0.6 * rng.random((columns, 3))
    stones = [
        builder.add_material(parent=marble, vein_color=tint, frequency=float(frequency))
        for tint, frequency in zip(veins.tolist(), rng.uniform(1.0, 3.0, columns), strict=True)
    ]
    angle = 2.0 * np.pi * (np.arange(columns) + 0.5) / max(columns, 1)
    feet = np.stack([0.55 * half * np.cos(angle), np.zeros(columns), 0.55 * half * np.sin(angle)], axis=1)
    column, ball = builder.add_mesh(cylinder(48), "column"), builder.add_mesh(BUILT_IN["sphere"](), "ball")
    if columns:
        standing = multiply(translation(np.add(feet, (0.0, 1.0, 0.0))), scaling((0.35, 2.0, 0.35)))
        builder.add_objects(builder.add_nodes(standing), column, np.array(stones))
        beside = multiply(translation(np.add(0.5 * feet, (0.0, 0.3, 0.0))), scaling((0.6, 0.6, 0.6)))
        builder.add_objects(builder.add_nodes(beside), ball, np.array(stones)[::-1])
    plain = builder.add_material(base_color=(0.7, 0.55, 0.2), metallic=1.0, roughness=0.3)
    builder.add_objects(
        builder.add_node(multiply(translation((0, 0.5, 0)), scaling((0.5, 0.5, 0.5)))), ball, plain
    )

    _add_pools(builder, pools, marble, seed)
    builder.lights.sky, builder.lights.ground = (0.22, 0.26, 0.32), (0.10, 0.09, 0.08)
    builder.lights.add_directional((0.7, -0.7, -0.35), (1.0, 0.95, 0.86), 1.4, casts_shadow=bool(shadows))
    if lights:
        spread = rng.uniform(-0.9, 0.9, (lights, 2)) * half
        hue = 2.0 * np.pi * (rng.random((lights, 1)) + np.array([0.0, 1.0, 2.0]) / 3.0)
        where = np.stack([spread[:, 0], rng.uniform(0.4, 2.4, lights), spread[:, 1]], axis=1)
        builder.lights.add_points(where, 2.5, 0.55 + 0.45 * np.cos(hue), 1.2)
    add_sky(builder, environment)
    projection = Perspective(near=0.05)
    builder.views["overview"] = Camera.look_at((0.9, 2.1, half + 2.6), (0.0, 0.9, 0.0), projection=projection)
    builder.views["along"] = Camera.look_at(
        (-0.3 * half, 1.5, -half + 0.5), (half, 1.2, -half + 0.1), projection=projection
    )
    way = np.array([(0.3, 1.6, half + 2.0), (0.3, 1.6, -0.8 * half)])
    builder.paths["ground"] = make_path(way, projection, rounding=1.0, ahead=1.5)
    builder.paths["sky"] = make_path(np.add(way, (0.0, 1.6, 0.0)), projection, 1.0, ahead=3.0, sink=1.8)
    return builder.build()


def _add_pools(builder: SceneBuilder, count: int, stone: int, seed: int) -> None:
    """Add pools one behind the other, in the rain, each with a rim of stone."""
    if not count:
        return
    pool = WaterPool(
        _POOL, cells=(72, 40), depth=0.06, damping=0.6, rain=5.0, drop=0.06, radius=0.09, max_height=0.15
    )
    water = builder.add_material(base_color=(0.10, 0.24, 0.28), roughness=0.15, metallic=0.0)
    away = 0.5 * _SIDE + 1.9 * np.arange(count)
    positions = np.stack([np.zeros(count), np.full(count, _RIM[1] - 0.08), away], axis=1)
    meshes = [builder.add_mesh(pool.make_mesh(), f"water {number}", pool.bounds) for number in range(count)]
    builder.simulate(
        builder.add_objects(builder.add_nodes(translation(positions)), meshes, water),
        WaterSimulation(count, pool, seed=seed),
    )
    builder.views["pool"] = Camera.look_at(
        (1.4, 1.5, 2.2 + away[0]), (0.0, 0.1, away[0]), projection=Perspective(near=0.05)
    )
    block, (width, height) = builder.add_mesh(BUILT_IN["box"](), "rim"), _RIM
    long, deep = _POOL[0] + 2.0 * width, _POOL[1]
    for x, z, size in (
        (0.0, 0.5 * (deep + width), (long, height, width)),
        (0.5 * (long - width), 0.0, (width, height, deep)),
    ):
        for side in (-1.0, 1.0):
            rims = np.add(positions, (side * x, 0.5 * height - positions[0, 1], side * z))
            builder.add_objects(builder.add_nodes(multiply(translation(rims), scaling(size))), block, stone)


YARD: Final = Generator(
    "yard",
    "materials with shaders of their own: bricks in relief, marble, squares; ground and sky paths",
    (
        Option("columns", 7, "how many columns of marble", 0, 1_000),
        Option("lights", 6, "coloured lights between them", 0, 4_096),
        Option("pools", 0, "pools in the rain, whose surfaces are simulated where they are drawn", 0, 64),
        Option("shadows", 0, "whether the sun casts shadows, 0 or 1", 0, 1),
        SEED,
        ENVIRONMENT,
    ),
    make_yard,
)
