"""Inferred lighting: a light pre-pass with light buffers that are smaller than the image (Kircher and
Lawrance, 2009).

1. `normals` draws the geometry, as in a light pre-pass.
2. `downscale` keeps the surfaces of every so many pixels, with their depth.
3. `point lights` and `spot lights` collect terms at these pixels, whose number falls with the square of the
   scale.
4. `materials` draws the geometry again. Each fragment takes its terms from the four nearest texels by a
   filter that is **sensitive to discontinuities**: texels whose surface lies in another plane or is turned
   away hardly count. So light doesn't leak over edges. Where none of the four belongs to its surface, a
   fragment takes their mean.

Transparent surfaces are lit by the same passes, because they are **stippled**: `stipple` draws them over
three of each 2 × 2 texels of the small buffers, an object always over the same one. So four surfaces behind
each other are lit at once: an opaque one and three transparent ones. In the pass `transparency` a fragment
takes its terms from the four nearest texels that its object may have. To opaque surfaces, stippled texels are
those of strangers.

The original compares the numbers of objects and faces; here the stored normals and distances say the same,
without another buffer. What is lit is an exact position of the image, also where the scale isn't 1 / n.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Final

import rhi.shading as sl
from renderer import rules
from renderer.frame import DEPTH_FORMAT, Effect, Frame, FrameEffects, FramePass, Target
from renderer.light_kinds.bounds import LightBounds
from renderer.shaders.encodings import decode_normal
from renderer.shaders.lighting import MAX_HALF_FLOAT
from renderer.shaders.pixels import BackgroundScreen
from renderer.shaders.structs import Object, SurfacePoint, SurfaceVarying
from renderer.techniques.parts.clustered_passes import clustered_passes
from renderer.techniques.parts.depth import DEPTH_SHADERS
from renderer.techniques.parts.finish import FINISH_SHADERS, finish_image, forward_passes
from renderer.techniques.parts.geometry_buffer import SurfaceReader, full_size_pixel, surface_format
from renderer.techniques.parts.light_list_reader import ForwardByCells
from renderer.techniques.parts.light_terms import (
    DIRECTIONS,
    SHININESS_FORMAT,
    TERM_SHADERS,
    NormalShader,
    NormalTexels,
    bind_resources,
    collect_terms,
    list_terms,
    name_terms,
    normals_pass,
)
from renderer.techniques.parts.light_volumes import VolumeShader, declare_lights
from renderer.techniques.parts.resolve import DEFAULT_LIGHT_BITS, SUM_FORMATS, check_bits
from renderer.techniques.parts.scene_shader import ForwardShader, SceneShader
from renderer.techniques.parts.variants import (
    FORWARD,
    Lighting,
    draw_full_screen,
    lit_pass,
    make_scene_drawer,
)
from rhi import DepthFunction, DepthWrite, refuse

_NEAR_PLANE: Final = 0.01
"""The largest distance of a texel's surface from a fragment's plane, in distances from the eye."""
_ALIKE: Final = 0.9
"""The least cosine between normals of one surface."""
_STRANGER: Final = 1e-4
"""The weight of a texel with another surface, where all four have one."""
_LAYERS: Final = 3
"""The transparent surfaces behind each other that are lit at once."""
_MIN_WEIGHT: Final = 1e-3
"""Where texels of the fragment's surface have less of the bilinear weights, all of them count the same."""


class DownscaledSize(sl.Struct):
    """Width and height of the downscaled buffers in texels."""

    size: sl.ivec2


class DownscaledTexels(sl.Struct):
    """Output of `DownscaleShader`."""

    surface: sl.uvec4
    shininess: float
    depth: sl.FragmentDepth


class DownscaleShader(BackgroundScreen):
    """Copies the surface of one pixel per texel of the downscaled buffers. The background gets a distance
    that the filter never accepts."""

    surface: sl.UintTexture2D
    shininess: sl.Texture2D
    depth: sl.Texture2D
    downscaled: sl.Uniform[DownscaledSize]

    def fragment(self) -> DownscaledTexels:
        pixel = sl.ivec2(full_size_pixel(sl.fragment_coordinate().xy, self.rays.size, self.downscaled.size))
        surface = self.surface.load(pixel)
        depth = self.depth.load(pixel).x
        if depth == self.rays.farthest:
            surface.x = sl.float_bits_to_uint(-1e30)
        return DownscaledTexels(surface=surface, shininess=self.shininess.load(pixel).x, depth=depth)


class Taps(sl.Struct):
    """The four texels that a pixel takes its light from, and their weights. `first` and `last` are
    opposite corners; weights are in the order first, right of it, below it, last."""

    first: sl.ivec2
    last: sl.ivec2
    weights: sl.vec4


