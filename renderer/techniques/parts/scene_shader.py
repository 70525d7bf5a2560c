"""The shared shaders of techniques: the vertex stage of the scene, and the light that reaches its surfaces.

Techniques combine these classes with their own; `renderer.techniques.parts.variants` sets the switches of
what a scene may lack. What surfaces are made of is said by a `MaterialShader`, the renderer's or a material's
own. Every pass over the scene's geometry has the vertex stage of `SceneShader`, so that equal code gives
equal depth: a later pass may test it with EQUAL.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import rhi.shading as sl
from renderer.light_kinds.bounds import BOUND_FIELDS, LightBounds
from renderer.light_kinds.directional import DirectionalLight, directional_incidence
from renderer.light_kinds.generation import define, for_each_kind, for_kind
from renderer.light_kinds.incidence import MIN_SQUARED_DISTANCE, Incidence
from renderer.scene import ShadingModel
from renderer.shaders.area_lights import AreaLightReader, SourceShape, area_terms
from renderer.shaders.environment import EnvironmentLight
from renderer.shaders.fog import FogReader, apply_fog
from renderer.shaders.lighting import (
    MAX_HALF_FLOAT,
    ambient_light,
    apply_haze,
    highlight,
    in_range,
    reflected_light,
    safe_normalize,
)
from renderer.shaders.materials import MaterialShader, color_scale
from renderer.shaders.metals import (
    ambient_light_metallic,
    anisotropic_terms,
    encode_roughness,
    metallic_surface,
    metallic_terms,
    reflected_light_metallic,
    stretch_surface,
)
from renderer.shaders.pixels import ViewRayShader
from renderer.shaders.spheres import (
    GGX_TAIL,
    PHONG_TAIL,
    SphereLightReader,
    lobe_normalization,
    nearest_direction,
    sphere_cosine,
)
from renderer.shaders.structs import (
    Ambient,
    Haze,
    Material,
    Object,
    ObjectPosition,
    SecondUv,
    SurfaceInput,
    SurfaceParameters,
    SurfacePoint,
    SurfaceVarying,
    Tangent,
    Vertex,
    VertexColor,
    relative_position,
)
from renderer.shaders.tone_mapping import tone_map
from renderer.shadows import ShadowReceiver

_METALLIC: Final = int(ShadingModel.METALLIC_ROUGHNESS)


if TYPE_CHECKING:

    class ObjectLightReader(MaterialShader):
        """The base of shaders that read which lights reach an object."""

        def list_lights(self, object_data: Object) -> LightBounds:
            """The bounds of the object's lights in the light list."""

else:
    ObjectLightReader = define(
        f"""
class ObjectLightReader(MaterialShader):
    def list_lights(self, object_data: Object) -> LightBounds:
        return LightBounds({", ".join(f"object_data.{name}" for name in BOUND_FIELDS)})
""",
        "ObjectLightReader",
        __name__,
        MaterialShader=MaterialShader,
        LightBounds=LightBounds,
        Object=Object,
    )


