"""Light pre-pass: light is collected before materials are known (Engel, 2009; Russell, 2010).

1. `normals` draws the geometry and stores normal, distance and shininess of the nearest surface.
2. `point lights` and `spot lights` add up the **terms** of the lighting equation, by volumes as in deferred
   shading: the irradiance, and the light that a specular colour of 1 would mirror.
3. `materials` draws the geometry again, where its depth equals, with the shader of forward shading. Each
   material completes the equation itself, and adds what no light buffer has: ambient and directional light,
   rim, emission.

So a geometry buffer need not hold what materials are made of: 10 bytes a pixel instead of 16, for geometry
that is drawn twice. A scene without point and spot lights is drawn once, by forward shading.

The terms take six channels. With `specular_channels=1` they take four: what is mirrored is stored as its
luminance, in the alpha of the diffuse term, and gets that term's hue. That is right where one light prevails.
"""

from __future__ import annotations

from functools import partial
from typing import Final

import rhi.shading as sl
from renderer import rules
from renderer.frame import DEPTH_FORMAT, Frame, FrameEffects, FramePass
from renderer.light_kinds.bounds import LightBounds
from renderer.shaders.lighting import MAX_HALF_FLOAT
from renderer.shaders.structs import SurfacePoint
from renderer.techniques.parts.clustered_passes import clustered_passes
from renderer.techniques.parts.depth import DEPTH_SHADERS
from renderer.techniques.parts.finish import FINISH_SHADERS, finish_image, forward_passes
from renderer.techniques.parts.light_list_reader import ForwardByCells
from renderer.techniques.parts.light_terms import (
    PACKED_TERM_SHADERS,
    TERM_SHADERS,
    bind_resources,
    collect_terms,
    list_terms,
    luminance,
    name_terms,
    normals_pass,
)
from renderer.techniques.parts.light_volumes import VolumeShader, declare_lights
from renderer.techniques.parts.resolve import DEFAULT_LIGHT_BITS, SUM_FORMATS, check_bits
from renderer.techniques.parts.scene_shader import ForwardShader
from renderer.techniques.parts.variants import FORWARD, Lighting, lit_pass
from rhi import Format, refuse
from rhi.errors.arguments import to_integer


class LitByTerms(ForwardShader):
    """Adds the light of accumulated terms. If they are packed, the specular term is a luminance."""

    is_packed = False

    diffuse: sl.Texture2D
    specular: sl.Texture2D
    grazing: sl.Texture2D

    def shade_local_lights(self, surface: SurfacePoint, lights: LightBounds) -> sl.vec3:
        pixel = sl.ivec2(sl.fragment_coordinate().xy)
        terms = sl.min(self.diffuse.load(pixel), MAX_HALF_FLOAT)
        specular = terms.rgb / sl.max(luminance(terms.rgb), 1e-6) * terms.a
        if not self.is_packed:
            specular = sl.min(self.specular.load(pixel).rgb, MAX_HALF_FLOAT)
        if not self.has_diffuse_light:
            terms = sl.vec4(0.0)
        if not self.has_specular_light:
            return surface.base_color * terms.rgb
        color = surface.base_color * terms.rgb + surface.specular_color * specular
        if self.has_metals:
            color += sl.min(self.grazing.load(pixel).rgb, MAX_HALF_FLOAT)
        return color


def check_channels(specular_channels: int, call: str) -> None:
    """Refuse a number of specular channels that isn't 1 or 3."""
    if to_integer(specular_channels) not in (1, 3):
        refuse(rules.BAD_TECHNIQUE, f"{call}(specular_channels=...)", specular_channels, "1 or 3")


class LightPrePass:
    """Accumulates the terms of light before materials complete the lighting equation."""

    name: Final = "light_pre_pass"
    shaders: Final[tuple[type[sl.Shader], ...]] = (
        *TERM_SHADERS,
        *PACKED_TERM_SHADERS,
        VolumeShader,
        LitByTerms,
        ForwardByCells,
        *DEPTH_SHADERS,
        *FINISH_SHADERS,
    )
    """The shaders of its passes: a draw's shader is one of them, or several combined."""

    def __init__(
        self, *, specular_channels: int = 3, stencil: bool = False, light_bits: int = DEFAULT_LIGHT_BITS
    ) -> None:
        """`specular_channels` is 3 or 1. `stencil` masks each light in the stencil buffer. `light_bits`
        (16 or 32) are the bits per channel of the accumulated terms."""
        check_channels(specular_channels, "LightPrePass")
        check_bits(light_bits, SUM_FORMATS, "LightPrePass(light_bits=...)")
        self.light_bits = light_bits
        self.specular_channels = specular_channels
        self.stencil = stencil

    def declare(self, effects: FrameEffects) -> tuple[FramePass[Frame], ...]:
        """The passes `normals`, one per kind of local lights in view, and `materials`. Without local
        lights, those of forward shading."""
        if effects.has_anisotropy or effects.lighting_models:
            return clustered_passes(effects)
        reads = ("surface", "shininess", "depth")
        buffers = list_terms(effects, packed=self.specular_channels == 1)
        collect = partial(collect_terms, stencil=self.stencil)
        lights, last = declare_lights(effects, name_terms(buffers), reads, collect, bits=self.light_bits)
        if not lights:
            return forward_passes(effects)
        shader_bindings, packed = dict(zip(buffers, last, strict=True)), self.specular_channels == 1
        lighting = Lighting(
            (LitByTerms,), {"is_packed": packed}, partial(bind_resources, names=shader_bindings), tuple(last)
        )
        reason = "draws the visible objects, lit by what was collected"
        return (
            normals_pass(effects, Format.D32FS8 if self.stencil else DEPTH_FORMAT),
            *lights,
            lit_pass(effects, lighting, reason, after_depth=True, name="materials"),
            *finish_image(effects, FORWARD),
        )
