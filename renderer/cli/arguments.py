"""Arguments that the commands share."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn


class Parser(argparse.ArgumentParser):
    """An argument parser whose errors are one line."""

    def __init__(self, **options: Any) -> None:
        super().__init__(formatter_class=argparse.RawDescriptionHelpFormatter, **options)

    def error(self, message: str) -> NoReturn:
        """Say what is wrong in one line, and exit with code 2."""
        print(f"error: {' '.join(message.split())} (see {self.prog} --help)", file=sys.stderr)
        sys.exit(2)


def add_command(
    commands: Any, name: str, run: Callable[[argparse.Namespace], None], summary: str, examples: str
) -> Parser:
    """A command's parser; `examples` end its help."""
    parser: Parser = commands.add_parser(
        name, help=summary, description=f"{summary[0].upper()}{summary[1:]}.", epilog=f"examples:\n{examples}"
    )
    parser.set_defaults(run=run)
    return parser


def add_settings(parser: Parser) -> None:
    """`--settings FILE`."""
    parser.add_argument(
        "--settings",
        type=Path,
        metavar="F.json",
        help="numbers of the visibility algorithms, as `tune` finds them (default: b=50, n=20)",
    )


def parse_size(text: str) -> tuple[int, int]:
    """`960x540` as (960, 540)."""
    width, _, height = text.lower().partition("x")
    if not (width.isascii() and width.isdigit() and height.isascii() and height.isdigit()):
        raise argparse.ArgumentTypeError(f"{text!r} is no size; give WIDTHxHEIGHT, such as 960x540")
    if not int(width) or not int(height):
        raise argparse.ArgumentTypeError(f"{text!r} is empty; give a width and a height of 1 or more")
    return int(width), int(height)


def parse_count(text: str) -> int:
    """A whole number of 1 or more."""
    if not (text.isascii() and text.isdigit() and int(text)):
        raise argparse.ArgumentTypeError(f"{text!r} is no whole number of 1 or more")
    return int(text)


def parse_frame(text: str) -> int:
    """A whole number of 0 or more."""
    if not (text.isascii() and text.isdigit()):
        raise argparse.ArgumentTypeError(f"{text!r} is no frame; give a whole number of 0 or more")
    return int(text)
