"""Meshes: vertex, instance and index arrays, matched by field name to the inputs of a program's vertex stage.

- A mesh's arrays are structured: one field per attribute. A program reads the fields that it names, in
  any order, width and padding; a missing field is refused with both lists.
- `view` returns a part of a mesh (first, count, base vertex, base instance) that shares everything else.
- The vertex array is created once per mesh and program, and shared by views; each view keeps its own prepared
  draw per program (`prepared_draws`). So views are immutable: another part is another view.
- All of these are dropped with the program or the buffer that they were made for (`Timeline.watch`).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import field
from typing import Any, Final, Self, TypeAlias, cast
from weakref import WeakSet

import numpy as np
from numpy.typing import ArrayLike, NDArray

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
from rhi.contract.interrupts import DeferredInterrupts
from rhi.contract.layout import VectorType, repack
from rhi.contract.limits import vertex_faults
from rhi.device.core.core import Core, Owner
from rhi.device.resources.buffers import Buffer, StorageBuffer
from rhi.device.resources.lifetime import Resource
from rhi.errors import Rule
from rhi.errors.arguments import ArgumentChecker, to_integer
from rhi.errors.data_classes import dataclass
from rhi.errors.device_objects import DeviceObject
from rhi.errors.named_tuples import NamedTuple
from rhi.errors.rules import DRAW_ARRAY, MESH_ATTRIBUTE, MESH_DATA, MESH_INDEX, MESH_RANGE

VertexSource: TypeAlias = NDArray[Any] | Mapping[str, ArrayLike] | Buffer
"""Vertices: a structured array, arrays by attribute name, or a buffer with a structured dtype.
(`device.mesh` also accepts a number of vertices without attributes.)"""

_ZEROS: Final = np.zeros(1 << 16, np.float32)  # which stay in a core's cache
_FORMATS: Final = {(f.code, f.components, f.normalized): f for f in VertexFormat}


@dataclass(slots=True, eq=False, weakref_slot=True)
class DrawableData(DeviceObject):
    """The vertices that a `Drawable` and all its views share.

    Attributes:
        buffers, vertex_arrays: as in `Drawable`.
        vertex_count, instance_count: numbers of vertices and of elements of the per-instance data.
        instance_fields: the names of fields that are read once per instance.
        is_indexed: whether there are indices.
        element_count: number of indices or, without indices, of vertices.
    """

    core: Core
    buffers: Sequence[Owner] = ()
    vertex_arrays: dict[object, Id] = field(default_factory=dict)
    vertex_count: int = 0
    instance_fields: Collection[str] = ()
    instance_count: int = 0
    is_indexed: bool = False
    element_count: int = 0


class MeshData(DrawableData):
    """The buffers of a mesh."""

    __slots__ = ("index_buffer", "index_format", "instances", "label", "owned", "vertices", "views")
    buffers: Sequence[Buffer]

    def __init__(
        self,
        core: Core,
        vertices: VertexSource | int,
        indices: ArrayLike | Buffer | None,
        instances: VertexSource | None,
        label: str,
    ) -> None:
        call = "device.mesh"
        core.check_ready()
        # Everything is checked before the first buffer is created, so that a refused call leaves nothing
        # behind.
        count = to_integer(vertices)
        vertex_array = None if count is not None else _source(core, cast("VertexSource", vertices), call)
        if count is not None and not 1 <= count < 1 << 31:
            core.refuse(MESH_DATA, call, f"{count} vertices", "1 to 2**31 - 1")
        vertex_count = _length(vertex_array) if count is None else count
        instance_array = None if instances is None else _source(core, instances, call)
        index_array = _index_source(core, indices, vertex_count, call)
        super().__init__(core, vertex_count=vertex_count, element_count=vertex_count)
        self.label = label
        self.owned: list[Buffer] = []
        self.vertices = None if vertex_array is None else self._buffer(vertex_array, f"{label} vertices")
        self.instances = (
            None if instance_array is None else self._buffer(instance_array, f"{label} instances")
        )
        self.index_buffer = None if index_array is None else self._buffer(index_array, f"{label} indices")
        self.index_format = IndexFormat.UINT32
        if self.index_buffer is not None:
            self.index_format = (
                IndexFormat.UINT16 if self.index_buffer.dtype.itemsize == 2 else IndexFormat.UINT32
            )
            self.is_indexed, self.element_count = True, self.index_buffer.count
        if self.instances is not None:
            self.instance_count = self.instances.count
        self.views: WeakSet[Mesh] = WeakSet()
        sources = (self.vertices, self.instances, self.index_buffer)
        self.buffers = tuple(buffer for buffer in sources if buffer is not None)
        self.instance_fields = instance_field_names(self.vertices, self.instances)
        for buffer in self.buffers:
            core.timeline.watch(self, buffer.id)

    def __del__(self) -> None:
        for vertex_array in getattr(self, "vertex_arrays", {}).values():
            self.core.timeline.drop(vertex_array)

    def _buffer(self, source: NDArray[Any] | Buffer, label: str) -> Buffer:
        if isinstance(source, Buffer):
            return source
        buffer = Buffer(self.core, len(source), source.dtype, label=label.strip(), data=source)
        self.owned.append(buffer)
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
        self.core.check_ready()
        with DeferredInterrupts():
            vertex_array = self.core.new_id()
            self.core.create(self.core.backend.create_vertex_array, vertex_array, descriptor)
            self.cache_vertex_array(key, program, vertex_array)
        return vertex_array

    def cache_vertex_array(self, key: object, program: Id, vertex_array: Id) -> None:
        """Keep a vertex array until this mesh, one of its buffers or the program is destroyed."""
        # Command buffers that were recorded at the same time bring one each; all are kept.
        self.vertex_arrays[key if key not in self.vertex_arrays else (key, vertex_array)] = vertex_array
        self.core.timeline.watch(self, program)

    def describe_vertex_array(
        self, program: Id, name: str, attributes: tuple[Attribute, ...]
    ) -> VertexArrayDescriptor:
        """Return the vertex array that reads a program's inputs from this mesh; `mesh-attribute` if it can't."""
        call = f"draw of program {name!r}"
        sources = [
            StreamSource(buffer.id, buffer.dtype, per_instance)
            for buffer, per_instance in ((self.vertices, False), (self.instances, True))
            if buffer is not None
        ]
        streams = describe_streams(self.core, sources, attributes, MESH_ATTRIBUTE, call)
        index_buffer = self.index_buffer.id if self.index_buffer else 0
        return VertexArrayDescriptor(program, streams, index_buffer, self.index_format)

    def note_retired(self, resource: Id) -> None:
        """Drop the vertex arrays and draws of a destroyed program, or all of them if a buffer of this mesh is
        destroyed."""
        if any(buffer.id == resource for buffer in self.buffers):
            self._forget()
        else:
            keys = [key for key in self.vertex_arrays if _program_id(key) == resource]
            for view in self.views:
                for key in keys:
                    view.prepared_draws.pop(key, None)
            for key in keys:
                self.core.timeline.retire(self.vertex_arrays.pop(key))

    def _forget(self) -> None:
        """Drop all prepared draws and vertex arrays."""
        for view in self.views:
            view.prepared_draws.clear()
        while self.vertex_arrays:
            self.core.timeline.retire(self.vertex_arrays.popitem()[1])

    def destroy(self) -> None:
        """Destroy the buffers that were created for this mesh."""
        self.core.check_thread("destroy")
        with DeferredInterrupts():
            self._forget()
            for buffer in self.owned:
                buffer.destroy()


def _program_id(key: Any) -> Id:
    """Return the id of the program that a vertex array is kept for."""
    program = key[0] if isinstance(key, tuple) else key
    return int(program.id)


class StreamSource(NamedTuple):
    """Vertices or instances as they lie in a buffer: from byte `offset` on, elements of a structured
    dtype."""

    buffer: Id
    dtype: np.dtype[Any]
    per_instance: bool
    offset: int = 0


def describe_streams(
    core: Core, sources: Sequence[StreamSource], attributes: tuple[Attribute, ...], rule: Rule, call: str
) -> tuple[VertexStream, ...]:
    """Return the streams that the inputs of a vertex stage are read from: each from the first source that has
    a field of its name.

    Raises:
        ValidationError: `rule` if a field is missing or has a type that the stage can't read.
    """
    streams = []
    remaining = {attribute.name: attribute for attribute in attributes}
    for source in sources:
        fields: Any = source.dtype.fields or {}
        read_attributes = tuple(
            VertexAttribute(
                remaining[name].location, select_vertex_format(core, remaining[name], dtype, rule, call), at
            )
            for name, (dtype, at, *_) in fields.items()
            if name in remaining
        )
        for name in fields:
            remaining.pop(name, None)
        if read_attributes:
            streams.append(
                VertexStream(
                    source.buffer, source.offset, source.dtype.itemsize, source.per_instance, read_attributes
                )
            )
    if remaining:
        have = ", ".join(field for source in sources for field in source.dtype.names or ()) or "no fields"
        core.refuse(
            rule,
            call,
            f"a mesh with {have}",
            f"fields {', '.join(f'{a.name}: {a.type}' for a in attributes)}",
        )
    core.require(call, vertex_faults(streams, core.capabilities))
    return tuple(streams)


def select_vertex_format(
    core: Core, attribute: Attribute, dtype: np.dtype[Any], rule: Rule, call: str
) -> VertexFormat:
    """Return the format in which a field feeds an input; refuse by `rule` a field that can't.

    Integers that feed floats are normalised. A field may have more components than the input reads, never
    fewer.
    """
    base, shape = dtype.subdtype or (dtype, ())
    components, scalar = attribute_shape(attribute)
    component_count = int(np.prod(shape)) if shape else 1
    form = (
        _FORMATS.get((base.str[1:], component_count, scalar == "float" and base.kind in "iu"))
        if base.isnative
        else None
    )
    if form is None or form.components < components or form.kind != scalar:
        formats = (f for f in VertexFormat if f.kind == scalar and f.components >= components)
        allowed = f"{attribute.name} as {attribute.type}: {', '.join(map(_format_text, formats))}"
        core.refuse(rule, call, f"{attribute.name} as {component_count}×{base.str.lstrip('<|=')}", allowed)
    return form


def attribute_shape(attribute: Attribute) -> tuple[int, str]:
    """Return an attribute's number of components and the name of its scalar type."""
    vector = attribute.type
    if isinstance(vector, VectorType):
        return vector.size, str(vector.scalar)
    return 1, str(vector)


