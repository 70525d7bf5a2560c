"""What the shaders of all techniques share: the vertex stage of the scene, and the light that reaches all surfaces.

Techniques combine these classes with their own. A feature that a scene lacks costs nothing: the bases have no images
and no lights, and each of the other classes adds one feature with its binding. Every pass over the scene's geometry has
the vertex stage of `SceneShader`, so that equal code gives equal depth: a later pass may test it with EQUAL.
"""

from __future__ import annotations

from typing import Final

from renderer.scene import ShadingModel
from renderer.shaders.fog import FogConstants, through_fog
from renderer.shaders.lighting import (
    BRIGHTEST,
    ambient_light,
    directional_incidence,
    highlight,
    reflected_light,
    safe_normalize,
    through_haze,
    tone_map,
)
from renderer.shaders.metals import (
    ambient_light_of_metal,
    metal_surface,
    metal_terms,
    reflected_by_metal,
    shininess_of_metal,
)
from renderer.shaders.structs import (
    Ambient,
    DirectionalLight,
    Haze,
    Incidence,
    Material,
    Object,
    ObjectPosition,
    SurfacePoint,
    SurfaceVarying,
    Vertex,
    ViewConstants,
    relative_position,
)
from renderer.shadows import SHADOW_PARTS, ShadowReceiver
from rhi.shading import (
    Precision,
    Shader,
    Storage,
    Uniform,
    instance_index,
    ivec3,
    min,
    vec2,
    vec3,
    vec4,
)

_METALLIC: Final = int(ShadingModel.METALLIC_ROUGHNESS)


class SceneShader(Shader):
    """Draws the scene's geometry."""

    # Highlights end up in 8 bits: a pow as exact as GL's (128 ulp) halves the time of a lit pass on OpenCL.
    precision = Precision.FAST

    view: Uniform[ViewConstants]
    objects: Storage[Object]
    places: Storage[ObjectPosition]
    has_planes = False

    def vertex(self, v: Vertex) -> SurfaceVarying:
        return self.transform(v, vec2(0.0), vec4(1.0, 0.0, 0.0, 1.0), vec4(1.0))

    def transform(self, v: Vertex, uv2: vec2, tangent: vec4, color: vec4) -> SurfaceVarying:
        row = self.find_object()
        thing = self.objects[row]
        position = thing.linear @ v.position + relative_position(self.places[row], self.view)
        return SurfaceVarying(
            clip=self.view.relative_view_projection @ vec4(position, 1.0),
            position=position,
            normal=thing.normal @ v.normal,
            uv=v.uv,
            uv2=uv2,
            tangent=self.turn_tangent(thing, tangent),
            color=color,
            material=thing.material,
            lights=self.list_lights(thing),
        )

    def turn_tangent(self, thing: Object, tangent: vec4) -> vec4:
        """Return a tangent of a mesh as it is in the world."""
        return tangent

    def find_object(self) -> int:
        """Return the row of the object that is drawn."""
        return instance_index()

    def list_lights(self, thing: Object) -> ivec3:
        """Return where the point lights that light the object begin in the light rows, where they end and the spot
        lights begin, and where those end."""
        return ivec3(thing.lights_begin, thing.points_end, thing.lights_end)

    def find_texel(self, v: SurfaceVarying) -> vec4:
        """Return what multiplies the base colour of the fragment's material."""
        return vec4(1.0)

    def find_normal(self, v: SurfaceVarying) -> vec3:
        """Return the unit normal of the fragment, as maps bend it."""
        return self.turn_side(self.bend(safe_normalize(v.normal), v))

    def find_plane(self, v: SurfaceVarying, normal: vec3) -> vec3:
        """Return the unit normal of the fragment's surface, which maps don't bend, given the `normal` that they do."""
        return normal

    def bend(self, normal: vec3, v: SurfaceVarying) -> vec3:
        """Return a unit normal as maps bend it."""
        return normal

    def turn_side(self, normal: vec3) -> vec3:
        """Return the normal of the side that is seen, given that of the front."""
        return normal


class ReflectingShader(Shader):
    """How surfaces reflect light: by the specular model. The other classes with these methods have other models."""

    def with_model(self, surface: SurfacePoint, material: Material, metal: vec2) -> SurfacePoint:
        """Return a surface as the model needs it, given its base colour, and how metallic and rough it is."""
        return surface

    def find_shininess(self, material: Material, metal: vec2) -> float:
        """Return the shininess of such a surface alone."""
        return material.shininess

    def find_terms(self, surface: SurfacePoint, to_light: vec3) -> vec3:
        """Return what the surface does with light from a unit direction in front of it: the terms of its base color, of
        its specular color, and of white."""
        return vec3(1.0, highlight(surface, to_light), 0.0)

    def reflect_light(self, surface: SurfacePoint, light: Incidence) -> vec3:
        """Return the light that the surface reflects to the eye."""
        return reflected_light(surface, light)

    def reflect_ambient(self, surface: SurfacePoint, ambient: Ambient, material: Material) -> vec3:
        """Return the ambient light that the surface sends to the eye."""
        return ambient_light(surface, ambient, material.rim_strength, material.rim_power)


