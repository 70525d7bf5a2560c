"""The end of every technique, once its opaque surfaces are drawn: sky, transparent surfaces, depth of field, bloom
and tones."""

from __future__ import annotations

from typing import Final

from renderer.frame import Blending, Effect, Frame, FrameEffects, FramePass, last_version
from renderer.shaders.environment import EnvironmentSky
from renderer.shaders.fog import apply_fog_to_background
from renderer.shaders.pixels import BackgroundScreen, pixel_position
from renderer.shaders.tone_mapping import inverse_tone_map
from renderer.techniques.parts.bloom import BLOOM_SHADERS, bloom_passes
from renderer.techniques.parts.depth import depth_pass
from renderer.techniques.parts.depth_of_field import (
    BLURRED_LIGHT,
    DEPTH_OF_FIELD_SHADERS,
    depth_of_field_passes,
)
from renderer.techniques.parts.scene_shader import FinishShader, ForwardShader
from renderer.techniques.parts.transparency import TRANSPARENCY_SHADERS, declare_transparency, sorted_pass
from renderer.techniques.parts.variants import FORWARD, Lighting, draw_full_screen, lit_pass, name_samples
from rhi import DepthFunction
from rhi.shading import Shader, Struct, Uniform, fragment_coordinate, vec3, vec4


class Background(Struct):
    """The light of the background."""

    light: vec3


class SkyShader(BackgroundScreen, FinishShader):
    """Draws the background through all of the fog."""

    background: Uniform[Background]

    def fragment(self) -> vec4:
        pixel = fragment_coordinate().xy
        start = pixel_position(self.rays, pixel, 0.0)
        direction = pixel_position(self.rays, pixel, 1.0) - start
        light = apply_fog_to_background(self.background.light, direction, self.fog_at(start))
        return self.finish(light, direction)


class SkyBox(EnvironmentSky, BackgroundScreen, FinishShader):
    """Draws the environment behind everything, through all of the fog."""

    has_fogged_sky = False

    def fragment(self) -> vec4:
        pixel = fragment_coordinate().xy
        start = pixel_position(self.rays, pixel, 0.0)
        direction = pixel_position(self.rays, pixel, 1.0) - start
        light = self.sky_at(self.rays, pixel)
        if self.has_fogged_sky:
            light = apply_fog_to_background(light, direction, self.fog_at(start))
        return self.finish(light, direction)


FINISH_SHADERS: Final[tuple[type[Shader], ...]] = (
    SkyShader,
    SkyBox,
    ForwardShader,
    *TRANSPARENCY_SHADERS,
    *DEPTH_OF_FIELD_SHADERS,
    *BLOOM_SHADERS,
)
"""The shaders of `finish_image`, and of `forward_passes` with one sample per pixel."""


def forward_passes(
    effects: FrameEffects, lighting: Lighting = FORWARD, *, samples: int = 1
) -> tuple[FramePass[Frame], ...]:
    """The passes of forward shading: one over the visible objects, lit by their light lists, and those of
    `finish_image`. Other techniques use them if no local light is in view."""
    return draw_once(effects, lighting, "draws the visible objects, lit", samples=samples)


def draw_once(
    effects: FrameEffects,
    lighting: Lighting,
    reason: str,
    *,
    samples: int,
    depth_first: str = "",
    lists: tuple[FramePass[Frame], ...] = (),
    transparent: Lighting = FORWARD,
) -> tuple[FramePass[Frame], ...]:
    """The passes of a technique that draws the visible objects lit once: `depth` if it is drawn first, the
    light lists, `forward`, and those of `finish_image`.

    Depth of several samples can't be read, but layers, culling and lists of lights read depth. So with
    several samples, depth of one is always drawn before, and if `depth_first`, then that of all.

    Args:
        lighting, reason: as for `lit_pass`.
        samples: samples per pixel.
        depth_first: why depth is drawn before; empty if it isn't.
        lists: the passes that list lights.
        transparent: how transparent surfaces are lit.
    """
    passes = list(lists)
    if effects.shading_reads:
        depth_first = depth_first or effects.depth_reason
    if depth_first or samples > 1:
        reason_before = depth_first or "layers and culling can't read depth of several samples"
        passes.insert(0, depth_pass(reason_before, has_meshlets=samples == 1))
    if depth_first and samples > 1:
        passes.append(depth_pass("no hidden fragment is lit", samples=samples))
    passes.append(lit_pass(effects, lighting, reason, after_depth=bool(depth_first), samples=samples))
    return *passes, *finish_image(effects, transparent, samples=samples)


