"""Texture tables in shaders: `self.images[index].sample(uv)` becomes a call of a function of this module.

- The functions are written in the shading language itself, so they run on every backend and on NumPy. They
  find an image by the words of the table (`rhi.shading.ir.texture_pages`), apply its sampler's wrap modes and
  select its mip levels. The device's own sampler filters the texels of a level.
- Mip levels and anisotropy follow the same equations as `rhi.shading.numpy.host_textures`.
- The index is clamped to the table. All reads have explicit levels, so they may stand in any control flow;
  only `sample` and `sample_bias` take derivatives.
- A shader with two tables needs the functions twice: `table_callee` returns copies for each.
"""

from __future__ import annotations

import ast
from functools import cache
from types import FunctionType
from typing import Final

from rhi.contract.descriptors import Stage
from rhi.contract.layout import INT, UINT
from rhi.shading.ir import tree
from rhi.shading.ir.texture_pages import ANISOTROPY_STEPS, TRANSPOSED, WORDS_ACROSS
from rhi.shading.language import rules
from rhi.shading.language.builtins import BUILTINS
from rhi.shading.language.function import function
from rhi.shading.language.functions import clamp, ddx, ddy, dot, floor, length, log2, mix, saturate, sqrt
from rhi.shading.language.shader import Declaration, Shader
from rhi.shading.language.source import source_of, span_of, suggest
from rhi.shading.language.textures import IntTexture2D, Texture2DArray
from rhi.shading.language.vectors import ivec2, ivec3, ivec4, vec2, vec3, vec4
from rhi.shading.parser.context import FunctionParser
from rhi.shading.parser.signatures import Callee

_TABLE: Final = "_rhi_table"
_REPEAT, _MIRROR, _BORDER = 0, 1, 3
_NEAREST_MIP = 1
_MINIFIES_NEAREST, _MAGNIFIES_NEAREST, _MIP_SHIFT, _ANISOTROPY_SHIFT = 16, 32, 6, 9
_ROW_SHIFT: Final = WORDS_ACROSS.bit_length() - 1
_SMALL, _HUGE = 2.0**-100, 2.0**100


@function
def _wrap(u: float, size: float, mode: int) -> float:
    """Return a wrapped coordinate in texels. Beyond an edge lies the border of one texel, and no more."""
    wrapped = u
    if mode == _REPEAT:
        wrapped = u - floor(u)
    elif mode == _MIRROR:
        wrapped = abs(u - 2.0 * floor(u * 0.5 + 0.5))
    if mode == _BORDER:
        return clamp(wrapped * size, -0.5, size + 0.5)
    if mode == _REPEAT:
        return clamp(wrapped * size, 0.0, size)
    return clamp(wrapped * size, 0.5, size - 0.5)


@function
def _unpack(size: int) -> ivec2:
    return ivec2(size & 65535, (size >> 16) & 65535)


