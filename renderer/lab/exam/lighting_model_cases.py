"""Lighting models of materials' own, compared with their equations in float64.

A plane of three strips fills the image: two with models of their own, with a plain one between them. So a pass over a
geometry buffer has to tell them apart.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np

from renderer.content.material_shaders import Cloth, Skin, Toon
from renderer.lab.exam.case import CaseImage, CaseResult, Measures, largest_error
from renderer.lab.exam.ray_traced_cases import draw
from renderer.lab.exam.scenes import shows_something
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
    projection = Perspective(0.9, _SIZE[0] / _SIZE[1], near=0.05 * unit)
    eye, target = middle + unit * _EYE, middle + unit * _TARGET
    return builder.build(), Camera.look_at(eye, target, projection=projection)


def compute_levels(view: ModelView) -> Floats:
    """The levels (h, w, 3) of a view by the equations of its models."""
    width, height = _SIZE
    camera = Camera.look_at(_EYE, _TARGET, projection=Perspective(0.9, width / height))
    x = ((np.arange(width) + 0.5) / width * 2.0 - 1.0) * np.tan(0.45) * width / height
    y = (1.0 - (np.arange(height) + 0.5) / height * 2.0) * np.tan(0.45)
    rays = np.stack(np.broadcast_arrays(x[None, :], y[:, None], -1.0), axis=-1) @ camera.rotation
    hit = _EYE + rays * (-_EYE[2] / rays[..., 2])[..., None]
    to_eye, to_light = _unit(_EYE - hit), _unit(_LIGHT - hit)
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
    sine = np.sqrt(1.0 - _unit(to_eye + to_light)[..., 2] ** 2)
    inverse = 1.0 / _ROUGHNESS**2
    lobe = (2.0 + inverse) / (2.0 * np.pi) * sine**inverse
    lobe = np.pi * lobe / (4.0 * (facing + to_eye[..., 2] - facing * to_eye[..., 2]))
    scattered = _BASE * 0.96  # what a surface mirrors, it doesn't scatter
    return np.asarray(facing[..., None] * (scattered + np.array(_SHEEN) * lobe[..., None]))


def _unit(v: Floats) -> Floats:
    return np.asarray(v / np.linalg.norm(v, axis=-1, keepdims=True))


def measure_lighting_models(device: Device) -> CaseResult:
    """Draw the views, and measure by how many levels they are off."""
    numbers, holds, images = dict[str, object](), dict[str, bool](), dict[str, CaseImage]()
    error = 0.0
    for title, view in _VIEWS.items():
        scene, camera = make_model_scene(view)
        image = draw(device, scene, camera, _SIZE, technique=view.technique)
        off = np.abs(image[..., :3].astype(np.float64) - compute_levels(view)).max(axis=2)
        numbers[f"{title}: levels off"] = round(float(off.max()), 3)
        error = largest_error(error, float(off.max()))
        for description, is_true in shows_something([image]).items():
            holds[f"{title}: {description}"] = is_true
        images |= {title: image, f"{title}, off": off}
    return CaseResult(error, numbers, holds, lambda: images)


MEASURES: Final[Measures] = {96: measure_lighting_models}
