"""`view`: show a scene in a window, and move through it.

  python -m renderer view city
  python -m renderer view hall --backend cl --size 1280x720
  python -m renderer view model.glb --technique clustered --shadows all
  python -m renderer view city --camera street --script tour.txt
  python -m renderer view city --live swept --budget-ms 30        after: accuracy city --output swept
  python -m renderer view city --listen 7000            then, in another terminal: nc 127.0.0.1 7000

F1 shows what the keys do, F2 or ` opens the console, in which Tab completes. A script has the console's lines, and
`wait SECONDS`. --listen takes the same lines from programs of this computer, after a first line that is printed here
and has a token: whoever knows it can do what the console can, and write below --write-to.
"""

from __future__ import annotations

import argparse
from typing import Final

from renderer.cli import options
from renderer.cli.arguments import load_settings, open_scene
from renderer.cli.options import option
from renderer.cli.output import OutputError, note
from renderer.cli.subcommand import Subcommand
from renderer.content import parse_camera
from renderer.viewer.budget import FrameBudget, load_steps
from renderer.viewer.look import PLAIN, SHADOWS, Look

_OPTIONS: Final = (
    options.SCENE,
    options.BACKEND,
    *options.technique("forward", is_given=False),
    options.visibility(None, "the settings', or frustum"),
    options.settings("file with settings; what is saved to it takes effect; other arguments count more at first"),
    options.camera(),
    options.frame("frame of the path"),
    options.size(what="size of the window in pixels"),
    options.choice("--shadows", "lights that cast shadows: those of which the scene says so, all, or none", SHADOWS,
                   SHADOWS[0]),
    options.STEREO_OUTPUT,
    option("--show", "picture what the frame is made of, as `render` does", metavar="NAME"),
    options.switch("--particles", "draw the drops of the hall's fountains as particles"),
    options.switch("--overlay", "draw times, counters and the culling over each frame"),
    options.choice("--canvas", "where the picture is shown; page is one in the browser", ("window", "qt", "page"),
                   "window"),
    option("--budget-ms", "with --live: the most that a frame is to take", type=options.parse_bound, metavar="M"),
    options.file("--live", "keep --budget-ms by the most accurate settings that do, of a folder of `accuracy`", "DIR"),
    options.switch("--immediate", "don't wait for the display's refresh"),
    options.file("--script", "commands to run, a line each", "F"),
    option("--listen", "run commands from this port of the loopback address", type=options.parse_frame, metavar="PORT"),
    options.file("--write-to", "with --listen: where alone commands write (default: the working folder)", "DIR"),
    options.count("--frames", "end after so many frames, and say how fast"),
)  # fmt: skip


def _run(given: argparse.Namespace) -> None:
    from renderer.viewer.showing import open_viewer

    if (given.live is None) != (given.budget_ms is None):
        raise OutputError("--live: the folder of a front, and --budget-ms what a frame may take: both, or neither")
    steps = None if given.live is None else load_steps(given.live / "front.json")
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
        if steps is not None:
            stage.keep_budget(FrameBudget(steps, given.budget_ms))
        shown.viewer.run_script(script)
        if given.listen is not None:
            port = shown.listen(given.listen, given.write_to)
            note(f"listening on 127.0.0.1:{port}, for connections whose first line is: {shown.viewer.greeting}")
        shown.end_after = given.frames
        shown.run()
        if given.frames is not None:
            worked = f"{1e3 * stage.counter.processor:.1f} ms of processors a frame"
            kept = "" if stage.budget is None else f"   {stage.budget.describe()}"
            note(f"{stage.counter.describe()}   {worked}{kept}")
    finally:
        shown.close()


COMMAND: Final = Subcommand("view", "show a scene in a window, and move through it", _OPTIONS, _run, __doc__)
