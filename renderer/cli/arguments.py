"""Arguments that the commands share."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

import rhi
from renderer.visibility import Settings


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


def add_scene(parser: Parser) -> None:
    """`SCENE`."""
    parser.add_argument("scene", metavar="SCENE", help="a generator (see `scenes`) or a model file")


def add_backend(parser: Parser) -> None:
    """`--backend NAME`."""
    parser.add_argument(
        "--backend",
        metavar="NAME",
        help=f"{', '.join(rhi.backend_names())} (default: RHI_BACKEND, or the first that works)",
    )


def add_size(parser: Parser, size: tuple[int, int] = (960, 540), what: str = "of the image") -> None:
    """`--size WxH`."""
    help = f"{what} (default: {size[0]}x{size[1]})"
    parser.add_argument("--size", type=parse_size, default=size, metavar="WxH", help=help)


def add_walk(parser: Parser, what: str) -> None:
    """`--camera-path PATH`, `--frame N` and `--frames N`, which says how many frames do `what`."""
    parser.add_argument(
        "--camera-path",
        default="ground",
        metavar="PATH",
        help="ground, sky, or the .json file of a walk-through (default: %(default)s)",
    )
    parser.add_argument(
        "--frame",
        type=parse_frame,
        metavar="N",
        help="first frame, 60 a second (default: so that the frames lie around the path's middle)",
    )
    parser.add_argument(
        "--frames", type=parse_count, default=60, metavar="N", help=f"{what} (default: %(default)s)"
    )


def add_settings(parser: Parser) -> None:
    """`--settings FILE`; `load_settings` reads it."""
    parser.add_argument(
        "--settings",
        type=Path,
        metavar="F.json",
        help="numbers of the visibility algorithms, as `tune` finds them (default: b=50, n=20)",
    )


def load_settings(given: argparse.Namespace) -> Settings:
    """What `--settings` names, or the defaults."""
    return Settings() if given.settings is None else Settings.load(given.settings)


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
