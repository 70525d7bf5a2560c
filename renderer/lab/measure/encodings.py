"""Encodings to compare: what each loses, and what it costs to encode and decode a value on a device.

Values are stored and read back by a compute shader, once for the errors, which are found against the values in float64,
and many times in a loop for the time. The loop can't be shortened: each turn begins with what the last one has read.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

import rhi.shading as sl
from renderer.lab.measure.published_encodings import (
    decode_derivatives,
    decode_octahedral_truncated,
    decode_tangent_frame,
    encode_derivatives,
    encode_octahedral_truncated,
    encode_tangent_frame,
)
from renderer.scene import Camera, Depth, Perspective
from renderer.scene.arrays import Floats
from renderer.shaders import encodings
from renderer.shaders.pixels import PixelRays, distance_at, nearness_of, place_pixel
from renderer.techniques.parts.full_screen import find_rays
from rhi import Device, Program
from rhi.shading import round as round_to_whole

GROUP: Final = 64
TURNS: Final = 64
"""The number of times that a value is stored and read in a run that is timed."""


class StoredValue(sl.Struct):
    """The value that an encoding stores: up to eight numbers."""

    first: sl.vec4
    second: sl.vec4


class Turns(sl.Struct):
    """The number of times that values are stored and read."""

    count: int


class RoundTrip(sl.Shader):
    """Stores and reads each value: the base, which keeps it as it is."""

    precision = sl.Precision.FAST  # as the geometry pass has it
    work_group = (GROUP,)
    turns: sl.Uniform[Turns]
    values: sl.Storage[StoredValue]
    results: sl.StorageRW[StoredValue]

    def compute(self) -> None:
        row = sl.global_id().x
        if row >= len(self.values):
            return
        value = self.values[row]
        for _ in range(self.turns.count):
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
    """Stores a normal as the best of four."""

    def store(self, value: StoredValue) -> StoredValue:
        steps = float((1 << self.bits - 1) - 1)
        normal = encodings.decode_octahedral(encodings.encode_octahedral_best(value.first.xyz, steps), steps)
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


class StoredChanges(RoundTrip):
    """Stores the derivatives of texture coordinates."""

    def store(self, value: StoredValue) -> StoredValue:
        x = encodings.decode_change(encodings.encode_change(value.first.xy))
        y = encodings.decode_change(encodings.encode_change(value.first.zw))
        return StoredValue(first=sl.vec4(x, y), second=value.second)


class PublishedChanges(RoundTrip):
    """Stores the derivatives of texture coordinates as Listing 1.5 does."""

    def store(self, value: StoredValue) -> StoredValue:
        return StoredValue(first=decode_derivatives(encode_derivatives(value.first)), second=value.second)


class StoredPlace(RoundTrip):
    """Stores texture coordinates."""

    def store(self, value: StoredValue) -> StoredValue:
        return StoredValue(
            first=sl.vec4(encodings.decode_uv(encodings.encode_uv(value.first.xy)), 0.0, 0.0), second=value.second
        )


class StoredPosition(RoundTrip):
    """Stores how far along the view something is at a pixel as the depth of a float, and finds its position by the ray
    of the pixel. A value is the pixel, the distance, and the position that was read."""

    is_reversed = True
    steps = 0.0
    """The last of the whole numbers that the depth is stored as; 0 for a float."""

    rays: sl.Uniform[PixelRays]

    def store(self, value: StoredValue) -> StoredValue:
        depth = self.find_depth(value.first.z)
        distance = distance_at(self.rays, nearness_of(self.rays, depth))
        position = place_pixel(self.rays, value.first.xy, distance)
        along = sl.dot(position, self.rays.forward)
        return StoredValue(first=sl.vec4(value.first.xy, along, 0.0), second=sl.vec4(position, 0.0))

    def find_depth(self, distance: float) -> float:
        """Return the depth of a distance as a target holds it."""
        lens = self.rays.lens
        depth = (lens.x - lens.z * distance) / (lens.y - lens.w * distance)
        if not self.is_reversed:
            depth = 1.0 - depth
        if self.steps > 0.0:
            depth = round_to_whole(depth * self.steps) / self.steps
        return depth


class StandardPosition(StoredPosition):
    """Likewise, with the far plane at 1."""

    is_reversed = False


class StandardPosition24(StandardPosition):
    """Likewise, as a whole number of 24 bits."""

    steps = float(2**24 - 1)


class StandardPosition16(StandardPosition):
    """Likewise, as a whole number of 16 bits."""

    steps = float(2**16 - 1)


class WorldMatrix(sl.Struct):
    """The way back from clip coordinates to the world."""

    inverse: sl.mat4
    eye: sl.vec3


class PositionByMatrix(StoredPosition):
    """Stores depth likewise, and finds the position in the world by a matrix."""

    world: sl.Uniform[WorldMatrix]

    def store(self, value: StoredValue) -> StoredValue:
        depth = self.find_depth(value.first.z)
        place = value.first.xy / self.rays.size * 2.0 - 1.0
        found = self.world.inverse @ sl.vec4(place.x, -place.y, depth, 1.0)
        position = found.xyz / found.w - self.world.eye
        along = sl.dot(position, self.rays.forward)
        return StoredValue(first=sl.vec4(value.first.xy, along, 0.0), second=sl.vec4(position, 0.0))


@dataclass(frozen=True)
class Encoding:
    """An encoding to compare.

    Attributes:
        stores: what it stores. bits: how many bits that takes.
        shader: stores and reads it. sample: makes `count` (k, 8) values. measure: finds the error of each, given the
            values and what was read, in `unit`.
        uniforms: what the shader has besides values, by binding.
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
    """Return values (k, 8) as `StoredValue` has them."""
    packed: NDArray[Any] = np.ascontiguousarray(values, np.float32).view(StoredValue.dtype).reshape(len(values))
    return packed


