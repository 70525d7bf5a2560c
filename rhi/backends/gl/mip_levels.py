"""Mip levels, by a compute stage: a box filter of all texels that a texel of the next level covers.

- GL's own levels leave texels out along odd axes, and Mesa compiles its blits anew in each context. Texts of
  programs are kept by its cache.
- A level is read as the texture's format, and written as unsigned integers of the same size, through views.
  So results are rounded to nearest, whatever a driver does when it stores.
- Views need textures with immutable storage. Others, which other code has made, are copied to such a texture
  and back.
"""

from __future__ import annotations

import ctypes
from typing import Final, NamedTuple

import moderngl

from rhi.backends.gl import enums
from rhi.backends.gl.entry_points import EntryPoints
from rhi.backends.gl.gl_textures import GlTexture
from rhi.contract.descriptors import TextureDescriptor, TextureKind
from rhi.contract.formats import ChannelKind, Format

_GROUP: Final = 8
"""Texels along an edge of a work-group."""
_IMAGE_UNIT: Final = 0


class _Words(NamedTuple):
    """The format of unsigned integers with a texel's size: GL's, and its name in GLSL."""

    internal: int
    name: str


_WORDS: Final = {
    1: _Words(enums.R8UI, "r8ui"),
    2: _Words(enums.R16UI, "r16ui"),
    4: _Words(enums.R32UI, "r32ui"),
    8: _Words(enums.RG32UI, "rg32ui"),
    16: _Words(enums.RGBA32UI, "rgba32ui"),
}
_BINDINGS: Final = (
    enums.IMAGE_BINDING_NAME,
    enums.IMAGE_BINDING_LEVEL,
    enums.IMAGE_BINDING_LAYERED,
    enums.IMAGE_BINDING_LAYER,
    enums.IMAGE_BINDING_ACCESS,
    enums.IMAGE_BINDING_FORMAT,
)

_HEAD: Final = """#version 450
layout(local_size_x = {group}, local_size_y = {group}) in;
layout(binding = {unit}) uniform {sampler} source;
layout(binding = {image}, {words}) writeonly uniform {target} target;
uniform ivec3 size;  // of the level above
uniform int level;  // the level above

// Texels from 2 at on, and their weights: a box as wide as the target's texel.
int taps(int at, int size, out vec3 weights) {{
    int half_size = size / 2;
    if (size == 1) {{ weights = vec3(1.0, 0.0, 0.0); return 1; }}
    if (size % 2 == 0) {{ weights = vec3(0.5, 0.5, 0.0); return 2; }}
    weights = vec3(float(half_size - at), float(half_size), float(at + 1)) / float(size);
    return 3;
}}
"""
_MAIN: Final = """
void main() {{
    ivec3 at = ivec3(gl_GlobalInvocationID);
    ivec3 end = max(size / 2, ivec3(1));
    if (at.x >= end.x || at.y >= end.y) return;
    if (size.x % 2 == 0 && size.y % 2 == 0 && {flat_}) {{
        ivec3 p = ivec3(2 * at.xy, at.z);
        vec4 sum = 0.25 * (texelFetch(source, p, level) + texelFetch(source, p + ivec3(1, 0, 0), level)
            + texelFetch(source, p + ivec3(0, 1, 0), level) + texelFetch(source, p + ivec3(1, 1, 0), level));
        imageStore(target, at, {stored});
        return;
    }}
    vec3 across, down, deep;
    int columns = taps(at.x, size.x, across), rows = taps(at.y, size.y, down);
    int first = at.z, layers = 1;
    deep = vec3(1.0);
    {depth}
    vec4 sum = vec4(0.0);
    for (int z = 0; z < layers; z++)
        for (int y = 0; y < rows; y++)
            for (int x = 0; x < columns; x++)
                sum += deep[z] * down[y] * across[x]
                    * texelFetch(source, ivec3(2 * at.xy + ivec2(x, y), first + z), level);
    imageStore(target, at, {stored});
}}
"""
_DEPTH: Final = "first = size.z == 1 ? 0 : 2 * at.z; layers = taps(at.z, size.z, deep);"
_FLOATS: Final = """
// A float of 5 bits of exponent and some of fraction, without its sign: rounded to nearest, ties to even.
uint small_float(float value, uint fraction) {
    uint bits = floatBitsToUint(value) & 0x7fffffffu, rest = 23u - fraction;
    if (bits > 0x7f800000u) return (31u << fraction) | 1u;
    if (bits == 0x7f800000u) return 31u << fraction;
    if (bits < 0x38800000u) return uint(roundEven(abs(value) * float(1u << (14u + fraction))));
    uint rounded = (bits - 0x38000000u + (1u << (rest - 1u)) - 1u + ((bits >> rest) & 1u)) >> rest;
    return min(rounded, (31u << fraction) - 1u);
}
"""
_SRGB: Final = """
float encode(float light) {
    light = clamp(light, 0.0, 1.0);
    return light <= 0.0031308 ? light * 12.92 : 1.055 * pow(light, 1.0 / 2.4) - 0.055;
}
"""


