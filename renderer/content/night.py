"""The city at night: street lights, lit windows, lanterns and cars, up to thousands of lights.

Blocks are lit from the middle of the city outwards, each with `_PER_BLOCK` lights: more lights light more
blocks, as densely, and the first lights stay where they are. Only if there are more lights than the blocks
have room for, the others are windows. The seed that makes a city makes the same city here.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from renderer.content import furniture, shapes
from renderer.content.buildings import intersect_windows
from renderer.content.city import PITCH, STREET, CityPlan, add_city, add_daylight
from renderer.content.furniture import CAR_LENGTH, HEADLIGHT, STREET_LIGHT_REACH, TAIL_LIGHT
from renderer.content.specs import (
    APERTURE,
    BLOOM,
    FOCUS,
    FOG,
    OCCLUSION,
    SEED,
    SHADOWS,
    SUN_DEGREES,
    Generator,
    Option,
    add_depth_of_field,
    add_fog_and_bloom,
    add_occlusion,
    cast_shadows,
    widen_sun,
)
from renderer.content.textures import NIGHT_WINDOWS
from renderer.scene.arrays import Floats, Indices
from renderer.scene.lights import Lights
from renderer.scene.scene import Scene
from renderer.scene.scene_builder import SceneBuilder
from rhi.math import Camera, Perspective, multiply, rotation, scaling, translation

_STREET_LIGHT, _WINDOW, _CAR = range(3)
_KINDS: Final = (
    _STREET_LIGHT,
    _WINDOW,
    _STREET_LIGHT,
    _WINDOW,
    _CAR,
    _CAR,
    _CAR,
    _CAR,
    _STREET_LIGHT,
    _WINDOW,
    _STREET_LIGHT,
    _WINDOW,
)
"""The lights of a block, in the order in which they are added; a car has two headlights and two tail
lights."""

_PER_BLOCK: Final = len(_KINDS)
_WINDOWS: Final = _KINDS.count(_WINDOW)

_SODIUM: Final = (1.0, 0.66, 0.32)
_SIGNS: Final = np.array(
    [
        (1.0, 0.74, 0.42), (1.0, 0.86, 0.66), (1.0, 0.30, 0.36), (0.25, 0.75, 1.0), (0.45, 1.0, 0.55),
        (1.0, 0.38, 0.85), (1.0, 0.58, 0.20),
    ]
)  # fmt: skip
"""Colours of shop windows; windows of upper storeys have one of the first `_HOMES`."""
_HOMES: Final = 2
_PAINTS: Final = (
    (0.45, 0.05, 0.04),
    (0.06, 0.10, 0.28),
    (0.50, 0.50, 0.52),
    (0.03, 0.03, 0.035),
    (0.30, 0.24, 0.12),
)

_LIT_FOG: Final = (0.045, 0.042, 0.045)
"""The colour of fog that the city lights."""


def make_night(
    lights: int,
    sun: int,
    blocks: int,
    detail: int,
    seed: int,
    shadows: int,
    fog: float = 0.0,
    bloom: float = 0.0,
    occlusion: float = 0.0,
    sun_degrees: float = 0.0,
    focus: float = 0.0,
    aperture: float = 0.05,
) -> Scene:
    """Make the city of `make_city` at night, with `lights` lights; with `sun` these are off, and the sun
    shines."""
    options = f"lights={lights},sun={sun},blocks={blocks},detail={detail},seed={seed}"
    builder = SceneBuilder(f"night:{options}")
    rng = np.random.default_rng([seed, 23])
    plan = add_city(builder, blocks, detail, seed, at_night=True)
    per_block = max(_PER_BLOCK, -(-lights // len(plan.centres)))
    kinds = np.array(_KINDS + (_WINDOW,) * (per_block - _PER_BLOCK))
    nearest = np.argsort((plan.centres**2).sum(1), kind="stable")
    number = np.arange(lights)
    block, slot = nearest[number // per_block], number % per_block
    kind = kinds[slot]
    rank = (kinds[:, None] == np.arange(3)).cumsum(0)[
        slot, kind
    ] - 1  # which one of its kind it is in its block
    slots = [
        (block[kind == light_kind], rank[kind == light_kind]) for light_kind in (_STREET_LIGHT, _WINDOW, _CAR)
    ]
    _add_street_lights(builder, plan, *slots[_STREET_LIGHT], detail)
    _add_windows(builder, plan, *slots[_WINDOW], rng, detail, np.sqrt(_PER_BLOCK / per_block))
    _add_cars(builder, plan, *slots[_CAR], rng, detail)
    if sun:
        builder.lights = Lights()
        add_daylight(builder)
    else:
        builder.background = (0.004, 0.006, 0.014)
        builder.haze = 1.0 / 1500.0
        builder.lights.sky, builder.lights.ground = (0.016, 0.022, 0.040), (0.014, 0.012, 0.010)
        builder.lights.add_directional((0.45, -0.70, -0.55), (0.62, 0.76, 1.0), 0.11)
    _add_views(builder, blocks)
    if shadows:
        cast_shadows(builder)
    add_fog_and_bloom(builder, fog, bloom, builder.background if sun else _LIT_FOG, 0.05)
    add_occlusion(builder, occlusion)
    widen_sun(builder, sun_degrees)
    add_depth_of_field(builder, focus, aperture)
    return builder.build()


NIGHT: Final = Generator(
    "night",
    "the city at night: street lights, lit windows and cars; ground and sky paths",
    (
        Option("lights", 1024, "lights, from the middle outwards, 12 on each block", 0, 65_536),
        Option("sun", 0, "1: the same streets in daylight, with the lights off", 0, 1),
        Option("blocks", 44, "blocks along each side", 1, 256),
        Option("detail", 7, "how finely facades are divided", 2, 32),
        SEED,
        SHADOWS,
        FOG,
        BLOOM,
        OCCLUSION,
        SUN_DEGREES,
        FOCUS,
        APERTURE,
    ),
    make_night,
)


def _along_street(plan: CityPlan, block: Indices, along_x: Indices, at: Floats, aside: Floats) -> Floats:
    """Return places (k, 3) on one of the two streets of each block, which run along its lower edges.

    Args:
        along_x: (k,) 1 for the street that runs along x, 0 for that along z.
        at: (k,) metres along the street from the middle of the block.
        aside: (k,) metres from the middle of the street.
    """
    edge = plan.centres[block] - 0.5 * PITCH
    middle = plan.centres[block]
    x = np.where(along_x, middle[:, 0] + at, edge[:, 0] + aside)
    z = np.where(along_x, edge[:, 1] + aside, middle[:, 1] + at)
    return np.stack([x, np.zeros(len(block)), z], axis=1)


def _add_street_lights(
    builder: SceneBuilder, plan: CityPlan, block: Indices, rank: Indices, detail: int
) -> None:
    """Add the street lights `rank` (k,), 0 to 3, of the blocks `block` (k,): two in each street, one on
    either side."""
    along_x, second = rank % 2, rank // 2
    side = np.where(second ^ along_x, 1.0, -1.0)
    feet = _along_street(
        plan, block, along_x, np.where(second, 0.25, -0.25) * PITCH, side * (0.5 * STREET + 0.8)
    )
    # The arm points along +x, and is turned to the middle of the street: -x or +x, -z or +z.
    angle = np.where(along_x, side * 0.5 * np.pi, np.where(side > 0.0, np.pi, 0.0))
    transforms = multiply(translation(feet), rotation((0, 1, 0), angle))
    metal = builder.add_material(
        base_color=(0.10, 0.11, 0.12), specular_color=(0.4, 0.4, 0.4), shininess=60.0
    )
    cover_material = builder.add_material(base_color=_SODIUM, emission=6.0)
    nodes = builder.add_nodes(transforms)
    builder.add_objects(nodes, builder.add_mesh(furniture.make_post(detail), "post"), metal)
    builder.add_objects(
        nodes,
        builder.add_mesh(furniture.make_street_light_cover(detail), "street light cover"),
        cover_material,
    )
    heads = (transforms @ (STREET_LIGHT_REACH, 5.6, 0.0, 1.0))[:, :3]
    is_spot = second == 0
    builder.lights.add_spots(heads[is_spot], (0, -1, 0), 16.0, 0.35, 1.05, _SODIUM, 150.0)
    builder.lights.add_points(heads[~is_spot], 14.0, (1.0, 0.74, 0.44), 60.0)


def _add_windows(
    builder: SceneBuilder,
    plan: CityPlan,
    block: Indices,
    rank: Indices,
    rng: np.random.Generator,
    detail: int,
    strength: float,
) -> None:
    """Add lit windows to the buildings of the blocks `block` (k,), every other one a shop's, and lanterns
    where there is no building. `rank` (k,) numbers those of a block; `strength` is below 1 if they are
    many."""
    draws = rng.random((int(rank.max(initial=_WINDOWS - 1)) + 1, len(plan.centres), 4))[rank, block]
    building = plan.building_index[block]
    _add_lanterns(builder, plan, block[building < 0], draws[building < 0], detail, strength)
    has_building = building >= 0
    draws = draws[has_building]
    rank = rank[has_building]
    building = building[has_building]
    lots = plan.lot_transforms[building]
    height = lots[:, 1, 1]
    is_shop = rank % 2 == 0
    y = np.where(is_shop, 2.9, 5.0 + (0.5 * np.minimum(height, 36.0) - 5.0) * draws[:, 0])
    angle = 0.5 * np.pi * np.floor(4.0 * draws[:, 1])
    out = np.round(np.stack([np.sin(angle), np.zeros(len(angle)), np.cos(angle)], axis=1))
    aside = np.where(is_shop, 0.3, 0.6) * (draws[:, 2] - 0.5)
    start = 2.0 * out + aside[:, None] * out[:, ::-1] + np.stack([0 * y, y / height, 0 * y], axis=1)
    wall = np.empty_like(start)
    across = np.empty_like(start)
    up = np.empty_like(start)
    for shape in np.unique(plan.mesh_index[building]).tolist():
        mine = plan.mesh_index[building] == shape
        wall[mine], across[mine], up[mine] = intersect_windows(
            plan.meshes[shape], NIGHT_WINDOWS, start[mine], -out[mine]
        )
    wall = _transform_points(
        lots, np.where(is_shop[:, None], start + ((wall - start) * out).sum(1)[:, None] * out, wall)
    )
    facing = (lots[:, :3, :3] @ out[..., None])[..., 0]
    facing = np.round(facing / np.linalg.norm(facing, axis=1, keepdims=True))
    color = np.floor(draws[:, 3] * np.where(is_shop, len(_SIGNS), _HOMES)).astype(np.int64)
    sign_materials = np.array(
        [builder.add_material(base_color=tuple(sign_color), emission=1.6) for sign_color in _SIGNS]
    )
    width, tall = (
        np.linalg.norm((lots[:, :3, :3] @ side[..., None])[..., 0], axis=1) for side in (across, up)
    )
    sign, pane = (
        np.array((3.4, 0.7, 0.24)),
        np.stack([0.48 * width, 0.54 * tall, np.full(len(tall), 0.1)], axis=1),
    )
    size = np.where(is_shop[:, None], sign, pane)
    turned = multiply(rotation((0, 1, 0), np.arctan2(facing[:, 0], facing[:, 2])), scaling(size))
    nodes = builder.add_nodes(multiply(translation(wall + 0.05 * facing), turned))
    builder.add_objects(nodes, builder.add_mesh(shapes.box(), "lit window"), sign_materials[color])
    intensity = strength * np.where(is_shop, 15.0, 9.0)
    builder.lights.add_points(wall + 0.9 * facing, np.where(is_shop, 12.0, 10.0), _SIGNS[color], intensity)


def _add_lanterns(
    builder: SceneBuilder, plan: CityPlan, block: Indices, draws: Floats, detail: int, strength: float
) -> None:
    """Add lanterns in parks and open places, somewhere on the blocks `block` (k,)."""
    xz = plan.centres[block] + (draws[:, :2] - 0.5) * (PITCH - STREET - 4.0)
    feet = np.stack([xz[:, 0], np.zeros(len(xz)), xz[:, 1]], axis=1)
    iron = builder.add_material(base_color=(0.05, 0.06, 0.05), specular_color=(0.3, 0.3, 0.3), shininess=40.0)
    lantern_material = builder.add_material(base_color=(1.0, 0.86, 0.62), emission=4.0)
    nodes = builder.add_nodes(translation(feet))
    builder.add_objects(nodes, builder.add_mesh(furniture.make_lantern_post(detail), "lantern post"), iron)
    builder.add_objects(nodes, builder.add_mesh(furniture.make_lantern(detail), "lantern"), lantern_material)
    builder.lights.add_points(feet + np.array((0.0, 3.2, 0.0)), 12.0, (1.0, 0.82, 0.58), 26.0 * strength)


def _add_cars(
    builder: SceneBuilder,
    plan: CityPlan,
    block: Indices,
    rank: Indices,
    rng: np.random.Generator,
    detail: int,
) -> None:
    """Add a car in a street of each of the blocks `block` (k,), and its lights `rank` (k,): 0 and 1 are
    headlights, 2 and 3 are tail lights."""
    draws = rng.random((4, len(plan.centres)))[:, block]
    along_x, onwards = draws[0] < 0.5, np.where(draws[1] < 0.5, 1.0, -1.0)
    # Traffic keeps to the right, and cars stand off the crossings.
    at = (PITCH - STREET - CAR_LENGTH - 1.0) * (draws[2] - 0.5)
    feet = _along_street(plan, block, along_x, at, onwards * np.where(along_x, 2.3, -2.3))
    angle = np.where(along_x, np.where(onwards > 0.0, 0.0, np.pi), -0.5 * np.pi * onwards)
    transforms = multiply(translation(feet), rotation((0, 1, 0), angle))
    first = rank == 0
    nodes = builder.add_nodes(transforms[first])
    paints = np.array(
        [
            builder.add_material(
                base_color=c, specular_color=(0.25, 0.25, 0.25), shininess=70.0, rim_strength=0.3
            )
            for c in _PAINTS
        ]
    )
    trim = builder.add_material(
        base_color=(0.02, 0.02, 0.025), specular_color=(0.3, 0.3, 0.3), shininess=90.0
    )
    white = builder.add_material(base_color=(1.0, 0.95, 0.85), emission=6.0)
    red = builder.add_material(base_color=(1.0, 0.06, 0.03), emission=2.5)
    for mesh, name, material in (
        (furniture.make_car_body(), "car", paints[(draws[3, first] * len(paints)).astype(np.int64)]),
        (furniture.make_car_trim(detail), "car trim", trim),
        (furniture.make_headlights(), "headlights", white),
        (furniture.make_tail_lights(), "tail lights", red),
    ):
        builder.add_objects(nodes, builder.add_mesh(mesh, name), material)
    right = np.where(rank % 2, 1.0, -1.0)[:, None] * (0.0, 0.0, 1.0) + (1.0, 1.0, 0.0)
    is_head = rank < 2
    heads = _transform_points(transforms[is_head], (HEADLIGHT + np.array((0.12, 0.0, 0.0))) * right[is_head])
    tails = _transform_points(
        transforms[~is_head], (TAIL_LIGHT - np.array((0.25, 0.0, 0.0))) * right[~is_head]
    )
    ahead = transforms[is_head, :3, 0] - (0.0, 0.09, 0.0)
    builder.lights.add_spots(heads, ahead, 20.0, 0.16, 0.5, (1.0, 0.93, 0.80), 90.0)
    builder.lights.add_points(tails, 5.0, (1.0, 0.08, 0.04), 1.6)


def _transform_points(transforms: Floats, points: Floats) -> Floats:
    """Return points (k, 3) under transforms (k, 4, 4)."""
    moved: Floats = (transforms[:, :3, :3] @ points[..., None])[..., 0] + transforms[:, :3, 3]
    return moved


def _add_views(builder: SceneBuilder, blocks: int) -> None:
    """Add a view of the middle of the city, as the first one: it is lit even by few lights."""
    projection = Perspective(fov=np.radians(60.0), near=0.2)
    to_street = 0.5 * PITCH * (blocks % 2)
    eye, target = np.array((3.5, 7.0, 42.0)), np.array((-2.0, 3.0, -8.0))
    crossing = np.array((to_street, 0.0, to_street))
    views = {"crossing": Camera.look_at(crossing + eye, crossing + target, projection=projection)}
    builder.views = views | builder.views
