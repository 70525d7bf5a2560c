"""Terms of the lighting equation, which lights add up by their volumes before materials are known."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import rhi.shading as sl
from renderer.frame import DEPTH_FORMAT, Effect, Frame, Needs, Pass, Target
from renderer.shaders.encodings import decode_normal
from renderer.shaders.lighting import safe_normalize
from renderer.shaders.structs import SurfacePoint, SurfaceVarying
from renderer.techniques.parts.geometry_buffer import SurfaceReader, SurfaceWriter, find_surface_format
from renderer.techniques.parts.light_volumes import VolumeShader, VolumeVarying, draw_volumes
from renderer.techniques.parts.scene_shader import ReflectingShader
from renderer.techniques.parts.variants import scene_pass
from rhi import Format, Texture

SHININESS_FORMAT: Final = Format.R16F
_SHININESS_SCALE: Final = 0.5
"""Of what is stored: a shininess may be 100,000, a half float 65,504."""


DIRECTIONS: Final = {"has_color": False, "has_occlusion_maps": False, "has_emissive_maps": False}
"""Switches of shaders that draw what light depends on, and leave the rest of materials to a later pass."""


class NormalTexels(sl.Struct):
    """The texels that `NormalShader` writes."""

    surface: sl.uvec4
    shininess: float


class NormalShader(SurfaceWriter, ReflectingShader):
    """Writes normal, distance and shininess."""

    def fragment(self, v: SurfaceVarying) -> NormalTexels:
        at = self.take(v)
        described = self.see(at)
        shininess = self.find_shininess(self.materials[v.material], described.roughness)
        surface = self.encode_surface(at, described.normal)
        return NormalTexels(surface=surface, shininess=shininess * _SHININESS_SCALE)


class LightTerms(sl.Struct):
    """The terms of the lighting equation: those of a base colour, of a specular colour, and of white, which are the
    irradiance, and what a specular colour of 1 mirrors; only the metallic-roughness model has the third."""

    diffuse: sl.vec4
    specular: sl.vec4
    grazing: sl.vec4


class SpecularTerms(sl.Struct):
    """The terms of scenes without the metallic-roughness model."""

    diffuse: sl.vec4
    specular: sl.vec4


class PackedMetalTerms(sl.Struct):
    """The terms of the metallic-roughness model, where the specular one is a luminance."""

    diffuse: sl.vec4
    grazing: sl.vec4


@sl.function
def luminance(color: sl.vec3) -> float:
    """Return how bright a linear colour looks (Rec. 709)."""
    return sl.dot(color, sl.vec3(0.2126, 0.7152, 0.0722))


class TermShader(VolumeShader, SurfaceReader, ReflectingShader):
    """The base of shaders that collect the terms of lights by their volumes."""

    precision = sl.Precision.FAST

    shininess: sl.Texture2D

    def collect(self, light: int, place: sl.ivec2) -> LightTerms:
        """Return the terms of a light at the surface at a place of the buffers."""
        texel = self.surface.load(place)
        position = self.find_place(texel, place)
        if not self.is_reached(position, light):
            return LightTerms(diffuse=sl.vec4(0.0), specular=sl.vec4(0.0), grazing=sl.vec4(0.0))
        incidence = self.find_incidence(position, light)
        normal = decode_normal(texel.y)
        surface = SurfacePoint(
            position=position,
            normal=normal,
            plane=self.read_plane(texel, normal),
            to_eye=safe_normalize(-position),
            base_color=sl.vec3(1.0),
            specular_color=sl.vec3(1.0),
            shininess=self.shininess.load(place).x / _SHININESS_SCALE,
            occlusion=1.0,
            emissive=sl.vec3(1.0),
        )
        # The terms of spheres have their n·l.
        facing = 1.0 if self.has_spheres else sl.dot(surface.normal, incidence.direction)
        if facing <= 0.0:
            return LightTerms(diffuse=sl.vec4(0.0), specular=sl.vec4(0.0), grazing=sl.vec4(0.0))
        terms = (
            self.find_sphere_terms(surface, incidence.direction, self.find_size(position, light))
            if self.has_spheres
            else self.find_terms(surface, incidence.direction)
        )
        light_in = self.unblocked(incidence.irradiance * facing, position, surface.plane, light)
        specular = light_in * terms.y
        return LightTerms(
            diffuse=sl.vec4(light_in * terms.x, luminance(specular)),
            specular=sl.vec4(specular, 0.0),
            grazing=sl.vec4(light_in * terms.z, 0.0),
        )


class PlainTerms(TermShader):
    """Collects the terms of lights but that of white."""

    def fragment(self, v: VolumeVarying) -> SpecularTerms:
        terms = self.collect(v.light, sl.ivec2(sl.fragment_coordinate().xy))
        return SpecularTerms(diffuse=terms.diffuse, specular=terms.specular)


class MetalTerms(TermShader):
    """Collects the terms of lights, that of white among them."""

    def fragment(self, v: VolumeVarying) -> LightTerms:
        return self.collect(v.light, sl.ivec2(sl.fragment_coordinate().xy))


class PackedTerms(TermShader):
    """Collects the terms of lights, the specular one as a luminance."""

    def fragment(self, v: VolumeVarying) -> sl.vec4:
        return self.collect(v.light, sl.ivec2(sl.fragment_coordinate().xy)).diffuse


class PackedMetals(TermShader):
    """Collects the terms of lights, the specular one as a luminance, and that of white."""

    def fragment(self, v: VolumeVarying) -> PackedMetalTerms:
        terms = self.collect(v.light, sl.ivec2(sl.fragment_coordinate().xy))
        return PackedMetalTerms(diffuse=terms.diffuse, grazing=terms.grazing)


def normals_pass(needs: Needs, depth_format: Format = DEPTH_FORMAT) -> Pass[Frame]:
    """Return the pass that draws `surface`, `shininess` and `depth`."""
    return Pass(
        "normals",
        draw_normals,
        "stores what lights must know of the nearest surface of each pixel",
        writes=(
            Target("surface", find_surface_format(needs)),
            Target("shininess", SHININESS_FORMAT),
            Target("depth", depth_format),
        ),
    )


def draw_normals(frame: Frame) -> None:
    """Draw the visible objects: what lights must know of them."""
    color = [frame.targets["surface"], frame.targets["shininess"]]
    frame.draw_visible(scene_pass(frame, NormalShader, color=color, switches=DIRECTIONS))


def list_terms(needs: Needs, *, packed: bool = False) -> list[str]:
    """Return the names of the terms that are collected."""
    grazing = ["grazing"] if Effect.METALS in needs.effects else []
    return ["diffuse", *([] if packed else ["specular"]), *grazing]


def collect_terms(
    frame: Frame,
    *,
    effect: Effect,
    targets: Sequence[str],
    clears: bool,
    stencil: bool = False,
    prefix: str = "",
) -> None:
    """Add the terms of the point or spot lights in view to the light buffers.

    Args:
        prefix: that of the names of the contents that are lit, if they are shrunk.
    """
    shaders = {1: PackedTerms, 2: PlainTerms}
    if Effect.METALS in frame.needs.effects:
        shaders = {2: PackedMetals, 3: MetalTerms}
    draw_volumes(
        frame,
        effect,
        shaders[len(targets)],
        targets,
        own={name: frame.targets[f"{prefix}{name}"] for name in ("surface", "shininess")},
        switches={"is_shrunk": bool(prefix)},
        depth=f"{prefix}depth",
        clears=clears,
        is_masked=stencil,
    )


def bind_contents(frame: Frame, names: Mapping[str, str]) -> dict[str, Texture]:
    """Return bindings that are contents of these names."""
    return {binding: frame.targets[name] for binding, name in names.items()}
