"""Transient memory: constants, vertices and indices that live for one frame (thesis 4.3).

- `TransientMemory` uploads them to rings; its ranges and meshes are valid until the frame is presented.
- Meshes are checked and read as those of `device.mesh`, by the same functions, and have the same views.
- A command buffer has transient memory of its own, with the same lifetime: an `Arena` instead of the rings.
- Programs write the values of their uniform bindings to the same memory, through `uniforms` (`UniformRing`).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, NoReturn, TypeAlias, TypeVar, cast, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rhi.contract.descriptors import Attribute, Id, Primitive, VertexArrayDescriptor
from rhi.contract.formats import IndexFormat
from rhi.contract.interrupts import DeferredInterrupts
from rhi.device.core.arena import Arena
from rhi.device.core.core import Core
from rhi.device.core.ring import Ring
from rhi.device.core.uniform_ring import TransientOwner, UniformRing
from rhi.device.resources.buffers import as_constants, as_storage, storage_dtype
from rhi.device.resources.meshes import (
    Drawable,
    DrawableData,
    StreamSource,
    as_structured,
    attribute_shape,
    describe_streams,
    instance_field_names,
    match_indices,
)
from rhi.device.resources.programs import Program, check_program
from rhi.errors import RhiError
from rhi.errors.arguments import ArgumentChecker, to_integer
from rhi.errors.data_classes import dataclass
from rhi.errors.device_objects import DeviceObject
from rhi.errors.rules import IMMEDIATE_VERTEX, MESH_ATTRIBUTE
from rhi.shading import Struct
from rhi.shading.language.bindings import StorageRange, UniformRange

T = TypeVar("T")
MAX_LAYOUTS: Final = 1024
"""Largest number of (program, vertex layout) pairs that are cached from frame to frame."""

VertexArrays: TypeAlias = NDArray[Any] | Mapping[str, ArrayLike]
"""Vertices or instances: a structured array, or arrays by attribute name."""

_VertexArrayKey: TypeAlias = tuple[Id, tuple[StreamSource, ...], Id, IndexFormat]


class TransientMemory(DeviceObject):
    """Memory for data that is used in only one frame, or only one command buffer.

    Attributes:
        uniforms: the ring for uniform blocks, which also holds the arrays of `storage`.
        arguments: the ring for the arrays of draws of `device.draw_many`.
    """

    __slots__ = (
        "__weakref__",
        "_core",
        "_indices",
        "_layouts",
        "_mesh_owner",
        "_vertex_arrays",
        "_vertices",
        "arguments",
        "uniforms",
    )

    def __init__(self, core: Core, capacity: int = 1 << 16, arena: Arena | None = None) -> None:
        """Allocate from rings of initially `capacity` bytes each, or everything from one arena."""
        self._core = core
        memories: list[Ring | Arena] = [arena] * 4 if arena is not None else []
        if arena is None:
            for label in ("transient constants", "transient vertices", "transient indices", "draw arguments"):
                ring = Ring(
                    core.backend,
                    core.timeline,
                    core.new_id,
                    capacity,
                    label,
                    check=core.check_ready,
                    restarts=core.orders_writes,
                )
                core.frame_rings.append(ring)
                memories.append(ring)
            core.frame_rings.append(self)
        uniform_memory, self._vertices, self._indices, self.arguments = memories
        self.uniforms = UniformRing(core, uniform_memory)
        self._mesh_owner = TransientOwner(core, "transient memory")
        self._vertex_arrays: dict[_VertexArrayKey, Id] = {}
        self._layouts: set[tuple[object, ...]] = set()  # that fit their program

    def __repr__(self) -> str:
        return f"TransientMemory({self.capacity} bytes)"

    @property
    def capacity(self) -> int:
        """Total size in bytes."""
        memories = {
            id(ring): ring for ring in (self.uniforms.memory, self._vertices, self._indices, self.arguments)
        }
        return sum(memory.capacity for memory in memories.values() if memory.buffer)

    @overload
    def uniform(self, value: NDArray[Any]) -> UniformRange[Any]: ...

    @overload
    def uniform(self, value: T) -> UniformRange[T]: ...

    def uniform(self, value: Any) -> UniformRange[Any]:
        """Upload constants for the draws of this frame: a struct, or a single value; see `Device.uniform`."""
        core = self._core
        core.check_command()
        kind: Any = type(value)
        try:
            if isinstance(value, Struct):
                data = value.to_bytes()
            else:
                kind, constants = as_constants(ArgumentChecker("transient.uniform"), value)
                data = constants.to_bytes()
        except RhiError as error:  # also of structs, which may have no layout in memory
            core.refusals.note(error)
            raise
        return self.uniforms.push(data, kind)

    def storage(self, element: type[T], source: int | ArrayLike) -> StorageRange[T]:
        """Upload an array that the draws and dispatches of this frame read as `Storage[T]`; see
        `Device.storage`.

        Shaders can't write it: it can't be bound as `StorageRW[T]`.

        Raises:
            ValidationError: `layout-mismatch`, as there.
        """
        core = self._core
        core.check_command()
        check = ArgumentChecker("transient.storage", core.refuse)
        dtype = storage_dtype(check, element)
        data = as_storage(check, core, element, source, dtype, core.capabilities.max_storage_bytes)
        core.upload_bytes += data.nbytes
        memory = self.uniforms.memory
        offset = memory.write(
            data.reshape(-1).view(np.uint8).data, data.nbytes, core.capabilities.storage_alignment
        )
        count = data.nbytes // dtype.itemsize
        return StorageRange(memory.buffer, offset, data.nbytes, element, count, self._mesh_owner)

    def mesh(
        self,
        program: Program[...],
        vertices: VertexArrays | int,
        indices: ArrayLike | None = None,
        primitive: Primitive = Primitive.TRIANGLES,
        *,
        instances: VertexArrays | None = None,
    ) -> TransientMesh:
        """Upload a mesh for one program, valid in this frame; arrays are checked and read as those of
        `Device.mesh`.

        Args:
            vertices: a structured array, a dict of arrays by attribute name, or a number of vertices without
                any.
            indices: integers into `vertices`; the largest uint16 or uint32 restarts a
                strip, a fan or quads.
            instances: as for `vertices`, with one element per instance.

        Raises:
            ValidationError: `immediate-vertex` if the arrays don't provide the inputs of the program's vertex
                stage, or contain NaN; `mesh-index`.
        """
        call = "transient.mesh"
        core = self._core
        core.check_command()
        check = ArgumentChecker(call, core.refuse)
        check_program(core, program, call)
        check.choice("primitive", primitive, Primitive)
        count = to_integer(vertices)
        vertex_array = None
        instance_array = None
        index_array = None
        if count is None:
            vertex_array = as_structured(core, cast("VertexArrays", vertices), IMMEDIATE_VERTEX, call)
            count = len(vertex_array)
        elif not 1 <= count < 1 << 31:
            core.refuse(IMMEDIATE_VERTEX, call, f"{count} vertices", "1 to 2**31 - 1")
        if instances is not None:
            instance_array = as_structured(core, instances, IMMEDIATE_VERTEX, call)
        if indices is not None:
            index_array = match_indices(core, indices, count, call)
        return self.upload_mesh(program, count, vertex_array, index_array, instance_array, primitive)

    def upload_mesh(
        self,
        program: Program[...],
        vertex_count: int,
        vertices: NDArray[Any] | None,
        indices: NDArray[Any] | None,
        instances: NDArray[Any] | None,
        primitive: Primitive,
    ) -> TransientMesh:
        """Upload a mesh whose arrays were checked."""
        core, attributes = self._core, program.descriptor.attributes
        array_sources = [
            (array, per) for array, per in ((vertices, False), (instances, True)) if array is not None
        ]
        layout = (program.id, *((array.dtype, per_instance) for array, per_instance in array_sources))
        if layout not in self._layouts:
            # Before anything is uploaded: do the arrays have the fields that the program reads?
            parts = [StreamSource(0, array.dtype, per_instance) for array, per_instance in array_sources]
            describe_streams(core, parts, attributes, IMMEDIATE_VERTEX, "transient.mesh")
            self._layouts.add(layout)
        sources, start = [], 0
        for array, per_instance in array_sources:
            stride = array.dtype.itemsize
            offset = self._upload(self._vertices, array, stride)
            # Vertices are counted from the start of the ring, so that all meshes of a layout share a vertex
            # array. Instances can't be: shaders count them from 0. So their vertex array begins at their own
            # offset.
            if not per_instance:
                start = offset // stride
            sources.append(
                StreamSource(self._vertices.buffer, array.dtype, per_instance, offset if per_instance else 0)
            )
        first = start
        base = 0
        index_buffer = 0
        index_format = IndexFormat.UINT32
        if indices is not None:
            size = indices.dtype.itemsize
            first, base = self._upload(self._indices, indices, size) // size, start
            index_buffer = self._indices.buffer
            index_format = IndexFormat.UINT16 if size == 2 else IndexFormat.UINT32
        vertex_array = self._get_vertex_array(program, tuple(sources), index_buffer, index_format)
        count = vertex_count if indices is None else len(indices)
        data = TransientMeshData(
            core,
            (self._mesh_owner,),
            {program: vertex_array},
            vertex_count,
            instance_field_names(vertices, instances),
            0 if instances is None else len(instances),
            indices is not None,
            count,
            first,
            base,
        )
        return TransientMesh(data, primitive, first, count, base)

    def _upload(self, memory: Ring | Arena, array: NDArray[Any], alignment: int) -> int:
        """Copy an array to memory and return its offset there."""
        self._core.upload_bytes += array.nbytes
        return memory.write(np.ascontiguousarray(array).view(np.uint8).data, array.nbytes, alignment)

    def _get_vertex_array(
        self,
        program: Program[...],
        sources: tuple[StreamSource, ...],
        index_buffer: Id,
        index_format: IndexFormat,
    ) -> Id:
        """Return the vertex array for a program that reads these sources, creating it if there is none."""
        core, key = self._core, (program.id, sources, index_buffer, index_format)
        vertex_array = self._vertex_arrays.get(key)
        if vertex_array is None:
            core.check_ready()
            streams = describe_streams(
                core, sources, program.descriptor.attributes, IMMEDIATE_VERTEX, "transient.mesh"
            )
            descriptor = VertexArrayDescriptor(program.id, streams, index_buffer, index_format)
            with DeferredInterrupts():
                vertex_array = core.new_id()
                core.create(core.backend.create_vertex_array, vertex_array, descriptor)
                self._vertex_arrays[key] = vertex_array
                if not core.records:  # else a command buffer owns them
                    core.timeline.watch(self, program.id)
        return vertex_array

    def note_retired(self, resource: Id) -> None:
        """Drop the vertex arrays of a program that is destroyed."""
        for key in [key for key in self._vertex_arrays if key[0] == resource]:
            self._core.timeline.retire(self._vertex_arrays.pop(key))

    def mark(self, fence: int) -> None:
        """End the frame: destroy the vertex arrays that no later frame uses, as `Ring.mark` frees the rings'
        memory.

        These are the vertex arrays of outgrown buffers and of instances. If there are very many, most belong
        to destroyed programs, and all are destroyed.
        """
        if not self._vertex_arrays and not self._layouts:
            return
        crowded = len(self._layouts) > MAX_LAYOUTS
        if crowded:
            self._layouts.clear()
        current = (self._vertices.buffer, self._indices.buffer, 0)
        for key in list(self._vertex_arrays):
            _, sources, index_buffer, _ = key
            if (
                crowded
                or index_buffer not in current[1:]
                or any(source.buffer != current[0] or source.per_instance for source in sources)
            ):
                with DeferredInterrupts():
                    self._core.timeline.retire(self._vertex_arrays.pop(key))


@dataclass(slots=True, eq=False)
class TransientMeshData(DrawableData):
    """The vertices of a transient mesh, and where they and its indices begin in their rings."""

    first: int = 0
    base_vertex: int = 0


class TransientMesh(Drawable):
    """A mesh in transient memory, for one program, or a part of it; created by `device.transient.mesh`.

    `first` and `base_vertex` count from the start of the frame's memory, since that is what a draw needs.
    """

    __slots__ = ()
    data: TransientMeshData

    def __repr__(self) -> str:
        return f"TransientMesh({self.primitive.name}, {self.first - self.data.first}+{self.count})"

    def offset_draws(self, draws: NDArray[Any]) -> NDArray[Any]:
        """Return draws as the backend needs them: counted from the start of the frame's memory."""
        placed = draws.copy()
        placed["first"] += self.data.first
        if self.is_indexed:
            placed["base_vertex"] += self.data.base_vertex
        return placed

    def _part(
        self, first: int, count: int, base_vertex: int, base_instance: int, primitive: Primitive
    ) -> TransientMesh:
        data = self.data
        return TransientMesh(
            data, primitive, data.first + first, count, data.base_vertex + base_vertex, base_instance
        )

    def create_vertex_array(
        self, key: object, program: Id, name: str, attributes: tuple[Attribute, ...]
    ) -> NoReturn:
        """Refuse the draw: the transient mesh was created for another program."""
        self.core.refuse(
            MESH_ATTRIBUTE,
            f"draw of program {name!r}",
            "a transient mesh that was made for another program",
            "one made for this one",
        )


