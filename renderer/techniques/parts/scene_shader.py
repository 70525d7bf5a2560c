"""The shared shaders of techniques: the vertex stage of the scene, and the light that reaches its surfaces.

Techniques combine these classes with their own; `renderer.techniques.parts.variants` sets the switches of what a scene
may lack. What surfaces are made of is said by a `MaterialShader`, the renderer's or a material's own. Every pass over
the scene's geometry has the vertex stage of `SceneShader`, so that equal code gives equal depth: a later pass may test
it with EQUAL.
"""

from __future__ import annotations

from typing import Final

import rhi.shading as sl
from renderer.scene import ShadingModel
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
from renderer.shaders.materials import MaterialShader
from renderer.shaders.metals import (
    ambient_light_of_metal,
    metal_surface,
    metal_terms,
    reflected_by_metal,
    shininess_of_metal,
)
from renderer.shaders.spheres import GGX_TAIL, PHONG_TAIL, SourceReader, lobe_share, nearest_direction, sphere_cosine
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
    SurfaceInput,
    SurfaceParameters,
    SurfacePoint,
    SurfaceVarying,
    Tangent,
    Vertex,
    VertexColor,
    relative_position,
)
from renderer.shadows import ShadowReceiver

_METALLIC: Final = int(ShadingModel.METALLIC_ROUGHNESS)


class SceneShader(MaterialShader):
    """Draws the scene's geometry."""

    is_coverage = False
    """Whether it draws where surfaces are, and nothing else of them but what masks cut."""
    has_planes = False
    has_two_sides = False

    objects: sl.Storage[Object]
    places: sl.Storage[ObjectPosition]

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

    def take(self, v: SurfaceVarying) -> SurfaceInput:
        """Return the point of the surface that the fragment shows, on the side that is seen. Backs are drawn of
        materials with two sides only (`DRAW_GROUPS`). Varyings that nothing else reads aren't interpolated."""
        side = 1.0
        if self.has_two_sides:
            side = 1.0 if sl.front_facing() else -1.0
        second = v.uv2 if self.has_second_uvs else sl.vec2(0.0)
        return SurfaceInput(
            position=v.position,
            normal=safe_normalize(v.normal) * side,
            uv=sl.fract(v.uv) if self.is_own else v.uv,
            uv2=second,
            changes=sl.vec4(sl.ddx(v.uv), sl.ddy(v.uv)) if self.has_changes else sl.vec4(0.0),
            changes2=sl.vec4(sl.ddx(second), sl.ddy(second)) if self.has_second_uvs else sl.vec4(0.0),
            tangent=v.tangent * side if self.has_normal_maps else sl.vec4(1.0, 0.0, 0.0, 1.0),
            color=v.color if self.has_vertex_colors else sl.vec4(1.0),
            material=v.material,
        )

    def find_plane(self, at: SurfaceInput, normal: sl.vec3) -> sl.vec3:
        """Return the unit normal of the fragment's surface, which maps don't bend, given the `normal` that they do:
        shadow maps hold these surfaces."""
        return at.normal if self.has_planes else normal


