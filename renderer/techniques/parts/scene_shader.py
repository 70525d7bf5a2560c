"""The shared shaders of techniques: the vertex stage of the scene, its surfaces, and the light that reaches them.

Techniques combine these classes with their own. What a scene may lack is a switch, a constant `has_…` that
`renderer.techniques.parts.variants` sets: a stage keeps the branches that are taken, and a program binds what they
read. So a feature that a scene lacks costs nothing. Every pass over the scene's geometry has the vertex stage of
`SceneShader`, so that equal code gives equal depth: a later pass may test it with EQUAL.

A texture is read in one of two ways. If all images are in one array, and all are read by texture coordinates as they
are, a texture's row is its layer. Otherwise a table of textures (`TextureUse`) leads to an array, a layer and the
transform of texture coordinates. All fragments of a primitive have one material, and so take the same branches: there,
derivatives of texture coordinates are defined, and a device skips the arrays that aren't read. llvmpipe doesn't: it
samples each array that a texture might be in. So colours are looked for in the arrays of colours alone (`images`), and
data, such as normals, in those of data (`maps`).
"""

from __future__ import annotations

from typing import Final

import rhi.shading as sl
from renderer.scene import AlphaMode, ShadingModel
from renderer.shaders.fog import FogConstants, through_fog
from renderer.shaders.lighting import (
    BRIGHTEST,
    ambient_light,
    directional_incidence,
    highlight,
    in_range,
    point_incidence,
    reflected_light,
    safe_normalize,
    spot_incidence,
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
    PointLight,
    SecondUv,
    SpotLight,
    SurfacePoint,
    SurfaceVarying,
    Tangent,
    TextureUse,
    Vertex,
    VertexColor,
    ViewConstants,
    relative_position,
)
from renderer.shadows import ShadowReceiver

_METALLIC: Final = int(ShadingModel.METALLIC_ROUGHNESS)
_MASK: Final = int(AlphaMode.MASK)
_ROUNDING: Final = 2.0**-16
"""The most that an alpha may be below the cut and still be at it: filtering rounds."""
_NO_NORMAL: Final = 5e-5
"""The square of a normal's length, below which it has no direction. No number of 8 bits means 0: a vector of length 0
is stored as 127 or 128, 1/255 beside it along each axis, and a diagonal would be made of that."""


