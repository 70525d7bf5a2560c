"""The recorder: a `Backend` that records each call and forwards it to another backend.

- Each call is recorded before it is forwarded: its op, its arguments and its call site (the caller's code
  object and instruction offset). A call that raises stays in the stream, marked with the error.
- Data to be written is copied, and the copy is forwarded. So the stream stays correct whatever the caller
  does with its array, and the inner backend need not copy again.
- The methods are generated from the signatures of `Backend`, once when a class is created. One text stands
  for all of them, and arguments are passed without packing (`*args` would double the cost).
"""

from __future__ import annotations

import linecache
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from types import CodeType, MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, Final

from rhi.commands.ops import Op
from rhi.commands.stream import CommandStream
from rhi.contract.backend import Backend, Capabilities
from rhi.contract.descriptors import Id, VertexArrayDescriptor
from rhi.errors.call_sites import MARK, MARKED, mark_library
from rhi.errors.device_objects import DeviceObject

RepeatableCommand = tuple[tuple[Any, ...] | None, Callable[..., object], tuple[Any, ...]]
"""A command's entry in the stream, or None, and a call with its arguments."""


class CommandMethods(DeviceObject):
    """The command methods of a `Backend`, all generated from one text.

    A subclass defines `METHOD`, the body of a method, in which `{op}` stands for the number of its `Op`,
    `{method}` for its name and `{arguments}` for its arguments ("a, b, " or nothing). Methods that the
    subclass defines itself are kept. The body receives data to be written as `bytes`, and sequences as
    tuples. A subclass without a `METHOD` of its own inherits the methods.

    Attributes:
        METHOD: the body of each generated method.
        GLOBALS: the global names that the body uses, besides Python's builtins. It sees no others.
        GENERATED: the names of the methods that were generated.
    """

    __slots__ = ()

    METHOD: ClassVar[str]
    GENERATED: ClassVar[frozenset[str]]
    GLOBALS: ClassVar[Mapping[str, object]] = MappingProxyType({})

    def __init_subclass__(cls) -> None:
        if "METHOD" not in vars(cls):
            return
        namespace = {"__name__": cls.__module__, **cls.GLOBALS}
        mark_library()
        if hasattr(sys.modules[cls.__module__], MARK):
            namespace[MARK] = True  # else the generated frames would pass for the user's
        methods = _make_methods(cls, namespace)
        cls.GENERATED = frozenset(methods)
        for name, method in methods.items():
            setattr(cls, name, method)

    if TYPE_CHECKING:  # the methods that __init_subclass__ generates
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
        copy_texture_to_buffer = Backend.copy_texture_to_buffer
        copy_buffer_to_texture = Backend.copy_buffer_to_texture
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


def _make_methods(cls: type[CommandMethods], namespace: dict[str, object]) -> dict[str, Callable[..., Any]]:
    """Generate the methods that a class doesn't define itself. Compiling them together takes half the
    time."""
    lines: list[str] = []
    for op in Op:
        if op.method in vars(cls):
            continue
        lines.append(f"def {op.method}({', '.join(('self', *op.parameters))}):")
        for name, annotation in op.parameters.items():
            if annotation == "BytesLike":
                lines.append(f"    {name} = bytes({name})")
            elif annotation.startswith("Sequence["):
                lines.append(f"    {name} = tuple({name})")
        arguments = "".join(f"{name}, " for name in op.parameters)
        look = "pass" if op.method.startswith(_IN_PASSES) else _MARK_LIBRARY
        lines.append(cls.METHOD.format(op=int(op), method=op.method, arguments=arguments, look=look))
    source = "\n".join(lines)
    file = f"<{cls.__module__}.{cls.__qualname__}>"
    linecache.cache[file] = (len(source), None, source.splitlines(keepends=True), file)  # for tracebacks
    methods: dict[str, Any] = {}
    exec(compile(source, file, "exec"), namespace, methods)
    for name, method in methods.items():
        method.__qualname__ = f"{cls.__qualname__}.{name}"
        method.__doc__ = getattr(Backend, name).__doc__
    return methods


class _NoFrame:
    """Stands for the caller's frame where the whole call stack belongs to this package."""

    f_globals: ClassVar[dict[str, object]] = {}
    f_code = None
    f_lasti = -1


CALLER_LOOKUP: Final = f"""\
    {{look}}
    frame = get_frame(1)
    while "{MARK}" in frame.f_globals:
        frame = frame.f_back or no_frame
"""
"""The part of a `METHOD` that finds the innermost frame of user code: `frame`, with its code object
(`frame.f_code`) and instruction offset (`frame.f_lasti`)."""

_MARK_LIBRARY: Final = "if len(modules) != marked[0]: mark_library()"
_IN_PASSES: Final = ("bind_", "set_", "draw", "end_", "push_", "pop_")
"""Prefixes of commands that only occur inside passes: `begin_pass` has marked new modules already."""

CALLER_LOOKUP_GLOBALS: Final = MappingProxyType(
    {
        "get_frame": sys._getframe,
        "no_frame": _NoFrame(),
        "mark_library": mark_library,
        "marked": MARKED,
        "modules": sys.modules,
    }
)
"""The `GLOBALS` that `CALLER_LOOKUP` needs."""

_RECORD: Final = f"{CALLER_LOOKUP}    self._write(({{op}}, {{arguments}}frame.f_code, frame.f_lasti))\n"


