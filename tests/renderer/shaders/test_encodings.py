"""Encodings of the geometry buffer: their errors against float64, and the hard cases in float64."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import rhi.shading as sl
from renderer.lab.exam import CASES, CaseResult, encoding_cases
from renderer.lab.measure.encoding_errors import (
    GROUP,
    RoundTripCount,
    angles_in_degrees,
    pack_values,
    sample_derivatives,
    sample_frames,
    vector_errors,
)
from renderer.lab.measure.published_encodings import (
    decode_derivatives,
    decode_octahedral_truncated,
    decode_tangent_frame,
    encode_derivatives,
    encode_octahedral_truncated,
    encode_tangent_frame,
)
from renderer.shaders.encodings import (
    TangentFrame,
    compute_bitangent,
    decode_direction,
    decode_frame,
    decode_gradient,
    decode_octahedral,
    encode_direction,
    encode_frame,
    encode_gradient,
    encode_octahedral,
    encode_octahedral_nearest,
)

Floats = NDArray[Any]


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
    rounded_normals, steps, last = normals.astype(np.float32), float(2 ** (bits - 1) - 1), float(2**bits - 1)

    def off(code: Floats, decode: Any, scale: float) -> tuple[float, float]:
        angles = angles_in_degrees(normals, np.asarray(sl.evaluate(decode, code, scale), np.float64))
        return angles.mean(), angles.max()

    errors = off(sl.evaluate(encode_octahedral, rounded_normals, steps), decode_octahedral, steps)
    assert errors[0] < 1.02 * rounded[0]
    assert 0.9 * rounded[1] < errors[1] < 1.005 * rounded[1]
    errors = off(sl.evaluate(encode_octahedral_nearest, rounded_normals, steps), decode_octahedral, steps)
    assert errors[0] < 1.02 * best[0]
    assert 0.9 * best[1] < errors[1] < 1.005 * best[1]
    errors = off(
        sl.evaluate(encode_octahedral_truncated, rounded_normals, last), decode_octahedral_truncated, last
    )
    assert errors[0] < 1.02 * truncated[0]
    assert 0.9 * truncated[1] < errors[1] < 1.005 * truncated[1]


def make_frames(normals: Floats, tangents: Floats, sides: Floats | float = 1.0) -> Floats:
    frames = np.zeros(len(normals), TangentFrame.dtype)
    frames["normal"], frames["tangent"], frames["side"] = normals, tangents, sides
    return frames


def test_a_tangent_is_stored_better_than_by_its_cosine() -> None:
    values = sample_frames(np.random.default_rng(3), 40_000)
    frames = make_frames(values[:, :3], values[:, 4:7], values[:, 7])
    ours = sl.evaluate(decode_frame, sl.evaluate(encode_frame, frames))
    theirs = sl.evaluate(decode_tangent_frame, sl.evaluate(encode_tangent_frame, frames))
    assert angles_in_degrees(values[:, :3], ours["normal"].astype(float)).max() < 0.08
    assert angles_in_degrees(values[:, 4:7], ours["tangent"].astype(float)).max() < 0.46
    assert 0.7 < angles_in_degrees(values[:, 4:7], theirs["tangent"].astype(float)).max() < 0.94
    assert (ours["side"] == values[:, 7]).all()
    assert (theirs["side"] == values[:, 7]).all()
    assert np.abs(np.sum(ours["normal"] * ours["tangent"], 1)).max() < 1e-6
    bitangents = np.cross(values[:, :3], values[:, 4:7]) * values[:, 7:]
    read = np.asarray(sl.evaluate(compute_bitangent, ours), float)
    assert angles_in_degrees(bitangents, read).max() < 0.46


def test_derivatives_are_stored_better_than_by_cosines() -> None:
    values = sample_derivatives(np.random.default_rng(4), 40_000)[:, :4]
    rounded_values = values.astype(np.float32)
    ours = np.asarray(
        sl.evaluate(decode_gradient, sl.evaluate(encode_gradient, rounded_values[:, :2])), float
    )
    theirs = np.asarray(
        sl.evaluate(decode_derivatives, sl.evaluate(encode_derivatives, rounded_values)), float
    )
    assert angles_in_degrees(values[:, :2], ours).max() < 0.12
    assert vector_errors(values[:, :2], ours).max() < 0.31
    assert 9.0 < angles_in_degrees(values[:, :2], theirs[:, :2]).max() < 10.3


# hard cases in float64; on devices the exam has them


@pytest.mark.parametrize(
    ("number", "measure"),
    [
        (37, encoding_cases.measure_normals),
        (38, encoding_cases.measure_axes),
        (39, encoding_cases.measure_derivatives),
        (40, encoding_cases.measure_tangents),
        (41, encoding_cases.measure_texture_coordinates),
    ],
)
def test_hard_cases_are_stored_in_float64(number: int, measure: Callable[[Floats], CaseResult]) -> None:
    packed = pack_values(encoding_cases.list_values())
    groups, results = -(-len(packed) // GROUP), 4 * len(packed)
    read = sl.run_compute(
        encoding_cases.EveryEncoding, groups, values=packed, results=results, dtype=np.float64
    )["results"]
    errors = measure(np.concatenate([read["first"], read["second"]], axis=1).reshape(-1, 4, 8))
    assert CASES[number].passes(errors), errors


# positions far from the origin; on devices the exam has them


@pytest.mark.parametrize("projection", encoding_cases.PROJECTIONS)
def test_positions_far_from_the_origin_are_read_in_float64(projection: str) -> None:
    values = encoding_cases.list_far_pixels()
    camera, encoding = encoding_cases.make_far_camera(projection)
    groups = -(-len(values) // GROUP)
    bindings = {
        "values": pack_values(values),
        "round_trips": RoundTripCount(count=1),
        "results": len(values),
        **encoding.uniforms,
    }
    results = sl.run_compute(encoding.shader, groups, dtype=np.float64, **bindings)["results"]
    read = np.concatenate([results["first"], results["second"]], axis=1)
    along, across = encoding_cases.position_errors(camera, values, read)
    assert along.max() < 1e-6
    assert across.max() < encoding_cases.PIXEL_TOLERANCE


@pytest.mark.parametrize("codes", [4, 512, 2048])
def test_a_direction_of_any_number_of_codes_comes_back(codes: int) -> None:
    read = sl.evaluate(decode_direction, np.arange(codes), codes)
    assert (np.abs(read).sum(1) == 1.0).all()
    assert (sl.evaluate(encode_direction, read, codes) == np.arange(codes)).all()


@pytest.mark.parametrize("codes", [4, 512, 2048])
def test_a_vector_of_length_0_has_a_direction(codes: int) -> None:
    assert sl.evaluate(encode_direction, np.zeros(2, np.float32), codes) == codes // 4
