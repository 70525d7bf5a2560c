"""Deformable meshes on a device, and the dispatch that writes the vertices of those that are due.

What never changes is uploaded once, at the first dispatch. In each frame follow the joints' matrices and the
weights of active targets. Offsets are added by NumPy where float32 or the device's memory isn't enough for
them: huge weights that cancel, and tangents that follow from all triangles around. The device then moves
these vertices by their joints as any others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.scene.arrays import Floats, Indices, list_ranges
from renderer.scene.deformation.deformable_mesh import DeformableMesh, any_mirrors
from renderer.scene.deformation.deformation_kernels import (
    LANES,
    MAX_GROUPS,
    ActiveTarget,
    DeformationGroup,
    DeformationLayout,
    DeformedMember,
    DeformVertices,
    Influence,
    RestVertex,
)
from rhi import Device, StorageBuffer
from rhi.math.indexing import reduce_runs, repeat_each
from rhi.shading import vec4

_LARGEST_SUM: Final = 32.0
"""The most that active targets may add, times their number, in half extents of the mesh: float32 sums are then
within 2^-19 of it."""
_LARGEST_FACTOR: Final = (
    1e20  # of a weight, and of an offset: their products are neither infinite nor denormal
)
_LARGEST_ELEMENT: Final = 1e36
_MOST_FLOATS: Final = 1 << 25  # of offsets on a device: 128 MiB, which each WebGPU device can bind


@dataclass(frozen=True, eq=False, slots=True)
class Pose:
    """The pose of a member: the weights (t,) of its targets, and the matrices (j, 4, 4) of its joints, or None
    without a skin. Members with the same joints share the array."""

    weights: Floats
    matrices: Floats | None


class DeformationBuffers:
    """Deformable meshes on a device.

    Attributes:
        device: the device.
        morphed_by_numpy: how many members had their targets added by NumPy so far.
    """

    def __init__(self, device: Device, meshes: Sequence[DeformableMesh]) -> None:
        """Upload meshes."""
        self.device = device
        self.morphed_by_numpy = 0
        self._meshes = tuple(meshes)
        counts = np.array([len(mesh.vertices) for mesh in meshes], np.int64)
        self._counts: Indices = counts
        self._rest_begins: Indices = np.cumsum(counts) - counts
        self._is_morphed = np.zeros(len(meshes), bool)  # whose vertices at rest have offsets already
        vertices = [_pack_rest(mesh, mesh.vertices) for mesh in meshes]
        self._rest = device.storage(RestVertex, np.concatenate(vertices), label="vertices at rest")
        packed = [_pack_influences(mesh) for mesh in meshes]
        self._influence_strides: Indices = np.array([part.shape[1] for part in packed], np.int64)
        sizes = np.array([part.size for part in packed], np.int64)
        self._influence_begins: Indices = np.where(sizes > 0, np.cumsum(sizes) - sizes, -1)
        self._group_influences = [_count_influences(part) for part in packed]
        influences = np.concatenate([*(part.reshape(-1) for part in packed), np.zeros(1, Influence.dtype)])
        self._influences = device.storage(Influence, influences, label="joints of vertices")
        self._strides: Indices = np.array([9 if mesh.has_tangents else 6 for mesh in meshes], np.int64)
        self._offset_begins: Indices = np.full(len(meshes), -1, np.int64)  # -1: NumPy adds offsets
        offsets: list[NDArray[np.float32]] = []
        total = 0
        for number, mesh in enumerate(meshes):
            size = len(mesh.position_offsets) * len(mesh.vertices) * int(self._strides[number])
            if size and mesh.tangent_groups is None and total + size <= _MOST_FLOATS:
                self._offset_begins[number] = total
                offsets.append(_pack_offsets(mesh))
                total += size
        self._offsets = device.storage(
            float, np.concatenate(offsets or [np.zeros(1, np.float32)]), label="offsets of targets"
        )

    def run(
        self,
        members: Indices,
        poses: Sequence[Pose],
        vertices: StorageBuffer[float],
        first_vertices: Indices,
        stride: int,
        tangent: int,
    ) -> None:
        """Write the vertices of `members` (j,) at their poses.

        Args:
            vertices: what is drawn.
            first_vertices: (j,), the number of each member's first vertex in it.
            stride: floats from vertex to vertex.
            tangent: floats from the begin of a vertex to its tangent; negative if vertices have none.
        """
        table: Any = np.zeros(len(members), DeformedMember.dtype)
        table["rest"], table["count"] = self._rest_begins[members], self._counts[members]
        table["influence"], table["offset_stride"] = self._influence_begins[members], self._strides[members]
        table["influence_stride"] = self._influence_strides[members]
        table["vertex"] = stride * first_vertices
        matrices = _MatrixTable()
        targets: list[NDArray[Any]] = []
        for row, (member, pose) in enumerate(zip(members.tolist(), poses, strict=True)):
            mesh = self._meshes[member]
            if pose.matrices is not None:
                table["matrix"][row], table["mirrors"][row] = matrices.add(pose.matrices, mesh.middle)
            targets.append(self._select_targets(member, pose.weights))
        target_counts = [len(active) for active in targets]
        table["targets_end"] = np.cumsum(target_counts)
        table["targets_begin"] = table["targets_end"] - target_counts
        layout = DeformationLayout(stride=stride, tangent=tangent)
        self._dispatch(members, table, matrices.rows, np.concatenate(targets), vertices, layout)

    def _select_targets(self, member: int, weights: Floats) -> NDArray[Any]:
        """Return the targets (k,) of `ActiveTarget` that the device adds; NumPy has added any others."""
        mesh = self._meshes[member]
        active = np.flatnonzero(weights)
        if len(active) and not self._is_summable(member, weights[active], mesh.relative_offsets[active]):
            self._write_rest(member, mesh.morph(weights))
            self._is_morphed[member] = True
            self.morphed_by_numpy += 1
            active = active[:0]
        elif self._is_morphed[member]:
            self._write_rest(member, mesh.vertices)
            self._is_morphed[member] = False
        selected: Any = np.zeros(len(active), ActiveTarget.dtype)
        selected["first"] = self._offset_begins[member] + active * (
            self._counts[member] * self._strides[member]
        )
        selected["weight"] = weights[active]
        return np.asarray(selected)

    def _is_summable(self, member: int, weights: Floats, sizes: Floats) -> bool:
        """Return whether float32 is enough for the sum of active targets."""
        if self._offset_begins[member] < 0 or max(np.abs(weights).max(), sizes.max()) > _LARGEST_FACTOR:
            return False
        return bool(len(weights) * (np.abs(weights) @ sizes) <= _LARGEST_SUM)

    def _write_rest(self, member: int, vertices: NDArray[Any]) -> None:
        self._rest.write(_pack_rest(self._meshes[member], vertices), int(self._rest_begins[member]))

    def _dispatch(
        self,
        members: Indices,
        table: NDArray[Any],
        matrices: NDArray[np.float32],
        targets: NDArray[Any],
        vertices: StorageBuffer[float],
        layout: DeformationLayout,
    ) -> None:
        group_counts = -(-table["count"].astype(np.int64) // LANES)
        groups: Any = np.zeros(int(group_counts.sum()), DeformationGroup.dtype)
        groups["member"] = repeat_each(np.arange(len(table)), group_counts)
        groups["first"] = LANES * list_ranges(np.zeros_like(group_counts), group_counts)
        groups["influences"] = np.concatenate([self._group_influences[member] for member in members.tolist()])
        transient, program = self.device.transient, self.device.program(DeformVertices)
        bindings: dict[str, Any] = {
            "rest": self._rest,
            "influences": self._influences,
            "offsets": self._offsets,
            "targets": transient.storage(
                ActiveTarget, targets if len(targets) else np.zeros(1, targets.dtype)
            ),
            "matrices": transient.storage(vec4, matrices),
            "members": transient.storage(DeformedMember, table),
            "vertices": vertices,
        }
        for first in range(0, len(groups), MAX_GROUPS):
            part = groups[first : first + MAX_GROUPS]
            self.device.dispatch(
                program,
                len(part),
                layout=layout,
                groups=transient.storage(DeformationGroup, part),
                **bindings,
            )

    def destroy(self) -> None:
        """Destroy the buffers."""
        for buffer in (self._rest, self._influences, self._offsets):
            buffer.destroy()


class _MatrixTable:
    """The rows of the joints' matrices of a dispatch; members with the same joints and middle share them."""

    def __init__(self) -> None:
        self._parts: list[NDArray[np.float32]] = []
        self._count = 0
        self._first_rows: dict[tuple[int, bytes], tuple[int, bool]] = {}

    def add(self, matrices: Floats, middle: NDArray[np.float32]) -> tuple[int, bool]:
        """Return the first row of matrices (j, 4, 4) that move points relative to `middle`, and whether any of
        them mirrors."""
        key = (id(matrices), middle.tobytes())
        if key not in self._first_rows:
            rows = matrices[:, :3].copy()
            rows[:, :, 3] += matrices[:, :3, :3] @ middle.astype(np.float64)
            self._first_rows[key] = (self._count, any_mirrors(matrices))
            finite = np.clip(rows, -_LARGEST_ELEMENT, _LARGEST_ELEMENT)  # else a weight of 0 makes it NaN
            self._parts.append(finite.reshape(-1, 4).astype(np.float32))
            self._count += 3 * len(matrices)
        return self._first_rows[key]

    @property
    def rows(self) -> NDArray[np.float32]:
        """All rows (k, 4), at least one."""
        return np.concatenate(self._parts or [np.zeros((1, 4), np.float32)])