class SceneShader(ObjectLightReader):
    """Draws the scene's geometry."""

    is_coverage = False
    """Whether it draws where surfaces are, and nothing else of them but what masks cut."""
    has_geometric_normals = False
    has_two_sides = False

    objects: sl.Storage[Object]
    object_positions: sl.Storage[ObjectPosition]

    def vertex(self, v: Vertex, second: SecondUv, tangent: Tangent, color: VertexColor) -> SurfaceVarying:
        return self.transform(
            v,
            second.uv2 if self.has_second_uvs else sl.vec2(0.0),
            tangent.tangent if self.has_normal_maps else sl.vec4(1.0, 0.0, 0.0, 1.0),
            color.color if self.has_vertex_colors else sl.vec4(1.0),
        )

    def transform(self, v: Vertex, uv2: sl.vec2, tangent: sl.vec4, color: sl.vec4) -> SurfaceVarying:
        object_index = self.get_object_index()
        object_data = self.objects[object_index]
        if self.has_normal_maps and self.has_texture_transforms and self.has_table and not self.is_own:
            # A material's own shader has no map whose coordinates are turned.
            tangent = self.turn_tangent(object_data.material, v.normal, tangent)
        position = object_data.linear @ v.position + relative_position(
            self.object_positions[object_index], self.view
        )
        return SurfaceVarying(
            clip=self.view.relative_view_projection @ sl.vec4(position, 1.0),
            position=position,
            normal=object_data.normal @ v.normal,
            uv=v.uv,
            uv2=uv2,
            tangent=self.transform_tangent(object_data, tangent),
            color=color,
            material=object_data.material,
            lights=self.list_lights(object_data),
        )

    def transform_tangent(self, object_data: Object, tangent: sl.vec4) -> sl.vec4:
        """A mesh's tangent in world space."""
        if not self.has_normal_maps:
            return tangent
        # A transform that mirrors an object turns its bitangents, but not the product of its normals and
        # tangents.
        mirrors = sl.determinant(object_data.linear) < 0.0
        return sl.vec4(object_data.linear @ tangent.xyz, -tangent.w if mirrors else tangent.w)

    def get_object_index(self) -> int:
        """Index of the object that is drawn."""
        return sl.instance_index()

    def surface_input(self, v: SurfaceVarying) -> SurfaceInput:
        """The surface point that the fragment shows, on the visible side. Back faces are drawn only of
        two-sided materials (`DRAW_GROUPS`). Varyings that nothing reads aren't interpolated."""
        side = 1.0
        if self.has_two_sides:
            side = 1.0 if sl.front_facing() else -1.0
        second = v.uv2 if self.has_second_uvs else sl.vec2(0.0)
        return SurfaceInput(
            position=v.position,
            normal=safe_normalize(v.normal) * side,
            uv=sl.fract(v.uv) if self.is_own else v.uv,
            uv2=second,
            uv_gradients=sl.vec4(sl.ddx(v.uv), sl.ddy(v.uv)) if self.has_gradients else sl.vec4(0.0),
            uv2_gradients=sl.vec4(sl.ddx(second), sl.ddy(second)) if self.has_second_uvs else sl.vec4(0.0),
            tangent=v.tangent * side if self.has_normal_maps else sl.vec4(1.0, 0.0, 0.0, 1.0),
            color=v.color if self.has_vertex_colors else sl.vec4(1.0),
            material=v.material,
        )

    def geometric_normal_of(self, at: SurfaceInput, normal: sl.vec3) -> sl.vec3:
        """Unit geometric normal of the fragment's surface, as shadow maps have it; `normal` if no normal
        map bends it."""
        return at.normal if self.has_geometric_normals else normal


