"""Encodings of the geometry buffer: their errors against float64, and the hard cases, on the devices too."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import rhi
from renderer.measure.encodings import (
    ENCODINGS,
    GROUP,
    SIZE,
    Encoding,
    StoredValue,
    Turns,
    find_degrees,
    find_vector_errors,
    pack_values,
    run_round_trip,
    sample_changes,
    sample_frames,
)
from renderer.measure.published_encodings import (
    decode_derivatives,
    decode_octahedral_truncated,
    decode_tangent_frame,
    encode_derivatives,
    encode_octahedral_truncated,
    encode_tangent_frame,
)
from renderer.scene import Camera, Depth, Perspective
from renderer.shaders.encodings import (
    TangentFrame,
    decode_change,
    decode_direction,
    decode_frame,
    decode_normal,
    decode_octahedral,
    decode_uv,
    encode_change,
    encode_direction,
    encode_frame,
    encode_normal,
    encode_octahedral,
    encode_octahedral_best,
    encode_uv,
    find_bitangent,
    material_depth,
)
from renderer.techniques.full_screen import find_rays
from rhi.shading import (
    FragmentDepth,
    Shader,
    Storage,
    StorageRW,
    Struct,
    Uniform,
    cross,
    evaluate,
    fragment_coordinate,
    global_id,
    ivec2,
    run_compute,
    vec4,
    vertex_index,
)

Floats = NDArray[Any]
AXES = np.concatenate([np.eye(3), -np.eye(3)])


def unit(vectors: Floats) -> Floats:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def stored(normals: Floats) -> Floats:
    """Return normals (k, 3) as they are read from the buffer."""
    bits = evaluate(encode_normal, normals.astype(np.float32))
    return np.asarray(evaluate(decode_normal, bits), np.float64)


def degrees_off(normals: Floats) -> Floats:
    """Return the angles between normals and what is stored of them; exact for small ones."""
    read, given = unit(stored(normals)), unit(normals.astype(np.float64))
    return np.degrees(2.0 * np.arcsin(0.5 * np.linalg.norm(read - given, axis=-1)))


def test_a_normal_is_stored_to_the_error_of_rounding() -> None:
    off = degrees_off(unit(np.random.default_rng(0).normal(size=(100_000, 3))))
    assert off.mean() == pytest.approx(0.0013, rel=0.1)
    assert 0.0030 < off.max() < 0.0040


def test_axes_are_exact() -> None:
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    assert degrees_off(axes).max() < 1e-5


@pytest.mark.parametrize("zero", [0.0, -0.0])
def test_zeros_of_both_signs_mean_the_same(zero: float) -> None:
    for z in (1.0, -1.0):
        assert degrees_off(np.array([[zero, zero, z], [zero, 0.6, 0.8 * z], [0.6, zero, 0.8 * z]])).max() < 0.004


def test_seams_between_octants_are_no_worse_than_the_rest() -> None:
    turn = np.linspace(0, 2 * np.pi, 10_000)
    circle, still = np.stack([np.cos(turn), np.sin(turn)], 1), np.zeros(len(turn))
    for axis in range(3):
        for tilt in (0.0, 1e-7, -1e-7, 1e-4, -1e-4):
            near = unit(np.insert(circle, axis, still + tilt, axis=1))
            assert degrees_off(near).max() < 0.0040
    edges = unit(np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float))
    assert degrees_off(edges).max() < 0.0040


def test_the_downward_pole_is_stored_from_all_sides() -> None:
    around = np.random.default_rng(1).normal(size=(1000, 3)) * (1e-6, 1e-6, 0) - (0, 0, 1)
    assert degrees_off(unit(around)).max() < 0.0040


def test_a_vector_of_length_0_gives_a_unit_vector() -> None:
    assert np.linalg.norm(stored(np.zeros((1, 3)))) == pytest.approx(1.0)


# errors against float64, in degrees: the mean and the largest


@pytest.mark.parametrize(
    ("bits", "rounded", "best", "truncated"),
    [
        (8, (0.337, 0.950), (0.315, 0.635), (0.670, 1.90)),
        (10, (0.084, 0.235), (0.078, 0.158), (0.167, 0.472)),
        (12, (0.021, 0.059), (0.0195, 0.039), (0.042, 0.118)),
        (16, (0.0013, 0.0037), (0.0012, 0.0025), (0.0026, 0.0074)),
    ],
)
def test_octahedral_normals_are_as_exact_as_their_bits_allow(
    bits: int, rounded: tuple[float, float], best: tuple[float, float], truncated: tuple[float, float]
) -> None:
    normals = sample_frames(np.random.default_rng(2), 40_000)[:, :3]
    given, steps, last = normals.astype(np.float32), float(2 ** (bits - 1) - 1), float(2**bits - 1)

    def off(code: Floats, decode: Any, scale: float) -> tuple[float, float]:
        angles = find_degrees(normals, np.asarray(evaluate(decode, code, scale), np.float64))
        return angles.mean(), angles.max()

    found = off(evaluate(encode_octahedral, given, steps), decode_octahedral, steps)
    assert found[0] < 1.02 * rounded[0]
    assert 0.9 * rounded[1] < found[1] < 1.005 * rounded[1]
    found = off(evaluate(encode_octahedral_best, given, steps), decode_octahedral, steps)
    assert found[0] < 1.02 * best[0]
    assert 0.9 * best[1] < found[1] < 1.005 * best[1]
    found = off(evaluate(encode_octahedral_truncated, given, last), decode_octahedral_truncated, last)
    assert found[0] < 1.02 * truncated[0]
    assert 0.9 * truncated[1] < found[1] < 1.005 * truncated[1]


def make_frames(normals: Floats, tangents: Floats, sides: Floats | float = 1.0) -> Floats:
    frames = np.zeros(len(normals), TangentFrame.dtype)
    frames["normal"], frames["tangent"], frames["side"] = normals, tangents, sides
    return frames


def test_a_tangent_is_stored_better_than_by_its_cosine() -> None:
    values = sample_frames(np.random.default_rng(3), 40_000)
    frames = make_frames(values[:, :3], values[:, 4:7], values[:, 7])
    ours = evaluate(decode_frame, evaluate(encode_frame, frames))
    theirs = evaluate(decode_tangent_frame, evaluate(encode_tangent_frame, frames))
    assert find_degrees(values[:, :3], ours["normal"].astype(float)).max() < 0.08
    assert find_degrees(values[:, 4:7], ours["tangent"].astype(float)).max() < 0.46
    assert 0.7 < find_degrees(values[:, 4:7], theirs["tangent"].astype(float)).max() < 0.94
    assert (ours["side"] == values[:, 7]).all()
    assert (theirs["side"] == values[:, 7]).all()
    assert np.abs(np.sum(ours["normal"] * ours["tangent"], 1)).max() < 1e-6
    bitangents = np.cross(values[:, :3], values[:, 4:7]) * values[:, 7:]
    read = np.asarray(evaluate(find_bitangent, ours), float)
    assert find_degrees(bitangents, read).max() < 0.46


def test_derivatives_are_stored_better_than_by_cosines() -> None:
    values = sample_changes(np.random.default_rng(4), 40_000)[:, :4]
    given = values.astype(np.float32)
    ours = np.asarray(evaluate(decode_change, evaluate(encode_change, given[:, :2])), float)
    theirs = np.asarray(evaluate(decode_derivatives, evaluate(encode_derivatives, given)), float)
    assert find_degrees(values[:, :2], ours).max() < 0.12
    assert find_vector_errors(values[:, :2], ours).max() < 0.31
    assert 9.0 < find_degrees(values[:, :2], theirs[:, :2]).max() < 10.3


def test_a_direction_of_any_number_of_codes_comes_back() -> None:
    for codes in (4, 512, 2048):
        read = evaluate(decode_direction, np.arange(codes), codes)
        assert (np.abs(read).sum(1) == 1.0).all()
        assert (evaluate(encode_direction, read, codes) == np.arange(codes)).all()


# hard cases, on devices and in float64


class EveryEncoding(Shader):
    """Stores and reads each value with every encoding."""

    work_group = (GROUP,)
    values: Storage[StoredValue]
    results: StorageRW[StoredValue]

    def compute(self) -> None:
        row = global_id().x
        if row >= len(self.values):
            return
        first = self.values[row].first
        second = self.values[row].second
        frame = decode_frame(
            encode_frame(TangentFrame(normal=first.xyz, tangent=second.xyz, side=second.w))
        )
        fine = decode_normal(encode_normal(first.xyz))
        coarse = decode_octahedral(encode_octahedral(first.xyz, 127.0), 127.0)
        best = decode_octahedral(encode_octahedral_best(first.xyz, 127.0), 127.0)
        read = decode_uv(encode_uv(first.xy))
        x = decode_change(encode_change(first.xy))
        y = decode_change(encode_change(first.zw))
        self.results[4 * row] = StoredValue(first=vec4(frame.normal, 0.0), second=vec4(frame.tangent, frame.side))
        self.results[4 * row + 1] = StoredValue(first=vec4(fine, 0.0), second=vec4(coarse, 0.0))
        self.results[4 * row + 2] = StoredValue(first=vec4(best, 0.0), second=vec4(x, y))
        bitangent = cross(frame.normal, frame.tangent) * frame.side
        self.results[4 * row + 3] = StoredValue(first=vec4(read, 0.0, 0.0), second=vec4(bitangent, 0.0))


SEAMS = unit(
    np.array(
        [(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if abs(x) + abs(y) + abs(z) > 1], float
    )
)
NORMALS = np.concatenate(
    [
        AXES,
        np.where(AXES == 0.0, -0.0, AXES),
        SEAMS,
        unit(SEAMS + np.array([1e-6, -1e-6, 1e-6])),
        unit(np.array([[1e-7, -1e-7, -1.0], [-1e-7, 0.0, -1.0], [1.0, 1e-8, -1e-8], [0.6, -0.8, -1e-9]])),
    ]
)
CHANGES = np.array(
    [
        (0, 0, -0.0, 0), (1e-9, 0, 0, -1e-30), (65_504, 0, 0, -65_504), (1e5, -1e5, 1e30, 0), (1, 0, 0, 1),
        (-1, 0, 0, -1), (0.5, 0.5, -0.5, 0.5), (2.0**-20, 0, 2.0**-19, 0), (1e-3, 1e-3 + 1e-9, -1e-3, -1e-3),
    ]
)  # fmt: skip
PLACES = np.array([(0.999999, -0.25), (1000.3, 0.0), (-1e-9, 1.0), (-1000.7, 0.5), (65535 / 65536, -0.0)])


def list_hard_cases() -> Floats:
    """Return (k, 8) values: normals with tangents along both axes of their plane and both sides, then derivatives, then
    texture coordinates."""
    helper = np.where(np.abs(NORMALS[:, :1]) > 0.9, (0.0, 1.0, 0.0), (1.0, 0.0, 0.0))
    first = unit(np.cross(NORMALS, helper))
    second = np.cross(NORMALS, first)
    tied = unit(np.cross(NORMALS, (1.0, 1.0, 0.999)))  # of axes: two components are the same, or nearly
    blocks = []
    for tangents, side in ((first, 1.0), (-first, -1.0), (second, 1.0), (-second, -1.0), (tied, 1.0)):
        block = np.zeros((len(NORMALS), 8))
        block[:, :3], block[:, 4:7], block[:, 7] = NORMALS, tangents, side
        blocks.append(block)
    changes, places = np.zeros((len(CHANGES), 8)), np.zeros((len(PLACES), 8))
    changes[:, :4], places[:, :2] = CHANGES, PLACES
    changes[:, 4], places[:, 4] = 1.0, 1.0
    return np.concatenate([*blocks, changes, places])


def check_hard_cases(results: Floats) -> None:
    """Check what was read of the hard cases, (4 k, 8)."""
    values = list_hard_cases()
    results = np.asarray(results, np.float64).reshape(len(values), 4, 8)
    assert np.isfinite(results).all()
    count = 5 * len(NORMALS)
    given, read = values[:count], results[:count]
    assert find_degrees(given[:, :3], read[:, 1, :3]).max() < 0.0038
    assert find_degrees(given[:, :3], read[:, 1, 4:7]).max() < 0.951
    assert find_degrees(given[:, :3], read[:, 2, :3]).max() < 0.640
    assert find_degrees(given[:, :3], read[:, 0, :3]).max() < 0.08
    assert find_degrees(given[:, 4:7], read[:, 0, 4:7]).max() < 0.46
    assert (read[:, 0, 7] == given[:, 7]).all()
    assert find_degrees(np.cross(given[:, :3], given[:, 4:7]) * given[:, 7:], read[:, 3, 4:7]).max() < 0.46
    # axes are exact however few bits there are, where numbers without a middle give x = y = -0.0039
    axes = np.abs(given[:, :3]).max(1) == 1.0
    for one in (read[:, 0, :3], read[:, 1, :3], read[:, 1, 4:7], read[:, 2, :3]):
        assert np.abs(one[axes] - given[axes, :3]).max() < 1e-6
    changes = results[count : count + len(CHANGES), 2, 4:8]
    assert changes[0].tolist() == changes[1].tolist() == [0, 0, 0, 0]
    assert changes[2].tolist() == [4088, 0, 0, -4088]
    assert changes[3].tolist() == [2044, -2044, 4088, 0]
    assert changes[4:7].tolist() == CHANGES[4:7].tolist()
    assert changes[7].tolist() == [0, 0, 2.0**-19, 0]
    assert find_vector_errors(CHANGES[8:, :2], changes[8:, :2]).max() < 0.31
    places = results[count + len(CHANGES) :, 3, :2] - PLACES.astype(np.float32)
    assert np.abs(places - np.round(places)).max() <= 0.5 / 65536 + 1e-12
    assert (results[:, 3, :2] >= 0.0).all()
    assert (results[count + len(CHANGES) :, 3, :2] < 1.0).all()


def test_hard_cases_are_stored_on_devices(device: rhi.Device) -> None:
    packed = pack_values(list_hard_cases())
    values, results = device.storage(StoredValue, packed), device.storage(StoredValue, 4 * len(packed))
    groups = -(-len(packed) // GROUP)
    device.dispatch(device.program(EveryEncoding), groups, values=values, results=results)
    check_hard_cases(np.ascontiguousarray(results.read()).view(np.float32).reshape(-1, 8))


def test_hard_cases_are_stored_in_float64() -> None:
    packed = pack_values(list_hard_cases())
    groups, results = -(-len(packed) // GROUP), 4 * len(packed)
    read = run_compute(EveryEncoding, groups, values=packed, results=results, dtype=np.float64)["results"]
    check_hard_cases(np.concatenate([read["first"], read["second"]], axis=1))


LENSES = {
    "reversed": Perspective(near=1e-3, far=1e7),
    "without a far plane": Perspective(near=1e-3),
    "standard": Perspective(near=1e-3, far=1e7, depth=Depth.STANDARD),
}
"""Lenses from a millimetre to 10,000 km."""


def list_far_pixels() -> Floats:
    """Return (k, 8) pixels, corners and the middle among them, and distances from 2 mm to 9,000 km."""
    values = np.zeros((1000, 8))
    values[:, :2] = np.random.default_rng(6).uniform(0.0, SIZE, (1000, 2))
    values[:5, :2] = [(0, 0), (SIZE[0], 0), (0, SIZE[1]), SIZE, (SIZE[0] / 2, SIZE[1] / 2)]
    values[:, 2] = np.geomspace(2e-3, 9e6, 1000)
    return values.astype(np.float32).astype(np.float64)


def find_far_positions(lens: str) -> tuple[Camera, Encoding]:
    """Return a camera 10⁶ m from the origin, and the encoding of what it sees."""
    camera = Camera.look_at((1e6, 50, -1e6), (1e6 + 3, 49, -1e6 + 5), projection=LENSES[lens])
    name = f"position by a ray, D32F{'' if lens == 'standard' else ' reversed'}"
    encoding = next(one for one in ENCODINGS if one.name == name)
    return camera, replace(encoding, uniforms={"rays": find_rays(camera, SIZE)})


def find_position_errors(camera: Camera, values: Floats, read: Floats) -> tuple[Floats, Floats]:
    """Return how far positions are off along the view, as shares of their distance, and across it, in pixels."""
    seen = read[:, 4:7] @ camera.rotation.T
    clip = np.concatenate([seen, np.ones((len(seen), 1))], axis=1) @ camera.projection.matrix.T
    place = (0.5 + clip[:, :2] / clip[:, 3:] * (0.5, -0.5)) * SIZE
    return np.abs(-seen[:, 2] / values[:, 2] - 1.0), np.abs(place - values[:, :2]).max(1)


@pytest.mark.parametrize("lens", LENSES)
def test_positions_far_from_the_origin_are_read_on_devices(device: rhi.Device, lens: str) -> None:
    values = list_far_pixels()
    camera, encoding = find_far_positions(lens)
    read = run_round_trip(device, encoding.shader, values, **encoding.uniforms)
    along, across = find_position_errors(camera, values, read)
    if lens == "standard":  # the control: next to 1, a step of a float is 6 % of the distance at 1 km
        is_near = values[:, 2] < 0.1
        assert along[is_near].max() < 1e-5
        assert along[~is_near].max() > 0.5
    else:
        assert along.max() < 2e-6
        assert across.max() < 5e-4


@pytest.mark.parametrize("lens", LENSES)
def test_positions_far_from_the_origin_are_read_in_float64(lens: str) -> None:
    values = list_far_pixels()
    camera, encoding = find_far_positions(lens)
    groups = -(-len(values) // GROUP)
    bindings = {"values": pack_values(values), "turns": Turns(count=1), "results": len(values), **encoding.uniforms}
    found = run_compute(encoding.shader, groups, dtype=np.float64, **bindings)["results"]
    read = np.concatenate([found["first"], found["second"]], axis=1)
    along, across = find_position_errors(camera, values, read)
    assert along.max() < 1e-6
    assert across.max() < 5e-4


def test_numbers_without_a_middle_miss_the_axis() -> None:
    up = np.array([0.0, 0.0, 1.0], np.float32)
    read = evaluate(decode_octahedral_truncated, evaluate(encode_octahedral_truncated, up, 255.0), 255.0)
    assert read[0] == read[1] == pytest.approx(-0.0039, abs=1e-4)


# materials as depth


class MaterialDepth(Struct):
    """A depth alone."""

    depth: FragmentDepth


class MaterialOfPixel(Shader):
    """Writes the depth of material x + 256 y."""

    def vertex(self) -> vec4:
        corner = vertex_index()
        return vec4(float(corner % 2) * 4.0 - 1.0, float(corner // 2) * 4.0 - 1.0, 0.5, 1.0)

    def fragment(self) -> MaterialDepth:
        pixel = ivec2(fragment_coordinate().xy)
        return MaterialDepth(depth=material_depth(pixel.x + 256 * pixel.y))


class Chosen(Struct):
    """A material."""

    row: int


class AtMaterial(Shader):
    """Covers the target at the depth of a material."""

    chosen: Uniform[Chosen]

    def vertex(self) -> vec4:
        corner = vertex_index()
        depth = material_depth(self.chosen.row)
        return vec4(float(corner % 2) * 4.0 - 1.0, float(corner // 2) * 4.0 - 1.0, depth, 1.0)

    def fragment(self) -> vec4:
        return vec4(1.0)


def test_each_of_65536_materials_is_a_depth_of_its_own(device: rhi.Device) -> None:
    size, triangle = (256, 256), device.mesh(3)
    materials, seen = device.texture(size, rhi.Format.D16), device.texture(size, rhi.Format.R8)
    with (
        device.render_pass(None, materials),
        device.states(rhi.CullMode.NONE, rhi.DepthTest.ON, rhi.DepthWrite.ON, rhi.DepthFunction.ALWAYS),
    ):
        device.draw(device.program(MaterialOfPixel), triangle)
    rows = np.round(materials.read().astype(np.float64) * 65535.0).astype(np.int64)
    assert (rows.ravel() == np.arange(65536)).all()
    chosen = device.uniform(Chosen(row=0))
    for row in (0, 1, 255, 32767, 32768, 54321, 65534, 65535):
        chosen.write(Chosen(row=row))
        with (
            device.render_pass(seen, materials, clear=(0.0, 0.0, 0.0, 0.0)),
            device.states(
                rhi.CullMode.NONE, rhi.DepthTest.ON, rhi.DepthWrite.OFF, rhi.DepthFunction.EQUAL
            ),
        ):
            device.draw(device.program(AtMaterial), triangle, chosen=chosen)
        assert np.flatnonzero(seen.read()).tolist() == [row]
