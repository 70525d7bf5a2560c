"""Light pre-pass: light is collected before materials are known (Engel, 2009; Russell, 2010).

1. `normals` draws the geometry and stores normal, distance and shininess of the nearest surface.
2. `point lights` and `spot lights` add up the **terms** of the lighting equation, by volumes as in deferred shading:
   the irradiance, and the light that a specular colour of 1 would mirror.
3. `materials` draws the geometry again, where its depth equals, with the shader of forward shading. Each material
   completes the equation itself, and adds what no light buffer has: ambient and directional light, rim, emission.

So a geometry buffer need not hold what materials are made of: 10 bytes a pixel instead of 16, for geometry that is
drawn twice. A scene without point and spot lights is drawn once, by forward shading.

The terms take six channels. With `specular_channels=1` they take four: what is mirrored is stored as its luminance, in
the alpha of the diffuse term, and gets that term's hue. That is right where one light prevails.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache, partial
from typing import Any, Final

from renderer import rules
from renderer.frame import DEPTH_FORMAT, Effect, Frame, Needs, Pass, Target, TechniquePass
from renderer.shaders.encodings import decode_normal
from renderer.shaders.lighting import BRIGHTEST, safe_normalize
from renderer.shaders.structs import SurfacePoint, SurfaceVarying
from renderer.techniques.finish import finish_image
from renderer.techniques.forward import Forward, bind_materials, find_forward
from renderer.techniques.forward_shader import ForwardShader, forward_variant
from renderer.techniques.geometry_buffer import (
    SurfaceReader,
    SurfaceShader,
    bind_surface,
    draw_surfaces,
    find_surface_format,
    list_planes,
)
from renderer.techniques.light_volumes import (
    VolumeShader,
    VolumeVarying,
    declare_lights,
    draw_volumes,
    lit_variant,
)
from renderer.techniques.scene_shader import SHADING_PARTS, ReflectingShader
from renderer.techniques.surfaces import Aspect, MaterialShader, list_models
from rhi import DepthFunction, DepthWrite, Format, Program, Texture, refuse
from rhi.shading import (
    Precision,
    Struct,
    Texture2D,
    dot,
    fragment_coordinate,
    function,
    ivec2,
    max,
    min,
    uvec4,
    vec3,
    vec4,
)

SHININESS_FORMAT: Final = Format.R16F
_SHININESS_SCALE: Final = 0.5
"""Of what is stored: a shininess may be 100,000, a half float 65,504."""


class NormalTexels(Struct):
    """What `NormalShader` writes."""

    surface: uvec4
    shininess: float


class NormalShader(MaterialShader, SurfaceShader):
    """Writes normal, distance and shininess."""

    def fragment(self, v: SurfaceVarying) -> NormalTexels:
        _ = self.find_texel(v)  # which leaves out what isn't drawn
        shininess = self.find_shininess(self.materials[v.material], self.find_metal(v))
        return NormalTexels(surface=self.encode_surface(v), shininess=shininess * _SHININESS_SCALE)


class LightTerms(Struct):
    """The terms of the lighting equation: those of a base colour, of a specular colour, and of white, which are the
    irradiance, and what a specular colour of 1 mirrors; only the metallic-roughness model has the third."""

    diffuse: vec4
    specular: vec4
    grazing: vec4


class SpecularTerms(Struct):
    """The terms of scenes without the metallic-roughness model."""

    diffuse: vec4
    specular: vec4


class PackedMetalTerms(Struct):
    """The terms of the metallic-roughness model, where the specular one is a luminance."""

    diffuse: vec4
    grazing: vec4


@function
def luminance(color: vec3) -> float:
    """Return how bright a linear colour looks (Rec. 709)."""
    return dot(color, vec3(0.2126, 0.7152, 0.0722))


class TermShader(VolumeShader, SurfaceReader, ReflectingShader):
    """The base of shaders that collect the terms of lights by their volumes."""

    precision = Precision.FAST

    shininess: Texture2D

    def collect(self, light: int, place: ivec2) -> LightTerms:
        """Return the terms of a light at the surface at a place of the buffers."""
        texel = self.surface.load(place)
        position = self.find_place(texel, place)
        if not self.is_reached(position, light):
            return LightTerms(diffuse=vec4(0.0), specular=vec4(0.0), grazing=vec4(0.0))
        incidence = self.find_incidence(position, light)
        normal = decode_normal(texel.x)
        surface = SurfacePoint(
            position=position,
            normal=normal,
            plane=self.read_plane(texel, normal),
            to_eye=safe_normalize(-position),
            base_color=vec3(1.0),
            specular_color=vec3(1.0),
            shininess=self.shininess.load(place).x / _SHININESS_SCALE,
            occlusion=1.0,
            emissive=vec3(1.0),
        )
        facing = dot(surface.normal, incidence.direction)
        if facing <= 0.0:
            return LightTerms(diffuse=vec4(0.0), specular=vec4(0.0), grazing=vec4(0.0))
        terms = self.find_terms(surface, incidence.direction)
        light_in = self.unblocked(incidence.irradiance * facing, position, surface.plane, light)
        specular = light_in * terms.y
        return LightTerms(
            diffuse=vec4(light_in * terms.x, luminance(specular)),
            specular=vec4(specular, 0.0),
            grazing=vec4(light_in * terms.z, 0.0),
        )


class PlainTerms(TermShader):
    """Collects the terms of lights but that of white."""

    def fragment(self, v: VolumeVarying) -> SpecularTerms:
        terms = self.collect(v.light, ivec2(fragment_coordinate().xy))
        return SpecularTerms(diffuse=terms.diffuse, specular=terms.specular)


class MetalTerms(TermShader):
    """Collects the terms of lights, that of white among them."""

    def fragment(self, v: VolumeVarying) -> LightTerms:
        return self.collect(v.light, ivec2(fragment_coordinate().xy))


class PackedTerms(TermShader):
    """Collects the terms of lights, the specular one as a luminance."""

    def fragment(self, v: VolumeVarying) -> vec4:
        return self.collect(v.light, ivec2(fragment_coordinate().xy)).diffuse


class PackedMetals(TermShader):
    """Collects the terms of lights, the specular one as a luminance, and that of white."""

    def fragment(self, v: VolumeVarying) -> PackedMetalTerms:
        terms = self.collect(v.light, ivec2(fragment_coordinate().xy))
        return PackedMetalTerms(diffuse=terms.diffuse, grazing=terms.grazing)


class WithTerms(ForwardShader):
    """Adds the light of terms."""

    diffuse: Texture2D
    specular: Texture2D

    def pointlight(self, surface: SurfacePoint, begin: int, end: int) -> vec3:
        place = ivec2(fragment_coordinate().xy)
        diffuse = min(self.diffuse.load(place).rgb, BRIGHTEST)
        specular = min(self.specular.load(place).rgb, BRIGHTEST)
        return surface.base_color * diffuse + surface.specular_color * specular


class WithPackedTerms(ForwardShader):
    """Adds the light of terms whose specular one is a luminance."""

    diffuse: Texture2D

    def pointlight(self, surface: SurfacePoint, begin: int, end: int) -> vec3:
        terms = min(self.diffuse.load(ivec2(fragment_coordinate().xy)), BRIGHTEST)
        hue = terms.rgb / max(luminance(terms.rgb), 1e-6)
        return surface.base_color * terms.rgb + surface.specular_color * hue * terms.a


class WithGrazingTerms(ForwardShader):
    """Adds the light of the term of white."""

    grazing: Texture2D

    def pointlight(self, surface: SurfacePoint, begin: int, end: int) -> vec3:
        grazing = min(self.grazing.load(ivec2(fragment_coordinate().xy)).rgb, BRIGHTEST)
        return super().pointlight(surface, begin, end) + grazing


class LightPrePass:
    """Collects the terms of light before materials complete the equation."""

    name: Final = "light_pre_pass"

    def __init__(self, *, specular_channels: int = 3, stencil: bool = False) -> None:
        """`specular_channels` is 3 or 1. With `stencil`, each light is masked in a stencil buffer."""
        if specular_channels not in (1, 3):
            refuse(rules.BAD_TECHNIQUE, "LightPrePass(specular_channels=...)", specular_channels, "1 or 3")
        self.specular_channels = specular_channels
        self.stencil = stencil

    def declare(self, needs: Needs) -> tuple[Pass[Frame], ...]:
        """Return the passes `normals`, those of lights in view, and `materials`; without such lights, that of forward
        shading."""
        reads = ("surface", "shininess", "depth")
        buffers = list_terms(needs, packed=self.specular_channels == 1)
        lights, last = declare_lights(needs, buffers, reads, partial(collect_terms, stencil=self.stencil))
        if not lights:
            return Forward().declare(needs)
        return (
            normals_pass(needs, Format.D32FS8 if self.stencil else DEPTH_FORMAT),
            *lights,
            Pass(
                "materials",
                partial(draw_materials, terms=dict(zip(buffers, last, strict=True))),
                "draws the visible objects, lit by what was collected",
                reads=("depth", *last),
                writes=(needs.image,),
            ),
            *finish_image(needs, find_forward),
        )


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
    targets = frame.targets
    draw_surfaces(
        frame,
        NormalShader,
        (Aspect.COVERAGE, Aspect.NORMAL, Aspect.METAL),
        [targets["surface"], targets["shininess"]],
        list_models(frame.needs),
    )


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
    models = (SHADING_PARTS[name] for name in list_models(frame.needs))
    parts = (*list_planes(frame.needs), *models)
    draw_volumes(
        frame,
        effect,
        lit_variant(shaders[len(targets)], effect, parts, is_shrunk=bool(prefix)),
        bind_surface(frame, f"{prefix}surface") | {"shininess": frame.targets[f"{prefix}shininess"]},
        targets,
        depth=f"{prefix}depth",
        clears=clears,
        is_masked=stencil,
    )


@cache
def materials_variant(parts: tuple[str, ...], terms: tuple[str, ...], *, has_sun: bool) -> type[ForwardShader]:
    """Return the forward shader with these of `PARTS` that takes the light of lamps from these terms."""
    lit = WithTerms if "specular" in terms else WithPackedTerms
    grazing = [WithGrazingTerms] if "grazing" in terms else []
    return type("Materials", (*grazing, lit, forward_variant(*parts, has_sun=has_sun)), {"__module__": __name__})


def draw_materials(frame: Frame, *, terms: Mapping[str, str]) -> None:
    """Draw the visible objects again, lit by the terms: the contents of each."""
    features, bindings = bind_materials(frame)
    shader = materials_variant(tuple(features), tuple(terms), has_sun=frame.needs.has_sun)
    draw_again(frame, frame.program(shader), bindings | bind_terms(frame, terms))


def bind_terms(frame: Frame, terms: Mapping[str, str]) -> dict[str, Texture]:
    """Return the bindings of the terms."""
    return {term: frame.targets[name] for term, name in terms.items()}


def draw_again(frame: Frame, program: Program[Any], bindings: dict[str, Any]) -> None:
    """Draw the image: the visible objects, whose depth was drawn before."""
    targets, resources = frame.targets, frame.resources
    frame.draw_visible(
        TechniquePass(
            frame.device,
            resources,
            frame.view,
            program,
            bindings,
            color=frame.image,
            depth=targets["depth"],
            clear=frame.background,
            states=(DepthFunction.EQUAL, DepthWrite.OFF),
            clears=False,
        )
    )
