"""The hall: rows of columns, swaying flags on poles, fountains, banners of cloth, point and spot lights, deep
views.

Flags are chains of nodes (the pole, then the segments of the cloth, each of which rotates about the end of
the one before), so this is the scene with moving objects and a deep hierarchy. Their motion depends on the
time alone. Cross walls with doorways divide the hall: most of what lies behind them is hidden. Banners are
cloth in the draught that goes through the hall.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.content import shapes
from renderer.content.fountains import BOUNDS, DROPS, FountainSimulation, make_drops
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
from renderer.content.textures import paint_stripes
from renderer.scene.arrays import Floats, Indices
from renderer.scene.catch_up import Recompute
from renderer.scene.cloth import ClothGrid, ClothSimulation, Fabric, Gust, Wind, make_cloth_grid
from renderer.scene.cloth.cloth_grid import INTERVAL, SUB_STEPS
from renderer.scene.meshes import MeshGeometry, make_geometry
from renderer.scene.paths import make_path
from renderer.scene.scene import Scene
from renderer.scene.scene_builder import SceneBuilder
from rhi.math import Camera, Perspective, multiply, rotation, scaling, translation
from rhi.math.indexing import repeat_each

BAY: Final = 6.0
"""Distance between columns in metres."""

SEGMENTS: Final = 6
"""Number of segments of a flag's cloth: the depth of its chain of nodes."""

_HEIGHT: Final = 9.0
_BANNER: Final = (2.4, 3.2)  # width and height of a banner, metres
_GATHERED: Final = 0.88  # of a banner's width is taken by its rings
_RINGS: Final = 5  # that a banner hangs by
_BAR: Final = 8.3  # height of the bars that banners hang from, metres
_CLOTH: Final = (0.34, 1.3)  # width of a segment and height of a flag, metres
_THICKNESS: Final = 0.01  # of a side of the cloth, metres
_PARTS: Final = np.arange(SEGMENTS)
_SWING: Final = 0.11 * (1.0 + 0.35 * _PARTS)  # greatest angle between a segment and the one before, radians
_DELAY: Final = 0.9  # of a segment behind the one before, radians of the wave

_OVERLAP: Final = 14.0
"""About how many coloured lights reach a place, seen from above."""

_REACH: Final = (2.0, 10.0)
"""Least and greatest range of a coloured light in metres."""

_CLEAR: Final = 1.0  # least distance of a coloured light from the axis of a column, metres

_HUES: Final = np.array(
    [
        (1.0, 0.22, 0.16), (1.0, 0.52, 0.14), (1.0, 0.84, 0.30), (0.45, 1.0, 0.25), (0.15, 1.0, 0.55),
        (0.16, 0.85, 1.0), (0.22, 0.45, 1.0), (0.52, 0.28, 1.0), (1.0, 0.25, 0.85), (1.0, 0.88, 0.74),
    ]
)  # fmt: skip
"""Colours of coloured lights."""


