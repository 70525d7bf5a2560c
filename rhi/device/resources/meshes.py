"""Meshes: vertex, instance and index arrays, matched by field name to the inputs of a program's vertex stage.

- A mesh's arrays are structured: one field per attribute. A program reads the fields that it names, in
  any order, width and padding; a missing field is refused with both lists.
- `view` returns a part of a mesh (first, count, base vertex, base instance) that shares everything else.
- The vertex array is created once per mesh and program, and shared by views; each view keeps its own prepared draw
  per program (`prepared_draws`). So views are immutable: another part is another view.
- All of these are dropped with the program or the buffer that they were made for (`Timeline.watch`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, TypeAlias
from weakref import WeakSet

import numpy as np
from numpy.typing import NDArray

from rhi.contract.descriptors import (
    DRAW,
    DRAW_UNINDEXED,
    Attribute,
    Id,
    Primitive,
    VertexArrayDescriptor,
    VertexAttribute,
    VertexFormat,
    VertexStream,
)
from rhi.contract.formats import IndexFormat
from rhi.contract.layout import VectorType
from rhi.device.core.core import Core, Owner
from rhi.device.core.interrupts import HeldInterrupts
from rhi.device.resources.buffers import Buffer
from rhi.device.resources.lifetime import Resource
from rhi.errors import Rule
from rhi.errors.rules import DRAW_ARRAY, MESH_ATTRIBUTE, MESH_DATA, MESH_INDEX, MESH_RANGE

__rhi_internal__ = True

VertexSource: TypeAlias = "NDArray[Any] | Mapping[str, NDArray[Any]] | Buffer"
"""Vertices: a structured array, arrays by attribute name, or a buffer with a structured dtype.
(`device.mesh` also accepts a number of vertices without attributes.)"""

_FORMATS: Final = {(f.code, f.components, f.normalized): f for f in VertexFormat}


class MeshData:
    """The buffers of a mesh, shared by its views."""

    __slots__ = ("__weakref__", "buffers", "core", "index_buffer", "index_count", "index_format", "instances", "label",
                 "owned", "vertex_arrays", "vertex_count", "vertices", "views")  # fmt: skip

    def __init__(
        self, core: Core, vertices: VertexSource | int, indices: NDArray[Any] | Buffer | None,
        instances: VertexSource | None, label: str,
    ) -> None:  # fmt: skip
        call = "device.mesh"
        core.check_open()
        # Everything is checked before the first buffer is created, so that a refused call leaves nothing behind.
        if isinstance(vertices, np.integer):
            vertices = int(vertices)
        vertex_array = None if isinstance(vertices, int) else _structured(core, vertices, call)
        if isinstance(vertices, int) and vertices < 1:
            core.refuse(MESH_DATA, call, f"{vertices} vertices", "1 or more")
        self.vertex_count = vertices if isinstance(vertices, int) else _length(vertex_array)
        instance_array = None if instances is None else _structured(core, instances, call)
        index_array = _index_source(core, indices, self.vertex_count, call)
        self.core = core
        self.label = label
        self.owned: list[Buffer] = []
        self.vertices = None if vertex_array is None else self._buffer(vertex_array, f"{label} vertices")
        self.instances = None if instance_array is None else self._buffer(instance_array, f"{label} instances")
        self.index_buffer = None if index_array is None else self._buffer(index_array, f"{label} indices")
        self.index_format = IndexFormat.UINT32
        self.index_count: int | None = None
        if self.index_buffer is not None:
            self.index_format = (
                IndexFormat.UINT16 if self.index_buffer.dtype.itemsize == 2 else IndexFormat.UINT32
            )
            self.index_count = self.index_buffer.count
        self.vertex_arrays: dict[object, Id] = {}
        self.views: WeakSet[Mesh] = WeakSet()
        sources = (self.vertices, self.instances, self.index_buffer)
        self.buffers = tuple(buffer for buffer in sources if buffer is not None)
        for buffer in self.buffers:
            core.timeline.watch(self, buffer.id)

    def _buffer(self, source: NDArray[Any] | Buffer, label: str) -> Buffer:
        if isinstance(source, Buffer):
            return source
        buffer = Buffer(self.core, len(source), source.dtype, label=label.strip())
        self.owned.append(buffer)
        buffer.write(source)
        return buffer

    def create_vertex_array(
        self, key: object, program: Id, name: str, attributes: tuple[Attribute, ...]
    ) -> Id:
        """Create the vertex array of this mesh for a program's inputs; called at the first draw of the pair.

        It is kept under `key`, the `Program`, since ids of two devices may be equal.

        Raises:
            ValidationError: `mesh-attribute` if a field is missing or has a type that the stage can't read.
        """
        descriptor = self.describe_vertex_array(program, name, attributes)
        with HeldInterrupts():
            vertex_array = self.core.new_id()
            self.core.create(self.core.backend.create_vertex_array, vertex_array, descriptor)
            self.keep_vertex_array(key, program, vertex_array)
        return vertex_array

    def keep_vertex_array(self, key: object, program: Id, vertex_array: Id) -> None:
        """Keep a vertex array until this mesh, one of its buffers or the program is destroyed."""
        # Command buffers that were recorded at the same time bring one each; all are kept.
        self.vertex_arrays[key if key not in self.vertex_arrays else (key, vertex_array)] = vertex_array
        self.core.timeline.watch(self, program)

    def describe_vertex_array(
        self, program: Id, name: str, attributes: tuple[Attribute, ...]
    ) -> VertexArrayDescriptor:
        """Return how a program's inputs are read from this mesh; `mesh-attribute` if they can't be."""
        streams = []
        remaining = {attribute.name: attribute for attribute in attributes}
        for buffer, per_instance in ((self.vertices, False), (self.instances, True)):
            if buffer is None:
                continue
            fields: Any = buffer.dtype.fields or {}
            found = tuple(
                VertexAttribute(
                    remaining[field].location, self._format(remaining[field], dtype, name), offset
                )
                for field, (dtype, offset, *_) in fields.items()
                if field in remaining
            )
            for field in fields:
                remaining.pop(field, None)
            if found:
                streams.append(VertexStream(buffer.id, 0, buffer.dtype.itemsize, per_instance, found))
        if remaining:
            have = ", ".join(
                field for b in (self.vertices, self.instances) if b for field in b.dtype.names or ()
            )
            need = ", ".join(f"{a.name}: {a.type}" for a in attributes)
            self.core.refuse(
                MESH_ATTRIBUTE, f"draw of program {name!r}", f"a mesh with {have}", f"fields {need}"
            )
        return VertexArrayDescriptor(
            program, tuple(streams), self.index_buffer.id if self.index_buffer else 0, self.index_format
        )

    def _format(self, attribute: Attribute, dtype: np.dtype[Any], program: str) -> VertexFormat:
        base, shape = dtype.subdtype or (dtype, ())
        wanted = attribute.type
        components = wanted.size if isinstance(wanted, VectorType) else 1
        scalar = str(wanted.scalar if isinstance(wanted, VectorType) else wanted)
        given = int(np.prod(shape)) if shape else 1
        code = base.str[1:]
        normalized = scalar == "float" and base.kind in "iu"
        # A field may have more components than the input reads, never fewer.
        form = _FORMATS.get((code, given, normalized))
        if form is None or form.components < components or (form.kind != scalar):
            self.core.refuse(
                MESH_ATTRIBUTE,
                f"draw of program {program!r}",
                f"{attribute.name} as {given}×{code}",
                f"{attribute.name} as {wanted}: " + ", ".join(_format_text(f) for f in VertexFormat
                                                             if f.kind == scalar and f.components >= components),
            )  # fmt: skip
        return form

    def note_retired(self, resource: Id) -> None:
        """Drop what was made for a program, or everything, as a buffer of this mesh is destroyed."""
        if any(buffer.id == resource for buffer in self.buffers):
            self._forget()
        else:
            made = [key for key in self.vertex_arrays if _program_id(key) == resource]
            for view in self.views:
                for key in made:
                    view.prepared_draws.pop(key, None)
            for key in made:
                self.core.timeline.retire(self.vertex_arrays.pop(key))

    def _forget(self) -> None:
        """Drop all prepared draws and vertex arrays."""
        for view in self.views:
            view.prepared_draws.clear()
        while self.vertex_arrays:
            self.core.timeline.retire(self.vertex_arrays.popitem()[1])

    def destroy(self) -> None:
        """Destroy the buffers that were created for this mesh."""
        with HeldInterrupts():
            self._forget()
            for buffer in self.owned:
                buffer.destroy()


def _program_id(key: Any) -> Id:
    """Return the id of the program that a vertex array is kept for."""
    program = key[0] if isinstance(key, tuple) else key
    return int(program.id)


def _format_text(form: VertexFormat) -> str:
    return f"{form.components}×{form.code}{' normalised' if form.normalized else ''}"


class Drawable:
    """Vertices that a draw can read: a `Mesh`, or a `TransientMesh`.

    Attributes:
        primitive, first, count, base_vertex, base_instance: the arguments of a draw. `first` and `count` are in
            indices for an indexed mesh, in vertices otherwise. Read-only.
        buffers: the resources that a draw reads, which must be usable.
        vertex_arrays: the vertex array for each program that has drawn this.
        prepared_draws: by program, the prepared draw as a function of the number of instances.
    """

    __slots__ = (
        "__weakref__",
        "base_instance",
        "base_vertex",
        "buffers",
        "count",
        "first",
        "prepared_draws",
        "primitive",
        "vertex_arrays",
    )

    def __init__(
        self,
        primitive: Primitive,
        first: int,
        count: int,
        base_vertex: int,
        base_instance: int,
        buffers: Sequence[Owner],
        vertex_arrays: dict[object, Id],
    ) -> None:
        self.primitive = primitive
        self.first = first
        self.count = count
        self.base_vertex = base_vertex
        self.base_instance = base_instance
        self.buffers = buffers
        self.vertex_arrays = vertex_arrays
        self.prepared_draws: dict[object, Callable[[int], object]] = {}

    def create_vertex_array(
        self, key: object, program: Id, name: str, attributes: tuple[Attribute, ...]
    ) -> Id:
        """Create the vertex array for a program's inputs and keep it in `vertex_arrays`; see `MeshData`."""
        raise NotImplementedError


