"""Depth of field, compared with rays in float64 through 128 points of the aperture.

Posts stand on a striped floor, before the focus, in it and beyond it, and a small light shines far behind. Frames are
drawn finer than the reference, so that a pixel's middle is compared with the rays through it. The error is the mean
over all pixels. What remains is what the image doesn't show: surfaces beyond its edges and behind near things.
"""

from __future__ import annotations

from functools import cache, partial
from typing import Final

import numpy as np

from renderer.content import BUILT_IN
from renderer.lab.exam.case import CaseImage, CaseResult, Measures, largest_error
from renderer.lab.exam.ray_traced_cases import draw
from renderer.lab.exam.scenes import make_projection, shows_something
from renderer.lab.measure.ray_tracer import RayTracer
from renderer.scene import (
    Camera,
    DepthOfField,
    Fog,
    Scene,
    SceneBuilder,
)
from renderer.scene.arrays import Floats
from rhi import Device
from rhi.math import multiply, rotation, scaling, translation

_SIZE: Final = (28, 16)
_FINER: Final = 9
"""Frames have as many times the pixels of the reference along each axis; the middle of each block is
compared."""
_ASPECT: Final = _SIZE[0] / _SIZE[1]
_FAR: Final = 2.0**21
_FOCUS: Final = 4.0
_SETTINGS: Final[dict[str, dict[str, object]]] = {
    "default": {"depth_of_field.max_radius": 0.2},
    "fine": {
        "depth_of_field.max_radius": 0.2,
        "depth_of_field.samples": 512,
        "depth_of_field.bits": 32,
    },
}
_POSTS: Final = (
    ((-0.8, 0.6, 1.6), (0.3, 1.2, 0.3), 0.4, (0.8, 0.2, 0.1)),
    ((0.9, 0.3, 1.9), (0.25, 0.6, 0.25), 0.9, (0.7, 0.6, 0.1)),
    ((0.2, 0.5, 0.0), (0.7, 1.0, 0.7), 0.7, (0.2, 0.6, 0.25)),
    ((1.5, 0.5, -4.0), (0.8, 1.0, 0.8), 0.3, (0.2, 0.3, 0.8)),
    ((-1.6, 1.2, -5.0), (0.8, 2.4, 0.8), 0.2, (0.8, 0.7, 0.2)),
)
"""Position and size in units of the scene, an angle around the vertical axis in radians, and a colour."""


def make_posts(unit: float, offset: float, aperture: float, fog: Fog | None) -> Scene:
    """Make posts on a striped floor.

    Args:
        unit: metres of the scene's unit.
        offset: metres from the origin, along each axis.
        aperture: the radius of the aperture, in units.
        fog: that of the scene.
    """
    builder = SceneBuilder("posts")
    builder.background = (0.02, 0.05, 0.12)
    builder.lights.sky, builder.lights.ground = (0.5, 0.55, 0.6), (0.3, 0.25, 0.2)
    builder.lights.add_directional((-0.4, -1.0, -0.6), intensity=1.2)
    builder.fog, builder.depth_of_field = fog, DepthOfField(_FOCUS * unit, aperture * unit)
    box = builder.add_mesh(BUILT_IN["box"]())

    def add(
        position: Floats, size: Floats, angle: float, color: tuple[float, float, float], emission: float = 0.0
    ) -> None:
        material = builder.add_material(base_color=color, specular_color=(0.0, 0.0, 0.0), emission=emission)
        turned = multiply(rotation((0, 1, 0), angle), scaling(np.multiply(size, unit)))
        node = builder.add_node(multiply(translation(np.multiply(position, unit) + offset), turned))
        builder.add_objects(node, box, material)

    for number in range(12):
        color = (0.6, 0.55, 0.5) if number % 2 else (0.15, 0.18, 0.2)
        add(np.array([0.0, -0.05, 3.5 - number]), np.array([14.0, 0.1, 1.0]), 0.0, color)
    for position, size, angle, color in _POSTS:
        add(np.array(position), np.array(size), angle, color)
    add(np.array([0.3, 1.9, -6.0]), np.full(3, 0.4), 0.0, (1.0, 0.8, 0.6), emission=8.0)
    return builder.build()


def make_post_camera(unit: float, offset: float, *, is_parallel: bool) -> Camera:
    """The camera that looks at the posts; its focus is on the middle one."""
    projection = make_projection(unit, _ASPECT, 3.2, is_parallel=is_parallel)
    eye, aim = (np.multiply(point, unit) + offset for point in ((0.0, 1.3, 4.0), (0.0, 0.6, 0.0)))
    return Camera.look_at(eye, aim, projection=projection)


@cache  # the same for each device
def trace_views() -> dict[str, tuple[Scene, Camera, Floats]]:
    """Scenes by title, each with a camera and its ray-traced image in levels (h, w, 3)."""
    views = {
        "in a world of 1 mm": (
            make_posts(1e-3, 0.0, 0.3, None),
            make_post_camera(1e-3, 0.0, is_parallel=False),
        ),
        "parallel, far from the origin, in fog": (
            make_posts(1.0, _FAR, 0.2, Fog(0.05, base=_FAR)),
            make_post_camera(1.0, _FAR, is_parallel=True),
        ),
    }
    return {
        title: (scene, camera, RayTracer(scene).draw(camera, _SIZE))
        for title, (scene, camera) in views.items()
    }


def measure_focus(settings: str, technique: str, device: Device) -> CaseResult:
    """Draw posts with depth of field, and measure by how many levels pixels are off in the mean."""
    numbers, holds, images = dict[str, object](), dict[str, bool](), dict[str, CaseImage]()
    error = 0.0
    size = (_SIZE[0] * _FINER, _SIZE[1] * _FINER)
    for title, (scene, camera, traced) in trace_views().items():
        image = draw(device, scene, camera, size, technique, _SETTINGS[settings])
        depth_of_field, scene.depth_of_field = scene.depth_of_field, None
        sharp = draw(device, scene, camera, size, technique)
        scene.depth_of_field = depth_of_field
        middle = slice(_FINER // 2, None, _FINER)
        off, blur = (
            np.abs(levels[middle, middle, :3].astype(np.float64) - traced).max(axis=2)
            for levels in (image, sharp)
        )
        numbers |= {
            f"{title}: levels off in the mean": round(float(off.mean()), 3),
            f"{title}: without an aperture": round(float(blur.mean()), 3),
        }
        error = largest_error(error, float(off.mean()))
        holds |= {f"{title}: {condition}": value for condition, value in shows_something([image]).items()}
        holds[f"{title}: the aperture changes five levels in the mean"] = bool(blur.mean() > 5.0)
        images |= {title: image, f"{title}, off": off}
    return CaseResult(error, numbers, holds, lambda: images)


MEASURES: Final[Measures] = {
    85: partial(measure_focus, "fine", "forward"),
    86: partial(measure_focus, "default", "tiled_deferred"),
}