class SceneShader(sl.Shader):
    """Draws the scene's geometry, and reads its textures."""

    # Highlights end up in 8 bits: a pow as exact as GL's (128 ulp) halves the time of a lit pass on OpenCL.
    precision = sl.Precision.FAST
    lean = True

    view: sl.Uniform[ViewConstants]
    objects: sl.Storage[Object]
    places: sl.Storage[ObjectPosition]
    materials: sl.Storage[Material]
    textures: sl.Storage[TextureUse]
    images: sl.Texture2DArray
    images_1: sl.Texture2DArray
    images_2: sl.Texture2DArray
    images_3: sl.Texture2DArray
    images_4: sl.Texture2DArray
    images_5: sl.Texture2DArray
    images_6: sl.Texture2DArray
    images_7: sl.Texture2DArray
    maps: sl.Texture2DArray
    maps_1: sl.Texture2DArray
    maps_2: sl.Texture2DArray
    maps_3: sl.Texture2DArray
    maps_4: sl.Texture2DArray
    maps_5: sl.Texture2DArray
    maps_6: sl.Texture2DArray
    maps_7: sl.Texture2DArray
    image_arrays = 1
    map_arrays = 1
    has_table = False
    has_images = False
    has_second_uvs = False
    has_vertex_colors = False
    has_masks = False
    has_normal_maps = False
    has_planes = False
    has_two_sides = False

    def vertex(self, v: Vertex, second: SecondUv, tangent: Tangent, color: VertexColor) -> SurfaceVarying:
        return self.transform(
            v,
            second.uv2 if self.has_second_uvs else sl.vec2(0.0),
            tangent.tangent if self.has_normal_maps else sl.vec4(1.0, 0.0, 0.0, 1.0),
            color.color if self.has_vertex_colors else sl.vec4(1.0),
        )

    def transform(self, v: Vertex, uv2: sl.vec2, tangent: sl.vec4, color: sl.vec4) -> SurfaceVarying:
        row = self.find_object()
        thing = self.objects[row]
        position = thing.linear @ v.position + relative_position(self.places[row], self.view)
        return SurfaceVarying(
            clip=self.view.relative_view_projection @ sl.vec4(position, 1.0),
            position=position,
            normal=thing.normal @ v.normal,
            uv=v.uv,
            uv2=uv2,
            tangent=self.turn_tangent(thing, tangent),
            color=color,
            material=thing.material,
            lights=self.list_lights(thing),
        )

    def turn_tangent(self, thing: Object, tangent: sl.vec4) -> sl.vec4:
        """Return a tangent of a mesh as it is in the world."""
        if not self.has_normal_maps:
            return tangent
        # A transform that mirrors an object turns its bitangents, but not the product of its normals and tangents.
        mirrors = sl.determinant(thing.linear) < 0.0
        return sl.vec4(thing.linear @ tangent.xyz, -tangent.w if mirrors else tangent.w)

    def find_object(self) -> int:
        """Return the row of the object that is drawn."""
        return sl.instance_index()

    def list_lights(self, thing: Object) -> sl.ivec3:
        """Return where the point lights that light the object begin in the light rows, where they end and the spot
        lights begin, and where those end."""
        return sl.ivec3(thing.lights_begin, thing.points_end, thing.lights_end)

    def find_texel(self, v: SurfaceVarying) -> sl.vec4:
        """Return what multiplies the base colour of the fragment's material. Nothing is drawn where the alpha of a mask
        is below its cut."""
        texel = sl.vec4(1.0)
        if self.has_images:
            texture = self.materials[v.material].texture
            if texture >= 0:
                texel = self.read_color(texture, v)
        if self.has_vertex_colors:
            texel = texel * v.color
        if self.has_masks:
            material = self.materials[v.material]
            if material.alpha_mode == _MASK and material.base_color.a * texel.a < material.alpha_cutoff - _ROUNDING:
                sl.discard()
        return texel

    def cut(self, v: SurfaceVarying) -> None:
        """Leave out what isn't drawn."""
        if self.has_masks:
            _ = self.find_texel(v)

    def find_normal(self, v: SurfaceVarying) -> sl.vec3:
        """Return the unit normal of the fragment, as maps bend it."""
        return self.turn_side(self.bend(safe_normalize(v.normal), v))

    def find_plane(self, v: SurfaceVarying, normal: sl.vec3) -> sl.vec3:
        """Return the unit normal of the fragment's surface, which maps don't bend, given the `normal` that they do:
        shadow maps hold these surfaces."""
        return self.turn_side(safe_normalize(v.normal)) if self.has_planes else normal

    def bend(self, normal: sl.vec3, v: SurfaceVarying) -> sl.vec3:
        """Return a unit normal as maps bend it. Where a texture has no direction, it is as it was."""
        if not self.has_normal_maps:
            return normal
        material = self.materials[v.material]
        if material.normal_texture < 0:
            return normal
        texel = self.read_data(material.normal_texture, v).xyz * 2.0 - 1.0
        tangent = safe_normalize(v.tangent.xyz)
        up = sl.cross(normal, tangent) * (-1.0 if v.tangent.w < 0.0 else 1.0)
        bent = (tangent * texel.x + up * texel.y) * material.normal_scale + normal * texel.z
        if sl.dot(bent, bent) < _NO_NORMAL:
            return normal
        return safe_normalize(bent)

    def turn_side(self, normal: sl.vec3) -> sl.vec3:
        """Return the normal of the side that is seen, given that of the front. Backs are drawn of materials with two
        sides only (`DRAW_GROUPS`)."""
        if self.has_two_sides:
            return normal if sl.front_facing() else -normal
        return normal

    def read_color(self, texture: int, v: SurfaceVarying) -> sl.vec4:
        """Return the texel of the texture of colours of this row."""
        if self.has_table:
            use = self.textures[texture]
            return self.read_images(use.array, self.place(use, v), self.change_right(use, v), self.change_below(use, v))
        return self.images.sample(sl.vec3(v.uv, float(texture)))

    def read_data(self, texture: int, v: SurfaceVarying) -> sl.vec4:
        """Return the texel of the texture of data of this row."""
        if self.has_table:
            use = self.textures[texture]
            return self.read_maps(use.array, self.place(use, v), self.change_right(use, v), self.change_below(use, v))
        return self.maps.sample(sl.vec3(v.uv, float(texture)))

    # Texture coordinates by the table are numbers of a buffer, from which a fragment that failed a test may have read
    # zeros (llvmpipe), so its neighbours would derive nonsense. Derivatives are those of the varying, transformed
    # alike.

    def place(self, use: TextureUse, v: SurfaceVarying) -> sl.vec3:
        """Return the texture coordinates and the layer at which a texture is read."""
        uv = v.uv
        if self.has_second_uvs:
            uv = v.uv if use.uv_set == 0 else v.uv2
        at = sl.vec3(uv, 1.0)
        return sl.vec3(sl.dot(use.u, at), sl.dot(use.v, at), use.layer)

    def change_right(self, use: TextureUse, v: SurfaceVarying) -> sl.vec2:
        """Return the change of texture coordinates to the next pixel on the right."""
        change = sl.ddx(v.uv)
        if self.has_second_uvs:
            second = sl.ddx(v.uv2)
            change = change if use.uv_set == 0 else second
        right = sl.vec3(change, 0.0)
        return sl.vec2(sl.dot(use.u, right), sl.dot(use.v, right))

    def change_below(self, use: TextureUse, v: SurfaceVarying) -> sl.vec2:
        """Return the change of texture coordinates to the next pixel below."""
        change = sl.ddy(v.uv)
        if self.has_second_uvs:
            second = sl.ddy(v.uv2)
            change = change if use.uv_set == 0 else second
        below = sl.vec3(change, 0.0)
        return sl.vec2(sl.dot(use.u, below), sl.dot(use.v, below))

    def read_images(self, array: int, place: sl.vec3, right: sl.vec2, below: sl.vec2) -> sl.vec4:
        """Return a texel of an array of colours, given the changes of texture coordinates to the pixels on the right
        and below."""
        if self.image_arrays > 1 and array == 1:
            return self.images_1.sample_grad(place, right, below)
        if self.image_arrays > 2 and array == 2:
            return self.images_2.sample_grad(place, right, below)
        if self.image_arrays > 3 and array == 3:
            return self.images_3.sample_grad(place, right, below)
        if self.image_arrays > 4 and array == 4:
            return self.images_4.sample_grad(place, right, below)
        if self.image_arrays > 5 and array == 5:
            return self.images_5.sample_grad(place, right, below)
        if self.image_arrays > 6 and array == 6:
            return self.images_6.sample_grad(place, right, below)
        if self.image_arrays > 7 and array == 7:
            return self.images_7.sample_grad(place, right, below)
        return self.images.sample_grad(place, right, below)

    def read_maps(self, array: int, place: sl.vec3, right: sl.vec2, below: sl.vec2) -> sl.vec4:
        """Return a texel of an array of data, given the changes of texture coordinates to the pixels on the right and
        below."""
        if self.map_arrays > 1 and array == 1:
            return self.maps_1.sample_grad(place, right, below)
        if self.map_arrays > 2 and array == 2:
            return self.maps_2.sample_grad(place, right, below)
        if self.map_arrays > 3 and array == 3:
            return self.maps_3.sample_grad(place, right, below)
        if self.map_arrays > 4 and array == 4:
            return self.maps_4.sample_grad(place, right, below)
        if self.map_arrays > 5 and array == 5:
            return self.maps_5.sample_grad(place, right, below)
        if self.map_arrays > 6 and array == 6:
            return self.maps_6.sample_grad(place, right, below)
        if self.map_arrays > 7 and array == 7:
            return self.maps_7.sample_grad(place, right, below)
        return self.maps.sample_grad(place, right, below)


