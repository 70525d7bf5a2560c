"""Draws that moderngl lacks: with base vertex or base instance, quads, indirect draws, and arrays of
draws."""

from __future__ import annotations

import ctypes
import struct
from collections.abc import Callable, Iterable
from functools import partial
from itertools import repeat
from typing import Any, Final, TypeAlias

import moderngl
import numpy as np
from numpy.typing import NDArray

from rhi.backends.gl import enums
from rhi.backends.gl.entry_points import EntryPoints
from rhi.backends.gl.gl_buffers import Buffers
from rhi.backends.gl.gl_formats import INDEX_TYPES, map_enums
from rhi.backends.gl.gl_programs import LinkedProgram, VertexArrays
from rhi.backends.gl.quads import QuadIndices
from rhi.contract.descriptors import DRAW, DRAW_UNINDEXED, Id, Primitive, VertexArrayDescriptor
from rhi.contract.formats import IndexFormat
from rhi.contract.limits import MAX_ELEMENTS

_RECORD: Final = struct.Struct("<5I")  # a draw's arguments; a base vertex isn't looked at
_add = partial(np.add, dtype=np.int64)
MODES: Final = map_enums(Primitive, QUADS="TRIANGLES")

DrawCalls: TypeAlias = tuple[Callable[..., object], Iterable[tuple[Any, ...]]]
"""A function, and the arguments for each call of it."""


