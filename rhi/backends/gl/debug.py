"""Validation mode: the driver's own messages as exceptions.

- GL reports errors through a callback, and an exception can't leave a callback. So the callback collects the
  messages, and each method of the backend raises them at its end. Debug output is synchronous, so the error
  names the call that caused it.
- Some drivers report nothing without a debug context, which moderngl can't request (Mesa doesn't need one). A
  deliberate error at the start shows whether the driver is one of these; `glGetError` then follows each
  method.
"""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Callable, Sequence
from typing import Any, Final

import moderngl
import numpy as np
from numpy.typing import NDArray
from typing_extensions import Buffer as BytesLike

from rhi.backends.gl import enums
from rhi.backends.gl.entry_points import DEBUG_CALLBACK, EntryPoints
from rhi.backends.gl.gl_backend import GlBackend
from rhi.backends.gl.gl_errors import NAMES, drain_errors
from rhi.backends.gl.gl_host import SharedContext
from rhi.backends.gl.loop_checks import LoopChecks
from rhi.contract.backend import Backend, PreparedQueries
from rhi.contract.descriptors import BufferDescriptor, Id, Primitive
from rhi.errors import DeviceError
from rhi.errors.rules import DEVICE_DEBUG

_WAITING: Final = frozenset({"read_buffer", "read_texture", "wait"})  # these have waited for the GPU anyway
_EXECUTING: Final = ("draw", "dispatch")  # how the names of calls begin that execute a program's loops
_FATAL: Final = (enums.DEBUG_TYPE_ERROR, enums.DEBUG_TYPE_UNDEFINED_BEHAVIOR)


class DebugOutput:
    """A collector of the errors that a context reports.

    Attributes:
        is_silent: whether the driver reports nothing, so that `glGetError` must be called.
    """

    def __init__(self, gl: EntryPoints) -> None:
        self._gl = gl
        self._messages: list[str] = []
        self._callback = DEBUG_CALLBACK(self._receive)
        gl.Enable(enums.DEBUG_OUTPUT)
        gl.Enable(enums.DEBUG_OUTPUT_SYNCHRONOUS)
        gl.DebugMessageCallback(ctypes.cast(self._callback, ctypes.c_void_p), None)
        gl.Enable(enums.NO_ERROR)  # an error on purpose: no capability has this name
        self.is_silent = not self._messages
        self.clear()

    def clear(self) -> None:
        """Discard all errors so far."""
        drain_errors(self._gl)
        self._messages.clear()

    def take(self) -> str:
        """Return and discard the messages reported since the last call, one per line; empty if there are
        none."""
        code = self._gl.GetError() if self.is_silent else enums.NO_ERROR
        if not self._messages and code == enums.NO_ERROR:
            return ""
        text = "\n".join(self._messages) or NAMES.get(code, hex(code))
        self.clear()
        return text

    def _receive(
        self, source: int, kind: int, number: int, severity: int, length: int, message: int, user: int | None
    ) -> None:
        if kind in _FATAL:
            self._messages.append(ctypes.string_at(message, length).decode(errors="replace").strip())


class DebugGlBackend(GlBackend):
    """A `GlBackend` whose methods raise the errors that the driver reports as `DeviceError`
    (`device-debug`)."""

    def __init__(self, context: moderngl.Context, shared: SharedContext | None = None) -> None:
        super().__init__(context, shared)
        self._debug = DebugOutput(self.gl)
        self._loop_checks: LoopChecks | None = None
        self._is_signalled = True  # no loop was executed since the last signal
        if shared is None and "llvmpipe" in self.capabilities.device:
            self._loop_checks = LoopChecks(context, self.gl)
            self._programs.instrument = self._loop_checks.add

    def prepare_uniform(self, buffer: Id) -> Callable[[int, int, int], object]:
        return lambda slot, offset, size: self.bind_uniform(slot, buffer, offset, size)

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
        return lambda instances: self.draw(
            vertex_array, primitive, first, count, instances, base_vertex, base_instance
        )

    def create_filled_buffer(self, buffer: Id, descriptor: BufferDescriptor, data: BytesLike) -> None:
        self.check(super().create_filled_buffer, "create_filled_buffer", buffer, descriptor, data)

    def prepare_queries(self, queries: Sequence[Id]) -> PreparedQueries:
        return _CheckedQueries(super().prepare_queries(queries), self)

    def draw_clipped(
        self, vertex_array: Id, primitive: Primitive, draws: NDArray[Any], clips: NDArray[np.int64]
    ) -> None:
        self.check(super().draw_clipped, "draw_clipped", vertex_array, primitive, draws, clips)

    def make_current(self) -> None:
        super().make_current()
        self._debug.clear()  # some of the calls that restore states are errors

    def check(self, call: Callable[..., object], name: str, *arguments: object) -> Any:
        """Call a function and raise the errors that the driver reports during the call.

        Refuse the call if other code has made another context current, since earlier calls may be lost.
        """
        self.check_context()
        try:
            result = call(*arguments)
        except Exception:
            self._debug.clear()
            raise
        message = self._debug.take()
        if message:
            text = ", ".join(map(_format_argument, arguments))
            raise DeviceError(DEVICE_DEBUG, f"{name}({text})", message)
        if self._loop_checks is not None and self._has_finished(name):
            error = self._loop_checks.take()
            if error is not None:
                raise error
        return result

    def _has_finished(self, name: str) -> bool:
        """Note that the method `name` was called; return whether it leaves the GPU without work.

        A poll of the fence must not wait, and reading the counters does unless the GPU is idle."""
        if name == "signal":
            self._is_signalled = True
        elif name.startswith(_EXECUTING):
            self._is_signalled = False
        return name in _WAITING or (name == "completed" and self._is_signalled and self._fence.is_idle)


class _CheckedQueries:
    """Prepared queries that are checked like the backend's methods."""

    def __init__(self, queries: PreparedQueries, backend: DebugGlBackend) -> None:
        self._queries = queries
        self._backend = backend

    def draw(
        self, vertex_array: Id, primitive: Primitive, draws: NDArray[Any], query_indices: NDArray[np.int64]
    ) -> None:
        self._backend.check(self._queries.draw, "draw_counted", vertex_array, primitive, draws, query_indices)

    def draw_conditional(
        self,
        vertex_array: Id,
        primitive: Primitive,
        buffer: Id,
        offset: int,
        query_indices: NDArray[np.int64],
    ) -> None:
        draw = self._queries.draw_conditional
        self._backend.check(draw, "draw_conditional", vertex_array, primitive, buffer, offset, query_indices)

    def read(self, query_indices: NDArray[np.int64]) -> NDArray[np.int64] | None:
        samples: NDArray[np.int64] | None = self._backend.check(
            self._queries.read, "read_queries", query_indices
        )
        return samples


def _checked(name: str) -> Callable[..., Any]:
    method = getattr(GlBackend, name)

    @functools.wraps(method)
    def checked(self: DebugGlBackend, *arguments: object) -> object:
        return self.check(method.__get__(self), name, *arguments)

    return checked


def _format_argument(argument: object) -> str:
    text = repr(argument)
    return text if len(text) <= 60 else text[:57] + "..."


for _name, _member in vars(Backend).items():
    if callable(_member) and not _name.startswith("_") and _name != "close":
        setattr(DebugGlBackend, _name, _checked(_name))
