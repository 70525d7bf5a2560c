"""Light from an environment, compared with float64 integrals over its image.

Balls of all roughnesses, metals, others and those of the specular model, are above a floor, and the sky is behind
them. The reference sums the image for what surfaces scatter, and the image and lobes for what they mirror. What
remains is that surfaces mirror one lobe, as it is seen along the normal, instead of that of their view (split-sum).
"""

from __future__ import annotations

from functools import cache, partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.content import BUILT_IN
from renderer.content.skies import paint_sky
from renderer.lab.exam.case import CaseImage, CaseResult, Measures, largest_error
from renderer.lab.exam.ray_traced_cases import draw
from renderer.lab.exam.scenes import make_projection, shows_something
from renderer.lab.measure.ray_tracer import RayTracer
from renderer.scene import Camera, Environment, Fog, Scene, SceneBuilder
from renderer.scene.arrays import Floats
from renderer.scene.environment import texel_directions
from rhi import Device
from rhi.math import multiply, scaling, translation

_SIZE: Final = (40, 22)
_FINER: Final = 5
"""Frames have as many times the pixels of the reference along each axis; the middle of each block is
compared."""
_ASPECT: Final = _SIZE[0] / _SIZE[1]
_ROWS: Final = 32
_FAR: Final = 2.0**21
_SUN: Final = np.array([0.5, 0.6, 0.62]) / np.linalg.norm([0.5, 0.6, 0.62])


def make_image(sun: float) -> NDArray[Any]:
    """Paint a sky with a disc of so much light, of a radius of 8°."""
    image = paint_sky(height=_ROWS)
    is_sun = texel_directions(_ROWS, 2 * _ROWS) @ _SUN > np.cos(np.radians(8.0))
    return np.where(is_sun[..., None], np.float32(sun), image) if sun else image


def make_balls(environment: Environment, unit: float, offset: float, fog: Fog | None) -> Scene:
    """Make balls above a floor.

    Args:
        environment: that of the scene.
        unit: metres of the scene's unit.
        offset: metres from the origin, along each axis.
        fog: that of the scene.
    """
    builder = SceneBuilder("balls")
    builder.environment, builder.fog = environment, fog
    ball, box = builder.add_mesh(BUILT_IN["sphere"]()), builder.add_mesh(BUILT_IN["box"]())

    def add(mesh: int, position: tuple[float, float, float], size: float, **material: Any) -> None:
        transform = translation(np.multiply(position, unit) + offset)
        scale = scaling(np.multiply((size, size if mesh == ball else 0.2, size), unit))
        builder.add_objects(
            builder.add_node(multiply(transform, scale)), mesh, builder.add_material(**material)
        )

    for column in range(5):
        x, roughness = 1.1 * column - 2.2, 0.1 + 0.225 * column
        add(ball, (x, 0.4, 0.0), 1.0, base_color=(0.95, 0.7, 0.3), metallic=1.0, roughness=roughness)
        add(ball, (x, 1.5, 0.0), 1.0, base_color=(0.6, 0.1, 0.1), metallic=0.0, roughness=roughness)
        add(
            ball,
            (x, 2.6, 0.0),
            1.0,
            base_color=(0.1, 0.1, 0.3),
            specular_color=(0.5, 0.5, 0.5),
            shininess=4.0 ** (column + 1),
        )
    add(box, (0.0, -0.3, 0.0), 9.0, base_color=(0.5, 0.5, 0.5), specular_color=(0.0, 0.0, 0.0))
    return builder.build()


def make_ball_camera(unit: float, offset: float, *, is_parallel: bool) -> Camera:
    """The camera that looks at the balls."""
    projection = make_projection(unit, _ASPECT, 4.6, is_parallel=is_parallel)
    eye, aim = (np.multiply(point, unit) + offset for point in ((0.6, 2.4, 4.6), (0.0, 1.4, 0.0)))
    return Camera.look_at(eye, aim, projection=projection)


@cache  # the same for each device
def trace_view(name: str) -> tuple[Scene, Camera, Floats]:
    """A scene, its camera, and its ray-traced image in levels (h, w, 3)."""
    if name == "sky":
        scene = make_balls(Environment(make_image(0.0), turn=0.7), 1e-3, 0.0, None)
        camera = make_ball_camera(1e-3, 0.0, is_parallel=False)
    else:
        scene = make_balls(Environment(make_image(80.0), 0.8, -2.0), 1.0, _FAR, Fog(0.03, base=_FAR))
        camera = make_ball_camera(1.0, _FAR, is_parallel=True)
    return scene, camera, RayTracer(scene).draw(camera, _SIZE)


def measure_environment(view: str, technique: str, device: Device) -> CaseResult:
    """Draw balls in an environment, and measure by how many levels pixels are off in the mean."""
    scene, camera, traced = trace_view(view)
    size = (_SIZE[0] * _FINER, _SIZE[1] * _FINER)
    image = draw(device, scene, camera, size, technique)
    environment, scene.environment = scene.environment, None
    bare = draw(device, scene, camera, size, technique)
    scene.environment = environment
    middle = slice(_FINER // 2, None, _FINER)
    off, effect = (
        np.abs(levels[middle, middle, :3].astype(np.float64) - traced).max(axis=2) for levels in (image, bare)
    )
    error = largest_error(0.0, float(off.mean()))
    numbers: dict[str, object] = {
        "levels off in the mean": round(error, 3),
        "99 of 100 pixels": round(float(np.percentile(off, 99)), 1),
        "without the environment": round(float(effect.mean()), 1),
    }
    holds = {
        **shows_something([image]),
        "the environment changes forty levels in the mean": bool(effect.mean() > 40.0),
        "a pixel in a hundred is 16 levels off at most": bool(np.percentile(off, 99) < 16.0),
    }
    images: dict[str, CaseImage] = {view: image, f"{view}, off": off}
    return CaseResult(error, numbers, holds, lambda: images)


MEASURES: Final[Measures] = {
    89: partial(measure_environment, "sky", "forward"),
    90: partial(measure_environment, "sun", "clustered_deferred"),
}
