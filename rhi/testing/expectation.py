"""`expect(stream)`: assertions on the commands that meet some conditions.

- An `Expectation` is a set of conditions on commands. Methods that add a condition return a new expectation,
  so a common beginning can be kept and used twice; `exactly`, `at_least`, `at_most`, `before` and `costs`
  assert.
- A failure is an AssertionError that lists the matching commands and those that miss the fewest conditions,
  each with how it misses them and the line that issued it.
"""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Collection, Mapping

from numpy.typing import ArrayLike

from rhi.commands.ops import DISPATCHES, DRAWS, Op
from rhi.commands.stream import Commands
from rhi.contract.descriptors import ProgramDescriptor
from rhi.contract.states import State
from rhi.device.device import Device
from rhi.errors import refuse
from rhi.errors.rules import ASSERTION_ARGUMENT
from rhi.shading import Struct
from rhi.testing.arguments import (
    check_arguments,
    check_data,
    check_labels,
    check_program,
    check_resources,
    check_states,
    checker,
    read_commands,
    read_tolerance,
)
from rhi.testing.buffer_tracking import as_fields
from rhi.testing.conditions import (
    Condition,
    HasArguments,
    HasBindings,
    HasData,
    HasStates,
    IsOp,
    UsesProgram,
    Where,
    Within,
)
from rhi.testing.effect_patterns import EffectPattern
from rhi.testing.messages import MAX_SHOWN, fail, show_command, show_commands
from rhi.testing.work import Costs, cost_of, total_costs


def expect(commands: Commands | Device) -> Expectation:
    """Begin an expectation on a stream, a part of it such as `frames(stream)[i]`, or the stream of a
    device.

    Examples:
        >>> device.stream.clear()
        >>> with device.event("sun"), device.render_pass(image), device.states(rhi.CullMode.FRONT):
        ...     device.draw(program, mesh, tint=(1, 0, 0, 1))
        >>> draws = expect(device).draws(program="Flat").within("sun")
        >>> len(draws.with_states(rhi.CullMode.FRONT).exactly(1))
        1
    """
    return Expectation(read_commands("expect", "commands", commands), ())


def frames(commands: Commands | Device) -> list[Commands]:
    """Split commands into frames, each ending with its `present`; commands after the last `present` are left
    out.

    Examples:
        >>> device.stream.clear()
        >>> for _ in range(2):
        ...     with device.render_pass(image, clear=(0, 0, 0, 1)):
        ...         pass
        ...     device.present(image)
        >>> len(frames(device))
        2
    """
    whole = read_commands("frames", "commands", commands)
    result, start = [], 0
    for end, command in enumerate(whole, 1):
        if command.op is Op.PRESENT:
            result.append(whole[start:end])
            start = end
    return result


