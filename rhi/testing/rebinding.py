"""Why a command binds: what changed since the same slot was bound before, or why it is bound again.

A device leaves out what is bound already. `python -m rhi docs passes` says when it binds everything again; anything
else that is bound a second time is needless, on every backend.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from rhi.commands.ops import WORK, Op
from rhi.commands.stream import Command, Commands, CommandStream
from rhi.contract.descriptors import BindingKind
from rhi.device.device import Device
from rhi.errors.choices import Choice
from rhi.testing.arguments import checker, read_command, read_commands
from rhi.testing.buffer_tracking import bindings_of

_KINDS: Final = {
    Op.BIND_UNIFORM: BindingKind.UNIFORM,
    Op.BIND_STORAGE: BindingKind.STORAGE,
    Op.BIND_TEXTURE: BindingKind.TEXTURE,
    Op.BIND_IMAGE: BindingKind.IMAGE,
}
_BINDS: Final = frozenset({Op.BIND_PROGRAM, *_KINDS})
_PASS_ENDS: Final = frozenset({Op.BEGIN_PASS, Op.END_PASS})


class BindReason(Choice):
    """The reason of a binding command; the value describes it."""

    FIRST = "nothing was bound here before"
    CHANGED = "something else was bound here before"
    NEW_PROGRAM = "another program was bound in between, so all bindings are checked and bound"
    NEW_PASS = "a render pass began or ended, so the program and all of its bindings are bound again"
    LOST = "a resource was destroyed or locked, or a call failed, so everything is bound again"
    NEEDLESS = "the same is bound already, through another object: keep the range or binding that is passed"


@dataclass(frozen=True)
class BoundBecause:
    """The answer of `why_bound`.

    Attributes:
        command: the binding command.
        name: the binding's name in its program, "" for BIND_PROGRAM.
        reason: why it was issued.
        before: the latest command that bound the same slot, None if there is none in the stream.
    """

    command: Command
    name: str
    reason: BindReason
    before: Command | None

    def __str__(self) -> str:
        name = f"{self.name}: " if self.name else ""
        before = f"; before: {self.before}" if self.before is not None else ""
        return f"{name}{self.reason.value} ({self.command}{before})"


def why_bound(command: Command) -> BoundBecause:
    """Return why a BIND_PROGRAM, BIND_UNIFORM, BIND_STORAGE, BIND_TEXTURE or BIND_IMAGE was issued.

    Raises:
        ValidationError: `assertion-argument` for any other command.

    Examples:
        >>> for _ in range(2):
        ...     with device.render_pass(image):
        ...         device.draw(program, mesh, tint=(1, 0, 0, 1))
        >>> why_bound(device.stream.filter(rhi.Op.BIND_PROGRAM)[-1]).reason.name
        'NEW_PASS'
    """
    read_command("why_bound", command)
    if command.op not in _BINDS:
        checker("why_bound").fail("command", command, "a command that binds, such as Op.BIND_TEXTURE")
    stream, index = command.stream, command.index
    before = _find_same_slot(stream, command)
    names = {(binding.kind, binding.slot): binding.name for binding in bindings_of(command)}
    name = "" if command.op is Op.BIND_PROGRAM else names.get((_KINDS[command.op], command["slot"]), "")
    if before is None:
        return BoundBecause(command, name, BindReason.FIRST, None)
    if before.values != command.values:
        reason = BindReason.NEW_PROGRAM if command.op is Op.BIND_PROGRAM else BindReason.CHANGED
        return BoundBecause(command, name, reason, before)
    if command.op is Op.BIND_PROGRAM:
        return BoundBecause(command, name, _explain_program(stream, before.index, index), before)
    program = _find_program_of_this_draw(stream, index)
    if program is None:
        return BoundBecause(command, name, BindReason.NEEDLESS, before)
    reason = why_bound(Command(stream, program)).reason
    return BoundBecause(
        command, name, BindReason.NEW_PROGRAM if reason is BindReason.FIRST else reason, before
    )


def needless_bindings(commands: Commands | Device) -> list[BoundBecause]:
    """Return the commands that bind what is bound already: draws that are passed a new object for the same
    range, texture or image each time. `print(*needless_bindings(device), sep="\\\\n")` shows them with their
    lines.

    Examples:
        >>> device.stream.clear()
        >>> needless_bindings(device)
        []
    """
    selected = read_commands("needless_bindings", "commands", commands)
    reasons = (why_bound(command) for command in selected.filter(frozenset(_KINDS)))
    return [reason for reason in reasons if reason.reason is BindReason.NEEDLESS]


def _find_same_slot(stream: CommandStream, command: Command) -> Command | None:
    """The latest command before this one that bound the same slot of the same kind."""
    for index in range(command.index - 1, -1, -1):
        if stream.op(index) is command.op:
            earlier = Command(stream, index)
            if command.op is Op.BIND_PROGRAM or earlier["slot"] == command["slot"]:
                return earlier
    return None


def _find_program_of_this_draw(stream: CommandStream, index: int) -> int | None:
    """The index of the BIND_PROGRAM that belongs to the same draw or dispatch, None if it binds no program."""
    for earlier in range(index - 1, -1, -1):
        op = stream.op(earlier)
        if op is Op.BIND_PROGRAM:
            return earlier
        if op in WORK:
            return None
    return None


def _explain_program(stream: CommandStream, before: int, index: int) -> BindReason:
    """Return why a program was bound again, with no other one bound in between."""
    if any(stream.op(between) in _PASS_ENDS for between in range(before + 1, index)):
        return BindReason.NEW_PASS
    return BindReason.LOST