def _format_text(form: VertexFormat) -> str:
    return f"{form.components}×{form.code}{' normalised' if form.normalized else ''}"


class Drawable(DeviceObject):
    """Vertices that a draw can read: a `Mesh`, or a `TransientMesh`.

    A draw whose numbers reach beyond the vertices or instances is refused. Indices in a buffer, and arguments
    that the device reads, aren't known here: backends clamp reads beyond the end.

    Attributes:
        data: the vertices that it shares with its views.
        primitive, first, count, base_vertex, base_instance: the arguments of a draw. `first` and `count` are
            in indices for an indexed mesh, in vertices otherwise. Read-only.
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
        "data",
        "first",
        "prepared_draws",
        "primitive",
        "vertex_arrays",
    )

    def __init__(
        self,
        data: DrawableData,
        primitive: Primitive,
        first: int,
        count: int,
        base_vertex: int = 0,
        base_instance: int = 0,
    ) -> None:
        self.data = data
        self.primitive = primitive
        self.first = first
        self.count = count
        self.base_vertex = base_vertex
        self.base_instance = base_instance
        self.buffers, self.vertex_arrays = data.buffers, data.vertex_arrays
        self.prepared_draws: dict[object, Callable[[int], object]] = {}

    def create_vertex_array(
        self, key: object, program: Id, name: str, attributes: tuple[Attribute, ...]
    ) -> Id:
        """Create the vertex array for a program's inputs and keep it in `vertex_arrays`; see `MeshData`."""
        raise NotImplementedError

    # -- parts -------------------------------------------------------------------------------------------

    @property
    def core(self) -> Core:
        """The core of its device."""
        return self.data.core

    @property
    def is_indexed(self) -> bool:
        """True if there are indices."""
        return self.data.is_indexed

    @property
    def element_count(self) -> int:
        """Number of indices or, without indices, of vertices of the whole mesh, also for a view."""
        return self.data.element_count

    @property
    def vertex_count(self) -> int:
        """Number of vertices of the whole."""
        return self.data.vertex_count

    @property
    def instance_fields(self) -> Collection[str]:
        """The names of fields that are read once per instance."""
        return self.data.instance_fields

    @property
    def instance_count(self) -> int:
        """Number of elements of the per-instance data."""
        return self.data.instance_count

    def view(
        self,
        first: int = 0,
        count: int | None = None,
        *,
        base_vertex: int = 0,
        base_instance: int = 0,
        primitive: Primitive | None = None,
    ) -> Self:
        """Return a part that shares everything else: `count` indices or vertices of the whole, from `first`
        on.

        Raises:
            ValidationError: `mesh-range` if the part reaches beyond the indices or vertices.

        Examples:
            >>> first = mesh.view(0, 3)  # vertices 0 to 2
            >>> with device.render_pass(image):
            ...     device.draw(program, first, tint=(1, 0, 0, 1))
        """
        core = self.core
        total = self.element_count
        call = f"{type(self).__name__}.view"
        check = ArgumentChecker(call, core.refuse)
        first = check.integer("first", first)
        count = total - first if count is None else check.integer("count", count)
        base_vertex = check.integer("base_vertex", base_vertex, *_COLUMNS["base_vertex"])
        base_instance = check.integer("base_instance", base_instance)
        if primitive is not None:
            check.choice("primitive", primitive, Primitive)
        if first < 0 or count < 0 or first + count > total or not 0 <= base_instance < 1 << 31:
            given = f"first {first}, count {count}, base instance {base_instance}"
            core.refuse(MESH_RANGE, call, given, f"within {total} elements, base instance 0 or more")
        if not self.is_indexed and base_vertex:
            core.refuse(MESH_RANGE, call, f"base vertex {base_vertex}", "0 for a mesh without indices")
        if base_vertex >= self.vertex_count:
            core.refuse(
                MESH_RANGE, call, f"base vertex {base_vertex}", f"below {self.vertex_count}, the vertices"
            )
        return self._part(first, count, base_vertex, base_instance, primitive or self.primitive)

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

        Examples:
            >>> mesh.draws([0, 0], 3, instances=[5, 7])["instances"].tolist()
            [5, 7]
        """
        core = self.core
        total = self.element_count
        call = f"{type(self).__name__}.draws"
        arguments = {
            "first": first,
            "count": total if count is None else count,
            "instances": instances,
            "base_vertex": base_vertex,
            "base_instance": base_instance,
        }
        columns = _integer_columns(ArgumentChecker(call, core.refuse), arguments)
        if len(columns["first"]) and int((columns["first"] + columns["count"]).max()) > total:
            core.refuse(MESH_RANGE, call, "first + count beyond the mesh", f"within {total} elements")
        draws = np.zeros(len(columns["first"]), DRAW if self.is_indexed else DRAW_UNINDEXED)
        if not self.is_indexed and columns.pop("base_vertex").any():
            core.refuse(MESH_RANGE, call, "a base vertex", "0 for a mesh without indices")
        for name, column in columns.items():
            draws[name] = column
        _check_base_vertices(self, draws, call)
        return draws

    def offset_draws(self, draws: NDArray[Any]) -> NDArray[Any]:
        """Convert draws that count from this mesh's first elements to the numbers that backends need."""
        return draws

    def _part(
        self, first: int, count: int, base_vertex: int, base_instance: int, primitive: Primitive
    ) -> Self:
        """Return the part that `view` has checked."""
        raise NotImplementedError


