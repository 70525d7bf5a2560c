"""Skins and morph targets: meshes whose vertices are computed where they are drawn.

How vertices follow weights and joints is the matter of `renderer.scene.deformation`; here are the nodes, tracks
and skins of a file that say where those are. Vertices of a skin are relative to the nearest node above all
joints that never moves, and that is where the object is placed; glTF ignores the mesh's own node.

Both have bounds that hold at all times. A skinned vertex lies between the points where its joints take it, so
it is within the boxes that these sweep; an offset vertex is between the extremes of each weight. Normals are
turned with the vertices; tangents stay as they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.content.gltf.accessors import Accessors
from renderer.content.gltf.document import JsonObject
from renderer.content.gltf.nodes import GltfNode
from renderer.content.gltf.primitives import PrimitiveMesh
from renderer.content.gltf.tracks import NodeMotion, PropertyTracks, Track
from renderer.scene.arrays import Floats, Indices
from renderer.scene.catch_up import Recompute
from renderer.scene.clips import Clips
from renderer.scene.deformation import DeformableMesh, DeformationBuffers, Pose
from renderer.scene.meshes import VERTEX, MeshBounds, MeshGeometry
from renderer.scene.tangents import add_stretch, split_by_tangents
from rhi import Device, StorageBuffer
from rhi.math import multiply, transform_bounds

TARGET_ATTRIBUTES: Final = frozenset(("POSITION", "NORMAL", "TANGENT"))
"""The attributes that morph targets move."""

_FIRST: Final = np.zeros(1, np.int64)
_ROUNDING: Final = 2.0**-18  # of the largest coordinate: vertices are computed in float32


@dataclass(frozen=True, eq=False, slots=True)
class NodeTree:
    """The nodes of a file with their motion.

    Attributes:
        nodes: all nodes, parents first.
        member: for each node its number in the motion, or -1.
        moves: whether each node is animated, or below one that is.
        motion: the motion of the animated nodes, or None.
    """

    nodes: list[GltfNode]
    member: Indices
    moves: NDArray[np.bool_]
    motion: NodeMotion | None

    @classmethod
    def make(cls, nodes: list[GltfNode], animated: tuple[Indices, NodeMotion] | None) -> NodeTree:
        """Create the tree of `nodes`, given the rows of those that are animated and their motion."""
        member = np.full(len(nodes), -1)
        if animated is not None:
            member[animated[0]] = np.arange(len(animated[0]))
        moves = member >= 0
        for row, node in enumerate(nodes):  # parents come first
            moves[row] |= node.parent >= 0 and moves[node.parent]
        return cls(nodes, member, moves, None if animated is None else animated[1])

    def chain(self, row: int) -> list[int]:
        """Return a node and all above it, from the root downwards."""
        ancestors = []
        while row >= 0:
            ancestors.append(row)
            row = self.nodes[row].parent
        return ancestors[::-1]

    def common_anchor(self, rows: Sequence[int]) -> int:
        """Return the deepest node that is above or at all `rows` and never moves, or -1."""
        chains = [self.chain(row) for row in rows]
        anchor = -1
        for level in zip(*chains, strict=False):
            if len(set(level)) > 1 or self.member[level[0]] >= 0:
                break
            anchor = level[0]
        return anchor

    def sweep(self, row: int, anchor: int, box: MeshBounds) -> MeshBounds:
        """Return a box in the space of `anchor` that holds at all times a box in the space of the node
        `row`."""
        while row != anchor:
            if self.motion is not None and self.member[row] >= 0:
                box = self.motion.reach(int(self.member[row]), *box)
            else:
                low, high = transform_bounds(self.nodes[row].local[None], box[0][None], box[1][None])
                box = (low[0], high[0])
            row = self.nodes[row].parent
        return box

    def compute_bounds(self, contents: Sequence[tuple[int, MeshBounds]]) -> MeshBounds:
        """Return the boxes (k, 3) that hold at all times what is at the animated nodes, down to the next
        ones.

        They are in the space of the first node above that isn't animated. `contents` are boxes, each at a
        node.
        """
        boxes_of_nodes: dict[int, list[MeshBounds]] = {}
        for row, box in contents:
            if self.moves[row]:
                nearest = row
                while self.member[nearest] < 0:
                    nearest = self.nodes[nearest].parent
                boxes_of_nodes.setdefault(nearest, []).append(self.sweep(row, nearest, box))
        count = int(self.member.max()) + 1
        lower, upper = np.zeros((count, 3)), np.zeros((count, 3))
        for row, boxes in boxes_of_nodes.items():
            above = row
            while above >= 0 and self.moves[above]:
                above = self.nodes[above].parent
            union = (np.min([low for low, _ in boxes], axis=0), np.max([high for _, high in boxes], axis=0))
            lower[self.member[row]], upper[self.member[row]] = self.sweep(row, above, union)
        return lower, upper


class Skeleton:
    """The joints of a skin: matrices from the mesh, where it was bound, to the space of the `anchor`."""

    def __init__(self, tree: NodeTree, joints: list[int], inverse_bind_matrices: Floats) -> None:
        self.tree = tree
        self.joints = joints
        self.inverse_bind_matrices = inverse_bind_matrices
        self.anchor = tree.common_anchor(joints)
        below = {row for joint in joints for row in tree.chain(joint)} - set(tree.chain(self.anchor))
        rows = sorted(below)
        at = {row: number for number, row in enumerate(rows)}
        self.parents: Indices = np.array([at.get(tree.nodes[row].parent, -1) for row in rows], np.int64)
        self.rest: Floats = np.array([tree.nodes[row].local for row in rows]).reshape(-1, 4, 4)
        self.joint_rows: Indices = np.array([at.get(joint, -1) for joint in joints], np.int64)
        self.members: Indices = tree.member[rows]
        self._alone = JointTable([self])
        self._cache_key = (np.nan, 0)  # for a time and a version of the clips
        self._cached: Floats = inverse_bind_matrices

    @property
    def moves(self) -> bool:
        """True if any joint is animated."""
        return bool((self.members >= 0).any())

    def matrices(self, seconds: float) -> Floats:
        """Return the matrices (j, 4, 4) of all joints at a time; the same array as long as it is the same time."""
        if not self.is_at(seconds):
            self._alone.compute(seconds)
        return self._cached

    def is_at(self, seconds: float) -> bool:
        """Return whether `matrices` are known for a time."""
        return self._cache_key == self._key(seconds)

    def store(self, seconds: float, matrices: Floats) -> None:
        """Keep the matrices of a time."""
        self._cached, self._cache_key = matrices, self._key(seconds)

    def _key(self, seconds: float) -> tuple[float, int]:
        return seconds, 0 if self.tree.motion is None else self.tree.motion.version


class JointTable:
    """The joints of several skeletons of a file, in one table: all of them are computed at once, level by
    level."""

    def __init__(self, skeletons: Sequence[Skeleton]) -> None:
        self.skeletons = tuple(skeletons)
        counts = np.array([len(skeleton.parents) for skeleton in skeletons], np.int64)
        begins = np.cumsum(counts) - counts
        self._locals = np.concatenate([skeleton.rest for skeleton in skeletons])
        self._levels = _list_levels(_shift([skeleton.parents for skeleton in skeletons], begins))
        self._joint_rows = _shift([skeleton.joint_rows for skeleton in skeletons], begins)
        self._binds = np.concatenate([skeleton.inverse_bind_matrices for skeleton in skeletons])
        self._ends = np.cumsum([len(skeleton.joints) for skeleton in skeletons])
        members = np.concatenate([skeleton.members for skeleton in skeletons])
        self._moving: Indices = np.flatnonzero(members >= 0)
        self._members: Indices = members[self._moving]
        self._motion = skeletons[0].tree.motion

    def compute(self, seconds: float) -> None:
        """Bring the matrices of all skeletons to a time."""
        if self._motion is not None and len(self._members):
            self._motion.set_time(self._members, seconds)
            self._locals[self._moving] = self._motion.transforms(self._members)
        worlds = np.zeros((len(self._locals) + 1, 4, 4))
        worlds[-1] = np.eye(4)
        for level, parents in self._levels:
            worlds[level] = multiply(worlds[parents], self._locals[level])
        matrices = multiply(worlds[self._joint_rows], self._binds)
        for skeleton, part in zip(self.skeletons, np.split(matrices, self._ends[:-1]), strict=True):
            skeleton.store(seconds, part)


def _shift(parts: Sequence[Indices], begins: Indices) -> Indices:
    """Return indices of several tables for the joined one; -1 stays."""
    shifted: Indices = np.concatenate(
        [np.where(part >= 0, part + begin, -1) for part, begin in zip(parts, begins.tolist(), strict=True)]
    )
    return shifted


def _list_levels(parents: Indices) -> list[tuple[Indices, Indices]]:
    """Return the rows of each level of a hierarchy, and their parents; -1 is above the first level."""
    depth = np.zeros(len(parents), np.int64)
    for row, parent in enumerate(parents.tolist()):  # parents come first
        depth[row] = depth[parent] + 1 if parent >= 0 else 0
    levels = [np.flatnonzero(depth == number) for number in range(int(depth.max(initial=-1)) + 1)]
    return [(level, parents[level]) for level in levels]


@dataclass(frozen=True, eq=False, slots=True)
class DeformedMesh:
    """A mesh with targets, with a skin, or both, as a file animates it.

    Attributes:
        geometry: the mesh as it stands in the file.
        shape: its vertices with targets and joints.
        weights: the targets' weights, with the tracks that animate them.
        skeleton: the joints' transforms; None without a skin.
    """

    geometry: MeshGeometry
    shape: DeformableMesh
    weights: PropertyTracks
    skeleton: Skeleton | None

    @property
    def is_animated(self) -> bool:
        """True if it changes with time."""
        return bool(self.weights.list_tracks(0)) or (self.skeleton is not None and self.skeleton.moves)

    def pose(self, seconds: float) -> Pose:
        """Return the weights of its targets and the matrices of its joints at a time."""
        matrices = None if self.skeleton is None else self.skeleton.matrices(seconds)
        return Pose(self.weights.evaluate(_FIRST, seconds)[0], matrices)

    def vertices(self, seconds: float) -> NDArray[Any]:
        """Return the vertices (v,) at a time: of `VERTEX`, with tangents if the mesh has some."""
        pose = self.pose(seconds)
        return self.shape.deform(pose.weights, pose.matrices)

    def bounds(self) -> MeshBounds:
        """Return a box that holds all vertices at all times."""
        shape = self.shape
        position = self.geometry.vertices["position"].astype(np.float64)
        least, most = self.weights.value_bounds(0)
        ends = np.stack(
            [least[:, None, None] * shape.position_offsets, most[:, None, None] * shape.position_offsets]
        )
        low, high = position + ends.min(0).sum(0), position + ends.max(0).sum(0)
        boxes: list[MeshBounds] = []
        if self.skeleton is None or shape.joints is None or shape.joint_weights is None:
            boxes.append((low.min(0), high.max(0)))
        else:
            for number, joint in enumerate(self.skeleton.joints):
                is_moved = ((shape.joints == number) & (shape.joint_weights > 0.0)).any(1)
                if is_moved.any():
                    corners = low[is_moved].min(0)[None], high[is_moved].max(0)[None]
                    below, above = transform_bounds(
                        self.skeleton.inverse_bind_matrices[number][None], *corners
                    )
                    boxes.append(self.skeleton.tree.sweep(joint, self.skeleton.anchor, (below[0], above[0])))
        lower, upper = np.min([box[0] for box in boxes], axis=0), np.max([box[1] for box in boxes], axis=0)
        slack = _ROUNDING * max(float(np.abs([lower, upper]).max()), 1e-30)
        return lower - slack, upper + slack


class Deformations:
    """The deformed meshes of a file: a simulation for `SceneBuilder.simulate`."""

    catch_up: Final = Recompute()

    def __init__(self, meshes: Sequence[DeformedMesh], clips: Clips) -> None:
        self.meshes, self._clips = tuple(meshes), clips
        self._seconds = np.zeros(len(meshes))
        self._buffers: DeformationBuffers | None = None
        self._table: JointTable | None = None  # of the skeletons that the last frame drew

    @property
    def version(self) -> int:
        """The version of the clips."""
        return self._clips.version

    def __deepcopy__(self, memo: object) -> Deformations:
        """Return a copy with times of its own; the meshes never change, and the clips are the scene's."""
        duplicate = copy(self)
        duplicate._seconds, duplicate._buffers, duplicate._table = self._seconds.copy(), None, None
        return duplicate

    def set_time(self, members: Indices, seconds: float) -> None:
        """Set the time of `members` (j,)."""
        self._seconds[members] = seconds

    def vertices(self, members: Indices) -> NDArray[Any]:
        """Return the present vertices of `members` (j,), one after another: of `VERTEX`, with tangents if
        any of the meshes has some."""
        self._pose_skeletons(members)
        parts = [self.meshes[member].vertices(self._seconds[member]) for member in members.tolist()]
        if len({part.dtype for part in parts}) > 1:
            indices = np.zeros(3, np.uint32)
            parts = [MeshGeometry(part, indices).with_attributes({"tangent"}).vertices for part in parts]
        return np.concatenate(parts or [np.zeros(0, VERTEX)])

    def deform(
        self,
        device: Device,
        members: Indices,
        vertices: StorageBuffer[float],
        first_vertices: Indices,
        stride: int,
        tangent: int = -1,
    ) -> None:
        """Write the present vertices of `members` (j,), in one dispatch.

        Args:
            vertices: what is drawn.
            first_vertices: (j,), the number of each member's first vertex in it.
            stride: floats from vertex to vertex.
            tangent: floats from the begin of a vertex to its tangent; negative if vertices have none.
        """
        if self._buffers is None or self._buffers.device is not device:
            if self._buffers is not None:
                self._buffers.destroy()
            self._buffers = DeformationBuffers(device, [mesh.shape for mesh in self.meshes])
        self._pose_skeletons(members)
        poses = [self.meshes[member].pose(self._seconds[member]) for member in members.tolist()]
        self._buffers.run(members, poses, vertices, first_vertices, stride, tangent)

    def _pose_skeletons(self, members: Indices) -> None:
        """Compute the joints of all `members` (j,) at once, if they are at the same time."""
        seconds = np.unique(self._seconds[members]).tolist()
        skeletons = dict.fromkeys(
            skeleton
            for member in members.tolist()
            if (skeleton := self.meshes[member].skeleton) is not None and not skeleton.is_at(seconds[0])
        )
        if len(seconds) == 1 and len(skeletons) > 1:
            if self._table is None or self._table.skeletons != tuple(skeletons):
                self._table = JointTable(list(skeletons))
            self._table.compute(seconds[0])

    def release(self, device: Device) -> None:
        """Destroy what is on this device, if anything is."""
        if self._buffers is not None and self._buffers.device is device:
            self._buffers.destroy()
            self._buffers = None


