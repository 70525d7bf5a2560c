"""Transient memory: constants, vertices and indices that live for one frame (thesis 4.3).

- `TransientMemory` uploads them to rings; its ranges and meshes are valid until the frame is presented.
- Vertices are laid out as the program's vertex stage reads them.
- A command buffer has transient memory of its own, with the same lifetime: an `Arena` instead of the rings.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, NoReturn, TypeVar

import numpy as np
from numpy.typing import NDArray
from typing_extensions import Buffer as BytesLike

from rhi.contract.descriptors import (
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
from rhi.device.core.core import Core
from rhi.device.core.interrupts import HeldInterrupts
from rhi.device.core.ring import Ring
from rhi.device.resources.meshes import Drawable, check_finite, match_indices
from rhi.device.resources.programs import Program
from rhi.errors import RhiError
from rhi.errors.rules import IMMEDIATE_VERTEX, MESH_ATTRIBUTE, RESOURCE_DESTROYED
from rhi.shading.language.bindings import UniformRange

if TYPE_CHECKING:
    from rhi.shading import Struct

__rhi_internal__ = True

S = TypeVar("S", bound="Struct")

_FLOAT_FORMATS = {f.components: f for f in VertexFormat if f.code == "f4"}
_INT_FORMATS = {f.components: f for f in VertexFormat if f.code == "i4"}
_UINT_FORMATS = {f.components: f for f in VertexFormat if f.code == "u4" and not f.normalized}
_BY_SCALAR = {"float": _FLOAT_FORMATS, "int": _INT_FORMATS, "uint": _UINT_FORMATS}


class TransientOwner:
    """The owner of transient memory, in place of a resource, for the checks of bindings and meshes.

    For constants (with a `buffer`), a new one is created when their ring has grown.
    """

    __slots__ = ("bind_uniform", "core", "destroyed", "label")

    def __init__(self, core: Core, label: str, buffer: Id = 0) -> None:
        self.core = core
        if buffer:
            self.bind_uniform = core.prepare_uniform(buffer)
        self.destroyed = False
        self.label = label


class Arena:
    """Memory that only grows, uploaded to the backend as one buffer at the first execution.

    It has the part of the interface of `Ring` that `TransientMemory` uses.
    """

    __slots__ = ("buffer", "data", "generation")

    def __init__(self, buffer: Id) -> None:
        self.buffer = buffer
        self.generation = 0
        self.data = bytearray()

    @property
    def capacity(self) -> int:
        """Number of bytes allocated."""
        return len(self.data)

    def write(self, data: BytesLike, size: int, alignment: int) -> int:
        """Append `size` bytes and return their offset, a multiple of `alignment`."""
        self.data.extend(bytes(-len(self.data) % alignment))
        offset = len(self.data)
        self.data.extend(memoryview(data)[:size])
        return offset


class TransientMemory:
    """Memory for data that is used in only one frame, or only one command buffer.

    Attributes:
        arguments: the ring for the arrays of draws of `device.draw_many`.
    """

    __slots__ = ("__weakref__", "_constants", "_core", "_indices", "_mesh_owner", "_owner", "_owner_generation",
                 "_vertex_arrays", "_vertices", "arguments")  # fmt: skip

    def __init__(self, core: Core, capacity: int = 1 << 16, arena: Arena | None = None) -> None:
        """Allocate from rings of initially `capacity` bytes each, or everything from one arena."""
        self._core = core
        memories: list[Ring | Arena] = [arena] * 4 if arena is not None else []
        if arena is None:
            for label in ("transient constants", "transient vertices", "transient indices", "draw arguments"):
                ring = Ring(core.backend, core.timeline, core.new_id, capacity, label)
                core.frame_rings.append(ring)
                memories.append(ring)
        self._constants, self._vertices, self._indices, self.arguments = memories
        self._owner: TransientOwner | None = None
        self._owner_generation = 0
        self._mesh_owner = TransientOwner(core, "transient vertices")
        self._vertex_arrays: dict[tuple[object, ...], Id] = {}

    @property
    def capacity(self) -> int:
        """Total size in bytes."""
        memories = {
            id(each): each for each in (self._constants, self._vertices, self._indices, self.arguments)
        }
        return sum(memory.capacity for memory in memories.values() if memory.buffer)

    def uniform(self, value: S) -> UniformRange[S]:
        """Upload constants for the draws of this frame."""
        core = self._core
        core.check_open()
        try:
            data = value.to_bytes()
        except RhiError as error:  # a struct without a layout in memory
            core.refusals.note(error)
            raise
        core.upload_bytes += len(data)
        offset = self._constants.write(data, len(data), core.capabilities.uniform_alignment)
        if self._owner is None or self._constants.generation != self._owner_generation:
            # The ring has moved to a larger buffer. Ranges of the old one stay valid for this frame; a new owner
            # makes draws bind the new buffer.
            self._owner = TransientOwner(core, "transient constants", self._constants.buffer)
            self._owner_generation = self._constants.generation
        return UniformRange(self._constants.buffer, offset, len(data), type(value), self._owner)

    def mesh(
        self,
        program: Program[Any],
        vertices: NDArray[Any],
        indices: NDArray[Any] | None = None,
        primitive: Primitive = Primitive.TRIANGLES,
    ) -> TransientMesh:
        """Upload a mesh for one program, valid in this frame.

        Args:
            vertices: (n,), a structured array with the program's vertex fields.
            indices: integers into `vertices`; the largest uint16 or uint32 restarts a strip.

        Raises:
            ValidationError: `immediate-vertex`, `mesh-index`.
        """
        self._core.check_open()
        array = match_vertices(self._core, program, vertices)
        if indices is not None:
            indices = match_indices(self._core, indices, len(array), "transient.mesh")
        return self.place_mesh(program, array, indices, primitive)

    def place_mesh(
        self, program: Program[Any], vertices: NDArray[Any], indices: NDArray[Any] | None, primitive: Primitive
    ) -> TransientMesh:  # fmt: skip
        """Upload a mesh whose arrays come from `match_vertices` and `match_indices`."""
        vertex_array, first, base = self._place(program, vertices, indices)
        count = len(vertices) if indices is None else len(indices)
        return TransientMesh(
            self._core, {program: vertex_array}, primitive, first, count, base, self._mesh_owner
        )

    def _place(
        self, program: Program[Any], vertices: NDArray[Any], indices: NDArray[Any] | None
    ) -> tuple[Id, int, int]:
        """Upload vertices and indices to the rings; return (vertex array, first, base vertex)."""
        core = self._core
        stride = vertices.dtype.itemsize
        core.upload_bytes += vertices.nbytes
        start = self._vertices.write(vertices.view(np.uint8).data, vertices.nbytes, stride) // stride
        first, base, index_buffer, index_format = start, 0, 0, IndexFormat.UINT32
        if indices is not None:
            size = indices.dtype.itemsize
            core.upload_bytes += indices.nbytes
            first = self._indices.write(indices.view(np.uint8).data, indices.nbytes, size) // size
            base, index_buffer = start, self._indices.buffer
            index_format = IndexFormat.UINT16 if size == 2 else IndexFormat.UINT32
        key = (program.id, self._vertices.buffer, index_buffer, index_format)
        vertex_array = self._vertex_arrays.get(key)
        if vertex_array is None:
            self._drop_outdated()
            stream = VertexStream(
                self._vertices.buffer, 0, stride, False, vertex_attributes(program.descriptor.attributes)
            )
            descriptor = VertexArrayDescriptor(program.id, (stream,), index_buffer, index_format)
            with HeldInterrupts():
                vertex_array = core.new_id()
                core.create(core.backend.create_vertex_array, vertex_array, descriptor)
                self._vertex_arrays[key] = vertex_array
                if not core.records:  # else a command buffer owns them
                    core.timeline.watch(self, program.id)
        return vertex_array, first, base

    def note_retired(self, resource: Id) -> None:
        """Drop the vertex arrays of a program that is destroyed."""
        for key in [key for key in self._vertex_arrays if key[0] == resource]:
            self._core.timeline.retire(self._vertex_arrays.pop(key))

    def _drop_outdated(self) -> None:
        """Destroy the vertex arrays of buffers that a grown ring has replaced."""
        current = (self._vertices.buffer, self._indices.buffer, 0)
        with HeldInterrupts():
            for key in [k for k in self._vertex_arrays if k[1] != current[0] or k[2] not in current[1:]]:
                self._core.timeline.retire(self._vertex_arrays.pop(key))


class TransientMesh(Drawable):
    """A mesh in transient memory, laid out for one program."""

    __slots__ = ("_core",)

    def __init__(
        self, core: Core, vertex_arrays: dict[object, Id], primitive: Primitive, first: int, count: int,
        base_vertex: int, *owners: TransientOwner,
    ) -> None:  # fmt: skip
        super().__init__(primitive, first, count, base_vertex, 0, owners, vertex_arrays)
        self._core = core

    def __repr__(self) -> str:
        return f"TransientMesh({self.primitive.name}, {self.first}+{self.count})"

    def create_vertex_array(
        self, key: object, program: Id, name: str, attributes: tuple[Attribute, ...]
    ) -> NoReturn:
        """Refuse the draw: transient vertices are laid out for one program, and this is another one."""
        self._core.refuse(
            MESH_ATTRIBUTE,
            f"draw of program {name!r}",
            "a transient mesh that was made for another program",
            "one made for this one",
        )


EMPTY_MESH: Final = Drawable(Primitive.TRIANGLES, 0, 0, 0, 0, (), {})
"""Stands in for a mesh in checks that run before its vertices are uploaded."""


def vertex_attributes(attributes: tuple[Attribute, ...]) -> tuple[VertexAttribute, ...]:
    """Return the formats and offsets of attributes in tightly packed vertices."""
    packed, offset = [], 0
    for attribute in attributes:
        components, scalar = _shape(attribute)
        packed.append(VertexAttribute(attribute.location, _BY_SCALAR[scalar][components], offset))
        offset += 4 * components
    return tuple(packed)


def vertex_dtype(attributes: tuple[Attribute, ...]) -> np.dtype[Any]:
    """Return the NumPy dtype of tightly packed vertices with these attributes."""
    codes = {"float": "<f4", "int": "<i4", "uint": "<u4"}
    fields: list[Any] = []
    for attribute in attributes:
        components, scalar = _shape(attribute)
        fields.append((attribute.name, codes[scalar], (components,)) if components > 1
                      else (attribute.name, codes[scalar]))  # fmt: skip
    return np.dtype(fields)


def match_vertices(core: Core, program: Program[Any], array: NDArray[Any]) -> NDArray[Any]:
    """Return an array's fields as tightly packed vertices of the program.

    Raises:
        ValidationError: `immediate-vertex` if a field is missing or has another shape.
    """
    if program.destroyed:
        core.refuse(RESOURCE_DESTROYED, "vertices", repr(program))
    dtype = vertex_dtype(program.descriptor.attributes)
    given = np.asarray(array)
    names = dtype.names or ()
    if given.ndim != 1 or not given.dtype.names or any(
        name not in given.dtype.names or given.dtype[name].shape != dtype[name].shape for name in names
    ):  # fmt: skip
        core.refuse(IMMEDIATE_VERTEX, "vertices", f"shape {given.shape} of {given.dtype}", str(dtype))
    check_finite(core, given, IMMEDIATE_VERTEX, "vertices")
    if given.dtype == dtype:
        return np.ascontiguousarray(given)
    packed = np.empty(len(given), dtype)
    for name in names:
        packed[name] = given[name]
    return packed


def _shape(attribute: Attribute) -> tuple[int, str]:
    """Return an attribute's number of components and the name of its scalar type."""
    vector = attribute.type
    if isinstance(vector, VectorType):
        return vector.size, str(vector.scalar)
    return 1, str(vector)
