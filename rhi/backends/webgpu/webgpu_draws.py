"""Draws and dispatches.

- A prepared draw is one call of the implementation if nothing has changed, two if only the offset of a uniform has,
  and a few more for another mesh of the same layout.
- A program that writes memory draws in a segment of its own: WebGPU makes writes visible between passes only.
- Fans and quads are drawn as indexed triangles. Without indices, all share one index buffer for each kind.
  Indexed quads are expanded on the device, once for each version of their buffer; indexed fans, which may
  restart, on the CPU, which waits.
- WebGPU's lists of points, lines and triangles don't restart. Those whose indices the CPU has written are
  drawn with indices of whole primitives, computed once for each version of their buffer.
- Draws without indices have records of 5 words in the contract and of 4 in WebGPU, so a compute stage
  rewrites their arguments. It also rewrites arguments with other strides, or with counts that the device
  can't read.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from collections.abc import Set as AbstractSet
from typing import Final

import numpy as np
from numpy.typing import NDArray

from rhi.backends.webgpu.command_encoder import Stream
from rhi.backends.webgpu.implementation import DrawFunctions, GpuObject, Handle
from rhi.backends.webgpu.tools import EXPAND_QUADS, LIST_DRAWS, RESTART_QUADS, Tools, expand_fan
from rhi.backends.webgpu.webgpu_bindings import BoundResources
from rhi.backends.webgpu.webgpu_buffers import RESTART_BITS, Buffers, GpuBuffer
from rhi.backends.webgpu.webgpu_flags import GpuBufferUsage
from rhi.backends.webgpu.webgpu_pipelines import Pipelines, States, TargetFormats
from rhi.backends.webgpu.webgpu_programs import GpuProgram, PipelineLayout
from rhi.contract.descriptors import Id, Primitive, VertexArrayDescriptor
from rhi.contract.formats import IndexFormat
from rhi.contract.limits import count_elements, draw_faults
from rhi.contract.states import StateChange, clamp_rectangle
from rhi.contract.topology import LISTS, list_primitives

_FAN: Final = Primitive.TRIANGLE_FAN
_QUADS: Final = Primitive.QUADS
_CONVERTED: Final = frozenset({_FAN, _QUADS})
_MAX_LISTED: Final = 64
"""Ranges of an index buffer with restarts whose whole primitives are kept."""
_RECORD: Final = 20
"""Bytes of a draw's arguments in the contract."""
_CORNERS: Final = np.array([0, 1, 2, 0, 2, 3], np.uint32)
_SMALLEST: Final = 1024


class GpuVertexArray:
    """A vertex array. `key` is the same object for all arrays of one layout, `restarts` the index format of
    its strips' pipelines, `may_restart` whether its indices may restart, as they were when it was bound
    last. `packed` is what binds it, once it was bound, where commands are packed, and `buffers` what that uses."""

    __slots__ = (
        "buffers",
        "descriptor",
        "expanded",
        "indexed",
        "key",
        "listed",
        "may_restart",
        "packed",
        "restart_bit",
        "restarts",
        "values",
    )

    def __init__(self, descriptor: VertexArrayDescriptor, key: object) -> None:
        self.descriptor = descriptor
        self.indexed = descriptor.index_buffer != 0
        self.restarts = descriptor.index_format if self.indexed else None
        self.key = key
        self.expanded: tuple[tuple[int, int, int], GpuObject] | None = (
            None  # quads: (first, count, version), indices
        )
        self.restart_bit = RESTART_BITS[descriptor.index_format] if self.indexed else 0
        self.may_restart = 0
        self.packed = b""
        self.buffers: list[GpuBuffer] = []
        self.values: tuple[int, NDArray[np.integer]] | None = None  # version, all indices
        self.listed: dict[tuple[Primitive, int, int], tuple[int, GpuObject | None]] = {}  # size, indices