def make_hall(
    columns: int,
    rows: int,
    flags: int,
    fountains: int,
    cloths: int,
    lights: int,
    detail: int,
    seed: int,
    shadows: int,
    drops: int,
    cloth_detail: int,
    cloth_rate: int,
    sub_steps: int,
    fog: float = 0.0,
    bloom: float = 0.0,
    occlusion: float = 0.0,
    sun_degrees: float = 0.0,
    focus: float = 0.0,
    aperture: float = 0.05,
) -> Scene:
    """Make a hall of `columns` x `rows` columns with `flags` flags and `fountains` fountains along its middle
    aisle and `cloths` banners between its columns, lit by its bulbs, or by `lights` coloured lights among the
    columns."""
    rng = np.random.default_rng([seed, 8])
    options = f"columns={columns},rows={rows},flags={flags},fountains={fountains},detail={detail},seed={seed}"
    others = {"drops": drops, "cloth_detail": cloth_detail, "cloth_rate": cloth_rate, "sub_steps": sub_steps}
    for name, value in {"cloths": cloths, **others}.items():
        if value != _DEFAULT_OPTIONS[name]:
            options = f"{name}={value},{options}"
    builder = SceneBuilder(f"hall:lights={lights},{options}" if lights else f"hall:{options}")
    builder.background = (0.01, 0.012, 0.02)
    length, width = columns * BAY, (rows + 1) * BAY
    _add_shell(builder, length, width, columns)
    feet = _add_columns(builder, columns, rows, length, detail)
    _add_flags(builder, rng, _flag_positions(flags, length), detail)
    _add_fountains(builder, fountains, length, detail, seed, drops)
    bars = _list_bars(cloths, columns, rows, length)
    if cloths:
        _add_banners(
            builder, bars, make_banner(2 * cloth_detail or detail, sub_steps, 1.0 / cloth_rate), seed
        )
    if lights:
        _add_colored_lights(builder, lights, feet, length, width, seed)
    else:
        _add_bulbs(builder, rng, columns, length, width)
    _add_cameras(builder, length, width)
    if cloths:
        _add_banner_camera(builder, float(bars[:, 0].min()))
    if shadows:
        cast_shadows(builder)
    add_fog_and_bloom(builder, fog, bloom, (0.16, 0.13, 0.10), 0.4)
    add_occlusion(builder, occlusion)
    widen_sun(builder, sun_degrees)
    add_depth_of_field(builder, focus, aperture)
    return builder.build()


HALL: Final = Generator(
    "hall",
    "rows of columns, swaying flags, fountains, point and spot lights, deep views; ground and sky paths",
    (
        Option("columns", 24, "columns in each row", 2, 512),
        Option("rows", 4, "rows of columns", 2, 64),
        Option("flags", 32, "flags on poles", 0, 4096),
        Option("fountains", 0, "fountains, simulated where they are drawn", 0, 4096),
        Option("cloths", 0, "banners of cloth, simulated on the device where they are drawn", 0, 4096),
        Option("lights", 0, "coloured lights among the columns; 0: bulbs along the aisle", 0, 65_536),
        Option("detail", 8, "how finely columns are divided", 3, 64),
        SEED,
        SHADOWS,
        Option(
            "drops",
            DROPS,
            "drops of a fountain, one of which is thrown in each step; they fly 1.5 s",
            1,
            DROPS,
        ),
        Option("cloth_detail", 0, "parts of a banner between two of its rings; 0: half of `detail`", 0, 10),
        Option("cloth_rate", round(1.0 / INTERVAL), "steps of banners a second", 10, 1000),
        Option("sub_steps", SUB_STEPS, "sub-steps of a step of banners", 1, 32),
        FOG,
        BLOOM,
        OCCLUSION,
        SUN_DEGREES,
        FOCUS,
        APERTURE,
    ),
    make_hall,
)
_DEFAULT_OPTIONS: Final = {option.name: option.default for option in HALL.options}


