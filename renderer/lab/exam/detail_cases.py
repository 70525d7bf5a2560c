"""Levels of detail, compared with rays in float64 to the full meshes.

Bodies that emit light stand before nothing, so a pixel is covered or not. Where it isn't as the rays say, the error is
its distance from the nearest pixel that is as it is, less the pixel that sampling may take.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from renderer.content.shapes import bumpy_sphere
from renderer.lab.exam.case import CaseImage, CaseResult, Measures, largest_error
from renderer.lab.exam.scenes import shows_something
from renderer.lab.measure.ray_tracer import RayTracer
from renderer.renderer import Renderer
from renderer.scene import Camera, Orthographic, Perspective, Projection, Scene, SceneBuilder
from renderer.visibility import find_missing_feature
from rhi import Device
from rhi.math import multiply, rotation, scaling, translation

_SIZE: Final = (160, 90)
_PIXELS: Final = 8.0
_ALGORITHMS: Final = ("frustum", "two_pass", "depth_pyramid")
"""The CPU chooses the levels of the first one, the device those of the others."""
_VIEWS: Final[dict[str, tuple[tuple[float, ...], tuple[float, ...], Projection]]] = {
    "along a row": ((0.0, 2.5, 6.0), (0.5, 0.0, -20.0), Perspective(0.9, 16 / 9, near=0.1)),
    "from within a body": ((0.3, 0.2, -5.0), (1.0, 0.0, -30.0), Perspective(0.6, 16 / 9, near=0.1)),
    "parallel": ((4.0, 9.0, 6.0), (0.5, 0.0, -14.0), Orthographic(16.0, 16 / 9, 0.1, 90.0)),
}


@cache
def make_row() -> Scene:
    """Make a row of turned and stretched bodies with levels."""
    builder = SceneBuilder("levels")
    builder.lights.sky = builder.lights.ground = builder.background = (0.0, 0.0, 0.0)
    mesh = builder.add_mesh(bumpy_sphere(24, 0.15), levels=5)
    material = builder.add_material(emission=1.0)
    for number in range(12):
        stretch = scaling(np.array([1.0 + 0.1 * number, 1.0 if number % 3 else -0.7, 1.4]))
        turned = multiply(rotation((0.3, 1.0, 0.1), 0.7 * number), stretch)
        at = (1.9 * (number % 2) - 1.0 + 0.2 * number, 0.0, 1.5 - 1.4 * number**1.4)
        builder.add_objects(builder.add_node(multiply(translation(at), turned)), mesh, material)
    return builder.build()


def make_view(title: str) -> Camera:
    """Return the camera of a view."""
    eye, target, projection = _VIEWS[title]
    return Camera.look_at(eye, target, projection=projection)


@cache  # the same for each device
def trace_row(title: str) -> NDArray[np.bool_]:
    """The pixels (h, w) that rays to the full meshes hit."""
    covered: NDArray[np.bool_] = RayTracer(make_row()).draw(make_view(title), _SIZE).max(axis=2) > 0.0
    return covered


def _measure_distances(covered: NDArray[np.bool_], expected: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return for each pixel by how much an edge has moved there, 0 where none has."""
    off = np.zeros(covered.shape)
    for is_covered in (False, True):
        alike = np.argwhere(expected == is_covered)
        for y, x in np.argwhere((covered == is_covered) & (expected != is_covered)):
            nearest = np.hypot(*(alike - (y, x)).T).min() if len(alike) else np.inf
            off[y, x] = max(float(nearest) - 1.0, 0.0)
    return off


def measure_levels(device: Device) -> CaseResult:
    """Draw the views within an error, with levels that the CPU and that the device chooses, and measure how far edges
    have moved."""
    numbers, holds, images = dict[str, object](), dict[str, bool](), dict[str, CaseImage]()
    error, scene = 0.0, make_row()
    for name in _ALGORITHMS:
        if find_missing_feature(name, device) is not None:
            continue
        with Renderer(device, scene, size=_SIZE, visibility=name, technique="forward") as renderer:
            for title in _VIEWS:
                counts, drawn, part = [], [], f"{title}, {name}"
                for renderer.detail_error in (_PIXELS, 0.0):
                    for _ in range(2):  # the first frame of a view may draw what another one showed
                        result = renderer.render(make_view(title))
                    drawn.append(result.image.read())
                    counts.append(result.statistics.triangles)
                off, finest = (
                    _measure_distances(image[..., :3].max(axis=2) > 0, trace_row(title)) for image in drawn
                )
                numbers[f"{part}: pixels off"] = round(float(off.max()), 3)
                numbers[f"{part}: triangles"] = counts[0]
                error = largest_error(error, float(off.max()))
                holds |= dict(_check_view(part, drawn, counts, finest))
                images |= {part: drawn[0], f"{part}, full": drawn[1], f"{part}, off": off}
    return CaseResult(error, numbers, holds, lambda: images)


def _check_view(
    part: str, drawn: list[NDArray[np.uint8]], counts: list[int], finest: NDArray[np.float64]
) -> Iterator[tuple[str, bool]]:
    yield f"{part}: levels have fewer triangles", counts[0] < counts[1]
    yield f"{part}: levels are seen", bool((drawn[0] != drawn[1]).any())
    yield f"{part}: full meshes are where the rays are", float(finest.max()) == 0.0
    for description, is_true in shows_something(drawn).items():
        yield f"{part}: {description}", is_true


MEASURES: Final[Measures] = {93: measure_levels}
