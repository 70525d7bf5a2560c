"""Sphere lights, compared with a reference that adds up the light of all their parts, and with points."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from frames import draw, first_view_camera, make_boxes, max_difference

import rhi
from renderer.content import BUILT_IN
from renderer.lab.measure.ray_tracer import RayTracer
from renderer.lab.measure.ray_tracer.tracer import inverse_tone_map
from renderer.scene import Camera, Perspective, Scene, scaling, translation
from renderer.techniques import Deferred, ResourceCapture

SIZE = (48, 32)
MATT = {"base_color": (0.6, 0.5, 0.4), "specular_color": (0.0, 0.0, 0.0)}
SHINY = {"base_color": (0.0, 0.0, 0.0), "specular_color": (0.05, 0.05, 0.05)}
METAL = {"base_color": (0.5, 0.5, 0.5), "metallic": 1.0}


def stage(*radii: float, height: float = 1.0, strength: float = 2.0, **material: Any) -> Scene:
    """Make a floor and a ball, dark but for a local light of each radius, all in one place."""
    builder = make_boxes(translation((0, -5, 0)) @ scaling((100, 10, 100)), **material)
    builder.add_objects(
        builder.add_node(translation((1.5, 0.6, 0))), builder.add_mesh(BUILT_IN["sphere"]()), 0
    )
    builder.lights.sky = builder.lights.ground = builder.background = (0.0, 0.0, 0.0)
    for radius in radii:
        builder.lights.add_point((-0.3, height, 0), 30.0, (1.0, 0.8, 0.6), strength, source_radius=radius)
    builder.views["eye"] = Camera.look_at((0, 2.5, 5), (0, 0.3, 0), projection=Perspective(0.9, 1.5))
    return builder.build()


@pytest.mark.parametrize(
    ("radius", "height"), [(0.5, 1.0), (0.5, 0.3), (0.7, -0.2), (0.02, 0.01), (0.0, 1.0)]
)
def test_scattered_light_is_within_a_level_of_that_of_all_parts_of_the_sphere(
    drawing_device: rhi.Device, radius: float, height: float
) -> None:
    """A level is what rounding takes; the sphere may be cut by the floor, which is then lit inside of it,
    too."""
    scene = stage(radius, height=height, **MATT)
    exact = RayTracer(scene).draw(first_view_camera(scene), SIZE)
    assert max_difference(draw(drawing_device, scene, size=SIZE), exact) <= 1
    if height == 0.3:  # the control
        assert max_difference(draw(drawing_device, stage(0.0, height=height, **MATT), size=SIZE), exact) > 10


def measure_light(device: rhi.Device, scene: Scene, size: tuple[int, int] = SIZE) -> tuple[Any, Any]:
    """Return the red light (h, w) of the local lights, as drawn and of the reference."""
    watched, eye = ResourceCapture(Deferred(), "light"), first_view_camera(scene)
    draw(device, scene, watched, size=size)
    y, x = np.indices(size[::-1]) + 0.5
    exact = inverse_tone_map(RayTracer(scene).trace(eye, size, np.stack([x.ravel(), y.ravel()], axis=1)))
    return np.asarray(watched.texels)[..., 0], exact[:, 0].reshape(size[::-1])


@pytest.mark.parametrize(
    "material",
    [*({**SHINY, "shininess": s} for s in (20.0, 1000.0)), *({**METAL, "roughness": r} for r in (0.2, 0.7))],
)
def test_a_highlight_has_the_energy_of_that_of_all_parts_of_the_sphere(
    drawing_device: rhi.Device, material: dict[str, Any]
) -> None:
    """A representative point is an approximation: a seventh of the energy, half of the peak; a point's is
    exact."""
    for radius, least, lowest in ((0.0, 0.995, 0.995), (0.1, 0.86, 0.45), (0.6, 0.86, 0.6)):
        drawn, exact = measure_light(drawing_device, stage(radius, strength=0.04, **material))
        assert least <= drawn.sum() / exact.sum() <= 1.02, radius
        assert lowest <= drawn.max() / exact.max() <= 1.005, radius


def test_the_highlight_of_a_mirror_is_as_wide_as_the_sphere(drawing_device: rhi.Device) -> None:
    for radius, pixels in ((0.0, 1), (0.4, 50), (0.8, 200)):
        scene = stage(radius, strength=0.04, shininess=5000.0, **SHINY)
        drawn, exact = (
            (light > 0.2 * light.max()).sum() for light in measure_light(drawing_device, scene, (96, 64))
        )
        assert exact > pixels
        assert 1.0 <= drawn / exact < 1.2, radius


def test_a_point_light_is_the_same_beside_a_sphere_light(drawing_device: rhi.Device) -> None:
    point, both = stage(0.0), stage(0.0, 0.5)
    both.lights.point["intensity"][1] = 0.0
    assert max_difference(*(draw(drawing_device, scene, size=SIZE) for scene in (point, both))) <= 1
