"""Tessellated meshes: without cracks at their edges, seams and creases, and as smooth as the surface that is meant.

The eye is inside a closed body, so the background shows through any crack. Triangles are read back, too: an edge
has another triangle on its other side, at positions that are equal bit by bit.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.content.shapes import box, cylinder, sphere
from renderer.lab.exam.case import CaseResult, Measures, largest_error
from renderer.lab.exam.crack_cases import background_pixels
from renderer.lab.exam.scenes import make_camera, shows_something
from renderer.renderer import Renderer
from renderer.scene import Camera, MeshGeometry, Scene, SceneBuilder, scaling, tessellate
from renderer.scene.arrays import Floats, Indices
from renderer.tessellation import TessellationSettings
from rhi import Device

SIZE: Final = (256, 144)
_RADIUS: Final = 0.5
_BODIES: Final = {"sphere": sphere(12), "box": box(), "cylinder": cylinder(8)}
_INSIDE: Final = [
    make_camera(eye, aim, fov=1.6, near=0.01)
    for eye, aim in (((0.4, 0.1, 0.3), (-1.0, 0.2, -0.6)), ((-0.7, 0.5, 0.2), (0.2, -1.0, 0.4)))
]
_OUTSIDE: Final = [
    make_camera(eye, (0.02, 0.01, 0.0), fov=0.5)
    for eye in ((0.0, 0.3, 2.6), (2.1, 1.4, 0.8), (-0.3, -2.5, 0.4), (-1.7, 0.1, -1.6))
]


def _make_scene(
    geometry: MeshGeometry, size: float, heights: Floats | None, *, is_smooth: bool = True
) -> Scene:
    """Make a grey body before a red background, seen from both sides; if not `is_smooth`, of flat triangles."""
    builder = SceneBuilder("body")
    builder.background = (1.0, 0.0, 0.0)
    builder.lights.sky = builder.lights.ground = (0.6, 0.6, 0.6)
    builder.lights.add_directional((-0.5, -0.8, -0.6), (0.0, 1.0, 0.3))
    surface = tessellate(geometry, halvings=4, heights=heights, smoothness=float(is_smooth))
    material = builder.add_material(base_color=(0.5, 0.5, 0.5), double_sided=True)
    builder.add_objects(
        builder.add_node(scaling((size,) * 3)), builder.add_tessellated_mesh(surface), material
    )
    return builder.build()


def read_triangles(renderer: Renderer) -> Indices:
    """The triangles (t, 3) of the only surface, as they were drawn last."""
    count = 3 * renderer.tessellator.surfaces[0].read_count()
    return np.asarray(renderer.resources.indices.read(0, count).astype(np.int64).reshape(-1, 3))


def count_open_edges(positions: NDArray[np.float32], triangles: Indices) -> int:
    """Count the edges that no other triangle has the other way round, at positions of equal bits."""
    bits = np.ascontiguousarray(positions).view(np.uint32)
    _, point = np.unique(bits, axis=0, return_inverse=True)
    corner = point.reshape(-1)[triangles]
    corner = corner[(corner != np.roll(corner, 1, axis=1)).all(axis=1)]  # at a pole edges are points
    begin, end = corner.reshape(-1).astype(np.int64), np.roll(corner, -1, axis=1).reshape(-1).astype(np.int64)
    return int((~np.isin(begin * len(bits) + end, end * len(bits) + begin)).sum())


def measure_closed_bodies(device: Device) -> CaseResult:
    """Look around in bodies with bumps, whose texture coordinates and normals have seams, and count the pixels of
    background and the edges that are open."""
    heights = 0.03 * np.random.default_rng(5).random((24, 24))
    images, counts, opened, sizes = dict[str, NDArray[Any]](), list[int](), list[int](), list[int]()
    for title, geometry in _BODIES.items():
        scene = _make_scene(geometry, 4.0, heights)
        with Renderer(device, scene, size=SIZE, visibility="frustum") as renderer:
            for number, camera in enumerate(_INSIDE):
                renderer.tessellator.settings = TessellationSettings(edge_pixels=(4.0, 20.0)[number % 2])
                image = images[f"{title}, eye {number}"] = renderer.render(camera).image.read()
                counts.append(int(background_pixels(image).sum()))
                triangles = read_triangles(renderer)
                opened.append(count_open_edges(scene.meshes.vertices["position"], triangles))
                sizes.append(len(triangles))
            seen = int(
                background_pixels(renderer.render(make_camera((0, 0, 9), (0, 0, 0))).image.read()).sum()
            )
    holds = {
        "views have different triangles": len(set(sizes)) == len(sizes),
        "an eye outside sees the background": seen > 1000,
    }
    numbers = {"pixels of background": counts, "open edges": opened, "triangles": sizes}
    return CaseResult(
        sum(counts) + sum(opened), numbers, holds | shows_something(images.values()), lambda: images
    )


def measure_outline(image: NDArray[np.uint8], camera: Camera) -> float:
    """The largest distance in pixels from a sphere's outline of a pixel on its wrong side."""
    camera = camera.with_aspect(SIZE[0] / SIZE[1])
    x, y = np.meshgrid(*((np.arange(count) + 0.5) / count * 2.0 - 1.0 for count in SIZE))
    scale = np.diag(camera.projection.matrix)
    rays = np.stack([x / scale[0], -y / scale[1], -np.ones_like(x)], axis=-1) @ camera.rotation
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    away = float(np.linalg.norm(camera.position))
    angle = np.arccos(np.clip(rays @ -camera.position / away, -1.0, 1.0)) - np.arcsin(_RADIUS / away)
    wrong = background_pixels(image) != (angle > 0.0)
    return float(np.abs(angle)[wrong].max(initial=0.0)) * 0.5 * SIZE[1] * float(scale[1])


def measure_smooth_ball(device: Device) -> CaseResult:
    """Draw a sphere of 120 triangles as a smooth surface, and compare its outline with the sphere's."""
    images, errors = dict[str, NDArray[Any]](), {True: 0.0, False: 0.0}
    for is_smooth in errors:
        scene = _make_scene(sphere(12), 1.0, None, is_smooth=is_smooth)
        with Renderer(device, scene, size=SIZE, visibility="frustum") as renderer:
            renderer.tessellator.settings = TessellationSettings(edge_pixels=4.0)
            for number, camera in enumerate(_OUTSIDE):
                title = f"{'smooth' if is_smooth else 'flat'}, eye {number}"
                image = images[title] = renderer.render(camera).image.read()
                errors[is_smooth] = largest_error(errors[is_smooth], measure_outline(image, camera))
    numbers = {"smooth, pixels": errors[True], "flat triangles, pixels": errors[False]}
    holds = {"flat triangles are off by 2 pixels": errors[False] > 2.0}
    return CaseResult(errors[True], numbers, holds | shows_something(images.values()), lambda: images)


MEASURES: Final[Measures] = {106: measure_closed_bodies, 107: measure_smooth_ball}
