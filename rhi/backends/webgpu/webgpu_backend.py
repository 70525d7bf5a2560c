"""rhi's contract on one device of an implementation of WebGPU.

- The device's objects create resources; what happens often is a function of the `Implementation`.
- Clip space, the order of rows and the provoking vertex are the same as in the contract, so nothing is
  flipped.
- WebGPU checks all commands when they are submitted: what it refuses then is raised as `device-driver`, by
  the call that submits.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future
from time import monotonic
from typing import Any, Final

from rhi.backends.webgpu.command_encoder import Stream
from rhi.backends.webgpu.implementation import FormatUses, GpuObject, Host, Implementation
from rhi.backends.webgpu.tools import Tools
from rhi.backends.webgpu.webgpu_bindings import BoundResources
from rhi.backends.webgpu.webgpu_buffers import Buffers
from rhi.backends.webgpu.webgpu_capabilities import query_capabilities
from rhi.backends.webgpu.webgpu_draws import Draws
from rhi.backends.webgpu.webgpu_errors import translate_errors
from rhi.backends.webgpu.webgpu_pipelines import Pipelines, States
from rhi.backends.webgpu.webgpu_programs import GpuProgram
from rhi.backends.webgpu.webgpu_queries import Queries
from rhi.backends.webgpu.webgpu_recorded_draws import RecordedDraws
from rhi.backends.webgpu.webgpu_samplers import Samplers
from rhi.backends.webgpu.webgpu_textures import Textures
from rhi.contract import descriptors
from rhi.contract.descriptors import Id
from rhi.contract.driver_faults import is_fourth_uniform_faulty
from rhi.contract.formats import ChannelKind, Format
from rhi.contract.interrupts import DeferredInterrupts
from rhi.contract.states import StateChange

_FIRST_PAUSE: Final = 2e-5
_LONGEST_PAUSE: Final = 5e-4


class WebGpuBackend:
    """A backend on one device. `rhi.contract.backend.Backend` documents the methods.

    Attributes:
        device: WebGPU's device, for what only this backend has.
        get_surface: returns the window's texture for the next image; its argument says whether the texture
            should encode sRGB. None: `present` shows nothing.
    """

    def __init__(self, implementation: Implementation, host: Host, uses: FormatUses) -> None:
        self._implementation = implementation
        self.get_surface: Callable[[bool], GpuObject] | None = None
        device = self.device = host.device
        self._fence = implementation.create_fence(device)
        mappings = self._mappings = implementation.create_mappings()
        self._stream = Stream(implementation, device, self._fence)
        self._buffers = Buffers(device, self._stream, mappings)
        self._tools = Tools(device, self._buffers)
        self._textures = Textures(device, self._stream, self._buffers, self._tools, uses)
        self._samplers = Samplers(device)
        self.capabilities = query_capabilities(implementation, host, uses)
        self._bindings = BoundResources(
            device,
            self._stream,
            self._buffers,
            self._textures,
            self._samplers,
            self.capabilities.unfilterable_formats,
        )
        self._states = States(implementation)
        self._pipelines = Pipelines(device, self.capabilities)
        self._draws = Draws(
            device,
            self._stream,
            self._buffers,
            self._bindings,
            self._states,
            self._pipelines,
            self._tools,
            host.features,
        )
        self._queries = Queries(
            device, self._stream, mappings, "timestamp-query-inside-passes" in host.features
        )
        self._recorded = RecordedDraws(
            device, self._stream, self._buffers, self._bindings, self._states, self._draws
        )
        self._has_pads = is_fourth_uniform_faulty(host.info["device"])
        self._programs: dict[Id, GpuProgram] = {}
        self._destroyers: dict[Id, Callable[[Id], None]] = {}
        self.bind_uniform = self._bindings.bind_uniform
        self.bind_storage = self._bindings.bind_storage
        self.bind_texture = self._bindings.bind_texture
        self.bind_image = self._bindings.bind_image
        self.set_states = self._states.set
        self.draw = self._draws.draw
        self.draw_indirect = self._draws.draw_indirect
        self.draw_clipped = self._draws.draw_clipped
        self.dispatch = self._draws.dispatch
        self.dispatch_indirect = self._draws.dispatch_indirect
        self.write_buffer = self._buffers.write
        self.read_buffer = self._buffers.read
        self.copy_buffer = self._buffers.copy
        self.clear_buffer = self._buffers.clear
        self.write_texture = self._textures.write
        self.read_texture = self._textures.read
        self.copy_texture = self._textures.copy
        self.copy_texture_to_buffer = self._textures.copy_to_buffer
        self.copy_buffer_to_texture = self._textures.copy_from_buffer
        self.resolve_texture = self._textures.resolve
        self.generate_mipmaps = self._textures.generate_mipmaps
        self.begin_query, self.end_query = self._queries.begin, self._queries.end
        self.write_query, self.read_query = self._queries.write, self._queries.read
        self.end_pass = self._stream.end_pass
        self.push_label, self.pop_label = self._stream.push_label, self._stream.pop_label
        self.signal, self.completed = self._stream.signal, self._fence.poll

    def on_interruption(self, call: Callable[[], None]) -> None:
        """Do nothing: no other code changes this device's bindings."""

    def close(self) -> None:
        with DeferredInterrupts():
            self._stream.abandon()
            self._implementation.release(self.device)
            self._fence.close()
            self._mappings.close()

    # -- resources ---------------------------------------------------------------------------------------

    def create_buffer(self, buffer: Id, descriptor: descriptors.BufferDescriptor) -> None:
        self._buffers.create(buffer, descriptor)
        self._destroyers[buffer] = self._buffers.destroy

    def create_texture(self, texture: Id, descriptor: descriptors.TextureDescriptor) -> None:
        self._textures.create(texture, descriptor)
        self._destroyers[texture] = self._textures.destroy

    def create_sampler(self, sampler: Id, descriptor: descriptors.SamplerDescriptor) -> None:
        self._samplers.create(sampler, descriptor)
        self._destroyers[sampler] = self._samplers.destroy

    def create_program(self, program: Id, descriptor: descriptors.ProgramDescriptor) -> None:
        self._programs[program] = GpuProgram(
            self._implementation, self.device, program, descriptor, has_pads=self._has_pads
        )
        self._destroyers[program] = self._destroy_program

    def _destroy_program(self, program: Id) -> None:
        gone = self._programs.pop(program)
        self._pipelines.forget(gone)
        if self._draws.program is gone:
            self._draws.program = None

    def create_vertex_array(self, vertex_array: Id, descriptor: descriptors.VertexArrayDescriptor) -> None:
        self._draws.create_array(vertex_array, descriptor)
        self._destroyers[vertex_array] = self._draws.destroy_array

    def create_query(self, query: Id, kind: descriptors.QueryKind) -> None:
        self._queries.create(query, kind)
        self._destroyers[query] = self._queries.destroy

    def destroy(self, resource: Id) -> None:
        self._bindings.forget(resource)
        self._destroyers.pop(resource)(resource)

    # -- passes, bindings and draws ----------------------------------------------------------------------

    def begin_pass(self, descriptor: descriptors.PassDescriptor) -> None:
        textures = self._textures
        colors = tuple(textures[color.texture].descriptor.format for color in descriptor.colors)
        depth = textures[descriptor.depth.texture].descriptor.format if descriptor.depth is not None else None
        if self._queries.is_full and self._queries.is_idle:
            self._stream.submit()
        self._draws.begin_pass((colors, depth, descriptor.samples))
        self._stream.begin_pass(descriptor)

    def bind_program(self, program: Id) -> None:
        self._draws.bind_program(self._programs[program])

    def prepare_uniform(self, buffer: Id) -> Callable[[int, int, int], object]:
        """See `rhi.contract.backend.SupportsPreparedDraws`."""
        return self._bindings.prepare_uniform(buffer)

    def prepare_uniform_write(self, buffer: Id) -> Callable[[int, int, bytes], object]:
        """See `rhi.contract.backend.SupportsOrderedWrites`."""
        return self._bindings.prepare_uniform_write(buffer)

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
        return self._draws.prepare(
            self._programs[program], vertex_array, primitive, first, count, base_vertex, base_instance
        )

    def prepare_recorded_draws(
        self, commands: Sequence[tuple[str, tuple[Any, ...]]]
    ) -> list[tuple[int, int, Callable[[], bool]]]:
        """See `rhi.contract.backend.SupportsRecordedDraws`."""
        return self._recorded.prepare(commands, self._programs, self)

    @property
    def is_building(self) -> bool:
        """See `rhi.contract.backend.SupportsPreparedKernels`: pipelines are made at once."""
        return False

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
        done: Future[None] = Future()
        if vertex_array and (colors or depth is not None):
            self._draws.prepare_pipeline(
                self._programs[program], vertex_array, (tuple(colors), depth, samples), states
            )
        done.set_result(None)
        return [done]

    # -- time --------------------------------------------------------------------------------------------

    def wait(self, value: int, seconds: float) -> bool:
        """Wait by polling: WebGPU has no wait with a timeout."""
        deadline, pause = monotonic() + seconds, _FIRST_PAUSE
        while self._fence.poll() < value:
            if monotonic() >= deadline:
                return False
            self._fence.pause(pause)
            pause = min(_LONGEST_PAUSE, pause * 1.5)
        return True

    def begin_conditional(self, query: Id, inverted: bool) -> None:
        raise NotImplementedError("begin_conditional")  # `capabilities.conditional_rendering` is False

    def end_conditional(self) -> None:
        raise NotImplementedError("end_conditional")

    def present(self, texture: Id) -> None:
        if texture and self.get_surface is not None:
            source = self._textures.view(texture, "2d", 0, 1, 0, 1)
            with translate_errors("device.present"):
                is_srgb = self._textures.objects[texture].descriptor.format.kind is ChannelKind.SRGB
                self._tools.blit(self._stream.outside(), source, self.get_surface(is_srgb))
        self._stream.submit()
