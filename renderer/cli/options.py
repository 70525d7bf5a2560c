"""Options of the command line: their kinds, each said once, and those that several commands share.

A kind gives an option its parser, its placeholder and the end of its help, "(default: …)". A command lists its options:
they are data, so a command is its name, its summary, its options and the function that runs it.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import rhi
from renderer.frame import Blending
from renderer.scene import Depth
from renderer.stereo import OUTPUTS
from renderer.techniques import TECHNIQUES, AutoTechnique
from renderer.visibility import ALGORITHMS

QUERY_KINDS: Final = ("native", "emulated")
"""The kinds of occlusion queries that `--queries` names."""

WAYS: Final = {
    "all_lights": "forward looks at all lights of the scene for each fragment, instead of those of its object's list",
    "stencil": "deferred and light_pre_pass mask each light in a stencil buffer",
    "depth_first": "clustered draws depth before, so that no hidden fragment is lit",
    "multi_pass": "deferred_plus shades each material by draws of its own",
    "binned": "deferred_plus shades lists of each material's pixels",
}
"""Other ways of some techniques to the same picture, settings of `TechniqueSettings`."""


def parse_size(text: str) -> tuple[int, int]:
    """Parse "WIDTHxHEIGHT"."""
    width, _, height = text.lower().partition("x")
    if not (width.isascii() and width.isdigit() and height.isascii() and height.isdigit()):
        raise argparse.ArgumentTypeError(f"{text!r} is not a size; give WIDTHxHEIGHT, such as 960x540")
    if not int(width) or not int(height):
        raise argparse.ArgumentTypeError(f"{text!r} is empty; give a width and a height of 1 or more")
    return int(width), int(height)


def parse_number(text: str, allowed: Callable[[float], bool], wanted: str) -> float:
    """Parse a number that is `allowed`."""
    try:
        number = float(text)
    except ValueError:
        number = -1.0
    if not allowed(number):
        raise argparse.ArgumentTypeError(f"{text!r} is not {wanted}")
    return number


def parse_length(text: str) -> float:
    """Parse a length in metres: 0 or more, or inf."""
    return parse_number(text, lambda number: number >= 0.0, "a length in metres")


def parse_bound(text: str) -> float:
    """Parse a finite number above 0."""
    return parse_number(text, lambda number: 0.0 < number < float("inf"), "a number above 0")


def parse_count(text: str, least: int = 1) -> int:
    """Parse a whole number of `least` or more."""
    if not (text.isascii() and text.isdigit() and int(text) >= least):
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number of {least} or more")
    return int(text)


def parse_frame(text: str) -> int:
    """Parse a whole number of 0 or more."""
    return parse_count(text, 0)


def parse_names(known: Collection[str], what: str) -> Callable[[str], list[str]]:
    """Return a parser of names between commas, each of which must be in `known`."""

    def parse(text: str) -> list[str]:
        names = text.split(",")
        for name in names:
            if name not in known:
                raise argparse.ArgumentTypeError(f"{name!r} {what}; give some of {', '.join(known)}")
        return list(dict.fromkeys(names))

    return parse


@dataclass(frozen=True, eq=False, slots=True)
class CommandOption:
    """An argument of a command.

    Attributes:
        flag: its name.
        told: what argparse is told of it.
        group: options of one group exclude each other.
    """

    flag: str
    told: dict[str, Any]
    group: str = ""


def add_options(parser: argparse.ArgumentParser, options: Iterable[CommandOption]) -> None:
    """Let a parser read options."""
    groups: dict[str, Any] = {"": parser}
    for one in options:
        if one.group not in groups:
            groups[one.group] = parser.add_mutually_exclusive_group()
        groups[one.group].add_argument(one.flag, **one.told)


def option(flag: str, help: str, default: Any = None, shown: object = None, **told: Any) -> CommandOption:
    """Return an option whose help ends with its default, or with `shown` in its place; "" ends it without."""
    shown = default if shown is None else shown
    ending = "" if shown is None or shown == "" else f" (default: {shown})"
    return CommandOption(flag, {"help": help + ending, "default": default, **told})


def switch(flag: str, help: str) -> CommandOption:
    """Return an option that is given or not."""
    return CommandOption(flag, {"help": help, "action": "store_true"})


def count(flag: str, help: str, default: int | None = None, shown: object = None, least: int = 1) -> CommandOption:
    """Return an option that is a whole number of `least` or more."""
    return option(flag, help, default, shown, type=partial(parse_count, least=least), metavar="N")


def length(flag: str, help: str, shown: object = None) -> CommandOption:
    """Return an option that is a length in metres."""
    return option(flag, help, None, shown, type=parse_length, metavar="M")


def file(flag: str, help: str, form: str = "F.png", default: str | None = None, **told: Any) -> CommandOption:
    """Return an option that is the path of a file or folder."""
    return option(flag, help, None if default is None else Path(default), type=Path, metavar=form, **told)


def choice(flag: str, help: str, known: Iterable[str], default: Any = None, shown: object = None) -> CommandOption:
    """Return an option that is one of some names."""
    return option(flag, help, default, shown, choices=known)


def some(flag: str, known: Collection[str], wrong: str, default: Sequence[str] | None = None,
         shown: object = None, help: str = "") -> CommandOption:  # fmt: skip
    """Return an option that is a list of some of `known`; `wrong` says what another isn't."""
    help = f"{help}some of {', '.join(known)}"
    shown = shown or ",".join(default or ())
    return option(flag, help, default, shown, type=parse_names(known, wrong), metavar="A,B,…")


