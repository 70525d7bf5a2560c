"""The rasteriser of a device: its parts, and the submission of gathered draws.

- `draws` gathers draws into a batch, with the current `draw_state`; `launcher` runs the batch's kernels.
- `vertex_arrays` and `bindings` know the addresses of what draws read; `queries` counts samples.
- A batch is submitted when draws with another pipeline or target follow, or any other command
  (`Rasteriser.flush`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Future
from functools import partial
from typing import Any

import pyopencl as cl

from rhi.backends.cl.builds import Builds, Kernel
from rhi.backends.cl.cl_context import ClContext
from rhi.backends.cl.cl_errors import translate_errors
from rhi.backends.cl.memory.cl_buffers import Buffers
from rhi.backends.cl.memory.cl_samplers import Samplers
from rhi.backends.cl.memory.cl_textures import Textures
from rhi.backends.cl.memory.in_flight import InFlight
from rhi.backends.cl.memory.pools import IndexList, Pool
from rhi.backends.cl.raster.assembly import Assembler
from rhi.backends.cl.raster.batches import Batch
from rhi.backends.cl.raster.boxes import AttributeBoxes
from rhi.backends.cl.raster.cl_bindings import Bindings
from rhi.backends.cl.raster.cl_draws import Draws
from rhi.backends.cl.raster.cl_pipelines import Pipeline
from rhi.backends.cl.raster.cl_queries import SampleQueries
from rhi.backends.cl.raster.draw_columns import CONDITION, INVERTED, SAMPLES
from rhi.backends.cl.raster.draw_state import DrawState
from rhi.backends.cl.raster.draw_tables import PreparedDraws
from rhi.backends.cl.raster.general_raster import GeneralRaster
from rhi.backends.cl.raster.launcher import Launcher
from rhi.backends.cl.raster.merger import make_key
from rhi.backends.cl.raster.vertex_arrays import VertexArrays
from rhi.contract.descriptors import Binding, BindingKind, Id, ProgramDescriptor, VertexArrayDescriptor
from rhi.contract.formats import Format


class Rasteriser:
    """The rasteriser of one device.

    Attributes:
        works: whether the device is a CPU, for which the kernels are written, and reads host memory in place.
            A GPU executes them, but stops where they load vectors at any address.
        bindings: the bound resources.
        state: the pass, program and render states of the next draw.
        vertex_arrays: vertex arrays, and the prepared draws that changes of buffers invalidate.
        queries: occlusion queries and the running counter.
        draws: the draw commands.
    """

    def __init__(
        self,
        context: ClContext,
        builds: Builds,
        buffers: Buffers,
        textures: Textures,
        samplers: Samplers,
        in_flight: InFlight,
    ) -> None:
        self._context = context
        self.works = context.shares_memory and bool(context.device.type & cl.device_type.CPU)
        self._builds = builds
        self._general = GeneralRaster(context, builds, samplers.texture_functions)
        self._programs: dict[Id, Pipeline] = {}
        self._buffers = buffers
        self._prepared = prepared = PreparedDraws()
        boxes = AttributeBoxes(prepared, Pool(in_flight))
        self._batch = Batch(prepared, boxes)
        self._launcher = Launcher(context, self._builds, in_flight, boxes)
        self.bindings = Bindings(buffers, textures, samplers)
        self.state = DrawState(textures)
        assembler = Assembler(self._read_indices, partial(IndexList, in_flight))
        self.vertex_arrays = VertexArrays(assembler, prepared, boxes, buffers, self.bindings)
        self.queries = SampleQueries(self._count_into, self.flush, self._is_gathering)
        self.draws = Draws(
            self._batch,
            prepared,
            self.state,
            self.vertex_arrays,
            self.bindings.columns,
            buffers,
            self.flush,
            self._flush_batch,
            self.change_stored,
        )

    def close(self) -> None:
        """Release kernels and memory, which reference cycles would keep until Python's next collection."""
        self._batch.state = self.state.ready_for = self.state.target = None
        self._launcher.release()

    # -- programs and vertex arrays --------------------------------------------------------------------------

    def create_program(self, program: Id, descriptor: ProgramDescriptor) -> None:
        """Emit the code of a program that draws. Its kernels are built when vertex layout and targets are
        known."""
        self._programs[program] = Pipeline(self._context, self._builds, self._general, descriptor)
        _ = self._launcher.geometry

    def prepare_kernels(
        self,
        program: Id,
        vertex_array: Id,
        values: Mapping[type, Any],
        colors: Sequence[Format],
        depth: Format | None,
        samples: int,
    ) -> list[Future[None]]:
        """Begin to optimise all kernels of a program for these states and targets; return futures of the
        ends.

        Args:
            vertex_array: 0 if there is none yet.
            values: the value of each state type.
            colors, depth: the formats of the targets; none if they aren't decided yet.
        """
        pipeline, geometry = self._programs[program], self._launcher.geometry
        kernels: list[Kernel | None] = [geometry.set_up, geometry.prefix, geometry.scatter]
        if vertex_array:
            vertex = self.vertex_arrays.by_id[vertex_array].kernel
            kernels += vertex.transform, vertex.measure
        ends = [kernel.optimise() for kernel in kernels if kernel is not None]
        if colors or depth is not None:
            ends.append(
                pipeline.optimise_raster(make_key(pipeline.descriptor, values, colors, depth, samples))
            )
        return [end for end in ends if end is not None]

    def destroy_program(self, program: Id) -> None:
        self.flush()
        self.state.forget(self._programs.pop(program))

    def bind_program(self, program: Id) -> None:
        self.state.bind_program(self._programs.get(program))

    def create_vertex_array(self, vertex_array: Id, descriptor: VertexArrayDescriptor) -> None:
        self.vertex_arrays.create(vertex_array, descriptor, self._programs[descriptor.program])

    # -- buffers and textures --------------------------------------------------------------------------------

    def change_stored(self, bindings: Sequence[Binding]) -> None:
        """Note that shaders wrote the resources of these bindings."""
        for binding in bindings:
            if binding.kind is BindingKind.STORAGE:
                self.vertex_arrays.change(self.bindings.slots[binding.kind, binding.slot][0], True)

    def _read_indices(self, buffer: Id, offset: int, size: int) -> bytes:
        self.flush()
        with translate_errors("device.draw", "indices"):
            return self._buffers.read(buffer, offset, size)

    # -- submission ------------------------------------------------------------------------------------------

    def flush(self) -> None:
        """Submit the gathered draws and the pass's remaining clears, so that any other command may follow."""
        self._flush_batch()
        if self.state.has_clears:
            self.state.fill_cleared(self._context.queue)

    def _flush_batch(self) -> None:
        """Submit the gathered draws; other draws of the pass follow."""
        if self._batch:
            self.state.ready_for = None
            event = None
            with translate_errors("a draw"):
                try:
                    event = self._launcher.launch(self._batch.take())
                finally:
                    self._prepared.recycle()
                    self.queries.finish_batch(event or cl.enqueue_marker(self._context.queue))

    def _is_gathering(self) -> bool:
        return bool(self._batch)

    # -- columns of the next draws ---------------------------------------------------------------------------

    def begin_conditional(self, query: Id, inverted: bool) -> None:
        columns = self.bindings.columns
        columns[CONDITION], columns[INVERTED] = self.queries.condition_address(query), inverted

    def end_conditional(self) -> None:
        self.bindings.columns[CONDITION] = self.bindings.columns[INVERTED] = 0

    def _count_into(self, address: int) -> None:
        self.bindings.columns[SAMPLES] = address