class ReflectingShader(sl.Shader):
    """The reflection of light by surfaces: by the specular model, the metallic-roughness model, or either of them,
    where the latter has a negative `shininess`."""

    lean = True
    has_metals = False
    has_both_models = False

    def make_surface(
        self, position: sl.vec3, plane: sl.vec3, described: SurfaceParameters, material: Material
    ) -> SurfacePoint:
        """Return the surface to be lit at a position, as a material's shader has described it."""
        surface = SurfacePoint(
            position=position,
            normal=described.normal,
            plane=plane,
            to_eye=safe_normalize(-position),
            base_color=material.base_color.rgb * described.color.rgb,
            specular_color=material.specular_color,
            shininess=material.shininess,
            occlusion=described.occlusion,
            emissive=described.emissive,
        )
        if self.has_metals and (not self.has_both_models or material.model == _METALLIC):
            return metal_surface(surface, described.metallic, described.roughness)
        return surface

    def find_shininess(self, material: Material, roughness: float) -> float:
        """Return the shininess of such a surface alone."""
        if self.has_both_models:
            return shininess_of_metal(roughness) if material.model == _METALLIC else material.shininess
        return shininess_of_metal(roughness) if self.has_metals else material.shininess

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

    def find_sphere_terms(self, surface: SurfacePoint, to_center: sl.vec3, size: float) -> sl.vec3:
        """Return what `find_terms` does, each times its n·l, for light from a sphere that is as large as
        `SourceReader.find_sizes` says, in which it is less than that of a point."""
        seen = sl.min(size, 1.0)
        sine = sl.sqrt(seen)
        cosine = sl.dot(surface.normal, to_center)
        if cosine <= -sine:
            return sl.vec3(0.0)
        toward = nearest_direction(surface, to_center, sine)
        slant = sl.sqrt(sl.max(0.5 + 0.5 * sl.dot(toward, surface.to_eye), 1e-4))
        mirrored = sl.saturate(sl.dot(surface.normal, toward))
        if self.has_metals and (not self.has_both_models or surface.shininess < 0.0):
            mirrored *= lobe_share(0.5 * sine / (surface.shininess * surface.shininess), slant, GGX_TAIL)
        else:
            mirrored *= lobe_share(0.5 * sine * sl.sqrt(0.5 * surface.shininess), slant, PHONG_TAIL)
        terms = self.find_terms(surface, toward)
        return terms * sl.vec3(sphere_cosine(cosine, seen), mirrored, mirrored) / sl.max(size, 1.0)

    def reflect_sphere(self, surface: SurfacePoint, light: Incidence, size: float) -> sl.vec3:
        """Return the light of a sphere that the surface reflects to the eye."""
        terms = self.find_sphere_terms(surface, light.direction, size)
        color = surface.base_color * terms.x + surface.specular_color * terms.y + terms.z
        return color * light.irradiance

    def reflect_ambient(self, surface: SurfacePoint, ambient: Ambient, material: Material) -> sl.vec3:
        """Return the ambient light that the surface sends to the eye."""
        if self.has_metals and (not self.has_both_models or surface.shininess < 0.0):
            return ambient_light_of_metal(surface, ambient)
        return ambient_light(surface, ambient, material.rim_strength, material.rim_power)


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


class LampShader(ReflectingShader, SourceReader, ShadowReceiver):
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
        if self.has_point_spheres:
            size = self.find_sizes(self.point_lights[row].position - surface.position, row).x
            sphere = self.reflect_sphere(surface, point_incidence(surface.position, self.point_lights[row]), size)
            return self.unblocked_point(sphere, surface.position, surface.plane, row)
        light = self.reflect_light(surface, point_incidence(surface.position, self.point_lights[row]))
        return self.unblocked_point(light, surface.position, surface.plane, row)

    def spotlight(self, surface: SurfacePoint, row: int) -> sl.vec3:
        """Return the light of the spot light of a row."""
        if not in_range(surface, self.spot_lights[row].position, self.spot_lights[row].range):
            return sl.vec3(0.0)
        if self.has_spot_spheres:
            size = self.find_sizes(self.spot_lights[row].position - surface.position, row).y
            sphere = self.reflect_sphere(surface, spot_incidence(surface.position, self.spot_lights[row]), size)
            return self.unblocked_spot(sphere, surface.position, surface.plane, row)
        light = self.reflect_light(surface, spot_incidence(surface.position, self.spot_lights[row]))
        return self.unblocked_spot(light, surface.position, surface.plane, row)


class SurfaceShader(SceneShader, ReflectingShader):
    """The base of shaders that draw the scene's geometry with its materials."""

    def find_surface(self, v: SurfaceVarying, material: Material) -> SurfacePoint:
        """Return the surface that the fragment shows."""
        at = self.take(v)
        described = self.see(at)
        return self.make_surface(at.position, self.find_plane(at, described.normal), described, material)


class ForwardShader(SurfaceShader, LampShader, ShadingShader):
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
