"""Encodings as Deferred+ publishes them (Doghramachi and Bucci 2017, Listings 1.5 and 1.6), to compare ours with.

All of them truncate. An angle is stored as its cosine, which is coarse where the cosine is near 1.
"""

from __future__ import annotations

from renderer.shaders.encodings import TangentFrame, fold_octahedron, unfold_octahedron
from rhi.shading import (
    Struct,
    abs,
    cross,
    dot,
    function,
    ivec2,
    length,
    max,
    normalize,
    pack_half_2x16,
    saturate,
    sqrt,
    uint,
    unpack_half_2x16,
    uvec4,
    vec2,
    vec3,
    vec4,
)


@function
def encode_octahedral_truncated(normal: vec3, last: float) -> ivec2:
    """Return a unit vector as two whole numbers from 0 to `last`; b bits each have 2^b - 1 as the last."""
    return ivec2((unfold_octahedron(normal) * 0.5 + 0.5) * last)


@function
def decode_octahedral_truncated(code: ivec2, last: float) -> vec3:
    """Return the unit vector that `encode_octahedral_truncated` has stored. An even count of numbers has no middle: of
    8 bits, +z has x and y of -0.0039."""
    return normalize(fold_octahedron(vec2(code) / last * 2.0 - 1.0, 1.0))


class StoredDerivatives(Struct):
    """The derivatives of texture coordinates: two halves and two directions of 8 bits."""

    lengths: uint
    directions: uint


@function
def encode_derivatives(derivatives: vec4) -> StoredDerivatives:
    """Return the changes of texture coordinates in x (`xy`) and in y (`zw`) in 48 bits. A length of 0, by which Listing
    1.5 divides, is taken as 1e-30."""
    lengths = vec2(length(derivatives.xy), length(derivatives.zw))
    cosines = vec2(derivatives.x, derivatives.z) / max(lengths, vec2(1e-30)) * 0.5 + 0.5
    first = uint(1) if derivatives.y < 0.0 else uint(0)
    second = uint(1) if derivatives.w < 0.0 else uint(0)
    codes = vec2(saturate(cosines.x), saturate(cosines.y)) * 127.0
    return StoredDerivatives(
        lengths=pack_half_2x16(lengths),
        directions=second << 15 | uint(codes.y) << 8 | first << 7 | uint(codes.x),
    )


@function
def decode_derivatives(stored: StoredDerivatives) -> vec4:
    """Return the derivatives that `encode_derivatives` has stored."""
    bits = stored.directions
    x = float(bits & 127) / 127.0 * 2.0 - 1.0
    z = float(bits >> 8 & 127) / 127.0 * 2.0 - 1.0
    y = sqrt(saturate(1.0 - x * x)) * (1.0 if (bits >> 7 & 1) == uint(0) else -1.0)
    w = sqrt(saturate(1.0 - z * z)) * (1.0 if (bits >> 15 & 1) == uint(0) else -1.0)
    lengths = unpack_half_2x16(stored.lengths)
    return vec4(vec2(x, y) * lengths.x, vec2(z, w) * lengths.y)


@function
def choose_axis(row: int) -> vec3:
    """Return the unit vector of one of the axes 0, 1 and 2."""
    return vec3(1.0 if row == 0 else 0.0, 1.0 if row == 1 else 0.0, 1.0 if row == 2 else 0.0)


@function
def encode_tangent_frame(frame: TangentFrame) -> uvec4:
    """Return a frame in 10, 10, 10 and 2 bits. The tangent is the cosine of its angle from a vector at right angles to
    the normal and to the axis that the tangent is nearest to."""
    code = encode_octahedral_truncated(frame.normal, 1023.0)
    sizes = abs(frame.tangent)
    largest = max(max(sizes.x, sizes.y), sizes.z)
    axis = 0 if largest == sizes.x else 1 if largest == sizes.y else 2
    first = normalize(cross(frame.normal, choose_axis(axis)))
    second = cross(frame.normal, first)
    cosine = uint(saturate(dot(frame.tangent, first) * 0.5 + 0.5) * 255.0)
    turn = uint(2) if dot(frame.tangent, second) > 0.0001 else uint(0)
    side = uint(1) if frame.side < 0.0 else uint(0)
    return uvec4(uint(code.x), uint(code.y), cosine << 2 | uint(axis), turn | side)


@function
def decode_tangent_frame(stored: uvec4) -> TangentFrame:
    """Return the frame that `encode_tangent_frame` has stored."""
    normal = decode_octahedral_truncated(ivec2(int(stored.x), int(stored.y)), 1023.0)
    cosine = float(stored.z >> 2) / 255.0 * 2.0 - 1.0
    sine = sqrt(saturate(1.0 - cosine * cosine)) * (1.0 if stored.w >= uint(2) else -1.0)
    first = normalize(cross(normal, choose_axis(int(stored.z & 3))))
    return TangentFrame(
        normal=normal,
        tangent=first * cosine + cross(normal, first) * sine,
        side=-1.0 if (stored.w & 1) == uint(1) else 1.0,
    )
