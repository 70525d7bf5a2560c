"""`compare light-culling`: what each test of lights against tiles or clusters keeps, and what it costs."""

from __future__ import annotations

import argparse
from typing import Final

import rhi
from renderer.cli.arguments import (
    add_backend,
    add_camera,
    add_form,
    add_frame,
    add_rounds,
    add_scene,
    add_size,
    open_scene,
    parse_count,
    parse_names,
)
from renderer.cli.comparison import ComparisonProgram, Report, describe, repeat
from renderer.cli.output import show_progress
from renderer.cli.subcommand import Parser
from renderer.content import parse_camera
from renderer.lab.measure.light_culling import compare_light_culling
from renderer.lights.culling import CONE_TESTS, SPHERE_TESTS
from renderer.renderer import Renderer
from renderer.visibility import make_visibility

_NOTES: Final = """\
  python -m renderer compare light-culling hall --lights 4,8,14 --tile 8 --size 1280x720
  python -m renderer compare light-culling hall --lights 14 --tests exact,hybrid,planes --pre-filter both
  python -m renderer compare light-culling night --lights 1024 --tests exact --cones sphere,tight --depth-mask both
  python -m renderer compare light-culling city --lights 13 --slices 24 --tile 64 --backend cl --json

The scene is drawn once, so that cells end at their tile's nearest and farthest surface; then every test lists the
lights of the same frame. `pairs` counts the lights on all lists, `over exact` is their number divided by that of the
pairs that overlap, found in float64, and `missed` counts those that overlap and aren't listed. The lights are chosen
from all point and spot lights of the scene; of a spot light the sphere around its cone is tested. `tests made` includes
those of blocks of 8 x 8 tiles. With a test of cones or the depth mask, which drop pairs of which only the spheres
overlap, `missed` counts lights that aren't listed for a cell with a pixel that they light. Times are medians:
`collect ms` from the upload of the lights until the lists are finished, `draw ms` of drawing the scene by the lists.
`kernels` says which kernels cl drew with: RHI_KERNELS=optimised measures a long run."""
_SWITCHES: Final = {"on": (True,), "off": (False,), "both": (True, False)}


def _add_arguments(parser: Parser) -> None:
    add_scene(parser)
    add_camera(parser)
    add_frame(parser, "frame of a path")
    parser.add_argument(
        "--lights",
        type=lambda text: [parse_count(part) for part in text.split(",")],
        default=[64, 128, 256, 512, 1024],
        metavar="N,N,…",
        help="numbers of lights (default: 64,128,256,512,1024)",
    )
    parser.add_argument(
        "--tests",
        type=parse_names(SPHERE_TESTS, "is not a test"),
        default=list(SPHERE_TESTS),
        metavar="A,B,…",
        help=f"some of {', '.join(SPHERE_TESTS)} (default: all)",
    )
    add_size(parser, (1280, 720))
    parser.add_argument(
        "--tile", type=parse_count, default=8, metavar="N", help="side of a tile in pixels (default: %(default)s)"
    )
    parser.add_argument(
        "--slices", type=parse_count, default=1, metavar="N", help="depth slices of a tile (default: %(default)s)"
    )
    parser.add_argument(
        "--cones",
        type=parse_names(CONE_TESTS, "is not a test"),
        default=["sphere"],
        metavar="A,B,…",
        help=f"tests of spot lights' cones, some of {', '.join(CONE_TESTS)} (default: sphere, which makes none)",
    )
    parser.add_argument(
        "--depth-mask",
        choices=_SWITCHES,
        default="off",
        help="whether 32 slices of a tile's depths are told apart (default: %(default)s)",
    )
    parser.add_argument(
        "--pre-filter",
        choices=_SWITCHES,
        default="on",
        help="whether blocks of tiles are tested before tiles (default: %(default)s)",
    )
    add_rounds(parser, "times each test is timed")
    add_backend(parser)
    add_form(parser)


def _measure(given: argparse.Namespace) -> Report:
    scene = open_scene(given.scene)
    camera = parse_camera(given.camera or next(iter(scene.views)), scene, given.frame)
    with rhi.create_device(given.backend) as device:
        visibility = make_visibility("frustum", scene, device)
        with Renderer(device, scene, size=given.size, visibility=visibility) as renderer:
            rows = compare_light_culling(
                renderer,
                camera,
                given.lights,
                given.tests,
                tile=given.tile,
                slices=given.slices,
                cones=given.cones,
                depth_masks=_SWITCHES[given.depth_mask],
                pre_filters=_SWITCHES[given.pre_filter],
                rounds=given.rounds,
                progress=lambda rounds: show_progress(rounds, len(rounds), "collect"),
            )
        about = describe(device) | {"scene": scene.name, "camera": given.camera or next(iter(scene.views))}
    return Report(about | repeat(given, "frame", "size", "tile", "slices", "rounds"), rows, scene=scene)


COMMAND: Final = ComparisonProgram(
    "light-culling", "compare the tests that assign lights to tiles or clusters", _NOTES, _add_arguments, _measure
).command
