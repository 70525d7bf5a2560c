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
from functools import cache, partial
from typing import Any, Final

from renderer.frame import DEPTH_FORMAT, IMAGE_FORMAT, Effect, Frame, Needs, Pass, Target
from renderer.shaders.lighting import is_near, point_light, spot_light
from renderer.shaders.structs import SurfacePoint
from renderer.techniques.forward import bind_shading
from renderer.techniques.forward_shader import PARTS
from renderer.techniques.geometry_buffer import (
    CoverShader,
    GeometryReader,
    Screen,
    bind_geometry,
    cover_geometry,
    geometry_pass,
)
from renderer.techniques.light_volumes import (
    BRIGHTEST,
    PointVolumes,
    SpotVolumes,
    VolumeShader,
    VolumeVarying,
    declare_lights,
    draw_volumes,
)
from renderer.techniques.scene_shader import ShadingShader, WithSun
from rhi import Format
from rhi.shading import (
    Precision,
    Shader,
    Texture2D,
    fragment_coordinate,
    ivec2,
    min,
    uint_bits_to_float,
    vec3,
    vec4,
)


class PointLighting(PointVolumes, GeometryReader):
    """Lights the geometry buffer by point lights."""

    precision = Precision.FAST

    def fragment(self, v: VolumeVarying) -> vec4:
        place = ivec2(fragment_coordinate().xy)
        texel = self.surface.load(place)
        position = self.find_place(texel, place)
        light = self.point_lights[v.light]
        if not is_near(position, light.position, light.range):
            return vec4(0.0)
        row = self.material.load(place)
        surface = self.read_surface(self.materials[int(row.x)], row, texel, position)
        return vec4(point_light(surface, light), 0.0)


class SpotLighting(SpotVolumes, GeometryReader):
    """Lights the geometry buffer by spot lights."""

    precision = Precision.FAST

    def fragment(self, v: VolumeVarying) -> vec4:
        place = ivec2(fragment_coordinate().xy)
        texel = self.surface.load(place)
        position = self.find_place(texel, place)
        light = self.spot_lights[v.light]
        if not is_near(position, light.position, light.range):
            return vec4(0.0)
        row = self.material.load(place)
        surface = self.read_surface(self.materials[int(row.x)], row, texel, position)
        return vec4(spot_light(surface, light), 0.0)


class ResolveShader(CoverShader, GeometryReader, ShadingShader):
    """Makes the image from the geometry buffer."""

    def fragment(self) -> vec4:
        place = ivec2(fragment_coordinate().xy)
        texel = self.surface.load(place)
        row = self.material.load(place)
        position = self.find_place(texel, place)
        material = self.materials[int(row.x)]
        surface = self.read_surface(material, row, texel, position)
        color = self.shade(surface, material)
        color += self.local_light(surface, place, uint_bits_to_float(texel.y))
        return self.finish(color, position)

    def local_light(self, surface: SurfacePoint, pixel: ivec2, distance: float) -> vec3:
        return vec3(0.0)


class WithLightBuffer(ResolveShader):
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
        """Return the passes `geometry`, `point lights` and `spot lights` if there are any in view, and `resolve`."""
        reads = ("surface", "material", "depth")
        lights, last = declare_lights(needs, ["light"], reads, partial(light_geometry, stencil=self.stencil))
        return (
            geometry_pass(needs, Format.D32FS8 if self.stencil else DEPTH_FORMAT),
            *lights,
            Pass(
                "resolve",
                partial(resolve, lights=last),
                "lights surfaces by what reaches all of them",
                reads=(*reads, *last),
                writes=(Target("image", IMAGE_FORMAT),),
            ),
        )


@cache
def lighting_variant(effect: Effect, *, has_images: bool) -> type[VolumeShader]:
    """Return the shader that lights the geometry buffer by point or spot lights."""
    base = PointLighting if effect is Effect.POINT_LIGHTS else SpotLighting
    return type(base.__name__, (base,), {"__module__": __name__, "has_images": True}) if has_images else base


def light_geometry(
    frame: Frame, *, effect: Effect, targets: Sequence[str], clears: bool, stencil: bool
) -> None:
    """Add the light of the point or spot lights in view to the light buffer."""
    device = frame.device
    shader = lighting_variant(effect, has_images=Effect.IMAGES in frame.needs.effects)
    mask = PointVolumes if effect is Effect.POINT_LIGHTS else SpotVolumes
    draw_volumes(
        frame,
        effect,
        device.program(shader),
        bind_geometry(frame),
        targets,
        clears=clears,
        mask=device.program(mask) if stencil else None,
    )


@cache
def resolve_variant(
    parts: tuple[str, ...], bases: tuple[type[ResolveShader], ...], *, has_sun: bool, has_images: bool
) -> type[Shader]:
    """Return a shader of the last pass with these of `PARTS` and these bases, and only their bindings."""
    known = PARTS | {"directional_lights": WithSun} if has_sun else PARTS
    added = tuple(known[part] for part in parts)
    return type("Resolve", (*added, *bases), {"__module__": __name__, "has_images": has_images})


def resolve(frame: Frame, *, lights: Sequence[str]) -> None:
    """Make the image: shade each pixel of the geometry buffer and add the light that was collected, if any was."""
    features, bindings = bind_shading(frame)
    if lights:
        (bindings["light"],) = (frame.targets[name] for name in lights)
    draw_resolve(frame, WithLightBuffer if lights else ResolveShader, features, bindings)


def draw_resolve(
    frame: Frame, base: type[ResolveShader], parts: Sequence[str], bindings: dict[str, Any]
) -> None:
    """Make the image with a shader and parts of it, and their bindings besides those of the geometry buffer."""
    device, targets, needs = frame.device, frame.targets, frame.needs
    has_images = Effect.IMAGES in needs.effects
    shader = resolve_variant(tuple(parts), (base,), has_sun=needs.has_sun, has_images=has_images)
    with (
        device.render_pass(
            targets.image, targets["depth"], clear=(*frame.resources.scene.background, 1.0)
        ),
        device.states(*cover_geometry(frame)),
    ):
        program: Any = device.program(shader)
        triangle = frame.resources.workspace(Screen).triangle
        device.draw(program, triangle, **bindings, **bind_geometry(frame))
