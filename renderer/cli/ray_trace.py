"""`ray-trace`: draw an image of a scene by rays, with reflections and refraction.

  python -m renderer ray-trace hall --size 320x180 --output rays.png
  python -m renderer ray-trace model.glb --bounces 4 --refraction-index 1.5 --rays 3
  python -m renderer ray-trace city --camera ground --frame 420 --bounces 0 --json

The reference ray tracer draws on the processor, in float64, and takes seconds to minutes. Without bounces its image is
the one that `render` approximates. With them, surfaces mirror each other, and transparent bodies bend what is behind
them. A scene with bloom or materials with shaders of their own is refused.
"""

from __future__ import annotations

import argparse
from time import process_time
from typing import Final

import numpy as np

from renderer.cli import options
from renderer.cli.arguments import open_scene
from renderer.cli.output import OutputError, note, prepare_image, print_report, write_image
from renderer.cli.subcommand import Subcommand
from renderer.content import parse_camera
from renderer.lab.measure.ray_tracer import RayTracer

_OPTIONS: Final = (
    options.SCENE,
    options.camera(),
    options.frame("frame of the path"),
    options.size((320, 180)),
    options.count("--rays", "rays along each side of a pixel", 2),
    options.count(
        "--bounces", "how many times rays go on from surfaces that mirror or bend them", 2, minimum=0
    ),
    options.option(
        "--refraction-index",
        "index of refraction of transparent objects, which are closed bodies then: water has 1.33, glass 1.5",
        1.0,
        metavar="N",
        type=options.parse_bound,
    ),
    options.switch("--penumbras", "shadows of whole sources instead of their centres, which takes longer"),
    options.output_file("--output", "image to write", default="ray-traced.png"),
    options.switch("--json", "print the result as JSON"),
)


def _run(arguments: argparse.Namespace) -> None:
    path = prepare_image(arguments.output)
    scene = open_scene(arguments.scene)
    width, height = arguments.size
    camera = parse_camera(arguments.camera or next(iter(scene.views)), scene, arguments.frame)
    begin = process_time()
    try:
        tracer = RayTracer(
            scene,
            has_penumbras=arguments.penumbras,
            bounces=arguments.bounces,
            refraction_index=arguments.refraction_index,
        )
    except ValueError as error:
        raise OutputError(str(error)) from error
    levels = tracer.draw(camera.with_aspect(width / height), arguments.size, arguments.rays)
    seconds = process_time() - begin
    write_image(path, np.rint(levels).astype(np.uint8))
    note(f"wrote {path}")
    rays = width * height * arguments.rays**2
    if arguments.json:
        report = {
            "image": str(path),
            "size": list(arguments.size),
            "rays": rays,
            "seconds": round(seconds, 2),
        }
        print_report(report, scene)
    else:
        print(f"{rays:,} rays from the eye, {seconds:.1f} s of processor time")


COMMAND: Final = Subcommand(
    "ray-trace", "draw an image by rays, with reflections and refraction", _OPTIONS, _run, __doc__
)