def finish_image(
    effects: FrameEffects, lighting: Lighting, *, samples: int = 1, has_sky: bool = False
) -> tuple[FramePass[Frame], ...]:
    """The passes that make `image` from `effects.image`, in which opaque surfaces have been drawn.

    Args:
        lighting: how transparent surfaces are lit.
        samples: how many samples a pixel has. With more than one, surfaces are in the resources that
            `name_samples` names.
        has_sky: whether fog before the background has been drawn, too.
    """
    image = effects.image.name
    if samples == 1:
        passes = [] if has_sky else [*_sky_passes(effects, image, "depth")]
        passes += declare_transparency(effects, lighting, image=last_version(passes, image))
    else:
        drawn, depth = name_samples(image, samples), name_samples("depth", samples)
        passes = [*_sky_passes(effects, drawn, depth)]
        # Weighted sums can't be resolved: those surfaces are drawn after it, with one sample.
        is_sorted = effects.blending is Blending.SORTED
        if is_sorted and Effect.TRANSPARENCY in effects.enabled:
            passes.append(sorted_pass(effects, lighting, image=last_version(passes, drawn), depth=depth))
        passes.append(_resolve_pass(effects, last_version(passes, drawn)))
        passes += () if is_sorted else declare_transparency(effects, lighting, image=image)
    return *passes, *camera_passes(effects, last_version(passes, image))


def camera_passes(effects: FrameEffects, light: str) -> tuple[FramePass[Frame], ...]:
    """The passes that make `image` from the resource `light` by the effects of the camera; none without any."""
    blurred = BLURRED_LIGHT if Effect.DEPTH_OF_FIELD in effects.enabled else light
    return *depth_of_field_passes(effects, light), *bloom_passes(effects, blurred)


def _resolve_pass(effects: FrameEffects, samples: str) -> FramePass[Frame]:
    def resolve(frame: Frame) -> None:
        frame.targets[samples].resolve_to(frame.image)

    return FramePass(
        "resolve", resolve, "a pixel is the mean of its samples", reads=(samples,), writes=(effects.image,)
    )


def _sky_passes(effects: FrameEffects, image: str, depth: str) -> tuple[FramePass[Frame], ...]:
    """The pass that draws the environment, or the fog in front of the background, over the resource `image`; none
    without an environment where fog doesn't change the background."""
    if Effect.SKY_BOX in effects.enabled:
        return (_sky_box_pass(effects, image, depth),)
    if not effects.has_fogged_sky:
        return ()

    def draw(frame: Frame) -> None:
        background = Background(light=inverse_tone_map(frame.resources.scene.background))
        draw_full_screen(
            frame,
            SkyShader,
            frame.targets[image],
            {"background": frame.resources.mirror(background)},
            depth=frame.targets[depth],
            states=(DepthFunction.EQUAL,),  # to the farthest depth, at which the triangle is
            switches={"has_fog": False, "has_haze": False},
        )

    reason = f"shows fog before the background; {effects.explain(Effect.FOG)}"
    return (FramePass("sky", draw, reason, reads=(depth,), changes={image: f"{image} with sky"}),)


def _sky_box_pass(effects: FrameEffects, image: str, depth: str) -> FramePass[Frame]:
    """The pass that draws the environment where no surface is."""

    def draw(frame: Frame) -> None:
        draw_full_screen(
            frame,
            SkyBox,
            frame.targets[image],
            depth=frame.targets[depth],
            states=(DepthFunction.EQUAL,),
            switches={"has_fog": False, "has_haze": False, "has_fogged_sky": effects.has_fogged_sky},
        )

    reason = f"draws the background; {effects.explain(Effect.SKY_BOX)}"
    return FramePass("sky box", draw, reason, reads=(depth,), changes={image: f"{image} with sky"})
