"""`debug reprojection`: draw the depth that `two_pass` begins a frame with (Deferred+, Figure 1.2).

  python -m renderer debug reprojection bazaar --frame 300 --output moved.png
  python -m renderer debug reprojection city --frame 900 --step 8 --backend cl --json

From left to right, at a quarter of the frame's size and near surfaces bright: this frame's depth; the depth of an
earlier frame, moved to where the camera sees it now, with holes in magenta; the same with its holes filled.
"""

from __future__ import annotations

import argparse
from typing import Final

import rhi
from renderer.cli import options
from renderer.cli.arguments import open_scene
from renderer.cli.output import OutputError, note, prepare_image, print_report, write_image
from renderer.cli.subcommand import Subcommand
from renderer.content import parse_path_frames
from renderer.lab.measure.reprojection_images import reproject_depth
from renderer.renderer import Renderer

_OPTIONS: Final = (
    options.SCENE,
    options.camera("ground"),
    options.frame("frame of the path"),
    options.count("--step", "number of frames that the camera has moved", 4),
    options.BACKEND,
    options.size(what="size of the frame in pixels"),
    options.output_file("--output", "file to write", default="reprojection.png"),
    options.switch("--json", "print the fractions as JSON"),
)


def _run(arguments: argparse.Namespace) -> None:
    path = prepare_image(arguments.output)
    scene = open_scene(arguments.scene)
    first = max(arguments.frame, arguments.step) - arguments.step
    last, frame = (
        parse_path_frames(arguments.camera, scene, range(number, number + 1))[0]
        for number in (first, first + arguments.step)
    )
    with rhi.create_device(arguments.backend) as device:
        if not device.capabilities.renders:
            raise OutputError(
                f"--backend: the {device.backend_name} device draws nothing, so there is no image"
            )
        with Renderer(device, scene, visibility="frustum", size=arguments.size) as renderer:
            depths = reproject_depth(renderer, last, frame)
    write_image(path, depths.draw())
    note(f"wrote {path}")
    fractions = {
        "holes": round(float(depths.holes.mean()), 4),
        "hides_too_much": round(float(depths.hides_too_much.mean()), 4),
    }
    if arguments.json:
        print_report({"image": str(path), "size": list(arguments.size)} | fractions, scene)
    else:
        print(f"{fractions['holes']:.2%} of the depths are holes")
        print(
            f"{fractions['hides_too_much']:.2%} are nearer than they should be, so the second pass draws more"
        )


COMMAND: Final = Subcommand(
    "reprojection", "draw the depth that `two_pass` begins a frame with", _OPTIONS, _run, __doc__
)
