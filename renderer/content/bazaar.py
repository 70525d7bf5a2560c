"""The bazaar: rooms full of things, no two neighbours alike, behind walls with doorways.

It has the shape of the scene that Deferred+ was measured with (table 1.1): hundreds of materials, each with a
colour, a normal, and a metal and roughness texture, thousands of instances of hundreds of meshes of some 240
triangles, many lights, each with a bulb that shines; and from the view `corner`, in which all of it is in the
frustum, walls hide most.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from renderer.content import shapes
from renderer.content.specs import (
    APERTURE,
    BLOOM,
    FOCUS,
    FOG,
    OCCLUSION,
    SEED,
    Generator,
    Option,
    add_depth_of_field,
    add_fog_and_bloom,
    add_occlusion,
)
from renderer.content.surfaces import KINDS, paint_surface
from renderer.scene.arrays import Floats, Indices
from renderer.scene.materials import AlphaMode, TextureMap
from renderer.scene.meshes import MeshGeometry
from renderer.scene.particles import Emitter, EmitterSimulation, make_quad
from renderer.scene.paths import make_path
from renderer.scene.scene import Scene
from renderer.scene.scene_builder import SceneBuilder
from rhi.math import Camera, Perspective, multiply, rotation, scaling, translation

ROOM: Final = 7.0
"""Width of a room in metres."""

_HEIGHT: Final = 3.4
_THICK: Final = 0.3  # of a wall
_DOOR: Final = (1.5, 2.4)  # width and height of a doorway, metres
_OPEN: Final = 0.18  # share of the walls between rooms that are missing
_CIRCLE: Final = 0.6  # the radius of the circles of lights, metres
_PER_ROOM: Final = 44  # things in a room, walls not counted
_VARIANTS: Final = 2  # surfaces of each kind
_TEXELS: Final = 256  # width and height of a surface's images
_DUST: Final = (0.10, 0.09, 0.08)  # colour of the fog


def make_bazaar(
    instances: int,
    materials: int,
    meshes: int,
    lights: int,
    detail: int,
    seed: int,
    radius: float = 0.0,
    moving: float = 0.0,
    fog: float = 0.0,
    bloom: float = 0.0,
    occlusion: float = 0.0,
    focus: float = 0.0,
    aperture: float = 0.05,
    leaves: int = 0,
) -> Scene:
    """Make a bazaar of `instances` objects with `materials` materials and `meshes` meshes, lit by `lights`
    lights: points, or spheres of a `radius`. A share of them, `moving`, go around in circles. In each room fall
    `leaves` leaves."""
    rng = np.random.default_rng([seed, 21])
    name = f"bazaar:instances={instances},materials={materials},meshes={meshes},lights={lights}"
    options = "".join(f",{key}={value:g}" for key, value in _list_options(radius, moving, leaves) if value)
    builder = SceneBuilder(f"{name},detail={detail},seed={seed}{options}")
    builder.background = (0.012, 0.014, 0.022)
    side = max(2, int(np.ceil(np.sqrt(instances / (_PER_ROOM + 4.0)))))
    used = _add_materials(builder, rng, materials, seed)
    walls = _add_walls(builder, rng, side, used, instances)
    _add_things(builder, rng, side, used, meshes, instances - walls, detail)
    _add_lights(builder, rng, side, lights, radius, round(moving * lights))
    if leaves:
        _add_leaves(builder, side, leaves, seed)
    _add_cameras(builder, side)
    add_fog_and_bloom(builder, fog, bloom, _DUST, 0.4)
    add_occlusion(builder, occlusion)
    add_depth_of_field(builder, focus, aperture)
    return builder.build()


BAZAAR: Final = Generator(
    "bazaar",
    "rooms full of things of hundreds of materials, behind walls; ground and sky paths",
    (
        Option("instances", 5000, "objects, bulbs not counted", 16, 200_000),
        Option("materials", 300, "materials with three textures each", 1, 65_000),
        Option("meshes", 400, "meshes of things", 1, 20_000),
        Option("lights", 256, "coloured point lights, each with a bulb", 0, 65_536),
        Option("detail", 12, "how finely things are divided", 4, 64),
        SEED,
        Option("radius", 0.0, "radius of the spheres that the lights are, metres; 0: points", 0.0, 1.0),
        Option("moving", 0.0, "share of the lights that go around in circles", 0.0, 1.0),
        FOG,
        BLOOM,
        OCCLUSION,
        FOCUS,
        APERTURE,
        Option("leaves", 0, "leaves that fall in each room, particles", 0, 10_000),
    ),
    make_bazaar,
)


def _list_options(radius: float, moving: float, leaves: int) -> tuple[tuple[str, float], ...]:
    return ("radius", radius), ("moving", moving), ("leaves", leaves)


def _add_leaves(builder: SceneBuilder, side: int, count: int, seed: int) -> None:
    """Add leaves that fall from the tops of the walls, in each of `side` x `side` rooms."""
    y, x = np.mgrid[:64, :64] / 31.5 - 1.0
    image = np.zeros((64, 64, 4), np.uint8)
    vein = np.exp(-((x / 0.05) ** 2)) + np.exp(-(((y + np.abs(x)) % 0.35 / 0.05) ** 2))
    image[..., :3] = np.clip(np.array((150, 78, 24)) + 60.0 * vein[..., None], 0.0, 255.0)
    image[..., 3] = np.where(np.abs(x) < 0.75 * np.cos(0.5 * np.pi * y) ** 0.8, 255, 0)
    material = builder.add_material(
        texture=builder.add_image(image),
        alpha_mode=AlphaMode.MASK,
        double_sided=True,
        metallic=0.0,
        roughness=0.8,
    )
    emitter = Emitter(
        particles=count,
        lifetime=6.0,
        box=(ROOM - 1.2, 0.0, ROOM - 1.2),
        velocity=(0.05, -0.5, 0.0),
        spread=0.06,
        acceleration=(0.0, 0.0, 0.0),
        spin=3.0,
    )
    middle = (np.arange(side) + 0.5 - 0.5 * side) * ROOM
    x, z = (values.ravel() for values in np.meshgrid(middle, middle))
    simulation = EmitterSimulation(len(x), emitter, make_quad(0.16, 0.2), seed=seed)
    nodes = builder.add_nodes(translation(np.stack([x, np.full(len(x), _HEIGHT - 0.2), z], axis=1)))
    meshes = [
        builder.add_mesh(simulation.make_mesh(room), f"leaves {room}", simulation.bounds)
        for room in range(len(x))
    ]
    builder.simulate(builder.add_objects(nodes, meshes, material), simulation)


def _add_materials(builder: SceneBuilder, rng: np.random.Generator, count: int, seed: int) -> Indices:
    """Add materials: each one of the surfaces, with a tint, a scale and a roughness of its own."""
    surfaces = [paint_surface(kind, _TEXELS, seed + turn) for turn in range(_VARIANTS) for kind in KINDS]
    images = [
        [builder.add_image(image) for image in (surface.color, surface.normal, surface.metal_roughness)]
        for surface in surfaces[: max(count, 1)]
    ]
    hue = 2.0 * np.pi * (rng.random((count, 1)) + np.array([0.0, 1.0, 2.0]) / 3.0)
    gray = rng.uniform(0.35, 0.8, (count, 1))
    tints = gray * (1.0 + rng.uniform(0.0, 0.45, (count, 1)) * np.cos(hue))
    rough, strength = rng.uniform(0.45, 1.0, count), rng.uniform(0.5, 1.2, count)
    scales = rng.choice([0.5, 1.0, 2.0], count)
    added = []
    for number in range(count):
        color, normal, metal = (
            TextureMap(image, scale=(float(scales[number]), float(scales[number])))
            for image in images[number % len(images)]
        )
        added.append(
            builder.add_material(
                base_color=tuple(tints[number].tolist()),
                texture=color,
                metallic=1.0,
                roughness=float(rough[number]),
                metallic_roughness_texture=metal,
                normal_texture=normal,
                normal_scale=float(strength[number]),
            )
        )
    return np.array(added)


def _add_walls(
    builder: SceneBuilder, rng: np.random.Generator, side: int, materials: Indices, most: int
) -> int:
    """Add floors and walls of `side` x `side` rooms, `most` of them at most; return how many."""
    floor = builder.add_mesh(shapes.plane(2, (3.0, 3.0)), "floor")
    wall = builder.add_mesh(shapes.box(2), "wall")
    half = 0.5 * side * ROOM
    middle = (np.arange(side) + 0.5) * ROOM - half
    x, z = (values.ravel() for values in np.meshgrid(middle, middle))
    tiles = multiply(translation(np.stack([x, 0.0 * x, z], 1)), scaling((ROOM, 1.0, ROOM)))
    parts = []
    for line in range(side + 1):
        at = line * ROOM - half
        for cell in middle.tolist():
            for turned in (False, True):
                is_outside = line in (0, side)
                if is_outside or rng.random() >= _OPEN:
                    parts.extend(_wall(at, cell, turned, closed=is_outside))
    everything = np.concatenate([tiles, np.array(parts)])[:most]
    ids = np.where(np.arange(len(everything)) < len(tiles), floor, wall)
    builder.add_objects(builder.add_nodes(everything), ids, rng.choice(materials, len(everything)))
    return len(everything)


def _wall(at: float, cell: float, turned: bool, closed: bool) -> list[Floats]:
    """Return the boxes of a wall between two rooms: one, or two beside a doorway and one above it."""
    door, lintel = _DOOR
    wing = 0.5 * (ROOM - door)
    if closed:
        boxes = [((0.0, 0.5 * _HEIGHT), (ROOM + _THICK, _HEIGHT))]
    else:
        boxes = [
            ((-0.5 * (door + wing), 0.5 * _HEIGHT), (wing, _HEIGHT)),
            ((0.5 * (door + wing), 0.5 * _HEIGHT), (wing, _HEIGHT)),
            ((0.0, 0.5 * (_HEIGHT + lintel)), (door, _HEIGHT - lintel)),
        ]
    placed = []
    for (along, up), (width, height) in boxes:
        if turned:
            placed.append(multiply(translation((at, up, cell + along)), scaling((_THICK, height, width))))
        else:
            placed.append(multiply(translation((cell + along, up, at)), scaling((width, height, _THICK))))
    return placed


def _add_things(
    builder: SceneBuilder,
    rng: np.random.Generator,
    side: int,
    materials: Indices,
    meshes: int,
    count: int,
    detail: int,
) -> None:
    """Add `count` things, evenly to all rooms, along the walls and in stacks, out of the way of the doors."""
    if count <= 0:
        return
    ids = np.array(
        [builder.add_mesh(_make_thing(rng, detail), f"thing {number}") for number in range(meshes)]
    )
    room = np.arange(count) % (side * side)
    middle = (np.stack(np.divmod(room, side), axis=1) + 0.5 - 0.5 * side) * ROOM
    reach = 0.5 * ROOM - 0.7
    away = rng.uniform(0.9, reach, (count, 2)) * rng.choice([-1.0, 1.0], (count, 2))
    size = rng.uniform(0.45, 1.15, count)
    floor = np.where(rng.random(count) < 0.3, rng.uniform(0.6, 2.0, count), 0.0)  # on shelves, and hanging
    positions = np.stack([middle[:, 0] + away[:, 0], floor, middle[:, 1] + away[:, 1]], axis=1)
    turned = rotation((0.0, 1.0, 0.0), rng.uniform(0.0, 2.0 * np.pi, count))
    matrices = multiply(multiply(translation(positions), turned), scaling(size[:, None] * np.ones(3)))
    number = np.arange(count)
    material_number = np.where(
        number < len(materials), number % len(materials), rng.integers(0, len(materials), count)
    )
    mesh_index = np.where(number < meshes, number % meshes, rng.integers(0, meshes, count))
    builder.add_objects(builder.add_nodes(matrices), ids[mesh_index], materials[material_number])


def _make_thing(rng: np.random.Generator, detail: int) -> MeshGeometry:
    """Make a vase, a barrel, a lantern or a post: a turned shape a metre high at most, on y = 0."""
    rings = max(detail - 3, 4)
    y = np.linspace(0.0, float(rng.uniform(0.5, 1.0)), rings)
    waves = rng.uniform(-1.0, 1.0, 3) * (0.16, 0.09, 0.05)
    phase = rng.uniform(0.0, 2.0 * np.pi, 3)
    shape = sum(
        wave * np.sin((order + 1) * 2.0 * y + turn)
        for order, (wave, turn) in enumerate(zip(waves.tolist(), phase.tolist(), strict=True))
    )
    radius = np.maximum(float(rng.uniform(0.16, 0.34)) + shape, 0.05)
    profile = np.concatenate([[(0.0, 0.0)], np.stack([radius, y], axis=1), [(0.0, y[-1])]])
    return shapes.lathe(profile, detail)


def _add_lights(
    builder: SceneBuilder, rng: np.random.Generator, side: int, count: int, radius: float, moving: int
) -> None:
    """Add lights, of which the first `moving` follow nodes that go around in circles."""
    lights = builder.lights
    lights.sky, lights.ground = (0.045, 0.05, 0.07), (0.03, 0.027, 0.024)
    if not count:
        lights.add_directional((-0.4, -0.8, -0.45), (1.0, 0.95, 0.88), 1.8)
        return
    half = 0.5 * side * ROOM - 0.5
    positions = rng.uniform((-half, 1.4, -half), (half, _HEIGHT - 0.2, half), (count, 3))
    colors = _hues(rng.random(count))
    reach = float(np.clip(2.2 * side * ROOM / np.sqrt(count), 2.5, 9.0))
    # Those that move are where their nodes are.
    in_node = np.where(np.arange(count)[:, None] < moving, 0.0, positions)
    rows = lights.add_points(in_node, reach, colors, 0.16 * reach**2, source_radius=radius)
    bulb = builder.add_mesh(shapes.sphere(8), "bulb")
    bulb_colors = _hues(np.arange(8) / 8.0)
    bulb_materials = [
        builder.add_material(base_color=tuple(color), emission=1.6) for color in bulb_colors.tolist()
    ]
    size = 2.0 * radius or 0.12
    transforms = multiply(translation(positions), scaling(np.full(3, size)))
    nodes = builder.add_nodes(transforms[moving:])
    if moving:
        circling = _add_circling_nodes(builder, positions[:moving], size)
        builder.attach_lights("point", rows[:moving], circling)
        nodes = np.concatenate([circling, nodes])
    nearest = np.abs(colors[:, None] - bulb_colors).sum(-1).argmin(1)
    builder.add_objects(nodes, bulb, np.array(bulb_materials)[nearest], casts_shadow=False)


def _add_circling_nodes(builder: SceneBuilder, middles: Floats, size: float) -> Indices:
    """Add nodes that go around `middles` (k, 3) on level circles, each at a speed of its own; return their ids."""
    turns = np.arange(len(middles))
    starts, speeds = 2.4 * turns, 0.6 + 0.9 * (0.618 * turns % 1.0)  # radians, and radians a second

    def circle(seconds: float) -> Floats:
        angles = starts + speeds * seconds
        offsets = _CIRCLE * np.stack([np.cos(angles), np.zeros(len(angles)), np.sin(angles)], axis=1)
        return multiply(translation(middles + offsets), scaling(np.full(3, size)))

    nodes = builder.add_nodes(circle(0.0), dynamic=True)
    reach = np.array([_CIRCLE + 0.5 * size, 0.5 * size, _CIRCLE + 0.5 * size]) * 1.001
    builder.animate(nodes, circle, (middles - reach, middles + reach))
    return nodes


def _hues(turns: Floats) -> Floats:
    """Return the colours (k, 3) of lights at `turns` (k,) of the way around the circle of hues."""
    hue = 2.0 * np.pi * (turns[:, None] + np.array([0.0, 1.0, 2.0]) / 3.0)
    return np.asarray(0.68 + 0.32 * np.cos(hue))


def _add_cameras(builder: SceneBuilder, side: int) -> None:
    half = 0.5 * side * ROOM
    projection = Perspective(fov=np.radians(60.0), near=0.1)
    corner = np.array(
        [-half - 7.5, 11.0, -half - 7.5]
    )  # so far that all is in view, so high that a fifth is seen
    builder.views["corner"] = Camera.look_at(corner, (0.0, 1.5, 0.0), projection=projection)
    builder.views["overview"] = Camera.look_at(
        (-1.1 * half, 0.8 * half, -1.1 * half), (0, 0, 0), projection=projection
    )
    row = ROOM * (side // 2 + 0.5) - half
    low = [(-half + 1.0, 1.7, row), (half - 1.0, 1.7, row)]
    builder.paths["ground"] = make_path(low, projection, rounding=2.0, ahead=5.0)
    high = [(-half, _HEIGHT + 3.0, row), (half, _HEIGHT + 3.0, row)]
    builder.paths["sky"] = make_path(high, projection, rounding=2.0, ahead=8.0, sink=3.0)
