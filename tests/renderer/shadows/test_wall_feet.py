"""Light doesn't leak under a wall that stands on the ground, beyond what a map's texels and its filter blur.

The ground right behind a wall is dark to its foot: rays say so. A map sees that foot to a texel, and a filter
reads texels beside it, so that a wall thinner than these lets light through. A bias that moved points through the
wall would let it through farther away, or behind thick walls.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from nightly_reasons import FEWER_CASES
from numpy.typing import NDArray
from tested_devices import open_device

import rhi
from renderer.content import BUILT_IN
from renderer.lab.measure.ray_tracer import RayTracer
from renderer.scene import Camera, Orthographic, Scene, SceneBuilder, rotation, scaling, translation
from renderer.settings import RenderSettings
from renderer.shadows import ShadowFilter
from rhi.math import multiply

SIZE = 192
PIXEL = 2.0 / SIZE
WALL_HEIGHT = 3.0
SETTINGS = RenderSettings().change_all(
    {
        "algorithm": "none",
        "shadows.cascades": 1,
        "shadows.cascade_size": 128,
        "shadows.distance": 20.0,
        "shadows.min_size": 128,
        "shadows.max_size": 128,
    }
)
"""Texels of 13.5 cm for the sun, and of 6.25 cm for a point light at the wall."""
SUN_TEXEL, POINT_TEXEL = 0.1355, 2.0 * 4.0 / 128
REACH = {ShadowFilter.HARD: 0.6, ShadowFilter.SMOOTH: 2.1}
"""Texels that light may reach behind a wall without thickness: half a texel, and 1.5 more by the filter."""


def make_wall(thickness: float, light: str, turn: float, elevation: float) -> Scene:
    """Make a wall on the ground that is lit from one side, turned about the up axis."""
    builder = SceneBuilder("wall")
    box = builder.add_mesh(BUILT_IN["box"]())
    grey = builder.add_material(base_color=(0.7, 0.7, 0.7), specular_color=(0.0, 0.0, 0.0))
    ground = multiply(translation((0.0, -0.25, 0.0)), scaling((30.0, 0.5, 30.0)))
    builder.add_objects(builder.add_node(ground), box, grey)
    stands = multiply(
        translation((0.0, 0.5 * WALL_HEIGHT, -0.5 * thickness)), scaling((20.0, WALL_HEIGHT, thickness))
    )
    turned = rotation((0, 1, 0), turn)
    builder.add_objects(builder.add_node(multiply(turned, stands)), box, grey)
    towards = np.array((0.2 * np.cos(elevation), -np.sin(elevation), -np.cos(elevation)))
    direction = turned[:3, :3] @ towards
    if light == "sun":
        builder.lights.add_directional(direction, intensity=2.0, casts_shadow=True)
    else:
        builder.lights.add_point(-4.0 * direction, 14.0, intensity=25.0, casts_shadow=True)
    return builder.build()


def make_camera(thickness: float, turn: float) -> Camera:
    """A camera that looks down at two metres of the ground behind the wall; up in the image is away from it."""
    turned = rotation((0, 1, 0), turn)[:3, :3]
    eye, aim = (turned @ (0.0, height, -thickness - 0.9) for height in (6.0, 0.0))
    return Camera.look_at(eye, aim, turned @ (0.0, 0.0, -1.0), Orthographic(2.0, 1.0, 0.0, 30.0))


def select_ground(elevation: float, size: int) -> NDArray[Any]:
    """The rows of an image that show ground that the wall shades, and their metres behind it."""
    behind = 1.9 - 2.0 * (np.arange(size) + 0.5) / size
    reach = min(0.6 * WALL_HEIGHT / np.tan(elevation), 0.9)
    return np.where((behind > 0.0) & (behind < reach), behind, np.nan)


def measure_leak(device: rhi.Device, scene: Scene, camera: Camera, elevation: float, **changes: Any) -> float:
    """Metres behind the wall that light reaches."""
    settings = SETTINGS.change_all({path.replace("__", "."): value for path, value in changes.items()})
    with settings.open(device, scene, (SIZE, SIZE)) as renderer:
        levels = renderer.render(settings.adapt_camera(camera)).image.read()[..., 1].astype(float)
    behind = select_ground(elevation, SIZE)
    ground = np.isfinite(behind)
    bright = (levels[ground] > levels[ground].min() + 8.0).any(axis=1)
    return float(behind[ground][bright].max(initial=0.0))


@pytest.mark.parametrize("light", ["sun", "point"])
@pytest.mark.parametrize("elevation", [0.15, 0.5, 1.3])
def test_rays_find_no_light_behind_a_wall(light: str, elevation: float) -> None:
    image = RayTracer(make_wall(0.01, light, 0.4, elevation)).draw(make_camera(0.01, 0.4), (24, 24))
    levels = image[np.isfinite(select_ground(elevation, 24))]
    assert np.ptp(levels, axis=(0, 1)).max() < 1.0


@pytest.mark.nightly_cases("cl-*", "wgpu-*", "*-deferred", reason=FEWER_CASES)
@pytest.mark.parametrize("technique", ["forward", "deferred"])
@pytest.mark.parametrize("light", ["sun", "point"])
@pytest.mark.parametrize("backend", ["gl", "cl", "wgpu"])
def test_light_behind_a_wall_reaches_no_farther_than_texels_and_filter(
    backend: str, light: str, technique: str
) -> None:
    texel = SUN_TEXEL if light == "sun" else POINT_TEXEL
    with open_device(backend) as device:
        for thickness, turn, elevation in (
            (0.01, 0.0, 0.5),
            (0.01, 0.4, 0.15),
            (0.1, 0.9, 1.3),
            (0.4, 0.4, 0.5),
        ):
            scene, camera = make_wall(thickness, light, turn, elevation), make_camera(thickness, turn)
            for shadow_filter, reach in REACH.items():
                leak = measure_leak(
                    device,
                    scene,
                    camera,
                    elevation,
                    shadows__filter=shadow_filter,
                    technique__name=technique,
                )
                most = max(reach * texel / np.sin(elevation) - thickness, 0.0) + PIXEL
                assert leak <= most, (thickness, turn, elevation, shadow_filter)


def test_thin_walls_leak_by_the_filter(gl: rhi.Device) -> None:
    """A control: the measure sees the light that a filter spreads."""
    scene = make_wall(0.01, "sun", 0.0, 0.5)
    assert measure_leak(gl, scene, make_camera(0.01, 0.0), 0.5) > SUN_TEXEL