class ReflectingShader(ViewRayShader):
    """Reflection of light by the specular model, the metallic-roughness model, or either of them; the
    latter is marked by a negative `shininess`."""

    lean = True
    has_metals = False
    has_both_models = False
    has_diffuse_light = True
    has_specular_light = True
    """Whether this part of the light is drawn (`LightComponent`)."""
    is_albedo = False
    has_anisotropy = False
    has_lighting_models = False
    """Whether surfaces may have lighting models of their materials' own (`renderer.techniques.parts.own_lighting`)."""
    has_decals = False
    has_any_material = False
    """Whether the surfaces may be of materials with different shaders."""

    def make_surface(
        self, position: sl.vec3, geometric_normal: sl.vec3, described: SurfaceParameters, material: Material
    ) -> SurfacePoint:
        """The surface to light at a position, from its material's parameters."""
        surface = SurfacePoint(
            position=position,
            normal=described.normal,
            geometric_normal=geometric_normal,
            to_eye=self.direction_to_eye(position),
            base_color=(sl.vec3(color_scale(material)) if self.has_decals else material.base_color.rgb)
            * described.color.rgb,
            specular_color=material.specular_color,
            shininess=material.shininess,
            occlusion=described.occlusion,
            emissive=described.emissive,
            irradiance=sl.vec3(-1.0),
            stretch=sl.vec3(0.0),
        )
        if (
            not self.is_albedo
            and self.has_metals
            and (not self.has_both_models or material.model == _METALLIC)
        ):
            return metallic_surface(surface, described.metallic, described.roughness)
        return surface

    def stretch(self, surface: SurfacePoint, at: SurfaceInput) -> SurfacePoint:
        """A surface of an anisotropic material; those of the specular model stay as they are."""
        return surface if surface.shininess > 0.0 else stretch_surface(surface, self.describe_anisotropy(at))

    def note_material(self, surface: SurfacePoint, material_index: int, shader: int) -> SurfacePoint:
        """The surface with the index of its material, and the number of its shader, where lighting models look."""
        surface.stretch = sl.vec3(float(material_index), float(shader), 0.0)
        return surface

    def describe_anisotropy(self, at: SurfaceInput) -> sl.vec3:
        """See `MaterialShader.describe_anisotropy`, which replaces it."""
        return sl.vec3(0.0)

    def surface_shininess(self, material: Material, roughness: float) -> float:
        """Shininess of a material with this roughness."""
        if self.has_both_models:
            return encode_roughness(roughness) if material.model == _METALLIC else material.shininess
        return encode_roughness(roughness) if self.has_metals else material.shininess

    def lighting_terms(self, surface: SurfacePoint, to_light: sl.vec3) -> sl.vec3:
        """Factors of base colour, specular colour and white for light from a unit direction in front of
        the surface."""
        if self.has_metals and (not self.has_both_models or surface.shininess < 0.0):
            if self.has_anisotropy:
                return anisotropic_terms(surface, to_light)
            return metallic_terms(surface, to_light)
        return sl.vec3(1.0, highlight(surface, to_light), 0.0)

    def keep_component(self, terms: sl.vec3) -> sl.vec3:
        """Those of `lighting_terms` that are drawn; the others become 0."""
        return terms * (sl.vec3(1.0, 0.0, 0.0) if self.has_diffuse_light else sl.vec3(0.0, 1.0, 1.0))

    def reflect_light(self, surface: SurfacePoint, light: Incidence) -> sl.vec3:
        """Light that the surface reflects to the eye."""
        if self.has_anisotropy or not (self.has_diffuse_light and self.has_specular_light):
            facing = sl.dot(surface.normal, light.direction)
            if facing <= 0.0:
                return sl.vec3(0.0)
            terms = self.lighting_terms(surface, light.direction)
            if not (self.has_diffuse_light and self.has_specular_light):
                terms = self.keep_component(terms)
            color = surface.base_color * terms.x + surface.specular_color * terms.y + terms.z
            return color * light.irradiance * facing
        if self.has_metals and (not self.has_both_models or surface.shininess < 0.0):
            return reflected_light_metallic(surface, light)
        return reflected_light(surface, light)

    def sphere_lighting_terms(self, surface: SurfacePoint, to_center: sl.vec3, size: float) -> sl.vec3:
        """The terms of `lighting_terms`, each times its n·l, for a sphere light of this squared angular
        size."""
        seen = sl.min(size, 1.0)
        sine = sl.sqrt(seen)
        cosine = sl.dot(surface.normal, to_center)
        if cosine <= -sine:
            return sl.vec3(0.0)
        toward = nearest_direction(surface, to_center, sine)
        slant = sl.sqrt(sl.max(0.5 + 0.5 * sl.dot(toward, surface.to_eye), 1e-4))
        mirrored = sl.saturate(sl.dot(surface.normal, toward))
        if self.has_metals and (not self.has_both_models or surface.shininess < 0.0):
            mirrored *= lobe_normalization(
                0.5 * sine / (surface.shininess * surface.shininess), slant, GGX_TAIL
            )
        else:
            mirrored *= lobe_normalization(0.5 * sine * sl.sqrt(0.5 * surface.shininess), slant, PHONG_TAIL)
        terms = self.lighting_terms(surface, toward)
        return terms * sl.vec3(sphere_cosine(cosine, seen), mirrored, mirrored) / sl.max(size, 1.0)

    def reflect_sphere(self, surface: SurfacePoint, light: Incidence, size: float) -> sl.vec3:
        """Light of a sphere that the surface reflects to the eye."""
        terms = self.sphere_lighting_terms(surface, light.direction, size)
        if not (self.has_diffuse_light and self.has_specular_light):
            terms = self.keep_component(terms)
        color = surface.base_color * terms.x + surface.specular_color * terms.y + terms.z
        return color * light.irradiance

    def reflect_ambient(self, surface: SurfacePoint, ambient: Ambient, material: Material) -> sl.vec3:
        """Ambient light that the surface sends to the eye."""
        if self.has_metals and (not self.has_both_models or surface.shininess < 0.0):
            return ambient_light_metallic(surface, ambient)
        return ambient_light(surface, ambient, material.rim_strength, material.rim_power)


