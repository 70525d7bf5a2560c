"""The parts of a failed assertion's message."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Final, NoReturn

from rhi.commands.stream import Command

MAX_SHOWN: Final = 5
"""Maximum number of commands in each list of a message."""

_INDENT: Final = " " * 10


def show_command(command: Command) -> str:
    """Return the line of a message that shows a command."""
    return f"  {command.index:>6}  {command}"


def show_commands(title: str, commands: Collection[Command], remarks: Mapping[int, str] | None = None) -> str:
    """Return a titled list of commands for a message; "" if there are none.

    Args:
        remarks: what is said below a command, by its index.
    """
    if not len(commands):
        return ""
    lines = []
    for command in list(commands)[:MAX_SHOWN]:
        lines.append(show_command(command))
        if remarks is not None:
            lines.append(f"{_INDENT}{remarks[command.index]}")
    if len(commands) > MAX_SHOWN:
        lines.append(f"{_INDENT}… and {len(commands) - MAX_SHOWN} more")
    return f"{title}:\n" + "\n".join(lines)


def fail(*parts: str) -> NoReturn:
    """Raise an AssertionError whose message is made of these parts, empty ones left out."""
    __tracebackhide__ = True
    raise AssertionError("\n".join(part for part in parts if part))
