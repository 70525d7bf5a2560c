"""Lighting of a geometry buffer: by the volumes of lights, or by the lists of clusters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import rhi.shading as sl
from renderer.frame import DEPTH_FORMAT, Effect, Frame, FrameEffects, FramePass
from renderer.shaders.lighting import MAX_HALF_FLOAT
from renderer.shaders.pixels import BackgroundScreen
from renderer.shaders.structs import SurfacePoint
from renderer.techniques.parts.clustered_passes import clustered_passes
from renderer.techniques.parts.finish import finish_image
from renderer.techniques.parts.geometry_buffer import (
    DEFAULT_NORMAL_BITS,
    GeometryReader,
    geometry_buffer_names,
    geometry_buffer_switches,
    geometry_pass,
)
from renderer.techniques.parts.light_list_reader import (
    CLUSTERS,
    LightListReader,
    bind_light_lists,
    light_list_pass,
    lit_by_cells,
)
from renderer.techniques.parts.light_volumes import VolumeShader, VolumeVarying, declare_lights, draw_volumes
from renderer.techniques.parts.resolve import resolve_pass
from renderer.techniques.parts.samples import (
    GeometrySamples,
    SampleMean,
    bind_samples,
    frame_samples,
    list_samples,
)
from renderer.techniques.parts.scene_shader import AreaReflectingShader, ShadingShader
from renderer.techniques.parts.variants import FORWARD, draw_full_screen, local_light_effects
from rhi import Format


class LightingShader(VolumeShader, GeometryReader, AreaReflectingShader):
    """Lights the geometry buffer by light volumes."""

    precision = sl.Precision.FAST

    def fragment(self, v: VolumeVarying) -> sl.vec4:
        pixel = sl.ivec2(sl.fragment_coordinate().xy)
        texel = self.load_surface(pixel, 0)
        position = self.surface_position(texel, pixel)
        if not self.is_reached(position, v.light):
            return sl.vec4(0.0)
        material_texel = self.load_material(pixel, 0)
        surface = self.read_surface(material_texel, texel, pixel, 0, position)
        if self.has_areas:
            shape = self.source_shape(v.light)
            if shape.strength > 0.0:
                incidence = self.light_incidence(position, v.light)
                area = self.reflect_area(surface, incidence, self.offset_to_light(position, v.light), shape)
                return sl.vec4(self.apply_shadow(area, position, surface.geometric_normal, v.light), 0.0)
        if self.has_spheres:
            size = self.squared_angular_size(position, v.light)
            sphere = self.reflect_sphere(surface, self.light_incidence(position, v.light), size)
            return sl.vec4(self.apply_shadow(sphere, position, surface.geometric_normal, v.light), 0.0)
        light = self.reflect_light(surface, self.light_incidence(position, v.light))
        return sl.vec4(self.apply_shadow(light, position, surface.geometric_normal, v.light), 0.0)


class GeometryResolve(BackgroundScreen, GeometryReader, ShadingShader):
    """Makes the image from the geometry buffer and the light of volumes, if there is any."""

    has_light = False
    light: sl.Texture2D

    def fragment(self) -> sl.vec4:
        return self.shade_sample(0)

    def shade_sample(self, sample: int) -> sl.vec4:
        pixel = self.get_pixel()
        texel = self.load_surface(pixel, sample)
        material_texel = self.load_material(pixel, sample)
        position = self.surface_position(texel, pixel)
        material = self.materials[int(material_texel.x)]
        surface = self.read_surface(material_texel, texel, pixel, sample, position)
        color = self.shade(surface, material)
        color += self.local_light(surface, pixel, sl.uint_bits_to_float(texel.x))
        return self.finish(color, position)

    def local_light(self, surface: SurfacePoint, pixel: sl.ivec2, distance: float) -> sl.vec3:
        return sl.min(self.light.load(pixel).rgb, MAX_HALF_FLOAT) if self.has_light else sl.vec3(0.0)


class LitByLists(LightListReader, GeometryResolve):
    """Makes the image from the geometry buffer, lit by the light lists of clusters."""

    def local_light(self, surface: SurfacePoint, pixel: sl.ivec2, distance: float) -> sl.vec3:
        return self.shade_cell_lights(surface, distance)


def volume_passes(
    effects: FrameEffects, *, stencil: bool, light_bits: int, normal_bits: int
) -> tuple[FramePass[Frame], ...]:
    """The passes that draw a geometry buffer, light it by volumes, and make the image; with anisotropic materials,
    those of clustered forward shading.

    Args:
        stencil: whether each light is masked in a stencil buffer, which takes two draws for each.
        light_bits: the bits of a channel of the light that is added up.
        normal_bits: those of each number of a normal.
    """
    if effects.needs_forward:
        return clustered_passes(effects)
    reads = geometry_buffer_names(effects)
    lights, last = declare_lights(
        effects, ["light"], reads, partial(light_geometry, stencil=stencil), bits=light_bits
    )
    return (
        geometry_pass(effects, Format.D32FS8 if stencil else DEPTH_FORMAT, normal_bits=normal_bits),
        *lights,
        resolve_pass(
            effects,
            partial(resolve, lights=last),
            "lights surfaces by what reaches all of them",
            (*reads, *last, *effects.shading_reads),
        ),
        *finish_image(effects, FORWARD),
    )


def cluster_passes(
    effects: FrameEffects, samples: int = 1, normal_bits: int = DEFAULT_NORMAL_BITS
) -> tuple[FramePass[Frame], ...]:
    """The passes that draw a geometry buffer and light it by the light lists of clusters; without local
    lights, by ambient and directional light alone. With anisotropic materials, those of clustered forward shading."""
    if effects.needs_forward:
        return clustered_passes(effects, samples=samples)
    reads, has_local_lights = (
        list_samples(samples, *geometry_buffer_names(effects)),
        bool(local_light_effects(effects)),
    )
    reason = "lights surfaces by what reaches all of them"
    reason += " and by their clusters' lights" if has_local_lights else ""
    return frame_samples(
        effects,
        geometry_pass(effects, samples=samples, normal_bits=normal_bits),
        *([light_list_pass(effects, CLUSTERS)] if has_local_lights else []),
        resolve_pass(
            effects,
            partial(light_clusters if has_local_lights else resolve, samples=samples),
            reason,
            (*reads, *(["light lists"] if has_local_lights else []), *effects.shading_reads),
        ),
        samples=samples,
        lighting=lit_by_cells(CLUSTERS) if has_local_lights else FORWARD,
    )


def light_geometry(
    frame: Frame, *, effect: Effect, targets: Sequence[str], clears: bool, stencil: bool
) -> None:
    """Add the light of one kind of local lights in view to the light buffer."""
    switches = geometry_buffer_switches(frame)
    draw_volumes(frame, effect, LightingShader, targets, switches=switches, clears=clears, is_masked=stencil)


def resolve(frame: Frame, *, lights: Sequence[str] = (), samples: int = 1) -> None:
    """Make the image: shade each pixel of the geometry buffer, and add the accumulated light, if any.

    Args:
        lights: the name of the resource with the accumulated light, the last of its passes; empty without
            any.
    """
    shader_bindings = {"light": frame.targets[lights[0]]} if lights else {}
    resolve_geometry(frame, GeometryResolve, shader_bindings, samples=samples, has_light=bool(lights))


def resolve_geometry(
    frame: Frame,
    shader: type[GeometryResolve],
    shader_bindings: Mapping[str, Any],
    *,
    samples: int = 1,
    **switches: bool,
) -> None:
    """Make the image with a shader, its own bindings, and its switches."""
    all_switches = geometry_buffer_switches(frame) | switches
    if samples == 1:
        depth, clear = frame.targets["depth"], frame.background
        draw_full_screen(
            frame, shader, frame.image, shader_bindings, depth=depth, clear=clear, switches=all_switches
        )
    else:
        bases, sample_bindings = (
            (SampleMean, GeometrySamples, shader),
            {**shader_bindings, **bind_samples(frame)},
        )
        draw_full_screen(
            frame, bases, frame.image, sample_bindings, switches={**all_switches, "samples": samples}
        )


def light_clusters(frame: Frame, *, samples: int = 1) -> None:
    """Make the image: shade each pixel of the geometry buffer by ambient and directional light and its
    cluster's lights."""
    resolve_geometry(frame, LitByLists, bind_light_lists(frame, CLUSTERS), samples=samples)
