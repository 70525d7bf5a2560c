"""Encodings to compare: the error of each, and the time to encode and decode a value on a device.

Values are stored and read back by a compute shader, once for the errors, compared with the values in float64,
and many times in a loop for the time. A compiler can't shorten the loop: each round starts with the last
one's result.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

import rhi.shading as sl
from renderer.frame.pixel_rays import compute_pixel_rays
from renderer.lab.measure.published_encodings import (
    decode_derivatives,
    decode_octahedral_truncated,
    decode_quaternion,
    decode_tangent_frame,
    encode_derivatives,
    encode_octahedral_truncated,
    encode_quaternion,
    encode_tangent_frame,
)
from renderer.scene import Camera, Depth, Perspective
from renderer.scene.arrays import Floats
from renderer.shaders import encodings
from renderer.shaders.pixels import PixelRays, depth_to_nearness, nearness_to_distance, pixel_position
from rhi import Device, Program
from rhi.shading import round as round_to_whole

GROUP: Final = 64
ROUND_TRIPS: Final = 64
"""The number of times that a value is stored and read in a run that is timed."""


class StoredValue(sl.Struct):
    """The value that an encoding stores: up to eight numbers."""

    first: sl.vec4
    second: sl.vec4


class RoundTripCount(sl.Struct):
    """The number of times that values are stored and read."""

    count: int


class RoundTrip(sl.Shader):
    """Stores and reads each value; this base class stores it unchanged."""

    precision = sl.Precision.FAST  # as the geometry pass has it
    work_group = (GROUP,)
    round_trips: sl.Uniform[RoundTripCount]
    values: sl.Storage[StoredValue]
    results: sl.StorageRW[StoredValue]

    def compute(self) -> None:
        row = sl.global_id().x
        if row >= len(self.values):
            return
        value = self.values[row]
        for _ in range(self.round_trips.count):
            value = self.store(value)
        self.results[row] = value

    def store(self, value: StoredValue) -> StoredValue:
        return value


class RoundedNormal(RoundTrip):
    """Stores a normal, rounded."""

    bits = 16

    def store(self, value: StoredValue) -> StoredValue:
        steps = float((1 << self.bits - 1) - 1)
        normal = encodings.decode_octahedral(encodings.encode_octahedral(value.first.xyz, steps), steps)
        return StoredValue(first=sl.vec4(normal, 0.0), second=value.second)


class BestNormal(RoundedNormal):
    """Stores a normal with the best of four roundings."""

    def store(self, value: StoredValue) -> StoredValue:
        steps = float((1 << self.bits - 1) - 1)
        normal = encodings.decode_octahedral(
            encodings.encode_octahedral_nearest(value.first.xyz, steps), steps
        )
        return StoredValue(first=sl.vec4(normal, 0.0), second=value.second)


class TruncatedNormal(RoundedNormal):
    """Stores a normal, truncated."""

    def store(self, value: StoredValue) -> StoredValue:
        last = float((1 << self.bits) - 1)
        normal = decode_octahedral_truncated(encode_octahedral_truncated(value.first.xyz, last), last)
        return StoredValue(first=sl.vec4(normal, 0.0), second=value.second)


class StoredFrame(RoundTrip):
    """Stores a normal and a tangent."""

    def store(self, value: StoredValue) -> StoredValue:
        frame = encodings.TangentFrame(normal=value.first.xyz, tangent=value.second.xyz, side=value.second.w)
        frame = encodings.decode_frame(encodings.encode_frame(frame))
        return StoredValue(first=sl.vec4(frame.normal, 0.0), second=sl.vec4(frame.tangent, frame.side))


class PublishedFrame(RoundTrip):
    """Stores a normal and a tangent as Listing 1.6 does."""

    def store(self, value: StoredValue) -> StoredValue:
        frame = encodings.TangentFrame(normal=value.first.xyz, tangent=value.second.xyz, side=value.second.w)
        frame = decode_tangent_frame(encode_tangent_frame(frame))
        return StoredValue(first=sl.vec4(frame.normal, 0.0), second=sl.vec4(frame.tangent, frame.side))


class QuaternionFrame(RoundTrip):
    """Stores a normal and a tangent as a quaternion."""

    def store(self, value: StoredValue) -> StoredValue:
        frame = encodings.TangentFrame(normal=value.first.xyz, tangent=value.second.xyz, side=value.second.w)
        frame = decode_quaternion(encode_quaternion(frame))
        return StoredValue(first=sl.vec4(frame.normal, 0.0), second=sl.vec4(frame.tangent, frame.side))


class StoredTextureDerivatives(RoundTrip):
    """Stores the derivatives of texture coordinates."""

    def store(self, value: StoredValue) -> StoredValue:
        x = encodings.decode_gradient(encodings.encode_gradient(value.first.xy))
        y = encodings.decode_gradient(encodings.encode_gradient(value.first.zw))
        return StoredValue(first=sl.vec4(x, y), second=value.second)


class PublishedTextureDerivatives(RoundTrip):
    """Stores the derivatives of texture coordinates as Listing 1.5 does."""

    def store(self, value: StoredValue) -> StoredValue:
        return StoredValue(first=decode_derivatives(encode_derivatives(value.first)), second=value.second)


class StoredTextureCoordinates(RoundTrip):
    """Stores texture coordinates."""

    def store(self, value: StoredValue) -> StoredValue:
        return StoredValue(
            first=sl.vec4(encodings.decode_uv(encodings.encode_uv(value.first.xy)), 0.0, 0.0),
            second=value.second,
        )


class StoredPosition(RoundTrip):
    """Stores the distance along the view at a pixel as a float depth, and reads the position back along the
    pixel's ray. A value is the pixel, the distance, and the position that was read."""

    is_reversed = True
    steps = 0.0
    """The last of the integers that the depth is stored as; 0 for a float."""

    rays: sl.Uniform[PixelRays]

    def store(self, value: StoredValue) -> StoredValue:
        depth = self.depth_at(value.first.z)
        distance = nearness_to_distance(self.rays, depth_to_nearness(self.rays, depth))
        position = pixel_position(self.rays, value.first.xy, distance)
        along = sl.dot(position, self.rays.forward)
        return StoredValue(first=sl.vec4(value.first.xy, along, 0.0), second=sl.vec4(position, 0.0))

    def depth_at(self, distance: float) -> float:
        """The depth of a distance as a target stores it."""
        projection = self.rays.projection
        depth = (projection.x - projection.z * distance) / (projection.y - projection.w * distance)
        if not self.is_reversed:
            depth = 1.0 - depth
        if self.steps > 0.0:
            depth = round_to_whole(depth * self.steps) / self.steps
        return depth


