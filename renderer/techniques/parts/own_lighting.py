"""Lighting models of materials' own, in the shaders that light surfaces.

A shader that draws the objects of one material shader calls that shader's model. One that lights a geometry buffer
finds the model of each pixel by the number of the shader in the pixel's material, and binds the parameters of each;
where no object in view has a model, neither is there.
"""

from __future__ import annotations

from typing import Any, Final

import rhi.shading as sl
from renderer.light_kinds.generation import define
from renderer.light_kinds.incidence import Incidence
from renderer.shaders.area_lights import SourceShape
from renderer.shaders.structs import SurfacePoint
from renderer.techniques.parts.scene_shader import ReflectingShader
from rhi.errors.shared_caches import cache_once

Models = tuple[tuple[int, type[Any]], ...]
"""Shaders of materials with lighting models, each with its number."""

_OWN: Final = """
class OwnLighting(LightingModelReader):
    def reflect_light(self, surface: SurfacePoint, light: Incidence) -> sl.vec3:
        if not self.has_diffuse_light:
            return sl.vec3(0.0)
        return model(surface, light$parameters)

    def reflect_sphere(self, surface: SurfacePoint, light: Incidence, size: float) -> sl.vec3:
        return self.reflect_light(surface, light)

    def reflect_area(
        self, surface: SurfacePoint, light: Incidence, to_center: sl.vec3, shape: SourceShape
    ) -> sl.vec3:
        return self.reflect_light(surface, light)
"""

_ANY: Final = """
class AnyLighting(LightingModelReader):
$declarations
    def has_model(self, surface: SurfacePoint) -> bool:
        number = int(surface.stretch.y)
        return $tests

    def reflect_light(self, surface: SurfacePoint, light: Incidence) -> sl.vec3:
        number = int(surface.stretch.y)
        material_index = int(surface.stretch.x)
        if not self.has_diffuse_light and self.has_model(surface):
            return sl.vec3(0.0)
$models
        return super().reflect_light(surface, light)

    def reflect_sphere(self, surface: SurfacePoint, light: Incidence, size: float) -> sl.vec3:
        if self.has_model(surface):
            return self.reflect_light(surface, light)
        return super().reflect_sphere(surface, light, size)

    def reflect_area(
        self, surface: SurfacePoint, light: Incidence, to_center: sl.vec3, shape: SourceShape
    ) -> sl.vec3:
        if self.has_model(surface):
            return self.reflect_light(surface, light)
        return super().reflect_area(surface, light, to_center, shape)
"""


class LightingModelReader(ReflectingShader):
    """Base of shaders that reflect light by models of materials' own, which they show as diffuse light."""

    has_lighting_models = True


def with_lighting_models(bases: tuple[type[Any], ...], models: Models) -> tuple[type[Any], ...]:
    """The bases of a shader, with what reflects light by these models if it lights surfaces that may have them."""
    if not any(issubclass(base, ReflectingShader) for base in bases):
        return bases
    for _, shader in models:
        if shader in bases:
            return own_lighting(shader), *bases
    if any(getattr(base, "has_any_material", False) for base in bases):
        return any_lighting(models), *bases
    return bases


@cache_once
def own_lighting(shader: type[Any]) -> type[LightingModelReader]:
    """The class that reflects light by the model of one shader of materials."""
    has_parameters = sl.find_element(shader, "parameters") is not None
    parameters = ", self.parameters[int(surface.stretch.x)]" if has_parameters else ""
    text = _OWN.replace("$parameters", parameters)
    return _define(text, "OwnLighting", model=shader.lighting_model)


@cache_once
def any_lighting(models: Models) -> type[LightingModelReader]:
    """The class that reflects light by the model of each pixel's material."""
    names: dict[str, Any] = {}
    declarations, calls = "", ""
    for number, shader in models:
        names[f"model_{number}"] = shader.lighting_model
        element, parameters = sl.find_element(shader, "parameters"), ""
        if element is not None:
            names[f"Parameters_{number}"] = element
            declarations += f"    parameters_{number}: sl.Storage[Parameters_{number}]\n"
            parameters = f", self.parameters_{number}[material_index]"
        calls += f"        if number == {number}:\n"
        calls += f"            return model_{number}(surface, light{parameters})\n"
    tests = " or ".join(f"number == {number}" for number, _ in models)
    text = _ANY.replace("$declarations", declarations).replace("$tests", tests).replace("$models", calls)
    return _define(text, "AnyLighting", **names)


def _define(text: str, name: str, **names: Any) -> type[LightingModelReader]:
    shader: type[LightingModelReader] = define(
        text,
        name,
        __name__,
        LightingModelReader=LightingModelReader,
        SurfacePoint=SurfacePoint,
        Incidence=Incidence,
        SourceShape=SourceShape,
        sl=sl,
        **names,
    )
    return shader
