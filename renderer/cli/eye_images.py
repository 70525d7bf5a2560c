"""Images of what each eye sees: the holes of a reprojected eye, and an anaglyph through its glasses."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

import rhi
from renderer.cli.output import OutputError, note, prepare_image, write_image
from renderer.renderer import FrameResult
from renderer.stereo import (
    ANAGLYPHS,
    GLASSES,
    compute_brightness,
    compute_rivalry,
    read_hole_mask,
    view_through_glasses,
)
from rhi.math.indexing import repeat_each

_MAGENTA: Final = (255, 0, 255, 255)


def prepare_eye_images(arguments: argparse.Namespace) -> None:
    """Check that the images of `--holes` and `--glasses` can be written."""
    if arguments.holes is not None:
        prepare_image(arguments.holes, "--holes")
    if arguments.glasses is not None:
        prepare_image(arguments.glasses, "--glasses")
        if arguments.stereo not in ANAGLYPHS:
            raise OutputError(f"--glasses: needs --stereo with an anaglyph: {', '.join(ANAGLYPHS)}")


def write_holes(result: FrameResult, path: Path | None) -> int:
    """Count the holes in a reprojected image; write it with them to `path`."""
    _, right = result.frames
    holes = read_hole_mask(right)
    if path is not None:
        pixels = right.targets.image.read()
        pixels[holes] = _MAGENTA
        write_image(path, pixels)
        note(f"wrote {path}: holes are magenta")
    return int(holes.sum())


def write_glasses(image: NDArray[np.uint8], path: Path) -> float:
    """Write what each eye sees of an anaglyph: above through the red and the cyan glass, below the brightness alone.
    Return the mean difference of both eyes' brightness, 0 to 1."""
    light = rhi.from_srgb(image[..., :3] / 255.0)
    seen = view_through_glasses(light)
    brightness = [
        repeat_each(compute_brightness(color, glass)[..., None], 3, axis=-1)
        for color, glass in zip(seen, GLASSES.values(), strict=True)
    ]
    both = np.concatenate([np.concatenate(row, axis=1) for row in (seen, brightness)])
    write_image(path, (255.0 * rhi.to_srgb(both) + 0.5).astype(np.uint8))
    note(f"wrote {path}: through the red and the cyan glass, and below the brightness of both")
    return round(compute_rivalry(light), 4)