class Mesh(Drawable, Resource):
    """Vertices with optional indices and per-instance data, or a part of them; created by `device.mesh`."""

    __slots__ = ("_is_view",)
    data: MeshData

    def __init__(
        self,
        data: MeshData,
        primitive: Primitive,
        first: int,
        count: int,
        base_vertex: int = 0,
        base_instance: int = 0,
        is_view: bool = False,
    ) -> None:
        super().__init__(data, primitive, first, count, base_vertex, base_instance)
        self._is_view = is_view
        data.views.add(self)

    def create_vertex_array(
        self, key: object, program: Id, name: str, attributes: tuple[Attribute, ...]
    ) -> Id:
        """Create the vertex array of this mesh for a program's inputs; all views of the mesh share it."""
        return self.data.create_vertex_array(key, program, name, attributes)

    @property
    def index_count(self) -> int | None:
        """Number of indices, None for a mesh without indices."""
        return self.element_count if self.is_indexed else None

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

    def __repr__(self) -> str:
        return f"Mesh({self.data.label!r}, {self.primitive.name}, {self.first}+{self.count})"

    def _part(
        self, first: int, count: int, base_vertex: int, base_instance: int, primitive: Primitive
    ) -> Mesh:
        return Mesh(self.data, primitive, first, count, base_vertex, base_instance, is_view=True)

    def destroy(self) -> None:
        """Destroy the buffers that were created for this mesh (not those passed in). A view owns none: they
        stay."""
        if self._is_view:
            return
        self.data.destroy()
        self.data.core.program = None