def _pack_rest(mesh: DeformableMesh, vertices: NDArray[Any]) -> NDArray[Any]:
    """Return vertices as the device has them, of skins relative to the middle of the mesh."""
    packed: Any = np.zeros(len(vertices), RestVertex.dtype)
    packed["position"], packed["normal"] = vertices["position"], vertices["normal"]
    if mesh.joints is not None:
        packed["position"] -= mesh.middle
    if mesh.has_tangents:
        packed["tangent"], packed["sign"] = vertices["tangent"][:, :3], vertices["tangent"][:, 3]
    else:
        packed["tangent"], packed["sign"] = (1.0, 0.0, 0.0), 1.0
    return np.asarray(packed)


def _pack_influences(mesh: DeformableMesh) -> NDArray[Any]:
    """Return the influences (v, k) of vertices, the largest first; k = 0 without a skin."""
    if mesh.joints is None or mesh.joint_weights is None:
        return np.zeros((len(mesh.vertices), 0), Influence.dtype)
    order = np.argsort(-mesh.joint_weights, axis=1, kind="stable")
    weights = np.take_along_axis(mesh.joint_weights, order, axis=1)
    most = max(int((weights > 0.0).sum(axis=1).max()), 1)
    packed: Any = np.zeros((len(weights), most), Influence.dtype)
    packed["joint"] = np.take_along_axis(mesh.joints, order, axis=1)[:, :most]
    packed["weight"] = weights[:, :most]
    return np.asarray(packed)


def _count_influences(influences: NDArray[Any]) -> Indices:
    """Return the most influences of a vertex in each group of vertices."""
    counts = (influences["weight"] > 0.0).sum(axis=1)
    return reduce_runs(np.maximum, counts, np.arange(0, len(counts), LANES))


def _pack_offsets(mesh: DeformableMesh) -> NDArray[np.float32]:
    """Return the offsets of all targets, those of a vertex together."""
    parts = [mesh.position_offsets, mesh.normal_offsets]
    if mesh.has_tangents:
        parts.append(mesh.tangent_offsets)
    return np.concatenate(parts, axis=2).astype(np.float32).reshape(-1)
