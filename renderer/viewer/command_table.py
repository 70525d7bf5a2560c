"""The table of the viewer's commands, which keys, the console, script files and the socket all use.

A command is a line of words: a name and arguments. Errors name the nearest words.
"""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any, Final, NoReturn

from renderer import rules
from rhi.errors import Rule, refuse

_MAX_LISTED: Final = 4  # words that errors list even if none is near

Words = Callable[[], Iterable[str]]


@dataclass(frozen=True, slots=True)
class Parameter:
    """An argument of a command.

    Attributes:
        name: its name in the help.
        parse: parses a word, or raises ValueError.
        words: the words for completion; if `is_exhaustive`, no others are allowed.
        is_optional: whether it may be left out; all after it may be left out, too.
    """

    name: str
    parse: Callable[[str], Any] = str
    words: Words | None = None
    is_exhaustive: bool = False
    is_optional: bool = False

    def read(self, call: str, word: str) -> Any:
        """The value of a word."""
        if self.words is not None and self.is_exhaustive and word not in (words := list(self.words())):
            refuse_word(rules.BAD_ARGUMENT, call, word, words)
        try:
            return self.parse(word)
        except ValueError:
            refuse(rules.BAD_ARGUMENT, call, word, self.name)


@dataclass(frozen=True, slots=True)
class ViewerCommand:
    """A command of the viewer.

    Attributes:
        name: the first word.
        summary: a sentence for the help.
        run: executes the command with the parameters' values, and returns its message.
    """

    name: str
    summary: str
    run: Callable[..., str]
    parameters: tuple[Parameter, ...] = ()

    @property
    def usage(self) -> str:
        """The command as it is typed, such as `camera NAME`; optional parameters are in brackets."""
        words = [
            f"[{parameter.name}]" if parameter.is_optional else parameter.name
            for parameter in self.parameters
        ]
        return " ".join([self.name, *words])


class CommandTable:
    """The viewer's commands, by name."""

    def __init__(self, commands: Iterable[ViewerCommand]) -> None:
        self._commands: Final = {command.name: command for command in commands}

    def __iter__(self) -> Iterator[ViewerCommand]:
        """Iterate over the commands, in the order of the help."""
        return iter(self._commands.values())

    def __getitem__(self, name: str) -> ViewerCommand:
        """The command of this name; other names are refused with the nearest one."""
        if name not in self._commands:
            refuse_word(rules.UNKNOWN_COMMAND, "command", name, self._commands)
        return self._commands[name]

    def add(self, command: ViewerCommand) -> None:
        """Add a command, such as that of a screen."""
        self._commands[command.name] = command

    def run(self, line: str) -> str:
        """Run a line and return its message. An empty line, or a comment that begins with #, does nothing.

        Raises:
            ValidationError: `viewer-unknown-command` or `viewer-bad-argument`, or what the command refuses.
        """
        words = split_line(line)
        if not words:
            return ""
        command, arguments = self[words[0]], words[1:]
        most = len(command.parameters)
        least = sum(not parameter.is_optional for parameter in command.parameters)
        if not least <= len(arguments) <= most:
            refuse(rules.BAD_ARGUMENT, command.name, f"{len(arguments)} arguments", command.usage)
        values = [
            parameter.read(command.name, word)
            for parameter, word in zip(command.parameters, arguments, strict=False)
        ]
        return command.run(*values)

    def complete(self, line: str) -> list[str]:
        """The words that complete the last word of `line`."""
        before, _, typed = line.rpartition(" ")
        words = before.split()
        if not words:
            return sorted(name for name in self._commands if name.startswith(typed))
        command = self._commands.get(words[0])
        number = len(words) - 1
        if command is None or number >= len(command.parameters):
            return []
        list_words = command.parameters[number].words
        return (
            sorted({word for word in list_words() if word.startswith(typed)})
            if list_words is not None
            else []
        )


def refuse_word(rule: Rule, call: str, word: str, words: Iterable[str]) -> NoReturn:
    """Refuse a word, listing the nearest ones; Tab lists the others."""
    words = list(words)
    near = get_close_matches(word.lower(), words, n=3, cutoff=0.5) or (
        words if len(words) <= _MAX_LISTED else []
    )
    refuse(rule, call, word, "", f"did you mean {' or '.join(near)}?" if near else "")


def split_line(line: str) -> list[str]:
    """The words of a line, with quotes as in a shell; a comment has none."""
    try:
        return shlex.split(line, comments=True)
    except ValueError as error:
        refuse(rules.BAD_ARGUMENT, "command", line, f"quotes that are closed: {error}")


def common_start(words: Iterable[str]) -> str:
    """The longest prefix that all words share."""
    words = list(words)
    least, most = min(words), max(words)
    for number, (first_letter, last_letter) in enumerate(zip(least, most, strict=False)):
        if first_letter != last_letter:
            return least[:number]
    return least
