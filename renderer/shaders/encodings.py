"""Encodings of surface attributes, in few bits, for a geometry buffer. Each is a pair of functions, and can
be tested and replaced alone.

| what | bits | how |
|---|---|---|
| a normal | 2 × 8 to 2 × 16 | octahedral: whole numbers from -`steps` to `steps` |
| a normal with its tangent | 32 | octahedral in 2 × 11 bits, a direction in 9, the bitangent's side in 1 |
| texture coordinates | 2 × 16 | their fractional parts |
| the change of texture coordinates from a pixel to the next | 24 | a direction in 11 bits, a length in 13 |
| a material | 16 | a depth, which a depth test compares |

Everything is rounded to whole numbers, and decoded from them without a rounding that matters: axes and zeros
come back exactly, and two programs that decode the same bits see the same vector. Normals of length 0 give
unit vectors.
"""

from __future__ import annotations

from typing import Final

import rhi.shading as sl

_FINEST: Final = 32767.0
_FRAME_STEPS: Final = 1023.0
_DIRECTION_CODES: Final = 512
_GRADIENT_DIRECTION_CODES: Final = 2048
_SMALLEST: Final = 107 << 8
"""The bits of 2^-20, with 8 bits of mantissa: the code 0 of lengths."""


@sl.function
def sign_or_one(x: float) -> float:
    """Return -1 for negative numbers, otherwise 1."""
    return -1.0 if x < 0.0 else 1.0


@sl.function
def octahedral_encode_point(normal: sl.vec3) -> sl.vec2:
    """Return the octahedral coordinates of a direction, from -1 to 1: the lower half is folded over the
    corners."""
    point = normal.xy / sl.max(sl.abs(normal.x) + sl.abs(normal.y) + sl.abs(normal.z), 1e-30)
    if normal.z < 0.0:
        x = (1.0 - sl.abs(point.y)) * sign_or_one(point.x)
        y = (1.0 - sl.abs(point.x)) * sign_or_one(point.y)
        point = sl.vec2(x, y)
    return point


@sl.function
def octahedral_decode_point(point: sl.vec2, steps: float) -> sl.vec3:
    """Return the point of an octahedron of radius `steps` from its octahedral coordinates in steps. With
    whole steps the point is exact."""
    z = steps - sl.abs(point.x) - sl.abs(point.y)
    fold = sl.max(-z, 0.0)
    return sl.vec3(point.x - sign_or_one(point.x) * fold, point.y - sign_or_one(point.y) * fold, z)


@sl.function
def encode_octahedral(normal: sl.vec3, steps: float) -> sl.ivec2:
    """Return a unit vector as two whole numbers from -`steps` to `steps`; b bits each have 2^(b-1) - 1
    steps."""
    return sl.ivec2(sl.round(octahedral_encode_point(normal) * steps))


@sl.function
def encode_octahedral_nearest(normal: sl.vec3, steps: float) -> sl.ivec2:
    """Return a unit vector like `encode_octahedral`, but choose, of the four pairs of numbers around it, the
    one that is decoded nearest to it. The largest error is two thirds of that of rounding."""
    corner = sl.clamp(
        sl.floor(octahedral_encode_point(normal) * steps), sl.vec2(-steps), sl.vec2(steps - 1.0)
    )
    best = corner
    least = 9.0
    for i in range(4):
        candidate = corner + sl.vec2(float(i & 1), float(i >> 1))
        off = sl.normalize(octahedral_decode_point(candidate, steps)) - normal
        if sl.dot(off, off) < least:
            least = sl.dot(off, off)
            best = candidate
    return sl.ivec2(best)


@sl.function
def decode_octahedral(code: sl.ivec2, steps: float) -> sl.vec3:
    """Return the unit vector that `encode_octahedral` or `encode_octahedral_nearest` has stored with as many
    steps."""
    return sl.normalize(octahedral_decode_point(sl.vec2(code), steps))


@sl.function
def encode_normal(normal: sl.vec3) -> sl.uint:
    """Return a unit vector in 2 × 16 bits, octahedral."""
    code = encode_octahedral(normal, _FINEST) + 32767
    return sl.uint(code.x) | sl.uint(code.y) << 16


@sl.function
def decode_normal(bits: sl.uint) -> sl.vec3:
    """Return the unit vector that `encode_normal` has stored, with an error of at most 0.0037°."""
    return decode_octahedral(sl.ivec2(int(bits & 65535), int(bits >> 16)) - 32767, _FINEST)


