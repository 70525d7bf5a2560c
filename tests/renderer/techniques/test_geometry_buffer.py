"""What a geometry buffer stores: normals, texels and positions."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from renderer.techniques.geometry_buffer import (
    decode_normal,
    decode_texel,
    encode_normal,
    encode_texel,
)
from rhi.shading import evaluate

Floats = NDArray[Any]


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


def test_a_texel_is_stored_finer_than_images_have_it() -> None:
    levels = np.linspace(0, 1, 4001)
    linear = np.where(levels <= 0.04045, levels / 12.92, ((levels + 0.055) / 1.055) ** 2.4)
    given = np.stack([linear, linear[::-1], np.full_like(linear, 0.5)], 1)
    read = np.asarray(evaluate(decode_texel, evaluate(encode_texel, given.astype(np.float32))))
    back = np.where(read <= 0.0031308, read * 12.92, 1.055 * np.maximum(read, 1e-9) ** (1 / 2.4) - 0.055)
    off = np.abs(back[:, 0] - levels) * 255
    assert off.max() < 0.25
    assert np.abs(back[:, 1] - levels[::-1]).max() * 255 < 0.25
    assert evaluate(decode_texel, evaluate(encode_texel, np.array([1.0, 0.0, 1.0], np.float32))).tolist() == [1, 0, 1]
