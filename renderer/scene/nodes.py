"""The node hierarchy as arrays, sorted by depth and updated level by level.

Rows are sorted by level when they are made, and stay when a node gets another parent; then an order of rows
is sorted again. The parents of a level precede it, and its world transforms are one multiplication of stacks
of matrices. Only rows that moved, or whose parent moved, are multiplied; a level without such rows is
skipped. A row is static unless it or an ancestor was declared dynamic, and a static row can't move. So
hierarchies over static objects are built once.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from renderer import rules
from renderer.scene.arrays import Floats, read_ids
from rhi.errors import refuse
from rhi.math import is_affine, multiply
from rhi.math.arguments import read_floats

MAX_SCALE: Final = 1e30
"""The largest number in the linear part of a node's transform to the world."""


class Nodes:
    """The parents and the local and world transforms of all nodes.

    Attributes:
        parents: (n,) int32, the rows of the parents, -1 for none.
        local: (n, 4, 4) float64, transforms from node to parent; read-only, changed by `set_local`.
        world: (n, 4, 4) float64, transforms from node to world; read-only, updated by `update`.
        dynamic: (n,) bool, whether a node may move.
        order: (n,) int64, the rows level after level.
        level_starts: (levels + 1,) int64; level l is the entries level_starts[l] to level_starts[l + 1] of
            `order`.
        hidden_itself: (n,) bool, whether a node is hidden by itself; changed by `hide` and `show`.
        hidden: (n,) bool, whether a node or one above it is hidden, as of the last `update`; read-only.
        keeps_parent: (n,) bool, whether a node keeps its parent: bounds that hold at all times are in the
            space above it.
        index_of_id: (n,) int64, the row of each id in the order in which the constructor was given them.
        names: the name of each row; may be empty.
        last_writer: the simulator that has last set transforms; None if something else has.
        version: a number that grows when an `update` has changed transforms.
    """

    def __init__(
        self, parents: ArrayLike, local: ArrayLike, dynamic: ArrayLike = False, names: Sequence[str] = ()
    ) -> None:
        parent_indices = np.asarray(parents, np.int64).reshape(-1)
        count = len(parent_indices)
        matrices = read_floats("Nodes(local=...)", local, rule=rules.BAD_TRANSFORM)
        if matrices.shape != (count, 4, 4) or not is_affine(matrices):
            refuse(rules.BAD_TRANSFORM, "Nodes(local=...)", f"shape {matrices.shape}", f"({count}, 4, 4)")
        if ((parent_indices < -1) | (parent_indices >= np.arange(count))).any():
            refuse(
                rules.BAD_INDEX, "Nodes(parents=...)", "a parent at or after its child", "-1 or an earlier id"
            )
        moves = np.broadcast_to(np.asarray(dynamic, bool), count).copy()

        depth = _depths(parent_indices)
        order = np.argsort(depth, kind="stable")
        self.index_of_id: NDArray[np.int64] = np.empty(count, np.int64)
        self.index_of_id[order] = np.arange(count)
        self._set_parents(np.where(parent_indices < 0, -1, self.index_of_id[parent_indices])[order])
        self.dynamic: NDArray[np.bool_] = moves[order]
        self.names: tuple[str, ...] = tuple(names[i] for i in order) if names else ("",) * count
        self._local: Floats = matrices[order].copy()
        self._world: Floats = self._local.copy()
        self._dirty: NDArray[np.bool_] = np.ones(count, bool)
        self.keeps_parent: NDArray[np.bool_] = np.zeros(count, bool)
        self.hidden_itself: NDArray[np.bool_] = np.zeros(count, bool)
        self._hidden: NDArray[np.bool_] = np.zeros(count, bool)
        self._has_hidden = False  # or shown, since the last update
        self.last_writer: object = None
        self.version = 0
        for level in self._levels()[1:]:
            self.dynamic[level] |= self.dynamic[self.parents[level]]
        for array in (self.dynamic, self.index_of_id):
            array.flags.writeable = False
        self.update()

    def __len__(self) -> int:
        return len(self.parents)

    @property
    def local(self) -> Floats:
        """The transforms from node to parent, (n, 4, 4) float64."""
        return _read_only(self._local)

    @property
    def world(self) -> Floats:
        """The transforms from node to world as of the last update, (n, 4, 4) float64."""
        return _read_only(self._world)

    @property
    def hidden(self) -> NDArray[np.bool_]:
        """The nodes that are hidden or below a hidden node as of the last update, (n,) bool."""
        return _read_only(self._hidden)

    def find(self, name: str) -> int:
        """Return the row of the first node with this name."""
        if name not in self.names:
            rules.refuse_name(rules.UNKNOWN_NODE, "find", name, [n for n in self.names if n][:20])
        return self.names.index(name)

    def set_local(self, indices: ArrayLike, local: ArrayLike) -> None:
        """Set the local transforms (k, 4, 4) or (4, 4) of the dynamic `indices` (k,); `update` applies
        them."""
        node_indices = read_ids("set_local(indices=...)", indices, len(self))
        matrices = read_floats("set_local(local=...)", local, rule=rules.BAD_TRANSFORM)
        if matrices.shape not in ((4, 4), (len(node_indices), 4, 4)) or not is_affine(matrices):
            refuse(rules.BAD_TRANSFORM, "set_local(local=...)", f"shape {matrices.shape}", "(k, 4, 4)")
        self._check_dynamic("set_local", node_indices)
        self._local[node_indices] = matrices
        self._dirty[node_indices] = True
        self.last_writer = None

    def set_parent(self, index: int, parent: int) -> None:
        """Hang a dynamic node, with all that is below it, on another one, -1 for none. It keeps its local
        transform."""
        self._check_dynamic("set_parent", read_ids("set_parent(index=...)", index, len(self)))
        if self.keeps_parent[index]:
            refuse(rules.FIXED_PARENT, "set_parent(index=...)", index)
        above = parent
        while 0 <= above < len(self) and above != index:
            above = int(self.parents[above])
        if above != -1:
            refuse(
                rules.BAD_INDEX,
                "set_parent(parent=...)",
                parent,
                f"-1, or a row that isn't below row {index}",
            )
        parents = self.parents.astype(np.int64)
        parents[index] = parent
        self._set_parents(parents)
        self._dirty[index] = self._has_hidden = True
        self.last_writer = None

    def _set_parents(self, parents: NDArray[np.int64]) -> None:
        """Set the parents of all rows, and sort these by their depth."""
        depth = _depths(parents)
        self.order: NDArray[np.int64] = np.argsort(depth, kind="stable")
        levels = int(depth.max()) + 1 if len(depth) else 0
        self.level_starts: NDArray[np.int64] = np.searchsorted(depth[self.order], np.arange(levels + 1))
        self.parents: NDArray[np.int32] = parents.astype(np.int32)
        self.parents.flags.writeable = False

    def _check_dynamic(self, call: str, indices: NDArray[np.int64]) -> None:
        static = indices[~self.dynamic[indices]]
        if static.size:
            refuse(rules.STATIC_NODE, f"{call}(indices=...)", f"row {static[0]} {self.names[static[0]]!r}")

    def hide(self, indices: ArrayLike) -> None:
        """Hide what is at the nodes `indices` (k,), static or not, and below them; `update` applies it."""
        self.hidden_itself[read_ids("hide(indices=...)", indices, len(self))] = self._has_hidden = True

    def show(self, indices: ArrayLike) -> None:
        """Show what `hide` has hidden at the nodes `indices` (k,). What is below a hidden node stays
        hidden."""
        self.hidden_itself[read_ids("show(indices=...)", indices, len(self))] = False
        self._has_hidden = True

    def update_hidden(self) -> bool:
        """Update which nodes are hidden, and return whether others may be than before."""
        has_changed, self._has_hidden = self._has_hidden, False
        if has_changed:
            self._hidden = self.hidden_itself.copy()
            for level in self._levels()[1:]:
                self._hidden[level] |= self._hidden[self.parents[level]]
        return has_changed

    def update(self) -> NDArray[np.bool_]:
        """Update the world transforms; return which rows changed, (n,) bool.

        Raises:
            ValidationError: `scene-bad-transform`; then no transform has changed, and the next update raises it
                again unless the node has been mended.
        """
        if not np.logical_or.reduce(self._dirty):
            return np.zeros(len(self._dirty), bool)
        changed, replaced = self._dirty.copy(), []
        try:
            for number, level in enumerate(self._levels()):
                if number:
                    changed[level] |= changed[self.parents[level]]
                moved = level[changed[level]]
                if not len(moved):
                    continue
                replaced.append((moved, self._world[moved]))
                if number:
                    self._world[moved] = multiply(self._world[self.parents[moved]], self._local[moved])
                else:
                    self._world[moved] = self._local[moved]
                _check_scales(self._world[moved, :3, :3])
        except BaseException:
            for moved, transforms in replaced:
                self._world[moved] = transforms
            raise
        self._dirty = np.zeros(len(self), bool)
        self.version += 1
        return changed

    @property
    def is_current(self) -> bool:
        """True if nodes are neither moved, hidden nor shown since the last `update` and `update_hidden`."""
        return not (self._has_hidden or 1 in self._dirty.tobytes())  # a quarter of the time of a reduction

    def _levels(self) -> list[NDArray[np.int64]]:
        """Return the rows of each level."""
        return [self.order[start:end] for start, end in pairwise(self.level_starts.tolist())]


def _check_scales(linear: Floats) -> None:
    """Refuse the linear parts (k, 3, 3) of world transforms that float32 can't hold.

    Below 2⁻¹²⁶, devices round coordinates to 0; up to `MAX_SCALE`, that moves no vertex by more than 12 nm.
    """
    largest = max(float(linear.max()), -float(linear.min()))
    if not largest <= MAX_SCALE:  # also if the product of transforms isn't finite
        refuse(
            rules.BAD_TRANSFORM,
            "Nodes.update",
            f"a scale of {largest:g} in the world",
            f"up to {MAX_SCALE:g}",
            tip="scale the vertices of the mesh instead",
        )


def _depths(parents: NDArray[np.int64]) -> NDArray[np.int64]:
    """Compute the depth of each node by pointer doubling: log2(depth) passes over all nodes."""
    depth = (parents >= 0).astype(np.int64)
    ancestor = parents.copy()
    while (ancestor >= 0).any():
        inside = np.flatnonzero(ancestor >= 0)
        above = ancestor[inside]
        depth[inside] += depth[above]
        ancestor[inside] = ancestor[above]
    return depth


def _read_only(array: NDArray[Any]) -> NDArray[Any]:
    view = array.view()
    view.flags.writeable = False
    return view
