"""`render`: render a scene, write the image and report what it cost.

  python -m renderer render city --output city.png
  python -m renderer render city:blocks=12,seed=3 --camera sky --frame 600
  python -m renderer render model.glb --camera 2,1.5,3 --size 1280x720
  python -m renderer render hall --camera ground --frames 120 --visibility frustum --json
  python -m renderer render city --visibility chc_plus_plus --queries emulated --json
  python -m renderer render city --backend null --json
  python -m renderer render city --camera ground --frame 600 --frames 120 --overlay
  python -m renderer render hall --show lights
  python -m renderer render hall --technique deferred --show surface
  python -m renderer render city --camera ground --frame 600 --stereo dubois
  python -m renderer render city --backend null --frames 10 --trace city.zip
  python -m renderer render city --camera ground --frame 600 --frames 120 --record walk.json

Times are measured from the scene's update until the GPU is finished. The first frame isn't counted, and with `auto`
neither are those in which it looks for the fastest visibility algorithm and technique. Counters are those of one frame,
or with several frames their mean. The image is that of the last frame.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import rhi
from renderer.cli import options
from renderer.cli.arguments import explain_technique, make_stereo, merge_settings, open_scene
from renderer.cli.options import option
from renderer.cli.output import list_left_out, name_of, note, prepare_image, show_progress, write_image
from renderer.cli.subcommand import Subcommand
from renderer.content import parse_shots
from renderer.lab.measure import FrameCost, measure_frame
from renderer.lab.measure.contents import picture_contents
from renderer.layers.overlay import Overlay
from renderer.layers.particles import Particles
from renderer.renderer import FrameResult, Renderer
from renderer.scene import CameraPath, Scene
from renderer.settings import RenderSettings
from renderer.stereo import Stereo, find_holes
from renderer.techniques import AutoTechnique, Forward, Technique, Watched
from renderer.techniques.inspection import INSPECTIONS, Inspection
from renderer.techniques.light_indexed import count_overflowing
from rhi.trace import save

_MAGENTA: Final = (255, 0, 255, 255)


_OPTIONS: Final = (
    options.SCENE,
    options.BACKEND,
    *options.technique(is_given=False),
    options.visibility(None, "the settings', auto"),
    options.settings("file with settings, written by `accuracy` or `tune`; other arguments count more"),
    options.queries("the settings', native"),
    options.camera(),
    options.frame("first frame of the path, at 60 a second"),
    options.frames(1, "number of frames to time"),
    options.size(),
    *options.STEREO,
    options.file("--holes", "as --reproject, and write the right eye's picture with its holes in magenta"),
    options.DEPTH,
    options.BLENDING,
    option("--edge-pixels", "length in pixels that edges of height fields are split down to", None, "the settings', 8",
           type=float, metavar="N"),
    option("--show", f"picture what the frame is made of instead of its light: {', '.join(INSPECTIONS)}, or a texture "
           "of the technique's plan, such as surface (see `plan`)", metavar="NAME"),
    option("--output", "image to write", None, "SCENE.png", type=Path, metavar="F.png"),
    options.file("--trace", "write a trace of all commands (see python -m rhi trace)", "F.zip"),
    options.file("--record", "write the frames' cameras as a walk-through, for --camera and --camera-path", "F.json"),
    options.switch("--particles", "draw the drops of the hall's fountains as particles, too"),
    options.switch("--overlay", "draw frame times, counters, the timer tree and the culling over each frame, which "
                   "costs time, too"),
    options.JSON,
)  # fmt: skip


def _run(given: argparse.Namespace) -> None:
    if given.output is not None:
        prepare_image(given.output)
    if given.holes is not None:
        prepare_image(given.holes, "--holes")
    given.reproject = given.reproject or given.holes is not None
    settings = merge_settings(given)
    given.reproject = given.reproject or (settings.reprojects and given.stereo is not None)
    scene = open_scene(given.scene)
    frames = range(given.frame, given.frame + given.frames)
    shots = [
        replace(shot, camera=settings.aim(shot.camera))
        for shot in parse_shots(given.camera or next(iter(scene.views)), scene, frames)
    ]
    if given.record is not None:
        given.record.parent.mkdir(parents=True, exist_ok=True)
        CameraPath.record([shot.camera for shot in shots]).save(given.record)
        note(f"wrote {given.record}: {len(shots)} frames")
    with (
        rhi.create_device(given.backend, record=True if given.trace is not None else None) as device,
        settings.open(device, scene, given.size, technique=_make_shown(given, settings, scene, device)) as renderer,
        ExitStack() as layers,
    ):
        renderer.stereo = make_stereo(given, scene, shots[0].camera.with_aspect(given.size[0] / given.size[1]))
        if given.particles:
            renderer.layers.append(Particles(device))
        if given.overlay:
            renderer.layers.append(Overlay(device, scale=max(1, given.size[1] // 720)))
        for layer in renderer.layers:
            layers.callback(layer.destroy)
        for _ in show_progress(warm_up(renderer), "find what is the fastest"):
            measure_frame(renderer, shots[0])
        costs = []
        for shot in show_progress(shots, "render"):
            result, cost = measure_frame(renderer, shot)
            costs.append(cost)
        if given.trace is not None:
            given.trace.parent.mkdir(parents=True, exist_ok=True)
            save(device, given.trace)
            note(f"wrote {given.trace}: {len(device.stream):,} commands")
        image, overflowing, holes = None, None, None
        if device.capabilities.shading:
            overflowing = count_overflowing(result.targets)
            image = prepare_image(given.output or Path(f"{name_of(scene)}.png"))
            watched = renderer.technique
            if isinstance(watched, Watched) and watched.texels is not None:
                write_image(image, picture_contents(given.show, watched.texels))
            else:
                write_image(image, result.image.read())
            if given.reproject and given.stereo is not None:
                holes = _report_holes(result, given.holes)
        else:
            note(f"the {device.backend_name} device records and draws nothing: there is no image")
        technique = explain_technique(renderer.technique, given)
        report = describe_run(renderer, costs, image, overflowing, technique, holes)
    print(json.dumps(report) if given.json else show_report(report))


def _make_shown(given: argparse.Namespace, settings: RenderSettings, scene: Scene, device: rhi.Device) -> Technique:
    """Return the technique that draws what `--show` names. Buffers are those of a technique that doesn't change."""
    if given.show in INSPECTIONS:
        return Inspection(given.show, settings.technique.find_cells(given.show))
    technique = settings.technique
    if given.show is None:
        return technique.make(scene, device)
    if technique.name == AutoTechnique.name:
        given.technique = Forward.name
    return Watched(replace(technique, name=given.technique).make(scene, device), given.show)


