"""The forward shader: a fragment is lit by the lights that reach its object, as its geometry is drawn.

A feature that a scene or a pass lacks costs nothing: `ForwardShader` has no light and no textures, each of the
classes below adds one feature with its bindings, and `forward_variant` combines those that are needed. The techniques
that light geometry as it is drawn differ in these features only: `ForPointPairs` draws an object once for each of its
point lights, and `WithIndexedPointLights` finds a pixel's point lights in a texture.
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
    Struct,
    Texture2D,
    Texture2DArray,
    Uniform,
    exp,
    fragment_coordinate,
    function,
    instance_index,
    ivec2,
    ivec3,
    length,
    max,
    mix,
    uvec4,
    vec2,
    vec3,
    vec4,
)

LIGHT_BITS: Final = 3
"""Bits of a light's number in each of the four channels of a texture of light indices."""
LIGHT_MASK: Final = (1 << LIGHT_BITS) - 1
LIGHTS_PER_PIXEL: Final = 24 // LIGHT_BITS
"""The lights whose numbers a pixel of light indices can hold: a float has 24 bits."""
LIGHTS_FULL: Final = float(1 << 24)
"""A channel of this or more says that a pixel has too many lights."""


class ForwardShader(Shader):
    """The base of all variants: no light."""

    # Highlights end up in 8 bits: a pow as exact as GL's (128 ulp) halves the time of a lit pass on OpenCL.
    precision = Precision.FAST

    view: Uniform[ViewConstants]
    objects: Storage[Object]
    places: Storage[ObjectPosition]
    materials: Storage[Material]

    def vertex(self, v: Vertex) -> SurfaceVarying:
        row = instance_index()
        thing = self.objects[row]
        return self.transform(v, row, ivec3(thing.lights_begin, thing.points_end, thing.lights_end))

    def transform(self, v: Vertex, row: int, lights: ivec3) -> SurfaceVarying:
        thing = self.objects[row]
        position = thing.linear @ v.position + relative_position(self.places[row], self.view)
        return SurfaceVarying(
            clip=self.view.relative_view_projection @ vec4(position, 1.0),
            position=position,
            normal=thing.normal @ v.normal,
            uv=v.uv,
            material=thing.material,
            lights=lights,
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
        color = self.surroundings(surface, material)
        color += self.emitted(surface, material)
        color += self.sunlight(surface)
        color += self.pointlight(surface, v.lights.x, v.lights.y)
        color += self.spotlight(surface, v.lights.y, v.lights.z)
        return vec4(self.shown(color, v.position), 1.0)

    def shown(self, color: vec3, position: vec3) -> vec3:
        return self.through_air(tone_map(color), position)

    def texel(self, image: int, uv: vec2) -> vec3:
        return vec3(1.0)

    def surroundings(self, surface: SurfacePoint, material: Material) -> vec3:
        return vec3(0.0)

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


class WithAmbient(ForwardShader):
    """Adds ambient light with the rim term."""

    ambient: Uniform[Ambient]

    def surroundings(self, surface: SurfacePoint, material: Material) -> vec3:
        return ambient_light(surface, self.ambient, material.rim_strength, material.rim_power)


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


@function
def next_light(packed: uvec4) -> int:
    """Return the number of the first light of a pixel's packed numbers, 0 if there is none (`light_indexed`)."""
    parts = packed & uvec4(LIGHT_MASK)
    return int(
        parts.x | (parts.y << LIGHT_BITS) | (parts.z << (2 * LIGHT_BITS)) | (parts.w << (3 * LIGHT_BITS))
    )


class WithIndexedPointLights(WithPointLights):
    """Finds the point lights of a pixel in a texture. A pixel with too many lights uses its object's list."""

    light_indices: Texture2D
    numbered: Storage[int]

    def pointlight(self, surface: SurfacePoint, begin: int, end: int) -> vec3:
        indices = self.light_indices.load(ivec2(fragment_coordinate().xy))
        if max(max(indices.x, indices.y), max(indices.z, indices.w)) >= LIGHTS_FULL:
            return super().pointlight(surface, begin, end)
        packed = uvec4(indices)
        color = vec3(0.0)
        number = next_light(packed)
        while number > 0:
            row = self.numbered[number - 1]
            if row >= 0:
                color += point_light(surface, self.point_lights[row])
            packed = packed >> uvec4(LIGHT_BITS)
            number = next_light(packed)
        return color


class WithIndexedSpotLights(WithSpotLights):
    """Finds the spot lights of a pixel in a texture. A pixel with too many lights uses its object's list."""

    light_indices: Texture2D
    numbered: Storage[int]

    def spotlight(self, surface: SurfacePoint, begin: int, end: int) -> vec3:
        indices = self.light_indices.load(ivec2(fragment_coordinate().xy))
        if max(max(indices.x, indices.y), max(indices.z, indices.w)) >= LIGHTS_FULL:
            return super().spotlight(surface, begin, end)
        packed = uvec4(indices)
        color = vec3(0.0)
        number = next_light(packed)
        while number > 0:
            row = self.numbered[number - 1]
            if row < 0:
                color += spot_light(surface, self.spot_lights[~row])
            packed = packed >> uvec4(LIGHT_BITS)
            number = next_light(packed)
        return color


class Unmapped(ForwardShader):
    """Leaves light linear and of any strength, to be added to other light."""

    def shown(self, color: vec3, position: vec3) -> vec3:
        return color


class Pair(Struct):
    """An object and one of its lights: the rows `object` of the objects, and `entry` of the light rows."""

    object: int
    entry: int


class ForPointPairs(ForwardShader):
    """Draws pairs of an object and one point light that reaches it; a pair is an instance."""

    pairs: Storage[Pair]

    def vertex(self, v: Vertex) -> SurfaceVarying:
        pair = self.pairs[instance_index()]
        return self.transform(v, pair.object, ivec3(pair.entry, pair.entry + 1, pair.entry + 1))


class ForSpotPairs(ForwardShader):
    """Draws pairs of an object and one spot light that reaches it; a pair is an instance."""

    pairs: Storage[Pair]

    def vertex(self, v: Vertex) -> SurfaceVarying:
        pair = self.pairs[instance_index()]
        return self.transform(v, pair.object, ivec3(pair.entry, pair.entry, pair.entry + 1))


PARTS: Final[dict[str, type[ForwardShader]]] = {
    "ambient": WithAmbient,
    "images": Textured,
    "directional_lights": WithDirectionalLights,
    "point_lights": WithPointLights,
    "spot_lights": WithSpotLights,
    "haze": WithHaze,
    "emission": WithEmission,
    "unmapped": Unmapped,
    "indexed_points": WithIndexedPointLights,
    "indexed_spots": WithIndexedSpotLights,
    "point_pairs": ForPointPairs,
    "spot_pairs": ForSpotPairs,
}
"""The features that can be added to the forward shader, by the names of their bindings where they have one."""


@cache
def forward_variant(*parts: str, has_sun: bool = False) -> type[ForwardShader]:
    """Return the forward shader with these of `PARTS`, and only their bindings. `has_sun` says that there is exactly
    one directional light."""
    known = PARTS | {"directional_lights": WithSun} if has_sun else PARTS
    bases = tuple(known[part] for part in parts)
    return type("Forward", (*bases, ForwardShader), {"__module__": __name__})