def read_skins(root: JsonObject, accessors: Accessors, tree: NodeTree) -> list[Skeleton | None]:
    """Return the skeletons of the file's skins; None for one whose joints aren't in the scene."""
    row_of = {node.number: row for row, node in enumerate(tree.nodes)}
    count = root.length("nodes")
    skeletons: list[Skeleton | None] = []
    for skin in root.children("skins"):
        joints = skin.indices("joints", count)
        if not joints:
            skin.refuse("joints", "none", "one or more nodes")
        number = skin.index("inverseBindMatrices", len(accessors))
        inverse_bind_matrices = np.tile(np.eye(4), (len(joints), 1, 1))
        if number >= 0:
            matrices = accessors.floats(number, "MAT4").astype(np.float64)
            if len(matrices) < len(joints) or not (np.abs(matrices) <= 1e30).all():
                accessors.fields[number].refuse("", f"{len(matrices)} matrices", f"{len(joints)} finite ones")
            inverse_bind_matrices = matrices[: len(joints)].reshape(-1, 4, 4).transpose(0, 2, 1).copy()
            inverse_bind_matrices[:, 3] = (0.0, 0.0, 0.0, 1.0)
        is_here = all(joint in row_of for joint in joints)
        skeletons.append(
            Skeleton(tree, [row_of[joint] for joint in joints], inverse_bind_matrices) if is_here else None
        )
    return skeletons