@sl.function
def encode_direction(direction: sl.vec2, codes: int) -> int:
    """Return the direction of a vector as a number below `codes`, a power of 2 of at least 4: the distance to
    it along the edge of a square that stands on its corner. Multiples of 90° are exact. The largest error is
    115° / `codes` near them and twice as much half-way between. (Equal angles have 180° / `codes` everywhere,
    and need sines.)"""
    x = direction.x / sl.max(sl.abs(direction.x) + sl.abs(direction.y), 1e-30)
    way = 3.0 + x if direction.y < 0.0 else 1.0 - x
    return int(sl.round(way * float(codes // 4))) & (codes - 1)


@sl.function
def decode_direction(code: int, codes: int) -> sl.vec2:
    """Return the vector with |x| + |y| = 1 whose direction `encode_direction` has stored; it is exact."""
    way = float(code) / float(codes // 4)
    if way < 2.0:
        return sl.vec2(1.0 - way, 1.0 - sl.abs(1.0 - way))
    return sl.vec2(way - 3.0, sl.abs(way - 3.0) - 1.0)


class TangentFrame(sl.Struct):
    """A normal and the directions of a texture's axes: unit vectors that are at right angles. `side` is that
    of the bitangent: 1 if it is cross(normal, tangent), -1 if it is the opposite."""

    normal: sl.vec3
    tangent: sl.vec3
    side: float


@sl.function
def compute_bitangent(frame: TangentFrame) -> sl.vec3:
    """Return the bitangent of a frame."""
    return sl.cross(frame.normal, frame.tangent) * frame.side


@sl.function
def octahedral_tangent(point: sl.vec3, normal: sl.vec3) -> sl.vec3:
    """Return a unit vector at a right angle to `normal`, which is the direction of a `point` of an
    octahedron. It depends on these alone, so a tangent is stored as its angle from it (Duff et al. 2017). It
    jumps at z = 0, where the point is exact: so all programs that decode the same bits see the same
    vector."""
    half = sign_or_one(point.z)
    share = -normal.x / (half + normal.z)
    return sl.vec3(1.0 + half * normal.x * share, half * normal.y * share, -half * normal.x)


@sl.function
def encode_frame(frame: TangentFrame) -> sl.uint:
    """Return a frame in 32 bits. The tangent is measured around the normal as it will be decoded, so there is
    no direction in which an error of the normal adds to it."""
    code = encode_octahedral_nearest(frame.normal, _FRAME_STEPS)
    point = octahedral_decode_point(sl.vec2(code), _FRAME_STEPS)
    normal = sl.normalize(point)
    first = octahedral_tangent(point, normal)
    around = sl.vec2(sl.dot(frame.tangent, first), sl.dot(frame.tangent, sl.cross(normal, first)))
    turn = encode_direction(around, _DIRECTION_CODES)
    side = sl.uint(1) if frame.side < 0.0 else sl.uint(0)
    return sl.uint(code.x + 1023) | sl.uint(code.y + 1023) << 11 | sl.uint(turn) << 22 | side << 31


@sl.function
def decode_frame(bits: sl.uint) -> TangentFrame:
    """Return the frame that `encode_frame` has stored. The error is at most 0.08° of the normal and 0.46° of
    the tangent."""
    code = sl.ivec2(int(bits & 2047), int(bits >> 11 & 2047)) - 1023
    point = octahedral_decode_point(sl.vec2(code), _FRAME_STEPS)
    normal = sl.normalize(point)
    first = octahedral_tangent(point, normal)
    around = decode_direction(int(bits >> 22 & 511), _DIRECTION_CODES)
    return TangentFrame(
        normal=normal,
        tangent=sl.normalize(first * around.x + sl.cross(normal, first) * around.y),
        side=-1.0 if bits >> 31 != sl.uint(0) else 1.0,
    )


@sl.function
def encode_uv(uv: sl.vec2) -> sl.uint:
    """Return the fractional part of texture coordinates in 2 × 16 bits. What is lost is whole repetitions of
    a texture, which its derivatives don't miss: they are stored beside it."""
    code = sl.round(sl.fract(uv) * 65536.0)  # 65536 is 0: the next repetition
    return sl.uint(code.x) & 65535 | (sl.uint(code.y) & 65535) << 16


@sl.function
def decode_uv(bits: sl.uint) -> sl.vec2:
    """Return the fractional part of the texture coordinates that `encode_uv` has stored."""
    return sl.vec2(float(bits & 65535), float(bits >> 16)) / 65536.0


@sl.function
def encode_gradient(change: sl.vec2) -> sl.uint:
    """Return a vector in 24 bits: a direction in 11, and its length |x| + |y| in 13, a float from 2^-20 to
    4088. Shorter vectors are 0, longer ones are as long as that."""
    change = sl.clamp(change, sl.vec2(-1e9), sl.vec2(1e9))
    bits = sl.float_bits_to_int(sl.abs(change.x) + sl.abs(change.y)) + 16384 >> 15
    length = sl.clamp(bits - _SMALLEST, 0, 8191)
    return sl.uint(encode_direction(change, _GRADIENT_DIRECTION_CODES)) | sl.uint(length) << 11


@sl.function
def decode_gradient(bits: sl.uint) -> sl.vec2:
    """Return the vector that `encode_gradient` has stored, with an error of at most 0.3 % of its length."""
    code = int(bits >> 11 & 8191)
    length = sl.int_bits_to_float(code + _SMALLEST << 15) if code > 0 else 0.0
    return decode_direction(int(bits & 2047), _GRADIENT_DIRECTION_CODES) * length


@sl.function
def material_depth(material_index: int) -> float:
    """Return the depth, in a depth buffer of 16 bits, that identifies a material: rows from 0 to 65,535 are
    exact."""
    return float(material_index) / 65535.0
