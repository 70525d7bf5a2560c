"""The grid: many copies of one mesh, a built-in one or a model file, in a square on the ground."""

from __future__ import annotations

from typing import Final

import numpy as np

from renderer.content.models import read_geometry
from renderer.content.shapes import BUILT_IN
from renderer.content.specs import SEED, Generator, Option
from renderer.scene.camera import Camera, Perspective
from renderer.scene.meshes import MeshGeometry
from renderer.scene.paths import make_path
from renderer.scene.scene import Scene, SceneBuilder
from renderer.scene.transforms import multiply, rotation, scaling, translation

__rhi_internal__ = True

_COLORS: Final = (
    (0.75, 0.22, 0.17), (0.88, 0.58, 0.16), (0.30, 0.56, 0.28), (0.16, 0.48, 0.60), (0.42, 0.30, 0.62),
    (0.80, 0.74, 0.62),
)  # fmt: skip


def make_grid(mesh: str, count: int, spacing: float, seed: int) -> Scene:
    """Make a scene of `count` copies of `mesh`, scaled to fit a metre, `spacing` metres apart on y = 0."""
    rng = np.random.default_rng([seed, 3])
    geometry = _unit(BUILT_IN[mesh]() if mesh in BUILT_IN else read_geometry(mesh))
    builder = SceneBuilder(f"grid:mesh={mesh},count={count},spacing={spacing:g},seed={seed}")
    builder.background = (0.30, 0.36, 0.44)
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
    places = np.stack([column - 0.5 * (side - 1), np.zeros(count), row - 0.5 * (side - 1)], axis=1) * spacing
    nodes = builder.add_nodes(multiply(translation(places), rotation((0, 1, 0), rng.uniform(0, 6.28, count))))
    builder.add_objects(
        nodes, builder.add_mesh(geometry, mesh), materials[rng.integers(0, len(_COLORS), count)]
    )

    half = 0.5 * side * spacing
    builder.lights.add_directional((-0.5, -0.8, -0.35), (1.0, 0.95, 0.88), 1.8)
    builder.lights.add_point((0.0, 0.5 * half + 2.0, half), 2.0 * half + 4.0, (0.6, 0.75, 1.0), half * half)
    lens = Perspective(near=0.05)
    builder.views["overview"] = Camera.look_at(
        (0.9 * half, 0.8 * half + 0.9, 1.5 * half + 0.6), (0, 0.3, 0), projection=lens
    )
    aisle = (side // 2 - 0.5 * side) * spacing
    ends = np.array([(aisle, 0.0, half + 1.5 * spacing), (aisle, 0.0, -half - 0.5 * spacing)])
    low, high = np.array([0.0, 0.6, 0.0]), np.array([0.0, 1.5 + 0.4 * half, 0.0])
    builder.paths["ground"] = make_path(ends + low, lens, rounding=spacing, ahead=spacing)
    builder.paths["sky"] = make_path(ends + high, lens, spacing, ahead=half + 1.0, sink=high[1])
    return builder.build()


GRID: Final = Generator(
    "grid",
    "copies of one mesh in a square; ground and sky paths",
    (
        Option("mesh", "torus", f"{', '.join(BUILT_IN)}, or a model file without a comma in its name"),
        Option("count", 400, "how many copies", 1, 1_000_000),
        Option("spacing", 1.5, "metres between copies", 0.1, 1e4),
        SEED,
    ),
    make_grid,
)


def _unit(geometry: MeshGeometry) -> MeshGeometry:
    """Scale a mesh so that its longest side is a metre, and place it on y = 0 over the origin."""
    lower, upper = geometry.bounds
    middle = 0.5 * (lower + upper) * (1.0, 0.0, 1.0) + lower * (0.0, 1.0, 0.0)
    size = float((upper - lower).max()) or 1.0
    return geometry.transformed(multiply(scaling(np.full(3, 1.0 / size)), translation(-middle)))
