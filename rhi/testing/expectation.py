"""`expect(stream)`: conditions, then a verdict.

- An `Expectation` is a set of conditions on commands. Methods that narrow it give a new one, so a common
  beginning can be kept and used twice; `exactly`, `at_least`, `at_most`, `before` and `costs` judge.
- A failure is an AssertionError that lists the matching commands and those that missed the fewest
  conditions, with what each of them has instead and the line that issued it.
"""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Collection, Mapping
from typing import Final, NoReturn

from rhi.commands.ops import DRAWS, Op
from rhi.commands.stream import Command, Commands
from rhi.contract.states import State
from rhi.device.device import Device
from rhi.shading import Struct
from rhi.testing.conditions import (
    Arguments,
    Condition,
    HasBindings,
    HasContents,
    HasStates,
    IsOp,
    Uses,
    Where,
    Within,
)
from rhi.testing.contents import as_fields
from rhi.testing.work import DISPATCHES, Counts, cost_of, count

SHOWN: Final = 5
"""Commands of each kind in a message."""


def expect(commands: Commands | Device) -> Expectation:
    """What is expected of these commands: a stream, a slice or `frames(stream)[i]`, or a device's stream."""
    return Expectation(commands.stream if isinstance(commands, Device) else commands, ())


def frames(commands: Commands | Device) -> list[Commands]:
    """The commands frame by frame; each ends with its `present`. What follows the last one is left out."""
    whole = commands.stream if isinstance(commands, Device) else commands
    result, start = [], 0
    for end, command in enumerate(whole, 1):
        if command.op is Op.PRESENT:
            result.append(whole[start:end])
            start = end
    return result


