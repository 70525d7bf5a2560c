"""Geometry buffers of several samples per pixel: edges are smooth, as forward shading with as many samples
draws them.

A triangle has the same texels in all samples of a pixel that it covers. So a pixel inside a triangle is
shaded once; only where the texels of a sample are not those of the one before is that sample shaded, too
(Lauritzen 2010; Thatcher 2014, 5.1.1). A pixel is the mean of its samples' colours, after their tones are
mapped, as a resolve would give it. A sample without a surface has the light of the background.

- Depth of one sample is drawn before: layers, culling and transparent surfaces test it. So transparent
  surfaces, drawn over the mean, have one sample.
- Surfaces are shaded at the pixel's centre, also where it is beyond their edge. Depth is that of each
  sample's own place, so distances are stored beside it.
"""

from __future__ import annotations

from typing import Any

import rhi.shading as sl
from renderer.frame import Effect, Frame, FrameEffects, FramePass
from renderer.shaders.environment import EnvironmentSky
from renderer.shaders.fog import FogReader, apply_fog_to_background
from renderer.shaders.lighting import MAX_HALF_FLOAT
from renderer.shaders.pixels import PixelShader, pixel_position
from renderer.shaders.tone_mapping import inverse_tone_map, tone_map
from renderer.techniques.parts.depth import depth_pass
from renderer.techniques.parts.finish import Background, finish_image
from renderer.techniques.parts.geometry_buffer import GeometryReader
from renderer.techniques.parts.packed_geometry import PackedReader
from renderer.techniques.parts.variants import FORWARD, Lighting, name_samples


class SampleReader(PixelShader, FogReader, EnvironmentSky):
    """Base of shaders that read each sample of a pixel, and average their colours."""

    samples = 2
    keeps_light = False

    background: sl.Uniform[Background]
    depth_samples: sl.Texture2DSamples

    def mix_samples(self) -> sl.vec4:
        """Mean colour of the samples."""
        total = sl.vec4(0.0)
        color = sl.vec4(0.0)
        for sample in range(self.samples):
            if self.is_new(sample):
                color = self.shade_sample(sample) if self.is_covered(sample) else self.background_color()
            total += color
        return total / float(self.samples)

    def is_covered(self, sample: int) -> bool:
        """True if a sample has a surface; otherwise its texels are left from an earlier frame."""
        return self.depth_samples.load(self.get_pixel(), sample).x != self.rays.farthest

    def is_new(self, sample: int) -> bool:
        """True if a sample differs from the sample before it."""
        if sample == 0:
            return True
        covered = self.is_covered(sample)
        return covered != self.is_covered(sample - 1) or (covered and not self.is_same(sample, sample - 1))

    def is_same(self, first: int, second: int) -> bool:
        """True if two covered samples have the same texels."""
        return True

    def background_color(self) -> sl.vec4:
        """Colour of a sample without a surface."""
        seen = self.background.light
        if self.has_sky_box:
            seen = self.sky_at(self.rays, sl.vec2(self.get_pixel()) + 0.5)
        if self.has_fog:
            pixel = sl.vec2(self.get_pixel()) + 0.5
            start = pixel_position(self.rays, pixel, 0.0)
            direction = pixel_position(self.rays, pixel, 1.0) - start
            seen = apply_fog_to_background(seen, direction, self.fog_at(start))
        if self.has_fog or self.has_sky_box:
            seen = sl.min(seen, MAX_HALF_FLOAT) if self.keeps_light else tone_map(seen)
        return sl.vec4(seen, 1.0)


class SampleMean(SampleReader):
    """First base of shaders that average the samples that their other bases read and light."""

    def fragment(self) -> sl.vec4:
        return self.mix_samples()


class GeometrySamples(SampleReader, GeometryReader):
    """Reads a geometry buffer of several samples."""

    surface_samples: sl.UintTexture2DSamples
    material_samples: sl.UintTexture2DSamples
    details_samples: sl.UintTexture2DSamples

    def load_surface(self, pixel: sl.ivec2, sample: int) -> sl.uvec4:
        return self.surface_samples.load(pixel, sample)

    def load_material(self, pixel: sl.ivec2, sample: int) -> sl.uvec4:
        return self.split_material_texel(self.material_samples.load(pixel, sample))

    def load_details(self, pixel: sl.ivec2, sample: int) -> sl.uvec4:
        return self.details_samples.load(pixel, sample)

    def is_same(self, first: int, second: int) -> bool:
        pixel = self.get_pixel()
        same = self.load_surface(pixel, first) == self.load_surface(pixel, second)
        return same and self.load_material(pixel, first) == self.load_material(pixel, second)


class PackedSamples(SampleReader, PackedReader):
    """Reads a packed geometry buffer of several samples."""

    packed_samples: sl.UintTexture2DSamples
    distances_samples: sl.Texture2DSamples
    vertex_colors_samples: sl.UintTexture2DSamples

    def load_words(self, sample: int) -> sl.uvec4:
        return self.packed_samples.load(self.get_pixel(), sample)

    def load_vertex_color(self, sample: int) -> sl.uint:
        return self.vertex_colors_samples.load(self.get_pixel(), sample).x

    def surface_distance(self, sample: int) -> float:
        return self.distances_samples.load(self.get_pixel(), sample).x

    def is_same(self, first: int, second: int) -> bool:
        return self.load_words(first) == self.load_words(second) and (
            self.surface_distance(first) == self.surface_distance(second)
        )


def bind_samples(frame: Frame) -> dict[str, Any]:
    """Bindings of a `SampleReader` that `FrameBindings` doesn't have."""
    has_fog, color = Effect.FOG in frame.effects.enabled, frame.background[:3]
    light = inverse_tone_map(frame.resources.scene.background) if has_fog else color
    return {"background": frame.resources.mirror(Background(light=light))}


def list_samples(samples: int, *resources: str) -> tuple[str, ...]:
    """Names of resources with this number of samples per pixel."""
    return tuple(name_samples(name, samples) for name in resources)


def frame_samples(
    effects: FrameEffects, *passes: FramePass[Frame], samples: int, lighting: Lighting = FORWARD
) -> tuple[FramePass[Frame], ...]:
    """The passes of a technique around those that draw opaque surfaces. With several samples, depth of one
    sample comes first, and the image already has the background's fog."""
    if samples == 1:
        return *passes, *finish_image(effects, lighting)
    before = depth_pass("layers and culling need depth of one sample", has_meshlets=False)
    return before, *passes, *finish_image(effects, lighting, has_sky=True)
