"""Cracks: surfaces without gaps, whose background must not show between their triangles.

Rasterisation promises that triangles with the same edge, both of its ends, leave no pixel out. It promises
nothing where an edge is split by a vertex on one side only (a T-junction): corners are rounded to parts of a
pixel, the vertex moves off the edge, and a pixel whose centre lies between shows what is behind. So such
pixels must be close to the edge, closer than corners are rounded; and terrain must not have such edges.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.content.shapes import grid_mesh
from renderer.lab.exam.case import CaseResult, Measures, largest_error
from renderer.lab.exam.scenes import make_camera, shows_something
from renderer.renderer import Renderer
from renderer.scene import Camera, Scene, SceneBuilder, make_height_field
from renderer.scene.arrays import Floats
from renderer.tessellation import TessellationSettings
from rhi import Device

SIZE: Final = (256, 144)
_STRIPS: Final = 128
_COLUMNS: Final = np.linspace(-8.0, 8.0, 17)
_BEFORE: Final = [
    make_camera(eye, (0.1, 0.0, 0.0), fov=0.8)
    for eye in ((0.3, 0.2, 5.0), (1.6, 1.1, 4.6), (-1.3, 0.7, 3.1), (0.4, -0.9, 2.2))
]
_FIELD, _LOWEST = 256.0, 6.0  # metres: the sides of the hills' field, and how deep it goes
_ABOVE: Final = [
    make_camera(eye, aim, fov=0.8)
    for eye, aim in (
        ((0, 90, 0), (1, 0, 1)), ((60, 45, 40), (30, 0, 10)), ((-60, 30, 60), (-45, 0, 35)),
        ((10, 22, 50), (0, 0, 25)), ((-80, 45, -10), (-40, 0, 0)), ((90, 20, 0), (200, 0, 0)),
    )
]  # fmt: skip


def points_on_seam(number: int, x: Floats) -> Floats:
    """Points (k, 3) at `x` (k,) of the line between two strips; all are exactly on it in float32."""
    return np.stack([x, 0.125 * (number - _STRIPS // 2) + x / 32.0, 0.0 * x], axis=1)


def make_strips(*, are_split: bool) -> Scene:
    """Make a wall of strips; each second one has a vertex at each metre of its edges, or all have if edges
    `are_split` on both sides."""
    builder = _make_builder("strips")
    node, greys = builder.add_node(), [builder.add_material(base_color=(grey,) * 3) for grey in (0.5, 0.8)]
    for number in range(_STRIPS):
        x = _COLUMNS if are_split or number % 2 else _COLUMNS[[0, -1]]
        grid = np.stack([points_on_seam(number, x), points_on_seam(number + 1, x)])
        builder.add_objects(node, builder.add_mesh(grid_mesh(grid)), greys[number % 2])
    return builder.build()


def make_hills() -> Scene:
    """Make hills whose triangles are chosen for the view, below all eyes but the last."""
    builder = _make_builder("hills")
    along = np.linspace(0.0, 9.0, 129)
    heights = 6.0 * np.sin(2.0 * along)[:, None] * np.cos(2.6 * along) + np.random.default_rng(1).random(
        (129, 129)
    )
    field = builder.add_height_field(make_height_field(heights, _FIELD))
    builder.add_objects(builder.add_node(), field, builder.add_material(base_color=(0.5, 0.5, 0.5)))
    return builder.build()


def _make_builder(name: str) -> SceneBuilder:
    """Begin a scene of grey objects before a red background."""
    builder = SceneBuilder(name)
    builder.background = (1.0, 0.0, 0.0)
    builder.lights.sky = builder.lights.ground = (0.6, 0.6, 0.6)
    builder.lights.add_directional((-0.5, -0.8, -0.6), (0.0, 1.0, 0.3))
    return builder


def background_pixels(image: NDArray[Any]) -> NDArray[np.bool_]:
    """The pixels (h, w) that show the background, a mask."""
    return np.asarray(image[..., 0] > 200) & (image[..., 1] < 50)


def distances_to_seams(camera: Camera, pixels: NDArray[np.bool_]) -> Floats:
    """The distances (k,) of the centres of `pixels` (h, w) from the nearest line between strips, in
    pixels."""
    width, height = SIZE
    matrix = camera.projection.matrix[[0, 1, 3], :3] @ camera.rotation
    screen = (
        np.array([[0.5 * width, 0.0, 0.5 * width], [0.0, -0.5 * height, 0.5 * height], [0.0, 0.0, 1.0]])
        @ matrix
    )
    ends = [[points_on_seam(number, _COLUMNS[[at]])[0] for at in (0, -1)] for number in range(_STRIPS + 1)]
    first, last = np.moveaxis((np.array(ends) - camera.position) @ screen.T, 1, 0)
    lines = np.cross(first, last)
    y, x = np.nonzero(pixels)
    away = (
        np.stack([x + 0.5, y + 0.5, np.ones(len(x))], axis=1) @ lines.T / np.hypot(lines[:, 0], lines[:, 1])
    )
    return np.asarray(np.abs(away).min(axis=1))


def covers_view(camera: Camera) -> bool:
    """True if the rays of all pixels meet the field: those of the corners do so at its lowest height."""
    x, y = np.array([(-1, -1, 1, 1), (-1, 1, -1, 1)]) / np.diag(camera.projection.matrix)[:2, None]
    rays = np.stack([x, y, -np.ones(4)], axis=1) @ camera.rotation
    ends = camera.position - rays * ((camera.position[1] + _LOWEST) / rays[:, 1:2])
    return bool((rays[:, 1] < 0.0).all() and (np.abs(ends[:, ::2]) < 0.5 * _FIELD).all())


def measure_split_edges(device: Device) -> CaseResult:
    """Draw strips whose edges are split on one side and on both, and measure how far from an edge the
    background shows."""
    images, numbers, error = dict[str, NDArray[Any]](), dict[str, object](), 0.0
    for title, are_split in (("one side", False), ("both sides", True)):
        scene, count = make_strips(are_split=are_split), 0
        with Renderer(device, scene, size=SIZE, visibility="frustum") as renderer:
            for number, camera in enumerate(_BEFORE):
                image = images[f"{title}, {number}"] = renderer.render(camera).image.read()
                through = background_pixels(image)
                count += int(through.sum())
                away = distances_to_seams(camera.with_aspect(SIZE[0] / SIZE[1]), through)
                error = largest_error(error, float(away.max(initial=0.0)))
        numbers[f"pixels through edges that are split on {title}"] = count
    holds = {"edges that are split on both sides are tight": count == 0, **shows_something(images.values())}
    return CaseResult(error, numbers, holds, lambda: images)


def measure_terrain_levels(device: Device) -> CaseResult:
    """Look down on hills from several positions, and count the pixels in which the background shows: each ray
    meets the field, whose triangles are of many sizes. The last eye looks over the field's edge, and must see
    the background."""
    scene, images = make_hills(), dict[str, NDArray[Any]]()
    sizes, fills, counts = list[int](), list[bool](), list[int]()
    with Renderer(device, scene, size=SIZE, visibility="frustum") as renderer:
        for number, camera in enumerate(_ABOVE):
            fills.append(covers_view(camera.with_aspect(SIZE[0] / SIZE[1])))
            renderer.tessellator.settings = TessellationSettings(edge_pixels=(6.0, 24.0)[number % 2])
            image = images[f"eye {number}"] = renderer.render(camera).image.read()
            counts.append(int(background_pixels(image).sum()))
            selected_indices = renderer.resources.indices.read(
                0, 3 * renderer.tessellator.surfaces[0].read_count()
            )
            corners = scene.meshes.vertices["position"][selected_indices.reshape(-1, 3), ::2].astype(
                np.float64
            )
            sizes.append(len(np.unique(np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])).round(3))))
    holds = {
        "triangles are of four sizes or more": min(sizes) >= 4,
        "all rays meet the field, but those of the last eye": all(fills[:-1]) and not fills[-1],
        "the last eye sees the background": counts[-1] > 1000,
    }
    numbers = {"pixels of background, eye by eye": counts, "sizes of triangles": sizes}
    return CaseResult(sum(counts[:-1]), numbers, holds | shows_something(images.values()), lambda: images)


MEASURES: Final[Measures] = {78: measure_split_edges, 79: measure_terrain_levels}
