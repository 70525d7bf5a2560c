"""Immediate mode: geometry that is specified vertex by vertex and drawn once (thesis 4.3).

`Immediate` collects vertices, one at a time or as whole arrays, and draws them all at the end of its `with`
block, with one upload to transient memory and one draw (Listing 4.9, but without counts in advance).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Generic, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from rhi.contract.descriptors import Primitive
from rhi.device.resources.meshes import Drawable, DrawableData, as_structured, check_finite
from rhi.device.resources.programs import Program
from rhi.device.transient import TransientMemory, VertexArrays, pack_vertices, vertex_dtype
from rhi.errors.arguments import ArgumentChecker
from rhi.errors.device_objects import DeviceObject
from rhi.errors.rules import IMMEDIATE_VERTEX, SCOPE_ORDER

if TYPE_CHECKING:
    from rhi.shading import Struct

S = TypeVar("S", bound="Struct")


class Immediate(DeviceObject, Generic[S]):
    """A `with device.immediate(program, Primitive.QUADS, …) as quads:` block; `quads.vertex(position=…)`
    fills it."""

    __slots__ = (
        "_arrays",
        "_attributes",
        "_bindings",
        "_dtype",
        "_instances",
        "_memory",
        "_open",
        "_primitive",
        "_program",
        "_vertices",
    )

    def __init__(
        self, memory: TransientMemory, program: Program[...], primitive: Primitive, bindings: dict[str, Any]
    ) -> None:
        program.check_names(bindings)
        if not program.descriptor.attributes:
            given = f"{program!r}, which reads no vertices"
            program.core.refuse(IMMEDIATE_VERTEX, "device.immediate", given, "a program with vertex inputs")
        self._memory = memory
        self._program = program
        self._primitive = primitive
        self._bindings = bindings
        self._attributes = program.descriptor.attributes
        self._dtype = vertex_dtype(self._attributes)
        self._instances: NDArray[Any] | None = None
        self._vertices: list[tuple[Any, ...]] = []
        self._arrays: list[NDArray[Any]] = []
        self._open = False

    def vertex(self, **fields: Any) -> None:
        """Add one vertex, with a value for each attribute of the program's vertex stage.

        Raises:
            ValidationError: `immediate-vertex` for a missing or unknown attribute.
        """
        names = self._dtype.names or ()
        try:
            row: tuple[Any, ...] | None = tuple(fields[name] for name in names)
        except KeyError:
            row = None
        if row is None or len(row) != len(fields) or not self._open:
            given = ", ".join(fields) if self._open else "a closed block"
            allowed = ", ".join(names) + " inside the `with` block"
            self._program.core.refuse(IMMEDIATE_VERTEX, "Immediate.vertex", given, allowed)
        self._vertices.append(row)

    def vertices(self, arrays: VertexArrays) -> None:
        """Add many vertices: a structured array with the program's vertex fields, or a dict of arrays by
        their names.

        Raises:
            ValidationError: `immediate-vertex`, as for `Device.mesh`.
        """
        core = self._program.core
        self._check_open("Immediate.vertices")
        packed = pack_vertices(core, self._attributes, self._dtype, arrays, "Immediate.vertices")
        self._arrays += [self._collect(), packed]

    def instances(self, arrays: VertexArrays) -> None:
        """Draw the vertices once for each element of these arrays, which hold some of the program's vertex
        fields.

        It comes before the first vertex; the vertices have the other fields.

        Raises:
            ValidationError: `immediate-vertex` for arrays without such a field, after a vertex, or a second
                time.
        """
        core, call = self._program.core, "Immediate.instances"
        self._check_open(call)
        if self._vertices or self._arrays or self._instances is not None:
            given = "other instances before" if self._instances is not None else "vertices before"
            core.refuse(IMMEDIATE_VERTEX, call, given, "instances once, and before the first vertex")
        array = as_structured(core, arrays, IMMEDIATE_VERTEX, call)
        have = array.dtype.names or ()
        taken = tuple(attribute for attribute in self._attributes if attribute.name in have)
        if not taken:
            need = ", ".join(attribute.name for attribute in self._attributes)
            core.refuse(IMMEDIATE_VERTEX, call, f"fields {', '.join(have)}", f"at least one of {need}")
        self._instances = pack_vertices(core, taken, vertex_dtype(taken), array, call)
        self._attributes = tuple(a for a in self._attributes if a not in taken)
        self._dtype = vertex_dtype(self._attributes)

    def __enter__(self) -> Self:
        core = self._program.core
        core.check_command()
        if self._open:
            core.refuse(
                SCOPE_ORDER, "device.immediate", "a block that is open already", "one begin for each end"
            )
        self._open = True
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if not self._open:
            self._program.core.scopes.refuse_unopened("device.immediate", error)
        self._open = False
        try:
            if kind is not None:
                return
            array = np.concatenate([*self._arrays, self._collect()])
        finally:
            instances, self._instances = self._instances, None
            if instances is not None:  # the block may be used again
                self._attributes = self._program.descriptor.attributes
                self._dtype = vertex_dtype(self._attributes)
            self._vertices.clear()
            self._arrays.clear()
        if not len(array):
            return
        # Everything is checked before the vertices are uploaded.
        program, core = self._program, self._program.core
        unplaced = Drawable(DrawableData(core), self._primitive, 0, 0)
        program.bind(program.check_can_draw, unplaced, self._bindings)
        vertices = array if array.dtype.names else None  # without fields only their number counts
        mesh = self._memory.upload_mesh(program, len(array), vertices, None, instances, self._primitive)
        core.flush_states()
        program.draw_unprepared(mesh, 1 if instances is None else len(instances))
        core.draws += 1

    def _collect(self) -> NDArray[Any]:
        """Pack the single vertices that were added since the latest array. They stay if one of them is
        refused."""
        core, call = self._program.core, "Immediate.vertex"
        check = ArgumentChecker(call, core.refuse, IMMEDIATE_VERTEX)
        array = np.empty(len(self._vertices), self._dtype)
        if not self._vertices:
            return array
        for number, name in enumerate(self._dtype.names or ()):
            column = array[name]
            values = check.array(name, [row[number] for row in self._vertices])
            if values.shape != column.shape or values.dtype.kind not in (
                "iu" if column.dtype.kind in "iu" else "iuf"
            ):
                core.refuse(IMMEDIATE_VERTEX, call, f"{name}: {values[-1]!r}", str(self._dtype[name]))
            if column.dtype.kind in "iu" and not _fits(values, column.dtype):
                core.refuse(IMMEDIATE_VERTEX, call, f"{name}: {values!r}", str(self._dtype[name]))
            with np.errstate(over="ignore"):  # numbers that are too large become infinite, and are refused
                column[...] = values
        check_finite(core, array, IMMEDIATE_VERTEX, call)
        self._vertices.clear()
        return array

    def _check_open(self, call: str) -> None:
        if not self._open:
            self._program.core.refuse(IMMEDIATE_VERTEX, call, "a closed block", "inside the `with` block")


def _fits(values: NDArray[Any], dtype: np.dtype[Any]) -> bool:
    limits = np.iinfo(dtype)
    return bool(limits.min <= values.min() and values.max() <= limits.max)