class Mesh(Drawable, Resource):
    """Vertices with optional indices and per-instance data, or a part of them; created by `device.mesh`."""

    __slots__ = ("data",)

    def __init__(
        self,
        data: MeshData,
        primitive: Primitive,
        first: int,
        count: int,
        base_vertex: int = 0,
        base_instance: int = 0,
    ) -> None:
        super().__init__(
            primitive, first, count, base_vertex, base_instance, data.buffers, data.vertex_arrays
        )
        self.data = data
        data.views.add(self)

    def create_vertex_array(
        self, key: object, program: Id, name: str, attributes: tuple[Attribute, ...]
    ) -> Id:
        """Create the vertex array of this mesh for a program's inputs; all views of the mesh share it."""
        return self.data.create_vertex_array(key, program, name, attributes)

    @property
    def vertex_count(self) -> int:
        """Number of vertices of the whole mesh."""
        return self.data.vertex_count

    @property
    def index_count(self) -> int | None:
        """Number of indices, None for a mesh without indices."""
        return self.data.index_count

    @property
    def is_indexed(self) -> bool:
        """Whether the mesh has indices."""
        return self.data.index_count is not None

    @property
    def vertices(self) -> Buffer | None:
        """The vertex buffer, None for vertices without attributes."""
        return self.data.vertices

    @property
    def indices(self) -> Buffer | None:
        """The index buffer, None without indices."""
        return self.data.index_buffer

    @property
    def instances(self) -> Buffer | None:
        """The buffer of per-instance data, None if there is none."""
        return self.data.instances

    @property
    def element_count(self) -> int:
        """Number of indices or, without indices, of vertices."""
        return self.data.vertex_count if self.data.index_count is None else self.data.index_count

    def __repr__(self) -> str:
        return f"Mesh({self.data.label!r}, {self.primitive.name}, {self.first}+{self.count})"

    def view(
        self,
        first: int = 0,
        count: int | None = None,
        *,
        base_vertex: int = 0,
        base_instance: int = 0,
        primitive: Primitive | None = None,
    ) -> Mesh:
        """Return a part of the mesh that shares its buffers.

        Raises:
            ValidationError: `mesh-range` if the part reaches beyond the indices or vertices.
        """
        core, total = self.data.core, self.element_count
        count = total - first if count is None else count
        if first < 0 or count < 0 or first + count > total or base_instance < 0:
            given = f"first {first}, count {count}, base instance {base_instance}"
            core.refuse(MESH_RANGE, "Mesh.view", given, f"within {total} elements, base instance 0 or more")
        if not self.is_indexed and base_vertex:
            core.refuse(MESH_RANGE, "Mesh.view", f"base vertex {base_vertex}", "0 for a mesh without indices")
        return Mesh(self.data, primitive or self.primitive, first, count, base_vertex, base_instance)

    def draws(
        self,
        first: Any = 0,
        count: Any = None,
        *,
        instances: Any = 1,
        base_vertex: Any = 0,
        base_instance: Any = 0,
    ) -> NDArray[Any]:
        """Return an array of draws for `draw_many`; each argument is a number or an array, as for `view`.

        Returns:
            (n,) of `DRAW` or, without indices, `DRAW_UNINDEXED`.
        """
        core = self.data.core
        count = self.element_count if count is None else count
        parts = np.broadcast_arrays(first, count, instances, base_vertex, base_instance)
        first, count, instances, base_vertex, base_instance = (np.atleast_1d(part) for part in parts)
        if len(first) and (first.min() < 0 or count.min() < 0 or (first + count).max() > self.element_count):
            core.refuse(
                MESH_RANGE,
                "Mesh.draws",
                "first + count beyond the mesh",
                f"within {self.element_count} elements",
            )
        draws = np.zeros(len(first), DRAW if self.is_indexed else DRAW_UNINDEXED)
        draws["first"], draws["count"], draws["instances"] = first, count, instances
        draws["base_instance"] = base_instance
        if self.is_indexed:
            draws["base_vertex"] = base_vertex
        elif np.any(base_vertex):
            core.refuse(MESH_RANGE, "Mesh.draws", "a base vertex", "0 for a mesh without indices")
        return draws

    def destroy(self) -> None:
        """Destroy the buffers that were created for this mesh (not those passed in)."""
        self.data.destroy()
        self.data.core.program = None


