"""Options of the command line: their kinds, each defined once, and those that several commands share.

A kind gives an option its parser, its placeholder and the end of its help, "(default: …)". A command lists
its options: they are data, so a command is its name, its summary, its options and the function that runs it.
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
from rhi.errors.output_paths import check_output_file, check_output_folder

QUERY_KINDS: Final = ("native", "emulated")
"""The kinds of occlusion queries that `--queries` names."""

TECHNIQUE_VARIANTS: Final = {
    "all_lights": "forward evaluates all lights of the scene for each fragment, instead of its object's list",
    "light_volumes": "forward_multipass adds lights by their volumes, over the lit image",
    "stencil": "deferred and light_pre_pass mask each light in a stencil buffer",
    "tiled_transparency": "forward_plus lights transparent surfaces by lists of tiles, instead of their objects'",
    "depth_first": "clustered draws depth before, so that no hidden fragment is lit",
    "multi_pass": "deferred_plus shades each material by draws of its own",
    "object_rectangles": "the same in a rectangle for each material, around its objects' boxes",
    "binned": "deferred_plus shades lists of each material's pixels",
    "tiled": "deferred_plus lights pixels by the lists of tiles, instead of those of clusters",
}
"""Variants of some techniques that draw the same image: settings of `TechniqueSettings`, with their help."""


def parse_size(text: str) -> tuple[int, int]:
    """Parse "WIDTHxHEIGHT"."""
    width, _, height = text.lower().partition("x")
    if not (width.isascii() and width.isdigit() and height.isascii() and height.isdigit()):
        raise argparse.ArgumentTypeError(f"{text!r} is not a size; give WIDTHxHEIGHT, such as 960x540")
    if not int(width) or not int(height):
        raise argparse.ArgumentTypeError(f"{text!r} is empty; give a width and a height of 1 or more")
    return int(width), int(height)


def parse_number(text: str, allowed: Callable[[float], bool], description: str) -> float:
    """Parse a number that is `allowed`."""
    try:
        number = float(text)
    except ValueError:
        number = -1.0
    if not allowed(number):
        raise argparse.ArgumentTypeError(f"{text!r} is not {description}")
    return number


def parse_length(text: str) -> float:
    """Parse a length in metres: 0 or more, or inf."""
    return parse_number(text, lambda number: number >= 0.0, "a length in metres")


def parse_bound(text: str) -> float:
    """Parse a finite number above 0."""
    return parse_number(text, lambda number: 0.0 < number < float("inf"), "a number above 0")


def parse_weight(text: str) -> float:
    """Parse a finite number of 0 or more."""
    return parse_number(text, lambda number: 0.0 <= number < float("inf"), "a number of 0 or more")


def parse_count(text: str, minimum: int = 1) -> int:
    """Parse a whole number of `minimum` or more."""
    if not (text.isascii() and text.isdigit() and int(text) >= minimum):
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number of {minimum} or more")
    return int(text)


def parse_frame(text: str) -> int:
    """Parse a whole number of 0 or more."""
    return parse_count(text, 0)


def parse_names(choices: Collection[str], what: str) -> Callable[[str], list[str]]:
    """A parser of names between commas, each of which must be in `choices`."""

    def parse(text: str) -> list[str]:
        names = text.split(",")
        for name in names:
            if name not in choices:
                raise argparse.ArgumentTypeError(f"{name!r} {what}; give some of {', '.join(choices)}")
        return list(dict.fromkeys(names))

    return parse


@dataclass(frozen=True, eq=False, slots=True)
class CommandOption:
    """An argument of a command.

    Attributes:
        flag: the option's name.
        keywords: the keyword arguments of `add_argument`.
        group: options of one group exclude each other.
        output: of an option that names what will be written: checks the path before any work is done for it.
    """

    flag: str
    keywords: dict[str, Any]
    group: str = ""
    output: Callable[[Path, str], None] | None = None


def add_options(parser: argparse.ArgumentParser, options: Iterable[CommandOption]) -> None:
    """Add options to an argparse parser."""
    groups: dict[str, Any] = {"": parser}
    for command_option in options:
        if command_option.group not in groups:
            groups[command_option.group] = parser.add_mutually_exclusive_group()
        groups[command_option.group].add_argument(command_option.flag, **command_option.keywords)


def option(
    flag: str, help: str, default: Any = None, default_text: object = None, **keywords: Any
) -> CommandOption:
    """An option whose help ends with its default, or with `default_text` instead; "" shows none."""
    default_text = default if default_text is None else default_text
    ending = "" if default_text is None or default_text == "" else f" (default: {default_text})"
    return CommandOption(flag, {"help": help + ending, "default": default, **keywords})


def switch(flag: str, help: str) -> CommandOption:
    """A flag without a value."""
    return CommandOption(flag, {"help": help, "action": "store_true"})


def count(
    flag: str, help: str, default: int | None = None, default_text: object = None, minimum: int = 1
) -> CommandOption:
    """An option with a whole number of `minimum` or more."""
    return option(flag, help, default, default_text, type=partial(parse_count, minimum=minimum), metavar="N")


def length(flag: str, help: str, default_text: object = None) -> CommandOption:
    """An option with a length in metres."""
    return option(flag, help, None, default_text, type=parse_length, metavar="M")


def file(
    flag: str, help: str, form: str = "F.png", default: str | None = None, **keywords: Any
) -> CommandOption:
    """An option with the path of a file or folder."""
    return option(flag, help, None if default is None else Path(default), type=Path, metavar=form, **keywords)


def output_file(
    flag: str, help: str, form: str = "F.png", default: str | None = None, **keywords: Any
) -> CommandOption:
    """An option with the path of a file to write."""
    return replace(file(flag, help, form, default, **keywords), output=check_output_file)


def output_folder(flag: str, help: str, default: str | None = None) -> CommandOption:
    """An option with the path of a folder to write to."""
    return replace(file(flag, help, "DIR", default), output=check_output_folder)


def check_outputs(options: Iterable[CommandOption], arguments: argparse.Namespace) -> None:
    """Check the paths of all that a command will write.

    Raises:
        OutputPathError: nothing can be written to one of them.
    """
    for command_option in options:
        path = getattr(arguments, command_option.flag.lstrip("-").replace("-", "_"), None)
        if command_option.output is not None and path is not None:
            command_option.output(path, command_option.flag)


def choice(
    flag: str, help: str, choices: Iterable[str], default: Any = None, default_text: object = None
) -> CommandOption:
    """An option with one of some names."""
    return option(flag, help, default, default_text, choices=choices)


def names(
    flag: str,
    allowed: Collection[str],
    wrong: str,
    default: Sequence[str] | None = None,
    default_text: object = None,
    help: str = "",
) -> CommandOption:
    """An option with a list of names in `allowed`; `wrong` is the error for other names."""
    help = f"{help}some of {', '.join(allowed)}"
    default_text = default_text or ",".join(default or ())
    return option(flag, help, default, default_text, type=parse_names(allowed, wrong), metavar="A,B,…")


def values(
    flag: str, help: str, parse: Callable[[str], Any], default: list[Any], default_text: object, form: str
) -> CommandOption:
    """An option with a list of values between commas."""
    return option(
        flag,
        help,
        default,
        default_text,
        type=lambda text: [parse(part) for part in text.split(",")],
        metavar=form,
    )


SCENE: Final = option("scene", "a scene generator (see `scenes`) or a model file", metavar="SCENE")
BACKEND: Final = option(
    "--backend", ", ".join(rhi.backend_names()), None, "RHI_BACKEND, or the first that works", metavar="NAME"
)
PATH: Final = option(
    "--camera-path",
    "a path of the scene (ground, sky), or the .json file of a walk-through",
    "ground",
    metavar="PATH",
)
JSON: Final = switch("--json", "print the result as JSON")
QUERIES_HELP: Final = "occlusion queries: the device's own, or emulated by two counters and a fence"


def size(default: tuple[int, int] = (960, 540), what: str = "size of the image in pixels") -> CommandOption:
    """The option `--size WxH`; `what` says what has that size."""
    return option("--size", what, default, "{}x{}".format(*default), type=parse_size, metavar="WxH")


def camera(default: str | None = None, default_text: object = None) -> CommandOption:
    """The option `--camera CAMERA`; `default_text` describes the default."""
    default_text = default_text or default or "the scene's first view"
    return option(
        "--camera",
        "a path (ground, sky), the .json file of a walk-through, a view of the scene, a position x,y,z, or "
        "a position and a target x,y,z,x,y,z",
        default,
        default_text,
        metavar="CAMERA",
    )


def frame(
    what: str = "first frame of the path", default: int | None = 0, default_text: object = None
) -> CommandOption:
    """The option `--frame N`; `what` says which frame it is."""
    return count("--frame", what, default, default_text, minimum=0)


def frames(default: int | None, what: str = "number of frames") -> CommandOption:
    """The option `--frames N`; `what` says what it counts."""
    return count("--frames", what, default)


def rounds(what: str, default: int = 5) -> CommandOption:
    """The option `--rounds N`; `what` says what it counts."""
    return count("--rounds", what, default)


def path_range(what: str) -> tuple[CommandOption, ...]:
    """The options of commands that draw a part of a path: its first frame and its length."""
    middle = "the frames lie around the path's middle"
    return PATH, frame("first frame of the path, at 60 a second", None, middle), frames(60, what)


def form(what: str = "table") -> tuple[CommandOption, ...]:
    """The options for how a result is printed."""
    as_markdown = switch("--markdown", f"print the {what} as Markdown")
    return tuple(replace(form_option, group="form") for form_option in (JSON, as_markdown))


def chart(what: str = "the times") -> CommandOption:
    """The option for a chart; `what` says what it shows."""
    return output_file("--plot", f"write a chart of {what}")


def settings(what: str, default_text: object = None) -> CommandOption:
    """The option `--settings F.json`; `what` says what the file has, `default_text` describes the default."""
    return option("--settings", what, None, default_text, type=Path, metavar="F.json")


def queries(default_text: str) -> CommandOption:
    """The option `--queries KIND`; `default_text` describes the default."""
    return choice("--queries", QUERIES_HELP, QUERY_KINDS, None, default_text)


def visibility(default: str | None, default_text: object = None, flag: str = "--visibility") -> CommandOption:
    """The option that names a visibility algorithm."""
    return choice(flag, "what decides which objects are drawn", ALGORITHMS, default, default_text)


TEXTURE_MEMORY: Final = option(
    "--texture-memory",
    "the most MiB of images; they have the mip levels that are read, as far as they fit",
    None,
    "all levels",
    type=parse_weight,
    metavar="MIB",
)


def technique(name: str = AutoTechnique.name, *, has_defaults: bool = True) -> tuple[CommandOption, ...]:
    """The options of a technique; without `has_defaults`, options that aren't set leave the value to a
    settings file."""
    how = "how the scene is drawn; auto tries a few and takes the fastest"
    smooth = "samples per pixel, which smooth edges; with more than one, auto is forward"
    return (
        choice("--technique", how, [AutoTechnique.name, *TECHNIQUES], name if has_defaults else None, name),
        count("--samples", smooth, 1 if has_defaults else None, 1),
        switch("--fxaa", "smooth the edges of the image, with any technique"),
        *(switch(f"--{name.replace('_', '-')}", help) for name, help in TECHNIQUE_VARIANTS.items()),
    )


STEREO_OUTPUT: Final = choice(
    "--stereo", "draw two eyes, and show them like this (python -m rhi docs stereo)", OUTPUTS
)
STEREO: Final = (
    STEREO_OUTPUT,
    length("--eye-distance", "metres between the eyes", "comfortable for the first frame, at most 0.063"),
    length(
        "--convergence",
        "metres from the eyes to the screen, where there is no parallax",
        "in the middle of what is seen",
    ),
    switch("--swap-eyes", "show each image to the other eye"),
    switch("--toe-in", "toe in the eyes, to demonstrate the distortion"),
    switch("--reproject", "reproject the right eye's image from the left one's"),
    option(
        "--far-error",
        "draw far objects once for both eyes, their parallax wrong by at most so many pixels",
        None,
        "the settings', 0: each eye draws all",
        type=parse_weight,
        metavar="N",
    ),
)
DEPTH: Final = choice(
    "--depth",
    "direction of depth: reversed has near at 1, standard has near at 0",
    [member.value for member in Depth],
    None,
    "the settings', reversed",
)
TEMPORAL: Final = switch("--temporal", "smooth edges by the samples of many frames (temporal anti-aliasing)")
BLENDING: Final = choice(
    "--blending",
    "transparent surfaces are drawn back to front, or averaged in any order",
    [member.value for member in Blending],
    None,
    "the settings', sorted",
)


def executor(what: str, kinds: str) -> CommandOption:
    """The option `--executor E`; `what` says what runs there, with its verb, and `kinds` lists the
    executors."""
    return option("--executor", f"where {what}: {kinds} of a scheduler", "serial", metavar="E")
