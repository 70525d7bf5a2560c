"""Effect patterns: the commands that one leaves in a stream, and assertions that a stream has none of it.

- A `EffectPattern` declares an effect by what only the effect has: programs, words of their text, bindings,
  resources, events, states, kinds of commands. A command belongs to the effect if it has any of these, or
  uses what has. So a draw belongs to it as well if its program reads a binding of the effect, or if it draws
  to a texture of the effect.
- `assert_free` asserts that a stream has no command of an effect. A pattern with a misspelt name is in no
  stream, so the assertion can be given a `control`: a stream with the effect, in which each part of the
  pattern must be found.
- `assert_same` asserts that two streams are the same, command by command and byte by byte: the stronger form,
  which needs no pattern, but a stream of a frame that never had the effect.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from typing import Any, Final, TypeAlias
from weakref import WeakKeyDictionary

from rhi.commands.ops import CREATIONS, DISPATCHES, DRAWS, Op
from rhi.commands.stream import Command, Commands
from rhi.contract.descriptors import ProgramDescriptor
from rhi.contract.states import State
from rhi.device.device import Device
from rhi.errors import refuse
from rhi.errors.rules import ASSERTION_ARGUMENT
from rhi.shading import Shader
from rhi.testing.arguments import checker, read_commands
from rhi.testing.conditions import HasStates
from rhi.testing.messages import MAX_SHOWN, fail, show_commands
from rhi.testing.work import BINDS, total_costs
from rhi.trace.diff import diff
from rhi.trace.ids import ids_of

_WORK: Final = DRAWS | DISPATCHES
_GROUPS: Final[dict[str, frozenset[Op]]] = {
    "events": frozenset({Op.PUSH_LABEL}),
    "passes": frozenset({Op.BEGIN_PASS}),
    "programs": frozenset({Op.CREATE_PROGRAM, Op.BIND_PROGRAM}),
    "resources": CREATIONS - {Op.CREATE_PROGRAM} | {Op.DESTROY},
    "uploads": frozenset({Op.WRITE_BUFFER, Op.WRITE_TEXTURE}),
    "bindings": BINDS,
    "draws": DRAWS,
    "dispatches": DISPATCHES,
}
"""The group in a message of each command."""

_OTHERS: Final = "others"
_ENDS: Final = frozenset({Op.POP_LABEL, Op.END_PASS})
"""The commands that end something which a message has shown already."""


_PARTS: Final = {
    "programs": "shaders, or their names",
    "states": "states, such as CullMode.NONE",
    "ops": "kinds of commands, such as Op.DRAW",
}

Part: TypeAlias = tuple[str, str]
"""A declared use of an effect pattern: its kind, such as "binding", and its name."""


@dataclass(frozen=True)
class EffectPattern:
    """The resources, commands and labels that belong to an effect. Names may have `*` for any characters.

    Attributes:
        effect: the effect's name, for messages.
        programs: programs of the effect alone, by their shaders or the names of these.
        words: names of functions and types that the text of a program has if the effect is in it; with a dot
            before, of fields that it reads (".emission").
        bindings: names of programs' bindings.
        resources: labels of the buffers and textures of the effect.
        events: labels of events, with all that is inside.
        states: states with which only the effect draws.
        ops: kinds of commands that only the effect issues.
        where: predicates of other commands of the effect, by what a message says of them.
    """

    effect: str
    programs: tuple[str | type[Shader], ...] = ()
    words: tuple[str, ...] = ()
    bindings: tuple[str, ...] = ()
    resources: tuple[str, ...] = ()
    events: tuple[str, ...] = ()
    states: tuple[State, ...] = ()
    ops: tuple[Op, ...] = ()
    where: Mapping[str, Callable[[Command], bool]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check = checker("EffectPattern")
        check.text("effect", self.effect)
        kinds: dict[str, Any] = {"programs": (str, type), "states": (State,), "ops": (Op,)}
        for name in ("programs", "words", "bindings", "resources", "events", "states", "ops"):
            values = getattr(self, name)
            if not isinstance(values, tuple):
                check.fail(name, values, "a tuple")
            for value in values:
                is_shader = not isinstance(value, type) or issubclass(value, Shader)
                if not isinstance(value, kinds.get(name, (str,))) or not is_shader or value == "":
                    check.fail(name, value, _PARTS.get(name, "names"))
        check.instance("where", self.where, Mapping, "functions of a command by name")
        for name, predicate in self.where.items():
            check.text("where", name)
            if not callable(predicate) or isinstance(predicate, type):
                check.fail(name, predicate, "a function of a command")

    def __str__(self) -> str:
        return f"of {self.effect}"

    def miss(self, command: Command) -> str:
        """Return "" if a command belongs to the effect, so that `expect(stream).of(effect)` selects it."""
        return "" if self.explain(command) else f"it has nothing of {self.effect}"

    def explain(self, command: Command) -> tuple[str, ...]:
        """The parts of the effect in a command, each part as a message says it; nothing if it doesn't
        belong to the effect."""
        return tuple(dict.fromkeys(reason for _, reason in self.match_parts(command)))

    @property
    def parts(self) -> tuple[Part, ...]:
        """The declared parts, each with its kind and its name."""
        return (
            *(("program", _name(program)) for program in self.programs),
            *(("word", word) for word in self.words),
            *(("binding", name) for name in self.bindings),
            *(("resource", label) for label in self.resources),
            *(("event", label) for label in self.events),
            *(("state", repr(state)) for state in self.states),
            *(("command", op.method) for op in self.ops),
            *(("predicate", name) for name in self.where),
        )

    def match_parts(self, command: Command) -> Iterator[tuple[Part, str]]:
        """Yield the parts that a command has, each with how it has it."""
        op = command.op
        yield from self._match_program(command)
        yield from self._match_resources(command)
        labels = (*command.labels, command["text"]) if op is Op.PUSH_LABEL else command.labels
        for label in self.events:
            if any(fnmatchcase(pattern, label) for pattern in labels):
                yield ("event", label), f"in {' / '.join(labels)}"
        for state in self.states if op in _WORK else ():
            if not HasStates((state,), 0.0).miss(command):
                yield ("state", repr(state)), f"with {state!r}"
        if op in self.ops:
            yield ("command", op.method), f"is a {op.method}"
        for name, predicate in self.where.items():
            if predicate(command):
                yield ("predicate", name), name

    def _match_program(self, command: Command) -> Iterator[tuple[Part, str]]:
        """Yield the parts of the program that a command makes, binds or runs."""
        op = command.op
        if op is Op.CREATE_PROGRAM:
            program = command["descriptor"]
        elif op in _WORK or op is Op.BIND_PROGRAM:
            program = command.resource(command["program"] if op is Op.BIND_PROGRAM else command.program)
        else:
            return
        if not isinstance(program, ProgramDescriptor):
            return
        for pattern in self.programs:
            if fnmatchcase(program.name, _name(pattern)):
                yield ("program", _name(pattern)), f"program {program.name}"
        text = _join_texts(program) if self.words else ""
        for word in self.words:
            begin = "" if word.startswith(".") else r"\b"
            if re.search(rf"{begin}{re.escape(word)}\b", text):
                yield ("word", word), f"{word} in the text of {program.name}"
        for name in self.bindings:
            for binding in program.bindings:
                if fnmatchcase(binding.name, name):
                    yield ("binding", name), f"binding {binding.name} of {program.name}"

    def _match_resources(self, command: Command) -> Iterator[tuple[Part, str]]:
        """Yield the resources of the effect that a command makes, writes, binds, reads by a binding or draws
        to."""
        if not self.resources:
            return
        op, values = command.op, command.values
        descriptors = [values[1]] if op in CREATIONS else []
        used = list(ids_of(op, values))
        if op in _WORK:
            used += [bound[0] for bound in command.bindings.values()]
            if command.render_pass is not None:
                used += ids_of(Op.BEGIN_PASS, (command.render_pass,))
        descriptors += map(command.resource, dict.fromkeys(used))
        for descriptor in descriptors:
            label = getattr(descriptor, "label", "")
            for pattern in self.resources:
                if fnmatchcase(label, pattern):
                    yield ("resource", pattern), f"uses {label!r}"


def assert_free(
    effect: EffectPattern, commands: Commands | Device, *, control: Commands | Device | None = None
) -> None:
    """Assert that a stream, or a part of it, has no command of an effect. A failure names what the effect
    costs, with the lines that issued it.

    Args:
        control: a stream with the effect. Each part of the pattern must be in it, so that a name that isn't
            that of anything is found.
    """
    __tracebackhide__ = True
    checker("assert_free").instance("effect", effect, EffectPattern, "an EffectPattern")
    if not effect.parts:
        fail(f"the pattern of {effect.effect} is empty, so no command can match it")
    selected = read_commands("assert_free", "commands", commands)
    if not len(selected):
        fail(f"the stream has no commands, so the assertion checks nothing about {effect.effect}")
    reasons = {command.index: why for command in selected if (why := effect.explain(command))}
    if reasons:
        _fail_with_cost(effect, selected, reasons)
    if control is not None:
        examined = read_commands("assert_free", "control", control)
        matched = {part for command in examined for part, _ in effect.match_parts(command)}
        missing = [f"  {kind} {name!r}" for kind, name in effect.parts if (kind, name) not in matched]
        if missing:
            fail(f"the control lacks parts of the pattern of {effect.effect}:", *missing)


def assert_same(
    commands: Commands | Device, expected: Commands | Device, *, description: str = "the streams"
) -> None:
    """Assert that two streams, or parts of streams, are the same, whatever the lines that issued them:
    operations, numbers, bytes and the text of programs. Ids may differ if they stand for equal resources, and
    so may places in streamed buffers.

    Args:
        description: what is compared, for messages.
    """
    __tracebackhide__ = True
    checker("assert_same").text("description", description)
    selected = read_commands("assert_same", "commands", commands)
    selected_expected = read_commands("assert_same", "expected", expected)
    if not len(selected) and not len(selected_expected):
        fail(f"both streams are empty, so the assertion checks nothing about {description}")
    if selected.stream is selected_expected.stream and list(selected.indices()) == list(
        selected_expected.indices()
    ):
        refuse(
            ASSERTION_ARGUMENT,
            "assert_same",
            "the same commands on both sides",
            "two streams, or parts of them",
        )
    differences = diff(selected, selected_expected)
    if differences:
        more = len(differences) - MAX_SHOWN
        fail(
            f"{description} differ in {len(differences)} places "
            f"({len(selected)} and {len(selected_expected)} commands):",
            str(differences[:MAX_SHOWN]),
            f"… and {more} more" if more > 0 else "",
        )


def _fail_with_cost(
    effect: EffectPattern, selected: Commands, reasons: Mapping[int, tuple[str, ...]]
) -> None:
    __tracebackhide__ = True
    matches = selected.filter(where=lambda command: command.index in reasons)
    groups: dict[str, list[Command]] = {}
    for command in matches.filter(frozenset(Op) - _ENDS):
        groups.setdefault(_group_of(command.op), []).append(command)
    order = [name for name in (*_GROUPS, _OTHERS) if name in groups]
    numbers = [f"{name}: {len(groups[name])}" for name in order]
    if uploaded := total_costs(matches).upload_bytes:
        numbers.append(f"bytes: {uploaded:,}")
    remarks = {index: "; ".join(why) for index, why in reasons.items()}
    fail(
        f"expected nothing of {effect.effect}, found {len(matches)} among {len(selected)} commands",
        ", ".join(numbers),
        *(show_commands(name, groups[name], remarks) for name in order),
    )


def _group_of(op: Op) -> str:
    return next((name for name, ops in _GROUPS.items() if op in ops), _OTHERS)


def _name(program: str | type[Shader]) -> str:
    return program if isinstance(program, str) else program.__name__


def _join_texts(program: ProgramDescriptor) -> str:
    """Return the GLSL of all stages of a program, which is written once."""
    text = _TEXTS.get(program)
    if text is None:
        text = "\n".join(program.emit("glsl", stage).text for stage in program.stages)
        _TEXTS[program] = text
    return text


_TEXTS: Final[WeakKeyDictionary[ProgramDescriptor, str]] = WeakKeyDictionary()
