"""`view`: show a scene in a window, and move through it."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Final

from renderer.cli.arguments import (
    DECIDES,
    add_backend,
    add_camera,
    add_frame,
    add_scene,
    add_settings,
    add_size,
    add_technique,
    load_settings,
    open_scene,
    parse_count,
    parse_frame,
)
from renderer.cli.output import note
from renderer.cli.subcommand import Parser, Subcommand
from renderer.content import parse_camera
from renderer.stereo import OUTPUTS
from renderer.viewer.look import PLAIN, SHADOWS, Look
from renderer.visibility import ALGORITHMS

_NOTES: Final = """\
  python -m renderer view city
  python -m renderer view hall --backend cl --size 1280x720
  python -m renderer view model.glb --technique clustered --shadows all
  python -m renderer view city --camera street --script tour.txt
  python -m renderer view city --listen 7000            then, in another terminal: nc 127.0.0.1 7000

F1 shows what the keys do, F2 or ` opens the console, in which Tab completes. A script has the console's lines, and
`wait SECONDS`. --listen takes the same lines from programs of this computer: whoever may open a connection there can do
what the console can, such as write pictures."""


def _add_arguments(parser: Parser) -> None:
    add_scene(parser)
    add_backend(parser)
    add_technique(parser, default="forward")
    parser.add_argument(
        "--visibility", choices=ALGORITHMS, help=DECIDES.replace("%(default)s", "the settings', or frustum")
    )
    add_settings(parser, "file with settings; what is saved to it takes effect; other arguments count more at first")
    add_camera(parser)
    add_frame(parser, "frame of the path")
    add_size(parser, what="size of the window in pixels")
    parser.add_argument(
        "--shadows",
        choices=SHADOWS,
        default=SHADOWS[0],
        help="lights that cast shadows: those of which the scene says so, all, or none (default: %(default)s)",
    )
    parser.add_argument("--stereo", choices=OUTPUTS, help="draw two eyes, and show them like this (docs/stereo.md)")
    parser.add_argument("--show", metavar="NAME", help="picture what the frame is made of, as `render` does")
    parser.add_argument("--particles", action="store_true", help="draw the drops of the hall's fountains as particles")
    parser.add_argument("--overlay", action="store_true", help="draw times, counters and the culling over each frame")
    parser.add_argument(
        "--canvas",
        choices=("window", "qt", "page"),
        default="window",
        help="where the picture is shown; page is one in the browser (default: %(default)s)",
    )
    parser.add_argument("--immediate", action="store_true", help="don't wait for the display's refresh")
    parser.add_argument("--script", type=Path, metavar="F", help="commands to run, a line each")
    parser.add_argument(
        "--listen", type=parse_frame, metavar="PORT", help="run commands from this port of the loopback address"
    )
    parser.add_argument("--frames", type=parse_count, metavar="N", help="end after so many frames, and say how fast")
    parser.set_defaults(technique=None, samples=None)  # so that settings of a file can hold


def _run(given: argparse.Namespace) -> None:
    from renderer.viewer.showing import open_viewer

    scene = open_scene(given.scene)
    camera = None if given.camera is None else parse_camera(given.camera, scene, given.frame)
    script = "" if given.script is None else given.script.read_text(encoding="utf-8", errors="replace")
    settings = load_settings(given, PLAIN)
    chosen = {name: getattr(given, name) for name in ("technique", "samples", "visibility")}
    chosen["fxaa"] = given.fxaa or None
    look = Look(settings, shadows=given.shadows, overlay=given.overlay, particles=given.particles)
    look = look.change(**{name: value for name, value in chosen.items() if value is not None})
    shown = open_viewer(
        scene,
        given.backend,
        canvas=given.canvas,
        size=given.size,
        look=look,
        camera=camera,
        vsync=not given.immediate,
        max_fps=10_000.0 if given.immediate else 60.0,
    )
    try:
        stage = shown.viewer.stage
        if given.settings is not None:
            shown.viewer.saved.note_settings(given.settings)
        stage.change(**{name: value for name, value in vars(given).items() if name in ("show", "stereo") and value})
        shown.viewer.run_script(script)
        if given.listen is not None:
            note(f"listening on 127.0.0.1:{shown.listen(given.listen)}")
        shown.end_after = given.frames
        shown.run()
        if given.frames is not None:
            worked = f"{1e3 * stage.counter.processor:.1f} ms of processors a frame"
            note(f"{stage.counter.describe()}   {worked}")
    finally:
        shown.close()


COMMAND: Final = Subcommand("view", "show a scene in a window, and move through it", _add_arguments, _run, _NOTES)
