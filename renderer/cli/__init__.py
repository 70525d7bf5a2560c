"""The command line: `python -m renderer render|demo|compare|tune|debug|scenes`.

Results go to stdout, all else to stderr. Whatever is wrong with the input ends in one line, `error: …`, and
exit code 2.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import NoReturn

from renderer.cli import compare, debug, demo, render, scenes, tune
from renderer.cli.arguments import Parser
from renderer.cli.output import OutputError, show_builds
from rhi import RhiError

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit code."""
    parser = Parser(
        prog="python -m renderer",
        description="Render a scene and say what it cost.",
        epilog="python -m renderer COMMAND --help says more, with examples.",
    )
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    for command in (render, demo, compare, tune, debug, scenes):
        command.add_to(commands)
    given = parser.parse_args(_join_negative(list(sys.argv[1:] if arguments is None else arguments)))
    show_builds()
    try:
        run = given.run
        run(given)
    except RhiError as error:
        _fail(_in_one_line(error))
    except (OutputError, OSError) as error:
        _fail(str(error))
    except ModuleNotFoundError as error:
        _fail(f"{error.name} is missing; install it with: pip install 'rhi[renderer]'")
    except KeyboardInterrupt:
        return 130
    return 0


def _join_negative(arguments: list[str]) -> list[str]:
    """`--camera -1,2,3` as `--camera=-1,2,3`, because argparse takes `-1,2,3` for an option."""
    joined: list[str] = []
    for argument in arguments:
        if joined and joined[-1] == "--camera" and argument[:1] == "-" and argument[1:2] in "0123456789.":
            joined[-1] += f"={argument}"
        else:
            joined.append(argument)
    return joined


def _in_one_line(error: RhiError) -> str:
    allowed = f" (allowed: {error.allowed})" if error.allowed else ""
    given = f": {error.given}" if error.given else ""
    tip = f"; {error.tip}" if error.tip else ""
    return f"{error.rule.sentence.rstrip('.')}{given}{allowed}{tip} [{error.rule.id}]"


def _fail(message: str) -> NoReturn:
    print(f"error: {' '.join(message.split())}", file=sys.stderr)
    sys.exit(2)
