"""Shaders that many tests share."""

from __future__ import annotations

import rhi.shading as sl


class Corner(sl.Struct):
    """A vertex in clip space, with a color."""

    position: sl.vec4
    color: sl.vec4


class Bare(sl.Struct):
    """A position alone."""

    clip: sl.vec4


class Shade(sl.Struct):
    """A position and a color that is interpolated."""

    clip: sl.vec4
    color: sl.vec4


class Colored(sl.Shader):
    """Passes vertex positions and colors through."""

    def vertex(self, v: Corner) -> Shade:
        return Shade(clip=v.position, color=v.color)

    def fragment(self, v: Shade) -> sl.vec4:
        return v.color


class Checkered(sl.Shader):
    """Discards every other fragment."""

    def vertex(self, v: Corner) -> Shade:
        return Shade(clip=v.position, color=v.color)

    def fragment(self, v: Shade) -> sl.vec4:
        at = sl.ivec2(sl.fragment_coordinate().xy)
        if (at.x + at.y) % 2 == 1:
            sl.discard()
        return v.color


class Loads(sl.Shader):
    """Loads texels by integer coordinates."""

    source: sl.Texture2D

    def vertex(self, v: Corner) -> Shade:
        return Shade(clip=v.position, color=v.color)

    def fragment(self, v: Shade) -> sl.vec4:
        return self.source.load(sl.ivec2(sl.fragment_coordinate().xy))


class FlatShade(sl.Struct):
    """A position and a color of the whole primitive."""

    clip: sl.vec4
    color: sl.Flat[sl.vec4]


class FlatColored(sl.Shader):
    """Draws each primitive in the color of its first vertex."""

    def vertex(self, v: Corner) -> FlatShade:
        return FlatShade(clip=v.position, color=v.color)

    def fragment(self, v: FlatShade) -> sl.vec4:
        return v.color


class Tint(sl.Struct):
    """A color."""

    color: sl.vec4


class Tinted(sl.Shader):
    """Draws everything in one uniform color."""

    tint: sl.Uniform[Tint]

    def vertex(self, v: Corner) -> FlatShade:
        return FlatShade(clip=v.position, color=self.tint.color)

    def fragment(self, v: FlatShade) -> sl.vec4:
        return v.color


class Weighted(sl.Shader):
    """A color from storage."""

    weights: sl.Storage[sl.vec4]

    def vertex(self, v: Corner) -> FlatShade:
        return FlatShade(clip=v.position, color=self.weights[0])

    def fragment(self, v: FlatShade) -> sl.vec4:
        return v.color


class UintColored(sl.Shader):
    """Colors as unsigned integers, for integer targets."""

    def vertex(self, v: Corner) -> FlatShade:
        return FlatShade(clip=v.position, color=v.color)

    def fragment(self, v: FlatShade) -> sl.uvec4:
        return sl.uvec4(v.color)


class IntColored(sl.Shader):
    """Colors as signed integers, for integer targets."""

    def vertex(self, v: Corner) -> FlatShade:
        return FlatShade(clip=v.position, color=v.color)

    def fragment(self, v: FlatShade) -> sl.ivec4:
        return sl.ivec4(v.color)


class DepthColor(sl.Struct):
    """A color, and a depth that the fragment stage writes."""

    color: sl.vec4
    depth: sl.FragmentDepth


class DepthFromColor(sl.Shader):
    """Writes the red channel as depth."""

    def vertex(self, v: Corner) -> Shade:
        return Shade(clip=v.position, color=v.color)

    def fragment(self, v: Shade) -> DepthColor:
        return DepthColor(color=v.color, depth=v.color.x)


class TexturedVarying(sl.Struct):
    """A position and texture coordinates."""

    clip: sl.vec4
    uv: sl.vec2


class TexturedVertex(sl.Struct):
    """A vertex in clip space, with texture coordinates."""

    position: sl.vec4
    uv: sl.vec2


class Dot(sl.Struct):
    """A vertex in clip space, with a color and a size."""

    position: sl.vec4
    color: sl.vec4
    size: float


class SizedShade(sl.Struct):
    """A position, a color and a size."""

    clip: sl.vec4
    color: sl.vec4
    size: sl.PointSize


class Sized(sl.Shader):
    """Draws points in their color."""

    def vertex(self, v: Dot) -> SizedShade:
        return SizedShade(clip=v.position, color=v.color, size=v.size)

    def fragment(self, v: SizedShade) -> sl.vec4:
        return v.color


class Located(Sized):
    """Writes the place inside the point."""

    def fragment(self, v: SizedShade) -> sl.vec4:
        return sl.vec4(sl.point_coordinate(), v.color.x, 1.0)


class Count(sl.Shader):
    """Counts its invocations."""

    total: sl.StorageRW[sl.uint]

    def compute(self) -> None:
        sl.atomic_add(self.total[0], sl.uint(1))