_FARTHEST_CLIP: Final = 1 << 30  # as in `Scissor`
_COLUMNS: Final = {
    "first": (0, (1 << 32) - 1),
    "count": (0, (1 << 32) - 1),
    "instances": (0, (1 << 31) - 1),
    "base_vertex": (-(1 << 30), 1 << 30),  # the offset of a transient mesh is added to it
    "base_instance": (0, (1 << 31) - 1),
}
"""The range of each column of an array of draws: (minimum, maximum)."""


def _integer_columns(check: ArgumentChecker, arguments: dict[str, Any]) -> dict[str, NDArray[np.int64]]:
    """Return numbers and arrays of whole numbers as arrays of equal length, (n,) int64."""
    columns = {}
    for name, value in arguments.items():
        minimum, maximum = _COLUMNS[name]
        column = check.array(name, value)
        if column.size and (
            column.dtype.kind not in "iu" or int(column.min()) < minimum or int(column.max()) > maximum
        ):
            check.fail(name, value, f"whole numbers from {minimum:,} to {maximum:,}")
        columns[name] = column.astype(np.int64)
    try:
        parts = np.broadcast_arrays(*columns.values())
    except ValueError as error:
        shapes = ", ".join(f"{name} {column.shape}" for name, column in columns.items())
        check.fail("shapes", shapes, f"numbers, and arrays of one length ({error})")
    if parts[0].ndim > 1:
        check.fail("first", arguments["first"], "a number or an array of one dimension")
    return dict(zip(columns, map(np.atleast_1d, parts), strict=True))


