"""The command stream: recorded commands, and views of them.

- A stream is one flat list of entries `op, arguments…, code, lasti`. A tuple per command took 2.5 times as
  long: one object per command keeps the garbage collector busy (a tuple that holds an enum stays tracked),
  and its header is a third of the memory. The start of each command is found when the stream is read.
- A call site is a code object and an instruction offset. It is resolved to a file and line on request. Code
  objects are never hashed, because their hash reads all of their contents.
"""

from __future__ import annotations

from array import array
from collections import deque
from collections.abc import Callable, Collection, Iterator, Sequence
from itertools import islice
from types import CodeType
from typing import Any, Final, overload

import numpy as np
from numpy.typing import NDArray

from rhi.commands.buffer_bytes import BufferBytes, UnknownDataError
from rhi.commands.context import CONTEXT_OPS, StreamContext
from rhi.commands.ops import BUFFER_WRITES, DRAW_ARGUMENTS, DRAWS, WIDTHS, WORK, Descriptor, Op, States
from rhi.commands.text import describe_call
from rhi.contract.descriptors import Id, PassDescriptor, ProgramDescriptor
from rhi.errors import RhiError, refuse
from rhi.errors.call_sites import CallSite, make_call_site
from rhi.errors.data_classes import dataclass
from rhi.errors.device_objects import DeviceObject
from rhi.errors.rules import COMMAND_ARGUMENT, COMMAND_CLEARED

__all__ = ["Command", "CommandStream", "Commands", "Failure", "Op", "Refusal", "StreamContext"]


@dataclass(frozen=True, slots=True)
class Failure:
    """The reason why a call failed: the id of a rule, or the exception's type if it names no rule."""

    error: str
    message: str


@dataclass(frozen=True, slots=True)
class Refusal:
    """A call that was refused, and therefore never became a command.

    Attributes:
        index: number of commands before it.
        error: the rule's id.
        call, given, allowed: the parts of the error message.
        labels: the open labels at the call, outermost first.
    """

    index: int
    error: str
    call: str
    given: str = ""
    allowed: str = ""
    site: CallSite | None = None
    labels: tuple[str, ...] = ()

    def __str__(self) -> str:
        given = f": {_on_one_line(self.given)}" if self.given else ""
        allowed = f" (allowed: {_on_one_line(self.allowed)})" if self.allowed else ""
        site = f"  {self.site}" if self.site is not None else ""
        return f"{self.call}{given}{allowed}{site}  REFUSED [{self.error}]"


def _on_one_line(text: str) -> str:
    first, more, _ = text.partition("\n")
    return first + " …" * bool(more)


