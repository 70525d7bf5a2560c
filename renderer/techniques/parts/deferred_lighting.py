"""Lighting of a geometry buffer: by the volumes of lights, or by the lists of clusters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import rhi.shading as sl
from renderer.frame import DEPTH_FORMAT, Effect, Frame, Needs, Pass
from renderer.shaders.lighting import BRIGHTEST
from renderer.shaders.pixels import BackgroundScreen
from renderer.shaders.structs import SurfacePoint
from renderer.techniques.parts.cell_lists import CLUSTERS, CellReader, bind_lists, by_cells, list_pass
from renderer.techniques.parts.finish import finish_image
from renderer.techniques.parts.geometry_buffer import (
    EXACT_NORMAL,
    GeometryReader,
    find_contents,
    geometry_pass,
    list_contents,
)
from renderer.techniques.parts.light_volumes import VolumeShader, VolumeVarying, declare_lights, draw_volumes
from renderer.techniques.parts.resolve import resolve_pass
from renderer.techniques.parts.samples import GeometrySamples, SampleMean, bind_samples, frame_samples, list_samples
from renderer.techniques.parts.scene_shader import ShadingShader
from renderer.techniques.parts.variants import FORWARD, draw_full_screen, list_lamps
from rhi import Format


class LightingShader(VolumeShader, GeometryReader):
    """Lights the geometry buffer by the volumes of lights."""

    precision = sl.Precision.FAST

    def fragment(self, v: VolumeVarying) -> sl.vec4:
        place = sl.ivec2(sl.fragment_coordinate().xy)
        texel = self.load_surface(place, 0)
        position = self.find_place(texel, place)
        if not self.is_reached(position, v.light):
            return sl.vec4(0.0)
        row = self.load_material(place, 0)
        surface = self.read_surface(row, texel, place, 0, position)
        if self.has_spheres:
            size = self.find_size(position, v.light)
            sphere = self.reflect_sphere(surface, self.find_incidence(position, v.light), size)
            return sl.vec4(self.unblocked(sphere, position, surface.plane, v.light), 0.0)
        light = self.reflect_light(surface, self.find_incidence(position, v.light))
        return sl.vec4(self.unblocked(light, position, surface.plane, v.light), 0.0)


class GeometryResolve(BackgroundScreen, GeometryReader, ShadingShader):
    """Makes the image from the geometry buffer, and from the light of volumes if there is any."""

    has_light = False
    light: sl.Texture2D

    def fragment(self) -> sl.vec4:
        return self.light_sample(0)

    def light_sample(self, sample: int) -> sl.vec4:
        place = self.find_pixel()
        texel = self.load_surface(place, sample)
        row = self.load_material(place, sample)
        position = self.find_place(texel, place)
        material = self.materials[int(row.x)]
        surface = self.read_surface(row, texel, place, sample, position)
        color = self.shade(surface, material)
        color += self.local_light(surface, place, sl.uint_bits_to_float(texel.x))
        return self.finish(color, position)

    def local_light(self, surface: SurfacePoint, pixel: sl.ivec2, distance: float) -> sl.vec3:
        return sl.min(self.light.load(pixel).rgb, BRIGHTEST) if self.has_light else sl.vec3(0.0)


class LitByLists(CellReader, GeometryResolve):
    """Makes the image from the geometry buffer, lit by the lights of clusters."""

    def local_light(self, surface: SurfacePoint, pixel: sl.ivec2, distance: float) -> sl.vec3:
        return self.celllight(surface, distance)


def volume_passes(needs: Needs, *, stencil: bool, light_bits: int, normal_bits: int) -> tuple[Pass[Frame], ...]:
    """Return the passes that draw a geometry buffer, light it by volumes, and make the image.

    Args:
        stencil: whether each light is masked in a stencil buffer, which takes two draws for each.
        light_bits: the bits of a channel of the light that is added up. normal_bits: those of each number of a normal.
    """
    reads = list_contents(needs)
    lights, last = declare_lights(needs, ["light"], reads, partial(light_geometry, stencil=stencil), bits=light_bits)
    return (
        geometry_pass(needs, Format.D32FS8 if stencil else DEPTH_FORMAT, normal_bits=normal_bits),
        *lights,
        resolve_pass(
            needs, partial(resolve, lights=last), "lights surfaces by what reaches all of them", (*reads, *last)
        ),
        *finish_image(needs, FORWARD),
    )


def cluster_passes(needs: Needs, samples: int = 1, normal_bits: int = EXACT_NORMAL) -> tuple[Pass[Frame], ...]:
    """Return the passes that draw a geometry buffer of so many samples, and light it by the lists of clusters; without
    lights to list, by what reaches all surfaces."""
    reads, has_lamps = list_samples(samples, *list_contents(needs)), bool(list_lamps(needs))
    because = "lights surfaces by what reaches all of them"
    because += " and by their clusters' lights" if has_lamps else ""
    return frame_samples(
        needs,
        geometry_pass(needs, samples=samples, normal_bits=normal_bits),
        *([list_pass(needs, CLUSTERS)] if has_lamps else []),
        resolve_pass(
            needs,
            partial(light_clusters if has_lamps else resolve, samples=samples),
            because,
            (*reads, *(["light lists"] if has_lamps else [])),
        ),
        samples=samples,
        lighting=by_cells(CLUSTERS) if has_lamps else FORWARD,
    )


def light_geometry(frame: Frame, *, effect: Effect, targets: Sequence[str], clears: bool, stencil: bool) -> None:
    """Add the light of the point or spot lights in view to the light buffer."""
    switches = find_contents(frame)
    draw_volumes(frame, effect, LightingShader, targets, switches=switches, clears=clears, is_masked=stencil)


def resolve(frame: Frame, *, lights: Sequence[str] = (), samples: int = 1) -> None:
    """Make the image: shade each pixel of the geometry buffer and add the light that was collected, if any was.

    Args:
        lights: the name of the contents with the collected light, the last of its passes; empty without any.
    """
    own = {"light": frame.targets[lights[0]]} if lights else {}
    resolve_geometry(frame, GeometryResolve, own, samples=samples, has_light=bool(lights))


def resolve_geometry(
    frame: Frame, shader: type[GeometryResolve], own: Mapping[str, Any], *, samples: int = 1, **switches: bool
) -> None:
    """Make the image with a shader, bindings of its own, and its switches."""
    contents = find_contents(frame) | switches
    if samples == 1:
        depth, clear = frame.targets["depth"], frame.background
        draw_full_screen(frame, shader, frame.image, own, depth=depth, clear=clear, switches=contents)
    else:
        bases, given = (SampleMean, GeometrySamples, shader), {**own, **bind_samples(frame)}
        draw_full_screen(frame, bases, frame.image, given, switches={**contents, "samples": samples})


def light_clusters(frame: Frame, *, samples: int = 1) -> None:
    """Make the image: shade each pixel of the geometry buffer by the light of everything and of its cluster."""
    resolve_geometry(frame, LitByLists, bind_lists(frame, CLUSTERS), samples=samples)
