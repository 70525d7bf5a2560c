"""The OpenCL backend: rhi's contract on one queue that executes in order.

- Draws gather (`rhi.backends.cl.raster.rasteriser`); all else goes to the queue as it comes, after the draws before
  it were handed over (`_flush`). So the contract's order is the queue's.
- Only reads wait, and indirect draws and dispatches, whose sizes OpenCL can't take from memory.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import wraps
from typing import Concatenate, Final, ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray
from typing_extensions import Buffer as BytesLike

from rhi.backends.cl.context import ClContext
from rhi.backends.cl.errors import DRIVER_ERRORS, make_error
from rhi.backends.cl.fence import Fence, Timestamps
from rhi.backends.cl.planes import alignment
from rhi.backends.cl.programs import Programs
from rhi.backends.cl.raster.query_sets import QuerySet
from rhi.backends.cl.raster.rasteriser import Rasteriser
from rhi.backends.cl.resources import Buffers, Staging, Textures
from rhi.backends.cl.samplers import Samplers
from rhi.backends.cl.slots import States
from rhi.contract.backend import Capabilities, PreparedQueries
from rhi.contract.descriptors import (
    BindingKind,
    BufferDescriptor,
    Id,
    PassDescriptor,
    Primitive,
    ProgramDescriptor,
    QueryKind,
    Region,
    SamplerDescriptor,
    Stage,
    TextureDescriptor,
    VertexArrayDescriptor,
)
from rhi.contract.states import StateChange

__rhi_internal__ = True

P = ParamSpec("P")
R = TypeVar("R")

_GROUPS_BYTES: Final = 12
_MAX_UNIFORM_BYTES: Final = 65536


def _told_as(
    call: str,
) -> Callable[[Callable[Concatenate[ClBackend, P], R]], Callable[Concatenate[ClBackend, P], R]]:
    """What OpenCL refuses in a method is a `DeviceError` of this call, and of the labels that it lies in."""

    def decorate(method: Callable[Concatenate[ClBackend, P], R]) -> Callable[Concatenate[ClBackend, P], R]:
        @wraps(method)
        def run(self: ClBackend, /, *arguments: P.args, **named: P.kwargs) -> R:
            try:
                return method(self, *arguments, **named)
            except DRIVER_ERRORS as error:
                raise make_error(error, self._states.place(call)) from error

        return run

    return decorate


class ClBackend:
    """One device and queue; see `rhi.contract.backend.Backend` for what the methods do.

    Attributes:
        context: OpenCL's device, context and queue, for what only OpenCL has.
    """

    def __init__(self, context: ClContext) -> None:
        self.context = context
        self._queue = context.queue
        staging = Staging()
        self._buffers = Buffers(context, staging)
        self._textures = Textures(context, staging)
        self._samplers = Samplers(context.context)
        self._programs = Programs(context, self._buffers, self._textures, self._samplers)
        self._timestamps = Timestamps(context.queue)
        self._states = States()
        self._rasteriser = Rasteriser(
            context, self._states.slots, self._buffers, self._textures, self._samplers
        )
        self._bind = self._rasteriser.bindings.bind
        self._capabilities = query_capabilities(context, self._rasteriser.works)
        self._counters = self._rasteriser.counters
        self._flush = self._rasteriser.flush
        self._fence = Fence(context.queue, staging, self._rasteriser.retired)
        self._destroyers: dict[Id, Callable[[Id], None]] = {}
        self._kinds: dict[Id, QueryKind] = {}

    @property
    def capabilities(self) -> Capabilities:
        return self._capabilities

    def close(self) -> None:
        try:
            self._flush()
            self._queue.finish()
        finally:
            for resource in list(self._destroyers):
                self.destroy(resource)

    # -- resources ---------------------------------------------------------------------------------------

    def create_buffer(self, buffer: Id, descriptor: BufferDescriptor) -> None:
        self._buffers.create(buffer, descriptor)
        self._destroyers[buffer] = self._destroy_buffer

    def create_texture(self, texture: Id, descriptor: TextureDescriptor) -> None:
        self._textures.create(texture, descriptor)
        self._destroyers[texture] = self._destroy_texture

    def create_sampler(self, sampler: Id, descriptor: SamplerDescriptor) -> None:
        self._samplers.create(sampler, descriptor)
        self._destroyers[sampler] = self._samplers.destroy

    def create_program(self, program: Id, descriptor: ProgramDescriptor) -> None:
        if Stage.VERTEX in descriptor.stages:
            self._rasteriser.create_program(program, descriptor)
            self._destroyers[program] = self._rasteriser.destroy_program
        else:
            self._programs.create(program, descriptor)
            self._destroyers[program] = self._programs.destroy

    def create_vertex_array(self, vertex_array: Id, descriptor: VertexArrayDescriptor) -> None:
        self._rasteriser.create_vertex_array(vertex_array, descriptor)
        self._destroyers[vertex_array] = self._rasteriser.destroy_vertex_array

    def create_query(self, query: Id, kind: QueryKind) -> None:
        queries = self._timestamps if kind is QueryKind.TIMESTAMP else self._counters
        queries.create(query, kind)
        self._kinds[query] = kind
        self._destroyers[query] = self._destroy_query

    def destroy(self, resource: Id) -> None:
        self._destroyers.pop(resource)(resource)

    def _destroy_buffer(self, buffer: Id) -> None:
        self._flush()
        self._rasteriser.forget(buffer)
        self._buffers.destroy(buffer)

    def _destroy_texture(self, texture: Id) -> None:
        self._flush()
        self._rasteriser.forget(texture)
        self._textures.destroy(texture)

    def _destroy_query(self, query: Id) -> None:
        kind = self._kinds.pop(query)
        (self._timestamps if kind is QueryKind.TIMESTAMP else self._counters).destroy(query)

    # -- memory ------------------------------------------------------------------------------------------

    @_told_as("Buffer.write")
    def write_buffer(self, buffer: Id, offset: int, data: BytesLike) -> None:
        if self._buffers[buffer].host is None:
            self._flush()
        self._rasteriser.write(buffer, offset, data)
        self._buffers.write(buffer, offset, data)

    @_told_as("Buffer.read")
    def read_buffer(self, buffer: Id, offset: int, size: int) -> bytes:
        self._flush()
        return self._buffers.read(buffer, offset, size)

    @_told_as("Buffer.copy_to")
    def copy_buffer(self, source: Id, source_offset: int, target: Id, target_offset: int, size: int) -> None:
        self._flush()
        self._rasteriser.change(target)
        self._buffers.copy(source, source_offset, target, target_offset, size)

    @_told_as("Buffer.clear")
    def clear_buffer(self, buffer: Id, offset: int, size: int, value: int) -> None:
        self._flush()
        self._rasteriser.change(buffer)
        self._buffers.clear(buffer, offset, size, value)

    @_told_as("Texture.write")
    def write_texture(self, texture: Id, level: int, region: Region, data: BytesLike) -> None:
        self._flush()
        self._textures.write(texture, level, region, data)

    @_told_as("Texture.read")
    def read_texture(self, texture: Id, level: int, region: Region, stencil: bool) -> NDArray[np.generic]:
        self._flush()
        return self._textures.read(texture, level, region, stencil)

    @_told_as("Texture.copy_to")
    def copy_texture(
        self, source: Id, source_level: int, source_region: Region, target: Id, target_level: int, x: int, y: int,
        layer: int,
    ) -> None:  # fmt: skip
        self._flush()
        self._textures.copy(source, source_level, source_region, target, target_level, x, y, layer)

    @_told_as("Texture.resolve_to")
    def resolve_texture(self, source: Id, target: Id) -> None:
        self._flush()
        self._textures.resolve(source, target)

    @_told_as("Texture.generate_mipmaps")
    def generate_mipmaps(self, texture: Id) -> None:
        self._flush()
        self._textures.generate_mipmaps(texture)

    # -- passes and bindings -----------------------------------------------------------------------------

    @_told_as("device.render_pass")
    def begin_pass(self, descriptor: PassDescriptor) -> None:
        self._flush()
        self._states.render_pass = descriptor
        self._rasteriser.begin_pass(descriptor)

    def set_states(self, changes: Sequence[StateChange]) -> None:
        self._rasteriser.set_states(changes)

    @_told_as("the end of a pass")
    def end_pass(self) -> None:
        self._flush()
        for color in self._states.render_pass.colors:
            if color.resolve:
                self._textures.resolve(color.texture, color.resolve)

    def bind_program(self, program: Id) -> None:
        self._states.program = program
        self._rasteriser.bind_program(program)

    def bind_uniform(self, slot: int, buffer: Id, offset: int, size: int) -> None:
        self._bind(BindingKind.UNIFORM, slot, (buffer, offset, size))

    def bind_storage(self, slot: int, buffer: Id, offset: int, size: int) -> None:
        self._bind(BindingKind.STORAGE, slot, (buffer, offset, size))

    def bind_texture(self, slot: int, texture: Id, sampler: Id) -> None:
        self._bind(BindingKind.TEXTURE, slot, (texture, sampler))

    def bind_image(self, slot: int, texture: Id, level: int, layer: int) -> None:
        self._bind(BindingKind.IMAGE, slot, (texture, level, layer))

    def prepare_uniform(self, buffer: Id) -> Callable[[int, int, int], object]:
        """See `rhi.contract.backend.PreparesDraws`."""
        return self._rasteriser.bindings.prepare_uniform(buffer)

    # -- work --------------------------------------------------------------------------------------------

    def draw(
        self, vertex_array: Id, primitive: Primitive, first: int, count: int, instances: int, base_vertex: int,
        base_instance: int,
    ) -> None:  # fmt: skip
        self._rasteriser.draw(vertex_array, primitive, first, count, instances, base_vertex, base_instance)

    def prepare_draw(
        self, program: Id, vertex_array: Id, primitive: Primitive, first: int, count: int, base_vertex: int,
        base_instance: int,
    ) -> Callable[[int], object]:  # fmt: skip
        """See `rhi.contract.backend.PreparesDraws`."""
        return self._rasteriser.prepare_draw(
            vertex_array, primitive, first, count, base_vertex, base_instance
        )

    def prepare_queries(self, queries: Sequence[Id]) -> PreparedQueries:
        """See `rhi.contract.backend.PreparesQueries`."""
        return QuerySet(self._rasteriser, len(queries))

    def on_interruption(self, call: Callable[[], None]) -> None:
        """Nobody interrupts: nothing is shared with other contexts."""

    @_told_as("device.draw_indirect")
    def draw_indirect(
        self, vertex_array: Id, primitive: Primitive, buffer: Id, offset: int, draws: int, stride: int,
        count_buffer: Id, count_offset: int,
    ) -> None:  # fmt: skip
        """Waits for what the device writes: indirect draws are read back and become plain ones."""
        self._rasteriser.draw_indirect(
            vertex_array, primitive, buffer, offset, draws, stride, count_buffer, count_offset
        )

    @_told_as("device.dispatch")
    def dispatch(self, x: int, y: int, z: int) -> None:
        self._flush()
        program = self._programs[self._states.program]
        program.launch(self._queue, self._states, (x, y, z))
        self._rasteriser.change_stored(program.written)

    @_told_as("device.dispatch_indirect")
    def dispatch_indirect(self, buffer: Id, offset: int) -> None:
        """Waits: OpenCL takes the number of work-groups from the CPU."""
        self._flush()
        words = np.frombuffer(self._buffers.read(buffer, offset, _GROUPS_BYTES), np.uint32)
        self.dispatch(*words.tolist())

    # -- time --------------------------------------------------------------------------------------------

    @_told_as("device.signal")
    def signal(self, value: int) -> None:
        self._flush()
        self._fence.signal(value)

    def completed(self) -> int:
        return self._fence.poll()

    def wait(self, value: int, seconds: float) -> bool:
        return self._fence.wait(value, seconds)

    def begin_query(self, query: Id) -> None:
        self._counters.begin(query)

    def end_query(self, query: Id) -> None:
        self._counters.end(query)

    @_told_as("a timestamp")
    def write_query(self, query: Id) -> None:
        if self._kinds[query] is QueryKind.TIMESTAMP:
            self._flush()
            self._timestamps.write(query)
        else:
            self._counters.take(query)

    def read_query(self, query: Id) -> int | None:
        queries = self._timestamps if self._kinds[query] is QueryKind.TIMESTAMP else self._counters
        return queries.read(query)

    @_told_as("device.conditional")
    def begin_conditional(self, query: Id, inverted: bool) -> None:
        self._rasteriser.begin_conditional(query, inverted)

    def end_conditional(self) -> None:
        self._rasteriser.end_conditional()

    def push_label(self, text: str) -> None:
        self._states.labels.append(text)

    def pop_label(self) -> None:
        self._states.labels.pop()

    @_told_as("device.present")
    def present(self, texture: Id) -> None:
        self._flush()
        self._queue.flush()


def query_capabilities(context: ClContext, draws: bool) -> Capabilities:
    """What the device can do, as far as this backend does it; `draws`: whether the rasteriser works on it."""
    device = context.device
    grain = alignment(device)
    x, y, z = (int(size) for size in (*device.max_work_item_sizes, 1, 1)[:3])
    return Capabilities(
        backend="cl",
        device=str(device.name).strip(),
        driver=f"{' '.join(device.platform.version.split())}, {device.driver_version}",
        passed_over=context.passed_over,
        max_uniform_bytes=min(_MAX_UNIFORM_BYTES, int(device.max_mem_alloc_size)),
        max_storage_bytes=min((1 << 32) - 1, int(device.max_mem_alloc_size)),
        max_work_group=(x, y, z),
        max_work_group_invocations=int(device.max_work_group_size),
        max_shared_bytes=int(device.local_mem_size),
        uniform_alignment=grain,
        storage_alignment=grain,
        max_texture_size=8192,  # the farthest that window positions reach, see kernels/common.cl
        draws=draws,
        indirect_count=draws,
        occlusion_queries=draws,
        sample_counter=draws,
        conditional_rendering=draws,
        alpha_test=draws,
    )
