"""Geometry buffers of several samples per pixel: edges are smooth, as forward shading with as many samples draws them.

A triangle has the same texels in all samples of a pixel that it covers. So a pixel inside a triangle is shaded once;
only where the texels of a sample are not those of the one before is that sample shaded, too (Lauritzen 2010; Thatcher
2014, 5.1.1). A pixel is the mean of its samples' colours, after their tones are mapped, as a resolve would give it.
A sample without a surface has the light of the background.

- Depth of one sample is drawn before: layers, culling and transparent surfaces test it. So transparent surfaces, drawn
  over the mean, have one sample.
- Surfaces are shaded at the pixel's centre, also where it is beyond their edge. Depth is that of each sample's own
  place, so distances are stored beside it.
"""

from __future__ import annotations

from typing import Any

import rhi.shading as sl
from renderer.frame import Effect, Frame, Needs, Pass
from renderer.frame.tones import find_light
from renderer.shaders.fog import FogConstants, through_all_fog
from renderer.shaders.lighting import BRIGHTEST, tone_map
from renderer.shaders.pixels import PixelRays, PixelShader, place_pixel
from renderer.techniques.parts.depth import depth_pass
from renderer.techniques.parts.finish import Background, finish_image
from renderer.techniques.parts.geometry_buffer import GeometryReader
from renderer.techniques.parts.packed_geometry import PackedReader
from renderer.techniques.parts.variants import FORWARD, Lighting, name_samples


class SampleReader(PixelShader):
    """The base of shaders that read what each sample of a pixel holds, and make the pixel their mean."""

    samples = 2
    has_fog = False
    has_glow = False

    fog: sl.Uniform[FogConstants]
    rays: sl.Uniform[PixelRays]
    backdrop: sl.Uniform[Background]
    depth_samples: sl.Texture2DSamples

    def mix_samples(self) -> sl.vec4:
        """Return the mean colour of the samples."""
        total = sl.vec4(0.0)
        color = sl.vec4(0.0)
        for sample in range(self.samples):
            if self.is_new(sample):
                color = self.light_sample(sample) if self.is_covered(sample) else self.find_backdrop()
            total += color
        return total / float(self.samples)

    def is_covered(self, sample: int) -> bool:
        """Return whether a sample has a surface; else its other texels are those of an earlier frame."""
        return self.depth_samples.load(self.find_pixel(), sample).x != self.rays.farthest

    def is_new(self, sample: int) -> bool:
        """Return whether a sample shows something else than the one before."""
        if sample == 0:
            return True
        covered = self.is_covered(sample)
        return covered != self.is_covered(sample - 1) or (covered and not self.is_same(sample, sample - 1))

    def is_same(self, one: int, other: int) -> bool:
        """Return whether two samples that have surfaces have the same texels."""
        return True

    def find_backdrop(self) -> sl.vec4:
        """Return the colour of a sample without a surface."""
        seen = self.backdrop.light
        if self.has_fog:
            place = sl.vec2(self.find_pixel()) + 0.5
            direction = place_pixel(self.rays, place, 1.0) - place_pixel(self.rays, place, 0.0)
            seen = through_all_fog(seen, direction, self.fog)
            seen = sl.min(seen, BRIGHTEST) if self.has_glow else tone_map(seen)
        return sl.vec4(seen, 1.0)


class SampleMean(SampleReader):
    """The first base of shaders that make the image of what other bases read and light."""

    def fragment(self) -> sl.vec4:
        return self.mix_samples()


class GeometrySamples(SampleReader, GeometryReader):
    """Reads a geometry buffer of several samples."""

    surface_samples: sl.UintTexture2DSamples
    material_samples: sl.UintTexture2DSamples
    details_samples: sl.UintTexture2DSamples

    def load_surface(self, place: sl.ivec2, sample: int) -> sl.uvec4:
        return self.surface_samples.load(place, sample)

    def load_material(self, place: sl.ivec2, sample: int) -> sl.uvec4:
        return self.separate(self.material_samples.load(place, sample))

    def load_details(self, place: sl.ivec2, sample: int) -> sl.uvec4:
        return self.details_samples.load(place, sample)

    def is_same(self, one: int, other: int) -> bool:
        place = self.find_pixel()
        same = self.load_surface(place, one) == self.load_surface(place, other)
        return same and self.load_material(place, one) == self.load_material(place, other)


class PackedSamples(SampleReader, PackedReader):
    """Reads a packed geometry buffer of several samples."""

    packed_samples: sl.UintTexture2DSamples
    distances_samples: sl.Texture2DSamples
    vertex_colors_samples: sl.UintTexture2DSamples

    def load_words(self, sample: int) -> sl.uvec4:
        return self.packed_samples.load(self.find_pixel(), sample)

    def load_vertex_color(self, sample: int) -> sl.uint:
        return self.vertex_colors_samples.load(self.find_pixel(), sample).x

    def find_distance(self, sample: int) -> float:
        return self.distances_samples.load(self.find_pixel(), sample).x

    def is_same(self, one: int, other: int) -> bool:
        return self.load_words(one) == self.load_words(other) and self.find_distance(one) == self.find_distance(other)


def bind_samples(frame: Frame) -> dict[str, Any]:
    """Return what a `SampleReader` binds besides what a frame has by name."""
    has_fog, color = Effect.FOG in frame.needs.effects, frame.background[:3]
    light = find_light(frame.resources.scene.background) if has_fog else color
    return {"backdrop": frame.resources.mirror(Background(light=light))}


def list_samples(samples: int, *contents: str) -> tuple[str, ...]:
    """Return the names of contents with so many samples per pixel."""
    return tuple(name_samples(name, samples) for name in contents)


def frame_samples(
    needs: Needs, *passes: Pass[Frame], samples: int, lighting: Lighting = FORWARD
) -> tuple[Pass[Frame], ...]:
    """Return the passes of a technique around those that make the opaque surfaces' image: with several samples, depth
    of one comes before, and the image has the background's fog already."""
    if samples == 1:
        return *passes, *finish_image(needs, lighting)
    before = depth_pass("layers and culling need depth of one sample")
    return before, *passes, *finish_image(needs, lighting, has_sky=True)
