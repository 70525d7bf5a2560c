"""Shadows: lit planes without acne at any slope, lights along up, and maps that don't crawl."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.content import BUILT_IN
from renderer.lab.exam.case import Found, Measures, Picture, find_largest
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
FLOOR: Final = Camera.look_at((0.3, 6, 5), (0.2, 0, 0.1))
SIZE: Final = 64
SUN: Final = np.array((-0.55, -0.62, -0.50)) / np.linalg.norm((-0.55, -0.62, -0.50))


def make_slope(degrees: float, normal_map: NDArray[np.uint8] | None = None) -> Scene:
    """Make a floor that the sun lights from `degrees` beside its normal, from between the axes of the map; its normals
    may be bent."""
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
    device: Device, degrees: float, settings: ShadowSettings | None, normal_map: NDArray[np.uint8] | None = None
) -> NDArray[Any]:
    """Return a frame of the floor, with shadows if there are settings."""
    scene = make_slope(degrees, normal_map)
    scene.lights.directional["casts_shadow"] = settings is not None
    with Renderer(device, scene, visibility="none", size=(SIZE, SIZE)) as renderer:
        if settings is not None:
            renderer.shadows.settings = settings
        return renderer.render(FLOOR).image.read()


def find_acne(device: Device, settings: ShadowSettings = SETTINGS) -> Found:
    """Draw a lit floor with shadows and without, at all slopes, and count the pixels that differ."""
    wrong, pictures = dict[str, int](), dict[str, Picture]()
    for degrees in SLOPES:
        want, shown = (render_slope(device, degrees, one) for one in (None, settings))
        wrong[f"{degrees:g}°"] = int((shown != want).any(-1).sum())
        pictures[f"{degrees:g}°"] = shown
    holds = {}
    for degrees in (45.0, 75.0):
        want, shown = (render_slope(device, degrees, one) for one in (None, replace(settings, bias=0.0)))
        darker = (shown[..., :3].astype(int) < want[..., :3].astype(int) - 8).any(-1)
        holds[f"without bias the floor shades itself at {degrees:g}°"] = bool(darker.mean() > 0.1)
        pictures[f"{degrees:g}° without bias"] = shown
    return Found(sum(wrong.values()), wrong, holds, lambda: pictures)


def _fit(camera: Camera, direction: Floats, settings: ShadowSettings) -> list[Cascade]:
    return fit_cascades([camera], direction, settings, 150.0, (-100.0, 100.0))


def _look_ahead(place: Floats) -> Camera:
    return Camera.look_at(place, np.add(place, (0.0, 0.0, -1.0)), projection=Perspective(fov=1.0, near=0.2))


def light_along_up(_: Device) -> Found:
    """Fit cascades of lights along the axes, and look that their axes are at right angles and along the light."""
    numbers: dict[str, object] = {}
    error = 0.0
    for direction in ((0, -1, 0), (0, 1, 0), (0, -1, 1e-12), (1, 0, 0)):
        off = 0.0
        for one in _fit(_look_ahead(np.zeros(3)), np.array(direction, float), ShadowSettings()):
            axes = one.camera.rotation
            along = one.camera.forward - np.array(direction) / np.linalg.norm(direction)
            off = find_largest(off, float(np.abs(axes @ axes.T - np.eye(3)).max()), float(np.abs(along).max()))
        numbers[str(direction)] = off
        error = find_largest(error, off)
    return Found(error, numbers)


def move_below_a_texel(_: Device) -> Found:
    """Move a camera by a tenth of a texel of 8 mm, 30 times, and look that maps stay or move by whole texels."""
    numbers: dict[str, object] = {}
    error, holds = 0.0, {}
    for place in (0.0, 1e5, 1e7):
        start = np.array((place, 2.0, place))
        first = _fit(_look_ahead(start), SUN, FINE)[0]
        right, texel = first.camera.rotation[0], first.texel
        shares = np.linspace(0.0, 3.0, 31)
        found = [_fit(_look_ahead(start + right * texel * share), SUN, FINE)[0] for share in shares]
        moved = np.array([(one.camera.position - first.camera.position) @ right for one in found])
        off = float(np.abs(moved / texel - np.round(moved / texel)).max())
        steps = len({one.camera.position.tobytes() for one in found})
        numbers[f"at {place:g} m"] = f"{off:.2g} of a texel of {1e3 * texel:.2f} mm, {steps} maps"
        error = find_largest(error, off)
        holds[f"at {place:g} m a map moves with every texel, and only then"] = 3 <= steps <= 4
    return Found(error, numbers, holds)


MEASURES: Final[Measures] = {48: find_acne, 49: light_along_up, 50: move_below_a_texel}
