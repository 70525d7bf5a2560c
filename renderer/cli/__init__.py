"""The command line: `python -m renderer COMMAND`, with the commands that are listed in `COMMANDS`.

Results go to stdout, everything else to stderr. Bad input ends in one line, `error: …`, and exit code 2. A
reader that goes away, as in `… --json | head`, ends a command quietly with exit code 141
(`rhi.errors.pipes`).
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Final, NoReturn

from renderer import rules
from renderer.cli import (
    accuracy,
    assets,
    capture,
    compare_backends,
    compare_buffers,
    compare_deferred_plus,
    compare_encodings,
    compare_light_culling,
    compare_stereo,
    compare_techniques,
    compare_visibility,
    convert,
    debug_reprojection,
    debug_visibility,
    demo,
    effect_costs,
    exam,
    film,
    plan,
    ray_trace,
    render,
    scenes,
    tune,
    view,
)
from renderer.cli.output import OutputError, show_builds
from renderer.cli.subcommand import Parser, Subcommand, SubcommandGroup
from rhi import RhiError

__all__ = ["COMMANDS", "main"]

COMMANDS: Final[tuple[Subcommand | SubcommandGroup, ...]] = (
    render.COMMAND,
    view.COMMAND,
    demo.COMMAND,
    film.COMMAND,
    ray_trace.COMMAND,
    SubcommandGroup(
        "compare",
        "compare techniques, visibility algorithms, tests of light culling, one eye and two, geometry buffers, "
        "encodings, or backends",
        (
            compare_techniques.COMMAND,
            compare_visibility.COMMAND,
            compare_light_culling.COMMAND,
            compare_deferred_plus.COMMAND,
            compare_stereo.COMMAND,
            compare_buffers.COMMAND,
            compare_encodings.COMMAND,
            compare_backends.COMMAND,
        ),
    ),
    plan.COMMAND,
    effect_costs.COMMAND,
    capture.COMMAND,
    accuracy.COMMAND,
    tune.COMMAND,
    exam.COMMAND,
    SubcommandGroup(
        "debug", "draw what the renderer does", (debug_visibility.COMMAND, debug_reprojection.COMMAND)
    ),
    convert.COMMAND,
    assets.COMMAND,
    scenes.COMMAND,
)
"""All commands, in the order of the help."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command that `arguments` name (the process's by default) and return the exit code."""
    parser = Parser(
        prog="python -m renderer",
        description="Render a scene and report what it cost.",
        epilog="python -m renderer COMMAND --help says more, with examples.",
    )
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    for command in COMMANDS:
        command.add_to(commands)
    parsed = parser.parse_args(_join_negative(list(sys.argv[1:] if arguments is None else arguments)))
    show_builds()
    try:
        parsed.run(parsed)
    except RhiError as error:
        _fail(rules.describe(error))
    except BrokenPipeError:
        raise  # the reader of the output has gone away
    except (OutputError, OSError) as error:
        _fail(str(error))
    except ModuleNotFoundError as error:  # the viewer's extra has all that the renderer's has
        extra = "viewer" if parsed.run is view.COMMAND.run else "renderer"
        _fail(rules.describe_missing(error.name, extra))
    except KeyboardInterrupt:
        return 130
    return 0


def _join_negative(arguments: list[str]) -> list[str]:
    """Join `--camera -1,2,3` to `--camera=-1,2,3`, because argparse would read `-1,2,3` as an option."""
    joined: list[str] = []
    for argument in arguments:
        if joined and joined[-1] == "--camera" and argument[:1] == "-" and argument[1:2] in "0123456789.":
            joined[-1] += f"={argument}"
        else:
            joined.append(argument)
    return joined


def _fail(message: str) -> NoReturn:
    print(f"error: {' '.join(message.split())}", file=sys.stderr)
    sys.exit(2)
