"""Commands: what a viewer can be told, in one table, by keys, the console, script files and a socket alike.

A command is a line of words: a name and arguments. Faults are refused in a sentence that names the nearest words.
"""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any, Final, NoReturn

from renderer import rules
from rhi.errors import Rule, refuse

_FEW: Final = 4  # words that are named even if none is near

Words = Callable[[], Iterable[str]]


@dataclass(frozen=True, slots=True)
class Parameter:
    """An argument of a command.

    Attributes:
        name: the word for it in the help. parse: makes its value of a word, or raises ValueError.
        words: the words that are known, for completion; if `is_closed`, no others are allowed.
        is_optional: whether it may be left out; all after it may be left out, too.
    """

    name: str
    parse: Callable[[str], Any] = str
    words: Words | None = None
    is_closed: bool = False
    is_optional: bool = False

    def read(self, call: str, word: str) -> Any:
        """Return the value of a word."""
        if self.words is not None and self.is_closed and word not in (known := list(self.words())):
            refuse_word(rules.BAD_ARGUMENT, call, word, known)
        try:
            return self.parse(word)
        except ValueError:
            refuse(rules.BAD_ARGUMENT, call, word, self.name)


@dataclass(frozen=True, slots=True)
class ViewerCommand:
    """A thing that a viewer can be told.

    Attributes:
        name: the first word. summary: a sentence for the help.
        run: does it, given the values of the parameters, and returns what it has to say.
    """

    name: str
    summary: str
    run: Callable[..., str]
    parameters: tuple[Parameter, ...] = ()

    @property
    def usage(self) -> str:
        """The command as it is written, such as `camera NAME`; what may be left out is in brackets."""
        words = [f"[{one.name}]" if one.is_optional else one.name for one in self.parameters]
        return " ".join([self.name, *words])


class CommandTable:
    """The viewer's commands, by name."""

    def __init__(self, commands: Iterable[ViewerCommand]) -> None:
        self._commands: Final = {command.name: command for command in commands}

    def __iter__(self) -> Iterator[ViewerCommand]:
        """Iterate over the commands, in the order of the help."""
        return iter(self._commands.values())

    def __getitem__(self, name: str) -> ViewerCommand:
        """Return the command of this name, or refuse it with the nearest one."""
        if name not in self._commands:
            refuse_word(rules.UNKNOWN_COMMAND, "command", name, self._commands)
        return self._commands[name]

    def run(self, line: str) -> str:
        """Run a line and return what it says. An empty one, or a comment that begins with #, does nothing.

        Raises:
            ValidationError: `viewer-unknown-command` or `viewer-bad-argument`, or what the command refuses.
        """
        words = split_line(line)
        if not words:
            return ""
        command, given = self[words[0]], words[1:]
        most = len(command.parameters)
        least = sum(not one.is_optional for one in command.parameters)
        if not least <= len(given) <= most:
            refuse(rules.BAD_ARGUMENT, command.name, f"{len(given)} arguments", command.usage)
        values = [one.read(command.name, word) for one, word in zip(command.parameters, given, strict=False)]
        return command.run(*values)

    def complete(self, line: str) -> list[str]:
        """Return the words that may end `line`: its last word is their beginning."""
        before, _, begun = line.rpartition(" ")
        words = before.split()
        if not words:
            return sorted(name for name in self._commands if name.startswith(begun))
        command = self._commands.get(words[0])
        number = len(words) - 1
        if command is None or number >= len(command.parameters):
            return []
        known = command.parameters[number].words
        return sorted({word for word in known() if word.startswith(begun)}) if known is not None else []


def refuse_word(rule: Rule, call: str, word: str, known: Iterable[str]) -> NoReturn:
    """Refuse a word, naming those that are near to it; Tab lists the others."""
    known = list(known)
    near = get_close_matches(word.lower(), known, n=3, cutoff=0.5) or (known if len(known) <= _FEW else [])
    refuse(rule, call, word, "", f"did you mean {' or '.join(near)}?" if near else "")


def split_line(line: str) -> list[str]:
    """Return the words of a line, with quotes as in a shell; none of a comment."""
    try:
        return shlex.split(line, comments=True)
    except ValueError as error:
        refuse(rules.BAD_ARGUMENT, "command", line, f"quotes that are closed: {error}")


def common_start(words: Iterable[str]) -> str:
    """Return the longest beginning that all words share."""
    words = list(words)
    least, most = min(words), max(words)
    for number, (one, other) in enumerate(zip(least, most, strict=False)):
        if one != other:
            return least[:number]
    return least