def _check_base_vertices(mesh: Drawable, draws: NDArray[Any], call: str) -> None:
    """Refuse draws whose first vertex already lies beyond the mesh."""
    if mesh.is_indexed and len(draws) and int(draws["base_vertex"].max()) >= mesh.vertex_count:
        given = f"base vertex {int(draws['base_vertex'].max())}"
        mesh.core.refuse(MESH_RANGE, call, given, f"below {mesh.vertex_count}, the vertices")


def check_draws(
    core: Core, mesh: Drawable, draws: NDArray[Any], attributes: tuple[Attribute, ...], call: str
) -> NDArray[Any]:
    """Return draws as backends need them. Refuse another dtype than the mesh's, draws beyond the mesh, and
    draws beyond its per-instance data if the program's `attributes` read any."""
    expected = DRAW if mesh.is_indexed else DRAW_UNINDEXED
    array = ArgumentChecker(call, core.refuse).array("draws", draws)
    if array.dtype != expected and (repacked := repack(expected, array)) is not None:
        array = repacked
    if array.dtype != expected or array.ndim != 1:
        core.refuse(DRAW_ARRAY, call, f"shape {array.shape} of {array.dtype}", f"(n,) of {expected}")
    if len(array):
        last = int((array["first"].astype(np.int64) + array["count"]).max())
        if last > mesh.element_count:
            core.refuse(
                MESH_RANGE, call, f"a draw up to element {last}", f"within {mesh.element_count} elements"
            )
        _check_base_vertices(mesh, array, call)
        if reads_instances(mesh, attributes):
            ends = array["base_instance"].astype(np.int64) + array["instances"]
            check_instance_end(core, mesh, int(np.max(ends, where=array["instances"] > 0, initial=0)), call)
    return np.ascontiguousarray(mesh.offset_draws(array))


