"""`debug visibility`: draw what was culled and why, from the camera and from above (thesis, Figures 6.1,
6.3).

  python -m renderer debug visibility city --frame 900 --output culled.png
  python -m renderer debug visibility city --algorithm frustum --camera sky --frame 700
  python -m renderer debug visibility hall --algorithm stop_and_wait --camera aisle --json

The left image is the camera's frame with the edges of bounding boxes; those of hidden objects are drawn over
what hides them. The right image shows the boxes from above, except those that cover more than a twentieth of
it. The frames before are drawn first, for algorithms that use the results of earlier frames (see --warm-up).
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

import rhi
from renderer.cli import options
from renderer.cli.arguments import load_settings, open_scene
from renderer.cli.output import OutputError, note, prepare_image, print_report
from renderer.cli.subcommand import Subcommand
from renderer.content import parse_path_frames
from renderer.lab.measure.culling_images import (
    COLORS,
    MEANINGS,
    CullingOutcome,
    compute_outcomes,
    render_culling_from_above,
    render_culling_from_camera,
)
from renderer.renderer import Renderer
from renderer.visibility import make_visibility

if TYPE_CHECKING:
    from PIL import Image

_LEGEND = 22
"""Height in pixels of the line of text below the images."""


_OPTIONS: Final = (
    options.SCENE,
    options.visibility("chc_plus_plus", flag="--algorithm"),
    options.settings(
        "file with the parameters of the visibility algorithms, written by `tune` or `accuracy`", "b=50, n=20"
    ),
    options.camera("ground"),
    options.frame("frame of the path"),
    options.count("--warm-up", "number of frames to draw before it", 30, minimum=0),
    options.BACKEND,
    options.size(what="size of each of the two images in pixels"),
    options.output_file("--output", "file to write", default="visibility.png"),
    options.switch("--json", "print the number of objects of each outcome as JSON"),
)


def _run(arguments: argparse.Namespace) -> None:
    path = prepare_image(arguments.output)
    settings = load_settings(arguments).visibility
    scene = open_scene(arguments.scene)
    path_frames = parse_path_frames(
        arguments.camera, scene, range(max(arguments.frame - arguments.warm_up, 0), arguments.frame + 1)
    )
    with rhi.create_device(arguments.backend) as device:
        if not device.capabilities.renders:
            raise OutputError(
                f"--backend: the {device.backend_name} device draws nothing, so there is no image"
            )
        algorithm = make_visibility(arguments.algorithm, scene, device, settings)
        with Renderer(device, scene, visibility=algorithm, size=arguments.size) as renderer:
            for path_frame in path_frames:
                result = renderer.render(path_frame.camera, path_frame.seconds)
            camera = path_frame.camera.with_aspect(arguments.size[0] / arguments.size[1])
            outcomes = compute_outcomes(scene, camera, result.visible)
            images = (
                render_culling_from_camera(renderer, camera, result, outcomes),
                render_culling_from_above(renderer, camera, outcomes),
            )
    counts = {outcome: int((outcomes == outcome).sum()) for outcome in CullingOutcome}
    compose(images, counts).save(path, optimize=True)
    note(f"wrote {path}")
    if arguments.json:
        numbers = {outcome.name.lower(): count for outcome, count in counts.items()}
        print_report({"image": str(path)} | numbers, scene)
    else:
        print("\n".join(f"{count:>8,} {MEANINGS[outcome]}" for outcome, count in counts.items()))


def compose(
    images: tuple[NDArray[np.uint8], NDArray[np.uint8]], counts: dict[CullingOutcome, int]
) -> Image.Image:
    """Join both images side by side above a legend of the colours."""
    side_by_side = np.concatenate([pixels[:, :, :3] for pixels in images], axis=1)
    height, width = side_by_side.shape[:2]
    from PIL import Image, ImageDraw  # optional

    image = Image.new("RGB", (width, height + _LEGEND))
    image.paste(Image.fromarray(side_by_side))
    draw = ImageDraw.Draw(image)
    for column, (outcome, count) in enumerate(counts.items()):
        left = 6 + column * width // len(counts)
        color = tuple((255.0 * rhi.to_srgb(np.array(COLORS[outcome]))).round().astype(int).tolist())
        draw.rectangle((left, height + 6, left + 10, height + 16), fill=color)
        draw.text((left + 16, height + 5), f"{MEANINGS[outcome]}: {count:,}", fill=(230, 230, 230))
    return image


COMMAND: Final = Subcommand("visibility", "draw what was culled and why", _OPTIONS, _run, __doc__)
