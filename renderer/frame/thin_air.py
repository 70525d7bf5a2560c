"""Haze and fog that change nothing: no channel of an 8-bit pixel differs by more than half a level without
them.

It follows from their density, and from how far the scene reaches from the eye. Fog also covers the
background, to infinity: where its color is another, it matters unless all rays leave it upwards.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from renderer.scene import Camera, Fog, Scene
from renderer.scene.arrays import Floats
from renderer.scene.negligible import LEAST_LIGHT
from rhi.math import is_parallel

HALF_LEVEL: Final = 0.5 / 255.0
"""Half a level of an 8-bit image, whose channels are from 0 to 1."""

_LEAST_LINEAR: Final = HALF_LEVEL / 12.92
"""Half a level as a linear color from 0 to 1: sRGB raises dark colors by 12.92."""

_BRIGHTEST_FOG: Final = 12.0
"""More light than any color of fog is seen as: at 12, tones reach white."""

THIN_HAZE: Final = 1e-5
"""The density per metre below which it is asked how far the view reaches. Denser air counts: most frames ask
nothing."""

_MAX_EXPONENT: Final = 60.0
"""The largest exponent of the density of fog in shaders."""


def is_haze_seen(scene: Scene, camera: Camera) -> bool:
    """Return whether haze changes the color of any surface by more than half a level."""
    if scene.haze >= THIN_HAZE:
        return True
    return bool(-np.expm1(-scene.haze * _farthest(scene, camera)) > _threshold(scene, _LEAST_LINEAR))


def is_fog_seen(scene: Scene, camera: Camera) -> bool:
    """Return whether fog changes the color of any surface, or of the background, by more than half a
    level."""
    fog = scene.fog
    if fog is None:
        return False
    eye = float(camera.position[1])
    if fog.density * np.exp(-min(fog.falloff * (eye - fog.base), _MAX_EXPONENT)) >= THIN_HAZE:
        return True
    threshold = _threshold(scene, LEAST_LIGHT / _BRIGHTEST_FOG)
    start = _lowest_start(camera)
    lowest = min(start, float(scene.bounds[0][1]))
    if -np.expm1(-_density(fog, lowest) * _farthest(scene, camera)) > threshold:
        return True
    return is_sky_fogged(scene, camera)


def is_sky_fogged(scene: Scene, camera: Camera) -> bool:
    """Return whether fog changes the background by more than half a level."""
    fog, environment = scene.fog, scene.environment
    has_sky_box = environment is not None and environment.is_visible
    if fog is None:
        return False
    if not has_sky_box and np.abs(np.subtract(fog.color, scene.background)).max() <= _threshold(
        scene, _LEAST_LINEAR
    ):
        return False
    threshold, density = _threshold(scene, LEAST_LIGHT / _BRIGHTEST_FOG), _density(fog, _lowest_start(camera))
    if fog.falloff <= 0.0 or -np.expm1(-density / fog.falloff) > threshold:
        return True  # even straight up, which needs no look at the view's rays
    # Light from infinitely far away gets through where rays leave the fog upwards.
    rise = fog.falloff * _least_rise(camera)
    return bool(rise <= 0.0 or -np.expm1(-density / rise) > threshold)


def _threshold(scene: Scene, share: float) -> float:
    """Return the `share` of light that makes no difference. Light that the camera spreads may be of any strength."""
    return share if scene.bloom is None and scene.depth_of_field is None else 0.0


def _farthest(scene: Scene, camera: Camera) -> float:
    """Return the greatest distance of any object from the eye in metres."""
    lower, upper = scene.bounds
    return float(np.linalg.norm(np.maximum(np.abs(lower - camera.position), np.abs(upper - camera.position))))


def _density(fog: Fog, height: float) -> float:
    """Return the density of fog per metre at a height in the world."""
    return float(fog.density * np.exp(min(-fog.falloff * (height - fog.base), _MAX_EXPONENT)))


def _lowest_start(camera: Camera) -> float:
    """Return the height at which the lowest ray of a view begins: the eye's, or with a parallel projection
    that of a corner of the image in the eye's plane."""
    eye = float(camera.position[1])
    if not is_parallel(camera.projection):
        return eye
    points, rays = _rays_of_border(camera)
    starts = points - rays * ((points @ camera.forward) / (rays @ camera.forward))[:, None]
    return eye + float(starts[:, 1].min())


def _least_rise(camera: Camera) -> float:
    """Return the sine of the lowest elevation of all rays of a view: that of a corner, or of an edge between
    two."""
    rays = _rays_of_border(camera)[1]
    return float((rays[:, 1] / np.linalg.norm(rays, axis=1)).min())


def _rays_of_border(camera: Camera) -> tuple[Floats, Floats]:
    """Return points (k, 3) relative to the eye on rays through the border of the image, and the directions
    (k, 3) of these rays, away from the eye."""
    matrix = np.linalg.inv(camera.relative_view_projection)
    edge = np.linspace(-1.0, 1.0, 33)
    sides = [np.stack(np.broadcast_arrays(edge, side), 1) for side in (-1.0, 1.0)]
    at = np.concatenate([*sides, *(points[:, ::-1] for points in sides)])
    ends = [
        np.column_stack([at, np.full(len(at), depth), np.ones(len(at))]) @ matrix.T for depth in (0.25, 0.75)
    ]
    near, far = (points[:, :3] / points[:, 3:] for points in ends)
    rays = far - near
    return near, rays * np.sign(rays @ camera.forward)[:, None]
