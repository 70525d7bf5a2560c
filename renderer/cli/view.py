"""`view`: show a scene in a window, and move through it.

  python -m renderer view city
  python -m renderer view hall --backend cl --size 1280x720
  python -m renderer view model.glb --technique clustered --shadows all
  python -m renderer view city --camera street --script tour.txt
  python -m renderer view city --live swept --budget-ms 30        after: accuracy city --output swept
  python -m renderer view city --listen 7000            then, in another terminal: nc 127.0.0.1 7000

F1 shows what the keys do, F2 or ` opens the console, in which Tab completes. A script has the console's
lines, and `wait SECONDS`. --listen takes the same lines from programs of this computer, after a first line
that is printed here and has a token: whoever knows it can do what the console can, and write below
--write-to.
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Final

from renderer.cli import options
from renderer.cli.arguments import load_settings, note_omissions
from renderer.cli.options import option
from renderer.cli.output import OutputError, note
from renderer.cli.subcommand import Subcommand
from renderer.content import load_scene, parse_camera
from renderer.scene import Camera, Scene
from renderer.viewer.display_settings import PLAIN, SHADOWS, DisplaySettings
from renderer.viewer.frame_budget import FrameBudget, load_steps

if TYPE_CHECKING:
    from renderer.viewer.viewer_screen import ViewerScreen

_MIB_PER_FRAME: Final = 8.0
"""MiB of images that a frame uploads with `--texture-memory`."""

_OPTIONS: Final = (
    options.SCENE,
    options.BACKEND,
    *options.technique("forward", has_defaults=False),
    options.TEMPORAL,
    options.visibility(None, "the settings', or frustum"),
    options.settings(
        "file with settings, reloaded whenever it is saved; other arguments override it at the start"
    ),
    options.camera(),
    options.frame("frame of the path"),
    options.size(what="size of the window in pixels"),
    options.choice(
        "--shadows",
        "lights that cast shadows: as the scene says, all, or none",
        SHADOWS,
        SHADOWS[0],
    ),
    options.STEREO_OUTPUT,
    option("--show", "show what the frame is made of, as `render` does", metavar="NAME"),
    options.switch("--particles", "draw the drops of the hall's fountains as particles"),
    options.switch("--overlay", "draw times, counters and the culling over each frame"),
    options.choice(
        "--canvas", "where the image is shown; page is one in the browser", ("window", "qt", "page"), "window"
    ),
    option(
        "--budget-ms",
        "with --live: the time budget of a frame in milliseconds",
        type=options.parse_bound,
        metavar="M",
    ),
    options.file(
        "--live",
        "keep to --budget-ms with the most accurate settings in a folder written by `accuracy`",
        "DIR",
    ),
    options.TEXTURE_MEMORY,
    options.switch("--immediate", "don't wait for the display's refresh"),
    options.file("--script", "commands to run, one per line", "F"),
    option(
        "--listen",
        "run commands from this port of the loopback address",
        type=options.parse_frame,
        metavar="PORT",
    ),
    options.file(
        "--write-to",
        "with --listen: the only folder that commands may write to (default: the working folder)",
        "DIR",
    ),
    options.count("--frames", "stop after this many frames and print the frame rate"),
)


def _run(arguments: argparse.Namespace) -> None:
    from renderer.viewer.viewer_screen import open_viewer

    if (arguments.live is None) != (arguments.budget_ms is None):
        raise OutputError(
            "--live (the folder of a Pareto front) and --budget-ms (milliseconds per frame) need each other"
        )
    steps = None if arguments.live is None else load_steps(arguments.live / "pareto_front.json")
    budget = None if steps is None else FrameBudget(steps, arguments.budget_ms)
    script = (
        "" if arguments.script is None else arguments.script.read_text(encoding="utf-8", errors="replace")
    )
    settings = load_settings(arguments, PLAIN)
    if arguments.texture_memory is not None:
        changes = {"textures.memory": arguments.texture_memory, "textures.memory_per_frame": _MIB_PER_FRAME}
        settings = settings.change_all(changes)
    overrides = {name: getattr(arguments, name) for name in ("technique", "samples", "visibility")}
    overrides |= {name: getattr(arguments, name) or None for name in ("fxaa", "temporal")}
    display = DisplaySettings(
        settings, shadows=arguments.shadows, overlay=arguments.overlay, particles=arguments.particles
    )
    display = display.change(**{name: value for name, value in overrides.items() if value is not None})
    scene: Scene | str = arguments.scene
    camera: Camera | None = None
    if arguments.camera is not None:  # a name that only the scene knows: no window opens if it is wrong
        scene = load_scene(arguments.scene)
        camera = parse_camera(arguments.camera, scene, arguments.frame)
    viewer_screen = open_viewer(
        scene,
        arguments.backend,
        canvas=arguments.canvas,
        size=arguments.size,
        display=display,
        camera=camera,
        begin=lambda viewer_screen: _begin(viewer_screen, arguments, budget, script),
        vsync=not arguments.immediate,
        max_fps=10_000.0 if arguments.immediate else 60.0,
    )
    try:
        viewer = viewer_screen.viewer
        if arguments.settings is not None:
            viewer.file_reloader.note_settings(arguments.settings)
        if arguments.listen is not None:
            port = viewer_screen.listen(arguments.listen, arguments.write_to)
            note(f"listening on 127.0.0.1:{port}, for connections whose first line is: {viewer.greeting}")
        viewer_screen.run()
        if arguments.frames is not None:
            session = viewer.session
            worked = f"{1e3 * session.counter.processor:.1f} ms of processors a frame"
            budget_text = "" if session.budget is None else f"   {session.budget.describe()}"
            note(f"{session.counter.describe()}   {worked}{budget_text}")
    finally:
        viewer_screen.close()


def _begin(
    viewer_screen: ViewerScreen, arguments: argparse.Namespace, budget: FrameBudget | None, script: str
) -> None:
    """Apply the arguments that need the scene, before its first frame."""
    session = viewer_screen.viewer.session
    note_omissions(session.scene)
    session.change(
        **{name: value for name, value in vars(arguments).items() if name in ("show", "stereo") and value}
    )
    if budget is not None:
        session.set_budget(budget)
    viewer_screen.viewer.run_script(script)
    if arguments.frames is not None:
        viewer_screen.end_after = viewer_screen.frames + arguments.frames


COMMAND: Final = Subcommand("view", "show a scene in a window, and move through it", _OPTIONS, _run, __doc__)
