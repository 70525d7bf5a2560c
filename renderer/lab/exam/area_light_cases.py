"""Rectangles and tubes as lights, compared with rays in float64 to all parts of them.

Scattered light is exact but for the ends of tubes, so the error counts pixels of matt surfaces. Highlights are fits:
a mean over metals bounds them.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Final, NamedTuple

import numpy as np

from renderer.content import BUILT_IN
from renderer.lab.exam.case import CaseImage, CaseResult, Measures, largest_error
from renderer.lab.exam.ray_traced_cases import draw
from renderer.lab.exam.scenes import shows_something
from renderer.lab.measure.ray_tracer import RayTracer
from renderer.scene import Camera, Perspective, Scene, SceneBuilder
from renderer.scene.arrays import Floats
from rhi import Device
from rhi.math import multiply, scaling, translation

_SIZE: Final = (24, 15)
_OFFSETS: Final = ((0.5, 0.5), (0.35, 0.35), (0.65, 0.65))
_EDGE: Final = 5.0
"""Levels by which the samples of a pixel differ at an edge."""
_METAL_MEAN: Final = 3.0
"""Levels that highlights are off in the mean, at most."""


class AreaView(NamedTuple):
    """A scene before a camera: its lights, what it is made of, the metres of its unit, where it is, and the technique
    that draws it."""

    lights: tuple[str, ...]
    roughness: float | None = None
    unit: float = 1.0
    offset: float = 0.0
    technique: str = "forward"


_VIEWS: Final = {
    "a panel and a tube": AreaView(("panel", "tube")),
    "the same in millimetres, 10⁴ m away": AreaView(("panel", "tube"), None, 1e-3, 1e4, "deferred"),
    "a panel in the plane of a wall, and a strip": AreaView(("flush", "strip"), technique="clustered"),
    "metal": AreaView(("panel", "tube"), 0.3),
    "rough metal": AreaView(("panel", "tube"), 0.7, technique="light_pre_pass"),
}


def make_area_scene(view: AreaView) -> tuple[Scene, Camera]:
    """Make a floor, a wall and a ball that stands close to the lights, and a camera before them."""
    builder, unit = SceneBuilder("areas"), view.unit
    middle = np.full(3, view.offset)
    builder.lights.sky = builder.lights.ground = builder.background = (0.0, 0.0, 0.0)
    if view.roughness is None:
        material = builder.add_material(base_color=(0.7, 0.6, 0.5), specular_color=(0.0, 0.0, 0.0))
    else:
        material = builder.add_material(base_color=(0.8, 0.7, 0.6), metallic=1.0, roughness=view.roughness)
    box, ball = (builder.add_mesh(BUILT_IN[name]()) for name in ("box", "sphere"))
    bodies = (
        (box, (0, -1, 0), (12, 2, 12)),
        (box, (0, 2, -3), (12, 8, 2)),
        (ball, (0.8, 0.6, 0), (1.2, 1.2, 1.2)),
    )
    for mesh, position, size in bodies:
        placed = multiply(translation(middle + unit * np.array(position)), scaling(unit * np.array(size)))
        builder.add_objects(builder.add_node(placed), mesh, material)
    add, reach, bright = builder.lights, 12.0 * unit, unit**2
    for name in view.lights:
        if name == "panel":
            at = middle + unit * np.array((-0.9, 1.1, -0.6))
            add.add_rectangle(
                at, (0.6, -0.5, 0.6), reach, 1.4 * unit, 0.9 * unit, (1, 0.8, 0.6), 1.2 * bright
            )
        elif name == "tube":
            at = middle + unit * np.array((1.2, 1.9, 0.4))
            add.add_tube(at, (1, 0.3, 0.4), reach, 1.5 * unit, 0.03 * unit, (0.5, 0.7, 1), 0.6 * bright)
        elif name == "flush":
            at = middle + unit * np.array((0.0, 1.4, -2.0))
            add.add_rectangle(at, (0, 0, 1), reach, 2.0 * unit, 1.0 * unit, (1, 1, 0.8), 3.0 * bright)
        else:
            at = middle + unit * np.array((-1.5, 1.0, 1.0))
            add.add_rectangle(at, (0.4, -1, -0.4), reach, 1.5 * unit, 0.0, (1, 0.5, 0.5), 1.0 * bright)
    projection = Perspective(0.8, _SIZE[0] / _SIZE[1], near=0.05 * unit)
    eye, target = (middle + unit * np.array(point) for point in ((-0.5, 2.6, 5.0), (0.1, 0.7, -0.5)))
    return builder.build(), Camera.look_at(eye, target, projection=projection)


@cache  # the same for each device
def trace_area(view: AreaView) -> tuple[Floats, Floats]:
    """The ray-traced lowest and highest levels (h, w, 3) of pixels."""
    scene, camera = make_area_scene(view)
    traced = RayTracer(scene)
    levels = [traced.draw(camera, _SIZE, at=offset) for offset in _OFFSETS]
    return np.minimum.reduce(levels), np.maximum.reduce(levels)


def measure_area_lights(device: Device) -> CaseResult:
    """Draw the views, and measure by how many levels matt pixels are out of the bounds of the reference."""
    numbers, holds, images = dict[str, object](), dict[str, bool](), dict[str, CaseImage]()
    error = 0.0
    for title, view in _VIEWS.items():
        scene, camera = make_area_scene(view)
        image = draw(device, scene, camera, _SIZE, technique=view.technique)
        # The image is the same for all units, positions and techniques.
        low, high = trace_area(view._replace(unit=1.0, offset=0.0, technique=""))
        levels = image[..., :3].astype(np.float64)
        is_smooth = (high - low).max(axis=2) < _EDGE
        off = np.where(is_smooth, np.maximum(low - levels, levels - high).max(axis=2), 0.0).clip(0.0)
        if view.roughness is None:
            numbers[f"{title}: levels off"] = round(float(off.max()), 3)
            error = largest_error(error, float(off.max()))
        else:
            mean = float(off[is_smooth].mean())
            numbers[f"{title}: levels off in the mean"] = round(mean, 3)
            holds[f"{title}: less than {_METAL_MEAN:g} levels off in the mean"] = mean < _METAL_MEAN
        holds |= dict(_check_view(title, image, is_smooth))
        images |= {title: image, f"{title}, off": off}
    return CaseResult(error, numbers, holds, lambda: images)


def _check_view(title: str, image: CaseImage, is_smooth: Floats) -> Iterator[tuple[str, bool]]:
    yield f"{title}: most pixels are compared", bool(is_smooth.mean() > 0.5)
    for description, is_true in shows_something([image]).items():
        yield f"{title}: {description}", is_true


MEASURES: Final[Measures] = {91: measure_area_lights}
