"""Narrow spot lights and lights in worlds of any size light a plane as float64 says, with every technique."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from frames import open_renderer
from lighting_reference import encode, reference_plane_light
from nightly_reasons import FEWER_CASES, ONLY_KERNELS
from numpy.typing import NDArray
from tested_devices import open_device

import rhi
from renderer.content import BUILT_IN
from renderer.scene import Camera, Perspective, Scene, SceneBuilder, scaling, translation
from renderer.techniques import TECHNIQUES

SIZE = (48, 36)
ALBEDO = np.array((0.7, 0.6, 0.5))
TECHNIQUE_NAMES = [name for name in TECHNIQUES if name not in ("auto", "inferred")]
"""`inferred` lights fewer pixels than the image has: it blurs the edges of cones."""


@dataclass(frozen=True)
class Light:
    """A light above a plane in a world of `scale` metres: its height and, for spot lights, half angles in
    degrees."""

    scale: float
    height: float
    outer: float = 0.0
    inner: float = 0.0

    def __str__(self) -> str:
        angles = f", {self.inner:g} to {self.outer:g} degrees" if self.outer else ""
        return f"{self.height:g} high in {self.scale:g} m{angles}"


LIGHTS = [
    *(
        Light(1.0, 100.0 / max(half, 0.02), half, share * half)
        for half in (0.02, 0.1, 0.5, 3.0)
        for share in (0.0, 0.5)
    ),
    *(Light(scale, height) for scale in (1e-4, 1e-3, 1e-2, 1.0, 1e3) for height in (0.05, 1.0)),
    *(Light(scale, 1.0, 40.0, 10.0) for scale in (1e-4, 1e-2, 1e3)),
    Light(1.0, 1.0, 180.0, 180.0),
    Light(1.0, 1.0, 180.0, 0.0),
]


def make_scene(light: Light) -> tuple[Scene, Camera]:
    """A plane below a light whose cone is about as wide as the image."""
    scale = light.scale
    builder = SceneBuilder("a light above a plane")
    material = builder.add_material(base_color=tuple(ALBEDO), specular_color=(0.2, 0.2, 0.2), shininess=20.0)
    floor = builder.add_node(translation((0, -0.5 * scale, 0)) @ scaling((40 * scale, scale, 40 * scale)))
    builder.add_objects(floor, builder.add_mesh(BUILT_IN["box"]()), material)
    away = light.height * scale
    position, strength = (0.1 * scale, away, -0.05 * scale), float(2.0 * away**2)
    if light.outer:
        angles = np.radians((light.inner, light.outer))
        builder.lights.add_spot(position, (0.05, -1, 0.02) if light.outer > 5 else (0, -1, 0), 4.0 * away,
                                angles[0], angles[1], intensity=strength)  # fmt: skip
    else:
        builder.lights.add_point(position, 4.0 * away, intensity=strength)
    builder.lights.sky = builder.lights.ground = (0.02, 0.02, 0.02)
    width = 2.2 * away * np.tan(np.radians(min(light.outer, 40.0) or 40.0))
    eye = np.array((0.1, 0.0, -0.05)) * scale + np.array((0.05, 1.0, 0.4)) * width
    camera = Camera.look_at(
        eye, (0.1 * scale, 0.0, -0.05 * scale), (0, 1, 0), Perspective(0.9, 4 / 3, 0.01 * width)
    )
    return builder.build(), camera


def worst_levels(device: rhi.Device, technique: str, light: Light) -> tuple[float, float]:
    """The greatest difference from float64 in levels of 255, but for the hundredth of pixels that differ
    most, and how far the exact levels are apart."""
    scene, camera = make_scene(light)
    with open_renderer(device, scene, TECHNIQUES[technique](), size=SIZE) as renderer:
        image: NDArray[Any] = renderer.render(camera).image.read()[..., :3].astype(float)
    up = np.array((0.0, 1.0, 0.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        exact = encode(reference_plane_light(scene, camera, SIZE, np.zeros(3), up, ALBEDO)[0])
    return float(np.quantile(np.abs(image - np.nan_to_num(exact)).max(-1), 0.99)), float(
        np.ptp(exact[..., 0])
    )


@pytest.fixture(scope="module", params=["gl", "cl", "wgpu"])
def any_device(request: pytest.FixtureRequest) -> Iterator[rhi.Device]:
    with open_device(request.param) as device:
        yield device


@pytest.mark.nightly_cases("cl-*", "wgpu-*", reason=FEWER_CASES)
@pytest.mark.parametrize("light", LIGHTS, ids=str)
def test_each_light_is_that_of_float64(any_device: rhi.Device, light: Light) -> None:
    wrong, contrast = worst_levels(any_device, "forward", light)
    assert wrong <= 2.0
    assert contrast > 20.0, "control: the light shows"


def test_each_device_shows_narrow_and_near_lights(any_device: rhi.Device) -> None:
    wrong = {str(light): worst_levels(any_device, "forward", light)[0] for light in LIGHTS[2::6]}
    assert max(wrong.values()) <= 2.0, wrong


@pytest.mark.nightly_cases("cl*", "wgpu*", reason=ONLY_KERNELS)
@pytest.mark.parametrize("technique", TECHNIQUE_NAMES)
def test_each_technique_shows_narrow_and_near_lights(any_device: rhi.Device, technique: str) -> None:
    selected = [light for light in LIGHTS if light.outer in (0.1, 0.5) or light.scale in (1e-3, 1e-2)]
    wrong = {str(light): worst_levels(any_device, technique, light)[0] for light in selected}
    assert max(wrong.values()) <= 3.0, wrong