@sl.function
def filter_light(light: sl.Texture2D, taps: Taps) -> sl.vec3:
    """Weighted mean of four texels of light."""
    sum = sl.min(light.load(taps.first).rgb, MAX_HALF_FLOAT) * taps.weights.x
    sum += sl.min(light.load(sl.ivec2(taps.last.x, taps.first.y)).rgb, MAX_HALF_FLOAT) * taps.weights.y
    sum += sl.min(light.load(sl.ivec2(taps.first.x, taps.last.y)).rgb, MAX_HALF_FLOAT) * taps.weights.z
    return sum + sl.min(light.load(taps.last).rgb, MAX_HALF_FLOAT) * taps.weights.w


class StippledShader(SceneShader):
    """Assigns each object one texel of every 2 × 2. Light lists aren't used here: their varyings carry the
    number of that texel, 1 to 3."""

    def list_lights(self, object_data: Object) -> LightBounds:
        return LightBounds(1 + sl.instance_index() % _LAYERS)


class StippleShader(StippledShader, NormalShader):
    """Writes normal, distance and shininess to the texels of an object."""

    def fragment(self, v: SurfaceVarying) -> NormalTexels:
        texel = sl.ivec2(sl.fragment_coordinate().xy)
        if texel.x % 2 + 2 * (texel.y % 2) != v.lights.x:
            sl.discard()
        return super().fragment(v)