class Draws:
    """Issues the draws of one context. Each method takes the bound program."""

    def __init__(
        self,
        context: moderngl.Context,
        gl: EntryPoints,
        arrays: VertexArrays,
        buffers: Buffers,
        bounds_arguments: bool,
    ) -> None:
        """`bounds_arguments`: whether the driver may end the process if arguments in a buffer lie beyond the
        mesh (`rhi.contract.driver_faults.is_indirect_unbounded`)."""
        self._context = context
        self._gl = gl
        self._bounds_arguments = bounds_arguments
        self._arrays = arrays
        self._buffers = buffers
        self._quads = QuadIndices(context, buffers, arrays.check_context)
        self.release = self._quads.release

    def draw(
        self,
        linked: LinkedProgram,
        vertex_array: Id,
        primitive: Primitive,
        first: int,
        count: int,
        instances: int,
        base_vertex: int,
        base_instance: int,
    ) -> None:
        """Draw quads, or draw with a base vertex or base instance."""
        gl, array = self._gl, self._arrays.descriptors[vertex_array]
        name = linked.use(vertex_array)
        if primitive is Primitive.QUADS:
            self._draw_quads(name, array, first, count, instances, base_vertex, base_instance)
        elif array.index_buffer:
            index_type = INDEX_TYPES[array.index_format]
            offset = ctypes.c_void_p(first * array.index_format.size)
            gl.DrawElementsInstancedBaseVertexBaseInstance(
                MODES[primitive], count, index_type, offset, instances, base_vertex, base_instance
            )
        else:
            gl.DrawArraysInstancedBaseInstance(MODES[primitive], first, count, instances, base_instance)
        if linked.writes_memory:
            linked.memory_barrier()

    def _draw_quads(
        self,
        name: int,
        array: VertexArrayDescriptor,
        first: int,
        count: int,
        instances: int,
        base_vertex: int,
        base_instance: int,
    ) -> None:
        """Draw quads as triangles."""
        gl, corners = self._gl, count // 4 * 6
        if not corners:  # then there are no indices to read
            return
        if array.index_buffer:
            form = array.index_format
            indices, offset, corners = self._quads.expand(array.index_buffer, form, first, count)
            if not corners:
                return
        else:
            form, base_vertex = IndexFormat.UINT32, first
            indices, offset = self._quads.reserve(count // 4), 0
        gl.VertexArrayElementBuffer(name, indices)
        gl.DrawElementsInstancedBaseVertexBaseInstance(
            enums.TRIANGLES,
            corners,
            INDEX_TYPES[form],
            ctypes.c_void_p(offset),
            instances,
            base_vertex,
            base_instance,
        )
        if array.index_buffer:
            gl.VertexArrayElementBuffer(name, self._buffers.objects[array.index_buffer].glo)

    def draw_indirect(
        self,
        linked: LinkedProgram,
        vertex_array: Id,
        primitive: Primitive,
        buffer: Id,
        offset: int,
        draws: int,
        stride: int,
        count_buffer: Id,
        count_offset: int,
    ) -> None:
        gl, mode = self._gl, MODES[primitive]
        array = self._arrays.descriptors[vertex_array]
        stride = stride or DRAW.itemsize
        bounded = self._bound(vertex_array, buffer, offset, draws, stride) if self._bounds_arguments else None
        linked.use(vertex_array)
        source = self._buffers.objects[buffer]
        if bounded is not None:
            source, offset, stride = self._context.buffer(bounded), 0, bounded.itemsize
        gl.BindBuffer(enums.DRAW_INDIRECT_BUFFER, source.glo)
        if count_buffer:
            gl.BindBuffer(enums.PARAMETER_BUFFER, self._buffers.objects[count_buffer].glo)
            if array.index_buffer:
                index_type = INDEX_TYPES[array.index_format]
                gl.MultiDrawElementsIndirectCountARB(mode, index_type, offset, count_offset, draws, stride)
            else:
                gl.MultiDrawArraysIndirectCountARB(mode, offset, count_offset, draws, stride)
            # With a parameter buffer bound, Mesa reads the count from it even in draws that have no count.
            gl.BindBuffer(enums.PARAMETER_BUFFER, 0)
        elif array.index_buffer:
            gl.MultiDrawElementsIndirect(mode, INDEX_TYPES[array.index_format], offset, draws, stride)
        else:
            gl.MultiDrawArraysIndirect(mode, offset, draws, stride)
        if bounded is not None:
            source.release()
        if linked.writes_memory:
            linked.memory_barrier()

    def _bound(
        self, vertex_array: Id, buffer: Id, offset: int, draws: int, stride: int
    ) -> NDArray[np.void] | None:
        """Return the arguments of draws without what lies beyond the mesh; None if nothing does.

        Only llvmpipe needs this. It reads arguments when a draw is called, so reading them here waits for
        nothing more.
        """
        elements = self._arrays.count_elements(vertex_array)
        indexed = bool(self._arrays.descriptors[vertex_array].index_buffer)
        record, maximum = (DRAW, elements.indices) if indexed else (DRAW_UNINDEXED, elements.vertices)
        data = self._buffers.peek(buffer, offset, (draws - 1) * stride + record.itemsize)
        reads_instances = elements.instances < MAX_ELEMENTS
        if draws == 1:  # NumPy takes ten times as long for one
            count, instances, first, *bases = _RECORD.unpack(data)
            if first + count <= maximum and not (
                reads_instances and bases[indexed] + instances > elements.instances
            ):
                return None
        arguments = np.ndarray((draws,), record, data, strides=(stride,))
        last = _add(arguments["first"], arguments["count"]).max()
        if last <= maximum and not (
            reads_instances
            and _add(arguments["base_instance"], arguments["instances"]).max() > elements.instances
        ):
            return None
        room = maximum - arguments["first"].astype(np.int64)
        instance_room = elements.instances - arguments["base_instance"].astype(np.int64)
        bounded = arguments.copy()
        bounded["count"] = np.minimum(arguments["count"], np.maximum(room, 0))
        bounded["first"][bounded["count"] == 0] = 0
        if reads_instances:
            bounded["instances"] = np.minimum(arguments["instances"], np.maximum(instance_room, 0))
        return bounded

    def prepare_calls(
        self, linked: LinkedProgram, vertex_array: Id, primitive: Primitive, draws: NDArray[Any]
    ) -> DrawCalls:
        """Return the calls that draw an array of `rhi.DRAW` or `rhi.DRAW_UNINDEXED`; not for QUADS. They are
        valid until something else is bound or drawn."""
        array, mode = self._arrays.descriptors[vertex_array], repeat(MODES[primitive])
        indexed = bool(array.index_buffer)
        count, first, instances, base_instance = (
            draws[name].tolist() for name in ("count", "first", "instances", "base_instance")
        )
        if not draws["base_instance"].any() and not (indexed and draws["base_vertex"].any()):
            return linked[vertex_array], zip(mode, count, first, instances, strict=False)
        linked.use(vertex_array)
        call: Callable[..., object]
        if indexed:
            call, form = self._gl.DrawElementsInstancedBaseVertexBaseInstance, array.index_format
            offsets = map(ctypes.c_void_p, (form.size * draws["first"].astype(np.int64)).tolist())
            base_vertex = draws["base_vertex"].tolist()
            arguments: Iterable[tuple[Any, ...]] = zip(
                mode,
                count,
                repeat(INDEX_TYPES[form]),
                offsets,
                instances,
                base_vertex,
                base_instance,
                strict=False,
            )
        else:
            call = self._gl.DrawArraysInstancedBaseInstance
            arguments = zip(mode, first, count, instances, base_instance, strict=False)
        return linked.then_memory_barrier(call) if linked.writes_memory else call, arguments
