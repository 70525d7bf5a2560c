"""Baked light: the irradiance of a light over a plane, in closed form, beside a light that isn't baked.

The plane fills the image. Its light map is sampled from the equation that the image is compared with, so what is off is
what a map of so many texels, its filter and a geometry buffer round.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np

from renderer.lab.exam.case import CaseResult, Measures
from renderer.lab.exam.lit_planes import FIELD_OF_VIEW, intersect_plane, measure_views
from renderer.scene import Camera, Perspective, Scene, SceneBuilder, TextureMap, make_geometry
from renderer.scene.arrays import Floats
from renderer.shaders.tone_mapping import tone_map
from rhi import Device, SamplerDescriptor, Wrap, to_srgb
from rhi.shading import evaluate

_SIZE: Final = (48, 32)
_BASE: Final = np.array((0.8, 0.6, 0.4))
_TINT: Final = np.array((1.0, 0.8, 0.5))
_BAKED: Final = np.array((0.4, 0.7, 0.9))
_MOVING: Final = np.array((-0.6, -0.2, 0.7))
_RANGE: Final = 20.0
_EYE: Final = np.array((0.3, -1.0, 2.5))
_TARGET: Final = np.array((0.0, 0.2, 0.0))
_HALF: Final = 4.0
_TEXELS: Final = 256
_CLAMPED: Final = SamplerDescriptor(wrap_u=Wrap.CLAMP, wrap_v=Wrap.CLAMP)


class BakedView(NamedTuple):
    """A plane with a light map: the technique that draws it, whether a base map is read by other texture coordinates,
    and the intensities of the light that was baked and of the one that wasn't."""

    technique: str
    has_base_map: bool = False
    baked: float = 1.0
    moving: float = 0.3


_VIEWS: Final = {
    "object by object, by the second texture coordinates": BakedView("forward", has_base_map=True),
    "in a geometry buffer": BakedView("deferred", has_base_map=True),
    "brighter than 1 by far": BakedView("clustered_deferred", baked=40.0, moving=0.0),
    "by tiles": BakedView("tiled_deferred"),
    "material by material": BakedView("deferred_plus"),
    "where terms of light are collected": BakedView("light_pre_pass", has_base_map=True),
    "where it gives no light at all, and the sky does": BakedView("deferred", baked=0.0, moving=0.5),
}


def make_baked_scene(view: BakedView) -> tuple[Scene, Camera]:
    """Make the plane, the light that isn't baked, and a camera that the plane fills."""
    builder = SceneBuilder("baked")
    corners = np.array([[-1, -1, 0], [1, -1, 0], [-1, 1, 0], [1, 1, 0]], np.float64) * _HALF
    uv = np.array([[0, 1], [1, 1], [0, 0], [1, 0]], np.float64)
    geometry = make_geometry(
        corners, np.array([0, 1, 2, 2, 1, 3]), np.tile([0.0, 0.0, 1.0], (4, 1)), uv * 7.0, uv2=uv
    )
    middle = ((np.arange(_TEXELS) + 0.5) / _TEXELS * 2.0 - 1.0) * _HALF
    points = np.stack(np.broadcast_arrays(middle[None, :], -middle[:, None], 0.0), axis=-1)
    irradiance = measure_irradiance(points, _BAKED, view.baked)[..., None] * _TINT
    baked = builder.add_image((0.5 * irradiance).astype(np.float32))
    values: dict[str, Any] = {"light_map_texture": TextureMap(baked, uv_set=1, sampler=_CLAMPED)}
    if view.has_base_map:
        values["texture"] = builder.add_image(np.full((4, 4, 4), (255, 188, 255, 255), np.uint8))
    material = builder.add_material(
        base_color=tuple(_BASE), specular_color=(0.0, 0.0, 0.0), light_map_color=(2.0, 2.0, 2.0), **values
    )
    builder.add_objects(builder.add_node(), builder.add_mesh(geometry), material)
    builder.background = (0.0, 0.0, 0.0)
    builder.lights.sky, builder.lights.ground = (0.3, 0.5, 0.7), (0.2, 0.1, 0.1)  # which the map replaces
    builder.lights.add_point(_MOVING, _RANGE, intensity=view.moving)
    projection = Perspective(FIELD_OF_VIEW, _SIZE[0] / _SIZE[1], near=0.05)
    return builder.build(), Camera.look_at(_EYE, _TARGET, projection=projection)


def measure_irradiance(points: Floats, light: Floats, intensity: float) -> Floats:
    """The irradiance (...) at points (..., 3) of the plane z = 0, of a point light."""
    away = light - points
    squared = (away**2).sum(axis=-1)
    window = np.clip(1.0 - (squared / _RANGE**2) ** 2, 0.0, 1.0) ** 2
    return np.asarray(intensity * window * away[..., 2] / squared**1.5)


def compute_levels(view: BakedView) -> Floats:
    """The levels (h, w, 3) of a view."""
    hit = intersect_plane(_SIZE, _EYE, _TARGET)
    base = _BASE.copy()
    if view.has_base_map:
        base[1] *= ((188 / 255 + 0.055) / 1.055) ** 2.4
    arriving = measure_irradiance(hit, _BAKED, view.baked)[..., None] * _TINT
    arriving = arriving + measure_irradiance(hit, _MOVING, view.moving)[..., None]
    return np.asarray(255.0 * to_srgb(np.asarray(evaluate(tone_map, arriving * base), np.float64)))


def measure_light_maps(device: Device) -> CaseResult:
    """Draw the views, and measure by how many levels they are off."""
    return measure_views(device, _SIZE, _VIEWS, make_baked_scene, compute_levels)


MEASURES: Final[Measures] = {101: measure_light_maps}