def write_program(format: Format, is_volume: bool, unit: int) -> str:
    """Return the GLSL that computes a level of a format, reading from a texture unit."""
    words = _WORDS[format.texel_bytes]
    parts, start = [["0u"] for _ in range(4)], 0
    for channel, bits in enumerate(format.channel_bits):
        stored = _encode(format, "sum." + "xyzw"[channel], bits, channel)
        parts[start // 32].append(f"({stored} << {start % 32}u)")
        start += bits
    stored = f"uvec4({', '.join(' | '.join(part) for part in parts)})"
    sampler, target = ("sampler3D", "uimage3D") if is_volume else ("sampler2DArray", "uimage2DArray")
    head = _HEAD.format(
        group=_GROUP, unit=unit, image=_IMAGE_UNIT, sampler=sampler, target=target, words=words.name
    )
    functions = {ChannelKind.FLOAT: _FLOATS, ChannelKind.SRGB: _SRGB}.get(format.kind, "")
    return (
        head
        + functions
        + _MAIN.format(
            flat_="size.z == 1" if is_volume else "true", depth=_DEPTH if is_volume else "", stored=stored
        )
    )


def _encode(format: Format, value: str, bits: int, channel: int) -> str:
    """Return the expression of the stored bits of a channel."""
    if format.kind is ChannelKind.FLOAT:
        if bits == 32:
            return f"floatBitsToUint({value})"
        if bits == 16:
            return f"(small_float({value}, 10u) | ((floatBitsToUint({value}) >> 16) & 0x8000u))"
        return f"({value} < 0.0 ? 0u : small_float({value}, {bits - 5}u))"
    if format.kind is ChannelKind.SNORM:
        largest = (1 << bits - 1) - 1
        return f"(uint(int(roundEven(clamp({value}, -1.0, 1.0) * {largest}.0))) & {(1 << bits) - 1}u)"
    if format.kind is ChannelKind.SRGB and channel < 3:
        value = f"encode({value})"
    return f"uint(roundEven(clamp({value}, 0.0, 1.0) * {(1 << bits) - 1}.0))"


class MipLevels:
    """The programs that compute mip levels in one context."""

    def __init__(self, context: moderngl.Context, gl: EntryPoints) -> None:
        self._context = context
        self._gl = gl
        self._unit = 0
        self._programs: dict[tuple[Format, bool], moderngl.ComputeShader] = {}

    def generate(self, texture: GlTexture) -> None:
        """Compute all levels from 1 on. Changes the current program, and nothing else that is bound."""
        descriptor = texture.descriptor
        if descriptor.levels == 1:
            return
        immutable = ctypes.c_int()
        self._gl.GetTextureParameteriv(texture.name, enums.TEXTURE_IMMUTABLE_FORMAT, ctypes.byref(immutable))
        if immutable.value:
            self._generate(texture.name, texture)
        else:
            self._generate_in_copy(texture)

    def _generate_in_copy(self, texture: GlTexture) -> None:
        gl, descriptor = self._gl, texture.descriptor
        width, height = descriptor.size
        name = gl.create(gl.CreateTextures, texture.target)
        try:
            if descriptor.kind in (TextureKind.D2, TextureKind.CUBE):
                gl.TextureStorage2D(name, descriptor.levels, texture.pixel.internal, width, height)
            else:
                gl.TextureStorage3D(
                    name, descriptor.levels, texture.pixel.internal, width, height, descriptor.layers
                )
            self._copy(texture, texture.name, name, 0)
            self._generate(name, texture)
            for level in range(1, descriptor.levels):
                self._copy(texture, name, texture.name, level)
        finally:
            gl.delete(gl.DeleteTextures, name)

    def _copy(self, texture: GlTexture, source: int, target: int, level: int) -> None:
        size = (*texture.descriptor.level_size(level), texture.descriptor.level_layers(level))
        kind = texture.target
        self._gl.CopyImageSubData(source, kind, level, 0, 0, 0, target, kind, level, 0, 0, 0, *size)

    def _generate(self, name: int, texture: GlTexture) -> None:
        gl, descriptor = self._gl, texture.descriptor
        is_volume = descriptor.kind is TextureKind.D3
        program = self._get_program(descriptor, is_volume)
        words = _WORDS[descriptor.format.texel_bytes].internal
        views: list[int] = []
        bound = [gl.get_integer(binding, _IMAGE_UNIT) for binding in _BINDINGS]
        try:
            for form in (texture.pixel.internal, words):
                views.append(gl.create(gl.GenTextures))
                kind = enums.TEXTURE_3D if is_volume else enums.TEXTURE_2D_ARRAY
                layers = 1 if is_volume else descriptor.layers
                gl.TextureView(views[-1], kind, name, form, 0, descriptor.levels, 0, layers)
            gl.BindTextureUnit(self._unit, views[0])
            gl.BindSampler(self._unit, 0)
            for level in range(1, descriptor.levels):
                above = (*descriptor.level_size(level - 1), descriptor.level_layers(level - 1))
                width, height = descriptor.level_size(level)
                program["size"] = above
                program["level"] = level - 1
                gl.BindImageTexture(_IMAGE_UNIT, views[1], level, 1, 0, enums.WRITE_ONLY, words)
                groups = (-(-width // _GROUP), -(-height // _GROUP), descriptor.level_layers(level))
                program.run(*groups)
                gl.MemoryBarrier(enums.ALL_BARRIER_BITS)
        finally:
            image, level, layered, layer, access, form = bound
            gl.BindImageTexture(_IMAGE_UNIT, image, level, layered, layer, access, form)
            gl.BindTextureUnit(self._unit, 0)
            for view in views:
                gl.delete(gl.DeleteTextures, view)

    def _get_program(self, descriptor: TextureDescriptor, is_volume: bool) -> moderngl.ComputeShader:
        key = (descriptor.format, is_volume)
        if key not in self._programs:
            # The last unit of all stages: no binding of a program has it, since a stage has fewer.
            self._unit = self._gl.get_integer(enums.MAX_COMBINED_TEXTURE_IMAGE_UNITS) - 1
            text = write_program(*key, self._unit)
            self._programs[key] = self._context.compute_shader(text)
        return self._programs[key]

    def release(self) -> None:
        """Release all programs."""
        for program in self._programs.values():
            program.release()
        self._programs.clear()