class InferredLightShader(ForwardShader, SurfaceReader):
    """Adds the light of terms in buffers that are smaller than the image."""

    diffuse: sl.Texture2D
    specular: sl.Texture2D
    grazing: sl.Texture2D
    is_downscaled = True
    is_stippled = False

    def shade_local_lights(self, surface: SurfacePoint, lights: LightBounds) -> sl.vec3:
        taps = self.compute_taps(surface, lights.x)
        if not self.has_specular_light:
            return surface.base_color * filter_light(self.diffuse, taps)
        diffuse = filter_light(self.diffuse, taps)
        if not self.has_diffuse_light:
            diffuse = sl.vec3(0.0)
        color = surface.base_color * diffuse + surface.specular_color * filter_light(self.specular, taps)
        if self.has_metals:
            color += filter_light(self.grazing, taps)
        return color

    def compute_taps(self, surface: SurfacePoint, begin: int) -> Taps:
        """The texels and weights that the surface's pixel takes its light from."""
        size = self.surface.size()
        at = sl.fragment_coordinate().xy * sl.vec2(size) / self.rays.size - 0.5
        stride = 1
        offset = sl.ivec2(0)
        if (
            self.is_stippled
        ):  # the texels of the object are every second one, from the one that `StippledShader` tells
            stride = 2
            offset = sl.ivec2(begin % 2, begin // 2)
            at = (at - sl.vec2(offset)) * 0.5
        share = at - sl.floor(at)
        first = sl.clamp(sl.ivec2(sl.floor(at)) * stride + offset, sl.ivec2(0), size - 1)
        last = sl.clamp((sl.ivec2(sl.floor(at)) + 1) * stride + offset, sl.ivec2(0), size - 1)
        alike = sl.vec4(
            self.compare(surface, first),
            self.compare(surface, sl.ivec2(last.x, first.y)),
            self.compare(surface, sl.ivec2(first.x, last.y)),
            self.compare(surface, last),
        )
        across = sl.vec2(1.0 - share.x, share.x)
        weights = sl.vec4(across * (1.0 - share.y), across * share.y) * sl.step(sl.vec4(0.5), alike)
        if sl.dot(weights, sl.vec4(1.0)) < _MIN_WEIGHT:
            weights = alike
        return Taps(first=first, last=last, weights=weights / sl.dot(weights, sl.vec4(1.0)))

    def compare(self, surface: SurfacePoint, texel_position: sl.ivec2) -> float:
        """Weight of a texel: 1 if it belongs to the same surface, else nearly 0."""
        texel = self.surface.load(texel_position)
        away = sl.abs(sl.dot(surface.normal, self.surface_position(texel, texel_position) - surface.position))
        if (
            away > _NEAR_PLANE * sl.length(surface.position)
            or sl.dot(surface.normal, decode_normal(texel.y)) < _ALIKE
        ):
            return _STRANGER
        return 1.0


def check_scale(scale: float, call: str) -> None:
    """Refuse a scale of the light buffers that isn't above 0 and at most 1."""
    (number,) = rules.check_numbers(rules.BAD_TECHNIQUE, call, scale=scale)
    if not 0.0 < number <= 1.0:
        refuse(
            rules.BAD_TECHNIQUE, f"{call}(scale=...)", scale, "more than 0, at most 1; 0.4 or more looks good"
        )


class Inferred:
    """Accumulates the terms of light at lower resolution, and filters them to full resolution surface by
    surface."""

    name: Final = "inferred"
    shaders: Final[tuple[type[sl.Shader], ...]] = (
        *TERM_SHADERS,
        VolumeShader,
        DownscaleShader,
        StippleShader,
        InferredLightShader,
        StippledShader,
        ForwardByCells,
        *DEPTH_SHADERS,
        *FINISH_SHADERS,
    )
    """The shaders of its passes: a draw's shader is one of them, or several combined."""

    def __init__(
        self, *, scale: float = 0.6, stippled: bool = True, light_bits: int = DEFAULT_LIGHT_BITS
    ) -> None:
        """`scale` is the size of the light buffers as a fraction of the image's, above 0 and at most 1;
        `light_bits` (16 or 32) are the bits per channel of the accumulated terms.

        If they aren't `stippled`, transparent surfaces are lit by the lists of their objects; so they are at
        full size, where each texel that they take is missing in the image of what is behind them.
        """
        check_scale(scale, "Inferred")
        check_bits(light_bits, SUM_FORMATS, "Inferred(light_bits=...)")
        self.light_bits = light_bits
        self.scale = scale
        self.stippled = stippled

    def declare(self, effects: FrameEffects) -> tuple[FramePass[Frame], ...]:
        """The passes `normals`, `downscale`, one per kind of local lights in view, `materials`, and those
        of transparent surfaces. Without local lights, those of forward shading."""
        if effects.has_anisotropy or effects.lighting_models:
            return clustered_passes(effects)
        stippled = self.stippled and self.scale < 1.0 and Effect.TRANSPARENCY in effects.enabled
        scale = self.scale
        small = downscaled_names("small ")
        lit = downscaled_names("stippled " if stippled else "small ")
        collect = partial(collect_terms, prefix="stippled " if stippled else "small ")
        lights, last = declare_lights(
            effects, name_terms(list_terms(effects)), lit, collect, scale, self.light_bits
        )
        if not lights:
            return forward_passes(effects)
        shader_bindings = dict(zip(list_terms(effects), last, strict=True), surface=lit[0])
        formats = (surface_format(effects), SHININESS_FORMAT, DEPTH_FORMAT)
        lighting = Lighting(
            (InferredLightShader,), bind=partial(bind_resources, names=shader_bindings), reads=(lit[0], *last)
        )
        through = replace(
            lighting, bases=(StippledShader, InferredLightShader), switches={"is_stippled": True}
        )
        reason = "draws the visible objects, lit by what was collected"
        return (
            normals_pass(effects),
            FramePass(
                "downscale",
                downscale,
                f"lights {scale * scale:.0%} of the pixels",
                reads=("surface", "shininess", "depth"),
                writes=tuple(
                    Target(name, format, scale) for name, format in zip(small, formats, strict=True)
                ),
            ),
            *([_stipple_pass(effects, small, lit)] if stippled else []),
            *lights,
            lit_pass(effects, lighting, reason, after_depth=True, name="materials"),
            *finish_image(effects, through if stippled else FORWARD),
        )


def downscaled_names(prefix: str) -> tuple[str, str, str]:
    """Names of the downscaled resources with this prefix."""
    return f"{prefix}surface", f"{prefix}shininess", f"{prefix}depth"


def _stipple_pass(effects: FrameEffects, small: Sequence[str], stippled: Sequence[str]) -> FramePass[Frame]:
    """The pass that draws transparent surfaces over the downscaled resources."""
    return FramePass(
        "stipple",
        _stipple,
        f"lets light reach transparent surfaces; {effects.explain(Effect.TRANSPARENCY)}",
        changes=dict(zip(small, stippled, strict=True)),
    )


def _stipple(frame: Frame) -> None:
    surface, shininess, depth = (frame.targets[name] for name in downscaled_names("stippled "))
    color = [surface, shininess]
    stippled = make_scene_drawer(
        frame, StippleShader, color=color, depth=depth, clears=False, switches=DIRECTIONS
    )
    frame.draw_transparent(stippled, in_order=False)


def downscale(frame: Frame) -> None:
    """Copy the surfaces to the downscaled buffers."""
    targets = frame.targets
    small = targets["small surface"]
    draw_full_screen(
        frame,
        DownscaleShader,
        [small, targets["small shininess"]],
        {"downscaled": frame.device.transient.uniform(DownscaledSize(size=small.size))},
        depth=targets["small depth"],
        states=(DepthFunction.ALWAYS, DepthWrite.ON),
    )