def _add_shell(builder: SceneBuilder, length: float, width: float, columns: int) -> None:
    """Add floor and ceiling bay by bay, side walls, and a cross wall with a doorway every sixth bay."""
    stone = builder.add_material(base_color=(0.42, 0.39, 0.35), specular_color=(0.08, 0.08, 0.08))
    floor = builder.add_material(
        base_color=(0.30, 0.22, 0.17), specular_color=(0.35, 0.33, 0.3), shininess=120.0, rim_strength=0.25
    )
    ceiling = builder.add_material(base_color=(0.20, 0.24, 0.33), specular_color=(0.02, 0.02, 0.02))
    tile = builder.add_mesh(shapes.plane(4), "floor")
    cube = builder.add_mesh(shapes.box(2), "block")
    bays = (np.arange(columns) + 0.5) * BAY - 0.5 * length
    zero = np.zeros(columns)
    tiles = multiply(translation(np.stack([bays, zero, zero], 1)), scaling((BAY, 1.0, width)))
    builder.add_objects(builder.add_nodes(tiles), tile, floor, casts_shadow=False)
    lids = multiply(translation(np.stack([bays, zero + _HEIGHT + 0.2, zero], 1)), scaling((BAY, 0.4, width)))
    builder.add_objects(builder.add_nodes(lids), cube, ceiling)
    sides = [
        multiply(translation((0.0, 0.5 * _HEIGHT, z)), scaling((length, _HEIGHT, 0.4)))
        for z in (-0.5 * width, 0.5 * width)
    ]
    ends = [
        multiply(translation((x, 0.5 * _HEIGHT, 0.0)), scaling((0.4, _HEIGHT, width)))
        for x in (-0.5 * length, 0.5 * length)
    ]
    door, lintel = 3.2, 5.0
    wing = 0.5 * (width - door)
    crossed = []
    for x in np.arange(6, columns, 6) * BAY - 0.5 * length:
        for side in (-1.0, 1.0):
            middle = (x, 0.5 * _HEIGHT, side * 0.5 * (door + wing))
            crossed.append(multiply(translation(middle), scaling((0.5, _HEIGHT, wing))))
        above = (x, 0.5 * (_HEIGHT + lintel), 0.0)
        crossed.append(multiply(translation(above), scaling((0.5, _HEIGHT - lintel, door))))
    builder.add_objects(builder.add_nodes(np.array([*sides, *ends, *crossed])), cube, stone)


def _add_columns(builder: SceneBuilder, columns: int, rows: int, length: float, detail: int) -> Floats:
    """Add the columns; return their feet (columns * rows, 3)."""
    marble = builder.add_material(
        base_color=(0.74, 0.70, 0.62), specular_color=(0.3, 0.3, 0.3), shininess=64.0, rim_strength=0.3
    )
    profile = [(0.0, 0.0), (0.75, 0.0), (0.75, 0.25), (0.6, 0.4), (0.62, 0.55), (0.5, 0.7), (0.48, 3.0),
               (0.42, 7.4), (0.5, 7.6), (0.48, 7.75), (0.8, 8.5), (0.8, _HEIGHT)]  # fmt: skip
    mesh = builder.add_mesh(shapes.lathe(profile, 3 * detail), "column")
    x, z = np.meshgrid(
        (np.arange(columns) + 0.5) * BAY - 0.5 * length, (np.arange(rows) - 0.5 * (rows - 1)) * BAY
    )
    feet = np.stack([x.ravel(), np.zeros(x.size), z.ravel()], axis=1)
    builder.add_objects(builder.add_nodes(translation(feet)), mesh, marble)
    return feet