class ReflectingShader(sl.Shader):
    """The reflection of light by surfaces: by the specular model, the metallic-roughness model, or either of them,
    where the latter has a negative `shininess`."""

    lean = True
    has_metals = False
    has_both_models = False

    def with_model(self, surface: SurfacePoint, material: Material, metal: sl.vec2) -> SurfacePoint:
        """Return a surface as the model needs it, given its base colour, and how metallic and rough it is."""
        if self.has_metals and (not self.has_both_models or material.model == _METALLIC):
            return metal_surface(surface, metal.x, metal.y)
        return surface

    def find_shininess(self, material: Material, metal: sl.vec2) -> float:
        """Return the shininess of such a surface alone."""
        if self.has_both_models:
            return shininess_of_metal(metal.y) if material.model == _METALLIC else material.shininess
        return shininess_of_metal(metal.y) if self.has_metals else material.shininess

    def find_terms(self, surface: SurfacePoint, to_light: sl.vec3) -> sl.vec3:
        """Return what the surface does with light from a unit direction in front of it: the terms of its base color, of
        its specular color, and of white."""
        if self.has_metals and (not self.has_both_models or surface.shininess < 0.0):
            return metal_terms(surface, to_light)
        return sl.vec3(1.0, highlight(surface, to_light), 0.0)

    def reflect_light(self, surface: SurfacePoint, light: Incidence) -> sl.vec3:
        """Return the light that the surface reflects to the eye."""
        if self.has_metals and (not self.has_both_models or surface.shininess < 0.0):
            return reflected_by_metal(surface, light)
        return reflected_light(surface, light)

    def reflect_ambient(self, surface: SurfacePoint, ambient: Ambient, material: Material) -> sl.vec3:
        """Return the ambient light that the surface sends to the eye."""
        if self.has_metals and (not self.has_both_models or surface.shininess < 0.0):
            return ambient_light_of_metal(surface, ambient)
        return ambient_light(surface, ambient, material.rim_strength, material.rim_power)


