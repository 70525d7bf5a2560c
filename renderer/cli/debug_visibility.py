"""`debug visibility`: what was culled and why, from the camera and from above (thesis, Figures 6.1 and 6.3)."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

import rhi
from renderer.cli.arguments import (
    add_backend,
    add_command,
    add_scene,
    add_settings,
    add_size,
    load_settings,
    parse_frame,
)
from renderer.cli.output import OutputError, note, prepare_image
from renderer.content import load_scene, parse_camera
from renderer.measure.pictures import (
    COLORS,
    MEANINGS,
    CullingOutcome,
    find_fates,
    picture_from_above,
    picture_from_camera,
)
from renderer.renderer import Renderer
from renderer.scene import FRAMES_PER_SECOND
from renderer.visibility import ALGORITHMS, make_visibility

_EXAMPLES = """\
  python -m renderer debug visibility city --frame 900 --output culled.png
  python -m renderer debug visibility city --algorithm frustum --camera sky --frame 700
  python -m renderer debug visibility hall --algorithm stop_and_wait --camera aisle --json

To the left what the camera sees, with the edges of bounding boxes, those of hidden objects through what hides
them; to the right the boxes from above, but for those that cover more than a twentieth of the picture. An
algorithm that remembers is given the frames before."""

_LEGEND = 22
"""Pixels of a line of text and numbers below the pictures."""


def add_to(subjects: Any) -> None:
    """Add the command."""
    parser = add_command(subjects, "visibility", run, "picture what was culled and why", _EXAMPLES)
    add_scene(parser)
    parser.add_argument(
        "--algorithm", choices=ALGORITHMS, default="chc_plus_plus", help="(default: %(default)s)"
    )
    add_settings(parser)
    parser.add_argument(
        "--camera",
        default="ground",
        metavar="CAMERA",
        help="a path, a walk-through's .json, a view of the scene, x,y,z, or x,y,z,x,y,z (default: %(default)s)",
    )
    parser.add_argument("--frame", type=parse_frame, default=0, metavar="N", help="of the path (default: 0)")
    parser.add_argument(
        "--warm-up",
        type=parse_frame,
        default=30,
        metavar="N",
        help="how many frames to draw before (default: %(default)s)",
    )
    add_backend(parser)
    add_size(parser, what="of each of the two pictures")
    parser.add_argument(
        "--output", type=Path, default=Path("visibility.png"), metavar="F.png", help="(default: %(default)s)"
    )
    parser.add_argument("--json", action="store_true", help="print how many objects had which fate, as JSON")


def run(given: argparse.Namespace) -> None:
    """Draw and write."""
    path = prepare_image(given.output)
    settings = load_settings(given)
    scene = load_scene(given.scene)
    frames = range(max(given.frame - given.warm_up, 0), given.frame + 1)
    cameras = [parse_camera(given.camera, scene, frame) for frame in frames]
    with rhi.create_device(given.backend) as device:
        if not device.capabilities.renders:
            raise OutputError(f"--backend: the {device.backend_name} device draws nothing to picture")
        algorithm = make_visibility(given.algorithm, scene, device, settings)
        with Renderer(device, scene, visibility=algorithm, size=given.size) as renderer:
            for frame, camera in zip(frames, cameras, strict=True):
                result = renderer.render(camera, frame / FRAMES_PER_SECOND)
            camera = cameras[-1].with_aspect(given.size[0] / given.size[1])
            fates = find_fates(scene, camera, result.visible)
            pictures = (
                picture_from_camera(renderer, camera, result, fates),
                picture_from_above(renderer, camera, fates),
            )
    counts = {fate: int((fates == fate).sum()) for fate in CullingOutcome}
    compose(pictures, counts).save(path, optimize=True)
    note(f"wrote {path}")
    if given.json:
        print(json.dumps({"image": str(path)} | {fate.name.lower(): count for fate, count in counts.items()}))
    else:
        print("\n".join(f"{count:>8,} {MEANINGS[fate]}" for fate, count in counts.items()))


def compose(pictures: tuple[NDArray[np.uint8], NDArray[np.uint8]], counts: dict[CullingOutcome, int]) -> Image.Image:
    """Both side by side, and below what the colours mean."""
    side_by_side = np.concatenate([picture[:, :, :3] for picture in pictures], axis=1)
    height, width = side_by_side.shape[:2]
    image = Image.new("RGB", (width, height + _LEGEND))
    image.paste(Image.fromarray(side_by_side))
    draw = ImageDraw.Draw(image)
    for place, (fate, count) in enumerate(counts.items()):
        left = 6 + place * width // len(counts)
        color = tuple(round(255 * channel ** (1.0 / 2.2)) for channel in COLORS[fate])
        draw.rectangle((left, height + 6, left + 10, height + 16), fill=color)
        draw.text((left + 16, height + 5), f"{MEANINGS[fate]}: {count:,}", fill=(230, 230, 230))
    return image