def instance_field_names(
    vertices: Buffer | NDArray[Any] | None, instances: Buffer | NDArray[Any] | None
) -> frozenset[str]:
    """Return the names of the fields that a mesh reads once per instance. A vertex field of the same name
    takes precedence."""
    names = () if instances is None else instances.dtype.names or ()
    vertex_names = () if vertices is None else vertices.dtype.names or ()
    return frozenset(names).difference(vertex_names)


def reads_instances(mesh: Drawable, attributes: tuple[Attribute, ...]) -> bool:
    """True if a program with these attributes reads per-instance data of a mesh."""
    fields = mesh.instance_fields
    return bool(fields) and any(attribute.name in fields for attribute in attributes)


def check_instance_end(core: Core, mesh: Drawable, end: int, call: str) -> None:
    """Refuse a draw that reads per-instance data up to element `end` of a mesh that has fewer elements."""
    if end > mesh.instance_count:
        core.refuse(
            MESH_RANGE, call, f"instances up to {end}", f"within the mesh's {mesh.instance_count} instances"
        )


def check_clips(core: Core, clips: ArrayLike, count: int, call: str) -> NDArray[np.int64]:
    """Return rectangles (count, 4) of draws; refuse other shapes, other numbers than integers, and negative
    sizes."""
    check = ArgumentChecker(call, core.refuse)
    array = check.array("clips", clips)
    if array.shape != (count, 4) or array.dtype.kind not in "iu":
        check.fail("clips", f"{array.dtype} of shape {array.shape}", f"({count}, 4) integers")
    if count and (array[:, 2:].min() < 0 or np.abs(array.astype(np.float64)).max() > _FARTHEST_CLIP):
        given = f"rectangles from {array.min(0).tolist()} to {array.max(0).tolist()}"
        check.fail("clips", given, f"sizes from 0, all numbers up to {_FARTHEST_CLIP}")
    return array.astype(np.int64)


def _source(core: Core, source: VertexSource, call: str) -> NDArray[Any] | Buffer:
    """Return vertices or instances as a structured array, or the buffer that they already lie in."""
    if isinstance(source, StorageBuffer):
        source = source.owner
    if not isinstance(source, Buffer):
        return as_structured(core, source, MESH_DATA, call)
    core.check_usable(source, call)
    if not source.dtype.names:
        core.refuse(MESH_DATA, call, f"a buffer of {source.dtype}", "a buffer with a structured dtype")
    return source


def as_structured(core: Core, source: VertexSource, rule: Rule, call: str, minimum: int = 1) -> NDArray[Any]:
    """Return vertices, a structured array or arrays by attribute name, as an array (n,) with a field for
    each.

    Raises:
        ValidationError: `rule` for an array that isn't structured or has fewer than `minimum` elements, and
            for NaN and infinity.
    """
    check = ArgumentChecker(call, core.refuse, rule)
    array = (
        _interleave(core, source, rule, call)
        if isinstance(source, Mapping)
        else check.array("vertices", source)
    )
    if not array.dtype.names:
        tip = (
            'name the attributes: {"position": positions, …} or an array made with the vertex struct\'s dtype'
        )
        core.refuse(rule, call, f"an array of {array.dtype}", "a structured array or a dict of arrays", tip)
    if array.ndim != 1 or len(array) < minimum:
        core.refuse(rule, call, f"shape {array.shape}", f"(n,) with n of {minimum} or more")
    check_finite(core, array, rule, call)
    return array


def check_finite(core: Core, vertices: NDArray[Any], rule: Rule, call: str) -> None:
    """Refuse a structured array that contains NaN or infinity."""
    if _has_finite_words(vertices):
        return
    for name in vertices.dtype.names or ():
        values = vertices[name]
        if values.dtype.kind != "f" or not values.size:
            continue
        with np.errstate(invalid="ignore"):
            ends = values.min(), values.max()  # both are NaN if any number is
        if not np.isfinite(ends).all():
            bad = int(np.flatnonzero(~np.isfinite(values).reshape(len(values), -1).all(1))[0])
            core.refuse(rule, call, f"{name}[{bad}] = {values[bad]}", "finite numbers")


