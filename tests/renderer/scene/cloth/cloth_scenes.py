"""Small cloths, and scenes with them."""

from __future__ import annotations

from typing import Any

import numpy as np

from renderer.content import BUILT_IN
from renderer.scene import Camera, Perspective, Scene, SceneBuilder, scaling, translation
from renderer.scene.cloth import ClothGrid, ClothSimulation, Fabric, Gust, Wind, make_cloth_grid

BREEZE = Wind(
    (0.2, 0.0, 0.6),
    (Gust((0.0, 0.2, 2.0), (0.3, 0.4, 0.0), 0.7), Gust((0.5, 0.0, 1.0), (1.1, 0.3, 0.0), 0.4)),
)


def make_square(rows: int = 6, columns: int = 5, size: float = 1.0, **options: Any) -> ClothGrid:
    """Make a cloth that hangs by its upper edge, in the plane of x and y."""
    x, y = np.meshgrid(np.linspace(-0.5, 0.5, columns), np.linspace(0.0, -1.0, rows))
    pinned = np.zeros((rows, columns), bool)
    pinned[0] = True
    return make_cloth_grid(size * np.stack([x, y, np.zeros_like(x)], 2), pinned, **options)


def advance(cloths: ClothSimulation, first: int, last: int, members: Any = None) -> None:
    """Ask for the steps from `first` to `last`."""
    members = np.arange(len(cloths)) if members is None else np.asarray(members)
    for number in range(first, last + 1):
        cloths.step(members, np.full(len(members), number))


def read_points(cloths: ClothSimulation) -> np.ndarray:
    """Return the points (k, n, 3) of all cloths."""
    vertices = cloths.vertices(np.arange(len(cloths)))
    return vertices["position"].reshape(len(cloths), -1, 3)


def make_scene(
    count: int = 3, *, gap: float = 3.0, shadows: bool = False, cast: bool = True, **options: Any
) -> Scene:
    """Make `count` cloths in a row along x, `gap` metres apart, 2 m above a floor, in front of them a
    camera."""
    builder = SceneBuilder("washing")
    cloth_grid = make_square(fabric=Fabric(density=0.2))
    floor = builder.add_material(base_color=(0.6, 0.6, 0.6))
    builder.add_objects(
        builder.add_node(scaling((40.0, 1.0, 40.0))), builder.add_mesh(BUILT_IN["plane"]()), floor
    )
    linen = builder.add_material(base_color=(0.9, 0.8, 0.6), double_sided=True)
    meshes = [builder.add_mesh(cloth_grid.make_mesh(), f"cloth {i}", cloth_grid.bounds) for i in range(count)]
    nodes = builder.add_nodes(translation([(gap * i, 2.0, 0.0) for i in range(count)]))
    hung = builder.add_objects(nodes, meshes, linen, casts_shadow=cast)
    builder.simulate(hung, ClothSimulation(count, cloth_grid, BREEZE, **options))
    builder.lights.sky = builder.lights.ground = (0.2, 0.2, 0.2)
    builder.lights.add_directional((-0.3, -1.0, -0.6), intensity=2.0, casts_shadow=shadows)
    builder.views["all"] = look((gap * (count - 1) / 2, 2.0, 5.0), (gap * (count - 1) / 2, 1.5, 0.0), 1.9)
    return builder.build()


def look(eye: tuple[float, float, float], aim: tuple[float, float, float], fov: float = 0.6) -> Camera:
    """Return a camera."""
    return Camera.look_at(eye, aim, projection=Perspective(fov=fov, near=0.1, far=50.0))


AWAY = look((0.0, 2.0, 5.0), (0.0, 40.0, 60.0))
"""A camera that sees nothing."""
