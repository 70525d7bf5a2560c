"""Building meshes on unit lots (x and z from -1/2 to 1/2, y from 0 to 1), which instances scale.

`detail` sets how finely facades are divided; at 7 a building has about 600 triangles. A facade's relief is
part of its outline: pilasters stand out from the wall, so that one loft makes walls, cornices and roof.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from renderer.content import shapes
from renderer.content.textures import ROOF_UV, WINDOWS
from renderer.scene.arrays import Floats, Indices
from renderer.scene.meshes import MeshGeometry, join
from rhi.math import multiply, scaling, translation

LoftRing = tuple[float, float, float]

_RAYS: Final = 256  # that meet a building at a time: some 50 MB

KINDS: Final = ("tower", "setback", "corner", "round", "house", "slab")
"""The kinds of buildings."""


def make_building(kind: str, floors: int, detail: int) -> MeshGeometry:
    """Make a building of one of `KINDS` with windows for `floors` storeys."""
    bays = max((detail + 1) // 2, 1)
    walls = (8 * bays / WINDOWS, floors / WINDOWS)
    cornice = 1.0 - 0.35 / floors
    shop = 1.0 / floors
    if kind == "tower":
        outline = _pilasters(_SQUARE * 0.94, bays, 0.05)
        rings = [_ring(0, 1), _ring(shop, 1), _ring(shop, 0.985), _ring(cornice, 0.985), _ring(cornice, 1.03)]
        return _with_roof(outline, [*rings, _ring(1, 1.03)], walls, 0.94)
    if kind == "setback":
        outline = _divided(_CHAMFERED, bays)
        steps = [(0.0, 1.0), (0.52, 1.0), (0.52, 0.8), (0.78, 0.8), (0.78, 0.6), (0.94, 0.6), (0.94, 0.4)]
        return _with_roof(outline, [*(_ring(y, s) for y, s in steps), _ring(1, 0.4)], walls, 0.34)
    if kind == "corner":
        outline = _pilasters(_ANGLE, max(bays - 1, 1), 0.04)
        rings = [_ring(0, 1), _ring(cornice, 1), _ring(cornice, 1.02), _ring(1, 1.02)]
        moved = _with_roof(outline, rings, walls, 0.95)
        return moved.transformed(translation((-0.2, 0.0, -0.2)))
    if kind == "round":
        angle = np.arange(8 * detail) * (2.0 * np.pi / (8 * detail))
        outline = 0.46 * np.stack([np.cos(angle), -np.sin(angle)], axis=1)
        rings = [
            _ring(0, 1),
            _ring(shop, 1),
            _ring(shop, 0.97),
            _ring(0.9, 0.97),
            _ring(0.9, 0.85),
            _ring(1, 0.85),
        ]
        return _with_roof(outline, rings, walls, 0.78, smooth=True)
    if kind == "house":
        outline = _pilasters(_SQUARE * 0.9, bays, 0.02)
        eaves = 0.62
        rings = [_ring(0, 1), _ring(eaves, 1), _ring(eaves, 1.1), (1.0, 0.62, 0.0)]
        body = shapes.loft(outline, rings, (walls[0], walls[1] / eaves), ROOF_UV)
        chimneys = [
            _block((0.18, 0.9, 0.12), (0.09, 0.22, 0.09)),
            _block((-0.2, 0.9, -0.1), (0.09, 0.2, 0.09)),
        ]
        dormers = [
            _block((x, 0.74, side * 0.33), (0.11, 0.16, 0.16))
            for x in (-0.3, -0.1, 0.1, 0.3)
            for side in (-1.0, 1.0)
        ]
        return join([body, *chimneys, *dormers])
    outline = _divided(_SQUARE * (0.92, 0.62), bays)
    body = _with_roof(outline, [_ring(0, 1), _ring(1, 1)], walls, 0.93)
    return join([body, *_balconies(bays), _block((0.15, 0.97, 0.0), (0.2, 0.1, 0.2))])


def intersect_windows(
    building: MeshGeometry, windows: int, start: Floats, along: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return the middles (k, 3) of the windows that rays meet, and the vectors across and up a window and its
    frame.

    Rays begin at `start` (k, 3) and run along unit vectors (k, 3); each must meet the front of a wall. Their
    intersection with triangles is that of Möller and Trumbore (1997). The texture has `windows` x `windows`
    windows.
    """
    table = building.vertices[building.indices].reshape(-1, 3)
    uv = table["uv"].astype(np.float64)
    to_uv = np.stack([uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]], axis=-1)
    is_wall = np.linalg.det(to_uv) != 0.0  # what has no windows has one point of the texture
    corners = table["position"][is_wall].astype(np.float64)
    uv = uv[is_wall]
    to_uv = to_uv[is_wall]
    edge, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    parts_of_blocks: list[tuple[Indices, Floats]] = []
    for at in range(0, len(start), _RAYS):
        ray, begin = along[at : at + _RAYS, None], start[at : at + _RAYS, None] - corners[:, 0]
        across, turned = np.cross(ray, other), np.cross(begin, edge)
        area = (across * edge).sum(-1)
        u, v = (begin * across).sum(-1), (ray * turned).sum(-1)
        hit = (area > 0.0) & (u >= 0.0) & (v >= 0.0) & (u + v <= area)
        distance = np.where(hit, (other * turned).sum(-1) / np.where(hit, area, 1.0), np.inf)
        nearest = distance.argmin(1)
        share = np.stack([u, v], -1)[np.arange(len(u)), nearest] / area[np.arange(len(u)), nearest, None]
        parts_of_blocks.append((nearest, share))
    triangle, share = (np.concatenate(parts) for parts in zip(*parts_of_blocks, strict=True))
    sides = np.stack([edge, other], axis=-1)[triangle]
    met = uv[triangle, 0] + (to_uv[triangle] @ share[..., None])[..., 0]
    per_pane = sides @ np.linalg.inv(to_uv[triangle]) / windows
    middle = (np.floor(met * windows) + 0.5) / windows - met
    point = corners[triangle, 0] + (sides @ share[..., None])[..., 0]
    return point + windows * (per_pane @ middle[..., None])[..., 0], per_pane[..., 0], per_pane[..., 1]


