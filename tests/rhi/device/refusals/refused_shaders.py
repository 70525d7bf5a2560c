"""The shaders that tests of refusals share."""

from __future__ import annotations

from rhi import (
    Format,
)
from rhi.conformance.shaders import Bare, Corner, Tint
from rhi.shading import (
    DepthTexture2D,
    Image2D,
    Shader,
    Storage,
    Struct,
    Texture2D,
    Uniform,
    image,
    ivec2,
    vec2,
    vec4,
)


class Shift(Struct):
    """Another struct of the same size."""

    by: vec4


class Everything(Shader):
    """A binding of each kind."""

    tint: Uniform[Tint]
    weights: Storage[float]
    albedo: Texture2D
    shadow: DepthTexture2D
    target: Image2D = image(Format.RGBA8)

    def vertex(self, v: Corner) -> Bare:
        return Bare(clip=v.position)

    def fragment(self) -> vec4:
        self.target.store(ivec2(0, 0), vec4(self.weights[0]))
        lit = self.shadow.sample_compare(vec2(0.5, 0.5), 0.5)
        return self.tint.color * self.albedo.sample(vec2(0.5, 0.5)) * lit


class Passing(Shader):
    """A program of its own, to be destroyed."""

    def vertex(self, v: Corner) -> Bare:
        return Bare(clip=v.position)

    def fragment(self) -> vec4:
        return vec4(1.0)
