"""Affine transforms as stacks of matrices, so that whole arrays are built, multiplied and applied at once.

Matrices are (..., 4, 4) float64 for column vectors: `matrix @ vector`. Every function takes and returns
stacks, so that no caller loops over objects.
"""

from __future__ import annotations

from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rhi.errors import refuse
from rhi.errors.rules import DEVICE_ARGUMENT
from rhi.math.arguments import read_floats
from rhi.math.indexing import repeat_each

Floats: TypeAlias = NDArray[np.float64]
"""Coordinates, sizes and matrices in float64."""
A = TypeVar("A", bound=NDArray[Any])


def freeze(array: A) -> A:
    """Make an array read-only, and return it."""
    array.setflags(write=False)
    return array


def translation(offset: ArrayLike) -> Floats:
    """Return matrices (..., 4, 4) that translate by `offset` (..., 3).

    Examples:
        >>> (translation((1, 2, 3)) @ (0, 0, 0, 1)).tolist()
        [1.0, 2.0, 3.0, 1.0]
    """
    moved = read_floats("translation(offset=...)", offset, 3)
    matrix = _identity(moved.shape[:-1])
    matrix[..., :3, 3] = moved
    return matrix


def scaling(factors: ArrayLike) -> Floats:
    """Return matrices (..., 4, 4) that scale the axes by `factors` (..., 3), or all of them by one number.

    Examples:
        >>> (scaling((2, 2, 2)) @ (1, 1, 1, 1)).tolist()
        [2.0, 2.0, 2.0, 1.0]
    """
    scaled = read_floats("scaling(factors=...)", factors)
    if scaled.shape == ():
        scaled = repeat_each(scaled, 3)
    scaled = read_floats("scaling(factors=...)", scaled, 3)
    matrix = _identity(scaled.shape[:-1])
    for axis in range(3):
        matrix[..., axis, axis] = scaled[..., axis]
    return matrix


def rotation(axis: ArrayLike, angle: ArrayLike) -> Floats:
    """Return matrices (..., 4, 4) that rotate by `angle` (...) radians about the unit `axis` (3,),
    right-handed.

    Examples:
        >>> (rotation((0, 1, 0), np.pi / 2) @ (0, 0, 1, 1)).round(6).tolist()
        [1.0, 0.0, 0.0, 1.0]
    """
    about = read_floats("rotation(axis=...)", axis, 3)
    if about.ndim != 1:
        refuse(DEVICE_ARGUMENT, "rotation(axis=...)", f"shape {about.shape}", "shape (3,)")
    x, y, z = about
    turned = read_floats("rotation(angle=...)", angle)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    sine, cosine = np.sin(turned)[..., None, None], np.cos(turned)[..., None, None]
    matrix = _identity(turned.shape)
    matrix[..., :3, :3] = np.eye(3) + sine * cross + (1.0 - cosine) * (cross @ cross)
    return matrix


def multiply(left: ArrayLike, right: ArrayLike) -> Floats:
    """Return `left @ right` for stacks of affine matrices, with a last row of exactly 0 0 0 1."""
    a, b = read_floats("multiply(left=...)", left, 4, 4), read_floats("multiply(right=...)", right, 4, 4)
    product = a @ b
    product[..., 3, :] = (0.0, 0.0, 0.0, 1.0)
    return product


def is_affine(matrices: Floats) -> bool:
    """True if all `matrices` (..., 4, 4) are finite and have the last row 0 0 0 1."""
    read = read_floats("is_affine(matrices=...)", matrices, 4, 4)
    return bool(np.isfinite(read).all() and (read[..., 3, :] == (0.0, 0.0, 0.0, 1.0)).all())


def transform_bounds(matrices: Floats, lower: Floats, upper: Floats) -> tuple[Floats, Floats]:
    """Return axis-aligned bounds of transformed boxes, using the absolute matrix (Arvo, Graphics Gems, 1990).

    `matrices` is (n, 4, 4), `lower` and `upper` are (n, 3). The centre is multiplied by the matrix and the
    half extents by its absolute values, which gives the bounds of the eight transformed corners.
    Values are rounded outwards by the error of that sum, so that no corner lies outside.
    """
    matrices = read_floats("transform_bounds(matrices=...)", matrices, 4, 4)
    lower = read_floats("transform_bounds(lower=...)", lower, 3)
    upper = read_floats("transform_bounds(upper=...)", upper, 3)
    if not (matrices.ndim == 3 and lower.ndim == upper.ndim == 2):
        shapes = f"shapes {matrices.shape}, {lower.shape} and {upper.shape}"
        refuse(DEVICE_ARGUMENT, "transform_bounds", shapes, "shapes (n, 4, 4), (n, 3) and (n, 3)")
    centre, extent = 0.5 * (lower + upper), 0.5 * (upper - lower)
    linear = matrices[:, :3, :3]
    absolute = np.abs(linear)
    moved = np.einsum("nij,nj->ni", linear, centre) + matrices[:, :3, 3]
    reach = np.einsum("nij,nj->ni", absolute, extent)
    size = np.einsum("nij,nj->ni", absolute, np.abs(centre)) + np.abs(matrices[:, :3, 3]) + reach
    reach += 8.0 * np.finfo(np.float64).eps * size
    return moved - reach, moved + reach


def normal_matrices(matrices: NDArray[Any]) -> Floats:
    """Return the matrices (..., 3, 3) for normals under the transforms (..., 4, 4): cofactors, which also
    suit singular ones.

    The cofactor matrix is the inverse transpose times the determinant, whose sign is removed so that
    mirrored objects keep outward normals. Results are not normalised.
    """
    linear = read_floats("normal_matrices(matrices=...)", matrices, 4, 4)[..., :3, :3]
    x, y, z = linear[..., :, 0], linear[..., :, 1], linear[..., :, 2]
    cofactors = np.stack([np.cross(y, z), np.cross(z, x), np.cross(x, y)], axis=-1)
    determinant = (x * cofactors[..., :, 0]).sum(-1)
    return np.where(determinant < 0.0, -1.0, 1.0)[..., None, None] * cofactors


def relative_to(matrices: Floats, eye: ArrayLike) -> NDArray[np.float32]:
    """Return world transforms (..., 4, 4) relative to `eye` (3,), in float32.

    The subtraction is done in float64, before rounding: near the eye, float32 is then as fine
    at 1e6 m from the origin as at the origin.
    """
    moved = np.array(read_floats("relative_to(matrices=...)", matrices, 4, 4))
    moved[..., :3, 3] -= read_floats("relative_to(eye=...)", eye, 3)
    return moved.astype(np.float32)


def _identity(shape: tuple[int, ...]) -> Floats:
    matrix = np.zeros((*shape, 4, 4))
    for axis in range(4):
        matrix[..., axis, axis] = 1.0
    return matrix