def vertex_dtype(attributes: tuple[Attribute, ...]) -> np.dtype[Any]:
    """Return the NumPy dtype of tightly packed vertices with these attributes."""
    codes = {"float": "<f4", "int": "<i4", "uint": "<u4"}
    fields: list[Any] = []
    for attribute in attributes:
        components, scalar = attribute_shape(attribute)
        fields.append(
            (attribute.name, codes[scalar], (components,))
            if components > 1
            else (attribute.name, codes[scalar])
        )
    return np.dtype(fields)


def pack_vertices(
    core: Core, attributes: tuple[Attribute, ...], dtype: np.dtype[Any], source: VertexArrays, call: str
) -> NDArray[Any]:
    """Return arrays as a copy of tightly packed vertices with these attributes, converted as a draw would
    read them.

    Args:
        dtype: the attributes' `vertex_dtype`.

    Raises:
        ValidationError: `immediate-vertex` if a field is missing or has a type that the vertex stage can't
            read.
    """
    rows = as_structured(core, source, IMMEDIATE_VERTEX, call, minimum=0)
    if rows.dtype == dtype:
        return np.array(rows)
    describe_streams(core, [StreamSource(0, rows.dtype, False)], attributes, IMMEDIATE_VERTEX, call)
    packed = np.empty(len(rows), dtype)
    for attribute in attributes:
        field, column = rows[attribute.name], packed[attribute.name]
        if field.ndim > 1:
            field = field[:, : column.shape[1]] if column.ndim > 1 else field[:, 0]
        if attribute_shape(attribute)[1] == "float" and field.dtype.kind in "iu":  # normalised
            column[...] = np.maximum(field / np.float32(np.iinfo(field.dtype).max), -1.0)
        else:
            column[...] = field
    return packed
