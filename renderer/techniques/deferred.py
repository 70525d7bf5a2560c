"""Deferred shading: the scene's geometry is drawn once, without light; then each light lights the pixels that it
reaches (Hargreaves and Harris, 2004).

1. `geometry` stores the nearest surface of each pixel (`geometry_buffer`).
2. `point lights` and `spot lights` draw the lights' volumes and add what the surfaces in them reflect
   (`light_volumes`).
3. `resolve` adds the light that reaches everything (ambient, directional, emitted), maps tones and adds haze.

So the cost of a light doesn't depend on the number of objects. A scene without point and spot lights has no light
buffer and only the passes 1 and 3.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any, Final

from renderer.frame import DEPTH_FORMAT, Effect, Frame, Needs, Pass
from renderer.shaders.lighting import BRIGHTEST
from renderer.shaders.structs import SurfacePoint
from renderer.techniques.finish import finish_image
from renderer.techniques.forward import bind_shading, find_forward
from renderer.techniques.geometry_buffer import (
    GeometryReader,
    bind_geometry,
    find_layout,
    geometry_pass,
    list_contents,
    list_planes,
    list_readers,
)
from renderer.techniques.light_volumes import (
    VolumeShader,
    VolumeVarying,
    declare_lights,
    draw_volumes,
    lit_variant,
)
from renderer.techniques.resolve import ResolveShader, draw_resolve, resolve_pass
from renderer.techniques.scene_shader import ShadingShader
from rhi import Format
from rhi.shading import (
    Precision,
    Texture2D,
    fragment_coordinate,
    ivec2,
    min,
    uint_bits_to_float,
    vec3,
    vec4,
)


class LightingShader(VolumeShader, GeometryReader):
    """Lights the geometry buffer by the volumes of lights."""

    precision = Precision.FAST

    def fragment(self, v: VolumeVarying) -> vec4:
        place = ivec2(fragment_coordinate().xy)
        texel = self.surface.load(place)
        position = self.find_place(texel, place)
        if not self.is_reached(position, v.light):
            return vec4(0.0)
        row = self.material.load(place)
        surface = self.read_surface(row, texel, place, position)
        light = self.reflect_light(surface, self.find_incidence(position, v.light))
        return vec4(self.unblocked(light, position, surface.plane, v.light), 0.0)


class GeometryResolve(ResolveShader, GeometryReader, ShadingShader):
    """Makes the image from the geometry buffer."""

    def fragment(self) -> vec4:
        place = ivec2(fragment_coordinate().xy)
        texel = self.surface.load(place)
        row = self.material.load(place)
        position = self.find_place(texel, place)
        material = self.materials[int(row.x)]
        surface = self.read_surface(row, texel, place, position)
        color = self.shade(surface, material)
        color += self.local_light(surface, place, uint_bits_to_float(texel.y))
        return self.finish(color, position)

    def local_light(self, surface: SurfacePoint, pixel: ivec2, distance: float) -> vec3:
        return vec3(0.0)


class WithLightBuffer(GeometryResolve):
    """Adds the light of volumes."""

    light: Texture2D

    def local_light(self, surface: SurfacePoint, pixel: ivec2, distance: float) -> vec3:
        return min(self.light.load(pixel).rgb, BRIGHTEST)


class Deferred:
    """Draws the scene to a geometry buffer, lights that by volumes, and makes the image from both."""

    name: Final = "deferred"

    def __init__(self, *, stencil: bool = False) -> None:
        """With `stencil`, each light is masked in a stencil buffer, which takes two draws for each."""
        self.stencil = stencil

    def declare(self, needs: Needs) -> tuple[Pass[Frame], ...]:
        """Return the passes `geometry`, `point lights` and `spot lights` if there are any in view, and `resolve`, and
        those of transparent surfaces."""
        reads = list_contents(needs)
        lights, last = declare_lights(needs, ["light"], reads, partial(light_geometry, stencil=self.stencil))
        return (
            geometry_pass(needs, Format.D32FS8 if self.stencil else DEPTH_FORMAT),
            *lights,
            resolve_pass(
                needs, partial(resolve, lights=last), "lights surfaces by what reaches all of them", (*reads, *last)
            ),
            *finish_image(needs, find_forward),
        )


def light_geometry(
    frame: Frame, *, effect: Effect, targets: Sequence[str], clears: bool, stencil: bool
) -> None:
    """Add the light of the point or spot lights in view to the light buffer."""
    shader = lit_variant(LightingShader, effect, list_readers(frame.needs))
    draw_volumes(frame, effect, shader, bind_geometry(frame), targets, clears=clears, is_masked=stencil)


def resolve(frame: Frame, *, lights: Sequence[str]) -> None:
    """Make the image: shade each pixel of the geometry buffer and add the light that was collected, if any was."""
    features, bindings = bind_shading(frame)
    if lights:
        (bindings["light"],) = (frame.targets[name] for name in lights)
    resolve_geometry(frame, WithLightBuffer if lights else GeometryResolve, features, bindings)


def resolve_geometry(
    frame: Frame, base: type[GeometryResolve], parts: Sequence[str], bindings: dict[str, Any]
) -> None:
    """Make the image with a shader and parts of it, and their bindings besides those of the geometry buffer."""
    readers = (*list_planes(frame.needs), *find_layout(frame.needs).parts)
    draw_resolve(frame, (*readers, base), parts, bindings | bind_geometry(frame), depth=frame.targets["depth"])