def read_deformed(
    primitive: JsonObject,
    mesh: PrimitiveMesh,
    accessors: Accessors,
    weights: Floats,
    tracks: Sequence[Track],
    clips: Clips,
    skeleton: Skeleton | None,
    normal_map_uv: str = "",
) -> DeformedMesh:
    """Return a primitive as it is deformed at a node.

    Args:
        normal_map_uv: the set of texture coordinates of its material's normal map, or "" without one.
        weights: those of the targets (t,), as the node or the mesh has them.
        tracks: those of the weights, of `clips`.
        skeleton: that of the node's skin, or None.
    """
    targets = primitive.children("targets")
    if {len(weights), *(track.values.shape[-1] for track in tracks)} - {len(targets)}:
        primitive.refuse("targets", f"{len(targets)} targets", "as many as weights")
    groups = None
    if normal_map_uv and "tangent" not in mesh.geometry.attributes:
        geometry, sources, groups = split_by_tangents(mesh.geometry, normal_map_uv)
        mesh = PrimitiveMesh(geometry, mesh.vertex_indices[sources])
    if normal_map_uv:
        mesh = replace(mesh, geometry=add_stretch(mesh.geometry, normal_map_uv))
    offsets = np.zeros((len(targets), len(mesh.vertex_indices), 3), np.float32)
    turns, tangents = np.zeros_like(offsets), np.zeros_like(offsets)
    for number, target in enumerate(targets):
        for name, changed in (("POSITION", offsets), ("NORMAL", turns), ("TANGENT", tangents)):
            index = target.index(name, len(accessors))
            if index >= 0:
                differences = accessors.floats(index, "VEC3")
                last = int(mesh.vertex_indices.max())
                if len(differences) <= last:
                    target.refuse(name, f"{len(differences)} offsets", f"one for each of {last + 1} vertices")
                if not (np.abs(differences) <= 1e30).all():
                    largest = np.abs(differences).max()
                    target.refuse(name, f"an offset of {largest:g}", "numbers from -1e30 to 1e30")
                changed[number] = differences[mesh.vertex_indices]
    moved = PropertyTracks(tracks, np.zeros(len(tracks), np.int64), weights[None], clips)
    joints, shares = (None, None) if skeleton is None else _read_joints(primitive, mesh, accessors, skeleton)
    shape = DeformableMesh(
        mesh.geometry.vertices, offsets, turns, tangents, joints, shares, groups if targets else None
    )
    return DeformedMesh(mesh.geometry, shape, moved, skeleton)