class CommandWriter(CommandMethods):
    """A `Backend` that only records: it writes commands into `stream`. Command buffers are recorded with it.

    Attributes:
        stream: the commands so far.
        vertex_arrays: the requested vertex arrays, by id. They are created once, before the commands are
            executed.
    """

    __slots__ = ("_write", "capabilities", "stream", "vertex_arrays")

    METHOD = _RECORD
    GLOBALS = CALLER_LOOKUP_GLOBALS

    def __init__(self, capabilities: Capabilities) -> None:
        self.capabilities = capabilities
        self.stream = CommandStream()
        self.vertex_arrays: dict[Id, VertexArrayDescriptor] = {}
        self._write: Callable[[tuple[Any, ...]], None] = self.stream.data.extend

    def create_vertex_array(self, vertex_array: Id, descriptor: VertexArrayDescriptor) -> None:
        """Remember the vertex array; it is created later."""
        self.vertex_arrays[vertex_array] = descriptor

    def completed(self) -> int:
        """Return 0: no fence is ever reached here."""
        return 0

    def read_query(self, query: Id) -> int | None:
        """Return None: no query has an answer here."""
        return None

    def close(self) -> None:
        """Do nothing: there is nothing to release."""


PORTABLE_ALIGNMENT: Final = 256
"""The coarsest alignment in bytes of uniform and storage ranges that a device may ask for (WebGPU, 3.6.2)."""


class ForwardingBackend(CommandMethods):
    """A `Backend` that forwards every call to another. Subclasses add their work to some or all calls.

    Attributes:
        backend: the backend that receives all calls.
    """

    __slots__ = ("backend",)

    METHOD = "    return self.backend.{method}({arguments})"

    def __init__(self, backend: Backend) -> None:
        self.backend = backend

    @property
    def capabilities(self) -> Capabilities:
        """The capabilities of the inner backend."""
        return self.backend.capabilities

    def close(self) -> None:
        """Close the inner backend."""
        self.backend.close()

    def completed(self) -> int:
        """Return the inner backend's fence value. This isn't a command."""
        return self.backend.completed()

    def read_query(self, query: Id) -> int | None:
        """Return the inner backend's answer to a query. This isn't a command."""
        return self.backend.read_query(query)


class Recorder(ForwardingBackend):
    """A `Backend` that records every command into `stream` and forwards it to `backend`.

    Attributes:
        stream: the commands so far. It grows until `stream.clear()`, and is kept when the backend is closed.
    """

    __slots__ = ("_write", "stream")

    METHOD = f"""\
{_RECORD}\
    try:
        return self.backend.{{method}}({{arguments}})
    except BaseException as error:
        self._fail(error)
        raise
"""
    GLOBALS = CALLER_LOOKUP_GLOBALS

    def __init__(self, backend: Backend) -> None:
        super().__init__(backend)
        self.stream = CommandStream()
        self._write: Callable[[tuple[Any, ...]], None] = self.stream.data.extend

    @property
    def capabilities(self) -> Capabilities:
        """The capabilities of the inner backend. Ranges of a device that draws are aligned as WebGPU promises, so
        that what is recorded replays on every device, however fine its own alignment."""
        inner = self.backend.capabilities
        if not inner.shading:
            return inner
        return replace(
            inner,
            uniform_alignment=max(inner.uniform_alignment, PORTABLE_ALIGNMENT),
            storage_alignment=max(inner.storage_alignment, PORTABLE_ALIGNMENT),
        )

    def forward(self, op: Op, arguments: tuple[Any, ...], code: CodeType | None, offset: int) -> None:
        """Record a command that was called elsewhere, with its own call site, and forward it."""
        self.repeat([self.prepare(op, arguments, code, offset)])

    def prepare(
        self, op: Op, arguments: tuple[Any, ...], code: CodeType | None, offset: int
    ) -> RepeatableCommand:
        """Return a command for `repeat`, which takes less time than `forward` from the second call on."""
        return (int(op), *arguments, code, offset), *resolve_call(self.backend, op, arguments, code, offset)

    def repeat(self, commands: Iterable[RepeatableCommand]) -> None:
        """Record commands as the stream has them, and forward them. A command without an entry is only
        called: it records itself.

        If a command raises, those after it stay in the iterator.
        """
        entry: tuple[Any, ...] | None = None
        try:
            for entry, call, arguments in commands:
                if entry is not None:
                    self._write(entry)
                call(*arguments)
        except BaseException as error:
            if entry is not None:
                self._fail(error)
            raise

    @contextmanager
    def paused(self) -> Iterator[None]:
        """Forward calls without recording them. Commands recorded afterwards still know the states and labels
        that were set meanwhile."""
        before = self._write
        self._write = self.stream.skip
        try:
            yield
        finally:
            self._write = before

    @property
    def is_paused(self) -> bool:
        """True if calls are forwarded without being recorded."""
        return self._write == self.stream.skip

    def _fail(self, error: BaseException) -> None:
        if not self.is_paused:
            self.stream.fail(error)


def forward(backend: Backend, op: Op, arguments: tuple[Any, ...], code: CodeType | None, offset: int) -> None:
    """Call a backend's command that was called elsewhere, with its call site if the backend has a `forward`
    method."""
    call, call_arguments = resolve_call(backend, op, arguments, code, offset)
    call(*call_arguments)


def resolve_call(
    backend: Backend, op: Op, arguments: tuple[Any, ...], code: CodeType | None, offset: int
) -> tuple[Callable[..., object], tuple[Any, ...]]:
    """Return the method that `forward` calls, and its arguments."""
    with_site = getattr(backend, "forward", None)
    if with_site is not None:
        return with_site, (op, arguments, code, offset)
    resolve = getattr(backend, "resolve_command", None)
    return resolve(op, arguments) if resolve is not None else (getattr(backend, op.method), arguments)