class Expectation:
    """Some conditions, and the commands that they are put to."""

    __slots__ = ("_commands", "_conditions")

    def __init__(self, commands: Commands, conditions: tuple[Condition, ...]) -> None:
        self._commands = commands
        self._conditions = conditions

    def __str__(self) -> str:
        return " ".join(map(str, self._conditions)) or "commands"

    __repr__ = __str__

    # -- narrowing ---------------------------------------------------------------------------------------

    def draws(self, *, program: object = None, **arguments: object) -> Expectation:
        """Draws, indirect ones included, with these arguments of `Backend.draw` or `draw_indirect`.

        Args:
            program: the program, its id or its shader's name.
            arguments: values to be equal; use `pytest.approx` for a tolerance.
        """
        return self._work(DRAWS, program, arguments)

    def dispatches(self, *, program: object = None, **arguments: object) -> Expectation:
        """Dispatches of compute programs, as `draws`."""
        return self._work(DISPATCHES, program, arguments)

    def commands(self, *ops: Op, **arguments: object) -> Expectation:
        """Commands of these kinds (none given: of all kinds) with these arguments."""
        narrowed = self._and(IsOp(frozenset(ops))) if ops else self
        return narrowed._and(Arguments(arguments)) if arguments else narrowed

    def within(self, *labels: str) -> Expectation:
        """Inside these labels, nested in this order; others may lie between and around."""
        return self._and(Within(labels))

    def with_states(self, *states: State, tolerance: float = 0.0) -> Expectation:
        """While these states hold; `tolerance` is the most by which their numbers may differ."""
        return self._and(HasStates(states, tolerance))

    def with_bindings(self, **resources: object) -> Expectation:
        """While the program's bindings are these resources: objects as they are given to `device.draw`, a
        buffer or texture of which any part will do, a label, or an id."""
        return self._and(HasBindings(resources))

    def with_contents(
        self, binding: str, wanted: Mapping[str, object] | Struct, *, tolerance: float = 0.0
    ) -> Expectation:
        """While a uniform or storage binding of the program holds these numbers.

        Args:
            wanted: a value of the struct, or numbers by their names: `{"color": (1, 0, 0, 1)}`; in arrays and
                nested structs by a path, `{"lights.0.color": …}`.
            tolerance: by how much each number may differ.

        What the stream doesn't say (written on the device, or before the stream) doesn't match; the message says so.
        """
        return self._and(HasContents(binding, as_fields(wanted), tolerance))

    def where(self, name: str, predicate: object) -> Expectation:
        """For which `predicate(command)` is true; `name` stands for it in messages."""
        assert callable(predicate)
        return self._and(Where(name, predicate))

    def _work(self, ops: Collection[Op], program: object, arguments: dict[str, object]) -> Expectation:
        narrowed = self.commands(*ops, **arguments)
        return narrowed if program is None else narrowed._and(Uses(program))

    def _and(self, condition: Condition) -> Expectation:
        return Expectation(self._commands, (*self._conditions, condition))

    # -- verdicts ----------------------------------------------------------------------------------------

    def matches(self) -> Commands:
        """The commands that meet all conditions."""
        found = self._commands
        for condition in self._conditions:
            found = found.filter(condition.ops) if isinstance(condition, IsOp) else found.filter(
                where=lambda command, condition=condition: not condition.miss(command)  # type: ignore[misc]
            )  # fmt: skip
        return found

    def exactly(self, number: int) -> Commands:
        """There are so many; returns them."""
        return self._judge(f"exactly {number}", number, number)

    def at_least(self, number: int) -> Commands:
        """There are so many or more; returns them."""
        return self._judge(f"at least {number}", number, None)

    def at_most(self, number: int) -> Commands:
        """There are so many or fewer; returns them."""
        return self._judge(f"at most {number}", 0, number)

    def before(self, other: Expectation) -> None:
        """The last of these comes before the first of the others, and there are some of both."""
        first, second = self.at_least(1), other.at_least(1)
        last, next_one = first[-1], second[0]
        if last.index > next_one.index:
            fail(
                f"expected all {self}\nbefore all  {other}, but",
                show_commands("this one", [last]),
                show_commands("comes after", [next_one]),
            )

    def costs(
        self,
        *,
        max_draws: int | None = None,
        max_dispatches: int | None = None,
        max_hardware_state_changes: int | None = None,
        max_upload_bytes: int | None = None,
        max_creations: int | None = None,
    ) -> Counts:
        """A budget for the commands: none of these numbers is exceeded. Returns what they come to.

        For a frame, `expect(frames(stream)[1]).costs(…)`; for a label, `expect(stream).within("sun").costs(…)`.
        """
        budget = {
            "draws": max_draws,
            "dispatches": max_dispatches,
            "hardware_state_changes": max_hardware_state_changes,
            "upload_bytes": max_upload_bytes,
            "creations": max_creations,
        }
        found = self.matches()
        counts = count(found)
        over = []
        for name, most in budget.items():
            spent = getattr(counts, name)
            if most is not None and spent > most:
                over.append(f"{name.replace('_', ' ')}: {spent:,}, allowed {most:,}\n{_spenders(found, name)}")
        if over:
            fail(f"{self} go over budget", *over)
        return counts

    def _judge(self, wanted: str, least: int, most: int | None) -> Commands:
        found = self.matches()
        if len(found) < least or (most is not None and len(found) > most):
            fail(
                f"expected {wanted}: {self}\nfound {len(found)} among {len(self._commands)} commands",
                show_commands("matching", found),
                self._show_nearest(found),
            )
        return found

    def _show_nearest(self, found: Commands) -> str:
        """The commands of the right kind that missed the fewest conditions."""
        matching = set(found.indices())
        kinds = [condition for condition in self._conditions if isinstance(condition, IsOp)]
        others = [condition for condition in self._conditions if condition not in kinds]
        candidates = []
        for command in self._commands:
            if command.index in matching or any(kind.miss(command) for kind in kinds):
                continue
            misses: list[str] = []
            for condition in others:
                if isinstance(condition, Where) and misses:
                    continue  # a predicate may rely on the conditions before it
                if miss := condition.miss(command):
                    misses.append(miss)
            candidates.append((len(misses), command.index, command, misses))
        nearest = heapq.nsmallest(SHOWN, candidates, key=lambda one: one[:2])
        if not kinds or not nearest:
            return ""
        lines = [f"{show_command(command)}\n          {'; '.join(misses)}" for _, _, command, misses in nearest]
        return "nearest:\n" + "\n".join(lines)


def show_command(command: Command) -> str:
    """A command's line in a message."""
    return f"  {command.index:>6}  {command}"


def show_commands(title: str, commands: Collection[Command]) -> str:
    """Some lines under a title; nothing if there are no commands."""
    if not len(commands):
        return ""
    lines = [show_command(command) for command in list(commands)[:SHOWN]]
    if len(commands) > SHOWN:
        lines.append(f"          … and {len(commands) - SHOWN} more")
    return f"{title}:\n" + "\n".join(lines)


def fail(*parts: str) -> NoReturn:
    """Raise an AssertionError of these parts."""
    __tracebackhide__ = True
    raise AssertionError("\n".join(part for part in parts if part))


def _spenders(commands: Commands, name: str) -> str:
    """The lines that a cost came from, the most expensive ones first."""
    by_line: Counter[str] = Counter()
    for command in commands:
        cost = getattr(cost_of(command), name)
        if cost:
            by_line[f"{command.op.method}  {command.site or ''}"] += cost
    return "\n".join(f"  {cost:>8,}  {line}" for line, cost in by_line.most_common(SHOWN))
