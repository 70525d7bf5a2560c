"""Commands of the command line: each module defines one, and `renderer.cli.COMMANDS` lists them all."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NoReturn

from renderer.cli.options import CommandOption, add_options, check_outputs


class Parser(argparse.ArgumentParser):
    """An argument parser that reports errors in one line."""

    def __init__(self, **options: Any) -> None:
        super().__init__(formatter_class=argparse.RawDescriptionHelpFormatter, **options)

    def error(self, message: str) -> NoReturn:
        """Print the error in one line and exit with code 2."""
        print(f"error: {' '.join(message.split())} (see {self.prog} --help)", file=sys.stderr)
        sys.exit(2)


@dataclass(frozen=True, slots=True)
class Subcommand:
    """A command of the command line.

    Attributes:
        summary: one line for the list of commands; it begins the command's own help.
        options: the command's arguments.
        run: executes the command with its parsed arguments.
        notes: the docstring of the command's module. After its first line it has examples, and says what the
            results
            mean: the end of the command's help. None where Python keeps no docstrings.
    """

    name: str
    summary: str
    options: Sequence[CommandOption]
    run: Callable[[argparse.Namespace], None]
    notes: str | None

    def add_to(self, commands: Any) -> None:
        """Add the command's parser to `commands`, the result of `add_subparsers`."""
        examples = (self.notes or "").partition("\n\n")[2].rstrip()
        parser = commands.add_parser(
            self.name, help=self.summary, description=_sentence(self.summary), epilog=f"examples:\n{examples}"
        )
        add_options(parser, self.options)
        parser.set_defaults(run=self._check_and_run)

    def _check_and_run(self, arguments: argparse.Namespace) -> None:
        check_outputs(self.options, arguments)
        self.run(arguments)


@dataclass(frozen=True, slots=True)
class SubcommandGroup:
    """Commands with a common first word, such as `compare visibility` and `compare backends`."""

    name: str
    summary: str
    members: tuple[Subcommand, ...]

    def add_to(self, commands: Any) -> None:
        """Add the parsers of all members to `commands`, the result of `add_subparsers`."""
        parser = commands.add_parser(
            self.name,
            help=self.summary,
            description=_sentence(self.summary),
            epilog=f"python -m renderer {self.name} SUBJECT --help says more, with examples.",
        )
        subjects = parser.add_subparsers(metavar="SUBJECT", required=True)
        for member in self.members:
            member.add_to(subjects)


def _sentence(summary: str) -> str:
    return f"{summary[0].upper()}{summary[1:]}."
