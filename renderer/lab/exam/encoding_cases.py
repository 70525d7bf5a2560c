"""Encodings of geometry buffers: values whose codes are at an edge, stored and read on the device."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

import rhi.shading as sl
from renderer.frame.pixel_rays import compute_pixel_rays
from renderer.lab.exam.case import CaseResult, Measures, largest_error
from renderer.lab.measure.encoding_errors import (
    ENCODINGS,
    GROUP,
    SIZE,
    Encoding,
    StoredValue,
    angles_in_degrees,
    depth_errors,
    pack_values,
    pixel_errors,
    run_round_trip,
    vector_errors,
)
from renderer.lab.measure.published_encodings import decode_octahedral_truncated, encode_octahedral_truncated
from renderer.scene import Camera, Depth, Perspective
from renderer.scene.arrays import Floats
from renderer.shaders import encodings
from renderer.shadows.maps import FarDepth
from rhi import CullMode, DepthFunction, DepthTest, DepthWrite, Device, Format


class EveryEncoding(sl.Shader):
    """Stores and reads each value with every encoding; four results for each."""

    work_group = (GROUP,)
    values: sl.Storage[StoredValue]
    results: sl.StorageRW[StoredValue]

    def compute(self) -> None:
        row = sl.global_id().x
        if row >= len(self.values):
            return
        first = self.values[row].first
        second = self.values[row].second
        frame = encodings.decode_frame(
            encodings.encode_frame(
                encodings.TangentFrame(normal=first.xyz, tangent=second.xyz, side=second.w)
            )
        )
        fine = encodings.decode_normal(encodings.encode_normal(first.xyz))
        coarse = encodings.decode_octahedral(encodings.encode_octahedral(first.xyz, 127.0), 127.0)
        best = encodings.decode_octahedral(encodings.encode_octahedral_nearest(first.xyz, 127.0), 127.0)
        read = encodings.decode_uv(encodings.encode_uv(first.xy))
        x = encodings.decode_gradient(encodings.encode_gradient(first.xy))
        y = encodings.decode_gradient(encodings.encode_gradient(first.zw))
        self.results[4 * row] = StoredValue(
            first=sl.vec4(frame.normal, 0.0), second=sl.vec4(frame.tangent, frame.side)
        )
        self.results[4 * row + 1] = StoredValue(first=sl.vec4(fine, 0.0), second=sl.vec4(coarse, 0.0))
        self.results[4 * row + 2] = StoredValue(first=sl.vec4(best, 0.0), second=sl.vec4(x, y))
        bitangent = encodings.compute_bitangent(frame)
        self.results[4 * row + 3] = StoredValue(first=sl.vec4(read, 0.0, 0.0), second=sl.vec4(bitangent, 0.0))


def _normalize(vectors: Floats) -> Floats:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


_AXES: Final = np.concatenate([np.eye(3), -np.eye(3)])
_SIDES: Final = (-1, 0, 1)
_SEAMS: Final = _normalize(
    np.array(
        [(x, y, z) for x in _SIDES for y in _SIDES for z in _SIDES if abs(x) + abs(y) + abs(z) > 1], float
    )
)
NORMALS: Final = np.concatenate(
    [
        _AXES,
        np.where(_AXES == 0.0, -0.0, _AXES),
        _SEAMS,
        _normalize(_SEAMS + np.array([1e-6, -1e-6, 1e-6])),
        _normalize(
            np.array([[1e-7, -1e-7, -1.0], [-1e-7, 0.0, -1.0], [1.0, 1e-8, -1e-8], [0.6, -0.8, -1e-9]])
        ),
    ]
)
DERIVATIVES: Final = np.array(
    [
        (0, 0, -0.0, 0), (1e-9, 0, 0, -1e-30), (65_504, 0, 0, -65_504), (1e5, -1e5, 1e30, 0), (1, 0, 0, 1),
        (-1, 0, 0, -1), (0.5, 0.5, -0.5, 0.5), (2.0**-20, 0, 2.0**-19, 0), (1e-3, 1e-3 + 1e-9, -1e-3, -1e-3),
    ]
)  # fmt: skip
"""Derivatives of texture coordinates."""
CLAMPED_DERIVATIVES: Final = np.array([(4088, 0, 0, -4088), (2044, -2044, 4088, 0)])
"""The decoded vectors of the third and fourth of `DERIVATIVES`: the longest that can be stored, in their
directions."""
TEXTURE_COORDINATES: Final = np.array(
    [(0.999999, -0.25), (1000.3, 0.0), (-1e-9, 1.0), (-1000.7, 0.5), (65535 / 65536, -0.0)]
)
"""Texture coordinates."""
_FRAMES: Final = 5 * len(NORMALS)


def list_values() -> Floats:
    """Values (k, 8): normals with tangents along both axes of their plane and both handednesses, then
    derivatives, then texture coordinates."""
    helper = np.where(np.abs(NORMALS[:, :1]) > 0.9, (0.0, 1.0, 0.0), (1.0, 0.0, 0.0))
    first = _normalize(np.cross(NORMALS, helper))
    second = np.cross(NORMALS, first)
    tied = _normalize(np.cross(NORMALS, (1.0, 1.0, 0.999)))  # of axes: two components are the same, or nearly
    blocks = []
    for tangents, side in ((first, 1.0), (-first, -1.0), (second, 1.0), (-second, -1.0), (tied, 1.0)):
        block = np.zeros((len(NORMALS), 8))
        block[:, :3], block[:, 4:7], block[:, 7] = NORMALS, tangents, side
        blocks.append(block)
    changes, coordinates = np.zeros((len(DERIVATIVES), 8)), np.zeros((len(TEXTURE_COORDINATES), 8))
    changes[:, :4], coordinates[:, :2] = DERIVATIVES, TEXTURE_COORDINATES
    changes[:, 4], coordinates[:, 4] = 1.0, 1.0
    return np.concatenate([*blocks, changes, coordinates])


def store_values(device: Device, first: int) -> Floats:
    """Store values on a device and return what it reads, (k, 4, 8). They are stored from index `first` on, so
    that a stale result would differ."""
    packed = pack_values(np.roll(list_values(), first, axis=0))
    values, results = device.storage(StoredValue, packed), device.storage(StoredValue, 4 * len(packed))
    device.dispatch(device.program(EveryEncoding), -(-len(packed) // GROUP), values=values, results=results)
    read = np.ascontiguousarray(results.read()).view(np.float32)
    values.destroy()
    results.destroy()
    return np.roll(read.astype(np.float64).reshape(-1, 4, 8), -first, axis=0)


# Each takes the decoded values, (k, 4, 8).


def measure_normals(read: Floats) -> CaseResult:
    """The greatest angle of normals in 2 × 16 bits, 2 × 8 bits, the best of 4 and the frame's, each relative
    to what its bits allow."""
    values = list_values()[:_FRAMES, :3]
    bounds = {
        "2 × 16 bits": 0.0038,
        "2 × 8 bits": 0.951,
        "2 × 8 bits, best of 4": 0.640,
        "in a tangent frame": 0.08,
    }
    stored = (read[:_FRAMES, 1, :3], read[:_FRAMES, 1, 4:7], read[:_FRAMES, 2, :3], read[:_FRAMES, 0, :3])
    angles = {
        title: float(angles_in_degrees(values, decoded).max())
        for title, decoded in zip(bounds, stored, strict=True)
    }
    numbers = {f"{title}, of {bounds[title]}°": f"{angle:.4f}°" for title, angle in angles.items()}
    return CaseResult(largest_error(*(angles[title] / bounds[title] for title in bounds)), dict(numbers))


def measure_axes(read: Floats) -> CaseResult:
    """The error of the axes, which must be small even with few bits. Codes without a middle give x = y =
    -0.0039."""
    values = list_values()[:_FRAMES, :3]
    axes = np.abs(values).max(1) == 1.0
    stored = (read[:_FRAMES, 0, :3], read[:_FRAMES, 1, :3], read[:_FRAMES, 1, 4:7], read[:_FRAMES, 2, :3])
    error = largest_error(*(float(np.abs(decoded[axes] - values[axes]).max()) for decoded in stored))
    up = np.array([0.0, 0.0, 1.0], np.float32)
    x, y, _ = sl.evaluate(
        decode_octahedral_truncated, sl.evaluate(encode_octahedral_truncated, up, 255.0), 255.0
    )
    holds = {"numbers without a middle miss the axis": bool(x == y and abs(x + 0.0039) < 1e-4)}
    return CaseResult(error, {"axes": int(axes.sum())}, holds)


def measure_derivatives(read: Floats) -> CaseResult:
    """The error of derivatives that can be stored, in percent; those of length 0 and too long ones must have
    exact results."""
    changes = read[_FRAMES : _FRAMES + len(DERIVATIVES), 2, 4:8]
    rounded = (vector_errors(DERIVATIVES[8:, part], changes[8:, part]) for part in (slice(2), slice(2, 4)))
    error = largest_error(*(float(errors.max()) for errors in rounded))
    holds = {
        "length 0, and what rounds to it, is 0": not changes[:2].any(),
        "what is too long keeps its direction": bool((changes[2:4] == CLAMPED_DERIVATIVES).all()),
        "directions of axes and diagonals are exact": bool((changes[4:7] == DERIVATIVES[4:7]).all()),
        "the shortest are rounded": changes[7].tolist() == [0, 0, 2.0**-19, 0],
        "all are finite": bool(np.isfinite(read).all()),
    }
    return CaseResult(
        error,
        {
            f"{derivatives}": errors.tolist()
            for derivatives, errors in zip(DERIVATIVES.tolist(), changes, strict=True)
        },
        holds,
    )


def measure_tangents(read: Floats) -> CaseResult:
    """The greatest angle of tangents and bitangents in degrees."""
    values, frames = list_values()[:_FRAMES], read[:_FRAMES]
    tangents = float(angles_in_degrees(values[:, 4:7], frames[:, 0, 4:7]).max())
    bitangents = np.cross(values[:, :3], values[:, 4:7]) * values[:, 7:]
    aside = float(angles_in_degrees(bitangents, frames[:, 3, 4:7]).max())
    holds = {"sides are exact": bool((frames[:, 0, 7] == values[:, 7]).all())}
    return CaseResult(
        largest_error(tangents, aside), {"tangents": f"{tangents:.3f}°", "bitangents": f"{aside:.3f}°"}, holds
    )


def measure_texture_coordinates(read: Floats) -> CaseResult:
    """The error of texture coordinates, ignoring whole repetitions."""
    coordinates = read[_FRAMES + len(DERIVATIVES) :, 3, :2]
    off = coordinates - TEXTURE_COORDINATES.astype(np.float32)
    every = read[:, 3, :2]
    holds = {"all are from 0 to below 1": bool((every >= 0.0).all() and (coordinates < 1.0).all())}
    numbers = {
        f"{expected}": decoded.tolist()
        for expected, decoded in zip(TEXTURE_COORDINATES.tolist(), coordinates, strict=True)
    }
    return CaseResult(float(np.abs(off - np.round(off)).max()), numbers, holds)


class MaterialDepth(sl.Struct):
    """A depth alone."""

    depth: sl.FragmentDepth


class MaterialOfPixel(FarDepth):
    """Writes the depth of material x + 256 y."""

    def fragment(self) -> MaterialDepth:
        pixel = sl.ivec2(sl.fragment_coordinate().xy)
        return MaterialDepth(depth=encodings.material_depth(pixel.x + 256 * pixel.y))


class SelectedMaterial(sl.Struct):
    """A material."""

    material_index: int


class MaterialPixels(sl.Shader):
    """Covers the target at the depth of a material."""

    selected: sl.Uniform[SelectedMaterial]

    def vertex(self) -> sl.vec4:
        corner = sl.vertex_index()
        depth = encodings.material_depth(self.selected.material_index)
        return sl.vec4(float(corner % 2) * 4.0 - 1.0, float(corner // 2) * 4.0 - 1.0, depth, 1.0)

    def fragment(self) -> sl.vec4:
        return sl.vec4(1.0)


def measure_material_depths(device: Device) -> CaseResult:
    """Write a depth of 16 bits for each of 65,536 materials, and draw where it equals that of one of them."""
    size, triangle = (256, 256), device.mesh(3)
    materials, seen = device.texture(size, Format.D16), device.texture(size, Format.R8)
    with (
        device.render_pass(None, materials),
        device.states(CullMode.NONE, DepthTest.ON, DepthWrite.ON, DepthFunction.ALWAYS),
    ):
        device.draw(device.program(MaterialOfPixel), triangle)
    depths: NDArray[Any] = materials.read()
    rows = np.round(depths.astype(np.float64) * 65535.0).astype(np.int64).ravel()
    wrong = int((rows != np.arange(65536)).sum())
    numbers: dict[str, object] = {"depths that aren't those of their material": wrong}
    selected = device.uniform(SelectedMaterial(material_index=0))
    for row in (0, 1, 255, 32767, 32768, 54321, 65534, 65535):
        selected.write(SelectedMaterial(material_index=row))
        with (
            device.render_pass(seen, materials, clear=(0.0, 0.0, 0.0, 0.0)),
            device.states(CullMode.NONE, DepthTest.ON, DepthWrite.OFF, DepthFunction.EQUAL),
        ):
            device.draw(device.program(MaterialPixels), triangle, selected=selected)
        pixels = np.flatnonzero(seen.read())
        off = len(np.setxor1d(pixels, [row]))
        numbers[f"pixels of material {row}"] = len(pixels)
        wrong += off
    for resource in (triangle, materials, seen, selected):
        resource.destroy()
    return CaseResult(wrong, numbers)


PROJECTIONS: Final = {
    "reversed": Perspective(near=1e-3, far=1e7),
    "without a far plane": Perspective(near=1e-3),
    "standard": Perspective(near=1e-3, far=1e7, depth=Depth.STANDARD),
}
"""Projections from a millimetre to 10,000 km."""
PIXEL_TOLERANCE: Final = 5e-4
"""The largest allowed error of a position in pixels."""


def list_far_pixels() -> Floats:
    """Pixels, corners and the middle among them, and distances from 2 mm to 9,000 km: (k, 8)."""
    values = np.zeros((1000, 8))
    values[:, :2] = np.random.default_rng(6).uniform(0.0, SIZE, (1000, 2))
    values[:5, :2] = [(0, 0), (SIZE[0], 0), (0, SIZE[1]), SIZE, (SIZE[0] / 2, SIZE[1] / 2)]
    values[:, 2] = np.geomspace(2e-3, 9e6, 1000)
    return values.astype(np.float32).astype(np.float64)


def make_far_camera(projection_name: str) -> tuple[Camera, Encoding]:
    """A camera 10⁷ m from the origin, and the encoding of its depth."""
    camera = Camera.look_at((1e7, 50, -1e7), (1e7 + 3, 49, -1e7 + 5), projection=PROJECTIONS[projection_name])
    name = f"position by a ray, D32F{'' if projection_name == 'standard' else ' reversed'}"
    encoding = next(candidate for candidate in ENCODINGS if candidate.name == name)
    return camera, replace(encoding, uniforms={"rays": compute_pixel_rays(camera, SIZE)})


def position_errors(camera: Camera, values: Floats, read: Floats) -> tuple[Floats, Floats]:
    """The errors of positions along the view, relative to their distance, and across it, in pixels."""
    return 1e-6 * depth_errors(values, read, camera), pixel_errors(values, read, camera)


def measure_positions(device: Device) -> CaseResult:
    """Store depths and read positions from them, with projections that reverse depth and with one that
    doesn't."""
    values, numbers = list_far_pixels(), dict[str, object]()
    error = widest = lost = 0.0
    for projection_name in PROJECTIONS:
        camera, encoding = make_far_camera(projection_name)
        read = run_round_trip(device, encoding.shader, values, **encoding.uniforms)
        along, across = position_errors(camera, values, read)
        if projection_name == "standard":  # next to 1, a step of a float is 6 % of the distance at 1 km
            lost = float(along[values[:, 2] > 0.1].max())
            error = largest_error(error, float(along[values[:, 2] < 0.004].max()))
        else:
            error = largest_error(error, float(along.max()))
            widest = largest_error(widest, float(across.max()))
        numbers[f"{projection_name}: along, at most"] = float(along.max())
    holds = {
        f"across, it is at most {PIXEL_TOLERANCE} pixels": widest <= PIXEL_TOLERANCE,
        "standard depth loses what is far": lost > 0.5,
    }
    return CaseResult(error, {**numbers, "across": widest}, holds)


def _measure(measure: Callable[[Floats], CaseResult], first: int, device: Device) -> CaseResult:
    return measure(store_values(device, first))


MEASURES: Final[Measures] = {
    37: partial(_measure, measure_normals, 37),
    38: partial(_measure, measure_axes, 38),
    39: partial(_measure, measure_derivatives, 39),
    40: partial(_measure, measure_tangents, 40),
    41: partial(_measure, measure_texture_coordinates, 41),
    42: measure_material_depths,
    66: measure_positions,
}
