"""Shadows: lit planes without acne at any slope, lights along the up axis, and maps that don't crawl."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.content import BUILT_IN
from renderer.lab.exam.case import CaseImage, CaseResult, Measures, largest_error
from renderer.renderer import Renderer
from renderer.scene import Camera, Perspective, Scene, SceneBuilder, scaling, translation
from renderer.scene.arrays import Floats
from renderer.shadows import ShadowSettings
from renderer.shadows.cascades import Cascade, fit_cascades
from rhi import Device

SETTINGS: Final = ShadowSettings(cascades=1, cascade_size=128, distance=20.0)
FINE: Final = ShadowSettings(cascades=1, cascade_size=1024, distance=4.0)
"""Settings with texels of less than a centimetre."""
SLOPES: Final = (0.0, 5.0, 20.0, 45.0, 60.0, 75.0, 85.0, 88.0, 89.0)
FLOOR_CAMERA: Final = Camera.look_at((0.3, 6, 5), (0.2, 0, 0.1))
SIZE: Final = 64
SUN: Final = np.array((-0.55, -0.62, -0.50)) / np.linalg.norm((-0.55, -0.62, -0.50))


def make_slope(degrees: float, normal_map: NDArray[np.uint8] | None = None) -> Scene:
    """Make a floor that the sun lights at `degrees` to its normal, from between the axes of the map; a normal
    map may bend its normals."""
    builder = SceneBuilder("slope")
    mesh = builder.add_mesh(BUILT_IN["box"]())
    floor = builder.add_node(translation((0, -0.5, 0)) @ scaling((30, 1, 30)))
    maps: dict[str, Any] = {} if normal_map is None else {"normal_texture": builder.add_image(normal_map)}
    builder.add_objects(floor, mesh, builder.add_material(specular_color=(0, 0, 0), **maps))
    angle, turn = np.radians(degrees), 0.7
    down = (np.sin(angle) * np.cos(turn), -np.cos(angle), np.sin(angle) * np.sin(turn))
    builder.lights.add_directional(down, intensity=1.0 / np.cos(angle))
    return builder.build()


def render_slope(
    device: Device,
    degrees: float,
    settings: ShadowSettings | None,
    normal_map: NDArray[np.uint8] | None = None,
) -> NDArray[Any]:
    """Render the floor, with shadows if there are settings."""
    scene = make_slope(degrees, normal_map)
    scene.lights.directional["casts_shadow"] = settings is not None
    with Renderer(device, scene, visibility="none", size=(SIZE, SIZE)) as renderer:
        if settings is not None:
            renderer.shadows.settings = settings
        return renderer.render(FLOOR_CAMERA).image.read()


def measure_shadow_acne(device: Device, settings: ShadowSettings = SETTINGS) -> CaseResult:
    """Draw a lit floor with shadows and without, at all slopes, and count the pixels that differ."""
    wrong, images = dict[str, int](), dict[str, CaseImage]()
    for degrees in SLOPES:
        expected, image = (render_slope(device, degrees, map_settings) for map_settings in (None, settings))
        wrong[f"{degrees:g}°"] = int((image != expected).any(-1).sum())
        images[f"{degrees:g}°"] = image
    holds = {}
    for degrees in (45.0, 75.0):
        expected, image = (
            render_slope(device, degrees, map_settings)
            for map_settings in (None, replace(settings, bias=0.0))
        )
        darker = (image[..., :3].astype(int) < expected[..., :3].astype(int) - 8).any(-1)
        holds[f"without bias the floor shades itself at {degrees:g}°"] = bool(darker.mean() > 0.1)
        images[f"{degrees:g}° without bias"] = image
    return CaseResult(sum(wrong.values()), wrong, holds, lambda: images)


def _fit(camera: Camera, direction: Floats, settings: ShadowSettings) -> list[Cascade]:
    return fit_cascades([camera], direction, settings, 150.0, (-100.0, 100.0))


def _look_ahead(position: Floats) -> Camera:
    return Camera.look_at(
        position, np.add(position, (0.0, 0.0, -1.0)), projection=Perspective(fov=1.0, near=0.2)
    )


def measure_light_along_up(_: Device) -> CaseResult:
    """Fit cascades of lights along the axes, and check that their axes are at right angles and along the
    light."""
    numbers: dict[str, object] = {}
    error = 0.0
    for direction in ((0, -1, 0), (0, 1, 0), (0, -1, 1e-12), (1, 0, 0)):
        off = 0.0
        for cascade in _fit(_look_ahead(np.zeros(3)), np.array(direction, float), ShadowSettings()):
            axes = cascade.camera.rotation
            along = cascade.camera.forward - np.array(direction) / np.linalg.norm(direction)
            off = largest_error(
                off, float(np.abs(axes @ axes.T - np.eye(3)).max()), float(np.abs(along).max())
            )
        numbers[str(direction)] = off
        error = largest_error(error, off)
    return CaseResult(error, numbers)


def measure_subtexel_moves(_: Device) -> CaseResult:
    """Move a camera by a tenth of a texel of 8 mm, 30 times, and check that maps stay or move by whole
    texels."""
    numbers: dict[str, object] = {}
    error, holds = 0.0, {}
    for position in (0.0, 1e5, 1e7):
        start = np.array((position, 2.0, position))
        first = _fit(_look_ahead(start), SUN, FINE)[0]
        right, texel = first.camera.rotation[0], first.texel
        shares = np.linspace(0.0, 3.0, 31)
        cascades = [_fit(_look_ahead(start + right * texel * share), SUN, FINE)[0] for share in shares]
        moved = np.array([(cascade.camera.position - first.camera.position) @ right for cascade in cascades])
        off = float(np.abs(moved / texel - np.round(moved / texel)).max())
        steps = len({cascade.camera.position.tobytes() for cascade in cascades})
        numbers[f"at {position:g} m"] = f"{off:.2g} of a texel of {1e3 * texel:.2f} mm, {steps} maps"
        error = largest_error(error, off)
        holds[f"at {position:g} m a map moves with every texel, and only then"] = 3 <= steps <= 4
    return CaseResult(error, numbers, holds)


MEASURES: Final[Measures] = {48: measure_shadow_acne, 49: measure_light_along_up, 50: measure_subtexel_moves}
