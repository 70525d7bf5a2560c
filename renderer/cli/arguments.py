"""Arguments that several commands share, and how their texts are parsed."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Collection
from dataclasses import replace
from pathlib import Path
from typing import Final

import rhi
from renderer import rules
from renderer.cli.output import note
from renderer.cli.subcommand import Parser
from renderer.content import load_scene
from renderer.frame import Blending
from renderer.scene import Camera, Depth, Scene
from renderer.settings import RenderSettings
from renderer.stereo import OUTPUTS, Stereo, find_rig
from renderer.techniques import TECHNIQUES, AutoTechnique, Technique, TechniqueSettings
from rhi import refuse

PATH_HELP: Final = (
    "a path of the scene (ground, sky), or the .json file of a walk-through (default: %(default)s)"
)
CAMERA_HELP: Final = (
    "a path (ground, sky), the .json file of a walk-through, a view of the scene, a position x,y,z, or a position and "
    "a target x,y,z,x,y,z"
)
SETTINGS_HELP: Final = (
    "file with the parameters of the visibility algorithms, written by `tune` or `accuracy` (default: b=50, n=20)"
)
QUERY_KINDS: Final = ("native", "emulated")
"""The kinds of occlusion queries that `--queries` names."""
DECIDES: Final = "what decides which objects are drawn (default: %(default)s)"


def add_scene(parser: Parser) -> None:
    """Add `SCENE`."""
    parser.add_argument("scene", metavar="SCENE", help="a scene generator (see `scenes`) or a model file")


def open_scene(text: str) -> Scene:
    """Load the scene that `SCENE` names; what its file has and the scene hasn't is listed on stderr."""
    scene = load_scene(text)
    for omission in scene.omissions:
        note(f"left out: {omission}")
    return scene


def add_backend(parser: Parser) -> None:
    """Add `--backend NAME`."""
    parser.add_argument(
        "--backend",
        metavar="NAME",
        help=f"{', '.join(rhi.backend_names())} (default: RHI_BACKEND, or the first that works)",
    )


def add_size(
    parser: Parser, size: tuple[int, int] = (960, 540), what: str = "size of the image in pixels"
) -> None:
    """Add `--size WxH`; `what` says what has that size."""
    help = f"{what} (default: {size[0]}x{size[1]})"
    parser.add_argument("--size", type=parse_size, default=size, metavar="WxH", help=help)


WAYS: Final = {
    "stencil": "deferred and light_pre_pass mask each light in a stencil buffer",
    "depth_first": "clustered draws depth before, so that no hidden fragment is lit",
    "multi_pass": "deferred_plus shades each material by draws of its own",
}
"""Other ways of some techniques to the same picture, settings of `TechniqueSettings`."""


def add_technique(parser: Parser, default: str = AutoTechnique.name) -> None:
    """Add `--technique NAME`, `--samples N`, `--fxaa` and the options of `WAYS`, which `make_technique` reads."""
    parser.add_argument(
        "--technique",
        choices=[AutoTechnique.name, *TECHNIQUES],
        default=default,
        help=f"how the scene is drawn; auto tries a few and takes the fastest (default: {default})",
    )
    parser.add_argument(
        "--samples",
        type=parse_count,
        default=1,
        metavar="N",
        help="samples per pixel, which smooth edges; with more than one, auto is forward (default: 1)",
    )
    parser.add_argument(
        "--fxaa", action="store_true", help="smooth the edges of the image, with any technique"
    )
    for name, help in WAYS.items():
        parser.add_argument(f"--{name.replace('_', '-')}", action="store_true", help=help)


def make_technique(given: argparse.Namespace, scene: Scene, device: rhi.Device) -> Technique:
    """Return the technique that the arguments of `add_technique` describe, for a scene and a device."""
    ways = {name: getattr(given, name) for name in WAYS}
    return TechniqueSettings(given.technique, samples=given.samples, fxaa=given.fxaa, **ways).make(scene, device)


