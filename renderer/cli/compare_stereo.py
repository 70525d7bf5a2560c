"""`compare stereo`: what a frame costs with one eye and with two, with and without shadows.

  python -m renderer compare stereo city --sizes 640x360,960x540 --shadows off,on
  python -m renderer compare stereo hall --technique deferred --stereo dubois,side_by_side --json
  python -m renderer compare stereo night:lights=256 --sizes 960x540 --backend cl --markdown

One eye and all stereo outputs take turns, frame by frame along a path, with frustum culling. Times are
medians, from the scene's update until the GPU is finished; `processor ms` is the time of the processor in all
threads. Ratios are to one eye in the same frame. An output that ends in _reprojected makes the right eye's
image from the left one's. With `--shadows on`, all lights that can cast shadows. Under OpenCL set
RHI_KERNELS=optimised, or the first frames are drawn by kernels that were built quickly; `kernels` says which
ones cl ran in the frames.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from functools import partial
from typing import Final

import rhi
from renderer.cli import options
from renderer.cli.arguments import open_scene
from renderer.cli.comparison import ComparisonProgram, Report, describe, repeat
from renderer.cli.output import show_progress
from renderer.content import load_scene, parse_camera_path
from renderer.lab.comparison import Record
from renderer.lab.comparisons.stereo_comparison import compare_stereo, list_stereos
from renderer.scene import Scene
from renderer.stereo import compute_rig
from renderer.techniques import TECHNIQUES

_SWITCH: Final = {"off": False, "on": True}
_DEFAULT: Final = ("dubois", "color", "side_by_side", "color_reprojected")


def _measure(arguments: argparse.Namespace) -> Report:
    first, *others = (_SWITCH[name] for name in arguments.shadows)
    scenes = {first: _cast(open_scene(arguments.scene), first)}
    scenes |= {has_shadows: _cast(load_scene(arguments.scene), has_shadows) for has_shadows in others}
    scene = next(iter(scenes.values()))
    path = parse_camera_path(arguments.camera_path, scene)
    width, height = arguments.sizes[0]
    rig = compute_rig(
        scene,
        path.camera(arguments.frame).with_aspect(width / height),
        eye_distance=arguments.eye_distance,
        convergence=arguments.convergence,
    )

    with rhi.create_device(arguments.backend) as device:
        rows = compare_stereo(
            device,
            scenes,
            path,
            rig,
            arguments.sizes,
            arguments.stereo,
            range(arguments.frame, arguments.frame + arguments.frames),
            TECHNIQUES[arguments.technique],
            partial(show_progress, task="compare"),
        )
        metadata = describe(device) | repeat(
            arguments, "scene", "technique", "camera_path", "frame", "frames"
        )
        metadata |= {"eye_distance": rig.eye_distance, "convergence": rig.convergence}
        return Report(metadata, list(rows), scene=scene)


def _cast(scene: Scene, has_shadows: bool) -> Scene:
    scene.lights.cast_shadows(has_shadows)
    return scene


def format_sizes(rows: Sequence[Record]) -> Sequence[Record]:
    """Format sizes for people."""
    return [row | {"size": "{} × {}".format(*row["size"])} for row in rows]


_OPTIONS: Final = (
    options.SCENE,
    options.values(
        "--sizes",
        "sizes of the image in pixels",
        options.parse_size,
        [(640, 360), (960, 540)],
        "640x360,960x540",
        "WxH,…",
    ),
    options.names("--shadows", _SWITCH, "is neither off nor on", ["off"], "off", "shadows, "),
    options.names("--stereo", list_stereos(), "is no output", _DEFAULT),
    options.choice("--technique", "how the scene is drawn", TECHNIQUES, "forward"),
    options.length("--eye-distance", "metres between the eyes", "comfortable"),
    options.length("--convergence", "metres to the screen", "comfortable"),
    options.PATH,
    options.frame(default=900),
    options.frames(20),
    options.BACKEND,
    *options.form(),
)
COMMAND: Final = ComparisonProgram(
    "stereo",
    "compare what a frame costs with one eye and with two",
    __doc__,
    _OPTIONS,
    _measure,
    display_rows=format_sizes,
).command
