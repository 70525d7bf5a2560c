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

from collections.abc import Sequence
from functools import cache, partial
from typing import Any, Final

from renderer import rules
from renderer.frame import DEPTH_FORMAT, IMAGE_FORMAT, Effect, Frame, Needs, Pass, Target, TechniquePass
from renderer.shaders.encodings import decode_normal
from renderer.shaders.lighting import highlight, safe_normalize
from renderer.shaders.structs import Material, SurfacePoint, SurfaceVarying
from renderer.techniques.forward import Forward, bind_materials, find_forward
from renderer.techniques.forward_shader import ForwardShader, forward_variant
from renderer.techniques.geometry_buffer import (
    SURFACE_FORMAT,
    SurfaceReader,
    SurfaceShader,
    bind_scene,
    bind_surface,
)
from renderer.techniques.light_volumes import (
    BRIGHTEST,
    VolumeShader,
    VolumeVarying,
    declare_lights,
    draw_volumes,
    lit_variant,
)
from renderer.techniques.transparency import declare_transparency
from rhi import DepthFunction, DepthWrite, Format, Program, Texture, refuse
from rhi.shading import (
    Precision,
    Storage,
    Struct,
    Texture2D,
    dot,
    fragment_coordinate,
    function,
    ivec2,
    max,
    min,
    uvec2,
    vec3,
    vec4,
)

SHININESS_FORMAT: Final = Format.R16F
_SHININESS_SCALE: Final = 0.5
"""Of what is stored: a shininess may be 100,000, a half float 65,504."""


class NormalTexels(Struct):
    """What `NormalShader` writes."""

    surface: uvec2
    shininess: float


class NormalShader(SurfaceShader):
    """Writes normal, distance and shininess."""

    materials: Storage[Material]

    def fragment(self, v: SurfaceVarying) -> NormalTexels:
        shininess = self.materials[v.material].shininess * _SHININESS_SCALE
        return NormalTexels(surface=self.encode_surface(v), shininess=shininess)


class LightTerms(Struct):
    """The terms of the lighting equation: irradiance, and what a specular colour of 1 mirrors."""

    diffuse: vec4
    specular: vec4


@function
def luminance(color: vec3) -> float:
    """Return how bright a linear colour looks (Rec. 709)."""
    return dot(color, vec3(0.2126, 0.7152, 0.0722))


class TermShader(VolumeShader, SurfaceReader):
    """Collects the terms of lights by their volumes."""

    precision = Precision.FAST

    shininess: Texture2D

    def fragment(self, v: VolumeVarying) -> LightTerms:
        return self.collect(v.light, ivec2(fragment_coordinate().xy))

    def collect(self, light: int, place: ivec2) -> LightTerms:
        """Return the terms of a light at the surface at a place of the buffers."""
        texel = self.surface.load(place)
        position = self.find_place(texel, place)
        if not self.is_reached(position, light):
            return LightTerms(diffuse=vec4(0.0), specular=vec4(0.0))
        incidence = self.find_incidence(position, light)
        surface = SurfacePoint(
            position=position,
            normal=decode_normal(texel.x),
            to_eye=safe_normalize(-position),
            base_color=vec3(1.0),
            specular_color=vec3(1.0),
            shininess=self.shininess.load(place).x / _SHININESS_SCALE,
        )
        facing = dot(surface.normal, incidence.direction)
        if facing <= 0.0:
            return LightTerms(diffuse=vec4(0.0), specular=vec4(0.0))
        diffuse = self.unblocked(incidence.irradiance * facing, position, surface.normal, light)
        specular = diffuse * highlight(surface, incidence.direction)
        return LightTerms(diffuse=vec4(diffuse, luminance(specular)), specular=vec4(specular, 0.0))


class PackedTerms(TermShader):
    """Collects the terms of lights, the specular one as a luminance."""

    def fragment(self, v: VolumeVarying) -> vec4:  # type: ignore[override]
        return self.collect(v.light, ivec2(fragment_coordinate().xy)).diffuse


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
        buffers = ["diffuse", "specular"] if self.specular_channels == 3 else ["diffuse"]
        lights, last = declare_lights(needs, buffers, reads, partial(collect_terms, stencil=self.stencil))
        if not lights:
            return Forward().declare(needs)
        return (
            normals_pass(Format.D32FS8 if self.stencil else DEPTH_FORMAT),
            *lights,
            Pass(
                "materials",
                partial(draw_materials, terms=last),
                "draws the visible objects, lit by what was collected",
                reads=("depth", *last),
                writes=(Target("image", IMAGE_FORMAT),),
            ),
            *declare_transparency(needs, find_forward),
        )


def normals_pass(depth_format: Format) -> Pass[Frame]:
    """Return the pass that draws `surface`, `shininess` and `depth`."""
    return Pass(
        "normals",
        draw_normals,
        "stores what lights must know of the nearest surface of each pixel",
        writes=(
            Target("surface", SURFACE_FORMAT),
            Target("shininess", SHININESS_FORMAT),
            Target("depth", depth_format),
        ),
    )


def draw_normals(frame: Frame) -> None:
    """Draw the visible objects: what lights must know of them."""
    targets, resources = frame.targets, frame.resources
    frame.draw_visible(
        TechniquePass(
            frame.device,
            resources,
            frame.view,
            frame.device.program(NormalShader),
            bind_scene(frame) | {"materials": resources.materials.buffer},
            color=[targets["surface"], targets["shininess"]],
            depth=targets["depth"],
        )
    )


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
    shader = PackedTerms if len(targets) == 1 else TermShader
    draw_volumes(
        frame,
        effect,
        lit_variant(shader, effect, is_shrunk=bool(prefix)),
        bind_surface(frame, f"{prefix}surface") | {"shininess": frame.targets[f"{prefix}shininess"]},
        targets,
        depth=f"{prefix}depth",
        clears=clears,
        is_masked=stencil,
    )


@cache
def materials_variant(parts: tuple[str, ...], *, has_sun: bool, packed: bool) -> type[ForwardShader]:
    """Return the forward shader with these of `PARTS` that takes the light of point and spot lights from terms."""
    lit = WithPackedTerms if packed else WithTerms
    return type("Materials", (lit, forward_variant(*parts, has_sun=has_sun)), {"__module__": __name__})


def draw_materials(frame: Frame, *, terms: Sequence[str]) -> None:
    """Draw the visible objects again, lit by the terms."""
    features, bindings = bind_materials(frame)
    shader = materials_variant(tuple(features), has_sun=frame.needs.has_sun, packed=len(terms) == 1)
    draw_again(frame, frame.device.program(shader), bindings | bind_terms(frame, terms))


def bind_terms(frame: Frame, terms: Sequence[str]) -> dict[str, Texture]:
    """Return the bindings of the terms, whose contents have these names."""
    return {name: frame.targets[term] for name, term in zip(("diffuse", "specular"), terms, strict=False)}


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
            color=targets.image,
            depth=targets["depth"],
            clear=(*resources.scene.background, 1.0),
            states=(DepthFunction.EQUAL, DepthWrite.OFF),
            clears=False,
        )
    )
