"""Encodings as Deferred+ publishes them (Doghramachi and Bucci 2017, Listings 1.5 and 1.6), to compare ours
with, and the quaternion of a tangent frame, which Deferred+ dismisses (section 1.3.2).

Those of the listings truncate. An angle is stored as its cosine, which is coarse where the cosine is near 1.
"""

from __future__ import annotations

import rhi.shading as sl
from renderer.shaders.encodings import TangentFrame, octahedral_decode_point, octahedral_encode_point


@sl.function
def encode_octahedral_truncated(normal: sl.vec3, last: float) -> sl.ivec2:
    """Encode a unit vector as two integers from 0 to `last`; for b bits `last` is 2^b - 1."""
    return sl.ivec2((octahedral_encode_point(normal) * 0.5 + 0.5) * last)


@sl.function
def decode_octahedral_truncated(code: sl.ivec2, last: float) -> sl.vec3:
    """Decode the unit vector of `encode_octahedral_truncated`. An even number of codes has no middle: with 8
    bits, +z has x and y of -0.0039."""
    return sl.normalize(octahedral_decode_point(sl.vec2(code) / last * 2.0 - 1.0, 1.0))


class StoredDerivatives(sl.Struct):
    """The derivatives of texture coordinates: two halves and two directions of 8 bits."""

    lengths: sl.uint
    directions: sl.uint


@sl.function
def encode_derivatives(derivatives: sl.vec4) -> StoredDerivatives:
    """Encode the derivatives of texture coordinates in x (`xy`) and in y (`zw`) in 48 bits. A length of 0, by
    which Listing 1.5 divides, is taken as 1e-30."""
    lengths = sl.vec2(sl.length(derivatives.xy), sl.length(derivatives.zw))
    cosines = sl.vec2(derivatives.x, derivatives.z) / sl.max(lengths, sl.vec2(1e-30)) * 0.5 + 0.5
    first = sl.uint(1) if derivatives.y < 0.0 else sl.uint(0)
    second = sl.uint(1) if derivatives.w < 0.0 else sl.uint(0)
    codes = sl.vec2(sl.saturate(cosines.x), sl.saturate(cosines.y)) * 127.0
    return StoredDerivatives(
        lengths=sl.pack_half_2x16(lengths),
        directions=second << 15 | sl.uint(codes.y) << 8 | first << 7 | sl.uint(codes.x),
    )


@sl.function
def decode_derivatives(stored: StoredDerivatives) -> sl.vec4:
    """Decode the derivatives of `encode_derivatives`."""
    bits = stored.directions
    x = float(bits & 127) / 127.0 * 2.0 - 1.0
    z = float(bits >> 8 & 127) / 127.0 * 2.0 - 1.0
    y = sl.sqrt(sl.saturate(1.0 - x * x)) * (1.0 if (bits >> 7 & 1) == sl.uint(0) else -1.0)
    w = sl.sqrt(sl.saturate(1.0 - z * z)) * (1.0 if (bits >> 15 & 1) == sl.uint(0) else -1.0)
    lengths = sl.unpack_half_2x16(stored.lengths)
    return sl.vec4(sl.vec2(x, y) * lengths.x, sl.vec2(z, w) * lengths.y)


@sl.function
def choose_axis(index: int) -> sl.vec3:
    """The unit vector of axis 0, 1 or 2."""
    return sl.vec3(1.0 if index == 0 else 0.0, 1.0 if index == 1 else 0.0, 1.0 if index == 2 else 0.0)


@sl.function
def encode_tangent_frame(frame: TangentFrame) -> sl.uvec4:
    """Encode a tangent frame in 10, 10, 10 and 2 bits. The tangent is the cosine of its angle from a vector
    at right angles to the normal and to the axis that the tangent is nearest to."""
    code = encode_octahedral_truncated(frame.normal, 1023.0)
    sizes = sl.abs(frame.tangent)
    max_size = sl.max(sl.max(sizes.x, sizes.y), sizes.z)
    axis = 0 if max_size == sizes.x else 1 if max_size == sizes.y else 2
    first = sl.normalize(sl.cross(frame.normal, choose_axis(axis)))
    second = sl.cross(frame.normal, first)
    cosine = sl.uint(sl.saturate(sl.dot(frame.tangent, first) * 0.5 + 0.5) * 255.0)
    turn = sl.uint(2) if sl.dot(frame.tangent, second) > 0.0001 else sl.uint(0)
    side = sl.uint(1) if frame.side < 0.0 else sl.uint(0)
    return sl.uvec4(sl.uint(code.x), sl.uint(code.y), cosine << 2 | sl.uint(axis), turn | side)


