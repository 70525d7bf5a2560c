"""`compare stereo`: what a frame costs with one eye and with two, with and without shadows."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from typing import Final

import rhi
from renderer.cli.arguments import (
    add_backend,
    add_camera_path,
    add_form,
    add_frame,
    add_frames,
    add_scene,
    parse_length,
    parse_names,
    parse_size,
)
from renderer.cli.comparison import ComparisonProgram, Report, describe, repeat
from renderer.cli.output import show_progress
from renderer.cli.subcommand import Parser
from renderer.content import find_path, load_scene
from renderer.lab.comparison import Record
from renderer.lab.stereo import compare_stereo, list_stereos
from renderer.scene import Scene
from renderer.stereo import find_rig
from renderer.techniques import TECHNIQUES

_NOTES: Final = """\
  python -m renderer compare stereo city --sizes 640x360,960x540 --shadows off,on
  python -m renderer compare stereo hall --technique deferred --stereo dubois,side_by_side --json
  python -m renderer compare stereo night:lights=256 --sizes 960x540 --backend cl --markdown

One eye and all ways to show two take turns, frame by frame along a path, culled by the frustum. Times are medians, from
the scene's update until the GPU is finished; `processor ms` is the time of the processor in all threads. Ratios are to
one eye in the same frame. An output that ends in _reprojected makes the right eye's picture of the left one's. With
`--shadows on`, all lights cast shadows that can. Under OpenCL set RHI_KERNELS=optimised, or the first frames are drawn
by kernels that were built in a hurry; `kernels` says which ones cl ran in the frames."""
_SWITCH: Final = {"off": False, "on": True}
_DEFAULT: Final = ("dubois", "color", "side_by_side", "color_reprojected")


def _add_arguments(parser: Parser) -> None:
    add_scene(parser)
    parser.add_argument(
        "--sizes",
        type=lambda text: [parse_size(part) for part in text.split(",")],
        default=[(640, 360), (960, 540)],
        metavar="WxH,…",
        help="sizes of the image in pixels (default: 640x360,960x540)",
    )
    parser.add_argument(
        "--shadows",
        type=_parse_switches,
        default=[False],
        metavar="off,on",
        help="without shadows, with them, or both (default: off)",
    )
    parser.add_argument(
        "--stereo",
        type=parse_names(list_stereos(), "is no output"),
        default=list(_DEFAULT),
        metavar="A,B,…",
        help=f"some of {', '.join(list_stereos())} (default: {','.join(_DEFAULT)})",
    )
    parser.add_argument(
        "--technique", choices=TECHNIQUES, default="forward", help="how the scene is drawn (default: %(default)s)"
    )
    parser.add_argument(
        "--eye-distance", type=parse_length, metavar="M", help="metres between the eyes (default: comfortable)"
    )
    parser.add_argument(
        "--convergence", type=parse_length, metavar="M", help="metres to the screen (default: comfortable)"
    )
    add_camera_path(parser)
    add_frame(parser, default=900)
    add_frames(parser, 20)
    add_backend(parser)
    add_form(parser)


def _measure(given: argparse.Namespace) -> Report:
    scenes = {has_shadows: _load(given.scene, has_shadows) for has_shadows in given.shadows}
    scene = next(iter(scenes.values()))
    path = find_path(given.camera_path, scene)
    width, height = given.sizes[0]
    rig = find_rig(
        scene,
        path.camera(given.frame).with_aspect(width / height),
        eye_distance=given.eye_distance,
        convergence=given.convergence,
    )

    def progress(frames: range) -> Iterable[int]:
        return show_progress(frames, len(frames), "compare")

    with rhi.create_device(given.backend) as device:
        rows = compare_stereo(
            device,
            scenes,
            path,
            rig,
            given.sizes,
            given.stereo,
            range(given.frame, given.frame + given.frames),
            TECHNIQUES[given.technique],
            progress,
        )
        about = describe(device) | repeat(given, "scene", "technique", "camera_path", "frame", "frames")
        about |= {"eye_distance": rig.eye_distance, "convergence": rig.convergence}
        return Report(about, list(rows), scene=scene)


def _load(text: str, has_shadows: bool) -> Scene:
    scene = load_scene(text)
    lights = scene.lights
    if has_shadows:
        lights.cast_shadows()
    else:
        for some in (lights.directional, lights.point, lights.spot):
            some["casts_shadow"] = False
    return scene


def show_sizes(rows: Sequence[Record]) -> Sequence[Record]:
    """Write sizes for people."""
    return [row | {"size": "{} × {}".format(*row["size"])} for row in rows]


def _parse_switches(text: str) -> list[bool]:
    names = text.split(",")
    for name in names:
        if name not in _SWITCH:
            raise argparse.ArgumentTypeError(f"{name!r} is neither off nor on")
    return [_SWITCH[name] for name in dict.fromkeys(names)]


COMMAND: Final = ComparisonProgram(
    "stereo", "compare what a frame costs with one eye and with two", _NOTES, _add_arguments, _measure, show=show_sizes
).command
