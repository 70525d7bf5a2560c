"""Vertex arrays, and the draws that are prepared from them.

- A prepared draw names vertices and indices by address. It holds until the index buffer changes: each index
  buffer has a version, which callers of `prepare` compare with the one that they prepared for.
- A draw reads only within its buffers, whatever its indices and base vertex: an index beyond the vertices
  reads the last one, and what lies beyond without indices, or beyond the instances of an indirect draw, isn't
  drawn. The range of vertices that a draw's indices name is only used if it lies in the buffers; otherwise
  the kernel looks each index up, and clamps it.
- All changes of buffers come through here: the assembler keeps copies of indices, and boxes depend on
  vertices.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from typing_extensions import Buffer as BytesLike

from rhi.backends.cl.memory.cl_buffers import Buffers
from rhi.backends.cl.memory.pools import IndexList
from rhi.backends.cl.raster.assembly import Assembler
from rhi.backends.cl.raster.boxes import AttributeBoxes
from rhi.backends.cl.raster.cl_bindings import Bindings
from rhi.backends.cl.raster.cl_pipelines import Pipeline, VertexKernels
from rhi.backends.cl.raster.draw_tables import DrawSlot, PreparedDraws
from rhi.backends.cl.raster.kernel_structs import DRAW_STRUCT, GROUP, MAX_STREAMS
from rhi.contract.descriptors import Id, Primitive, VertexArrayDescriptor
from rhi.contract.limits import MAX_ELEMENTS, ElementCounts, count_elements
from rhi.contract.topology import CORNERS, LISTS


class VertexArray:
    """A vertex array and its kernels; `version[0]` changes with the contents of its index buffer."""

    __slots__ = ("descriptor", "elements", "id", "kernel", "pipeline", "version")

    def __init__(
        self,
        id: Id,
        descriptor: VertexArrayDescriptor,
        pipeline: Pipeline,
        kernel: VertexKernels,
        version: list[int],
        elements: ElementCounts,
    ) -> None:
        self.id = id
        self.elements = elements
        self.descriptor = descriptor
        self.pipeline = pipeline
        self.kernel = kernel
        self.version = version


class VertexArrays:
    """The vertex arrays of a device.

    Attributes:
        by_id: the vertex arrays.
    """

    def __init__(
        self,
        assembler: Assembler[IndexList],
        prepared: PreparedDraws,
        boxes: AttributeBoxes,
        buffers: Buffers,
        bindings: Bindings,
    ) -> None:
        self.by_id: dict[Id, VertexArray] = {}
        self._versions: dict[Id, list[int]] = {}  # by index buffer
        self._assembler = assembler
        self._prepared = prepared
        self._boxes = boxes
        self._buffers = buffers
        self._bindings = bindings

    def create(self, vertex_array: Id, descriptor: VertexArrayDescriptor, pipeline: Pipeline) -> None:
        if len(descriptor.streams) > MAX_STREAMS:
            raise AssertionError(f"{len(descriptor.streams)} vertex streams")
        version = self._versions.setdefault(descriptor.index_buffer, [0])
        if descriptor.index_buffer:
            self._assembler.watch(descriptor.index_buffer, self._buffers[descriptor.index_buffer].size)
        kernel = pipeline.get_vertex_kernels(descriptor.streams)
        self.by_id[vertex_array] = VertexArray(
            vertex_array,
            descriptor,
            pipeline,
            kernel,
            version,
            count_elements(descriptor, lambda buffer: self._buffers[buffer].size),
        )
        self._boxes.watch(vertex_array, {stream.buffer for stream in descriptor.streams})

    def destroy(self, vertex_array: Id) -> None:
        del self.by_id[vertex_array]
        self._boxes.unwatch(vertex_array)

    # -- changes of buffers ----------------------------------------------------------------------------------

    def write(self, buffer: Id, offset: int, data: BytesLike) -> None:
        """Note that the CPU writes a buffer."""
        self._assembler.write(buffer, offset, data)
        self._change_version(buffer)

    def change(self, buffer: Id, shader_wrote: bool = False) -> None:
        """Note that the device may write a buffer, by a copy, a clear or a shader."""
        self._buffers[buffer].device_wrote = True
        self._assembler.change(buffer, shader_wrote)
        self._change_version(buffer)

    def forget(self, resource: Id) -> None:
        """Drop the state of a buffer or texture that is being destroyed."""
        self._assembler.forget(resource)
        self._change_version(resource)
        self._versions.pop(resource, None)
        self._boxes.forget(resource)

    def _change_version(self, buffer: Id) -> None:
        version = self._versions.get(buffer)
        if version is not None:
            version[0] += 1
        self._boxes.change(buffer)

    # -- prepared draws --------------------------------------------------------------------------------------

    def prepare(
        self,
        slot: DrawSlot,
        array: VertexArray,
        primitive: Primitive,
        first: int,
        count: int,
        base_vertex: int,
        base_instance: int,
    ) -> None:
        """Fill in a prepared draw."""
        descriptor, elements = array.descriptor, array.elements
        if not descriptor.index_buffer:
            count = max(0, min(count, elements.vertices - first))
            first = first if count else 0
        assembly = self._assembler.assemble(
            primitive, first, count, descriptor.index_buffer, descriptor.index_format
        )
        slot.memory = assembly.memory
        row = np.zeros((), DRAW_STRUCT)
        row["primitives"], row["primitive"] = assembly.count // assembly.corners, assembly.corners
        indices, index_bytes = 0, 0
        if assembly.memory is not None:
            indices, index_bytes = assembly.memory.address + 4 * assembly.start, 4
        elif assembly.indexed:
            indices = (
                self._bindings.buffer_address(descriptor.index_buffer)
                + descriptor.index_format.size * assembly.start
            )
            index_bytes = descriptor.index_format.size
        base = assembly.base + (base_vertex if descriptor.index_buffer else 0)
        low, high = assembly.lowest, assembly.highest
        if low is not None and high is not None and not 0 <= low + base <= high + base < elements.vertices:
            low = None if assembly.indexed else low
        base = min(max(base, -MAX_ELEMENTS), MAX_ELEMENTS)
        if low is None or high is None:  # one vertex per index
            row["vertex_indices"], row["vertex_index_bytes"] = indices, index_bytes
            row["vertices"], row["first_vertex"] = assembly.count, base
        else:
            row["indices"], row["index_bytes"] = indices, index_bytes
            row["lowest"], row["vertices"] = low, high - low + 1
            row["first_vertex"] = low + base
        row["base_instance"] = min(base_instance, MAX_ELEMENTS)
        self._store(slot.number, array, row)

    def prepare_lists(
        self, numbers: NDArray[np.int64], array: VertexArray, primitive: Primitive, draws: NDArray[Any]
    ) -> bool:
        """Fill in prepared draws, by their numbers, for an array of draws; return False if they have to be
        prepared one by one, because of strips, restarts, or indices that the host doesn't know."""
        descriptor = array.descriptor
        if primitive not in LISTS:
            return False
        first, count = (draws[name].astype(np.int64) for name in ("first", "count"))
        corners = CORNERS[primitive]
        whole = count - count % corners
        rows = np.zeros(len(draws), DRAW_STRUCT)
        if descriptor.index_buffer:
            ranges = self._assembler.compute_index_ranges(
                first, count, descriptor.index_buffer, descriptor.index_format
            )
            if ranges is None:
                return False
            low, high = ranges
            size = descriptor.index_format.size
            rows["indices"] = self._bindings.buffer_address(descriptor.index_buffer) + size * first
            rows["index_bytes"] = size
            base = draws["base_vertex"]
            if (low + base < 0).any() or (high + base >= array.elements.vertices).any():
                return False
            rows["first_vertex"] = low + base
        else:
            low, high = first, first + whole - 1
            if (first + count > array.elements.vertices).any():
                return False
            rows["first_vertex"] = low
        rows["lowest"], rows["vertices"] = low, high - low + 1
        rows["primitives"], rows["primitive"] = whole // corners, corners
        rows["base_instance"] = np.minimum(draws["base_instance"], MAX_ELEMENTS)
        self._store(numbers, array, rows)
        return True

    def _store(self, numbers: int | NDArray[np.int64], array: VertexArray, rows: NDArray[Any]) -> None:
        """Store prepared draws, by their numbers; `rows`: `DRAW_STRUCT`s without their groups."""
        prepared, streams = self._prepared, array.descriptor.streams
        rows["primitive_groups"] = -(-rows["primitives"] // GROUP)
        rows["vertex_groups"] = -(-rows["vertices"] // GROUP)
        rows["last_vertex"], rows["last_instance"] = array.elements.vertices - 1, array.elements.instances - 1
        prepared.draws[numbers] = rows
        prepared.arrays[numbers], prepared.was_drawn[numbers] = array.id, False
        prepared.streams[numbers, : len(streams)] = [
            self._bindings.buffer_address(stream.buffer) + stream.offset for stream in streams
        ]
