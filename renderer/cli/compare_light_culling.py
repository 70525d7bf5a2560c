"""`compare light-culling`: what each test of lights against tiles or clusters keeps, and what it costs.

  python -m renderer compare light-culling hall --lights 4,8,14 --tile 8 --size 1280x720 python -m renderer
  compare light-culling hall --lights 14 --tests exact,hybrid,planes --pre-filter both python -m renderer
  compare light-culling hall:lights=1024 --tests planes,exact --plot pairs.png python -m renderer compare
  light-culling night --lights 1024 --tests exact --cones sphere,tight --depth-mask both python -m renderer
  compare light-culling city --lights 13 --slices 24 --tile 64 --backend cl --json

The scene is drawn once, so that cells end at their tile's nearest and farthest surface; then every test lists
the lights of the same frame. `pairs` counts the lights on all lists, `over exact` is their number divided by
that of the pairs that overlap, found in float64, and `missed` counts those that overlap and aren't listed.
The lights are chosen from all point and spot lights of the scene; of a spot light the sphere around its cone
is tested. `tests made` includes those of blocks of 8 x 8 tiles. With a test of cones or the depth mask, which
drop pairs of which only the spheres overlap, `missed` counts lights that aren't listed for a cell with a
pixel that they light. Times are medians: `collect ms` from the upload of the lights until the lists are
finished, `draw ms` of drawing the scene by the lists. `kernels` says which kernels cl drew with:
RHI_KERNELS=optimised measures a long run.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from functools import partial
from typing import Any, Final

import rhi
from renderer.cli import options
from renderer.cli.arguments import open_scene
from renderer.cli.comparison import ComparisonProgram, Report, describe, repeat
from renderer.cli.output import show_progress
from renderer.content import parse_camera
from renderer.lab.comparison import Record
from renderer.lab.comparisons.light_culling_comparison import compare_light_culling
from renderer.lights.culling import CONE_TESTS, SPHERE_TESTS
from renderer.renderer import Renderer

_SWITCHES: Final = {"on": (True,), "off": (False,), "both": (True, False)}


_COUNTS: Final = [64, 128, 256, 512, 1024]
_OPTIONS: Final = (
    options.SCENE,
    options.camera(),
    options.frame("frame of a path"),
    options.values(
        "--lights", "numbers of lights", options.parse_count, _COUNTS, "64,128,256,512,1024", "N,N,…"
    ),
    options.names("--tests", SPHERE_TESTS, "is not a test", list(SPHERE_TESTS), "all"),
    options.size((1280, 720)),
    options.count("--tile", "side of a tile in pixels", 8),
    options.count("--slices", "depth slices of a tile", 1),
    options.names(
        "--cones",
        CONE_TESTS,
        "is not a test",
        ["sphere"],
        "sphere, which makes none",
        "tests of spot lights' cones, ",
    ),
    options.choice("--depth-mask", "whether 32 slices of a tile's depths are told apart", _SWITCHES, "off"),
    options.choice("--pre-filter", "whether blocks of tiles are tested before tiles", _SWITCHES, "on"),
    options.rounds("times each test is timed"),
    options.BACKEND,
    *options.form(),
)


def _measure(arguments: argparse.Namespace) -> Report:
    scene = open_scene(arguments.scene)
    camera = parse_camera(arguments.camera or next(iter(scene.views)), scene, arguments.frame)
    with rhi.create_device(arguments.backend) as device:
        with Renderer(device, scene, size=arguments.size, visibility="frustum") as renderer:
            rows = compare_light_culling(
                renderer,
                camera,
                arguments.lights,
                arguments.tests,
                tile=arguments.tile,
                slices=arguments.slices,
                cones=arguments.cones,
                depth_masks=_SWITCHES[arguments.depth_mask],
                pre_filters=_SWITCHES[arguments.pre_filter],
                rounds=arguments.rounds,
                progress=partial(show_progress, task="collect"),
            )
        metadata = describe(device) | {
            "scene": scene.name,
            "camera": arguments.camera or next(iter(scene.views)),
        }
    return Report(
        metadata | repeat(arguments, "frame", "size", "tile", "slices", "rounds"), rows, scene=scene
    )


def plot_tests(figure: Any, rows: Sequence[Record]) -> None:
    """Draw pairs and times over the number of lights, with a line for each test (Thatcher 2014, figures 5, 6,
    7, 9)."""
    tests = dict.fromkeys(tuple(row[name] for name in _TEST_COLUMNS) for row in rows)
    for number, (key, title) in enumerate(_CHART_COLUMNS.items(), 1):
        axes = figure.add_subplot(1, len(_CHART_COLUMNS), number)
        for test in tests:
            test_rows = [row for row in rows if tuple(row[name] for name in _TEST_COLUMNS) == test]
            words = [name.replace("_", " ") for name in ("depth_mask", "pre_filter") if test_rows[0][name]]
            words += [] if test_rows[0]["cones"] == "sphere" else [f"{test_rows[0]['cones']} cones"]
            axes.plot(
                [row["lights"] for row in test_rows],
                [row[key] for row in test_rows],
                marker=".",
                label=", ".join((test[0], *words)),
            )
        axes.set_xlabel("lights")
        axes.set_title(title)
        axes.set_ylim(bottom=0.0)
    axes.legend(fontsize="small")


_TEST_COLUMNS: Final = ("test", "cones", "depth_mask", "pre_filter")
_CHART_COLUMNS: Final = {
    "pairs": "pairs of a cell and a light",
    "collect_ms": "ms to list",
    "draw_ms": "ms to draw",
}
COMMAND: Final = ComparisonProgram(
    "light-culling",
    "compare the tests that assign lights to tiles or clusters",
    __doc__,
    (*_OPTIONS, options.chart("pairs and times")),
    _measure,
    plot=plot_tests,
).command
