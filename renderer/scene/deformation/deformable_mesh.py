"""A mesh with morph targets, with a skin, or both, and its vertices at a pose, by NumPy in float64.

A vertex is its position plus the weighted offsets of the targets, then the weighted mean of where the joints
take it. Normals are turned by the cofactors of that mean, so they stay normal where it stretches or mirrors.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.scene.arrays import Floats, Indices
from renderer.scene.meshes import vertex_format
from renderer.scene.tangents import TangentGroups

MIRROR_TOLERANCE: Final = 2.0**-18
"""Of the terms of a determinant: a smaller one is rounding, and mirrors nothing."""

_UP: Final = (0.0, 1.0, 0.0)
_SHORTEST: Final = 1e-20  # length of a normal or tangent that has a direction


@dataclass(frozen=True, eq=False)
class DeformableMesh:
    """A mesh with t targets, with a skin, or both.

    Attributes:
        vertices: (v,) of a `vertex_format`, the mesh without targets and joints.
        position_offsets, normal_offsets, tangent_offsets: (t, v, 3), what targets add at weight 1. Those of
            tangents count only if the vertices have tangents.
        joints, joint_weights: (v, 4), the joints of each vertex and their weights, which add up to 1; None
            without a skin.
        tangent_groups: those by which tangents are computed after targets have moved vertices; None where
            the mesh has tangents of its own, or needs none.
    """

    vertices: NDArray[Any]
    position_offsets: NDArray[np.float32]
    normal_offsets: NDArray[np.float32]
    tangent_offsets: NDArray[np.float32]
    joints: Indices | None = None
    joint_weights: Floats | None = None
    tangent_groups: TangentGroups | None = None

    @property
    def has_tangents(self) -> bool:
        """True if its vertices have tangents."""
        return "tangent" in (self.vertices.dtype.names or ())

    @cached_property
    def middle(self) -> NDArray[np.float32]:
        """The middle (3,) of the box of its vertices, without targets and joints."""
        position = self.vertices["position"]
        return np.asarray(0.5 * position.min(0) + 0.5 * position.max(0), np.float32)

    @cached_property
    def relative_offsets(self) -> Floats:
        """The largest offset (t,) of each target at weight 1: of positions in half extents of the mesh, of
        normals and tangents in their unit."""
        extent = float(np.abs(self.vertices["position"] - self.middle).max())
        parts = [(self.position_offsets, extent), (self.normal_offsets, 1.0)]
        if self.has_tangents:
            parts.append((self.tangent_offsets, 1.0))
        with np.errstate(divide="ignore", invalid="ignore"):
            sizes = [np.abs(offsets).max(axis=(1, 2), initial=0.0) / unit for offsets, unit in parts]
        largest: Floats = np.nan_to_num(np.max(sizes, axis=0), nan=0.0, posinf=np.inf)
        return largest

    def deform(self, weights: Floats, matrices: Floats | None) -> NDArray[Any]:
        """Return the vertices (v,) at a pose: of `VERTEX`, with tangents if the mesh has some.

        Args:
            weights: (t,), of the targets.
            matrices: (j, 4, 4), by which joints move points; None without a skin.
        """
        deformed = self.morph(weights)
        if matrices is not None:
            self._skin(deformed, matrices)
        if self.has_tangents:
            _normalize_tangents(deformed["tangent"])
        return deformed

    def morph(self, weights: Floats) -> NDArray[Any]:
        """Return the vertices (v,) with the offsets of targets, before joints move them."""
        source = self.vertices
        morphed = np.zeros(len(source), vertex_format({"tangent"} if self.has_tangents else ()))
        for name in morphed.dtype.names or ():
            morphed[name] = source[name]
        if len(self.position_offsets):
            morphed["position"] += np.tensordot(weights, self.position_offsets, 1)
            moved = source["normal"] + np.tensordot(weights, self.normal_offsets, 1)
            morphed["normal"] = _unit_normals(moved, source["normal"])
            if self.tangent_groups is not None:
                signed = self.tangent_groups.compute(morphed["position"], morphed["normal"])
                morphed["tangent"][self.tangent_groups.corners, :3] = signed[:, :3]
            elif self.has_tangents:
                morphed["tangent"][:, :3] += np.tensordot(weights, self.tangent_offsets, 1)
        return morphed

    def _skin(self, vertices: NDArray[Any], matrices: Floats) -> None:
        """Move vertices by their joints."""
        assert self.joint_weights is not None
        blend = np.einsum("vk,vkij->vij", self.joint_weights, matrices[:, :3][self.joints])
        vertices["position"] = np.einsum("vij,vj->vi", blend[:, :, :3], vertices["position"]) + blend[:, :, 3]
        turned = _turn_normals(blend[:, :, :3], vertices["normal"])
        vertices["normal"] = _unit_normals(turned, vertices["normal"])
        if self.has_tangents:
            tangent = vertices["tangent"]
            along = np.einsum("vij,vj->vi", blend[:, :, :3], tangent[:, :3])
            largest = np.abs(along).max(axis=1, keepdims=True)
            tangent[:, :3] = np.where(
                largest > 0.0, along / np.where(largest > 0.0, largest, 1.0), self.vertices["tangent"][:, :3]
            )
            if any_mirrors(matrices):
                tangent[:, 3] *= np.where(np.linalg.det(blend[:, :, :3]) < 0.0, -1.0, 1.0)


def any_mirrors(matrices: Floats) -> bool:
    """Return whether any of the matrices (j, 4, 4) mirrors."""
    return bool((np.linalg.det(matrices[:, :3, :3]) < 0.0).any())


def _normalize_tangents(tangent: NDArray[Any]) -> None:
    """Give the directions of tangents (v, 4) length 1. Those without a direction are along x."""
    length = np.linalg.norm(tangent[:, :3], axis=1, keepdims=True)
    tangent[:, :3] = np.where(
        length > _SHORTEST, tangent[:, :3] / np.maximum(length, _SHORTEST), (1.0, 0.0, 0.0)
    )


def _unit_normals(normals: NDArray[Any], rest: NDArray[Any]) -> NDArray[Any]:
    """Return normals (v, 3) of length 1. Where they have no direction they are those at `rest`, or upwards."""
    length, rest_length = (np.linalg.norm(array, axis=1, keepdims=True) for array in (normals, rest))
    unit: NDArray[Any] = np.where(rest_length > _SHORTEST, rest / np.maximum(rest_length, _SHORTEST), _UP)
    return np.where(length > _SHORTEST, normals / np.maximum(length, _SHORTEST), unit)


def _turn_normals(blend: Floats, normals: NDArray[Any]) -> Floats:
    """Return normals (v, 3) turned as `blend` (v, 3, 3) moves points: by its cofactors, up to their length."""
    a, b, c = blend.transpose(2, 1, 0).copy()  # columns, (3, v)
    x, y, z = _cross(b, c), _cross(c, a), _cross(a, b)
    turned = x * normals[:, 0] + y * normals[:, 1] + z * normals[:, 2]
    largest = np.abs(turned).max(axis=0)  # with its sign where the matrix mirrors
    terms = a * x  # their sum is the determinant, whose rounding is no mirror
    largest[terms.sum(axis=0) < -MIRROR_TOLERANCE * np.abs(terms).sum(axis=0)] *= -1.0
    directions: Floats = turned / np.where(largest == 0.0, 1.0, largest)
    return directions.T


def _cross(first: Floats, second: Floats) -> Floats:
    """Return the cross products (3, v) of vectors; `numpy.cross` takes several times as long."""
    (a, b, c), (x, y, z) = first, second
    return np.stack([b * z - c * y, c * x - a * z, a * y - b * x])
