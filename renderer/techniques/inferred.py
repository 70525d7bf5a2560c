"""Inferred lighting: a light pre-pass with light buffers that are smaller than the image (Kircher and Lawrance, 2009).

1. `normals` draws the geometry, as in a light pre-pass.
2. `shrink` keeps the surfaces of every so many pixels, with their depth.
3. `point lights` and `spot lights` collect terms at these pixels, whose number falls with the square of the scale.
4. `materials` draws the geometry again. Each fragment takes its terms from the four nearest texels by a filter that is
   **sensitive to discontinuities**: texels whose surface lies in another plane or is turned away hardly count. So light
   doesn't leak over edges. Where none of the four belongs to its surface, a fragment takes their mean.

Transparent surfaces are lit by the same passes, because they are **stippled**: `stipple` draws them over three of each
2 × 2 texels of the small buffers, an object always over the same one. So four surfaces behind each other are lit at
once: an opaque one and three transparent ones. In the pass `transparency` a fragment takes its terms from the four
nearest texels that its object may have. To opaque surfaces, stippled texels are those of strangers.

The original compares the numbers of objects and faces; here the stored normals and distances say the same, without
another buffer. What is lit is an exact position of the image, also where the scale isn't 1 / n.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Final

import rhi.shading as sl
from renderer import rules
from renderer.frame import DEPTH_FORMAT, Effect, Frame, Needs, Pass, Target
from renderer.shaders.encodings import decode_normal
from renderer.shaders.lighting import BRIGHTEST
from renderer.shaders.pixels import BackgroundScreen
from renderer.shaders.structs import Object, SurfacePoint, SurfaceVarying
from renderer.techniques.parts.finish import finish_image, forward_passes
from renderer.techniques.parts.geometry_buffer import SurfaceReader, find_shrunk, find_surface_format
from renderer.techniques.parts.light_terms import (
    DIRECTIONS,
    SHININESS_FORMAT,
    NormalShader,
    NormalTexels,
    bind_contents,
    collect_terms,
    list_terms,
    normals_pass,
)
from renderer.techniques.parts.light_volumes import declare_lights
from renderer.techniques.parts.resolve import EXACT_BITS, SUM_FORMATS, check_bits
from renderer.techniques.parts.scene_shader import ForwardShader, SceneShader
from renderer.techniques.parts.variants import FORWARD, Lighting, draw_full_screen, lit_pass, scene_pass
from rhi import DepthFunction, DepthWrite, refuse

_NEAR_PLANE: Final = 0.01
"""The largest distance of a texel's surface from a fragment's plane, in distances from the eye."""
_ALIKE: Final = 0.9
"""The least cosine between normals of one surface."""
_STRANGER: Final = 1e-4
"""The weight of a texel with another surface, where all four have one."""
_LAYERS: Final = 3
"""The transparent surfaces behind each other that are lit at once."""
_LEAST: Final = 1e-3
"""Where texels of the fragment's surface have less of the bilinear weights, all of them count the same."""


class Shrunk(sl.Struct):
    """The size of shrunk buffers in texels."""

    size: sl.ivec2


class ShrunkTexels(sl.Struct):
    """The texels that `ShrinkShader` writes."""

    surface: sl.uvec4
    shininess: float
    depth: sl.FragmentDepth


class ShrinkShader(BackgroundScreen):
    """Copies every so many pixels. The background is put out of reach of the filter."""

    surface: sl.UintTexture2D
    shininess: sl.Texture2D
    depth: sl.Texture2D
    shrunk: sl.Uniform[Shrunk]

    def fragment(self) -> ShrunkTexels:
        place = sl.ivec2(find_shrunk(sl.fragment_coordinate().xy, self.rays.size, self.shrunk.size))
        surface = self.surface.load(place)
        depth = self.depth.load(place).x
        if depth == self.rays.farthest:
            surface.x = sl.float_bits_to_uint(-1e30)
        return ShrunkTexels(surface=surface, shininess=self.shininess.load(place).x, depth=depth)


class Taps(sl.Struct):
    """The four texels that a pixel takes its light from, at the corners `first` and `last`, and their weights: of the
    first, of the one to its right, of the one below, and of the last."""

    first: sl.ivec2
    last: sl.ivec2
    weights: sl.vec4


@sl.function
def filter_light(light: sl.Texture2D, taps: Taps) -> sl.vec3:
    """Return the mean of four texels of light."""
    sum = sl.min(light.load(taps.first).rgb, BRIGHTEST) * taps.weights.x
    sum += sl.min(light.load(sl.ivec2(taps.last.x, taps.first.y)).rgb, BRIGHTEST) * taps.weights.y
    sum += sl.min(light.load(sl.ivec2(taps.first.x, taps.last.y)).rgb, BRIGHTEST) * taps.weights.z
    return sum + sl.min(light.load(taps.last).rgb, BRIGHTEST) * taps.weights.w


class Stippled(SceneShader):
    """Tells the texels of an object. The lists of its lights aren't used; their place in the varyings has the number of
    the texel in each 2 × 2, from 1 to 3."""

    def list_lights(self, thing: Object) -> sl.ivec3:
        return sl.ivec3(1 + sl.instance_index() % _LAYERS)


class StippleShader(Stippled, NormalShader):
    """Writes normal, distance and shininess to an object's texels."""

    def fragment(self, v: SurfaceVarying) -> NormalTexels:
        place = sl.ivec2(sl.fragment_coordinate().xy)
        if place.x % 2 + 2 * (place.y % 2) != v.lights.x:
            sl.discard()
        return super().fragment(v)