class Expectation:
    """Commands, and conditions that select some of them."""

    __slots__ = ("_commands", "_conditions")

    def __init__(self, commands: Commands, conditions: tuple[Condition, ...]) -> None:
        self._commands = commands
        self._conditions = conditions

    def __str__(self) -> str:
        return " ".join(map(str, self._conditions)) or "commands"

    __repr__ = __str__

    # -- conditions ---------------------------------------------------------------------------------------

    def draws(self, *, program: object = None, **arguments: object) -> Expectation:
        """Select draws, indirect ones included, with these arguments of `Backend.draw` or `draw_indirect`. Of
        an indirect command or `draw_many`, one of its draws has them.

        Args:
            program: the program, its id, its shader's class or the name of that.
            arguments: values to compare for equality; use `pytest.approx` for a tolerance.
        """
        return self._work(DRAWS, program, arguments)

    def dispatches(self, *, program: object = None, **arguments: object) -> Expectation:
        """Select dispatches of compute programs; arguments as for `draws`."""
        return self._work(DISPATCHES, program, arguments)

    def commands(self, *ops: Op, **arguments: object) -> Expectation:
        """Select commands of these kinds (default: all kinds) with these arguments."""
        for op in ops:
            checker("commands").instance("op", op, Op, "kinds of commands, such as Op.DRAW")
        check_arguments("commands", ops or self._kinds(), arguments)
        narrowed = self._and(IsOp(frozenset(ops))) if ops else self
        return narrowed._and(HasArguments(arguments)) if arguments else narrowed

    def within(self, *labels: str) -> Expectation:
        """Select commands inside these labels, nested in this order; other labels may lie between and around
        them."""
        check_labels("within", labels)
        return self._and(Within(labels))

    def with_states(self, *states: State, tolerance: float = 0.0) -> Expectation:
        """Select commands issued while these states are set, their numbers within `tolerance`."""
        check_states("with_states", states)
        return self._and(HasStates(states, read_tolerance("with_states", tolerance)))

    def with_bindings(self, **resources: object) -> Expectation:
        """Select commands while these resources are bound.

        Args:
            resources: by the names of the program's bindings an object as passed to `device.draw`, a buffer
                or texture any part of which matches, a label, or an id.
        """
        check_resources("with_bindings", resources)
        return self._and(HasBindings(resources))

    def with_data(
        self, binding: str, expected: Mapping[str, object] | Struct | ArrayLike, *, tolerance: float = 0.0
    ) -> Expectation:
        """Select commands while a uniform or storage binding of the program contains these numbers.

        Args:
            expected: a value of the struct, or numbers by name: `{"color": (1, 0, 0, 1)}`; in arrays and
                nested structs by path, `{"lights.0.color": …}`. Of a uniform that is no struct, its numbers.
            tolerance: the maximum difference of each number.

        Unknown contents (last written on the device, or before the stream) don't match; the message
        says so.

        Examples:
            >>> device.stream.clear()
            >>> with device.render_pass(image):
            ...     device.draw(device.program(Tinted), mesh, tint=Tint(color=(1, 0, 0, 1)))
            >>> matches = expect(device).draws().with_data("tint", {"color": (1, 0, 0, 1)}).exactly(1)
        """
        fields = as_fields(expected)
        check_data("with_data", binding, fields)
        return self._and(HasData(binding, fields, read_tolerance("with_data", tolerance)))

    def of(self, effect: EffectPattern) -> Expectation:
        """Select commands that belong to an effect."""
        checker("of").instance("effect", effect, EffectPattern, "an EffectPattern")
        if not effect.parts:
            refuse(
                ASSERTION_ARGUMENT,
                "of",
                f"the pattern of {effect.effect}",
                "a pattern with at least one part",
            )
        return self._and(effect)

    def where(self, name: str, predicate: object) -> Expectation:
        """Select commands for which `predicate(command)` is true; `name` stands for it in messages."""
        checker("where").text("name", name)
        if not callable(predicate) or isinstance(predicate, type):
            checker("where").fail("predicate", predicate, "a function of a command")
        return self._and(Where(name, predicate))

    def _work(self, ops: Collection[Op], program: object, arguments: dict[str, object]) -> Expectation:
        narrowed = self.commands(*ops, **arguments)
        if program is not None:
            check_program("draws" if DRAWS & set(ops) else "dispatches", program)
        expected = program.__name__ if isinstance(program, type) else program
        return narrowed if program is None else narrowed._and(UsesProgram(expected))

    def _kinds(self) -> Collection[Op]:
        """The kinds of commands that the conditions so far leave."""
        kinds = frozenset(Op)
        for condition in self._conditions:
            if isinstance(condition, IsOp):
                kinds &= condition.ops
        return kinds

    def _list_programs(self) -> list[ProgramDescriptor]:
        """The programs that the matching commands may use: all of the stream's, or those that a condition
        names."""
        stream = self._commands.stream
        descriptors = list(stream.context(len(stream)).resources.values())
        descriptors += [item["descriptor"] for item in stream.filter(Op.CREATE_PROGRAM)]
        programs = [item for item in descriptors if isinstance(item, ProgramDescriptor)]
        for condition in self._conditions:
            if isinstance(condition, UsesProgram) and isinstance(condition.program, str):
                name = condition.program
                named = [item for item in programs if name in (item.name, item.name.rpartition(".")[2])]
                programs = named or programs
        return programs

    def _and(self, condition: Condition) -> Expectation:
        return Expectation(self._commands, (*self._conditions, condition))

    # -- assertions ----------------------------------------------------------------------------------------

    def matches(self) -> Commands:
        """Return the commands that meet all conditions.

        Raises:
            ValidationError: `assertion-argument` if there are none because a condition names a binding or
                field that no program has, or numbers of another shape.
        """
        commands = self._select()
        if not len(commands):
            self._check_names()
        return commands

    def _check_names(self) -> None:
        """Refuse names that nothing has, with which no command can match."""
        programs = self._list_programs()
        for condition in self._conditions:
            if isinstance(condition, (HasBindings, HasData)):
                condition.check_names(programs)

    def _select(self) -> Commands:
        data = [condition for condition in self._conditions if isinstance(condition, HasData)]
        programs = self._list_programs() if data else []
        for row in data:
            row.check_shapes(programs)
        commands = self._commands
        for condition in self._conditions:
            commands = (
                commands.filter(condition.ops)
                if isinstance(condition, IsOp)
                else commands.filter(
                    where=lambda command, condition=condition: not condition.miss(command)  # type: ignore[misc]
                )
            )
        return commands

    def exactly(self, number: int) -> Commands:
        """Assert that exactly `number` commands match, and return them.

        Examples:
            >>> matches = expect(device).draws(program="NoSuchProgram").exactly(0)
        """
        number = checker("exactly").integer("number", number, 0)
        return self._assert_number(f"exactly {number}", number, number)

    def at_least(self, number: int) -> Commands:
        """Assert that `number` or more commands match, and return them."""
        number = checker("at_least").integer("number", number, 0)
        return self._assert_number(f"at least {number}", number, None)

    def at_most(self, number: int) -> Commands:
        """Assert that `number` or fewer commands match, and return them."""
        number = checker("at_most").integer("number", number, 0)
        return self._assert_number(f"at most {number}", 0, number)

    def before(self, other: Expectation) -> None:
        """Assert that all matching commands precede all of `other`, and that both match some."""
        checker("before").instance("other", other, Expectation, "another expectation")
        if other._commands.stream is not self._commands.stream:
            refuse(
                ASSERTION_ARGUMENT,
                "before",
                "an expectation on another stream",
                "an expectation on the same stream",
            )
        first, second = self.at_least(1), other.at_least(1)
        last, next_one = first[-1], second[0]
        if last.index >= next_one.index:
            fail(
                f"expected all {self}\nbefore all  {other}, but",
                show_commands("the last of the first", [last]),
                show_commands("comes after the first of the second", [next_one]),
            )

    def costs(
        self,
        *,
        max_draws: int | None = None,
        max_dispatches: int | None = None,
        max_hardware_state_changes: int | None = None,
        max_upload_bytes: int | None = None,
        max_creations: int | None = None,
    ) -> Costs:
        """Assert that the costs of the matching commands are within a budget, and return the costs.

        They have the fields `draws`, `dispatches`, `hardware_state_changes`, `upload_bytes` and `creations`,
        which are numbers. For a frame, `expect(frames(stream)[1]).costs(…)`; for a label,
        `expect(stream).within("sun").costs(…)`.

        Examples:
            >>> device.stream.clear()
            >>> with device.render_pass(image):
            ...     device.draw(program, mesh, tint=(1, 0, 0, 1))
            >>> costs = expect(device).draws().costs(max_draws=1)
        """
        budget = {
            "draws": max_draws,
            "dispatches": max_dispatches,
            "hardware_state_changes": max_hardware_state_changes,
            "upload_bytes": max_upload_bytes,
            "creations": max_creations,
        }
        for name, most in budget.items():
            checker("costs").integer_or_none(f"max_{name}", most, 0)
        commands = self.matches()
        counts = total_costs(commands)
        exceeded = []
        for name, most in budget.items():
            spent = getattr(counts, name)
            if most is not None and spent > most:
                exceeded.append(
                    f"{name.replace('_', ' ')}: {spent:,}, allowed {most:,}\n{_show_spending(commands, name)}"
                )
        if exceeded:
            fail(f"{self} exceed the budget", *exceeded)
        return counts

    def _assert_number(self, expected: str, minimum: int, maximum: int | None) -> Commands:
        commands = self._select()
        if len(commands) < minimum or (maximum is not None and len(commands) > maximum):
            fail(
                f"expected {expected}: {self}\nfound {len(commands)} among {len(self._commands)} commands",
                show_commands("matching", commands),
                self._show_nearest(commands),
            )
        if not len(commands):
            self._check_names()
        return commands

    def _show_nearest(self, matches: Commands) -> str:
        """Show the commands of the right kind that miss the fewest conditions."""
        matching = set(matches.indices())
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
        nearest = heapq.nsmallest(MAX_SHOWN, candidates, key=lambda candidate: candidate[:2])
        if not kinds or not nearest:
            return ""
        lines = [
            f"{show_command(command)}\n          {'; '.join(misses)}" for _, _, command, misses in nearest
        ]
        return "nearest:\n" + "\n".join(lines)


def _show_spending(commands: Commands, name: str) -> str:
    """Show the lines of the program that caused a cost, the most expensive ones first."""
    by_line: Counter[str] = Counter()
    for command in commands:
        cost = getattr(cost_of(command), name)
        if cost:
            by_line[f"{command.op.method}  {command.site or ''}"] += cost
    return "\n".join(f"  {cost:>8,}  {line}" for line, cost in by_line.most_common(MAX_SHOWN))
