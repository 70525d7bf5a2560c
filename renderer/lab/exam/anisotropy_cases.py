"""Anisotropic metal, compared with its equation in float64 along explicit tangents and bitangents.

A plane fills the image, so the point of each pixel is where its ray meets the plane.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from renderer.content.material_shaders import Brushed
from renderer.lab.exam.case import CaseResult, Measures
from renderer.lab.exam.lit_planes import FIELD_OF_VIEW, intersect_plane, measure_views, normalize
from renderer.scene import Camera, Perspective, Scene, SceneBuilder, make_geometry
from renderer.scene.arrays import Floats
from renderer.shaders.tone_mapping import tone_map
from rhi import Device, to_srgb
from rhi.math import translation
from rhi.shading import evaluate

_SIZE: Final = (48, 32)
_BASE: Final = np.array((0.9, 0.7, 0.4))
_LIGHT: Final = np.array((0.4, 0.7, 1.2))
_RANGE: Final = 20.0
_EYE: Final = np.array((0.5, -1.0, 2.5))
_TARGET: Final = np.array((0.0, 0.2, 0.0))


class BrushedView(NamedTuple):
    """A plane of brushed material before a light: what it is made of, the metres of its unit, where it is, and the
    technique that draws it."""

    anisotropy: float
    rotation: float
    roughness: float = 0.35
    metallic: float = 1.0
    unit: float = 1.0
    offset: float = 0.0
    technique: str = "forward"


_VIEWS: Final = {
    "along the tangent": BrushedView(0.8, 0.0),
    "turned, in a technique that stores tangents": BrushedView(0.6, 0.7, technique="deferred_plus"),
    "as far as it goes, partly scattering, in a technique with a buffer": BrushedView(
        1.0, -1.2, metallic=0.3, technique="deferred"
    ),
    "smoother than a highlight may be": BrushedView(0.4, 2.0, roughness=0.0, technique="clustered"),
    "in millimetres, 10⁴ m away": BrushedView(0.8, 0.4, unit=1e-3, offset=1e4, technique="light_pre_pass"),
    "round": BrushedView(0.0, 0.4),
}


def make_brushed_scene(view: BrushedView) -> tuple[Scene, Camera]:
    """Make a plane whose u grows along x and whose v falls along y, a light before it, and a camera that it fills."""
    builder, unit, middle = SceneBuilder("brushed"), view.unit, np.full(3, view.offset)
    corners = np.array([[-9, -9, 0], [9, -9, 0], [-9, 9, 0], [9, 9, 0]], np.float64) * unit
    uv = np.array([[0, 1], [1, 1], [0, 0], [1, 0]], np.float64)
    geometry = make_geometry(corners, np.array([0, 1, 2, 2, 1, 3]), np.tile([0.0, 0.0, 1.0], (4, 1)), uv)
    material = builder.add_material(
        base_color=tuple(_BASE),
        metallic=view.metallic,
        roughness=view.roughness,
        shader=Brushed,
        anisotropy=view.anisotropy,
        anisotropy_rotation=view.rotation,
    )
    builder.add_objects(builder.add_node(translation(middle)), builder.add_mesh(geometry), material)
    builder.lights.sky = builder.lights.ground = builder.background = (0.0, 0.0, 0.0)
    builder.lights.add_point(middle + unit * _LIGHT, _RANGE * unit, intensity=1.5 * unit**2)
    projection = Perspective(FIELD_OF_VIEW, _SIZE[0] / _SIZE[1], near=0.05 * unit)
    return builder.build(), Camera.look_at(
        middle + unit * _EYE, middle + unit * _TARGET, projection=projection
    )


def compute_levels(view: BrushedView) -> Floats:
    """The levels (h, w, 3) of a view, by the equation of Burley (2012) and glTF's KHR_materials_anisotropy."""
    hit = intersect_plane(_SIZE, _EYE, _TARGET)
    normal = np.array((0.0, 0.0, 1.0))
    tangent = np.array((np.cos(view.rotation), np.sin(view.rotation), 0.0))
    bitangent = np.cross(normal, tangent)
    across = max(view.roughness, 0.1) ** 2
    along = across + (1.0 - across) * view.anisotropy**2
    to_eye, to_light = normalize(_EYE - hit), normalize(_LIGHT - hit)
    halfway = normalize(to_eye + to_light)
    parts = (halfway @ tangent / along) ** 2 + (halfway @ bitangent / across) ** 2 + (halfway @ normal) ** 2
    lobe = 1.0 / (along * across * parts**2)  # times π
    for direction in (to_eye, to_light):
        cosine = direction @ normal
        widths = (along * (direction @ tangent)) ** 2 + (across * (direction @ bitangent)) ** 2
        lobe = lobe / (cosine + np.sqrt(widths + cosine**2))
    distance = np.linalg.norm(_LIGHT - hit, axis=-1)
    received = (
        1.5 * np.clip(1.0 - (distance / _RANGE) ** 4, 0.0, 1.0) ** 2 / distance**2 * (to_light @ normal)
    )
    grazing = ((1.0 - (to_eye * halfway).sum(axis=-1)) ** 5)[..., None]
    f0 = 0.04 + (_BASE - 0.04) * view.metallic
    scattered = _BASE * (1.0 - view.metallic) * (1.0 - f0) * (1.0 - grazing)
    light = received[..., None] * (scattered + (f0 + (1.0 - f0) * grazing) * lobe[..., None])
    return np.asarray(255.0 * to_srgb(np.asarray(evaluate(tone_map, light), np.float64)))


def measure_anisotropy(device: Device) -> CaseResult:
    """Draw the views, and measure by how many levels they are off."""
    return measure_views(device, _SIZE, _VIEWS, make_brushed_scene, compute_levels)


MEASURES: Final[Measures] = {92: measure_anisotropy}
