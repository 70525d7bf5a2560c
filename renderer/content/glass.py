"""Glass: coloured panes behind each other and balls of glass, between columns, to test objects seen through
others.

Panes stand in rows across the view, each of a colour and an opacity of its own, so that several cover each
other wherever one looks along the rows.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from renderer.content.shapes import BUILT_IN
from renderer.content.specs import SEED, Generator, Option
from renderer.scene.materials import AlphaMode
from renderer.scene.paths import make_path
from renderer.scene.scene import Scene
from renderer.scene.scene_builder import SceneBuilder
from rhi.math import Camera, Perspective, multiply, rotation, scaling, translation

_TINTS: Final = np.array(
    [(0.10, 0.45, 0.85), (0.90, 0.18, 0.12), (0.95, 0.72, 0.10), (0.12, 0.65, 0.30), (0.60, 0.20, 0.75)]
)
_GAP: Final = 1.6
"""Metres between two rows."""
_STEP: Final = 1.3
"""Metres between two panes of a row."""


def make_glass(panes: int, lights: int, seed: int) -> Scene:
    """Make a scene of `panes` panes and half as many balls of glass, lit by the sun and by `lights` point
    lights."""
    rng = np.random.default_rng([seed, 11])
    builder = SceneBuilder(f"glass:panes={panes},lights={lights},seed={seed}")
    builder.background = (0.16, 0.24, 0.36)
    rows = max(1, int(np.ceil(np.sqrt(panes / 2.0))))
    columns = -(-panes // rows)
    row, column = np.divmod(np.arange(panes), columns)
    x = (column - 0.5 * (columns - 1)) * _STEP + 0.3 * rng.uniform(-1, 1, panes)
    z = (0.5 * (rows - 1) - row) * _GAP
    half = np.array([0.5 * columns * _STEP + 2.0, 0.5 * rows * _GAP + 2.0])
    box, ball = (builder.add_mesh(BUILT_IN[name](), name) for name in ("box", "sphere"))

    floor = builder.add_material(base_color=(0.30, 0.28, 0.26), specular_color=(0.02, 0.02, 0.02))
    builder.add_objects(
        builder.add_node(multiply(translation((0, -0.1, 0)), scaling((2 * half[0], 0.2, 2 * half[1])))),
        box,
        floor,
    )
    stone = builder.add_material(base_color=(0.55, 0.48, 0.38), specular_color=(0.03, 0.03, 0.03))
    ends = np.arange(rows + 1) * _GAP - 0.5 * rows * _GAP
    for side in (-1.0, 1.0):
        positions = np.stack(
            [np.full(rows + 1, side * (half[0] - 1.2)), np.full(rows + 1, 1.2), ends], axis=1
        )
        builder.add_objects(
            builder.add_nodes(multiply(translation(positions), scaling((0.35, 2.4, 0.35)))), box, stone
        )

    tints = np.clip(
        _TINTS[rng.integers(0, len(_TINTS), panes)] + rng.uniform(-0.08, 0.08, (panes, 3)), 0.02, 1.0
    )
    clear = rng.uniform(0.35, 0.7, panes)
    materials = [
        builder.add_material(
            base_color=(*tint, opacity),
            alpha_mode=AlphaMode.BLEND,
            specular_color=(0.5, 0.5, 0.5),
            shininess=120.0,
        )
        for tint, opacity in zip(tints.tolist(), clear.tolist(), strict=True)
    ]
    height = rng.uniform(1.3, 2.1, panes)
    stands = multiply(
        translation(np.stack([x, 0.5 * height, z], axis=1)),
        rotation((0, 1, 0), rng.uniform(-0.25, 0.25, panes)),
    )
    cut = scaling(np.stack([np.ones(panes), height, np.full(panes, 0.03)], axis=1))
    builder.add_objects(builder.add_nodes(multiply(stands, cut)), box, np.array(materials))
    balls = panes // 2
    size = rng.uniform(0.4, 0.8, balls)
    where = np.stack(
        [rng.uniform(-1, 1, balls) * (half[0] - 2.0), 0.5 * size, z[:balls] + 0.5 * _GAP], axis=1
    )
    nodes = builder.add_nodes(multiply(translation(where), scaling(np.stack([size] * 3, axis=1))))
    builder.add_objects(nodes, ball, np.array(materials)[::-1][:balls])

    builder.lights.sky, builder.lights.ground = (0.20, 0.24, 0.30), (0.08, 0.07, 0.06)
    builder.lights.add_directional((-0.5, -0.9, -0.4), (1.0, 0.95, 0.88), 0.9)
    if lights:
        spread = rng.uniform(-1, 1, (lights, 2)) * (half - 1.0)
        positions = np.stack([spread[:, 0], rng.uniform(0.8, 2.4, lights), spread[:, 1]], axis=1)
        hue = 2.0 * np.pi * (rng.random((lights, 1)) + np.array([0.0, 1.0, 2.0]) / 3.0)
        builder.lights.add_points(positions, 3.0, 0.55 + 0.45 * np.cos(hue), 1.5)
    projection = Perspective(near=0.05)
    builder.views["along"] = Camera.look_at((0.8, 1.9, half[1] + 0.9), (0.0, 0.7, 0.0), projection=projection)
    builder.views["overview"] = Camera.look_at(
        (half[0], 3.0, half[1] + 1.5), (0.0, 0.6, 0.0), projection=projection
    )
    way = np.array([(0.2, 1.4, half[1] + 2.0), (0.2, 1.4, -half[1] - 1.0)])
    builder.paths["ground"] = make_path(way, projection, rounding=_GAP, ahead=_GAP)
    builder.paths["sky"] = make_path(
        np.add(way, (0.0, 2.0, 0.0)), projection, _GAP, ahead=2.0 * _GAP, sink=2.0
    )
    return builder.build()


GLASS: Final = Generator(
    "glass",
    "coloured panes behind each other, and balls of glass; ground and sky paths",
    (
        Option("panes", 24, "how many panes", 1, 10_000),
        Option("lights", 12, "coloured lights between them", 0, 4_096),
        SEED,
    ),
    make_glass,
)