class WithMetals(ReflectingShader):
    """All surfaces are of the metallic-roughness model."""

    def with_model(self, surface: SurfacePoint, material: Material, metal: vec2) -> SurfacePoint:
        return metal_surface(surface, metal.x, metal.y)

    def find_shininess(self, material: Material, metal: vec2) -> float:
        return shininess_of_metal(metal.y)

    def find_terms(self, surface: SurfacePoint, to_light: vec3) -> vec3:
        return metal_terms(surface, to_light)

    def reflect_light(self, surface: SurfacePoint, light: Incidence) -> vec3:
        return reflected_by_metal(surface, light)

    def reflect_ambient(self, surface: SurfacePoint, ambient: Ambient, material: Material) -> vec3:
        return ambient_light_of_metal(surface, ambient)


class WithBothModels(ReflectingShader):
    """Some surfaces are of the metallic-roughness model: those with a negative `shininess`."""

    def with_model(self, surface: SurfacePoint, material: Material, metal: vec2) -> SurfacePoint:
        if material.model == _METALLIC:
            return metal_surface(surface, metal.x, metal.y)
        return surface

    def find_shininess(self, material: Material, metal: vec2) -> float:
        return shininess_of_metal(metal.y) if material.model == _METALLIC else material.shininess

    def find_terms(self, surface: SurfacePoint, to_light: vec3) -> vec3:
        if surface.shininess < 0.0:
            return metal_terms(surface, to_light)
        return vec3(1.0, highlight(surface, to_light), 0.0)

    def reflect_light(self, surface: SurfacePoint, light: Incidence) -> vec3:
        if surface.shininess < 0.0:
            return reflected_by_metal(surface, light)
        return reflected_light(surface, light)

    def reflect_ambient(self, surface: SurfacePoint, ambient: Ambient, material: Material) -> vec3:
        if surface.shininess < 0.0:
            return ambient_light_of_metal(surface, ambient)
        return ambient_light(surface, ambient, material.rim_strength, material.rim_power)


class FinishShader(Shader):
    """Makes pixels of light."""

    precision = Precision.FAST

    def finish(self, color: vec3, position: vec3) -> vec4:
        """Return the pixel of a surface that sends this light to the eye."""
        return vec4(self.through_air(tone_map(color), position), 1.0)

    def through_air(self, color: vec3, position: vec3) -> vec3:
        return color


class ShadingShader(FinishShader, ReflectingShader, ShadowReceiver):
    """Shades a surface, wherever it comes from: ambient light."""

    ambient: Uniform[Ambient]

    def shade(self, surface: SurfacePoint, material: Material) -> vec3:
        """Return the light of the surface without that of point and spot lights."""
        color = self.reflect_ambient(surface, self.ambient, material)
        color += self.emitted(surface, material)
        return color + self.sunlight(surface)

    def emitted(self, surface: SurfacePoint, material: Material) -> vec3:
        return vec3(0.0)

    def sunlight(self, surface: SurfacePoint) -> vec3:
        return vec3(0.0)


class WithEmission(ShadingShader):
    """Adds light that materials emit."""

    def emitted(self, surface: SurfacePoint, material: Material) -> vec3:
        return super().emitted(surface, material) + surface.base_color * material.emission


class WithEmissiveColors(ShadingShader):
    """Adds light of a colour of its own that materials emit."""

    def emitted(self, surface: SurfacePoint, material: Material) -> vec3:
        return super().emitted(surface, material) + material.emissive * surface.emissive


class WithDirectionalLights(ShadingShader):
    """Adds directional lights."""

    directional_lights: Storage[DirectionalLight]

    def sunlight(self, surface: SurfacePoint) -> vec3:
        color = vec3(0.0)
        for i in range(len(self.directional_lights)):
            light = self.reflect_light(surface, directional_incidence(self.directional_lights[i]))
            color += self.unblocked_sun(light, surface.position, surface.plane, i)
        return color


class WithSun(ShadingShader):
    """Adds a single directional light. Without a loop, a compiler sees that the light is the same for all fragments,
    which saves llvmpipe a twentieth of the pass."""

    directional_lights: Storage[DirectionalLight]

    def sunlight(self, surface: SurfacePoint) -> vec3:
        light = self.reflect_light(surface, directional_incidence(self.directional_lights[0]))
        return self.unblocked_sun(light, surface.position, surface.plane, 0)


class WithHaze(FinishShader):
    """Adds haze, which fades to the background. That is a final colour, so it is mixed in after tone mapping."""

    haze: Uniform[Haze]

    def through_air(self, color: vec3, position: vec3) -> vec3:
        return through_haze(color, position, self.haze)


class WithFog(FinishShader):
    """Adds fog, through which light goes before its tones are mapped."""

    fog: Uniform[FogConstants]

    def finish(self, color: vec3, position: vec3) -> vec4:
        return super().finish(through_fog(color, position, self.fog), position)


class Bright(FinishShader):
    """Leaves light linear and of any strength, for glow."""

    def finish(self, color: vec3, position: vec3) -> vec4:
        return vec4(min(self.through_air(color, position), BRIGHTEST), 1.0)


SHADING_PARTS: Final[dict[str, type[Shader]]] = {
    "directional_lights": WithDirectionalLights,
    "haze": WithHaze,
    "fog": WithFog,
    "bright": Bright,
    "emission": WithEmission,
    "emissive_colors": WithEmissiveColors,
    "metals": WithMetals,
    "both_models": WithBothModels,
    **SHADOW_PARTS,
}
"""The features that can be added to a `ShadingShader`, by the names of their bindings where they have one."""
