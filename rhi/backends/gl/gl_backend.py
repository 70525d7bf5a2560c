"""The GL backend: rhi's contract on one OpenGL context.

- moderngl creates the context, buffers, programs and vertex arrays. Its C functions also make the calls that
  happen thousands of times a frame: binding a range and drawing. All other calls go through `entry_points`.
- Conventions: each vertex stage ends by negating y, so texel rows, window y and gl_FragCoord.y count from the
  top. For GL the image is mirrored, so the two windings and the origin of point coordinates are swapped. Clip
  control could flip y too, but it would change Mesa's fill rule from top-left to bottom-left. It is used for
  depth 0…1 only.
- A context is current per thread, and a process may hold several. Each method therefore first checks whether
  another backend of this process has taken the thread (5 ns). Code outside of this package does so unnoticed:
  `resume` asks the driver, at points where the device has time for that. A backend is used on one thread at a
  time.
- Memory order: a full memory barrier follows each dispatch, and each draw of a program that writes memory.
  llvmpipe's draws are waited for before anything but a fragment reads their targets (`llvmpipe`).
"""

from __future__ import annotations

import ctypes
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from threading import get_ident
from typing import Any, Final
from weakref import finalize

import moderngl
import numpy as np
from numpy.typing import NDArray
from typing_extensions import Buffer as BytesLike

from rhi.backends.gl import enums
from rhi.backends.gl.entry_points import EntryPoints
from rhi.backends.gl.framebuffers import Framebuffers
from rhi.backends.gl.gl_buffers import Buffers
from rhi.backends.gl.gl_capabilities import query_capabilities
from rhi.backends.gl.gl_context import CURRENT_CONTEXT, make_current_context_query
from rhi.backends.gl.gl_draws import MODES, DrawCalls, Draws
from rhi.backends.gl.gl_errors import drain_errors
from rhi.backends.gl.gl_fence import Fence
from rhi.backends.gl.gl_host import HostFramebuffer, SharedContext
from rhi.backends.gl.gl_programs import LinkedProgram, Programs, VertexArrays
from rhi.backends.gl.gl_queries import Queries
from rhi.backends.gl.gl_query_sets import GlQuerySet
from rhi.backends.gl.gl_samplers import Samplers
from rhi.backends.gl.gl_states import RenderStates
from rhi.backends.gl.gl_textures import Textures
from rhi.backends.gl.llvmpipe import UnfinishedDraws, keep_freed_memory
from rhi.backends.gl.mip_levels import MipLevels
from rhi.commands.recorder import CommandMethods
from rhi.contract.backend import PreparedQueries
from rhi.contract.descriptors import (
    Attachment,
    BufferDescriptor,
    Id,
    PassDescriptor,
    Primitive,
    ProgramDescriptor,
    QueryKind,
    Region,
    SamplerDescriptor,
    TextureDescriptor,
    TextureKind,
    VertexArrayDescriptor,
)
from rhi.contract.driver_faults import is_indirect_unbounded
from rhi.contract.formats import ChannelKind
from rhi.contract.states import AlphaFunction, AlphaReference, AlphaTest, StateChange
from rhi.errors import DeviceError, refuse
from rhi.errors.rules import DEVICE_CONTEXT, TEXTURE_FORMAT

_NO_LAYERS: Final = -1
_QUADS: Final = Primitive.QUADS
_TESTS_ALPHA: Final = AlphaTest.ON
_MAX_LABELS: Final = 60  # open at a time; GL guarantees 64
_MAX_LABEL_BYTES: Final = 255
_UNUSED_FEATURES: Final = (
    enums.RASTERIZER_DISCARD,
    enums.COLOR_LOGIC_OP,
    enums.LINE_SMOOTH,
    enums.POLYGON_SMOOTH,
    enums.POLYGON_OFFSET_LINE,
    enums.POLYGON_OFFSET_POINT,
    enums.SAMPLE_ALPHA_TO_ONE,
    enums.SAMPLE_COVERAGE,
    enums.SAMPLE_MASK,
    enums.SAMPLE_SHADING,
    *range(enums.CLIP_DISTANCE0, enums.CLIP_DISTANCE0 + 8),
)
"""Features that this backend never enables, but other code might."""

