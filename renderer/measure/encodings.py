"""Comparison of encodings: what each loses, and what it costs to encode and decode a value on a device.

Values are stored and read back by a compute shader, once for the errors, which are found against the values in float64,
and many times in a loop for the time. The loop can't be shortened: each turn begins with what the last one has read.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.measure.alternate import alternate
from renderer.measure.published_encodings import (
    decode_derivatives,
    decode_octahedral_truncated,
    decode_tangent_frame,
    encode_derivatives,
    encode_octahedral_truncated,
    encode_tangent_frame,
)
from renderer.scene.arrays import Floats
from renderer.shaders.encodings import (
    TangentFrame,
    decode_change,
    decode_frame,
    decode_normal,
    decode_octahedral,
    decode_uv,
    encode_change,
    encode_frame,
    encode_normal,
    encode_octahedral,
    encode_octahedral_best,
    encode_uv,
)
from rhi import Device, Program
from rhi.shading import Precision, Shader, Storage, StorageRW, Struct, Uniform, global_id, vec4

GROUP: Final = 64
TURNS: Final = 64
"""How often a value is stored and read in a run that is timed."""


class StoredValue(Struct):
    """What an encoding stores: up to eight numbers."""

    first: vec4
    second: vec4


class Turns(Struct):
    """How often values are stored and read."""

    count: int


class RoundTrip(Shader):
    """Stores and reads each value: the base, which keeps it as it is."""

    precision = Precision.FAST  # as the geometry pass has it
    work_group = (GROUP,)
    turns: Uniform[Turns]
    values: Storage[StoredValue]
    results: StorageRW[StoredValue]

    def compute(self) -> None:
        row = global_id().x
        if row >= len(self.values):
            return
        value = self.values[row]
        for _ in range(self.turns.count):
            value = self.store(value)
        self.results[row] = value

    def store(self, value: StoredValue) -> StoredValue:
        return value


class StoredNormal(RoundTrip):
    """Stores a normal in 2 × 16 bits."""

    def store(self, value: StoredValue) -> StoredValue:
        normal = decode_normal(encode_normal(value.first.xyz))
        return StoredValue(first=vec4(normal, 0.0), second=value.second)


class RoundedNormal(RoundTrip):
    """Stores a normal, rounded."""

    bits = 16

    def store(self, value: StoredValue) -> StoredValue:
        steps = float((1 << self.bits - 1) - 1)
        normal = decode_octahedral(encode_octahedral(value.first.xyz, steps), steps)
        return StoredValue(first=vec4(normal, 0.0), second=value.second)


class BestNormal(RoundedNormal):
    """Stores a normal as the best of four."""

    def store(self, value: StoredValue) -> StoredValue:
        steps = float((1 << self.bits - 1) - 1)
        normal = decode_octahedral(encode_octahedral_best(value.first.xyz, steps), steps)
        return StoredValue(first=vec4(normal, 0.0), second=value.second)


class TruncatedNormal(RoundedNormal):
    """Stores a normal, truncated."""

    def store(self, value: StoredValue) -> StoredValue:
        last = float((1 << self.bits) - 1)
        normal = decode_octahedral_truncated(encode_octahedral_truncated(value.first.xyz, last), last)
        return StoredValue(first=vec4(normal, 0.0), second=value.second)


class StoredFrame(RoundTrip):
    """Stores a normal and a tangent."""

    def store(self, value: StoredValue) -> StoredValue:
        frame = TangentFrame(normal=value.first.xyz, tangent=value.second.xyz, side=value.second.w)
        frame = decode_frame(encode_frame(frame))
        return StoredValue(first=vec4(frame.normal, 0.0), second=vec4(frame.tangent, frame.side))


class PublishedFrame(RoundTrip):
    """Stores a normal and a tangent as Listing 1.6 does."""

    def store(self, value: StoredValue) -> StoredValue:
        frame = TangentFrame(normal=value.first.xyz, tangent=value.second.xyz, side=value.second.w)
        frame = decode_tangent_frame(encode_tangent_frame(frame))
        return StoredValue(first=vec4(frame.normal, 0.0), second=vec4(frame.tangent, frame.side))


class StoredChanges(RoundTrip):
    """Stores the derivatives of texture coordinates."""

    def store(self, value: StoredValue) -> StoredValue:
        x = decode_change(encode_change(value.first.xy))
        y = decode_change(encode_change(value.first.zw))
        return StoredValue(first=vec4(x, y), second=value.second)


class PublishedChanges(RoundTrip):
    """Stores the derivatives of texture coordinates as Listing 1.5 does."""

    def store(self, value: StoredValue) -> StoredValue:
        return StoredValue(first=decode_derivatives(encode_derivatives(value.first)), second=value.second)


class StoredPlace(RoundTrip):
    """Stores texture coordinates."""

    def store(self, value: StoredValue) -> StoredValue:
        return StoredValue(first=vec4(decode_uv(encode_uv(value.first.xy)), 0.0, 0.0), second=value.second)


@dataclass(frozen=True)
class Encoding:
    """An encoding to compare.

    Attributes:
        stores: what it stores. bits: how many bits that takes.
        shader: stores and reads it. sample: makes `count` (k, 8) values. measure: finds the error of each, given the
            values and what was read, in `unit`.
    """

    name: str
    stores: str
    bits: int
    shader: type[RoundTrip]
    sample: Callable[[np.random.Generator, int], Floats]
    measure: Callable[[Floats, Floats], Floats]
    unit: str


@dataclass(frozen=True, slots=True)
class EncodingRow:
    """What an encoding loses and costs.

    Attributes:
        mean_error, max_error: in `unit`, the larger ones of the devices'.
        nanoseconds: by backend, the median time to encode and decode a value, all lanes and cores taken together.
    """

    name: str
    stores: str
    bits: int
    unit: str
    mean_error: float
    max_error: float
    nanoseconds: dict[str, float]


def compare_encodings(
    devices: Sequence[Device],
    encodings: Sequence[Encoding],
    *,
    count: int = 1 << 14,
    rounds: int = 5,
    progress: Callable[[range], Iterable[int]] = lambda rounds: rounds,
) -> list[EncodingRow]:
    """Return a row for each encoding, of `count` random values of the kind that it stores."""
    errors: dict[str, list[Floats]] = {one.name: [] for one in encodings}
    times: dict[str, dict[str, float]] = {one.name: {} for one in encodings}
    for device in devices:
        works = {}
        for one in encodings:
            values = one.sample(np.random.default_rng(0), count)
            errors[one.name].append(one.measure(values, run_round_trip(device, one.shader, values)))
            works[one.name] = time_round_trip(device, one.shader, values)
        for name, found in alternate(works, progress(range(rounds))).items():
            times[name][device.backend_name] = round(1e9 * found.median / count / TURNS, 2)
    return [
        EncodingRow(
            one.name,
            one.stores,
            one.bits,
            one.unit,
            max(float(some.mean()) for some in errors[one.name]),
            max(float(some.max()) for some in errors[one.name]),
            times[one.name],
        )
        for one in encodings
    ]


def pack_values(values: Floats) -> NDArray[Any]:
    """Return values (k, 8) as `StoredValue` has them."""
    packed: NDArray[Any] = np.ascontiguousarray(values, np.float32).view(StoredValue.dtype).reshape(len(values))
    return packed


def run_round_trip(device: Device, shader: type[RoundTrip], values: Floats) -> Floats:
    """Return what a device reads of values (k, 8) that it has stored."""
    results = device.storage(StoredValue, len(values))
    given, turns = device.storage(StoredValue, pack_values(values)), device.uniform(Turns(count=1))
    groups = -(-len(values) // GROUP)
    device.dispatch(device.program(shader), groups, turns=turns, values=given, results=results)
    read: Floats = np.ascontiguousarray(results.read()).view(np.float32).reshape(-1, 8).astype(np.float64)
    for buffer in (results, given, turns):
        buffer.destroy()
    return read


def time_round_trip(device: Device, shader: type[RoundTrip], values: Floats) -> Callable[[int], None]:
    """Return a function that stores and reads the values many times, and waits for the device."""
    results = device.storage(StoredValue, len(values))
    given, turns = device.storage(StoredValue, pack_values(values)), device.uniform(Turns(count=TURNS))
    groups = -(-len(values) // GROUP)
    program: Program[Any] = device.program(shader)

    def run(_: int) -> None:
        device.dispatch(program, groups, turns=turns, values=given, results=results)
        device.finish()

    return run


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
    return np.maximum(
        find_vector_errors(given[:, :2], read[:, :2]), find_vector_errors(given[:, 2:4], read[:, 2:4])
    )


def find_offset(given: Floats, read: Floats) -> Floats:
    """Return the larger error of texture coordinates, whole repetitions aside, in millionths of a repetition."""
    off = read[:, :2] - given[:, :2]
    errors: Floats = 1e6 * np.abs(off - np.round(off)).max(1)
    return errors


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
)
"""The encodings to compare, in the order of the table."""