class StandardPosition(StoredPosition):
    """Like `StoredPosition`, with the far plane at 1."""

    is_reversed = False


class StandardPosition24(StandardPosition):
    """Like `StandardPosition`, as an integer of 24 bits."""

    steps = float(2**24 - 1)


class StandardPosition16(StandardPosition):
    """Like `StandardPosition`, as an integer of 16 bits."""

    steps = float(2**16 - 1)


class WorldMatrix(sl.Struct):
    """The matrix from clip space back to the world."""

    inverse: sl.mat4
    eye: sl.vec3


class PositionByMatrix(StoredPosition):
    """Stores depth like `StoredPosition`, and reads the position in the world back by a matrix."""

    world: sl.Uniform[WorldMatrix]

    def store(self, value: StoredValue) -> StoredValue:
        depth = self.depth_at(value.first.z)
        ndc = value.first.xy / self.rays.size * 2.0 - 1.0
        unprojected = self.world.inverse @ sl.vec4(ndc.x, -ndc.y, depth, 1.0)
        position = unprojected.xyz / unprojected.w - self.world.eye
        along = sl.dot(position, self.rays.forward)
        return StoredValue(first=sl.vec4(value.first.xy, along, 0.0), second=sl.vec4(position, 0.0))


@dataclass(frozen=True)
class Encoding:
    """An encoding to compare.

    Attributes:
        stores: what it stores.
        bits: how many bits that takes.
        shader: stores and reads it.
        sample: makes `count` (k, 8) values.
        measure: the error of each, from the values and what was read, in `unit`.
        uniforms: the shader's other bindings.
    """

    name: str
    stores: str
    bits: int
    shader: type[RoundTrip]
    sample: Callable[[np.random.Generator, int], Floats]
    measure: Callable[[Floats, Floats], Floats]
    unit: str
    uniforms: Mapping[str, sl.Struct] = field(default_factory=dict)


def pack_values(values: Floats) -> NDArray[Any]:
    """Values (k, 8) as `StoredValue` structs."""
    packed: NDArray[Any] = (
        np.ascontiguousarray(values, np.float32).view(StoredValue.dtype).reshape(len(values))
    )
    return packed