class MaterialShader(SceneShader, ReflectingShader):
    """The base of shaders that draw the scene's geometry with its materials."""

    has_roughness_maps = False
    has_occlusion_maps = False
    has_emissive_maps = False

    def find_surface(self, v: SurfaceVarying, material: Material) -> SurfacePoint:
        """Return the surface that the fragment shows."""
        normal = self.find_normal(v)  # before a mask leaves a fragment out, whose neighbours derive from it
        return self.color_surface(v, material, normal, self.find_texel(v))

    def color_surface(self, v: SurfaceVarying, material: Material, normal: sl.vec3, texel: sl.vec4) -> SurfacePoint:
        """Return the surface with this normal, and with a texel that multiplies its base colour."""
        surface = SurfacePoint(
            position=v.position,
            normal=normal,
            plane=self.find_plane(v, normal),
            to_eye=safe_normalize(-v.position),
            base_color=material.base_color.rgb * texel.rgb,
            specular_color=material.specular_color,
            shininess=material.shininess,
            occlusion=self.find_occlusion(v),
            emissive=self.find_emissive(v),
        )
        return self.with_model(surface, material, self.find_metal(v))

    def find_metal(self, v: SurfaceVarying) -> sl.vec2:
        """Return how metallic and how rough the fragment is."""
        material = self.materials[v.material]
        metal = sl.vec2(material.metallic, material.roughness)
        if self.has_roughness_maps and material.metallic_roughness_texture >= 0:
            metal = metal * self.read_data(material.metallic_roughness_texture, v).zy
        return metal

    def find_occlusion(self, v: SurfaceVarying) -> float:
        """Return how much of the ambient light reaches the fragment."""
        if not self.has_occlusion_maps:
            return 1.0
        material = self.materials[v.material]
        if material.occlusion_texture < 0:
            return 1.0
        return sl.mix(1.0, self.read_data(material.occlusion_texture, v).x, material.occlusion_strength)

    def find_emissive(self, v: SurfaceVarying) -> sl.vec3:
        """Return what multiplies the emissive colour of the fragment's material."""
        if not self.has_emissive_maps:
            return sl.vec3(1.0)
        texture = self.materials[v.material].emissive_texture
        if texture < 0:
            return sl.vec3(1.0)
        return self.read_color(texture, v).rgb


class FinishShader(sl.Shader):
    """Makes pixels of light. Fog is what light goes through before its tones are mapped. Haze fades to the background,
    a final colour, so it is mixed in after that. For glow, light stays linear and of any strength."""

    precision = sl.Precision.FAST
    lean = True
    has_haze = False
    has_fog = False
    has_glow = False

    haze: sl.Uniform[Haze]
    fog: sl.Uniform[FogConstants]

    def finish(self, color: sl.vec3, position: sl.vec3) -> sl.vec4:
        """Return the pixel of a surface that sends this light to the eye."""
        seen = color
        if self.has_fog:
            seen = through_fog(seen, position, self.fog)
        if not self.has_glow:
            seen = tone_map(seen)
        if self.has_haze:
            seen = through_haze(seen, position, self.haze)
        if self.has_glow:
            seen = sl.min(seen, BRIGHTEST)
        return sl.vec4(seen, 1.0)