def call_site_at(code: CodeType | None, offset: int) -> CallSite | None:
    """Return the line of the instruction at an offset in bytes, or None without a code object."""
    if code is None:
        return None
    position = next(islice(code.co_positions(), offset // 2, None), None)
    line = position[0] if position is not None else None
    return make_call_site(code, line or code.co_firstlineno)


class Command(DeviceObject):
    """A recorded call with its arguments: `command.op`, `command["count"]`, `command.site`.

    Labels, states, program, bindings, resources and render pass are derived from the commands before it. They
    are available until the stream is cleared; afterwards they raise `command-cleared`.
    """

    _copy_tip = "rhi.trace.save(stream, path) writes a stream to a file, and rhi.trace.load reads it"
    __slots__ = ("_code", "_generation", "_stream", "failure", "index", "offset", "op", "values")

    def __init__(self, stream: CommandStream, index: int) -> None:
        op, values, code, lasti = stream.entry(index)
        self._stream = stream
        self._generation = stream.generation
        self._code: CodeType | None = code
        self.offset: int = lasti
        """Offset of the calling instruction in the caller's code, in bytes."""
        self.index = index
        """Index of the command in its stream."""
        self.op = op
        self.values: tuple[Any, ...] = values
        """The arguments in order."""
        self.failure: Failure | None = stream.failures.get(index)
        """The reason why the call failed, or None."""

    @property
    def stream(self) -> CommandStream:
        """The stream that contains this command."""
        return self._stream

    @property
    def arguments(self) -> dict[str, Any]:
        """The arguments by their parameter names in `rhi.contract.Backend`."""
        return dict(zip(self.op.parameters, self.values, strict=True))

    def __getitem__(self, name: str) -> Any:
        """Return an argument by its name; an unknown name raises `command-argument`."""
        _check_argument(self.op, name)
        return self.arguments[name]

    @property
    def draw_arguments(self) -> NDArray[np.void]:
        """The draws of a DRAW or DRAW_INDIRECT, such as those of `device.draw_many`: an array (n,) of
        `rhi.DRAW`, whether the mesh has indices or not.

        The draws of an indirect command are derived from what was written to its buffer before. Conditional
        rendering may drop them on the device.

        Raises:
            UnknownDataError: the device wrote them, or they were written before the stream.
            ValidationError: `command-argument` for any other command.
        """
        if self.op not in DRAWS:
            refuse(COMMAND_ARGUMENT, f"{self.op.method}: draw_arguments", "no draw", "draw, draw_indirect")
        self._check_generation()
        stream = self._stream
        if stream._bytes is None:
            stream._bytes = BufferBytes(stream)
        return stream._bytes.read_draws(self.index)

    @property
    def site(self) -> CallSite | None:
        """The user's line that made the call, or None if no user code was on the stack."""
        return call_site_at(self._code, self.offset)

    @property
    def labels(self) -> tuple[str, ...]:
        """The open labels, outermost first. The commands that push and pop a label are outside of it."""
        labels = self._context().labels
        return labels[:-1] if self.op is Op.POP_LABEL else labels

    @property
    def states(self) -> States:
        """The render states in effect."""
        return self._context().states.copy()

    @property
    def program(self) -> Id:
        """The id of the bound program, 0 for none."""
        return self._context().program

    @property
    def render_pass(self) -> PassDescriptor | None:
        """The descriptor of the open render pass, or None outside a pass."""
        return self._context().render_pass

    def resource(self, resource: Id) -> Descriptor | None:
        """Return the descriptor of a resource that exists at this command, or None."""
        return self._context().resources.get(resource)

    @property
    def bindings(self) -> dict[str, tuple[int, ...]]:
        """The bindings of the bound program by name: (buffer, offset, size) of a uniform or storage range,
        (texture, sampler) of a texture, (texture, level, layer) of an image."""
        context = self._context()
        program = context.resources.get(context.program)
        bindings = program.bindings if isinstance(program, ProgramDescriptor) else ()
        slots = context.slots
        return {b.name: slots[b.kind, b.slot] for b in bindings if (b.kind, b.slot) in slots}

    def _context(self) -> StreamContext:
        self._check_generation()
        return self._stream.context(self.index)

    def _check_generation(self) -> None:
        if self._generation != self._stream.generation:
            refuse(COMMAND_CLEARED, f"command {self.index} ({self.op.method})", "a cleared stream")

    def __str__(self) -> str:
        call = describe_call(self.op.method, self.arguments)
        site = f"  {self.site}" if self._code is not None else ""
        failure = f"  FAILED [{self.failure.error}]" if self.failure is not None else ""
        return f"{call}{self._show_draws()}{site}{failure}"

    def _show_draws(self) -> str:
        if self.op is not Op.DRAW_INDIRECT or self._generation != self._stream.generation:
            return ""
        return f"  draws: {self.describe_draws()}"

    def describe_draws(self) -> str:
        """Return the draws of a draw command as text, at most `MAX_PRINTED_DRAWS` of them."""
        try:
            draws = self.draw_arguments
        except UnknownDataError as error:
            return f"unknown, {error}"
        text = "; ".join(map(_describe_draw, draws[:MAX_PRINTED_DRAWS].tolist())) or "none"
        more = len(draws) - MAX_PRINTED_DRAWS
        return f"{text}; … and {more} more" if more > 0 else text

    __repr__ = __str__


MAX_PRINTED_DRAWS: Final = 4
"""Number of an indirect command's draws that its text shows."""


def _describe_draw(draw: tuple[int, ...]) -> str:
    """Return a draw's numbers as text, without those after `instances` that are 0."""
    numbers = zip(DRAW_ARGUMENTS, draw, strict=True)
    return ", ".join(f"{name}={value}" for i, (name, value) in enumerate(numbers) if i < 2 or value)


def _check_argument(op: Op, name: str) -> None:
    if name not in op.parameters:
        refuse(COMMAND_ARGUMENT, f"{op.method}: {name!r}", name, ", ".join(op.parameters) or "no arguments")


class Commands(DeviceObject, Sequence[Command]):
    """A fixed selection of commands of a stream, in order. It doesn't change while the stream grows."""

    __slots__ = ("_indices", "_stream")
    _copy_tip = "rhi.trace.save(stream, path) writes it to a file, and rhi.trace.load reads it"

    def __init__(self, stream: CommandStream, indices: Sequence[int]) -> None:
        self._stream = stream
        self._indices = indices

    @property
    def stream(self) -> CommandStream:
        """The stream that these commands are a part of."""
        return self._stream

    def indices(self) -> Sequence[int]:
        """Return the indices of these commands in the stream."""
        return self._indices

    def __len__(self) -> int:
        return len(self.indices())

    def __iter__(self) -> Iterator[Command]:
        for index in self.indices():
            yield Command(self._stream, index)

    @overload
    def __getitem__(self, index: int) -> Command: ...
    @overload
    def __getitem__(self, index: slice) -> Commands: ...
    def __getitem__(self, index: int | slice) -> Command | Commands:
        if isinstance(index, slice):
            return Commands(self._stream, self.indices()[index])
        return Command(self._stream, self.indices()[index])

    def filter(
        self,
        op: Op | Collection[Op] | None = None,
        *,
        label: str | None = None,
        where: Callable[[Command], bool] | None = None,
        **arguments: object,
    ) -> Commands:
        """Return the commands that meet all conditions: their op is `op` or one of several, they are inside
        the label at any depth, they have these argument values (`instances=4`; requires `op`), and `where` is
        true for them.

        Raises:
            ValidationError: `command-argument` for an argument that the op doesn't have.
        """
        ops = frozenset(Op) if op is None else frozenset((op,)) if isinstance(op, Op) else frozenset(op)
        for name in arguments:
            for single_op in ops if op is not None else ():
                _check_argument(single_op, name)
            if op is None:
                refuse(COMMAND_ARGUMENT, f"filter({name}=…)", "no op", "an op along with arguments")
        expected = arguments.items()

        def meets(command: Command) -> bool:
            if label is not None and label not in command.labels:
                return False
            if expected:
                actual = command.arguments
                if any(actual[name] != value for name, value in expected):
                    return False
            return where is None or where(command)

        stream = self._stream
        candidates = [index for index in self.indices() if stream.op(index) in ops]
        if label is None and where is None and not expected:
            return Commands(stream, candidates)
        return Commands(stream, [index for index in candidates if meets(Command(stream, index))])

    def draws(self) -> Commands:
        """Return the draws among these commands, indirect draws included."""
        return self.filter(DRAWS)

    @property
    def refusals(self) -> tuple[Refusal, ...]:
        """The calls that were refused between the first and the last of these commands; all of them for a
        whole stream."""
        indices, refused = self.indices(), self._stream._refusals
        if self._stream is self or not refused:
            return tuple(refused)
        first, last = (indices[0], indices[-1]) if indices else (0, -1)
        return tuple(refusal for refusal in refused if first < refusal.index <= last)

    def format(self, limit: int | None = None, refusals: Sequence[Refusal] | None = None) -> str:
        """Return the commands as text, one line each and indented by their labels, at most `limit` of them.
        Refused calls are listed in between: `refusals`, or by default the property of that name."""
        refused = deque(self.refusals if refusals is None else refusals)
        lines: list[str] = []
        count = 0
        for command in islice(self, limit):
            while refused and refused[0].index <= command.index:
                lines.append(_format_refusal(refused.popleft()))
            lines.append(f"{command.index:>6}  {'  ' * len(command.labels)}{command}")
            count += 1
        if count < len(self):
            lines.append(f"… and {len(self) - count} more")
        else:
            lines.extend(map(_format_refusal, refused))
        return "\n".join(lines)

    def __str__(self) -> str:
        return self.format(MAX_PRINTED_COMMANDS)

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {len(self)} commands>"


def _format_refusal(refusal: Refusal) -> str:
    return f"     ×  {'  ' * len(refusal.labels)}{refusal}"


MAX_PRINTED_COMMANDS: Final = 1000
"""Number of commands that `str` of a stream shows."""


class CommandStream(Commands):
    """The commands that a `Recorder` has recorded, oldest first.

    The stream grows as more commands are recorded; `stream[:]` selects those that it contains now.

    Attributes:
        data: the flat list of entries (`op, *arguments, code, lasti`). Only whole entries may be appended.
        failures: the calls that raised an exception, by index.
        generation: number of times that the stream was cleared.
        is_complete: whether the stream contains all commands since its creation: it was never cleared and
            recording was never paused.
    """

    __slots__ = (
        "_base",
        "_bytes",
        "_cursor",
        "_gaps",
        "_refusals",
        "_starts",
        "data",
        "failures",
        "generation",
        "is_complete",
    )

    def __init__(self) -> None:
        super().__init__(self, ())
        self.data: list[Any] = []
        self.failures: dict[int, Failure] = {}
        self._refusals: list[Refusal] = []
        self.generation = 0
        self.is_complete = True
        self._starts = array("Q")  # where each command begins in data, as far as it was read
        self._base = StreamContext()  # the context before the first command
        self._gaps: list[
            tuple[int, Op, tuple[Any, ...]]
        ] = []  # (index, op, arguments) of commands that weren't kept
        self._bytes: BufferBytes | None = None  # since the first indirect draw that was looked at
        self._cursor = (0, 0, self._base.copy())  # (commands, gaps) that the context includes

    def indices(self) -> range:
        """Return the indices of all commands."""
        return range(len(self))

    def __len__(self) -> int:
        starts, data = self._starts, self.data
        position = starts[-1] + WIDTHS[data[starts[-1]]] if starts else 0
        while position < len(data):
            starts.append(position)
            position += WIDTHS[data[position]]
        return len(starts)

    def op(self, index: int) -> Op:
        """Return the op of a command."""
        op: int = self.data[self._starts[index]]
        return _OPS[op]

    def entry(self, index: int) -> tuple[Op, tuple[Any, ...], CodeType | None, int]:
        """Return (op, arguments, code, lasti) of a command. The index must be less than an earlier `len`."""
        start = self._starts[index]
        op = _OPS[self.data[start]]
        end = start + WIDTHS[op]
        code, lasti = self.data[end - 2 : end]
        return op, tuple(self.data[start + 1 : end - 2]), code, lasti

    def context(self, index: int) -> StreamContext:
        """Return the context just before a command. It is valid until the next call of this method."""
        done, gaps, context = self._cursor
        if index < done:
            done = 0
            gaps = 0
            context = self._base.copy()
        while True:
            gaps = self.apply_skipped(context, gaps, done)
            if done >= index:
                break
            if done not in self.failures:
                op, arguments, _, _ = self.entry(done)
                context.apply(op, arguments)
            done += 1
        self._cursor = (done, gaps, context)
        return context

    def initial_context(self) -> StreamContext:
        """Return a copy of the context before the first command, with the resources that are older than it."""
        return self._base.copy()

    def apply_skipped(self, context: StreamContext, first: int, index: int) -> int:
        """Apply to `context` the commands that were skipped up to `index`, from the `first` of them on.

        Returns:
            How many skipped commands the context includes now, which is the next call's `first`.
        """
        for op, arguments in self.skipped(first, index):
            context.apply(op, arguments)
            first += 1
        return first

    def skipped(self, first: int, index: int) -> Iterator[tuple[Op, tuple[Any, ...]]]:
        """Return (op, arguments) of the commands that were skipped up to `index`, from the `first` of them on:
        those that change the context, or bytes of a buffer.

        Of a skipped `write_buffer` the third argument is the number of bytes, since the bytes weren't kept. Of
        several draws and dispatches in a row only the first is here: the others write the same bindings.
        """
        while first < len(self._gaps) and self._gaps[first][0] <= index:
            yield self._gaps[first][1:]
            first += 1

    def clear(self) -> None:
        """Remove all commands. States, labels, program and pass remain known for the commands that follow."""
        self._base = self.context(len(self)).copy()
        self.data.clear()
        self.failures.clear()
        self._refusals.clear()
        self._gaps.clear()
        self._bytes = None
        self._starts = array("Q")
        self._cursor = (0, 0, self._base.copy())
        self.generation += 1
        self.is_complete = False

    def assume(self, resource: Id, descriptor: Descriptor) -> None:
        """Declare a resource that was created before the first command."""
        self._base.resources[resource] = descriptor
        self._bytes = None
        self._cursor = (0, 0, self._base.copy())

    def skip(self, entry: tuple[Any, ...]) -> None:
        """Update the context by a command without keeping it; used instead of `data.extend(entry)`."""
        self.is_complete = False
        op, arguments, index, gaps = _OPS[entry[0]], entry[1:-2], len(self), self._gaps
        if op not in _KEPT_OF_SKIPPED or (
            op in WORK and gaps and gaps[-1][0] == index and gaps[-1][1] in WORK
        ):
            return
        if op is Op.WRITE_BUFFER:
            arguments = (*arguments[:-1], len(arguments[-1]))
        gaps.append((index, op, arguments))

    def note_refusal(self, error: RhiError) -> None:
        """Record that a call was refused at this point of the stream."""
        index = len(self)
        labels = self.context(index).labels
        self.add_refusal(
            Refusal(index, error.rule.id, error.call, error.given, error.allowed, error.site, labels)
        )

    def add_refusal(self, refusal: Refusal) -> None:
        """Add a refused call. Its index is not below the indices of earlier ones."""
        self._refusals.append(refusal)

    def fail(self, error: BaseException) -> None:
        """Mark the last command as failed."""
        name = error.rule.id if isinstance(error, RhiError) else type(error).__name__
        self.failures[len(self) - 1] = Failure(name, str(error))


_OPS: Final[tuple[Op, ...]] = tuple(Op)
_KEPT_OF_SKIPPED: Final = CONTEXT_OPS | BUFFER_WRITES