class TableFunctions(Shader):
    """The functions that read a table. `table` and `table_words` stand for the bindings of any table."""

    table: Texture2DArray
    table_words: IntTexture2D

    def word(self, index: int) -> ivec4:
        """Return a word of the table."""
        return self.table_words.load(ivec2(index & (WORDS_ACROSS - 1), index >> _ROW_SHIFT))

    def entry(self, index: int) -> ivec4:
        """Return the word of an image: its first level, levels, size and flags."""
        return self.word(clamp(index, 0, self.word(0).x - 1) + 1)

    def read_level(self, entry: ivec4, number: int, at: vec2, is_nearest: bool) -> vec4:
        """Filter one level, which exists."""
        record = self.word(entry.x + number)
        size = _unpack(record.z)
        wrap_u = entry.w & 3
        wrap_v = (entry.w >> 2) & 3
        u = at.x
        v = at.y
        if (entry.w & TRANSPOSED) != 0:
            u, v = v, u
            wrap_u, wrap_v = wrap_v, wrap_u
        texel = vec2(_wrap(u, float(size.x), wrap_u), _wrap(v, float(size.y), wrap_v))
        if is_nearest:
            i = int(floor(texel.x))
            j = int(floor(texel.y))
            if wrap_u != _BORDER:
                i = min(i, size.x - 1)
            if wrap_v != _BORDER:
                j = min(j, size.y - 1)
            return self.table.load(ivec3(record.x + i, record.y + j, record.w))
        page = self.word(0)
        position = vec2(float(record.x) + texel.x, float(record.y) + texel.y)
        position = vec2(position.x / float(page.y), position.y / float(page.z))
        return self.table.sample_lod(vec3(position, float(record.w)), 0.0)

    def read_levels(self, entry: ivec4, at: vec2, lod: float) -> vec4:
        """Filter an image at a level of detail."""
        mip = (entry.w >> _MIP_SHIFT) & 3
        is_minified = lod > 0.0
        is_nearest = (entry.w & (_MINIFIES_NEAREST if is_minified else _MAGNIFIES_NEAREST)) != 0
        level = 0.0
        if is_minified and mip != 0:
            level = min(lod, float(entry.y - 1))
        first = floor(level)
        part = level - first
        if mip == _NEAREST_MIP:
            first = floor(level + 0.5)
            part = 0.0
        color = self.read_level(entry, int(first), at, is_nearest)
        if part > 0.0:
            color = mix(color, self.read_level(entry, int(first) + 1, at, is_nearest), part)
        return color

    def average(self, entry: ivec4, at: vec2, dx: vec2, dy: vec2, bias: float) -> vec4:
        """Sample a pixel's area; with anisotropy it is the mean along the longer axis of its ellipse."""
        whole = _unpack(entry.z)
        size = vec2(float(whole.x), float(whole.y))
        a = dx * size
        b = dy * size
        aa = dot(a, a)
        bb = dot(b, b)
        ab = dot(a, b)
        longer = max(aa, bb)
        anisotropy = float(entry.w >> _ANISOTROPY_SHIFT) / float(ANISOTROPY_STEPS)
        if anisotropy <= 1.0 or not (longer > _SMALL and aa + bb < _HUGE):
            return self.read_levels(entry, at, 0.5 * log2(max(longer, _SMALL)) + bias)
        half = (aa - bb) * 0.5 / longer
        product = ab / longer
        area = abs(a.x * b.y - a.y * b.x) / longer
        spread = sqrt(half * half + product * product)
        longest = (aa + bb) * 0.5 / longer + spread
        ratio = anisotropy
        if longest < anisotropy * area:
            ratio = longest / area
        longest *= longer
        cell = max(longest / (ratio * ratio), min(longest, 1.0))
        ratio = max(sqrt(longest / cell), 1.0)
        lod = 0.5 * log2(cell) + bias
        right = product
        down = spread - half
        if half > 0.0:
            right = half + spread
            down = product
        along = length(vec2(right, down)) * ratio
        further = vec2(0.0)
        if along > 0.0:
            further = (dx * right + dy * down) / along
        left = ratio
        total = vec4(0.0)
        while left > 0.0:
            position = max(left * 0.5 - 0.5, 0.0)
            weight = saturate(left * 0.5)
            total += self.read_levels(entry, at + further * position, lod) * weight
            total += self.read_levels(entry, at - further * position, lod) * weight
            left -= 2.0
        return total / ratio

    def sample(self, index: int, at: vec2) -> vec4:
        """Sample an image in a fragment stage."""
        return self.average(self.entry(index), at, ddx(at), ddy(at), 0.0)

    def sample_bias(self, index: int, at: vec2, bias: float) -> vec4:
        """Sample an image in a fragment stage, with a bias of the level."""
        return self.average(self.entry(index), at, ddx(at), ddy(at), bias)

    def sample_first(self, index: int, at: vec2) -> vec4:
        """Sample an image in a stage without derivatives: its largest level."""
        return self.read_levels(self.entry(index), at, 0.0)

    def sample_lod(self, index: int, at: vec2, lod: float) -> vec4:
        """Sample an image at a level of detail."""
        return self.read_levels(self.entry(index), at, lod)

    def sample_grad(self, index: int, at: vec2, dx: vec2, dy: vec2) -> vec4:
        """Sample an image with the changes of coordinates to the next pixels."""
        return self.average(self.entry(index), at, dx, dy, 0.0)

    def load(self, index: int, texel: ivec2, level: int = 0) -> vec4:
        """Return one texel, zeros outside."""
        entry = self.entry(index)
        if level < 0 or level >= entry.y:
            return vec4(0.0)
        record = self.word(entry.x + level)
        size = _unpack(record.z)
        i = texel.x
        j = texel.y
        if (entry.w & TRANSPOSED) != 0:
            i, j = j, i
        if i < 0 or j < 0 or i >= size.x or j >= size.y:
            return vec4(0.0)
        return self.table.load(ivec3(record.x + i, record.y + j, record.w))

    def size(self, index: int, level: int = 0) -> ivec2:
        """Return the width and height of a level."""
        entry = self.entry(index)
        size = _unpack(self.word(entry.x + clamp(level, 0, entry.y - 1)).z)
        if (entry.w & TRANSPOSED) != 0:
            return ivec2(size.y, size.x)
        return size

    def levels(self, index: int) -> int:
        """Return the number of mip levels."""
        return self.entry(index).y

    def count(self) -> int:
        """Return the number of images."""
        return self.word(0).x


