"""The grid: many copies of one mesh, a built-in one or a model file, in a square on the ground.

With lights it is the scene of Wilks's tests (2019): objects times lights, where nothing changes but their
numbers. The view `field` sees all lights, and neither it nor any light moves when there are more lights or,
up to 256, more copies.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from renderer.content.models import read_geometry
from renderer.content.shapes import BUILT_IN
from renderer.content.specs import SEED, Generator, Option
from renderer.scene.meshes import MeshGeometry
from renderer.scene.paths import make_path
from renderer.scene.scene import Scene
from renderer.scene.scene_builder import SceneBuilder
from rhi.math import Camera, Perspective, multiply, rotation, scaling, translation

_COLORS: Final = (
    (0.75, 0.22, 0.17), (0.88, 0.58, 0.16), (0.30, 0.56, 0.28), (0.16, 0.48, 0.60), (0.42, 0.30, 0.62),
    (0.80, 0.74, 0.62),
)  # fmt: skip


_FIELD: Final = 16
"""Copies along each side of the area over which lights are spread."""

_STRIDES: Final = np.array([0.7548776662466927, 0.5698402909980532])
"""Those of the R2 sequence, which fills a square evenly, however many of its points are used (Roberts,
2018)."""


def make_grid(
    mesh: str, count: int, spacing: float, lights: int, levels: int, meshlet_size: int, seed: int
) -> Scene:
    """Make a scene of `count` copies of `mesh`, scaled to fit a metre, `spacing` metres apart on y = 0. They
    are lit by the sun, or by `lights` coloured lights above them. Far copies are drawn as one of up to `levels`
    simplified versions, and the mesh is cut into meshlets of at most `meshlet_size` triangles."""
    rng = np.random.default_rng([seed, 3])
    geometry = _unit(BUILT_IN[mesh]() if mesh in BUILT_IN else read_geometry(mesh))
    options = f"mesh={mesh},count={count},spacing={spacing:g},seed={seed}"
    options += f",levels={levels}" if levels else ""
    options += f",meshlet_size={meshlet_size}" if meshlet_size else ""
    builder = SceneBuilder(f"grid:lights={lights},{options}" if lights else f"grid:{options}")
    materials = np.array(
        [
            builder.add_material(
                base_color=c, specular_color=(0.3, 0.3, 0.3), shininess=48.0, rim_strength=0.2
            )
            for c in _COLORS
        ]
    )
    side = int(np.ceil(np.sqrt(count)))
    row, column = np.divmod(np.arange(count), side)
    positions = (
        np.stack([column - 0.5 * (side - 1), np.zeros(count), row - 0.5 * (side - 1)], axis=1) * spacing
    )
    nodes = builder.add_nodes(
        multiply(translation(positions), rotation((0, 1, 0), rng.uniform(0, 6.28, count)))
    )
    builder.add_objects(
        nodes,
        builder.add_mesh(geometry, mesh, levels=levels, meshlet_size=meshlet_size),
        materials[rng.integers(0, len(_COLORS), count)],
    )

    half = 0.5 * side * spacing
    projection = Perspective(near=0.05)
    if lights:
        builder.background = (0.006, 0.007, 0.012)
        _add_lights(builder, lights, max(_FIELD, side) * spacing, spacing, seed)
        far = 0.5 * max(_FIELD, side) * spacing + 1.0
        builder.views["field"] = Camera.look_at(
            (0.0, 1.15 * far, 1.5 * far), (0.0, 0.0, 0.1 * far), projection=projection
        )
    else:
        builder.background = (0.30, 0.36, 0.44)
        builder.lights.add_directional((-0.5, -0.8, -0.35), (1.0, 0.95, 0.88), 1.8)
        light_position = (0.0, 0.5 * half + 2.0, half)
        builder.lights.add_point(light_position, 2.0 * half + 4.0, (0.6, 0.75, 1.0), half * half)
    builder.views["overview"] = Camera.look_at(
        (0.9 * half, 0.8 * half + 0.9, 1.5 * half + 0.6), (0, 0.3, 0), projection=projection
    )
    aisle = (side // 2 - 0.5 * side) * spacing
    ends = np.array([(aisle, 0.0, half + 1.5 * spacing), (aisle, 0.0, -half - 0.5 * spacing)])
    low, high = np.array([0.0, 0.6, 0.0]), np.array([0.0, 1.5 + 0.4 * half, 0.0])
    builder.paths["ground"] = make_path(ends + low, projection, rounding=spacing, ahead=spacing)
    builder.paths["sky"] = make_path(ends + high, projection, spacing, ahead=half + 1.0, sink=high[1])
    return builder.build()


GRID: Final = Generator(
    "grid",
    "copies of one mesh in a square; ground and sky paths",
    (
        Option("mesh", "torus", f"{', '.join(BUILT_IN)}, or a model file without a comma in its name"),
        Option("count", 400, "how many copies", 1, 1_000_000),
        Option("spacing", 1.5, "metres between copies", 0.1, 1e4),
        Option("lights", 0, "coloured lights above the copies; 0: the sun", 0, 65_536),
        Option("levels", 0, "simplified versions of the mesh at most, for far copies", 0, 12),
        Option(
            "meshlet_size", 0, "the most triangles of a meshlet, 8 or more; 0: the mesh is whole", 0, 4096
        ),
        SEED,
    ),
    make_grid,
)


def _add_lights(builder: SceneBuilder, count: int, width: float, spacing: float, seed: int) -> None:
    """Add point lights over a square around the origin, the first one above its middle."""
    draws = np.random.default_rng([seed, 7]).random((count, 2))
    xz = ((0.5 + np.arange(count)[:, None] * _STRIDES) % 1.0 - 0.5) * width
    positions = np.stack([xz[:, 0], 1.0 + spacing * (0.4 + 0.6 * draws[:, 0]), xz[:, 1]], axis=1)
    hue = 2.0 * np.pi * (draws[:, 1, None] + np.array([0.0, 1.0, 2.0]) / 3.0)
    lights = builder.lights
    lights.sky, lights.ground = (0.05, 0.055, 0.07), (0.03, 0.028, 0.025)
    lights.add_points(positions, 4.0 * spacing, 0.52 + 0.48 * np.cos(hue), 1.3 * spacing**2)


def _unit(geometry: MeshGeometry) -> MeshGeometry:
    """Scale a mesh so that its longest side is a metre, and place it on y = 0 over the origin."""
    lower, upper = geometry.bounds
    middle = 0.5 * (lower + upper) * (1.0, 0.0, 1.0) + lower * (0.0, 1.0, 0.0)
    size = float((upper - lower).max()) or 1.0
    return geometry.transformed(multiply(scaling(np.full(3, 1.0 / size)), translation(-middle)))
