"""The GL backend: rhi's contract on one OpenGL context.

- moderngl creates the context, buffers, programs and vertex arrays. Its C functions also make the calls that happen
  thousands of times a frame: binding a range and drawing. All other calls go through `entry_points`.
- Conventions: each vertex stage ends by negating y, so texel rows, window y and gl_FragCoord.y count from the top.
  For GL the image is mirrored, so the two windings and the origin of point coordinates are swapped. Clip control
  could flip y too, but it would change Mesa's fill rule from top-left to bottom-left. It is used for depth 0…1 only.
- A context is current per thread, and a process may hold several. Each method therefore first checks whether its own
  context is current (5 ns). Only one thread at a time may use a backend.
- Memory order: a full memory barrier follows each dispatch, and each draw of a program that writes memory.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any, Final

import moderngl
import numpy as np
from numpy.typing import NDArray
from typing_extensions import Buffer as BytesLike

from rhi.backends.gl import enums
from rhi.backends.gl.buffers import Buffers
from rhi.backends.gl.capabilities import query_capabilities
from rhi.backends.gl.draws import MODES, DrawCalls, Draws
from rhi.backends.gl.entry_points import EntryPoints
from rhi.backends.gl.fence import Fence
from rhi.backends.gl.framebuffers import Framebuffers
from rhi.backends.gl.heap import keep_freed_memory
from rhi.backends.gl.programs import LinkedProgram, Programs, VertexArrays
from rhi.backends.gl.queries import Queries
from rhi.backends.gl.query_sets import GlQuerySet
from rhi.backends.gl.samplers import Samplers
from rhi.backends.gl.states import RenderStates
from rhi.backends.gl.textures import Textures
from rhi.contract.backend import Capabilities, PreparedQueries
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
    VertexArrayDescriptor,
)
from rhi.contract.formats import ChannelKind
from rhi.contract.states import AlphaFunction, AlphaReference, AlphaTest, StateChange

__rhi_internal__ = True

_QUADS: Final = Primitive.QUADS
_TESTS_ALPHA: Final = AlphaTest.ON
_MAX_LABELS: Final = 60  # open at a time; GL guarantees 64
_MAX_LABEL_BYTES: Final = 255

_current: GlBackend | None = None
"""The backend whose context is current."""


class GlBackend:
    """A backend on one GL context. `rhi.contract.backend.Backend` documents the methods.

    Attributes:
        context: moderngl's context, for features that only GL has. A caller that changes its state must restore it.
        gl: the entry points of GL.
    """

    def __init__(self, context: moderngl.Context) -> None:
        global _current
        if _current is not None:
            _current._interrupted()
        _current = self
        self.context = context
        gl = self.gl = EntryPoints(context.mglo._context.load)
        self._capabilities = query_capabilities(gl, context.version_code, context.extensions)
        if "llvmpipe" in self._capabilities.device:
            keep_freed_memory()
        gl.ClipControl(enums.LOWER_LEFT, enums.ZERO_TO_ONE)
        gl.PointParameteri(enums.POINT_SPRITE_COORD_ORIGIN, enums.LOWER_LEFT)  # the top, since y is flipped
        gl.ProvokingVertex(enums.FIRST_VERTEX_CONVENTION)
        gl.Disable(enums.PRIMITIVE_RESTART)  # moderngl enables it, and it restarts at 0xFFFFFFFF only
        gl.Enable(enums.PRIMITIVE_RESTART_FIXED_INDEX)
        gl.Enable(enums.PROGRAM_POINT_SIZE)
        gl.Enable(enums.FRAMEBUFFER_SRGB)
        gl.Disable(enums.DITHER)

        self._buffers = Buffers(context, gl)
        self._textures = Textures(gl)
        self._samplers = Samplers(gl)
        self._framebuffers = Framebuffers(gl, self._textures)
        self._arrays = VertexArrays(context, gl, self._buffers)
        self._programs = Programs(context, gl, self._arrays)
        self._queries = Queries(gl)
        self._fence = Fence(gl)
        self._draws = Draws(context, gl, self._arrays, self._buffers)
        self._destroyers: dict[Id, Callable[[Id], None]] = {}

        self._interrupted: Callable[[], None] = lambda: None
        self._program: Id = 0
        self._bound_program: LinkedProgram = None  # type: ignore[assignment]  # nothing draws before bind_program
        self._tests_alpha = False
        self._pass = PassDescriptor((0, 0))
        self._condition: tuple[Id, bool] | None = None
        self._labels = 0
        self._states = RenderStates(gl, self._capabilities.depth_bias_clamp, self._change_alpha_test)
        self._bind_uniform = self._buffers.bind_uniform
        self._bind_storage = self._buffers.bind_storage
        self._bind_texture, self._texture_names = gl.BindTextureUnit, self._textures.names
        self._bind_sampler, self._sampler_names = gl.BindSampler, self._samplers.names

    @property
    def capabilities(self) -> Capabilities:
        return self._capabilities

    def _activate(self) -> None:
        global _current
        if _current is not None:
            _current._interrupted()
        self.context.mglo.__enter__()
        _current = self

    def on_interruption(self, call: Callable[[], None]) -> None:
        self._interrupted = call

    def activate(self) -> None:
        """Make this backend's context current."""
        if _current is not self:
            self._activate()

    def close(self) -> None:
        global _current
        if _current is not self:
            self._activate()
        self._queries.stop()
        self.context.mglo.__exit__()  # a current context would survive its release
        self.context.release()  # releases all its objects too
        _current = None

    # -- resources ---------------------------------------------------------------------------------------

    def create_buffer(self, buffer: Id, descriptor: BufferDescriptor) -> None:
        if _current is not self:
            self._activate()
        self._buffers.create(buffer, descriptor)
        self._destroyers[buffer] = self._buffers.destroy

    def create_texture(self, texture: Id, descriptor: TextureDescriptor) -> None:
        if _current is not self:
            self._activate()
        self._textures.create(texture, descriptor)
        self._destroyers[texture] = self._destroy_texture

    def create_sampler(self, sampler: Id, descriptor: SamplerDescriptor) -> None:
        if _current is not self:
            self._activate()
        self._samplers.create(sampler, descriptor)
        self._destroyers[sampler] = self._samplers.destroy

    def create_program(self, program: Id, descriptor: ProgramDescriptor) -> None:
        if _current is not self:
            self._activate()
        self._programs.create(program, descriptor)
        self._destroyers[program] = self._destroy_program

    def create_vertex_array(self, vertex_array: Id, descriptor: VertexArrayDescriptor) -> None:
        if _current is not self:
            self._activate()
        self._arrays.descriptors[vertex_array] = descriptor
        self._programs[descriptor.program].prepare(vertex_array)
        self._destroyers[vertex_array] = self._destroy_vertex_array

    def create_query(self, query: Id, kind: QueryKind) -> None:
        if _current is not self:
            self._activate()
        self._queries.create(query, kind)
        self._destroyers[query] = self._queries.destroy

    def destroy(self, resource: Id) -> None:
        if _current is not self:
            self._activate()
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
        del self._arrays.descriptors[vertex_array]

    # -- memory ------------------------------------------------------------------------------------------

    def write_buffer(self, buffer: Id, offset: int, data: BytesLike) -> None:
        if _current is not self:
            self._activate()
        self._buffers.write(buffer, offset, data)

    def read_buffer(self, buffer: Id, offset: int, size: int) -> bytes:
        if _current is not self:
            self._activate()
        return self._buffers.read(buffer, offset, size)

    def copy_buffer(self, source: Id, source_offset: int, target: Id, target_offset: int, size: int) -> None:
        if _current is not self:
            self._activate()
        self._buffers.copy(source, source_offset, target, target_offset, size)

    def clear_buffer(self, buffer: Id, offset: int, size: int, value: int) -> None:
        if _current is not self:
            self._activate()
        self._buffers.clear(buffer, offset, size, value)

    def write_texture(self, texture: Id, level: int, region: Region, data: BytesLike) -> None:
        if _current is not self:
            self._activate()
        self._textures.write(texture, level, region, data)

    def read_texture(self, texture: Id, level: int, region: Region, stencil: bool) -> NDArray[np.generic]:
        if _current is not self:
            self._activate()
        return self._textures.read(texture, level, region, stencil)

    def copy_texture(
        self, source: Id, source_level: int, source_region: Region, target: Id, target_level: int, x: int, y: int,
        layer: int,
    ) -> None:  # fmt: skip
        if _current is not self:
            self._activate()
        self._textures.copy(source, source_level, source_region, target, target_level, x, y, layer)

    def resolve_texture(self, source: Id, target: Id) -> None:
        if _current is not self:
            self._activate()
        width, height = self._textures[source].descriptor.size
        with self._unmasked(False, False, False):
            self.gl.BlitNamedFramebuffer(
                self._framebuffers.find_color(source), self._framebuffers.find_color(target),
                0, 0, width, height, 0, 0, width, height, enums.COLOR_BUFFER_BIT, enums.NEAREST,
            )  # fmt: skip

    def generate_mipmaps(self, texture: Id) -> None:
        if _current is not self:
            self._activate()
        with self._unmasked(False, False, False):
            self.gl.GenerateTextureMipmap(self._textures[texture].name)

    # -- passes, state, binding --------------------------------------------------------------------------

    def begin_pass(self, descriptor: PassDescriptor) -> None:
        if _current is not self:
            self._activate()
        self.gl.BindFramebuffer(enums.FRAMEBUFFER, self._framebuffers.find(descriptor))
        self._pass = descriptor
        self._states.set_target_size(descriptor.size)
        self._clear(descriptor)

    def end_pass(self) -> None:
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
        """Let clears and blits of these buffers ignore scissor, write masks and conditional rendering."""
        condition = self._condition
        if condition is not None:
            self.end_conditional()
        try:
            self._states.open_masks(color, depth, stencil)
            yield
            self._states.close_masks(color, depth, stencil)
        except BaseException:  # an interrupt may have cut off any of them
            self._states.apply_all()
            raise
        finally:
            if condition is not None:
                self.begin_conditional(*condition)

    def set_states(self, changes: Sequence[StateChange]) -> None:
        if _current is not self:
            self._activate()
        self._states.set(changes)

    def bind_program(self, program: Id) -> None:
        if _current is not self:
            self._activate()
        self._program = program
        if self._tests_alpha:
            self._change_alpha_test()
        else:
            self._bound_program = self._programs[program]

    def _change_alpha_test(self) -> None:
        values = self._states.values
        self._tests_alpha = values[AlphaTest] is _TESTS_ALPHA
        if not self._program:
            return
        if self._tests_alpha:
            function, reference = values[AlphaFunction], values[AlphaReference].value
            self._bound_program = self._programs.find_alpha_tested(self._program, function, reference)
        else:
            self._bound_program = self._programs[self._program]

    def bind_uniform(self, slot: int, buffer: Id, offset: int, size: int) -> None:
        if _current is not self:
            self._activate()
        self._bind_uniform[buffer](slot, offset, size)

    def bind_storage(self, slot: int, buffer: Id, offset: int, size: int) -> None:
        if _current is not self:
            self._activate()
        self._bind_storage[buffer](slot, offset, size)

    def bind_texture(self, slot: int, texture: Id, sampler: Id) -> None:
        if _current is not self:
            self._activate()
        self._bind_texture(slot, self._texture_names[texture])
        self._bind_sampler(slot, self._sampler_names[sampler])

    def bind_image(self, slot: int, texture: Id, level: int, layer: int) -> None:
        if _current is not self:
            self._activate()
        image = self._textures[texture]
        self.gl.BindImageTexture(
            slot, image.name, level, layer < 0, max(layer, 0), enums.READ_WRITE, image.pixel.internal
        )

    # -- work --------------------------------------------------------------------------------------------

    def draw(
        self, vertex_array: Id, primitive: Primitive, first: int, count: int, instances: int, base_vertex: int,
        base_instance: int,
    ) -> None:  # fmt: skip
        if _current is not self:
            self._activate()
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
        self, program: Id, vertex_array: Id, primitive: Primitive, first: int, count: int, base_vertex: int,
        base_instance: int,
    ) -> Callable[[int], object]:  # fmt: skip
        if _current is not self:
            self._activate()
        if base_vertex or base_instance or primitive is _QUADS:
            return lambda instances: self.draw(
                vertex_array, primitive, first, count, instances, base_vertex, base_instance
            )
        return partial(self._programs[program][vertex_array], MODES[primitive], count, first)

    def prepare_queries(self, queries: Sequence[Id]) -> PreparedQueries:
        """See `rhi.contract.backend.PreparesQueries`."""
        return GlQuerySet(self, self.gl, self._queries, queries)

    def prepare_calls(self, vertex_array: Id, primitive: Primitive, draws: NDArray[Any]) -> DrawCalls:
        """Return `Draws.prepare_calls` for the bound program."""
        if _current is not self:
            self._activate()
        return self._draws.prepare_calls(self._bound_program, vertex_array, primitive, draws)

    def draw_indirect(
        self, vertex_array: Id, primitive: Primitive, buffer: Id, offset: int, draws: int, stride: int,
        count_buffer: Id, count_offset: int,
    ) -> None:  # fmt: skip
        if _current is not self:
            self._activate()
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
        if _current is not self:
            self._activate()
        if self._condition is None:
            self._bound_program.dispatch(x, y, z)
        else:  # conditions apply to draws only, but OpenGL would drop the dispatch, too
            with self._unmasked(False, False, False):
                self._bound_program.dispatch(x, y, z)

    def dispatch_indirect(self, buffer: Id, offset: int) -> None:
        if _current is not self:
            self._activate()
        if self._condition is None:
            self._bound_program.dispatch_indirect(self._buffers.objects[buffer], offset)
        else:
            with self._unmasked(False, False, False):
                self._bound_program.dispatch_indirect(self._buffers.objects[buffer], offset)

    # -- time --------------------------------------------------------------------------------------------

    def signal(self, value: int) -> None:
        if _current is not self:
            self._activate()
        self._fence.signal(value)

    def completed(self) -> int:
        if _current is not self:
            self._activate()
        return self._fence.poll()

    def wait(self, value: int, seconds: float) -> bool:
        if _current is not self:
            self._activate()
        return self._fence.wait(value, seconds)

    def begin_query(self, query: Id) -> None:
        if _current is not self:
            self._activate()
        self._queries.begin(query)

    def end_query(self, query: Id) -> None:
        if _current is not self:
            self._activate()
        self._queries.end(query)

    def write_query(self, query: Id) -> None:
        if _current is not self:
            self._activate()
        self._queries.write(query)

    def read_query(self, query: Id) -> int | None:
        if _current is not self:
            self._activate()
        return self._queries.read(query)

    def begin_conditional(self, query: Id, inverted: bool) -> None:
        if _current is not self:
            self._activate()
        self._condition = query, inverted
        self._queries.begin_conditional(query, inverted)

    def end_conditional(self) -> None:
        if _current is not self:
            self._activate()
        self._condition = None
        self._queries.end_conditional()

    def push_label(self, text: str) -> None:
        if _current is not self:
            self._activate()
        self._labels += 1
        if self._labels <= _MAX_LABELS:
            label = text.encode()[:_MAX_LABEL_BYTES]
            self.gl.PushDebugGroup(enums.DEBUG_SOURCE_APPLICATION, 0, -1, label)

    def pop_label(self) -> None:
        if _current is not self:
            self._activate()
        if self._labels <= _MAX_LABELS:
            self.gl.PopDebugGroup()
        self._labels -= 1

    def present(self, texture: Id) -> None:
        if _current is not self:
            self._activate()
        self.gl.Flush()
