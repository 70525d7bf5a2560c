"""Lighting models of materials' own: what a function must look like to be one, and what it may ask of a surface."""

from __future__ import annotations

from typing import Any, Final

import rhi.shading as sl
from renderer import rules
from renderer.light_kinds.incidence import Incidence
from renderer.shaders.structs import SurfacePoint
from rhi import refuse
from rhi.shading.language.function import ShadingFunction

_RESULT: Final = sl.vec3


def check_lighting_model(shader: type[Any]) -> None:
    """Refuse a `lighting_model` that isn't one: a function of the shading language with the right signature."""
    model, call = shader.lighting_model, f"class {shader.__name__}: lighting_model"
    if model is None:
        return
    if not isinstance(model, ShadingFunction):
        refuse(rules.BAD_LIGHTING_MODEL, call, model)
    if shader.has_anisotropy:
        refuse(rules.BAD_LIGHTING_MODEL, call, "a model beside has_anisotropy", "one of them")
    annotations = dict(model.python.__annotations__)
    actual = [*annotations.values()]
    own = sl.find_element(shader, "parameters")
    expected = [SurfacePoint, Incidence, *([own] if own is not None else []), _RESULT]
    if actual != expected or model.python.__code__.co_argcount != len(expected) - 1:
        refuse(rules.BAD_LIGHTING_MODEL, call, _describe(actual), _describe(expected))


def _describe(types: list[Any]) -> str:
    *parameters, result = [getattr(annotation, "__name__", str(annotation)) for annotation in types] or [
        "nothing"
    ]
    return f"({', '.join(parameters)}) -> {result}"


@sl.function
def surface_roughness(surface: SurfacePoint) -> float:
    """Return the roughness of a surface, from 0 to 1: that of a shininess, where the material is of the specular
    model (Karis 2013: 2 / α² - 2)."""
    if surface.shininess < 0.0:
        return -surface.shininess
    return sl.sqrt(sl.sqrt(2.0 / (surface.shininess + 2.0)))
