"""Costs and errors of levels of detail in a field of dense meshes.

Each object is a sphere with bumps, of some side² triangles, with up to 6 levels; the field leads away from the eye.
Frames have a shadow map of the sun. The variants draw with other limits of the error in pixels, 0 for full meshes, and
take turns, round by round, in one process. Times are medians over the rounds, from the frame's begin until the device
is finished; *different* is the share of pixels, in percent, that differ from the full meshes' by more than 8 levels of
255.

With `--lists` the variants are draws of the CPU (`frustum`) and lists of the device (`two_pass`), with a draw for each
object and with instances, each without levels and with them, and there is no shadow map. Draws are those of the last
frame.

    python benchmarks/detail.py [--lists] [--backend gl] [--objects 1024] [--side 64] [--rounds 7] [--json]
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

import rhi
from renderer.cli import options
from renderer.cli.comparison import run_benchmark
from renderer.content.shapes import bumpy_sphere
from renderer.lab.comparison import Column, Record, Subject, average, compare, ratio, time
from renderer.renderer import FrameResult, Renderer
from renderer.scene import Camera, Scene, SceneBuilder, translation
from renderer.scene.meshes import make_geometry
from renderer.visibility.gpu.two_pass import TwoPassCulling

LIMITS: Final = (0.0, 0.5, 1.0, 2.0, 4.0)
LIST_LIMITS: Final = (0.0, 1.0)
SIZE: Final = (960, 540)
SPACING: Final = 3.0
COLUMNS: Final[dict[str, Column]] = {
    "triangles": average(0),
    "draws": average(0),
    "different": average(3),
    "milliseconds": time(),
    "ratio": ratio(),
}
"""The columns of a frame's cost; the ratio is to the first variant."""


class SingleDraws(TwoPassCulling):
    """Culling whose lists have a draw for each object."""

    has_instances = False


DRAWN: Final = {
    "by the CPU": None,
    "in lists, one by one": SingleDraws,
    "in lists, as instances": TwoPassCulling,
}
"""The algorithms by how objects are drawn; None for the frustum's."""


def make_field(count: int, side: int, casts_shadow: bool) -> Scene:
    """Make so many objects on the ground, each of about `side`² triangles."""
    builder, row_length = SceneBuilder("field"), math.ceil(count**0.5)
    column, row = np.arange(count) % row_length, np.arange(count) // row_length
    positions = np.stack([SPACING * (column - 0.5 * row_length), 0.0 * row, -SPACING * row], axis=1)
    nodes = builder.add_nodes(translation(positions))
    builder.add_objects(nodes, builder.add_mesh(bumpy_sphere(side, 0.08), levels=6), builder.add_material())
    reach = 2.0 * SPACING * row_length
    corners = [(-reach, -1.2, -reach), (-reach, -1.2, reach), (reach, -1.2, reach), (reach, -1.2, -reach)]
    builder.add_objects(
        builder.add_node(),
        builder.add_mesh(make_geometry(corners, [0, 1, 2, 0, 2, 3])),
        builder.add_material(),
    )
    builder.lights.add_directional((0.3, -1.0, -0.5), casts_shadow=casts_shadow)
    return builder.build()


class Variant:
    """A renderer with one limit of the error, whose objects an algorithm draws."""

    result: FrameResult
    number: int

    def __init__(
        self,
        device: rhi.Device,
        scene: Scene,
        pixels: float,
        full: Variant | None,
        algorithm: TwoPassCulling | None = None,
    ) -> None:
        self.device, self.full, self.algorithm = device, full or self, algorithm
        self.renderer = Renderer(
            device, scene, visibility=algorithm or "frustum", size=SIZE, technique="forward"
        )
        self.renderer.detail_error = pixels

    def draw(self, number: int) -> None:
        """Draw a frame from an eye that moves on a little."""
        self.number = number
        camera = Camera.look_at((0.0, 4.0, 8.0 - 0.01 * number), (0.0, 0.0, -26.0))
        self.result = self.renderer.render(camera)
        self.device.finish()

    def read(self) -> NDArray[np.int64]:
        return self.result.image.read()[..., :3].astype(np.int64)

    def count(self) -> Mapping[str, float]:
        if self.full.number != self.number:  # variants take turns in any order
            self.full.draw(self.number)
        differs = np.abs(self.read() - self.full.read()).max(axis=2) > 8
        return {
            "triangles": self.result.statistics.triangles,
            "draws": self.count_draws(),
            "different": 100.0 * float(differs.mean()),
        }

    def count_draws(self) -> int:
        """Return the draws of objects: those of both lists where the device makes them."""
        algorithm = self.algorithm
        if algorithm is None:
            return len(self.result.visible)
        return sum(int(draws.totals.read()[:-1].sum()) for draws in (algorithm.first, algorithm.second))

    def destroy(self) -> None:
        self.renderer.destroy()
        if self.algorithm is not None:
            self.algorithm.destroy()


def measure(arguments: argparse.Namespace) -> Iterator[Record]:
    """Yield the cost of each limit, or of each way to draw."""
    scene = make_field(arguments.objects, arguments.side, not arguments.lists)
    cells = [(drawn, pixels) for drawn in DRAWN for pixels in LIST_LIMITS]
    if not arguments.lists:
        cells = [("by the CPU", pixels) for pixels in LIMITS]
    with rhi.create_device(arguments.backend) as device:
        variants: list[Variant] = []
        for drawn, pixels in cells:
            kind = DRAWN[drawn]
            algorithm = None if kind is None else kind(scene, device)
            variants.append(Variant(device, scene, pixels, variants[0] if variants else None, algorithm))
        subjects = [
            Subject({"drawn": drawn, "pixels": pixels}, variant.draw, count=variant.count, device=device)
            for (drawn, pixels), variant in zip(cells, variants, strict=True)
        ]
        yield from compare(subjects, COLUMNS, range(arguments.rounds), warm_ups=2)
        for variant in variants:
            variant.destroy()


OPTIONS = (
    options.option("--backend", "the device", "gl"),
    options.count("--objects", "objects", 1024),
    options.count("--side", "the root of the triangles of each object", 64),
    options.switch("--lists", "compare draws of the CPU with lists of the device"),
    options.rounds("rounds", 7),
)


if __name__ == "__main__":
    run_benchmark(__doc__, OPTIONS, measure)
