"""`render`: render a scene, write the image and report what it cost.

  python -m renderer render city --output city.png
  python -m renderer render city:blocks=12,seed=3 --camera sky --frame 600
  python -m renderer render model.glb --camera 2,1.5,3 --size 1280x720
  python -m renderer render hall --camera ground --frames 120 --visibility frustum --json
  python -m renderer render city --visibility chc_plus_plus --queries emulated --json
  python -m renderer render city --backend null --json
  python -m renderer render city --camera ground --frame 600 --frames 120 --overlay
  python -m renderer render hall --show lights
  python -m renderer render hall --show specular
  python -m renderer render hall --technique deferred --show surface
  python -m renderer render city --camera ground --frame 600 --stereo dubois
  python -m renderer render city --backend null --frames 10 --trace city.zip
  python -m renderer render city --camera ground --frame 600 --frames 120 --record walk.json

Times are measured from the scene's update until the GPU is finished. The first frame isn't counted, and with
`auto` neither are those in which it looks for the fastest visibility algorithm and technique. Counters are
those of one frame, or with several frames their mean. The image is that of the last frame.
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
from renderer.cli.eye_images import prepare_eye_images, write_glasses, write_holes
from renderer.cli.options import option
from renderer.cli.output import (
    note,
    prepare_image,
    report_omissions,
    short_name,
    show_progress,
    write_image,
)
from renderer.cli.subcommand import Subcommand
from renderer.content import parse_path_frames
from renderer.frame import COMPONENTS
from renderer.inspection import FrameCost, measure_frame
from renderer.inspection.texture_images import texture_to_image
from renderer.layers.overlay import Overlay
from renderer.layers.particles import Particles
from renderer.renderer import Renderer
from renderer.scene import CameraPath, Scene
from renderer.settings import RenderSettings
from renderer.stereo import Stereo
from renderer.techniques import AutoTechnique, Forward, ResourceCapture, Technique
from renderer.techniques.inspection import INSPECTIONS, Inspection
from renderer.techniques.light_indexed import count_overflowing
from rhi.errors.output_paths import check_output_file
from rhi.trace import save

_OPTIONS: Final = (
    options.SCENE,
    options.BACKEND,
    *options.technique(has_defaults=False),
    options.visibility(None, "the settings', auto"),
    options.settings("file with settings, written by `accuracy` or `tune`; other arguments override them"),
    options.queries("the settings', native"),
    options.camera(),
    options.frame("first frame of the path, at 60 a second"),
    options.frames(1, "number of frames to time"),
    options.size(),
    *options.STEREO,
    options.output_file(
        "--holes", "as --reproject, and write the right eye's image with its holes in magenta"
    ),
    options.output_file(
        "--glasses",
        "with an anaglyph: write what each eye sees through its glass, in color and as brightness",
    ),
    options.DEPTH,
    options.BLENDING,
    options.TEMPORAL,
    options.TEXTURE_MEMORY,
    option(
        "--edge-pixels",
        "length in pixels that edges of tessellated surfaces are split down to",
        None,
        "the settings', 8",
        type=float,
        metavar="N",
    ),
    option(
        "--show",
        f"show a component of the light alone: {', '.join(COMPONENTS)}; or what the frame is made of instead: "
        f"{', '.join(INSPECTIONS)}, or a texture of the technique's plan, such as surface (see `plan`)",
        metavar="NAME",
    ),
    replace(
        option("--output", "image to write", None, "SCENE.png", type=Path, metavar="F.png"),
        output=check_output_file,
    ),
    options.output_file("--trace", "write a trace of all commands (see python -m rhi trace)", "F.zip"),
    options.output_file(
        "--record", "write the frames' cameras as a walk-through, for --camera and --camera-path", "F.json"
    ),
    options.switch("--particles", "draw the drops of the hall's fountains as particles, too"),
    options.switch(
        "--overlay",
        "draw frame times, counters, the timer tree and the culling over each frame, which costs time, too",
    ),
    options.JSON,
)


def _run(arguments: argparse.Namespace) -> None:
    if arguments.output is not None:
        prepare_image(arguments.output)
    prepare_eye_images(arguments)
    arguments.reproject = arguments.reproject or arguments.holes is not None
    settings = merge_settings(arguments)
    if arguments.stereo is not None:
        arguments.reproject, arguments.far_error = settings.reprojects, settings.far_error
    scene = open_scene(arguments.scene)
    if arguments.output is None:
        check_output_file(Path(f"{short_name(scene)}.png"), "--output")
    frames = range(arguments.frame, arguments.frame + arguments.frames)
    path_frames = [
        replace(path_frame, camera=settings.adapt_camera(path_frame.camera))
        for path_frame in parse_path_frames(arguments.camera or next(iter(scene.views)), scene, frames)
    ]
    if arguments.record is not None:
        arguments.record.parent.mkdir(parents=True, exist_ok=True)
        CameraPath.record([path_frame.camera for path_frame in path_frames]).save(arguments.record)
        note(f"wrote {arguments.record}: {len(path_frames)} frames")
    with (
        rhi.create_device(arguments.backend, record=True if arguments.trace is not None else None) as device,
        settings.open(
            device,
            scene,
            arguments.size,
            technique=_make_technique_to_show(arguments, settings, scene, device),
        ) as renderer,
        ExitStack() as layers,
    ):
        renderer.light_component = COMPONENTS.get(arguments.show, renderer.light_component)
        renderer.stereo = make_stereo(
            arguments, scene, path_frames[0].camera.with_aspect(arguments.size[0] / arguments.size[1])
        )
        if arguments.particles:
            renderer.layers.append(Particles(device))
        if arguments.overlay:
            renderer.layers.append(Overlay(device, scale=max(1, arguments.size[1] // 720)))
        for layer in renderer.layers:
            layers.callback(layer.destroy)
        for _ in show_progress(warm_up(renderer), "find the fastest technique"):
            measure_frame(renderer, path_frames[0])
        costs = []
        for path_frame in show_progress(path_frames, "render"):
            result, cost = measure_frame(renderer, path_frame)
            costs.append(cost)
        if arguments.trace is not None:
            arguments.trace.parent.mkdir(parents=True, exist_ok=True)
            save(device, arguments.trace)
            note(f"wrote {arguments.trace}: {len(device.stream):,} commands")
        image, overflowing, holes, rivalry = None, None, None, None
        if device.capabilities.shading:
            overflowing = count_overflowing(result.targets)
            image = prepare_image(arguments.output or Path(f"{short_name(scene)}.png"))
            watched = renderer.technique
            if isinstance(watched, ResourceCapture) and watched.texels is not None:
                write_image(image, texture_to_image(arguments.show, watched.texels))
            else:
                write_image(image, result.image.read())
            if arguments.reproject and arguments.stereo is not None:
                holes = write_holes(result, arguments.holes)
            if arguments.glasses is not None:
                rivalry = write_glasses(result.image.read(), arguments.glasses)
        else:
            note(f"the {device.backend_name} device records and draws nothing: there is no image")
        technique = explain_technique(renderer.technique, arguments)
        report = describe_run(renderer, costs, image, overflowing, technique, holes, rivalry)
    print(json.dumps(report) if arguments.json else format_report(report))


def _make_technique_to_show(
    arguments: argparse.Namespace, settings: RenderSettings, scene: Scene, device: rhi.Device
) -> Technique:
    """The technique that draws what `--show` names. Buffers need a technique that stays the same."""
    if arguments.show in INSPECTIONS:
        return Inspection(arguments.show, settings.technique.get_cluster_settings(arguments.show))
    technique = settings.technique
    if arguments.show is None or arguments.show in COMPONENTS:
        return technique.make(scene, device)
    if technique.name == AutoTechnique.name:
        arguments.technique = Forward.name
    return ResourceCapture(replace(technique, name=arguments.technique).make(scene, device), arguments.show)


def warm_up(renderer: Renderer) -> Iterator[None]:
    """Yield once for each uncounted frame: one, and with `auto` all of its trials."""
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
    rivalry: float | None = None,
) -> dict[str, Any]:
    """The report that `--json` prints."""
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
        **_describe_streaming(renderer),
        **({} if overflowing is None else {"overflowing_pixels": overflowing}),
        **(
            {"unshadowed_lights": renderer.shadows.unshadowed_lights}
            if renderer.shadows.unshadowed_lights
            else {}
        ),
        **({} if renderer.stereo is None else _describe_stereo(renderer.stereo)),
        **({} if holes is None else {"holes": holes}),
        **({} if rivalry is None else {"rivalry": rivalry}),
        "image": None if image is None else str(image),
        **report_omissions(renderer.scene),
    }


def _describe_streaming(renderer: Renderer) -> dict[str, Any]:
    """The images and levels for which there is no memory; empty if there are none."""
    images = renderer.images
    report = None if images is None or images.stream is None else images.stream.report
    if report is None or not report.reduced:
        return {}
    return {"reduced_images": report.reduced, "lost_levels": report.lost_levels}


def _describe_stereo(stereo: Stereo) -> dict[str, Any]:
    rig = stereo.rig
    return {"stereo": stereo.output, "eye_distance": rig.eye_distance, "convergence": rig.convergence}


def format_report(report: dict[str, Any]) -> str:
    """Format the report as text."""
    times = report["milliseconds"]
    printed = report | {
        "size": "{} × {}".format(*report["size"]),
        "milliseconds": f"{times['median']:.2f} (least {times['min']:.2f}, most {times['max']:.2f})",
        "image": report["image"] or "none: this device draws nothing",
    }
    printed.pop("left_out", None)  # printed on stderr already
    texts = {key: f"{value:,}" if isinstance(value, int) else value for key, value in printed.items()}
    names = {"uploads_bytes": "bytes uploaded", "image_bytes": "bytes of images"}
    return "\n".join(
        f"{names.get(key, key.replace('_', ' ')) + ':':<24}{text}" for key, text in texts.items()
    )


COMMAND: Final = Subcommand(
    "render", "render a scene to an image and report what it cost", _OPTIONS, _run, __doc__
)