class ShadingShader(FinishShader, ReflectingShader, ShadowReceiver):
    """Shades a surface, wherever it comes from: by the light that isn't a lamp's."""

    has_emission = False
    has_emissive_colors = False
    has_directional_lights = False
    has_sun = False
    """Whether there is exactly one directional light. Without a loop, a compiler sees that the light is the same for
    all fragments, which saves llvmpipe a twentieth of the pass."""

    ambient: sl.Uniform[Ambient]
    directional_lights: sl.Storage[DirectionalLight]

    def shade(self, surface: SurfacePoint, material: Material) -> sl.vec3:
        """Return the light of the surface without that of point and spot lights."""
        color = self.reflect_ambient(surface, self.ambient, material)
        if self.has_emission:
            color += surface.base_color * material.emission
        if self.has_emissive_colors:
            color += material.emissive * surface.emissive
        if self.has_sun:
            color += self.sunlight(surface, 0)
        elif self.has_directional_lights:
            for i in range(len(self.directional_lights)):
                color += self.sunlight(surface, i)
        return color

    def sunlight(self, surface: SurfacePoint, row: int) -> sl.vec3:
        """Return the light of a directional light."""
        light = self.reflect_light(surface, directional_incidence(self.directional_lights[row]))
        return self.unblocked_sun(light, surface.position, surface.plane, row)


class LampShader(ReflectingShader, ShadowReceiver):
    """The base of shaders that light surfaces by lamps, point and spot lights."""

    has_point_lights = False
    has_spot_lights = False
    has_gaps = False

    point_lights: sl.Storage[PointLight]
    spot_lights: sl.Storage[SpotLight]
    light_rows: sl.Storage[int]

    def lamplight(self, surface: SurfacePoint, lights: sl.ivec3) -> sl.vec3:
        """Return the light of the lamps between three places in the light rows: where the point lights begin, where
        they end and the spot lights begin, and where those end."""
        color = sl.vec3(0.0)
        if self.has_point_lights:
            for place in range(lights.x, lights.y):
                row = self.find_row(place)
                if not self.has_gaps or row >= 0:
                    color += self.pointlight(surface, row)
        if self.has_spot_lights:
            for place in range(lights.y, lights.z):
                row = self.find_row(place)
                if not self.has_gaps or row >= 0:
                    color += self.spotlight(surface, row)
        return color

    def find_row(self, place: int) -> int:
        """Return the row of the light at a place; where there may be gaps, -1 if there is none."""
        return self.light_rows[place]

    def pointlight(self, surface: SurfacePoint, row: int) -> sl.vec3:
        """Return the light of the point light of a row."""
        if not in_range(surface, self.point_lights[row].position, self.point_lights[row].range):
            return sl.vec3(0.0)
        light = self.reflect_light(surface, point_incidence(surface.position, self.point_lights[row]))
        return self.unblocked_point(light, surface.position, surface.plane, row)

    def spotlight(self, surface: SurfacePoint, row: int) -> sl.vec3:
        """Return the light of the spot light of a row."""
        if not in_range(surface, self.spot_lights[row].position, self.spot_lights[row].range):
            return sl.vec3(0.0)
        light = self.reflect_light(surface, spot_incidence(surface.position, self.spot_lights[row]))
        return self.unblocked_spot(light, surface.position, surface.plane, row)


class ForwardShader(MaterialShader, LampShader, ShadingShader):
    """Draws the scene lit: a fragment by all lights that reach its object."""

    def fragment(self, v: SurfaceVarying) -> sl.vec4:
        return self.light(v, self.materials[v.material])

    def light(self, v: SurfaceVarying, material: Material) -> sl.vec4:
        """Return the pixel of the lit surface."""
        return self.light_surface(self.find_surface(v, material), v, material)

    def light_surface(self, surface: SurfacePoint, v: SurfaceVarying, material: Material) -> sl.vec4:
        """Return the pixel of a surface that the fragment shows."""
        color = self.shade(surface, material)
        color += self.lamplight_at(surface, v)
        return self.finish(color, v.position)

    def lamplight_at(self, surface: SurfacePoint, v: SurfaceVarying) -> sl.vec3:
        """Return the light of the lamps that reach the surface that the fragment shows."""
        return self.lamplight(surface, v.lights)