class FinishShader(FogReader):
    """Makes pixels of light: applies fog, then tone mapping, then haze, which fades to the final
    background colour. For effects of the camera, light stays linear and of any strength."""

    precision = sl.Precision.FAST
    lean = True
    has_haze = False
    keeps_light = False

    haze: sl.Uniform[Haze]

    def finish(self, color: sl.vec3, position: sl.vec3) -> sl.vec4:
        """Pixel of a surface at a position that sends this light to the eye."""
        seen = color
        if self.has_fog:
            path = self.path_from_eye(position)
            seen = apply_fog(seen, path, self.fog_at(position - path))
        if not self.keeps_light:
            seen = tone_map(seen)
        if self.has_haze:
            seen = apply_haze(seen, self.path_from_eye(position), self.haze)
        if self.keeps_light:
            seen = sl.min(seen, MAX_HALF_FLOAT)
        return sl.vec4(seen, 1.0)


class ShadingShader(FinishShader, ReflectingShader, ShadowReceiver, EnvironmentLight):
    """Shades a surface by ambient, emitted and directional light."""

    has_ambient_light = True
    has_light_maps = False
    has_ambient_occlusion = False
    has_contact_shadows = False
    contact_light = 0
    """The index of the directional light whose contact shadows are drawn."""

    has_emission = False
    has_emissive_colors = False
    has_directional_lights = False
    has_single_directional_light = False
    """Whether there is exactly one directional light. Without a loop, a compiler sees that the light is the
    same for all fragments, which saves llvmpipe a twentieth of the pass."""

    ambient: sl.Uniform[Ambient]
    ambient_occlusion: sl.Texture2D
    contact_shadows: sl.Texture2D
    directional_lights: sl.Storage[DirectionalLight]

    def shade(self, surface: SurfacePoint, material: Material) -> sl.vec3:
        """Light of the surface without local lights."""
        if self.is_albedo:
            return surface.base_color
        color = sl.vec3(0.0)
        if self.has_ambient_light:
            color = self.shade_ambient(surface, material)
        if self.has_emission:
            color += surface.base_color * material.emission
        if self.has_emissive_colors:
            color += material.emissive * surface.emissive
        if self.has_single_directional_light:
            color += self.shade_directional_light(surface, 0)
        elif self.has_directional_lights:
            for i in range(len(self.directional_lights)):
                color += self.shade_directional_light(surface, i)
        return color

    def shade_ambient(self, surface: SurfacePoint, material: Material) -> sl.vec3:
        """Light that the surface reflects of what arrives from all around."""
        if self.has_light_maps and surface.irradiance.x >= 0.0:  # where what is hidden has been baked
            return self.reflect_light_map(surface, material)
        if self.has_environment:
            color = self.reflect_environment(surface, material)
        else:
            color = self.reflect_ambient(surface, self.ambient, material)
        if self.has_ambient_occlusion:
            color *= self.ambient_occlusion.load(self.get_pixel()).x
        return color

    def reflect_light_map(self, surface: SurfacePoint, material: Material) -> sl.vec3:
        """Light of the surface's light map that it sends to the eye. It mirrors the environment, or without one
        the mean of what arrives."""
        if self.has_environment:
            scattered = surface.base_color * surface.irradiance * surface.occlusion
            surface.base_color = sl.vec3(0.0)
            return scattered + self.reflect_environment(surface, material)
        even = Ambient(sky=surface.irradiance, ground=surface.irradiance)
        return self.reflect_ambient(surface, even, material)

    def reflect_environment(self, surface: SurfacePoint, material: Material) -> sl.vec3:
        """Light of the environment that the surface sends to the eye."""
        if self.has_metals and (not self.has_both_models or surface.shininess < 0.0):
            return self.reflect_environment_metallic(surface)
        return self.reflect_environment_specular(surface, material)

    def shade_directional_light(self, surface: SurfacePoint, light_index: int) -> sl.vec3:
        """Light that the surface reflects of a directional light."""
        light = self.reflect_light(surface, directional_incidence(self.directional_lights[light_index]))
        if self.has_contact_shadows and light_index == self.contact_light:
            light *= self.contact_shadows.load(self.get_pixel()).x
        return self.shadow_directional_light(light, surface.position, surface.geometric_normal, light_index)


