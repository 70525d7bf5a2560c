"""`compare stereo`: what a frame costs with one eye and with two, with and without shadows.

  python -m renderer compare stereo city --sizes 640x360,960x540 --shadows off,on
  python -m renderer compare stereo hall --technique deferred --stereo dubois,side_by_side --json
  python -m renderer compare stereo night:lights=256 --sizes 960x540 --backend cl --markdown

One eye and all ways to show two take turns, frame by frame along a path, culled by the frustum. Times are medians, from
the scene's update until the GPU is finished; `processor ms` is the time of the processor in all threads. Ratios are to
one eye in the same frame. An output that ends in _reprojected makes the right eye's picture of the left one's. With
`--shadows on`, all lights cast shadows that can. Under OpenCL set RHI_KERNELS=optimised, or the first frames are drawn
by kernels that were built in a hurry; `kernels` says which ones cl ran in the frames.
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
from renderer.content import find_path, load_scene
from renderer.lab.comparison import Record
from renderer.lab.stereo import compare_stereo, list_stereos
from renderer.scene import Scene
from renderer.stereo import find_rig
from renderer.techniques import TECHNIQUES

_SWITCH: Final = {"off": False, "on": True}
_DEFAULT: Final = ("dubois", "color", "side_by_side", "color_reprojected")


def _measure(given: argparse.Namespace) -> Report:
    first, *others = (_SWITCH[name] for name in given.shadows)
    scenes = {first: _cast(open_scene(given.scene), first)}
    scenes |= {has_shadows: _cast(load_scene(given.scene), has_shadows) for has_shadows in others}
    scene = next(iter(scenes.values()))
    path = find_path(given.camera_path, scene)
    width, height = given.sizes[0]
    rig = find_rig(
        scene,
        path.camera(given.frame).with_aspect(width / height),
        eye_distance=given.eye_distance,
        convergence=given.convergence,
    )

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
            partial(show_progress, what="compare"),
        )
        about = describe(device) | repeat(given, "scene", "technique", "camera_path", "frame", "frames")
        about |= {"eye_distance": rig.eye_distance, "convergence": rig.convergence}
        return Report(about, list(rows), scene=scene)


def _cast(scene: Scene, has_shadows: bool) -> Scene:
    scene.lights.cast_shadows(has_shadows)
    return scene


def show_sizes(rows: Sequence[Record]) -> Sequence[Record]:
    """Write sizes for people."""
    return [row | {"size": "{} × {}".format(*row["size"])} for row in rows]


_OPTIONS: Final = (
    options.SCENE,
    options.several("--sizes", "sizes of the image in pixels", options.parse_size, [(640, 360), (960, 540)],
                    "640x360,960x540", "WxH,…"),
    options.some("--shadows", _SWITCH, "is neither off nor on", ["off"], "off", "shadows, "),
    options.some("--stereo", list_stereos(), "is no output", _DEFAULT),
    options.choice("--technique", "how the scene is drawn", TECHNIQUES, "forward"),
    options.length("--eye-distance", "metres between the eyes", "comfortable"),
    options.length("--convergence", "metres to the screen", "comfortable"),
    options.PATH,
    options.frame(default=900),
    options.frames(20),
    options.BACKEND,
    *options.form(),
)  # fmt: skip
COMMAND: Final = ComparisonProgram(
    "stereo", "compare what a frame costs with one eye and with two", __doc__, _OPTIONS, _measure, show=show_sizes
).command
