"""The shaders of random programs, one for each `ShaderKind`.

Their vertex stage is the same: it moves each instance by a step in the window. So few kernels are built, and
the interpreter has one rule for positions.
"""

from __future__ import annotations

from typing import Final

import rhi.shading as sl
from rhi.conformance.programs.model import ShaderKind
from rhi.conformance.shaders import Corner, Flat, FlatShade, Shade, Smooth


class Move(sl.Struct):
    """The distance by which each instance is moved in clip space; the level and layer to load from."""

    step: sl.vec2
    level: int
    layer: int


class FlatShader(Flat):
    """The color of the first corner."""

    move: sl.Uniform[Move]

    def vertex(self, v: Corner) -> FlatShade:
        step = sl.vec4(self.move.step, 0.0, 0.0) * (float(sl.instance_index()) * v.position.w)
        return FlatShade(clip=v.position + step, color=v.color)


class SmoothShader(Smooth):
    """The interpolated color."""

    move: sl.Uniform[Move]

    def vertex(self, v: Corner) -> Shade:
        step = sl.vec4(self.move.step, 0.0, 0.0) * (float(sl.instance_index()) * v.position.w)
        return Shade(clip=v.position + step, color=v.color)


class Pair(sl.Struct):
    """Two colors."""

    first: sl.vec4
    second: sl.vec4


class TwoTargetsShader(FlatShader):
    """The color, and reversed to a second target."""

    def fragment(self, v: FlatShade) -> Pair:  # type: ignore[override]
        return Pair(first=v.color, second=v.color.wzyx)


class UintShader(FlatShader):
    """The color as unsigned integers."""

    def fragment(self, v: FlatShade) -> sl.uvec4:  # type: ignore[override]
        return sl.uvec4(v.color)


class IntShader(FlatShader):
    """The color as signed integers."""

    def fragment(self, v: FlatShade) -> sl.ivec4:  # type: ignore[override]
        return sl.ivec4(v.color)


class DiscardShader(FlatShader):
    """Discards every other texel."""

    def fragment(self, v: FlatShade) -> sl.vec4:
        subresource = sl.ivec2(sl.fragment_coordinate().xy)
        if (subresource.x + subresource.y) % 2 == 0:
            sl.discard()
        return v.color


class DiscardEarlyShader(DiscardShader):
    """Discards every other texel after their depth was written."""

    early_depth = True


class ColorAndDepth(sl.Struct):
    """A color and a depth."""

    color: sl.vec4
    depth: sl.FragmentDepth


class WrittenDepthShader(FlatShader):
    """The alpha of the color is the depth."""

    def fragment(self, v: FlatShade) -> ColorAndDepth:  # type: ignore[override]
        return ColorAndDepth(color=v.color, depth=v.color.w)


class CountShader(FlatShader):
    """Counts fragments, and keeps the largest red of each column."""

    counts: sl.StorageRW[sl.uint]
    reds: sl.StorageRW[sl.uint]

    def fragment(self, v: FlatShade) -> sl.vec4:
        column = int(sl.fragment_coordinate().x) % 64
        sl.atomic_add(self.counts[column], sl.uint(1))
        sl.atomic_max(self.reds[column], sl.uint(max(v.color.x, 0.0) * 16.0))
        return v.color


class CountEarlyShader(CountShader):
    """Counts the fragments that pass the tests."""

    early_depth = True


class LoadShader(FlatShader):
    """Adds the texel of an image."""

    source: sl.Texture2D

    def fragment(self, v: FlatShade) -> sl.vec4:
        return v.color + self.source.load(sl.ivec2(sl.fragment_coordinate().xy), self.move.level)


class LoadLayerShader(FlatShader):
    """Adds the texel of a layer of an array."""

    source: sl.Texture2DArray

    def fragment(self, v: FlatShade) -> sl.vec4:
        subresource = sl.ivec2(sl.fragment_coordinate().xy)
        return v.color + self.source.load(sl.ivec3(subresource, self.move.layer), self.move.level)


class AddTexels(sl.Shader):
    """Adds the first channel of each texel to the cell of its column."""

    work_group = (8, 8)
    source: sl.Texture2D
    counts: sl.StorageRW[sl.uint]

    def compute(self) -> None:
        subresource = sl.ivec2(sl.global_id().xy)
        size = self.source.size()
        if subresource.x < size.x and subresource.y < size.y:
            value = sl.clamp(self.source.load(subresource).x, 0.0, 4.0)
            sl.atomic_add(self.counts[subresource.x % 64], sl.uint(value * 8.0))


SHADERS: Final[dict[ShaderKind, type[sl.Shader]]] = {
    ShaderKind.FLAT: FlatShader,
    ShaderKind.SMOOTH: SmoothShader,
    ShaderKind.TWO_TARGETS: TwoTargetsShader,
    ShaderKind.UINT: UintShader,
    ShaderKind.INT: IntShader,
    ShaderKind.DISCARD: DiscardShader,
    ShaderKind.DISCARD_EARLY: DiscardEarlyShader,
    ShaderKind.WRITTEN_DEPTH: WrittenDepthShader,
    ShaderKind.COUNT: CountShader,
    ShaderKind.COUNT_EARLY: CountEarlyShader,
    ShaderKind.LOAD: LoadShader,
    ShaderKind.LOAD_LAYER: LoadLayerShader,
}
