"""The recorder: a `Backend` that writes each call down and passes it on.

- Written down are the op, the arguments and the caller's frame (its code object and instruction), before the
  call is passed on; a call that raises stays in the stream, marked with the error.
- Memory that is written is copied, and the copy is passed on, so that the stream stays true whatever the
  caller does with its array, and the inner backend need not copy again.
- The methods are generated, once when the class is made, from the signatures of `Backend`: the text below
  stands for all of them, and arguments are passed without packing (`*args` would double the cost).
"""

from __future__ import annotations

import linecache
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import CodeType
from typing import TYPE_CHECKING, Any, ClassVar, Final

from rhi.commands.ops import Op
from rhi.commands.stream import CommandStream
from rhi.contract.backend import Backend, Capabilities
from rhi.contract.descriptors import Id, VertexArrayDescriptor

__rhi_internal__ = True


class CommandMethods:
    """The command methods of a `Backend`, all made from one text.

    A subclass gives `METHOD`, the body of a method in which `{op}` stands for the number of its `Op`,
    `{method}` for its name and `{arguments}` for its arguments ("a, b, " or nothing). Methods that the
    subclass writes out itself are left alone. Memory arrives in the body as `bytes`, sequences as tuples.
    """

    __slots__ = ()

    METHOD: ClassVar[str]

    def __init_subclass__(cls) -> None:
        for op in Op:
            if op.method not in vars(cls):
                setattr(cls, op.method, _make_method(cls, op))

    if TYPE_CHECKING:  # what __init_subclass__ makes, for type checkers
        create_buffer = Backend.create_buffer
        create_texture = Backend.create_texture
        create_sampler = Backend.create_sampler
        create_program = Backend.create_program
        create_vertex_array = Backend.create_vertex_array
        create_query = Backend.create_query
        destroy = Backend.destroy
        write_buffer = Backend.write_buffer
        read_buffer = Backend.read_buffer
        copy_buffer = Backend.copy_buffer
        clear_buffer = Backend.clear_buffer
        write_texture = Backend.write_texture
        read_texture = Backend.read_texture
        copy_texture = Backend.copy_texture
        resolve_texture = Backend.resolve_texture
        generate_mipmaps = Backend.generate_mipmaps
        begin_pass = Backend.begin_pass
        end_pass = Backend.end_pass
        set_states = Backend.set_states
        bind_program = Backend.bind_program
        bind_uniform = Backend.bind_uniform
        bind_storage = Backend.bind_storage
        bind_texture = Backend.bind_texture
        bind_image = Backend.bind_image
        draw = Backend.draw
        draw_indirect = Backend.draw_indirect
        dispatch = Backend.dispatch
        dispatch_indirect = Backend.dispatch_indirect
        signal = Backend.signal
        wait = Backend.wait
        begin_query = Backend.begin_query
        end_query = Backend.end_query
        write_query = Backend.write_query
        begin_conditional = Backend.begin_conditional
        end_conditional = Backend.end_conditional
        push_label = Backend.push_label
        pop_label = Backend.pop_label
        present = Backend.present


def _make_method(cls: type[CommandMethods], op: Op) -> Callable[..., Any]:
    module = sys.modules[cls.__module__]
    lines = [f"def {op.method}({', '.join(('self', *op.parameters))}):"]
    for name, annotation in op.parameters.items():
        if annotation == "BytesLike":
            lines.append(f"    {name} = bytes({name})")
        elif annotation.startswith("Sequence["):
            lines.append(f"    {name} = tuple({name})")
    arguments = "".join(f"{name}, " for name in op.parameters)
    body = cls.METHOD.format(op=int(op), method=op.method, arguments=arguments)
    source = "\n".join((*lines, body))
    file = f"<{cls.__module__}.{cls.__qualname__}.{op.method}>"
    linecache.cache[file] = (len(source), None, source.splitlines(keepends=True), file)  # for tracebacks
    made: dict[str, Any] = {}
    exec(compile(source, file, "exec"), vars(module), made)
    method: Callable[..., Any] = made[op.method]
    method.__qualname__ = f"{cls.__qualname__}.{op.method}"
    method.__doc__ = getattr(Backend, op.method).__doc__
    return method