class Draws:
    """Draws of a device.

    Attributes:
        program: the bound program.
        targets: the formats of the open pass.
    """

    def __init__(
        self,
        device: GpuObject,
        stream: Stream,
        buffers: Buffers,
        bindings: BoundResources,
        states: States,
        pipelines: Pipelines,
        tools: Tools,
        features: AbstractSet[str],
    ) -> None:
        self._device = device
        self._stream = stream
        self._buffers = buffers
        self._bindings = bindings
        self._states = states
        self._pipelines = pipelines
        self._tools = tools
        implementation = self._implementation = stream.implementation
        self.use_functions(implementation)
        self._index_formats = implementation.index_formats
        self._counts_draws = "multi-draw-indirect-count" in features
        self._has_base_instances = "indirect-first-instance" in features
        self.program: GpuProgram | None = None
        self.targets: TargetFormats = ((), None, 1)
        self.arrays: dict[Id, GpuVertexArray] = {}
        self._keys: dict[object, object] = {}
        self._current: tuple[Id, Primitive] | None = None  # what the pass is ready to draw
        self._alike: tuple[object, ...] | None = (
            None  # the layout, primitive and restarts that its pipeline is for
        )
        self._layout: PipelineLayout | None = None
        self._alone = False  # the last draw wrote memory, so the next one begins a segment
        self._shared_indices: dict[Primitive, tuple[int, GpuObject]] = {}
        stream.on_begin.append(self._lose)

    def use_functions(self, functions: DrawFunctions) -> None:
        """Make the calls of later draws by these functions: those of passes, or those of bundles."""
        self._set_pipeline = functions.set_pipeline
        self._set_group = functions.set_bind_group
        self._set_vertices = functions.set_vertex_buffer
        self._set_indices = functions.set_index_buffer
        self._draw_vertices = functions.draw
        self._draw_indices = functions.draw_indexed

    # -- what is bound -----------------------------------------------------------------------------------

    def create_array(self, vertex_array: Id, descriptor: VertexArrayDescriptor) -> None:
        key = tuple((s.stride, s.per_instance, s.attributes) for s in descriptor.streams)
        self.arrays[vertex_array] = GpuVertexArray(descriptor, self._keys.setdefault(key, key))

    def destroy_array(self, vertex_array: Id) -> None:
        del self.arrays[vertex_array]

    def begin_pass(self, targets: TargetFormats) -> None:
        """Draw to targets of these formats from here on."""
        self.targets = targets
        self._current = self._alike = None
        self._alone = False

    def bind_program(self, program: GpuProgram) -> None:
        self.program = program
        self._current = self._alike = None
        self._bindings.invalidate()
        self._bindings.retextured = True

    def _lose(self) -> None:
        """Note that a segment begins, without any state set."""
        self.lose_bindings()
        self._states.moved = True

    def lose_bindings(self) -> None:
        """Note that no pipeline, group and buffer is set, as when a segment or a bundle begins."""
        self._current = self._alike = None
        self._bindings.invalidate()

    def open_segment(self) -> Handle:
        """Return the handle of the open segment; begin one if there is none, or if the last draw wrote memory."""
        stream = self._stream
        if self._alone:
            if stream.render is not None:
                stream.end_segment()
            self._alone = False
        if stream.render is None:
            stream.begin_segment()
        if self._states.moved:
            self._states.apply(stream.render, stream.pass_.size)  # type: ignore[union-attr]
        return stream.render

    def can_bundle(self, program: GpuProgram, vertex_array: Id, primitive: Primitive) -> bool:
        """True if a draw is a call of WebGPU, and needs nothing outside of its pass."""
        copies = program.written_images and program.textures
        expands = self.arrays[vertex_array].indexed and primitive in _CONVERTED
        return not (program.descriptor.writes_memory or copies or expands)

    def _select_layout(self, program: GpuProgram) -> PipelineLayout:
        if self._bindings.retextured or self._layout is None:
            layout = program.layout(self._bindings.unfiltered(program))
            if layout is not self._layout:
                self._layout = layout
                self._current = self._alike = None
                self._bindings.invalidate()
            self._bindings.retextured = False
        return self._layout

    def ready(self, vertex_array: Id, primitive: Primitive) -> Handle:
        """Return the handle of the render pass, ready for a draw."""
        stream = self._stream
        states = self._states
        bindings = self._bindings
        program = self.program
        assert program is not None
        writes = program.descriptor.writes_memory
        if writes or self._alone:
            if stream.render is not None:
                stream.end_segment()
            self._alone = writes
        layout = self._select_layout(program)
        copies = {}
        if program.written_images and program.textures:
            copies = bindings.copied(program)
        if stream.render is None:
            stream.begin_segment()
        render = stream.render
        array = self.arrays[vertex_array]
        alike = (array.key, primitive, array.restarts)
        if states.changed or alike != self._alike:
            pipeline = self._pipelines.get_render_pipeline(
                program, layout, array.descriptor, array.key, primitive, states, self.targets
            )
            self._set_pipeline(render, pipeline._internal)
            if stream.retained is not None:
                stream.retained.append(pipeline)
            self._alike = alike
            self._current = None
        if states.moved:
            states.apply(render, stream.pass_.size)  # type: ignore[union-attr]
        if bindings.changed:
            bindings.apply(program, layout, self._set_group, render)
        elif bindings.moved:
            bindings.move(program, self._set_group, render)
        if copies:
            self._set_group(
                render,
                2,
                bindings.sampling_copies(program, layout, copies)._internal,
                0,
                self._implementation.no_offsets,
            )
            bindings.dirty[2] = bindings.changed = True
        if self._current is None or self._current[0] != vertex_array:
            self._bind_array(render, vertex_array, array)
        self._current = (vertex_array, primitive)
        return render

    def _bind_array(self, render: Handle, vertex_array: Id, array: GpuVertexArray) -> None:
        descriptor, buffers, serial = array.descriptor, self._buffers.objects, self._stream.serial
        if array.packed:
            for buffer in array.buffers:
                buffer.serial = serial
            render += array.packed
            if array.indexed:
                array.may_restart = array.buffers[-1].restarts & array.restart_bit
            return
        set_vertices = self._set_vertices
        packs = self._implementation.pack_group is not None
        start = len(render) if packs else 0
        for number, stream in enumerate(descriptor.streams):
            buffer = buffers[stream.buffer]
            buffer.serial = serial
            set_vertices(render, number, buffer.handle, stream.offset, buffer.size - stream.offset)
        if array.indexed:
            buffer = buffers[descriptor.index_buffer]
            buffer.serial = serial
            self._set_indices(
                render, buffer.handle, self._index_formats[descriptor.index_format], 0, buffer.size
            )
            array.may_restart = buffer.restarts & array.restart_bit
        if packs:
            array.buffers = self.list_buffers(vertex_array)
            array.packed = bytes(render[start:])

    def list_buffers(self, vertex_array: Id) -> list[GpuBuffer]:
        """Return the buffers of a vertex array; that of indices is the last."""
        descriptor = self.arrays[vertex_array].descriptor
        used = [stream.buffer for stream in descriptor.streams]
        if descriptor.index_buffer:
            used.append(descriptor.index_buffer)
        return [self._buffers.objects[buffer] for buffer in used]

    # -- draws -------------------------------------------------------------------------------------------

    def draw(
        self,
        vertex_array: Id,
        primitive: Primitive,
        first: int,
        count: int,
        instances: int,
        base_vertex: int,
        base_instance: int,
    ) -> None:
        if primitive in _CONVERTED:
            self._draw_converted(vertex_array, primitive, first, count, instances, base_vertex, base_instance)
        elif self.arrays[vertex_array].indexed:
            if self._restarts(vertex_array, primitive, first, count):
                self._draw_converted(
                    vertex_array, primitive, first, count, instances, base_vertex, base_instance
                )
                return
            render = self.ready(vertex_array, primitive)
            self._draw_indices(render, count, instances, first, base_vertex, base_instance)
        else:
            self._draw_vertices(self.ready(vertex_array, primitive), count, instances, first, base_instance)

    def prepare(
        self,
        program: GpuProgram,
        vertex_array: Id,
        primitive: Primitive,
        first: int,
        count: int,
        base_vertex: int,
        base_instance: int,
    ) -> Callable[[int], object]:
        """See `rhi.contract.backend.SupportsPreparedDraws`."""
        array = self.arrays[vertex_array]
        copies = bool(program.written_images and program.textures)
        draw = self.draw
        indexed = array.indexed
        lists = primitive in LISTS
        streamed = indexed and self._buffers[array.descriptor.index_buffer].shadow is not None
        if (
            primitive in _CONVERTED
            or program.descriptor.writes_memory
            or copies
            or (lists and streamed)  # whose indices are looked at in each draw
        ):
            return lambda instances: draw(
                vertex_array, primitive, first, count, instances, base_vertex, base_instance
            )
        stream = self._stream
        states = self._states
        bindings = self._bindings
        key, alike = (vertex_array, primitive), (array.key, primitive, array.restarts)
        select_offsets, offset_array = program.select_offsets, program.offset_array
        uniform_count = len(program.uniforms)
        offset_slice = slice(0, uniform_count)
        bind_array = self._bind_array
        ready = self.ready
        set_group = self._set_group
        draw_vertices, draw_indices = self._draw_vertices, self._draw_indices
        record = self._implementation.pack_draw(indexed, count, first, base_vertex, base_instance)
        pack_group = self._implementation.pack_group

        def quick(instances: int) -> None:
            render = stream.render
            if render is None or states.changed or states.moved or bindings.changed or self._alone:
                render = ready(vertex_array, primitive)
            elif self._current is not key and self._current != key:
                if self._alike == alike and not bindings.retextured:
                    bind_array(render, vertex_array, array)
                    self._current = key
                else:
                    render = ready(vertex_array, primitive)
            if bindings.moved and pack_group is not None:
                pack = bindings.pack_offsets or bindings.prepare_offsets(pack_group, program, render)
                render += pack(*select_offsets(bindings.offsets))
                bindings.moved = False
            elif bindings.moved:  # as `BoundResources.move` does, without its frame
                offset_array[offset_slice] = select_offsets(bindings.offsets)
                set_group(render, 0, bindings.uniform_group, uniform_count, offset_array)
                bindings.moved = False
            if record is not None and instances == 1 and not (array.may_restart and lists):
                render += record
            elif indexed:
                if array.may_restart and lists:
                    draw(vertex_array, primitive, first, count, instances, base_vertex, base_instance)
                else:
                    draw_indices(render, count, instances, first, base_vertex, base_instance)
            else:
                draw_vertices(render, count, instances, first, base_instance)

        return quick

    def prepare_pipeline(
        self, program: GpuProgram, vertex_array: Id, targets: TargetFormats, changes: Sequence[StateChange]
    ) -> None:
        """Make the pipeline for triangles of a vertex array."""
        states = States(self._implementation)
        states.set([change for change in changes if change.type in states.values])
        array, layout = self.arrays[vertex_array], program.layout(())
        self._pipelines.get_render_pipeline(
            program, layout, array.descriptor, array.key, Primitive.TRIANGLES, states, targets
        )

    def _draw_converted(
        self,
        vertex_array: Id,
        primitive: Primitive,
        first: int,
        count: int,
        instances: int,
        base_vertex: int,
        base_instance: int,
        clip: Sequence[int] | None = None,
    ) -> None:
        """Draw fans or quads as triangles, and lists that restart as whole primitives; inside a clip of
        `draw_clipped`."""
        array = self.arrays[vertex_array]
        if primitive in LISTS:
            corners, indices = self._list(array, primitive, first, count)
            if indices is not None:
                self._draw_corners(
                    vertex_array, primitive, corners, indices, instances, base_vertex, base_instance, clip
                )
            return
        corners = count // 4 * 6 if primitive is _QUADS else max(0, count - 2) * 3
        if not corners:
            return
        if not array.indexed:
            indices, base = self._shared(primitive, corners), first
        elif primitive is _QUADS:
            indices, base = self._expand_quads(array, first, count), base_vertex
        else:
            triangles = self._expand_fan(array.descriptor, first, count)
            base, corners = base_vertex, triangles.size
            if not corners:
                return
            indices = self._indices(triangles)
        self._draw_corners(vertex_array, primitive, corners, indices, instances, base, base_instance, clip)

    def _draw_corners(
        self,
        vertex_array: Id,
        primitive: Primitive,
        corners: int,
        indices: GpuObject,
        instances: int,
        base: int,
        base_instance: int,
        clip: Sequence[int] | None,
    ) -> None:
        """Draw the first `corners` indices of another index buffer."""
        render = self.ready(vertex_array, primitive)
        if clip is not None:
            self._clip(render, clip)
        if self._stream.retained is not None:
            self._stream.retained.append(indices)
        self._set_indices(render, indices._internal, self._index_formats[IndexFormat.UINT32], 0, 4 * corners)
        self._draw_indices(render, corners, instances, 0, base, base_instance)
        self._current = None

    def _restarts(self, vertex_array: Id, primitive: Primitive, first: int, count: int) -> bool:
        """True if some of the indices of a list may restart it."""
        array = self.arrays[vertex_array]
        buffer = self._buffers[array.descriptor.index_buffer]
        copy = buffer.copy
        if primitive not in LISTS:
            return False
        if copy is None:
            return bool(buffer.restarts & array.restart_bit)
        if not count:
            return False
        form = array.descriptor.index_format
        values = np.frombuffer(copy, form.dtype, count, first * form.size)
        return bool(values.max() == form.restart)

    def _list(
        self, array: GpuVertexArray, primitive: Primitive, first: int, count: int
    ) -> tuple[int, GpuObject | None]:
        """Return the number of indices of a list's whole primitives, and a buffer of them if any."""
        form = array.descriptor.index_format
        buffer = self._buffers[array.descriptor.index_buffer]
        if buffer.copy is not None:
            values = np.frombuffer(buffer.copy, form.dtype, count, first * form.size)
            corners = list_primitives(primitive, values, form.restart)
            return corners.size, self._indices(corners) if corners.size else None
        if array.values is None or array.values[0] != buffer.version:
            data = self._buffers.read(array.descriptor.index_buffer, 0, buffer.descriptor.size)
            array.values = buffer.version, np.frombuffer(data, form.dtype, len(data) // form.size)
            array.listed.clear()
        key = (primitive, first, count)
        if key not in array.listed:
            if len(array.listed) == _MAX_LISTED:
                array.listed.clear()
            corners = list_primitives(primitive, array.values[1][first : first + count], form.restart)
            array.listed[key] = corners.size, self._indices(corners) if corners.size else None
        return array.listed[key]

    def _indices(self, values: NDArray[np.uint32]) -> GpuObject:
        return self._buffers.filled(values.ravel(), GpuBufferUsage.INDEX)

    def _shared(self, primitive: Primitive, corners: int) -> GpuObject:
        """Return shared indices for fans or quads without indices, for at least this many vertices."""
        capacity, index_buffer = self._shared_indices.get(primitive, (0, None))
        if corners > capacity:
            triangles = max(_SMALLEST, 1 << (corners // 3 - 1).bit_length())
            if primitive is _QUADS:
                indices = 4 * np.arange(triangles // 2, dtype=np.uint32)[:, None] + _CORNERS
            else:
                indices = expand_fan(np.arange(triangles + 2, dtype=np.uint32), None)
            index_buffer = self._indices(indices)
            self._shared_indices[primitive] = indices.size, index_buffer
        return index_buffer

    def _expand_quads(self, array: GpuVertexArray, first: int, count: int) -> GpuObject:
        """Return the triangles of indexed quads."""
        descriptor = array.descriptor
        buffer = self._buffers.use(descriptor.index_buffer)
        key = (first, count, buffer.version)
        if array.expanded is not None and array.expanded[0] == key and buffer.copy is None:
            return array.expanded[1]
        short = int(descriptor.index_format is IndexFormat.UINT16)
        expanded, restarts = self._buffers.temporary(count // 4 * 24), self._buffers.temporary(4)
        encoder = self._stream.outside()
        buffer = self._buffers.use(descriptor.index_buffer)
        resources = [
            {"buffer": buffer.object},
            {"buffer": expanded},
            self._tools.constants([first, count, short, 0]),
            {"buffer": restarts},
        ]
        self._tools.compute(encoder, EXPAND_QUADS, resources, -(-count // 256))
        self._tools.compute(encoder, RESTART_QUADS, resources, 1)
        array.expanded = key, expanded
        return expanded

    def _expand_fan(self, descriptor: VertexArrayDescriptor, first: int, count: int) -> NDArray[np.uint32]:
        """Return the triangles of an indexed fan, reading its indices back."""
        form = descriptor.index_format
        data = self._buffers.read(descriptor.index_buffer, first * form.size, count * form.size)
        return expand_fan(np.frombuffer(data, form.dtype), form.restart)

    def draw_clipped(
        self, vertex_array: Id, primitive: Primitive, draws: NDArray[np.void], clips: NDArray[np.int64]
    ) -> None:
        """See `rhi.contract.backend.SupportsClippedDraws`."""
        array = self.arrays[vertex_array]
        indexed = array.indexed
        base_vertices = draws["base_vertex"].tolist() if indexed else [0] * len(draws)
        columns = [draws[name].tolist() for name in ("first", "count", "instances", "base_instance")]
        rows = zip(*columns, base_vertices, clips.tolist(), strict=True)
        for first, count, instances, base_instance, base_vertex, clip in rows:
            if primitive is _FAN or self._alone or self.program.descriptor.writes_memory:  # type: ignore[union-attr]
                self._states.moved = True
            if indexed and self._restarts(vertex_array, primitive, first, count):
                self._draw_converted(
                    vertex_array, primitive, first, count, instances, base_vertex, base_instance, clip
                )
                continue
            render = self.ready(vertex_array, primitive)
            self._clip(render, clip)
            if indexed:
                self._draw_indices(render, count, instances, first, base_vertex, base_instance)
            else:
                self._draw_vertices(render, count, instances, first, base_instance)
        self._states.moved = True

    def _clip(self, render: Handle, clip: Sequence[int]) -> None:
        size = self._stream.pass_.size  # type: ignore[union-attr]
        self._implementation.set_scissor_rect(render, *clamp_rectangle(clip, *size))

    # -- indirect draws ----------------------------------------------------------------------------------

    def draw_indirect(
        self,
        vertex_array: Id,
        primitive: Primitive,
        buffer: Id,
        offset: int,
        draws: int,
        stride: int,
        count_buffer: Id,
        count_offset: int,
    ) -> None:
        if not draws:
            return
        stride = stride or _RECORD
        indexed = self.arrays[vertex_array].indexed
        if (
            primitive is _FAN
            or not self._has_base_instances
            or (indexed and self._restarts_anywhere(vertex_array, primitive))
        ):
            self._draw_each(
                vertex_array, primitive, buffer, offset, draws, stride, count_buffer, count_offset
            )
            return
        arguments = self._buffers.use(buffer)
        program = self.program
        assert program is not None
        safe = not program.descriptor.writes_memory  # else the program may bind the same buffer
        many = (
            self._implementation.multi_draw_indexed_indirect
            if indexed
            else self._implementation.multi_draw_indirect
        )
        if indexed and safe and stride == _RECORD and not count_buffer:
            many(self.ready(vertex_array, primitive), arguments.handle, offset, draws)
        elif indexed and safe and stride == _RECORD and self._counts_draws:
            counts = self._buffers.use(count_buffer)
            self._implementation.multi_draw_indexed_indirect_count(
                self.ready(vertex_array, primitive),
                arguments.handle,
                offset,
                counts.handle,
                count_offset,
                draws,
            )
            counts.serial = self._stream.serial
        else:
            listed = self._list_draws(
                arguments, offset, stride, draws, 5 if indexed else 4, count_buffer, count_offset
            )
            many(self.ready(vertex_array, primitive), listed._internal, 0, draws)
        arguments.serial = self._stream.serial

    def _restarts_anywhere(self, vertex_array: Id, primitive: Primitive) -> bool:
        """True if any index of a list's buffer may restart it."""
        descriptor = self.arrays[vertex_array].descriptor
        copy = self._buffers[descriptor.index_buffer].copy
        count = 0 if copy is None else len(copy) // descriptor.index_format.size
        return self._restarts(vertex_array, primitive, 0, count)

    def _list_draws(
        self,
        arguments: GpuBuffer,
        offset: int,
        stride: int,
        draws: int,
        words: int,
        count_buffer: Id,
        count_offset: int,
    ) -> GpuObject:
        """Return the arguments of draws tightly, with no instances for those beyond the count."""
        if arguments.copy is not None and not count_buffer:
            rows = np.ndarray((draws, words), np.uint32, arguments.copy, offset, (stride, 4))
            return self._buffers.filled(rows, GpuBufferUsage.INDIRECT)
        encoder = self._stream.outside()
        arguments.serial = self._stream.serial
        counts = self._buffers.use(count_buffer) if count_buffer else arguments
        listed = self._buffers.temporary(4 * words * draws)
        constants = self._tools.constants(
            [offset // 4, stride // 4, draws, words, count_offset // 4, int(count_buffer != 0), 0, 0]
        )
        resources = [{"buffer": arguments.object}, {"buffer": counts.object}, {"buffer": listed}, constants]
        self._tools.compute(encoder, LIST_DRAWS, resources, -(-draws // 64))
        return listed

    def _draw_each(
        self,
        vertex_array: Id,
        primitive: Primitive,
        buffer: Id,
        offset: int,
        draws: int,
        stride: int,
        count_buffer: Id,
        count_offset: int,
    ) -> None:
        """Draw each record of an indirect draw, after reading its arguments back."""
        if count_buffer:
            draws = min(draws, int.from_bytes(self._buffers.read(count_buffer, count_offset, 4), "little"))
        array = self.arrays[vertex_array]
        indexed = array.indexed
        elements = count_elements(
            array.descriptor, lambda buffer_id: self._buffers[buffer_id].descriptor.size
        )
        data = self._buffers.read(buffer, offset, (draws - 1) * stride + _RECORD) if draws else b""
        for number in range(draws):
            words = np.frombuffer(data, np.uint32, 5, number * stride)
            count, instances, first, fourth, fifth = words.tolist()
            base_vertex = int(words[3:4].view(np.int32)[0]) if indexed else 0
            base_instance = fifth if indexed else fourth
            faults = draw_faults(elements, indexed, first, count, instances, base_vertex, base_instance)
            # WebGPU would refuse all commands because of a draw beyond the mesh, also of an empty one.
            if count and instances and next(faults, None) is None:
                self.draw(vertex_array, primitive, first, count, instances, base_vertex, base_instance)

    # -- dispatches --------------------------------------------------------------------------------------

    def dispatch(self, x: int, y: int, z: int) -> None:
        if x and y and z:
            self._implementation.dispatch_workgroups(self._ready_compute(), x, y, z)

    def dispatch_indirect(self, buffer: Id, offset: int) -> None:
        # A dispatch can't write the buffer that its arguments are in, so they are copied.
        arguments = self._buffers.temporary(16)
        encoder = self._stream.outside()
        encoder.copy_buffer_to_buffer(self._buffers.use(buffer).object, offset, arguments, 0, 12)
        self._implementation.dispatch_workgroups_indirect(self._ready_compute(), arguments._internal, 0)

    def _ready_compute(self) -> Handle:
        """Return the handle of a compute pass, ready for a dispatch of the bound program."""
        program, bindings = self.program, self._bindings
        assert program is not None
        layout = self._select_layout(program)
        copies = bindings.copied(program) if program.written_images and program.textures else {}
        pipeline = self._pipelines.get_compute_pipeline(program, layout)
        compute = self._stream.compute()
        self._implementation.set_compute_pipeline(compute, pipeline._internal)
        bindings.invalidate()
        bindings.apply(program, layout, self._implementation.set_compute_bind_group, compute)
        if copies:
            group = bindings.sampling_copies(program, layout, copies)
            self._implementation.set_compute_bind_group(
                compute, 2, group._internal, 0, self._implementation.no_offsets
            )
        bindings.invalidate()
        return compute