def explain_technique(technique: Technique, given: argparse.Namespace) -> dict[str, str]:
    """Return the technique that draws, as `technique`, and `because`, why it does."""
    if isinstance(technique, AutoTechnique):
        return {"technique": technique.chosen, "because": technique.because}
    if given.technique == AutoTechnique.name:
        return {"technique": technique.name, "because": f"{given.samples} samples per pixel, which others don't have"}
    return {"technique": technique.name, "because": "was asked for"}


def add_stereo(parser: Parser) -> None:
    """Add `--stereo OUTPUT` and what describes the eyes, which `make_stereo` reads."""
    parser.add_argument(
        "--stereo", choices=OUTPUTS, help="draw two eyes, and show them like this (docs/stereo.md)"
    )
    parser.add_argument(
        "--eye-distance",
        type=parse_length,
        metavar="M",
        help="metres between the eyes (default: comfortable for the first frame, at most 0.063)",
    )
    parser.add_argument(
        "--convergence",
        type=parse_length,
        metavar="M",
        help="metres from the eyes to the screen, where there is no parallax (default: in the middle of what is seen)",
    )
    parser.add_argument("--swap-eyes", action="store_true", help="show each picture to the other eye")
    parser.add_argument("--toe-in", action="store_true", help="turn the eyes towards each other, to see why not")
    parser.add_argument(
        "--reproject", action="store_true", help="make the right eye's picture of the left one's"
    )


def make_stereo(given: argparse.Namespace, scene: Scene, camera: Camera) -> Stereo | None:
    """Return the stereo that the arguments of `add_stereo` describe, comfortable for a camera where they don't say."""
    if given.stereo is None:
        named = ("eye_distance", "convergence", "swap_eyes", "toe_in", "reproject")
        for name in named:
            if getattr(given, name):
                refuse(rules.NO_STEREO, "render", f"--{name.replace('_', '-')} without --stereo")
        return None
    rig = find_rig(
        scene,
        camera,
        eye_distance=given.eye_distance,
        convergence=given.convergence,
        is_toed_in=given.toe_in,
    )
    return Stereo(rig, given.stereo, is_swapped=given.swap_eyes, is_reprojected=given.reproject)


def add_camera(parser: Parser, default: str = "the scene's first view") -> None:
    """Add `--camera CAMERA`, which is None if it isn't given; `default` says what holds then."""
    parser.add_argument("--camera", metavar="CAMERA", help=f"{CAMERA_HELP} (default: {default})")


def add_frame(parser: Parser, what: str = "first frame of the path", default: int = 0) -> None:
    """Add `--frame N`; `what` says which frame it is."""
    parser.add_argument(
        "--frame", type=parse_frame, default=default, metavar="N", help=f"{what} (default: %(default)s)"
    )


def add_frames(parser: Parser, default: int, what: str = "number of frames") -> None:
    """Add `--frames N`; `what` says what it counts."""
    parser.add_argument(
        "--frames", type=parse_count, default=default, metavar="N", help=f"{what} (default: %(default)s)"
    )


def add_rounds(parser: Parser, what: str, default: int = 5) -> None:
    """Add `--rounds N`; `what` says what it counts."""
    parser.add_argument(
        "--rounds", type=parse_count, default=default, metavar="N", help=f"{what} (default: %(default)s)"
    )


def add_form(parser: Parser, what: str = "table") -> None:
    """Add `--json` and `--markdown`, of which one may be given; `what` is what the second one prints."""
    form = parser.add_mutually_exclusive_group()
    form.add_argument("--json", action="store_true", help="print the result as JSON")
    form.add_argument("--markdown", action="store_true", help=f"print the {what} as Markdown")


def add_chart(parser: Parser, what: str = "the times") -> None:
    """Add `--plot F.png`; `what` is what the chart shows."""
    parser.add_argument("--plot", type=Path, metavar="F.png", help=f"write a chart of {what}")


def add_camera_path(parser: Parser) -> None:
    """Add `--camera-path PATH`."""
    parser.add_argument("--camera-path", default="ground", metavar="PATH", help=PATH_HELP)


