"""Primitives of glTF as meshes of the renderer: triangles, and the solids that points and lines become
(`renderer.content.gltf.solids`).

Two primitives with the same accessors are one mesh, whatever their materials. A primitive that uses less than
half of the vertices of its accessors, as when many share one array, gets a copy of those that it uses.
Missing normals are flat, as glTF demands; single ones that aren't directions are computed from the triangles
around them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer import rules
from renderer.content.gltf.accessors import Accessors
from renderer.content.gltf.container import EXPORT_TIP
from renderer.content.gltf.document import JsonObject
from renderer.content.gltf.solids import LINES, POINT, SEGMENT, Solid, list_ends
from renderer.scene.arrays import Floats, Indices
from renderer.scene.meshes import VERTEX, MeshGeometry, compute_normals, vertex_format
from renderer.scene.omissions import Omissions
from rhi.errors import refuse

TRIANGLES: Final = 4
_STRIP: Final = 5

ATTRIBUTES: Final = {
    "POSITION": ("position", ("VEC3",)),
    "NORMAL": ("normal", ("VEC3",)),
    "TEXCOORD_0": ("uv", ("VEC2",)),
    "TEXCOORD_1": ("uv2", ("VEC2",)),
    "TANGENT": ("tangent", ("VEC4",)),
    "COLOR_0": ("color", ("VEC4", "VEC3")),
}
"""Attributes of glTF, the fields of vertices that they are read into, and the types that they may have."""
_UNIT: Final = 1e-4  # deviation of a squared length from 1 beyond which a normal is normalised


@dataclass(frozen=True, eq=False, slots=True)
class PrimitiveMesh:
    """A primitive's triangles, and the `vertex_indices` (v,) of its accessors that its vertices were read
    from."""

    geometry: MeshGeometry
    vertex_indices: Indices


class Primitives:
    """Reads primitives, each set of accessors once.

    Attributes:
        accessors: those of the file.
        omissions: what was left out.
    """

    def __init__(self, accessors: Accessors, omissions: Omissions) -> None:
        self.accessors, self.omissions = accessors, omissions
        self._shapes: dict[object, PrimitiveMesh | None] = {}

    def has_positions(self, primitive: JsonObject) -> bool:
        """Return whether a primitive has positions; one that doesn't is noted as left out."""
        if "POSITION" in primitive.child("attributes"):
            return True
        self.omissions.add("primitives without positions", primitive.where)
        return False

    def is_unlit(self, primitive: JsonObject) -> bool:
        """Return whether a primitive isn't lit, whatever its material: glTF's points and lines without
        normals."""
        return self._mode(primitive) < TRIANGLES and "NORMAL" not in primitive.child("attributes")

    def key(self, primitive: JsonObject) -> object:
        """Return the key of a primitive's triangles: its accessors and its mode."""
        attributes = primitive.child("attributes")
        count = len(self.accessors)
        used = [(name, attributes.index(name, count, required=True)) for name in sorted(attributes.values)]
        return (tuple(used), primitive.index("indices", count), self._mode(primitive))

    def read(self, primitive: JsonObject) -> PrimitiveMesh | None:
        """Return the triangles of a primitive, or None if it has none."""
        key = self.key(primitive)
        if key not in self._shapes:
            self._shapes[key] = self._read(primitive)
        return self._shapes[key]

    def _read(self, primitive: JsonObject) -> PrimitiveMesh | None:
        mode = self._mode(primitive)
        attributes = primitive.child("attributes")
        packed = primitive.extension("KHR_draco_mesh_compression")
        if (
            packed is not None
            and "bufferView" not in self.accessors.fields[self._number(attributes, "POSITION")]
        ):
            packed.refuse(
                "", "only compressed vertices", "accessors with the same vertices, uncompressed", EXPORT_TIP
            )
        for name in sorted(attributes.values.keys() - ATTRIBUTES.keys()):
            if name not in ("JOINTS_0", "WEIGHTS_0"):
                self.omissions.add(f"vertex attribute {name}", attributes.where)
        columns = {
            name: self._column(attributes, name, types)
            for name, (_, types) in ATTRIBUTES.items()
            if name in attributes
        }
        count = len(columns["POSITION"])
        for name, column in columns.items():
            if len(column) != count:
                attributes.refuse(name, f"{len(column)} vertices", f"{count}, as many as positions")
        used = self._corners(primitive, count)
        self.accessors.file.budget.spend("vertices", count + len(used))
        if mode < TRIANGLES:
            return self._make_solids(
                primitive, columns, list_ends(used, mode), SEGMENT if mode >= LINES else POINT
            )
        corners = _list_triangles(used, mode)
        if not len(corners):
            self.omissions.add("primitives without a triangle", primitive.where)
            return None
        if "NORMAL" not in columns:
            columns.pop("TANGENT", None)  # glTF: tangents without normals are ignored
            rows = corners.reshape(-1).astype(np.int64)
            corners = np.arange(len(rows), dtype=np.uint32)
        else:
            rows, corners = _used_vertices(corners.reshape(-1), count)
        return PrimitiveMesh(self._assemble(attributes, columns, rows, corners), rows)

    def _make_solids(
        self,
        primitive: JsonObject,
        columns: dict[str, NDArray[np.float32]],
        ends: NDArray[np.uint32],
        solid: Solid,
    ) -> PrimitiveMesh | None:
        """Return the solids of points or lines with these `ends`, or None if there are none."""
        if not len(ends):
            self.omissions.add("primitives without a line", primitive.where)
            return None
        self.accessors.file.budget.spend("vertices", solid.size * len(ends))
        rows, corners, outward, radius = solid.make_vertices(columns["POSITION"], ends)
        indices = corners.reshape(-1).astype(np.uint32)
        geometry = self._assemble(primitive.child("attributes"), columns, rows, indices, outward, radius)
        return PrimitiveMesh(geometry, rows)

    def _mode(self, primitive: JsonObject) -> int:
        return primitive.whole("mode", TRIANGLES, 0, 6)

    def _column(self, attributes: JsonObject, name: str, types: tuple[str, ...]) -> NDArray[np.float32]:
        return self.accessors.floats(self._number(attributes, name), types)

    def _number(self, attributes: JsonObject, name: str) -> int:
        return attributes.index(name, len(self.accessors), required=True)

    def _corners(self, primitive: JsonObject, count: int) -> NDArray[np.uint32]:
        """Return the indices of a primitive; refuse one that isn't below `count`."""
        number = primitive.index("indices", len(self.accessors))
        if number < 0:
            return np.arange(count, dtype=np.uint32)
        corners = self.accessors.array(number, "SCALAR", "u")
        if int(corners.max()) >= count:
            worst = int(np.argmax(corners >= count))
            self.accessors.fields[number].refuse(
                "", f"element {worst} is index {corners[worst]}", f"0 to {count - 1}"
            )
        return corners.astype(np.uint32)

    def _assemble(
        self,
        attributes: JsonObject,
        columns: dict[str, NDArray[np.float32]],
        rows: Indices,
        corners: NDArray[np.uint32],
        outward: Floats | None = None,
        radius: float = 0.0,
    ) -> MeshGeometry:
        """Return the mesh of the vertices `rows`; vertices of solids are moved `outward` (v, 3) by
        `radius`."""
        position = columns["POSITION"][rows]
        if outward is not None:
            with np.errstate(over="ignore"):
                position = (position + radius * outward).astype(np.float32)
        finite = np.isfinite(position).all(1)
        if not finite.all():
            worst = int(rows[np.argmin(finite)])
            refuse(
                rules.BAD_VERTICES,
                f"load_model({attributes.file!r})",
                f"{attributes.file}: {attributes.path_of('POSITION')}: vertex {worst} is "
                f"{columns['POSITION'][worst]}",
                "finite numbers",
            )
        more = {ATTRIBUTES[name][0] for name in columns} - set(VERTEX.names or ())
        vertices: NDArray[Any] = np.zeros(len(rows), vertex_format(more))
        vertices["position"] = position
        if outward is not None and "NORMAL" not in columns:
            vertices["normal"] = outward
        else:
            vertices["normal"] = self._normals(attributes, columns.get("NORMAL"), rows, position, corners)
        for name, column in columns.items():
            if name not in ("POSITION", "NORMAL"):
                vertices[ATTRIBUTES[name][0]] = self._finite(attributes, name, column[rows])
        return MeshGeometry(vertices, np.ascontiguousarray(corners))

    def _normals(
        self,
        attributes: JsonObject,
        stored: NDArray[np.float32] | None,
        rows: Indices,
        position: NDArray[np.float32],
        corners: NDArray[np.uint32],
    ) -> NDArray[Any]:
        if stored is None:
            return compute_normals(position, corners)
        normals = stored[rows]
        with np.errstate(over="ignore", invalid="ignore"):
            squared = np.einsum("ij,ij->i", normals, normals, dtype=np.float64)
        bad = ~(np.isfinite(squared) & (squared > 1e-12))
        off = ~bad & (np.abs(squared - 1.0) > _UNIT)
        if off.any():
            normals[off] = normals[off] / np.sqrt(squared[off])[:, None]
        if bad.any():
            self.omissions.add("normals that aren't directions", attributes.path_of("NORMAL"), int(bad.sum()))
            normals[bad] = compute_normals(position, corners)[bad]
        return normals

    def _finite(self, attributes: JsonObject, name: str, values: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the values (v, size) of an attribute: 0 where they aren't finite, and colours with alpha."""
        bad = ~np.isfinite(values).all(1)
        if bad.any():
            self.omissions.add(f"{name} that isn't a number", attributes.path_of(name), int(bad.sum()))
            values[bad] = 0.0
        if name == "COLOR_0" and values.shape[1] == 3:
            values = np.concatenate([values, np.ones((len(values), 1), np.float32)], axis=1)
        return values


def _list_triangles(corners: NDArray[np.uint32], mode: int) -> NDArray[np.uint32]:
    """Return the triangles (t, 3) of a list, a strip or a fan; what is left over at the end isn't drawn."""
    count = len(corners)
    if mode == TRIANGLES:
        return corners[: count - count % 3].reshape(-1, 3)
    first = np.arange(max(count - 2, 0))
    if mode == _STRIP:
        odd = first % 2
        return corners[np.stack([first, first + 1 + odd, first + 2 - odd], axis=1)]
    return corners[np.stack([first + 1, first + 2, np.zeros_like(first)], axis=1)]


def _used_vertices(corners: NDArray[np.uint32], count: int) -> tuple[Indices, NDArray[np.uint32]]:
    """Return the rows of the vertices to keep, and the indices of these: all rows, if at least half are
    used."""
    if len(corners) * 2 >= count:
        used = np.zeros(count, bool)
        used[corners] = True
        if used.sum() * 2 >= count:
            return np.arange(count), corners
        rows = np.flatnonzero(used)
        number = np.zeros(count, np.uint32)
        number[rows] = np.arange(len(rows), dtype=np.uint32)
        return rows, number[corners]
    rows, corners_again = np.unique(corners, return_inverse=True)
    return rows.astype(np.int64), corners_again.astype(np.uint32)
