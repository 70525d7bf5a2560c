"""The forward shader: each fragment is lit by all lights that reach its object, in one pass.

A feature that a scene lacks costs nothing: `ForwardShader` has no lights and no textures, each of the classes
below adds one feature with its binding, and `forward_variant` combines those that are needed.
"""

from __future__ import annotations

from functools import cache
from typing import Final

from renderer.shaders.lighting import (
    ambient_light,
    directional_light,
    in_range,
    point_light,
    safe_normalize,
    spot_light,
    tone_map,
)
from renderer.shaders.structs import (
    Ambient,
    DirectionalLight,
    Haze,
    Material,
    Object,
    ObjectPosition,
    PointLight,
    SpotLight,
    SurfacePoint,
    SurfaceVarying,
    Vertex,
    ViewConstants,
    relative_position,
)
from rhi.shading import (
    Precision,
    Shader,
    Storage,
    Texture2DArray,
    Uniform,
    exp,
    instance_index,
    ivec3,
    length,
    mix,
    vec2,
    vec3,
    vec4,
)


class ForwardShader(Shader):
    """The base of all variants: ambient light with the rim term."""

    # Highlights end up in 8 bits: a pow as exact as GL's (128 ulp) halves the time of a lit pass on OpenCL.
    precision = Precision.FAST

    view: Uniform[ViewConstants]
    ambient: Uniform[Ambient]
    objects: Storage[Object]
    places: Storage[ObjectPosition]
    materials: Storage[Material]

    def vertex(self, v: Vertex) -> SurfaceVarying:
        row = instance_index()
        thing = self.objects[row]
        position = thing.linear @ v.position + relative_position(self.places[row], self.view)
        return SurfaceVarying(
            clip=self.view.relative_view_projection @ vec4(position, 1.0),
            position=position,
            normal=thing.normal @ v.normal,
            uv=v.uv,
            material=thing.material,
            lights=ivec3(thing.lights_begin, thing.points_end, thing.lights_end),
        )

    def fragment(self, v: SurfaceVarying) -> vec4:
        material = self.materials[v.material]
        surface = SurfacePoint(
            position=v.position,
            normal=safe_normalize(v.normal),
            to_eye=safe_normalize(-v.position),
            base_color=material.base_color.rgb * self.texel(material.texture, v.uv),
            specular_color=material.specular_color,
            shininess=material.shininess,
        )
        color = ambient_light(surface, self.ambient, material.rim_strength, material.rim_power)
        color += self.emitted(surface, material)
        color += self.sunlight(surface)
        color += self.pointlight(surface, v.lights.x, v.lights.y)
        color += self.spotlight(surface, v.lights.y, v.lights.z)
        return vec4(self.through_air(tone_map(color), v.position), 1.0)

    def texel(self, image: int, uv: vec2) -> vec3:
        return vec3(1.0)

    def emitted(self, surface: SurfacePoint, material: Material) -> vec3:
        return vec3(0.0)

    def sunlight(self, surface: SurfacePoint) -> vec3:
        return vec3(0.0)

    def pointlight(self, surface: SurfacePoint, begin: int, end: int) -> vec3:
        return vec3(0.0)

    def spotlight(self, surface: SurfacePoint, begin: int, end: int) -> vec3:
        return vec3(0.0)

    def through_air(self, color: vec3, position: vec3) -> vec3:
        return color


class Textured(ForwardShader):
    """Adds images: the layers of one texture."""

    images: Texture2DArray

    def texel(self, image: int, uv: vec2) -> vec3:
        # All fragments of a primitive take the same branch, so the derivatives of uv are defined.
        if image < 0:
            return vec3(1.0)
        return self.images.sample(vec3(uv, float(image))).rgb


class WithEmission(ForwardShader):
    """Adds light that materials emit."""

    def emitted(self, surface: SurfacePoint, material: Material) -> vec3:
        return surface.base_color * material.emission


class WithDirectionalLights(ForwardShader):
    """Adds directional lights."""

    directional_lights: Storage[DirectionalLight]

    def sunlight(self, surface: SurfacePoint) -> vec3:
        color = vec3(0.0)
        for i in range(len(self.directional_lights)):
            color += directional_light(surface, self.directional_lights[i])
        return color


class WithSun(ForwardShader):
    """Adds a single directional light. Without a loop, a compiler sees that the light is the same for all fragments,
    which saves llvmpipe a twentieth of the pass."""

    directional_lights: Storage[DirectionalLight]

    def sunlight(self, surface: SurfacePoint) -> vec3:
        return directional_light(surface, self.directional_lights[0])


class WithPointLights(ForwardShader):
    """Adds point lights."""

    point_lights: Storage[PointLight]
    light_rows: Storage[int]

    def pointlight(self, surface: SurfacePoint, begin: int, end: int) -> vec3:
        color = vec3(0.0)
        for i in range(begin, end):
            row = self.light_rows[i]
            if in_range(surface, self.point_lights[row].position, self.point_lights[row].range):
                color += point_light(surface, self.point_lights[row])
        return color


class WithSpotLights(ForwardShader):
    """Adds spot lights."""

    spot_lights: Storage[SpotLight]
    light_rows: Storage[int]

    def spotlight(self, surface: SurfacePoint, begin: int, end: int) -> vec3:
        color = vec3(0.0)
        for i in range(begin, end):
            row = self.light_rows[i]
            if in_range(surface, self.spot_lights[row].position, self.spot_lights[row].range):
                color += spot_light(surface, self.spot_lights[row])
        return color


class WithHaze(ForwardShader):
    """Adds haze, which fades to the background. That is a final colour, so it is mixed in after tone mapping."""

    haze: Uniform[Haze]

    def through_air(self, color: vec3, position: vec3) -> vec3:
        return mix(self.haze.color, color, exp(-self.haze.density * length(position)))


PARTS: Final[dict[str, type[ForwardShader]]] = {
    "images": Textured,
    "directional_lights": WithDirectionalLights,
    "point_lights": WithPointLights,
    "spot_lights": WithSpotLights,
    "haze": WithHaze,
    "emission": WithEmission,
}
"""The features that can be added to the forward shader, by the names of their bindings where they have one."""


@cache
def forward_variant(*parts: str, has_sun: bool = False) -> type[ForwardShader]:
    """Return the forward shader with these of `PARTS`, and only their bindings. `has_sun` says that there is exactly
    one directional light."""
    known = PARTS | {"directional_lights": WithSun} if has_sun else PARTS
    bases = tuple(known[part] for part in parts)
    return type("Forward", (*bases, ForwardShader), {"__module__": __name__})
