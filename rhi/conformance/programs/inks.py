"""The shaders of random programs, one for each `Ink`.

Their vertex stage is the same: it moves each instance by a step in the window. So few kernels are built, and the
interpreter has one rule for positions.
"""

from __future__ import annotations

from typing import Final

from rhi.conformance.programs.steps import Ink
from rhi.conformance.shaders import Corner, FlatShade, Shade
from rhi.shading import (
    FragmentDepth,
    Shader,
    StorageRW,
    Struct,
    Texture2D,
    Texture2DArray,
    Uniform,
    atomic_add,
    atomic_max,
    clamp,
    discard,
    fragment_coordinate,
    global_id,
    instance_index,
    ivec2,
    ivec3,
    ivec4,
    uint,
    uvec4,
    vec2,
    vec4,
)


class Move(Struct):
    """The distance by which each instance is moved in clip space; the level and layer to load from."""

    step: vec2
    level: int
    layer: int


class FlatInk(Shader):
    """The color of the first corner."""

    move: Uniform[Move]

    def vertex(self, v: Corner) -> FlatShade:
        step = vec4(self.move.step, 0.0, 0.0) * (float(instance_index()) * v.position.w)
        return FlatShade(clip=v.position + step, color=v.color)

    def fragment(self, v: FlatShade) -> vec4:
        return v.color


class SmoothInk(Shader):
    """The interpolated color."""

    move: Uniform[Move]

    def vertex(self, v: Corner) -> Shade:
        step = vec4(self.move.step, 0.0, 0.0) * (float(instance_index()) * v.position.w)
        return Shade(clip=v.position + step, color=v.color)

    def fragment(self, v: Shade) -> vec4:
        return v.color


class Pair(Struct):
    """Two colors."""

    first: vec4
    second: vec4


class TwoInk(FlatInk):
    """The color, and reversed to a second target."""

    def fragment(self, v: FlatShade) -> Pair:  # type: ignore[override]
        return Pair(first=v.color, second=v.color.wzyx)


class UintInk(FlatInk):
    """The color as unsigned integers."""

    def fragment(self, v: FlatShade) -> uvec4:  # type: ignore[override]
        return uvec4(v.color)


class IntInk(FlatInk):
    """The color as signed integers."""

    def fragment(self, v: FlatShade) -> ivec4:  # type: ignore[override]
        return ivec4(v.color)


class HolesInk(FlatInk):
    """Discards every other texel."""

    def fragment(self, v: FlatShade) -> vec4:
        place = ivec2(fragment_coordinate().xy)
        if (place.x + place.y) % 2 == 0:
            discard()
        return v.color


class HolesEarlyInk(HolesInk):
    """Discards every other texel after their depth was written."""

    early_depth = True


class Deep(Struct):
    """A color and a depth."""

    color: vec4
    depth: FragmentDepth


class DeepInk(FlatInk):
    """The alpha of the color is the depth."""

    def fragment(self, v: FlatShade) -> Deep:  # type: ignore[override]
        return Deep(color=v.color, depth=v.color.w)


class CountInk(FlatInk):
    """Counts fragments, and keeps the largest red of each column."""

    counts: StorageRW[uint]
    reds: StorageRW[uint]

    def fragment(self, v: FlatShade) -> vec4:
        column = int(fragment_coordinate().x) % 64
        atomic_add(self.counts[column], uint(1))
        atomic_max(self.reds[column], uint(max(v.color.x, 0.0) * 16.0))
        return v.color


class CountEarlyInk(CountInk):
    """Counts the fragments that pass the tests."""

    early_depth = True


class LoadInk(FlatInk):
    """Adds the texel of an image."""

    source: Texture2D

    def fragment(self, v: FlatShade) -> vec4:
        return v.color + self.source.load(ivec2(fragment_coordinate().xy), self.move.level)


class LoadLayerInk(FlatInk):
    """Adds the texel of a layer of an array."""

    source: Texture2DArray

    def fragment(self, v: FlatShade) -> vec4:
        place = ivec2(fragment_coordinate().xy)
        return v.color + self.source.load(ivec3(place, self.move.layer), self.move.level)


class AddTexels(Shader):
    """Adds the first channel of each texel to the cell of its column."""

    work_group = (8, 8)
    source: Texture2D
    counts: StorageRW[uint]

    def compute(self) -> None:
        place = ivec2(global_id().xy)
        size = self.source.size()
        if place.x < size.x and place.y < size.y:
            value = clamp(self.source.load(place).x, 0.0, 4.0)
            atomic_add(self.counts[place.x % 64], uint(value * 8.0))


SHADERS: Final[dict[Ink, type[Shader]]] = {
    Ink.FLAT: FlatInk,
    Ink.SMOOTH: SmoothInk,
    Ink.TWO: TwoInk,
    Ink.UINT: UintInk,
    Ink.INT: IntInk,
    Ink.HOLES: HolesInk,
    Ink.HOLES_EARLY: HolesEarlyInk,
    Ink.DEEP: DeepInk,
    Ink.COUNT: CountInk,
    Ink.COUNT_EARLY: CountEarlyInk,
    Ink.LOAD: LoadInk,
    Ink.LOAD_LAYER: LoadLayerInk,
}
