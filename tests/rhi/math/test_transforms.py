"""Affine transforms on stacks: bounds, normals, camera-relative positions."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import rhi
from rhi.math import multiply, normal_matrices, relative_to, rotation, scaling, transform_bounds, translation


def random_transforms(count, seed, scale=1.0):
    rng = np.random.default_rng(seed)
    matrices = np.zeros((count, 4, 4))
    matrices[:, :3] = rng.normal(size=(count, 3, 4)) * scale
    matrices[:, 3, 3] = 1.0
    return matrices


def corners_of(lower, upper):
    choice = np.array(np.meshgrid([0, 1], [0, 1], [0, 1])).reshape(3, 8).T.astype(bool)
    return np.where(choice, upper[..., None, :], lower[..., None, :])


@given(seed=st.integers(0, 2**32 - 1), exponent=st.sampled_from([-20, 0, 3, 20]))
@settings(max_examples=40)
def test_transformed_bounds_hold_every_transformed_corner(seed, exponent):
    rng = np.random.default_rng(seed)
    matrices = random_transforms(7, seed, 10.0**exponent)
    lower = rng.normal(size=(7, 3))
    upper = lower + rng.uniform(0.0, 2.0, (7, 3)) * (rng.random((7, 3)) < 0.8)
    moved_lower, moved_upper = transform_bounds(matrices, lower, upper)
    corners = np.einsum("nij,nkj->nki", matrices[:, :3, :3], corners_of(lower, upper))
    corners += matrices[:, None, :3, 3]
    assert (corners >= moved_lower[:, None]).all()
    assert (corners <= moved_upper[:, None]).all()
    # and are no looser than the corners' own bounds, up to rounding
    size = np.abs(corners).max() + np.abs(matrices).max()
    assert np.allclose(moved_lower, corners.min(1), rtol=0.0, atol=1e-13 * size)
    assert np.allclose(moved_upper, corners.max(1), rtol=0.0, atol=1e-13 * size)


def test_rotation_is_right_handed():
    turned = rotation((0, 1, 0), np.pi / 2) @ (0.0, 0.0, 1.0, 1.0)
    assert np.allclose(turned, (1.0, 0.0, 0.0, 1.0))


def test_builders_make_stacks():
    assert translation(np.zeros((5, 3))).shape == (5, 4, 4)
    assert scaling(np.ones((2, 3, 3))).shape == (2, 3, 4, 4)
    assert np.array_equal(scaling(2), scaling((2, 2, 2)))
    with pytest.raises(rhi.ValidationError):
        scaling((2, 2))
    assert rotation((1, 0, 0), np.zeros(6)).shape == (6, 4, 4)
    product = multiply(translation((1, 2, 3)), scaling((2, 2, 2))) @ (1.0, 1.0, 1.0, 1.0)
    assert product.tolist() == [3.0, 4.0, 5.0, 1.0]


@pytest.mark.parametrize("factors", [(2.0, 0.5, 3.0), (-1.0, 1.0, 2.0)])
def test_normals_stay_perpendicular_and_outward_under_scaling_and_mirroring(factors):
    matrix = multiply(rotation((0, 0, 1), 0.4), scaling(factors))
    normal, tangent = np.array([1.0, 1.0, 0.0]), np.array([1.0, -1.0, 0.3])
    moved_normal, moved_tangent = normal_matrices(matrix) @ normal, matrix[:3, :3] @ tangent
    assert abs(moved_normal @ moved_tangent) < 1e-12
    assert moved_normal @ (matrix[:3, :3] @ normal) > 0.0


def test_normals_survive_a_flattening_transform():
    matrices = scaling((1.0, 0.0, 1.0))
    assert np.allclose(normal_matrices(matrices) @ (0.0, 1.0, 0.0), (0.0, 1.0, 0.0))


def test_positions_relative_to_a_far_eye_keep_a_tenth_of_a_millimetre():
    eye = np.array([1e6, 50.0, -1e6])
    offset = np.array([12.3456, -0.001, 7.25])
    moved = relative_to(translation(eye + offset), eye)
    assert moved.dtype == np.float32
    assert np.abs(moved[:3, 3] - offset).max() < 1e-6
    rounded_first = (eye + offset).astype(np.float32) - eye.astype(np.float32)
    assert np.abs(rounded_first - offset).max() > 1e-3  # what it saves us from
