"""The city: blocks of buildings of several shapes between streets, taller downtown.

Each block has one building, and blocks are `PITCH` metres apart. So streets are straight, views along them
are deep, and at eye level most of the city is hidden. Buildings share meshes by shape and height, and differ
by transform and material. By default there are about 1,900 objects and 1.1 million triangles, as in the
thesis's model of New York (7.1). The same seed gives the same city.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.content.buildings import KINDS, make_building, make_street_light, make_trees
from renderer.content.shapes import plane
from renderer.content.skies import add_sky
from renderer.content.specs import (
    APERTURE,
    BLOOM,
    ENVIRONMENT,
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
from renderer.content.textures import NIGHT_WINDOWS, WINDOWS, paint_facade, paint_lit_facade, paint_street
from renderer.scene.arrays import Floats, Indices
from renderer.scene.meshes import MeshGeometry
from renderer.scene.paths import make_path
from renderer.scene.scene import Scene
from renderer.scene.scene_builder import SceneBuilder
from rhi.math import Camera, Perspective, multiply, rotation, scaling, translation

PITCH: Final = 34.0
"""Distance in metres from the middle of one street to that of the next."""

STREET: Final = 11.0
"""Width of a street in metres, from kerb to kerb."""

EYE_HEIGHT: Final = 1.8

_LOT: Final = PITCH - STREET - 3.0  # 1.5 m of pavement on each side
_STOREY: Final = 3.4
_FLOORS: Final = (4, 10, 26)  # numbers of storeys of the meshes; instances are scaled to their height

_WALLS: Final = np.array(
    [
        (0.62, 0.54, 0.44), (0.50, 0.30, 0.22), (0.70, 0.66, 0.58), (0.38, 0.24, 0.19),
        (0.46, 0.48, 0.50), (0.66, 0.50, 0.33), (0.30, 0.33, 0.38), (0.72, 0.62, 0.48),
    ]
)  # fmt: skip
_GLASS: Final = np.array([(0.42, 0.55, 0.62), (0.36, 0.46, 0.50), (0.52, 0.56, 0.60), (0.30, 0.40, 0.52)])


@dataclass(frozen=True, eq=False, slots=True)
class CityPlan:
    """The plan of a city: positions and sizes of its blocks and buildings.

    Attributes:
        centres: (n,) the middles of the blocks (x, z).
        half: half the width of the city.
        building_index: (n,) the building on each block, or -1.
        meshes: the meshes of buildings on lots of 1 x 1 x 1.
        mesh_index: (k,) the mesh of each building.
        lot_transforms: (k, 4, 4) the transforms of their lots.
        route: (c, 3) the corners of the route through the streets.
    """

    centres: Floats
    half: float
    building_index: Indices
    meshes: list[MeshGeometry]
    mesh_index: Indices
    lot_transforms: Floats
    route: Floats


def make_city(
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
    environment: float = 0.0,
) -> Scene:
    """Make a city of `blocks` x `blocks`; `detail` sets how finely facades are divided, `seed` varies
    everything."""
    builder = SceneBuilder(f"city:blocks={blocks},detail={detail},seed={seed}")
    plan = add_city(builder, blocks, detail, seed)
    add_daylight(builder)
    _add_street_lights(builder, plan.route, detail)
    if shadows:
        cast_shadows(builder)
    add_fog_and_bloom(builder, fog, bloom, builder.background, 0.05)
    add_occlusion(builder, occlusion)
    widen_sun(builder, sun_degrees)
    add_depth_of_field(builder, focus, aperture)
    add_sky(builder, environment)
    return builder.build()


def add_city(builder: SceneBuilder, blocks: int, detail: int, seed: int, at_night: bool = False) -> CityPlan:
    """Add ground, buildings, parks, paths and views, but no lights.

    At night windows are lit, and the ground is cut into smaller tiles, so that few lights reach each one.
    """
    rng = np.random.default_rng([seed, 44])
    index = np.stack(np.meshgrid(np.arange(blocks), np.arange(blocks), indexing="ij"), -1).reshape(-1, 2)
    centre = np.asarray((index - 0.5 * (blocks - 1)) * PITCH, np.float64)
    half = 0.5 * blocks * PITCH

    downtown = rng.uniform(-0.25, 0.25, 2) * half
    near = np.exp(-(((centre - downtown) / (0.38 * half)) ** 2).sum(1))
    height = 9.0 + 20.0 * rng.random(len(centre)) + near * (24.0 + 140.0 * rng.random(len(centre)) ** 1.7)
    use = rng.random(len(centre))
    built = use >= 0.10
    built[0] = True  # the smallest city has a building too
    park = ~built & (use < 0.04)

    materials = _add_materials(builder, seed, at_night)
    _add_ground(builder, blocks, seed, at_night)
    shapes, shape, transforms = _add_buildings(
        builder, rng, centre[built], height[built], near[built], detail, materials, at_night
    )
    _add_parks(builder, rng, centre[park], detail, seed)
    route = _street_route(blocks)
    _add_cameras(builder, route, half, float(height[built].max()))
    building = np.where(built, np.cumsum(built) - 1, -1)
    return CityPlan(centre, half, building, shapes, shape, transforms, route)


def add_daylight(builder: SceneBuilder) -> None:
    """Add the sun and the sky."""
    builder.background = (0.42, 0.60, 0.82)
    builder.haze = 1.0 / 3200.0
    builder.lights.sky, builder.lights.ground = (0.30, 0.38, 0.50), (0.16, 0.15, 0.13)
    builder.lights.add_directional((-0.55, -0.62, -0.50), (1.0, 0.90, 0.74), 2.3)


CITY: Final = Generator(
    "city",
    "blocks of buildings between streets, taller downtown; ground and sky paths",
    (
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
        ENVIRONMENT,
    ),
    make_city,
)


def _add_materials(builder: SceneBuilder, seed: int, at_night: bool) -> dict[str, NDArray[np.int64]]:
    """Add the materials; return their ids by facade style."""
    paint = paint_lit_facade if at_night else paint_facade
    images = {style: builder.add_image(paint(style, seed)) for style in ("punched", "ribbon", "glass")}
    emission = 1.2 if at_night else 0.0
    stone: dict[str, Any] = {"specular_color": (0.03, 0.03, 0.03), "shininess": 16.0, "rim_strength": 0.05}
    pane: dict[str, Any] = {"specular_color": (0.5, 0.5, 0.5), "shininess": 90.0, "rim_strength": 0.35}
    styles = {"punched": (_WALLS, stone), "ribbon": (_WALLS, stone), "glass": (_GLASS, pane)}
    return {
        style: np.array(
            [
                builder.add_material(base_color=tuple(c), texture=images[style], emission=emission, **look)
                for c in colors
            ]
        )
        for style, (colors, look) in styles.items()
    }


def _add_ground(builder: SceneBuilder, blocks: int, seed: int, at_night: bool) -> None:
    """Add tiles of streets, so that the ground can be culled too, and a plain around them."""
    image = builder.add_image(paint_street(STREET / PITCH, seed))
    streets = builder.add_material(texture=image, base_color=(1, 1, 1), shininess=24.0)
    plain = builder.add_material(base_color=(0.24, 0.27, 0.17), specular_color=(0, 0, 0))
    tiles = (blocks + 1) // 2 if at_night else min(blocks, 4)
    edges = np.linspace(0, blocks, tiles + 1).astype(np.int64)
    meshes = {
        (w, d): builder.add_mesh(plane(1, (w, d)), f"ground {w}x{d}")
        for w in _steps(edges)
        for d in _steps(edges)
    }
    for x0, x1 in pairwise(edges.tolist()):
        for z0, z1 in pairwise(edges.tolist()):
            size = np.array([x1 - x0, 1.0, z1 - z0]) * (PITCH, 1.0, PITCH)
            middle = (np.array([x0 + x1, 0.0, z0 + z1]) - (blocks, 0.0, blocks)) * 0.5 * PITCH
            node = builder.add_node(multiply(translation(middle), scaling(size)), name="ground")
            builder.add_objects(node, meshes[x1 - x0, z1 - z0], streets, casts_shadow=False)
    wide = builder.add_mesh(plane(), "plain")
    extent, edge = 6.0 * blocks * PITCH + 2000.0, blocks * PITCH
    # At night the plain is a frame around the city: one quad below it would be in reach of all lights.
    far, side = 0.25 * (extent + edge), 0.5 * (extent - edge)
    frame = [
        (0.0, far, extent, side),
        (0.0, -far, extent, side),
        (far, 0.0, side, edge),
        (-far, 0.0, side, edge),
    ]
    for x, z, width, depth in frame if at_night else [(0.0, 0.0, extent, extent)]:
        transform = multiply(translation((x, -0.5, z)), scaling((width, 1.0, depth)))
        builder.add_objects(builder.add_node(transform, name="plain"), wide, plain, casts_shadow=False)


def _steps(edges: NDArray[np.int64]) -> set[int]:
    return {int(step) for step in np.diff(edges)}


def _add_buildings(
    builder: SceneBuilder,
    rng: np.random.Generator,
    centre: Floats,
    height: Floats,
    near: Floats,
    detail: int,
    materials: dict[str, NDArray[np.int64]],
    at_night: bool,
) -> tuple[list[MeshGeometry], Indices, Floats]:
    """Add a building on each block; return the meshes, which of them is each building's, and the lots'
    transforms."""
    count = len(centre)
    floors = height / _STOREY
    storeys = np.abs(np.log(floors[:, None] / np.array(_FLOORS))).argmin(1)
    # Cumulative fractions of the kinds, by height: houses and slabs are low, towers high.
    shares = np.array([(0.04, 0.02, 0.22, 0.06, 0.44, 0.22), (0.28, 0.12, 0.24, 0.10, 0.0, 0.26),
                       (0.40, 0.30, 0.0, 0.22, 0.0, 0.08)]).cumsum(1)  # fmt: skip
    kind = (rng.random(count)[:, None] > shares[storeys]).sum(1).clip(0, len(KINDS) - 1)
    used, mesh = np.unique(kind * len(_FLOORS) + storeys, return_inverse=True)
    shapes, meshes = [], []
    for pair in used.tolist():
        name, storey_count = KINDS[pair // len(_FLOORS)], _FLOORS[pair % len(_FLOORS)]
        shapes.append(make_building(name, storey_count, detail))
        if at_night:
            shapes[-1].vertices["uv"] *= WINDOWS / NIGHT_WINDOWS
        meshes.append(builder.add_mesh(shapes[-1], f"{name} {storey_count}"))
    size = np.stack([*(_LOT * rng.uniform(0.82, 1.0, (2, count))), height], axis=1)[:, [0, 2, 1]]
    turn = rotation((0, 1, 0), 0.5 * np.pi * rng.integers(0, 4, count))
    to_centre = translation(np.stack([centre[:, 0], np.zeros(count), centre[:, 1]], axis=1))
    transforms = multiply(to_centre, multiply(turn, scaling(size)))
    nodes = builder.add_nodes(transforms)

    glass = (np.isin(kind, [KINDS.index("setback"), KINDS.index("round")])) | (
        near * rng.random(count) > 0.45
    )
    ribbon = ~glass & (rng.random(count) < 0.35)
    color = rng.random(count)
    material = np.empty(count, np.int64)
    for style, is_style in (("glass", glass), ("ribbon", ribbon), ("punched", ~glass & ~ribbon)):
        ids = materials[style]
        material[is_style] = ids[(color[is_style] * len(ids)).astype(np.int64)]
    builder.add_objects(nodes, np.array(meshes)[mesh], material)
    return shapes, mesh, transforms


def _add_parks(
    builder: SceneBuilder, rng: np.random.Generator, centre: Floats, detail: int, seed: int
) -> None:
    side = PITCH - STREET - 2.0
    lawn = builder.add_mesh(plane(), "lawn")
    trees = [builder.add_mesh(make_trees(9, detail, seed + i), f"trees {i}") for i in range(3)]
    grass = builder.add_material(base_color=(0.16, 0.30, 0.08), specular_color=(0, 0, 0))
    leaves = [
        builder.add_material(base_color=c, specular_color=(0.02, 0.02, 0.02), rim_strength=0.2, rim_power=3.0)
        for c in ((0.12, 0.27, 0.07), (0.20, 0.30, 0.06), (0.28, 0.24, 0.05))
    ]
    to_centre = translation(np.stack([centre[:, 0], np.full(len(centre), 0.05), centre[:, 1]], axis=1))
    nodes = builder.add_nodes(multiply(to_centre, scaling((side, 1.0, side))))
    pick = rng.integers(0, 3, (2, len(centre)))
    builder.add_objects(nodes, lawn, grass, casts_shadow=False)
    builder.add_objects(nodes, np.array(trees)[pick[0]], np.array(leaves)[pick[1]])


def _street_route(blocks: int) -> Floats:
    """Return the corners (k, 3) of a route along streets from one end of the city to the other.

    It leads along x and changes street three times, back and forth around the middle street.
    """
    streets = np.round(np.array([-0.12, 0.08, -0.05, 0.10]) * blocks) + blocks // 2
    turns = np.round(np.linspace(0, blocks, 5))
    way = [(turns[0], streets[0])]
    for turn, before, after in zip(turns[1:-1], streets[:-1], streets[1:], strict=True):
        way += [(turn, before), (turn, after)]
    way.append((turns[-1], streets[-1]))
    xz = (np.array(way, np.float64) - 0.5 * blocks) * PITCH
    moved = np.concatenate([[True], (np.diff(xz, axis=0) != 0).any(1)])
    xz = xz[moved]
    return np.stack([xz[:, 0], np.full(len(xz), EYE_HEIGHT), xz[:, 1]], axis=1)


def _add_street_lights(builder: SceneBuilder, route: Floats, detail: int) -> None:
    """Add street lights along the route, a spot and a point light in turn."""
    lights = builder.lights
    mesh = builder.add_mesh(make_street_light(detail), "street light")
    metal = builder.add_material(
        base_color=(0.10, 0.11, 0.12), specular_color=(0.4, 0.4, 0.4), shininess=60.0
    )
    to_kerb = 0.5 * STREET + 0.8
    lit = np.concatenate([route[1:-1], np.round(0.5 * (route[1:] + route[:-1]) / PITCH) * PITCH])
    for number, crossing in enumerate(lit):
        foot = crossing * (1.0, 0.0, 1.0) + (-to_kerb, 0.0, to_kerb)
        turn = multiply(translation(foot), rotation((0, 1, 0), 0.25 * np.pi))
        builder.add_objects(builder.add_node(turn, name=f"street light {number}"), mesh, metal)
        head = (turn @ (1.6, 5.7, 0.0, 1.0))[:3]
        if number % 2:
            lights.add_spot(head, (0.0, -1.0, 0.0), 22.0, 0.5, 1.0, (1.0, 0.80, 0.50), 60.0)
        else:
            lights.add_point(head, 18.0, (1.0, 0.72, 0.42), 20.0)


def _add_cameras(builder: SceneBuilder, route: Floats, half: float, top: float) -> None:
    projection = Perspective(fov=np.radians(60.0), near=0.2)
    builder.paths["ground"] = make_path(route, projection, rounding=48.0, ahead=44.0)
    roofs = top + 12.0
    flight = [
        (-half, roofs, -0.7 * half),
        (-0.3 * half, roofs + 25.0, 0.2 * half),
        (0.3 * half, roofs, -0.2 * half),
        (half, roofs + 10.0, 0.7 * half),
    ]
    builder.paths["sky"] = make_path(flight, projection, rounding=0.5 * half, ahead=160.0, sink=85.0)
    builder.views["overview"] = Camera.look_at(
        (0.62 * half, top * 0.80 + 20.0, 0.70 * half),
        (0.0, -0.35 * top, 0.0),
        projection=projection,
    )
    builder.views["street"] = Camera.look_at(
        route[0] + (2.0, 0.6, 0.0), route[1] + (0.0, 9.0, 0.0), projection=projection
    )
    builder.views["roofs"] = Camera.look_at(
        (-0.5 * half, 0.5 * top + 12.0, 0.5 * half),
        (0.2 * half, 0.25 * top, -0.1 * half),
        projection=projection,
    )
    builder.views["above"] = Camera.look_at(
        (0.0, 2.1 * half + top, 0.0), (0.0, 0.0, 0.0), (0, 0, -1), projection
    )