def make_trees(count: int, detail: int, seed: int) -> MeshGeometry:
    """Make `count` trees on a lot of 1 x 1: trunks, and round or pointed crowns, with heights in metres."""
    rng = np.random.default_rng([seed, 5])
    crowns = (shapes.sphere(max(detail, 4)), shapes.cone(max(detail, 4)))
    trunk = shapes.cylinder(max(detail - 2, 3))
    side = int(np.ceil(np.sqrt(count)))
    parts = []
    for tree in range(count):
        spot = (np.array(divmod(tree, side)) + rng.uniform(0.3, 0.7, 2)) / side - 0.5
        height, crown = rng.uniform(5.0, 10.0), crowns[tree % 2]
        middle = (spot[0], 0.62 * height, spot[1])
        width = 0.16 * rng.uniform(0.8, 1.2)
        parts.append(crown.transformed(_box_transform(middle, (width, 0.75 * height, width))))
        parts.append(
            trunk.transformed(_box_transform((spot[0], 0.15 * height, spot[1]), (0.02, 0.3 * height, 0.02)))
        )
    return join(parts)


def make_street_light(detail: int) -> MeshGeometry:
    """Make a street light in metres: a post of 6 m, an arm along +x, and a head at (1.6, 5.9, 0)."""
    post = shapes.lathe([(0.14, 0.0), (0.1, 0.6), (0.06, 6.0), (0.0, 6.0)], max(detail, 4))
    arm = shapes.box().transformed(_box_transform((0.8, 5.97, 0.0), (1.7, 0.07, 0.07)))
    head = shapes.sphere(max(detail, 4)).transformed(_box_transform((1.6, 5.9, 0.0), (0.5, 0.22, 0.3)))
    return join([post, arm, head])


_SQUARE: Final = 0.5 * np.array([(1, 1), (1, -1), (-1, -1), (-1, 1)], np.float64)
_CHAMFERED: Final = np.array(
    [
        (0.48, 0.36),
        (0.48, -0.36),
        (0.36, -0.48),
        (-0.36, -0.48),
        (-0.48, -0.36),
        (-0.48, 0.36),
        (-0.36, 0.48),
        (0.36, 0.48),
    ]
)
_ANGLE: Final = np.array(
    [(0.66, 0.16), (0.66, -0.24), (-0.24, -0.24), (-0.24, 0.66), (0.16, 0.66), (0.16, 0.16)]
)
"""An L-shaped outline; its origin is in the corner where the wings meet, from where all of it can be seen."""


def _ring(y: float, scale: float) -> LoftRing:
    return (y, scale, scale)


def _divided(corners: Floats, parts: int) -> Floats:
    """Divide each edge of a closed polygon into `parts`."""
    after = np.roll(corners, -1, axis=0)
    share = (np.arange(parts) / parts)[None, :, None]
    return (corners[:, None] + share * (after - corners)[:, None]).reshape(-1, 2)


def _pilasters(corners: Floats, bays: int, depth: float) -> Floats:
    """Add `bays` pilasters of 4 points to each edge, which stand out from the centre by the fraction `depth`.

    Their sides point at the centre, so that all of the outline can still be seen from there.
    """
    along = np.roll(corners, -1, axis=0) - corners
    share = ((np.arange(bays)[:, None] + np.array([0.36, 0.36, 0.64, 0.64])) / bays).reshape(-1)
    out = np.tile([1.0, 1.0 + depth, 1.0 + depth, 1.0], bays)
    wall = (corners[:, None] + share[None, :, None] * along[:, None]) * out[None, :, None]
    return np.concatenate([corners[:, None], wall], axis=1).reshape(-1, 2)


def _with_roof(
    outline: Floats, rings: list[LoftRing], walls: tuple[float, float], inner: float, smooth: bool = False
) -> MeshGeometry:
    """Make a loft with a parapet around a flat roof; `inner` is the roof's scale."""
    top = rings[-1][0]
    low = top - 0.3 * (top - rings[-2][0]) if len(rings) > 2 else 0.97
    return shapes.loft(outline, [*rings, _ring(top, inner), _ring(low, inner)], walls, ROOF_UV, smooth)


def _balconies(bays: int) -> list[MeshGeometry]:
    """Make slabs on the two long sides, on four storeys."""
    x = (np.arange(bays) + 0.5) / bays * 0.92 - 0.46
    return [
        _block((float(at), y, side * 0.335), (0.6 / bays, 0.02, 0.06))
        for at in x
        for y in (0.2, 0.4, 0.6, 0.8)
        for side in (-1.0, 1.0)
    ]


def _block(centre: tuple[float, float, float], size: tuple[float, float, float]) -> MeshGeometry:
    part = shapes.box().transformed(_box_transform(centre, size))
    vertices = part.vertices.copy()
    vertices["uv"] = ROOF_UV
    return MeshGeometry(vertices, part.indices)


def _box_transform(centre: tuple[float, float, float], size: tuple[float, float, float]) -> Floats:
    return multiply(translation(centre), scaling(size))
