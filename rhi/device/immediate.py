"""Immediate mode: geometry that is specified vertex by vertex and drawn once (thesis 4.3).

`Immediate` collects vertices, one at a time or as whole arrays, and draws them all at the end of its `with` block,
with one upload to transient memory and one draw (Listing 4.9, but without counts in advance).
"""

from __future__ import annotations

from types import TracebackType
from typing import TYPE_CHECKING, Any, Generic, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from rhi.contract.descriptors import Primitive
from rhi.device.resources.meshes import check_finite
from rhi.device.resources.programs import Program
from rhi.device.transient import EMPTY_MESH, TransientMemory, match_vertices, vertex_dtype
from rhi.errors.rules import IMMEDIATE_VERTEX

if TYPE_CHECKING:
    from rhi.shading import Struct

__rhi_internal__ = True

S = TypeVar("S", bound="Struct")


class Immediate(Generic[S]):
    """A `with device.immediate(program, Primitive.QUADS, …) as quads:` block; `quads.vertex(position=…)` fills it."""

    __slots__ = ("_arrays", "_bindings", "_dtype", "_memory", "_open", "_primitive", "_program", "_rows")

    def __init__(
        self, memory: TransientMemory, program: Program[Any], primitive: Primitive, bindings: dict[str, Any]
    ) -> None:
        program.check_names(bindings)
        if not program.descriptor.attributes:
            given = f"{program!r}, which reads no vertices"
            program.core.refuse(IMMEDIATE_VERTEX, "device.immediate", given, "a program with vertex inputs")
        self._memory = memory
        self._program = program
        self._primitive = primitive
        self._bindings = bindings
        self._dtype = vertex_dtype(program.descriptor.attributes)
        self._rows: list[tuple[Any, ...]] = []
        self._arrays: list[NDArray[Any]] = []
        self._open = False

    def vertex(self, **fields: Any) -> None:
        """Add one vertex, with a value for each attribute of the program's vertex stage.

        Raises:
            ValidationError: `immediate-vertex` for a missing or unknown attribute.
        """
        names = self._dtype.names or ()
        try:
            row = tuple(fields[name] for name in names)
        except KeyError:
            row = ()
        if len(row) != len(fields) or not self._open:
            given = ", ".join(fields) if self._open else "a closed block"
            allowed = ", ".join(names) + " inside the `with` block"
            self._program.core.refuse(IMMEDIATE_VERTEX, "Immediate.vertex", given, allowed)
        self._rows.append(row)

    def vertices(self, array: NDArray[Any]) -> None:
        """Add many vertices: a structured array with the program's vertex fields."""
        program = self._program
        if not self._open:
            program.core.refuse(
                IMMEDIATE_VERTEX, "Immediate.vertices", "a closed block", "inside the `with` block"
            )
        matched = np.array(
            match_vertices(program.core, program, array)
        )  # a copy: the caller may change its array
        self._arrays += [self._collect(), matched]

    def __enter__(self) -> Self:
        self._program.core.check_command()
        self._open = True
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._open = False
        try:
            if kind is not None:
                return
            array = np.concatenate([*self._arrays, self._collect()])
        finally:
            self._rows.clear()
            self._arrays.clear()
        if not len(array):
            return
        # Everything is checked before the vertices are uploaded.
        program, core = self._program, self._program.core
        program.bind(program.check_can_draw, EMPTY_MESH, self._bindings)
        mesh = self._memory.place_mesh(program, array, None, self._primitive)
        core.flush_states()
        program.draw_unprepared(mesh, 1)
        core.draws += 1

    def _collect(self) -> NDArray[Any]:
        """Return the single vertices added since the latest array; they are kept if one of them is refused."""
        core = self._program.core
        try:
            array = np.array(self._rows, self._dtype)
        except (TypeError, ValueError) as error:
            core.refuse(IMMEDIATE_VERTEX, "Immediate.vertex", str(error), str(self._dtype))
        check_finite(core, array, IMMEDIATE_VERTEX, "Immediate.vertex")
        self._rows.clear()
        return array
