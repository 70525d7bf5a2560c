"""Transparent surfaces: drawn over the image after all opaque ones, behind which they are hidden. They hide
nothing.

A surface of opacity a covers the share a of what is behind it: `a · its colour + (1 - a) · what was there`.
Its colour is that of an opaque surface, lit by the same lights, mapped to tones and in the same haze. Shaders
return a · colour and a (*premultiplied*), so that nothing but a sum is left to blending.

What covers what is decided in one of two ways (`Blending`):

- **Sorted**: objects are drawn back to front, in one pass over `image`. That is exact where objects don't
  interleave; of one object the far sides are drawn before the near ones. Layers that the image would round
  away, many and faint ones, are added up in a target of their own, which the pass `blend` puts over the
  image.
- **Weighted**: all are drawn in any order to two sums, from which `blend` makes a mean colour: near surfaces
  weigh more (McGuire and Bavoil 2013, equation 9). The share of the background that is seen is exact, the
  order isn't.

Techniques that light pixels instead of fragments have no light for these surfaces. They are lit by the lists
of their objects as in forward shading, or by lists of their own where a technique has any that hold for
surfaces in front of the nearest one, as those of clusters do.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Final

import rhi.shading as sl
from renderer.frame import Blending, Effect, Frame, FrameEffects, FramePass, Target
from renderer.frame.drawing import NEARER
from renderer.shaders.lighting import MAX_HALF_FLOAT
from renderer.shaders.pixels import BackgroundScreen
from renderer.shaders.structs import SurfaceVarying
from renderer.techniques.parts.full_screen import Color
from renderer.techniques.parts.scene_shader import ForwardShader
from renderer.techniques.parts.variants import Lighting, draw_full_screen, make_scene_drawer
from rhi import BlendFactor, BlendFunction, DepthWrite, Format

COLORS: Final = "transparent colors"
WEIGHTS: Final = "transparent weights"
"""The resources that weighted surfaces are added up in."""

_HEAVIEST: Final = 1e3
"""The largest weight: 65 of them still fit into a half float."""
_WEIGHT_FORMATS: Final = {Format.RGBA16F: Format.R16F, Format.RGBA32F: Format.R32F}
"""The format of weights beside that of colors."""
_SUMS: Final = BlendFunction(
    BlendFactor.ONE,
    BlendFactor.ONE,
    source_alpha=BlendFactor.ZERO,
    destination_alpha=BlendFactor.ONE_MINUS_SOURCE_ALPHA,
)
"""Adds up colours and weights, and multiplies what of the background is left."""


class TransparentShader(ForwardShader):
    """Draws a lit surface with premultiplied alpha."""

    def fragment(self, v: SurfaceVarying) -> sl.vec4:
        seen = self.cover(v)
        return sl.vec4(seen.rgb * seen.a, seen.a)

    def cover(self, v: SurfaceVarying) -> sl.vec4:
        """Colour of the surface, and its opacity in alpha."""
        material = self.materials[v.material]
        at = self.surface_input(v)
        described = self.evaluate(at)
        surface = self.make_surface(
            at.position, self.geometric_normal_of(at, described.normal), described, material
        )
        if self.has_anisotropy:
            surface = self.stretch(surface, at)
        if self.has_lighting_models:
            surface = self.note_material(surface, v.material, material.shader)
        opacity = sl.saturate(material.base_color.a * described.color.a)
        return sl.vec4(self.light_surface(surface, v, material).rgb, opacity)


class WeightedTexels(sl.Struct):
    """Output of `WeightedShader`: a weighted colour with the opacity in alpha, and the weight."""

    colors: sl.vec4
    weights: float


class WeightedShader(TransparentShader):
    """Adds a lit surface to weighted sums."""

    def fragment(self, v: SurfaceVarying) -> WeightedTexels:  # type: ignore[override]  # other targets than the image
        seen = self.cover(v)
        path = self.path_from_eye(v.position)
        near = sl.dot(path, path) / 40000.0  # squared distances in 200 m
        weight = seen.a * sl.clamp(0.03 / (1e-5 + near * near), 1e-2, _HEAVIEST)
        return WeightedTexels(colors=sl.vec4(seen.rgb * weight, seen.a), weights=weight)


class LayersShader(BackgroundScreen):
    """Blends transparent surfaces, which were added up, over the image."""

    colors: sl.Texture2D

    def fragment(self) -> sl.vec4:
        colors = self.colors.load(sl.ivec2(sl.fragment_coordinate().xy))
        if colors.a == 0.0:
            sl.discard()  # nothing covers this pixel
        return colors


class BlendShader(BackgroundScreen):
    """Blends the weighted mean of transparent surfaces over the image."""

    colors: sl.Texture2D
    weights: sl.Texture2D

    def fragment(self) -> sl.vec4:
        pixel = sl.ivec2(sl.fragment_coordinate().xy)
        colors = sl.min(self.colors.load(pixel), MAX_HALF_FLOAT)
        if colors.a == 1.0:
            sl.discard()  # nothing covers this pixel
        weight = sl.min(self.weights.load(pixel).x, MAX_HALF_FLOAT)
        return sl.vec4(colors.rgb * ((1.0 - colors.a) / sl.max(weight, 1e-6)), 1.0 - colors.a)


class WideBlendShader(BlendShader):
    """The same for sums of single floats, which hold every sum of weights."""

    def fragment(self) -> sl.vec4:
        pixel = sl.ivec2(sl.fragment_coordinate().xy)
        colors = self.colors.load(pixel)
        if colors.a == 1.0:
            sl.discard()
        mean = colors.rgb / sl.max(self.weights.load(pixel).x, 1e-12)
        return sl.vec4(sl.min(mean, MAX_HALF_FLOAT) * (1.0 - colors.a), 1.0 - colors.a)


TRANSPARENCY_SHADERS: Final[tuple[type[sl.Shader], ...]] = (
    TransparentShader,
    WeightedShader,
    LayersShader,
    BlendShader,
    WideBlendShader,
)
"""The shaders of transparent surfaces, combined with those of a `Lighting`."""


def declare_transparency(
    effects: FrameEffects, lighting: Lighting, *, image: str = "image"
) -> tuple[FramePass[Frame], ...]:
    """The passes that draw transparent surfaces over the resource `image`, tested against `depth`; none if
    no transparent object is in view."""
    if Effect.TRANSPARENCY not in effects.enabled:
        return ()
    if effects.blending is Blending.SORTED:
        if effects.layers_format is None:
            return (sorted_pass(effects, lighting, image=image),)
        return (
            FramePass(
                "transparency",
                partial(_add_sorted, lighting=lighting),
                effects.explain(Effect.TRANSPARENCY),
                reads=("depth", *lighting.reads),
                writes=(Target(COLORS, effects.layers_format),),
            ),
            FramePass(
                "blend",
                partial(_blend_layers, image=image),
                "puts layers that the image would round away over what is behind them",
                reads=(COLORS,),
                changes={image: f"{image} with transparency"},
            ),
        )
    colors = effects.layers_format or Format.RGBA16F
    return (
        FramePass(
            "transparency",
            partial(_add_weighted, lighting=lighting),
            effects.explain(Effect.TRANSPARENCY),
            reads=("depth", *lighting.reads),
            writes=(Target(COLORS, colors), Target(WEIGHTS, _WEIGHT_FORMATS[colors])),
        ),
        FramePass(
            "blend",
            partial(_blend, image=image),
            "puts transparent surfaces over what is behind them",
            reads=(COLORS, WEIGHTS),
            changes={image: f"{image} with transparency"},
        ),
    )


def sorted_pass(
    effects: FrameEffects,
    lighting: Lighting,
    *,
    image: str = "image",
    depth: str = "depth",
) -> FramePass[Frame]:
    """The pass that draws transparent surfaces back to front over the resource `image`."""
    return FramePass(
        "transparency",
        partial(_draw_sorted, lighting=lighting, image=image, depth=depth),
        effects.explain(Effect.TRANSPARENCY),
        reads=(depth, *lighting.reads),
        changes={image: f"{image} with transparency"},
    )


def _draw_sorted(frame: Frame, *, lighting: Lighting, image: str, depth: str) -> None:
    _draw(frame, lighting, TransparentShader, [image], depth, BlendFunction.PREMULTIPLIED)


def _add_sorted(frame: Frame, *, lighting: Lighting) -> None:
    """Add transparent surfaces up in a target of their own, back to front."""
    clear = (0.0, 0.0, 0.0, 0.0)
    _draw(frame, lighting, TransparentShader, [COLORS], "depth", BlendFunction.PREMULTIPLIED, clear=clear)


def _blend_layers(frame: Frame, *, image: str) -> None:
    targets = frame.targets
    if len(frame.draw_result.transparent):
        bindings = {"colors": targets[COLORS]}
        states = (BlendFunction.PREMULTIPLIED,)
        draw_full_screen(frame, LayersShader, targets[image], bindings, states=states)


def _add_weighted(frame: Frame, *, lighting: Lighting) -> None:
    clear = (0.0, 0.0, 0.0, 1.0)
    _draw(frame, lighting, WeightedShader, [COLORS, WEIGHTS], "depth", _SUMS, clear=clear, in_order=False)


def _draw(
    frame: Frame,
    lighting: Lighting,
    shader: type[TransparentShader],
    resources: Sequence[str],
    depth: str,
    blending: BlendFunction,
    *,
    clear: Color | None = None,
    in_order: bool = True,
) -> None:
    """Draw the transparent objects in view to these resources, tested against `depth`."""
    targets = frame.targets
    surfaces = make_scene_drawer(
        frame,
        shader,
        *lighting.bases,
        shader_bindings=lighting.bind(frame),
        # Ambient occlusion, contact shadows and decals are those of the opaque surfaces behind.
        switches={
            **lighting.switches,
            "has_ambient_occlusion": False,
            "has_contact_shadows": False,
            "has_decals": False,
        },
        color=[targets[name] for name in resources],
        depth=targets[depth],
        clear=clear,
        states=(DepthWrite.OFF, NEARER[frame.camera.projection.depth], blending),
        clears=False,
    )
    frame.draw_transparent(surfaces, in_order=in_order)


def _blend(frame: Frame, *, image: str) -> None:
    targets = frame.targets
    bindings = {"colors": targets[COLORS], "weights": targets[WEIGHTS]}
    if len(frame.draw_result.transparent):
        shader = BlendShader if frame.effects.layers_format is Format.RGBA16F else WideBlendShader
        draw_full_screen(frame, shader, targets[image], bindings, states=(BlendFunction.PREMULTIPLIED,))
