"""The numpy backend: rhi's contract on NumPy. Memory, copies, clears, time and compute; no draws.

The example of docs/porting.md, steps 1 to 4. Every call is executed at once. So commands execute in the order
of the calls, reads never wait, and a fence is completed as soon as it is signalled.
"""

from __future__ import annotations

import time
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray
from typing_extensions import Buffer as BytesLike

from rhi.contract import (
    BindingKind,
    BufferDescriptor,
    Capabilities,
    Id,
    PassDescriptor,
    ProgramDescriptor,
    QueryKind,
    Region,
    SamplerDescriptor,
    TextureDescriptor,
    refuse,
    rules,
)
from rhi_numpy.memory import Memory
from rhi_numpy.programs import Program

__rhi_internal__ = True  # errors name the line that called rhi, not one of this module


class NumpyBackend:
    """The backend of one device; see `rhi.contract.Backend`."""

    def __init__(self) -> None:
        self._capabilities = Capabilities(
            backend="numpy",
            device="NumPy",
            driver=f"NumPy {np.__version__}",
            sample_counts=(1,),
            max_texture_slots=0,
            max_image_slots=0,
            uniform_alignment=16,
            storage_alignment=16,
            texture_buffer_copies=True,
            draws=False,
            indirect_count=False,
            occlusion_queries=False,
            conditional_rendering=False,
            alpha_to_coverage=False,
            depth_bias_clamp=False,
            blend_per_target=False,
        )
        self._memory = Memory()
        self._programs: dict[Id, Program] = {}
        self._times: dict[Id, int | None] = {}
        self._fence = 0
        self._program: Id = 0
        self._ranges: dict[tuple[BindingKind, int], tuple[Id, int, int]] = {}

    @property
    def capabilities(self) -> Capabilities:
        return self._capabilities

    def close(self) -> None:
        self._memory = Memory()
        self._programs.clear()

    # -- 1: buffers --------------------------------------------------------------------------------------

    def create_buffer(self, buffer: Id, descriptor: BufferDescriptor) -> None:
        self._memory.create_buffer(buffer, descriptor)

    def destroy(self, resource: Id) -> None:
        for table in (self._memory.buffers, self._memory.textures, self._programs, self._times):
            table.pop(resource, None)

    def write_buffer(self, buffer: Id, offset: int, data: BytesLike) -> None:
        source = np.frombuffer(memoryview(data), np.uint8)
        self._memory.buffers[buffer][offset : offset + len(source)] = source

    def read_buffer(self, buffer: Id, offset: int, size: int) -> bytes:
        return self._memory.buffers[buffer][offset : offset + size].tobytes()

    def copy_buffer(self, source: Id, source_offset: int, target: Id, target_offset: int, size: int) -> None:
        data = self._memory.buffers[source][source_offset : source_offset + size]
        self._memory.buffers[target][target_offset : target_offset + size] = data

    def clear_buffer(self, buffer: Id, offset: int, size: int, value: int) -> None:
        self._memory.buffers[buffer][offset : offset + size].view("<u4")[:] = value

    # -- 2: textures and passes --------------------------------------------------------------------------

    def create_texture(self, texture: Id, descriptor: TextureDescriptor) -> None:
        self._memory.create_texture(texture, descriptor)

    def create_sampler(self, sampler: Id, descriptor: SamplerDescriptor) -> None:
        """Do nothing: no shader can sample a texture, since `max_texture_slots` is 0."""

    def write_texture(self, texture: Id, level: int, region: Region, data: BytesLike) -> None:
        self._memory.write_texture(texture, level, region, data)

    def read_texture(self, texture: Id, level: int, region: Region, stencil: bool) -> NDArray[np.generic]:
        return self._memory.box(texture, level, region, stencil).copy()

    def copy_texture(
        self,
        source: Id,
        source_level: int,
        source_region: Region,
        target: Id,
        target_level: int,
        x: int,
        y: int,
        layer: int,
    ) -> None:
        region = Region(x, y, source_region.width, source_region.height, layer, source_region.layers)
        self._memory.copy_texture(source, source_level, source_region, target, target_level, region)

    def copy_texture_to_buffer(
        self, source: Id, level: int, region: Region, target: Id, offset: int, row_bytes: int
    ) -> None:
        rows = self._memory.texture_rows(source, level, region)
        self._memory.buffer_rows(target, offset, row_bytes, rows)[:] = rows

    def copy_buffer_to_texture(
        self, source: Id, offset: int, row_bytes: int, target: Id, level: int, region: Region
    ) -> None:
        rows = self._memory.texture_rows(target, level, region)
        data = self._memory.buffer_rows(source, offset, row_bytes, rows).tobytes()
        self._memory.write_texture(target, level, region, data)

    def generate_mipmaps(self, texture: Id) -> None:
        self._memory.generate_mipmaps(texture)

    def begin_pass(self, descriptor: PassDescriptor) -> None:
        self._memory.clear_targets(descriptor)

    def end_pass(self) -> None:
        """Do nothing: there is only 1 sample, so there is nothing to resolve."""

    # -- 3: time and labels ------------------------------------------------------------------------------

    def signal(self, value: int) -> None:
        self._fence = value

    def completed(self) -> int:
        return self._fence

    def wait(self, value: int, seconds: float) -> bool:
        return True  # the front end waits only for values that were signalled

    def create_query(self, query: Id, kind: QueryKind) -> None:
        self._times[query] = None

    def write_query(self, query: Id) -> None:
        self._times[query] = time.perf_counter_ns()

    def read_query(self, query: Id) -> int | None:
        return self._times[query]

    def push_label(self, text: str) -> None:
        """Do nothing: labels are for debugging tools, and NumPy has none."""

    def pop_label(self) -> None:
        """Do nothing, as in `push_label`."""

    def present(self, texture: Id) -> None:
        """Do nothing: there is no window."""

    # -- 4: compute --------------------------------------------------------------------------------------

    def create_program(self, program: Id, descriptor: ProgramDescriptor) -> None:
        self._programs[program] = Program(descriptor)

    def bind_program(self, program: Id) -> None:
        self._program = program

    def bind_uniform(self, slot: int, buffer: Id, offset: int, size: int) -> None:
        self._ranges[BindingKind.UNIFORM, slot] = buffer, offset, size

    def bind_storage(self, slot: int, buffer: Id, offset: int, size: int) -> None:
        self._ranges[BindingKind.STORAGE, slot] = buffer, offset, size

    def dispatch(self, x: int, y: int, z: int) -> None:
        self._programs[self._program].launch((x, y, z), self._memory.buffers, self._ranges)

    def dispatch_indirect(self, buffer: Id, offset: int) -> None:
        x, y, z = np.frombuffer(self.read_buffer(buffer, offset, 12), "<u4").tolist()
        self.dispatch(x, y, z)

    # -- 5 to 8: methods whose capabilities are declared missing -----------------------------------------

    def _refuse(self, *arguments: object) -> NoReturn:
        refuse(
            rules.DEVICE_CAPABILITY,
            "the numpy backend",
            "a draw, or a call that draws need",
            "memory and compute",
        )

    create_vertex_array = set_states = draw = draw_indirect = resolve_texture = _refuse
    bind_texture = bind_image = begin_query = end_query = begin_conditional = end_conditional = _refuse
