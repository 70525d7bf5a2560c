"""Scaling: a finished image is brought to the size that is shown, by bilinear samples in linear light.

A smaller image is drawn in less time, as pixels cost the most, and loses what is finer than its pixels. One
twice as large has four samples for each pixel that is shown, of which a bilinear sample is the mean.
"""

from __future__ import annotations

import rhi.shading as sl
from renderer.frame import Frame
from renderer.shaders.pixels import BackgroundScreen
from renderer.techniques.parts.variants import draw_full_screen
from rhi import Texture


class OutputSize(sl.Struct):
    """Size of the output image in pixels."""

    size: sl.vec2


class ScalingShader(BackgroundScreen):
    """Scales an image with bilinear samples."""

    precision = sl.Precision.FAST
    source: sl.Texture2D
    output_size: sl.Uniform[OutputSize]

    def fragment(self) -> sl.vec4:
        return self.source.sample_lod(sl.fragment_coordinate().xy / self.output_size.size, 0.0)


def scale_image(frame: Frame, output_image: Texture) -> None:
    """Draw the frame's image to the output image, which has another size."""
    output_size = frame.view.mirror(OutputSize(size=output_image.size))
    bindings = {"source": frame.targets["image"], "output_size": output_size}
    draw_full_screen(frame, ScalingShader, output_image, bindings)
