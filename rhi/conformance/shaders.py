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


class Shaded(sl.Shader):
    """Half a shader: passes vertex positions and colors on to a fragment stage."""

    def vertex(self, v: Corner) -> Shade:
        return Shade(clip=v.position, color=v.color)


class Smooth(sl.Shader):
    """Half a shader: draws the interpolated color that a vertex stage gives."""

    def fragment(self, v: Shade) -> sl.vec4:
        return v.color


class Positions(sl.Shader):
    """Half a shader: passes vertex positions on."""

    def vertex(self, v: Corner) -> Bare:
        return Bare(clip=v.position)


class Colored(Shaded):
    """Passes vertex positions and colors through."""

    def fragment(self, v: Shade) -> sl.vec4:
        return v.color


class Checkered(Shaded):
    """Discards every other fragment."""

    def fragment(self, v: Shade) -> sl.vec4:
        at = sl.ivec2(sl.fragment_coordinate().xy)
        if (at.x + at.y) % 2 == 1:
            sl.discard()
        return v.color


class Loads(Shaded):
    """Loads texels by integer coordinates."""

    source: sl.Texture2D

    def fragment(self, v: Shade) -> sl.vec4:
        return self.source.load(sl.ivec2(sl.fragment_coordinate().xy))


class FlatShade(sl.Struct):
    """A position and a color of the whole primitive."""

    clip: sl.vec4
    color: sl.Flat[sl.vec4]


class Flat(sl.Shader):
    """Half a shader: draws each primitive in the color that a vertex stage gives."""

    def fragment(self, v: FlatShade) -> sl.vec4:
        return v.color


class FlatColored(Flat):
    """Draws each primitive in the color of its first vertex."""

    def vertex(self, v: Corner) -> FlatShade:
        return FlatShade(clip=v.position, color=v.color)


class Tint(sl.Struct):
    """A color."""

    color: sl.vec4


class Tinted(Flat):
    """Draws everything in one uniform color."""

    tint: sl.Uniform[Tint]

    def vertex(self, v: Corner) -> FlatShade:
        return FlatShade(clip=v.position, color=self.tint.color)


class Weighted(Flat):
    """A color from storage."""

    weights: sl.Storage[sl.vec4]

    def vertex(self, v: Corner) -> FlatShade:
        return FlatShade(clip=v.position, color=self.weights[0])


class UintColored(FlatColored):
    """Colors as unsigned integers, for integer targets."""

    def fragment(self, v: FlatShade) -> sl.uvec4:  # type: ignore[override]
        return sl.uvec4(v.color)


class IntColored(FlatColored):
    """Colors as signed integers, for integer targets."""

    def fragment(self, v: FlatShade) -> sl.ivec4:  # type: ignore[override]
        return sl.ivec4(v.color)


class DepthColor(sl.Struct):
    """A color, and a depth that the fragment stage writes."""

    color: sl.vec4
    depth: sl.FragmentDepth


class DepthFromColor(Shaded):
    """Writes the red channel as depth."""

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


class Painted(sl.Struct):
    """A vertex as interface renderers pack it: a place, and a color in four bytes."""

    position: sl.vec2
    color: sl.vec4


class PaintedShader(Smooth):
    """Draws vertices in their own colors."""

    def vertex(self, v: Painted) -> Shade:
        return Shade(clip=sl.vec4(v.position, 0.5, 1.0), color=v.color)


class PaintedTwo(sl.Struct):
    """A place, and a color of two components."""

    position: sl.vec2
    color: sl.vec2


class PaintedTwice(Smooth):
    """Draws vertices in their own two components."""

    def vertex(self, v: PaintedTwo) -> Shade:
        return Shade(clip=sl.vec4(v.position, 0.5, 1.0), color=sl.vec4(v.color, 0.0, 1.0))


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
