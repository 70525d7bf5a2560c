"""The lighting model once more, in NumPy and float64, written from docs/renderer.md: what shaders must show.

It looks at one plane that fills the image, found by ray casting, so nothing here knows of rasterisation.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from renderer.scene import Camera, Perspective, Scene

Floats = NDArray[np.float64]


def shade_plane(
    scene: Scene,
    camera: Camera,
    size: tuple[int, int],
    point: Floats,
    plane: Floats,
    albedo: Floats,
    normal: Floats | None = None,
) -> Floats:
    """(height, width, 3) of 0…255, sRGB, not rounded: the plane through `point` as `camera` sees it.

    The plane is at right angles to the unit vector `plane`, by which it is lit too unless another `normal` is
    given. It has the scene's first material, with `albedo` for base colour times texel.
    """
    return encode(reference_plane_light(scene, camera, size, point, plane, albedo, normal)[0])


def compute_pixel_rays(camera: Camera, size: tuple[int, int]) -> Floats:
    """Return the direction (height, width, 3) of each pixel, of length 1 along the view."""
    projection = camera.projection
    assert isinstance(projection, Perspective)
    width, height = size
    x = ((np.arange(width) + 0.5) / width * 2 - 1) * np.tan(projection.fov / 2) * width / height
    y = (1 - (np.arange(height) + 0.5) / height * 2) * np.tan(projection.fov / 2)
    return np.asarray(np.stack(np.broadcast_arrays(x[None, :], y[:, None], -1.0), -1) @ camera.rotation)


def reference_plane_light(
    scene: Scene,
    camera: Camera,
    size: tuple[int, int],
    point: Floats,
    plane: Floats,
    albedo: Floats,
    normal: Floats | None = None,
    material: int = 0,
) -> tuple[Floats, Floats]:
    """Return the linear colours (height, width, 3) of a plane, of another material than the first if that is
    given, and the distances (height, width) from the eye; see `shade_plane`."""
    normal = plane if normal is None else normal
    rays = compute_pixel_rays(camera, size)
    distance = ((point - camera.position) @ plane) / (rays @ plane)
    assert (distance > 0).all(), "the plane must fill the image"
    hit = camera.position + rays * distance[..., None]
    color = shade(scene, scene.materials[material], hit, normal, _unit(camera.position - hit), albedo)
    mapped, away = tone_map(color), np.linalg.norm(hit - camera.position, axis=-1)
    through = np.exp(-scene.haze * away)[..., None]
    return mapped * through + np.array(scene.background) * (1 - through), away


def shade(scene: Scene, material: Any, hit: Floats, normal: Floats, to_eye: Floats, albedo: Floats) -> Floats:
    """Return the linear light from `hit` to the eye."""
    lights = scene.lights
    sky, ground = np.array(lights.sky), np.array(lights.ground)

    def hemisphere(direction: Floats) -> Floats:
        upward = (1 + direction[..., 1:2]) / 2
        return np.asarray(sky * upward + ground * (1 - upward))

    cosine = np.clip((to_eye * normal).sum(-1, keepdims=True), 0, 1)
    mirror = material["specular_color"] + material["rim_strength"] * (1 - cosine) ** material["rim_power"]
    beyond = 2 * (to_eye @ normal)[..., None] * normal - to_eye
    color = albedo * (material["emission"] + hemisphere(normal)) + mirror * hemisphere(beyond)

    def reflect(to_light: Floats, irradiance: Floats) -> Floats:
        facing = np.maximum((to_light * normal).sum(-1, keepdims=True), 0)
        halfway = _unit(to_light + to_eye)
        shininess = float(material["shininess"])
        lobe = np.clip((halfway * normal).sum(-1, keepdims=True), 0, 1) ** shininess
        specular = material["specular_color"] * lobe * (shininess + 8) / 8
        return np.asarray((albedo + specular) * irradiance * facing)

    for light in lights.directional:
        color = color + reflect(-light["direction"].astype(float), light["color"] * light["intensity"])
    for light in [*lights.point, *lights.spot]:
        way = light["position"] - hit
        distance = np.linalg.norm(way, axis=-1, keepdims=True)
        window = np.clip(1 - (distance / light["range"]) ** 4, 0, 1) ** 2
        irradiance = light["color"] * light["intensity"] * window / distance**2
        if "outer" in light.dtype.names:
            away = -(way / distance) @ light["direction"]
            inner, outer = np.cos(float(light["inner"])), np.cos(float(light["outer"]))
            share = (away - outer) / (inner - outer) if inner != outer else np.where(away >= outer, 1.0, 0.0)
            irradiance = irradiance * np.clip(share, 0, 1)[..., None] ** 2
        color = color + reflect(way / distance, irradiance)
    return np.asarray(color)


def tone_map(color: Floats) -> Floats:
    """Narkowicz's fit of the ACES curve at an exposure of 0.6."""
    x = 0.6 * color
    return np.clip(x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14), 0, 1)


def encode(linear: Floats) -> Floats:
    """Encode linear light as sRGB, 0…255."""
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055) * 255


def _unit(v: Floats) -> Floats:
    return np.asarray(v / np.linalg.norm(v, axis=-1, keepdims=True))
