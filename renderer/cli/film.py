"""`film`: draw the frames of a camera path to a video or to images, on any number of workers.

  python -m renderer film city --camera ground --frames 0:600 --output city.mp4
  python -m renderer film city --camera sky --frames 0:1800:2 --size 1920x1080 --samples 4 --output city.mp4
  python -m renderer film hall --camera walk.json --output hall/%05d.png --executor processes:4
  python -m renderer film city --camera ground --output city.mp4 --executor dask:tcp://scheduler:8786
  python -m renderer film city --camera ground --frames 0:600 --stereo side_by_side --output city.mp4

Frames A to B - 1 are drawn, of which 60 are a second; A:B:S draws every S-th, and its video has 60 / S frames
a second. Frames whose files are complete aren't drawn again: after an interrupt, or where a process has died,
the same command goes on. The frames of a video are in the folder NAME.mp4.frames until it is complete.

The bytes don't depend on the number of workers. Each frame is drawn as if no other had been: simulations are
those of its time, with all steps since time 0, `auto` is forward and frustum culling, and the overlay shows
no times. The scene and the settings travel to each worker once. A worker that dies gives its frame to
another; a frame that ends three processes is named, and all others are drawn.
"""

from __future__ import annotations

import argparse
import json
import re
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Any, Final

from renderer.cli import options
from renderer.cli.arguments import make_stereo, merge_settings, open_scene
from renderer.cli.options import option
from renderer.cli.output import note, report_omissions
from renderer.cli.subcommand import Subcommand
from renderer.scene.paths import FRAMES_PER_SECOND
from renderer.techniques import AutoTechnique, Forward
from renderer.viewer.scene_films import (
    FilmLayers,
    SceneFilm,
    choose_backend,
    first_camera,
    identify,
    list_frames,
    resolve_camera,
)
from rhi.errors.output_paths import check_output_file
from rhi_screen import film as draw_film
from rhi_screen.executors import KINDS

_RANGE: Final = re.compile(r"(\d+):(\d+)(?::(\d+))?")


def parse_range(text: str) -> range:
    """Parse `A:B` or `A:B:STEP`, the numbers from A to B - 1."""
    match = _RANGE.fullmatch(text) if text.isascii() else None
    frames = range(0) if match is None else range(int(match[1]), int(match[2]), max(int(match[3] or 1), 1))
    if match is None or not len(frames) or match[3] == "0":
        raise argparse.ArgumentTypeError(
            f"{text!r} is not a range of frames; give A:B, such as 0:600, or A:B:STEP"
        )
    return frames


_OPTIONS: Final = (
    options.SCENE,
    options.camera(default_text="the scene's first path"),
    option(
        "--frames",
        "frames to draw, of 60 a second: A to B - 1",
        None,
        "all of the path",
        type=parse_range,
        metavar="A:B[:STEP]",
    ),
    options.size(what="size of a frame in pixels"),
    replace(
        option(
            "--output",
            "video to write, or the images' names with %%d or %%05d for the number",
            type=Path,
            metavar="F.mp4|DIR/%%05d.png",
            required=True,
        ),
        output=check_output_file,
    ),
    options.executor("frames are drawn", KINDS),
    options.BACKEND,
    *options.technique(Forward.name, has_defaults=False),
    options.visibility(None, "the settings', frustum"),
    options.settings("file with settings, written by `accuracy` or `tune`; other arguments override them"),
    options.queries("the settings', native"),
    *options.STEREO,
    options.DEPTH,
    options.BLENDING,
    options.TEXTURE_MEMORY,
    options.switch("--particles", "draw the drops of the hall's fountains as particles, too"),
    options.switch("--overlay", "draw what each frame shows and culls over it, without times"),
    options.JSON,
)


def _run(arguments: argparse.Namespace) -> None:
    arguments.edge_pixels = arguments.temporal = None
    is_auto = arguments.technique == AutoTechnique.name
    settings = merge_settings(arguments)
    if arguments.stereo is not None:
        arguments.reproject, arguments.far_error = settings.reprojects, settings.far_error
    scene = open_scene(arguments.scene)
    path = resolve_camera(arguments.camera, scene)
    frames = list_frames(arguments.frames, path)
    step = arguments.frames.step if arguments.frames is not None else 1
    if is_auto:
        note("auto measures times, so it would draw other frames elsewhere: forward draws this film")
    layers = FilmLayers(arguments.particles, arguments.overlay, arguments.size[1])
    render = SceneFilm(
        scene,
        path,
        arguments.size,
        settings=settings,
        backend=choose_backend(arguments.backend),
        stereo=make_stereo(arguments, scene, first_camera(scene, path, arguments.size)),
        layers=layers,
    )
    began = perf_counter()
    try:
        result = draw_film(
            render,
            frames,
            arguments.executor,
            arguments.output,
            fps=FRAMES_PER_SECOND / step,
            identity=identify(render, arguments.scene),
        )
    except KeyboardInterrupt:
        note("interrupted: finished frames are stored, and the same command draws the others")
        raise
    report: dict[str, Any] = {
        "scene": scene.name,
        "frames": result.frames,
        "drawn": result.drawn,
        "reused": result.reused,
        "size": list(arguments.size),
        "devices": list(result.sources),
        "seconds": round(perf_counter() - began, 3),
        "output": str(arguments.output),
        **report_omissions(scene),
    }
    if len(result.sources) > 1:
        note(f"{len(result.sources)} kinds of devices have drawn frames, which may differ by their rounding")
    if any(source.startswith("null:") for source in result.sources):
        note("the null device draws nothing: its frames are black")
    if arguments.json:
        print(json.dumps(report))
    else:
        existed = f", {result.reused} existed" if result.reused else ""
        print(
            f"{arguments.output}: {result.frames} frames, {result.drawn} drawn in {report['seconds']:.1f} s{existed}"
        )


COMMAND: Final = Subcommand(
    "film",
    "draw the frames of a camera path to a video or to images, on many workers",
    _OPTIONS,
    _run,
    __doc__,
)
