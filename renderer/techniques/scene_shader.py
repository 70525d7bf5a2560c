"""What the shaders of all techniques share: the vertex stage of the scene, and the light that reaches all surfaces.

Techniques combine these classes with their own. A feature that a scene lacks costs nothing: the bases have no images
and no lights, and each of the other classes adds one feature with its binding. Every pass over the scene's geometry has
the vertex stage of `SceneShader`, so that equal code gives equal depth: a later pass may test it with EQUAL.
"""

from __future__ import annotations

from typing import Final

from renderer.shaders.lighting import ambient_light, directional_light, through_haze, tone_map
from renderer.shaders.structs import (
    Ambient,
    DirectionalLight,
    Haze,
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
    Texture2DArray,
    Uniform,
    instance_index,
    ivec3,
    vec2,
    vec3,
    vec4,
)


class SceneShader(Shader):
    """Draws the scene's geometry."""

    # Highlights end up in 8 bits: a pow as exact as GL's (128 ulp) halves the time of a lit pass on OpenCL.
    precision = Precision.FAST

    view: Uniform[ViewConstants]
    objects: Storage[Object]
    places: Storage[ObjectPosition]

    def vertex(self, v: Vertex) -> SurfaceVarying:
        row = instance_index()
        thing = self.objects[row]
        return self.transform(v, row, thing, ivec3(thing.lights_begin, thing.points_end, thing.lights_end))

    def transform(self, v: Vertex, row: int, thing: Object, lights: ivec3) -> SurfaceVarying:
        position = thing.linear @ v.position + relative_position(self.places[row], self.view)
        return SurfaceVarying(
            clip=self.view.relative_view_projection @ vec4(position, 1.0),
            position=position,
            normal=thing.normal @ v.normal,
            uv=v.uv,
            material=thing.material,
            lights=lights,
        )

    def texel(self, image: int, uv: vec2) -> vec4:
        return vec4(1.0)


class Textured(SceneShader):
    """Adds images: the layers of one texture."""

    images: Texture2DArray

    def texel(self, image: int, uv: vec2) -> vec4:
        # All fragments of a primitive take the same branch, so the derivatives of uv are defined.
        if image < 0:
            return vec4(1.0)
        return self.images.sample(vec3(uv, float(image)))


class FinishShader(Shader):
    """Makes pixels of light."""

    precision = Precision.FAST

    def finish(self, color: vec3, position: vec3) -> vec4:
        """Return the pixel of a surface that sends this light to the eye."""
        return vec4(self.through_air(tone_map(color), position), 1.0)

    def through_air(self, color: vec3, position: vec3) -> vec3:
        return color


class ShadingShader(FinishShader, ShadowReceiver):
    """Shades a surface, wherever it comes from: ambient light with the rim term."""

    ambient: Uniform[Ambient]

    def shade(self, surface: SurfacePoint, material: Material) -> vec3:
        """Return the light of the surface without that of point and spot lights."""
        color = ambient_light(surface, self.ambient, material.rim_strength, material.rim_power)
        color += self.emitted(surface, material)
        return color + self.sunlight(surface)

    def emitted(self, surface: SurfacePoint, material: Material) -> vec3:
        return vec3(0.0)

    def sunlight(self, surface: SurfacePoint) -> vec3:
        return vec3(0.0)


class WithEmission(ShadingShader):
    """Adds light that materials emit."""

    def emitted(self, surface: SurfacePoint, material: Material) -> vec3:
        return surface.base_color * material.emission


class WithDirectionalLights(ShadingShader):
    """Adds directional lights."""

    directional_lights: Storage[DirectionalLight]

    def sunlight(self, surface: SurfacePoint) -> vec3:
        color = vec3(0.0)
        for i in range(len(self.directional_lights)):
            light = directional_light(surface, self.directional_lights[i])
            color += self.unblocked_sun(light, surface.position, surface.normal, i)
        return color


class WithSun(ShadingShader):
    """Adds a single directional light. Without a loop, a compiler sees that the light is the same for all fragments,
    which saves llvmpipe a twentieth of the pass."""

    directional_lights: Storage[DirectionalLight]

    def sunlight(self, surface: SurfacePoint) -> vec3:
        light = directional_light(surface, self.directional_lights[0])
        return self.unblocked_sun(light, surface.position, surface.normal, 0)


class WithHaze(FinishShader):
    """Adds haze, which fades to the background. That is a final colour, so it is mixed in after tone mapping."""

    haze: Uniform[Haze]

    def through_air(self, color: vec3, position: vec3) -> vec3:
        return through_haze(color, position, self.haze)


SHADING_PARTS: Final[dict[str, type[Shader]]] = {
    "directional_lights": WithDirectionalLights,
    "haze": WithHaze,
    "emission": WithEmission,
    **SHADOW_PARTS,
}
"""The features that can be added to a `ShadingShader`, by the names of their bindings where they have one."""