def check_draws(core: Core, mesh: Mesh, draws: NDArray[Any], call: str) -> NDArray[Any]:
    """Return draws as a contiguous array; refuse a dtype that is not the mesh's, and draws beyond the mesh."""
    expected = DRAW if mesh.is_indexed else DRAW_UNINDEXED
    array = np.asarray(draws)
    if array.dtype != expected or array.ndim != 1:
        core.refuse(DRAW_ARRAY, call, f"shape {array.shape} of {array.dtype}", f"(n,) of {expected}")
    if len(array):
        last = int((array["first"].astype(np.int64) + array["count"]).max())
        if last > mesh.element_count:
            core.refuse(
                MESH_RANGE, call, f"a draw up to element {last}", f"within {mesh.element_count} elements"
            )
    return np.ascontiguousarray(array)


def _structured(core: Core, source: VertexSource, call: str) -> NDArray[Any] | Buffer:
    if isinstance(source, Buffer):
        if not source.dtype.names:
            core.refuse(MESH_DATA, call, f"a buffer of {source.dtype}", "a buffer with a structured dtype")
        return source
    array = _interleave(core, source, call) if isinstance(source, Mapping) else np.asarray(source)
    if not array.dtype.names:
        tip = (
            'name the attributes: {"position": positions, …} or an array made with the vertex struct\'s dtype'
        )
        core.refuse(
            MESH_DATA, call, f"an array of {array.dtype}", "a structured array or a dict of arrays", tip
        )
    if array.ndim != 1 or not len(array):
        core.refuse(MESH_DATA, call, f"shape {array.shape}", "(n,) with n of 1 or more")
    check_finite(core, array, MESH_DATA, call)
    return array