METHODS: Final = ("sample", "sample_bias", "sample_lod", "sample_grad", "load", "size", "levels")
"""The methods of an image of a table."""
_FRAGMENT_ONLY: Final = frozenset({"sample_bias"})


@cache
def table_callee(table: str, name: str) -> Callee | None:
    """Return a function of `TableFunctions` that reads the table of this name, None if there is none."""
    original = TableFunctions.__dict__.get(name)
    if not isinstance(original, FunctionType):
        return None
    copy = FunctionType(
        original.__code__, original.__globals__, original.__name__, original.__defaults__, None
    )
    copy.__annotations__ = dict(original.__annotations__)
    copy.__qualname__ = original.__qualname__
    setattr(copy, _TABLE, table)
    return Callee(source_of(copy), TableFunctions, True)


def table_of(python: FunctionType) -> str:
    """Return the name of the table that a function of this module reads, "" for functions of users."""
    name: str = getattr(python, _TABLE, "")
    return name


def declared_table(parser: FunctionParser, node: ast.expr) -> Declaration | None:
    """Return the texture table that `self.name` names, None if it names something else."""
    if (
        isinstance(node, ast.Attribute)
        and parser.is_self(node.value)
        and not table_of(parser.source.function)
    ):
        declared: Declaration | None = parser.stage.shader._declared.get(node.attr)
        if declared is not None and declared.is_table:
            return declared
    return None


def method_of_table(parser: FunctionParser, node: ast.Call, declared: Declaration) -> Callee:
    """Return the function for a method of `self.images[index]`."""
    assert isinstance(node.func, ast.Attribute)
    name = node.func.attr
    if name not in METHODS:
        tip = suggest(name, METHODS)
        actual = f"{declared.type}[…].{name}"
        parser.refuse(rules.UNKNOWN_MEMBER, node.func, actual, ", ".join(METHODS), tip)
    is_fragment = parser.stage.stage is Stage.FRAGMENT
    if name in _FRAGMENT_ONLY and not is_fragment:
        stage = parser.stage
        actual = f"{name} in the {stage.stage.value} stage of {stage.shader.__name__}"
        parser.refuse(rules.STAGE, node, actual, Stage.FRAGMENT.value)
    callee = table_callee(declared.name, "sample_first" if name == "sample" and not is_fragment else name)
    assert callee is not None
    return callee


def parse_index(parser: FunctionParser, node: ast.expr) -> tree.Expression:
    """Return the index of an image as an int. A uint beyond all ints becomes the largest."""
    if isinstance(node, ast.Slice | ast.Tuple):
        parser.refuse(rules.SYNTAX, node, f"[{ast.unparse(node)}]", "one index")
    index = parser.expression(node)
    if index.type is UINT:
        row, span = BUILTINS["min"], span_of(node)
        overload = row.choose([UINT, UINT], [False, False])
        assert overload is not None
        most = tree.Constant(UINT, span, 2**31 - 1)
        bounded = tree.BuiltinCall(UINT, span, row, overload, (index, most))
        return tree.Convert(INT, span, bounded)
    if index.type is not INT:
        parser.refuse(rules.WRONG_TYPE, node, str(index.type), "int or uint")
    if isinstance(index, tree.Constant) and index.value < 0 and not parser.untaken:
        parser.refuse(rules.OUT_OF_RANGE, node, str(int(index.value)), "0 or more", "count back from len(…)")
    return index
