"""The contract's draws, gathered into batches.

- Draws gather while pass, pipeline and vertex layout stay (`rhi.backends.cl.raster.batches`). Bindings, and
  states that are data for kernels, are columns of a draw's row and may change from draw to draw.
- A draw's prepared part is kept with its caller (`prepare_draw`) until the indices that it names change.
- Indirect draws and their counts are read back and become direct draws.
- Draws of programs that write memory are flushed one by one, since later draws may read what they wrote.
- Draws in rectangles of their own are prepared together, unless they have to be assembled; each has its own
  view.
- A draw that fails leaves the batch as it was: its partial row is removed (`Batch.drop_partial_row`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from rhi.backends.cl.cl_errors import translate_errors
from rhi.backends.cl.memory.cl_buffers import Buffers
from rhi.backends.cl.raster.batches import Batch, BatchState
from rhi.backends.cl.raster.cl_pipelines import Pipeline
from rhi.backends.cl.raster.draw_columns import COUNTER_BYTES, INSTANCES, PREPARED, VIEW
from rhi.backends.cl.raster.draw_list_cache import DrawListCache
from rhi.backends.cl.raster.draw_state import DrawState, scissor_views
from rhi.backends.cl.raster.draw_tables import DrawList, DrawSlot, PreparedDraws, number_in_runs
from rhi.backends.cl.raster.vertex_arrays import VertexArray, VertexArrays
from rhi.contract.descriptors import DRAW, DRAW_UNINDEXED, Binding, Id, Primitive
from rhi.contract.queries import list_draws
from rhi.contract.states import Scissor, StateChange, Viewport

_COUNT_BYTES: Final = 4  # of the number of indirect draws


class Draws:
    """Gathers the draws of one device."""

    def __init__(
        self,
        batch: Batch,
        prepared: PreparedDraws,
        state: DrawState,
        arrays: VertexArrays,
        columns: list[int],
        buffers: Buffers,
        flush: Callable[[], None],
        flush_batch: Callable[[], None],
        change_stored: Callable[[Sequence[Binding]], None],
    ) -> None:
        """
        Args:
            columns: the list that draws' rows are picked from (`bindings.Bindings`).
            flush: submits the gathered draws, so that any other command may follow.
            flush_batch: submits the gathered draws when other draws of the pass follow.
            change_stored: notes that shaders wrote the resources of storage bindings.
        """
        self._batch = batch
        self._prepared = prepared
        self._lists = DrawListCache(prepared)
        self._state = state
        self._arrays = arrays.by_id
        self._prepare = arrays.prepare
        self._prepare_lists = arrays.prepare_lists
        self._columns = columns
        self._buffers = buffers
        self._flush = flush
        self._flush_batch = flush_batch
        self._change_stored = change_stored

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
        array = self._arrays[vertex_array]
        slot = DrawSlot(self._prepared)
        self._prepare(slot, array, primitive, first, count, base_vertex, base_instance)
        pipeline = self._begin(array)
        self._columns[PREPARED], self._columns[INSTANCES] = slot.number, instances
        try:
            self._batch.rows.extend(pipeline.pick(self._columns))
        except BaseException:
            self._batch.drop_partial_row()
            raise
        self._end(pipeline)

    def draw_clipped(
        self, vertex_array: Id, primitive: Primitive, draws: NDArray[Any], clips: NDArray[np.int64]
    ) -> None:
        """See `rhi.contract.backend.SupportsClippedDraws`: all draws are prepared at once, each with its own
        view."""
        array = self._arrays[vertex_array]
        state = self._state
        prepared = self._prepared
        numbers = np.array([prepared.add() for _ in range(len(draws))])
        try:
            if array.pipeline.descriptor.writes_memory or not self._prepare_lists(
                numbers, array, primitive, draws
            ):
                self._draw_each_clipped(vertex_array, primitive, draws, clips)
                return
            pipeline = self._begin(array)
            assert state.target is not None
            batch, row = self._batch, pipeline.pick(self._columns)
            rows = np.empty((len(draws), len(row)), np.uint64)
            rows[:] = row
            rows[:, PREPARED], rows[:, INSTANCES] = numbers, draws["instances"]
            rows[:, VIEW] = np.arange(len(batch.views), len(batch.views) + len(draws))
            batch.views += scissor_views(
                batch.views[row[VIEW]], state.values[Viewport], state.target.size, clips
            )
            batch.rows.frombytes(rows.tobytes())
            state.ready_for = None  # the next draw has the view before
        finally:
            for number in numbers.tolist():
                prepared.release(number)

    def _draw_each_clipped(
        self, vertex_array: Id, primitive: Primitive, draws: NDArray[Any], clips: NDArray[np.int64]
    ) -> None:
        state = self._state
        before = StateChange(Scissor, state.values[Scissor])
        try:
            for clip, arguments in zip(clips.tolist(), list_draws(draws), strict=True):
                state.set((StateChange(Scissor, Scissor(*clip)),))
                self.draw(vertex_array, primitive, *arguments)
        finally:
            state.set((before,))

    def prepare_draw(
        self,
        vertex_array: Id,
        primitive: Primitive,
        first: int,
        count: int,
        base_vertex: int,
        base_instance: int,
    ) -> Callable[[int], object]:
        """Return a function that draws as `draw` does; its argument is the number of instances."""
        array = self._arrays[vertex_array]
        if array.pipeline.descriptor.writes_memory:
            return lambda instances: self.draw(
                vertex_array, primitive, first, count, instances, base_vertex, base_instance
            )
        state = self._state
        columns = self._columns
        prepare = self._prepare
        get_ready = self._get_ready
        kernel, version = array.kernel, array.version
        slot = DrawSlot(self._prepared)
        number, prepared_version = slot.number, -1
        extend = self._batch.rows.extend
        pick = array.pipeline.pick
        drop_partial_row = self._batch.drop_partial_row

        def draw(instances: int) -> None:
            nonlocal prepared_version
            if version[0] != prepared_version:
                prepare(slot, array, primitive, first, count, base_vertex, base_instance)
                prepared_version = version[0]
            if state.ready_for is not kernel:
                get_ready(array)
            columns[PREPARED] = number
            columns[INSTANCES] = instances
            try:  # costs nothing unless it fails
                extend(pick(columns))
            except BaseException:
                drop_partial_row()
                raise

        return draw

    def forget(self, vertex_array: Id) -> None:
        """Drop the state of a vertex array that is being destroyed."""
        self._lists.forget(vertex_array)

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
        """Draw with arguments from memory; waits for them unless only the CPU wrote them."""
        if count_buffer:
            words = np.frombuffer(self._read_arguments(count_buffer, count_offset, _COUNT_BYTES), np.uint32)
            draws = min(draws, int(words[0]))
        if not draws:
            return
        record = DRAW if self._arrays[vertex_array].descriptor.index_buffer else DRAW_UNINDEXED
        stride = stride or record.itemsize
        data = self._read_arguments(buffer, offset, (draws - 1) * stride + record.itemsize)
        arguments = np.ndarray((draws,), record, data, strides=(stride,)).copy()
        # Only the device knew these numbers, so nobody has checked them.
        room = self._arrays[vertex_array].elements.instances - arguments["base_instance"].astype(np.int64)
        arguments["instances"] = np.clip(arguments["instances"], 0, np.maximum(room, 0))
        self._gather_list(vertex_array, primitive, arguments)

    def draw_counted(
        self,
        vertex_array: Id,
        primitive: Primitive,
        draws: NDArray[Any],
        counters: NDArray[np.int64],
        first: int,
    ) -> None:
        """Draw an array of draws, each counted by a counter of its own.

        Args:
            draws: (n,) of `rhi.DRAW` or `rhi.DRAW_UNINDEXED`.
            counters: (n,) numbers of the counters.
            first: the address of counter 0.
        """
        self._gather_list(vertex_array, primitive, draws, counters, first - COUNTER_BYTES)

    def draw_conditional(
        self,
        vertex_array: Id,
        primitive: Primitive,
        buffer: Id,
        offset: int,
        query_indices: NDArray[np.int64],
        counters: NDArray[np.int64],
        *,
        is_counted: bool,
    ) -> None:
        """Draw an array of draws, each on condition of a counter.

        Args:
            query_indices: (n,) draws are numbered within each run of equal rows.
            counters: (n,) the counters' addresses.
            is_counted: whether the draws that count there were submitted.
        """
        if not is_counted:
            self._flush_batch()
        array = self._arrays[vertex_array]
        indexed = bool(array.descriptor.index_buffer)
        record = DRAW if indexed else DRAW_UNINDEXED
        data = self._read_arguments(buffer, offset, len(query_indices) * record.itemsize)
        draws = np.frombuffer(data, record)
        draw_list = self._lists.make_conditional(
            vertex_array,
            primitive,
            array.version[0],
            draws,
            number_in_runs(query_indices),
            counters,
            indexed,
            self._filler(array, primitive),
        )
        self._gather(array, draw_list)

    def _gather_list(
        self,
        vertex_array: Id,
        primitive: Primitive,
        draws: NDArray[Any],
        counters: NDArray[np.int64] | None = None,
        start: int = 0,
    ) -> None:
        """Gather an array of draws. Without counters the draws are numbered, so that shaders can tell them
        apart."""
        array = self._arrays[vertex_array]
        indexed = bool(array.descriptor.index_buffer)
        fill = self._filler(array, primitive)
        draw_list = self._lists.lookup(
            vertex_array, primitive, array.version[0], draws, counters, indexed, fill
        )
        self._gather(array, draw_list, start)

    def _filler(self, array: VertexArray, primitive: Primitive) -> Callable[..., None]:
        """Return the function that fills in a prepared draw of an array of draws."""
        return lambda slot, *draw: self._prepare(slot, array, primitive, *draw)

    def _gather(self, array: VertexArray, draw_list: DrawList, start: int = 0) -> None:
        """Gather a draw list. `start`: the address that its counter offsets are relative to."""
        pipeline = self._begin(array)
        self._state.ready_for = None  # the next draw has to spread a list that is alone
        self._batch.gather(draw_list, pipeline.pick(self._columns), start)
        self._end(pipeline)

    def _read_arguments(self, buffer: Id, offset: int, size: int) -> bytes:
        with translate_errors("device.draw_indirect", "arguments"):
            cpu_copy = self._buffers.get_cpu_copy(buffer)
            if cpu_copy is not None:
                return cpu_copy[offset : offset + size].tobytes()
            self._flush()
            return self._buffers.read(buffer, offset, size)

    def _begin(self, array: VertexArray) -> Pipeline:
        """Prepare the batch for draws of this vertex array."""
        if self._state.ready_for is not array.kernel:
            self._get_ready(array)
        pipeline = self._state.pipeline
        assert pipeline is not None
        if pipeline.descriptor.writes_memory:
            self._flush()
            self._get_ready(array)
        return pipeline

    def _end(self, pipeline: Pipeline) -> None:
        if pipeline.descriptor.writes_memory:
            self._flush()
            self._change_stored(pipeline.written)

    def _get_ready(self, array: VertexArray) -> None:
        """Set up the batch and the view column for the current state. Flushes draws gathered with another
        state."""
        state, batch = self._state, self._batch
        pipeline, target = state.pipeline, state.target
        assert pipeline is not None
        assert target is not None
        state.ready_for = None
        merger, raster, view, table = state.look_up(pipeline, target)
        now = batch.state
        if (
            now is None
            or now.raster is not raster
            or now.vertex is not array.kernel
            or now.target is not target
            or now.table["edges"] != table["edges"]
        ):
            self._flush_batch()
            streams = len(array.descriptor.streams)
            batch.state = BatchState(pipeline, target, array.kernel, streams, raster, merger, table)
        batch.spread()
        if not batch.views or batch.views[-1] is not view:
            batch.views.append(view)
        self._columns[VIEW] = len(batch.views) - 1
        state.ready_for = array.kernel