def check_finite(core: Core, vertices: NDArray[Any], rule: Rule, call: str) -> None:
    """Refuse a structured array that contains NaN or infinity."""
    for name in vertices.dtype.names or ():
        values = vertices[name]
        if values.dtype.kind == "f" and not np.isfinite(values).all():
            bad = int(np.flatnonzero(~np.isfinite(values).reshape(len(values), -1).all(1))[0])
            core.refuse(rule, call, f"{name}[{bad}] = {values[bad]}", "finite numbers")


def _interleave(core: Core, arrays: Mapping[str, NDArray[Any]], call: str) -> NDArray[Any]:
    columns = {name: np.asarray(values) for name, values in arrays.items()}
    lengths = {len(values) if values.ndim else 0 for values in columns.values()}
    if len(lengths) != 1:
        shapes = ", ".join(f"{name} {values.shape}" for name, values in columns.items())
        core.refuse(MESH_DATA, call, shapes or "no arrays", "arrays of equal length")
    # NumPy makes float64 arrays by default, which no vertex stage reads: they become float32.
    types = [
        (name, np.float32 if values.dtype == np.float64 else values.dtype, values.shape[1:])
        for name, values in columns.items()
    ]
    rows = np.zeros(lengths.pop(), types)
    for name, values in columns.items():
        rows[name] = values
    return rows