def run_round_trip(device: Device, shader: type[RoundTrip], values: Floats, **uniforms: sl.Struct) -> Floats:
    """Store values (k, 8) on a device, and return what it reads back."""
    buffers = _make_buffers(device, values, 1, uniforms)
    device.dispatch(device.program(shader), -(-len(values) // GROUP), **buffers)
    read: Floats = (
        np.ascontiguousarray(buffers["results"].read()).view(np.float32).reshape(-1, 8).astype(np.float64)
    )
    for buffer in buffers.values():
        buffer.destroy()
    return read


def time_round_trip(
    device: Device, shader: type[RoundTrip], values: Floats, **uniforms: sl.Struct
) -> Callable[[int], None]:
    """A function that stores and reads the values many times, and waits for the device."""
    buffers = _make_buffers(device, values, ROUND_TRIPS, uniforms)
    program: Program[...] = device.program(shader)

    def run(_: int) -> None:
        device.dispatch(program, -(-len(values) // GROUP), **buffers)
        device.finish()

    return run


def _make_buffers(
    device: Device, values: Floats, round_trips: int, uniforms: Mapping[str, sl.Struct]
) -> dict[str, Any]:
    """Create the buffers that a `RoundTrip` binds."""
    return {
        "round_trips": device.uniform(RoundTripCount(count=round_trips)),
        "values": device.storage(StoredValue, pack_values(values)),
        "results": device.storage(StoredValue, len(values)),
        **{name: device.uniform(value) for name, value in uniforms.items()},
    }


def angles_in_degrees(expected: Floats, decoded: Floats) -> Floats:
    """The angles between vectors (k, 3), exact for small ones."""
    expected_unit, decoded_unit = (
        vectors / np.linalg.norm(vectors, axis=-1, keepdims=True) for vectors in (expected, decoded)
    )
    angles: Floats = np.degrees(
        2.0 * np.arcsin(np.minimum(0.5 * np.linalg.norm(expected_unit - decoded_unit, axis=-1), 1.0))
    )
    return angles


def vector_errors(expected: Floats, decoded: Floats) -> Floats:
    """The differences of vectors (k, n) in percent of their lengths; for a vector of length 0, the length
    that was read."""
    lengths = np.linalg.norm(expected, axis=-1)
    errors: Floats = (
        100.0 * np.linalg.norm(decoded - expected, axis=-1) / np.where(lengths > 0.0, lengths, 1.0)
    )
    return errors


def sample_frames(rng: np.random.Generator, count: int) -> Floats:
    """Random normals with tangents at right angles to them, of both handednesses: (k, 8)."""
    normals = rng.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    tangents = np.cross(normals, rng.normal(size=(count, 3)))
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    sides = np.where(rng.random((count, 1)) < 0.5, -1.0, 1.0)
    return np.concatenate([normals, np.zeros((count, 1)), tangents, sides], axis=1)


def sample_derivatives(rng: np.random.Generator, count: int) -> Floats:
    """Random derivatives of texture coordinates, from far magnified to far minified textures: (k, 8)."""
    angles, lengths = rng.uniform(0.0, 2.0 * np.pi, (count, 2)), np.exp2(rng.uniform(-14.0, 4.0, (count, 2)))
    vectors = np.stack([np.cos(angles) * lengths, np.sin(angles) * lengths], axis=2).reshape(count, 4)
    return np.concatenate([vectors, np.zeros((count, 4))], axis=1)


def sample_texture_coordinates(rng: np.random.Generator, count: int) -> Floats:
    """Random texture coordinates of a few repetitions, exact in float32: (k, 8)."""
    coordinates = rng.uniform(-4.0, 4.0, (count, 8)).astype(np.float32)
    return coordinates.astype(np.float64)


def derivative_errors(expected: Floats, decoded: Floats) -> Floats:
    """The larger error of both derivatives in percent."""
    return np.maximum(
        vector_errors(expected[:, :2], decoded[:, :2]), vector_errors(expected[:, 2:4], decoded[:, 2:4])
    )


def texture_coordinate_errors(expected: Floats, decoded: Floats) -> Floats:
    """The larger error of the texture coordinates, ignoring whole repetitions, in millionths of a
    repetition."""
    off = decoded[:, :2] - expected[:, :2]
    errors: Floats = 1e6 * np.abs(off - np.round(off)).max(1)
    return errors


SIZE: Final = (1280, 720)
"""The size in pixels of the image that stored positions belong to."""


def make_camera(depth: Depth) -> Camera:
    """The camera of stored positions, two thousand kilometres from the origin of the world."""
    projection = Perspective(near=0.1, far=1e4, depth=depth)
    return Camera.look_at((1e6, 50.0, -2e6), (1e6 + 3.0, 49.0, -2e6 + 5.0), projection=projection)


def sample_pixels(rng: np.random.Generator, count: int) -> Floats:
    """Random pixels and distances along the view, as many near as far, exact in float32: (k, 8)."""
    pixels, distances = rng.uniform(0.0, SIZE, (count, 2)), np.geomspace(0.2, 9000.0, count)
    values = np.concatenate([pixels, distances[:, None], np.zeros((count, 5))], axis=1)
    return values.astype(np.float32).astype(np.float64)


_CAMERA: Final = make_camera(Depth.REVERSED)


def depth_errors(expected: Floats, decoded: Floats, camera: Camera = _CAMERA) -> Floats:
    """The errors of distances along the view, in millionths of the distance."""
    along = decoded[:, 4:7] @ camera.forward
    errors: Floats = 1e6 * np.abs(along / expected[:, 2] - 1.0)
    return errors


def pixel_errors(expected: Floats, decoded: Floats, camera: Camera = _CAMERA) -> Floats:
    """The distance in pixels between a position and its decoded value, in the image."""
    seen = decoded[:, 4:7] @ camera.rotation.T
    clip = np.concatenate([seen, np.ones((len(seen), 1))], axis=1) @ camera.projection.matrix.T
    pixels = (0.5 + clip[:, :2] / clip[:, 3:] * (0.5, -0.5)) * SIZE
    errors: Floats = np.abs(pixels - expected[:, :2]).max(1)
    return errors


def _positions(
    name: str, bits: int, shader: type[RoundTrip], measure: Callable[[Floats, Floats], Floats], unit: str
) -> Encoding:
    camera = make_camera(Depth.STANDARD if issubclass(shader, StandardPosition) else Depth.REVERSED)
    uniforms: dict[str, sl.Struct] = {"rays": compute_pixel_rays(camera, SIZE)}
    if issubclass(shader, PositionByMatrix):
        inverse = np.linalg.inv(camera.view_projection)
        uniforms["world"] = WorldMatrix(inverse=inverse, eye=camera.position)
    return Encoding(f"position by {name}", "position", bits, shader, sample_pixels, measure, unit, uniforms)


def _normals(name: str, bits: int, base: type[RoundedNormal]) -> Encoding:
    shader = type(base.__name__, (base,), {"__module__": __name__, "bits": bits})
    return Encoding(
        f"octahedral 2 × {bits}, {name}", "normal", 2 * bits, shader, sample_frames, normal_errors, "degrees"
    )


def normal_errors(expected: Floats, decoded: Floats) -> Floats:
    """The angles between normals and what was read, in degrees."""
    return angles_in_degrees(expected[:, :3], decoded[:, :3])


def tangent_errors(expected: Floats, decoded: Floats) -> Floats:
    """The angles between tangents and what was read, in degrees."""
    return angles_in_degrees(expected[:, 4:7], decoded[:, 4:7])


def _frames(
    name: str,
    shader: type[RoundTrip],
    bits: int = 32,
    measure: Callable[[Floats, Floats], Floats] = tangent_errors,
) -> Encoding:
    return Encoding(name, "normal and tangent", bits, shader, sample_frames, measure, "degrees")


ENCODINGS: Final = (
    *(
        _normals(name, bits, base)
        for bits in (8, 10, 11, 12, 16)
        for name, base in (
            ("truncated", TruncatedNormal),
            ("rounded", RoundedNormal),
            ("best of 4", BestNormal),
        )
    ),
    _frames("tangent by the cosine of its angle (Listing 1.6)", PublishedFrame),
    _frames("tangent by its way around a square", StoredFrame),
    _frames("quaternion 3 × 10, its tangent (McAuley)", QuaternionFrame, 33),
    _frames("quaternion 3 × 10, its normal (McAuley)", QuaternionFrame, 33, normal_errors),
    Encoding(
        "derivatives by cosines, halves (Listing 1.5)",
        "derivatives",
        48,
        PublishedTextureDerivatives,
        sample_derivatives,
        derivative_errors,
        "%",
    ),
    Encoding(
        "derivatives by their ways around a square",
        "derivatives",
        48,
        StoredTextureDerivatives,
        sample_derivatives,
        derivative_errors,
        "%",
    ),
    Encoding(
        "fractional parts",
        "texture coordinates",
        32,
        StoredTextureCoordinates,
        sample_texture_coordinates,
        texture_coordinate_errors,
        "10⁻⁶",
    ),
    _positions("a ray, D32F reversed", 32, StoredPosition, depth_errors, "10⁻⁶"),
    _positions("a ray, D32F", 32, StandardPosition, depth_errors, "10⁻⁶"),
    _positions("a ray, D16", 16, StandardPosition16, depth_errors, "10⁻⁶"),
    _positions("a ray, D24", 24, StandardPosition24, depth_errors, "10⁻⁶"),
    _positions("a ray, D32F reversed, in the image", 32, StoredPosition, pixel_errors, "pixels"),
    _positions("the world's matrix, D32F reversed", 32, PositionByMatrix, depth_errors, "10⁻⁶"),
    _positions("the world's matrix, in the image", 32, PositionByMatrix, pixel_errors, "pixels"),
)
"""The encodings to compare, in the order of the table."""