def several(
    flag: str, help: str, parse: Callable[[str], Any], default: list[Any], shown: object, form: str
) -> CommandOption:
    """Return an option that is a list of values between commas."""
    return option(flag, help, default, shown, type=lambda text: [parse(part) for part in text.split(",")], metavar=form)


SCENE: Final = option("scene", "a scene generator (see `scenes`) or a model file", metavar="SCENE")
BACKEND: Final = option(
    "--backend", ", ".join(rhi.backend_names()), None, "RHI_BACKEND, or the first that works", metavar="NAME"
)
PATH: Final = option(
    "--camera-path", "a path of the scene (ground, sky), or the .json file of a walk-through", "ground", metavar="PATH"
)
JSON: Final = switch("--json", "print the result as JSON")
QUERIES_HELP: Final = "occlusion queries: the device's own, or emulated by two counters and a fence"


def size(default: tuple[int, int] = (960, 540), what: str = "size of the image in pixels") -> CommandOption:
    """Return the option `--size WxH`; `what` says what has that size."""
    return option("--size", what, default, "{}x{}".format(*default), type=parse_size, metavar="WxH")


def camera(default: str | None = None, shown: object = None) -> CommandOption:
    """Return the option `--camera CAMERA`; `shown` says what holds without it."""
    shown = shown or default or "the scene's first view"
    return option(
        "--camera", "a path (ground, sky), the .json file of a walk-through, a view of the scene, a position x,y,z, or "
        "a position and a target x,y,z,x,y,z", default, shown, metavar="CAMERA",
    )  # fmt: skip


def frame(what: str = "first frame of the path", default: int | None = 0, shown: object = None) -> CommandOption:
    """Return the option `--frame N`; `what` says which frame it is."""
    return count("--frame", what, default, shown, least=0)


def frames(default: int | None, what: str = "number of frames") -> CommandOption:
    """Return the option `--frames N`; `what` says what it counts."""
    return count("--frames", what, default)


def rounds(what: str, default: int = 5) -> CommandOption:
    """Return the option `--rounds N`; `what` says what it counts."""
    return count("--rounds", what, default)


def walk(what: str) -> tuple[CommandOption, ...]:
    """Return the options of commands that draw a part of a path: where it begins and how long it is."""
    middle = "the frames lie around the path's middle"
    return PATH, frame("first frame of the path, at 60 a second", None, middle), frames(60, what)


def form(what: str = "table") -> tuple[CommandOption, ...]:
    """Return the options for how a result is printed."""
    as_markdown = switch("--markdown", f"print the {what} as Markdown")
    return tuple(replace(one, group="form") for one in (JSON, as_markdown))


def chart(what: str = "the times") -> CommandOption:
    """Return the option for a chart; `what` is what it shows."""
    return file("--plot", f"write a chart of {what}")


def settings(what: str, shown: object = None) -> CommandOption:
    """Return the option `--settings F.json`; `what` says what the file has, `shown` what holds without it."""
    return option("--settings", what, None, shown, type=Path, metavar="F.json")


def queries(shown: str) -> CommandOption:
    """Return the option `--queries KIND`; `shown` says what holds without it."""
    return choice("--queries", QUERIES_HELP, QUERY_KINDS, None, shown)


def visibility(default: str | None, shown: object = None, flag: str = "--visibility") -> CommandOption:
    """Return the option that names an algorithm of visibility."""
    return choice(flag, "what decides which objects are drawn", ALGORITHMS, default, shown)


def technique(name: str = AutoTechnique.name, *, is_given: bool = True) -> tuple[CommandOption, ...]:
    """Return the options of a technique; not `is_given` leaves what isn't asked for to a file of settings."""
    how = "how the scene is drawn; auto tries a few and takes the fastest"
    smooth = "samples per pixel, which smooth edges; with more than one, auto is forward"
    return (
        choice("--technique", how, [AutoTechnique.name, *TECHNIQUES], name if is_given else None, name),
        count("--samples", smooth, 1 if is_given else None, 1),
        switch("--fxaa", "smooth the edges of the image, with any technique"),
        *(switch(f"--{name.replace('_', '-')}", help) for name, help in WAYS.items()),
    )


STEREO_OUTPUT: Final = choice("--stereo", "draw two eyes, and show them like this (docs/stereo.md)", OUTPUTS)
STEREO: Final = (
    STEREO_OUTPUT,
    length("--eye-distance", "metres between the eyes", "comfortable for the first frame, at most 0.063"),
    length("--convergence", "metres from the eyes to the screen, where there is no parallax",
           "in the middle of what is seen"),
    switch("--swap-eyes", "show each picture to the other eye"),
    switch("--toe-in", "turn the eyes towards each other, to see why not"),
    switch("--reproject", "make the right eye's picture of the left one's"),
)  # fmt: skip
DEPTH: Final = choice(
    "--depth", "direction of depth: reversed has near at 1, standard has near at 0", [one.value for one in Depth], None,
    "the settings', reversed",
)  # fmt: skip
BLENDING: Final = choice(
    "--blending", "transparent surfaces are drawn back to front, or averaged in any order",
    [one.value for one in Blending], None, "the settings', sorted",
)  # fmt: skip


def executor(what: str, kinds: str) -> CommandOption:
    """Return the option `--executor E`; `what` runs there, and `kinds` says where that can be."""
    return option("--executor", f"where {what} run: {kinds} of a scheduler", "serial", metavar="E")