def run_round_trip(device: Device, shader: type[RoundTrip], values: Floats, **uniforms: sl.Struct) -> Floats:
    """Return what a device reads of values (k, 8) that it has stored."""
    buffers = _make_buffers(device, values, 1, uniforms)
    device.dispatch(device.program(shader), -(-len(values) // GROUP), **buffers)
    read: Floats = np.ascontiguousarray(buffers["results"].read()).view(np.float32).reshape(-1, 8).astype(np.float64)
    for buffer in buffers.values():
        buffer.destroy()
    return read


def time_round_trip(
    device: Device, shader: type[RoundTrip], values: Floats, **uniforms: sl.Struct
) -> Callable[[int], None]:
    """Return a function that stores and reads the values many times, and waits for the device."""
    buffers = _make_buffers(device, values, TURNS, uniforms)
    program: Program[...] = device.program(shader)

    def run(_: int) -> None:
        device.dispatch(program, -(-len(values) // GROUP), **buffers)
        device.finish()

    return run


def _make_buffers(device: Device, values: Floats, turns: int, uniforms: Mapping[str, sl.Struct]) -> dict[str, Any]:
    """Create what a `RoundTrip` binds."""
    return {
        "turns": device.uniform(Turns(count=turns)),
        "values": device.storage(StoredValue, pack_values(values)),
        "results": device.storage(StoredValue, len(values)),
        **{name: device.uniform(value) for name, value in uniforms.items()},
    }


def find_degrees(given: Floats, read: Floats) -> Floats:
    """Return the angles between vectors (k, 3), exact for small ones."""
    one, other = (some / np.linalg.norm(some, axis=-1, keepdims=True) for some in (given, read))
    angles: Floats = np.degrees(2.0 * np.arcsin(np.minimum(0.5 * np.linalg.norm(one - other, axis=-1), 1.0)))
    return angles


def find_vector_errors(given: Floats, read: Floats) -> Floats:
    """Return the differences of vectors (k, n) in percent of their lengths; of a vector of length 0, what was read."""
    lengths = np.linalg.norm(given, axis=-1)
    errors: Floats = 100.0 * np.linalg.norm(read - given, axis=-1) / np.where(lengths > 0.0, lengths, 1.0)
    return errors


def sample_frames(rng: np.random.Generator, count: int) -> Floats:
    """Return (k, 8) random normals with tangents at right angles to them, of both sides."""
    normals = rng.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    tangents = np.cross(normals, rng.normal(size=(count, 3)))
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    sides = np.where(rng.random((count, 1)) < 0.5, -1.0, 1.0)
    return np.concatenate([normals, np.zeros((count, 1)), tangents, sides], axis=1)


def sample_changes(rng: np.random.Generator, count: int) -> Floats:
    """Return (k, 8) random derivatives of texture coordinates, from far magnified to far minified textures."""
    angles, lengths = rng.uniform(0.0, 2.0 * np.pi, (count, 2)), np.exp2(rng.uniform(-14.0, 4.0, (count, 2)))
    vectors = np.stack([np.cos(angles) * lengths, np.sin(angles) * lengths], axis=2).reshape(count, 4)
    return np.concatenate([vectors, np.zeros((count, 4))], axis=1)


def sample_places(rng: np.random.Generator, count: int) -> Floats:
    """Return (k, 8) random texture coordinates of a few repetitions, exact in float32."""
    places = rng.uniform(-4.0, 4.0, (count, 8)).astype(np.float32)
    return places.astype(np.float64)


def find_turned(given: Floats, read: Floats) -> Floats:
    """Return the larger error of both derivatives in percent."""
    return np.maximum(find_vector_errors(given[:, :2], read[:, :2]), find_vector_errors(given[:, 2:4], read[:, 2:4]))


def find_offset(given: Floats, read: Floats) -> Floats:
    """Return the larger error of texture coordinates, whole repetitions aside, in millionths of a repetition."""
    off = read[:, :2] - given[:, :2]
    errors: Floats = 1e6 * np.abs(off - np.round(off)).max(1)
    return errors


SIZE: Final = (1280, 720)
"""The size in pixels of the image that positions are stored of."""


def make_camera(depth: Depth) -> Camera:
    """Return the camera of positions, two thousand kilometres from the origin of the world."""
    lens = Perspective(near=0.1, far=1e4, depth=depth)
    return Camera.look_at((1e6, 50.0, -2e6), (1e6 + 3.0, 49.0, -2e6 + 5.0), projection=lens)


def sample_pixels(rng: np.random.Generator, count: int) -> Floats:
    """Return (k, 8) random pixels and distances along the view, as many near as far, exact in float32."""
    pixels, distances = rng.uniform(0.0, SIZE, (count, 2)), np.geomspace(0.2, 9000.0, count)
    values = np.concatenate([pixels, distances[:, None], np.zeros((count, 5))], axis=1)
    return values.astype(np.float32).astype(np.float64)


_CAMERA: Final = make_camera(Depth.REVERSED)


def find_depth_errors(given: Floats, read: Floats, camera: Camera = _CAMERA) -> Floats:
    """Return the errors of distances along the view, in millionths of them."""
    along = read[:, 4:7] @ camera.forward
    errors: Floats = 1e6 * np.abs(along / given[:, 2] - 1.0)
    return errors


def find_pixel_errors(given: Floats, read: Floats, camera: Camera = _CAMERA) -> Floats:
    """Return how many pixels what was read is beside what was given, in the image."""
    seen = read[:, 4:7] @ camera.rotation.T
    clip = np.concatenate([seen, np.ones((len(seen), 1))], axis=1) @ camera.projection.matrix.T
    place = (0.5 + clip[:, :2] / clip[:, 3:] * (0.5, -0.5)) * SIZE
    errors: Floats = np.abs(place - given[:, :2]).max(1)
    return errors


def _positions(
    name: str, bits: int, shader: type[RoundTrip], measure: Callable[[Floats, Floats], Floats], unit: str
) -> Encoding:
    camera = make_camera(Depth.STANDARD if issubclass(shader, StandardPosition) else Depth.REVERSED)
    uniforms: dict[str, sl.Struct] = {"rays": find_rays(camera, SIZE)}
    if issubclass(shader, PositionByMatrix):
        inverse = np.linalg.inv(camera.view_projection)
        uniforms["world"] = WorldMatrix(inverse=inverse, eye=camera.position)
    return Encoding(f"position by {name}", "position", bits, shader, sample_pixels, measure, unit, uniforms)


def _normals(name: str, bits: int, base: type[RoundedNormal]) -> Encoding:
    shader = type(base.__name__, (base,), {"__module__": __name__, "bits": bits})
    return Encoding(
        f"octahedral 2 × {bits}, {name}",
        "normal",
        2 * bits,
        shader,
        sample_frames,
        lambda given, read: find_degrees(given[:, :3], read[:, :3]),
        "degrees",
    )


def _tangents(name: str, shader: type[RoundTrip]) -> Encoding:
    return Encoding(
        name,
        "normal and tangent",
        32,
        shader,
        sample_frames,
        lambda given, read: find_degrees(given[:, 4:7], read[:, 4:7]),
        "degrees",
    )


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
    _tangents("tangent by the cosine of its angle (Listing 1.6)", PublishedFrame),
    _tangents("tangent by its way around a square", StoredFrame),
    Encoding(
        "derivatives by cosines, halves (Listing 1.5)",
        "derivatives",
        48,
        PublishedChanges,
        sample_changes,
        find_turned,
        "%",
    ),
    Encoding(
        "derivatives by their ways around a square", "derivatives", 48, StoredChanges, sample_changes, find_turned, "%"
    ),
    Encoding("fractional parts", "texture coordinates", 32, StoredPlace, sample_places, find_offset, "10⁻⁶"),
    _positions("a ray, D32F reversed", 32, StoredPosition, find_depth_errors, "10⁻⁶"),
    _positions("a ray, D32F", 32, StandardPosition, find_depth_errors, "10⁻⁶"),
    _positions("a ray, D16", 16, StandardPosition16, find_depth_errors, "10⁻⁶"),
    _positions("a ray, D24", 24, StandardPosition24, find_depth_errors, "10⁻⁶"),
    _positions("a ray, D32F reversed, in the image", 32, StoredPosition, find_pixel_errors, "pixels"),
    _positions("the world's matrix, D32F reversed", 32, PositionByMatrix, find_depth_errors, "10⁻⁶"),
    _positions("the world's matrix, in the image", 32, PositionByMatrix, find_pixel_errors, "pixels"),
)
"""The encodings to compare, in the order of the table."""
