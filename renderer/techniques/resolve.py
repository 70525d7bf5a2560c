"""The last pass of techniques that add up light: maps the sum to colours, and mixes in haze.

The sum is linear light of any strength in `light` (RGBA16F). Each pixel is tone-mapped, then fades to the background by
the distance of its surface, which its depth tells. A pixel without a surface is the background, whatever `light` holds.
"""

from __future__ import annotations

from typing import Any, Final

from renderer.frame import IMAGE_FORMAT, Effect, Frame, Needs, Pass, Target
from renderer.shaders.lighting import through_haze, tone_map
from renderer.shaders.pixels import FullScreen, PixelConstants, nearness_of, position_at
from renderer.shaders.structs import Haze
from renderer.techniques.full_screen import bind_pixels, draw_full_screen
from rhi import Format
from rhi.shading import Texture2D, Uniform, discard, fragment_coordinate, ivec2, vec3, vec4

LIGHT_FORMAT: Final = Format.RGBA16F
"""The format of light that is added up."""


class Resolve(FullScreen):
    """Maps light to colours."""

    light: Texture2D
    depth: Texture2D
    pixels: Uniform[PixelConstants]

    def fragment(self) -> vec4:
        place = fragment_coordinate().xy
        nearness = nearness_of(self.depth.load(ivec2(place)).x, self.pixels)
        if nearness == 0.0:
            discard()
        position = position_at(place, nearness, self.pixels)
        return vec4(self.through_air(tone_map(self.light.load(ivec2(place)).rgb), position), 1.0)

    def through_air(self, color: vec3, position: vec3) -> vec3:
        return color


class ResolveHaze(Resolve):
    """Adds haze."""

    haze: Uniform[Haze]

    def through_air(self, color: vec3, position: vec3) -> vec3:
        return through_haze(color, position, self.haze)


def declare_resolve(needs: Needs, light: str = "light", depth: str = "depth") -> Pass[Frame]:
    """Return the pass that writes `image` from the contents `light` and `depth`."""

    def resolve(frame: Frame) -> None:
        resources, targets = frame.resources, frame.targets
        has_haze = Effect.HAZE in frame.needs.effects
        haze: dict[str, Any] = {"haze": resources.haze.buffer} if has_haze else {}
        draw_full_screen(
            frame,
            ResolveHaze if has_haze else Resolve,
            targets["image"],
            clear=(*resources.scene.background, 1.0),
            light=targets[light],
            depth=targets[depth],
            pixels=bind_pixels(frame),
            **haze,
        )

    because = "maps the light that was added up to colours"
    if Effect.HAZE in needs.effects:
        because += f"; {needs.explain(Effect.HAZE)}"
    return Pass("resolve", resolve, because, reads=(light, depth), writes=(Target("image", IMAGE_FORMAT),))
