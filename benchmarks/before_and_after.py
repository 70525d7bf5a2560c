"""Images of the city and the bazaar without effects and with them, in about the same time.

*Before* is drawn by `clustered`, without smoothed edges and without effects. *After* is drawn by `deferred_plus` at
fewer pixels, and what that saves pays for effects. The city, at .9 of the width and height, has a sky all around that
lights it and is mirrored, a sun half a degree wide, bloom, and smoothed edges (FXAA). The bazaar, at .8, has lights of
12 cm with penumbras, bloom, and the samples of several frames put together (`temporal`).

Both take turns, frame by frame, in one process, along the path on the ground; times are from the begin of a frame until
the device is finished. `--images` writes the last frames, before on the left.

    python benchmarks/before_and_after.py [--backend gl] [--size 960x540] [--rounds 24] [--images FOLDER] [--json]
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Final

import numpy as np
from numpy.typing import NDArray

import rhi
from renderer.cli import options
from renderer.cli.comparison import run_benchmark
from renderer.cli.output import prepare_image, write_image
from renderer.content import load_scene
from renderer.frame import TemporalSettings
from renderer.lab.comparison import Column, Record, Subject, compare, interval, ratio, time
from renderer.renderer import FrameResult
from renderer.scene import PathFrame
from renderer.settings import RenderSettings
from renderer.techniques import TechniqueSettings

COLUMNS: Final[dict[str, Column]] = {
    "ms": time(1e3, 1),
    "processor_ms": time(1e3, 1, processor=True),
    "ratio": ratio(2, processor=True),
    "ratio_interval": interval(2),
}
BEFORE: Final = RenderSettings(technique=TechniqueSettings("clustered"), algorithm="frustum")
SMOOTH_EDGES: Final = BEFORE.change_all(
    {"technique": TechniqueSettings("deferred_plus", fxaa=True), "scale": 0.9}
)
FEWER_PIXELS: Final = BEFORE.change_all(
    {
        "technique": TechniqueSettings("deferred_plus"),
        "temporal": TemporalSettings(is_on=True),
        "scale": 0.8,
    }
)
SCENES: Final = {
    "city": {
        "before": ("city:shadows=1", BEFORE),
        "after": ("city:shadows=1,environment=1.5,sun_degrees=0.5,bloom=0.03", SMOOTH_EDGES),
    },
    "bazaar": {
        "before": ("bazaar", BEFORE),
        "after": ("bazaar:radius=0.12,bloom=0.06", FEWER_PIXELS),
    },
}
FIRST_FRAME: Final = 420


def make_drawing(
    stack: ExitStack, device: rhi.Device, spec: str, settings: RenderSettings, size: tuple[int, int]
) -> tuple[Callable[[int], None], Callable[[], NDArray[np.uint8]]]:
    """Make a function that draws a frame of the path on the ground, and one that reads the last one."""
    scene = load_scene(spec)
    renderer = stack.enter_context(settings.open(device, scene, size))
    path = scene.paths["ground"]
    results: list[FrameResult] = []

    def draw(number: int) -> None:
        frame = path.path_frame(FIRST_FRAME + number)
        frame = PathFrame(frame.number, frame.camera.with_aspect(size[0] / size[1]))
        results[:] = [settings.render(renderer, frame)]
        device.finish()

    return draw, lambda: results[0].image.read()


def measure(arguments: argparse.Namespace) -> Iterator[Record]:
    """Yield the times of each scene's images."""
    for title, variants in SCENES.items():
        output = arguments.images and prepare_image(arguments.images / f"{title}-before-and-after.png")
        with ExitStack() as stack:
            device = stack.enter_context(rhi.create_device(arguments.backend))
            drawings = {
                name: make_drawing(stack, device, spec, settings, arguments.size)
                for name, (spec, settings) in variants.items()
            }
            subjects = [
                Subject({"scene": title, "image": name}, draw, device=device)
                for name, (draw, _) in drawings.items()
            ]
            yield from compare(subjects, COLUMNS, range(arguments.rounds), warm_ups=3)
            if output:
                write_image(output, np.concatenate([read() for _, read in drawings.values()], axis=1))


OPTIONS = (
    options.option("--backend", "the device", "gl"),
    options.size(),
    options.rounds("rounds", 24),
    options.output_folder("--images", "folder for the last frames, before on the left"),
)


if __name__ == "__main__":
    run_benchmark(__doc__, OPTIONS, measure)
