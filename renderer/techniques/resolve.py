"""The last pass of techniques that collect light: makes the image of what earlier passes have left of each pixel.

A shader of this pass finds the light that each surface sends to the eye, and finishes it as forward shading does: maps
tones, and adds haze by the distance of the surface. A pixel without a surface is the background.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from typing import Any, Final

from renderer.frame import Effect, Frame, Needs, Pass
from renderer.shaders.pixels import FullScreen, distance_at, nearness_of, place_pixel
from renderer.techniques.air import bind_air
from renderer.techniques.forward_shader import find_parts
from renderer.techniques.full_screen import draw_full_screen
from renderer.techniques.scene_shader import FinishShader
from rhi import Format, Texture
from rhi.shading import Shader, Texture2D, discard, fragment_coordinate, ivec2, vec4

LIGHT_FORMAT: Final = Format.RGBA16F
"""The format of light that is added up."""


class ResolveShader(FullScreen, FinishShader):
    """The base of shaders that make the image."""


class LightSum(ResolveShader):
    """Makes the image of all light, added up in `light`."""

    light: Texture2D
    depth: Texture2D

    def fragment(self) -> vec4:
        place = fragment_coordinate().xy
        nearness = nearness_of(self.rays, self.depth.load(ivec2(place)).x)
        if nearness == 0.0:
            discard()
        position = place_pixel(self.rays, place, distance_at(self.rays, nearness))
        return self.finish(self.light.load(ivec2(place)).rgb, position)


def resolve_pass(
    needs: Needs, run: Callable[[Frame], None], because: str, reads: tuple[str, ...]
) -> Pass[Frame]:
    """Return the pass that writes `needs.image`."""
    return Pass("resolve", run, because, reads=reads, writes=(needs.image,))


def sum_pass(needs: Needs, light: str) -> Pass[Frame]:
    """Return the pass that writes `needs.image` from the contents `light` and `depth`."""

    def resolve(frame: Frame) -> None:
        targets = frame.targets
        parts, bindings = bind_air(frame)
        given = {"light": targets[light], "depth": targets["depth"]}
        draw_resolve(frame, (LightSum,), parts, given | bindings)

    because = "maps the light that was added up to colours"
    for effect in (Effect.HAZE, Effect.FOG):
        if effect in needs.effects:
            because += f"; {needs.explain(effect)}"
    return resolve_pass(needs, resolve, because, (light, "depth"))


@cache
def resolve_variant(
    bases: tuple[type[Shader], ...], parts: tuple[str, ...], *, has_sun: bool
) -> type[ResolveShader]:
    """Return a shader of the pass with these bases and these parts (`find_parts`), and only their bindings."""
    return type("Resolve", (*find_parts(parts, has_sun=has_sun), *bases), {"__module__": __name__})


def draw_resolve(
    frame: Frame,
    bases: tuple[type[Shader], ...],
    parts: Sequence[str],
    bindings: dict[str, Any],
    *,
    depth: Texture | None = None,
) -> None:
    """Make the image with a shader of these bases, the last of which is a `ResolveShader`, and parts of it.

    Args:
        bindings: all but the rays of the frame's view.
        depth: the depth that tells the background; None if the shader discards it.
    """
    shader = resolve_variant(bases, tuple(parts), has_sun=frame.needs.has_sun)
    draw_full_screen(frame, shader, frame.image, bindings, depth=depth, clear=frame.background)
