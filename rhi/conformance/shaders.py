"""Shaders that many tests share."""

from __future__ import annotations

from rhi.shading import (
    Flat,
    FragmentDepth,
    PointSize,
    Shader,
    Storage,
    StorageRW,
    Struct,
    Texture2D,
    Uniform,
    atomic_add,
    discard,
    fragment_coordinate,
    ivec2,
    ivec4,
    point_coordinate,
    uint,
    uvec4,
    vec2,
    vec4,
)


class Corner(Struct):
    """A vertex in clip space, with a color."""

    position: vec4
    color: vec4


class Bare(Struct):
    """A position alone."""

    clip: vec4


class Shade(Struct):
    """A position and a color that is interpolated."""

    clip: vec4
    color: vec4


class Colored(Shader):
    """Passes vertex positions and colors through."""

    def vertex(self, v: Corner) -> Shade:
        return Shade(clip=v.position, color=v.color)

    def fragment(self, v: Shade) -> vec4:
        return v.color


class Checkered(Shader):
    """Discards every other fragment."""

    def vertex(self, v: Corner) -> Shade:
        return Shade(clip=v.position, color=v.color)

    def fragment(self, v: Shade) -> vec4:
        at = ivec2(fragment_coordinate().xy)
        if (at.x + at.y) % 2 == 1:
            discard()
        return v.color


class Loads(Shader):
    """Loads texels by integer coordinates."""

    source: Texture2D

    def vertex(self, v: Corner) -> Shade:
        return Shade(clip=v.position, color=v.color)

    def fragment(self, v: Shade) -> vec4:
        return self.source.load(ivec2(fragment_coordinate().xy))


class FlatShade(Struct):
    """A position and a color of the whole primitive."""

    clip: vec4
    color: Flat[vec4]


class FlatColored(Shader):
    """Draws each primitive in the color of its first vertex."""

    def vertex(self, v: Corner) -> FlatShade:
        return FlatShade(clip=v.position, color=v.color)

    def fragment(self, v: FlatShade) -> vec4:
        return v.color


class Tint(Struct):
    """A color."""

    color: vec4


class Tinted(Shader):
    """Draws everything in one uniform color."""

    tint: Uniform[Tint]

    def vertex(self, v: Corner) -> FlatShade:
        return FlatShade(clip=v.position, color=self.tint.color)

    def fragment(self, v: FlatShade) -> vec4:
        return v.color


class Weighted(Shader):
    """A color from storage."""

    weights: Storage[vec4]

    def vertex(self, v: Corner) -> FlatShade:
        return FlatShade(clip=v.position, color=self.weights[0])

    def fragment(self, v: FlatShade) -> vec4:
        return v.color


class UintColored(Shader):
    """Colors as unsigned integers, for integer targets."""

    def vertex(self, v: Corner) -> FlatShade:
        return FlatShade(clip=v.position, color=v.color)

    def fragment(self, v: FlatShade) -> uvec4:
        return uvec4(v.color)


class IntColored(Shader):
    """Colors as signed integers, for integer targets."""

    def vertex(self, v: Corner) -> FlatShade:
        return FlatShade(clip=v.position, color=v.color)

    def fragment(self, v: FlatShade) -> ivec4:
        return ivec4(v.color)


class DepthColor(Struct):
    """A color, and a depth that the fragment stage writes."""

    color: vec4
    depth: FragmentDepth


class DepthFromColor(Shader):
    """Writes the red channel as depth."""

    def vertex(self, v: Corner) -> Shade:
        return Shade(clip=v.position, color=v.color)

    def fragment(self, v: Shade) -> DepthColor:
        return DepthColor(color=v.color, depth=v.color.x)


class TexturedVarying(Struct):
    """A position and texture coordinates."""

    clip: vec4
    uv: vec2


class TexturedVertex(Struct):
    """A vertex in clip space, with texture coordinates."""

    position: vec4
    uv: vec2


class Dot(Struct):
    """A vertex in clip space, with a color and a size."""

    position: vec4
    color: vec4
    size: float


class SizedShade(Struct):
    """A position, a color and a size."""

    clip: vec4
    color: vec4
    size: PointSize


class Sized(Shader):
    """Draws points in their color."""

    def vertex(self, v: Dot) -> SizedShade:
        return SizedShade(clip=v.position, color=v.color, size=v.size)

    def fragment(self, v: SizedShade) -> vec4:
        return v.color


class Located(Sized):
    """Writes the place inside the point."""

    def fragment(self, v: SizedShade) -> vec4:
        return vec4(point_coordinate(), v.color.x, 1.0)


class Count(Shader):
    """Counts its invocations."""

    total: StorageRW[uint]

    def compute(self) -> None:
        atomic_add(self.total[0], uint(1))
