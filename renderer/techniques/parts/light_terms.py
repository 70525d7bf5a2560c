"""Terms of the lighting equation, which lights add up by their volumes before materials are known."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import rhi.shading as sl
from renderer.frame import DEPTH_FORMAT, Effect, Frame, FrameEffects, FramePass, Target
from renderer.light_kinds.incidence import MIN_SQUARED_DISTANCE
from renderer.shaders.encodings import decode_normal
from renderer.shaders.structs import SurfacePoint, SurfaceVarying
from renderer.techniques.parts.geometry_buffer import SurfaceReader, SurfaceWriter, surface_format
from renderer.techniques.parts.light_volumes import VolumeShader, VolumeVarying, draw_volumes
from renderer.techniques.parts.scene_shader import AreaReflectingShader, ReflectingShader
from renderer.techniques.parts.variants import make_scene_drawer
from rhi import Format, Texture

SHININESS_FORMAT: Final = Format.R16F
_SHININESS_SCALE: Final = 0.5
"""Of what is stored: a shininess may be 100,000, a half float 65,504."""


DIRECTIONS: Final = {"has_color": False, "has_occlusion_maps": False, "has_emissive_maps": False}
"""Switches of shaders that draw what light depends on, and leave the rest of materials to a later pass."""


class NormalTexels(sl.Struct):
    """Output of `NormalShader`."""

    surface: sl.uvec4
    shininess: float


class NormalShader(SurfaceWriter, ReflectingShader):
    """Writes normal, distance and shininess."""

    def fragment(self, v: SurfaceVarying) -> NormalTexels:
        at = self.surface_input(v)
        described = self.evaluate(at)
        shininess = self.surface_shininess(self.materials[v.material], described.roughness)
        surface = self.encode_surface(at, described.normal)
        return NormalTexels(surface=surface, shininess=shininess * _SHININESS_SCALE)


class LightTerms(sl.Struct):
    """Terms of the lighting equation: the factors of the base colour (irradiance), of the specular colour,
    and of white. Only the metallic-roughness model has the third."""

    diffuse: sl.vec4
    specular: sl.vec4
    grazing: sl.vec4


class SpecularTerms(sl.Struct):
    """Terms of scenes without the metallic-roughness model."""

    diffuse: sl.vec4
    specular: sl.vec4


class PackedMetalTerms(sl.Struct):
    """Terms of the metallic-roughness model, with the specular one packed as a luminance."""

    diffuse: sl.vec4
    grazing: sl.vec4


@sl.function
def luminance(color: sl.vec3) -> float:
    """Luminance of a linear colour (Rec. 709)."""
    return sl.dot(color, sl.vec3(0.2126, 0.7152, 0.0722))


class TermShader(VolumeShader, SurfaceReader, AreaReflectingShader):
    """Base of shaders that accumulate the terms of lights by light volumes."""

    precision = sl.Precision.FAST

    shininess: sl.Texture2D

    def collect(self, light: int, pixel: sl.ivec2) -> LightTerms:
        """Terms of a light for the surface at a pixel of the buffers."""
        texel = self.surface.load(pixel)
        position = self.surface_position(texel, pixel)
        if not self.is_reached(position, light):
            return LightTerms(diffuse=sl.vec4(0.0), specular=sl.vec4(0.0), grazing=sl.vec4(0.0))
        incidence = self.light_incidence(position, light)
        normal = decode_normal(texel.y)
        surface = SurfacePoint(
            position=position,
            normal=normal,
            geometric_normal=self.read_geometric_normal(texel, normal),
            to_eye=self.direction_to_eye(position),
            base_color=sl.vec3(1.0),
            specular_color=sl.vec3(1.0),
            shininess=self.shininess.load(pixel).x / _SHININESS_SCALE,
            occlusion=1.0,
            emissive=sl.vec3(1.0),
            irradiance=sl.vec3(-1.0),
            stretch=sl.vec3(0.0),
        )
        if self.has_areas:
            shape = self.source_shape(light)
            if shape.strength > 0.0:
                to_center = self.offset_to_light(position, light)
                area = self.area_lighting_terms(surface, to_center, shape)
                at_a_metre = incidence.irradiance * sl.max(sl.dot(to_center, to_center), MIN_SQUARED_DISTANCE)
                return self.spread(
                    self.apply_shadow(at_a_metre, position, surface.geometric_normal, light), area
                )
        # The terms of spheres have their n·l.
        facing = 1.0 if self.has_spheres else sl.dot(surface.normal, incidence.direction)
        if facing <= 0.0:
            return LightTerms(diffuse=sl.vec4(0.0), specular=sl.vec4(0.0), grazing=sl.vec4(0.0))
        terms = (
            self.sphere_lighting_terms(
                surface, incidence.direction, self.squared_angular_size(position, light)
            )
            if self.has_spheres
            else self.lighting_terms(surface, incidence.direction)
        )
        light_in = self.apply_shadow(incidence.irradiance * facing, position, surface.geometric_normal, light)
        return self.spread(light_in, terms)

    def spread(self, light_in: sl.vec3, terms: sl.vec3) -> LightTerms:
        """The terms of a light of this irradiance."""
        specular = light_in * terms.y
        return LightTerms(
            diffuse=sl.vec4(light_in * terms.x, luminance(specular)),
            specular=sl.vec4(specular, 0.0),
            grazing=sl.vec4(light_in * terms.z, 0.0),
        )


class PlainTerms(TermShader):
    """Accumulates the diffuse and specular terms."""

    def fragment(self, v: VolumeVarying) -> SpecularTerms:
        terms = self.collect(v.light, sl.ivec2(sl.fragment_coordinate().xy))
        return SpecularTerms(diffuse=terms.diffuse, specular=terms.specular)


class MetalTerms(TermShader):
    """Accumulates the diffuse, specular and grazing terms."""

    def fragment(self, v: VolumeVarying) -> LightTerms:
        return self.collect(v.light, sl.ivec2(sl.fragment_coordinate().xy))


class PackedTerms(TermShader):
    """Accumulates the diffuse term, with the luminance of the specular term in alpha."""

    def fragment(self, v: VolumeVarying) -> sl.vec4:
        return self.collect(v.light, sl.ivec2(sl.fragment_coordinate().xy)).diffuse


class PackedMetals(TermShader):
    """Accumulates the diffuse term, with the luminance of the specular term in alpha, and the grazing
    term."""

    def fragment(self, v: VolumeVarying) -> PackedMetalTerms:
        terms = self.collect(v.light, sl.ivec2(sl.fragment_coordinate().xy))
        return PackedMetalTerms(diffuse=terms.diffuse, grazing=terms.grazing)


TERM_SHADERS: Final[tuple[type[sl.Shader], ...]] = (NormalShader, PlainTerms, MetalTerms)
"""The shaders of `normals_pass` and `collect_terms`."""
PACKED_TERM_SHADERS: Final[tuple[type[sl.Shader], ...]] = (PackedTerms, PackedMetals)
"""Those of packed terms."""


def normals_pass(effects: FrameEffects, depth_format: Format = DEPTH_FORMAT) -> FramePass[Frame]:
    """The pass that draws `surface`, `shininess` and `depth`."""
    return FramePass(
        "normals",
        draw_normals,
        "stores what lights must know of the nearest surface of each pixel",
        writes=(
            Target("surface", surface_format(effects)),
            Target("shininess", SHININESS_FORMAT),
            Target("depth", depth_format),
        ),
    )


def draw_normals(frame: Frame) -> None:
    """Draw what light depends on of the visible objects."""
    color = [frame.targets["surface"], frame.targets["shininess"]]
    frame.draw_visible(make_scene_drawer(frame, NormalShader, color=color, switches=DIRECTIONS))


def list_terms(effects: FrameEffects, *, packed: bool = False) -> list[str]:
    """Names of the accumulated terms."""
    grazing = ["grazing"] if Effect.METALS in effects.enabled else []
    return ["diffuse", *([] if packed else ["specular"]), *grazing]


def name_terms(terms: Sequence[str]) -> list[str]:
    """Names of the resources that hold accumulated terms."""
    return [f"{term} terms" for term in terms]


def collect_terms(
    frame: Frame,
    *,
    effect: Effect,
    targets: Sequence[str],
    clears: bool,
    stencil: bool = False,
    prefix: str = "",
) -> None:
    """Add the terms of one kind of local lights in view to the light buffers.

    Args:
        prefix: the prefix of the names of downscaled resources; empty if they are at full size.
    """
    shaders = {1: PackedTerms, 2: PlainTerms}
    if Effect.METALS in frame.effects.enabled:
        shaders = {2: PackedMetals, 3: MetalTerms}
    draw_volumes(
        frame,
        effect,
        shaders[len(targets)],
        targets,
        shader_bindings={name: frame.targets[f"{prefix}{name}"] for name in ("surface", "shininess")},
        # Materials leave out what isn't drawn: where terms are packed, diffuse light is the hue of the specular.
        switches={"is_downscaled": bool(prefix), "has_diffuse_light": True, "has_specular_light": True},
        depth=f"{prefix}depth",
        clears=clears,
        is_masked=stencil,
    )


def bind_resources(frame: Frame, names: Mapping[str, str]) -> dict[str, Texture]:
    """Bindings of resources of the plan: a resource's name for each binding's."""
    return {binding: frame.targets[name] for binding, name in names.items()}
