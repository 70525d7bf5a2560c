"""The arguments of assertions, checked so that none holds because of a slip: a misspelt name, a shape that no
value has, a number that nothing equals.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from numbers import Real
from typing import Any, Final

import numpy as np

from rhi.commands.ops import DRAW_ARGUMENTS, ID_KINDS, Op
from rhi.commands.stream import Command, Commands
from rhi.contract.states import State
from rhi.device.device import Device
from rhi.device.resources.programs import Program
from rhi.errors import refuse
from rhi.errors.arguments import ArgumentChecker, to_integer
from rhi.errors.array_likes import to_real_array
from rhi.errors.rules import ASSERTION_ARGUMENT
from rhi.shading import Shader

_PLAIN: Final = (bool, int, float, complex, str, bytes, tuple, list, set, frozenset, dict, type(None), type)
"""Types that compare by value alone; others, as of `pytest.approx`, may equal a number in a way of their
own."""
_CLASSES: Final = frozenset(
    {"Primitive", "Region", "PassDescriptor", "QueryKind"} | {kind.__name__ for kind in ID_KINDS.values()}
)
"""Annotations of arguments that are classes, whose values are equal to nothing else."""


def checker(call: str) -> ArgumentChecker:
    """The function that checks the arguments of an assertion."""
    return ArgumentChecker(call, rule=ASSERTION_ARGUMENT)


def read_commands(call: str, name: str, commands: Any) -> Commands:
    """Return commands, or those of a device."""
    if isinstance(commands, Device):
        return commands.stream
    return checker(call).instance(name, commands, Commands, "a stream, a part of one, or a device")


def read_command(call: str, command: Any) -> Command:
    """Return a command."""
    return checker(call).instance("command", command, Command, "a command of a stream")


def read_tolerance(call: str, tolerance: Any) -> float:
    """Return a tolerance: finite, 0 or more."""
    return checker(call).number("tolerance", tolerance, 0.0)


def check_arguments(call: str, ops: Iterable[Op], arguments: Mapping[str, object]) -> None:
    """Refuse arguments that no command of these kinds has, and values that none can be equal to."""
    ops = frozenset(ops)
    annotations = {name: kind for op in ops for name, kind in op.parameters.items()}
    if Op.DRAW_INDIRECT in ops:
        annotations.update((name, Op.DRAW.parameters[name]) for name in DRAW_ARGUMENTS)
    for name, value in arguments.items():
        if name not in annotations:
            refuse_name(call, "argument", name, annotations)
        _check_value(call, name, value, annotations[name])


def _check_value(call: str, name: str, value: Any, annotation: str) -> None:
    is_number = annotation in ("int", "float") or annotation in ID_KINDS
    if not is_number:
        if annotation == "str":
            checker(call).text(name, value)
        elif (type(value) in _PLAIN or isinstance(value, type)) and annotation in _CLASSES:
            checker(call).fail(name, value, f"a value of {annotation}")
        return
    if type(value) not in _PLAIN and not isinstance(value, Real):
        if getattr(type(value), "__eq__", None) is object.__eq__:
            checker(call).fail(name, value, "a number, or what compares with numbers, as pytest.approx")
        return
    if annotation == "float":
        checker(call).number(name, value)
    else:
        checker(call).integer(name, value, None if name == "base_vertex" else 0)


def check_program(call: str, program: object) -> None:
    """Refuse what names no program: it is an object, an id, a shader's class or the name of one."""
    if isinstance(program, str):
        if program:
            return
    elif isinstance(program, type):
        if issubclass(program, Shader):
            return
    elif isinstance(program, Program) or (to_integer(program) or 0) > 0:
        return
    checker(call).fail("program", program, "a program, its id, its shader's class, or the name of that")


def check_labels(call: str, labels: tuple[Any, ...]) -> None:
    """Refuse labels that are none."""
    if not labels:
        refuse(ASSERTION_ARGUMENT, call, "no labels", "one or more")
    for label in labels:
        checker(call).text("label", label)


def check_states(call: str, states: tuple[Any, ...]) -> None:
    """Refuse what is no state, and two values of the same one."""
    if not states:
        refuse(ASSERTION_ARGUMENT, call, "no states", "one or more, such as CullMode.NONE")
    keys = []
    for state in states:
        if not isinstance(state, State):
            checker(call).fail("state", state, "states, such as CullMode.NONE or Viewport(…)")
        keys.append((type(state), getattr(state, "target", None)))
    if len(set(keys)) < len(keys):
        refuse(ASSERTION_ARGUMENT, call, ", ".join(map(repr, states)), "one value of each state")


def check_resources(call: str, resources: Mapping[str, object]) -> None:
    """Refuse values that no binding is equal to."""
    if not resources:
        refuse(ASSERTION_ARGUMENT, call, "no bindings", "one or more, such as tint=buffer")
    for name, value in resources.items():
        is_label = isinstance(value, str) and bool(value)
        is_id = (to_integer(value) or 0) > 0
        is_resource = any(
            hasattr(value, attribute) for attribute in ("id", "buffer", "texture")
        ) and not isinstance(value, type)
        if not (is_label or is_id or is_resource):
            checker(call).fail(name, value, "a buffer, a texture, a part of one, a label, or an id")


def check_data(call: str, binding: Any, expected: Mapping[str, object]) -> None:
    """Refuse data that names nothing, and numbers that nothing is equal to."""
    checker(call).text("binding", binding)
    if not expected:
        refuse(ASSERTION_ARGUMENT, call, "no fields", "numbers by the names of fields")
    for path, value in expected.items():
        checker(call).text("field", path)
        _check_numbers(call, path, value)


def _check_numbers(call: str, path: str, value: Any) -> None:
    try:
        numbers = to_real_array(value)
    except (TypeError, ValueError) as error:
        refuse(ASSERTION_ARGUMENT, call, f"{path}={value!r}", f"real numbers: {error}")
    if not np.isfinite(numbers).all():
        refuse(ASSERTION_ARGUMENT, call, f"{path}={value!r}", "finite numbers: NaN equals nothing")


def refuse_name(call: str, kind: str, name: str, names: Iterable[str]) -> None:
    """Refuse a name that nothing has, with the one that was meant."""
    available = sorted(set(names))
    close = get_close_matches(name, available, 1)
    tip = f"did you mean {close[0]!r}?" if close else ""
    refuse(ASSERTION_ARGUMENT, call, f"{kind} {name!r}", ", ".join(available) or f"no {kind}s", tip)
