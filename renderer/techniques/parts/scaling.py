"""Scaling: a finished image is brought to the size that is shown, by bilinear samples in linear light.

A smaller image is drawn in less time, as pixels cost the most, and loses what is finer than its pixels. One twice as
large has four samples for each pixel that is shown, of which a bilinear sample is the mean.
"""

from __future__ import annotations

import rhi.shading as sl
from renderer.frame import Frame
from renderer.shaders.pixels import BackgroundScreen
from renderer.techniques.parts.variants import draw_full_screen


class ShownSize(sl.Struct):
    """The size of an image that is shown, in pixels."""

    size: sl.vec2


class Scaled(BackgroundScreen):
    """Shows an image at another size."""

    precision = sl.Precision.FAST
    source: sl.Texture2D
    shown: sl.Uniform[ShownSize]

    def fragment(self) -> sl.vec4:
        return self.source.sample_lod(sl.fragment_coordinate().xy / self.shown.size, 0.0)


def scale_image(frame: Frame) -> None:
    """Draw the frame's image to the picture that is shown, if that has another size."""
    targets = frame.targets
    if targets.picture is not None:
        shown = frame.view.mirror(ShownSize(size=targets.picture.size))
        draw_full_screen(frame, Scaled, targets.picture, {"source": targets["image"], "shown": shown})
