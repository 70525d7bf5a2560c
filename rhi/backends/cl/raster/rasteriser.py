"""The rasteriser: takes draws as the contract has them and makes batches of them.

- Draws gather while pass, pipeline and vertex layout stay (`rhi.backends.cl.raster.batches`). What is bound
  (`.bindings`), and states that are data for kernels, are columns of a draw's row.
- `stale` says that pass, program or states changed: the next draw looks up its pipeline and view, in a memo.
- A draw's prepared part is kept with its caller (`prepare_draw`) until the indices that it names change.
- Indirect draws are read back and become plain draws; so are counts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from operator import itemgetter
from typing import Any, Final

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray
from typing_extensions import Buffer as BytesLike

from rhi.backends.cl.buffers import Buffers
from rhi.backends.cl.context import ClContext
from rhi.backends.cl.errors import translate_errors
from rhi.backends.cl.planes import TexelPlane
from rhi.backends.cl.pools import Addresses, IndexList, Retired
from rhi.backends.cl.raster.assembly import Assembler
from rhi.backends.cl.raster.batches import (
    CONDITION,
    COUNTER_BYTES,
    FIXED_COLUMNS,
    INSTANCES,
    INVERTED,
    PREPARED,
    SAMPLES,
    VIEW,
    Batch,
    describe_batch,
)
from rhi.backends.cl.raster.bindings import COLUMNS, Bindings
from rhi.backends.cl.raster.builds import Builds, Kernel
from rhi.backends.cl.raster.counters import Counters
from rhi.backends.cl.raster.draw_lists import DrawLists, DrawSlot
from rhi.backends.cl.raster.merger import MergerKey, make_key
from rhi.backends.cl.raster.pipelines import Pipeline, VertexKernels
from rhi.backends.cl.raster.tables import GROUP, MAX_STREAMS
from rhi.backends.cl.raster.targets import Surface, Target, color_clear, depth_clear, stencil_clear
from rhi.backends.cl.raster.views import make_view
from rhi.backends.cl.samplers import Samplers
from rhi.backends.cl.slots import Slots
from rhi.backends.cl.textures import Textures
from rhi.contract.descriptors import (
    Attachment,
    Binding,
    BindingKind,
    DepthAttachment,
    Id,
    PassDescriptor,
    Primitive,
    ProgramDescriptor,
    VertexArrayDescriptor,
)
from rhi.contract.formats import Format
from rhi.contract.states import DEFAULTS, MAX_TARGETS, PER_TARGET, StateChange

__rhi_internal__ = True

_MAX_MEMO: Final = 4096
_COMMAND: Final = np.dtype([(name, "u4") for name in ("count", "instances", "first", "third", "fourth")])


class _Array:
    """A vertex array: its kernel, and whether its indices are what they were."""

    __slots__ = ("descriptor", "id", "kernel", "pipeline", "version")

    def __init__(
        self, id: Id, descriptor: VertexArrayDescriptor, pipeline: Pipeline, kernel: VertexKernels, version: list[int]
    ) -> None:  # fmt: skip
        self.id = id
        self.descriptor = descriptor
        self.pipeline = pipeline
        self.kernel = kernel
        self.version = version


class _Program:
    """A program that draws: its pipeline, and which columns its draws' rows have."""

    __slots__ = ("descriptor", "pick", "pipeline", "written")

    def __init__(self, pipeline: Pipeline) -> None:
        self.pipeline = pipeline
        self.descriptor = pipeline.descriptor
        columns = list(range(FIXED_COLUMNS))
        for binding in self.descriptor.bindings:
            start = COLUMNS[binding.kind, binding.slot]
            columns += [start] if binding.kind is BindingKind.UNIFORM else [start, start + 1]
        self.pick = itemgetter(*columns)
        self.written = [binding for binding in self.descriptor.bindings if binding.writes]