class Inference(ForwardShader, SurfaceReader):
    """Adds the light of terms in buffers that are smaller than the image."""

    diffuse: sl.Texture2D
    specular: sl.Texture2D
    grazing: sl.Texture2D
    is_shrunk = True
    is_stippled = False

    def lamplight(self, surface: SurfacePoint, lights: sl.ivec3) -> sl.vec3:
        taps = self.find_taps(surface, lights.x)
        diffuse = filter_light(self.diffuse, taps)
        color = surface.base_color * diffuse + surface.specular_color * filter_light(self.specular, taps)
        if self.has_metals:
            color += filter_light(self.grazing, taps)
        return color

    def find_taps(self, surface: SurfacePoint, begin: int) -> Taps:
        """Return the texels that the surface's pixel takes its light from."""
        size = self.surface.size()
        at = sl.fragment_coordinate().xy * sl.vec2(size) / self.rays.size - 0.5
        stride = 1
        offset = sl.ivec2(0)
        if self.is_stippled:  # the texels of the object are every second one, from the one that `Stippled` tells
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
        if sl.dot(weights, sl.vec4(1.0)) < _LEAST:
            weights = alike
        return Taps(first=first, last=last, weights=weights / sl.dot(weights, sl.vec4(1.0)))

    def compare(self, surface: SurfacePoint, place: sl.ivec2) -> float:
        """Return the weight of a texel: 1 if it is of the same surface, or else that of a stranger."""
        texel = self.surface.load(place)
        away = sl.abs(sl.dot(surface.normal, self.find_place(texel, place) - surface.position))
        if away > _NEAR_PLANE * sl.length(surface.position) or sl.dot(surface.normal, decode_normal(texel.y)) < _ALIKE:
            return _STRANGER
        return 1.0


def check_scale(scale: float, call: str) -> None:
    """Refuse a size of the light buffers, in that of the image, that is out of its range."""
    if not 0.0 < scale <= 1.0:
        refuse(rules.BAD_TECHNIQUE, f"{call}(scale=...)", scale, "more than 0, at most 1; 0.4 and more look well")


class Inferred:
    """Collects the terms of light at a part of the pixels, and takes them for the others from their surface."""

    name: Final = "inferred"

    def __init__(self, *, scale: float = 0.6, stippled: bool = True, light_bits: int = EXACT_BITS) -> None:
        """`scale` is the width and height of light buffers in those of the image, more than 0 and at most 1;
        `light_bits` is 16 or 32, those of a channel of the terms that are added up.

        If they aren't `stippled`, transparent surfaces are lit by the lists of their objects; so they are at full size,
        where each texel that they take is missing in the picture of what is behind them.
        """
        check_scale(scale, "Inferred")
        check_bits(light_bits, SUM_FORMATS, "Inferred(light_bits=...)")
        self.light_bits = light_bits
        self.scale = scale
        self.stippled = stippled

    def declare(self, needs: Needs) -> tuple[Pass[Frame], ...]:
        """Return the passes `normals`, `shrink`, those of lights in view, and `materials`; without such lights, that of
        forward shading; and those of transparent surfaces."""
        stippled = self.stippled and self.scale < 1.0 and Effect.TRANSPARENCY in needs.effects
        scale, small, lit = self.scale, name_small("small "), name_small("stippled " if stippled else "small ")
        collect = partial(collect_terms, prefix="stippled " if stippled else "small ")
        lights, last = declare_lights(needs, list_terms(needs), lit, collect, scale, self.light_bits)
        if not lights:
            return forward_passes(needs)
        own = dict(zip(list_terms(needs), last, strict=True), surface=lit[0])
        formats = (find_surface_format(needs), SHININESS_FORMAT, DEPTH_FORMAT)
        lighting = Lighting((Inference,), bind=partial(bind_contents, names=own), reads=(lit[0], *last))
        through = replace(lighting, bases=(Stippled, Inference), switches={"is_stippled": True})
        because = "draws the visible objects, lit by what was collected"
        return (
            normals_pass(needs),
            Pass(
                "shrink",
                shrink,
                f"lights {scale * scale:.0%} of the pixels",
                reads=("surface", "shininess", "depth"),
                writes=tuple(Target(name, format, scale) for name, format in zip(small, formats, strict=True)),
            ),
            *([_stipple_pass(needs, small, lit)] if stippled else []),
            *lights,
            lit_pass(needs, lighting, because, after_depth=True, name="materials"),
            *finish_image(needs, through if stippled else FORWARD),
        )


def name_small(prefix: str) -> tuple[str, str, str]:
    """Return the names of shrunk contents."""
    return f"{prefix}surface", f"{prefix}shininess", f"{prefix}depth"


def _stipple_pass(needs: Needs, small: Sequence[str], stippled: Sequence[str]) -> Pass[Frame]:
    """Return the pass that draws transparent surfaces over shrunk contents."""
    return Pass(
        "stipple",
        _stipple,
        f"lets light reach transparent surfaces; {needs.explain(Effect.TRANSPARENCY)}",
        changes=dict(zip(small, stippled, strict=True)),
    )


def _stipple(frame: Frame) -> None:
    surface, shininess, depth = (frame.targets[name] for name in name_small("stippled "))
    color = [surface, shininess]
    stippled = scene_pass(frame, StippleShader, color=color, depth=depth, clears=False, switches=DIRECTIONS)
    frame.draw_transparent(stippled, in_order=False)


def shrink(frame: Frame) -> None:
    """Keep the surfaces of every so many pixels."""
    targets = frame.targets
    small = targets["small surface"]
    draw_full_screen(
        frame,
        ShrinkShader,
        [small, targets["small shininess"]],
        {"shrunk": frame.device.transient.uniform(Shrunk(size=small.size))},
        depth=targets["small depth"],
        states=(DepthFunction.ALWAYS, DepthWrite.ON),
    )
