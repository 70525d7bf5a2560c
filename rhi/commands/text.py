"""Commands as text: one line each, in the form of the call that made them.

Arguments are shown as Python source where possible (`CullMode.NONE`, `Region(0, 0, 4, 4)`), without fields
that have their default value. Memory is shown by its size.
"""

from __future__ import annotations

import dataclasses
import enum
from collections.abc import Mapping

from rhi.contract.states import PlatformState, StateChange


def describe_call(method: str, arguments: Mapping[str, object]) -> str:
    """Return a call as text: `method(name=value, …)`."""
    return f"{method}({', '.join(f'{name}={describe(value)}' for name, value in arguments.items())})"


def describe(value: object) -> str:
    """Return a value as shortened source text."""
    if isinstance(value, enum.Enum):
        return f"{type(value).__name__}.{value.name}"
    if isinstance(value, bytes):
        return f"<{len(value)} bytes>"
    if isinstance(value, StateChange):
        return _describe_change(value)
    if isinstance(value, tuple):
        return f"({', '.join(map(describe, value))}{',' if len(value) == 1 else ''})"
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return _describe_dataclass(value)
    return repr(value)


def _describe_change(change: StateChange) -> str:
    if not isinstance(change.value, tuple):
        return describe(change.value)
    if change.type is PlatformState:
        return ", ".join(map(describe, change.value)) or "no PlatformState"
    first = change.value[0]
    if all(value == first for value in change.value):  # the same for all targets
        return describe(first)
    return f"{change.type.__name__} per target {describe(change.value)}"


def _describe_dataclass(value: object) -> str:
    """Return a value's name in its class (`Scissor.OFF`), or its source without fields that have their
    default."""
    name = type(value).__name__
    for constant, constant_value in vars(type(value)).items():
        if type(constant_value) is type(value) and constant_value == value:
            return f"{name}.{constant}"
    if hasattr(value, "emit"):  # a program in full would take pages
        return f"{name}({getattr(value, 'name', '')!r})"
    parts: list[str] = []
    gap = False
    for field in dataclasses.fields(value):  # type: ignore[arg-type]
        part = getattr(value, field.name)
        if field.default is not dataclasses.MISSING and part == field.default:
            gap = True
        else:
            parts.append(f"{field.name}={describe(part)}" if gap else describe(part))
    return f"{name}({', '.join(parts)})"