class AreaReflectingShader(ReflectingShader, AreaLightReader):
    """Reflection of light of rectangles and tubes."""

    lean = True

    def area_lighting_terms(self, surface: SurfacePoint, to_center: sl.vec3, shape: SourceShape) -> sl.vec3:
        """The terms of `lighting_terms`, each times its n·l, for the light of a rectangle or a tube, per unit of
        intensity."""
        if self.has_metals and (not self.has_both_models or surface.shininess < 0.0):
            return area_terms(surface, to_center, shape, self.lobe_fit(surface, True), True)
        return area_terms(surface, to_center, shape, self.lobe_fit(surface, False), False)

    def reflect_area(
        self, surface: SurfacePoint, light: Incidence, to_center: sl.vec3, shape: SourceShape
    ) -> sl.vec3:
        """Light of a rectangle or a tube that the surface reflects to the eye. `light` is that of a point in its
        middle."""
        terms = self.area_lighting_terms(surface, to_center, shape)
        if not (self.has_diffuse_light and self.has_specular_light):
            terms = self.keep_component(terms)
        color = surface.base_color * terms.x + surface.specular_color * terms.y + terms.z
        return color * (light.irradiance * sl.max(sl.dot(to_center, to_center), MIN_SQUARED_DISTANCE))


class LocalLightReader(AreaReflectingShader, SphereLightReader, ShadowReceiver):
    """Base of shaders that light surfaces by local lights. `has_…_areas` says for a kind whether its lights may be
    rectangles or tubes."""

    has_gaps = False

    light_list: sl.Storage[int]

    def get_light_index(self, entry: int) -> int:
        """The index of the light at an entry of the light list; where there may be gaps, -1 if there is
        none."""
        return self.light_list[entry]


_SHADE_AREA: Final = """
        if self.has_${kind}_areas:
            shape = self.source_shape(light_index)
            if shape.strength > 0.0:
                to_center = self.${kind}_lights[light_index].position - surface.position
                area = self.reflect_area(
                    surface, $incidence(surface.position, self.${kind}_lights[light_index]), to_center, shape
                )
                return self.shadow_${kind}_light(area, surface.position, surface.geometric_normal, light_index)
"""