_current_backends: dict[int, GlBackend] = {}
"""By thread, the backend that made its context current there last."""
_dropped: Final[deque[tuple[moderngl.Context, Callable[[], int | None], int | None]]] = deque()
"""Contexts of devices that were collected without being closed, each with the function that returns the
current context, and its result for this one. They are released later, since a finalizer may run on any
thread."""


def release_dropped() -> None:
    """Release the contexts of devices that were dropped unclosed."""
    while True:
        try:
            context, get_current, handle = _dropped.popleft()
        except IndexError:  # another thread may have released the last
            return
        if get_current() == handle:
            context.mglo.__exit__()  # a current context would survive its release
        context.release()


class GlBackend:
    """A backend on one GL context. `rhi.contract.backend.Backend` documents the methods.

    Attributes:
        context: moderngl's context, for features that only GL has. A caller that changes its state must
            restore it.
        gl: the entry points of GL.
    """

    def __init__(self, context: moderngl.Context, shared: SharedContext | None = None) -> None:
        """`shared`: the same context, if it shares objects with a context of other code."""
        function = CURRENT_CONTEXT if shared is None else shared.api.current_context_function
        self._get_current = make_current_context_query(context, function)
        self._handle = self._get_current()
        self._is_current = True
        self._interrupted: Callable[[], None] = lambda: None
        self.context = context
        self._take_thread()
        context.mglo.__enter__()
        gl = self.gl = EntryPoints(context.mglo._context.load)
        capabilities = query_capabilities(gl, context.version_code, context.extensions)
        self.capabilities = replace(capabilities, shares_textures=shared is not None)
        is_llvmpipe = "llvmpipe" in self.capabilities.device
        if is_llvmpipe:
            keep_freed_memory()
        self._unfinished = UnfinishedDraws(gl, keeps_order=not is_llvmpipe)
        self._set_conventions()

        self._buffers = Buffers(context, gl, keeps_order=not is_llvmpipe)
        self._textures = Textures(gl)
        self._samplers = Samplers(gl)
        self._framebuffers = Framebuffers(gl, self._textures)
        self._mip_levels = MipLevels(context, gl)
        self._arrays = VertexArrays(context, gl, self._buffers, self.check_context)
        self._programs = Programs(context, gl, self._arrays, self._unfinished.finish if is_llvmpipe else None)
        self._queries = Queries(gl)
        self._fence = Fence(gl)
        self._draws = Draws(
            context, gl, self._arrays, self._buffers, is_indirect_unbounded(self.capabilities.device)
        )
        self._destroyers: dict[Id, Callable[[Id], None]] = {}
        self._shared = shared
        self._host_framebuffer = HostFramebuffer(gl)
        self._presented: Id = 0

        self._program: Id = 0
        self._bound_program: LinkedProgram = None  # type: ignore[assignment]  # nothing draws before bind_program
        self._tests_alpha = False
        self._pass = PassDescriptor((0, 0))
        self._targets = 0  # the color targets of the open pass, as bits
        self._framebuffer = 0
        self._layer_count = 0  # of the open pass
        self._condition: tuple[Id, bool] | None = None
        self._labels = 0
        self._states = RenderStates(gl, self.capabilities.depth_bias_clamp, self._change_alpha_test)
        self._bind_uniform = self._buffers.bind_uniform
        self._bind_storage = self._buffers.bind_storage
        self._bind_texture, self._texture_names = gl.BindTextureUnit, self._textures.names
        self._bind_sampler, self._sampler_names = gl.BindSampler, self._samplers.names
        self._drop = (
            finalize(self, _dropped.append, (context, self._get_current, self._handle))
            if shared is None
            else None
        )
        if self._drop is not None:
            self._drop.atexit = False

    def on_interruption(self, call: Callable[[], None]) -> None:
        self._interrupted = call

    def close(self) -> None:
        self._activate()
        self._queries.stop()
        if self._shared is not None:  # shared objects outlive this context
            for resource in list(self._destroyers):
                self.destroy(resource)
            self._draws.release()
            self._mip_levels.release()
            self._fence.release()
        self.release_current()  # a current context would survive its release
        if self._shared is not None and self._get_current() == self._shared.host.context:
            self._host_framebuffer.destroy()
        self.context.release()  # releases all its objects too
        if self._drop is not None:
            self._drop.detach()

    # -- the context on its thread -------------------------------------------------------------------------

    def activate(self) -> None:
        """Make this backend's context current if another backend's context is."""
        if not self._is_current:
            self._activate()

    def _activate(self) -> None:
        self._take_thread()
        self.context.mglo.__enter__()  # ignores errors
        if self._get_current() != self._handle:
            raise DeviceError(
                DEVICE_CONTEXT,
                "device.make_current",
                "a context that the driver refuses to make current here",
                "a thread without a GLX context, while the device's context is current on no other thread",
                "let toolkits create windows with EGL, or release their context; call release_current() on the "
                "other thread",
            )
        self._is_current = True
        self._queries.resume()
        kind: type = type(self)
        if kind is _DormantGlBackend:
            self.__class__ = GlBackend

    def _leave_thread(self) -> None:
        """Mark the context as not current, so that the next command activates it first."""
        self._is_current = False
        if type(self) is GlBackend:
            self.__class__ = _DormantGlBackend

    def _take_thread(self) -> None:
        """Note for the backend whose context was current on this thread that it no longer is."""
        thread = get_ident()
        holder = _current_backends.get(thread)
        if holder is not None and holder is not self:
            holder._suspend_queries()
            holder._leave_thread()
            holder._interrupted()
        _current_backends[thread] = self

    def _suspend_queries(self) -> None:
        """Suspend the active queries, so that they don't count another device's draws. Makes this context
        current."""
        if self._queries.is_active:
            if self._get_current() != self._handle:
                self.context.mglo.__enter__()
            if self._get_current() == self._handle:  # it isn't if it is current on another thread
                self._queries.suspend()

    def resume(self) -> bool:
        """See `rhi.contract.backend.SupportsCurrentContext`."""
        if not self._is_current:
            self._activate()  # another backend had the thread, which every method checks: nothing is lost
        elif self._get_current() != self._handle:
            self.make_current()
            return True
        return False

    def check_context(self) -> None:
        """Check that this context is current before a draw creates an object on first use.

        Raises:
            DeviceError: `device-context`; the own context is current now.
        """
        if self.resume():
            given = "another context, made current by other code since the device's last check"
            raise DeviceError(DEVICE_CONTEXT, "draw", given)

    def make_current(self) -> None:
        """See `rhi.contract.backend.SupportsCurrentContext`."""
        self._leave_thread()
        self._activate()
        self._restore_state()

    def release_current(self) -> None:
        """See `rhi.contract.backend.SupportsCurrentContext`."""
        if self._get_current() == self._handle:
            self.context.mglo.__exit__()
        if _current_backends.get(get_ident()) is self:
            del _current_backends[get_ident()]
        self._leave_thread()

    def hand_back(self) -> None:
        """See `rhi.contract.backend.SupportsCurrentContext`."""
        if self._shared is None:
            return
        if not self._is_current:
            self._activate()
        presented, self._presented = self._presented, 0
        if not self._shared.restores_host:
            return
        gl, image = self.gl, self._textures[presented] if presented else None
        drawn = gl.FenceSync(enums.SYNC_GPU_COMMANDS_COMPLETE, 0)
        gl.Flush()
        self.release_current()
        if self._get_current() == self._shared.host.context:  # else its window is closed
            gl.WaitSync(drawn, 0, enums.TIMEOUT_IGNORED)
            binding = self._shared.api, self._shared.host
            if image is not None:
                self._host_framebuffer.show(image.name, image.descriptor.size, *binding)
            else:
                self._host_framebuffer.note_idle(*binding)
            gl.DeleteSync(drawn)

    # -- buffers of CUDA -----------------------------------------------------------------------------------

    def name_buffer(self, buffer: Id) -> int:
        """See `rhi.contract.backend.SupportsBufferNames`."""
        if not self._is_current:
            self._activate()
        return self._buffers.share(buffer)

    # -- textures of other code ----------------------------------------------------------------------------

    def name_texture(self, texture: Id) -> int:
        """See `rhi.contract.backend.SupportsTextureSharing`."""
        return self._textures.names[texture]

    def describe_texture(self, name: int) -> TextureDescriptor | str:
        """See `rhi.contract.backend.SupportsTextureSharing`."""
        if not self._is_current:
            self._activate()
        return self._textures.describe(name)

    @contextmanager
    def adopting_texture(self, name: int) -> Iterator[None]:
        """See `rhi.contract.backend.SupportsTextureSharing`."""
        self._textures.adopting = name
        try:
            yield
        finally:
            self._textures.adopting = 0

    def _set_conventions(self) -> None:
        """Set the state that stays the same for the life of the context."""
        gl = self.gl
        gl.ClipControl(enums.LOWER_LEFT, enums.ZERO_TO_ONE)
        gl.PointParameteri(enums.POINT_SPRITE_COORD_ORIGIN, enums.LOWER_LEFT)  # the top, since y is flipped
        gl.ProvokingVertex(enums.FIRST_VERTEX_CONVENTION)
        gl.Disable(enums.PRIMITIVE_RESTART)  # moderngl enables it, and it restarts at 0xFFFFFFFF only
        gl.Enable(enums.PRIMITIVE_RESTART_FIXED_INDEX)
        gl.Enable(enums.PROGRAM_POINT_SIZE)
        gl.Enable(enums.FRAMEBUFFER_SRGB)
        gl.Disable(enums.DITHER)

    def _restore_state(self) -> None:
        """Set all state of the context again, except for bindings.

        Other code may have changed any of it, and some calls may have gone to another context."""
        gl = self.gl
        for feature in _UNUSED_FEATURES:
            gl.Disable(feature)
        self._set_conventions()
        self._textures.set_transfers()
        self._states.apply_all()
        gl.BindFramebuffer(enums.FRAMEBUFFER, self._framebuffer)
        self._queries.restore(self._condition)
        self._restore_labels()
        drain_errors(gl)

    def _restore_labels(self) -> None:
        gl, expected = self.gl, min(self._labels, _MAX_LABELS)
        depth = gl.get_integer(enums.DEBUG_GROUP_STACK_DEPTH) - 1
        for _ in range(expected, depth):
            gl.PopDebugGroup()
        for _ in range(depth, expected):
            gl.PushDebugGroup(enums.DEBUG_SOURCE_APPLICATION, 0, -1, b"restored")

    # -- resources ---------------------------------------------------------------------------------------

    def create_buffer(self, buffer: Id, descriptor: BufferDescriptor) -> None:
        self._buffers.create(buffer, descriptor)
        self._destroyers[buffer] = self._buffers.destroy

    def create_filled_buffer(self, buffer: Id, descriptor: BufferDescriptor, data: BytesLike) -> None:
        """See `rhi.contract.backend.SupportsFilledBuffers`."""
        self._buffers.create(buffer, descriptor, data)
        self._destroyers[buffer] = self._buffers.destroy

    def create_texture(self, texture: Id, descriptor: TextureDescriptor) -> None:
        self._textures.create(texture, descriptor)
        self._destroyers[texture] = self._destroy_texture

    def create_sampler(self, sampler: Id, descriptor: SamplerDescriptor) -> None:
        self._samplers.create(sampler, descriptor)
        self._destroyers[sampler] = self._samplers.destroy

    def create_program(self, program: Id, descriptor: ProgramDescriptor) -> None:
        self._programs.create(program, descriptor)
        self._destroyers[program] = self._destroy_program

    def create_vertex_array(self, vertex_array: Id, descriptor: VertexArrayDescriptor) -> None:
        self._arrays.descriptors[vertex_array] = descriptor
        self._programs[descriptor.program].prepare(vertex_array)
        self._destroyers[vertex_array] = self._destroy_vertex_array

    def create_query(self, query: Id, kind: QueryKind) -> None:
        self._queries.create(query, kind)
        self._destroyers[query] = self._queries.destroy

    def destroy(self, resource: Id) -> None:
        self._destroyers.pop(resource)(resource)

    def _destroy_texture(self, texture: Id) -> None:
        self._framebuffers.forget(texture)
        self._textures.destroy(texture)

    def _destroy_program(self, program: Id) -> None:
        if program == self._program:
            self._program = 0
        self._programs.destroy(program)

    def _destroy_vertex_array(self, vertex_array: Id) -> None:
        self._programs.forget_vertex_array(vertex_array)
        self._arrays.destroy(vertex_array)

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
        self._unfinished.finish()
        return self._textures.read(texture, level, region, stencil)

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
        self._unfinished.finish()
        self._textures.copy(source, source_level, source_region, target, target_level, x, y, layer)

    def copy_texture_to_buffer(
        self, source: Id, level: int, region: Region, target: Id, offset: int, row_bytes: int
    ) -> None:
        self._buffers.note_change(target)
        buffer = self._buffers.objects[target].glo
        self._unfinished.finish()
        self._textures.copy_to_buffer(source, level, region, buffer, offset, row_bytes)

    def copy_buffer_to_texture(
        self, source: Id, offset: int, row_bytes: int, target: Id, level: int, region: Region
    ) -> None:
        buffer = self._buffers.objects[source].glo
        self._textures.copy_from_buffer(buffer, offset, row_bytes, target, level, region)

    def resolve_texture(self, source: Id, target: Id) -> None:
        width, height = self._textures[source].descriptor.size
        with self._unmasked(False, False, False):
            self.gl.BlitNamedFramebuffer(
                self._framebuffers.get_for_color(source),
                self._framebuffers.get_for_color(target),
                0,
                0,
                width,
                height,
                0,
                0,
                width,
                height,
                enums.COLOR_BUFFER_BIT,
                enums.NEAREST,
            )
        self._unfinished.add()

    def generate_mipmaps(self, texture: Id) -> None:
        self._unfinished.finish()
        with self._unmasked(False, False, False):
            self._mip_levels.generate(self._textures[texture])

    # -- passes, state, binding --------------------------------------------------------------------------

    def begin_pass(self, descriptor: PassDescriptor) -> None:
        self._framebuffer = self._framebuffers.get_or_create(descriptor)
        self.gl.BindFramebuffer(enums.FRAMEBUFFER, self._framebuffer)
        self._pass = descriptor
        self._targets = (1 << len(descriptor.colors)) - 1
        self._states.set_target_size(descriptor.size)
        self._layer_count = self._count_layers(descriptor)
        if self._program and self._bound_program.has_layer:
            self._bound_program.set_layer_count(self._layer_count)
        self._clear(descriptor)

    def _count_layers(self, descriptor: PassDescriptor) -> int:
        """Return the number of layers that a pass draws to; −1 if that is one, whatever vertices choose."""
        if not descriptor.is_layered:
            return _NO_LAYERS
        target = descriptor.colors[0] if descriptor.colors else descriptor.depth
        assert target is not None
        return self._textures[target.texture].descriptor.level_layers(target.level)

    def end_pass(self) -> None:
        self._framebuffer = self._targets = 0  # a framebuffer lives no longer than its textures
        self._unfinished.add()
        for color in self._pass.colors:
            if color.resolve:
                self.resolve_texture(color.texture, color.resolve)

    def _clear(self, descriptor: PassDescriptor) -> None:
        colors = [(i, color) for i, color in enumerate(descriptor.colors) if color.clear is not None]
        depth = descriptor.depth.clear if descriptor.depth is not None else None
        stencil = descriptor.depth.clear_stencil if descriptor.depth is not None else None
        if not colors and depth is None and stencil is None:
            return
        gl = self.gl
        with self._unmasked(bool(colors), depth is not None, stencil is not None):
            for index, color in colors:
                self._clear_color(index, color)
            if depth is not None and stencil is not None:
                gl.ClearBufferfi(enums.DEPTH_STENCIL, 0, depth, stencil)
            elif depth is not None:
                gl.ClearBufferfv(enums.DEPTH, 0, ctypes.byref(ctypes.c_float(depth)))
            elif stencil is not None:
                gl.ClearBufferiv(enums.STENCIL, 0, ctypes.byref(ctypes.c_int(stencil)))

    def _clear_color(self, index: int, attachment: Attachment) -> None:
        kind = self._textures[attachment.texture].descriptor.format.kind
        values = attachment.clear or ()
        if kind is ChannelKind.UINT:
            self.gl.ClearBufferuiv(enums.COLOR, index, (ctypes.c_uint * 4)(*map(int, values)))
        elif kind is ChannelKind.INT:
            self.gl.ClearBufferiv(enums.COLOR, index, (ctypes.c_int * 4)(*map(int, values)))
        else:
            self.gl.ClearBufferfv(enums.COLOR, index, (ctypes.c_float * 4)(*values))

    @contextmanager
    def _unmasked(self, color: bool, depth: bool, stencil: bool) -> Iterator[None]:
        """Disable scissor, write masks and conditional rendering for clears and blits of these buffers."""
        condition = self._condition
        if condition is not None:
            self.end_conditional()
        try:
            self._states.open_masks(color, depth, stencil)
            yield
            self._states.close_masks(color, depth, stencil)
        except BaseException:  # an interrupt may have come after any of these calls
            self._states.apply_all()
            raise
        finally:
            if condition is not None:
                self.begin_conditional(*condition)

    def set_states(self, changes: Sequence[StateChange]) -> None:
        self._states.set(changes)

    def bind_program(self, program: Id) -> None:
        self._program = program
        if self._tests_alpha:
            self._change_alpha_test()
        else:
            self._bound_program = self._programs[program]
        if self._bound_program.has_layer:
            self._bound_program.set_layer_count(self._layer_count)
        unwritten = self._targets & ~self._bound_program.outputs
        if unwritten != self._states.unwritten:
            self._states.leave_unwritten(unwritten)

    def _change_alpha_test(self) -> None:
        values = self._states.values
        self._tests_alpha = values[AlphaTest] is _TESTS_ALPHA
        if not self._program:
            return
        if self._tests_alpha:
            function, reference = values[AlphaFunction], values[AlphaReference].value
            self._bound_program = self._programs.get_alpha_tested(self._program, function, reference)
        else:
            self._bound_program = self._programs[self._program]
        if self._bound_program.has_layer:
            self._bound_program.set_layer_count(self._layer_count)

    def bind_uniform(self, slot: int, buffer: Id, offset: int, size: int) -> None:
        self._bind_uniform[buffer](slot, offset, size)

    def bind_storage(self, slot: int, buffer: Id, offset: int, size: int) -> None:
        self._bind_storage[buffer](slot, offset, size)

    def bind_texture(self, slot: int, texture: Id, sampler: Id) -> None:
        self._bind_texture(slot, self._texture_names[texture])
        self._bind_sampler(slot, self._sampler_names[sampler])

    def bind_image(self, slot: int, texture: Id, level: int, layer: int) -> None:
        image = self._textures[texture]
        self.gl.BindImageTexture(
            slot, image.name, level, layer < 0, max(layer, 0), enums.READ_WRITE, image.pixel.internal
        )

    # -- work --------------------------------------------------------------------------------------------

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
        if base_vertex or base_instance or primitive is _QUADS:
            self._draws.draw(
                self._bound_program,
                vertex_array,
                primitive,
                first,
                count,
                instances,
                base_vertex,
                base_instance,
            )
        else:
            self._bound_program[vertex_array](MODES[primitive], count, first, instances)

    def prepare_uniform(self, buffer: Id) -> Callable[[int, int, int], object]:
        return self._bind_uniform[buffer]

    def prepare_draw(
        self,
        program: Id,
        vertex_array: Id,
        primitive: Primitive,
        first: int,
        count: int,
        base_vertex: int,
        base_instance: int,
    ) -> Callable[[int], object]:
        if not self._is_current:
            self._activate()
        if base_vertex or base_instance or primitive is _QUADS:
            return lambda instances: self.draw(
                vertex_array, primitive, first, count, instances, base_vertex, base_instance
            )
        return partial(self._programs[program][vertex_array], MODES[primitive], count, first)

    def prepare_queries(self, queries: Sequence[Id]) -> PreparedQueries:
        """See `rhi.contract.backend.SupportsPreparedQueries`."""
        return GlQuerySet(self, self.gl, self._queries, queries)

    def prepare_calls(self, vertex_array: Id, primitive: Primitive, draws: NDArray[Any]) -> DrawCalls:
        """Return `Draws.prepare_calls` for the bound program."""
        if not self._is_current:
            self._activate()
        return self._draws.prepare_calls(self._bound_program, vertex_array, primitive, draws)

    def draw_clipped(
        self, vertex_array: Id, primitive: Primitive, draws: NDArray[Any], clips: NDArray[np.int64]
    ) -> None:
        """See `rhi.contract.backend.SupportsClippedDraws`."""
        call, arguments = self.prepare_calls(vertex_array, primitive, draws)
        self._states.call_in_scissors(call, arguments, clips)

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
        self._draws.draw_indirect(
            self._bound_program,
            vertex_array,
            primitive,
            buffer,
            offset,
            draws,
            stride,
            count_buffer,
            count_offset,
        )

    def dispatch(self, x: int, y: int, z: int) -> None:
        self._unfinished.finish()
        if self._condition is None:
            self._bound_program.dispatch(x, y, z)
        else:  # conditions apply to draws only, but OpenGL would drop the dispatch, too
            with self._unmasked(False, False, False):
                self._bound_program.dispatch(x, y, z)

    def dispatch_indirect(self, buffer: Id, offset: int) -> None:
        self._unfinished.finish()
        if self._condition is None:
            self._bound_program.dispatch_indirect(self._buffers.objects[buffer], offset)
        else:
            with self._unmasked(False, False, False):
                self._bound_program.dispatch_indirect(self._buffers.objects[buffer], offset)

    # -- time --------------------------------------------------------------------------------------------

    def signal(self, value: int) -> None:
        self._fence.signal(value)

    def completed(self) -> int:
        return self._fence.poll()

    def wait(self, value: int, seconds: float) -> bool:
        return self._fence.wait(value, seconds)

    def begin_query(self, query: Id) -> None:
        self._queries.begin(query)

    def end_query(self, query: Id) -> None:
        self._queries.end(query)

    def write_query(self, query: Id) -> None:
        self._queries.write(query)

    def read_query(self, query: Id) -> int | None:
        return self._queries.read(query)

    def read_issue_time(self, query: Id) -> int | None:
        """See `rhi.contract.backend.SupportsIssueTimes`."""
        return None if self.read_query(query) is None else self._queries[query].issued

    def begin_conditional(self, query: Id, inverted: bool) -> None:
        self._condition = query, inverted
        self._queries.begin_conditional(query, inverted)

    def end_conditional(self) -> None:
        self._condition = None
        self._queries.end_conditional()

    def push_label(self, text: str) -> None:
        self._labels += 1
        if self._labels <= _MAX_LABELS:
            label = text.encode()[:_MAX_LABEL_BYTES]
            self.gl.PushDebugGroup(enums.DEBUG_SOURCE_APPLICATION, 0, -1, label)

    def pop_label(self) -> None:
        if self._labels <= _MAX_LABELS:
            self.gl.PopDebugGroup()
        self._labels -= 1

    def present(self, texture: Id) -> None:
        if self._shared is not None and texture:
            descriptor = self._textures[texture].descriptor
            texel = descriptor.format
            if (
                descriptor.kind is not TextureKind.D2
                or descriptor.samples > 1
                or texel.is_depth
                or texel.is_integer
            ):
                refuse(
                    TEXTURE_FORMAT, "device.present", repr(descriptor), "a 2D image of colors with one sample"
                )
        self.gl.Flush()
        self._presented = texture


class _DormantGlBackend(GlBackend, CommandMethods):
    """A `GlBackend` whose context isn't current, since another backend of this process took its thread.

    A command first makes the context current, and the object an ordinary `GlBackend` again. So the methods of
    `GlBackend` needn't check this.
    """

    METHOD = """\
    self._activate()
    return self.{method}({arguments})
"""

    def completed(self) -> int:
        self._activate()
        return self.completed()

    def read_query(self, query: Id) -> int | None:
        self._activate()
        return self.read_query(query)