def add_walk(parser: Parser, what: str) -> None:
    """Add `--camera-path PATH`, `--frame N` and `--frames N`; `what` says what the last one counts."""
    add_camera_path(parser)
    parser.add_argument(
        "--frame",
        type=parse_frame,
        metavar="N",
        help="first frame of the path, at 60 a second (default: the frames lie around the path's middle)",
    )
    add_frames(parser, 60, what)


def add_settings(parser: Parser, what: str = SETTINGS_HELP) -> None:
    """Add `--settings FILE`, which `load_settings` reads."""
    parser.add_argument("--settings", type=Path, metavar="F.json", help=what)


def load_settings(given: argparse.Namespace, default: RenderSettings | None = None) -> RenderSettings:
    """Return the settings in the file that `--settings` names, or `default`, or the defaults of all."""
    return default or RenderSettings() if given.settings is None else RenderSettings.load(given.settings)


def merge_settings(given: argparse.Namespace) -> RenderSettings:
    """Return the settings in the file that `--settings` names, or the defaults, with what other arguments say instead:
    those of `add_technique`, `--visibility`, `--queries`, `--depth`, `--blending`, `--edge-pixels` and `--reproject`,
    None where they aren't given. Those of `add_technique` then hold what is merged."""
    settings = load_settings(given)
    ways = {name: getattr(given, name) or None for name in WAYS}
    of_technique = {"name": given.technique, "samples": given.samples, "fxaa": given.fxaa or None, **ways}
    chosen = {name: value for name, value in of_technique.items() if value is not None}
    technique = replace(settings.technique, **chosen)
    given.technique, given.samples, given.fxaa = technique.name, technique.samples, technique.fxaa
    for name in WAYS:
        setattr(given, name, getattr(technique, name))
    changes = {
        "technique": technique,
        "algorithm": given.visibility,
        "visibility.emulated": None if given.queries is None else given.queries == "emulated",
        "depth": None if given.depth is None else Depth(given.depth),
        "blending": None if given.blending is None else Blending(given.blending),
        "reprojects": given.reproject or None,
        "tessellation.edge_pixels": given.edge_pixels,
    }
    return settings.change_all({path: value for path, value in changes.items() if value is not None})


def add_queries(parser: Parser, default: str) -> None:
    """Add `--queries KIND`, which is None if it isn't given; `default` says what holds then."""
    parser.add_argument(
        "--queries",
        choices=QUERY_KINDS,
        help=f"occlusion queries: the device's own, or emulated by two counters and a fence (default: {default})",
    )


def parse_size(text: str) -> tuple[int, int]:
    """Parse `960x540` as (960, 540)."""
    width, _, height = text.lower().partition("x")
    if not (width.isascii() and width.isdigit() and height.isascii() and height.isdigit()):
        raise argparse.ArgumentTypeError(f"{text!r} is not a size; give WIDTHxHEIGHT, such as 960x540")
    if not int(width) or not int(height):
        raise argparse.ArgumentTypeError(f"{text!r} is empty; give a width and a height of 1 or more")
    return int(width), int(height)


def parse_length(text: str) -> float:
    """Parse a length in metres, 0 or more; it may be infinite."""
    try:
        length = float(text)
    except ValueError:
        length = -1.0
    if not length >= 0.0:
        raise argparse.ArgumentTypeError(f"{text!r} is not a length in metres")
    return length


def parse_count(text: str) -> int:
    """Parse a whole number of 1 or more."""
    if not (text.isascii() and text.isdigit() and int(text)):
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number of 1 or more")
    return int(text)


def parse_names(known: Collection[str], what: str) -> Callable[[str], list[str]]:
    """Return what parses `a,b` as a list of known names, each of them once; `what` ends the error: "is not a test"."""

    def parse(text: str) -> list[str]:
        names = text.split(",")
        for name in names:
            if name not in known:
                raise argparse.ArgumentTypeError(f"{name!r} {what}; give some of {', '.join(known)}")
        return list(dict.fromkeys(names))

    return parse


def parse_frame(text: str) -> int:
    """Parse a whole number of 0 or more."""
    if not (text.isascii() and text.isdigit()):
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number of 0 or more")
    return int(text)