if TYPE_CHECKING:

    class LocalLightShader(LocalLightReader):
        """The base of shaders that light surfaces by the lights of all kinds with a position."""

        def shade_local_lights(self, surface: SurfacePoint, lights: LightBounds) -> sl.vec3:
            """The light of those lights whose indices are between these bounds in the light list."""

else:
    LocalLightShader = define(
        "class LocalLightShader(LocalLightReader):\n"
        + for_each_kind(
            "    has_${kind}_lights = False\n$areas    ${kind}_lights: sl.Storage[$Element]\n",
            areas=lambda _, kind: f"    has_{kind.name}_areas = False\n" if kind.has_shapes else "",
        )
        + """
    def shade_local_lights(self, surface: SurfacePoint, lights: LightBounds) -> sl.vec3:
        color = sl.vec3(0.0)
"""
        + for_each_kind(
            """
        if self.has_${kind}_lights:
            for entry in range(lights.$begin, lights.$end):
                light_index = self.get_light_index(entry)
                if not self.has_gaps or light_index >= 0:
                    color += self.shade_${kind}_light(surface, light_index)
"""
        )
        + """
        return color
"""
        + for_each_kind(
            """
    def shade_${kind}_light(self, surface: SurfacePoint, light_index: int) -> sl.vec3:
        if not in_range(
            surface, self.${kind}_lights[light_index].position, self.${kind}_lights[light_index].range
        ):
            return sl.vec3(0.0)
$areas        if self.has_${kind}_spheres:
            size = self.squared_angular_sizes(
                self.${kind}_lights[light_index].position - surface.position, light_index
            ).$component
            sphere = self.reflect_sphere(
                surface, $incidence(surface.position, self.${kind}_lights[light_index]), size
            )
            return self.shadow_${kind}_light(sphere, surface.position, surface.geometric_normal, light_index)
        light = self.reflect_light(surface, $incidence(surface.position, self.${kind}_lights[light_index]))
        return self.shadow_${kind}_light(light, surface.position, surface.geometric_normal, light_index)
""",
            areas=lambda _, kind: for_kind(_SHADE_AREA, kind) if kind.has_shapes else "",
        ),
        "LocalLightShader",
        __name__,
        LocalLightReader=LocalLightReader,
        LightBounds=LightBounds,
        SurfacePoint=SurfacePoint,
        in_range=in_range,
        sl=sl,
    )


class SurfaceShader(SceneShader, ReflectingShader):
    """Base of shaders that draw the scene's geometry with its materials."""

    def evaluate_surface(self, v: SurfaceVarying, material: Material) -> SurfacePoint:
        """The surface that the fragment shows."""
        at = self.surface_input(v)
        described = self.evaluate(at)
        surface = self.make_surface(
            at.position, self.geometric_normal_of(at, described.normal), described, material
        )
        if self.has_anisotropy:
            surface = self.stretch(surface, at)
        if self.has_lighting_models:
            surface = self.note_material(surface, v.material, material.shader)
        if self.has_light_maps:
            surface.irradiance = self.sample_light_map(at)
        return surface


class ForwardShader(SurfaceShader, LocalLightShader, ShadingShader):
    """Draws the scene lit, each fragment by all lights that reach its object."""

    def fragment(self, v: SurfaceVarying) -> sl.vec4:
        return self.light(v, self.materials[v.material])

    def light(self, v: SurfaceVarying, material: Material) -> sl.vec4:
        """Pixel of the lit surface."""
        return self.light_surface(self.evaluate_surface(v, material), v, material)

    def light_surface(self, surface: SurfacePoint, v: SurfaceVarying, material: Material) -> sl.vec4:
        """Pixel of a surface that the fragment shows."""
        color = self.shade(surface, material)
        color += self.shade_local_lights_at(surface, v)
        return self.finish(color, v.position)

    def shade_local_lights_at(self, surface: SurfacePoint, v: SurfaceVarying) -> sl.vec3:
        """Light of the local lights that reach the fragment's surface."""
        return self.shade_local_lights(surface, v.lights)
