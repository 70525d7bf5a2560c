"""The OpenCL backend: rhi's contract on one queue that executes in order.

- Draws are gathered into batches (`rhi.backends.cl.raster.rasteriser`). Every other command first submits the
  gathered draws (`_flush`) and then enqueues its own work, so the queue has the order of the contract.
- Only reads, and indirect draws and dispatches, wait for the device: OpenCL can't take sizes from memory.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future
from functools import wraps
from typing import Any, Concatenate, Final, ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray
from typing_extensions import Buffer as BytesLike

from rhi.backends.cl.builds import Builds
from rhi.backends.cl.cl_capabilities import query_capabilities
from rhi.backends.cl.cl_context import ClContext
from rhi.backends.cl.cl_errors import DRIVER_ERRORS, make_error
from rhi.backends.cl.cl_fence import Fence, Timestamps
from rhi.backends.cl.cl_programs import ComputePrograms
from rhi.backends.cl.memory.cl_buffers import Buffers
from rhi.backends.cl.memory.cl_samplers import Samplers
from rhi.backends.cl.memory.cl_textures import Textures
from rhi.backends.cl.memory.in_flight import InFlight
from rhi.backends.cl.raster.cl_query_sets import ClQuerySet
from rhi.backends.cl.raster.rasteriser import Rasteriser
from rhi.contract import descriptors
from rhi.contract.backend import PreparedQueries
from rhi.contract.descriptors import Id
from rhi.contract.formats import Format
from rhi.contract.limits import dispatch_faults
from rhi.contract.states import StateChange

P = ParamSpec("P")
R = TypeVar("R")

_GROUPS_BYTES: Final = 12


def _reports_errors_as(
    call: str,
) -> Callable[[Callable[Concatenate[ClBackend, P], R]], Callable[Concatenate[ClBackend, P], R]]:
    """Return a decorator that reports a method's OpenCL errors as `DeviceError` of this call and the open
    labels."""

    def decorate(method: Callable[Concatenate[ClBackend, P], R]) -> Callable[Concatenate[ClBackend, P], R]:
        @wraps(method)
        def run(self: ClBackend, /, *arguments: P.args, **named: P.kwargs) -> R:
            try:
                return method(self, *arguments, **named)
            except DRIVER_ERRORS as error:
                raise make_error(error, self._locate(call)) from error

        return run

    return decorate


class ClBackend:
    """A device and its queue; `rhi.contract.backend.Backend` documents the methods.

    Attributes:
        context: OpenCL's device, context and queue, for uses outside of rhi's contract.
    """

    def __init__(self, context: ClContext) -> None:
        self.context = context
        self._queue = context.queue
        in_flight = InFlight()
        self._buffers = Buffers(context, in_flight)
        self._textures = Textures(context, in_flight)
        self._samplers = Samplers(context.context)
        self._builds = builds = Builds(context)
        self._programs = ComputePrograms(context, builds, self._buffers, self._textures, self._samplers)
        self._timestamps = Timestamps(context.queue)
        self._program: Id = 0
        self._render_pass = descriptors.PassDescriptor((0, 0))
        self._labels: list[str] = []  # the open ones, outermost first
        self._rasteriser = Rasteriser(
            context, builds, self._buffers, self._textures, self._samplers, in_flight
        )
        self._slots = self._rasteriser.bindings.slots
        self._bind = self._rasteriser.bindings.bind
        self._draw_state = self._rasteriser.state
        self._draws = self._rasteriser.draws
        self._vertex_arrays = self._rasteriser.vertex_arrays
        self.capabilities = query_capabilities(context, self._rasteriser.works)
        self._sample_queries = self._rasteriser.queries
        self._flush = self._rasteriser.flush
        self._fence = Fence(context.queue, in_flight)
        self._residency = context.programs
        self._destroyers: dict[Id, Callable[[Id], None]] = {}
        self._kinds: dict[Id, descriptors.QueryKind] = {}
        self.set_states, self.draw = self._draw_state.set, self._draws.draw
        self.prepare_uniform = self._rasteriser.bindings.prepare_uniform
        self.completed, self.wait = self._fence.poll, self._fence.wait
        self.begin_query, self.end_query = self._sample_queries.begin, self._sample_queries.end
        self.end_conditional = self._rasteriser.end_conditional

    @property
    def quick_work(self) -> int:
        """Number of work-items launched of kernels that aren't optimised (`rhi.backends.cl.builds`)."""
        return self._builds.quick_work

    @property
    def is_building(self) -> bool:
        """See `rhi.contract.backend.SupportsPreparedKernels`."""
        return self._builds.is_building

    def close(self) -> None:
        try:
            try:
                self._flush()
            finally:  # commands use memory that is released below
                self._queue.finish()
        finally:
            for resource in list(self._destroyers):
                self.destroy(resource)
            self._fence.release()
            self._builds.close()
            self._rasteriser.close()

    def _locate(self, call: str) -> str:
        """Return a call's name with the labels that are open around it, for errors."""
        return f"{call} in {' / '.join(self._labels)}" if self._labels else call

    # -- resources ---------------------------------------------------------------------------------------

    def create_buffer(self, buffer: Id, descriptor: descriptors.BufferDescriptor) -> None:
        self._buffers.create(buffer, descriptor)
        self._destroyers[buffer] = self._destroy_buffer

    def create_texture(self, texture: Id, descriptor: descriptors.TextureDescriptor) -> None:
        self._textures.create(texture, descriptor)
        self._destroyers[texture] = self._destroy_texture

    def create_sampler(self, sampler: Id, descriptor: descriptors.SamplerDescriptor) -> None:
        self._samplers.create(sampler, descriptor)
        self._destroyers[sampler] = self._samplers.destroy

    def create_program(self, program: Id, descriptor: descriptors.ProgramDescriptor) -> None:
        if descriptors.Stage.VERTEX in descriptor.stages:
            self._rasteriser.create_program(program, descriptor)
            self._destroyers[program] = self._rasteriser.destroy_program
        else:
            self._programs.create(program, descriptor)
            self._destroyers[program] = self._programs.destroy

    def create_vertex_array(self, vertex_array: Id, descriptor: descriptors.VertexArrayDescriptor) -> None:
        self._rasteriser.create_vertex_array(vertex_array, descriptor)
        self._destroyers[vertex_array] = self._destroy_vertex_array

    def create_query(self, query: Id, kind: descriptors.QueryKind) -> None:
        queries = self._timestamps if kind is descriptors.QueryKind.TIMESTAMP else self._sample_queries
        queries.create(query, kind)
        self._kinds[query] = kind
        self._destroyers[query] = self._destroy_query

    def destroy(self, resource: Id) -> None:
        self._destroyers.pop(resource)(resource)

    def _destroy_buffer(self, buffer: Id) -> None:
        self._forget(buffer)
        self._buffers.destroy(buffer)

    def _destroy_texture(self, texture: Id) -> None:
        self._forget(texture)
        self._textures.destroy(texture)

    def _forget(self, resource: Id) -> None:
        self._flush()
        self._vertex_arrays.forget(resource)
        self._programs.forget(resource)

    def _destroy_vertex_array(self, vertex_array: Id) -> None:
        self._draws.forget(vertex_array)
        self._vertex_arrays.destroy(vertex_array)

    def _destroy_query(self, query: Id) -> None:
        kind = self._kinds.pop(query)
        (self._timestamps if kind is descriptors.QueryKind.TIMESTAMP else self._sample_queries).destroy(query)

    # -- memory ------------------------------------------------------------------------------------------

    @_reports_errors_as("Buffer.write")
    def write_buffer(self, buffer: Id, offset: int, data: BytesLike) -> None:
        if self._buffers[buffer].host is None:
            self._flush()
        self._vertex_arrays.write(buffer, offset, data)
        self._buffers.write(buffer, offset, data)

    @_reports_errors_as("Buffer.read")
    def read_buffer(self, buffer: Id, offset: int, size: int) -> bytes:
        if self._buffers[buffer].read_in_place:
            return self._buffers.read(buffer, offset, size)
        self._flush()
        data = self._buffers.read(buffer, offset, size)
        self._fence.release()
        return data

    @_reports_errors_as("Buffer.read")
    def host_memory(self, buffer: Id) -> NDArray[np.uint8] | None:
        """See `rhi.contract.backend.SupportsHostMemory`."""
        self._flush()
        memory = self._buffers.host_memory(buffer)
        self._fence.release()
        return memory

    @_reports_errors_as("Buffer.copy_to")
    def copy_buffer(self, source: Id, source_offset: int, target: Id, target_offset: int, size: int) -> None:
        self._flush()
        self._vertex_arrays.change(target)
        self._buffers.copy(source, source_offset, target, target_offset, size)

    @_reports_errors_as("Buffer.clear")
    def clear_buffer(self, buffer: Id, offset: int, size: int, value: int) -> None:
        self._flush()
        self._vertex_arrays.change(buffer)
        self._buffers.clear(buffer, offset, size, value)

    @_reports_errors_as("Texture.write")
    def write_texture(self, texture: Id, level: int, region: descriptors.Region, data: BytesLike) -> None:
        self._flush()
        self._textures.write(texture, level, region, data)

    @_reports_errors_as("Texture.read")
    def read_texture(
        self, texture: Id, level: int, region: descriptors.Region, stencil: bool
    ) -> NDArray[np.generic]:
        self._flush()
        texels = self._textures.read(texture, level, region, stencil)
        self._fence.release()
        return texels

    @_reports_errors_as("Texture.copy_to")
    def copy_texture(
        self,
        source: Id,
        source_level: int,
        source_region: descriptors.Region,
        target: Id,
        target_level: int,
        x: int,
        y: int,
        layer: int,
    ) -> None:
        self._flush()
        self._textures.copy(source, source_level, source_region, target, target_level, x, y, layer)

    @_reports_errors_as("Texture.copy_to_buffer")
    def copy_texture_to_buffer(
        self, source: Id, level: int, region: descriptors.Region, target: Id, offset: int, row_bytes: int
    ) -> None:
        self._flush()
        self._vertex_arrays.change(target)
        self._textures.copy_to_buffer(source, level, region, self._buffers[target].cl, offset, row_bytes)

    @_reports_errors_as("Texture.copy_from_buffer")
    def copy_buffer_to_texture(
        self, source: Id, offset: int, row_bytes: int, target: Id, level: int, region: descriptors.Region
    ) -> None:
        self._flush()
        self._textures.copy_from_buffer(self._buffers[source].cl, offset, row_bytes, target, level, region)

    @_reports_errors_as("Texture.resolve_to")
    def resolve_texture(self, source: Id, target: Id) -> None:
        self._flush()
        self._textures.resolve(source, target)

    @_reports_errors_as("Texture.generate_mipmaps")
    def generate_mipmaps(self, texture: Id) -> None:
        self._flush()
        self._textures.generate_mipmaps(texture)

    # -- passes and bindings -----------------------------------------------------------------------------

    @_reports_errors_as("device.render_pass")
    def begin_pass(self, descriptor: descriptors.PassDescriptor) -> None:
        self._flush()
        self._render_pass = descriptor
        self._draw_state.begin_pass(descriptor)
        if descriptor.is_layered:  # tiles of draws clear one layer only
            self._flush()

    @_reports_errors_as("the end of a pass")
    def end_pass(self) -> None:
        self._flush()
        for color in self._render_pass.colors:
            if color.resolve:
                self._textures.resolve(color.texture, color.resolve)

    def bind_program(self, program: Id) -> None:
        self._program = program
        self._rasteriser.bind_program(program)

    def bind_uniform(self, slot: int, buffer: Id, offset: int, size: int) -> None:
        self._bind(descriptors.BindingKind.UNIFORM, slot, (buffer, offset, size))

    def bind_storage(self, slot: int, buffer: Id, offset: int, size: int) -> None:
        self._bind(descriptors.BindingKind.STORAGE, slot, (buffer, offset, size))

    def bind_texture(self, slot: int, texture: Id, sampler: Id) -> None:
        self._bind(descriptors.BindingKind.TEXTURE, slot, (texture, sampler))

    def bind_image(self, slot: int, texture: Id, level: int, layer: int) -> None:
        self._bind(descriptors.BindingKind.IMAGE, slot, (texture, level, layer))

    # -- work --------------------------------------------------------------------------------------------

    def prepare_draw(
        self,
        program: Id,
        vertex_array: Id,
        primitive: descriptors.Primitive,
        first: int,
        count: int,
        base_vertex: int,
        base_instance: int,
    ) -> Callable[[int], object]:
        """See `rhi.contract.backend.SupportsPreparedDraws`."""
        return self._draws.prepare_draw(vertex_array, primitive, first, count, base_vertex, base_instance)

    def prepare_kernels(
        self,
        program: Id,
        vertex_array: Id,
        colors: Sequence[Format],
        depth: Format | None,
        samples: int,
        states: Sequence[StateChange],
    ) -> Sequence[Future[None]]:
        """See `rhi.contract.backend.SupportsPreparedKernels`."""
        if program in self._programs:
            return self._programs[program].prepare()
        values = dict(states)
        return self._rasteriser.prepare_kernels(program, vertex_array, values, colors, depth, samples)

    def prepare_queries(self, queries: Sequence[Id]) -> PreparedQueries:
        """See `rhi.contract.backend.SupportsPreparedQueries`."""
        return ClQuerySet(self._rasteriser, len(queries))

    def on_interruption(self, call: Callable[[], None]) -> None:
        """Ignore the callback: this backend shares no context, so nothing interrupts it."""

    @_reports_errors_as("device.draw_clipped")
    def draw_clipped(
        self,
        vertex_array: Id,
        primitive: descriptors.Primitive,
        draws: NDArray[Any],
        clips: NDArray[np.int64],
    ) -> None:
        """See `rhi.contract.backend.SupportsClippedDraws`."""
        self._draws.draw_clipped(vertex_array, primitive, draws, clips)

    @_reports_errors_as("device.draw_indirect")
    def draw_indirect(
        self,
        vertex_array: Id,
        primitive: descriptors.Primitive,
        buffer: Id,
        offset: int,
        draws: int,
        stride: int,
        count_buffer: Id,
        count_offset: int,
    ) -> None:
        """Draw directly, with arguments that are read back; waits if the device wrote them."""
        self._draws.draw_indirect(
            vertex_array, primitive, buffer, offset, draws, stride, count_buffer, count_offset
        )

    @_reports_errors_as("device.dispatch")
    def dispatch(self, x: int, y: int, z: int) -> None:
        self._flush()
        program = self._programs[self._program]
        program.launch(self._queue, self._slots, (x, y, z))
        self._rasteriser.change_stored(program.written)

    @_reports_errors_as("device.dispatch_indirect")
    def dispatch_indirect(self, buffer: Id, offset: int) -> None:
        """Read the arguments back, which waits: OpenCL takes the number of work-groups from the CPU."""
        self._flush()
        words = np.frombuffer(self._buffers.read(buffer, offset, _GROUPS_BYTES), np.uint32)
        groups = words.tolist()
        if not any(
            dispatch_faults(groups, "", self.capabilities)
        ):  # as in WebGPU, another dispatch does nothing
            self.dispatch(*groups)

    # -- time --------------------------------------------------------------------------------------------

    @_reports_errors_as("device.signal")
    def signal(self, value: int) -> None:
        self._flush()
        self._fence.signal(value)
        self._residency.reach(value)

    @_reports_errors_as("a timestamp")
    def write_query(self, query: Id) -> None:
        if self._kinds[query] is descriptors.QueryKind.TIMESTAMP:
            self._flush()
            self._timestamps.write(query)
        else:
            self._sample_queries.take(query)

    def read_query(self, query: Id) -> int | None:
        queries = (
            self._timestamps
            if self._kinds[query] is descriptors.QueryKind.TIMESTAMP
            else self._sample_queries
        )
        return queries.read(query)

    def read_issue_time(self, query: Id) -> int | None:
        """See `rhi.contract.backend.SupportsIssueTimes`."""
        return self._timestamps.read_issue_time(query)

    @_reports_errors_as("device.conditional")
    def begin_conditional(self, query: Id, inverted: bool) -> None:
        self._rasteriser.begin_conditional(query, inverted)

    def push_label(self, text: str) -> None:
        self._labels.append(text)

    def pop_label(self) -> None:
        del self._labels[-1:]

    @_reports_errors_as("device.present")
    def present(self, texture: Id) -> None:
        self._flush()
        self._queue.flush()
