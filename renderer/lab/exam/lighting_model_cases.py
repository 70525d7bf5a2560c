"""Lighting models of materials' own, compared with their equations in float64.

A plane of three strips fills the image: two with models of their own, with a plain one between them. So a pass over a
geometry buffer has to tell them apart.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np

from renderer.content.material_shaders import Cloth, Skin, Toon
from renderer.lab.exam.case import CaseResult, Measures
from renderer.lab.exam.lit_planes import FIELD_OF_VIEW, intersect_plane, measure_views, normalize
from renderer.scene import Camera, Perspective, Scene, SceneBuilder, make_geometry
from renderer.scene.arrays import Floats
from renderer.shaders.tone_mapping import tone_map
from rhi import Device, to_srgb
from rhi.math import translation
from rhi.shading import evaluate

_SIZE: Final = (48, 32)
_BASE: Final = np.array((0.8, 0.5, 0.3))
_LIGHT: Final = np.array((0.4, 0.7, 0.6))
_RANGE: Final = 20.0
_EYE: Final = np.array((0.3, -1.0, 2.5))
_TARGET: Final = np.array((0.0, 0.2, 0.0))
_STRIP: Final = 0.6
"""Half the width of the plain strip in the middle."""
_STEPS, _SOFTNESS, _WRAP, _SHEEN, _ROUGHNESS = 4.0, 0.5, (0.6, 0.3, 0.1), (0.5, 0.6, 0.9), 0.4


class ModelView(NamedTuple):
    """The models of the left and the right strip, the metres of the view's unit, where it is, and the technique that
    draws it."""

    left: str
    right: str
    technique: str
    unit: float = 1.0
    offset: float = 0.0


_VIEWS: Final = {
    "object by object": ModelView("toon", "cloth", "forward"),
    "by volumes of lights": ModelView("cloth", "skin", "deferred"),
    "by tiles": ModelView("skin", "toon", "tiled_deferred"),
    "material by material": ModelView("toon", "skin", "deferred_plus"),
    "where terms of light are collected": ModelView("skin", "cloth", "light_pre_pass"),
    "in millimetres, 10⁴ m away": ModelView("cloth", "toon", "clustered_deferred", unit=1e-3, offset=1e4),
}
_MATERIALS: Final[dict[str, dict[str, Any]]] = {
    "plain": {"specular_color": (0.0, 0.0, 0.0)},
    "toon": {"shader": Toon, "steps": _STEPS, "softness": _SOFTNESS},
    "cloth": {"shader": Cloth, "sheen_color": _SHEEN, "metallic": 0.0, "roughness": _ROUGHNESS},
    "skin": {"shader": Skin, "wrap": _WRAP},
}


def make_model_scene(view: ModelView) -> tuple[Scene, Camera]:
    """Make the strips, a light before them, and a camera that they fill."""
    builder, unit, middle = SceneBuilder("models"), view.unit, np.full(3, view.offset)
    node = builder.add_node(translation(middle))
    for name, low, high in ((view.left, -9, -_STRIP), ("plain", -_STRIP, _STRIP), (view.right, _STRIP, 9)):
        corners = np.array([[low, -9, 0], [high, -9, 0], [low, 9, 0], [high, 9, 0]], np.float64) * unit
        geometry = make_geometry(corners, np.array([0, 1, 2, 2, 1, 3]), np.tile([0.0, 0.0, 1.0], (4, 1)))
        material = builder.add_material(base_color=tuple(_BASE), **_MATERIALS[name])
        builder.add_objects(node, builder.add_mesh(geometry), material)
    builder.lights.sky = builder.lights.ground = builder.background = (0.0, 0.0, 0.0)
    builder.lights.add_point(middle + unit * _LIGHT, _RANGE * unit, intensity=unit**2)
    projection = Perspective(FIELD_OF_VIEW, _SIZE[0] / _SIZE[1], near=0.05 * unit)
    eye, target = middle + unit * _EYE, middle + unit * _TARGET
    return builder.build(), Camera.look_at(eye, target, projection=projection)


def compute_levels(view: ModelView) -> Floats:
    """The levels (h, w, 3) of a view by the equations of its models."""
    hit = intersect_plane(_SIZE, _EYE, _TARGET)
    to_eye, to_light = normalize(_EYE - hit), normalize(_LIGHT - hit)
    squared = ((_LIGHT - hit) ** 2).sum(axis=-1)
    irradiance = np.clip(1.0 - (squared / _RANGE**2) ** 2, 0.0, 1.0) ** 2 / squared
    facing = to_light[..., 2]
    answers = {name: reflect(name, facing, to_eye, to_light) for name in (view.left, "plain", view.right)}
    reflected = np.where((hit[..., 0] < -_STRIP)[..., None], answers[view.left], answers["plain"])
    reflected = np.where((hit[..., 0] > _STRIP)[..., None], answers[view.right], reflected)
    light = irradiance[..., None] * reflected
    return np.asarray(255.0 * to_srgb(np.asarray(evaluate(tone_map, light), np.float64)))


def reflect(model: str, facing: Floats, to_eye: Floats, to_light: Floats) -> Floats:
    """The light (h, w, 3) that a model reflects for each unit of irradiance; the normal is z."""
    if model == "plain":
        return np.asarray(facing[..., None] * _BASE)
    if model == "toon":
        whole, part = np.divmod(facing * _STEPS, 1.0)
        t = np.clip((part - (1.0 - _SOFTNESS)) / _SOFTNESS, 0.0, 1.0)
        return np.asarray(((whole + t * t * (3.0 - 2.0 * t)) / _STEPS)[..., None] * _BASE)
    if model == "skin":
        wrap = np.array(_WRAP)
        return np.asarray(_BASE * np.maximum(facing[..., None] + wrap, 0.0) / (1.0 + wrap) ** 2)
    sine = np.sqrt(1.0 - normalize(to_eye + to_light)[..., 2] ** 2)
    inverse = 1.0 / _ROUGHNESS**2
    lobe = (2.0 + inverse) / (2.0 * np.pi) * sine**inverse
    lobe = np.pi * lobe / (4.0 * (facing + to_eye[..., 2] - facing * to_eye[..., 2]))
    scattered = _BASE * 0.96  # what a surface mirrors, it doesn't scatter
    return np.asarray(facing[..., None] * (scattered + np.array(_SHEEN) * lobe[..., None]))


def measure_lighting_models(device: Device) -> CaseResult:
    """Draw the views, and measure by how many levels they are off."""
    return measure_views(device, _SIZE, _VIEWS, make_model_scene, compute_levels)


MEASURES: Final[Measures] = {96: measure_lighting_models}