def _has_finite_words(vertices: NDArray[Any]) -> bool:
    """True if all words of an array are finite as floats: ten times as fast as a test of each field.

    A product with zeros reads them once, where minimum and maximum would read them twice. A negative result
    proves nothing, since bytes and integers may look like NaN.
    """
    fields: Any = vertices.dtype.fields or {}
    floats = [(kind.base, at) for kind, at, *_ in fields.values() if kind.base.kind == "f"]
    has_words = vertices.dtype.itemsize % 4 == 0 and vertices.flags.c_contiguous and vertices.size
    if not has_words or any(base != np.float32 or at % 4 for base, at in floats):
        return False
    words = vertices.view(np.float32)
    blocks = (words[i : i + len(_ZEROS)] for i in range(0, words.size, len(_ZEROS)))
    with np.errstate(invalid="ignore"):  # 0 times NaN or infinity is NaN
        return all(np.dot(block, _ZEROS[: len(block)]) == 0.0 for block in blocks)


def _interleave(core: Core, arrays: Mapping[str, ArrayLike], rule: Rule, call: str) -> NDArray[Any]:
    check = ArgumentChecker(call, core.refuse, rule)
    columns = {check.text("attribute", name): check.array(name, values) for name, values in arrays.items()}
    for name, values in columns.items():
        if not values.ndim:
            check.fail(name, arrays[name], "an array with an element for each vertex")
    lengths = set(map(len, columns.values()))
    if len(lengths) != 1:
        shapes = ", ".join(f"{name} {values.shape}" for name, values in columns.items())
        core.refuse(rule, call, shapes or "no arrays", "arrays of equal length")
    for name, values in columns.items():
        if values.dtype.kind not in "iuf":
            check.fail(name, arrays[name], "an array of numbers")
    # NumPy makes float64 arrays by default, which no vertex stage reads: they become float32.
    types = [
        (name, np.float32 if values.dtype == np.float64 else values.dtype, values.shape[1:])
        for name, values in columns.items()
    ]
    if len(columns) == 1 and values.size:  # its memory is that of the rows
        (values,) = columns.values()
        return (
            np.ascontiguousarray(values, types[0][1])
            .reshape(len(values), -1)
            .view(types)
            .reshape(len(values))
        )
    rows = np.empty(lengths.pop(), types)
    for name, values in columns.items():
        rows[name] = values
    return rows


def _length(source: NDArray[Any] | Buffer | None) -> int:
    if source is None:
        return 0
    return source.count if isinstance(source, Buffer) else len(source)


def _index_source(
    core: Core, source: ArrayLike | Buffer | None, vertices: int, call: str
) -> NDArray[Any] | Buffer | None:
    if source is None:
        return None
    if isinstance(source, StorageBuffer):
        source = source.owner
    if isinstance(source, Buffer):
        core.check_usable(source, call)
        if source.dtype not in (np.dtype("u2"), np.dtype("u4")):
            core.refuse(MESH_INDEX, call, f"a buffer of {source.dtype}", "uint16 or uint32")
        return source
    return match_indices(core, source, vertices, call)


def match_indices(core: Core, source: ArrayLike, vertices: int, call: str) -> NDArray[Any]:
    """Return indices of any integer dtype as (n,) uint16 or uint32.

    Raises:
        ValidationError: `mesh-index` for an index that is neither below `vertices` nor restarts a strip, a
            fan or quads.
    """
    array = ArgumentChecker(call, core.refuse).array("indices", source)
    if array.dtype.kind not in "iu" or not array.size:
        core.refuse(MESH_INDEX, call, f"shape {array.shape} of {array.dtype}", "integers, one or more")
    array = array.reshape(-1)
    code = array.dtype if array.dtype in (np.dtype("u2"), np.dtype("u4")) else np.dtype("u4")
    if array.max() < vertices and (array.dtype.kind == "u" or array.min() >= 0):
        return np.ascontiguousarray(array, code)
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
            f"0 to {vertices - 1}, or {restart} to restart a strip, a fan or quads",
        )
    return np.ascontiguousarray(array, code)
