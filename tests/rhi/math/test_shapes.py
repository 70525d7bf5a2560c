"""Shapes: closed, of unit size, with faces that are counter-clockwise from outside."""

from __future__ import annotations

import numpy as np
import pytest

from rhi.math import make_cube, make_sphere


@pytest.mark.parametrize("shape", ["cube", "sphere"])
def test_a_shape_is_closed_and_its_faces_look_outwards(shape: str) -> None:
    """The volume that signed tetrahedra to the origin sum up to is the shape's own, and each edge has two
    faces."""
    positions, indices = make_sphere(48) if shape == "sphere" else (make_cube()[0], make_cube()[3])
    corners = positions.astype(float)[indices.reshape(-1, 3)]
    volume = np.linalg.det(corners).sum() / 6.0
    assert volume == pytest.approx(4 / 3 * np.pi if shape == "sphere" else 8.0, rel=5e-3)
    faces = np.unique(positions.round(5), axis=0, return_inverse=True)[1].ravel()[indices].reshape(-1, 3)
    faces = faces[[len(set(face)) == 3 for face in faces.tolist()]]  # at the poles some are lines
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    assert len(np.unique(edges, axis=0)) == len(edges), "each direction of an edge once"
    assert {tuple(edge) for edge in edges.tolist()} == {tuple(edge[::-1]) for edge in edges.tolist()}


def test_a_cube_has_flat_faces_and_a_whole_image_on_each() -> None:
    positions, normals, uvs, indices = make_cube()
    for face in range(6):
        rows = slice(4 * face, 4 * face + 4)
        assert (positions[rows] @ normals[4 * face] == 1.0).all()
        assert sorted(map(tuple, uvs[rows].tolist())) == [(0, 0), (0, 1), (1, 0), (1, 1)]
    assert (indices.dtype, len(indices)) == (np.uint16, 36)