class Rasteriser:
    """All that draws on one device.

    Attributes:
        bindings: what is bound.
        works: whether the device can do it, see `rhi.backends.cl.pools`.
        values: the state of each type that holds now.
        stale: whether the next draw has to look up what it is drawn with.
        retired: memory to be kept until the next fence value has passed.
    """

    def __init__(
        self, context: ClContext, slots: Slots, buffers: Buffers, textures: Textures, samplers: Samplers
    ) -> None:
        self._context = context
        self._buffers = buffers
        self._textures = textures
        self._addresses = Addresses(context)
        self.works = self._addresses.work
        self.retired = Retired()
        self._builds = Builds(context)
        self._batch = Batch(context, self._builds, self._addresses, self.retired)
        self._assembler: Assembler[IndexList] = Assembler(self._read, self._upload)
        self._programs: dict[Id, _Program] = {}
        self._arrays: dict[Id, _Array] = {}
        self._versions: dict[Id, list[int]] = {}
        self._lists = DrawLists(self._batch.prepared)
        self._device_wrote: set[Id] = set()
        self.bindings = Bindings(slots, self._addresses, buffers, textures, samplers)
        self._bound = self.bindings.columns
        self._slots = slots
        self._memo: dict[object, tuple[MergerKey, Kernel, bytes, dict[str, float]]] = {}
        self._program: _Program | None = None
        self._target: Target | None = None
        self._clears = False  # whether some of the target may still have to be cleared
        self._formats: tuple[tuple[Format, ...], Format | None] = ((), None)
        self.values: dict[type, Any] = {
            state: (value,) * MAX_TARGETS if state in PER_TARGET else value
            for state, value in DEFAULTS.items()
        }
        self.stale = True
        self.counters = Counters(context, self._addresses, self._count_into, self.flush, self._is_gathering)

    # -- programs and vertices -------------------------------------------------------------------------------

    def create_program(self, program: Id, descriptor: ProgramDescriptor) -> None:
        """Emits its stages; kernels are built when all that they need is known."""
        self._programs[program] = _Program(
            Pipeline(self._context, self._builds, descriptor, self._addresses)
        )
        _ = self._batch.geometry

    def destroy_program(self, program: Id) -> None:
        self.flush()
        gone = self._programs.pop(program)
        if self._program is gone:
            self._program = None
        self._memo = {key: value for key, value in self._memo.items() if key[0] is not gone}  # type: ignore[index]

    def create_vertex_array(self, vertex_array: Id, descriptor: VertexArrayDescriptor) -> None:
        if len(descriptor.streams) > MAX_STREAMS:
            raise AssertionError(f"{len(descriptor.streams)} vertex streams")
        pipeline = self._programs[descriptor.program].pipeline
        version = self._versions.setdefault(descriptor.index_buffer, [0])
        if descriptor.index_buffer:
            self._assembler.watch(descriptor.index_buffer, self._buffers[descriptor.index_buffer].size)
        kernel = pipeline.find_vertex(descriptor.streams)
        self._arrays[vertex_array] = _Array(vertex_array, descriptor, pipeline, kernel, version)
        self._batch.boxes.watch(vertex_array, {stream.buffer for stream in descriptor.streams})

    def destroy_vertex_array(self, vertex_array: Id) -> None:
        del self._arrays[vertex_array]
        self._batch.boxes.unwatch(vertex_array)

    # -- what happens to buffers -----------------------------------------------------------------------------

    def write(self, buffer: Id, offset: int, data: BytesLike) -> None:
        """The CPU writes a buffer."""
        self._assembler.write(buffer, offset, data)
        self._change_version(buffer)

    def change(self, buffer: Id) -> None:
        """The device writes a buffer."""
        self._device_wrote.add(buffer)
        self._assembler.change(buffer)
        self._change_version(buffer)

    def forget(self, resource: Id) -> None:
        """A buffer or texture is destroyed."""
        self.bindings.forget(resource)
        self._assembler.forget(resource)
        self._change_version(resource)
        self._versions.pop(resource, None)
        self._batch.boxes.forget(resource)
        self._device_wrote.discard(resource)

    def change_stored(self, bindings: Sequence[Binding]) -> None:
        """Shaders wrote what these have bound."""
        for binding in bindings:
            if binding.kind is BindingKind.STORAGE:
                self.change(self._slots[binding.kind, binding.slot][0])

    def _change_version(self, buffer: Id) -> None:
        version = self._versions.get(buffer)
        if version is not None:
            version[0] += 1
        self._batch.boxes.change(buffer)

    def _read(self, buffer: Id, offset: int, size: int) -> bytes:
        self.flush()
        with translate_errors("device.draw", "indices or arguments"):
            return self._buffers.read(buffer, offset, size)

    def _upload(self, indices: NDArray[np.uint32]) -> IndexList:
        flags = cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR
        padded = np.append(indices, np.zeros(3 * GROUP, np.uint32))  # room for a group's loads
        with translate_errors("device.draw", f"{len(indices)} indices"):
            memory = cl.Buffer(self._context.context, flags, hostbuf=padded)
        return IndexList(memory, self._addresses.find(memory), self.retired)

    # -- what holds ----------------------------------------------------------------------------------------

    def begin_pass(self, descriptor: PassDescriptor) -> None:
        textures = self._textures
        colors, formats = [], []
        for color in descriptor.colors:
            texture = textures[color.texture]
            format = texture.descriptor.format
            colors.append(self._make_surface(color, texture.levels, color_clear(color, format)))
            formats.append(format)
        depth = stencil = drawn = None
        depth_format = None
        attachment = descriptor.depth
        if attachment is not None:
            texture = drawn = textures[attachment.texture]
            depth_format = texture.descriptor.format
            depth = self._make_surface(attachment, texture.levels, depth_clear(attachment, depth_format))
            if texture.stencil:
                stencil = self._make_surface(attachment, texture.stencil, stencil_clear(attachment), True)
        self._target = Target(descriptor.size, descriptor.samples, colors, depth, stencil, drawn)
        self._formats = tuple(formats), depth_format
        self.stale = True

    def set_states(self, changes: Sequence[StateChange]) -> None:
        self.values.update(changes)
        self.stale = True

    def bind_program(self, program: Id) -> None:
        self._program = self._programs.get(program)
        self.stale = True

    def _make_surface(
        self, attachment: Attachment | DepthAttachment, planes: Sequence[TexelPlane], clear: bytes | None,
        stencil: bool = False,
    ) -> Surface:  # fmt: skip
        """What an attachment draws into; `planes`: by level."""
        plane = planes[attachment.level]
        if clear is not None:
            self._textures[attachment.texture].changes += 1
            self._clears = True
        address = self.bindings.find_plane(attachment.texture, plane, stencil)
        samples = self._textures[attachment.texture].descriptor.samples
        return Surface(plane, attachment.layer, samples, address, clear)

    # -- draws -----------------------------------------------------------------------------------------------

    def draw(
        self, vertex_array: Id, primitive: Primitive, first: int, count: int, instances: int, base_vertex: int,
        base_instance: int,
    ) -> None:  # fmt: skip
        array = self._arrays[vertex_array]
        place = DrawSlot(self._batch.prepared)
        self._assemble(place, array, primitive, first, count, base_vertex, base_instance)
        program = self._begin_gathering(array)
        self._bound[PREPARED], self._bound[INSTANCES] = place.number, instances
        self._batch.rows.extend(program.pick(self._bound))
        self._end_gathering(program)

    def prepare_draw(
        self, vertex_array: Id, primitive: Primitive, first: int, count: int, base_vertex: int, base_instance: int
    ) -> Callable[[int], object]:  # fmt: skip
        """A function of the number of instances that does what `draw` would."""
        array = self._arrays[vertex_array]
        program = self._programs[array.descriptor.program]
        batch, bound, version = self._batch, self._bound, array.version
        place = DrawSlot(batch.prepared)
        number, known = place.number, -1
        extend, pick = batch.rows.extend, program.pick

        def draw(instances: int) -> None:
            nonlocal known
            if version[0] != known:
                self._assemble(place, array, primitive, first, count, base_vertex, base_instance)
                known = version[0]
            if self.stale or batch.vertex is not array.kernel:
                self._get_ready(array)
            bound[PREPARED] = number
            bound[INSTANCES] = instances
            extend(pick(bound))

        if program.descriptor.writes_memory:
            return lambda instances: self.draw(
                vertex_array, primitive, first, count, instances, base_vertex, base_instance
            )
        return draw

    def draw_indirect(
        self, vertex_array: Id, primitive: Primitive, buffer: Id, offset: int, draws: int, stride: int,
        count_buffer: Id, count_offset: int,
    ) -> None:  # fmt: skip
        """Waits for the arguments, unless only the CPU wrote them."""
        if count_buffer:
            words = np.frombuffer(self._read_arguments(count_buffer, count_offset, 4), np.uint32)
            draws = min(draws, int(words[0]))
        if not draws:
            return
        stride = stride or _COMMAND.itemsize
        data = self._read_arguments(buffer, offset, (draws - 1) * stride + _COMMAND.itemsize)
        arguments = np.ndarray((draws,), _COMMAND, data, strides=(stride,))
        self._gather_list(vertex_array, primitive, arguments)

    def draw_counted(
        self, vertex_array: Id, primitive: Primitive, draws: NDArray[Any], counters: NDArray[np.int64], first: int
    ) -> None:  # fmt: skip
        """Draws of an array, each counted by the counter of its number; `first`: the address of number 0."""
        self._gather_list(vertex_array, primitive, draws.view(_COMMAND), counters, first - COUNTER_BYTES)

    def _gather_list(
        self, vertex_array: Id, primitive: Primitive, draws: NDArray[Any],
        counters: NDArray[np.int64] | None = None, start: int = 0,
    ) -> None:  # fmt: skip
        """Draws that are numbered or, with counters, each counted by its own."""
        array = self._arrays[vertex_array]

        def fill(place: DrawSlot, *draw: int) -> None:
            self._assemble(place, array, primitive, *draw)

        key = vertex_array, primitive, array.version[0]
        indexed = bool(array.descriptor.index_buffer)
        found = self._lists.find(key, draws, counters, indexed, fill)
        program = self._begin_gathering(array)
        self._batch.gather(found, program.pick(self._bound), start)
        self.stale = True  # what follows makes room for itself
        self._end_gathering(program)

    def _read_arguments(self, buffer: Id, offset: int, size: int) -> bytes:
        host = self._buffers[buffer].host
        if host is not None and buffer not in self._device_wrote:
            return host[offset : offset + size].tobytes()
        return self._read(buffer, offset, size)

    def _begin_gathering(self, array: _Array) -> _Program:
        """Draws of this array follow."""
        if self.stale or self._batch.vertex is not array.kernel:
            self._get_ready(array)
        program = self._program
        assert program is not None
        if program.descriptor.writes_memory:
            self.flush()
            self._get_ready(array)
        return program

    def _end_gathering(self, program: _Program) -> None:
        if program.descriptor.writes_memory:
            self.flush()
            self.change_stored(program.written)

    def _get_ready(self, array: _Array) -> None:
        """Look up what the next draws are drawn with; what was gathered otherwise is flushed."""
        program, target, batch = self._program, self._target, self._batch
        assert program is not None
        assert target is not None
        colors, depth = self._formats
        key = program, target.size, target.samples, colors, depth, *self.values.values()
        known = self._memo.get(key)
        if known is None:
            if len(self._memo) == _MAX_MEMO:
                self._memo.clear()
            merger = make_key(program.descriptor, self.values, colors, depth, target.samples)
            view = make_view(self.values, target.size, colors, depth).tobytes()
            table = describe_batch(program.pipeline, target.size, merger)
            known = self._memo[key] = merger, program.pipeline.find_raster(merger), view, table
        merger, raster, view, table = known
        if batch.raster is not raster or batch.vertex is not array.kernel or batch.target is not target:
            self._flush_batch()
            streams = len(array.descriptor.streams)
            batch.begin(program.pipeline, target, array.kernel, streams, raster, merger, table)
        batch.mix()
        if not batch.views or batch.views[-1] is not view:
            batch.views.append(view)
        self._bound[VIEW] = len(batch.views) - 1
        self.stale = False

    def _assemble(
        self, place: DrawSlot, array: _Array, primitive: Primitive, first: int, count: int, base_vertex: int,
        base_instance: int,
    ) -> None:  # fmt: skip
        """Fill in a prepared draw."""
        made = array.descriptor
        assembly = self._assembler.assemble(primitive, first, count, made.index_buffer, made.index_format)
        prepared = self._batch.prepared
        row = prepared.draws[place.number]
        place.memory = assembly.memory
        primitives = assembly.count // assembly.corners
        row["primitives"], row["primitive"] = primitives, assembly.corners
        row["primitive_groups"] = -(-primitives // GROUP)
        indices, index_bytes = 0, 0
        if assembly.memory is not None:
            indices, index_bytes = assembly.memory.address + 4 * assembly.start, 4
        elif assembly.indexed:
            indices = self.bindings.find_buffer(made.index_buffer) + made.index_format.size * assembly.start
            index_bytes = made.index_format.size
        base = assembly.base + (base_vertex if made.index_buffer else 0)
        row["indices"], row["index_bytes"] = indices, index_bytes
        row["vertex_indices"], row["vertex_index_bytes"] = 0, 0
        if assembly.lowest is None or assembly.highest is None:  # one vertex per index
            row["vertex_indices"], row["vertex_index_bytes"] = indices, index_bytes
            row["indices"], row["index_bytes"] = 0, 0
            row["lowest"], row["vertices"], row["first_vertex"] = 0, assembly.count, base
        else:
            row["lowest"], row["vertices"] = assembly.lowest, assembly.highest - assembly.lowest + 1
            row["first_vertex"] = assembly.lowest + base
        row["vertex_groups"] = -(-int(row["vertices"]) // GROUP)
        row["base_instance"], row["box"] = base_instance, 0
        prepared.arrays[place.number], prepared.seen[place.number] = array.id, False
        prepared.streams[place.number, : len(made.streams)] = [
            self.bindings.find_buffer(stream.buffer) + stream.offset for stream in made.streams
        ]

    def flush(self) -> None:
        """Hand what was gathered to the device, so that anything else may follow."""
        self._flush_batch()
        if self._clears:
            assert self._target is not None
            with translate_errors("device.render_pass"):
                self._target.fill_cleared(self._context.queue)
            self._clears = False

    def _flush_batch(self) -> None:
        """Hand what was gathered to the device; other draws of the pass follow."""
        if self._batch:
            self.stale = True
            event = None
            with translate_errors("a draw"):
                try:
                    event = self._batch.flush()
                finally:
                    self.counters.finish_batch(event or cl.enqueue_marker(self._context.queue))

    def _is_gathering(self) -> bool:
        return bool(self._batch)

    def begin_conditional(self, query: Id, inverted: bool) -> None:
        self._bound[CONDITION], self._bound[INVERTED] = self.counters.find_condition(query), inverted

    def end_conditional(self) -> None:
        self._bound[CONDITION] = self._bound[INVERTED] = 0

    def _count_into(self, address: int) -> None:
        self._bound[SAMPLES] = address
