"""The shaders that tests of refusals share."""

from __future__ import annotations

import rhi.shading as sl
from rhi import Format
from rhi.conformance.shaders import Positions, Tint


class Shift(sl.Struct):
    """Another struct of the same size."""

    by: sl.vec4


class Everything(Positions):
    """A binding of each kind."""

    tint: sl.Uniform[Tint]
    weights: sl.Storage[float]
    albedo: sl.Texture2D
    shadow: sl.DepthTexture2D
    target: sl.Image2D = sl.image(Format.RGBA8)

    def fragment(self) -> sl.vec4:
        self.target.store(sl.ivec2(0, 0), sl.vec4(self.weights[0]))
        lit = self.shadow.sample_compare(sl.vec2(0.5, 0.5), 0.5)
        return self.tint.color * self.albedo.sample(sl.vec2(0.5, 0.5)) * lit


class Passing(Positions):
    """A program of its own, to be destroyed."""

    def fragment(self) -> sl.vec4:
        return sl.vec4(1.0)