@sl.function
def decode_tangent_frame(stored: sl.uvec4) -> TangentFrame:
    """Decode the tangent frame of `encode_tangent_frame`."""
    normal = decode_octahedral_truncated(sl.ivec2(int(stored.x), int(stored.y)), 1023.0)
    cosine = float(stored.z >> 2) / 255.0 * 2.0 - 1.0
    sine = sl.sqrt(sl.saturate(1.0 - cosine * cosine)) * (1.0 if stored.w >= sl.uint(2) else -1.0)
    first = sl.normalize(sl.cross(normal, choose_axis(int(stored.z & 3))))
    return TangentFrame(
        normal=normal,
        tangent=first * cosine + sl.cross(normal, first) * sine,
        side=-1.0 if (stored.w & 1) == sl.uint(1) else 1.0,
    )


@sl.function
def encode_quaternion(frame: TangentFrame) -> sl.uvec4:
    """Encode a tangent frame as the unit quaternion that turns the axes into tangent, bitangent and normal
    (McAuley, Rendering the World of Far Cry 4, 2015).

    Of its four components the largest follows from the others, which are stored in 10 bits each. Two bits say
    which one it is, and a bit that the target has elsewhere is the handedness. Each row of `4 q qᵀ` is a multiple
    of the quaternion; that of the largest component is exact enough.
    """
    x, z = frame.tangent, frame.normal
    y = sl.cross(z, x)
    squares = sl.vec4(
        1.0 + x.x - y.y - z.z, 1.0 - x.x + y.y - z.z, 1.0 - x.x - y.y + z.z, 1.0 + x.x + y.y + z.z
    )
    largest = sl.max(sl.max(squares.x, squares.y), sl.max(squares.z, squares.w))
    index = 0 if largest == squares.x else 1 if largest == squares.y else 2 if largest == squares.z else 3
    sums = sl.vec3(y.z + z.y, z.x + x.z, x.y + y.x)  # 4 yz, 4 zx, 4 xy
    turns = sl.vec3(y.z - z.y, z.x - x.z, x.y - y.x)  # 4 xw, 4 yw, 4 zw
    others = sl.vec3(sums.z, sums.y, turns.x)
    if index == 1:
        others = sl.vec3(sums.z, sums.x, turns.y)
    elif index == 2:
        others = sl.vec3(sums.y, sums.x, turns.z)
    elif index == 3:
        others = turns
    others = others / sl.sqrt(sl.dot(others, others) + largest * largest)
    codes = sl.uvec3(sl.saturate(others * 0.70710678 + 0.5) * 1023.0 + 0.5)
    side = sl.uint(4) if frame.side < 0.0 else sl.uint(0)
    return sl.uvec4(codes, sl.uint(index) | side)


@sl.function
def decode_quaternion(stored: sl.uvec4) -> TangentFrame:
    """Decode the tangent frame of `encode_quaternion`."""
    others = (sl.vec3(stored.xyz) / 1023.0 - 0.5) * 1.41421356
    largest = sl.sqrt(sl.saturate(1.0 - sl.dot(others, others)))
    index = int(stored.w & 3)
    q = sl.vec4(largest, others)
    if index == 1:
        q = sl.vec4(others.x, largest, others.yz)
    elif index == 2:
        q = sl.vec4(others.xy, largest, others.z)
    elif index == 3:
        q = sl.vec4(others, largest)
    tangent = sl.vec3(
        1.0 - 2.0 * (q.y * q.y + q.z * q.z), 2.0 * (q.x * q.y + q.w * q.z), 2.0 * (q.x * q.z - q.w * q.y)
    )
    normal = sl.vec3(
        2.0 * (q.x * q.z + q.w * q.y), 2.0 * (q.y * q.z - q.w * q.x), 1.0 - 2.0 * (q.x * q.x + q.y * q.y)
    )
    return TangentFrame(normal=normal, tangent=tangent, side=-1.0 if stored.w >= sl.uint(4) else 1.0)
