"""What commands cost, and what was asked for next to what was issued.

`device.states` and `device.draw` say what shall hold; a device sends only what differs from what holds
already. `watch` counts both sides over a block of code, so that a test can assert on the caching itself.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import astuple, dataclass, field
from typing import Final

from rhi.commands.ops import DRAWS, Op
from rhi.commands.stream import Command, Commands
from rhi.device.device import Device
from rhi.testing.conditions import bindings_of

DISPATCHES: Final = frozenset({Op.DISPATCH, Op.DISPATCH_INDIRECT})
CREATIONS: Final = frozenset(op for op in Op if op.method.startswith("create_"))
BINDS: Final = frozenset({Op.BIND_UNIFORM, Op.BIND_STORAGE, Op.BIND_TEXTURE, Op.BIND_IMAGE})


@dataclass(frozen=True, slots=True)
class Counts:
    """What commands come to. A draw is one call, indirect or not; creations are those of all resources,
    also of those that the device makes for itself (samplers, vertex arrays, rings)."""

    draws: int = 0
    dispatches: int = 0
    hardware_state_changes: int = 0
    upload_bytes: int = 0
    creations: int = 0


def cost_of(command: Command) -> Counts:
    """What one command comes to; nothing if it failed."""
    op = command.op
    if command.failure is not None:
        return Counts()
    if op in DRAWS:
        return Counts(draws=1)
    if op in DISPATCHES:
        return Counts(dispatches=1)
    if op is Op.SET_STATES:
        return Counts(hardware_state_changes=len(command["changes"]))
    if op in (Op.WRITE_BUFFER, Op.WRITE_TEXTURE):
        return Counts(upload_bytes=len(command["data"]))
    return Counts(creations=1) if op in CREATIONS else Counts()


def count(commands: Iterable[Command]) -> Counts:
    """What commands come to."""
    totals = [0] * 5
    for command in commands:
        totals = [a + b for a, b in zip(totals, astuple(cost_of(command)), strict=True)]
    return Counts(*totals)


@dataclass(frozen=True, slots=True)
class Calls:
    """How often a state was set, a program bound, and something bound for it."""

    states: int = 0
    programs: int = 0
    bindings: int = 0


@dataclass(slots=True)
class Work:
    """What a block of code did; complete when the block has ended.

    Attributes:
        commands: what was issued.
        requested: states set by scopes; of each draw and dispatch, its program and its bindings.
        issued: what of that reached the backend.
    """

    commands: Commands
    requested: Calls = field(default_factory=Calls)
    issued: Calls = field(default_factory=Calls)


@contextmanager
def watch(device: Device) -> Iterator[Work]:
    """`with watch(device) as work:` counts what the block asks for and what is issued.

    Raises:
        ValidationError: `device-not-recording` if the device doesn't record.
    """
    stream, start, before = device.stream, len(device.stream), device.statistics
    work = Work(stream[start:])
    yield work
    after = device.statistics
    work.commands = stream[start:]
    users = [command for command in work.commands if command.op in DRAWS | DISPATCHES]
    work.requested = Calls(
        after.software_state_changes - before.software_state_changes,
        len(users),
        sum(len(bindings_of(command)) for command in users),
    )
    work.issued = Calls(
        after.hardware_state_changes - before.hardware_state_changes,
        len(work.commands.filter(Op.BIND_PROGRAM)),
        len(work.commands.filter(BINDS)),
    )
