"""`compare buffers`: what layouts of the geometry buffer take, and what they lose.

  python -m renderer compare buffers hall:lights=64 --camera ground --frame 600
  python -m renderer compare buffers hall:lights=64 --backend cl --markdown

The renderer's own layout is compared with those that Wilks (Figures 5.1 and 5.2) and Russell (Figures 2.2.2 and 2.2.3)
print. All are lit by the same lists of lights, so times differ by what a layout stores and loads. Errors are levels of
255 from forward shading: what a layout doesn't store, it can't show.
"""

from __future__ import annotations

import argparse
from functools import partial
from typing import Final

import rhi
from renderer.cli import options
from renderer.cli.arguments import open_scene
from renderer.cli.comparison import ComparisonProgram, Report, describe, repeat
from renderer.cli.output import show_progress
from renderer.content import parse_path_frames
from renderer.lab.comparisons.buffer_comparison import compare_buffers
from renderer.renderer import Renderer

_OPTIONS: Final = (
    options.SCENE,
    options.camera(),
    options.frame("frame of a path"),
    options.rounds("times each layout is timed"),
    options.size(),
    options.BACKEND,
    *options.form(),
)


def _measure(arguments: argparse.Namespace) -> Report:
    scene = open_scene(arguments.scene)
    camera = arguments.camera or next(iter(scene.views))
    (frame,) = parse_path_frames(camera, scene, range(arguments.frame, arguments.frame + 1))
    with (
        rhi.create_device(arguments.backend) as device,
        Renderer(device, scene, visibility="frustum", size=arguments.size) as renderer,
    ):
        rows = compare_buffers(
            renderer,
            frame,
            rounds=arguments.rounds,
            progress=partial(show_progress, task="compare"),
        )
        metadata = describe(device) | repeat(arguments, "scene", "camera", "frame", "size", "rounds")
        return Report(metadata, list(rows), f"{arguments.scene}, {metadata['device']}", scene)


COMMAND: Final = ComparisonProgram(
    "buffers",
    "compare layouts of the geometry buffer, the renderer's own and published ones",
    __doc__,
    _OPTIONS,
    _measure,
).command