def _read_joints(
    primitive: JsonObject, mesh: PrimitiveMesh, accessors: Accessors, skeleton: Skeleton
) -> tuple[Indices, Floats]:
    attributes = primitive.child("attributes")
    count = len(accessors)
    joints = accessors.array(attributes.index("JOINTS_0", count, required=True), "VEC4", "u").astype(np.int64)
    shares = accessors.floats(attributes.index("WEIGHTS_0", count, required=True), "VEC4").astype(np.float64)
    last = int(mesh.vertex_indices.max())
    if len(joints) <= last or len(shares) <= last:
        attributes.refuse("JOINTS_0", f"{min(len(joints), len(shares))} vertices", f"{last + 1} or more")
    joints, shares = joints[mesh.vertex_indices], shares[mesh.vertex_indices]
    finite = np.isfinite(shares).all(axis=1)
    if not finite.all():
        worst = int(mesh.vertex_indices[np.argmin(finite)])
        attributes.refuse(
            "WEIGHTS_0", f"vertex {worst} is {shares[np.argmin(finite)].tolist()}", "finite numbers"
        )
    if joints.max() >= len(skeleton.joints):
        attributes.refuse("JOINTS_0", f"joint {joints.max()}", f"0 to {len(skeleton.joints) - 1}")
    shares = np.maximum(shares, 0.0)
    total = shares.sum(1, keepdims=True)
    shares = np.where(total > 0.0, shares / np.where(total > 0.0, total, 1.0), (1.0, 0.0, 0.0, 0.0))
    return joints, shares