def _flag_positions(flags: int, length: float) -> Floats:
    """Return the feet of the poles (flags, 3): two lines along the middle aisle, or more if there are many
    flags."""
    number = np.arange(flags)
    lines = max(2, 2 * int(np.ceil(flags / (2.0 * length))))  # at least one metre between poles
    per_line = int(np.ceil(flags / lines)) or 1
    line, slot = number // per_line, number % per_line
    side = np.where(line % 2, 1.0, -1.0) * (1.9 + 0.25 * (line // 2))
    return np.stack([((slot + 0.5) / per_line - 0.5) * (length - BAY), np.zeros(flags), side], axis=1)


def _add_flags(builder: SceneBuilder, rng: np.random.Generator, positions: Floats, detail: int) -> None:
    count = len(positions)
    if not count:
        return
    width, height = _CLOTH
    colors = [((0.72, 0.10, 0.12), (0.92, 0.86, 0.70)), ((0.10, 0.22, 0.55), (0.90, 0.90, 0.88)),
              ((0.08, 0.42, 0.26), (0.95, 0.75, 0.20))]  # fmt: skip
    cloths = _add_striped(builder, colors, 3)
    iron = builder.add_material(base_color=(0.08, 0.08, 0.09), specular_color=(0.5, 0.5, 0.5), shininess=80.0)
    pole = builder.add_mesh(shapes.lathe([(0.06, 0.0), (0.04, 4.6), (0.09, 4.7), (0.0, 4.8)], detail), "pole")
    cloth = [builder.add_mesh(_cloth(part, detail), f"cloth {part}") for part in range(SEGMENTS)]

    poles = builder.add_nodes(
        multiply(translation(positions), rotation((0, 1, 0), rng.uniform(-0.6, 0.6, count)))
    )
    builder.add_objects(poles, pole, iron)
    material = cloths[np.arange(count) % len(cloths)]
    phase = rng.uniform(0.0, 2.0 * np.pi, count)
    hinges = np.array(
        [translation((0.0, 4.55 - height, 0.0) if part == 0 else (width, 0.0, 0.0)) for part in _PARTS]
    )
    above, segments = poles, []
    for part in range(SEGMENTS):
        above = builder.add_nodes(repeat_each(hinges[part : part + 1], count, axis=0), above, dynamic=True)
        builder.add_objects(above, cloth[part], material)
        segments.append(above)
    lower, upper = (corner.repeat(count, axis=0) for corner in _sway_bounds())
    builder.animate(np.concatenate(segments), _Sway(hinges, phase), (lower, upper))


def _add_striped(builder: SceneBuilder, colors: Sequence[Any], stripes: int, **values: Any) -> Indices:
    """Add a cloth's material for each pair of colours; return their ids."""
    images = [builder.add_image(paint_stripes(first, second, stripes)) for first, second in colors]
    plain = {"specular_color": (0.05, 0.05, 0.05), **values}
    return np.array([builder.add_material(texture=image, **plain) for image in images])


class _Sway:
    """The motion of the segments of all flags, part after part: a wave that runs along the cloth and grows
    outwards."""

    catch_up: Final = Recompute()

    def __init__(self, hinges: Floats, phase: NDArray[np.float64]) -> None:
        self.hinges, self.phase = hinges, phase
        self.angle = np.zeros(SEGMENTS * len(phase))

    def set_time(self, members: Indices, seconds: float) -> None:
        """Compute the angles of `members` (j,) at their hinges."""
        part, flag = np.divmod(members, len(self.phase))
        self.angle[members] = _SWING[part] * np.sin(2.4 * seconds + self.phase[flag] - _DELAY * part)

    def transforms(self, members: Indices) -> Floats:
        """Return the transforms (j, 4, 4) of `members` (j,)."""
        hinge = self.hinges[members // len(self.phase)]
        return multiply(hinge, rotation((0, 1, 0), self.angle[members]))


def _sway_bounds() -> tuple[Floats, Floats]:
    """Return the boxes (SEGMENTS, 3) that the segments never leave, in the space of the pole.

    A segment's direction is a sum of sines of one frequency: a sine too, whose amplitude is known.
    """
    width, height = _CLOTH
    turned = np.abs(np.cumsum(_SWING * np.exp(-1j * _DELAY * _PARTS)))
    ends = np.cumsum(width * np.cos(turned))  # least, of the hinge that follows a segment
    aside = np.cumsum(width * np.sin(turned)) + 2.0 * _THICKNESS
    low = np.full(SEGMENTS, 4.55 - height)
    lower = np.stack([ends - width * np.cos(turned) - 2.0 * _THICKNESS, low, -aside], axis=1)
    upper = np.stack([width * (_PARTS + 1.0) + 2.0 * _THICKNESS, low + height, aside], axis=1)
    return lower, upper


def _cloth(part: int, detail: int) -> MeshGeometry:
    """Make both sides of one segment from its hinge at x = 0; the flag's stripes continue through all
    segments."""
    width, height = _CLOTH
    x, y = np.meshgrid(np.linspace(0.0, width, detail + 1), np.linspace(0.0, height, detail + 1))
    uv = np.stack([(part + x / width) / SEGMENTS, 1.0 - y / height], axis=-1).reshape(-1, 2)
    front = shapes.grid_mesh(np.stack([x, y, np.full_like(x, _THICKNESS)], axis=-1), uv.reshape(*x.shape, 2))
    vertices = np.concatenate([front.vertices, front.vertices])
    back = vertices[len(front.vertices) :]
    back["position"][:, 2] = -_THICKNESS
    back["normal"] *= -1.0
    turned = front.indices.reshape(-1, 3)[:, ::-1] + len(front.vertices)
    return make_geometry(
        vertices["position"],
        np.concatenate([front.indices, turned.ravel()]),
        vertices["normal"],
        vertices["uv"],
    )


def _add_fountains(
    builder: SceneBuilder, count: int, length: float, detail: int, seed: int, drops: int
) -> None:
    """Add basins on alternating sides of the middle aisle, with a fountain in each."""
    if not count:
        return
    stone = builder.add_material(
        base_color=(0.46, 0.45, 0.43), specular_color=(0.2, 0.2, 0.2), shininess=48.0
    )
    water = builder.add_material(
        base_color=(0.45, 0.62, 0.75), specular_color=(0.6, 0.6, 0.6), shininess=90.0, emission=0.25
    )
    profile = [
        (0.0, 0.0),
        (1.0, 0.0),
        (1.05, 0.5),
        (0.92, 0.5),
        (0.88, 0.2),
        (0.1, 0.2),
        (0.06, 0.9),
        (0.0, 0.9),
    ]
    basin = builder.add_mesh(shapes.lathe(profile, 2 * detail), "basin")
    x = ((np.arange(count) + 0.5) / count - 0.5) * (length - BAY)
    side = np.where(np.arange(count) % 2, 1.0, -1.0) * 0.5 * BAY
    positions = np.stack([x, np.zeros(count), side], axis=1)
    builder.add_objects(builder.add_nodes(translation(positions)), basin, stone)
    sprays = [builder.add_mesh(make_drops(drops), f"spray {number}", BOUNDS) for number in range(count)]
    nozzles = builder.add_nodes(translation(positions + np.array([0.0, 0.9, 0.0])))
    builder.simulate(builder.add_objects(nozzles, sprays, water), FountainSimulation(count, seed, drops))


def _list_bars(count: int, columns: int, rows: int, length: float) -> Floats:
    """Return the middles of the bars that `count` banners hang from (count, 3): first along the middle aisle,
    from its middle outwards, then along the others, and then between those."""
    bays = (np.arange(columns) + 0.5) * BAY - 0.5 * length
    aisles = (np.arange(rows - 1) - 0.5 * (rows - 2)) * BAY
    bays, aisles = (
        bays[np.argsort(np.abs(bays), kind="stable")],
        aisles[np.argsort(np.abs(aisles), kind="stable")],
    )
    slot = np.arange(count)
    layer, bay = np.divmod(slot, columns * (rows - 1))
    layers = -(-count // (columns * (rows - 1))) or 1
    x = bays[bay % columns] + BAY * layer / layers
    return np.stack([x, np.full(count, _BAR), aisles[bay // columns]], axis=1)


def _add_banners(builder: SceneBuilder, positions: Floats, cloth_grid: ClothGrid, seed: int) -> None:
    """Hang banners across the aisles."""
    count = len(positions)
    wood = builder.add_material(base_color=(0.16, 0.09, 0.05), specular_color=(0.1, 0.1, 0.1))
    colors = (((0.72, 0.10, 0.12), (0.95, 0.80, 0.38)), ((0.12, 0.24, 0.60), (0.92, 0.90, 0.84)))
    cloths = _add_striped(builder, colors, 5, double_sided=True)
    turned = multiply(translation(positions), rotation((0, 1, 0), np.full(count, 0.5 * np.pi)))
    bars = builder.add_nodes(multiply(turned, scaling((_BANNER[0] + 0.5, 0.07, 0.07))))
    builder.add_objects(bars, builder.add_mesh(shapes.box(1), "bar"), wood)
    mesh = cloth_grid.make_mesh()
    banners = [builder.add_mesh(mesh, f"banner {number}", cloth_grid.bounds) for number in range(count)]
    hung = builder.add_objects(builder.add_nodes(turned), banners, cloths[np.arange(count) // 2 % 2])
    builder.simulate(hung, ClothSimulation(count, cloth_grid, DRAUGHT, seed=seed))


def make_banner(detail: int, sub_steps: int = SUB_STEPS, interval: float = INTERVAL) -> ClothGrid:
    """Make a banner that hangs in folds from the origin, about the plane of x and y, by five rings."""
    (width, height), part = _BANNER, max(detail // 2, 1)
    columns, rows = (_RINGS - 1) * part + 1, 6 * part + 1
    x, y = np.meshgrid(np.linspace(-0.5 * width, 0.5 * width, columns), np.linspace(0.0, -height, rows))
    flat = np.stack([x, y, np.zeros_like(x)], 2)
    ring = width / (_RINGS - 1)
    fold = (
        2.0 * ring / np.pi * np.sqrt(1.0 - _GATHERED)
    )  # as deep as makes a wave's length that of the flat cloth
    folded = np.stack([_GATHERED * x, y, fold * np.sin(np.pi * (x + 0.5 * width) / ring)], 2)
    pinned = np.zeros((rows, columns), bool)
    pinned[0, ::part] = True
    room = ((-0.6 * width, -1.02 * height, -0.6 * height), (0.6 * width, 0.05 * height, 0.6 * height))
    fabric = Fabric(density=0.3, drag=3.0)
    return make_cloth_grid(
        folded, pinned, flat=flat, fabric=fabric, bounds=room, sub_steps=sub_steps, interval=interval
    )


DRAUGHT: Final = Wind(
    (0.0, 0.1, 0.4),
    (
        Gust((0.0, 0.1, 1.6), (0.04, 0.06, 0.0), 5.3),
        Gust((0.2, 0.0, 1.1), (0.19, 0.16, 0.0), 1.9),
        Gust((0.5, 0.0, 0.9), (0.55, 0.37, 0.0), 1.1),
    ),
)
"""The wind on banners: it swells and falls slowly, with waves that run down and across."""


def _add_banner_camera(builder: SceneBuilder, first: float) -> None:
    """Add a view along the middle aisle, of all banners from the `first` one on."""
    projection = Perspective(fov=np.radians(65.0), near=0.1)
    eye, aim = (first - 2.8, 2.2, 1.4), (first + 15.2, 5.6, -0.6)
    builder.views["banners"] = Camera.look_at(eye, aim, projection=projection)


def _add_bulbs(
    builder: SceneBuilder, rng: np.random.Generator, columns: int, length: float, width: float
) -> None:
    lights = builder.lights
    lights.sky, lights.ground = (0.05, 0.055, 0.075), (0.035, 0.028, 0.02)
    bulb_material = builder.add_material(base_color=(1.0, 0.78, 0.45), emission=3.0)
    bulb = builder.add_mesh(shapes.sphere(12), "bulb")
    every = max(1, columns // 8)
    xs = (np.arange(0, columns, every) + 0.5) * BAY - 0.5 * length + 0.5 * BAY
    for number, x in enumerate(xs[:-1] if len(xs) > 1 else xs):
        side = 1.0 if number % 2 else -1.0
        position = np.array([x, 4.2, side * 0.25 * width])
        color = ((1.0, 0.72, 0.40), (0.55, 0.72, 1.0), (1.0, 0.52, 0.36))[number % 3]
        lights.add_point(position, 16.0, color, 26.0)
        node = builder.add_node(
            multiply(translation(position), scaling((0.3, 0.3, 0.3))), name=f"bulb {number}"
        )
        builder.add_objects(node, bulb, bulb_material)
        aim = (float(rng.uniform(-0.2, 0.2)), -1.0, -0.1 * side)
        lights.add_spot((x, _HEIGHT - 0.4, 0.0), aim, 14.0, 0.30, 0.55, (1.0, 0.95, 0.85), 55.0)


class _HallLight(IntEnum):
    """The last of eight kinds of coloured lights; those before them float."""

    NEAR_FLOOR = 5
    NEAR_CEILING = 6
    SPOT = 7


def _add_colored_lights(
    builder: SceneBuilder, count: int, columns: Floats, length: float, width: float, seed: int
) -> None:
    """Add `count` coloured lights outside of the `columns` (k, 3): of eight, five float between floor and
    ceiling, one is near the floor, one near the ceiling, and one is a spot that hangs from it.

    Ranges shrink as lights get denser, so that about as many reach a place, and it is about as bright.
    """
    draws = np.random.default_rng([seed, 64]).random((count, 5))
    kind = np.arange(count) % 8
    # A bay's width less that of a cross wall at its ends; what is in a column is moved out of it.
    xs, zs = np.unique(columns[:, 0]), np.unique(columns[:, 2])
    middle = xs[(draws[:, 0] * len(xs)).astype(np.int64)]
    x, z = middle + (BAY - 1.0) * (draws[:, 1] - 0.5), (width - 1.6) * (draws[:, 2] - 0.5)
    nearest = zs[np.abs(z[:, None] - zs).argmin(1)]
    away = np.maximum(np.hypot(x - middle, z - nearest), 1e-6)
    further = np.maximum(_CLEAR / away, 1.0)
    positions = np.stack(
        [middle + (x - middle) * further, 0.0 * x, nearest + (z - nearest) * further], axis=1
    )
    positions[:, 1] = np.select(
        [kind == _HallLight.NEAR_FLOOR, kind >= _HallLight.NEAR_CEILING],
        [0.25, _HEIGHT - 0.35],
        1.0 + 5.0 * draws[:, 3],
    )
    reach = float(np.clip(np.sqrt(_OVERLAP * length * width / (np.pi * count)), *_REACH))
    number = (draws[:, 4] * len(_HUES)).astype(np.int64)
    is_spot = kind == _HallLight.SPOT
    lights = builder.lights
    lights.sky, lights.ground = (0.026, 0.028, 0.040), (0.020, 0.017, 0.015)
    lights.add_points(positions[~is_spot], reach, _HUES[number[~is_spot]], 0.12 * reach**2)
    aims = np.stack([draws[:, 3] - 0.5, 0.0 * x - 2.0, draws[:, 4] - 0.5], axis=1)
    far = max(reach, _HEIGHT + 2.0)
    lights.add_spots(positions[is_spot], aims[is_spot], far, 0.14, 0.26, _HUES[number[is_spot]], 2.4 * far)
    bulb_materials = np.array([builder.add_material(base_color=tuple(hue), emission=1.4) for hue in _HUES])
    bulb = builder.add_mesh(shapes.sphere(8), "bulb")
    size = 0.05 + 0.012 * reach
    nodes = builder.add_nodes(multiply(translation(positions), scaling((size, size, size))))
    builder.add_objects(nodes, bulb, bulb_materials[number])


def _add_cameras(builder: SceneBuilder, length: float, width: float) -> None:
    projection = Perspective(fov=np.radians(65.0), near=0.1)
    end = 0.5 * length - 1.5
    builder.views["overview"] = Camera.look_at((-end, 2.6, 0.6), (0.0, 2.8, 0.0), projection=projection)
    builder.views["aisle"] = Camera.look_at(
        (-end, 1.7, 0.5 * width - 2.0), (end, 2.2, 0.5 * width - 2.6), projection=projection
    )
    builder.views["flags"] = Camera.look_at(
        (-end + 4.0, 3.4, 0.0), (-end + 10.0, 3.9, 2.2), projection=projection
    )
    low = [(-end, 1.7, 0.0), (end, 1.7, 0.0)]
    high = [(-end, _HEIGHT - 1.2, 0.0), (-1.0, 3.6, 0.0), (1.0, 3.6, 0.0), (end, _HEIGHT - 1.2, 0.0)]
    builder.paths["ground"] = make_path(low, projection, rounding=4.0, ahead=8.0)
    builder.paths["sky"] = make_path(high, projection, rounding=6.0, ahead=8.0, sink=1.5)
