"""The OpenCL backend: rhi's contract on one queue that executes in order. Memory, time and compute; no draws.

- Commands go to the queue as they come, so the contract's order is the queue's. Only reads wait, and an indirect
  dispatch, because OpenCL can't take the number of work-groups from memory.
- Passes clear and resolve. `capabilities.draws` is False: the front end refuses programs that draw.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NoReturn

import numpy as np
from numpy.typing import NDArray
from typing_extensions import Buffer as BytesLike

from rhi.backend import Capabilities
from rhi.backends.cl.context import Context
from rhi.backends.cl.errors import translate_errors
from rhi.backends.cl.programs import Programs
from rhi.backends.cl.queries import Fence, Queries
from rhi.backends.cl.resources import Buffers, Staging, Textures, alignment
from rhi.backends.cl.states import States
from rhi.descriptors import (
    BindingKind,
    BufferDescriptor,
    Id,
    PassDescriptor,
    ProgramDescriptor,
    QueryKind,
    Region,
    SamplerDescriptor,
    TextureDescriptor,
)
from rhi.errors import refuse
from rhi.rules import DEVICE_CAPABILITY

__rhi_internal__ = True

_GROUPS_BYTES: Final = 12
_MAX_UNIFORM_BYTES: Final = 65536


class ClBackend:
    """One device and queue; see `rhi.backend.Backend` for what the methods do.

    Attributes:
        context: OpenCL's device, context and queue, for what only OpenCL has.
    """

    def __init__(self, context: Context) -> None:
        self.context = context
        self._queue = context.queue
        self._capabilities = query_capabilities(context)
        staging = Staging()
        self._buffers = Buffers(context, staging)
        self._textures = Textures(context, staging)
        self._programs = Programs(context)
        self._queries = Queries(context.queue)
        self._fence = Fence(context.queue, staging)
        self._states = States()
        self._destroyers: dict[Id, Callable[[Id], None]] = {}

    @property
    def capabilities(self) -> Capabilities:
        return self._capabilities

    def close(self) -> None:
        self._queue.finish()
        for resource in list(self._destroyers):
            self.destroy(resource)

    # -- resources ---------------------------------------------------------------------------------------

    def create_buffer(self, buffer: Id, descriptor: BufferDescriptor) -> None:
        self._buffers.create(buffer, descriptor)
        self._destroyers[buffer] = self._buffers.destroy

    def create_texture(self, texture: Id, descriptor: TextureDescriptor) -> None:
        self._textures.create(texture, descriptor)
        self._destroyers[texture] = self._textures.destroy

    def create_sampler(self, sampler: Id, descriptor: SamplerDescriptor) -> None:
        pass  # nothing samples yet

    def create_program(self, program: Id, descriptor: ProgramDescriptor) -> None:
        self._programs.create(program, descriptor)
        self._destroyers[program] = self._programs.destroy

    def create_query(self, query: Id, kind: QueryKind) -> None:
        """TIMESTAMP: the other kinds count what is drawn."""
        self._queries.create(query)
        self._destroyers[query] = self._queries.destroy

    def destroy(self, resource: Id) -> None:
        self._destroyers.pop(resource)(resource)

    # -- memory ------------------------------------------------------------------------------------------

    def write_buffer(self, buffer: Id, offset: int, data: BytesLike) -> None:
        self._buffers.write(buffer, offset, data)

    def read_buffer(self, buffer: Id, offset: int, size: int) -> bytes:
        return self._buffers.read(buffer, offset, size)

    def copy_buffer(self, source: Id, source_offset: int, target: Id, target_offset: int, size: int) -> None:
        self._buffers.copy(source, source_offset, target, target_offset, size)

    def clear_buffer(self, buffer: Id, offset: int, size: int, value: int) -> None:
        self._buffers.clear(buffer, offset, size, value)

    def write_texture(self, texture: Id, level: int, region: Region, data: BytesLike) -> None:
        self._textures.write(texture, level, region, data)

    def read_texture(self, texture: Id, level: int, region: Region, stencil: bool) -> NDArray[np.generic]:
        return self._textures.read(texture, level, region, stencil)

    def copy_texture(
        self, source: Id, source_level: int, source_region: Region, target: Id, target_level: int, x: int, y: int,
        layer: int,
    ) -> None:  # fmt: skip
        self._textures.copy(source, source_level, source_region, target, target_level, x, y, layer)

    def resolve_texture(self, source: Id, target: Id) -> None:
        self._textures.resolve(source, target)

    def generate_mipmaps(self, texture: Id) -> None:
        self._textures.generate_mipmaps(texture)

    # -- passes and bindings -----------------------------------------------------------------------------

    def begin_pass(self, descriptor: PassDescriptor) -> None:
        self._states.render_pass = descriptor
        for color in descriptor.colors:
            if color.clear is not None:
                self._textures.clear_color(color)
        if descriptor.depth is not None:
            self._textures.clear_depth(descriptor.depth)

    def end_pass(self) -> None:
        for color in self._states.render_pass.colors:
            if color.resolve:
                self._textures.resolve(color.texture, color.resolve)

    def bind_program(self, program: Id) -> None:
        self._states.program = program

    def bind_uniform(self, slot: int, buffer: Id, offset: int, size: int) -> None:
        self._states.ranges[BindingKind.UNIFORM, slot] = buffer, offset, size

    def bind_storage(self, slot: int, buffer: Id, offset: int, size: int) -> None:
        self._states.ranges[BindingKind.STORAGE, slot] = buffer, offset, size

    # -- work --------------------------------------------------------------------------------------------

    def dispatch(self, x: int, y: int, z: int) -> None:
        states = self._states
        with translate_errors(states.place("device.dispatch")):
            self._programs[states.program].launch(self._queue, self._buffers, states, (x, y, z))

    def dispatch_indirect(self, buffer: Id, offset: int) -> None:
        """Waits: OpenCL takes the number of work-groups from the CPU."""
        words = np.frombuffer(self._buffers.read(buffer, offset, _GROUPS_BYTES), np.uint32)
        self.dispatch(*words.tolist())

    # -- time --------------------------------------------------------------------------------------------

    def signal(self, value: int) -> None:
        self._fence.signal(value)

    def completed(self) -> int:
        return self._fence.poll()

    def wait(self, value: int, seconds: float) -> bool:
        return self._fence.wait(value, seconds)

    def write_query(self, query: Id) -> None:
        self._queries.write(query)

    def read_query(self, query: Id) -> int | None:
        return self._queries.read(query)

    def push_label(self, text: str) -> None:
        self._states.labels.append(text)

    def pop_label(self) -> None:
        self._states.labels.pop()

    def present(self, texture: Id) -> None:
        self._queue.flush()

    # -- what needs capabilities that are declared missing ---------------------------------------------------

    def _refuse(self, *arguments: object) -> NoReturn:
        refuse(
            DEVICE_CAPABILITY, "the cl backend", "a draw, or what serves draws", "memory, time and compute"
        )

    create_vertex_array = set_states = draw = draw_indirect = _refuse
    begin_query = end_query = begin_conditional = end_conditional = _refuse
    bind_texture = bind_image = _refuse


def query_capabilities(context: Context) -> Capabilities:
    """What the device can do, as far as this backend does it."""
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
        max_texture_slots=0,
        max_image_slots=0,
        max_work_group=(x, y, z),
        max_work_group_invocations=int(device.max_work_group_size),
        max_shared_bytes=int(device.local_mem_size),
        uniform_alignment=grain,
        storage_alignment=grain,
        draws=False,
        indirect_count=False,
        occlusion_queries=False,
        conditional_rendering=False,
        alpha_to_coverage=False,
        depth_bias_clamp=False,
        blend_per_target=False,
    )
