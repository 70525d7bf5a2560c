"""The costs of commands, and the work that code requested compared with the work that the device issued.

`device.states` and `device.draw` request states, programs and bindings; the device sends only those that
differ from the current ones. `count_work` counts both over a block of code, so that a test can assert on the
caching itself.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import astuple, dataclass, field
from typing import Final

from rhi.commands.ops import CREATIONS, DISPATCHES, DRAWS, Op
from rhi.commands.stream import Command, Commands
from rhi.device.device import Device
from rhi.testing.arguments import checker
from rhi.testing.buffer_tracking import bindings_of

BINDS: Final = frozenset({Op.BIND_UNIFORM, Op.BIND_STORAGE, Op.BIND_TEXTURE, Op.BIND_IMAGE})


@dataclass(frozen=True, slots=True)
class Costs:
    """The costs of some commands. A draw is one call, indirect or not; creations count all resources,
    including those that the device creates for itself (samplers, vertex arrays, rings)."""

    draws: int = 0
    dispatches: int = 0
    hardware_state_changes: int = 0
    upload_bytes: int = 0
    creations: int = 0


def cost_of(command: Command) -> Costs:
    """Return the costs of one command; a failed command costs nothing."""
    op = command.op
    if command.failure is not None:
        return Costs()
    if op in DRAWS:
        return Costs(draws=1)
    if op in DISPATCHES:
        return Costs(dispatches=1)
    if op is Op.SET_STATES:
        return Costs(hardware_state_changes=len(command["changes"]))
    if op in (Op.WRITE_BUFFER, Op.WRITE_TEXTURE):
        return Costs(upload_bytes=len(command["data"]))
    return Costs(creations=1) if op in CREATIONS else Costs()


def total_costs(commands: Iterable[Command]) -> Costs:
    """Return the summed costs of commands."""
    totals = [0] * 5
    for command in commands:
        totals = [a + b for a, b in zip(totals, astuple(cost_of(command)), strict=True)]
    return Costs(*totals)


@dataclass(frozen=True, slots=True)
class CallCounts:
    """Numbers of states that were set, programs that were bound, and resources that were bound for them."""

    states: int = 0
    programs: int = 0
    bindings: int = 0


@dataclass(slots=True)
class Work:
    """The work of a block of code; complete when the block has ended.

    Attributes:
        commands: the issued commands.
        requested: states set by scopes, and the program and the bindings of each draw and dispatch.
        issued: the part of these that reached the backend.
    """

    commands: Commands
    requested: CallCounts = field(default_factory=CallCounts)
    issued: CallCounts = field(default_factory=CallCounts)


@contextmanager
def count_work(device: Device) -> Iterator[Work]:
    """Count the work that a block requests and the work that the device issues: `with count_work(device) as
    work:`.

    Raises:
        ValidationError: `device-not-recording` if the device doesn't record.

    Examples:
        >>> with count_work(device) as work:
        ...     with device.render_pass(image):
        ...         for _ in range(10):
        ...             with device.states(rhi.DepthWrite.OFF):
        ...                 device.draw(program, mesh, tint=(1, 0, 0, 1))
        >>> work.requested.states, work.issued.states
        (10, 1)
    """
    checker("count_work").instance("device", device, Device, "a device")
    stream, start, before = device.stream, len(device.stream), device.statistics
    work = Work(stream[start:])
    yield work
    after = device.statistics
    work.commands = stream[start:]
    users = [command for command in work.commands if command.op in DRAWS | DISPATCHES]
    work.requested = CallCounts(
        after.software_state_changes - before.software_state_changes,
        len(users),
        sum(len(bindings_of(command)) for command in users),
    )
    work.issued = CallCounts(
        after.hardware_state_changes - before.hardware_state_changes,
        len(work.commands.filter(Op.BIND_PROGRAM)),
        len(work.commands.filter(BINDS)),
    )