def _length(source: NDArray[Any] | Buffer | None) -> int:
    if source is None:
        return 0
    return source.count if isinstance(source, Buffer) else len(source)


def _index_source(
    core: Core, source: NDArray[Any] | Buffer | None, vertices: int, call: str
) -> NDArray[Any] | Buffer | None:
    if source is None:
        return None
    if isinstance(source, Buffer):
        if source.dtype not in (np.dtype("u2"), np.dtype("u4")):
            core.refuse(MESH_INDEX, call, f"a buffer of {source.dtype}", "uint16 or uint32")
        return source
    return match_indices(core, source, vertices, call)


def match_indices(core: Core, source: NDArray[Any], vertices: int, call: str) -> NDArray[Any]:
    """Return indices of any integer dtype as (n,) uint16 or uint32.

    Raises:
        ValidationError: `mesh-index` for an index that is neither below `vertices` nor restarts a strip.
    """
    array = np.asarray(source)
    if array.dtype.kind not in "iu" or not array.size:
        core.refuse(MESH_INDEX, call, f"shape {array.shape} of {array.dtype}", "integers, one or more")
    array = array.reshape(-1)
    code = array.dtype if array.dtype in (np.dtype("u2"), np.dtype("u4")) else np.dtype("u4")
    restart = np.iinfo(code).max
    inside = (array >= 0) & (array < vertices)
    if array.dtype == code:
        inside |= array == restart
    if not inside.all():
        bad = int(np.flatnonzero(~inside)[0])
        core.refuse(
            MESH_INDEX,
            call,
            f"index {array[bad]} at {bad}",
            f"0 to {vertices - 1}, or {restart} to restart a strip",
        )
    return np.ascontiguousarray(array, code)