def warm_up(renderer: Renderer) -> Iterator[None]:
    """Yield once for each frame to draw before the first counted one: one, and with `auto` all on trial."""
    yield
    while renderer.is_trying:
        yield


def describe_run(
    renderer: Renderer,
    costs: list[FrameCost],
    image: Path | None,
    overflowing: int | None,
    technique: dict[str, str],
    holes: int | None = None,
) -> dict[str, Any]:
    """Return the report that `--json` prints."""
    summary = FrameCost.summarize(costs)
    summary["uploads_bytes"] = summary.pop("upload_bytes")
    return {
        "backend": renderer.device.backend_name,
        "device": renderer.device.capabilities.device,
        "scene": renderer.scene.name,
        "size": list(renderer.size),
        "frames": len(costs),
        **technique,
        **summary,
        "image_bytes": renderer.image_bytes,
        **({} if overflowing is None else {"overflowing_pixels": overflowing}),
        **({"dark_lamps": renderer.shadows.dark_lamps} if renderer.shadows.dark_lamps else {}),
        **({} if renderer.stereo is None else _describe_stereo(renderer.stereo)),
        **({} if holes is None else {"holes": holes}),
        "image": None if image is None else str(image),
        **list_left_out(renderer.scene),
    }


def _describe_stereo(stereo: Stereo) -> dict[str, Any]:
    rig = stereo.rig
    return {"stereo": stereo.output, "eye_distance": rig.eye_distance, "convergence": rig.convergence}


def _report_holes(result: FrameResult, path: Path | None) -> int:
    """Return the number of holes in a reprojected picture; write it with them to `path`."""
    _, right = result.frames
    holes = find_holes(right)
    if path is not None:
        pixels = right.targets.image.read()
        pixels[holes] = _MAGENTA
        write_image(path, pixels)
        note(f"wrote {path}: holes are magenta")
    return int(holes.sum())


def show_report(report: dict[str, Any]) -> str:
    """Format the report as text."""
    times = report["milliseconds"]
    shown = report | {
        "size": "{} × {}".format(*report["size"]),
        "milliseconds": f"{times['median']:.2f} (least {times['min']:.2f}, most {times['max']:.2f})",
        "image": report["image"] or "none: this device draws nothing",
    }
    shown.pop("left_out", None)  # stderr has it
    texts = {key: f"{value:,}" if isinstance(value, int) else value for key, value in shown.items()}
    names = {"uploads_bytes": "bytes uploaded", "image_bytes": "bytes of images"}
    return "\n".join(f"{names.get(key, key.replace('_', ' ')) + ':':<24}{text}" for key, text in texts.items())


COMMAND: Final = Subcommand("render", "render a scene to an image and report what it cost", _OPTIONS, _run, __doc__)