class _Nowhere:
    """Stands for the caller's frame where the whole call stack belongs to this package."""

    f_globals: ClassVar[dict[str, object]] = {}
    f_code = None
    f_lasti = -1


# Names that the generated methods use.
_get_frame = sys._getframe
_nowhere = _Nowhere()


_FIND_CALLER: Final = """\
    frame = _get_frame(1)
    while "__rhi_internal__" in frame.f_globals:
        frame = frame.f_back or _nowhere
    self._write(({op}, {arguments}frame.f_code, frame.f_lasti))
"""


class CommandWriter(CommandMethods):
    """Writes commands into `stream` and does nothing else: the backend that a command buffer is recorded on.

    Attributes:
        stream: the commands so far.
        vertex_arrays: those that were asked for; they are made once, before the commands are carried out.
    """

    __slots__ = ("_write", "capabilities", "stream", "vertex_arrays")

    METHOD = _FIND_CALLER

    def __init__(self, capabilities: Capabilities) -> None:
        self.capabilities = capabilities
        self.stream = CommandStream()
        self.vertex_arrays: dict[Id, VertexArrayDescriptor] = {}
        self._write: Callable[[tuple[Any, ...]], None] = self.stream.data.extend

    def create_vertex_array(self, vertex_array: Id, descriptor: VertexArrayDescriptor) -> None:
        """Keep it for later."""
        self.vertex_arrays[vertex_array] = descriptor

    def completed(self) -> int:
        """Nothing is."""
        return 0

    def read_query(self, query: Id) -> int | None:
        """There is no answer."""
        return None

    def close(self) -> None:
        """There is nothing to let go of."""


class Recorder(CommandMethods):
    """Writes the commands that reach `backend` into `stream`.

    Attributes:
        backend: what every call is passed on to.
        stream: the commands so far. It grows until `stream.clear()`.
    """

    __slots__ = ("_write", "backend", "stream")

    METHOD = f"""\
{_FIND_CALLER}\
    try:
        return self.backend.{{method}}({{arguments}})
    except BaseException as error:
        self._fail(error)
        raise
"""

    def __init__(self, backend: Backend) -> None:
        self.backend = backend
        self.stream = CommandStream()
        self._write: Callable[[tuple[Any, ...]], None] = self.stream.data.extend

    @property
    def capabilities(self) -> Capabilities:
        """Those of the backend behind."""
        return self.backend.capabilities

    def close(self) -> None:
        """Close the backend; the stream stays."""
        self.backend.close()

    def completed(self) -> int:
        """As the backend says; not a command."""
        return self.backend.completed()

    def read_query(self, query: Id) -> int | None:
        """As the backend says; not a command."""
        return self.backend.read_query(query)

    def pass_on(self, op: Op, arguments: tuple[Any, ...], code: CodeType | None, offset: int) -> None:
        """Write down a command that was called elsewhere, at its own call site, and pass it on."""
        self._write((int(op), *arguments, code, offset))
        try:
            pass_on(self.backend, op, arguments, code, offset)
        except BaseException as error:
            self._fail(error)
            raise

    @contextmanager
    def paused(self) -> Iterator[None]:
        """Pass calls on without writing them down. States and labels set meanwhile are known to the
        commands that follow."""
        before = self._write
        self._write = self.stream.leave_out
        try:
            yield
        finally:
            self._write = before

    @property
    def is_paused(self) -> bool:
        """Whether calls are passed on without being written down."""
        return self._write == self.stream.leave_out

    def _fail(self, error: BaseException) -> None:
        if not self.is_paused:
            self.stream.fail(error)


def pass_on(backend: Backend, op: Op, arguments: tuple[Any, ...], code: CodeType | None, offset: int) -> None:
    """Call a backend's command that was called elsewhere: with the call site, if the backend has a method for that."""
    with_site = getattr(backend, "pass_on", None)
    if with_site is None:
        getattr(backend, op.method)(*arguments)
    else:
        with_site(op, arguments, code, offset)
